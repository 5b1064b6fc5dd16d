"""What one sample is worth, against a dense scan of the schedule without it."""

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.design import sample_losses
from sampling_design.design.losses import design_and_losses
from sampling_design.errors import ArgumentError
from sampling_design.records.record import above
from tests.cases import few
from tests.oracles.design import best_on_grid, window_sigma_scan

A, C = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.array([[1.0, 0.0]])


def designed(**more):
    return design_schedule(
        Plant(A, C), Requirement(**{"window": 4.0, "spacing": 0.4, "samples": 4, **more}), starts=1, branches=0
    )


@pytest.mark.long
def test_a_price_is_what_a_scan_without_the_sample_says():
    design = designed(samples=3, fixed=[0.0], forbidden=[[1.0, 2.0]])
    losses = sample_losses(design, every_period=True)
    times = design.schedule.times
    for i in range(times.size):
        scan = window_sigma_scan(A, C, np.delete(times, i), 4.0, 4.0)
        assert losses.lower[i] <= scan * (1 + 1e-7)
        assert losses.lower[i] >= scan * (1 - 5e-3)
    assert losses.dearest == np.argmin(losses.lower)
    assert np.all(losses.price > 0)
    assert losses.price == pytest.approx(losses.sigma - losses.lower)
    assert f"{times[losses.dearest]:.6g}" in losses.explain()
    assert "without t" in str(losses)


@pytest.mark.parametrize("every_period", few([True, False], 0))
def test_no_schedule_with_one_sample_fewer_exceeds_the_bound(every_period):
    design = designed(samples=3)
    losses = sample_losses(design, every_period=every_period)
    periods = 1 if every_period else 2
    assert np.all(losses.lower <= losses.bound)
    assert np.all(losses.bound <= design.upper_bound)
    count, period = 3 * periods - 1, 4.0 * periods
    best, _ = best_on_grid(A, C, period, 4.0, 0.4, count, 6 * periods)
    assert 0 < best <= losses.bound.min()
    if every_period:
        fewer = designed(samples=2)
        assert fewer.sigma <= losses.bound[0] <= fewer.upper_bound * 1.2


@pytest.mark.long
def test_a_lost_fixed_sample_has_a_bound_of_its_own():
    free = sample_losses(designed(samples=3), every_period=True).bound
    design = designed(samples=3, fixed=[0.0, 0.5])
    losses = sample_losses(design, every_period=True)
    where = np.isin(design.schedule.times, [0.0, 0.5])
    assert losses.bound[~where][0] < losses.bound[where].max()  # without the free one two close ones remain
    assert losses.bound.max() <= free[0] * (1 + 1e-3)
    assert f"none exceeds {above(losses.bound[0])}" in str(losses)
    assert losses.to_dict()["without"][0]["bound"] == losses.bound[0]


def test_missing_once_costs_less_where_a_window_spans_periods():
    design = designed(window=4.0, period=2.0, samples=2)
    once, always = sample_losses(design), sample_losses(design, every_period=True)
    assert once.alike == (len({f"{low:.6g}" for low in once.lower}) == 1)
    assert (
        ("any sample is missed" in once.explain()) == once.alike == ("costs as much" in once.plot().get_title("left"))
    )
    assert np.all(once.lower >= always.lower)
    assert np.any(once.lower > always.upper)


def test_the_only_sample_of_a_lap_is_worth_everything():
    design = designed(window=4.0, period=1.0, samples=1)
    assert sample_losses(design, every_period=True).lower.tolist() == [0.0]
    assert sample_losses(design).lower[0] > 0


def test_without_a_schedule_there_is_nothing_to_lose():
    with pytest.raises(ArgumentError, match="there is no sample to lose"):
        sample_losses(design_schedule(Plant([[-1.0]], [[1.0]])))


def test_what_sees_nothing_has_nothing_to_lose():
    unseen = designed(window=2 * np.pi, period=np.pi, samples=1)
    with pytest.raises(ArgumentError, match="`design` must make every state observable, or there is nothing to lose"):
        sample_losses(unseen)


@pytest.mark.long
def test_a_design_and_its_losses_share_a_budget():
    asked = Requirement(window=4.0, spacing=0.4, samples=3)
    design, losses = design_and_losses(Plant(A, C), asked, every_period=True, rng=1, budget=20.0)
    assert losses.sigma == design.sigma
    assert losses.lower.size == 3
    faded, none = design_and_losses(Plant([[-1.0]], [[1.0]]))
    assert (faded.schedule, none) == (None, None)
