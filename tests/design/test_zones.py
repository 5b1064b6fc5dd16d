"""Zones hold every schedule that they claim to hold, and a set of boxes that leaves one out is found out."""

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.design.problem import DesignProblem
from sampling_design.design.zones import (
    SIDES,
    covered,
    follower_zones,
    halves,
    lateness,
    origin_zones,
    tightened,
    turnable,
    widest_gap,
)
from tests.oracles.design import random_schedule

P, SPACING, COUNT = 4.0, 0.3, 6


def problem(**changes):
    given = {"window": P, "period": P, "spacing": SPACING, "samples": COUNT}
    none = {"forbidden": np.zeros((0, 2)), "fixed": np.zeros(0), "available": (None,)}
    return DesignProblem(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), **(given | none | changes))


def followers(times, side):
    """Distances to the samples after the one from which all come late, or early, by definition."""
    late = times - np.arange(times.size) * P / times.size
    origin = int(np.argmin(late) if side == "late" else np.argmax(late))
    return np.sort(np.mod(times - times[origin], P))[1:]


def held(zones, distances):
    """Whether every follower lies in its zone."""
    return bool(np.all((distances >= zones[:, 0]) & (distances <= zones[:, 1])))


def draws(count, seed=9):
    rng = np.random.default_rng(seed)
    yield np.arange(COUNT) * P / COUNT
    yield np.arange(COUNT) * SPACING
    yield from (random_schedule(rng, P, SPACING, COUNT) for _ in range(count))


@pytest.mark.parametrize("side", SIDES)
def test_from_some_sample_all_others_come_late_and_from_some_early(side):
    zones = origin_zones(problem(), side)
    assert all(held(zones, followers(times, side)) for times in draws(60))
    even = np.arange(1, COUNT) * P / COUNT
    wrong = even - 0.05 if side == "late" else even + 0.05
    assert not held(zones, wrong)


@pytest.mark.parametrize("side", SIDES)
def test_tightening_loses_no_schedule_and_sees_where_there_is_none(side):
    case, rng = problem(), np.random.default_rng(3)
    kept = 0
    for times in draws(60):
        after = followers(times, side)
        box = np.sort(after[:, None] + rng.uniform(-0.4, 0.4, (COUNT - 1, 2)), axis=1)
        box = np.stack([np.minimum(box[:, 0], after - 1e-12), np.maximum(box[:, 1], after + 1e-12)], axis=1)
        tight = tightened(case, box)
        kept += 1
        assert held(tight, after)
        assert np.all(tight[:, 0] >= np.maximum(box[:, 0], 0.0) - 1e-15)
        assert np.all(tight[:, 1] <= np.minimum(box[:, 1], P) + 1e-15)
    assert kept > 50
    crowded = origin_zones(case, side)
    crowded[0, 0] = P - (COUNT - 1) * SPACING + 1e-3
    assert tightened(case, crowded) is None


def test_a_box_cut_again_and_again_is_covered_and_one_piece_less_is_not():
    case, rng = problem(), np.random.default_rng(4)
    region = origin_zones(case, "late")
    boxes = [region]
    for _ in range(25):
        box = boxes.pop(int(rng.integers(len(boxes))))
        index = int(rng.integers(COUNT - 1))
        boxes += halves(box, index, float(rng.uniform(*box[index])))
    alive = [b for b in boxes if tightened(case, b) is not None]
    assert covered(case, region, alive)
    assert 5 < len(alive) < len(boxes)
    for gone in range(len(alive)):
        assert not covered(case, region, alive[:gone] + alive[gone + 1 :])
    inner = alive[0].copy()
    inner[0, 1] = tightened(case, inner)[0].mean()
    assert not covered(case, region, [inner, *alive[1:]])


def test_boxes_that_no_cut_parts_are_not_taken_for_a_cover():
    case = problem(samples=3)
    region = np.array([[0.3, 2.3], [0.6, 2.6]])
    pinwheel = [
        np.array([[0.3, 1.3], [0.6, 2.1]]),
        np.array([[0.3, 1.8], [2.1, 2.6]]),
        np.array([[1.8, 2.3], [1.1, 2.6]]),
        np.array([[1.3, 2.3], [0.6, 1.1]]),
    ]
    assert not covered(case, region, pinwheel)


@pytest.mark.parametrize("side", SIDES)
def test_follower_zones_hold_the_followers_of_every_sample(side):
    case = problem()
    for times in draws(40):
        after = followers(times, side)
        zones = tightened(case, np.stack([after - 0.05, after + 0.1], axis=1))
        every = follower_zones(case, zones)
        for origin in times:
            assert held(every, np.sort(np.mod(times - origin, P))[1:])
        gaps = np.diff(np.append(times, times[0] + P))
        assert gaps.max() <= widest_gap(case, zones) + 1e-12
        late = lateness(case, zones)
        shift = after - np.arange(1, COUNT) * P / COUNT
        assert np.all((late[1:, 0] <= shift) & (shift <= late[1:, 1]))
        assert np.all(late[0] == 0.0)


def test_only_requirements_that_may_be_shifted_are_turned():
    assert turnable(problem())
    assert turnable(problem(fixed=np.array([1.0])))
    assert not turnable(problem(fixed=np.array([1.0, 2.0])))
    assert not turnable(problem(available=(np.array([[0.0, 1.0]]),)))
    assert not turnable(problem(samples=1))
