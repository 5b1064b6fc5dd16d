"""Samples that leave the plan for a while: what they guarantee, sought in floats and proven by gains.

A sequence is the plan until some time, then other samples, then the plan again. Before it the plan's own filter bounds
the error, whatever it once was; from there on every gap is judged by itself, until a sample at which the error is
again no larger than the plan's proof supposes, and as many more as that proof looks back.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sampling_design.accuracy.between_samples import KnownIntegrals, RowBetweenSamples, open_row
from sampling_design.accuracy.results_out import results_in
from sampling_design.accuracy.sampled_system import KnownSpan
from sampling_design.accuracy.search import GainSearch
from sampling_design.errors import UndecidedError
from sampling_design.planning.accuracy_oracle import WINDOWS, AccuracyOracle, GridSpan
from sampling_design.planning.adversary_program import GridWindow
from sampling_design.planning.figures import PlanFigures
from sampling_design.planning.problem import WHOLE, RowGoal
from sampling_design.planning.search_progress import BETWEEN, GAINS, STARTED, SYSTEM
from sampling_design.planning.sequence_deviation import (
    GRAIN,
    SampleSequence,
    asked,
    departs_and_returns,
    phase_of,
    sequence_filter,
)
from sampling_design.planning.sequence_system import plan_system, sequence_system
from sampling_design.planning.transient_bound import cut_gains, nodes_out, out_at, settled_factors, wider_by
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.budget import ENDLESS, Budget
from sampling_design.schedules.jitter import ON_TIME

SHARPER = 40  # offsets of a gap that are solved, at most
HOPELESS, FEW = 10.0, 4  # a bound so many times what is asked for, after so many solves, is not proven closer
ROUNDED = 1e-12  # share by which two offsets of one gap may differ that are the same

FADED = 0.01
"""What a change still adds to a gap, as a share of the plan's own accuracy, from which on it is not proven closer."""


def span_begin(plan: PlanFigures, sequence: SampleSequence, span: GridSpan) -> float:
    """From when on a stretch of a sequence is looked at."""
    return float(sequence.times[span.last]) + (span.begin * plan.problem.step if span.arrived is not None else 0.0)


def looks_back(plan: PlanFigures) -> int:
    """Samples that the plan's proof looks back."""
    parts = [1]
    if plan.accuracy is not None:
        parts += [len(given) for part in plan.accuracy.proof for given in part.gains]
    if plan.deviation is not None:
        parts.append(sequence_filter(plan).back)
    return max(parts)


def forgets(plan: PlanFigures) -> int:
    """Samples over which the plan's filter must be followed until nothing of what was before them counts."""
    own = 0 if plan.accuracy is None else int(plan_system(plan).forgetting.max(initial=0))
    return max(own, len(plan.schedule))


def settles(plan: PlanFigures) -> int:
    """Samples of the plan after a change, beside one period, until its own proof holds again; that before it, too.

    Where samples may be early or late, what they add decays as well.
    """
    factor = 1 + bool(plan.problem.timing_tolerance)
    return factor * max(looks_back(plan), forgets(plan)) + len(plan.schedule) + 2


def settling_time(plan: PlanFigures) -> float:
    """How long the plan is followed after a change until that is so and the results are in; before it as well."""
    period = plan.schedule.period
    return settles(plan) * period / len(plan.schedule) + period + time_out(plan)


def time_out(plan: PlanFigures) -> float:
    """A time that holds all samples whose results may be out at once, by whole periods of the plan; 0: none is."""
    out, period = longest_out(plan), plan.schedule.period
    return (np.ceil((out + plan.problem.timing_tolerance.span) / period) + 1) * period if out else 0.0


def worst_ratio(
    plan: PlanFigures,
    sequence: SampleSequence,
    above: float = np.inf,
    until: float = np.inf,
    *,
    closely: bool = True,
    budget: Budget = ENDLESS,
) -> float:
    """The largest ratio of accuracy to tolerance from the sample before the first change on, in floats, on the grid.

    Stops once a gap is worse than `above`, begins at or after `until`, or the budget is over. Unless `closely`, a gap
    is looked at where it ends, and only the worst of them elsewhere: attained all the same.
    """
    deviation = sequence_filter(plan).worst(sequence, until)[0] if plan.deviation is not None else 0.0
    if deviation > above or plan.accuracy is None:
        return deviation
    return max(deviation, _bounded_worst(plan, sequence, above, until, budget, closely=closely))


def _bounded_worst(
    plan: PlanFigures, sequence: SampleSequence, above: float, until: float, budget: Budget, *, closely: bool
) -> float:
    """The same of the goals that are guaranteed; what a change does decays: so many gaps no worse end it."""
    worst = before = here = 0.0
    where: tuple[GridWindow, int, float, float, int] | None = None
    oracle, back = plan.oracle, departs_and_returns(plan, sequence)[1]
    goals, out, count = oracle.problem.guaranteed, longest_out(plan), judged_at_once(plan)
    for i, span in enumerate(spans_of(plan, sequence)):
        if span_begin(plan, sequence, span) >= until + out or budget.over:
            break
        window, last = window_after(oracle, sequence, span)
        for g in goals:
            far = min(above, max(worst, 1.0))  # what is far below neither breaks anything nor is the worst
            ratios = oracle.ratios_at(window, g, last, span.length, far, begin=span.begin, closely=closely, known=here)
            found = max(ratios.values(), default=0.0)
            where = (window, g, last, span.length, span.begin) if found > max(worst, here) else where
            here = max(here, found)
            if here > above:
                return here
        worst = max(worst, here)
        if i % count == count - 1:
            if here <= before and is_past(plan, sequence, span, back):
                break
            before, here = here, 0.0
    if where is not None and not closely:
        worst = max(worst, *oracle.ratios_at(*where[:4], begin=where[4]).values())
    return worst


def longest_out(plan: PlanFigures) -> float:
    """How long a result may be out."""
    delay = plan.problem.result_delay
    return 0.0 if delay is None else float(delay.max())


def judged_at_once(plan: PlanFigures) -> int:
    """Stretches that are judged before it is asked whether what a change does has faded: those of a period."""
    return plan.samples if plan.problem.result_delay is None else int(plan.chosen.sum())


def is_past(plan: PlanFigures, sequence: SampleSequence, span: GridSpan, back: int) -> bool:
    """Whether a stretch comes after some sample, and after what was out then."""
    if sequence.result_delay is None:
        return span.last >= back
    return back < len(sequence.times) and bool(sequence.times[span.last] >= sequence.times[back] + longest_out(plan))


def spans_of(plan: PlanFigures, sequence: SampleSequence) -> list[GridSpan]:
    """The stretches of a sequence that are judged, on the grid."""
    step, times = plan.problem.step, sequence.times
    if sequence.result_delay is None:
        knots = _knots(plan.oracle, sequence)
        return [
            GridSpan(k, int(np.ceil(max(skipped, 0.0) / step - WHOLE)), knots[k + 1] - knots[k], end=times[k + 1])
            for k, skipped in enumerate(sequence.since - times[:-1])
            if k >= sequence.start
        ]
    comes = sequence.comes_after(np.isfinite(plan.problem.v_bound), late=False)
    first, found, tiny = float(times[0]), list[GridSpan](), WHOLE * step
    for each in results_in(times - first, comes, end=float(times[-1]) - first):
        if each.end + first <= sequence.judged_since + tiny:
            continue
        k, at = int(each.samples[-1]), float(each.times[-1])
        since = max(each.begin, sequence.since - first)
        begin = int(np.floor((since - at) / step + WHOLE)) + (since > tiny)  # what comes in at a step is in after it
        length = int(np.floor((each.end - at) / step + WHOLE))
        if begin <= length:
            found.append(GridSpan(k, begin, length, each.arrived, each.end + first))
    return found


def _knots(oracle: AccuracyOracle, sequence: SampleSequence) -> Array:
    """The steps of a sequence's samples, whole where they are on the grid."""
    steps = sequence.times / oracle.problem.step
    whole = np.round(steps)
    return np.where(np.abs(steps - whole) <= WHOLE, whole, steps)


def window_after(oracle: AccuracyOracle, sequence: SampleSequence, span: GridSpan) -> tuple[GridWindow, float]:
    """The window of what is in during a stretch, and the step of its last sample."""
    knots, measured, begins = _read_by(oracle, sequence, span)
    start, last = oracle.initial_set if begins else None, float(knots[-1])
    key = (knots - last).tobytes(), measured.tobytes(), begins
    if key not in oracle.windows:
        while len(oracle.windows) >= WINDOWS:
            del oracle.windows[next(iter(oracle.windows))]
        oracle.windows[key] = GridWindow(oracle.discrete, knots, measured, start=start)
    return oracle.windows[key], last


def _read_by(oracle: AccuracyOracle, sequence: SampleSequence, span: GridSpan) -> tuple[Array, Mask, bool]:
    """Steps of the samples before a stretch, what is in of them, and whether all begins with the first of them.

    They reach as far back as matters to the plan, and over as many samples: where some are late or lost, farther.
    """
    k, knots = span.last, _knots(oracle, sequence)[: span.last + 1]
    first = min(max(sequence.first - 1, 0), k)
    planned = int(np.searchsorted(knots, knots[first] - oracle.back))
    low = min(int(np.searchsorted(knots, knots[k] - oracle.back)), max(k - (first - planned), 0))
    return knots[low:], span.known(sequence.measured[low : k + 1]), bool(sequence.begins) and low == 0


def gap_ratios(plan: PlanFigures, sequence: SampleSequence, since: float, until: float) -> dict[int, float]:
    """The ratio of accuracy to tolerance in each gap that ends after a time and begins before another, in floats."""
    oracle, times = plan.oracle, sequence.times
    found: dict[int, float] = {}
    if plan.deviation is not None:
        for k, _, _, ratios in sequence_filter(plan).gaps(sequence, until):
            if times[k + 1] > since:
                found[k] = max(found.get(k, 0.0), float(ratios.max()))
    goals = oracle.problem.guaranteed
    for span in spans_of(plan, replace(sequence, since=max(sequence.since, since))) if goals else ():
        begin = span_begin(plan, sequence, span)
        if begin >= until:
            break
        for k in gaps_of(sequence, span.last, begin, span.end):
            found[k] = max(found.get(k, 0.0), _ratio_in(oracle, sequence, span))
    return found


def _ratio_in(oracle: AccuracyOracle, sequence: SampleSequence, span: GridSpan) -> float:
    """The ratio in a stretch: most of a sequence are those of another, by whole periods later, and solved once."""
    knots, measured, begins = _read_by(oracle, sequence, span)
    phase = float(knots[-1]) % oracle.problem.steps
    key = (oracle.back, (knots - knots[-1]).tobytes(), measured.tobytes(), begins, span.begin, span.length, phase)
    if key not in oracle.ratios:
        window, last = window_after(oracle, sequence, span)
        found = [oracle.ratios_at(window, g, last, span.length, begin=span.begin) for g in oracle.problem.guaranteed]
        oracle.ratios[key] = max((value for each in found for value in each.values()), default=0.0)
    return oracle.ratios[key]


def gaps_of(sequence: SampleSequence, k: int, begin: float, end: float) -> range:
    """The gaps between samples in which a stretch after one of them lies."""
    if sequence.result_delay is None:
        return range(k, k + 1)
    tiny = GRAIN * float(sequence.times[-1] - sequence.times[0])
    low = int(np.searchsorted(sequence.times, begin + tiny, side="right")) - 1
    return range(max(low, 0), max(int(np.searchsorted(sequence.times, end - tiny, side="left")), low + 1, 1))


def proven_ratio(
    plan: PlanFigures, sequence: SampleSequence, gaps: dict[int, float] | None = None, budget: Budget = ENDLESS
) -> float:
    """The largest ratio of accuracy to tolerance of a sequence over all real times, proven by gains; stops beyond 1.

    Once the budget is over, these are the filter's, which prove less.

    Of standard deviations, by the filter run through the sequence, by as much more as it ends with. `gaps` gets the
    ratio in each gap, and of all that follows the sequence as that of its last sample; then nothing stops it.
    """
    deviation = 0.0
    if plan.deviation is not None:
        deviation, wider = sequence_filter(plan).worst(sequence)
        deviation = max(deviation, wider * sequence_filter(plan).usual)
        if gaps is not None:
            for k, _, _, ratios in sequence_filter(plan).gaps(sequence):
                gaps[k] = max(gaps.get(k, 0.0), float(ratios.max()))
            gaps[len(sequence.times) - 1] = wider * sequence_filter(plan).usual
    if plan.accuracy is None or (deviation > 1 and gaps is None):
        return deviation
    return max(deviation, _proven_bounds(plan, sequence, gaps, budget))


def _proven_bounds(plan: PlanFigures, sequence: SampleSequence, gaps: dict[int, float] | None, budget: Budget) -> float:
    """The same of the goals that are guaranteed; infinite where a sequence does not end with enough of the plan.

    Gaps are judged one by one until `settled + back`, but where those since a change are the plan's for long enough:
    of that sample all results are in when the sequence ends.
    From the sample `settled` on the error is at most `wider` times what the plan's filter bounds,
    R_j >= cost_j + |rest_j|'R_k with k = j - forgetting[j]: over as many samples by what is found here, and so over all
    that follow, since wider >= 1. Gains of the plan's proof reach back no farther than `settled`, and what they prove
    grows at most as their rest does.
    """
    problem, schedule, times = plan.problem, plan.schedule, sequence.centres
    back, count = looks_back(plan), len(schedule)
    work, n = plan.oracle.work, plan.plant.n_states
    work.add(SYSTEM, len(times) * n**2)
    memory = forgets(plan)
    out = longest_out(plan)
    complete = int(np.sum(sequence.taken_by + out <= times[-1])) if out else len(times)
    worst, settled = 0.0, complete - 1 - max(back, memory) - count
    work.add(STARTED, n * len(times) * memory if sequence.begins else 0)
    try:
        system = sequence_system(plan, sequence, len(times) - max(settled, 0))
    except UndecidedError:  # nothing bounds what early and late samples do
        system = None
    search = None if system is None else GainSearch(*system, lambda: work.add(GAINS, back * n), budget)
    if search is None or settled < sequence.first or not _is_the_plan(search, plan, settled):
        if gaps is not None:
            gaps.update(dict.fromkeys(range(max(sequence.first - 1, 0), len(times)), np.inf))
        return np.inf
    search.back = back
    goals = [(goal, KnownIntegrals()) for goal in problem.goals if not goal.stochastic]
    usual = max(r / g.tolerance for r, g in zip(plan.reached.tolist(), problem.goals, strict=True) if not g.stochastic)
    factors = _transient_factors(plan, sequence, search, settled + back)
    faded = usual * (1 + FADED) if usual > 1 else min(usual * (1 + FADED), 1.0)
    for span in search.system.spans:
        k = search.system.sample_of(span.node)
        begin, end = (float(times[k]) + offset for offset in (span.begin, span.end))
        if end <= sequence.judged_since if sequence.in_parts else k < sequence.start:
            continue
        if k >= settled + back:
            break
        here = float(usual) * factors.get(span.node, np.inf)
        if not here <= max(min(worst, 1.0), faded):
            here, skipped = 0.0, sequence.skipped(k)
            for goal, known in goals:
                work.spend(BETWEEN)
                opened = open_row(search.system, span.node, goal.row, known=known).since(skipped)
                at = [d for d in asked(plan, sequence, k, goal, (span.begin, span.end)) if d >= skipped]
                here = max(here, _gap_bound(search, opened, span.node, goal, at) / goal.tolerance)
        worst = max(worst, here)
        if gaps is not None:
            for gap in gaps_of(sequence, k, begin, end):
                gaps[gap] = max(gaps.get(gap, 0.0), here)
        elif worst > 1:
            return worst
    wider = _wider(search, plan, sequence, range(settled, settled + memory), 1 / usual if 0 < usual < 1 else np.inf)
    if gaps is not None:
        gaps[len(times) - 1] = max(gaps.get(len(times) - 1, 0.0), float(usual) * wider)
    return max(worst, float(usual) * wider)


def _wider(
    search: GainSearch, plan: PlanFigures, sequence: SampleSequence, samples: range, room: float = np.inf
) -> float:
    """How many times as large as the plan's filter bounds it the error is at most at samples of a sequence, at least 1.

    So it is after all that follow, if those are the plan's and they are as many as its filter looks back.
    """
    filtered, wider = plan_system(plan), 1.0
    for k in samples:
        phase = phase_of(plan.schedule, float(sequence.clock_times[k]))
        wider = max(wider, _beyond(search, k, filtered.reach[phase], room))
    return wider


def settled_since(plan: PlanFigures, sequence: SampleSequence) -> tuple[float, float]:
    """From when on the error, or its covariance, is at most so many times the plan's own, for ever; infinite if never.

    The sequence ends with the plan, and that goes on.
    """
    times, memory, since, wider = sequence.centres, forgets(plan), -np.inf, 1.0
    if plan.deviation is not None:
        wider, since = sequence_filter(plan).worst(sequence)[1], float(times[-1])
    if plan.accuracy is not None:
        settled = len(times) - 1 - memory
        system = sequence_system(plan, sequence, len(times) - max(settled, 0))
        search = GainSearch(*system)
        search.back = looks_back(plan)
        if settled < sequence.first or not _is_the_plan(search, plan, settled):
            return np.inf, np.inf
        since = max(since, float(times[settled]))
        wider = max(wider, _wider(search, plan, sequence, range(settled, settled + memory)))
    return (since, wider) if np.isfinite(wider) else (np.inf, np.inf)


def _gap_bound(search: GainSearch, opened: RowBetweenSamples, k: int, goal: RowGoal, asked: list[float]) -> float:
    """A bound on one row over the gap after a sample: offsets are solved where it is highest, until it is enough."""
    enough = goal.tolerance
    if goal.at == "after each sample":
        at = search.system.judged[k].begin
        if search.system.sample_of(k) != k:  # some of its outputs are not read yet
            return 0.0
        return at_offset(search, goal.row, k, at) if opened.d[0] <= at * (1 + ROUNDED) else 0.0
    if goal.at == "given times":
        return max((at_offset(search, goal.row, k, d) for d in asked), default=0.0)
    solved: set[int] = set()
    for _ in range(SHARPER):
        nodes, panels = opened.bound(search.directions[k])
        panel = int(np.argmax(panels))
        top = float(panels[panel])
        if top <= enough or (top > HOPELESS * enough and len(solved) >= FEW):
            break
        fresh = [o for o in (panel + int(nodes[panel + 1] > nodes[panel]), panel, panel + 1) if o not in solved]
        if not fresh:
            break
        solved.add(fresh[0])
        _bounded_by_gains(search, k, opened.mu[fresh[0]])
    return top


def known_at(plan: PlanFigures, history: SampleSequence, t: float, budget: Budget = ENDLESS) -> dict[str, float]:
    """How well each goal is known at a time at or after the last sample: bounds that are proven, or deviations.

    Infinite where an error of any size at the plan's start would not have shown.
    """
    found = {} if plan.deviation is None else sequence_filter(plan).at(history, t)
    if plan.accuracy is not None:
        exact = history if not history.begins else replace(history, late=ON_TIME, known_sides=np.zeros((0, 2, 1)))
        limited = history.begins and bool(history.late)  # samples that may be late do not show a start of any size
        try:
            bounds = _bounds_at(plan, exact, t, budget, limited=False)
        except UndecidedError:  # nor can doubles follow one beside which the rest fades
            bounds, limited = dict.fromkeys((goal.name for goal in plan.goals), 0.0), True
        if limited:
            known = _bounds_at(plan, history, t, budget, limited=True)
            bounds = {name: value if np.isinf(value) else known[name] for name, value in bounds.items()}
        found |= bounds
    return {goal.name: found[goal.name] for goal in plan.goals}


def _bounds_at(
    plan: PlanFigures, history: SampleSequence, t: float, budget: Budget, *, limited: bool
) -> dict[str, float]:
    """The same of the goals that are guaranteed."""
    search = GainSearch(*sequence_system(plan, history, limited=limited, until=t), budget=budget)
    search.back = looks_back(plan)
    last = max(0, history.taken(t))
    if history.in_parts:
        begins = np.array([float(history.centres[0]) + span.time + span.begin for span in search.system.spans])
        tiny = GRAIN * plan.schedule.period
        last = search.system.spans[max(0, int(np.searchsorted(begins, t + tiny, side="right")) - 1)].node
    since = t - float(history.centres[search.system.sample_of(last)])
    return {goal.name: at_offset(search, goal.row, last, since) for goal in plan.goals if not goal.stochastic}


def at_offset(search: GainSearch, row: Array, k: int, d: float) -> float:
    """A bound on one row (n,) so long after a sample, by gains."""
    if d <= 0:
        return _bounded_by_gains(search, k, search.system.mu(k, row[None])[:, 0])
    opened = open_row(search.system, k, row, d)
    return _bounded_by_gains(search, k, opened.mu[-1]) + float(opened.above[-1])


def _bounded_by_gains(search: GainSearch, k: int, mu: Array) -> float:
    """A bound on mu'z at a node by gains that are solved for, and kept; by the filter's once the budget is over."""
    if not search.budget.over:
        return search.gains(k, mu).value
    search.sketch(k, mu[None])
    return float(search.directions[k].bound(mu[None])[0])


def _transient_factors(plan: PlanFigures, sequence: SampleSequence, search: GainSearch, stop: int) -> dict[int, float]:
    """How much more than the plan's stretches those of a sequence are at most, by node; none where they are not its."""
    own, system, found = plan_system(plan), search.system, dict[int, float]()
    if any(goal.at == "given times" for goal in plan.goals):  # which offsets those are differs from gap to gap
        return found
    gaps, samples = ({id(part) for part in parts} for parts in (own.gaps, own.samples))
    both = zip(system.gaps[:stop], system.samples[:stop], strict=False)
    usual = np.array([id(gap) in gaps and id(sample) in samples for gap, sample in both])  # no noisier than the plan's
    spans: dict[int, list[KnownSpan]] = {}
    for span in system.spans:
        spans.setdefault(system.sample_of(span.node), []).append(span)
    for k in np.flatnonzero(usual & ~np.append(False, usual[:-1])).tolist():
        end = k + int(np.argmin(np.append(usual[k:], False)))
        phases = [phase_of(plan.schedule, float(t)) for t in sequence.clock_times[k:end]]
        reach = [search.directions[i].reach for i in range(k, end)]
        wider, factors = wider_by(plan, phases, reach), settled_factors(plan, phases, reach)
        for i, phase in enumerate(phases):
            for span in spans.get(k + i, ()):
                node = phase if span.node < len(system) else nodes_out(plan).get(out_at(system, span.node, phase))
                if node is None or not _within(span, own.judged.get(node)):
                    continue
                factor = float(factors[i])
                if span.node >= len(system):
                    now = search.directions[span.node].bound(np.eye(own.D.size))
                    factor = max(*wider_by(plan, [node], [now]), cut_gains(plan)[node].factor(wider[i::-1]))
                found[span.node] = factor
    return found


def _within(span: KnownSpan, own: KnownSpan | None) -> bool:
    """Whether a stretch is one of the plan's own, or a part of it."""
    if own is None:
        return False
    tiny = GRAIN * (own.end - own.begin)
    return span.begin >= own.begin - tiny and span.end <= own.end + tiny


def _is_the_plan(search: GainSearch, plan: PlanFigures, settled: int) -> bool:
    """Whether the samples and gaps of a system are those of the plan's own from one of them on."""
    own, system = plan_system(plan), search.system
    samples, gaps = ({id(part) for part in parts} for parts in (own.samples, own.gaps))
    return {id(part) for part in system.samples[settled : len(system)]} <= samples and {
        id(g) for g in system.gaps[settled:]
    } <= gaps


def _beyond(search: GainSearch, k: int, reach: Array, room: float) -> float:
    """How many times as large the error z at a sample may be as what bounds the plan's; solved where above `room`."""
    entries = np.eye(reach.size)
    known = search.directions[k].bound(entries) / reach
    for i in np.flatnonzero(known > room):
        known[i] = min(known[i], _bounded_by_gains(search, k, entries[i]) / reach[i])
    return float(known.max(initial=0.0))
