"""What is known at the time: which results are in when, and what does not fit."""

from dataclasses import replace

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule, guaranteed_accuracy
from sampling_design.errors import ArgumentError
from sampling_design.schedules.sensor import Sensor

WALK = Plant([[0.0]], [[1.0], [1.0]], states=["level"], outputs=["gauge", "lab"])


def terms(gauge, lab):
    """Noise bound and delay of each sensor."""
    pairs = zip(("gauge", "lab"), (gauge, lab), strict=True)
    return {name: Sensor(noise_bound=size, result_delay=delay) for name, (size, delay) in pairs}


BOTH = PeriodicSchedule.from_times([0.0], 1.0, [[1, 1]], output_names=["gauge", "lab"])


@pytest.mark.parametrize("unit", [1.0, 1e-9, 1e9])
@pytest.mark.parametrize(("gauge", "lab"), [(0.0, 0.5), (0.25, 3.25), (2.0, 2.0)])
def test_the_quick_and_the_exact_one_are_weighed_at_each_time(unit, gauge, lab):
    """For x' = w the error is the least of v_i + w times the age of the latest result of either."""
    slow = PeriodicSchedule.from_times([0.0], unit, [[1, 1]], output_names=["gauge", "lab"])
    given = {"w_bound": 0.1 / unit, "v_bound": terms((0.3, gauge * unit), (0.02, lab * unit))}
    found = guaranteed_accuracy(WALK, slow, **given)
    ends = np.unique(np.mod([gauge, lab], 1.0))
    at = np.append(ends, 1.0 + ends[0])[1:]  # just before each result comes
    left = [min(v + 0.1 * (t + np.ceil(r - t + 1e-9)) for v, r in ((0.3, gauge), (0.02, lab))) for t in at]
    assert found.verify()
    assert np.allclose([found.lower[0], found.upper[0]], max(left), rtol=2e-3)


def test_a_finite_schedule_says_what_is_in_by_its_end():
    given = {"w_bound": 0.1, "initial_error": 1.0, "start": -1.0}
    noise = terms((0.3, None), (0.02, (0.5, 1.5)))
    dated = Schedule([0.0, 1.0], [[1, 1], [0, 1]], output_names=["gauge", "lab"])
    found = guaranteed_accuracy(WALK, dated, v_bound=noise, **given)
    assert found.question.end == 2.5
    assert found.verify()
    at = [float(found.profile.upper[0, np.searchsorted(found.profile.edges, t - 1e-6) - 1]) for t in (0.0, 1.5, 2.5)]
    assert at == pytest.approx([1.1, 0.45, 0.27], rel=5e-3)
    assert "results come after" in str(found)
    assert "1.5 s (lab)" in found.explain()
    assert found.to_dict()["result_delay"] == {"gauge": 0.0, "lab": 1.5}
    alone = guaranteed_accuracy(WALK, dated.between(-0.5, 0.5), end=2.5, v_bound=[0.3, 0.02], **given)
    without = alone.profile.upper[0, np.searchsorted(alone.profile.edges, 2.5 - 1e-6) - 1]
    assert at[-1] == pytest.approx(without, rel=5e-3)  # until the second result comes


def test_what_grows_while_results_are_out_proves_itself():
    """Gains are put in again over the samples that they are of, and over no more."""
    plant = Plant([[1.5, 1.0], [0.0, -0.5]], [[1.0, 0.0], [1.0, 1.0]], G=[[1.0], [1.0]], outputs=["gauge", "lab"])
    dated = PeriodicSchedule.from_times([0.0, 0.4], 1.0, [[1, 1], [0, 1]], output_names=["gauge", "lab"])
    found = guaranteed_accuracy(plant, dated, w_bound=0.1, v_bound=terms((0.1, 0.4), (0.02, 2.7)))
    assert found.verify()
    assert not replace(found, upper=found.upper * 0.999).verify()


def test_bounds_that_are_not_about_0_shift_what_is_known_at_the_time():
    """For x' = w in [.05, .15] the middle of what is known of age 1.5 lies 1.5 times .1 after the reading."""
    dated = PeriodicSchedule.from_times([0.0], 1.0, [[0, 1]], output_names=["gauge", "lab"])
    found = guaranteed_accuracy(WALK, dated, w_bound={"w1": (0.05, 0.15)}, v_bound=terms((0.3, None), (0.02, 0.5)))
    assert found.verify()
    assert found.upper[0] == pytest.approx(0.02 + 0.05 * 1.5, rel=2e-3)
    assert found.offset[0] == pytest.approx(0.1 * 1.5, rel=2e-3)


@pytest.mark.parametrize(
    ("delay", "said"),
    [
        (-1.0, "`result_delay` must not be negative"),
        ((2.0, 1.0), r"`result_delay` must be \(least, most\), got \(2.0, 1.0\): the least is more"),
        ((1.0, 2.0, 3.0), r"`result_delay` must be a number or a pair \(least, most\)"),
        (np.inf, "`result_delay` must be"),
    ],
)
def test_what_does_not_fit_is_refused(delay, said):
    with pytest.raises(ArgumentError, match=said):
        terms((0.1, 0.0), (0.1, delay))


def test_a_sensor_that_is_none_is_refused():
    noise = {"labb": Sensor(noise_bound=0.1, result_delay=1.0)}
    with pytest.raises(ArgumentError, match="unknown key 'labb' in `v_bound`"):
        guaranteed_accuracy(WALK, BOTH, w_bound=0.1, v_bound=noise)


def test_a_first_sample_at_the_start_may_come_late():
    """Before its result is in, what is known is the start and what the disturbance did to it since."""
    found = guaranteed_accuracy(
        WALK, Schedule([0.0, 1.0], [[0, 1], [0, 1]], output_names=["gauge", "lab"]), w_bound=0.1,
        v_bound=terms((0.3, 0.0), (0.02, 0.5)), initial_error=1.0, start=0.0, end=2.0,
    )  # fmt: skip
    assert found.verify()
    assert found.upper[0] == pytest.approx(1.0 + 0.1 * 0.5, rel=2e-3)


def test_times_in_a_refusal_have_digits_enough_to_be_told_apart():
    at = 1.7e9
    with pytest.raises(
        ArgumentError, match=r"`end` not before 1700000001\.5, when the last result is in, got 1700000000 "
    ):
        guaranteed_accuracy(
            WALK, Schedule([at, at + 1], [[0, 1], [0, 1]], output_names=["gauge", "lab"]), w_bound=0.1,
            v_bound=terms((0.3, 0.0), (0.02, 0.5)), initial_error=1.0, start=at, end=at + 1.25,
        )  # fmt: skip


def test_what_bounds_nodes_of_which_results_are_out_is_found_when_it_is_asked_for():
    found = guaranteed_accuracy(WALK, BOTH, w_bound=0.1, v_bound=terms((0.3, 0.25), (0.02, 3.25)))
    system, bounds = found.question.filter_bounds(WALK)
    assert len(bounds) == len(system.samples) > len(system)
    assert [each.reach for each in bounds] == [each.reach for each in bounds[:]]
    assert all(np.all(each.reach > 0) for each in bounds)
