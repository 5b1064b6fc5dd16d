"""Programs over stages against a general solver that knows nothing of stages."""

import numpy as np
import pytest
from scipy.optimize import linprog

from sampling_design.numerics.stage_programs import StageProgram


def _reference(F, B, H, mu, S):
    """The same program as one dense linear program."""
    n, K, widths = len(mu), len(H), [X.shape[1] for X in B]
    size = K * n + sum(widths)
    equal, rows, at = [], [], K * n
    for k, (step, push) in enumerate(zip(F, B, strict=True)):
        row = np.zeros((n, size))
        row[:, (k + 1) * n : (k + 2) * n] = np.eye(n)
        row[:, k * n : (k + 1) * n] = -step
        row[:, at : at + widths[k]] = -push
        at += widths[k]
        equal.append(row)
    for k, seen in [*enumerate(H), (0, np.zeros((0, n)) if S is None else S)]:
        row = np.zeros((len(seen), size))
        row[:, k * n : (k + 1) * n] = seen
        rows += [row, -row]
    if S is None:
        equal.append(np.eye(n, size))
    cost = np.zeros(size)
    cost[(K - 1) * n : K * n] = -mu
    limits = [(None, None)] * (K * n) + [(-1, 1)] * sum(widths)
    above, fixed = np.vstack(rows), np.vstack(equal)
    found = linprog(cost, above, np.ones(len(above)), fixed, np.zeros(len(fixed)), limits)
    return -found.fun


@pytest.mark.parametrize("rest", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_the_general_solver_agrees(seed, rest):
    rng = np.random.default_rng(seed)
    n, K = int(rng.integers(1, 5)), int(rng.integers(2, 9))
    F = [rng.standard_normal((n, n)) for _ in range(K - 1)]
    B = [rng.standard_normal((n, rng.integers(1, 6))) for _ in F]
    H = [rng.standard_normal((rng.integers(0, 3), n)) for _ in range(K)]
    mu, S = rng.standard_normal(n), None if rest else rng.standard_normal((n + 2, n))
    found = StageProgram(F, B, H, S).solve(mu, [np.zeros(len(X)) for X in H], 1e-9)
    meant = _reference(F, B, H, mu, S)
    assert found.gap < 1e-7
    assert abs(mu @ found.z[-1] - meant) <= 1e-6 * meant
    # the multipliers alone bound it: costates run back from mu, everything at its bound
    g, total = mu, 0.0
    for k in range(K - 1, -1, -1):
        total += float(np.abs(found.gains[k]).sum())
        g = g - H[k].T @ found.gains[k]
        if k:
            assert np.allclose(found.costates[k - 1], g, atol=1e-6 * np.abs(mu).max())
            total += float(np.abs(B[k - 1].T @ g).sum())
            g = F[k - 1].T @ g
    total += float(np.abs(found.start).sum())
    assert abs(total - meant) <= 1e-5 * meant


def test_it_ends_early_where_that_is_enough():
    rng = np.random.default_rng(3)
    F, H = [0.9 * np.eye(3)] * 20, [rng.standard_normal((1, 3)) for _ in range(21)]
    B = [rng.standard_normal((3, 6)) for _ in F]
    program, mu, guess = StageProgram(F, B, H), np.array([1.0, -2.0, 0.5]), [np.zeros(1)] * 21
    best = program.solve(mu, guess, 1e-8)
    rough = program.solve(mu, guess, 1e-8, enough=1.5 * float(mu @ best.z[-1]), near=0.1)
    assert best.gap <= 1e-8 < rough.gap <= 0.1
