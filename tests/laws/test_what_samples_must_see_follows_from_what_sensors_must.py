"""Where sensors are paid one by one, rows for whole samples hold for every choice and close the proof of its cost."""

from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.planning import bounds
from sampling_design.planning.adversary_program import DisturbedTrajectory
from sampling_design.planning.bounds import CostProver
from sampling_design.planning.covering import CoveringProgram, CoveringRows, cheapest, relaxed
from sampling_design.planning.evidence import CostProof, CostTree, proven_cost
from sampling_design.planning.hidden_trajectories import HiddenTrajectories, HiddenTrajectory
from sampling_design.planning.problem import pose_plan
from sampling_design.records.budget import Budget
from tests.cases import few

STEPS, LEVEL = 5, 1.0
PLANT = sd.Plant([[0.0, 1.0], [-1.0, -0.1]], np.eye(2), states=["place", "speed"], outputs=["y", "z"])
STILL = DisturbedTrajectory(np.zeros((1, 1)), np.zeros(1, dtype=np.intp), np.zeros((1, 2)), np.zeros((2, 2)))


def posed(rng=None, unit=1.0):
    """Two sensors with prices of their own; with `rng`, not both at all times, some of them limited."""
    sensors = {"y": {"noise_bound": 0.2, "price": 2.0 * unit}, "z": {"noise_bound": 0.3, "price": 3.0 * unit}}
    if rng is not None:
        sensors["y"]["available"] = [[0.0, 1.5]] if rng.random() < 0.5 else None
        sensors["z"]["longest_use"] = int(rng.integers(2, 5))
    wanted = sd.PlanRequirement(
        {"place": 1.0}, period=2.5, grid=0.5, w_bound=0.1, sensors=sensors, visit_price=5.0 * unit
    )
    return pose_plan(PLANT, wanted)


def pooled(problem, rng, count):
    """Trajectories and tangents that some measurements see, a third of them at samples."""
    pool = HiddenTrajectories(STEPS, [problem.ends(0)])
    for k in range(count):
        own = bool(rng.random() < 0.3)
        if k % 3 == 2:
            slopes = np.where(rng.random((STEPS, 2)) < 0.5, rng.uniform(0.05, 0.8, (STEPS, 2)), 0.0)
            pool.add(HiddenTrajectory(0, 1.2, 0, own, slopes, None, np.zeros((STEPS, 2))))
        else:
            peaks = np.where(rng.random((STEPS, 2)) < rng.uniform(0.2, 0.5), 2.0, 0.5)
            pool.add(HiddenTrajectory(0, 1.0, 0, own, peaks, STILL))
    return pool


def seen(problem, pool, chosen):
    """Whether a choice sees every trajectory, whichever way it is turned; by hand."""
    for trajectory, end in product(pool.trajectories, range(STEPS)):
        if trajectory.at_sample and not chosen[end].any():
            continue
        taken = [trajectory.weights(LEVEL)[(end - i) % STEPS, j] for i, j in np.argwhere(chosen).tolist()]
        if sum(taken) < 1 - 1e-12:
            return False
    return True


def choices(problem):
    """All admissible choices."""
    for bits in product((False, True), repeat=2 * STEPS):
        chosen = np.array(bits).reshape(STEPS, 2)
        if problem.is_admissible(chosen):
            yield chosen


@pytest.mark.parametrize("seed", few(range(12), 0, 3))
def test_the_least_cost_of_all_choices_is_what_is_proven(seed):
    rng = np.random.default_rng(seed)
    problem = posed(rng if seed % 2 else None, unit=10.0 ** (4 * (seed % 4) - 8))
    pool, covering = pooled(problem, rng, 3), CoveringRows(problem)
    keys = [(a, end) for a in range(len(pool.trajectories)) for end in range(STEPS)]
    model, dearest = covering.model(pool.trajectories, keys, LEVEL), covering.dearest
    assert model.b.size == len(covering.frame[1]) + 2 * len(keys)
    least = dearest
    for chosen in choices(problem):
        if seen(problem, pool, chosen):
            assert np.all(model.A @ covering.point(chosen) >= model.b - 1e-12)
            least = min(least, problem.cost(chosen))
        else:
            assert np.any(model.A @ covering.point(chosen) < model.b - 1e-12)
    for within in (False, True):
        found, none = cheapest(covering, model, np.zeros(model.c.size), Budget(counted=True), within_limits=within)
        assert none == (least == dearest)
        assert found is None or seen(problem, pool, found)
    proof = CostProver(covering, pool, Budget(counted=True), lambda x, level: None).least_cost(LEVEL, dearest)
    assert proof.value == pytest.approx(least, rel=1e-9)
    assert proven_cost(covering, pool, proof) >= proof.value * (1 - 1e-9)


@pytest.mark.parametrize("seed", few([8, 42, 17, 23], 0))
def test_a_proof_is_found_with_as_many_nodes_as_it_has(seed, monkeypatch):
    """One leaf that is left open ends it all, so that no branch keeps nodes that another one lacks."""
    rng = np.random.default_rng(seed)
    problem = posed()
    pool, covering = pooled(problem, rng, 3), CoveringRows(problem)
    prover = CostProver(covering, pool, Budget(counted=True), lambda x, level: None)
    least = min(problem.cost(chosen) for chosen in choices(problem) if seen(problem, pool, chosen))
    proof = prover.least_cost(LEVEL, least, decide=True)
    assert proof.value == least
    nodes = len(proof.tree.to_list())
    for many, enough in ((nodes, True), (1, False)):
        monkeypatch.setattr(bounds, "MOST_NODES", many)
        assert (prover.least_cost(LEVEL, least, decide=True).value == least) == enough


def test_without_them_a_visit_is_taken_by_halves():
    """Two times at which both sensors see: half of each at half a visit does, as if it were a whole one."""
    problem = posed()
    pool, covering = HiddenTrajectories(STEPS, [problem.ends(0)]), CoveringRows(problem)
    peaks = np.where(np.arange(STEPS) == 2, 2.0, 0.5)[:, None] * [1, 1]
    pool.add(HiddenTrajectory(0, 1.0, 0, False, peaks, STILL))
    model = covering.model(pool.trajectories, [(0, 0), (0, 2)], LEVEL)
    ones, work = np.ones(model.c.size), Budget(counted=True)
    without = CoveringProgram(model.c, model.A[:-2], model.b[:-2])
    assert relaxed(without, 0 * ones, ones, work)[2] == pytest.approx(2 * 5.0, rel=1e-5)
    assert relaxed(model, 0 * ones, ones, work)[2] == pytest.approx(2 * 7.0, rel=1e-5)  # as every choice


def test_a_proof_with_rows_that_there_are_not_proves_nothing():
    problem = posed()
    pool, covering = pooled(problem, np.random.default_rng(1), 2), CoveringRows(problem)
    proof = CostProver(covering, pool, Budget(counted=True), lambda x, level: None).least_cost(LEVEL, covering.dearest)
    rows = len(covering.frame[1]) + 2 * len(proof.keys)
    for row, value in ((rows - 1, 0.0), (rows, -np.inf)):
        forged = CostProof(LEVEL, 0.0, proof.keys, CostTree((row,), (0.0,)))
        assert proven_cost(covering, pool, forged) == value
