"""Samples are held against a schedule one at a time: by differences of time, whatever the clock's zero is."""

from functools import cache

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import (
    GapRange,
    Jitter,
    LostSamples,
    MovingHorizonEstimator,
    PeriodicSchedule,
    Plant,
    Schedule,
    SpacedWindows,
    certify,
)
from sampling_design.accuracy.readings import BelowDetection
from sampling_design.estimators.online import schedule_watch
from sampling_design.estimators.online.schedule_watch import ScheduleWatch
from sampling_design.schedules.output_jitter import OutputJitter

PLANT = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
TWO = Plant(PLANT.A, np.eye(2), outputs=["a", "b"])
TIMES = [0.0, 0.9, 2.0, 3.1]
UNIX = 1.7e9


@pytest.mark.parametrize(
    "schedule", [Schedule(TIMES), PeriodicSchedule.from_times(TIMES, 4.0)], ids=["finite", "periodic"]
)
def test_a_first_sample_at_zero_is_not_due_twice(schedule):
    certificate = certify(PLANT, schedule, eta=0.3, P2=np.eye(2))
    mhe = MovingHorizonEstimator(PLANT, certificate)
    assert [mhe.update(t, [0.0]).on_schedule for t in TIMES] == [True] * 4
    late = MovingHorizonEstimator(PLANT, certificate)
    assert [late.update(t, [0.0]).on_schedule for t in (0.0, 0.9, 2.01)] == [True, True, False]


def followed(schedule, times, prior_time, unit="s", **options):
    """Flags of an estimator that holds a certificate of `schedule` (made where numbers are of size one)."""
    scale = float(np.min(getattr(schedule, "gaps", [1.0])))
    plant = Plant([[0.0, 1 / scale], [-1 / scale, 0.0]], [[1.0, 0.0]], time_unit=unit)
    certificate = certify(plant, schedule, eta=0.3 / scale, P2=np.eye(2))
    mhe = MovingHorizonEstimator(plant, certificate, prior_time=prior_time, **options)
    return [mhe.update(float(t), [0.0]).on_schedule for t in times]


def test_every_second_sample_missing_is_seen_at_unix_time():
    times = UNIX + 1.0 * np.arange(0, 52, 2)
    assert followed(PeriodicSchedule([1.0]), times, UNIX) == [True] + [False] * 25


def test_a_kilohertz_schedule_that_is_kept_is_seen_to_be_kept_at_unix_time():
    times = [float(f"{UNIX + k / 1000:.6f}") for k in range(101)]
    assert followed(PeriodicSchedule([1e-3]), times, UNIX) == [True] * 101
    times[50] += 2e-5
    assert followed(PeriodicSchedule([1e-3]), times, UNIX) == [True] * 50 + [False] * 51


def test_a_window_at_unix_time_keeps_its_length():
    mhe = MovingHorizonEstimator(Plant([[0.0]], [[1.0]]), horizon=5.07e-3, prior_time=UNIX)
    for k in range(1, 30):
        estimate = mhe.update(UNIX + k * 1e-3, [0.0])
    assert estimate.t - estimate.window_start == pytest.approx(5.07e-3, abs=1e-6)


def test_a_person_is_on_schedule_within_the_tolerance_that_was_given():
    schedule, late = PeriodicSchedule([1.0]), np.array([0.0, 0.05, -0.08, 0.02])
    times = 1.0 + np.arange(4) + late
    assert followed(schedule, times, 0.0) == [True, False, False, False]
    assert followed(schedule, times, 0.0, timing_tolerance=0.1) == [True] * 4
    assert followed(schedule, times, 0.0, timing_tolerance=0.06) == [True, True, False, False]


def test_the_jitter_that_a_certificate_allows_counts_for_ever():
    rng, family = np.random.default_rng(0), Jitter(PeriodicSchedule.from_times([0.5, 1.2], 2.0), 0.05)
    watch, times = ScheduleWatch(family, "s"), family.draw(rng, duration=300.0).times
    one = np.ones(1)
    assert watch.sample_fits(np.array([0.0, times[0]]), one, first=True)
    assert all(watch.sample_fits(times[k - 4 : k + 1], one, first=False) for k in range(4, times.size))
    assert not watch.sample_fits(np.array([*times[96:100], times[100] + 0.11]), one, first=False)
    assert not watch.sample_fits(np.array([*times[96:99], times[100]]), one, first=False)


@cache
def read_apart():
    return certify(TWO, OutputJitter(PeriodicSchedule([1.0], 0.5), [0.1, 0.0], [0.1, 0.2]), eta=0.3, P2=np.eye(2))


def flags(samples, prior_time=0.0):
    """Whether each sample (time, outputs read) is on schedule, for an estimator whose certificate is `read_apart`."""
    mhe = MovingHorizonEstimator(TWO, read_apart(), prior_time=prior_time, schedule_zero=prior_time)
    told = [(prior_time + t, [0.0 if on in read else np.nan for on in "ab"]) for t, read in samples]
    return [mhe.update(t, y).on_schedule for t, y in told]


@pytest.mark.parametrize(
    ("samples", "kept"),
    [
        ([(0.4, "a"), (0.7, "b"), (1.5, "b"), (1.6, "a"), (2.5, "ab")], 5),
        ([(0.5, "ab"), (1.5, "b"), (1.5 + 0.1, "a")], 3),
        ([(0.5, "ab"), (1.45, "b")], 1),  # b is never early
        ([(0.5, "ab"), (1.39, "a")], 1),
        ([(0.5, "ab"), (1.65, "ab")], 1),  # a is too late, b is not
        ([(0.5, "ab"), (1.6, "a"), (1.75, "b")], 2),
        ([(0.5, "ab"), (1.5, "a"), (2.4, "a"), (2.5, "b")], 2),  # b was due by 1.7
        ([(0.5, "a"), (1.5, "ab")], 1),
        ([(0.5, "ab"), (1.5, "ab"), (1.55, "a")], 2),  # twice
    ],
)
@pytest.mark.parametrize("zero", [0.0, UNIX])
def test_each_output_is_on_schedule_by_its_own_times(samples, kept, zero):
    assert flags(samples, zero) == [k < kept for k in range(len(samples))]


def test_members_whose_outputs_come_apart_are_on_schedule_and_no_others():
    family, rng = read_apart().family, np.random.default_rng(4)
    member = family.draw(rng, samples=25)
    samples = [
        (t, "".join(n for n, on in zip("ab", row, strict=True) if on))
        for t, row in zip(member.times, member.outputs, strict=True)
    ]
    assert flags(samples) == [True] * len(samples)
    mhe = MovingHorizonEstimator(TWO, read_apart())
    assert mhe.update(0.5, [0.0, 0.0]).on_schedule
    assert mhe.predict(1.59).on_schedule
    assert not mhe.predict(1.61).on_schedule  # a was due


def test_lost_samples_are_counted():
    watch = ScheduleWatch(LostSamples(PeriodicSchedule([1.0]), most=1, of=3), "s")

    def fits(*times):
        return watch.sample_fits(np.array(times), np.ones(1), first=False)

    assert fits(10.0, 11.0, 13.0)
    assert fits(10.0, 12.0, 13.0, 15.0)
    assert not fits(10.0, 12.0, 14.0)
    assert not fits(10.0, 13.0)
    assert not fits(10.0, 11.0, 12.5)
    assert watch.nothing_missed([10.0], 12.0, first=False)
    assert not watch.nothing_missed([10.0], 12.1, first=False)


def test_past_the_end_of_a_finite_schedule_nothing_is_on_it():
    watch, one = ScheduleWatch(Schedule([1.0, 2.0]), "s"), np.ones(1)
    assert watch.sample_fits(np.array([1.0, 2.0]), one, first=False)
    assert not watch.sample_fits(np.array([2.0, 3.0]), one, first=False)
    assert not watch.nothing_missed([2.0], 2.5, first=False)
    assert not ScheduleWatch(Schedule([]), "s").sample_fits(np.array([0.0, 1.0]), one, first=True)


def test_a_family_that_remembers_no_gap_is_asked_for_the_last_one_alone():
    """The answers along a record are those of the whole record so far."""
    family, rng = GapRange(0.5, 1.5), np.random.default_rng(1)
    watch = ScheduleWatch(family, "s")
    assert not family.remembers
    for _ in range(40):
        times = np.cumsum(np.concatenate([[0.0], rng.uniform(0.45, 1.55, 6)])).tolist()
        fits = [watch.sample_fits(times[: k + 1], np.ones(1), k == 1) for k in range(1, 7)]
        whole = [times[1] <= 1.5 and family.contains(Schedule(times[1 : k + 1])) for k in range(1, 7)]
        assert np.logical_and.accumulate(fits).tolist() == whole


def test_rounded_stamps_far_from_zero_keep_a_range_of_gaps():
    """Stamps to a thousandth, whose differences are gaps of the range but for their own rounding."""
    gaps = np.random.default_rng(2).integers(300, 1201, 400) / 1000
    for zero in (1e4, -1e4, -1.7e9):
        times = np.round(zero + np.cumsum(gaps), 3).tolist()
        watch = ScheduleWatch(GapRange(0.3, 1.2), "s")
        assert all(watch.sample_fits(times[: k + 1], np.ones(1), False) for k in range(1, 400))
        assert not watch.sample_fits([*times, times[-1] + 1.2001], np.ones(1), False)


EVERY = PeriodicSchedule([1.0])


@pytest.mark.parametrize(
    "plan",
    [EVERY, Schedule([1.0, 2.0, 3.0]), Jitter(EVERY, 0.1), LostSamples(EVERY, most=1, of=3), GapRange(0.3, 1.2)],
    ids=lambda plan: type(plan).__name__,
)
def test_what_names_no_outputs_plans_every_one(plan):
    watch = ScheduleWatch(plan, "s")
    assert watch.sample_fits([1.0, 2.0], np.ones(2), False)
    assert not watch.sample_fits([1.0, 2.0], np.array([1.0, 0.0]), False)


def test_an_estimate_from_a_sample_without_one_output_keeps_no_claim_of_a_certificate():
    mhe = MovingHorizonEstimator(TWO, certify(TWO, EVERY, eta=0.3, P2=np.eye(2)))
    read = [[0.0, 0.0], [0.0, np.nan], [0.0, 0.0]]
    assert [mhe.update(t, y).on_schedule for t, y in zip([1.0, 2.0, 3.0], read, strict=True)] == [True, False, False]


@pytest.mark.parametrize("zero", [0.0, UNIX])
@pytest.mark.parametrize("seed", range(4))
def test_samples_are_on_schedule_while_the_windows_that_began_can_still_be_filled(seed, zero):
    """Against the windows themselves, those to come filled as soon as may be: drawn members, some with a time moved."""
    T, k, spacing, rng = 3.0, 3, 0.25, np.random.default_rng(seed)
    family = SpacedWindows(window=T, count=k, spacing=spacing)
    watch, times, one = ScheduleWatch(family, "s"), family.draw(rng, samples=12).times.copy(), np.ones(1)
    if seed % 2:
        times[5:] += 0.4
    times = np.concatenate([[0.0], times])

    def may_begin(piece):
        filled = np.append(piece, piece[-1] + spacing * np.arange(1, k + 1))
        windows = np.all(filled[k:] - filled[:-k] <= T + 1e-6)
        return bool(windows and np.all(np.diff(piece[1:]) >= spacing - 1e-6))

    ahead, found = np.arange(0.06, T, 0.1), []
    for n in range(2, len(times) + 1):
        piece, clock = times[:n], zero + times[:n]
        found.append(watch.sample_fits(clock, one, n == 2))
        assert found[-1] == may_begin(piece)
        if not found[-1]:
            break
        said = [watch.nothing_missed(clock, clock[-1] + gap, False) for gap in ahead]
        assert said == [gap < spacing or may_begin(np.append(piece, piece[-1] + gap)) for gap in ahead]
    assert found[-1] != bool(seed % 2)


def test_a_limit_is_no_sample_of_the_schedule_and_disturbs_none():
    """The claim is about numbers: a limit between them takes nothing of it away, one in place of a number does."""
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 2.0}
    made = certify(PLANT, PeriodicSchedule([1.0]), eta=0.4)
    plain, between, instead = (MovingHorizonEstimator(PLANT, made, **bounds) for _ in range(3))
    for t in (1.0, 2.0, 3.0):
        assert plain.update(t, [0.0]).on_schedule
        assert between.update(t, [0.0]).on_schedule
        assert between.update(t + 0.4, [BelowDetection(5.0)]).on_schedule
        found = instead.update(t, [BelowDetection(5.0)] if t == 2.0 else [0.0])
    assert not found.on_schedule


@pytest.mark.parametrize("schedule", [PeriodicSchedule([1.0, 0.7]), Schedule([1.0, 1.7, 2.7]), GapRange(0.6, 1.1)])
def test_the_clock_of_the_schedule_may_show_anything_at_its_zero(schedule):
    for zero in (0.0, 64.0, -8.0, 1.7e9):
        watch = ScheduleWatch(schedule, "s", zero=zero)
        times = [zero, zero + 1.0, zero + 1.7, zero + 2.7]
        fits = [watch.sample_fits(times[: k + 1], np.ones(1), k == 1) for k in (1, 2, 3)]
        assert fits == [True] * 3
        assert not watch.sample_fits([zero + 1.0, zero + 1.45], np.ones(1), False)
        assert watch.nothing_missed([zero + 1.0], zero + 1.6, False)
        assert not watch.nothing_missed([zero + 1.0], zero + 2.2, False)


@pytest.mark.parametrize("schedule", [PeriodicSchedule([1.0]), GapRange(0.9, 1.1)], ids=["plan", "gaps"])
def test_a_sample_is_judged_by_the_last_nodes_however_many_are_kept(schedule, monkeypatch):
    """Of six thousand nodes that were gone through an update took four times as long."""
    plant, looked_at, counts = sd.Plant([[0.0]], [[1.0]]), [], schedule_watch._counts
    certificate = sd.certify(plant, schedule, eta=0.05)
    mhe = sd.MovingHorizonEstimator(plant, certificate=certificate, horizon=100.0, w_bound=1.0, v_bound=1.0)
    monkeypatch.setattr(schedule_watch, "_counts", lambda node: looked_at.append(node) or counts(node))
    found = [mhe.update(float(t), [0.1]) for t in range(1, 100)]
    assert found[-1].on_schedule
    assert len(looked_at) <= 2 * len(found)
