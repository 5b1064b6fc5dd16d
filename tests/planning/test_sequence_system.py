"""Sequences in the plan's own coordinates: what is the plan's is not made again, and no adversary is beyond a bound."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.sampled_system import MeasurementModel
from sampling_design.accuracy.search import GainSearch
from sampling_design.planning.disturbed import delayed, without
from sampling_design.planning.sequence import forgets, looks_back, proven_ratio, settles
from sampling_design.planning.sequence_deviation import SampleSequence, phase_of, planned
from sampling_design.planning.sequence_system import _noisier, plan_system, sequence_system
from tests.oracles import planning as oracle


def alone(plan, k, late):
    """The plan with its sample k so late, and read with its second sensor alone."""
    sequence = delayed(plan, k, late)
    seen = sequence.measured.copy()
    seen[sequence.first] = [False, True]
    return SampleSequence(sequence.times, seen, sequence.first)


CHANGES = {
    "late": lambda plan: delayed(plan, 1, plan.problem.step),
    "lost": lambda plan: without(plan, 0, 1),
    "another sensor": lambda plan: alone(plan, 1, plan.problem.step),
}


@pytest.mark.parametrize("change", CHANGES)
def test_no_adversary_is_beyond_what_the_filter_bounds(week, change):
    sequence = CHANGES[change](week)
    own = plan_system(week)
    system, directions = sequence_system(week, sequence)
    fresh = [k for k, gap in enumerate(system.gaps) if not any(gap is other for other in own.gaps)]
    assert set(fresh) <= {sequence.first - 1, sequence.first}
    assert all(gap.length == pytest.approx(h) for gap, h in zip(system.gaps, np.diff(sequence.times), strict=True))
    search = GainSearch(system, directions)
    for k in (sequence.first - 1, sequence.first, sequence.first + 2):
        for unit in np.eye(system.D.size):
            bound = directions[k].bound(unit[None])[0]
            gains, adversary = search.both_sides(k, unit)
            assert 0 < adversary.value <= gains.value * (1 + 1e-9)
            assert adversary.value <= bound


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_proven_of_a_change_is_above_what_another_program_attains(week, change):
    sequence, plant = CHANGES[change](week), week.plant
    low = sequence.first - min(looks_back(week), 8)
    times, seen = sequence.times[low:], sequence.measured[low:]
    w, v, attained = np.array([0.02, 0.01]), np.array([0.5, 0.1]), 0.0
    for k in range(sequence.first - low - 1, sequence.first - low + 2):
        for end in np.linspace(times[k], times[k + 1], 3):
            program = oracle.hidden(plant.A, plant.C, plant.G, times[: k + 1], seen[: k + 1], [1.0, 0.0], end, w, v)
            attained = max(attained, program[0] / 3.0)
    proven = proven_ratio(week, sequence)
    assert attained <= proven * (1 + 1e-9)
    assert proven <= max(1.0, attained * 1.1) or proven > 1


def test_samples_of_other_clocks_are_the_plans(week):
    period = week.schedule.period
    times, seen = planned(week, 0.0, 3 * period)
    real, same = planned(week, 0.0, 3 * period - 1.0, week.clock)
    first = week.samples
    np.testing.assert_allclose(real, np.append(times[:first], times[first:] - 1.0), rtol=1e-12)
    np.testing.assert_array_equal(same, seen)
    system, _ = sequence_system(week, SampleSequence(real, seen, first, week.clock))
    own = plan_system(week)
    assert all(a is own.samples[phase_of(week.schedule, t)] for a, t in zip(system.samples, times, strict=True))


@pytest.fixture(scope="module")
def slow():
    """A plan of one sample a period whose filter looks back far: a level that drifts slowly, read with much noise."""
    plant = sd.Plant([[0.0, 1.0], [0.0, -0.05]], [[1.0, 0.0]], states=("level", "drift"), time_unit="h")
    wanted = sd.PlanRequirement(
        {"level": 2.2},
        period=2.0,
        grid=1.0,
        w_bound=[0.002, 0.001],
        sensors={"y1": {"noise_bound": 1.0, "price": 1.0}},
    )
    return sd.plan_samples(plant, wanted, certificate=False, robustness=False, from_start=False)


@pytest.mark.long
def test_a_filter_that_forgets_slowly_is_followed_until_it_has(slow):
    """What is said of all that follows is above what is found of each gap, one by one, for much longer."""
    count = len(slow.schedule)
    assert forgets(slow) > 4 * count
    sequence = without(slow, 0, 1)
    proven = proven_ratio(slow, sequence)
    times, seen = planned(slow, float(sequence.times[-1]) + 1e-6, float(sequence.times[-1]) + 40.0)
    longer = SampleSequence(np.append(sequence.times, times), np.vstack([sequence.measured, seen]), sequence.first)
    assert proven_ratio(slow, longer) <= proven * (1 + 1e-3)
    assert proven > max(slow.reached / [goal.tolerance for goal in slow.problem.goals])
    filtered = plan_system(slow)
    _, directions = sequence_system(slow, longer)
    settled = len(sequence.times) - 1 - max(looks_back(slow), forgets(slow)) - count
    over = [
        np.max(a.reach / filtered.reach[phase_of(slow.schedule, t)])
        for a, t in zip(directions, longer.times, strict=True)
    ]
    assert max(over[: sequence.first + 1]) > max(over[settled:])
    assert max(over[settled + forgets(slow) :]) <= max(over[settled : settled + forgets(slow)]) * (1 + 1e-6)


def test_a_sequence_that_does_not_end_with_the_plan_for_long_enough_proves_nothing(week):
    sequence = delayed(week, 1, week.problem.step)
    assert proven_ratio(week, sequence) < np.inf
    few = sequence.first + settles(week) - 4
    assert proven_ratio(week, SampleSequence(sequence.times[:few], sequence.measured[:few], sequence.first)) == np.inf
    moved = sequence.times.copy()
    moved[-3] += week.problem.step
    assert proven_ratio(week, SampleSequence(moved, sequence.measured, sequence.first)) == np.inf


@pytest.mark.parametrize("more", [0.0, 1e-10, 1e-3, 0.5])
def test_noise_that_joins_counts_in_full_however_exact_its_sensor_is(more):
    nearly, plain = (np.array([1e-7, 0.2]), np.array([1e-3, 1.0])), np.array([1e-10, 0.2])
    sample = MeasurementModel(np.arange(2), nearly[0], np.eye(2) / nearly[0][:, None], nearly[1], np.eye(2))
    found = _noisier(sample, plain, np.full(2, more))
    np.testing.assert_allclose(found.size * found.noise, plain + more, rtol=1e-12)
    np.testing.assert_allclose(found.size[:, None] * found.H, np.eye(2), rtol=1e-12)
    assert (found is sample) == (more == 0)
