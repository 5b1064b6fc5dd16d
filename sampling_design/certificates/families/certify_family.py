"""From a plant and a family of schedules to a proven certificate for all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from sampling_design import __version__
from sampling_design.certificates.exact.canonical import ScaledProblem, canonical, cut_weight, evened
from sampling_design.certificates.exact.certificate import WITHOUT_GAIN
from sampling_design.certificates.exact.given_weights import NoiseWeights, above_one, weights_of
from sampling_design.certificates.exact.proof import as_proven
from sampling_design.certificates.exact.retained_part import NEAREST, lyapunov_shapes
from sampling_design.certificates.exact.riccati import periodic_riccati_solution
from sampling_design.certificates.exact.weight_choice import rate_range
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.certificates.existence.counterexample import NearestFailure, refute
from sampling_design.certificates.families.family_certificate import FamilyCertificate
from sampling_design.certificates.families.graphs import PathCompleteGraph, graph_of, in_plant_terms, unrolled
from sampling_design.certificates.families.program import FamilyProgram, between
from sampling_design.certificates.families.step_proof import StepOutcome, dynamics_of, edge_conditions, node_conditions
from sampling_design.certificates.families.step_proof import prove as proven_along
from sampling_design.certificates.form.claims import FAMILY_CLAIM, RESOLUTION, STATED_MARGIN
from sampling_design.certificates.rigorous.decide import judged_while_sought
from sampling_design.errors import ArgumentError, CertificateError, SolverError, UndecidedError
from sampling_design.numerics.conic_programs import NO_TIME, TOO_LARGE
from sampling_design.numerics.filtering import propagate
from sampling_design.numerics.linalg import cut, discounted_flow, symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget, Progress
from sampling_design.records.record import Plain, SolverRecord, below, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import SamplingFamily

LARGEST_LAM = 1e8  # beyond this lambda a certificate is of no use and the conditions are lost in the solver's rounding
LAM_RTOL = 3e-3  # width of the bisection on lambda at the end; COARSE_RTOL while rates are compared
COARSE_RTOL = 0.05
LEAST_FLOOR = 1e-7
"""Kept information below this fraction of the nominal schedule's counts as none: the solver's tolerance, with room."""
LAYERS, LAYERS_GIVEN = 2, 6
"""Samples since the window's start that are told apart where P2 is chosen, and where it is given: the transient from
a given P2 may be long, and one matrix below all of it far too small."""
MOST_UNKNOWNS = 1500  # unknowns of a semidefinite program beyond which no layers are added
ROUNDS = 8  # how often a gap that the proof found may be added to the grid
SCAN, GOLDEN = 6, 4
"""Rates of the first scan, and bisections of the best one's neighbourhood afterwards."""
COMMENSURATE = 1e3  # up to this ratio noise of one and disturbances of one are weighed beside each other
RESPONSE = "noise as large as what disturbances of 1 do to an output within the longest gap"
TRIED_RATES = 3
MEMORY_GAIN = 1.1
"""Factor by which two levels of memory must raise the information that is kept, for a further one to be tried."""
IDLE = 1e-9
"""Least eigenvalue of the correlations of what the nominal schedule leaves, for coordinates: what nothing drives and
decays faster than errors are discounted has none, and below it more digits are lost than a solver has."""
ALIKE = " Without weights, bounds or scales w and v of 1 count alike: give w_bound, v_bound and initial_error."
NARROWINGS = 5  # halvings of the part of a family that is certified where the whole is undecided
LONGEST_PROOF = 60.0  # seconds in ball arithmetic for what doubles leave undecided
ROOM = 1.05  # factor on lambda where a gap that was added leaves no point at the lambda found before


@dataclass(frozen=True, eq=False)
class FamilyProposal:
    """Matrices of every node (P2 first), in the plant's terms as the graph and rate, for which all are proven.

    Where P is None there are none, and why: `kept` is the share of the nominal information that is kept, `gap` the one
    that is worst. `lam` is what they reach; without them the least on the grid, proven for nothing (infinite: none).
    """

    eta: float
    graph: PathCompleteGraph
    P: Array | None
    lam: float
    solver: SolverRecord
    kept: float
    gap: float | None

    @property
    def horizon(self) -> float:
        """ln(lam)/eta."""
        return float(np.log(max(self.lam, 1.0)) / self.eta)


@dataclass(frozen=True, eq=False)
class FamilySearch:
    """The semidefinite program of one plant, family and choice of weights, for one rate and memory after the other."""

    plant: Plant
    family: SamplingFamily
    weights: NoiseWeights
    P2: Array | None
    noise_gain: float
    budget: Budget = ENDLESS

    @cached_property
    def inner(self) -> ScaledProblem:
        """The problem in units in which the search is the same whatever those of the caller."""
        return evened(canonical(self.plant, self.family.nominal, self.weights, self.P2))

    def graph(self, memory: int, layers: int = LAYERS) -> PathCompleteGraph:
        """The family's graph with so much memory, and as many layers as there is room for."""
        graph, n = graph_of(self.family, memory, self.plant.n_outputs), self.plant.n_states
        room = MOST_UNKNOWNS // ((graph.count - 1) * n * (n + 1) // 2)
        return unrolled(graph, max(1, min(room, layers if self.P2 is None else LAYERS_GIVEN)))

    def program(self, eta: float, graph: PathCompleteGraph) -> FamilyProgram:
        """The inequalities in inner time, in coordinates where the nominal schedule keeps about the identity."""
        inner, n = self.inner, self.plant.n_states
        time, rate = inner.time, float(cut(eta * inner.time))
        edges = (replace(e, low=float(cut(e.low / time)), high=float(cut(e.high / time))) for e in graph.edges)
        graph = replace(graph, edges=tuple(edges))
        nominal = window_problem(inner.plant, inner.schedule, np.eye(n), *inner.weights, rate)
        Y = np.full((n, n), np.nan)  # of a nominal schedule that does not settle in doubles
        with suppress(SolverError):
            Y = np.mean(periodic_riccati_solution(nominal), axis=0)
        root = np.asarray(np.linalg.inv(_coordinate_root(Y)).T, dtype=np.float64)  # P = root root' = Y^-1
        dynamics = dynamics_of(inner.plant, inner.weights, rate, root, graph)
        given = None if self.P2 is None else dynamics.inside(cut_weight(inner.inside(self.P2)))
        sizes = self.plant.states.scales / inner.x  # beside each other: a common factor of all weights scales them all
        unit = dynamics.inside(np.diag(cut(np.min(sizes) / sizes) ** 2))
        return FamilyProgram(dynamics, graph, unit, given, self.budget)

    def least_lam(
        self, program: FamilyProgram, rtol: float, start: float = 2.0, enough: float = 0.0
    ) -> tuple[float, Array | None, float, SolverRecord]:
        """Return (lam, P, kept, solver): the least lambda on the grid, or one that is `enough`, and what is kept."""
        if program.P2 is not None:
            ratio, P, record = program.best_ratio()
            return (1 / ratio if P is not None else np.inf), P, max(ratio, 0.0), record
        floor, P, record = program.floor()
        kept = floor * float(np.linalg.eigvalsh(program.unit)[-1])
        if P is None or kept < LEAST_FLOOR:
            return np.inf, None, max(kept, 0.0), record
        low, high, lam, best = 1.0, np.inf, start, None
        missing, room = 0.0, 0.0  # slack at both ends, of which lambda is about a linear function
        while high > max(low * (1 + rtol), enough) and low < LARGEST_LAM and not self.budget.over:
            slack, matrices, record = program.feasible(lam, floor / self.noise_gain)
            if matrices is None:
                low, missing = lam, slack
            else:
                high, room, best, best_record = lam, slack, matrices, record
            lam = lam**2 * 2 if np.isinf(high) else low * between(high / low, missing, room, rtol)
        return (high, best, kept, best_record) if best is not None else (np.inf, None, kept, record)

    def propose(self, eta: float, memory: int, worst: float = LARGEST_LAM, enough: float = 0.0) -> FamilyProposal:
        """Return matrices for which every inequality is proven along its interval, or why there are none.

        They are those of the least lambda, or of one that is `enough`. One above `worst` on the grid ends the search.
        """
        graph = self.graph(memory)
        program = self.program(eta, graph)
        lam, P, kept, record = self.least_lam(program, LAM_RTOL, enough=enough)
        gap = None
        for _ in range(ROUNDS):
            if P is None or lam > worst or self.budget.over:
                break
            outcome = proven_along(program.dynamics, edge_conditions(program.dynamics, program.graph, P), self.budget)
            times = program.edge_times
            if outcome.failed:
                gap = self.inner.time * max(outcome.failed.values(), key=lambda item: item[1])[0]
            if outcome.proven:
                claimed, outcome = self._lam_of(program, P)
                if outcome.proven:
                    return FamilyProposal(eta, graph, self.outside(program, P), claimed, record, kept, gap)
                times = program.node_times
            program.gain(times, outcome.failed)
            if outcome.tight and not program.widen():
                break
            lam, P, kept, record = self.least_lam(program, LAM_RTOL, start=lam * ROOM, enough=max(enough, lam * ROOM))
        return FamilyProposal(eta, graph, None, lam, record, kept, gap)

    def outside(self, program: FamilyProgram, P: Array) -> Array:
        """Matrices of the program in the plant's terms; P2 as it was given."""
        found = np.stack([symmetrise(self.inner.outside(program.dynamics.outside(matrix))) for matrix in P])
        if self.P2 is not None:
            found[0] = self.P2
        return found

    @staticmethod
    def _lam_of(program: FamilyProgram, P: Array) -> tuple[float, StepOutcome]:
        """The lambda that the matrices reach, and the proof of (1 + margin) (1 - 1e-3) P2 <= lam Phi."""
        dynamics, graph, least = program.dynamics, program.graph, (1 + STATED_MARGIN) * (1 - RESOLUTION)
        parts = np.linspace(0.0, 1.0, 33)
        F, W = dynamics.flow(np.outer(graph.tops, parts).ravel())
        Y = propagate(np.repeat(np.linalg.inv(P), parts.size, axis=0), F, W)
        L = np.linalg.cholesky(P[0])
        lam = float(np.linalg.eigvalsh(symmetrise(L.T @ Y @ L))[:, -1].max())
        for _ in range(ROUNDS):
            outcome = proven_along(dynamics, node_conditions(graph, P, least * P[0] / lam))
            worst = max((theta for _, theta in outcome.failed.values()), default=0.0)
            if outcome.proven or worst < 1:
                break
            lam *= worst * (1 + RESOLUTION / 4)
        return lam, outcome

    def horizon(self, eta: float, memory: int) -> float:
        """ln(lam)/eta at a rate, roughly; infinite where there is nothing."""
        try:
            lam, P, _, _ = self.least_lam(self.program(eta, self.graph(memory, layers=1)), COARSE_RTOL)
        except CertificateError:
            return np.inf
        return np.inf if P is None else float(np.log(max(lam, 1.0)) / eta)

    def rates(self, bounds: tuple[float, float], memory: int, report: Progress) -> list[float]:
        """Rates in the order of the horizons that they promise."""
        scan = np.geomspace(*bounds, SCAN).tolist()
        return best_rates(scan, GOLDEN, lambda rate: self.horizon(rate, memory), lambda: self.budget.over, report)

    def decide(
        self, bounds: tuple[float, float], levels: Sequence[int], least: NearestFailure, report: Progress
    ) -> FamilyProposal:
        """Return the proposal with the least horizon at the least memory that has one; refuse, or say undecided."""
        missed: list[FamilyProposal] = []
        for level in levels:
            report(0.1, f"memory level {level}")
            proposal = self.propose(bounds[0], level)  # what exists at some rate exists at the least
            if proposal.P is not None:
                chosen = bounds[0] < bounds[1]
                return self.best_of(bounds, level, proposal, report) if chosen else proposal
            missed.append(proposal)
            if self.budget.over or proposal.solver.status in (TOO_LARGE, NO_TIME):
                break
            if len(missed) > 2 and proposal.kept < MEMORY_GAIN * missed[-3].kept:
                break  # two levels more, and no more information kept: memory is not what is missing
            if level == levels[0]:
                report(0.3, "search for a schedule without certificate")
                least = refute(self.plant, self.family, bounds[0], hints=[proposal.gap])
        raise _undecided(self, bounds[0], missed, least)

    def largest_part(self, eta: float, levels: Sequence[int]) -> SamplingFamily | None:
        """The largest part of the family, by halvings, that has a certificate at one of these levels of memory."""
        part, low, high = None, 0.0, 1.0
        for _ in range(NARROWINGS):
            smaller = self.family.narrowed(fraction := (low + high) / 2)
            if smaller is None or self.budget.over:
                break
            part_of, left = replace(self, family=smaller), levels
            while left and part_of.propose(eta, left[0], enough=LARGEST_LAM).P is None:
                left = left[1:]  # with less memory than a part needs, no larger one is tried
            low, high, part, levels = (fraction, high, smaller, left) if left else (low, fraction, part, levels)
        return part

    def by_own_decay(self, bounds: tuple[float, float], memory: int) -> FamilyProposal | None:
        """What the plant's own decay proves, whatever is sampled, without the noise gain; None if nothing."""
        own = -2 * float(np.max(np.linalg.eigvals(self.plant.A).real))
        if NEAREST * own < bounds[0]:
            return None
        eta = float(np.clip(own / 2, *bounds))
        inner, graph = self.inner, self.graph(memory, layers=1)
        program = self.program(eta, graph)
        dynamics = program.dynamics
        with suppress(SolverError, np.linalg.LinAlgError):
            for shape in lyapunov_shapes(inner, eta * inner.time, own * inner.time):
                lasting = dynamics.inside(symmetrise(shape))
                first = lasting if program.P2 is None else program.P2
                least = min(1.0, 1 / float(np.max(np.linalg.eigvals(np.linalg.solve(first, lasting)).real)))
                P = np.repeat((1 - RESOLUTION) * least * lasting[None], graph.count, axis=0)
                P[0] = first  # the others are below it, for a first sample that comes at once
                if proven_along(dynamics, edge_conditions(dynamics, program.graph, P), self.budget).proven:
                    lam, nodes = self._lam_of(program, P)
                    if nodes.proven:
                        kept = f"{WITHOUT_GAIN} {self.noise_gain:g}, for none was proven with it"
                        how: dict[str, Plain] = {"weights": kept} if program.P2 is None else {}
                        record = SolverRecord("sampling_design", __version__, "the plant decays on its own", 0, how)
                        return FamilyProposal(eta, graph, self.outside(program, P), lam, record, 0.0, None)
        return None

    def best_of(
        self, bounds: tuple[float, float], memory: int, known: FamilyProposal, report: Progress
    ) -> FamilyProposal:
        """The first of the most promising rates whose proposal is proven and better than `known`, else `known`.

        So it is where the time is over, or who asked interrupts: what is proven stays.
        """
        with suppress(KeyboardInterrupt):
            for rate in self.rates(bounds, memory, report)[:TRIED_RATES]:
                proposal = known if self.budget.over else self.propose(rate, memory)
                if proposal.P is not None and proposal.horizon < known.horizon:
                    return proposal
        return known


def _coordinate_root(Y: Array) -> Array:
    """A root of a covariance in the states' scales, for coordinates; of what decays and nothing drives, a little.

    Of one that cannot be followed, that of the scales themselves.
    """
    if not np.isfinite(Y).all():
        return np.eye(len(Y))
    size = np.where(np.diag(Y) > 0, np.diag(Y), 1.0)
    unit = np.sqrt(size)
    correlations = Y / np.outer(unit, unit)
    if np.linalg.eigvalsh(correlations)[0] < IDLE:
        Y = Y + IDLE * np.diag(size)
        Y = Y + np.diag(np.where(np.diag(correlations) > 0, 0.0, size))
    return np.asarray(np.linalg.cholesky(Y), dtype=np.float64)


def best_rates(
    scan: list[float], halvings: int, horizon: Callable[[float], float], over: Callable[[], bool], report: Progress
) -> list[float]:
    """Rates in the order of their finite horizons: a scan, then halvings of its best neighbourhood, until `over`."""
    tried: dict[float, float] = {}
    for rate in scan:
        if over():
            break
        tried[rate] = horizon(rate)
        report(0.3 * len(tried) / len(scan), "choice of the rate")
    for _ in range(halvings):
        ordered = sorted(tried)
        best = min(tried, key=lambda rate: (tried[rate], -rate), default=np.nan)
        if over() or not np.isfinite(tried.get(best, np.inf)):
            break
        place = ordered.index(best)
        for other in (ordered[max(place - 1, 0)], ordered[min(place + 1, len(ordered) - 1)]):
            rate = float(np.sqrt(best * other))
            if rate not in tried:
                tried[rate] = horizon(rate)
    return [rate for rate in sorted(tried, key=lambda rate: (tried[rate], rate)) if np.isfinite(tried[rate])]


@checked
def certify_family(
    plant: Plant,
    family: SamplingFamily,
    *,
    eta: float | None = None,
    P2: npt.ArrayLike | None = None,
    Qw: npt.ArrayLike | None = None,
    R: npt.ArrayLike | None = None,
    Qv: npt.ArrayLike | None = None,
    noise_gain: float = 3.0,
    budget: float | None = None,
    memory: int | None = None,
    progress: Progress | None = None,
) -> FamilyCertificate:
    """Certify that every schedule of a family makes a plant sample-based exponentially i-iIOSS (Assumption 7).

        Phi_h(P_u) + C'R~C >= P_v on every edge of the family's graph of gap words,    Phi_s(P_u) >= P2/lam

    Arguments as for `certify`. What is proven when the budget ends, or at an interrupt, is returned. Raises
    ArgumentError if one is out of range or family and plant do not fit, CertificateError if some schedule has no
    certificate (details `counterexample`, `gaps`, `eigenvalue`, `direction`), UndecidedError if neither was found.

    Notes
    -----
    *Assumptions.* As for `certify`. *Claim.* Holds for every schedule of the family, every real window start and
    every later time; lam is an upper bound on the family's supremum. *Method.* Semidefinite programs on a grid of gaps
    with a stated margin, bisection on lam, a search on eta; the continuum between the grid points is proven by
    stepping along it, and every gap where that fails joins the grid. `checkers` proves the result again by
    another route. *Numerical aspects.* Posed in coordinates where the nominal schedule keeps the identity.

    References
    ----------
    The paper, Assumption 7 and Theorem 17.
    """
    report = progress or (lambda fraction, message: None)
    family = in_plant_terms(plant, family)
    weights = weights_of(plant, Qw, R, Qv)
    if family.by_output and any(np.any(np.diag(np.diag(M)) != M) for M in (weights.R, weights.Qv)):
        raise ArgumentError("`R` and `Qv` must be diagonal where outputs are read at times of their own.")
    given = None if P2 is None else checks.definite("P2", P2, plant.n_states)
    rate = None if eta is None else checks.positive("eta", eta)
    noise_gain = above_one("noise_gain", noise_gain)
    limit = Budget(None if budget is None else checks.positive("budget", budget))
    levels = range(family.levels_of_memory) if memory is None else [checks.whole("memory", memory)]
    if not plant.n_states:
        return without_states(plant, family, weights, rate or 1.0, graph_of(family, levels[0], plant.n_outputs))
    bounds = rate_range(plant, family.nominal) if rate is None else (rate, rate)
    _refuse_too_long_gap(plant, float(graph_of(family, levels[0], plant.n_outputs).tops.max()), bounds[0])
    least = refute(plant, family, bounds[0], quick=True)
    search = FamilySearch(plant, family, weights, given, noise_gain, limit)

    def decided(weights: NoiseWeights) -> FamilyCertificate:
        with_them = replace(search, weights=weights)
        return certified(plant, family, weights, with_them.decide(bounds, levels, least, report))

    try:
        return decided(weights)
    except UndecidedError as error:
        told = plant.has_scales or any(weight is not None for weight in (P2, Qw, R, Qv))
        if error.details.get("status") != "undecided":
            raise
        other = None if told else _weights_by_response(plant, family)
        if other is not None and not limit.over:
            with suppress(UndecidedError):
                made = decided(other)
                return replace(made, solver=replace(made.solver, details={**made.solver.details, "weights": RESPONSE}))
        if (decaying := search.by_own_decay(bounds, levels[0])) is not None:
            with suppress(UndecidedError):
                return certified(plant, family, weights, decaying)
        text, details = str(error), dict(error.details)
        match details:
            case {"levels": int(tried)}:
                details["certified"] = part = search.largest_part(bounds[0], levels[:tried])
                text += "" if part is None else f" Certified is, as the largest part by halvings: {part.explain()}"
        text += "" if told else ALIKE
        raise UndecidedError(text, **details) from None


def _weights_by_response(plant: Plant, family: SamplingFamily) -> NoiseWeights | None:
    """Weights of noise as large as what disturbances of one do to an output within the longest gap.

        v_i^2 = d int_0^d |c_i e^{As} G|^2 ds,    Qw = I,    R = Qv = 2 diag(1/v_i^2)

    They go along with the units of the outputs. None where noise of one is about as large.
    """
    d = family.d_max
    _, W = discounted_flow(plant.A, plant.G @ plant.G.T, np.array([d]), 0.0)
    square = d * np.einsum("ij,jk,ik->i", plant.C, W[0], plant.C)
    near = (square > COMMENSURATE**-2) & (square < COMMENSURATE**2)
    if np.all(near | ~(square > 0) | ~np.isfinite(square)):
        return None
    usable = np.isfinite(square) & (square > 0)
    noise = 2.0 * np.diag(1.0 / np.where(usable, square, 1.0))
    return NoiseWeights(np.eye(plant.n_disturbances), noise, noise.copy())


def _refuse_too_long_gap(plant: Plant, longest: float, eta: float) -> None:
    """Say that it is undecided, before anything is tried, where the longest gap alone asks for too large a lambda.

    A window may start as the gap does, and nothing is measured until it ends: lambda is at least
    e^{(2 max Re mu + eta) h}.
    """
    rate, most = 2 * float(np.max(np.linalg.eigvals(plant.A).real)) + eta, 2 * float(np.log(LARGEST_LAM))
    if rate * longest > most:
        raise UndecidedError(
            f"undecided at rate {eta:.6g}: the squared error may grow by e^{rate * longest:.4g} within the longest gap "
            f"of {short(longest)}, and lambda is at least that; certificates of a family are sought up to "
            f"e^{most:.3g}. Gaps up to {short(most / rate)} can be tried.",
            status="undecided", eta=eta, growth=rate * longest, longest=most / rate,
        )  # fmt: skip


def certified(
    plant: Plant, family: SamplingFamily, weights: NoiseWeights, proposal: FamilyProposal, longest: float = np.inf
) -> FamilyCertificate:
    """The certificate of a proposal, judged by the independent checker; `longest` are seconds for ball arithmetic."""
    assert proposal.P is not None
    P, lam = proposal.P, max(proposal.lam, 1.0)
    made = FamilyCertificate(
        plant, family, P1=(1 - RESOLUTION) * P[0] / lam, P2=P[0], **weights._asdict(), eta=proposal.eta,
        lam=lam, lam_samples=lam, margin=STATED_MARGIN, solver=proposal.solver, graph=proposal.graph, P=P,
    )  # fmt: skip
    verdict = judged_while_sought(made.content, FAMILY_CLAIM, min(longest, LONGEST_PROOF))
    if not verdict.passed:
        raise UndecidedError(
            f"undecided: the proof of the certificate did not close: {verdict.reason}.",
            verification=verdict,
            certificate=made,
        )
    return as_proven(made)


def without_states(
    plant: Plant, family: SamplingFamily, weights: NoiseWeights, rate: float, graph: PathCompleteGraph
) -> FamilyCertificate:
    """The certificate where there is nothing to prove."""
    empty, P = np.zeros((0, 0)), np.zeros((graph.count, 0, 0))
    return FamilyCertificate(
        plant, family, P1=empty, P2=empty, **weights._asdict(), eta=rate, lam=1.0, lam_samples=1.0, graph=graph, P=P
    )


def _undecided(search: FamilySearch, eta: float, missed: list[FamilyProposal], least: NearestFailure) -> UndecidedError:
    """How far both sides came: the information that is kept, and the word that is observed worst."""
    if missed[-1].solver.status == TOO_LARGE:
        return UndecidedError(
            f"undecided at rate {eta:.6g}: the semidefinite program for {search.plant.n_states} states on this family "
            "would take more memory than a gigabyte. Certify rows of the state (`of`), or one schedule.",
            status="undecided", eta=eta, word=least.schedule,
        )  # fmt: skip
    if search.budget.over or missed[-1].solver.status == NO_TIME:
        return UndecidedError(
            f"undecided at rate {eta:.6g}: no certificate was proven within the budget, and no schedule of the family "
            "without one was found. Give it more time.", status="budget", eta=eta, word=least.schedule,
        )  # fmt: skip
    best = max(missed, key=lambda item: item.kept)
    known = f" Of the search for a counterexample: {least.searched}." if least.searched else ""
    return UndecidedError(
        f"undecided at rate {eta:.6g}: no certificate was found for this family, and no schedule of it without one."
        f"{known} The least observable schedule has the gaps {short(least.schedule.gaps)} (margin "
        f"{below(least.margin, 3)}).",
        status="undecided", eta=eta, levels=len(missed), kept=best.kept, gap=best.gap, word=least.schedule,
        margin=least.margin, searched=least.searched,
    )  # fmt: skip
