"""Goals that are standard deviations: planned, bounded by tangents, kept when samples are late, saved and refused."""

import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, FileFormatError, InfeasibleRequirementError, NotDetectableError
from sampling_design.planning import filter_deviation, sequence_deviation
from sampling_design.planning import search as plan_search
from sampling_design.planning.accuracy_oracle import AccuracyOracle, detecting_measurements, narrowed
from sampling_design.planning.bounds import CostProver
from sampling_design.planning.covering import CoveringRows
from sampling_design.planning.discrete_plant import discretize
from sampling_design.planning.disturbed import plan_robustness
from sampling_design.planning.evidence import (
    EASED,
    PlanBound,
    gathered,
    open_choices,
    resimulated,
    trajectory_of,
    trajectory_to_dict,
)
from sampling_design.planning.files import read_plan
from sampling_design.planning.filter_deviation import GridFilter, reached_first
from sampling_design.planning.plan_record import deviation_of, without_limits
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import accuracy_of, proven_plan
from sampling_design.planning.search import PlanSearch
from tests.cases import few
from tests.oracles import planning as oracle

OSCILLATOR = sd.Plant(
    [[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]], states=["position", "velocity"], outputs=["y", "rate"]
)
TERMS = {"y": {"noise_deviation": 0.2}, "rate": {"noise_deviation": 0.3, "price": 0.0}}
GIVEN = {"period": 6.4, "grid": 0.8, "w_intensity": [0.01, 0.02]}
ONE = {**GIVEN, "sensors": {"y": TERMS["y"]}}


def goal(tolerance, **more):
    return {"tolerance": tolerance, "kind": "standard deviation", **more}


def truth(times, seen, row, period=6.4, just_before=2e-3):
    """The worst just before each sample and on the grid, by the plain filter."""
    at = np.unique(np.concatenate([np.arange(0.0, period, 0.2), np.mod(np.asarray(times) - just_before, period)]))
    plant = OSCILLATOR
    return oracle.deviation(plant.A, plant.C, np.eye(2), times, seen, period, row, at, [0.01, 0.02], [0.2, 0.3]).max()


@pytest.fixture(scope="module")
def found():
    wanted = sd.PlanRequirement({"position": goal(0.29)}, **{**ONE, "grid": 1.6})
    return sd.plan_samples(OSCILLATOR, wanted, certificate=False)


def every(count, steps):
    """All choices of so many samples of the first sensor, one of them at step 0."""
    return [(0, *rest) for rest in combinations(range(1, steps), count - 1)]


def best_of_all(count, steps):
    choices = np.array(every(count, steps)) * 6.4 / steps
    return min(truth(at, [[True, False]] * count, [1.0, 0.0]) for at in choices)


@pytest.mark.long
def test_the_cheapest_plan_is_that_of_a_search_through_all_choices(found):
    count = next(k for k in range(1, 5) if best_of_all(k, 4) <= 0.29)
    assert found.samples == count == found.bound.cost.value
    assert found.status == "complete"
    assert found.verify()
    anew = truth(found.schedule.times, [[True, False]] * found.samples, [1.0, 0.0])
    assert anew <= found.reached[0] <= anew * 1.02  # the oracle looks every 0.2 s
    ((name, reached, again),) = oracle.deviations(found.to_dict())
    assert (name, reached) == ("position", found.reached[0])
    assert again <= reached <= again * 1.01


def test_the_filter_of_uneven_samples_is_that_of_the_plan():
    """Its covariance after each sample, and a sequence that is the plan's own, which nothing makes worse."""
    problem = pose_plan(OSCILLATOR, sd.PlanRequirement({"position": goal(1.0)}, **ONE))
    chosen = np.zeros_like(problem.allowed)
    chosen[[0, 1, 5], 0] = True
    plan = proven_plan(problem, chosen, PlanBound((), None, None), "budget")
    limits = sequence_deviation.SequenceFilter(plan).limits
    row = plan.oracle.rows[0]
    times = plan.schedule.times
    anew = oracle.deviation(
        OSCILLATOR.A, OSCILLATOR.C[:1], np.eye(2), times, [[True]] * 3, 6.4, [1.0, 0.0], times, [0.01, 0.02], [0.2]
    )
    np.testing.assert_allclose([np.sqrt(row @ P @ row) for P in limits], anew, rtol=1e-6)
    own, seen = sequence_deviation.planned(plan, -6.4, 10 * 6.4)
    _, wider = sequence_deviation.SequenceFilter(plan).worst(sequence_deviation.SampleSequence(own, seen, 3))
    assert wider == pytest.approx(1.0, abs=1e-6)


@pytest.mark.long
def test_a_plan_has_one_filter_that_works_out_each_flow_once(found, monkeypatch):
    asked, flow = [], sequence_deviation.discounted_flow
    monkeypatch.setattr(
        sequence_deviation, "discounted_flow", lambda A, W, lengths: asked.append(tuple(lengths)) or flow(A, W, lengths)
    )
    plan = replace(found)  # a plan that has no filter yet
    bears = plan_robustness(plan)
    np.testing.assert_allclose(bears.late, found.robustness.late)
    np.testing.assert_allclose(bears.lost_ratio, found.robustness.lost_ratio, rtol=1e-12)
    assert 0 < len(asked) == len({tuple(np.round(lengths, 6)) for lengths in asked})


@pytest.mark.long
def test_the_best_of_so_many_is_within_its_gap_of_all_choices():
    most = sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": goal(1.0)}, samples=3, **ONE), certificate=False)
    best = best_of_all(3, 8)
    assert most.bound.ratio.level <= best * (1 + 1e-9)
    assert most.reached[0] <= best * 1.02
    assert most.gap <= 0.1
    assert most.verify()


def test_a_tangent_lies_below_every_choice_and_touches_where_it_was_laid():
    problem = pose_plan(
        OSCILLATOR, sd.PlanRequirement({"position": goal(1.0), "velocity": goal(1.0)}, sensors=TERMS, **GIVEN)
    )
    spread = GridFilter(problem, discretize(problem))
    rng = np.random.default_rng(5)
    for g in (0, 1):
        z = rng.uniform(size=problem.allowed.shape) * (rng.uniform(size=problem.allowed.shape) < 0.5)
        tangent = spread.tangent(z, g)
        for _ in range(12):
            chosen = rng.uniform(size=z.shape) < rng.uniform(0.2, 0.9)
            before, _ = spread.variances(chosen[None])
            back = (tangent.end - np.arange(problem.steps)) % problem.steps
            line = tangent.reach**2 - float(np.sum(tangent.peaks * chosen[back]))
            assert line <= before[0, g, tangent.end] * (1 + 1e-9)
        step, inside = 1e-5, z > 0
        more = np.where(inside, z + step * rng.uniform(size=z.shape), z)
        rise = spread.tangent_at(more, g, tangent.end)
        value = [t.reach**2 - float(np.sum(t.peaks * t.point)) for t in (tangent, rise)]
        slope = float(np.sum(tangent.peaks * (rise.point - tangent.point)))
        assert value[1] - value[0] == pytest.approx(-slope, rel=1e-3)


def test_a_tangent_at_a_choice_asks_for_what_that_leaves_out_alone_and_stays_below_every_choice():
    problem = pose_plan(OSCILLATOR, sd.PlanRequirement({"velocity": goal(0.25)}, sensors=TERMS, **GIVEN))
    oracle, rng = AccuracyOracle(problem, discretize(problem)), np.random.default_rng(3)
    chosen = np.zeros_like(problem.allowed)
    chosen[[0, 4], 0] = True
    worst, (tangent,) = oracle.judge(chosen)
    assert worst * (1 - 1e-3) <= tangent.reach <= worst
    assert not np.any(tangent.peaks[tangent.touches == 1])
    level = 1.0
    found = narrowed(oracle, tangent, level)
    assert level < found.reach < tangent.reach
    shown = detecting_measurements(oracle, found, level)
    assert np.all(found.weights(level)[found.peaks > 0] == 1)
    assert 0 < shown.sum() < detecting_measurements(oracle, tangent, level).sum()
    assert not np.any(shown & chosen)
    assert oracle.grid_filter.variances(~shown[None])[0][0, 0, found.end] > (0.25 * level) ** 2  # without all of these
    back = (found.end - np.arange(problem.steps)) % problem.steps
    others = np.argwhere(shown)
    assert len(others) > 1
    for k in others:  # and each of these mends it
        more = ~shown
        more[tuple(k)] = True
        assert oracle.grid_filter.variances(more[None])[0][0, 0, found.end] <= (0.25 * level) ** 2
    for drawn in (rng.random((20, *chosen.shape)) < 0.5) & (rng.random((20, 1, 1)) < 0.7):
        line = found.reach**2 - float(np.sum(found.peaks * drawn[back]))
        assert line <= oracle.grid_filter.variances(drawn[None])[0][0, 0, found.end] / 0.25**2 * (1 + 1e-9)


def test_a_tangent_at_a_choice_is_worked_out_anew_from_its_file():
    problem = pose_plan(OSCILLATOR, sd.PlanRequirement({"velocity": goal(0.25)}, sensors=TERMS, **GIVEN))
    discrete = discretize(problem)
    chosen = np.zeros_like(problem.allowed)
    chosen[[0, 4], 0] = True
    (tangent,) = AccuracyOracle(problem, discrete).judge(chosen)[1]
    whole = GridFilter(problem, discrete).tangent_at(chosen.astype(float), 0, tangent.end)
    for each in (tangent, whole):
        again = resimulated(problem, discrete, trajectory_of(problem, discrete, trajectory_to_dict(each)))
        assert again.reach == pytest.approx(each.reach, rel=1e-6)
        np.testing.assert_allclose(again.peaks, each.peaks, rtol=1e-9, atol=1e-12)
    raised = replace(tangent, reach=(tangent.reach + whole.reach) / 2)
    assert resimulated(problem, discrete, raised).reach == pytest.approx(whole.reach, rel=1e-6)


def test_a_goal_at_given_times_has_its_tangent_there():
    wanted = sd.PlanRequirement({"position": goal(1.0, at=[2.4, 4.8])}, sensors=TERMS, **GIVEN)
    problem = pose_plan(OSCILLATOR, wanted)
    spread = GridFilter(problem, discretize(problem))
    z = problem.allowed & (np.arange(problem.steps) < 4)[:, None]
    before, _ = spread.variances(z[None])
    assert before[0, 0, 3] < before[0, 0, 6] < before[0, 0].max()  # times at which nothing is wanted are worse
    assert spread.tangent(z.astype(float), 0).end == 6


def test_late_and_lost_samples_are_as_the_plain_filter_has_them(found):
    bears = found.robustness
    worst = int(np.argmax(bears.lost_ratio))
    periods = 12
    times = np.concatenate([found.schedule.times + 6.4 * k for k in range(periods)])
    keep = np.ones(times.size, dtype=bool)
    keep[(periods - 2) * found.samples + worst] = False
    anew = truth(times[keep], [[True, False]] * int(keep.sum()), [1.0, 0.0], 6.4 * periods)
    assert anew <= bears.lost_ratio[worst] * 0.29 <= anew * 1.03


def test_the_next_sample_keeps_the_deviation_for_ever(found):
    answer = sd.next_sample(found)
    assert answer.proven
    later = found.schedule.times[found.schedule.times > answer.latest + 1e-9]
    periods = [found.schedule.times + 6.4 * k for k in range(1, 12)]
    times = np.concatenate([[0.0] if found.schedule.times[0] == 0 else [], [answer.latest], later, *periods])
    times = np.unique(np.round(times, 9))
    assert truth(times, [[True, False]] * times.size, [1.0, 0.0], 6.4 * 12) <= 0.29 * (1 + 1e-6)


@pytest.mark.long
def test_both_kinds_are_planned_together():
    wanted = sd.PlanRequirement(
        {"position": 0.8, "velocity": goal(0.6, at="after each sample")},
        w_bound=0.02,
        **{**ONE, "sensors": {"y": {"noise_bound": 0.4, "noise_deviation": 0.2}}},
    )
    both = sd.plan_samples(
        OSCILLATOR, wanted, certificate=False, robustness=False, from_start=False, search_seconds=0.3
    )
    assert both.keeps
    assert both.verify()
    assert both.accuracy is not None
    assert both.deviation is not None


def bounded_by_tangents(found):
    """A plan whose least cost is proven by tangents, as where choices are too many to be judged one by one."""
    problem = found.problem
    search = PlanSearch(problem, AccuracyOracle(problem, discretize(problem)))
    search.sharpen(1 / EASED**2, found.cost)
    covering = CoveringRows(without_limits(problem), fixed=problem.is_free)
    proof = CostProver(covering, search.pool, search.oracle.work, search.find).least_cost(1 / EASED**2, found.cost)
    return replace(found, bound=gathered(search.pool, None, proof))


def test_files_hold_tangents_and_are_not_believed(found, tmp_path):
    found = bounded_by_tangents(found)
    assert found.bound.trajectories
    path = found.save(tmp_path / "plan.json")
    again = read_plan(path)
    assert again.verify()
    assert again.bound.cost.value == found.bound.cost.value
    tree = json.loads(path.read_text())
    for change, words in (
        ({"point": [[99, 0, 0.5]]}, "touches beside the grid"),
        ({"knots": [0]}, "must be a trajectory .* or a tangent"),
        ({"goal": 7}, "must be a trajectory .* of a goal"),
    ):
        path.write_text(
            json.dumps(
                {
                    **tree,
                    "trajectories": [
                        {**tree["trajectories"][0], **change},
                        *tree["trajectories"][1:],
                    ],
                }
            )
        )
        with pytest.raises(FileFormatError, match=words):
            read_plan(path)
    raised = tuple(replace(a, reach=a.reach * 1.01) for a in found.bound.trajectories)
    assert not replace(found, bound=PlanBound(raised, found.bound.ratio, found.bound.cost)).verify()
    assert not replace(found, reached=found.reached * 0.99).verify()


def worst_of_quarters(problem, chosen):
    """The worst just before quarters of the grid's steps, by the plain filter."""
    (steps,), given = np.nonzero(chosen.any(axis=1)), problem.requirement
    before = np.mod(np.arange(4 * problem.steps) * problem.step / 4 - 2e-3, problem.period)
    row, w, (A, C) = problem.goals[0].row, np.broadcast_to(given.w_intensity, 2), (OSCILLATOR.A, OSCILLATOR.C)
    noise, at = problem.v_deviation, steps * problem.step
    return oracle.deviation(A, C, np.eye(2), at, chosen[steps], problem.period, row, before, w, noise).max()


HOURS = {"Mon-Sun": [["07:00", "19:00"]]}


@pytest.mark.parametrize("more", [{}, {"calendar": {"start": "2026-03-23", "zone": "UTC", "hours": HOURS}}])
def test_choices_that_are_judged_one_by_one_are_those_of_the_plain_filter(more, monkeypatch):
    plant = OSCILLATOR if not more else replace(OSCILLATOR, time_unit="h")
    asked = {**ONE, "sensors": TERMS} if not more else {**ONE, "period": 48.0, "grid": 4.0}
    problem = pose_plan(plant, sd.PlanRequirement({"position": goal(0.3)}, **asked, **more))
    covering, grid_filter = CoveringRows(problem, fixed=problem.is_free), GridFilter(problem, discretize(problem))
    below, worst = 2.5 * covering.cost.max(), {}
    for pair in combinations(covering.at.tolist(), 2):
        if pair[0] < covering.repeats_after:
            chosen = np.zeros_like(problem.allowed)
            chosen[list(pair)] = problem.allowed[list(pair)]
            worst[pair] = worst_of_quarters(problem, chosen) / 0.3
    values = np.unique(np.round(list(worst.values()), 6))
    for level in [values[0] / 2, *np.sqrt(values[1:] * values[:-1])[::3], values[-1] * 2]:
        kept = open_choices(covering, grid_filter, level, below)
        turns = [np.nonzero(np.roll(each, s, axis=0).any(axis=1)) for each in kept for s in range(problem.steps)]
        found = {tuple(steps.tolist()) for (steps,) in turns}
        assert {pair for pair, value in worst.items() if value < level} == found & set(worst)
        assert all(np.array_equal(each, each.any(axis=1)[:, None] & problem.allowed) for each in kept)
    assert len(kept) > 1
    monkeypatch.setattr("sampling_design.planning.evidence.MOST_CHOICES", len(kept) - 1)
    assert open_choices(covering, grid_filter, level, below) is None


def test_what_costs_less_is_judged_choice_by_choice_and_a_forged_cost_is_not_believed(found, tmp_path):
    proof = found.bound.cost
    assert (proof.judged, proof.value) == (True, found.cost)
    assert "At a lower cost, disturbances that no sample shows take position" in found.explain()
    path = found.save(tmp_path / "plan.json")
    tree = json.loads(path.read_text())
    assert tree["no_cheaper_than"]["tree"] == []
    tree["no_cheaper_than"]["value"] += 1.0
    path.write_text(json.dumps(tree))
    assert not read_plan(path).verify()
    tree["no_cheaper_than"]["level"] = 0.5  # those of that cost that keep the tolerances are above half of them
    path.write_text(json.dumps(tree))
    assert not read_plan(path).verify()
    for level in (proof.level, 0.5):  # what is proven of the cost proves no ratio: as many samples reach more
        ratio = replace(proof, level=level, value=found.cost)
        assert not replace(found, bound=replace(found.bound, ratio=ratio)).verify()


def test_what_is_missing_or_out_of_reach_is_said():
    with pytest.raises(ArgumentError, match="`w_intensity` is missing: accuracy of position needs it"):
        sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": goal(0.3)}, period=6.4, sensors=TERMS))
    with pytest.raises(ArgumentError, match="have no `noise_deviation`"):
        sd.plan_samples(
            OSCILLATOR, sd.PlanRequirement({"position": goal(0.3)}, **{**ONE, "sensors": {"y": {"noise_bound": 1.0}}})
        )
    with pytest.raises(ArgumentError, match="`w_intensity` must not be negative"):
        sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": goal(0.3)}, **{**ONE, "w_intensity": [0.1, -1.0]}))
    with pytest.raises(ArgumentError, match='`kind` must be "guaranteed" or "standard deviation"'):
        sd.PlanRequirement({"position": {"tolerance": 1.0, "kind": "likely"}})
    with pytest.raises(InfeasibleRequirementError, match="Not even measuring at every allowed time keeps"):
        sd.plan_samples(OSCILLATOR, sd.PlanRequirement({"position": goal(0.05)}, **ONE))


def test_choices_that_say_nothing_of_a_goal_are_refused():
    mixed = {"y": {"noise_bound": 0.2}, "rate": {"noise_deviation": 0.3}}
    wanted = sd.PlanRequirement({"position": 0.8, "velocity": goal(0.6)}, w_bound=0.02, sensors=mixed, **GIVEN)
    problem = pose_plan(OSCILLATOR, wanted)
    for sensor, judge, words in ((0, deviation_of, "`noise_deviation`"), (1, accuracy_of, "`noise_bound`")):
        with pytest.raises(NotDetectableError, match=f"reads no sensor that has a {words}"):
            judge(problem, np.arange(2) == np.full((8, 1), sensor))
    closed = {"y": {"noise_deviation": 0.2, "hours": {"Mon": [["08:00", "08:01"]]}}}
    hourly = {"period": 7 * 86400.0, "grid": 3600.0, "w_intensity": 1.0}
    hours = {"start": "2026-03-03", "hours": {"Tue": [["08:00", "10:00"]]}}
    with pytest.raises(InfeasibleRequirementError, match="No sensor that may be measured has a"):
        pose_plan(OSCILLATOR, sd.PlanRequirement({"position": goal(0.8)}, sensors=closed, calendar=hours, **hourly))


@pytest.mark.parametrize("seed", [1, 2])
def test_what_nothing_drives_has_no_bound_above_what_is_reached(seed):
    """In coordinates that mix a mode with others rounding drives it: of what is known exactly no ratio is proven."""
    T = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    A = np.array([[0.0, 3.25, 0.0], [-3.25, 0.0, 0.0], [0.0, 0.0, -1.46]])
    G = np.array([[0.68, 0.79, -0.42], [0.33, 0.45, 1.65], [0.0, 0.0, 0.0]])
    plant = sd.Plant(T @ A @ T.T, [[0.46, -1.68, 0.14]] @ T.T, G=T @ G)
    asked = {"fading": goal(0.9, row=T[:, 2], at="after each sample")}
    terms = {"y1": {"noise_deviation": 0.05}}
    wanted = sd.PlanRequirement(asked, period=1.0, grid=0.25, w_intensity=0.01, sensors=terms)
    plan = sd.plan_samples(plant, wanted, search_seconds=0.05, certificate=False, robustness=False, from_start=False)
    assert plan.ratio == 0.0
    assert plan.bound.ratio is None
    assert "0 of the tolerances" in str(plan)


def test_the_search_ends_where_a_growing_state_that_nothing_drives_refutes_choices():
    G = [[0.0, 0.0], [-2.4e-5, -1.56e-5]]
    plant = sd.Plant(np.diag([0.786, 0.227]), [[2.08, -1.34e5], [0.125, 0.544e5]], G=G)
    terms = {"y1": {"noise_deviation": 0.1, "price": 3.0}, "y2": {"noise_deviation": 0.3, "price": 0.0}}
    asked = {"x1": goal(6.1, at="after each sample"), "x2": goal(3.9e-5, at="after each sample")}
    wanted = sd.PlanRequirement(asked, period=3.0, grid=0.5, w_intensity=0.01, sensors=terms, visit_price=2.0)
    problem = pose_plan(plant, wanted)
    search = PlanSearch(problem, AccuracyOracle(problem, discretize(problem)))
    twice = np.zeros((6, 2), dtype=bool)
    twice[[0, 3], 1] = True
    chosen, none = search._one_by_one(1.0, 5.0)
    assert np.array_equal(chosen, twice)
    assert not none
    assert search._one_by_one(1.0, problem.cost(twice)) == (None, True)  # one sample, which leaves 1.14 of a tolerance


def test_a_bound_is_the_same_in_any_unit_where_nothing_drives_a_growing_state():
    A, G = np.diag([0.7856008, 0.22671526]), np.array([[0.0, 0.0], [-2.40019087, -1.55657975]])
    C, found = np.array([[2.08124873, -1.33726808], [0.12535155, 0.54422123]]), []
    units = (1.0, [1.0, 1.0], [1.0, 1.0]), (1e8, [1.0, 1e-5], [1e3, 1e-8])
    for hour, x, y in (*units, (1e-6, [1e9, 1e9], [1e-9, 1.0])):
        x, y = np.array(x), np.array(y)
        plant = sd.Plant(A * x[:, None] / x / hour, C * y[:, None] / x, G=G * x[:, None] / hour)
        asked = {f"x{i + 1}": goal(e * x[i], at="after each sample") for i, e in enumerate((6.0944, 3.91249))}
        terms = {
            f"y{j + 1}": {"noise_deviation": e * y[j], "price": c} for j, (e, c) in enumerate(((0.1, 3.0), (0.3, 0.0)))
        }
        wanted = sd.PlanRequirement(
            asked, period=3 * hour, grid=0.5 * hour, w_intensity=0.01 * hour, sensors=terms, visit_price=2.0
        )
        plan = sd.plan_samples(plant, wanted, search_seconds=0.1, certificate=False, robustness=False, from_start=False)
        found.append((plan.cost, plan.bound.cost.value, round(plan.bound.ratio.level, 4)))
    assert found == found[:1] * 3


def test_what_noise_reaches_comes_first():
    rng, sizes = np.random.default_rng(0), set()
    for _ in range(60):
        n = int(rng.integers(1, 6))
        r = int(rng.integers(0, n + 1))
        A, N, T = rng.standard_normal((n, n)), rng.standard_normal((n, 2)), np.linalg.qr(rng.standard_normal((n, n)))[0]
        A[r:, :r], N[r:] = 0.0, 0.0
        V, found = reached_first(T @ A @ T.T, T @ N)
        assert found == r
        assert np.allclose(V.T @ V, np.eye(n), rtol=0, atol=1e-12)
        assert (V.T @ T @ A @ T.T @ V)[r:, :r] == pytest.approx(np.zeros((n - r, r)), abs=1e-9)
        assert (V.T @ T @ N)[r:] == pytest.approx(np.zeros((n - r, 2)), abs=1e-9)
        sizes.add(n - r)
    assert {0, 1, 2} <= sizes


@pytest.mark.parametrize("seed", few(range(8), 0, 3))
def test_from_sample_to_sample_variances_are_those_step_by_step(seed, monkeypatch):
    """Of modes that grow where nothing shows them, too, and of choices with more and with fewer samples."""
    rng, steps = np.random.default_rng(seed), 24
    A, C = rng.standard_normal((3, 3)), rng.standard_normal((2, 3))
    A -= (float(np.linalg.eigvals(A).real.max()) - rng.uniform(-0.2, 0.2)) * np.eye(3)
    C[0] *= seed % 2  # a sensor that shows nothing
    sensors = {f"y{j}": {"noise_deviation": 0.1} for j in (1, 2)}
    tolerances = {f"x{i}": {"tolerance": 1.0, "kind": "standard deviation"} for i in (1, 2, 3)}
    asked = sd.PlanRequirement(tolerances, period=4.8, grid=0.2, w_intensity=0.1, sensors=sensors)
    problem = pose_plan(sd.Plant(A, C), asked)
    chosen = np.zeros((12, steps, 2), dtype=bool)
    for choice in chosen[:-1]:
        choice[rng.choice(steps, 1 + rng.integers(5), replace=False)] = rng.random(2) < [0.9, 0.6]
    found = []
    for sparse in (filter_deviation.SPARSE, steps + 1):
        monkeypatch.setattr(filter_deviation, "SPARSE", sparse)
        grid_filter = GridFilter(problem, discretize(problem))
        found.append((*grid_filter.variances(chosen), grid_filter.work.spent))
    (before, after, quick), (plain_before, plain_after, slow) = found
    np.testing.assert_allclose(before, plain_before, rtol=1e-7)
    np.testing.assert_allclose(after, plain_after, rtol=1e-7)
    assert quick < slow


def test_what_is_too_much_to_be_judged_one_by_one_is_gone_through_once(found, monkeypatch):
    """More choices are open at a larger level, and below a larger cost; fewer at smaller ones, which are asked anew."""
    search, asked = PlanSearch(found.problem, AccuracyOracle(found.problem, discretize(found.problem))), []
    monkeypatch.setattr(plan_search, "open_choices", lambda *of: asked.append(of[2:]))
    for level, below in ((1.0, 5.0), (1.0, 5.0), (1.2, 6.0), (0.9, 5.0), (1.0, 5.0), (1.0, 4.0)):
        assert search._one_by_one(level, below) is None
    assert asked == [(1.0, 5.0), (0.9, 5.0), (1.0, 4.0)]


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_what_grows_without_a_sample_takes_no_digit_of_what_is_known_after_one(angle):
    rates, noise, drive, step, M = np.array([2.0, -0.3]), np.array([0.1, 0.2]), np.array([0.1, 0.3]), 1.0, 9
    T = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    terms = {f"y{i + 1}": {"noise_deviation": float(s)} for i, s in enumerate(noise)}
    wanted = sd.PlanRequirement(
        {"x1": goal(1.0, at=[4.0, 8.0])}, period=M * step, grid=step, w_intensity=(drive**2).tolist(), sensors=terms
    )
    problem = pose_plan(sd.Plant(T @ np.diag(rates) @ T.T, T.T, G=T), wanted)
    chosen = np.zeros((M, 2), dtype=bool)
    chosen[1] = True

    def later(P, t):  # each mode has its sensor: two scalar recursions, without a difference
        return P * np.exp(2 * rates * t) + drive**2 * np.expm1(2 * rates * t) / (2 * rates)

    P = np.zeros(2)
    for _ in range(200):
        P = later(P, M * step)
        P = P * noise**2 / (P + noise**2)
    expected = [np.sqrt(T[0] ** 2 @ later(P, t)) for t in (3.0, 7.0)]
    assert GridFilter(problem, discretize(problem)).ratios(chosen[None])[0, 0, [4, 8]] == pytest.approx(expected, 1e-9)


@pytest.mark.parametrize("growth", few([5.0, 12.0, 16.0, 20.0, 33.0], 4))
def test_no_choice_is_refuted_that_keeps_its_level_whatever_grows(growth):
    """Covariances refuted plans from e^15 in a gap on that were ten times better than they had to be."""
    rng, M = np.random.default_rng(int(growth)), 8
    for n, p in ((2, 1), (2, 2), (3, 2), (3, 3)):
        A, C = rng.normal(size=(n, n)), rng.normal(size=(p, n))
        A *= growth / M / max(np.linalg.eigvals(A).real, key=abs)
        sensors = {f"y{j + 1}": {"noise_deviation": 10.0 ** rng.uniform(-3, 1)} for j in range(p)}
        goals = {f"x{i + 1}": goal(1.0) for i in range(n)}
        asked = sd.PlanRequirement(goals, period=8.0, grid=1.0, w_intensity=0.1, sensors=sensors)
        problem = pose_plan(sd.Plant(A, C), asked)
        grid_filter, every = GridFilter(problem, discretize(problem)), np.arange(M)
        for count in (1, 2, 3):
            at, read = np.sort(rng.choice(M, count, replace=False))[None], np.ones((1, count, p), dtype=bool)
            chosen = np.zeros((1, M, p), dtype=bool)
            chosen[0, at[0]] = True
            worst, gaps = float(grid_filter.worst(chosen).max()), np.diff(at[0], append=at[0, 0] + M)
            assert not grid_filter._beyond(at, read, worst * (1 + 1e-4), True)
            assert growth > 16 or grid_filter._beyond(at, read, worst * (1 - 1e-4), True)
            for g, reached in enumerate(np.sqrt(grid_filter.variances(chosen)[0][0])):
                at_most = replace(problem.goals[g], tolerance=float(reached.max()))
                of = GridFilter(replace(problem, goals=(at_most,)), discretize(problem))
                tangent = of.tangent(chosen[0].astype(float), 0)
                assert tangent is not None or growth > 20
                if tangent is not None:
                    gained = np.roll(tangent.peaks[::-1], (tangent.end + 1) % M, axis=0)[chosen[0]].sum()
                    assert tangent.reach**2 - gained == pytest.approx(1.0, abs=1e-4 if growth < 18 else 1.0)
                    assert tangent.reach**2 - gained < 1 + 1e-6
            best = grid_filter.measured(grid_filter.least, np.ones((M, p), dtype=bool))
            assert growth > 20 or np.all(grid_filter.lasting(every, best, worst * (1 + 1e-4)).max() >= gaps.max())


def test_a_tangent_that_overflows_says_nothing(found, monkeypatch):
    """Of states whose units are far apart rounding may leave covariances that are none."""
    M, grid_filter = found.problem.steps, GridFilter(found.problem, discretize(found.problem))
    lost = np.tile(1e100 * np.eye(2), (M, 1, 1))
    monkeypatch.setattr(grid_filter, "_periods", lambda *of: [(lost, lost)] * 2)
    assert grid_filter.tangent(np.ones(found.problem.allowed.shape), 0) is None


def test_a_plan_of_what_nothing_drives_reaches_nothing_and_is_read_back(tmp_path):
    level = sd.Plant([[-0.5]], [[1.0]], states=["level"], outputs=["y"])
    wanted = sd.PlanRequirement({"level": goal(1.0)}, period=4.0, grid=1.0, w_intensity=0.0, sensors={"y": TERMS["y"]})
    plan = sd.plan_samples(level, wanted)
    assert plan.reached.tolist() == [0.0]
    assert plan.robustness is not None
    assert read_plan(plan.save(tmp_path / "plan.json")).verify()
