"""What no schedule beats: an adversary whom even continuous measurement at every allowed time would not show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sampling_design.accuracy.between_samples import RowSearch
from sampling_design.accuracy.bounded_directions import BoundedDirections
from sampling_design.accuracy.bounds import Bound, SignalBounds
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.sampled_system import periodic_system
from sampling_design.accuracy.search import GainSearch
from sampling_design.accuracy.undetectable import GOLDEN, OTHER_STATES, DetectablePart, known_part, modes_with
from sampling_design.accuracy.witness import KEPT, AccuracyWitness, attains, physical
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.numerics.linalg import chain_speed, forced_flow
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.plants.clusters import balanced_schur, fastest_rate
from sampling_design.plants.functional import RequestedRows, Wanted, requested_rows
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.budget import Budget
from sampling_design.records.record import PlainRecord, TableRecord, below, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule

Zones = Sequence[tuple[float, float]] | None

SETTLING = (0.6, 0.9)
"""By how much the filter's fastest error shrinks from one node to the next, when nodes are first spread."""

HALVINGS = 6  # halvings of the step between nodes, until the trajectory keeps its bounds between them too
NODES = 512  # nodes that an adversary may last
CROWDED = 160  # nodes of one period, all zones together
SCALINGS = 80  # halvings and doublings of the time constant after which a step that settles is given up
SHALLOW = 32  # nodes of the first trajectory
TRIED = 4  # adversaries that are made to keep bounds between nodes, at most: a weaker one may shrink less
OFFSETS = 5  # offsets of the longest gap between zones that are looked at first
ON_EDGE = 1e-9  # share of the times at hand within which the end of a gap and that of a zone are one


@dataclass(frozen=True, eq=False, repr=False)
class AccuracyLimit(TableRecord, PlainRecord):
    """A lower bound on the least guaranteed error of each row that holds for every schedule of the allowed times.

    Attributes
    ----------
    plant : Plant
    rows : RequestedRows
    bounds : SignalBounds
    zones : (m, 2) array or None
        Allowed times of each period; None: all times.
    period : float
        Of the zones; 0 without them.
    lower : (r,) array
        Attained by `witnesses`: infinite where not even continuous measurement shows a mode.
    witnesses : tuple of AccuracyWitness
        From rest, with |C x(t)| within v_bound at every allowed real time; None where nothing is needed.
    phases : (r,) array
        Where in the period of the zones the last node of each stands.
    unknown : tuple of str
        Eigenvalues of modes that no measurement shows.
    closed : bool
        Whether the search for the strongest adversary ended within its budget: if not, `lower` holds and may be far
        below what could be attained.
    """

    plant: Plant
    rows: RequestedRows
    bounds: SignalBounds
    zones: Array | None
    period: float
    lower: Array
    witnesses: tuple[AccuracyWitness | None, ...]
    phases: Array
    unknown: tuple[str, ...]
    closed: bool = True

    _frame = "row:rows.names unit:rows.units lower"
    _plain = "rows:rows.names lower zones period unknown closed witnesses"
    _answers = (
        "errors at the worst time that no schedule of the allowed times falls below",
        "attained: by a trajectory for each row that no measurement shows",
        "no error is below {lower}",
        "`.verify()`",
    )

    def verify(self) -> bool:
        """Whether every witness keeps its bounds at all allowed real times and reaches its value."""
        known = _known(self.plant)
        phases = self.phases.tolist()
        for row, lower, trajectory, phase in zip(self.rows.matrix, self.lower, self.witnesses, phases, strict=True):
            lost = known.touches(row)
            if trajectory is None:
                if not (lost or lower == 0):
                    return False
                continue
            same = known.plant.same_dynamics(trajectory.plant) and np.array_equal(trajectory.row, row @ known.lift)
            value, excess = _kept(trajectory, phase, self.bounds, self.zones, self.period)
            if lost or not same or excess > 1 + KEPT or value < max(lower, trajectory.value) * (1 - KEPT):
                return False
        return True

    def _rows(self) -> list[tuple[str, str]]:
        where = "all times" if self.zones is None else f"{len(self.zones)} zones in {short(self.period)}"
        lines = [("measured at", f"{where} {self.plant.time_unit}" if self.zones is not None else where)]
        lines += [] if self.closed else [("search", "ended by its budget")]
        return lines + [(label, below(x)) for label, x in zip(self.rows.labels(), self.lower, strict=True)]

    def explain(self) -> str:
        """Say what nobody can know better."""
        when = "Even measured at all times" if self.zones is None else "Even measured at all allowed times"
        parts = [f"{n} is uncertain by {below(x, 4)}" for n, x in zip(self.rows.labels(), self.lower, strict=True)]
        more = "" if self.closed else " The budget ended the search: the true limit may be far above."
        return f"{when}, {', '.join(parts)} at the worst moment: no schedule and no estimator knows more.{more}"


@checked
def accuracy_limit(
    plant: Plant,
    *,
    w_bound: Bound = None,
    v_bound: Bound = None,
    of: Wanted = None,
    zones: Zones = None,
    period: float | None = None,
    rtol: float = 0.02,
    budget: float | None = None,
) -> AccuracyLimit:
    """Return a lower bound on the guaranteed error of wanted rows that no schedule of the allowed times beats.

        sup { c'x(t) : x(0) = 0, w within its bound, |C x(tau)| within v_bound at every allowed real time tau }

    Parameters
    ----------
    plant : Plant
    w_bound, v_bound : float, array or mapping
        As for `guaranteed_accuracy`; the noise of all sensors at any allowed time.
    of : str, sequence of str, or (r, n) array, optional
        Names of states or outputs, or rows of a matrix. Default all states.
    zones : sequence of (begin, end), optional
        Allowed times of each period, in order and apart, 0 <= begin <= end <= period. Default all times.
    period : float, optional
        Of the zones.
    rtol : float
        What the search may lose; the bound holds whatever it is.
    budget : float, optional [seconds]
        After it the adversaries that were found count, and 0 where there is none; the record says so (`closed`).

    Returns
    -------
    AccuracyLimit

    Raises
    ------
    ArgumentError
        If a bound is missing or of another shape, zones are not in order, or one of `zones` and `period` is missing.
    UndecidedError
        If disturbances are so weak, or `zones` so far apart, that no adversary can be followed in doubles, or where
        rounding in nearly dependent states hides what outputs show.

    Notes
    -----
    *Assumptions.* Every schedule takes its samples at allowed times, noise and disturbance keep their bounds. *Claim.*
    `lower` is attained: the adversary reads zero whenever it may be looked at. An exact sensor gives 0, and so does
    `w_bound` 0: trajectories begin at rest, and what is left of an unknown start is not counted. *Method.* The
    adversary's program with nodes at steps that are halved; then the trajectory is simulated exactly, |C x| bounded
    between nodes by chords and the second derivative, and everything divided by the largest ratio to its bound. The
    exact limit is at most `guaranteed_accuracy` of any one schedule.

    References
    ----------
    Micchelli and Rivlin, A survey of optimal recovery (1977).

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    >>> found = accuracy_limit(plant, w_bound=0.02, v_bound=0.1, of=[[1.0, 0.0]])
    >>> bool(0.098 <= found.lower[0] <= 0.1)
    True
    """
    rows, tolerance = requested_rows(plant, of), checks.positive("rtol", rtol)
    allowed = _zones(zones, period)
    span = 0.0 if period is None else float(period)
    known = _known(plant)
    one = SignalBounds.of(plant, 1, None, w_bound, v_bound, np.zeros(1))
    one = replace(one, w_centre=None, v_centre=None)
    lower, phases = np.full(len(rows), np.inf), np.zeros(len(rows))
    witnesses: list[AccuracyWitness | None] = [None] * len(rows)
    safe = [k for k, row in enumerate(rows.matrix) if not known.touches(row)]
    limit = Budget(None if budget is None else checks.positive("budget", budget))
    lower[safe] = 0.0
    if safe and np.all(one.v > 0) and np.any(one.w):  # what nothing drives stays at rest
        wanted = rows.matrix[safe] @ known.lift
        try:
            strongest = _strongest(known.plant, wanted, one, allowed, span, tolerance, limit)
        except UndecidedError:
            raise UndecidedError(
                "undecided: the disturbances are so weak beside the noise, or what is not measured grows so far "
                f"between allowed times, that the adversary cannot be followed in doubles. {OTHER_STATES}"
            ) from None
        for k, (witness, phase) in zip(safe, strongest, strict=True):
            witnesses[k], phases[k] = witness, phase
            lower[k] = 0.0 if witness is None else witness.value
    return AccuracyLimit(
        plant, rows, one, allowed, span, freeze(lower), tuple(witnesses), freeze(phases), unknown=known.modes,
        closed=not limit.over,
    )  # fmt: skip


def _zones(zones: Zones, period: float | None) -> Array | None:
    if zones is None:
        if period is not None:
            raise ArgumentError("`period` is that of `zones`, which are missing.")
        return None
    if period is None:
        raise ArgumentError("`zones` need their `period`.")
    span = checks.positive("period", period)
    table = np.array(checks.matrix("zones", np.asarray(list(zones), dtype=np.float64).reshape(-1, 2), None, 2))
    if not len(table):
        raise ArgumentError("`zones` must hold at least one (begin, end), got none.")
    flat = table.ravel()
    if np.any(np.diff(flat) < 0) or np.any(table[1:, 0] <= table[:-1, 1]) or flat[0] < 0 or flat[-1] > span:
        raise ArgumentError(f"`zones` must be in order, apart and within [0, {span!r}], got {table.tolist()!r:.80}.")
    return freeze(table)


def _time_constant(plant: Plant) -> float:
    """1/|A| in balanced coordinates, 1 where A is zero."""
    size = float(np.linalg.norm(plant.A * (d := balanced_schur(plant.A).d) / d[:, None], 2))
    return 1 / size if size > 0 else 1.0


def _known(plant: Plant) -> DetectablePart:
    """The plant without what not even continuous measurement shows.

    Raises UndecidedError where this takes a mode for hidden that the outputs show, up to rounding of A and C.
    """
    length = 0.1 * _time_constant(plant)
    count = 3 * plant.n_states
    times = length * (np.arange(count) / count) ** GOLDEN
    found = known_part(plant, times, length, [np.arange(plant.n_outputs)] * count)
    if found.modes and not unobservable_modes(plant):
        raise UndecidedError(
            "undecided: rounding in the coordinates of this plant hides that its outputs show "
            f"{modes_with(found.modes)}. {OTHER_STATES}"
        )
    return found


def _nodes(allowed: Array | None, period: float, step: float) -> tuple[Array, float]:
    """Nodes at most `step` apart in every zone, ends included, and the period."""
    if allowed is None:
        return np.zeros(1), step
    parts = [np.linspace(a, b, int(np.ceil((b - a) / step)) + 1) if b > a else np.array([a]) for a, b in allowed]
    nodes = np.concatenate(parts)
    return (nodes[:-1] if nodes[-1] - nodes[0] >= period else nodes), period


def _question(plant: Plant, bounds: SignalBounds, nodes: Array, period: float) -> AccuracyQuestion:
    schedule = PeriodicSchedule.from_times(nodes, period)
    v = np.broadcast_to(bounds.v, (nodes.size, plant.n_outputs))
    return AccuracyQuestion(
        plant, schedule, replace(bounds, v=freeze(v), v_centre=None), None, nodes, float(nodes[0] + period)
    )


def _step(plant: Plant, bounds: SignalBounds, allowed: Array | None, period: float) -> float:
    """A step over which the filter's fastest error shrinks by about a quarter."""
    if fastest_rate(plant.A):
        step = _time_constant(plant)
    else:
        step = 1 / (chain_speed(plant.A, plant.G, plant.C, bounds.w, bounds.v[0]) or 1.0)
    for _ in range(SCALINGS):
        system = periodic_system(plant, np.array([step]), _question(plant, bounds, np.zeros(1), step).bounds)
        sample, F = system.samples[0], system.gaps[0].F
        passed = F @ (np.eye(len(F)) - sample.K @ sample.H)
        fastest = float(np.min(np.abs(np.linalg.eigvals(passed))))
        if fastest < SETTLING[0]:
            step /= 2
        elif fastest > SETTLING[1]:
            step *= 1.5
        else:
            break
    if allowed is None:
        return step
    crowd = float(np.sum(allowed[:, 1] - allowed[:, 0])) / CROWDED
    return max(step, crowd, period * 1e-9)


def _strongest(
    plant: Plant, rows: Array, bounds: SignalBounds, allowed: Array | None, period: float, rtol: float, limit: Budget
) -> list[tuple[AccuracyWitness | None, float]]:
    """The strongest witness of each row over finer and finer nodes, and its phase; one against a row serves others."""
    best: list[tuple[AccuracyWitness | None, float]] = [(None, 0.0)] * len(rows)
    step, left = _step(plant, bounds, allowed, period), list(range(len(rows)))
    for halving in range(HALVINGS):
        nodes, span = _nodes(allowed, period, step)
        if not left or (halving and (limit.over or nodes.size > 2 * CROWDED)):
            break
        question = _question(plant, bounds, nodes, span)
        system = periodic_system(plant, np.diff(nodes, append=question.end), question.bounds)
        unbounded = BoundedDirections(np.zeros((plant.n_states, 0)), np.zeros(0))  # nothing is asked of gains
        search = GainSearch(system, [unbounded] * nodes.size, budget=limit)
        for k in tuple(left):
            found, phase, factor = _adversary_in_gap(search, question, rows[k], allowed, period, rtol)
            known = best[k][0]
            if found is not None and (known is None or found.value > known.value):
                best[k] = found, phase
            if factor <= 1 + rtol / 2:
                left.remove(k)
        step /= 2
    return best


def _adversary_in_gap(
    search: GainSearch, question: AccuracyQuestion, row: Array, allowed: Array | None, period: float, rtol: float
) -> tuple[AccuracyWitness | None, float, float]:
    """A witness that is admissible at all allowed real times, its phase, and by how much it had to shrink for it.

    Once the budget is spent: of those against other rows, if there is any.
    """
    found = search.opened(row)
    if not search.budget.over or not any(search.adversaries):
        _seek(search, found, allowed is not None, rtol)
    choices = []
    for k, opened in found.opened.items():
        for adversary in search.adversaries[k]:
            values = np.abs(opened.mu @ adversary.end) + opened.below
            place = 0 if allowed is None else int(np.argmax(values))
            choices.append((float(values[place]), place, adversary))
    best: tuple[AccuracyWitness | None, float, float] = None, 0.0, 1.0
    for top, place, adversary in sorted(choices, key=lambda choice: -choice[0])[:TRIED]:
        if best[0] is not None and (top <= best[0].value or search.budget.over):
            break
        trajectory = physical(row, found.opened[adversary.sample], adversary, place)
        trajectory, phase = replace(trajectory, last=0), float(question.nodes[adversary.sample])
        value, excess = _kept(trajectory, phase, question.bounds, allowed, period)
        if best[0] is None and value > 0 and not np.isfinite(excess):
            best = None, 0.0, np.inf
        elif value > 0 and (best[0] is None or value / max(excess, 1.0) > best[0].value):
            best = replace(trajectory.within(excess, value), last=0), phase, max(excess, 1.0)
    return best


def _seek(search: GainSearch, found: RowSearch, zoned: bool, rtol: float) -> None:
    """Seek adversaries after the node of the longest gap, from more and more samples back while that helps."""
    j = int(np.argmax([gap.length for gap in search.system.gaps]))
    at, search.deep, before = 0, SHALLOW, 0.0
    if zoned:
        last = found.opened[j].d.size - 1
        for k in range(1, OFFSETS + 1):
            search.oppose(j, found.opened[j].mu[last * k // OFFSETS], rough=True)
            if search.budget.over:
                return
        at = int(np.argmax(search.attained(found, j)))
    while True:
        search.oppose(j, found.opened[j].mu[at])
        now = float(search.attained(found, j)[at])
        if now <= before * (1 + rtol / 4) or 2 * search.deep > NODES or search.budget.over:
            break
        before = now
        search.deep *= 2


def _kept(
    witness: AccuracyWitness, phase: float, bounds: SignalBounds, zones: Array | None, period: float
) -> tuple[float, float]:
    """What a witness attains, and the factor by which it exceeds its bounds at all allowed times."""
    value, excess = attains(witness, replace(bounds, v=bounds.v[:1]))
    if not np.isfinite(excess):
        return value, excess
    closed = replace(witness, w=witness.simulate(bounds.w).w)  # what attains the value, and keeps bounds at the nodes
    return value, max(excess, _between(closed, bounds, _looked_into(witness, phase, zones, period)))


def _looked_into(witness: AccuracyWitness, phase: float, zones: Array | None, period: float) -> Mask:
    """Which gaps of a witness hold an allowed time; the last one is what follows its last node."""
    samples = witness.samples
    marks = np.append(samples, witness.edges[-1]) - samples[-1] + phase
    if zones is None:
        return np.ones(samples.size, dtype=bool)
    slack = ON_EDGE * max(period, float(np.abs(marks).max()))
    found = np.zeros(samples.size, dtype=bool)
    for k, (a, b) in enumerate(pairwise(marks)):
        for shift in range(int(np.floor(a / period)) - 1, int(np.floor(b / period)) + 2):
            begin, end = (zones + shift * period).T
            found[k] |= bool(np.any((begin < b - slack) & (end > a + slack)))
    return found


def _between(witness: AccuracyWitness, bounds: SignalBounds, looked: Mask) -> float:
    """The largest ratio of |C x| to its bound within some gaps, for all real times.

    On a cell w is constant: y'' = C A e^{As} q with q = A x + G w, and |y| lies below its chord plus d^2/8 sup|y''|.
    """
    plant, scale = witness.plant, witness.scales()
    A, G = plant.A * scale / scale[:, None], plant.G / scale[:, None]
    measured = np.isfinite(bounds.v[0])
    C = plant.C[measured] * scale / bounds.v[0, measured, None]
    lengths = np.diff(witness.edges)
    flows = forced_flow(A, G, lengths)
    ends = np.searchsorted(witness.edges, [*witness.samples, witness.edges[-1]])
    size, bend, third = np.linalg.norm(A, 2), C @ A, np.linalg.norm(C @ A @ A, axis=1)
    largest = 0.0
    for k in np.flatnonzero(looked):
        x = witness.states[k] / scale
        for cell in range(ends[k], ends[k + 1]):
            h, following = lengths[cell], flows[cell] @ np.concatenate([x, witness.w[cell]])
            start, end = A @ x + G @ witness.w[cell], A @ following + G @ witness.w[cell]
            drift = h / 2 * third * np.exp(size * h) * max(np.linalg.norm(start), np.linalg.norm(end))
            turn = np.maximum(np.abs(bend @ start), np.abs(bend @ end)) + drift
            y = np.maximum(np.abs(C @ x), np.abs(C @ following)) + h * h / 8 * turn
            if bounds.v_ball:
                ends_norm = max(np.linalg.norm(C @ x), np.linalg.norm(C @ following))
                largest = max(largest, float(ends_norm + h * h / 8 * np.linalg.norm(turn)))
            else:
                largest = max(largest, float(np.max(y, initial=0.0)))
            x = following
    return largest
