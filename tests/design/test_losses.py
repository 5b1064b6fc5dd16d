"""What one sample is worth, against a dense scan of the schedule without it."""

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule, sample_losses
from sampling_design.errors import ArgumentError
from tests.oracles.design import window_sigma_scan

A, C = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[1.0, 0.0]])


def designed(**more):
    return design_schedule(Plant(A, C), Requirement(**{"window": 4.0, "spacing": 0.4, "samples": 4, **more}), starts=3)


def test_a_price_is_what_a_scan_without_the_sample_says():
    design = designed(fixed=[0.0], forbidden=[[1.0, 2.0]])
    losses = sample_losses(design, every_lap=True)
    times = design.schedule.times
    for i in range(times.size):
        scan = window_sigma_scan(A, C, np.delete(times, i), 4.0, 4.0)
        assert losses.lower[i] <= scan * (1 + 1e-7)
        assert losses.lower[i] >= scan * (1 - 5e-3)
    assert losses.dearest == np.argmin(losses.lower)
    assert np.all(losses.price > 0)
    assert f"{times[losses.dearest]:.6g}" in losses.explain()
    assert "without t" in str(losses)


def test_missing_once_costs_less_where_a_window_spans_laps():
    design = designed(window=4.0, period=2.0, samples=2)
    once, always = sample_losses(design), sample_losses(design, every_lap=True)
    assert np.all(once.lower >= always.lower)
    assert np.any(once.lower > always.upper)


def test_the_only_sample_of_a_lap_is_worth_everything():
    design = designed(window=4.0, period=1.0, samples=1)
    assert sample_losses(design, every_lap=True).lower.tolist() == [0.0]
    assert sample_losses(design).lower[0] > 0


def test_without_a_schedule_there_is_nothing_to_lose():
    with pytest.raises(ArgumentError, match="there is no sample to lose"):
        sample_losses(design_schedule(Plant([[-1.0]], [[1.0]])))
