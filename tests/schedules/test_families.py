from itertools import islice, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sampling_design import ArgumentError, GapRange, Jitter, LostSamples, PeriodicSchedule, Schedule, SpacedWindows
from sampling_design.errors import InfeasibleRequirementError
from sampling_design.schedules.family import START, SamplingFamily
from sampling_design.schedules.files import family_from_dict
from sampling_design.schedules.output_jitter import OutputJitter
from sampling_design.schedules.sampling_set import SamplingSet
from tests.cases import few
from tests.oracles import schedules as oracle

eighths = st.integers(1, 24).map(lambda k: k / 8)

FAMILIES = [
    SpacedWindows(4.0, 2, 0.5),
    SpacedWindows(1.0, 1, 1.0),
    SpacedWindows(0.7, 7, 0.1),
    SpacedWindows(2.0, 3, 0.25, time_unit="h"),
    GapRange(0.5, 2.5),
    GapRange(1.0, 1.0, time_unit="d"),
    Jitter(PeriodicSchedule([1.0, 2.0, 1.5]), 0.45),
    Jitter(PeriodicSchedule([1.0], 0.0), 0.2),
    Jitter(Schedule([0.5, 1.0, 3.0], [[1, 0], [1, 1], [0, 1]]), 0.1),
    OutputJitter(PeriodicSchedule([1.0, 2.0], outputs=[[1, 1], [0, 1]]), [0.2, 0.1], [0.0, 0.7]),
    OutputJitter(Schedule([0.5, 1.0, 3.0], [[1, 0], [1, 1], [0, 1]]), [0.1, 0.0], [0.2, 0.3]),
    LostSamples(PeriodicSchedule([0.1]), 2, 5),
    LostSamples(PeriodicSchedule([1.0, 2.0], outputs=[[1, 0], [0, 1]]), 1, 2),
    LostSamples(Schedule([0.5, 1.0, 3.0, 4.0]), 1, 3),
    LostSamples(PeriodicSchedule([1.0, 0.5], 1.5, [[1, 0], [0, 1]]), 1, 2),  # first as late as it can be
    Jitter(PeriodicSchedule([1.0, 0.5], 1.5), 0.2),
    OutputJitter(PeriodicSchedule([1.0, 0.5], 1.5, [[1, 0], [0, 1]]), [0.2, 0.1], [0.0, 0.2]),
]
IDS = [f"{type(f).__name__}{i}" for i, f in enumerate(FAMILIES)]


@pytest.mark.parametrize("family", FAMILIES, ids=IDS)
def test_every_family_keeps_the_protocol(family):
    assert isinstance(family, SamplingFamily)
    assert family.contains(family.nominal)
    rng = np.random.default_rng(3)
    for _ in range(30):
        schedule = family.draw(rng)
        assert family.contains(schedule)
        K = SamplingSet(schedule)
        assert K.min_gap >= family.min_gap * (1 - 1e-12)
        assert K.d_max <= family.d_max * (1 + 1e-12)
    if family.nominal.endless:
        assert all(family.contains(suspect) for suspect in islice(family.suspects([1.3, 2.9], rng), 200))
    assert family.explain()
    assert str(family)


@pytest.mark.parametrize("family", FAMILIES, ids=IDS)
def test_a_seed_decides_a_draw_and_the_default_is_seed_zero(family):
    first = family.draw(np.random.default_rng(0))
    np.testing.assert_array_equal(first.times, family.draw().times)
    assert first.time_unit == getattr(family, "time_unit", None)


@pytest.mark.parametrize("family", [f for f in FAMILIES if isinstance(f.nominal, PeriodicSchedule)])
def test_a_draw_is_as_long_as_asked(family):
    stop = 12 * family.d_max
    assert family.draw(duration=stop).times[-1] >= stop - 2 * family.d_max
    if not isinstance(family, (LostSamples, OutputJitter)):
        assert len(family.draw(samples=7)) == 7
    for extent in ({"duration": 1e308}, {"samples": 10**18}):
        with pytest.raises(ArgumentError, match="samples or more: at most 1000000 are drawn"):
            SpacedWindows(4.0, 3, 0.5).draw(**extent)
    with pytest.raises(ArgumentError, match="give `duration` or `samples`, not both"):
        family.draw(duration=1e3, samples=3)


@pytest.mark.parametrize("family", FAMILIES, ids=IDS)
def test_plain_data_comes_back(family):
    back = family_from_dict(family.to_dict())
    assert back.to_dict() == family.to_dict()
    np.testing.assert_array_equal(back.draw().times, family.draw().times)


@given(st.lists(eighths, min_size=1, max_size=6), eighths, st.integers(1, 4), st.integers(0, 24))
def test_spaced_windows_judge_every_real_position(gaps, window, count, first):
    spacing = 0.125
    if (count - 1) * spacing > window:
        return
    family = SpacedWindows(window, count, spacing)
    first = min(first / 8, sum(gaps))
    periodic = PeriodicSchedule(gaps, first)
    unrolled = periodic.between(0.0, 3 * periodic.period + window).times.tolist()
    fewest = oracle.least_count(unrolled, window, 2 * periodic.period)
    assert family.contains(periodic) == (fewest >= count)
    finite = Schedule(unrolled[: len(gaps) + 2])
    if finite.times[-1] < window:
        assert not family.contains(finite)
    else:
        fewest = oracle.least_count(finite.times.tolist(), window, finite.times[-1] - window)
        assert family.contains(finite) == (fewest >= count)


def test_spaced_windows_see_the_dip_just_after_a_departure():
    """E21: windows at samples only hold two; just after a sample has left, one."""
    family = SpacedWindows(1.0, 2, 0.5)
    integers = PeriodicSchedule([1.0])
    assert all(integers.window(t, 1.0).times.size == 2 for t in range(2, 8))
    assert integers.window(5.5, 1.0).times.size == 1
    assert not family.contains(integers)


def test_spaced_windows_at_their_border():
    family = SpacedWindows(0.3, 3, 0.1)
    assert family.contains(PeriodicSchedule([0.1]))  # 0.1 + 0.1 + 0.1 > 0.3 in binary
    assert not family.contains(PeriodicSchedule([0.1 * (1 + 1e-9)]))
    assert not family.contains(PeriodicSchedule([0.1 * (1 - 1e-9)]))  # spacing
    assert not SpacedWindows(4.0, 2, 0.5).contains(PeriodicSchedule([1.0], 0.9).between(0.0, 3.9))
    late = SpacedWindows(2.0, 2, 0.5)
    assert late.contains(PeriodicSchedule([1.0, 1.0]))
    assert not late.contains(PeriodicSchedule([1.0, 1.0], 2.0))  # the window [0, 2] holds one sample
    assert not late.contains(Schedule([]))


def test_a_spacing_that_fills_no_window_is_refused_and_says_what_fits():
    """E37: Theorem 17 as printed speaks of an empty set of schedules, and a minimum over it bounds nothing."""
    window, count, spacing = 1.0, 4, 0.5
    slots = [s for s in np.arange(0.0, window + 0.25, 0.25) if s <= window]
    inside = [s for s in slots if s + (count - 1) * spacing <= window]
    assert inside == []  # printed: choose k times in the window, spacing apart: there are none
    with pytest.raises(
        InfeasibleRequirementError, match=r"apart need 1.5, and 2 in an endless schedule, more.*window of at least 2,"
    ) as caught:
        SpacedWindows(window, count, spacing)
    assert caught.value.obstacle == "spacing"
    for change in caught.value.nearest:
        repaired = {"window": window, "count": count, "spacing": spacing} | {change: caught.value.nearest[change]}
        family = SpacedWindows(**repaired)
        assert family.has_endless
        assert family.contains(family.nominal)


def test_one_window_may_be_filled_where_no_endless_schedule_is():
    family = SpacedWindows(1.0, 2, 0.75)
    assert not family.has_endless
    assert family.contains(Schedule([0.0, 1.0]))
    with pytest.raises(InfeasibleRequirementError, match=r"an endless schedule needs 2 gaps of 0.75"):
        _ = family.nominal
    with pytest.raises(InfeasibleRequirementError, match=r"just after a sample, 1.5 in all"):
        family.draw()
    with pytest.raises(InfeasibleRequirementError, match=r"spacing at most 1, or a window of at least 3.$"):
        SpacedWindows(1.0, 1, 3.0).draw()


def test_gap_range_judges_first_sample_and_gaps():
    family = GapRange(0.5, 1.5)
    assert family.contains(PeriodicSchedule([0.5, 1.5], 0.0))
    assert family.contains(Schedule([0.0]))
    assert not family.contains(Schedule([1.6, 2.6]))
    assert not family.contains(PeriodicSchedule([0.5, 1.51]))
    assert not family.contains(Schedule([0.5, 0.9]))
    assert not family.contains(Schedule([]))
    assert GapRange(0.1, 0.1).contains(Schedule(np.arange(1, 100) * 0.1))


def test_a_family_with_a_unit_converts_the_schedule():
    family = GapRange(18.0, 30.0, time_unit="h")
    assert family.contains(PeriodicSchedule([1.0], time_unit="d"))
    assert not family.contains(PeriodicSchedule([2.0], time_unit="d"))
    assert family.contains(PeriodicSchedule([20.0]))


def test_jitter_follows_sample_by_sample():
    family = Jitter(PeriodicSchedule([1.0]), 0.1)
    assert family.contains(Schedule([1.1, 1.9, 3.1]))
    assert not family.contains(Schedule([1.1, 2.11]))
    assert not family.contains(Schedule([2.0, 3.0]))
    assert not family.contains(Schedule([]))
    # deviations add up where the pace differs, however slightly
    assert not family.contains(PeriodicSchedule([1.0 + 1e-9]))
    assert family.contains(PeriodicSchedule([1.1, 0.9, 1.0]))
    assert not Jitter(Schedule([1.0, 2.0]), 0.1).contains(PeriodicSchedule([1.0]))
    assert not Jitter(Schedule([1.0, 2.0]), 0.1).contains(Schedule([1.0]))
    assert not Jitter(PeriodicSchedule([1.0], outputs=[[1, 0]]), 0.1).contains(PeriodicSchedule([1.0]))
    assert Jitter(PeriodicSchedule([1.0], outputs=[[1, 1]]), 0.1).contains(PeriodicSchedule([1.0]))
    long = PeriodicSchedule(np.full(1009, 1.0)), PeriodicSchedule(np.full(1013, 1.0))
    with pytest.raises(ArgumentError, match="1013 samples a period against 1009 nominal ones meet too late"):
        Jitter(long[0], 0.1).contains(long[1])


@pytest.mark.parametrize("level", [-1, 4, 10**300])
def test_a_level_of_memory_that_there_is_not_is_refused(level):
    for family in (Jitter(PeriodicSchedule([1.0]), 0.1), OutputJitter(PeriodicSchedule([1.0]), [0.1], [0.2])):
        with pytest.raises(ArgumentError, match="`memory` must be "):
            family.steps(level, 1)


def test_each_output_is_held_against_its_own_times():
    family = OutputJitter(PeriodicSchedule([1.0], first=0.5), [0.0, 0.1], [0.2, 0.1])
    a, b = [1, 0], [0, 1]
    assert family.contains(Schedule([0.4, 0.7, 1.5, 1.6], [b, a, a, b]))
    assert family.contains(Schedule([0.5, 1.5], [[1, 1], [1, 1]]))
    assert family.contains(Schedule([0.5]))  # a piece: b may still come
    assert family.contains(Schedule([0.5], [a]))
    assert not family.contains(Schedule([0.4, 0.7], [a, b]))
    assert not family.contains(Schedule([0.7, 1.5], [a, a]))  # b was due by 0.6
    assert not family.contains(Schedule([0.5, 0.6, 0.65], [a, b, b]))
    assert not family.contains(Schedule([0.5], [[1, 1, 1]]))
    assert not family.contains(Schedule([]))
    assert family.contains(PeriodicSchedule([0.9, 0.1], 0.5, [a, b]))
    assert not family.contains(PeriodicSchedule([1.0], 0.5, [a]))
    whole = OutputJitter(Schedule([0.5, 1.5], [a, b]), [0.1, 0.1], [0.1, 0.1])
    assert not whole.contains(Schedule([0.5], [a]))
    assert not whole.contains(Schedule([0.5, 1.5], [a, a]))
    one = OutputJitter(PeriodicSchedule([1.0], 0.5, [a]), [0.1, 0.1], [0.1, 0.1])
    assert one.contains(PeriodicSchedule([1.0], 0.6, [a]))
    assert not one.contains(PeriodicSchedule([1.0], 0.6, [[1, 1]]))  # b is never planned


@pytest.mark.parametrize(
    ("early", "late", "words"),
    [
        ([0.1], [0.1], "`early` must say it for each output: the schedule has 2 outputs, got 1"),
        ([], [], "`early` must say it for each output"),
        ([0.1, 0.1], [0.1], "`late` must have 2 entries, got 1"),
        ([0.1, -0.1], [0.1, 0.1], r"`early\[1\]` must not be negative"),
        ([0.6, 0.1], [0.1, 0.4], "together less than the least gap 1"),
        ([0.0, 0.9], [0.0, 0.0], r"first sample at 0\.2 cannot be so much earlier than late: plan it at 0\.45"),
    ],
)
def test_tolerances_that_do_not_fit_are_refused(early, late, words):
    with pytest.raises(ArgumentError, match=words):
        OutputJitter(PeriodicSchedule([1.0], 0.2, [[1, 1]]), early, late)


def test_lost_samples_count_among_neighbours():
    nominal = PeriodicSchedule([1.0])
    family = LostSamples(nominal, 1, 3)
    assert family.contains(PeriodicSchedule([1.0, 2.0]))
    assert not family.contains(PeriodicSchedule([2.0]))
    assert not family.contains(PeriodicSchedule([1.0, 2.0], 3.0))  # the first two are lost
    assert not family.contains(PeriodicSchedule([1.0, 1.5]))  # no nominal sample there
    assert not family.contains(PeriodicSchedule([np.pi]))
    assert not family.contains(Schedule([1.5]))
    assert not family.contains(Schedule([0.5]))
    assert not family.contains(Schedule([]))
    assert family.contains(Schedule([2.0, 3.0, 5.0]))
    assert family.d_max == 2.0
    assert not LostSamples(Schedule([1.0, 2.0]), 0, 1).contains(nominal)
    assert not LostSamples(Schedule([1.0, 2.0]), 0, 1).contains(Schedule([1.0]))  # the second is lost
    # a period that fits the nominal one only after several periods, and times that carry rounding
    assert LostSamples(PeriodicSchedule([0.1]), 2, 3).contains(PeriodicSchedule([0.3]))
    assert not LostSamples(PeriodicSchedule([0.1]), 1, 3).contains(PeriodicSchedule([0.3]))
    masked = LostSamples(PeriodicSchedule([1.0], outputs=[[1, 0]]), 1, 3)
    assert not masked.contains(PeriodicSchedule([1.0, 2.0]))
    assert masked.contains(PeriodicSchedule([1.0, 2.0], outputs=[[1, 0], [1, 0]]))


def test_even_with_everything_lost_one_sample_stays():
    assert len(LostSamples(Schedule([1.0]), 1, 2).draw(np.random.default_rng(5))) == 1


def test_bad_input():
    with pytest.raises(ArgumentError, match="`window` must be positive"):
        SpacedWindows(0.0, 1, 0.1)
    with pytest.raises(ArgumentError, match="`count` must be a whole number of at least 1"):
        SpacedWindows(1.0, 0, 0.1)
    with pytest.raises(ArgumentError, match="`spacing` must be positive"):
        SpacedWindows(1.0, 2, 0.0)
    with pytest.raises(ArgumentError, match="`time_unit` must be one of"):
        SpacedWindows(1.0, 2, 0.1, time_unit="years")
    with pytest.raises(ArgumentError, match="`time_unit` must be one of"):
        GapRange(1.0, 2.0, time_unit="years")
    with pytest.raises(
        ArgumentError, match=r"`longest` must be at least `shortest` = 2.0, got 1.0. Did you swap them\?"
    ):
        GapRange(2.0, 1.0)
    with pytest.raises(ArgumentError, match="`duration` must be at least the window 4"):
        SpacedWindows(4.0, 2, 0.5).draw(duration=3.0)
    with pytest.raises(ArgumentError, match=r"a Schedule or a PeriodicSchedule, got list .*Did you pass times\?"):
        GapRange(1.0, 2.0).contains([1.0])
    with pytest.raises(
        ArgumentError, match=r"`rng` must be a numpy\.random\.Generator or a whole number, got str 'seven'"
    ):
        GapRange(1.0, 2.0).draw("seven")
    with pytest.raises(ArgumentError, match="`timing_tolerance` must be less than half of the least gap 1"):
        Jitter(PeriodicSchedule([1.0]), 0.5)
    with pytest.raises(ArgumentError, match="are for an endless nominal schedule; this one is finite"):
        Jitter(Schedule([1.0]), 0.5).draw(samples=3)
    with pytest.raises(ArgumentError, match="`most` must be less than `of` = 3, got 3: every sample could be lost"):
        LostSamples(PeriodicSchedule([1.0]), 3, 3)
    with pytest.raises(ArgumentError, match=r"`kind` of a family must be one of .*gap-range, jitter, lost-samples"):
        family_from_dict({"kind": "spaced"})
    with pytest.raises(ArgumentError, match="a family of kind 'gap-range' needs `longest`"):
        family_from_dict({"kind": "gap-range", "shortest": 1.0})
    with pytest.raises(ArgumentError, match=r"unknown key 'longst' .* Did you mean 'longest'"):
        family_from_dict({"kind": "gap-range", "shortest": 1.0, "longst": 2.0})


@pytest.mark.parametrize(("window", "count", "spacing"), [(0.272191, 3, 0.02542), (1.0, 3, 0.1), (7.3, 2, 1.1)])
def test_no_step_of_spaced_windows_is_rounding_alone(window, count, spacing):
    """What a sum of gaps leaves of a cell may be the last digit of its border, which is the cell before, too."""
    family = SpacedWindows(window, count, spacing)
    for memory in range(family.levels_of_memory):
        steps, words, known = family.steps(memory, 1), [START], {START}
        while words:
            found = steps(words.pop())
            assert all(step.high - step.low > 1e-9 * window for step in found)
            new = {step.word for step in found} - known
            known |= new
            words += new


@pytest.mark.parametrize(("most", "of"), few([(1, 2), (1, 8), (2, 3), (2, 5), (3, 13)], 0, 3))
def test_losses_that_come_again_are_counted_over_as_many_rounds_as_it_takes(most, of):
    """However many periods `of` samples take: as if all of these were written out."""
    nominal = PeriodicSchedule([1.0])
    for count in range(1, 8):
        for kept in product([False, True], repeat=count):
            if any(kept):
                member = PeriodicSchedule.from_times(1.0 + np.flatnonzero(kept), float(count))
                lost = ~np.tile(kept, of + 1)
                worst = max(int(lost[k : k + of].sum()) for k in range(count))
                assert LostSamples(nominal, most, of).contains(member) == (worst <= most)
                assert LostSamples(nominal, 1, 10**12).contains(member) == all(kept)
