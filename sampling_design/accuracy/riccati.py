"""The filter's covariance on an endless schedule, by doubling: maps P -> Q + F P (I + G P)^-1 F' and their products.

Every map is three matrices (F, G, Q), G and Q positive semidefinite; two of them make a third without a difference
(structure-preserving doubling), so that nothing cancels.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from sampling_design.accuracy.undetectable import OTHER_STATES
from sampling_design.errors import UndecidedError
from sampling_design.numerics import filtering
from sampling_design.numerics.filtering import CovarianceMap
from sampling_design.numerics.linalg import psd_root, right_directions
from sampling_design.records.arrays import Array, Index, Mask

COARSER = (1e-5, 1e-4, 1e-3, 1e-2)
"""Noise that the filter takes a sensor to have at least, in units of what w does to a period's outputs, until its
covariance settles: for scaling only."""

RANDOM_WALK = 1e-3
"""Share of a free start's covariance that joins the filter's noise at each period, so that it never goes to sleep."""

REFINED = 1e-18  # share of what is too much that may be left of a bound on all samples' errors
SETTLED = 1e-14  # relative change of a doubled covariance at which it counts as the limit
DOUBLINGS = 60  # 2^60 periods: what has not settled by then does not

UNSTABLE = 1e-9
"""A filter whose error grows by more than this share over a period from P = 0 has to be started elsewhere."""

REPRODUCED = 1e-5
"""Relative change over a period, and growth of an error, below which what doubling found is the limit; above what a
small random walk leaves of trajectories that neither grow nor decay and that no noise reaches."""

STEADY = 1e-9
"""Relative change over a period at which roots have settled."""

FADED = 1e-4
"""Share of a start that changes of a deviation are judged beside at least: what decays and no noise reaches has no size
of its own."""

MOST_PERIODS = 64
"""Periods of roots, where doubling has failed: the error of a mode that grows by e^k falls by as much each period."""


def in_turn(maps: Iterable[CovarianceMap]) -> CovarianceMap:
    """Return the map that applies all of them, the first one first."""
    return reduce(CovarianceMap.then, maps)


def strong(period: CovarianceMap, start: Array, share: float) -> Array:
    """Return the limit of repeated periods from any P > 0: that from 0 unless it lets an error grow.

    A mode that grows and that no noise reaches stays hidden from P = 0; a random walk of so small a `share` of what
    periods from `start` leave wakes it.
    """
    P = limit(period)
    closed = period.F @ np.linalg.inv(np.eye(len(P)) + P @ period.G)
    if np.max(np.abs(np.linalg.eigvals(closed)), initial=0.0) <= 1 + UNSTABLE:
        return P
    return limit(CovarianceMap(period.F, period.G, period.Q + share * period.repeated()(start)))


def limit(period: CovarianceMap) -> Array:
    """Return the limit of repeated periods from P = 0, the least covariance that reproduces itself.

    Where a trajectory grows so far that doubling loses it, what is returned does not reproduce itself (`RootedPeriod`).
    """
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(DOUBLINGS):
            twice = period.then(period)
            if not all(np.isfinite(M).all() for M in (twice.F, twice.G, twice.Q)):
                break
            size = np.sqrt(np.diag(twice.Q))
            settled = np.all(np.abs(twice.Q - period.Q) <= SETTLED * np.outer(size, size))
            period = twice
            if settled:
                break
    return period.Q


@dataclass(frozen=True, eq=False)
class RootedPeriod:
    """A period of a filter by roots of its covariances: steps F between samples, rows in units of their noise, and
    roots of the noise that joins behind each sample.

    Between samples that e^k parts, a covariance has a condition of e^2k, a root has e^k: roots tell where doubling
    went wrong, and find what it has lost.
    """

    F: list[Array]
    rows: list[Array]
    noise: list[Array]

    def __call__(self, root: Array) -> tuple[list[Array], Array, Array]:
        """Return roots after each sample, that at the period's end from one at its beginning, and what becomes of an
        error that was made there."""
        after, error = [], np.eye(len(root))
        for F, H, noise in zip(self.F, self.rows, self.noise, strict=True):
            root, step, _ = filtering.root_update(filtering.largest_first(root), H, -H @ error)
            error = F @ (error + step)
            after.append(root)
            root = filtering.carried(root, F, noise)
        return after, root, error

    def exactly(self, root: Array, exact: Sequence[Mask], rounding: float, periods: int = 1) -> list[Array]:
        """Return roots after each sample of the last period, where `exact` sensors have no noise at all.

        What a root leaves of a state that is known is rounding, which has no size to be judged by: what is `unknown` is
        followed beside it as a space, where a row at an angle below `rounding`, or noise below that share, is none.
        """
        unknown, after = np.eye(len(root)), list[Array]()
        for F, H, noise, own in [*zip(self.F, self.rows, self.noise, exact, strict=True)] * periods:
            if not own.all():
                root = filtering.root_update(
                    filtering.largest_first(root), H[~own], np.zeros((np.count_nonzero(~own), 1))
                )[0]
            for row in H[own]:
                shown = row @ unknown
                if np.linalg.norm(shown) > rounding * np.linalg.norm(row):
                    left, rest = filtering.exact_update(unknown.T @ root, shown), right_directions(shown[None])[1][1:].T
                    unknown = unknown @ rest
                    root = unknown @ (rest.T @ left)
            after.append(root)
            unknown = np.linalg.qr(F @ unknown)[0]
            beside, sizes, _ = np.linalg.svd(noise - unknown @ (unknown.T @ noise))
            driven = np.count_nonzero(sizes > rounding * np.linalg.norm(noise))
            unknown = np.hstack([unknown, beside[:, :driven]])
            root = unknown @ (unknown.T @ filtering.carried(root, F, noise))
        return after[-len(self.F) :]

    def walking(self, noise: Array) -> RootedPeriod:
        """The period with this noise, a root, joining at its end."""
        return replace(self, noise=[*self.noise[:-1], np.hstack([self.noise[-1], noise])])

    def gives_back(self, root: Array) -> bool:
        """Whether a period ends with the covariance that it began with, and lets no error grow: of all that give back
        themselves, that is the one."""
        _, end, error = self(root)
        grown = float(np.max(np.abs(np.linalg.eigvals(error)), initial=0.0))
        return _differ(end, root) <= REPRODUCED and grown <= 1 + REPRODUCED

    def settled(self, root: Array) -> list[Array]:
        """Return roots after each sample of the period that all come to, begun from a `root` of full rank.

        Raises UndecidedError if they do not settle in doubles.
        """
        after, end, _ = self(root)
        last = [root, *after]
        least, change, root = [FADED * np.linalg.norm(each, axis=1) for each in last], np.inf, end
        for _ in range(MOST_PERIODS):
            after, root, _ = self(root)
            now = [root, *after]  # what a gap hides behind what grows shows after samples
            change = max(_differ(*each) for each in zip(now, last, least, strict=True))
            if change <= STEADY:
                return after
            last = now
        if change <= REPRODUCED:  # of growth that leaves no more digits, or of a random walk
            return after
        raise UndecidedError(
            "undecided: the covariance of the filter on this schedule does not settle in doubles. Do modes grow far "
            f"between two samples, or do outputs differ in almost nothing? {OTHER_STATES}"
        )


def _differ(one: Array, two: Array, least: Array | float = 0.0) -> float:
    """The largest difference of two covariances beside their diagonals, or beside what is the least of a deviation."""
    first, second = one @ one.T, two @ two.T
    size = np.maximum(np.sqrt(np.maximum(np.diag(first), np.diag(second))), least)
    size = np.where(size > 0, size, 1.0)
    return float(np.max(np.abs(first - second) / np.outer(size, size), initial=0.0))


def settled(F: Array, W: Array, rows: list[Array]) -> tuple[list[Array], list[Array], list[Array]]:
    """`_covariances` with their own noise or the first of `COARSER` that lets them settle, and rows' shares then.

    Of sensors that are nearly exact a covariance has no digit left across what they show. Coordinates and gains need
    none: what these prove is counted with the sensor's own noise.
    """
    reached = [np.sqrt(np.maximum(np.einsum("pi,kij,pj->p", H, W, H), 0.0)) for H in rows]
    most = max((float(each.max(initial=0.0)) for each in reached), default=0.0)

    def with_noise(coarser: float) -> tuple[list[Array], list[Array], list[Array]]:
        shares = [1 / np.maximum(1.0, coarser * each) for each in reached]
        return *_covariances(F, W, [H * own[:, None] for H, own in zip(rows, shares, strict=True)]), shares

    *tried, last = (0.0, *(coarser for coarser in COARSER if coarser * most > 1))
    for coarser in tried:
        with suppress(UndecidedError):
            return with_noise(coarser)
    return with_noise(last)


def _covariances(F: Array, W: Array, rows: list[Array]) -> tuple[list[Array], list[Array]]:
    """The filter's covariance before each sample, in its periodic limit, and a root of that after it."""
    maps = [CovarianceMap(f, H.T @ H, w) for f, H, w in zip(F, rows, W, strict=True)]
    rooted = RootedPeriod(list(F), rows, [filtering.covariance_root(w) for w in W])
    start = np.eye(F.shape[1])
    try:
        period = in_turn(maps)
        several = period.repeated()
        known = np.diag(several.G)
        start = np.diag(1 / np.where(known > 0, np.maximum(1e-9 * known, np.finfo(float).tiny), 1.0))
        walk = RANDOM_WALK * several(start)
        P = [limit(CovarianceMap(period.F, period.G, period.Q + walk))]
        followed = rooted.walking(psd_root(walk)).gives_back(psd_root(P[0]))
    except np.linalg.LinAlgError:  # of a condition beyond doubles: on which side of singular it falls is rounding's
        followed = False
    if not followed:
        return _by_roots(rooted, np.sqrt(np.diag(start)))
    for following in maps[:-1]:
        P.append(following(P[-1]))
    after = [filtering.information_update(X, H.T @ H) for X, H in zip(P, rows, strict=True)]
    return P, [_root_of(X) for X in after]


def _root_of(X: Array) -> Array:
    """A root of a covariance, of what has decayed beyond numbers beside the rest: any coordinates serve it."""
    size = np.diag(X)
    least = np.finfo(float).eps ** 2 * (float(size.max(initial=0.0)) or 1.0)
    return np.asarray(np.linalg.cholesky(X + np.diag(np.maximum(1e-15 * size, least))), dtype=np.float64)


def _by_roots(rooted: RootedPeriod, start: Array) -> tuple[list[Array], list[Array]]:
    """The same where a covariance in doubles has lost what modes that grow leave of it."""
    root = np.diag(start)
    for _ in range(len(start) + 1):
        _, root, _ = rooted(root)
    rooted = rooted.walking(np.sqrt(RANDOM_WALK) * root)
    after = rooted.settled(root)
    propagated = [np.hstack([F @ X, own]) for F, X, own in zip(rooted.F, after, rooted.noise, strict=True)]
    return [X @ X.T for X in [propagated[-1], *propagated[:-1]]], after


def least_bounds(costs: Array, rests: Array, at: Index) -> Array:
    """Return the least R (N, r) with R_j = cost_j + |rest_j|'R_k, k = at_j, for rests (N, n, r).

    Infinite if they do not contract.
    """
    rests = np.abs(rests[:, : costs.shape[1]])
    share = max(float(rests.sum(axis=1).max(initial=0.0)), np.finfo(float).eps)
    if share >= 1:
        return np.full(costs.shape, np.inf)
    found = np.full(costs.shape, float(costs.max(initial=0.0)) / (1 - share))
    for _ in range(int(np.ceil(np.log(REFINED) / np.log(share)))):
        found = costs + np.einsum("jik,ji->jk", rests, found[at])
    return found
