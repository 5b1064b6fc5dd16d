"""A result that is out, late or lost never leaves more open than was said of what is known at the time.

Another program works out, time by time, what the readings that are in by then leave possible: none is beyond what is
proven, the worst of them attains it, and results that come sooner, or not at all, change it in one direction.
"""

from __future__ import annotations

import functools

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.planning.disturbed import delayed, without
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from sampling_design.planning.sequence import proven_ratio, worst_ratio
from tests.cases import few
from tests.oracles import planning as oracle

PERIODS = 9


def drawn(case):
    """A plant of two outputs, a schedule whose samples read one or both, bounds and delays."""
    rng = np.random.default_rng(case)
    A = rng.normal(size=(2, 2)) * 0.8 - 0.3 * np.eye(2)
    plant = sd.Plant(A, np.eye(2) + 0.3 * rng.normal(size=(2, 2)), G=rng.normal(size=(2, 1)), outputs=["gauge", "lab"])
    count = int(rng.integers(2, 4))
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.3, 1.0, size=count))])
    seen = rng.random((count, 2)) < 0.6
    seen[0] = True
    seen[~seen.any(axis=1), 0] = True
    schedule = sd.PeriodicSchedule.from_times(times[:-1], float(times[-1]), seen, output_names=["gauge", "lab"])
    delays = rng.choice([0.0, 0.25, 0.8, 2.1], size=2) * float(times[-1]) / count * 1.3
    return plant, schedule, np.array([0.1]), rng.uniform(0.05, 0.3, size=2), delays


def late(v, delays):
    """Noise bound and result delay of each sensor."""
    each = zip(("gauge", "lab"), v, delays, strict=True)
    return {name: sd.schedules.Sensor(noise_bound=size, result_delay=delay) for name, size, delay in each}


def looked(plant, schedule, delays, w, v, c, looks=5):
    """Times of a late period just before each result comes, and between, with what is left open then."""
    period, times = schedule.period, np.asarray(schedule.times)
    every = np.concatenate([times + k * period for k in range(PERIODS)])
    seen = np.tile(schedule.outputs, (PERIODS, 1))
    comes = (every[:, None] + delays)[seen]
    begin = (PERIODS - 1) * period
    ends = [t - 1e-7 for t in comes if begin <= t <= begin + period]
    ends += np.linspace(begin, begin + period, looks, endpoint=False).tolist()
    system = plant.A, plant.C, plant.G
    return [(t, oracle.at_the_time(system, every, seen, delays, c, t, w, v)) for t in sorted(ends)]


@pytest.mark.parametrize("case", few(range(24), 0, 3))
def test_what_is_known_at_the_time_is_proven_and_attained(case):
    plant, schedule, w, v, delays = drawn(case)
    row = np.array([1.0, 0.4])
    found = sd.guaranteed_accuracy(plant, schedule, w_bound=w, v_bound=late(v, delays), of=[row])
    assert found.verify()
    left = looked(plant, schedule, delays, w, v, row)
    most = max(value for _, value in left)
    assert most <= found.upper[0] * (1 + 1e-6)
    assert found.lower[0] <= found.upper[0] <= found.lower[0] * 1.03
    assert most >= found.upper[0] * 0.95
    edges = found.profile.edges
    for t, value in left:  # at every time, and not only at the worst one
        at = edges[0] + (t - edges[0]) % schedule.period
        panel = min(int(np.searchsorted(edges, at, side="right")) - 1, edges.size - 2)
        assert value <= found.profile.upper[0, panel] * (1 + 1e-6)


@pytest.mark.parametrize("case", few(range(12), 1))
def test_results_that_come_sooner_never_leave_more_open(case):
    plant, schedule, w, v, delays = drawn(case)
    given = {"w_bound": w, "of": [[1.0, 0.4]]}
    at_once = sd.guaranteed_accuracy(plant, schedule, v_bound=v, **given)
    as_said = sd.guaranteed_accuracy(plant, schedule, v_bound=late(v, delays), **given)
    later = sd.guaranteed_accuracy(plant, schedule, v_bound=late(v, delays + 0.2), **given)
    assert at_once.lower[0] <= as_said.upper[0] * (1 + 1e-9)
    assert as_said.lower[0] <= later.upper[0] * (1 + 1e-9)
    ranges = [(0.0, float(delays[0])), (float(delays[1]) / 2, float(delays[1]))]
    same = sd.guaranteed_accuracy(plant, schedule, v_bound=late(v, ranges), **given)
    assert np.array_equal(same.upper, as_said.upper)
    assert np.array_equal(same.lower, as_said.lower)


def test_a_claim_that_forgets_the_delay_is_broken():
    """What is guaranteed with results at once is exceeded while they are out."""
    plant, schedule, w, v, _ = drawn(0)
    row, delays = np.array([1.0, 0.4]), np.array([0.6, 1.1])
    at_once = sd.guaranteed_accuracy(plant, schedule, w_bound=w, v_bound=v, of=[row])
    assert max(value for _, value in looked(plant, schedule, delays, w, v, row, looks=2)) > 1.05 * at_once.upper[0]


BODY = sd.Plant(
    [[0.0, 1.0], [-1.0, -0.1]], np.eye(2), G=[[0.0], [1.0]], states=["place", "speed"], outputs=["gauge", "lab"]
)
SENSORS = {
    "gauge": {"noise_bound": 0.2, "price": 1.0, "result_delay": 0.5},
    "lab": {"noise_bound": 0.05, "price": 3.0, "result_delay": (0.5, 2.25)},
}


@functools.cache
def followed(tolerance=None):
    """A plan of a rough gauge whose results come soon and of a laboratory whose results come late."""
    wanted = sd.PlanRequirement(
        {"place": 0.6, "speed": 0.6}, period=6.0, grid=0.5, w_bound=[0.1], sensors=SENSORS, timing_tolerance=tolerance
    )
    problem = pose_plan(BODY, wanted)
    chosen = np.zeros_like(problem.allowed)
    chosen[[0, 4, 8], 0] = True
    chosen[[2, 8], 1] = True
    return proven_plan(problem, chosen, PlanBound((), None, None), "budget")


def of_the_plan(plan, periods=6):
    times = np.concatenate([np.asarray(plan.schedule.times) + k * plan.schedule.period for k in range(periods)])
    return times, np.tile(plan.chosen[plan.chosen.any(axis=1)], (periods, 1))


def worst_truths(plan, times, seen, came, since, until):
    """The largest ratio of an error to its tolerance, flown: no result that is in shows it; just before each comes."""
    w, v = np.array([0.1]), plan.problem.v_bound
    comes = np.where(seen, times[:, None] + came, np.nan)
    ends = np.unique(np.round(comes[(comes > since) & (comes <= until)], 9)) - 1e-7
    worst = 0.0
    for end in [*ends.tolist(), until]:
        known = seen & (comes <= end)
        for goal in plan.goals:
            kept = times <= end
            _, nodes, _, u = oracle.hidden(BODY.A, BODY.C, BODY.G, times[kept], known[kept], goal.row, end, w, v)
            x = oracle.flown(BODY.A, BODY.G, nodes, u)
            y = np.abs(x[: int(kept.sum())] @ BODY.C.T / v)[known[kept]]
            excess = max(1.0, float(np.max(np.abs(u / w))), float(y.max(initial=0.0)))
            worst = max(worst, float(goal.row @ x[-1]) / excess / goal.tolerance)
    return worst


def test_no_truth_breaks_a_plan_whose_results_come_late():
    plan = followed()
    assert plan.verify()
    assert plan.ratio < 1
    times, seen = of_the_plan(plan)
    worst = worst_truths(plan, times, seen, plan.problem.result_delay, 28.0, 34.5)
    assert 0.95 * plan.ratio <= worst <= plan.ratio
    early = worst_truths(plan, times, seen, plan.problem.result_delays[:, 0], 31.0, 33.0)
    assert early <= worst  # results that come sooner than said


@pytest.mark.parametrize("k", few(range(4), 3))
def test_a_lost_or_late_sample_does_no_more_than_was_said(k):
    plan = followed()
    times, seen = of_the_plan(plan)
    at = int(np.flatnonzero(np.isclose(times, plan.schedule.times[k] + 24.0))[0])
    lost = worst_ratio(plan, without(plan, k, 1)), proven_ratio(plan, without(plan, k, 1), {})
    kept = np.arange(times.size) != at
    worst = worst_truths(plan, times[kept], seen[kept], plan.problem.result_delay, 24.0, 33.5)
    assert worst <= lost[1] * (1 + 1e-6)
    assert lost[0] <= lost[1] * (1 + 1e-6)
    assert worst >= 0.95 * lost[0]
    moved = times.copy()
    moved[at] += 0.5
    late = proven_ratio(plan, delayed(plan, k, 0.5), {})
    assert worst_truths(plan, moved, seen, plan.problem.result_delay, 26.0, 30.0) <= late * (1 + 1e-6)


@pytest.mark.long
def test_the_next_sample_counts_with_what_is_out():
    """A result that is awaited allows the next sample to be later than one that was never taken, and truths agree."""
    plan = followed()
    times, seen = of_the_plan(plan, 5)
    now = 26.25
    past = times <= now
    delays = plan.problem.result_delay
    rows = [
        (float(t), np.where(mask & (t + delays <= now), 0.0, np.nan), None)
        for t, mask in zip(times[past], seen[past], strict=True)
    ][-6:]
    out = [
        (float(t), BODY.outputs.names[j])
        for t, mask in zip(times[past][-6:], seen[past][-6:], strict=True)
        for j in np.flatnonzero(mask & (t + delays > now))
    ]
    assert out == [(25.0, "lab"), (26.0, "gauge")]
    found = sd.next_sample(plan, rows, now=now, awaited=out)
    assert found.keeps
    assert found.proven
    assert {(one.output, one.t) for one in found.awaited} == {(name, t) for t, name in out}
    lost = sd.next_sample(plan, rows, now=now)
    assert not lost.awaited
    assert not lost.keeps or lost.latest <= found.latest
    read = np.isin(BODY.outputs.names, found.outputs)
    following, masks = of_the_plan(plan, 7)
    after = following > found.latest + 1e-9
    every = np.concatenate([times[past], [found.latest], following[after]])
    masks = np.concatenate([seen[past], read[None], masks[after]])
    assert worst_truths(plan, every, masks, delays, now, found.latest + 6.0) <= 1.0
