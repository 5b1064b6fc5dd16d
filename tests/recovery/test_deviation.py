"""Standard deviations for white noise: against a plain filter, in the limit, unstable, unknown, finite."""

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.errors import ArgumentError

PLANT = sd.Plant([[0.0, 1.0], [-1.0, -0.2]], [[1.0, 0.0]], states=["position", "velocity"])
SCHEDULE = sd.PeriodicSchedule([0.7, 1.6, 0.9])
W, V = np.array([[0.02, 0.01], [0.01, 0.05]]), 0.3


def stepped(A, W, P, h, steps=400):
    """P flown over h by the trapezoidal rule on a fine grid."""
    F, d = expm(A * h / steps), h / steps
    for _ in range(steps):
        P = F @ (P + W * d / 2) @ F.T + W * d / 2
    return P


def after_periods(A, C, W, v, gaps, count, P):
    """Covariances after each sample of the last of so many periods; a plain filter."""
    for _ in range(count):
        after = []
        for h in gaps:
            K = P @ C.T @ np.linalg.inv(C @ P @ C.T + v**2 * np.eye(len(C)))
            P = P - K @ C @ P
            after.append(P)
            P = stepped(A, W, P, h)
    return after


def test_the_periodic_limit_is_that_of_a_plain_filter():
    found = sd.standard_deviation(PLANT, SCHEDULE, w_intensity=W, v_deviation=V)
    gaps = [1.6, 0.9, 0.7]  # the first sample stands behind the first gap
    after = after_periods(PLANT.A, PLANT.C, W, V, gaps, 12, 10 * np.eye(2))
    for j in range(3):
        at = int(np.flatnonzero(np.isclose(found.times, SCHEDULE.times[j]))[-1])
        assert found.profile[:, at] ** 2 == pytest.approx(np.diag(after[j]), rel=1e-4)
        before = stepped(PLANT.A, W, after[j], gaps[j] * 0.5)
        half = j * 65 + 32
        assert found.profile[:, half] ** 2 == pytest.approx(np.diag(before), rel=1e-4)
    assert np.all(found.worst >= found.profile.max(axis=1) * (1 - 1e-12))
    assert np.all(found.worst <= found.profile.max(axis=1) * (1 + 1e-3))
    assert np.all((found.mean < found.worst) & (found.mean > found.profile.min(axis=1)))


def test_an_unstable_mode_that_no_noise_reaches_is_still_followed():
    """From P = 0 the filter would sleep for ever; the strong solution of P = a^2 P v^2/(P + v^2) is (a^2 - 1) v^2."""
    plant = sd.Plant([[0.5]], [[1.0]], G=[[0.0]])
    found = sd.standard_deviation(plant, sd.PeriodicSchedule([1.0]), w_intensity=1.0, v_deviation=2.0)
    assert found.worst[0] ** 2 == pytest.approx((np.exp(1.0) - 1) * 4.0, rel=1e-5)


def test_a_finite_schedule_starts_from_nothing():
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
    found = sd.standard_deviation(plant, sd.Schedule([0.0, 2.0]), w_intensity=0.0, v_deviation=0.3, end=3.0)
    early = found.times < 2.0
    assert np.all(np.isinf(found.profile[1, early]))
    assert np.all(np.isinf(found.profile[0, early & (found.times > 0)]))
    last = found.profile[:, -1]  # a straight line through two points: (3 y2 - y1)/2 and (y2 - y1)/2
    assert last == pytest.approx([0.3 * np.sqrt(10) / 2, 0.3 * np.sqrt(2) / 2], rel=1e-4)


def test_unknown_rows_are_infinite_and_the_others_are_not():
    plant = sd.Plant(np.zeros((2, 2)), [[1.0, 0.0]], states=["seen", "unseen"])
    found = sd.standard_deviation(plant, sd.PeriodicSchedule([1.0]), w_intensity=[1.0, 1.0], v_deviation=[1.0])
    assert found.worst[0] ** 2 == pytest.approx((1 + np.sqrt(5)) / 2)
    assert np.isinf(found.worst[1])
    assert "infinite" in str(found)
    assert found.to_dict()["worst"][1] is None


def test_it_stands_beside_the_guaranteed_error():
    found = sd.accuracy(
        PLANT, SCHEDULE, w_bound=0.02, v_bound=0.4, of="position", w_intensity=W, v_deviation=V, rtol=0.1
    )
    alone = sd.standard_deviation(PLANT, SCHEDULE, of="position", w_intensity=W, v_deviation=V)
    assert found.deviation.worst == pytest.approx(alone.worst)
    assert "deviation of position" in str(found)
    assert "the best filter's standard deviation is at worst" in found.explain()
    assert found.to_dict()["deviation"]["rows"] == ["position"]


def test_more_samples_average_the_noise():
    seldom, often = (
        sd.standard_deviation(PLANT, sd.PeriodicSchedule([h]), w_intensity=W, v_deviation=V).worst for h in (1.0, 0.25)
    )
    assert np.all(often < 0.85 * seldom)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"w_intensity": None}, "`w_intensity` is missing"),
        ({"v_deviation": None}, "`v_deviation` is missing: give the standard deviation of the noise of y1"),
        ({"w_intensity": [-1.0, 0.0]}, "`w_intensity` must not be negative"),
        ({"w_intensity": [[1.0, 2.0], [2.0, 1.0]]}, "`w_intensity` must be positive semidefinite"),
        ({"v_deviation": [-1.0]}, "`v_deviation` must not be negative"),
    ],
)
def test_bad_input_is_refused(change, match):
    with pytest.raises(ArgumentError, match=match):
        sd.standard_deviation(PLANT, SCHEDULE, **({"w_intensity": W, "v_deviation": V} | change))


def test_a_mode_that_only_the_samples_hide_leaves_other_rows_as_they_are():
    """An oscillation at twice the samples' period beside a level with a sensor of its own."""
    A = np.zeros((3, 3))
    A[0, 1], A[1, 0] = np.pi, -np.pi
    both = sd.Plant(A, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = sd.standard_deviation(both, sd.PeriodicSchedule([1.0, 1.0]), w_intensity=1.0, v_deviation=1.0)
    assert np.isinf(found.worst).tolist() == [True, True, False]
    assert abs(found.worst[2] ** 2 - (1 + 5**0.5) / 2) < 1e-9
