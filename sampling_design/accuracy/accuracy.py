"""The least error that any estimator can guarantee for wanted rows of the state, over a whole schedule."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sampling_design.accuracy.accuracy_record import (
    Accuracy,
    AccuracyBracket,
    AccuracyProfile,
    panel_edges,
    proven_row,
    reopen,
)
from sampling_design.accuracy.between_samples import RowSearch, speed_of
from sampling_design.accuracy.bounded_directions import GapProof
from sampling_design.accuracy.bounds import Bound, NoiseBound
from sampling_design.accuracy.deviation import StandardDeviation, deviations
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.search import GainSearch
from sampling_design.accuracy.timing import moved_witness, noise_enough, refuse_tolerance
from sampling_design.accuracy.undetectable import DetectablePart
from sampling_design.accuracy.witness import KEPT, AccuracyWitness, left_open, strongest_witness
from sampling_design.errors import UndecidedError
from sampling_design.observability.alignment import align
from sampling_design.plants.functional import RequestedRows, Wanted, requested_rows
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.record import above, below
from sampling_design.records.signatures import open_verb
from sampling_design.records.vector_bounds import VectorBound
from sampling_design.schedules.jitter import Timing, TimingTolerance
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

MARGIN = 5e-5
"""By how much an upper bound is raised, so that balls prove it too, whose derivatives are bounded a little worse."""
RTOL = 0.01  # default width of the brackets, relative
WIDE = 1.05
"""Bracket beyond which late samples are looked at about their latest and earliest times, too: error that grows between
samples is bounded best about the latest ones, of one state exactly."""
FILTERED = (3e-4, 2.5e-5)  # counted: what the filter bounds after a sample, and with n states n^2 times
MOST_SOLVES = 2000  # programs for one row; a bracket that is not closed by then says so


@open_verb(AccuracyBracket)
def guaranteed_accuracy(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    *,
    w_bound: Bound = None,
    v_bound: NoiseBound = None,
    initial_error: VectorBound = None,
    of: Wanted = None,
    timing_tolerance: Timing = 0.0,
    start: float | None = None,
    end: float | None = None,
    w_intensity: VectorBound = None,
    v_deviation: VectorBound = None,
    rtol: float | None = None,
    budget: float | None = None,
    progress: Progress | None = None,
) -> Accuracy:
    """Return the least error that any estimator can guarantee for wanted rows, at the worst time of a schedule.

        rho(c; t) = min over gains of  h(rest) + int h_W(G'g(s)) ds + sum h_V(lambda_j)
                  = sup { c'x(t) : w, v within their bounds, all y_j = 0 }

    Parameters
    ----------
    plant : Plant, UncertainPlant or TimeVaryingPlant
        With constant parameters in a box: the worst of its plants, each with an estimator that knows it. One that
        varies in time: a finite schedule within its horizon, bounds on each entry, five times of each gap looked at.
    schedule : PeriodicSchedule or Schedule
        Periodic: without end, and so long under way that its start no longer matters. Finite: from `start` to `end`.
    w_bound : float, (q,) array or mapping
        Bound on the Euclidean norm of w(t), or on each entry; 0 where there is none. A mapping gives each disturbance
        by name a number or an interval, a pair (lower, upper).
    v_bound : float, (p,) or (N, p) array, mapping, or function of the sample's time
        Bound on the Euclidean norm of the noise of a sample, on each output, or on each output of each sample of the
        schedule (a better instrument today); 0 for an exact sensor. A mapping gives each output by name a number, a
        pair, one for each sample, a function of its time, or its `schedules.Sensor`: with a `result_delay` both sides
        are those of what is known at the time, results still out.
    initial_error : float, (n,) or (n, n) array, or mapping, optional
        What is known of x(start) less its nominal value on a finite schedule: a bound on its Euclidean norm, on each
        entry (infinite: unknown), a weight P for e'P e <= 1, or by names of states. Default: nothing.
    of : str, sequence of str, or (r, n) array, optional
        Names of states or outputs, or rows of a matrix. Default all states, each in its unit.
    timing_tolerance : float, pair (early, late), or dict of these by output [plant.time_unit]
        How early or late each sample may be, together less than the least gap: both sides are then those of all such
        times, which are known once samples are taken. What follows from a sample counts from `late` after its planned
        time on; the sample times of the record are those about which it is proven, the middles or the latest or
        earliest of all. Of a finite schedule `start` and `end` (default: the
        last sample and `late`) leave room for it. By output: those of one sample may fall apart, each within its own;
        `lower` is then that of times at which they come together.
    start, end : float, optional
        Of a finite schedule; default its first and its last sample.
    w_intensity, v_deviation : float or array, optional
        Sizes of white noises, as for `standard_deviation`, which then stands beside.
    rtol : float
        Relative width of the brackets; default 0.01, over a box 0.1.
    budget : float, optional [seconds]
        Searches end then, a few programs for each row that is left after: the bracket is proven, and `closed` says
        where it is wider than `rtol`. An interrupt (Ctrl-C) ends them likewise; a second one is raised.
    progress : callable, optional
        Called with the fraction of the rows that is done, and the bracket of the last one.

    Returns
    -------
    Accuracy, AccuracyOverBox or AccuracyAlong
        With `verify()`, which recomputes both sides without a solver.

    Raises
    ------
    ArgumentError
        If a bound is missing, negative or of another shape, a name is unknown, a sample of a finite schedule lies
        outside `start` and `end`, an endless one is given a start, or `timing_tolerance` or a
        `result_delay` does not fit the schedule.
    UndecidedError
        If nothing bounds the error: samples are too far apart, or what `timing_tolerance` adds grows with it.

    Notes
    -----
    *Assumptions.* w is bounded at every time and v at every sample; nothing else is known of them, nor of the start.
    *Claim.* `upper` holds for all real times and is guaranteed by an affine estimate; no estimator, linear or not,
    guarantees less than `lower`. *Method.* The adversary's program, a cone program with w constant on cells, over
    windows that grow until the past no longer matters; both sides are evaluated without the solver. The distant past
    costs at most what a filter's gains prove of it. *Numerical aspects.* Coordinates come from the filter's covariance,
    so that units change nothing; integrals are bounded for all real times by the trapezoidal rule with its proven
    error. Whether finitely many samples determine a row from an unknown start is decided numerically. Intervals
    that are not centred at 0 shift the estimate (`offset`) and leave its half-width as it is; what is bounded on one
    side only says nothing before there are data. `interval` says what composite samples will be worth, of readings
    that are all zero.

    References
    ----------
    Micchelli and Rivlin, A survey of optimal recovery (1977); Milanese and Tempo, Optimal algorithms theory for robust
    estimation and prediction (1985).

    Examples
    --------
    >>> import numpy as np
    >>> from sampling_design import Plant, PeriodicSchedule
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
    >>> found = guaranteed_accuracy(plant, PeriodicSchedule([1.0, 0.6, 1.4]), w_bound=0.02, v_bound=0.1)
    >>> [round(float(x), 3) for x in found.upper]
    [0.269, 0.123]
    >>> found.verify()
    True
    """
    tolerance = checks.positive("rtol", RTOL if rtol is None else rtol)
    late = TimingTolerance.of(timing_tolerance, plant.outputs.names, plant.time_unit)
    limit = Budget(None if budget is None else checks.positive("budget", budget))
    schedule = align(plant, schedule)
    rows = requested_rows(plant, of)
    question = AccuracyQuestion.of(plant, schedule, w_bound, v_bound, initial_error, start, end, late)
    if question.is_late:
        refuse_tolerance(question, w_intensity is not None or v_deviation is not None)
    deviation = None
    if w_intensity is not None or v_deviation is not None:
        deviation = deviations(question, rows, w_intensity, v_deviation)
    late, found, why = question.timing_tolerance, list[Accuracy](), None
    for by in dict.fromkeys([0.0, float(late.forward.min()), -float(late.back.min())]):
        if (limit.over and (found or why)) or (found and _is_narrow(found[0], tolerance)):
            break
        try:
            asked, tell = (question.about(by), None) if by else (question, progress)
            answer = answer_of(asked, rows, tolerance, limit, deviation, tell)
        except UndecidedError as error:
            why = why or error
            continue
        outgrown = by and not (np.isfinite(answer.upper).any() and answer.verify())  # doubles, by what stands for times
        found += [] if outgrown else [answer]
    if not found and why is not None:
        raise why
    return min(found, key=lambda each: float(np.sum(np.log(each.upper[each.upper > 0]))))


def _is_narrow(found: Accuracy, rtol: float) -> bool:
    """Whether what is proven about the middles is so near what is attained that other times need no look."""
    known = np.isfinite(found.upper)
    return bool(np.all(found.upper[known] <= found.lower[known] * (1 + rtol) * WIDE))


def answer_of(
    asked: AccuracyQuestion,
    rows: RequestedRows,
    tolerance: float,
    limit: Budget,
    deviation: StandardDeviation | None = None,
    progress: Progress | None = None,
) -> Accuracy:
    """Return the answer to a question, over its shortest period; UndecidedError as for `guaranteed_accuracy`."""
    question = asked.primitive()
    known = question.lasting()
    safe = [k for k, row in enumerate(rows.matrix) if known.plant.n_states and not known.touches(row)]
    noise, search, planned = None, None, None
    if safe and question.timing_tolerance:
        noise, search, planned = noise_enough(question, known, limit)
    elif safe:
        limit.spend((FILTERED[0] + FILTERED[1] * known.plant.n_states**2) * len(question.nodes))
        search = GainSearch(*question.filter_bounds(known.plant, known.moving), budget=limit)
    found: dict[int, RowSearch] = {}
    if search is not None:
        for done, k in enumerate(safe, 1):
            search.budget = limit.share(1 / (len(safe) + 1 - done))
            found[k] = _bracketed(search, rows.matrix[k] @ known.lift, tolerance, limit)
            if progress is not None:
                between = f"{below(found[k].lower)} to {above(found[k].upper)}"
                progress(done / len(safe), f"{rows.labels()[k]} {between}")
        search.budget = limit
        search.sketch_rows(found.values())
    if planned is not None and search is not None:  # on the same panels
        planned.system = planned.system.at_speed(speed_of(search.system))
    record = replace(
        _record(question, rows, known, search, found, tolerance, planned), deviation=deviation, noise=noise
    )
    if question is asked:
        return record
    count = len(asked.schedule) // len(question.schedule)
    at_samples = freeze(np.tile(record.at_samples, count))
    noise = None if noise is None else freeze(np.tile(noise, (count, 1)))
    profile = record.profile.repeated(asked.nodes)
    return replace(record, question=asked, at_samples=at_samples, profile=profile, noise=noise)


def bracket_of_rows(
    asked: AccuracyQuestion, rows: Array, tolerance: float, limit: Budget, opposed: int
) -> tuple[Array, Array]:
    """Return what is attained of the first so many rows at times as planned, and what gains prove of all: no profile.

    Raises UndecidedError as `guaranteed_accuracy` does.
    """
    question = asked.primitive()
    known = question.lasting()
    upper = np.array([known.at_rest(row) for row in rows])
    lower = upper[:opposed].copy()
    safe = [k for k, row in enumerate(rows) if known.plant.n_states and not known.touches(row)]
    if not safe:
        return lower, upper
    search = GainSearch(*question.filter_bounds(known.plant, known.moving), budget=limit)
    most = MOST_SOLVES if opposed or not limit.over else 0
    found = [search.row(rows[k] @ known.lift, _without_margin(tolerance), most) for k in safe]
    search.sketch_rows(found)
    for k, row in zip(safe, found, strict=True):
        again = search.opened(row.row, row.opened)
        upper[k] = search.top(again)[0] * (1 + MARGIN)
        if k < opposed:
            lower[k] = _witness(search, question, again, False, KEPT * upper[k], limit)[0].value * (1 - KEPT)
    return lower, upper


def _without_margin(tolerance: float) -> float:
    """The tolerance of a search whose upper side `MARGIN` joins."""
    return max((1 + tolerance) / (1 + 2 * MARGIN) - 1, tolerance / 2)


def _bracketed(search: GainSearch, row: Array, tolerance: float, limit: Budget) -> RowSearch:
    """The bracket and the profile of one row; after an interrupt what is proven by then."""
    tolerance = _without_margin(tolerance)
    try:
        found = search.row(row, tolerance, MOST_SOLVES)
        search.profile(found)
    except KeyboardInterrupt:
        limit.stop()
        found = search.row(row, tolerance, MOST_SOLVES)
    return found


def _witness(
    side: GainSearch, question: AccuracyQuestion, searched: RowSearch, moves: bool, rounding: float, limit: Budget
) -> tuple[AccuracyWitness, int, int]:
    """The strongest witness of a row, its node and offset; at real times that are sought, if samples may move.

    At rest where it attains `rounding` alone.
    """
    witness, j, offset = strongest_witness(side, searched.row, question, searched, limit)
    if moves and j < len(side.system) and not side.budget.over:  # where some results are out, it stays at planned times
        witness = max(witness, moved_witness(side, question, searched, j, offset), key=lambda found: found.value)
    return witness if witness.value > rounding else witness.within(np.inf, 0.0), j, offset


def _record(
    question: AccuracyQuestion,
    rows: RequestedRows,
    known: DetectablePart,
    finder: GainSearch | None,
    found: dict[int, RowSearch],
    rtol: float,
    planned: GainSearch | None,
) -> Accuracy:
    """`finder` searched for what gains prove; `planned`, if given, for what is attained without more noise."""
    times, count, plain = question.nodes, len(rows), question.initial is None
    edges = panel_edges(question, None if finder is None else finder.system, next(iter(found.values()), None))
    unknown = np.array([known.at_rest(row) for row in rows.matrix])
    lower, upper, worst = unknown.copy(), unknown.copy(), np.full(count, times[0])
    closed, offsets = np.ones(count, dtype=bool), np.zeros(count)
    known_from = np.where(unknown > 0, np.inf, -np.inf)
    at_samples = np.tile(unknown[:, None], (1, len(times)))
    below, above = np.tile(unknown[:, None], (2, 1, edges.size - 1))
    witnesses: list[AccuracyWitness | None] = [None] * count
    proof: tuple[GapProof, ...] = ()
    if finder is not None:
        kept = enumerate(finder.directions)
        proof = tuple(GapProof(j, freeze(a.mu), tuple(g.gains for g in a.gains)) for j, a in kept)
        reopen(finder, proof)
    for done, (k, search) in enumerate(found.items()):
        assert finder is not None
        limit = finder.budget.share(1 / (len(found) - done))
        again = finder.opened(search.row, search.opened)  # with what was found for the rows after it
        at_samples[k], above[k], known_from[k] = proven_row(question, finder.system, again)
        side, searched = (finder, again) if planned is None else (planned, planned.row(search.row, rtol, MOST_SOLVES))
        attained = np.concatenate([side.below(searched, j)[:-1] for j in searched.opened])
        below[k] = np.minimum(attained, above[k])  # where both meet, by rounding
        if np.isinf(at_samples[k]).all() and np.isinf(above[k]).all():
            continue
        upper[k] = finder.top(again)[0] * (1 + MARGIN)
        moves = side is planned and known.is_whole
        witness, j, offset = _witness(side, question, searched, moves, KEPT * upper[k], limit)
        witnesses[k], lower[k] = witness, witness.value * (1 - KEPT)
        worst[k] = question.time_of(finder.system, j) + again.opened[j].d[offset]
        if plain:
            worst[k] -= max(0.0, np.ceil(worst[k] / (question.end - times[0]) - 1)) * (question.end - times[0])
        offsets[k] = finder.offset(again, j, offset)
        closed[k] = (search.closed and search.idle) or upper[k] <= (1 + rtol) * witness.value
    return Accuracy(
        question=question,
        rows=rows,
        lower=freeze(lower),
        upper=freeze(upper),
        worst=freeze(worst),
        offset=freeze(offsets),
        known_from=freeze(known_from),
        closed=closed,
        at_samples=freeze(at_samples[:, question.samples]),
        profile=AccuracyProfile(freeze(edges), freeze(below), freeze(above), freeze(times[question.samples])),
        witnesses=tuple(witnesses),
        unknown=known.modes if plain else left_open(question, finder, upper),
        proof=proof,
    )
