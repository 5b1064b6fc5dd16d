"""The least scale of a shape on the noise budget, against windows whose ln lambda is known in closed form."""

import numpy as np
import pytest

from sampling_design.certificates.exact.noise_gain_scale import EXACT, RateWindows
from sampling_design.certificates.exact.window_gains import Look


class Known:
    """Windows of one state: ln lambda as a function of ln P2, and how often it was asked for."""

    def __init__(self, rises):
        self.rises, self.asked = rises, 0

    def looked(self, P):
        self.asked += 1
        return Look(self.rises(float(np.log(P[0, 0]))))


RISES = {
    "level": (lambda s: 5.0, lambda b: 5.0 - b),
    "half as fast": (lambda s: 0.5 * s + 3.0, lambda b: 2 * (3.0 - b)),
    "as fast beyond fifty": (lambda s: max(s - 50.0, 0.0), lambda b: -b),
    "smoothly": (lambda s: np.log1p(np.exp(s - 3.0)) + 0.1, lambda b: -np.log(np.exp(b - 0.1) - np.exp(-3.0))),
}


@pytest.mark.parametrize("name", RISES)
@pytest.mark.parametrize("budget", [1.5, 3.0, 1e6])
def test_the_scale_is_the_one_on_the_budget_from_above(name, budget):
    rises, root = RISES[name]
    known = Known(rises)
    P, log_lambda = RateWindows(known, np.eye(1), np.eye(1)).scaled(np.eye(1), budget)
    scale = float(np.log(P[0, 0]))
    assert scale == pytest.approx(root(np.log(budget)), abs=4 * EXACT)
    assert log_lambda - scale <= np.log(budget)
    assert known.asked <= 8


@pytest.mark.parametrize("rises", [lambda s: s + 5.0, lambda s: np.nan, lambda s: np.inf])
def test_no_scale_keeps_a_budget_that_none_can(rises):
    assert RateWindows(Known(rises), np.eye(1), np.eye(1)).scaled(np.eye(1), 3.0) is None


@pytest.mark.parametrize("hair", [1e-4, 1e-8, 1e-12])
def test_a_budget_that_every_scale_misses_by_a_hair_is_given_up_soon(hair):
    known = Known(lambda s: s + np.log(3.0) + hair)
    assert RateWindows(known, np.eye(1), np.eye(1)).scaled(np.eye(1), 3.0) is None
    assert known.asked <= 60


def test_a_guess_that_is_not_definite_in_doubles_is_left_out():
    """Seed 696 of the random plants ended in "Matrix is not positive definite"."""

    class Windows:
        def __init__(self, left):
            self.left = left

        def long_run(self, start):
            return self.left[None]

    definite = np.array([[2.0, 0.5], [0.5, 1.0]])
    (shape,) = RateWindows(Windows(definite), np.eye(2), np.eye(2)).driven(1e-10)
    least = np.linalg.eigvalsh(np.linalg.inv(definite))[0]
    np.testing.assert_allclose(shape, np.linalg.inv(definite) + least * np.eye(2), rtol=1e-8)
    assert RateWindows(Windows(np.diag([1.0, -1.0])), np.eye(2), np.eye(2)).driven(1e-10) == []
