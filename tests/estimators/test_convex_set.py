"""Convex sets: membership, bounding boxes, intersections, and refusal of empty ones."""

import numpy as np
import pytest

from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.convex_set import ConvexSet

TRIANGLE = ConvexSet.halfspaces([[-1.0, 0.0], [0.0, -1.0], [1.0, 2.0]], [0.0, 0.0, 2.0])


def test_membership_and_excess():
    both = TRIANGLE & ConvexSet.box([-np.inf, 0.5], [np.inf, np.inf]) & ConvexSet.ball(1.0, dimension=2)
    assert both.contains([0.5, 0.6])
    assert both.excess([0.5, 0.2]) == pytest.approx(0.3)
    assert both.excess([[0.5, 0.6], [2.0, 0.6]]) == pytest.approx(max(1.2, np.hypot(2.0, 0.6) - 1))
    assert both.excess(np.zeros((0, 2))) == -np.inf
    assert not both.is_box
    assert ConvexSet.box([0.0], [1.0]).is_box


def test_bounding_boxes_hold_the_set_and_touch_it():
    low, high = TRIANGLE.bounding_box()
    assert np.allclose([low, high], [[0, 0], [2, 1]], atol=1e-6)
    assert np.all(low <= 0)
    assert np.all(high >= [2, 1])
    shape = np.array([[1.0, 0.5], [0.0, 2.0]])
    ball = ConvexSet.ball(1.5, centre=[1.0, -1.0], shape=shape)
    angles = np.linspace(0, 2 * np.pi, 4001)
    edge = np.array([1.0, -1.0]) + 1.5 * np.linalg.solve(shape, [np.cos(angles), np.sin(angles)]).T
    low, high = ball.bounding_box()
    assert np.allclose([low, high], [edge.min(axis=0), edge.max(axis=0)], atol=1e-5)


@pytest.mark.parametrize("row", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("unit", [(1e-12, 1e-12), (1e-12, 1e12), (1.0, 1e-6), (1e12, 1.0)])
def test_bounding_boxes_are_the_same_in_any_units(row, unit):
    """The solver's tolerances are absolute, and 1e-7 of what is measured in nanometres is no tolerance."""
    low, high = ConvexSet.halfspaces(row * TRIANGLE.rows / unit, row * TRIANGLE.offsets).bounding_box()
    assert np.allclose([low / unit, high / unit], [[0, 0], [2, 1]], atol=1e-6)
    assert np.all(low < 0)  # outward, by what a solver leaves open
    assert np.all(high / unit > [2, 1])
    beside = ConvexSet([-np.inf, 0.0], [np.inf, unit[1]], row * np.array([[1.0, -1.0]]) / unit, [0.0])
    assert beside.bounding_box()[1] == pytest.approx(unit, rel=1e-6)  # x/unit <= y/unit <= 1


@pytest.mark.parametrize("row", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("unit", [(1e-12, 1e-12), (1e-12, 1e12), (1.0, 1e-6), (1e12, 1.0)])
@pytest.mark.parametrize(("side", "empty"), [(2.1, True), (2.0001, True), (1.9999, False), (0.5, False)])
def test_a_set_is_empty_in_all_units_or_in_none(row, unit, side, empty):
    """The triangle ends at 2; so does the ball, whose shape has its own unit."""
    unit = np.array(unit)
    beyond = ConvexSet.halfspaces(row * np.array([[-1.0, 0.0]]) / unit, [-row * side])
    triangle = ConvexSet.halfspaces(TRIANGLE.rows / unit, TRIANGLE.offsets)
    ball = ConvexSet.ball(row, centre=unit, shape=row * np.diag(1 / unit))
    for one in (triangle, ball):
        if empty:
            with pytest.raises(ArgumentError, match="the set is empty: every point violates it by"):
                one & beyond
        else:
            assert (one & beyond).dimension == 2


def test_a_half_space_without_direction_is_all_or_nothing():
    assert ConvexSet.halfspaces([[0.0, 0.0]], [1e-12]).contains([5.0, 5.0])
    with pytest.raises(ArgumentError, match="the set is empty: every point violates it by"):
        ConvexSet.halfspaces([[0.0, 0.0]], [-1e-12])


def test_half_spaces_never_widen_a_box():
    box = ConvexSet.box([-1e-9, 0.0], [1e-9, 5.0])
    low, high = (box & ConvexSet.halfspaces([[1.0, 1.0]], [100.0])).bounding_box()
    assert np.array_equal([low, high], [box.lower, box.upper])


def test_magnitudes():
    assert ConvexSet.ball(0.5, dimension=3).magnitude() == 0.5
    assert ConvexSet.box([-2.0, 0.0], [1.0, 3.0]).magnitude().tolist() == [2.0, 3.0]
    assert ConvexSet.box([-2.0, -np.inf], [1.0, 3.0]).magnitude() is None
    assert np.allclose(ConvexSet.ball(0.5, centre=[1.0, 0.0]).magnitude(), [1.5, 0.5])


def test_words():
    assert "3 half-spaces" in TRIANGLE.explain()
    assert "half-spaces=3" in repr(TRIANGLE)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ConvexSet.box([1.0], [0.0]), "the set is empty, got 1.0 > 0.0 at 0"),
        (lambda: ConvexSet.box([0.0], [1.0, 2.0]), "`upper` must have 1 entries as `lower` has, got 2"),
        (lambda: ConvexSet.box([np.nan], [1.0]), "must be a vector without NaN"),
        (
            lambda: ConvexSet.halfspaces([[1.0], [-1.0]], [0.0, -1.0]),
            "the set is empty: every point violates it by 0.5",
        ),
        (lambda: ConvexSet.ball(1.0, dimension=1) & ConvexSet.box([2.0], [3.0]), "the set is empty"),
        (lambda: ConvexSet.ball(1.0, dimension=1) & TRIANGLE, "sets must have one dimension, got 1 and 2"),
        (lambda: ConvexSet.ball(-1.0, dimension=1), "`radius` must not be negative"),
        (lambda: ConvexSet.ball(1.0), "`dimension` must be given for a ball"),
        (lambda: ConvexSet.halfspaces([[1.0, 0.0]], [0.0, 1.0]), "`offsets` must have 1 entry"),
    ],
)
def test_refusals(make, message):
    with pytest.raises(ArgumentError, match=message):
        make()
