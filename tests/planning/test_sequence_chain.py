"""Sequences in the plan's own coordinates: what is the plan's is not made again, and no adversary is beyond a bound."""

import numpy as np
import pytest

from sampling_design.planning.disturbed import delayed, without
from sampling_design.planning.sequence import looks_back, proven_ratio
from sampling_design.planning.sequence_chain import phase_of, plan_chain, sequence_chain
from sampling_design.planning.spread_sequence import SampleSequence, planned
from sampling_design.recovery.search import ChainSearch
from tests.oracles import planning as oracle


def alone(plan, k, late):
    """The plan with its sample k so late, and read with its second sensor alone."""
    sequence = delayed(plan, k, late)
    seen = sequence.seen.copy()
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
    own = plan_chain(week)
    chain, atoms = sequence_chain(week, own, sequence)
    fresh = [k for k, gap in enumerate(chain.gaps) if not any(gap is other for other in own.gaps)]
    assert set(fresh) <= {sequence.first - 1, sequence.first}
    assert all(gap.length == pytest.approx(h) for gap, h in zip(chain.gaps, np.diff(sequence.times), strict=True))
    search = ChainSearch(chain, atoms)
    for k in (sequence.first - 1, sequence.first, sequence.first + 2):
        for unit in np.eye(chain.D.size):
            bound = atoms[k].bound(unit[None])[0]
            gains, adversary = search.attack(k, unit)
            assert 0 < adversary.value <= gains.value * (1 + 1e-9)
            assert adversary.value <= bound


@pytest.mark.parametrize("change", CHANGES)
def test_what_is_proven_of_a_change_is_above_what_another_program_attains(week, change):
    sequence, plant = CHANGES[change](week), week.plant
    low = sequence.first - min(looks_back(week), 8)
    times, seen = sequence.times[low:], sequence.seen[low:]
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
    first = week.samples
    shifted = SampleSequence(np.append(times[:first], times[first:] + 1.0), seen, first, shift=1.0)
    chain, _ = sequence_chain(week, plan_chain(week), shifted)
    own = plan_chain(week)
    assert all(a is own.samples[phase_of(week.schedule, t)] for a, t in zip(chain.samples, times, strict=True))
