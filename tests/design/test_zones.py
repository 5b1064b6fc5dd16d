"""Zones hold every schedule that they claim to hold, and a set of boxes that leaves one out is found out."""

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.design.bounds.zones import (
    begins,
    covered,
    halves,
    origin_zones,
    region_of,
    regions,
    sides,
    tightened,
    zoned,
)
from sampling_design.design.problem.design_problem import DesignProblem
from tests.cases import few
from tests.oracles.design import random_schedule

COUNTED = ("late", "early")
P, SPACING, COUNT = 4.0, 0.3, 6


def problem(**changes):
    given = {"window": P, "period": P, "spacing": SPACING, "samples": COUNT}
    none = {"forbidden": np.zeros((0, 2)), "fixed": np.zeros(0), "available": (None,)}
    return DesignProblem(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), **(given | none | changes))


def counted(times, side, shift=0.0, begin=0.0):
    """The samples counted from the one after which all come late, or early, by definition; that one in [0, shift] from
    where periods `begin`."""
    late = times - np.arange(times.size) * P / times.size
    origin = int(np.argmin(late) if side == "late" else np.argmax(late))
    line = np.concatenate([times[origin:], times[:origin] + P])
    return line - (line[0] if shift == 0.0 else shift * np.floor((line[0] - begin) / shift))


def held(zones, distances):
    """Whether every follower lies in its zone."""
    return bool(np.all((distances >= zones[:, 0]) & (distances <= zones[:, 1])))


def draws(count, seed=9):
    rng = np.random.default_rng(seed)
    yield np.arange(COUNT) * P / COUNT
    yield np.arange(COUNT) * SPACING
    yield from (random_schedule(rng, P, SPACING, COUNT) for _ in range(count))


@pytest.mark.parametrize("side", COUNTED)
def test_from_some_sample_all_others_come_late_and_from_some_early(side):
    zones = origin_zones(problem(), side)
    assert all(held(zones, counted(times, side)) for times in draws(60))
    even = np.arange(COUNT) * P / COUNT
    wrong = even + (np.arange(COUNT) > 0) * (-0.05 if side == "late" else 0.05)
    assert not held(zones, wrong)


DAYS = np.array([[0.0, 0.3], [0.8, 1.3], [1.8, 2.3], [2.8, 3.3], [3.8, 4.0]])


@pytest.mark.parametrize(
    ("changes", "shift"),
    [
        ({}, 0.0),
        ({"fixed": np.array([1.0])}, 0.0),
        ({"forbidden": np.array([[0.0, 1.0]])}, P),
        ({"forbidden": DAYS}, 1.0),
        ({"forbidden": np.array([[0.0, 0.5], [2.0, 2.5]])}, 2.0),
        ({"forbidden": np.array([[0.0, 0.5], [2.0, 2.5]]), "available": (np.array([[0.0, 3.0]]),)}, P),
        ({"available": (np.array([[0.0, 1.0], [2.0, 3.0]]),)}, 2.0),
    ],
)
def test_a_requirement_may_be_turned_by_what_its_allowed_times_repeat_after(changes, shift):
    case = problem(**changes)
    assert case.least_shift == pytest.approx(shift)
    origin = begins(case, "late")
    assert origin_zones(case, "late")[0] == pytest.approx([origin, max(origin, origin + shift - case.shut)], abs=1e-9)


@pytest.mark.parametrize("side", COUNTED)
def test_tightening_loses_no_schedule_and_sees_where_there_is_none(side):
    case, rng = problem(), np.random.default_rng(3)
    for times in draws(60):
        line = counted(times, side)
        box = line[:, None] + np.sort(rng.uniform(-0.4, 0.4, (COUNT, 2)), axis=1)
        box = np.stack([np.minimum(box[:, 0], line - 1e-12), np.maximum(box[:, 1], line + 1e-12)], axis=1)
        tight = tightened(case, box, side)
        assert held(tight, line)
        assert np.all(tight[:, 0] >= box[:, 0] - 1e-15)
        assert np.all(tight[:, 1] <= box[:, 1] + 1e-15)
    crowded = origin_zones(case, side)
    crowded[1, 0] = P - (COUNT - 1) * SPACING + 1e-3
    crowded[1, 1] = P
    assert tightened(case, crowded, side) is None


@pytest.mark.parametrize("side", COUNTED)
def test_tightening_knows_closed_times(side):
    case = problem(forbidden=DAYS, spacing=0.1)
    root = origin_zones(case, side)
    rng, seen = np.random.default_rng(6), 0
    for _ in range(300):
        times = np.sort(rng.integers(0, 4, COUNT) + rng.uniform(0.3, 0.8, COUNT))
        gaps = np.diff(np.append(times, times[0] + P))
        if gaps.min() < 0.1:
            continue
        line = counted(times, side, 1.0, begins(case, side))
        seen += 1
        assert held(tightened(case, root, side), line)
        box = np.stack([line - rng.uniform(0, 0.5, COUNT), line + rng.uniform(0, 0.5, COUNT)], axis=1)
        tight = tightened(case, box, side)
        assert held(tight, line)
        inner = np.mod(tight, P)
        assert case.mask(inner[:, 0] + 1e-9).all()  # both ends moved to times that are allowed
        assert case.mask(inner[:, 1] - 1e-9).all()
    assert seen > 20
    night = root.copy()
    night[2] = 1.85, 2.25
    assert tightened(case, night, side) is None


@pytest.mark.parametrize("changes", [{}, {"forbidden": DAYS, "spacing": 0.05}])
def test_a_box_cut_again_and_again_is_covered_and_one_piece_less_is_not(changes):
    case, rng = problem(**changes), np.random.default_rng(4)
    region = origin_zones(case, "late")
    boxes = [region]
    for _ in range(40):
        box = boxes.pop(int(rng.integers(len(boxes))))
        index = int(rng.integers(1, COUNT))
        boxes += halves(box, index, float(rng.uniform(*box[index])))
    alive = [b for b in boxes if tightened(case, b, "late") is not None]
    assert covered(case, region, alive, "late")
    assert 3 <= len(alive) < len(boxes)
    for gone in range(len(alive)):
        assert not covered(case, region, alive[:gone] + alive[gone + 1 :], "late")
    inner = alive[0].copy()
    inner[1, 1] = tightened(case, inner, "late")[1].mean()
    assert not covered(case, region, [inner, *alive[1:]], "late")


def test_boxes_that_no_cut_parts_are_not_taken_for_a_cover():
    case = problem(samples=3)
    rest = [[0.0, 0.0]]
    region = np.array([*rest, [1.4, 3.4], [2.8, 3.7]])
    pinwheel = [
        np.array([*rest, [1.4, 2.4], [2.8, 3.3]]),
        np.array([*rest, [1.4, 1.9], [3.3, 3.7]]),
        np.array([*rest, [1.9, 3.4], [3.1, 3.7]]),
        np.array([*rest, [2.4, 3.4], [2.8, 3.1]]),
    ]
    assert not covered(case, region, pinwheel, "late")


@pytest.mark.parametrize(
    "changes",
    few(
        [
            {"fixed": np.array([0.5, 2.2])},
            {"fixed": np.array([0.2, 1.0, 3.1])},
            {"fixed": np.array([0.9]), "forbidden": np.array([[1.2, 2.0]])},
            {"forbidden": np.array([[0.3, 1.2], [2.0, 2.1]])},
        ],
        0,
    ),
)
def test_every_schedule_lies_in_a_region_of_sorted_samples_and_in_one_only(changes):
    case, rng, seen = problem(spacing=0.15, **changes), np.random.default_rng(5), 0
    assert sides(case) == ("sorted",)
    whole = regions(case, "sorted")
    for _ in range(3000):
        times = np.sort(np.concatenate([case.fixed, rng.uniform(0, P, COUNT - case.fixed.size)]))
        gaps = np.diff(np.append(times, times[0] + P))
        if gaps.min() < case.spacing or not case.mask(times).all():
            continue
        seen += 1
        lead = case.origin + np.min(np.mod(case.fixed - case.origin, P)) if case.fixed.size else case.origin
        line = lead + np.sort(np.mod(times - lead + 1e-12, P))
        assert sum(held(tightened(case, region, "sorted"), line) for region in whole) == 1
    assert seen > 15
    assert [region_of(case, "sorted", region) for region in whole] == list(range(len(whole)))
    assert region_of(case, "sorted", whole[0] + 10 * P) is None


def test_zones_need_two_samples_and_a_free_one():
    assert zoned(problem())
    assert zoned(problem(fixed=np.array([1.0])))
    assert zoned(problem(forbidden=DAYS))
    assert zoned(problem(fixed=np.array([1.0, 2.0])))
    assert zoned(problem(fixed=np.array([1.0]), forbidden=DAYS))
    assert not zoned(problem(fixed=np.linspace(0.0, 3.0, COUNT)))  # nothing is free
    assert not zoned(problem(samples=24, fixed=np.linspace(0.0, 3.0, 5)))  # 8855 ways to share the others out
    assert not zoned(problem(samples=1))
