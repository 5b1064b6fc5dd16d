import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sampling_design import ArgumentError, PeriodicSchedule, Schedule

eighths = st.integers(1, 40).map(lambda k: k / 8)


def test_finite_schedule_by_hand():
    schedule = Schedule.from_gaps([0.0, 1.0, 0.5], time_unit="h")
    np.testing.assert_array_equal(schedule.times, [0.0, 1.0, 1.5])
    np.testing.assert_array_equal(schedule.gaps, [1.0, 0.5])
    assert len(schedule) == 3
    assert not schedule.times.flags.writeable
    np.testing.assert_array_equal(schedule.in_unit("min").times, [0.0, 60.0, 90.0])
    assert schedule.explain() == "3 samples from 0 to 1.5 h."
    assert Schedule([]).explain() == "A schedule without samples."
    assert repr(schedule) == "Schedule(samples=3, times=[0, 1, 1.5], time_unit=h)"


def test_the_caller_keeps_his_array():
    times = np.array([0.0, 1.0])
    schedule = Schedule(times)
    times[0] = 0.5
    assert schedule.times[0] == 0.0


@pytest.mark.parametrize(
    ("closed", "kept"),
    [("both", [1.0, 2.0, 3.0]), ("left", [1.0, 2.0]), ("right", [2.0, 3.0]), ("neither", [2.0])],
)
def test_ends_of_an_interval(closed, kept):
    for schedule in (Schedule([0.0, 1.0, 2.0, 3.0, 4.0]), PeriodicSchedule([1.0])):
        assert schedule.between(1.0, 3.0, closed).times.tolist() == kept
        assert schedule.count(1.0, 3.0, closed) == len(kept)
    assert PeriodicSchedule([1.0], 0.0).between(-2.0, 0.5, "right").times.tolist() == [0.0]
    assert Schedule([0.0, 1.0, 2.0]).window(2.0, 1.0).times.tolist() == [1.0, 2.0]


@given(st.lists(eighths, min_size=1, max_size=5), st.integers(0, 40), st.integers(0, 400), st.integers(0, 400))
def test_a_periodic_schedule_unrolls_to_all_its_samples(gaps, first, a, b):
    first = min(first / 8, sum(gaps))
    schedule = PeriodicSchedule(gaps, first)
    start, stop = sorted((a / 8, b / 8))
    expected, time, i = [], first, 0
    while time <= stop:
        if time >= start:
            expected.append(time)
        i += 1
        time += gaps[i % len(gaps)]
    assert schedule.between(start, stop).times.tolist() == expected
    assert schedule.window(stop, stop - start).times.tolist() == expected


def test_masks_follow_their_samples():
    mask = [[1, 0], [0, 1]]
    schedule = PeriodicSchedule([1.0, 2.0], outputs=mask, output_names=("a", "b"))
    part = schedule.between(1.5, 6.5)
    assert part.times.tolist() == [3.0, 4.0, 6.0]
    np.testing.assert_array_equal(part.outputs, [[False, True], [True, False], [False, True]])
    assert part.output_names == ("a", "b")
    np.testing.assert_array_equal(Schedule([1.0, 2.0], mask).between(1.5, 3.0).outputs, [[False, True]])


def test_from_times_keeps_times_and_period_to_the_last_bit():
    times, period = [0.1, 0.2, 0.7], 0.1 + 0.7
    schedule = PeriodicSchedule.from_times(times, period)
    assert schedule.times.tolist() == times
    assert schedule.period == period
    late = PeriodicSchedule.from_times([1.0, 2.0, 4.0], 4.0)  # the period of PeriodicSchedule([1, 1, 2])
    assert late.gaps.tolist() == PeriodicSchedule([1.0, 1.0, 2.0]).gaps.tolist()
    assert late.first == 1.0
    assert PeriodicSchedule([1.0, 1.0, 2.0], time_unit="h").in_unit("min").times.tolist() == [60.0, 120.0, 240.0]
    assert late.explain() == "3 samples every 4, gaps from 1 to 2, without end."
    assert PeriodicSchedule([1.5, 1.5], time_unit="s").explain() == "2 samples every 3 s, all gaps 1.5 s, without end."


def test_plain_data_is_exact():
    schedule = Schedule([0.1, 0.30000000000000004], [[1, 0], [1, 1]], time_unit="h", output_names=["a", "b"])
    assert schedule.to_dict() == {
        "kind": "finite",
        "times": [0.1, 0.30000000000000004],
        "outputs": [[1, 0], [1, 1]],
        "time_unit": "h",
        "output_names": ["a", "b"],
    }
    assert PeriodicSchedule([1.0, 2.0]).to_dict() == {
        "kind": "periodic",
        "gaps": [1.0, 2.0],
        "first": 1.0,
        "times": [1.0, 3.0],
        "period": 3.0,
    }


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: Schedule([0.0, 2.0, 1.0]),
            r"times\[2\] = 1.0 which comes after times\[1\] = 2.0. Did you pass gaps\?",
        ),
        (lambda: Schedule([0.0, 1.0, 1.0]), r"times\[2\] = 1.0 which repeats times\[1\]"),
        (lambda: Schedule([-1.0, 1.0]), r"`times` must not be negative, got times\[0\] = -1.0"),
        (lambda: Schedule([0.0, np.nan]), r"`times` must be finite, got times\[1\] = nan"),
        (lambda: Schedule([[0.0, 1.0]]), "`times` must have 1 dimension, got shape"),
        (lambda: Schedule([1j]), "`times` must be real, got complex"),
        (lambda: Schedule([1.0], time_unit="year"), "`time_unit` must be one of ms, s, min, h, d, wk, got 'year'"),
        (lambda: Schedule([1.0], origin="soon"), "`origin` must be a date like .*, got 'soon'"),
        (
            lambda: Schedule([1.0], origin="2026-01-05T08:00+00:00\0"),
            r"`origin` must be a date like .*, got '2026-.*x00'",
        ),
        (lambda: Schedule([1.0], origin=5), "`origin` must be a date like .*, got int 5"),
        (
            lambda: PeriodicSchedule([1.0], origin="2026-03-29T02:30[Europe/Berlin]"),
            "skipped or repeated by the clocks",
        ),
        (lambda: Schedule([1.0], [[0, 0]]), "must measure at least one output at each sample, got none at sample 0"),
        (
            lambda: Schedule([1.0, 2.0], [[1, 0], [1]]),
            "`outputs` must be a rectangular array of numbers, got rows of unequal length",
        ),
        (lambda: Schedule([1.0], [[2]]), "`outputs` must hold True/False or 1/0 only"),
        (lambda: Schedule([1.0], [1]), r"`outputs` must have shape \(1, number of outputs\)"),
        (lambda: Schedule([1.0], [[1, 1]], output_names=["a"]), "`output_names` must have 2 entries, got 1"),
        (lambda: Schedule([1.0]).in_unit("h"), "`time_unit` is missing"),
        (lambda: Schedule.from_gaps([-1.0]), r"`gaps` must not be negative, got gaps\[0\] = -1.0"),
        (lambda: Schedule.from_gaps([1.0, 0.0]), r"`gaps` must be positive, got gaps\[1\] = 0.0"),
        (lambda: Schedule([1.0]).between(0.0, 1.0, "closed"), "`closed` must be one of both, left, right, neither"),
        (lambda: Schedule([1.0]).between(0.0, np.nan), "`end` must be finite, got nan"),
        (lambda: PeriodicSchedule([]), "`gaps` must not be empty"),
        (lambda: PeriodicSchedule([1e-9, 2e7]), "`gaps` must be told apart from zero beside the period"),
        (lambda: PeriodicSchedule([1.0, -1.0]), r"`gaps` must be positive, got gaps\[1\] = -1.0"),
        (lambda: PeriodicSchedule([1.0], 1.5), r"`first` must lie in \[0, period\] = \[0, 1.0\], got 1.5"),
        (lambda: PeriodicSchedule([1.0], -0.5), "`first` must not be negative"),
        (lambda: PeriodicSchedule([1.0]).between(0.0, np.inf), "`end` must be finite, got inf"),
        (lambda: PeriodicSchedule.from_times([], 1.0), "`times` must not be empty"),
        (lambda: PeriodicSchedule.from_times([0.5], 0.0), "`period` must be positive"),
        (lambda: PeriodicSchedule.from_times([0.0, 1.0], 1.0), r"must span less than one period 1.0.* next period\?"),
        (lambda: PeriodicSchedule.from_times([1.5], 1.0), r"`times` must begin in \[0, period\] = \[0, 1.0\], got 1.5"),
        (lambda: PeriodicSchedule.from_times([1.0, 0.5], 2.0), r"Did you pass gaps\? Use PeriodicSchedule\(gaps\)"),
    ],
)
def test_bad_input(build, message):
    with pytest.raises(ArgumentError, match=message):
        build()


def test_the_shortest_period_keeps_the_samples():
    long = PeriodicSchedule(
        [1.0, 0.5] * 3, 0.25, [[True, False], [True, True]] * 3, time_unit="h", output_names=["a", "b"]
    )
    short = long.primitive()
    assert (len(short), short.period, short.time_unit) == (2, 1.5, "h")
    assert short.between(0, 20).times.tolist() == long.between(0, 20).times.tolist()
    assert short.between(0, 20).outputs.tolist() == long.between(0, 20).outputs.tolist()
    for alone in (
        PeriodicSchedule([1.0, 0.5]),
        PeriodicSchedule([0.5] * 4, 1.5),
        PeriodicSchedule([0.5] * 2, outputs=[[True, False], [True, True]]),
    ):
        assert alone.primitive() is alone


def test_a_schedule_knows_its_longest_and_its_least_gap():
    finite, endless = Schedule([2.0, 2.5, 4.0]), PeriodicSchedule([1.0, 0.25], first=0.75)
    assert (finite.d_max, finite.min_gap) == (2.0, 0.5)
    assert (endless.d_max, endless.min_gap) == (1.0, 0.25)
    assert Schedule([3.0]).min_gap == np.inf
    with pytest.raises(ArgumentError, match="`schedule` must have at least one sample: without one it has no longest"):
        _ = Schedule([]).d_max


@pytest.mark.parametrize("factor", [3600.0, 1e-6, 1 / 7])
def test_the_first_sample_may_be_at_the_end_of_the_period_in_any_unit(factor):
    """In doubles a sum of gaps in another unit may lie below their sum in that unit."""
    rounded = 0
    for gaps in np.random.default_rng(0).uniform(0.1, 2.0, (40, 5)):
        made = PeriodicSchedule(gaps * factor, first=gaps.sum() * factor)
        assert made.first <= made.period
        np.testing.assert_allclose(made.times, PeriodicSchedule(gaps, first=gaps.sum()).times * factor, rtol=1e-15)
        rounded += gaps.sum() * factor > made.period
    assert rounded
    with pytest.raises(ArgumentError, match="`first` must lie in"):
        PeriodicSchedule(gaps, first=gaps.sum() * (1 + 1e-12))
