"""The exact projection of what nobody excludes lies between its polygons and within the ellipse of a quadratic cost."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError
from tests.oracles import accuracy as oracle

PLANT = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
SCHEDULE = sd.PeriodicSchedule([1.0, 0.6, 1.4])


@pytest.fixture(scope="module")
def found():
    return sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=0.02, v_bound=0.1)


def test_the_polygons_close_and_hold_what_the_oracle_attains(found):
    projection = found.projection("position", "velocity", t=float(SCHEDULE.times[0]))
    inner, outer, ellipse = projection.areas()
    assert 0.97 * outer <= inner <= outer < ellipse
    gaps = np.tile([0.6, 1.4, 1.0], 4)
    times = np.concatenate([[0.0], np.cumsum(np.roll(gaps, 0))])
    for angle in (0.3, 2.0):
        c = np.array([np.cos(angle), np.sin(angle)])
        value, *_ = oracle.adversary(PLANT.A, PLANT.C, PLANT.G, times, c, 0.02, 0.1, cells=6)
        assert np.max(projection.outer @ c) >= value * 0.999
        assert np.max(projection.inner @ c) <= value * 1.001
        assert np.max(projection.inner @ c) >= value * 0.95
        assert np.sqrt(c @ projection.ellipse @ c) >= value * 0.999


@pytest.mark.long
def test_the_ellipse_holds_the_set_at_every_time(found):
    for t in (0.7, 1.0, 1.9, 2.7):
        projection = found.projection("position", "velocity", t=max(t, float(SCHEDULE.times[0])), directions=6)
        assert np.all(
            np.einsum("ki,ij,kj->k", projection.inner, np.linalg.inv(projection.ellipse), projection.inner) <= 1 + 1e-9
        )


def test_it_speaks_and_is_drawn(found):
    projection = found.projection("position", "velocity", directions=5)
    assert projection.t == found.worst[0]
    assert "nobody can place position and velocity better" in projection.explain()
    assert "area of the ellipse" in str(projection)
    assert len(projection.to_dict()["outer"]) >= 4
    assert projection.plot().get_xlabel() == "error of position"


@pytest.mark.long
def test_a_known_start_has_a_projection_too():
    finite = sd.guaranteed_accuracy(
        PLANT, sd.Schedule([1.0, 2.0, 2.6]), w_bound=0.02, v_bound=0.1, initial_error=0.3, end=3.0
    )
    projection = finite.projection("position", "velocity", t=2.8)
    inner, outer, ellipse = projection.areas()
    assert 0.9 * outer <= inner <= outer < ellipse


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"second": "position"}, "`second` must be another row than `first`"),
        ({"second": "velocty"}, "Did you mean 'velocity'"),
        ({"t": 17.0}, r"`t` must lie in \["),
        ({"directions": 2}, "`directions`"),
    ],
)
def test_bad_input_is_refused(found, change, match):
    with pytest.raises(ArgumentError, match=match):
        found.projection(**({"first": "position", "second": "velocity"} | change))


def test_rows_that_are_not_known_have_none():
    plant = sd.Plant(np.zeros((2, 2)), [[1.0, 0.0]], states=["seen", "unseen"])
    found = sd.guaranteed_accuracy(plant, SCHEDULE, w_bound=0.02, v_bound=0.1)
    with pytest.raises(ArgumentError, match="`first` and `second` must be known"):
        found.projection("seen", "unseen")
    early = sd.guaranteed_accuracy(PLANT, sd.Schedule([1.0, 2.0, 2.6]), w_bound=0.02, v_bound=0.1)
    with pytest.raises(ArgumentError, match="`t` must be a time at which both rows are known"):
        early.projection("position", "velocity", t=1.5)
