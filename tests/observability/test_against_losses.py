"""Times moved so that more losses by chance are borne: what is borne is proven, the moves keep what they must."""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, loss_tolerance
from sampling_design.errors import ArgumentError
from sampling_design.observability.count.against_losses import design_against_losses
from tests.rescale import Units

SPIRAL = Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.0]])
EVEN = PeriodicSchedule(np.full(4, np.pi / 2))


def moved(schedule, others):
    """How far each sample is from where it was, over all periods."""
    count = len(others) // len(schedule)
    before = (schedule.times + schedule.period * np.arange(count)[:, None]).ravel()
    gaps = np.abs(others.times[:, None] - before)
    return np.minimum(gaps, others.period - gaps).min(axis=0)


@pytest.mark.parametrize("periods", [2, 4])
def test_evenly_spaced_samples_come_to_bear_all_but_one_hidden_sample(periods):
    found, tolerance = design_against_losses(SPIRAL, EVEN, 0.3, periods=periods, draws=6)
    best = np.exp(-0.2 * 2 * np.pi * periods / (4 * periods - 1))  # one sample is hidden from some direction always
    assert tolerance.lower == pytest.approx(best, rel=1e-9) == tolerance.upper
    assert loss_tolerance(SPIRAL, EVEN).lower < 0.54 < tolerance.lower < tolerance.limit
    assert tolerance.lower == loss_tolerance(SPIRAL, found).lower
    assert len(found) == 4 * periods
    assert 0 < moved(EVEN, found).max() <= 0.3


def test_what_may_not_move_stays_and_what_is_measured_goes_along():
    plant = Plant(SPIRAL.A, np.eye(2))
    asked = PeriodicSchedule(np.full(4, np.pi / 2), outputs=[[True, False], [True, True], [True, False], [False, True]])
    found, tolerance = design_against_losses(plant, asked, [0.0, 0.2, 0.3, 0.0], periods=2, draws=4)
    assert np.all(moved(asked, found) <= np.tile([1e-12, 0.2, 0.3, 1e-12], 2) + 1e-12)
    assert found.outputs.sum() == 2 * asked.outputs.sum()
    assert tolerance.lower > loss_tolerance(plant, asked).lower


def test_without_leeway_or_growth_nothing_is_moved():
    integrator = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    found, tolerance = design_against_losses(integrator, PeriodicSchedule([1.0]), 0.1)
    assert len(found) == 1
    assert tolerance.lower == 1
    assert len(design_against_losses(Plant([[-1.0]], [[1.0]]), PeriodicSchedule([1.0]), 0.1)[0]) == 1
    uneven = PeriodicSchedule(np.pi / 2 * np.array([0.6, 1.1, 0.8, 1.5]))
    assert design_against_losses(SPIRAL, uneven, 0.0)[1].lower == loss_tolerance(SPIRAL, uneven).lower


def test_units_change_nothing():
    units = Units.drawn(np.random.default_rng(1), SPIRAL)
    schedule = units.schedule(EVEN)
    plain = design_against_losses(SPIRAL, EVEN, 0.3, periods=2, draws=4)[1]
    other = design_against_losses(
        units.plant(SPIRAL), schedule, 0.3 * schedule.period / EVEN.period, periods=2, draws=4
    )[1]
    assert other.lower == pytest.approx(plain.lower, rel=1e-6)


@pytest.mark.parametrize(
    ("leeway", "words"),
    [
        (-0.1, "`leeway` must be at least 0 and less than half the least gap, 0.785398, so that .* got -0.1"),
        (0.8, "`leeway` must be at least 0 and less than half the least gap, 0.785398, so that .* got 0.8"),
        ([0.1, 0.1, 0.1, 0.9], "`leeway` must be at least 0 and less than half the least gap"),
        ([0.1, 0.1], "`leeway` must have 4 entries, got 2"),
        ("much", "`leeway` must be a number"),
        (np.nan, "`leeway` must be"),
    ],
)
def test_samples_keep_their_order(leeway, words):
    with pytest.raises(ArgumentError, match=words):
        design_against_losses(SPIRAL, EVEN, leeway)
