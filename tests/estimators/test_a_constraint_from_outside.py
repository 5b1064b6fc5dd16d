"""A kind of constraint that boxes, half-spaces and balls can say is one function, and every verb takes it.

Here the sum of moduli, sum |z_i| / s_i <= 1, with a half-space for each choice of signs.
"""

from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from tests.oracles.windows import by_the_reference

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
SCALES = np.array([1.0, 2.0])
TIMES = np.array([0.5, 1.7, 2.4, 3.9])
RECORD = [(t, [0.85 * np.cos(t) + error]) for t, error in zip(TIMES, (0.55, 0.4, -0.55, -0.5), strict=True)]


def diamond(scales):
    """Return {z : sum |z_i| / s_i <= 1}."""
    signs = np.array(list(product((-1.0, 1.0), repeat=len(scales))))
    return sd.estimators.ConvexSet.halfspaces(signs / scales, np.ones(len(signs)))


def estimator(**options):
    constraints = sd.Constraints(x=diamond(SCALES), **options)
    bounds = {"w_bound": 0.1, "v_bound": 0.6, "initial_error": 2.0}
    return sd.MovingHorizonEstimator(PLANT, horizon=4.0, constraints=constraints, **bounds)


def test_the_set_knows_its_points_and_its_extent():
    chosen = diamond(SCALES)
    assert chosen.contains([0.5, 1.0])
    assert not chosen.contains([0.5, 1.01])
    assert chosen.excess([1.0, 2.0]) == pytest.approx(1.0)
    assert np.allclose(chosen.bounding_box(), [-SCALES, SCALES], atol=1e-6)
    assert np.allclose(chosen.magnitude(), SCALES, atol=1e-6)


def test_every_engine_keeps_it_and_finds_the_same():
    reference = by_the_reference(estimator()).run(RECORD)
    found = [reference, *(estimator(engine=engine).run(RECORD) for engine in ("active set", "conic"))]
    free = sd.MovingHorizonEstimator(PLANT, horizon=4.0).run(RECORD)
    assert diamond(SCALES).excess(free.x) > 0.01  # without it an estimate lies outside
    for record in found:
        assert diamond(SCALES).excess(record.x) < 1e-6
        assert np.allclose(record.x, reference.x, atol=1e-6)


def test_intervals_use_it():
    last = estimator().run(RECORD).estimates[-1].interval()
    assert np.all(last.lower >= -SCALES - 1e-6)
    assert np.all(last.upper <= SCALES + 1e-6)
