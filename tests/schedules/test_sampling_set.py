from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sampling_design import ArgumentError, PeriodicSchedule, Schedule
from sampling_design.schedules.sampling_set import SamplingSet
from tests.oracles import schedules as oracle

eighths = st.integers(1, 40).map(lambda k: k / 8)  # exact in binary, so that sets can be compared exactly


@given(st.integers(0, 40), st.lists(eighths, min_size=0, max_size=9))
def test_sets_of_a_finite_schedule_follow_the_definition(first, later):
    gaps = [first / 8, *later]
    K = SamplingSet(Schedule.from_gaps(gaps))
    expected = oracle.sets_by_definition(gaps, len(gaps))
    assert K.distinct == len(gaps)
    for i in range(1, len(gaps) + 1):
        assert [Fraction(t) for t in K.starting_at(i).times.tolist()] == expected[i - 1]
        assert K.gap(i) == gaps[i - 1]
    assert K.d_max == max(gaps)
    assert K.min_gap == min(gaps[1:], default=np.inf)


@given(st.lists(eighths, min_size=1, max_size=5), st.integers(0, 40))
def test_sets_of_a_periodic_schedule_follow_the_definition(gaps, first):
    first = min(first / 8, sum(gaps))
    K = SamplingSet(PeriodicSchedule(gaps, first))
    n = len(gaps)
    d = [first, *(gaps[i % n] for i in range(1, 8 * n))]
    for i, exact in enumerate(oracle.sets_by_definition(d, 2 * n + 1), start=1):
        ours = K.starting_at(i).between(0.0, float(exact[n])).times.tolist()
        assert [Fraction(t) for t in ours] == [t for t in exact if t <= exact[n]]
        assert K.gap(i) == d[i - 1]
    assert K.d_max == max(d)
    assert K.min_gap == min(d[1:])


def test_later_sets_are_the_first_one_retimed():
    K = SamplingSet(Schedule([0.25, 1.0, 1.5, 4.0]))
    times = K.schedule.times
    for i in (2, 3, 4):
        np.testing.assert_array_equal(K.starting_at(i).times, times[i - 1 :] - times[i - 2])


@pytest.mark.parametrize(
    ("gaps", "first", "distinct"),
    [
        ([1.0, 2.0, 4.0], None, 3),
        ([1.0, 2.0, 1.0, 2.0], None, 2),
        ([1.0], None, 1),
        ([1.0, 2.0], 0.5, 3),
        ([1.0], 0.0, 2),
    ],
)
def test_a_periodic_sequence_has_one_set_per_sample_of_its_least_period(gaps, first, distinct):
    K = SamplingSet(PeriodicSchedule(gaps, first))
    assert K.distinct == distinct
    seen = {tuple(K.starting_at(i).between(0.0, 50.0).times.tolist()) for i in range(1, 3 * len(gaps) + 2)}
    assert len(seen) == distinct


def test_units_of_time_change_no_number_of_sets():
    factors = 10.0 ** np.random.default_rng(0).uniform(-9, 9, 200)
    for gaps, distinct in (
        ([0.5, 1.1], 2),
        ([0.3, 0.7, 0.3, 0.7], 2),
        ([0.7, 0.7, 0.7], 1),
        ([0.7, 0.7 * (1 + 1e-12)], 2),
    ):
        first = PeriodicSchedule(gaps)
        moved = (PeriodicSchedule.from_times(c * first.times, c * first.period) for c in factors)
        assert {SamplingSet(schedule).distinct for schedule in moved} == {distinct}


def test_outputs_turn_with_the_samples():
    mask = [[1, 0], [0, 1], [1, 1]]
    K = SamplingSet(PeriodicSchedule([1.0, 2.0, 3.0], outputs=mask))
    np.testing.assert_array_equal(K.starting_at(2).outputs, [[False, True], [True, True], [True, False]])
    finite = SamplingSet(Schedule([1.0, 2.0, 4.0], outputs=mask))
    np.testing.assert_array_equal(finite.starting_at(3).outputs, [[True, True]])
    assert SamplingSet(PeriodicSchedule([1.0, 1.0], outputs=[[1, 0], [0, 1]])).distinct == 2


def test_the_origin_of_a_set_is_left_out_and_the_first_gap_may_be_zero():
    K = SamplingSet(PeriodicSchedule([1.0], 0.0))
    assert K.starting_at(1).between(0.0, 2.0).times.tolist() == [0.0, 1.0, 2.0]
    assert K.starting_at(2).between(0.0, 2.0).times.tolist() == [1.0, 2.0]


@given(st.lists(eighths, min_size=1, max_size=6), st.integers(0, 80))
def test_kappa_is_the_fullest_closed_window(gaps, window):
    T = window / 8
    times = Schedule.from_gaps(gaps).times.tolist()
    assert SamplingSet(Schedule(times)).kappa(T) == oracle.largest_count(times, T)
    periodic = PeriodicSchedule(gaps)
    unrolled = periodic.between(0.0, 2 * periodic.period + T).times.tolist()
    assert SamplingSet(periodic).kappa(T) == oracle.largest_count(unrolled, T)


def test_kappa_of_equal_gaps_is_the_closed_form_and_errs_on_the_large_side():
    assert SamplingSet(PeriodicSchedule([1.0])).kappa(2.5) == 3
    assert SamplingSet(PeriodicSchedule([1.0])).kappa(3.0) == 4
    # ten gaps of 0.1 fill 1.0 up to rounding, at whichever sample the window begins
    assert SamplingSet(PeriodicSchedule([0.1])).kappa(1.0) == 11
    assert SamplingSet(Schedule(np.arange(1, 200) * 0.1)).kappa(1.0) == 11


def test_kappa_grows_without_bound_where_samples_cluster():
    """E26: clusters of N = 4/delta^2 samples at k pi keep sigma and break any bound on kappa."""
    counts = []
    for delta in (0.4, 0.2, 0.1):
        cluster = np.linspace(0.0, delta, round(4 / delta**2))
        counts.append(SamplingSet(Schedule(np.concatenate([k * np.pi + cluster for k in range(4)]))).kappa(np.pi / 2))
    assert counts == [25, 100, 400]


def test_bad_input():
    with pytest.raises(ArgumentError, match=r"Did you pass times\? Use Schedule\(times\)"):
        SamplingSet([1.0, 2.0])
    with pytest.raises(ArgumentError, match="must have at least one sample, got none"):
        SamplingSet(Schedule([]))
    K = SamplingSet(Schedule([1.0, 2.0]))
    with pytest.raises(ArgumentError, match="`i` must be at most 2, the number of samples, got 3"):
        K.starting_at(3)
    with pytest.raises(ArgumentError, match="`i` must be a whole number of at least 1, got 0"):
        K.gap(0)
    with pytest.raises(ArgumentError, match="`T` must not be negative"):
        K.kappa(-1.0)


def test_record_speaks():
    K = SamplingSet(PeriodicSchedule([1.0, 2.0]))
    assert repr(K) == "SamplingSet(first=1, d_max=2, min_gap=1, distinct=2)"
    assert K.explain() == "2 different sets K_i; the longest gap is 2, the shortest after the first sample 1."
