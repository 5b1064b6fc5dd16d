"""A grid that has all the times of a coarser one, and more, makes no plan dearer and none less accurate."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.planning import plan as room
from sampling_design.planning import proven_choice
from sampling_design.planning.accuracy_oracle import AccuracyOracle
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.evidence import resimulated
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import coarser, lifted_trajectories
from sampling_design.planning.search import PlanSearch
from tests.cases import few

BARE = {"certificate": False, "robustness": False, "from_start": False}
OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"], outputs=["y"])
GIVEN = {"period": 6.4, "w_bound": 0.02, "sensors": {"y": {"noise_bound": 0.2}}}
HOURS = {"start": "2026-03-02", "zone": "UTC", "hours": {"Mon-Fri": [["08:00", "12:00"], ["14:00", "16:00"]]}}
TANK = sd.Plant([[0.0]], [[1.0]], time_unit="h", states=["level"], outputs=["gauge"])
WEEK = {"accuracy": {"level": 1.8}, "w_bound": 0.02, "sensors": {"gauge": {"noise_bound": 0.1}}, "calendar": HOURS}
REFINED = [
    (OSCILLATOR, {"accuracy": {"position": 0.35}, **GIVEN}, (0.8, 0.8 / 3), 0.05),  # no more than the coarser one needs
    (OSCILLATOR, {"accuracy": {"position": 0.35}, **GIVEN}, (0.8, 0.8 / 3), 0.02),
    (OSCILLATOR, {"accuracy": {"position": 0.35}, **GIVEN}, (0.4, 0.4 / 3), 0.2),
    (OSCILLATOR, {"accuracy": {"position": 0.35}, **GIVEN}, (0.8, 0.8 / 3), 0.1),
    (OSCILLATOR, {"accuracy": {"position": 0.35}, **GIVEN}, (0.4, 0.1, 0.4 / 12), 4),
    (TANK, WEEK, ("1 h", "15 min", "5 min"), 2),
    (TANK, WEEK, ("1 h", "15 min", "1 min"), 8),
]


@pytest.fixture
def looked_at(monkeypatch):
    """Grids of a few steps have coarser ones that are looked at first, as those of many have."""
    monkeypatch.setattr("sampling_design.planning.proven_choice.COARSE", 8)


@pytest.mark.usefixtures("looked_at")
@pytest.mark.long
@pytest.mark.parametrize(("plant", "wanted", "grids", "seconds"), REFINED)
def test_a_finer_grid_is_never_worse(plant, wanted, grids, seconds):
    found = [
        sd.plan_samples(plant, sd.PlanRequirement(grid=grid, **wanted), search_seconds=seconds, **BARE)
        for grid in grids
    ]
    assert all(each.keeps and each.verify() for each in found)
    costs = [each.cost for each in found]
    assert costs == sorted(costs, reverse=True)


@pytest.mark.usefixtures("looked_at")
def test_a_search_that_finds_nothing_by_itself_ends_with_what_the_coarser_grid_has(monkeypatch):
    """The coarser grid's own search is the same however fine this one is."""
    found, late = [], PlanSearch.late
    monkeypatch.setattr(PlanSearch, "late", property(lambda own: own.problem.steps == 24 or late.fget(own)))
    for steps in (8, 24):
        wanted = sd.PlanRequirement({"position": 0.35}, grid=6.4 / steps, **GIVEN)
        run = room._Planning(pose_plan(OSCILLATOR, wanted), 0.1, None)
        best = run.sought()
        found.append((np.flatnonzero(best.chosen.any(axis=1)) / steps, best.worst))
    assert len(found[0][0]) == 4
    np.testing.assert_array_equal(found[0][0], found[1][0])
    assert found[0][1] == pytest.approx(found[1][1], rel=1e-9)


@pytest.mark.usefixtures("looked_at")
@pytest.mark.parametrize(("more", "cut"), few([(1.0, False), (0.0, True)], 0))
def test_what_a_coarser_grid_proves_is_not_proven_again(more, cut, monkeypatch):
    """Its times are the same times: so a proof that was cut there is no worse here."""
    asked, prove = [], proven_choice.proven_of

    def proving(problem, chosen, work):
        found = prove(problem, chosen, work)
        asked.append((problem.steps, (np.flatnonzero(chosen.any(axis=1)) * (24 // problem.steps)).tolist(), found.cut))
        return found

    monkeypatch.setattr(proven_choice, "proven_of", proving)
    monkeypatch.setattr(room, "AFTER", ((0.0, more), *room.AFTER[1:]))
    wanted = sd.PlanRequirement({"position": 0.35}, grid=6.4 / 24, **GIVEN)
    best = room._Planning(pose_plan(OSCILLATOR, wanted), 0.05, None).sought()
    assert len(asked) == len({tuple(times) for _, times, _ in asked}) > 1
    assert any(was for steps, _, was in asked if steps == 8) == cut
    assert best.worst <= 1


def block(rng, kind, size):
    """A part of a plant: an oscillator, integrators, or what grows or decays slowly."""
    if kind == "oscillator":
        rate, damping = rng.uniform(0.4, 1.6), rng.choice([0.0, 0.0, rng.uniform(-0.2, 0.05)])
        return np.array([[damping, rate], [-rate, damping]])
    rates = {"integrator": 0.0, "slow": -rng.uniform(0.05, 0.5), "growing": rng.uniform(0.02, 0.15)}
    return rates[kind] * np.eye(size) + np.eye(size, k=1)


def random_plan(seed, coarse):
    """A plant of one to four states, and what is asked of it but for the grid.

    Tolerances are 1.15 to 2.5 times what all steps of a coarse grid leave; every other seed has prices.
    """
    rng = np.random.default_rng([77, seed])
    n = int(rng.integers(1, 5))
    A, at = np.zeros((n, n)), 0
    while at < n:
        kind, size = str(rng.choice(["oscillator", "integrator", "slow", "growing"])), int(rng.integers(1, 3))
        part = block(rng, kind if n - at > 1 or kind != "oscillator" else "slow", min(size, n - at))
        A[at : at + len(part), at : at + len(part)] = part
        at += len(part)
    turn = np.linalg.qr(rng.standard_normal((n, n)))[0]
    plant = sd.Plant(turn @ A @ turn.T, rng.standard_normal((int(rng.integers(1, 3)) if n > 1 else 1, n)))
    sensors = {
        name: {"noise_bound": rng.uniform(0.05, 0.3), **({"price": float(rng.integers(1, 4))} if seed % 2 else {})}
        for name in plant.outputs.names
    }
    given = {"period": rng.uniform(4.0, 8.0), "w_bound": 0.02, "sensors": sensors}
    goals, slack = (
        rng.choice(plant.states.names, min(n, int(rng.integers(1, 3))), replace=False),
        rng.uniform(1.15, 2.5),
    )
    left = {}
    for goal in goals.tolist():
        problem = pose_plan(plant, sd.PlanRequirement({goal: 1.0}, grid=given["period"] / coarse, **given))
        left[goal] = AccuracyOracle(problem, discretize(problem)).judge(problem.allowed, longest=True)[0] * slack
    return plant, {"accuracy": left, **given}


SEARCHES = [(seed, *more) for more in ((None, 0.02, 8), (None, 0.3, 16), (3, 0.02, 8)) for seed in range(12)]


@pytest.mark.long
@pytest.mark.usefixtures("looked_at")
@pytest.mark.parametrize(("seed", "samples", "seconds", "steps"), SEARCHES)
def test_a_search_on_a_finer_grid_knows_what_that_on_the_coarser_one_ends_with(seed, samples, seconds, steps):
    """Cost, or ratio, is as low for three times as many steps, also where it was given next to nothing."""
    plant, asked = random_plan(seed, steps)
    found = []
    for count in (steps, 3 * steps):
        wanted = sd.PlanRequirement(grid=asked["period"] / count, samples=samples, **asked)
        run = room._Planning(pose_plan(plant, wanted), seconds, None)
        best = run.sought()
        found.append(run.problem.cost(best.chosen) if samples is None and best.worst <= 1 else best.worst)
    assert found[1] <= found[0] * (1 + 1e-9)


@pytest.mark.long
@pytest.mark.usefixtures("looked_at")
def test_the_most_accurate_plan_is_as_good_as_those_it_starts_from():
    wanted = sd.PlanRequirement({"position": 0.35}, samples=3, grid=0.8 / 3, **GIVEN)
    run = room._Planning(pose_plan(OSCILLATOR, wanted), 0.3, None)
    starts = run.started()
    assert starts
    assert all(not start[np.arange(24) % 3 > 0].any() for start in starts)
    best = min(run.feasible.proven(start).worst for start in starts)
    assert sd.plan_samples(OSCILLATOR, wanted, search_seconds=0.3, **BARE).ratio <= best * (1 + 1e-9)


@pytest.mark.usefixtures("looked_at")
def test_what_refutes_choices_on_a_coarser_grid_does_on_the_finer_one():
    """Lifted attacks reach what they did, are proven anew by the same bounds, and show no less between the steps."""
    for accuracy in ({"position": 0.35}, {"position": {"tolerance": 0.2, "kind": "standard deviation"}}):
        terms = {"y": {"noise_bound": 0.2, "noise_deviation": 0.2}}
        wanted = sd.PlanRequirement(accuracy, grid=0.8 / 3, w_intensity=0.01, **{**GIVEN, "sensors": terms})
        run = room._Planning(pose_plan(OSCILLATOR, wanted), 1.0, None)
        coarse = room._Planning(coarser(run.problem), 1.0, None)
        coarse._cheapest()
        attacks = coarse.search.pool.trajectories
        lifted = lifted_trajectories(run.oracle, coarse.discrete, attacks)
        assert len(lifted) == len(attacks) > 0
        for one, other in zip(attacks, lifted, strict=True):
            if one.response is not None:
                assert other.reach == pytest.approx(one.reach, rel=1e-6)
                assert other.end == 3 * one.end
                assert np.all(other.peaks[::3] >= one.peaks * (1 - 1e-6) - 1e-9)
                again = resimulated(run.problem, run.discrete, other)
                assert again.reach == pytest.approx(other.reach, rel=1e-5)


LADDERS = [("1 min", (3360, 840, 168)), ("5 min", (672, 168)), ("1 h", ())]


@pytest.mark.parametrize(("grid", "steps"), LADDERS)
def test_coarser_grids_are_those_of_whole_hours_and_days(grid, steps):
    always = {**WEEK, "calendar": {"start": "2026-03-02", "zone": "UTC"}}
    problem, found = pose_plan(TANK, sd.PlanRequirement(grid=grid, **always)), []
    while (problem := coarser(problem)) is not None:
        found.append(problem.steps)
        assert problem.period == pytest.approx(168, rel=1e-12)
    assert tuple(found) == steps


def test_a_grid_that_times_of_a_goal_fall_between_is_not_looked_at():
    goals = {"position": {"tolerance": 0.4, "at": [0.05]}}
    problem = pose_plan(OSCILLATOR, sd.PlanRequirement(goals, grid=0.025, **GIVEN))
    assert problem.steps == 256
    assert coarser(problem) is None
    assert np.array_equal(problem.goals[0].steps, [2])
