"""How early or late samples may be: one number, early apart from late, or each output by itself."""

import functools
import inspect

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance, moved


@pytest.mark.parametrize(
    ("said", "shift", "radius", "words"),
    [
        (0.2, 0.0, 0.2, "up to 0.2 s early or late"),
        ((0.1, 0.3), 0.1, 0.2, "up to 0.1 s early or up to 0.3 s late"),
        ([0.0, 0.4], 0.2, 0.2, "up to 0.4 s late"),
        ({"a": 0.2, "b": (0.0, 0.4)}, 0.1, 0.3, "up to 0.2 s early or late (a), up to 0.4 s late (b)"),
        ({"a": 0.2, "b": 0.0}, 0.0, 0.2, "up to 0.2 s early or late (a), on time (b)"),
    ],
)
def test_every_real_time_lies_within_the_radius_of_the_centre(said, shift, radius, words):
    late = TimingTolerance.of(said)
    assert (late.shift, late.radius) == pytest.approx((shift, radius))
    for early, after in zip(late.early, late.late, strict=True):
        assert -early <= late.shift <= after  # the centre is a time that all allow
        assert max(early + late.shift, after - late.shift) <= late.radius + 1e-12
    assert np.all(late.back >= 0)
    assert np.all(late.forward >= 0)
    assert late.back - late.radii == pytest.approx(-late.offsets)
    assert late.describe("s") == words
    assert TimingTolerance.of(late.plain) == late
    assert late.scaled(60.0).radius == pytest.approx(60 * late.radius)
    assert late
    assert not ON_TIME


@pytest.mark.parametrize(
    ("said", "words"),
    [
        (-0.1, "`timing_tolerance` must not be negative"),
        ((0.1, -0.1), r"`timing_tolerance\[1\]` must not be negative"),
        ((0.1, 0.1, 0.1), r"must be one number or two, \(early, late\), got 3 numbers"),
        ({"a": "x"}, "`timing_tolerance.a`"),
    ],
)
def test_what_is_no_tolerance_is_refused(said, words):
    with pytest.raises(ArgumentError, match=words):
        TimingTolerance.of(said)


PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], time_unit="min")
EVERY, BOUNDS = sd.PeriodicSchedule([1.0], time_unit="min"), {"w_bound": 0.1, "v_bound": 0.1}
CERTIFICATE = functools.cache(lambda: sd.certify(PLANT, EVERY, eta=0.4, P2=np.eye(2)))
SAID = {
    "window_sigma": lambda late: sd.window_sigma(PLANT, EVERY, 4.0, timing_tolerance=late).lower,
    "worst_case_sigma": lambda late: (
        sd.worst_case_sigma(PLANT, sd.SpacedWindows(4.0, 3, 0.5), timing_tolerance=late, rtol=0.5).timing_tolerance
    ),
    "guaranteed_accuracy": lambda late: (
        sd.guaranteed_accuracy(PLANT, EVERY, timing_tolerance=late, rtol=0.5, **BOUNDS).timing_tolerance
    ),
    "certify": lambda late: sd.certify(PLANT, EVERY, timing_tolerance=late, eta=0.4, P2=np.eye(2)).family.to_dict(),
    "MovingHorizonEstimator": lambda late: repr(
        sd.MovingHorizonEstimator(PLANT, CERTIFICATE(), timing_tolerance=late, **BOUNDS)
        .run([(1.05, [0.1]), (2.2, [0.2])])
        .estimates[-1]
        .on_schedule
    ),
    "Requirement": lambda late: sd.Requirement(window=4.0, timing_tolerance=late, time_unit="min").timing_tolerance,
    "PlanRequirement": lambda late: (
        sd.PlanRequirement(accuracy={"x1": 1.0}, timing_tolerance=late, time_unit="min").early_or_late("min").plain
    ),
}


def test_every_name_of_the_front_door_that_takes_one_is_judged_below():
    takes = {name for name in dir(sd) if "timing_tolerance" in parameters(getattr(sd, name))}
    assert takes - {"Jitter"} == set(SAID)  # a family holds the number that its file says


def parameters(thing):
    try:
        return inspect.signature(thing).parameters
    except (TypeError, ValueError):
        return ()


@pytest.mark.parametrize("verb", SAID)
def test_text_with_a_unit_says_what_a_number_does_everywhere(verb):
    assert SAID[verb]("6 s") == SAID[verb](0.1)
    with pytest.raises(ArgumentError, match=r"`timing_tolerance` must be a time like 0\.25 or .15 min., got 'soon'"):
        SAID[verb]("soon")


def test_families_are_about_the_centre():
    family = sd.Jitter.around(sd.PeriodicSchedule([1.0, 0.7]), TimingTolerance.of((0.1, 0.3)))
    assert family.contains(sd.PeriodicSchedule([1.0, 0.7], first=1.3))
    assert family.contains(sd.PeriodicSchedule([1.0, 0.7], first=0.9))
    assert not family.contains(sd.PeriodicSchedule([1.0, 0.7], first=0.85))
    with pytest.raises(ArgumentError, match="fall apart, and a family of schedules is of samples"):
        sd.Jitter.around(sd.PeriodicSchedule([1.0]), TimingTolerance.of({"y1": 0.1, "y2": 0.2}))
    one = sd.Jitter.around(sd.PeriodicSchedule([1.0]), TimingTolerance.of({"y1": (0.0, 0.2)}))
    assert one.to_dict() == sd.Jitter.around(sd.PeriodicSchedule([1.0]), TimingTolerance.of((0.0, 0.2))).to_dict()
    with pytest.raises(ArgumentError, match="early and late, together less than the least gap 1"):
        sd.window_sigma(sd.Plant([[0.0]], [[1.0]]), sd.PeriodicSchedule([1.0]), 9.0, timing_tolerance=(0.3, 0.9))


@pytest.mark.parametrize("by", [0.3, -0.3, 0.0])
def test_a_moved_schedule_has_its_samples_later(by):
    for schedule in (sd.PeriodicSchedule([1.0]), sd.PeriodicSchedule([0.5, 0.7], first=1.2), sd.Schedule([0.5, 1.0])):
        later = moved(schedule, by)
        assert later.between(0, 9).times == pytest.approx((schedule.between(0, 9 - by)).times + by)
    with pytest.raises(ArgumentError, match=r"first sample at 0 cannot be so much earlier than late: plan it at 0\.3"):
        moved(sd.Schedule([0.0, 1.0]), -0.3)


def test_certificates_hold_for_early_apart_from_late():
    plant, schedule = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), sd.PeriodicSchedule([1.0], first=0.4)
    found = sd.certify(plant, schedule, timing_tolerance=(0.0, 0.1), eta=0.3)
    assert found.verify().passed
    assert found.family.timing_tolerance == 0.05
    assert found.family.contains(sd.PeriodicSchedule([1.0], first=0.5))
    assert found.family.contains(sd.PeriodicSchedule([1.0], first=0.4))


def test_real_times_of_a_rule_for_windows_keep_a_wider_rule():
    rule, wider = sd.SpacedWindows(4.0, 3, 0.5), sd.SpacedWindows(4.3, 3, 0.2)
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    said = sd.worst_case_sigma(plant, rule, timing_tolerance=0.15, rtol=0.1)
    assert said.lower == pytest.approx(sd.worst_case_sigma(plant, wider, rtol=0.1).lower)
    rng = np.random.default_rng(0)
    for _ in range(20):
        planned = rule.draw(rng).times
        real = np.maximum(planned + rng.uniform(-0.15, 0.15, planned.size), 0.0)
        assert wider.contains(sd.Schedule(real))
    box = sd.UncertainPlant(plant, [sd.UncertainParameter("k", 0.0, 0.01, A=[[0.0, 0.0], [1.0, 0.0]], nominal=0.0)])
    wide = sd.worst_case_sigma(box, rule, timing_tolerance=0.15, rtol=0.3)
    assert wide.lower <= said.upper
    with pytest.raises(ArgumentError, match="could change places"):
        sd.worst_case_sigma(plant, rule, timing_tolerance=0.3)


def test_certificates_hold_for_outputs_that_are_read_one_at_a_time():
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), outputs=["a", "b"])
    planned = sd.PeriodicSchedule([1.0, 0.7], first=0.4, outputs=[[True, False], [False, True]])
    late = {"b": 0.02, "a": (0.0, 0.1)}
    found = sd.certify(plant, planned, timing_tolerance=late, eta=0.3, P2=np.eye(2))
    assert found.verify().passed
    assert found.family.timing_tolerance == pytest.approx(0.05)
    assert found.family.schedule.times == pytest.approx([0.45, 1.1])
    for a in (0.0, 0.1):
        for b in (-0.02, 0.02):
            times = planned.times + np.array([a, b])
            assert found.family.contains(sd.PeriodicSchedule.from_times(times, 1.7, planned.outputs))
    early = sd.PeriodicSchedule.from_times(planned.times - np.array([0.02, 0.0]), 1.7, planned.outputs)
    assert not found.family.contains(early)
    both = sd.PeriodicSchedule([1.0, 0.7], first=0.4)
    apart = sd.certify(plant, both, timing_tolerance=late, eta=0.3, P2=np.eye(2))
    assert apart.verify().passed
    assert (apart.family.early.tolist(), apart.family.late.tolist()) == ([0.0, 0.02], [0.1, 0.02])
