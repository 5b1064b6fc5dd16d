"""The least sigma over cells: a lower bound of every plant and position in a cell, and sigma at its centre.

With O(d) = O_0 + sum d_k O_k + X, |d_k| <= 1, and G_0 = O_0'O_0 = S'S:

    O'O >= (1 - t) (G_0 + sum d_k (O_0'O_k + O_k'O_0)) - (1/t - 1) X'X,

since the square of the first order is no loss. The right side is linear in d: its corners decide. A window that begins
s later sees |O e^{A s} x|, and |x| is convex in s to first order: its ends decide, whatever the condition of O.
"""

from __future__ import annotations

import numpy as np

from sampling_design.numerics.linalg import right_directions
from sampling_design.records.arrays import Array, Complex, Mask
from sampling_design.uncertain.box.expansion import BoxCells, expanded, signs
from sampling_design.uncertain.box.model import BoxModel

MOST_CORNERS = 6
"""Directions of a cell up to which all its corners are tried; beyond it every direction counts with its size."""
ROUNDING = 64 * float(np.finfo(float).eps)  # of sums of a few products, relative; times the number of rows and states
LEAST_SHARE = 1e-3  # of the weights of two rests, however small one is
LARGEST = 1e60  # a rest beyond it proves nothing


def least_sigma(
    model: BoxModel, cells: BoxCells, times: Array, measured: Mask, late: float
) -> tuple[Array, Array, Array]:
    """Of each cell: a proven lower bound of sigma, sigma at its centre, and how much parameters and position matter.

    For samples up to `late` early or late, of the centre the bound of it alone: what smaller cells lead to.
    """
    found = expanded(model, cells, times, measured, late)
    K, R, n = found.rows.shape
    if n > R:
        return np.zeros(K), np.zeros(K), np.ones((K, model.m + 1))
    Q, S = np.linalg.qr(found.rows)
    diagonal = np.abs(np.einsum("kii->ki", S))
    sound = (diagonal > 0).all(axis=1) & np.isfinite(found.slopes).all(axis=(1, 2, 3))
    S = np.where(sound[:, None, None], S, np.eye(n))
    back = np.linalg.solve(S, np.broadcast_to(np.eye(n), S.shape))
    unit = model.unit[:, None] * back
    turn = cells.h[:, None, None] * (model.unit[:, None] * (found.A @ back))
    centre = np.where(sound, 1 / np.linalg.norm(unit, 2, axis=(1, 2)), 0.0)
    turned = np.swapaxes(Q, 1, 2)[:, None] @ np.where(sound[:, None, None, None], found.slopes, 0.0) @ back[:, None]
    H = turned + np.swapaxes(turned, 2, 3)
    effect = np.linalg.norm(H, axis=(2, 3))
    moved = np.linalg.norm(turn, axis=(1, 2)) / np.linalg.norm(unit, axis=(1, 2))
    rounding = ROUNDING * (R + n) * (1 + effect.sum(axis=1))
    lower, slightest = np.zeros(K), np.full(K, np.inf)
    effect = np.column_stack([effect, moved])
    if found.lost is not None:
        lost = np.swapaxes(back, 1, 2) @ found.lost @ back
        fine = sound & (np.abs(lost).max(axis=(1, 2), initial=0.0) < LARGEST)
        lost = np.where(fine[:, None, None], lost, 0.0)
        alone = _lower(H[:, :0], lost, (unit, 0 * turn, 0 * unit), ROUNDING * (R + n) * np.ones(K))
        centre = np.where(fine, alone, 0.0)
    whole = effect
    for rest in found.rest:
        with np.errstate(over="ignore", invalid="ignore"):
            N = np.swapaxes(back, 1, 2) @ rest.N @ back
            N = N if found.lost is None else _together(N, lost)
            beyond = rest.beyond[:, None, None] * (rest.inverse @ back)
            worth = np.abs(beyond).max(axis=(1, 2), initial=0.0) / np.linalg.norm(unit, axis=(1, 2))
            worth = worth + np.einsum("kii->k", np.abs(N))
        close = sound & (worth < LARGEST)
        whole = np.where((worth < slightest)[:, None], effect + rest.effect, whole)
        slightest = np.fmin(slightest, worth)
        if close.any():
            k = np.flatnonzero(close)
            reached = _lower(H[k], N[k], (unit[k], turn[k], beyond[k]), rounding[k])
            lower[k] = np.maximum(lower[k], np.where(np.isfinite(reached), reached, 0.0))
    return np.minimum(lower, centre), centre, whole


def _together(one: Array, other: Array) -> Array:
    """What bounds |(X + E) z|^2 where X'X is at most the one (K, n, n) and E'E the other: weights by their size."""
    sizes = np.sqrt(np.maximum([np.trace(N, axis1=1, axis2=2) for N in (one, other)], np.finfo(float).tiny))
    share = np.clip(sizes[0] / sizes.sum(axis=0), LEAST_SHARE, 1 - LEAST_SHARE)[:, None, None]
    return np.asarray(one / share + other / (1 - share))


def _lower(H: Array, N: Array, window: tuple[Array, Array, Array | Complex], rounding: Array) -> Array:
    """The least sigma over the corners of I + sum +-H_k, the rest N taken off, and over both ends of the positions."""
    (K, m, n, _), (unit, turn, beyond) = H.shape, window
    eye = np.eye(n)
    if m <= MOST_CORNERS:
        corners = eye + np.einsum("cj,kjab->kcab", signs(m), H)
    else:
        values, vectors = np.linalg.eigh(H)
        sizes = (vectors * np.abs(values)[..., None, :]) @ np.swapaxes(vectors, 2, 3)
        corners = (eye - sizes.sum(axis=1))[:, None]
    worst = _worst(corners, unit)
    share = np.einsum("ka,kab,kb->k", worst, N, worst)
    t = np.clip(np.sqrt(np.clip(share, 0.0, 1.0)), 1e-12, 1 - 1e-12)
    less = (1 - t - rounding)[:, None, None, None] * corners - ((1 / t - 1)[:, None, None] * N)[:, None]
    values, vectors = np.linalg.eigh(less - 2 * rounding[:, None, None, None] * eye)
    positive = (values[..., 0] > 0).all(axis=1)
    root = vectors / np.sqrt(np.maximum(values, 1e-300))[..., None, :]  # less^-1 = root root'
    far = np.zeros(K)
    for sign in (-1.0, 1.0):
        far = np.maximum(far, np.linalg.norm((unit + sign * turn)[:, None] @ root, 2, axis=(2, 3)).max(axis=1))
    far = far + np.linalg.norm(beyond[:, None] @ root, 2, axis=(2, 3)).max(axis=1)
    return np.where(positive, 1 / (far * (1 + ROUNDING * n)), 0.0)


def _worst(M: Array, unit: Array) -> Array:
    """Of each stack the u, u'Mu = 1, that `unit` makes largest over all corners; zero where some M is not positive."""
    values, vectors = np.linalg.eigh(M)
    positive = np.asarray((values[..., 0] > 0).all(axis=1))
    root = vectors / np.sqrt(np.maximum(values, 1e-300))[..., None, :]
    s, right = right_directions(unit[:, None] @ root)
    k, rows = np.argmax(s[..., 0], axis=1), np.arange(len(M))
    found = np.einsum("kab,kb->ka", root[rows, k], right[rows, k, 0])
    return np.where(positive[:, None], found, 0.0)
