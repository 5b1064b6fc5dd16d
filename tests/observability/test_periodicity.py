"""Long windows of plants whose rows repeat: as cheap as short ones, and the same bracket."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.observability.worst_case import worst_case_sigma as module
from sampling_design.observability.worst_case.spaced_rows import exact_period, within_periods

C = [[1.0, 0.0], [0.3, 0.5]]
OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], C)


def test_what_repeats_exactly_is_known_in_any_coordinates():
    assert exact_period(OSCILLATOR) == pytest.approx(2 * np.pi, rel=2e-9)
    assert exact_period(OSCILLATOR) > 2 * np.pi
    assert exact_period(sd.Plant([[3.0, -10.0], [1.0, -3.0]], C)) == pytest.approx(2 * np.pi, rel=2e-9)
    with_bias = np.zeros((3, 3))
    with_bias[:2, :2] = [[0.0, 0.25], [-16.0, 0.0]]
    assert exact_period(sd.Plant(with_bias, [[1.0, 0.0, 1.0]])) == pytest.approx(np.pi, rel=2e-9)


@pytest.mark.parametrize(
    "A",
    [
        [[0.0, 1.0], [0.0, 0.0]],  # a Jordan block
        [[-1e-17, 1.0], [-1.0, 0.0]],  # hardly damped
        [[0.0, 1.0], [1.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0]],
        np.kron(np.diag([1.0, 2.0]), [[0.0, 1.0], [-1.0, 0.0]]),  # two frequencies
        np.kron([[1.0, 0.0], [0.0, 1.0]], [[0.0, 1.0], [-1.0, 0.0]]) + np.eye(4, k=2),  # resonance
    ],
)
def test_what_does_not_repeat_is_left_alone(A):
    plant = sd.Plant(A, np.eye(len(A))[:1])
    assert exact_period(plant) is None
    family = sd.SpacedWindows(1e5, 3, 1.0)
    assert within_periods(plant, family) is family


@pytest.mark.parametrize("C", [C, [[1.0, 0.2]]])
def test_the_shorter_window_has_the_bracket_of_the_longer_one(monkeypatch, C):
    plant, family = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], C), sd.SpacedWindows(40.0, 3, 0.7)
    short = sd.worst_case_sigma(plant, family)
    assert within_periods(plant, family).window < 40.0
    monkeypatch.setattr(module, "within_periods", lambda plant, family: family)
    whole = sd.worst_case_sigma(plant, family)
    assert short.family.window == whole.family.window == 40.0
    assert max(short.lower, whole.lower) <= min(short.upper, whole.upper)
    assert (np.diff(short.witness) >= 0.7 - 1e-12).all()


def test_a_window_of_many_periods_closes():
    found = sd.worst_case_sigma(OSCILLATOR, sd.SpacedWindows(1e5, 4, 1.0))
    near = sd.worst_case_sigma(OSCILLATOR, sd.SpacedWindows(100.0, 4, 1.0))
    assert found.closed
    assert found.family.window == 1e5
    assert (found.lower, found.upper) == pytest.approx((near.lower, near.upper), rel=0.02)
