"""Precomputed gains on a periodic schedule: radii hold from the first sample on, and end at the least."""

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.errors import ArgumentError
from tests.cases import few

PLANT = sd.Plant([[0.3, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], B=[[0.0], [1.0]], D=[[0.5]], states=["position", "velocity"])
SCHEDULE = sd.PeriodicSchedule([0.7, 1.6, 0.9])
W, V = 0.02, 0.3


@pytest.fixture(scope="module")
def found():
    return sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=W, v_bound=V)


def flown(plant, x, u, w, h, steps=8):
    """x after h, w constant on pieces."""
    n, joint = plant.n_states, np.zeros((plant.n_states + 1,) * 2)
    for piece in w:
        joint[:n, :n], joint[:n, n] = plant.A, plant.B @ u + plant.G @ piece
        x = (expm(joint * h / len(w)) @ np.append(x, 1.0))[:n]
    return x


@pytest.mark.parametrize("start", few([[0.6, 0.2], 0.5], 1))
def test_the_truth_is_within_the_radii_from_the_first_sample_on(found, start):
    rng = np.random.default_rng(7)
    ratios = []
    for run in range(3):
        gains = sd.accuracy.PeriodicGains(found, initial_error=start, prior=[1.0, -1.0], first=run % 3)
        e = rng.uniform(-1, 1, 2) * (np.array(start) if np.ndim(start) else 0.5 / np.sqrt(2))
        x, u, j = np.array([1.0, -1.0]) + e, np.zeros(1), run % 3
        for _ in range(60):
            y = PLANT.C @ x + PLANT.D @ u + V * rng.choice([-1.0, 1.0])
            after = rng.normal(size=1)
            estimate = gains.update(y, after)
            assert np.all(np.abs(x - estimate.value) <= estimate.radii * (1 + 1e-9))
            ratios.append(np.abs(x - estimate.value) / estimate.radii)
            u, j = after, (j + 1) % 3
            w = rng.normal(size=(3, 2))
            x = flown(PLANT, x, u, W * w / np.linalg.norm(w, axis=1, keepdims=True), SCHEDULE.gaps[j])
        assert gains.settled
        assert estimate.radii == pytest.approx(found.at_samples[:, (j - 1) % 3], rel=0.01)
    assert np.max(ratios) > 0.5


def test_no_estimator_guarantees_less_than_the_last_radius(found):
    """Data of a witness read zero; the estimate is zero, and the truth as far away as the lower bound says."""
    attack = found.witnesses[0]
    gains = sd.accuracy.PeriodicGains(found, initial_error=1.0)
    for _ in range(90):
        estimate = gains.update([0.0])
    assert estimate.value == pytest.approx([0.0, 0.0], abs=1e-9)
    assert attack.value <= found.upper[0]
    assert np.all(estimate.radii <= found.upper * 1.01)


def test_times_follow_the_schedule(found):
    gains = sd.accuracy.PeriodicGains(found, initial_error=1.0, first=2)
    times = [gains.update([0.0]).t for _ in range(7)]
    assert np.diff(times) == pytest.approx(np.tile(SCHEDULE.gaps, 3)[:6])


def test_a_growing_plant_with_inputs_does_not_drift():
    plant = sd.Plant([[0.8]], [[1.0]], B=[[1.0]])
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=0.1, v_bound=0.2)
    gains, x, u = sd.accuracy.PeriodicGains(found, initial_error=1.0), np.array([0.9]), np.zeros(1)
    for _ in range(200):
        estimate = gains.update(x, u)
        assert abs(x[0] - estimate.value[0]) <= estimate.radii[0] + 1e-14 * abs(x[0])  # of doubles
        x = flown(plant, x, u, np.array([[0.1]]), 1.0)
    assert x[0] > 1e30
    assert estimate.radii[0] == pytest.approx(found.at_samples[0, 0], rel=1e-3)


def test_intervals_off_centre_move_the_estimate():
    plant = sd.Plant([[0.0]], [[1.0]])
    found = sd.guaranteed_accuracy(
        plant, sd.PeriodicSchedule([1.0]), w_bound={"w1": (0.0, 0.2)}, v_bound={"y1": (0.0, 0.4)}
    )
    gains = sd.accuracy.PeriodicGains(found, initial_error=1.0)
    for k in range(40):
        estimate = gains.update([0.1 * k + 0.2])  # a truth of 0.1 k, every error in the middle
    assert estimate.value[0] == pytest.approx(3.9, abs=1e-6)
    assert estimate.radii[0] == pytest.approx(0.2)
    assert "within" in estimate.explain()
    assert "±" in str(estimate)
    assert estimate.to_dict()["t"] == estimate.t


def test_a_mask_names_what_must_be_read():
    plant = sd.Plant(np.diag([-0.1, 0.0]), np.eye(2))
    schedule = sd.PeriodicSchedule([1.0, 1.0], outputs=[[True, False], [True, True]])
    gains = sd.accuracy.PeriodicGains(
        sd.guaranteed_accuracy(plant, schedule, w_bound=0.1, v_bound=0.2), initial_error=1.0
    )
    assert np.isfinite(gains.update([1.0, np.nan]).value).all()
    with pytest.raises(ArgumentError, match="`y` must be finite where the schedule measures"):
        gains.update([1.0, np.nan])
    assert np.isfinite(gains.update([1.0, 1.0]).value).all()


def test_bad_input_is_refused(found):
    with pytest.raises(ArgumentError, match="`found` must be the accuracy of a periodic schedule"):
        sd.accuracy.PeriodicGains(
            sd.guaranteed_accuracy(PLANT, sd.Schedule([0.0, 1.0]), w_bound=W, v_bound=V), initial_error=1.0
        )
    with pytest.raises(ArgumentError, match="`initial_error` must bound every state"):
        sd.accuracy.PeriodicGains(found, initial_error=[1.0, np.inf])
    with pytest.raises(ArgumentError, match=r"`y` must have shape \(1,\), got \(2,\)"):
        sd.accuracy.PeriodicGains(found, initial_error=1.0).update([1.0, 2.0])
    plant = sd.Plant(np.zeros((2, 2)), [[1.0, 0.0]])
    with pytest.raises(ArgumentError, match="`found` must know every mode, but no sample shows"):
        sd.accuracy.PeriodicGains(sd.guaranteed_accuracy(plant, SCHEDULE, w_bound=W, v_bound=V), initial_error=1.0)
