"""What breaks a tolerance between the steps of the grid alone is found there, and says the same of every choice."""

from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.planning.accuracy_oracle import PARTS, AccuracyOracle, narrowed
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.evidence import AGAIN, resimulated, trajectory_of, trajectory_to_dict
from sampling_design.planning.hidden_trajectories import HiddenTrajectories
from sampling_design.planning.problem import pose_plan
from tests.cases import few

STEPS, RIVALS = 6, 2
BY_CHANCE = 1e-5  # share by which a choice keeps its tolerances on the grid


def kept_on_the_grid(seed):
    """A problem, its oracle, and a choice that keeps the tolerances as far as the grid tells, by hardly more."""
    rng = np.random.default_rng(seed)
    A, C = 1.5 * rng.standard_normal((2, 2)), rng.standard_normal((2, 2))
    A -= max(0.0, float(np.linalg.eigvals(A).real.max()) - 0.1) * np.eye(2)
    chosen = np.zeros((STEPS, 2), dtype=bool)
    chosen[[0, 2 + seed % 2], [0, 1]] = chosen[0, 1] = True
    sensors = {f"y{j}": {"noise_bound": 0.2, "result_delay": 0.6 if j == 1 and seed % 3 == 2 else None} for j in (1, 2)}
    asked = sd.PlanRequirement({"x1": 1.0}, period=3.0, grid=0.5, w_bound=[0.1, 0.2], sensors=sensors)
    plant = sd.Plant(A, C)
    problem = pose_plan(plant, asked)
    reached, _ = AccuracyOracle(problem, discretize(problem)).judge(chosen)
    problem = pose_plan(plant, asked.replace(accuracy={"x1": reached * (1 + BY_CHANCE)}))
    oracle = AccuracyOracle(problem, discretize(problem))
    oracle.judge(chosen)
    return problem, oracle, chosen, rng


def proven(problem, chosen):
    """What is proven of a choice at all times, over the tolerance."""
    delay = problem.result_delay
    sensors = {
        name: sd.schedules.Sensor(noise_bound=0.2, result_delay=None if delay is None else float(delay[j]))
        for j, name in enumerate(("y1", "y2"))
    }
    found = sd.guaranteed_accuracy(
        problem.plant, problem.schedule(chosen), w_bound=[0.1, 0.2], v_bound=sensors, of=["x1"]
    )
    return float(found.upper[0]) / problem.goals[0].tolerance


@pytest.mark.parametrize("seed", few([3, 4, 5, 6, 10, 13, 15, 17, 18, 21], 2))
def test_it_is_found_and_says_the_same_of_every_choice(seed):
    problem, oracle, chosen, rng = kept_on_the_grid(seed)
    assert oracle.judge(chosen)[0] <= 1
    worst, found = oracle.judge(chosen, above=1.0)
    between = [each for each in found if each.parts > 1]
    assert 1 < worst == max(each.reach for each in between)
    assert worst <= proven(problem, chosen)
    strongest = max(between, key=lambda each: each.reach)
    assert strongest.parts == PARTS
    others = [(rng.random(chosen.shape) < 0.5) | np.eye(STEPS, 2, dtype=bool) for _ in range(RIVALS)]
    true = {other.tobytes(): proven(problem, other) for other in others}
    smaller = narrowed(oracle, strongest, 1.0)
    assert smaller.parts == PARTS
    assert (smaller.weights(1.0) > 0).sum() <= (strongest.weights(1.0) > 0).sum()
    for each in (strongest, smaller):
        again = resimulated(problem, oracle.discrete, each)
        assert again.reach >= each.reach * (1 - AGAIN)
        np.testing.assert_allclose(again.peaks, each.peaks, rtol=1e-5, atol=1e-9)
        read = trajectory_of(problem, oracle.discrete, trajectory_to_dict(each))
        assert (read.end, read.parts, read.at_sample) == (each.end, each.parts, each.at_sample)
        np.testing.assert_allclose(read.peaks, each.peaks, rtol=1e-12)
        pool = HiddenTrajectories(STEPS, [problem.ends(0)])
        pool.add(each)
        assert pool.against(chosen)[0] > 1
        for other in others:  # turned by any steps, it says no more of other choices than is true of them
            assert pool.against(other)[0] <= true[other.tobytes()]


def test_a_trajectory_of_another_grid_is_no_proof():
    problem, oracle, chosen, _ = kept_on_the_grid(13)
    strongest = max(oracle.judge(chosen, above=1.0)[1], key=lambda each: each.reach)
    for other in (replace(strongest, parts=1), replace(strongest, parts=2 * PARTS)):
        again = resimulated(problem, oracle.discrete, other)
        assert again is None or again.reach < strongest.reach * (1 - AGAIN)
