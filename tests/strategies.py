"""Hypothesis strategies that rooms share: awkward plants and plain schedules.

Everything is built from small integers and seeds, so that examples shrink and repeat.
"""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from sampling_design import PeriodicSchedule, Plant, Schedule
from tests.oracles.plants import jordan_matrix, unimodular

seeds = st.integers(0, 2**31 - 1)


def _generic(A: np.ndarray, seed: int, outputs: int) -> Plant:
    rng = np.random.default_rng(seed)
    return Plant(A, rng.choice([-2.0, -1.0, 1.0, 2.0], (outputs, len(A))), B=rng.standard_normal((len(A), 1)))


def _rotated(A: np.ndarray, seed: int) -> np.ndarray:
    Q = np.linalg.qr(np.random.default_rng(seed).standard_normal(A.shape))[0]
    return Q @ A @ Q.T


@st.composite
def stable_plants(draw: st.DrawFn, largest: int = 6) -> Plant:
    """All eigenvalues have real part at most -0.2."""
    n, seed = draw(st.integers(1, largest)), draw(seeds)
    A = np.random.default_rng(seed).standard_normal((n, n))
    A -= (float(np.max(np.linalg.eigvals(A).real)) + 0.2) * np.eye(n)
    return _generic(A, seed, draw(st.integers(1, 2)))


@st.composite
def unstable_plants(draw: st.DrawFn, largest: int = 6) -> Plant:
    """At least one eigenvalue has real part 0.5; the others may lie on either side."""
    n, seed = draw(st.integers(1, largest)), draw(seeds)
    A = np.random.default_rng(seed).standard_normal((n, n))
    A += (0.5 - float(np.max(np.linalg.eigvals(A).real))) * np.eye(n)
    return _generic(A, seed, draw(st.integers(1, 2)))


@st.composite
def defective_plants(draw: st.DrawFn, largest: int = 6) -> Plant:
    """Integer Jordan blocks of size up to three, hidden by a unimodular similarity."""
    blocks: list[tuple[complex, int]] = []
    size = 0
    for _ in range(draw(st.integers(1, 3))):
        value = complex(draw(st.integers(-2, 1)), draw(st.sampled_from([0, 0, 1, 2])))
        block = draw(st.integers(1, 3))
        cost = block * (1 if value.imag == 0 else 2)
        if size + cost <= largest:
            blocks.append((value, block))
            size += cost
    J = jordan_matrix(blocks or [(0j, 2)])
    seed = draw(seeds)
    S, inverse = unimodular(len(J), np.random.default_rng(seed), draw(st.integers(0, 8)))
    return _generic(S @ J @ inverse, seed, draw(st.integers(1, 2)))


@st.composite
def clustered_plants(draw: st.DrawFn) -> Plant:
    """Oscillators whose frequencies differ by 1e-9 to 1e-3, in an orthogonal basis that hides them."""
    count, seed = draw(st.integers(2, 3)), draw(seeds)
    gap = 10.0 ** draw(st.integers(-9, -3))
    A = np.zeros((2 * count, 2 * count))
    for k in range(count):
        omega = 1.0 + k * gap
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, omega], [-omega, 0.0]]
    return _generic(_rotated(A, seed), seed, draw(st.integers(1, 2)))


@st.composite
def stiff_plants(draw: st.DrawFn) -> Plant:
    """Rates from 1e-3 to 1e4 side by side, with an oscillator between them, in an orthogonal basis."""
    seed = draw(seeds)
    fast, slow = -(10.0 ** draw(st.integers(2, 4))), 10.0 ** draw(st.integers(-3, -1)) * draw(st.sampled_from([-1, 1]))
    A = np.zeros((4, 4))
    A[0, 0], A[1, 1] = fast, slow
    A[2:, 2:] = [[0.0, 1.0], [-1.0, 0.0]]
    return _generic(_rotated(A, seed), seed, draw(st.integers(1, 2)))


def plants() -> st.SearchStrategy[Plant]:
    """Any of the kinds above."""
    return st.one_of(stable_plants(), unstable_plants(), defective_plants(), clustered_plants(), stiff_plants())


@st.composite
def gap_lists(draw: st.DrawFn, most: int = 6) -> list[float]:
    """One to `most` positive gaps that are multiples of 1/16 (sums are exact)."""
    return [k / 16 for k in draw(st.lists(st.integers(1, 48), min_size=1, max_size=most))]


@st.composite
def periodic_schedules(draw: st.DrawFn, most: int = 6) -> PeriodicSchedule:
    """Periodic schedules with exact times."""
    return PeriodicSchedule(draw(gap_lists(most)))


@st.composite
def finite_schedules(draw: st.DrawFn, most: int = 12) -> Schedule:
    """Finite schedules with exact times, the first one perhaps at zero."""
    gaps = draw(gap_lists(most))
    return Schedule(draw(st.sampled_from([0.0, gaps[0]])) + np.cumsum([0.0, *gaps[1:]]))
