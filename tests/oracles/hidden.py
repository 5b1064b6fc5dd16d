"""Plants with modes that no output shows, in random coordinates, and by hand what chosen rows of their state need."""

import numpy as np
from scipy.linalg import expm

from sampling_design import Plant


def block(rng: np.random.Generator, n: int) -> np.ndarray:
    """Real modes, spirals and, one time in three, a chain of two."""
    M, at = np.zeros((n, n)), 0
    while at < n:
        if n - at >= 2 and rng.random() < 0.5:
            rate, turn = rng.uniform(-0.3, 0.2), rng.uniform(0.3, 3)
            M[at : at + 2, at : at + 2] = [[rate, turn], [-turn, rate]]
            at += 2
        else:
            M[at, at] = rng.uniform(-0.5, 0.3)
            at += 1
    if n > 1 and rng.random() < 0.3:
        M[:2, :2] = [[0.1, 1.0], [0.0, 0.1]]
    return M


def random_hidden(rng: np.random.Generator, mixed: bool = True) -> tuple[Plant, np.ndarray, int]:
    """A plant, rows that no hidden mode enters, and how many states these rows and the outputs need; `mixed` units."""
    shown, hidden = int(rng.integers(1, 5)), int(rng.integers(1, 4))
    own, other = block(rng, shown), block(rng, hidden) + 0.3 * np.eye(hidden) * (rng.random() < 0.5)
    driven = rng.normal(size=(hidden, shown)) * (rng.random() < 0.7)
    A = np.block([[own, np.zeros((shown, hidden))], [driven, other]])
    C, H = rng.normal(size=(int(rng.integers(1, 3)), shown)), rng.normal(size=(int(rng.integers(1, shown + 1)), shown))
    rows = np.vstack([C, H])
    observed = np.vstack([rows @ np.linalg.matrix_power(own, k) for k in range(shown)])
    away = np.zeros((len(rows), hidden))
    T = rng.normal(size=(shown + hidden,) * 2)
    if rng.random() < 0.5 and mixed:
        T = 10 ** rng.uniform(-6, 6, shown + hidden)[:, None] * T
    back = np.linalg.inv(T)
    whole = np.hstack([rows, away]) @ back
    plant = Plant(T @ A @ back, whole[: len(C)])
    return plant, whole[len(C) :], int(np.linalg.matrix_rank(observed, 1e-9))


def random_rows(rng: np.random.Generator) -> tuple[Plant, np.ndarray, bool]:
    """A plant, rows that may hold hidden modes, and whether what the outputs never show of them dies out.

    That is asked of a simulation: the hidden part moves by itself, and its rows fall below 1e-3 of what they were by
    t = 50/0.1, or they do not. No hidden rate lies between -0.1 and 0.05.
    """
    shown, hidden = int(rng.integers(1, 4)), int(rng.integers(1, 4))
    rates = np.where(rng.random(hidden) < 0.5, rng.uniform(0.05, 0.3, hidden), rng.uniform(-0.5, -0.1, hidden))
    other = np.diag(rates)
    if hidden > 1 and rng.random() < 0.5:  # a chain: rows of its second vector show what its eigenvector does not
        other[1, 1], other[0, 1] = other[0, 0], 1.0
    A = np.block([[block(rng, shown), np.zeros((shown, hidden))], [rng.normal(size=(hidden, shown)), other]])
    C = np.hstack([rng.normal(size=(1, shown)), np.zeros((1, hidden))])
    H = np.hstack([rng.normal(size=(1, shown)), rng.normal(size=(1, hidden)) * (rng.random(hidden) < 0.5)])
    later = np.abs(H[:, shown:] @ expm(other * 50 / 0.1)).max()
    T = rng.normal(size=(shown + hidden,) * 2)
    back = np.linalg.inv(T)
    return Plant(T @ A @ back, C @ back), H @ back, bool(later < 1e-3)
