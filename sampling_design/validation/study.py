"""The scenarios of a validation, one method each, and the checks that they leave behind.

Assumption 7 itself is checked, inequality (16), along the worst pair of trajectories.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.constraints import Constraints
from sampling_design.estimators.gap_flows.cost_weights import CostFunction, largest_energy, marginal
from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.estimators.mhe import CLOSED_FORM, MovingHorizonEstimator
from sampling_design.numerics.filtering import inverse_root, measurement_update, propagate, whitened
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Progress
from sampling_design.records.record import Strength, moment, short
from sampling_design.records.sweeps import Journal
from sampling_design.records.workers import Workers
from sampling_design.schedules.family import AnySchedule
from sampling_design.validation.apriori_bound import AprioriBound, apriori_bound_of, worst_disturbance, worst_energy
from sampling_design.validation.error_map import ROUNDED, ErrorMap
from sampling_design.validation.monte_carlo import MonteCarloTrials, growth, measured, monte_carlo, own_growth, ratio
from sampling_design.validation.report import ROUNDING, ClaimCheck, ErrorCurve, ExampleRun, ValidationReport
from sampling_design.validation.scenario import (
    ErrorSources,
    EstimatedRun,
    ScenarioBounds,
    draw_inputs,
    driven,
    extent,
    initial_inputs,
    norm_of,
    real_run,
    resonant_inputs,
    true_run,
)
from sampling_design.validation.timeline import GAPS_TO_SETTLE, Timeline, build_timeline, default_duration

MOST_STARTS = 80  # window starts that are tried; they are spread evenly over the break points where there are more


def _pair_end(line: Timeline, start: int, span: float) -> int:
    """Break point at which pairs from `start` end."""
    return int(np.searchsorted(line.times, line.times[start] + span, side="right")) - 1


def sides(
    line: Timeline, certificate: SampledCertificate, start: int, stop: int, pairs: ErrorSources
) -> tuple[float, float]:
    """Simulate pairs from break point `start` to `stop`; return the largest |Dx|^2_P1 over the right side of (16).

    Returns that ratio and its time. `pairs` are differences e0, w and v of r pairs from one start, along the whole
    timeline. The right side counts samples in (start, t]; before and after each sample is looked at.
    """
    root, eta = np.linalg.cholesky(certificate.P1).T, certificate.eta
    x = pairs.e0
    total = np.einsum("ri,ij,rj->r", x, certificate.P2, x)
    best = (0.0, start)
    for c in range(start, stop):
        h, w = line.lengths[c], pairs.w[:, c]
        energy = np.einsum("ri,ij,rj->r", w, certificate.Qw, w)
        total = total * np.exp(-eta * h) + energy * discounted_length(eta, h)
        x = x @ line.F[c].T + w @ line.gamma[c].T
        left = np.sum((x @ root.T) ** 2, axis=1)
        best = max(best, (float(np.max(left / total)), c + 1))
        j = line.sample_at.get(c + 1)
        if j is not None:
            measured, v = line.masks[j] > 0, pairs.v[:, j]
            y = x @ line.plant.C.T + v
            total = total + np.einsum("ri,ij,rj->r", y, marginal(certificate.R, measured), y)
            total = total + np.einsum("ri,ij,rj->r", v, marginal(certificate.Qv, measured), v)
            best = max(best, (float(np.max(left / total)), c + 1))
    return best[0], float(line.times[best[1]])


def worst_pair(line: Timeline, certificate: SampledCertificate, span: float) -> tuple[float, float, float]:
    """Return how near the worst pair comes to equality in (16), over starts, times and w constant on cells.

    Returns the ratio of both sides, the start and the time.

    Least right side that leads to Dx(t) = xi is xi'Y^-1 xi; the pair that reaches it is found by going back from the
    worst xi, and then simulated like any other.
    """
    last = max(1, _pair_end(line, 0, max(line.times[-1] - span, 0.0)))
    starts = np.unique(np.linspace(0, last - 1, min(MOST_STARTS, last)).astype(int))
    root, best = np.linalg.cholesky(certificate.P1).T, (-np.inf, 0, 0)
    for start in starts:
        before, _ = _forward(line, certificate, int(start), _pair_end(line, int(start), span))
        tops = np.linalg.eigvalsh(symmetrise(root @ np.array(before) @ root.T))[:, -1]
        at = int(np.argmax(tops))
        best = max(best, (float(tops[at]), int(start), int(start) + at))
    _, start, stop = best
    stop = max(stop, start + 1)
    ratio, time = sides(line, certificate, start, stop, _backward(line, certificate, start, stop))
    return ratio, float(line.times[start]), time


def _cell_noise(line: Timeline, certificate: SampledCertificate, c: int) -> tuple[Array, Array]:
    """Gamma and (Qw delta)^-1 of a cell."""
    unit = np.linalg.inv(certificate.Qw) / discounted_length(certificate.eta, line.lengths[c])
    return line.gamma[c], unit


def _forward(line: Timeline, certificate: SampledCertificate, start: int, stop: int) -> tuple[list[Array], list[Array]]:
    """Covariances of one start, before and after each break point."""
    Y = np.asarray(np.linalg.inv(certificate.P2))
    before, later = [Y], [Y]
    for c in range(start, stop):
        gamma, unit = _cell_noise(line, certificate, c)
        Y = propagate(np.exp(certificate.eta * line.lengths[c]) * Y, line.F[c], gamma @ unit @ gamma.T)
        before.append(Y)
        j = line.sample_at.get(c + 1)
        if j is not None:
            measured = line.masks[j] > 0
            noise = np.linalg.inv(certificate.R) + np.linalg.inv(certificate.Qv)
            Y = measurement_update(Y, whitened(line.plant.C[measured], noise[np.ix_(measured, measured)]))
        later.append(Y)
    return before, later


def _backward(line: Timeline, certificate: SampledCertificate, start: int, stop: int) -> ErrorSources:
    """The pair of least right side that ends, just before `stop`'s sample, in the worst direction."""
    (before, later), plant = _forward(line, certificate, start, stop), line.plant
    root = np.linalg.cholesky(certificate.P1).T
    values, vectors = np.linalg.eigh(symmetrise(root @ before[-1] @ root.T))
    x = np.linalg.solve(root, vectors[:, -1] * np.sqrt(values[-1]))
    w = np.zeros((1, line.cells, plant.n_disturbances))
    v = np.zeros((1, line.samples.size, plant.n_outputs))
    for c in range(stop - 1, start - 1, -1):
        if c + 1 < stop and c + 1 in line.sample_at:
            j = line.sample_at[c + 1]
            measured = line.masks[j] > 0
            R, Qv = (marginal(M, measured)[np.ix_(measured, measured)] for M in (certificate.R, certificate.Qv))
            v[0, j, measured] = -np.linalg.solve(R + Qv, R @ plant.C[measured] @ x)
        gamma, unit = _cell_noise(line, certificate, c)
        half = inverse_root(before[c + 1 - start])
        dual = half.T @ (half @ x)
        w[0, c] = unit @ gamma.T @ dual
        x = np.exp(certificate.eta * line.lengths[c]) * later[c - start] @ line.F[c].T @ dual
    return ErrorSources(x[None], w, v)


Seeds = Sequence[np.random.SeedSequence]

SCENARIOS: tuple[str, ...] = ("pairs", "random", "worst", "resonant", "initial", "estimator", "constraints", "paper")

GROWTH_LIMIT = {"resonant": 1.5, "initial": 1.0}
"""Largest error of the second half over that of the first: a settled error under a disturbance in step with a mode
repeats itself (1), one that grows linearly doubles (2); what a wrong prior leaves decays. Times what a disturbance
that is slower than the run grows by itself."""
SETTLED = 3.0  # horizons that a run must last before its growth is judged
AGREEMENT = 1e-6
"""The real estimator and the linear error map may differ by this share of the largest error: steering an unstable truth
and solving the window problem cost some digits."""
REAL_RUNS = 3  # runs of the real estimator in each scenario that needs it
REAL_SAMPLES = 60  # samples of such a run
PAPER_RUNS = 64  # random runs of the paper's estimator
ROOMY = 100.0  # bounds this many times wider than what truth and estimates move in stay inactive
CHOSEN_HERE = ("prior", "prior_time", "constraints")


class ValidationStudy:
    """One plant, schedule and estimator under all scenarios."""

    def __init__(
        self,
        plant: Plant,
        schedule: AnySchedule,
        certificate: SampledCertificate | None,
        bounds: ScenarioBounds,
        options: dict[str, Any],
        duration: float | None,
    ):
        taken = [key for key in CHOSEN_HERE if key in options]
        if taken:
            raise ArgumentError(f"`{taken[0]}` is chosen by the scenarios, it cannot be given.")
        self.plant, self.schedule, self.certificate, self.bounds = plant, schedule, certificate, bounds
        self.options, self.duration = options, duration
        self.journal: Journal[MonteCarloTrials] | None = None
        self.skipped: list[str] = []
        self.checks: list[ClaimCheck] = []
        self.error_curves: list[ErrorCurve] = []
        self.example: ExampleRun | None = None
        estimator = self.estimator()
        self.horizon, self.begins = float(estimator.horizon), estimator.begins
        self.line = self._timeline(duration, self.horizon)
        self.map = ErrorMap(self.line, estimator, bounds)
        self.apriori = self._apriori(estimator)
        self.measure = self.apriori.root if self.apriori is not None else np.diag(1 / plant.states.scales)

    @property
    def _certified(self) -> SampledCertificate:
        assert self.certificate is not None  # there is no promise without one
        return self.certificate

    def _timeline(self, duration: float | None, horizon: float) -> Timeline:
        length = default_duration(self.schedule, horizon) if duration is None else duration
        length = checks.positive("duration", length)
        if not self.schedule.endless:
            length = min(length, float(self.schedule.times[-1]))
        return build_timeline(self.plant, self.schedule, length, horizon, self.begins)

    def estimator(self, plant: Plant | None = None, **more: Any) -> MovingHorizonEstimator:
        """Return the estimator under study, fresh."""
        bounds = {"w_bound": self.bounds.w, "v_bound": self.bounds.v, "initial_error": self.bounds.e0}
        return MovingHorizonEstimator(plant or self.plant, self.certificate, **{**self.options, **bounds, **more})

    def _apriori(self, estimator: MovingHorizonEstimator) -> AprioriBound | None:
        """The a-priori promise, if the estimator says that it is on the certificate's schedule all along."""
        if self.certificate is None:
            self.skipped.append("a-priori bounds and inequality (16): there is no certificate.")
            return None
        for t, mask in zip(self.line.times[self.line.samples], self.line.masks, strict=True):
            estimate = estimator.update(t, np.where(mask > 0, 0.0, np.nan))
            if not estimate.on_schedule:
                note = f"At t = {moment(t)}: {estimate.note}"
                self._find("a-priori bounds and inequality (16)", "not checked", 1.0, np.nan, note=note, checked=False)
                return None
        filtered = estimator.arrival_cost == "filtered"
        return apriori_bound_of(self.certificate, self.horizon, estimator.weights.cost, filtered)

    def run(self, scenarios: Sequence[str], seeds: Seeds, workers: Workers, progress: Progress | None) -> None:
        """Run the scenarios in order."""
        for k, name in enumerate(scenarios):

            def tell(fraction: float, message: str, k: int = k, name: str = name) -> None:
                if progress is not None:
                    progress((k + fraction) / len(scenarios), f"{name}: {message}")

            tell(0.0, "begun")
            getattr(self, f"_{name}")(seeds, workers, tell)
        if progress is not None:
            progress(1.0, "done")

    def report(self, settings: dict[str, object]) -> ValidationReport:
        """Return what was found."""
        bound = None if self.apriori is None else np.sqrt(self._largest(self.apriori))
        norm = "states over their scales" if self.apriori is None else f"|e|_P1, {self.apriori.theorem}"
        return ValidationReport(
            plant=self.plant,
            checks=tuple(self.checks),
            times=self.line.rows.times,
            bound=bound,
            norm=norm,
            error_curves=tuple(self.error_curves),
            example=self.example,
            settings=settings,
            skipped=tuple(self.skipped),
        )

    def _largest(self, apriori: AprioriBound) -> Array:
        b = self.bounds
        noise_energies = [largest_energy(weight, b.v) for weight in apriori.sample_weights(self.line.masks)]
        energies = largest_energy(apriori.prior, b.e0), largest_energy(apriori.w, b.w), np.array(noise_energies)
        return apriori.at_most(self.line, energies)

    def _judge(self, scenario: str, trials: MonteCarloTrials, strength: Strength = "sampled") -> None:
        """Checks that every linear scenario leaves: a-priori bound, plain bound, ellipsoids."""
        self.error_curves.append(ErrorCurve(scenario, trials.size.max(axis=0), np.median(trials.size, axis=0)))
        if self.apriori is not None:
            worst, source = float(np.max(trials.promised)), self.apriori.theorem
            note = _median_text(trials)
            self._find("a-priori bound", scenario, 1.0, worst, source=source, strength=strength, note=note)
            if source == "improved horizon theorem":
                self._plain(scenario, trials, strength)
        self._ellipsoids(scenario, trials.ellipsoid, _settled(trials.ellipsoid, self.line), strength)

    def _plain(self, scenario: str, trials: MonteCarloTrials, strength: Strength) -> None:
        b, times = self.bounds, self.line.rows.times
        bound = self._certified.error_bound(
            times, norm_of(b.e0), norm_of(b.w), norm_of(b.v), theorem="improved", length=self.horizon
        )
        worst = float(np.max(ratio(trials.plain.max(axis=0), bound)))
        self._find("Euclidean error bound", scenario, 1.0, worst, source=self.apriori.theorem, strength=strength)  # type: ignore[union-attr]

    def _ellipsoids(self, scenario: str, ratios: Array, settled: Array, strength: Strength = "sampled") -> None:
        worst, share = float(ratios.max()), float(np.mean(ratios <= 1 + ROUNDING))
        median = short(np.median(settled), 3) if settled.size else "-"
        note = f"{short(100 * share)} % inside; median ratio {median} after the first quarter"
        self._find("online ellipsoid", scenario, 1.0, worst, source="Theorem A", strength=strength, note=note)

    def _find(
        self, claim: str, scenario: str, predicted: float, observed: float, sense: str = "at most", **rest: Any
    ) -> None:
        self.checks.append(ClaimCheck(claim, scenario, predicted, observed, sense, **rest))

    def _pairs(self, seeds: Seeds, workers: Workers, tell: Progress) -> None:
        if self.apriori is None:
            return
        span = 3 * max(self.horizon, float(np.max(np.diff(self.line.times[self.line.samples]), initial=0.0)))
        source = "Assumption 7, equation (16)"
        largest, start, time = worst_pair(self.line, self._certified, span)
        where = f"at {moment(time)} from {moment(start)}"
        self._find("inequality (16)", "worst pair", 1.0, largest, source=source, strength="attained", note=where)

    def _random(self, seeds: Seeds, workers: Workers, tell: Progress) -> None:
        trials = monte_carlo(
            self.map, self.bounds, self.apriori, self.measure, seeds, workers, tell, journal=self.journal, name="random"
        )
        self._judge("random noise", trials)

    def _worst(self, seeds: Seeds, workers: Workers, tell: Progress) -> None:
        if self.apriori is not None:
            self._worst_energy(self.map, self.apriori)
        worst = worst_disturbance(self.map, self.bounds, self.measure)
        self._judge("worst disturbance", measured(self.map, self.apriori, self.measure, worst), "attained")

    def _worst_energy(self, error_map: ErrorMap, apriori: AprioriBound, scenario: str = "worst energy") -> None:
        largest, row, inputs = worst_energy(error_map, apriori)
        again = measured(error_map, apriori, apriori.root, inputs)
        note = f"worst at {moment(error_map.timeline.rows.times[row])}; run forward: {short(again.promised[0])}"
        observed = max(largest, float(again.promised[0]))
        self._find("a-priori bound", scenario, 1.0, observed, source=apriori.theorem, strength="attained", note=note)

    def _resonant(self, seeds: Seeds, workers: Workers, tell: Progress) -> None:
        inputs, names = resonant_inputs(self.line, self.bounds)
        trials = measured(self.map, self.apriori, self.measure, inputs)
        self._judge("resonant disturbance", trials)
        if self.line.times[-1] < SETTLED * self.horizon:
            self.skipped.append("growth under a resonant disturbance: the schedule ends within three horizons.")
            return
        if (self.certificate is None or not self.schedule.endless) and self.line.samples.size < GAPS_TO_SETTLE:
            where = "on a finite schedule" if self.certificate else "without a certificate"
            few = f"{self.line.samples.size} samples, {where} it settles in {GAPS_TO_SETTLE}."
            self.skipped.append(f"growth under a resonant disturbance: {few}")
            return
        if self.line.rarer:
            self.skipped.append("growth under a resonant disturbance: samples get rarer.")
            return
        grown = growth(trials.size, self.line.rows.times)
        own = own_growth(inputs.w, self.line.times[1:])
        at = int(np.argmax(grown / own))
        limit, note = GROWTH_LIMIT["resonant"] * float(own[at]), f"worst: {names[at]}"
        self._find("error does not grow", "resonant disturbance", limit, float(grown[at]), note=note)

    def _initial(self, seeds: Seeds, workers: Workers, tell: Progress) -> None:
        inputs = initial_inputs(self.line, self.bounds)
        self._judge("initial error", measured(self.map, self.apriori, self.measure, inputs), "attained")

    def _paper(self, seeds: Seeds, workers: Workers, tell: Progress) -> None:
        if self.apriori is None or {"cost", "horizon"} & set(self.options):
            return
        estimator = self.estimator(cost=CostFunction(form="paper"))
        line = self._timeline(self.duration, float(estimator.horizon))
        error_map = ErrorMap(line, estimator, self.bounds)
        apriori = apriori_bound_of(self._certified, float(estimator.horizon), "paper")
        trials = monte_carlo(
            error_map,
            self.bounds,
            apriori,
            apriori.root,
            seeds[:PAPER_RUNS],
            workers=workers,
            progress=tell,
            journal=self.journal,
            name="paper",
        )
        name, worst = "random noise, the paper's cost", float(np.max(trials.promised))
        self._find("a-priori bound", name, 1.0, worst, source=apriori.theorem, note=_median_text(trials))
        self._worst_energy(error_map, apriori, "worst energy, the paper's cost")
        self._ellipsoids(name, trials.ellipsoid, _settled(trials.ellipsoid, line))

    def _short(self, seeds: Seeds) -> tuple[ErrorMap, ErrorSources]:
        """The map of the first samples, and inputs along it, for runs of the real estimator."""
        error_map = self.map
        if self.line.samples.size > REAL_SAMPLES:
            line = self._timeline(float(self.line.times[self.line.samples[REAL_SAMPLES - 1]]), self.horizon)
            error_map = ErrorMap(line, self.estimator(), self.bounds)
        return error_map, draw_inputs(error_map.timeline, self.bounds, seeds[:REAL_RUNS])

    def _real_runs(
        self, line: Timeline, inputs: ErrorSources, tell: Progress, room: float | None = None, held: Array | None = None
    ) -> list[EstimatedRun]:
        """Runs of the real estimator; constrained to a box around the truth, wider by `room`, where that is given.

        Around the estimates, too, where their errors without constraints (r, R, n) are `held`: no constraint acts then.
        """
        runs = list[EstimatedRun]()
        for k in range(len(inputs.e0)):
            truth = true_run(line, inputs, k)
            states = truth.states if held is None else np.vstack([truth.states, truth.states[line.rows.at] + held[k]])
            limits = {} if room is None else {"constraints": Constraints(x=extent(states, room))}
            estimator = self.estimator(None if truth.u is None else driven(self.plant), **limits)
            runs.append(real_run(line, truth, estimator))
            tell((k + 1) / len(inputs.e0), f"run {k + 1}")
        return runs

    def _estimator(self, seeds: Seeds, workers: Workers, tell: Progress) -> None:
        error_map, inputs = self._short(seeds)
        runs = self._real_runs(error_map.timeline, inputs, tell)
        errors = np.array([run.errors for run in runs])
        self._agree("real estimator", runs, error_map, error_map.apply(inputs).e)
        self._estimates_keep_promises("real estimator", runs, error_map.timeline)
        radii = np.array([e.ellipsoid_radii for e in runs[0].estimates])
        self.example = ExampleRun(error_map.timeline.rows.times, errors[0], radii)

    def _agree(self, scenario: str, runs: list[EstimatedRun], error_map: ErrorMap, expected: Array) -> None:
        growth = np.abs(self.map.F * self.plant.states.scales / self.plant.states.scales[:, None]).max(initial=1.0)
        if ROUNDED * growth > AGREEMENT:
            self.skipped.append(f"difference to the linear error map ({scenario}): growth by {short(growth)} in a gap.")
            return
        held = np.abs([[each.x for each in run.estimates] for run in runs])  # an estimator widens what they hide
        hidden = ROUNDED * float(
            np.max(np.linalg.norm(np.einsum("kab,rkb->rka", np.abs(error_map.half), held), axis=2))
        )
        if hidden**2 > AGREEMENT:
            self.skipped.append(f"difference to the linear error map ({scenario}): rounding hides the weights' units.")
            return
        errors = np.array([run.errors for run in runs])
        size = float(np.max(np.linalg.norm(expected @ self.measure.T, axis=2)))
        away = float(np.max(np.linalg.norm((errors - expected) @ self.measure.T, axis=2)))
        self._find("difference to the linear error map", scenario, AGREEMENT, away / size if size else away)

    def _estimates_keep_promises(self, scenario: str, runs: list[EstimatedRun], line: Timeline) -> None:
        ratios, certified = np.array([run.ratios for run in runs]), np.array([run.certified for run in runs])
        if certified.any():
            self._ellipsoids(scenario, ratios[certified], _settled(ratios, line)[_settled(certified, line)])
        proven = float(np.mean(certified))
        failed = [e.note for r in runs for e in r.estimates if not e.certified]
        note = failed[0] if failed else ""
        self._find("share of proven estimates", scenario, 1.0, proven, "at least", note=note)

    def _constraints(self, seeds: Seeds, workers: Workers, tell: Progress) -> None:
        error_map, inputs = self._short(seeds)
        line, expected = error_map.timeline, error_map.apply(inputs).e
        for half, (label, room) in enumerate((("inactive constraints", ROOMY), ("active constraints", 0.0))):

            def announce(fraction: float, message: str, half: int = half, label: str = label) -> None:
                tell((half + fraction) / 2, f"{label}, {message}")

            runs = self._real_runs(line, inputs, announce, room, expected if room else None)
            errors = np.array([run.errors for run in runs])
            if room:
                self._agree(label, runs, error_map, expected)
            elif self.apriori is not None:
                worst = float(np.max(ratio(self.apriori.size(errors), self.apriori.along(line, inputs))))
                active = np.mean([r.estimates[k].engine not in CLOSED_FORM for r in runs for k in line.rows.samples])
                note = f"a constraint was active in {short(100 * active, 3)} % of the solves"
                self._find("a-priori bound", label, 1.0, worst, source=self.apriori.theorem, note=note)
            self._estimates_keep_promises(label, runs, line)


def _settled(ratios: Array, line: Timeline) -> Array:
    """Those (r, .) just after the samples beyond the first quarter."""
    return ratios[:, line.rows.samples[line.samples.size // 4 :]]


def _median_text(trials: MonteCarloTrials) -> str:
    return f"median over the runs {short(np.median(trials.promised), 3)}"
