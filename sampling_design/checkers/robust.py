"""Are matrices positive definite however far they are moved in given directions?

    F + sum_d s_d F_d + R > 0 for all |s_d| <= 1 and all R with |R| <= radius entrywise

A congruence with any W decides it as well: where W'(...)W > 0, W is regular and (...) > 0. With W about F^-1/2 the
first is about I, and what a direction takes from it is |W'F_d W| at most, |.| of a symmetric matrix that of its
eigenvalues. Signs of the widest directions are tried one after the other, and a branch ends where what those that are
left can take leaves it positive.
"""

import numpy as np

from .numbers import EPS
from .strict import Array, Mask

EIGENVALUES = 8  # those of an (m, m) matrix M are computed to within this times m eps |M|_F
MOST_BRANCHES = 1 << 13  # signs that are open at once for one matrix


def definite_robustly(form: Array, terms: Array, moves: Array, radius: Array) -> tuple[Array, int]:
    """A lower bound of what is left of I for each matrix (-1 where nothing is proven), and how many were tried.

    `form` (K, m, m), its directions `moves` (D, K, m, m), `radius` (K, m, m); `terms` bounds the sizes of all terms
    that any entry was summed from, directions included.
    """
    count, m = form.shape[:2]
    left = np.full(count, -1.0)
    d = np.sqrt(np.maximum(np.einsum("kii->ki", form), 0.0))
    fine = np.isfinite(form).all(axis=(1, 2)) & np.isfinite(radius).all(axis=(1, 2)) & (d > 0).all(axis=1)
    fine &= np.isfinite(moves).all(axis=(0, 2, 3)) & np.isfinite(terms).all(axis=(1, 2))
    if not fine.any():
        return left, 0
    at = np.flatnonzero(fine)
    form, terms, moves, radius, d = form[at], terms[at], moves[:, at], radius[at], d[at]
    values, vectors = np.linalg.eigh(form / (d[:, :, None] * d[:, None, :]))
    W = vectors / np.sqrt(np.maximum(values, EPS))[:, None, :] / d[:, :, None]
    Wt, size = np.swapaxes(W, 1, 2), np.abs(W)
    X = Wt @ form @ W
    Y = Wt @ moves @ W
    X, Y = (X + np.swapaxes(X, 1, 2)) / 2, (Y + np.swapaxes(Y, 2, 3)) / 2
    rounding = (8 * m + 2 * len(moves) + 40) * EPS * terms + radius * (1 + 16 * m * EPS)
    lost = np.linalg.norm(np.swapaxes(size, 1, 2) @ rounding @ size, axis=(1, 2)) * (1 + 16 * m * EPS)
    own, axes = np.linalg.eigh(Y)
    norms = np.abs(own).max(axis=2, initial=0.0)
    order = np.argsort(-norms.max(axis=1, initial=0.0))
    taken = (axes * np.abs(own)[:, :, None, :]) @ np.swapaxes(axes, 2, 3)  # |Y|, and the rounding of the eigenvalues
    taken = taken + (64 * m * EPS * norms)[:, :, None, None] * np.eye(m)
    found, spent = branched(X, Y[order], taken[order], lost, values[:, 0] > 0)
    left[at] = found
    return left, spent


def branched(X: Array, Y: Array, taken: Array, lost: Array, begin: Mask) -> tuple[Array, int]:
    """The least of what is left over all signs, found by branching; -1 where it is not positive."""
    m = X.shape[-1]
    least, failed, spent = np.full(len(X), np.inf), ~begin, 0
    rest = np.concatenate([np.cumsum(taken[::-1], axis=0)[::-1], np.zeros((1, *X.shape))])
    lost = lost + 4 * len(Y) * EPS * np.linalg.norm(rest[0], axis=(1, 2))
    owner, at = np.flatnonzero(begin), X[begin]
    for k in range(len(Y) + 1):
        if not len(owner):
            break
        spent += len(owner)
        bound, after = (np.linalg.eigvalsh(M)[:, 0] for M in (at, at - rest[k][owner]))
        room = EIGENVALUES * m * EPS * (np.linalg.norm(at, axis=(1, 2)) + np.linalg.norm(rest[k], axis=(1, 2))[owner])
        bound, after = bound - room - lost[owner], after - room - lost[owner]
        done = after > 0
        np.minimum.at(least, owner[done], after[done])
        failed[owner[bound <= 0]] = True  # no branch below it can be better in its middle
        going = ~done & ~failed[owner]
        if k == len(Y):
            failed[owner[going]] = True
            break
        owner, at = owner[going], at[going]
        crowded = np.bincount(owner, minlength=len(X)) > MOST_BRANCHES
        failed |= crowded
        keep = ~crowded[owner]
        owner, at = owner[keep], at[keep]
        step = Y[k][owner]
        owner, at = np.concatenate([owner, owner]), np.concatenate([at + step, at - step])
    return np.where(failed | ~np.isfinite(least), -1.0, least), spent
