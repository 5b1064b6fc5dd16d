"""Ball arithmetic: definiteness, bounds and flows against sixty digits; cases that are tight and cases that fail."""

import sys

import numpy as np
import pytest

from sampling_design.errors import MissingExtraError
from sampling_design.numerics import balls as balls
from sampling_design.numerics.balls import BallFlow, highest
from sampling_design.records.budget import Budget, BudgetSpentError
from tests.cases import few
from tests.oracles import balls as oracle


def random_symmetric(rng, values):
    Q = np.linalg.qr(rng.standard_normal((len(values), len(values))))[0]
    return Q @ np.diag(values) @ Q.T


def test_without_the_extra_the_refusal_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(MissingExtraError, match="python-flint, which is not installed"):
        balls.flint()


def test_precision_is_restored_even_after_an_error():
    before = balls.flint().ctx.prec
    with pytest.raises(ZeroDivisionError), balls.precision(300):
        1 / 0  # noqa: B018
    assert balls.flint().ctx.prec == before


@pytest.mark.parametrize("n", [1, 2, 5, 40])
def test_definite_is_decided_to_the_last_bit(n):
    """I - u u' with |u|^2 just below and just above one: floats cannot tell, balls can."""
    u = np.ones((n, 1))
    with balls.precision():
        one = balls.matrix(u) * balls.matrix(u.T) / n
        tiny = balls.ball(2.0**-100)
        assert balls.definite(balls.identity(n) * (1 + tiny) - one) is True
        assert balls.definite(balls.identity(n) * (1 - tiny) - one) is False
        wide = balls.matrix(np.eye(n)) * balls.flint().arb(0, 1)
        assert balls.definite(wide) is None


def test_definite_agrees_with_eigenvalues_on_random_matrices():
    rng = np.random.default_rng(0)
    for _ in range(100):
        M = random_symmetric(rng, rng.standard_normal(rng.integers(1, 6)))
        with balls.precision():
            assert balls.definite(balls.symmetric(M)) is bool(np.linalg.eigvalsh(M)[0] > 0)


@pytest.mark.parametrize(("n", "near"), [(1, 1e-40), (4, 1e-40), (20, 1e-34), (37, 1e-34)])
def test_cholesky_returns_the_root_or_none(n, near):
    """Below and above the size from which matrices are eliminated by blocks; one negative direction, wherever it is."""
    rng = np.random.default_rng(1)
    values = np.geomspace(1e-3, 5.0, n)
    M = random_symmetric(rng, values)
    with balls.precision():
        L = balls.cholesky(balls.symmetric(M))
        assert not np.triu(balls.floats(L), 1).any()
        assert balls.frobenius(L * L.transpose() - balls.symmetric(M)) < near
        for k in {0, n // 2, n - 1}:
            bad = balls.symmetric(random_symmetric(rng, np.where(np.arange(n) == k, -1e-9, values)))
            assert balls.definite(bad) is False
            assert balls.cholesky(bad) is None
        wide = balls.matrix(np.ones((n, n))) * balls.flint().arb(0, 1)
        assert balls.cholesky(wide) is None
        assert balls.cholesky(balls.matrix(np.diag([1.0, -1.0]))) is None
        assert balls.cholesky(balls.matrix(np.zeros((0, 0)))).nrows() == 0


def test_bounds_of_norms_hold_and_are_close():
    rng = np.random.default_rng(2)
    for _ in range(50):
        M = rng.standard_normal((4, 4))
        S = M + M.T
        with balls.precision():
            top, size, whole = (
                balls.largest(balls.matrix(S)),
                balls.spectral(balls.matrix(M)),
                balls.frobenius(balls.matrix(M)),
            )
            assert balls.definite(top * balls.identity(4) - balls.matrix(S)) is True
        assert float(top) == pytest.approx(np.linalg.eigvalsh(S)[-1], rel=1e-9)
        assert np.linalg.norm(M, 2) * (1 - 1e-12) <= float(size) <= np.linalg.norm(M, 2) * (1 + 1e-9)
        assert float(whole) == pytest.approx(np.linalg.norm(M))


def test_a_matrix_that_floats_cannot_hold_still_has_a_bound():
    with balls.precision():
        huge = balls.identity(2) * balls.flint().arb(10) ** 400
        assert balls.largest(huge) >= balls.flint().arb(10) ** 400


def test_raised_and_lowered_enclose_in_the_order_of_matrices():
    with balls.precision():
        wide = balls.matrix([[2.0, 1.0], [1.0, 3.0]]) + balls.matrix(np.ones((2, 2))) * balls.flint().arb(0, 1e-3)
        above, below = balls.raised(wide), balls.lowered(wide)
        for corner in ([[1, 1], [1, 1]], [[1, -1], [-1, 1]], [[-1, 1], [1, -1]]):
            member = balls.matrix([[2.0, 1.0], [1.0, 3.0]]) + balls.matrix(np.array(corner, dtype=float)) * balls.ball(
                9e-4
            )
            assert balls.definite(above - member)
            assert balls.definite(member - below)
        assert all(entry.rad() < 1e-40 for entry in above.entries())


PLANTS = {
    "oscillator": [[0.0, 1.0], [-1.0, 0.0]],
    "double integrator": [[0.0, 1.0], [0.0, 0.0]],
    "stiff": [[-300.0, 5.0, 0.0], [0.0, 0.3, 2.0], [0.0, -2.0, 0.3]],
    "unstable": [[2.0, 30.0], [0.0, 1.0]],
    "still": [[0.0, 0.0], [0.0, 0.0]],
}


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("duration", [1e-3, 0.7, 3.3])
def test_flow_contains_the_sixty_digit_solution(name, duration):
    A = np.array(PLANTS[name])
    n = len(A)
    S, Y = np.eye(n) * 0.25, np.diag(np.arange(1.0, n + 1))
    exact = oracle.flow(A.tolist(), S.tolist(), Y.tolist(), duration)
    with balls.precision(400):
        found = BallFlow(balls.matrix(A), balls.matrix(S)).step(balls.matrix(Y), balls.ball(duration))
        assert all(oracle.inside(exact[i, j], found[i, j]) for i in range(n) for j in range(n))


@pytest.mark.parametrize("name", few(PLANTS, 1))
def test_highest_holds_everywhere_and_is_close(name):
    """One per cent above the largest value of a dense scan is proven; one part in 1e9 below it, nothing."""
    A = np.array(PLANTS[name])
    n, duration = len(A), 1.1
    S, Y = np.eye(n) * 0.1, np.diag(np.linspace(0.5, 2.0, n))
    times = np.append(np.linspace(0, duration, 60), np.geomspace(1e-4, 1e-1, 20))
    tops = [float(oracle.largest(A.tolist(), S.tolist(), Y.tolist(), float(t))) for t in times]
    with balls.precision():
        flow = BallFlow(balls.matrix(A), balls.matrix(S))
        limit = balls.ball(max(tops) * (1 + 1e-2))
        proven = highest(flow, balls.matrix(Y), balls.ball(duration), Budget(60), limit=limit)
        assert proven is not None
        assert max(tops) <= float(proven) <= float(limit)
        low = balls.ball(max(tops) * (1 - 1e-9))
        assert highest(flow, balls.matrix(Y), balls.ball(duration), Budget(60), limit=low) is None


def test_a_bulge_between_equal_ends_is_seen():
    """Y turns by a half circle: both ends are the same, the middle is ten times as high."""
    with balls.precision():
        flow = BallFlow(balls.matrix([[0.0, 1.0], [-1.0, 0.0]]), balls.matrix(np.zeros((2, 2))))
        Y, half = balls.matrix(np.diag([1.0, 10.0])), balls.ball(3.141592653589793)
        first = lambda M: M[0, 0].upper()  # noqa: E731
        assert first(flow.step(Y, half)) < 1.0000001
        assert highest(flow, Y, half, Budget(60), top=first, limit=balls.ball(9.999)) is None
        assert highest(flow, Y, half, Budget(60), top=first, limit=balls.ball(10.001)) is not None


def test_a_spent_budget_stops_the_search():
    with balls.precision():
        flow = BallFlow(balls.matrix([[0.0, 1.0], [-1.0, 0.0]]), balls.identity(2))
        with pytest.raises(BudgetSpentError, match="the budget ran out"):
            highest(flow, balls.identity(2) * balls.ball(0.1), balls.ball(1.0), Budget(-1.0), limit=balls.ball(9.0))
