"""A record and its shift, means and limits and inputs with it, get the same answer of every verb."""

from dataclasses import replace
from datetime import datetime
from functools import cache
from itertools import product

import numpy as np
import pandas
import pytest

import sampling_design as sd
from sampling_design.accuracy.readings import CensoredReading
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.curve import estimate_curve
from sampling_design.records.record import moment
from tests.cases import few

PLANT = sd.Plant(
    [[0.0, 1.0], [-1.0, 0.0]],
    [[1.0, 0.0], [0.0, 1.0]],
    B=[[0.0], [1.0]],
    states=["level", "rate"],
    outputs=["gauge", "flow"],
    inputs=["pump"],
)
STILL = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), states=["level", "rate"], outputs=["gauge", "flow"])
BOUNDS = {"w_bound": 0.05, "v_bound": 0.05, "initial_error": 2.0}
SHIFTS = [64.0, -8.0, 2.0**30]
TIMES = np.array([0.5, 1.25, 2.0, 3.5, 5.0, 5.75])


def record(told=()):
    """Numbers without noise, of which some rows are limits or means; the pump is still."""
    y = np.stack([np.cos(TIMES), -np.sin(TIMES)], axis=1)
    rows = [[] for _ in TIMES]
    for k, each in told:
        y[k, each.output] = np.nan
        rows[k].append(each)
    return sd.Measurements(PLANT, TIMES, y, np.zeros((TIMES.size, 1)), censored=tuple(tuple(row) for row in rows))


def mean(k, since):
    """What a noise-free mean of the gauge until row k says."""
    value = (np.sin(TIMES[k]) - np.sin(since)) / (TIMES[k] - since)
    return k, CensoredReading(0, value, value, since)


def limit(k, upper):
    return k, CensoredReading(1, -np.inf, upper)


RECORDS = {
    "numbers": record(),
    "limits": record([limit(1, 0.0), limit(4, 1.5)]),
    "means": record([mean(2, 0.75), mean(4, 3.75), mean(5, 5.125)]),
}


@cache
def certificate():
    return sd.certify(PLANT, sd.GapRange(0.5, 1.5), eta=0.5)


def mhe(start):
    return sd.MovingHorizonEstimator(PLANT, certificate(), prior_time=start, **BOUNDS)


def filter_of(start):
    return sd.KalmanFilter(PLANT, cost=sd.CostFunction(eta=0.2), prior_time=start, **BOUNDS)


def in_set(start):
    return sd.SetMembershipEstimator(PLANT, prior_time=start, **BOUNDS)


def told_by_run(maker):
    def answer(rows, start):
        found = maker(start).run(rows)
        return found.times - start, found.x, found.radii, found.certified, found.on_schedule, found.status

    return answer


def told_by_smooth(rows, start):
    found = filter_of(start).smooth(rows)
    return found.times - start, found.x, found.ellipsoid_radii


def told_by_curve(rows, start):
    found = estimate_curve(filter_of(start), rows, 3, start=start)
    return (
        found.estimates.times - start,
        found.estimates.x,
        found.tube.times - start,
        found.tube.lower,
        found.tube.upper,
    )


def told_by_interval(rows, start):
    found = sd.state_interval(PLANT, rows, prior_time=start, **BOUNDS)
    return found.t - start, found.lower, found.upper


VERBS = {
    "mhe": told_by_run(mhe),
    "filter": told_by_run(filter_of),
    "set": told_by_run(in_set),
    "smooth": told_by_smooth,
    "curve": told_by_curve,
    "interval": told_by_interval,
}


@pytest.mark.parametrize(("verb", "kind"), few(product(VERBS, RECORDS), 0, 8, 15))
def test_a_record_and_its_shift_get_the_same_answer(verb, kind):
    answer, rows = VERBS[verb], RECORDS[kind]
    here = answer(rows, 0.0)
    for by in SHIFTS:
        there = answer(rows.shifted(by), by)
        for one, other in zip(here, there, strict=True):
            if isinstance(one, tuple):
                assert one == other
            else:
                assert other == pytest.approx(one, rel=1e-6, abs=1e-6, nan_ok=True)


OTHERS = {
    "minutes": {"time_unit": "min"},
    "outputs in another order": {"outputs": ["flow", "gauge"]},
    "another input": {"inputs": ["valve"]},
    "numbers in another unit": {"outputs": sd.plants.Signals(["gauge", "flow"], ["cm", "m/s"])},
}


@pytest.mark.parametrize(("verb", "other"), list(product([*VERBS, "next"], OTHERS)))
def test_a_record_in_the_terms_of_another_plant_is_refused(verb, other):
    """Minutes were read as seconds, and one output as the other."""
    made = {"outputs": ["gauge", "flow"], "inputs": ["pump"]} | OTHERS[other]
    rows = replace(RECORDS["numbers"], plant=sd.Plant(PLANT.A, PLANT.C, B=PLANT.B, **made))
    answer = VERBS.get(verb, lambda rows, start: sd.next_sample(weekly(), rows))
    with pytest.raises(ArgumentError, match=r"`record` must be Measurements in the plant's terms, time in (s|h), outp"):
        answer(rows, 0.0)


def test_a_log_shifted_by_whole_periods_is_the_same():
    plan, rows = sd.PeriodicSchedule([0.75, 0.75, 1.5]), RECORDS["limits"].between(0.0, 5.0)
    logs = []
    for by in (0.0, 66.0):
        times, outputs = rows.shifted(by).samples()
        log = sd.compare_schedule(PLANT, plan, times, 3.0, outputs=outputs)
        logs.append((log.deviations[-4:], log.match[-4:] - log.match[-1], log.largest_deviation, len(log.actual)))
    assert logs[1][0] == pytest.approx(logs[0][0], nan_ok=True)
    assert logs[1][1].tolist() == logs[0][1].tolist()
    assert logs[1][2:] == logs[0][2:]


def same(one, other):
    assert one.times == pytest.approx(other.times, abs=1e-12)
    assert np.array_equal(one.y, other.y, equal_nan=True)
    assert np.array_equal(one.u, other.u, equal_nan=True)
    assert one.censored == other.censored


@pytest.mark.parametrize("kind", RECORDS)
def test_a_record_is_shifted_cut_and_joined_as_a_whole(kind):
    rows = RECORDS[kind]
    same(rows.shifted(64.0).shifted(-64.0), rows)
    same(rows.between(-1.0, 2.0).merged(rows.between(2.5, 9.0)), rows)
    same(rows.merged(rows), rows)
    late = rows.between(2.0, 9.0)
    assert all(each.since is None or each.since >= 2.0 for row in late.censored for each in row)
    reversed_ = sd.Measurements(PLANT, TIMES[::-1], rows.y[::-1], rows.u[::-1], censored=rows.censored[::-1])
    same(reversed_.in_order(), rows)
    times, taken = rows.samples()
    assert times.tolist() == TIMES.tolist()
    assert taken.all()
    assert rows.samples(numbers=True)[1].sum() == np.isfinite(rows.y).sum()


def test_a_cut_record_says_which_input_holds():
    rows = sd.Measurements(PLANT, [0.0, 1.0, 2.0], [[1.0, np.nan]] * 3, [[0.5], [np.nan], [np.nan]])
    assert rows.between(1.0, 2.0).u.tolist() == [[0.5], [0.5]]
    assert len(sd.Measurements(PLANT, [], np.zeros((0, 2))).between(0.0, 1.0)) == 0


def test_dates_stay_where_they_are():
    rows = sd.Measurements(STILL, TIMES, RECORDS["numbers"].y, origin="2026-03-01T00:00:00+00:00")
    moved = rows.shifted(3600.0)
    assert moved.origin == "2026-02-28T23:00:00+00:00"
    back = moved.rebased("2026-03-01T01:00:00+01:00")
    same(back, rows)
    assert back.origin == "2026-03-01T01:00:00+01:00"
    same(rows.between(0.0, 2.0).merged(moved.between(3602.5, 3700.0)), rows)


TANK = sd.Plant([[-0.02]], [[1.0]], time_unit="h", states=["level"], outputs=["gauge"])
VISITS = {"gauge": [12.0, 7.2, 6.0], "date": ["2026-03-02T08:00", "2026-03-04T16:00", "2026-03-06T16:00"]}


@cache
def weekly():
    hours = {"start": "2026-03-02", "zone": "Europe/Berlin", "hours": {"Mon-Fri": [["08:00", "18:00"]]}}
    wanted = sd.PlanRequirement(
        {"level": 1.25}, grid="8 h", w_bound=0.03, sensors={"gauge": {"noise_bound": 0.5}}, calendar=hours
    )
    return sd.plan_samples(TANK, wanted, search_seconds=0.1, robustness=False, from_start=False)


@pytest.mark.parametrize("origin", [None, "2026-03-02", "2026-03-02T08:00", "2026-02-20T01:00"])
def test_a_dated_record_is_on_the_clock_of_a_dated_schedule_wherever_it_counts_from(origin):
    plan = weekly()
    schedule = sd.Schedule([8.0, 64.0, 112.0], time_unit="h", origin="2026-03-02T00:00+01:00[Europe/Berlin]")
    certificate = sd.certify(TANK, schedule)
    record = sd.read_measurements(pandas.DataFrame(VISITS), TANK, origin=origin, zone="Europe/Berlin")
    bounds = {"w_bound": 0.03, "v_bound": 0.5, "initial_error": 20.0}
    for shift in (0.0, 5.0):
        made = sd.MovingHorizonEstimator(TANK, certificate, **bounds, prior_time=shift, schedule_zero=shift)
        found = made.run(record, centred=False)
        assert found.on_schedule.all()
        assert found.times.tolist() == (schedule.times + shift).tolist()
        made.start(prior_time=shift)
        curve = estimate_curve(made, record, 1, start=shift)
        assert curve.measurements.times.tolist() == (schedule.times + shift).tolist()
        made.start(prior_time=shift)
        assert made.run(pandas.DataFrame(VISITS), centred=False).times.tolist() == found.times.tolist()
    asked = sd.next_sample(plan, record, prove=False)
    assert (asked.now, asked.latest) == (112.0, sd.next_sample(plan, [(t, [1.0]) for t in schedule.times]).latest)
    naive = sd.read_measurements(pandas.DataFrame(VISITS), TANK, origin=origin)
    for read in (lambda: sd.next_sample(plan, naive), lambda: made.run(naive)):
        with pytest.raises(ArgumentError, match="`record` has dates without a zone, which were read in UTC, and"):
            read()


def test_records_with_dates_follow_each_other_on_one_clock():
    frame = pandas.DataFrame(VISITS)
    together = sd.KalmanFilter(TANK, w_bound=0.03, v_bound=0.5, initial_error=20.0)
    one_by_one = sd.KalmanFilter(TANK, w_bound=0.03, v_bound=0.5, initial_error=20.0)
    found = [one_by_one.run(frame[k : k + 1]) for k in range(3)]
    assert [each.times[0] for each in found] == together.run(frame).times.tolist()
    assert found[2].to_frame().index[0].isoformat() == "2026-03-06T16:00:00+00:00"
    one_by_one.start()
    assert one_by_one.run(frame[1:]).times[0] == 0.0
    with pytest.raises(ArgumentError, match=r"\(latest sample at 48.0\)\. `maximum_delay` keeps more, `start"):
        one_by_one.run(frame[:1])


def test_now_is_a_date_by_the_clocks_of_the_plan_or_a_time():
    plan = weekly()
    when = [36.0, "2026-03-03T12:00", "2026-03-03T11:00+00:00", datetime(2026, 3, 3, 12)]
    assert [plan.elapsed("now", each) for each in when] == [36.0] * 4
    assert sd.next_sample(plan, now=when[1], prove=False).now == 36.0
    with pytest.raises(ArgumentError, match="`now` must be a date like 2026-01-05T08:00"):
        sd.next_sample(plan, now="tomorrow")


def test_records_that_do_not_belong_together_are_not_joined():
    rows = RECORDS["numbers"]
    with pytest.raises(ArgumentError, match="`origin` can be another one only of measurements with dates"):
        rows.rebased("2026-03-01")
    with pytest.raises(ArgumentError, match="`other` must be Measurements of the same plant, got"):
        rows.merged(sd.Measurements(STILL, TIMES, rows.y))
    dated = sd.Measurements(PLANT, TIMES, rows.y, rows.u, origin="2026-03-01T00:00:00+00:00")
    with pytest.raises(ArgumentError, match="`other` must have dates where these measurements do"):
        rows.merged(dated)
    with pytest.raises(ArgumentError, match=r"`other` contradicts these measurements at 0\.5"):
        rows.merged(sd.Measurements(PLANT, TIMES, rows.y + 1.0, rows.u))
    with pytest.raises(ArgumentError, match=r"`other` contradicts these measurements at 1\.25"):
        rows.merged(RECORDS["limits"])


def test_times_that_count_from_1970_are_told_apart():
    """Six digits of 1.7e9 s are half an hour; two instants of one record would read alike."""
    plant, begin = sd.named_plant("oscillator"), 1.7e9
    schedule = sd.Schedule([begin + 1.0, begin + 2.5], time_unit="s")
    assert schedule.explain() == "2 samples from 1700000001 to 1700000002.5 s."
    assert "[1700000001, 1700000002.5]" in str(schedule)
    record = [(begin + 1.0, [0.3]), (begin + 2.5, [0.2])]
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}
    interval = sd.state_interval(plant, record, prior_time=begin, **bounds)
    estimator = sd.MovingHorizonEstimator(plant, horizon=5.0, **bounds)
    estimate = estimator.run(record)[-1]
    known = sd.guaranteed_accuracy(plant, schedule, start=begin, end=begin + 4.0, **bounds)
    sigma = sd.window_sigma(plant, schedule, 1.5)
    for said in (str(interval), str(estimate), estimate.explain(), str(sigma), str(known)):
        assert "1.7e+09" not in said
        assert "170000000" in said
    assert moment(123.456789) == "123.457"
    assert moment(1e5) == "100000"
    assert moment([1e17, np.inf]) == "[1e+17, inf]"


@pytest.mark.parametrize("size", [1e-12, 1.0, 20.0, 1.7e9, 1e12])
def test_times_that_differ_by_more_than_rounding_are_written_differently_and_in_order(size):
    times = size * (1 + np.array([0.0, 3e-10, 1e-7, 2e-7, 1e-3, 0.1]))
    written = np.array([float(each) for each in moment(times).strip("[]").split(", ")])
    assert np.all(np.diff(written) > 0)
    assert np.all(np.diff([float(moment(t, times)) for t in times]) > 0)


def test_a_time_before_closing_is_not_written_as_the_time_of_closing():
    assert moment([14 - 1e-7, 20.0], [14.0]) == "[13.9999999, 20]"
    assert moment(14 - 1e-7) == "14"
    assert moment([1.1 + 2.2, 5.0], [3.3]) == "[3.3, 5]"  # rounding alone


def test_a_design_writes_its_times_within_the_hours_in_which_its_place_is_open():
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    requirement = sd.Requirement(
        window=5.0, period=5.0, samples=2, spacing=0.1, forbidden=[(0.0, 2.0), (3.1, 5.0)], fixed=[2.0, 3.1 - 1e-8]
    )
    assert "always at [2, 3.09999999]" in requirement.explain()
    design = sd.design_schedule(plant, requirement, starts=1, branches=0)
    assert "times [2, 3.09999999]" in " ".join(str(design).split())
    near = replace(sd.design.sample_losses(design), times=np.array([2.0, 2.00000001]))
    assert "without t = 2 " in str(near)
    assert "without t = 2.00000001 " in str(near)
