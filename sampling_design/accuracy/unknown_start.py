"""A start of which nothing is known: gains must leave nothing of it, or it makes every bound infinite."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from sampling_design.accuracy.undetectable import unobservable_directions
from sampling_design.records.arrays import Array, Mask

CHANGED = 1e-11  # share of the gains, in units of the noise, that may be changed to take away what they leave: rounding
SETTLED = 1e-14  # share of them from which on a change is the last one

ROUNDS = 6
"""Changes of gains, at most: one may end the gain of a one-sided row at 0, and the next does without that row."""

PLAYS = (1e-5, 1e-8, 0.0)
"""Shares of the largest gain above which that of a one-sided row may change; the next where one leaves a rest. A
solver's zeros are no zeros, and to make much of them costs much."""

LEFT = 1e-12
"""What no such change takes away must be below this share of the terms that it is a difference of: rounding."""

CUT = 1e-13  # singular values below this share of the largest say nothing: rounding
NEAR = 10.0  # a trajectory that comes so near to readings, in units of their errors, is near enough

UNKNOWN = 1e-6
"""Share of a target, run back to the start, in directions that are not seen, from which on it is unbounded."""


class FreeStart:
    """What rows say of a start, and the least change of gains that takes away what they leave of it.

    Parameters
    ----------
    H : (R, n) array
        The rows, run back to the start.
    below : (R,) bool array
        One-sided rows: their gains are not negative, and only where one is positive may it shrink.
    unit : (R,) array
        Sizes of the rows' noise: the least change counts in them.

    Notes
    -----
    *Claim.* Where `closes` is true, gains that leave nothing at all lie within `CHANGED` of those given, and cost no
    more than rounding does. That a rest is small in itself says nothing: a direction that decays fast has small terms,
    and a start may be as large in it as in any other.
    """

    def __init__(self, H: Array, below: Mask, unit: Array):
        self._H, self._below, self._unit = H, below, unit
        self._backs: dict[bytes, tuple[Array, Array]] = {}

    @cached_property
    def _sizes(self) -> Array:
        """(n,) what all rows show of each entry of the start."""
        with np.errstate(over="ignore", invalid="ignore"):
            sizes = np.linalg.norm(self._H / self._unit[:, None], axis=0)
        return np.asarray(np.where(sizes > 0, sizes, 1.0))

    def _change(self, gains: Array, rest: Array, play: float) -> Array:
        """Return the least change (R,) of gains after which nothing that some rows show is left of a rest (n,).

        These are the two-sided ones, and one-sided ones whose gains are above a share of the largest.
        """
        own = gains * self._unit
        usable = ~self._below | (own > play * np.abs(own).max(initial=0.0))
        key = usable.tobytes()
        if key not in self._backs:
            self._backs[key] = self._back(usable)
        back, sizes = self._backs[key]
        return np.asarray(back @ (rest / sizes) / self._unit)

    def _back(self, usable: Mask) -> tuple[Array, Array]:
        """What takes a rest away, and the sizes (n,) in which the start's entries count alike."""
        rows = np.where(usable[:, None], self._H, 0.0) / self._unit[:, None]
        with np.errstate(over="ignore", invalid="ignore"):
            sizes = np.linalg.norm(rows, axis=0)
        if not np.isfinite(sizes).all():
            return np.zeros_like(rows), np.ones(rows.shape[1])
        sizes = np.where(sizes > 0, sizes, 1.0)
        return np.asarray(np.linalg.pinv((rows / sizes).T, rcond=CUT)), sizes

    def _small(self, change: Array, gains: Array, share: float) -> bool:
        """Whether gains change by no more than a share."""
        return bool(np.abs(change) @ self._unit <= share * (np.abs(gains) @ self._unit))

    def without(self, gains: Array, begun: Array, rest: Callable[[Array], Array]) -> Array:
        """Return gains after the least change that leaves nothing; `rest` says what gains leave of a target `begun`."""
        own = gains
        for play in PLAYS:
            own = gains
            for _ in range(ROUNDS):
                change = self._change(own, rest(own), play)
                settled = self._small(change, own, SETTLED)
                own = own + change
                own = np.where(self._below, np.maximum(own, 0.0), own)
                if settled:
                    break
            if not self._below.any() or self.closes(own, begun, rest(own)):
                break
        return own

    def closes(self, gains: Array, begun: Array, rest: Array) -> bool:
        """Whether what gains leave is rounding: a change of them as small takes it away, and no one-sided row turns."""
        with np.errstate(over="ignore", invalid="ignore"):
            terms = (np.abs(begun) + np.abs(gains) @ np.abs(self._H)) / self._sizes
        most = LEFT * np.linalg.norm(terms)
        for play in PLAYS:
            change = self._change(gains, rest, play)
            if self._small(change, gains, CHANGED) and np.all((gains + change)[self._below] >= 0):
                with np.errstate(over="ignore", invalid="ignore"):
                    left = np.linalg.norm((rest - change @ self._H) / self._sizes)
                if not left > most:  # where rows have grown beyond all numbers, nobody can say
                    return True
        return False

    def start(self, residuals: Array) -> Array:
        """Return a start (n,) that shows about what two-sided rows showed.

        Only in the directions in which it must, to come within `NEAR` of them: where little is seen of one, noise alone
        would make it large.
        """
        rows = np.where(self._below[:, None], 0.0, self._H) / self._unit[:, None]
        size = np.linalg.norm(rows, axis=0)
        if not np.isfinite(size).all():
            return np.zeros(len(size))
        size = np.where(size > 0, size, 1.0)
        left, singular_values, right = np.linalg.svd(rows / size, full_matrices=False)
        part = left.T @ (residuals / self._unit)
        needed = (singular_values > CUT * singular_values.max(initial=0.0)) & (np.abs(part) > NEAR)
        return np.asarray(np.where(needed, part / np.where(needed, singular_values, 1.0), 0.0) @ right / size)

    @cached_property
    def _unobservable(self) -> Array:
        """(n, m) directions of the start that no row shows."""
        return unobservable_directions(self._H)

    def hides(self, begun: Array) -> bool:
        """Whether a target, run back to the start (n,), holds something that no gains can take away."""
        if not self._unobservable.size:
            return False
        return bool(np.linalg.norm(begun @ self._unobservable) > UNKNOWN * np.linalg.norm(begun))
