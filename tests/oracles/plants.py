"""Exact answers about matrices with integer entries, in rational arithmetic, and planted Jordan structures."""

from __future__ import annotations

import flint
import numpy as np


def exact(matrix: np.ndarray) -> flint.fmpq_mat:
    """The matrix with its float entries taken as the exact rationals that they are."""
    return flint.fmpq_mat(
        [[flint.fmpq(*float(v).as_integer_ratio()) for v in row] for row in np.asarray(matrix, dtype=float)]
    )


def minimal_polynomial_degree(matrix: np.ndarray) -> int:
    """Degree of the minimal polynomial: the least k for which I, A, ..., A^k are linearly dependent.

    It equals the sum over the distinct eigenvalues of their indices.
    """
    A = exact(matrix)
    n = A.nrows()
    power = flint.fmpq_mat([[flint.fmpq(int(i == j)) for j in range(n)] for i in range(n)])
    rows: list[list[flint.fmpq]] = []
    for k in range(n + 1):
        rows.append(list(power.entries()))
        if flint.fmpq_mat(rows).rank() <= k:
            return k
        power = power * A
    raise AssertionError("Cayley-Hamilton failed")


def distinct_eigenvalue_count(matrix: np.ndarray) -> int:
    """Number of distinct complex eigenvalues: n less the degree of gcd(p, p') for the characteristic polynomial."""
    p = exact(matrix).charpoly()
    return int(p.degree() - p.gcd(p.derivative()).degree())


def unimodular(n: int, rng: np.random.Generator, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """An integer matrix of determinant one and its integer inverse, from elementary row operations."""
    S, inverse = np.eye(n, dtype=int), np.eye(n, dtype=int)
    for _ in range(steps if n > 1 else 0):
        i, j = rng.choice(n, 2, replace=False)
        c = int(rng.choice([-1, 1]))
        S[i] += c * S[j]
        inverse[:, j] -= c * inverse[:, i]
    assert np.array_equal(S @ inverse, np.eye(n, dtype=int))
    return S, inverse


def jordan_matrix(blocks: list[tuple[complex, int]]) -> np.ndarray:
    """Real Jordan form with integer data; a complex value a + bi stands for the pair."""
    parts = []
    for value, size in blocks:
        if value.imag == 0:
            parts.append(int(value.real) * np.eye(size, dtype=int) + np.eye(size, k=1, dtype=int))
        else:
            a, b = int(value.real), int(value.imag)
            pair = np.array([[a, b], [-b, a]])
            parts.append(np.kron(np.eye(size, dtype=int), pair) + np.eye(2 * size, k=2, dtype=int))
    n = sum(len(p) for p in parts)
    result, at = np.zeros((n, n), dtype=int), 0
    for part in parts:
        result[at : at + len(part), at : at + len(part)] = part
        at += len(part)
    return result


def planted(rng: np.random.Generator, largest: int = 8, steps: int = 8, longest: int = 3) -> np.ndarray:
    """A random integer matrix whose Jordan blocks are hidden by a unimodular similarity."""
    blocks: list[tuple[complex, int]] = []
    size = 0
    while True:
        value = complex(int(rng.integers(-2, 3)), int(rng.choice([0, 0, 1, 2])))
        block = int(rng.integers(1, longest + 1))
        size += block * (1 if value.imag == 0 else 2)
        if size > largest:
            break
        blocks.append((value, block))
    J = jordan_matrix(blocks or [(0j, 2)])
    S, inverse = unimodular(len(J), rng, steps)
    return np.asarray(S @ J @ inverse)
