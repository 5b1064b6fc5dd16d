"""Attacks that little shows, and what a plan's own gains prove of the gaps that follow a change."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.bounds import InitialSet
from sampling_design.planning import sequence as sequences
from sampling_design.planning.accuracy_oracle import AccuracyOracle, detecting_measurements, narrowed
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.disturbed import delayed
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.sequence_system import plan_system
from sampling_design.planning.transient_bound import cut_gains, settled_factors

LEVEL = 1.0


@pytest.fixture(scope="module")
def oracle():
    """A plant that turns beside one that drifts, each with a sensor, read in twelve places of a period."""
    A = np.zeros((3, 3))
    A[:2, :2] = [[0.0, 1.0], [-1.0, 0.0]]
    plant = sd.Plant(A, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], G=[[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    wanted = sd.PlanRequirement(
        {"x1": 0.6, "x3": 0.9},
        period=6.0,
        grid=0.5,
        w_bound=[0.1, 0.1],
        sensors={"y1": {"noise_bound": 0.1, "price": 1.0}, "y2": {"noise_bound": 0.2, "price": 1.0}},
    )
    problem = pose_plan(plant, wanted)
    return AccuracyOracle(problem, discretize(problem))


def test_an_attack_is_narrowed_to_fewer_measurements_and_reaches_the_level_still(oracle):
    chosen = np.zeros_like(oracle.problem.allowed)
    chosen[[0, 5], 0] = chosen[3, 1] = True
    attacks = oracle.judge(chosen, above=LEVEL)[1]
    attack = max(attacks, key=lambda each: each.reach)
    assert attack.reach > LEVEL
    found = narrowed(oracle, attack, LEVEL)
    before, after = detecting_measurements(oracle, attack, LEVEL), detecting_measurements(oracle, found, LEVEL)
    assert found.reach > LEVEL
    assert not np.any(after & ~before)
    assert after.sum() < before.sum()
    assert not np.any(after & chosen)
    assert oracle.judge(oracle.problem.allowed & ~after)[0] >= found.reach * (1 - 1e-6)


def test_what_nothing_shows_drifts_until_it_reaches_any_level(oracle):
    chosen = np.zeros_like(oracle.problem.allowed)
    chosen[::3, 0] = True
    blindness = oracle.hidden(chosen)
    for level in (1.0, 5.0):
        attack = oracle.drifting_trajectory(blindness, level)
        assert attack.reach > level
        assert oracle.problem.goals[attack.goal].name == "x3"
        assert not np.any(detecting_measurements(oracle, attack, level) & ~blindness.where)


def test_gains_cut_off_nowhere_prove_what_the_plan_proves(week):
    whole = [part.cost[-1] + part.rest[-1] for part in cut_gains(week)]
    for part, total in zip(week.accuracy.proof, whole, strict=True):
        system = plan_system(week)
        assert total == pytest.approx(
            [evaluated_at(system, part, k) for k in range(len(part.gains))], rel=1e-9
        )  # the same sums, one by one


def evaluated_at(system, part, k):
    from sampling_design.accuracy.gains import evaluated

    nodes = system.nodes(part.sample, len(part.gains[k]))
    start = InitialSet.box(system.reach[nodes[0]])
    return evaluated(system, nodes, start, part.directions[[k]], [part.gains[k]])[0].value


def test_an_error_as_small_as_the_plans_leaves_its_gaps_as_they_are_and_a_larger_one_fades(week):
    system, N = plan_system(week), week.samples
    phases = [k % N for k in range(40 * N)]
    assert settled_factors(week, phases, [system.reach[k] for k in phases])[-1] == pytest.approx(1.0, abs=1e-6)
    wide = [system.reach[k] * (10.0 if j == 0 else 1.0) for j, k in enumerate(phases)]
    found = settled_factors(week, phases, wide)
    assert found[0] > 1.5
    assert np.all(found >= 1.0)
    assert found[-1] < 1.01


def test_gaps_that_the_plans_own_gains_prove_are_as_good_as_proven_one_by_one(week, monkeypatch):
    late = delayed(week, 0, week.problem.step)
    quick = sequences.proven_ratio(week, late)
    monkeypatch.setattr(sequences, "settled_factors", lambda plan, phases, reach: np.full(len(phases), np.inf))
    slow = sequences.proven_ratio(week, late)
    attained = sequences.worst_ratio(week, late)
    assert (
        attained * (1 - 1e-3) <= quick <= slow * (1 + 2 * sequences.FADED)
    )  # one by one, gaps are proven as far as asked
    assert attained * (1 - 1e-3) <= slow <= 1
