"""A plan that is kept although samples come early or late."""

from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.planning import sequence, sequence_system
from sampling_design.planning.disturbed import plan_start, without
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.figures import accuracy_of
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from sampling_design.planning.requirement_file import plan_requirement_from_dict
from sampling_design.planning.sequence import proven_ratio
from sampling_design.records.budget import Budget, BudgetSpentError
from tests.accuracy.test_timing import apart_from_rest

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"], outputs=["fix"])
WANTED = sd.PlanRequirement(
    {"position": 0.54}, period=4.0, grid=0.5, w_bound=0.05, sensors={"fix": {"noise_bound": 0.2}}
)


def made(seconds=1.0, **changes):
    wanted = WANTED.replace(**changes)
    return sd.plan_samples(PLANT, wanted, search_seconds=seconds, certificate=False, robustness=False, from_start=False)


@pytest.fixture(scope="module")
def plan():
    return made(0.1, timing_tolerance=0.1, initial_error=0.5)


@pytest.fixture(scope="module")
def proven():
    """One that nothing was sought for."""
    return held(0.1)


@pytest.mark.long
def test_no_real_times_break_a_tolerance(plan):
    assert plan.keeps
    assert plan.verify()
    assert "for samples up to 0.1 s early or late" in plan.explain()
    assert ("samples come", "up to 0.1 s early or late") in plan._rows()
    rng = np.random.default_rng(2)
    for _ in range(1):
        schedule = plan.schedule
        times = (schedule.times + schedule.period * np.arange(1, 3)[:, None]).ravel()
        moved = times + 0.1 * rng.choice([-1.0, 1.0], times.size)
        real = sd.PeriodicSchedule.from_times(moved - moved[0], 8.0)
        attained = sd.guaranteed_accuracy(PLANT, real, w_bound=0.05, v_bound=0.2, of=["position"], rtol=0.02)
        assert attained.lower[0] <= plan.reached[0] <= 0.54


@pytest.mark.long
def test_samples_on_time_alone_would_not_be_enough(plan):
    exact = made()
    assert exact.samples < plan.samples
    assert exact.bound.cost.value <= plan.samples
    late = sd.guaranteed_accuracy(
        PLANT, exact.schedule, w_bound=0.05, v_bound=0.2, of=["position"], timing_tolerance=0.2
    )
    assert late.lower[0] > 0.54  # the witness is at real times


def test_its_file_says_the_same(proven, tmp_path):
    found = sd.read_plan(proven.save(tmp_path / "plan.json"))
    assert found.requirement.timing_tolerance == 0.1
    assert np.allclose(found.reached, proven.reached, rtol=1e-6)
    assert found.verify()
    assert not replace(found, requirement=found.requirement.replace(timing_tolerance=0.21)).verify()


def attained(times, start, stop):
    """The largest error that a truth attains where samples come at these times, from one time to another."""
    schedule = sd.Schedule(times)
    found = sd.guaranteed_accuracy(
        PLANT, schedule, w_bound=0.05, v_bound=0.2, of=["position"], initial_error=0.5, start=0.0, end=stop, rtol=0.05
    )
    after = found.profile.edges[:-1] >= start
    return float(found.profile.lower[0][after].max())


def real_times(schedule, rng, late, stop):
    """Planned times before one, moved as far as they may be, or less."""
    times = (schedule.times + schedule.period * np.arange(4)[:, None]).ravel()
    times = times[times < stop]
    share = rng.choice([-1.0, 1.0], times.size) if rng.random() < 0.7 else rng.uniform(-1, 1, times.size)
    moved = times + late * share
    return np.where(times == 0, rng.uniform(0.01, 1.0) * late, moved)


@pytest.mark.long
def test_the_start_and_a_lost_sample_hold_at_all_real_times(plan):
    rng = np.random.default_rng(5)
    gaps, start = {}, plan_start(plan)
    proven_ratio(plan, without(plan, 1, 1), gaps)
    for lost, since, worst in ((None, start.from_time, start.ratio), (4, 4.0, max(gaps.values()))):
        assert np.isfinite([since, worst]).all()
        times = real_times(plan.schedule, rng, 0.1, 7.0)
        times = times if lost is None else np.delete(times, lost)
        assert attained(times, since if lost is None else since + 0.1, 7.0) <= worst * 0.54 * (1 + 1e-6)
    assert worst > 1.05  # what the lost one leaves is more


def test_noise_that_is_not_found_is_said(proven, monkeypatch):
    monkeypatch.setattr(sequence_system, "TURNS", 1)
    with pytest.raises(
        UndecidedError, match=r"nothing bounds what samples up to 0\.1 s early or late do where they are"
    ):
        sequence_system.sequence_system(proven, without(proven, 1, 1))
    assert np.isinf(proven_ratio(proven, without(proven, 1, 1)))


def test_the_noise_of_a_sequence_is_counted_as_work(proven, monkeypatch):
    work = Budget(0.05, counted=True)
    work.firm = True
    monkeypatch.setattr(proven.oracle, "work", work)
    with pytest.raises(BudgetSpentError, match="it does not fit into what is left"):
        sequence_system.sequence_system(proven, without(proven, 1, 1))


@pytest.mark.long
def test_what_is_said_of_the_next_sample_holds_at_all_real_times(plan):
    rng = np.random.default_rng(6)
    taken = real_times(plan.schedule, rng, 0.1, 3.0)
    found = sd.next_sample(plan, [(t, [0.0], None) for t in taken])
    assert found.proven
    assert found.latest > found.now
    for shift in (-0.1, 0.1):
        later = real_times(plan.schedule, rng, 0.1, 9.0)
        later = later[later > found.latest + 0.1]
        times = np.concatenate([taken, [found.latest + shift], later])
        assert attained(times, found.kept_from + 0.01, 9.0) <= found.ratio * 0.54 * (1 + 1e-6)


def test_samples_are_so_far_apart_that_they_keep_their_order():
    assert pose_plan(PLANT, WANTED.replace(timing_tolerance="200 ms")).spacing == 1
    assert pose_plan(PLANT, WANTED.replace(timing_tolerance="250 ms")).spacing == 2
    for said, early, spacing in ((("100 ms", "200 ms"), 0.1, 1), ((0.0, 0.2), 0.0, 1), ({"fix": [0.3, 0.2]}, 0.3, 2)):
        wanted = WANTED.replace(timing_tolerance=said)
        posed = pose_plan(PLANT, wanted)
        assert posed.timing_tolerance.early + posed.timing_tolerance.late == pytest.approx((early, 0.2))
        assert posed.spacing == spacing
        assert plan_requirement_from_dict(wanted.to_dict()).to_dict() == wanted.to_dict()
    with pytest.raises(ArgumentError, match="unknown key 'fx'"):
        pose_plan(PLANT, WANTED.replace(timing_tolerance={"fx": 0.2}))
    with pytest.raises(ArgumentError, match="`timing_tolerance` must be less than half of the period 4 s, got 2 s"):
        pose_plan(PLANT, WANTED.replace(timing_tolerance=2.0))
    with pytest.raises(ArgumentError, match="must be early and late, together less than the period 4 s, got 5 s"):
        pose_plan(PLANT, WANTED.replace(timing_tolerance=(1.0, 4.0)))
    with pytest.raises(ArgumentError, match="`timing_tolerance` is for goals that are guaranteed"):
        pose_plan(PLANT, WANTED.replace(accuracy={"position": {"tolerance": 1.0, "kind": "standard deviation"}},
                                        timing_tolerance=0.1))  # fmt: skip


def held(late, chosen=(0, 3, 6), **changes):
    """The plan of some steps, proven for a tolerance."""
    mask = np.isin(np.arange(8), chosen)[:, None]
    problem = pose_plan(PLANT, WANTED.replace(accuracy={"position": 0.52}, timing_tolerance=late, **changes))
    return proven_plan(problem, mask, PlanBound((), None, None), "budget")


def moved_by(plan, early, late):
    """The largest error that a truth attains where samples come so early and so late in turn."""
    times = (plan.schedule.times + plan.schedule.period * np.arange(2)[:, None]).ravel()
    real = times + np.where(np.arange(times.size) % 2, late, -early)
    schedule = sd.PeriodicSchedule.from_times(real - real[0], 2 * plan.schedule.period)
    return sd.guaranteed_accuracy(PLANT, schedule, w_bound=0.05, v_bound=0.2, of=["position"], rtol=0.02).lower[0]


def test_samples_that_are_only_late_are_those_about_a_later_time_and_prove_more():
    only, about, both = (held(late) for late in ((0.0, 0.2), 0.1, 0.2))
    assert only.keeps
    assert not both.keeps
    assert only.reached == pytest.approx(about.reached, rel=1e-9)
    assert only.accuracy.timing_tolerance == [0.0, 0.2]
    assert only.accuracy.profile.edges == pytest.approx(about.accuracy.profile.edges + 0.1)
    assert only.accuracy.lower[0] > 0.95 * only.reached[0]  # at real times
    assert moved_by(only, 0.0, 0.2) <= only.reached[0] < 0.95 * moved_by(only, 0.2, 0.2)  # who is early breaks it


@pytest.mark.long
def test_what_only_late_samples_bear_is_what_those_about_a_later_time_do():
    plans = [held(late, (0, 2, 4, 6), initial_error=0.5) for late in ((0.2, 0.0), 0.1, (0.05, 0.15))]
    lost = [proven_ratio(plan, without(plan, 1, 1), {}) for plan in plans]
    assert lost == pytest.approx([lost[0]] * 3, rel=1e-6)
    begins = [plan_start(plan) for plan in plans]
    assert np.isfinite([found.from_time for found in begins]).all()
    rng, (early, _, _) = np.random.default_rng(7), plans
    for _ in range(2):
        times = (early.schedule.times + 4.0 * np.arange(4)[:, None]).ravel()
        times = times[times < 7.0]
        real = times - np.where(times > 0, rng.choice([0.0, 0.2], times.size), 0.0)
        assert attained(real, begins[0].from_time, 7.0) <= begins[0].ratio * 0.52 * (1 + 1e-6)


def test_where_nothing_bounds_what_late_samples_do_no_plan_is_made():
    growing = sd.Plant([[0.0, 1.0], [1.0, 0.0]], [[1.0, 0.0]], outputs=["fix"])
    wanted = sd.PlanRequirement(
        {"x1": 9.0}, period=4.0, grid=2.0, w_bound=0.05, sensors={"fix": {"noise_bound": 0.2}}, timing_tolerance=0.9
    )
    with pytest.raises(UndecidedError, match="no plan was proven at all times within `timing_tolerance`"):
        sd.plan_samples(growing, wanted, search_seconds=0.2)


TWO = sd.Plant(PLANT.A, np.eye(2), states=["position", "velocity"], outputs=["fix", "speed"])
BOTH = sd.PlanRequirement(
    {"position": 0.36}, period=4.0, grid=0.5, w_bound=[0.05, 0.05], initial_error=0.5,
    sensors={"fix": {"noise_bound": 0.2}, "speed": {"noise_bound": 0.2}},
)  # fmt: skip
APART = {"fix": 0.1, "speed": 0.01}


def by_output(late, start=False):
    wanted = BOTH.replace(timing_tolerance=late)
    return sd.plan_samples(TWO, wanted, search_seconds=1.0, certificate=False, robustness=False, from_start=start)


@pytest.fixture(scope="module")
def parted():
    return by_output(APART, True)


def searched(plan, late, last, lost=(), periods=3):
    """The largest error of position just before a sample may be in, over times of each reading that a search moves."""
    schedule = plan.schedule
    times = (schedule.times + schedule.period * np.arange(periods)[:, None]).ravel()
    masks, kept = np.tile(plan.chosen[plan.chosen.any(axis=1)], (periods, 1)), np.delete(np.arange(last), lost)
    until = times[last] + min(np.array(late)[masks[last]])

    def reached(moved):
        real = [times[kept] + moved[kept, i] for i in range(2)]
        real = [own[masks[kept, i] & (own > 0)] for i, own in enumerate(real)]
        return apart_from_rest(TWO, np.array([1.0, 0.0]), real, until, 0.05, 0.2)

    moved = np.zeros(masks.shape)
    top = reached(moved)
    for k in kept[::-1][:4]:
        for i in np.flatnonzero(masks[k]):
            for side in (-1, 1):
                trial = moved.copy()
                trial[k, i] = side * late[i]
                if (found := reached(trial)) > top:
                    top, moved = found, trial
    return top


@pytest.mark.long
def test_each_output_has_the_tolerance_that_was_said_of_it(parted):
    largest, late, count = by_output(0.1), list(APART.values()), parted.samples
    assert parted.cost < largest.cost
    assert parted.verify()
    said = "up to 0.1 s early or late (fix), up to 0.01 s early or late (speed)"
    assert ("samples come", said) in parted._rows()
    found = max(searched(parted, late, last) for last in range(2 * count, 3 * count))
    assert 0.95 * parted.reached[0] < found <= parted.reached[0]
    wider = [0.1, 0.1]
    assert max(searched(parted, wider, last) for last in range(2 * count, 3 * count)) > parted.reached[0]


@pytest.mark.long
def test_a_sample_that_is_lost_while_outputs_fall_apart(parted):
    late, count = list(APART.values()), parted.samples
    for k in range(count):
        gaps = {}
        proven_ratio(parted, without(parted, k, 1), gaps)
        found = searched(parted, late, 2 * count + k + 1, lost=[2 * count + k], periods=4)
        assert parted.reached[0] < found <= max(gaps.values()) * 0.36


@pytest.mark.long
def test_gaps_that_the_plans_own_gains_prove_are_as_good_as_proven_one_by_one_while_outputs_fall_apart(monkeypatch):
    chosen = np.isin(np.arange(8), (0, 3, 6))[:, None] & np.ones(2, dtype=bool)
    problem = pose_plan(TWO, BOTH.replace(accuracy={"position": 0.45}, timing_tolerance=APART, initial_error=None))
    plan = proven_plan(problem, chosen, PlanBound((), None, None), "budget")
    found = []
    for factors in (sequence._transient_factors, lambda *_: {}):
        monkeypatch.setattr(sequence, "_transient_factors", factors)
        work, gaps = Budget(counted=True), {}
        plan.oracle.count(work)
        found.append((proven_ratio(plan, without(plan, 1, 1), gaps), gaps, work.spent))
    (quick, each, less), (slow, one_by_one, more) = found
    assert quick <= slow * (1 + 2 * sequence.FADED)
    assert max(each.values()) == pytest.approx(max(one_by_one.values()), rel=2 * sequence.FADED)
    assert less < 0.6 * more


def read_apart(schedule, late, rng, stop):
    """Readings of each output at times of its own, as one schedule."""
    times = (schedule.times + schedule.period * np.arange(3)[:, None]).ravel()
    masks = np.tile(np.ones((len(schedule), 2), dtype=bool) if schedule.outputs is None else schedule.outputs, (3, 1))
    real = times[:, None] + rng.choice([-1.0, 1.0], masks.shape) * late
    real = np.where(times[:, None] == 0, rng.uniform(0.01, 1.0, masks.shape) * late, real)
    k, i = np.nonzero(masks & (times[:, None] < stop))
    order = np.argsort(real[k, i])
    return sd.Schedule(real[k, i][order], np.eye(2, dtype=bool)[i[order]])


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_the_start_and_the_next_sample_hold_while_outputs_fall_apart(parted, seed):
    rng, late = np.random.default_rng(seed), np.array(list(APART.values()))
    given = {"w_bound": [0.05, 0.05], "v_bound": [0.2, 0.2], "of": ["position"], "initial_error": 0.5, "start": 0.0}
    assert np.isfinite(parted.start.from_time)
    schedule = read_apart(parted.schedule, late, rng, 7.0)
    found = sd.guaranteed_accuracy(TWO, schedule, end=max(7.0, schedule.times[-1]), rtol=0.05, **given)
    after = found.profile.edges[:-1] >= parted.start.from_time
    assert found.profile.lower[0][after].max() <= parted.start.ratio * 0.36 * (1 + 1e-6)
    answer = sd.next_sample(parted, [(0.05, [0.0, 0.0], None)])
    assert answer.proven
    for side in (-1, 1):
        own = np.flatnonzero([name in answer.outputs for name in TWO.outputs.names])
        real = np.sort(answer.latest + side * late[own])
        masks = np.eye(2, dtype=bool)[own[np.argsort(answer.latest + side * late[own])]]
        later = read_apart(parted.schedule, late, rng, 9.0)
        kept = later.times > answer.latest + 0.2
        whole = sd.Schedule(
            np.concatenate([[0.05], real, later.times[kept]]),
            np.concatenate([np.ones((1, 2), dtype=bool), masks, later.outputs[kept]]),
        )
        found = sd.guaranteed_accuracy(TWO, whole, end=max(9.0, whole.times[-1]), rtol=0.05, **given)
        after = found.profile.edges[:-1] >= answer.kept_from + 0.01
        assert found.profile.lower[0][after].max() <= answer.ratio * 0.36 * (1 + 1e-6)


def test_outputs_of_one_tolerance_are_samples_of_that_tolerance():
    chosen = np.zeros((8, 2), dtype=bool)
    chosen[0] = True
    one, each, nearer = (
        accuracy_of(pose_plan(TWO, BOTH.replace(timing_tolerance=late)), chosen)
        for late in (0.1, {"fix": 0.1, "speed": 0.1}, {"fix": 0.1, "speed": (0.0, 0.01)})
    )
    assert each.upper == pytest.approx(one.upper, rel=1e-9)
    assert each.lower == pytest.approx(one.lower, rel=1e-9)
    assert nearer.upper < 0.99 * one.upper
    assert nearer.timing_tolerance == {"fix": 0.1, "speed": [0.0, 0.01]}
