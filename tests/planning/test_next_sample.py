"""The next sample: proven, later than the plan asks where it can be, and refused where the plan says nothing."""

from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy import finite
from sampling_design.accuracy.readings import BelowDetection
from sampling_design.accuracy.search import GainSearch
from sampling_design.errors import ArgumentError, NotDetectableError
from sampling_design.planning import sequence_system
from sampling_design.planning.choices import NextChoices
from sampling_design.planning.deadline import GoalDeadline
from sampling_design.planning.disturbed import delayed, without
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.problem import pose_plan
from sampling_design.planning.proven_choice import proven_plan
from sampling_design.planning.recorded_samples import taken_samples
from sampling_design.planning.sequence import known_at, looks_back, proven_ratio, settling_time, worst_ratio
from sampling_design.planning.sequence_deviation import SampleSequence, planned
from sampling_design.planning.sequence_system import plan_system
from sampling_design.planning.upcoming_sample import _history
from sampling_design.records.budget import Budget
from tests.cases import few
from tests.counted_clock import Counted

BARE = {"certificate": False, "robustness": False, "from_start": False}


def deviating(plan, times, seen, resume):
    """The plan's samples, then those given, then the plan's from `resume` on, for as long as the proof asks."""
    first = times[0] if times.size else resume
    span = (looks_back(plan) + 1) * plan.schedule.period / len(plan.schedule) + plan.schedule.period
    before, after = planned(plan, first - span, first), planned(plan, resume, resume + span)
    return SampleSequence(
        np.concatenate([before[0], times, after[0]]), np.concatenate([before[1], seen, after[1]]), before[0].size
    )


def test_an_interrupt_after_the_answer_leaves_it(week, monkeypatch):
    def interrupted(*given):
        raise KeyboardInterrupt

    week = replace(week, requirement=week.requirement.replace(initial_error=[0.3, 0.05]))
    whole = sd.next_sample(week, now=0.0)
    assert whole.keeps
    monkeypatch.setattr(NextChoices, "best", interrupted)
    left = sd.next_sample(week, now=0.0)
    assert (left.latest, left.outputs, left.proven, left.keeps) == (whole.latest, whole.outputs, True, whole.keeps)
    assert not left.complete


def test_a_sample_may_be_late_by_so_much_and_the_plan_goes_on(week):
    unknown = sd.next_sample(week, now=0.0)
    assert "level is not known yet: what was read since the start does not tell the state. A" in unknown.explain()
    assert dict(unknown._rows())["level now"] == "not known yet (tolerance 3)"
    week = replace(week, requirement=week.requirement.replace(initial_error=[0.3, 0.05]))
    found = sd.next_sample(week, now=0.0)
    assert found.proven
    assert found.ratio <= 1
    planned_at = planned(week, 0.5, week.schedule.period)[0][0]
    assert found.latest >= planned_at - 1e-9
    assert week.problem.allowed[round(found.latest / week.problem.step) % week.problem.steps].any()
    assert f"Next sample {'by' if found.latest <= planned_at else 'at'} " in found.explain()
    outputs, day = week.plant.outputs.names, 24.0
    told = replace(
        found, latest=day + 14, outputs=outputs, alone={outputs[0]: day + 11.5, outputs[1]: day - 5}, deadline=None
    )
    clock, before = told.date(day + 14), told.date(day - 5)
    first = f"Next sample at {clock:%a} 14:00 ({', '.join(outputs)})"
    assert told.explain() == f"{first}; {outputs[0]} alone at 11:30; {outputs[1]} alone at {before:%a} 19:00."
    sampled = replace(told, proven=False)
    assert sampled.explain().endswith("19:00, by looks on the grid alone: between its times nothing is proven.")
    assert dict(sampled._answered())["evidence"].startswith("sampled: judged in floats on the grid")
    later = replace(
        told,
        deadline=GoalDeadline("level", day + 27.25, 1.02),
        alone_deadlines={outputs[0]: GoalDeadline("level", 40.0, 0.999)},
    )
    by = f"level reaches its tolerance by {told.date(day + 27.25):%a} 03:15"
    assert later.explain() == f"{told.explain()} If taken at the next allowed time after that, {by}."
    assert dict(later._rows())["later"] == by
    near = f"level comes to 0.999 of its tolerance by {told.date(40.0):%a} 16:00, and more is not ruled out"
    assert dict(later._rows())[f"{outputs[0]} alone"].endswith(f"; later: {near}")
    assert "at Wed 01 Apr 01:00" in replace(told, latest=9 * day).explain()  # one of these days had 23 hours
    assert found.to_dict()["latest"]["date"].endswith("+01:00")
    assert found.keeps
    none = replace(
        found,
        latest=-np.inf,
        best=-np.inf,
        alone={outputs[0]: -np.inf},
        ratio=1.001,
        proven=False,
        deadline=None,
        kept_from=np.inf,
        known={"level": 3.5},
        exceeded=GoalDeadline("level", -3.0, 1.1),
    )
    assert "the tolerances back (1.001 of them after the last one tried): keep to the plan's" in none.explain()
    since = f"level has been above its tolerance of 3 cm since {found.when(-3.0)}: within 3.5 cm now. "
    assert none.explain().startswith(since)
    assert dict(none._rows()) == {
        "now": found.when(0.0),
        "level now": "within 3.5 cm (tolerance 3)",
        "exceeded": f"level since {found.when(-3.0)}",
        "soonest help": "never",
        "kept again": "not known",
    }
    said = dict(none._answered())
    assert said["evidence"] == "nothing is proven: it may be exceeded"
    assert said["how good"] == "1.001 of the tolerance"
    late = replace(none, latest=day + 14, kept_from=2 * day)
    again = f"A sample at {found.when(day + 14)} ({', '.join(found.outputs)}) helps soonest"
    again += f". Every tolerance is kept from {found.when(2 * day)} on"
    assert replace(late, proven=True).explain() == f"{since}{again}."
    assert late.explain() == f"{since}{again}, by looks on the grid alone: between its times nothing is proven."
    first = replace(late, exceeded=None)
    assert "No single sample keeps every tolerance from now on. Every" in first.explain()
    goal = GoalDeadline("level", day + 20, 1.1)
    assert (
        f"level reaches its tolerance by {found.when(day + 20, 0.0)}. Every" in replace(first, deadline=goal).explain()
    )
    assert late.to_dict()["kept_from"]["time"] == 2 * day
    assert dict(replace(found, judged_until=9 * day)._rows())["not judged"].startswith("closed days from ")


def drifting(tolerance, holidays):
    """A level that drifts, read on Mondays, Wednesdays and Fridays at nine: its accuracy is a line in time."""
    place = {"start": "2026-06-01", "hours": {"Mon-Fri": [["09:00", "17:00"]]}, "holidays": holidays}
    wanted = sd.PlanRequirement(
        {"level": tolerance}, grid="1 h", w_bound=0.01, sensors={"y": {"noise_bound": 0.1}}, calendar=place
    )
    problem = pose_plan(sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["y"], time_unit="h"), wanted)
    chosen = np.zeros_like(problem.allowed)
    chosen[[9, 57, 105]] = True
    return proven_plan(problem, chosen, PlanBound((), None, None), "budget")


def every_sixth(A, C, tolerance):
    """The first state read at every sixth step of the grid, whatever it takes."""
    states = [f"x{i}" for i in range(len(A))]
    wanted = sd.PlanRequirement(
        {states[0]: tolerance}, grid=1.0, period=12.0, w_bound=[0.01] * len(A), sensors={"y": {"noise_bound": 0.1}}
    )
    problem = pose_plan(sd.Plant(A, C, states=states, outputs=["y"]), wanted)
    chosen = np.zeros_like(problem.allowed)
    chosen[[0, 6]] = True
    return proven_plan(problem, chosen, PlanBound((), None, None), "budget")


def test_where_the_clock_stands_changes_no_answer_as_long_as_doubles_tell_steps_apart():
    plan = every_sixth([[0.0]], [[1.0]], 0.168)
    near = sd.next_sample(plan, now=120_000.0)
    for zero in (1.2e6, 1.2e9, 1.2e12, 1.2e14):
        for record in (None, [(zero - 6.0, [0.0], None), (zero, [0.0], None)]):
            found = sd.next_sample(plan, record, now=zero)
            assert found.proven
            assert found.keeps
            assert found.latest == zero + 6.0 == near.latest - near.now + zero
            assert found.deadline.time == near.deadline.time - near.now + zero
            assert found.known["x0"] == pytest.approx(near.known["x0"], rel=1e-6)
    for now, record in ((1e19, None), (None, [(1e100, [0.0], None)])):
        with pytest.raises(ArgumentError, match="lies so far from the plan's start that no double tells steps"):
            sd.next_sample(plan, record, now=now)


def test_a_clock_that_is_far_beyond_the_record_is_refused_in_a_sentence():
    """Who gave seconds since 1970 for the time since the plan's start waited for ever, or for a list of all samples."""
    plan = every_sixth([[-0.1]], [[1.0]], 0.168)
    for rows, now in (([6.0], 1.7e9), ([6.0, 1.7e9], 1.7e9), ([6.0, 1.2e5], 1.2e5)):
        with pytest.raises(ArgumentError, match=r"steps of the plan's grid after the row at 6\.0, more than 50000"):
            sd.next_sample(plan, [(t, [0.0], None) for t in rows], now=now)


def test_rows_of_a_record_come_in_any_order_and_in_parts(week):
    """As estimators take them: what is read at one time may stand in several rows."""
    rows = [(float(t), np.zeros(week.plant.n_outputs), None) for t in week.schedule.times[:4]]
    parts = [(t, np.where(np.arange(y.size) == i, y, np.nan), u) for t, y, u in rows for i in range(y.size)]
    found, whole = (sd.next_sample(week, given, prove=False) for given in (parts[::-1], rows))
    assert (found.now, found.latest, found.outputs, found.known) == (
        whole.now,
        whole.latest,
        whole.outputs,
        whole.known,
    )


@pytest.mark.parametrize("zero", few([0.0, 1.2e6], 1))
def test_a_sample_beside_the_grid_counts_from_when_it_wastaken_samples(zero):
    """The error of a drifting level is v + w d so long after a sample: its tolerance is reached after 6.8."""
    plan = every_sixth([[0.0]], [[1.0]], 0.168)
    for taken, latest in ((60.1, 66.0), (60.4, 67.0), (60.7, 67.0)):
        found = sd.next_sample(plan, [(zero + taken, [0.0], None)])
        assert found.proven
        assert found.latest == zero + latest
        assert found.deadline.breaks
        assert taken + 6.8 <= found.deadline.time - zero <= taken + 7.8


@pytest.mark.parametrize(
    ("A", "tolerance"),
    few([([[0.0]], 0.168), ([[0, 0.3], [-0.3, 0]], 0.31), ([[0.1, 0.2], [0, 0.1]], 1.12)], 0, 2),
    ids=str,
)
def test_floats_attain_of_samples_beside_the_grid_what_gains_prove_and_no_more(A, tolerance):
    plan = every_sixth(A, np.eye(len(A))[:1], tolerance)
    span = settling_time(plan)
    for rng in map(np.random.default_rng, range(3)):
        times = 1200 + np.cumsum(rng.uniform(0.3, 9.0, 3))
        before, after = planned(plan, 1200 - span, 1200)[0], planned(plan, times[-1] + 0.3, times[-1] + span)[0]
        every = np.concatenate([before, times, after])
        sequence = SampleSequence.of(plan.problem, every, np.ones((every.size, 1), dtype=bool), before.size)
        attained, proven = worst_ratio(plan, sequence), proven_ratio(plan, sequence, {})
        assert 0.98 * proven < attained <= proven * (1 + 1e-6)


def test_times_without_dates_are_told_to_the_step_however_large():
    sensors = {"y": {"noise_bound": 0.1}}
    wanted = sd.PlanRequirement({"level": 1.35}, grid=1.0, period=48.0, w_bound=0.01, sensors=sensors)
    problem = pose_plan(sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["y"], time_unit="h"), wanted)
    chosen = np.zeros_like(problem.allowed)
    chosen[0] = True
    found = sd.next_sample(proven_plan(problem, chosen, PlanBound((), None, None), "budget"), now=48.0 * 70_000)
    assert found.latest >= 3_360_048
    assert f"Next sample by {found.latest:.0f} h (y)" in found.explain()


@pytest.mark.parametrize("holidays", few([[], ["2026-06-08"], ["2026-06-05", "2026-06-08"], ["2026-06-24"]], 0))
def test_no_promise_rests_on_a_sample_on_a_day_that_is_known_to_be_closed(holidays):
    plan, taken = drifting(1.35, holidays), [9.0]
    while taken[-1] < 300:
        found = sd.next_sample(plan, [(t, [0.0], None) for t in taken], now=taken[-1])
        assert found.proven
        assert found.keeps
        assert found.date(found.latest).date().isoformat() not in holidays
        taken.append(found.latest)
    assert 0.1 + 0.01 * np.diff(taken).max() <= 1.35
    if len(holidays) == 2:  # from Thursday's last hour to Tuesday's first
        assert np.diff(taken).max() <= 125


@pytest.mark.long
def test_a_closed_day_that_no_sample_makes_good_is_told_before_it_comes():
    found = sd.next_sample(drifting(0.85, ["2026-06-08"]), now=9.0)
    assert not found.keeps
    assert found.exceeded is None
    assert found.latest == 57.0  # the plan's own: nothing more is asked for where it would not help
    assert found.kept_from == 8 * 24 + 9.0
    assert 180 <= found.deadline.time <= 188  # 75 h after Friday's sample at nine, or one more at four
    assert "No single sample keeps every tolerance from now on: with one at Wed" in found.explain()
    far = sd.next_sample(drifting(1.35, ["2026-09-09"]), now=9.0)
    assert far.date(far.judged_until).date().isoformat() == "2026-09-09"


def test_what_is_known_after_a_miss_is_said():
    plan = drifting(0.85, [])
    found = sd.next_sample(plan, [(9.0, [0.0], None)], now=9.0 + 76)
    assert found.known["level"] == pytest.approx(0.86, abs=1e-6)
    assert found.exceeded.goal == "level"
    assert found.exceeded.time == pytest.approx(9 + 75, abs=1.0)
    assert found.latest == found.kept_from == 86.0
    assert found.proven


def test_samples_as_planned_change_nothing_of_what_is_proven(week):
    times, seen = planned(week, 0.0, week.schedule.period)
    sequence = deviating(week, times, seen, week.schedule.period)
    assert proven_ratio(week, sequence) <= 1


def test_a_week_without_samples_breaks_the_tolerance(week):
    empty = np.zeros(0), np.zeros((0, 2), dtype=bool)
    sequence = deviating(week, *empty, 2 * week.schedule.period)
    lost = replace(sequence, first=int(np.argmax(np.diff(sequence.times))) + 1)
    assert proven_ratio(week, lost) <= 1  # it starts after the plan's own samples: nothing is lost here
    late = deviating(week, np.array([0.0]), np.array([[True, True]]), 3 * week.schedule.period)
    assert proven_ratio(week, late) > 1


def test_a_limit_that_the_plan_does_not_count_with_says_nothing(week):
    planned_at = float(planned(week, 0.5, week.schedule.period)[0][0])
    one, other = (
        sd.next_sample(week, [(planned_at, [y, 2.0], None)], prove=False) for y in (np.nan, BelowDetection(1.0))
    )
    assert one.to_dict() == other.to_dict()


def test_wrong_arguments_are_refused(week):
    with pytest.raises(ArgumentError, match=r"must not lie before the last sample .*, got "):
        sd.next_sample(week, [(9.0, [1.0, 2.0], None)], now=3.0)
    with pytest.raises(ArgumentError, match="must hold 2 outputs a sample, got"):
        sd.next_sample(week, [(9.0, [1.0], None)])
    for row in (3.0, "a", [9.0], np.inf):
        with pytest.raises(ArgumentError, match=r"`record` must hold rows \(t, y, u\), got"):
            sd.next_sample(week, [row])
    with pytest.raises(ArgumentError, match="it does not, so there is nothing to go on keeping"):
        sd.next_sample(replace(week, reached=week.reached * 2))


def every_other_day(tolerance):
    """A level that drifts by .01 an hour at most, read to .1 every other day at eight, from the day before winter."""
    plant = sd.Plant([[0.0]], [[1.0]], time_unit="h", states=("level",), outputs=("gauge",))
    place = {"start": "2026-10-24", "zone": "Europe/Berlin", "hours": {"Mon-Sun": [["08:00", "09:00"]]}}
    wanted = sd.PlanRequirement(
        {"level": tolerance},
        period="2 d",
        grid="1 h",
        w_bound=0.01,
        sensors={"gauge": {"noise_bound": 0.1, "price": 1.0}},
        calendar=place,
    )
    problem = pose_plan(plant, wanted)
    chosen = np.zeros_like(problem.allowed)
    chosen[8] = True
    return proven_plan(problem, chosen, PlanBound((), None, None), "complete")


@pytest.mark.parametrize(("tolerance", "gap", "day"), [(0.595, 49.0, 26), (0.585, 25.0, 25)])
def test_what_passes_between_samples_is_counted_and_not_what_clocks_show(tolerance, gap, day):
    """49 h pass between eight and eight, two days apart, when summer ends: the level drifts for all of them."""
    found = sd.next_sample(every_other_day(tolerance), now=8.0)
    assert found.latest == 8.0 + gap
    assert found.date(found.latest).isoformat() == f"2026-10-{day}T08:00:00+01:00"
    assert found.proven
    following = 49.0 if gap == 49.0 else 48.0
    assert (0.1 + 0.01 * following) / tolerance <= found.ratio * (1 + 1e-9)
    assert found.ratio <= 1


def test_a_plan_that_hides_a_mode_for_ever_bounds_no_change():
    plant = sd.Plant([[0.0, 0.0], [0.0, 0.0]], [[1.0, 0.0]], outputs=["y"])
    terms = {"y": {"noise_bound": 0.1}}
    found = sd.plan_samples(
        plant, sd.PlanRequirement({"x1": 1.0}, period=8.0, grid=2.0, w_bound=[0.1, 0.0], sensors=terms), **BARE
    )
    with pytest.raises(NotDetectableError, match="what a change of its samples does is not bounded"):
        plan_system(found)


def test_within_a_budget_the_latest_sample_that_is_proven_by_then_is_the_answer(week):
    week = replace(week, requirement=week.requirement.replace(initial_error=[0.3, 0.05]))
    full = sd.next_sample(week, now=0.0)
    with Counted().running() as clock:
        sd.next_sample(week, now=0.0)  # what is remembered of the plan costs nothing any more
    whole, own = clock.read(), planned(week, 0.5, week.schedule.period)[0][0]
    assert full.complete
    assert "budget" not in dict(full._rows())
    latest = []
    for share in (1e-9, 0.5, 2.0):
        with Counted().running() as clock:
            found = sd.next_sample(week, now=0.0, budget=share * whole)
        assert found.proven
        assert found.ratio <= 1
        assert own - 1e-9 <= found.latest <= full.latest + 1e-9
        assert found.keeps
        assert found.complete is found.to_dict()["complete"] is (share > 1)
        assert found.complete or dict(found._rows())["budget"] == "spent: a later sample may do"
        latest.append((found.latest, clock.read()))
    assert latest[0][1] < 0.5 * whole
    assert latest[0][0] < latest[2][0] == full.latest
    assert latest[1][0] <= latest[2][0]
    with pytest.raises(ArgumentError, match=r"`budget` must be positive, got 0\.0"):
        sd.next_sample(week, now=0.0, budget=0.0)


def test_once_a_budget_is_over_nobody_looks_for_when_the_tolerances_are_kept_again(week):
    """Nothing is known at the start, so that no sample keeps them from then on."""
    full = sd.next_sample(week, now=0.0)
    with Counted().running() as clock:
        sd.next_sample(week, now=0.0)
    whole = clock.read()
    assert full.complete
    assert 0 < full.kept_from < np.inf
    with Counted().running() as clock:
        found = sd.next_sample(week, now=0.0, budget=1e-9)
    assert clock.read() < 0.3 * whole
    assert not found.complete
    assert found.kept_from == np.inf
    assert "No allowed sample is proven to bring the tolerances back: keep to the plan's next one" in found.explain()


def test_once_a_budget_is_over_the_filters_gains_prove_no_less_than_is_attained_and_nothing_is_solved(
    week, monkeypatch
):
    """Of late and lost samples: above what gains that are solved for prove, and the same where none are needed."""
    step = week.problem.step
    changed = [delayed(week, 0, 20 * step), delayed(week, 1, 12 * step), *(without(week, k, 1) for k in (0, 1))]
    near, until = delayed(week, 1, 2 * step), float(changed[0].times[-1])
    best = [proven_ratio(week, each, {}) for each in [near, *changed]]
    known = known_at(week, changed[0], until)["level"]

    def refused(*given):
        raise AssertionError("a program is solved")

    monkeypatch.setattr(GainSearch, "gains", refused)
    for each, solved in zip(changed, best[1:], strict=True):
        with pytest.raises(AssertionError, match="a program is solved"):
            proven_ratio(week, each, {})
        found = proven_ratio(week, each, {}, Budget(-1.0))
        assert worst_ratio(week, each) * (1 - 1e-6) <= solved < found < 1.1 * solved
    assert proven_ratio(week, near, {}, Budget(-1.0)) == best[0]
    assert known < known_at(week, changed[0], until, Budget(-1.0))["level"] < 1.5 * known


@pytest.mark.parametrize("known", [None, 40.0])
def test_the_start_of_a_plan_is_no_sample_that_keeps_its_first_one_away(known):
    """For x' = w nothing is within the tolerance before the first sample, an hour after the start, and all is then."""
    sensors = {"y": {"noise_bound": 0.1}}
    wanted = sd.PlanRequirement(
        {"level": 0.6}, grid=1.0, period=24.0, spacing=8.0, w_bound=0.01, sensors=sensors, initial_error=known
    )
    problem = pose_plan(sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["y"], time_unit="h"), wanted)
    chosen = np.zeros_like(problem.allowed)
    chosen[1] = True
    found = sd.next_sample(proven_plan(problem, chosen, PlanBound((), None, None), "budget"), now=0.0)
    assert (found.latest, found.kept_from) == (1.0, 1.0)
    assert found.proven


@pytest.mark.parametrize(
    ("turn", "tolerance", "spacing", "breaks"),
    few([(2.2, 1.0, None, True), (0.7, 1.2, None, True), (1.5, 1.6, None, False), (1.5, 1.6, 1.0, False)], 1, 3),
)
def test_no_time_is_said_to_be_soon_enough_before_which_a_sample_breaks_a_tolerance(turn, tolerance, spacing, breaks):
    """After a miss a swing is seen well a turn later, and badly before: "by" up to the plan's own sample alone."""
    plant = sd.Plant([[0.0, turn], [-turn, -0.01]], [[1.0, 0.0]], states=["place", "speed"], outputs=["y"])
    terms = {"y": {"noise_bound": 0.2, "spacing": spacing}}
    wanted = sd.PlanRequirement({"place": tolerance}, period=4.0, grid=0.5, w_bound=0.05, sensors=terms)
    problem, now = pose_plan(plant, wanted), 20.2
    chosen = np.zeros_like(problem.allowed)
    chosen[0] = True
    plan = proven_plan(problem, chosen, PlanBound((), None, None), "budget")
    record = [(t, [0.0]) for t in np.arange(0.0, 16.1, 4.0).tolist()]
    found = sd.next_sample(plan, record, now=now, prove=False)
    run = NextChoices(plan, _history(plan, taken_samples(plan, record), now), now)
    broken = [t for t, mask in run.options(None) if t < found.latest and run.ratio((t, mask)) > 1]
    assert bool(broken) == breaks
    word = "at" if breaks or spacing else "by"
    assert found.explain().startswith(f"Next sample {word} {found.latest:g} ")
    assert "by looks on the grid alone: between its times nothing is proven." in found.explain()


@pytest.mark.parametrize(("fast", "hour"), few([((-3.0, -2.0), 2), ((-3.0, -0.3), 2)], 1))
def test_a_start_that_fades_before_samples_show_it_leaves_what_a_known_one_leaves(fast, hour):
    """Doubles cannot say what modes leave of a start of any size that have decayed by e^-32; of it nothing is left."""
    plant = sd.Plant(np.diag([-0.02, *fast]) + 0.1 * np.eye(len(fast) + 1, k=1), np.eye(1, len(fast) + 1))
    known = {}
    for error in (None, 1e-3):
        wanted = sd.PlanRequirement(
            {"x1": 2.0}, grid=4.0, period=24.0, w_bound=0.03, initial_error=error, sensors={"y1": {"noise_bound": 0.5}}
        )
        problem = pose_plan(plant, wanted)
        chosen = np.zeros_like(problem.allowed)
        chosen[hour] = True
        plan = proven_plan(problem, chosen, PlanBound((), None, None), "budget")
        found = sd.next_sample(plan, now=400.0, prove=error is None)
        assert found.latest > 400.0
        known[error] = found.known["x1"]
    assert known[None] == pytest.approx(known[1e-3], rel=1e-3)


@pytest.mark.parametrize("budget", few([None, 1e3], 1))
def test_long_after_the_start_no_more_samples_are_looked_at_than_soon_after(week, monkeypatch, budget):
    """Counted in samples of systems and of paths back; within a budget the filter is followed from the start no longer
    than until it is near the plan's own."""
    counted = {"samples": 0, "paths": 0}

    def system_of(plan, sequence, *given, **named):
        counted["samples"] += len(sequence.times)
        return made(plan, sequence, *given, **named)

    def path(system, nodes, *given):
        counted["paths"] += 1
        return bounds(system, nodes, *given)

    made, bounds = sequence_system._noisier_system, finite.path_bounds
    monkeypatch.setattr(sequence_system, "_noisier_system", system_of)
    monkeypatch.setattr(finite, "path_bounds", path)
    seen = []
    for periods in (300, 5000):
        counted.update(samples=0, paths=0)
        again = replace(week)  # of which nothing is remembered
        assert sd.next_sample(again, now=periods * week.schedule.period + 1.0, budget=budget).proven
        seen.append(dict(counted))
    assert seen[0] == seen[1]
    assert min(seen[0].values()) > 0
