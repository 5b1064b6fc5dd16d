"""Of two plants that nothing couples, taken as one, every answer is that of each of them alone."""

from itertools import product

import numpy as np
import pytest
from scipy.linalg import block_diag

import sampling_design as sd
from sampling_design.accuracy import standard_deviation
from tests.cases import few

ROUNDING = 1e-9
HALVES = {
    "stiff": ([[-50.0, 1.0], [0.0, 0.1]], [[1.0, -2.0], [-1.0, 1.0]], [[-0.05], [-0.65]]),
    "decaying": ([[-0.1]], [[-1.0]], [[1.0]]),
    "level": ([[0.0]], [[0.5]], [[1.0]]),
    "oscillator": ([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], [[-1.15], [0.45]]),
    "defective": ([[-0.3, 1.0], [0.0, -0.3]], [[1.0, 0.0], [0.5, 0.0]], np.eye(2)),
}


def together(*names):
    """Both as one, then each alone: plant, and its bounds on w and v."""
    rng = np.random.default_rng([67, *map(len, names)])
    parts = [tuple(np.array(M) for M in HALVES[name]) for name in names]
    bounds = [(rng.uniform(0.1, 1, G.shape[1]), rng.uniform(0.1, 1, len(C))) for _, C, G in parts]
    parts = [tuple(block_diag(*both) for both in zip(*parts, strict=True)), *parts]
    bounds = [tuple(np.concatenate(both) for both in zip(*bounds, strict=True)), *bounds]
    return [(sd.Plant(A, C, G=G), w, v) for (A, C, G), (w, v) in zip(parts, bounds, strict=True)]


CASES = [pair for pair in product(HALVES, HALVES) if pair[0] != pair[1]]
SCHEDULE = sd.PeriodicSchedule([1.375, 0.5])


@pytest.mark.parametrize(("first", "second"), few(CASES, 13))
def test_the_guaranteed_accuracy_is_that_of_each_alone(first, second):
    found = [
        sd.guaranteed_accuracy(plant, SCHEDULE, w_bound=w, v_bound=v, rtol=0.05)
        for plant, w, v in together(first, second)
    ]
    lower, upper = (np.concatenate([getattr(one, end) for one in found[1:]]) for end in ("lower", "upper"))
    assert np.all(found[0].lower <= upper * (1 + ROUNDING))
    assert np.all(lower <= found[0].upper * (1 + ROUNDING))


@pytest.mark.parametrize(("first", "second"), few(CASES, 0, 11))
def test_deviation_sigma_and_lambda_are_those_of_each_alone(first, second):
    parts = together(first, second)
    deviation = [standard_deviation(p, SCHEDULE, w_intensity=w, v_deviation=v).worst for p, w, v in parts]
    np.testing.assert_allclose(deviation[0], np.concatenate(deviation[1:]), rtol=1e-7)
    sigma = [sd.window_sigma(plant, SCHEDULE, 2.5) for plant, _, _ in parts]
    assert sigma[0].lower <= min(one.upper for one in sigma[1:]) * (1 + ROUNDING)
    assert min(one.lower for one in sigma[1:]) <= sigma[0].upper * (1 + ROUNDING)
    lam = [
        sd.certify(
            plant, SCHEDULE, eta=0.1, P2=np.eye(plant.n_states), Qw=np.diag(w**-2), R=np.diag(v**-2), Qv=np.diag(v**-2)
        ).lam
        for plant, w, v in parts
    ]
    assert lam[0] == pytest.approx(max(lam[1:]), rel=1e-3)
