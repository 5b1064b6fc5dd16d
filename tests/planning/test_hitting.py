"""Few samples that see every motion: the answer of trying all choices, with a proof that adds up without a solver."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy import sparse

from sampling_design import PlanRequirement, Plant, plan_samples
from sampling_design.planning import hitting_set
from sampling_design.planning.adversary_program import DisturbedTrajectory
from sampling_design.planning.bounds import CostProver
from sampling_design.planning.covering import CoveringProgram, CoveringRows, relaxed
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.evidence import CostTree, PlanBound, bound_holds, proven_cost
from sampling_design.planning.hidden_trajectories import HIDDEN, MANY, HiddenTrajectories, HiddenTrajectory
from sampling_design.planning.hitting_set import smallest_hitting_set
from sampling_design.planning.problem import pose_plan
from sampling_design.records.budget import Budget
from tests.cases import few

STEPS = 12
TWO = Plant(
    [[0.0, 1.0], [-1.0, -0.1]], np.eye(2), B=[[1.0, 0.0], [0.0, 1.0]], states=["place", "speed"], outputs=["y", "z"]
)
NO_FLIGHT = DisturbedTrajectory(np.zeros((1, 1)), np.zeros(1, dtype=np.intp), np.zeros((1, 2)), np.zeros((2, 2)))


def test_a_row_that_nothing_sees_is_dearer_than_all_that_there_is():
    count = 1200
    program = CoveringProgram(np.ones(count), sparse.csr_matrix((1, count)), np.ones(1))
    assert relaxed(program, np.zeros(count), np.ones(count), Budget(counted=True))[2] > count


@pytest.mark.parametrize("taken", [0.3, 0.9])
def test_what_many_measurements_see_is_what_each_of_them_sees(taken):
    """Looked for from the largest ratio down, since most ends are seen by one of the first."""
    rng, steps = np.random.default_rng(3), 90
    peaks = rng.uniform(0.0, 1.6, (steps, 2))
    peaks[4] = 30.0
    at, sensor = np.nonzero(rng.random((steps, 2)) < taken)
    trajectory = HiddenTrajectory(0, 2.0, 0, False, peaks, NO_FLIGHT)
    pool = HiddenTrajectories(steps, [np.arange(steps) % 7 != 3])
    seen = [max(peaks[(end - i) % steps, j] for i, j in zip(at, sensor, strict=True)) for end in range(steps)]
    plain = np.where(pool.ends[0], 2.0 / np.maximum(np.array(seen) / HIDDEN, 1.0), 0.0)
    assert at.size > (MANY if taken > 0.5 else steps // 3)
    assert np.array_equal(pool.proven(trajectory, at, sensor), plain)


def posed(samples=3, *, closed=(), **more):
    sensors = {"y": {"noise_bound": 0.2}, "z": {"noise_bound": 0.3}}
    asked = PlanRequirement(
        {"place": 1.0}, period=6.0, grid=0.5, w_bound=0.1, **{"sensors": sensors, "samples": samples, **more}
    )
    problem = pose_plan(TWO, asked)
    allowed = problem.allowed.copy()
    allowed[list(closed)] = False
    return replace(problem, allowed=allowed)


def pooled(rng, problem, count, at_sample=False):
    """Motions of level one, each shown by some steps and sensors."""
    pool = HiddenTrajectories(problem.steps, [problem.ends(g) for g in range(len(problem.goals))])
    for _ in range(count):
        peaks = np.where(rng.random((problem.steps, 2)) < rng.uniform(0.1, 0.4), 2.0, 0.5)
        own = at_sample and bool(rng.random() < 0.5)
        pool.add(HiddenTrajectory(0, 1.0, 0, own, peaks, NO_FLIGHT))
    return pool


def seen_by(problem, pool, steps):
    """Whether samples with all sensors at these steps see every motion, whichever way it is turned; by hand."""
    for attack in pool.trajectories:
        for end in range(problem.steps):
            if attack.at_sample and end not in steps:
                continue
            if not any(attack.peaks[(end - i) % problem.steps].max() > 1 for i in steps):
                return False
    return True


def tried(problem, pool, most):
    """All choices of at most so many allowed steps that see every motion."""
    at = np.flatnonzero(problem.allowed.any(axis=1)).tolist()
    every = (steps for count in range(1, most + 1) for steps in combinations(at, count))
    return [steps for steps in every if seen_by(problem, pool, steps)]


@pytest.mark.parametrize("seed", few(range(40), *range(0, 40, 3)))
def test_it_says_what_trying_all_choices_says(seed):
    rng = np.random.default_rng(seed)
    closed = rng.choice(STEPS, 3, replace=False).tolist() if seed % 2 else ()
    problem = posed(int(rng.integers(2, 5)), closed=closed)
    pool = pooled(rng, problem, int(rng.integers(1, 5)), at_sample=seed % 4 > 1)
    covering = CoveringRows(problem, fixed=problem.is_free)
    most = int(problem.most_samples)
    found = smallest_hitting_set(covering, pool, 1.0, covering.dearest, Budget(counted=True))
    wanted = tried(problem, pool, most)
    assert found is not None
    assert found.none == (not wanted)
    if wanted:
        assert found.proof is None
        assert tuple(np.flatnonzero(found.chosen.any(axis=1)).tolist()) in wanted
        return
    assert proven_cost(covering, pool, found.proof) >= covering.dearest * (1 - 1e-9)
    loose = CoveringRows(
        replace(problem, most_samples=np.inf), fixed=covering.fixed
    )  # one more than these is all that is proven
    again = smallest_hitting_set(loose, pool, 1.0, most + 1.0, Budget(counted=True))
    assert proven_cost(loose, pool, again.proof) == most + 1.0


@pytest.mark.parametrize("price", [0.0, 3.0])
@pytest.mark.parametrize("at_sample", [False, True])
def test_rows_that_others_imply_ask_for_nothing_more(price, at_sample):
    problem = posed(None, sensors={"y": {"noise_bound": 0.2, "price": price}, "z": {"noise_bound": 0.3}})
    rng, covering = np.random.default_rng(5), CoveringRows(problem, fixed=problem.is_free)
    pool = pooled(rng, problem, 6, at_sample=at_sample)
    rows = covering.trajectory_rows(pool, 1.0)
    kept = rows.undominated()
    assert covering.whole == (not price)
    assert 0 < len(kept) < len(rows.keys)

    first = covering.frame[0].shape[0]
    programs = [(covering.model(pool.trajectories, keys, 1.0), len(keys)) for keys in (rows.keys, kept)]
    answers = []
    for _ in range(200):
        share, chosen = rng.uniform(0.6, 1.0), np.zeros(problem.allowed.shape, dtype=bool)
        chosen[:] = rng.random((STEPS, 1)) < share if covering.whole else rng.random((STEPS, 2)) < share
        x = covering.point(chosen)
        keeps = [bool(np.all((model.A @ x - model.b)[first : first + n] >= 0)) for model, n in programs]
        answers.append(keeps[0])
        assert keeps[0] == keeps[1]
    assert 10 < sum(answers) < 190
    clauses = [{*np.flatnonzero(s).tolist(), -1 - int(o)} for s, o in zip(rows.shows, rows.owner, strict=True)]
    mine = [clauses[rows.keys.index(key)] - {-1 - covering.columns} for key in kept]
    assert not any(one <= other for one in mine for other in mine if one is not other)


def test_both_answers_are_met():
    answers = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        problem = posed(3)
        covering = CoveringRows(problem, fixed=True)
        answers.append(
            smallest_hitting_set(covering, pooled(rng, problem, 3), 1.0, covering.dearest, Budget(counted=True)).none
        )
    assert 5 < sum(answers) < 35


@pytest.mark.parametrize("limit", [10.0, 14.0])
def test_a_limit_of_money_is_one_of_samples(limit):
    rng = np.random.default_rng(8)
    problem = posed(None, visit_price=5.0, cost_limit=limit)
    covering, pool = CoveringRows(problem, fixed=True), pooled(rng, problem, 6)
    assert not tried(problem, pool, 2)
    found = smallest_hitting_set(covering, pool, 1.0, covering.dearest, Budget(counted=True))
    assert found.none
    assert proven_cost(covering, pool, found.proof) > limit  # two samples are all that it buys


def leaves(tree):
    """How many there are, and the tree with one of its leaves, by number, proving nothing."""
    if not tree.branches:
        return 1, lambda k: CostTree() if k == 0 else tree
    (left, mend), (right, mend_right) = map(leaves, tree.branches)
    return left + right, lambda k: replace(tree, branches=(mend(k), mend_right(k - left)))


def unseen():
    """A pool that three samples do not see, and a proof with several leaves."""
    problem = posed(3)
    covering = CoveringRows(problem, fixed=True)
    for seed in range(1000):
        pool = pooled(np.random.default_rng(seed), problem, 3)
        found = smallest_hitting_set(covering, pool, 1.0, covering.dearest, Budget(counted=True))
        if found.none and leaves(found.proof.tree)[0] > 8:
            return covering, pool, found.proof
    raise AssertionError


def test_every_leaf_and_every_row_is_needed():
    covering, pool, proof = unseen()
    count, without = leaves(proof.tree)
    for k in range(count):
        assert proven_cost(covering, pool, replace(proof, tree=without(k))) < covering.dearest - 1
    for k in range(len(proof.keys)):  # a motion that all steps show asks for nothing
        (a, end), faint = proof.keys[k], HiddenTrajectories(pool.steps, pool.ends)
        faint.trajectories = [
            *pool.trajectories,
            replace(pool.trajectories[a], peaks=np.full_like(pool.trajectories[a].peaks, 2.0)),
        ]
        keys = (*proof.keys[:k], (len(pool.trajectories), end), *proof.keys[k + 1 :])
        assert proven_cost(covering, faint, replace(proof, keys=keys)) < covering.dearest - 1


def test_motions_that_end_where_nothing_is_asked_prove_nothing():
    problem = posed(3)
    ends = np.zeros(problem.steps, dtype=bool)
    ends[3] = True
    covering, pool = CoveringRows(problem, fixed=False), HiddenTrajectories(problem.steps, [ends])
    pool.add(HiddenTrajectory(0, 1.0, 3, False, np.full((problem.steps, 2), 0.5), NO_FLIGHT))
    found = smallest_hitting_set(covering, pool, 1.0, covering.dearest, Budget(counted=True))
    assert found.none
    assert proven_cost(covering, pool, found.proof) >= covering.dearest * (1 - 1e-9)
    turned = replace(found.proof, keys=tuple((a, end + 1) for a, end in found.proof.keys))
    assert proven_cost(covering, pool, turned) == -np.inf


def test_a_motion_at_a_sample_asks_nothing_where_none_may_be_taken():
    problem = posed(3, closed=[4])
    covering = CoveringRows(problem)
    attack = HiddenTrajectory(0, 1.0, 4, True, np.full((problem.steps, 2), 0.5), NO_FLIGHT)
    assert covering.rows(attack, 4, 1.0)[0][0].size == 0
    assert covering.rows(attack, 4, 1.0)[0][2] == 0.0
    assert covering.rows(attack, 5, 1.0)[0][2] == 0.0  # where one is taken, it must be seen: it is not
    assert covering.rows(attack, 5, 1.0)[0][1].tolist() == [-1.0]


@pytest.mark.parametrize(
    "more", [{"spacing": 1.0}, {"sensors": {"y": {"noise_bound": 0.2, "price": 1.0}, "z": {"noise_bound": 0.3}}}]
)
def test_where_more_than_the_number_counts_a_solver_is_asked(more):
    problem = posed(3, **more)
    assert (
        smallest_hitting_set(
            CoveringRows(problem, fixed=True),
            pooled(np.random.default_rng(0), problem, 2),
            1.0,
            4.0,
            Budget(counted=True),
        )
        is None
    )


def test_nodes_that_run_out_leave_the_question_to_the_solver(monkeypatch):
    covering, pool, _ = unseen()
    monkeypatch.setattr(hitting_set, "MOST_NODES", 3)
    found = smallest_hitting_set(covering, pool, 1.0, covering.dearest, Budget(counted=True))
    assert (found.chosen, found.none, found.proof) == (None, False, None)
    prover = CostProver(covering, pool, Budget(counted=True), lambda x, level: None)
    proof = prover.least_cost(1.0, covering.dearest, decide=True)
    assert proof.value >= covering.dearest * (1 - 1e-9)


def test_what_must_be_measured_once_is_met_and_has_no_proof():
    problem = posed(3)
    covering, pool = (
        CoveringRows(problem, fixed=False),
        HiddenTrajectories(problem.steps, [np.ones(problem.steps, dtype=bool)]),
    )
    masks = np.zeros((4, problem.steps, 2), dtype=bool)
    for k, mask in enumerate(masks):
        mask[3 * k : 3 * k + 3] = True
    assert (
        smallest_hitting_set(covering, pool, 1.0, covering.dearest, Budget(counted=True), masks[:3]).chosen[3:6].any()
    )
    found = smallest_hitting_set(covering, pool, 1.0, covering.dearest, Budget(counted=True), masks)
    assert found.none
    assert found.proof is None


def test_samples_are_whole_only_where_more_sensors_cost_nothing_and_break_nothing():
    assert CoveringRows(posed(3)).columns == STEPS
    both = {"y": {"noise_bound": 0.2, "price": 1.0}, "z": {"noise_bound": 0.3}}
    assert CoveringRows(posed(3, sensors=both)).columns == 3 * STEPS
    seldom = {"y": {"noise_bound": 0.2, "longest_use": 2}, "z": {"noise_bound": 0.3}}
    assert CoveringRows(posed(3, sensors=seldom)).columns == 3 * STEPS
    apart = {"y": {"noise_bound": 0.2, "spacing": 2.0}, "z": {"noise_bound": 0.3}}
    assert CoveringRows(posed(3, sensors=apart)).columns == 3 * STEPS
    problem = posed(3)
    allowed = problem.allowed.copy()
    allowed[5, 0] = False
    assert CoveringRows(replace(problem, allowed=allowed)).columns == 3 * STEPS - 1


def test_the_most_accurate_plan_reads_every_sensor_that_costs_nothing():
    found = plan_samples(
        TWO, posed(3).requirement, search_seconds=2.0, certificate=False, robustness=False, from_start=False
    )
    assert found.schedule.outputs is None or np.all(found.schedule.outputs)
    assert found.gap <= 0.02
    assert found.verify()
    problem = pose_plan(TWO, found.requirement)
    covering, ends = CoveringRows(problem, fixed=True), [problem.ends(0)]
    discrete, ratio = discretize(problem), found.bound.ratio
    assert bound_holds(found.bound, covering, covering, discrete, ends, 3.0)
    higher = PlanBound(found.bound.trajectories, replace(ratio, level=ratio.level * 1.05), None)
    assert not bound_holds(higher, covering, covering, discrete, ends, 3.0)  # a level nobody showed to be out of reach
