"""The exact two-dimensional projection of the set of states that nobody can exclude, between two polygons."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.between_samples import open_row
from sampling_design.accuracy.bounds import InitialSet
from sampling_design.accuracy.deviation import WALK
from sampling_design.accuracy.finite import DIFFUSE
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.riccati import in_turn, strong
from sampling_design.accuracy.sampled_system import SampledSystem
from sampling_design.accuracy.search import GainSearch
from sampling_design.accuracy.witness import attains, physical
from sampling_design.errors import ArgumentError
from sampling_design.numerics.filtering import CovarianceMap, information_update, propagate
from sampling_design.numerics.linalg import discounted_flow
from sampling_design.plants.functional import requested_rows
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.record import PlainRecord, above, below, moment, short
from sampling_design.records.signatures import checked

DISCOUNTS = np.geomspace(1e-3, 10.0, 13)  # Discounts of an ellipsoid over a mean gap that are tried
SHARES = np.geomspace(1e-2, 0.9, 9)  # shares of a sample in an ellipsoid that are tried


class ProjectionAreas(NamedTuple):
    """Areas of the polygon that is possible, of the one outside which nothing is, and of the ellipse."""

    inner: float
    outer: float
    ellipse: float


@dataclass(frozen=True, eq=False, repr=False)
class Projection(PlainRecord):
    """What data that read zero leave possible of two rows at one time: a convex set about 0, inner <= set <= outer.

    Attributes
    ----------
    names, units : tuple of two str
    t : float
    outer : (m, 2) array
        Corners of a polygon that holds the set, proven by gains: { p : |c'p| <= upper(c) } over some dozen c.
    inner : (k, 2) array
        Corners of a polygon inside it: points that adversaries attain.
    ellipse : (2, 2) array
        Q with { p : p'Q^-1 p <= 1 }, the projection of the best ellipsoid that a filter with one discount proves for
        the same bounds: what estimators with quadratic costs know.
    """

    names: tuple[str, str]
    units: tuple[str, str]
    t: float
    time_unit: str
    outer: Array
    inner: Array
    ellipse: Array

    _plain = "names t outer inner ellipse"

    def areas(self) -> ProjectionAreas:
        """Areas of inner polygon, outer polygon and ellipse."""
        ellipse = float(np.pi * np.sqrt(max(np.linalg.det(self.ellipse), 0.0)))
        return ProjectionAreas(_area(self.inner), _area(self.outer), ellipse)

    def _rows(self) -> list[tuple[str, str]]:
        inner, outer, ellipse = self.areas()
        return [
            ("rows", " and ".join(self.names)),
            ("t", f"{moment(self.t)} {self.time_unit}"),
            ("area", f"{below(inner)} to {above(outer)}"),
            ("area of the ellipse", f"{above(ellipse)}, {short(ellipse / outer, 3)} times that"),
        ]

    def explain(self) -> str:
        """Say how large the set is."""
        inner, outer, ellipse = self.areas()
        return (
            f"At {moment(self.t)} {self.time_unit} nobody can place {' and '.join(self.names)} better than within a "
            f"set of area {below(inner, 4)} to {above(outer, 4)}; the ellipse of a quadratic cost has "
            f"{above(ellipse, 4)}."
        )


@checked
def project_rows(
    question: AccuracyQuestion, first: str, second: str, t: float, directions: int, back: int, deep: int
) -> Projection:
    """Return the projection of { x : c'x <= rho(c; t) for all c } on two states or outputs.

    Parameters
    ----------
    question : AccuracyQuestion
        Asked anew, for other rows.
    first, second : str
        Names of states or outputs.
    t : float
        Within the period, or the finite schedule; at a sample: after it.
    directions : int
        Rows c, spread over half a turn in units of the two half-widths.
    back, deep : int
        Samples that gains and trajectories look back.

    Returns
    -------
    Projection

    Raises
    ------
    ArgumentError
        If a name is unknown, both are one, `t` lies outside, or one of the rows is not known at `t`.

    Notes
    -----
    *Claim.* Data that read zero leave possible what lies between both polygons, and nothing outside the outer one.
    *Method.* The program of `guaranteed_accuracy` for rows c'(first, second); every polygon holds for all c between
    them, too. The ellipsoid obeys X' = AX + XA' + bX + GG'/b between samples and X^-1 <- (1 - a) X^-1 + a C'C at
    them, in units of the bounds; b and a make the ellipse's area least.

    References
    ----------
    Milanese and Tempo (1985); Schweppe, Recursive state estimation: unknown but bounded errors and system inputs
    (1968).
    """
    if question.is_late:
        raise ArgumentError(
            "`projection` is of samples on time, known at once: leave `timing_tolerance`, `result_delay` out."
        )
    rows = requested_rows(question.plant, [first, second])
    if np.linalg.matrix_rank(rows.matrix) < 2:
        raise ArgumentError(f"`second` must be another row than `first`, got {first!r} and {second!r}.")
    count = checks.whole("directions", directions, 4)
    known = question.known()
    if any(known.touches(row) for row in rows.matrix):
        raise ArgumentError(f"`first` and `second` must be known, got {first!r} and {second!r}.")
    at = checks.number("t", t)
    if not question.nodes[0] <= at <= question.end:
        raise ArgumentError(f"`t` must lie in [{float(question.nodes[0])!r}, {question.end!r}], got {at!r}.")
    node = int(np.searchsorted(question.nodes, at, side="right")) - 1
    search = GainSearch(*question.filter_bounds(known.plant, known.moving))
    search.back, search.deep = back, deep
    lifted = rows.matrix @ known.lift
    sizes = np.array([_reached(search, node, row, at - question.nodes[node], question)[0] for row in lifted])
    if not np.all(np.isfinite(sizes)):
        raise ArgumentError(f"`t` must be a time at which both rows are known, got {at!r}.")
    sizes = np.where(sizes > 0, sizes, 1.0)
    planes, points = [], []
    for angle in np.pi * np.arange(count) / count:
        c = np.array([np.cos(angle), np.sin(angle)]) / sizes
        upper, x = _reached(search, node, c @ lifted, at - question.nodes[node], question)
        planes.append(c / max(upper, np.finfo(float).tiny))
        points.append(lifted @ x)
    both = np.vstack([points, np.negative(points)])
    shape = _ellipse(search.system, question, node, at - question.nodes[node], lifted)
    return Projection(
        (first, second),
        (rows.units[0], rows.units[1]),
        at,
        question.plant.time_unit,
        freeze(_polar(np.vstack([planes, np.negative(planes)]))),
        freeze(_hull(both / sizes) * sizes),
        freeze(shape),
    )


def _reached(search: GainSearch, node: int, row: Array, d: float, question: AccuracyQuestion) -> tuple[float, Array]:
    """The bound on a row at d after a node, and the state that an admissible adversary reaches against it."""
    system = search.system
    opened = open_row(system, node, row, d)
    mu = opened.mu[-1]
    if not np.isfinite(search.directions[node].rest(mu[None], mu[None])[0]):
        return np.inf, np.zeros(system.D.size)
    best = min(search.both_sides(node, mu)[0].value, search.gains(node, mu).value)
    adversary = search.adversaries[node][-1]
    witness = physical(row, opened, adversary, opened.d.size - 1 if d else 0)
    _, excess = attains(witness, question.bounds, question.initial, question.gaps)
    _, x, _ = witness.simulate()
    return best + float(opened.above[-1]), x / max(excess, 1.0) if np.isfinite(excess) else np.zeros(system.D.size)


def _polar(planes: Array) -> Array:
    """Corners of { p : planes p <= 1 }, in order."""
    from scipy.spatial import ConvexHull

    scale = np.max(np.abs(planes), axis=0)
    hull = ConvexHull(planes / scale)
    normals = hull.equations / -hull.equations[:, 2:]
    corners = normals[:, :2] / scale
    return np.asarray(_hull(corners * scale) / scale, dtype=np.float64)


def _hull(points: Array) -> Array:
    """Corners of the convex hull in order; a segment's ends where it is flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices], dtype=np.float64)
    except QhullError:
        order = np.argsort(points @ points[np.argmax(np.linalg.norm(points, axis=1))])
        return np.asarray(points[order[[0, -1]]], dtype=np.float64)


def _area(corners: Array) -> float:
    x, y = corners.T
    return float(abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) / 2)


def _ellipse(system: SampledSystem, question: AccuracyQuestion, node: int, d: float, rows: Array) -> Array:
    """Projection of the best ellipsoid with one discount and one share for every sample."""
    best, least = np.full((2, 2), np.inf), np.inf
    lengths = np.diff(question.nodes, append=question.end)
    mean = float(np.mean(lengths[lengths > 0])) if np.any(lengths > 0) else 1.0
    flat = rows * system.D
    for discount in DISCOUNTS / mean:
        for share in SHARES:
            X = _ellipsoid(system, question.initial, lengths, node, d, float(discount), float(share))
            if X is None:
                continue
            Q = flat @ X @ flat.T
            area = float(np.linalg.det(Q / np.outer(np.sqrt(np.diag(Q)), np.sqrt(np.diag(Q))))) * float(
                np.prod(np.diag(Q))
            )
            if np.isfinite(area) and 0 < area < least:
                best, least = Q, area
    return best


def _ellipsoid(
    system: SampledSystem,
    initial: InitialSet | None,
    lengths: Array,
    node: int,
    d: float,
    discount: float,
    share: float,
) -> Array | None:
    """X at d after a node, in units of D: of the error's ellipsoid e'X^-1 e <= 1."""
    n, q = system.G.shape
    noise = system.G @ system.G.T * (1.0 if system.bounds.w_ball else float(q)) / discount
    F, W = discounted_flow(system.A, noise, np.append(lengths, d), discount)
    F = F * np.exp(discount / 2 * np.append(lengths, d))[:, None, None]
    information = []
    for sample, L in zip(system.samples, system.L, strict=True):
        H = np.linalg.solve(L.T, sample.H.T).T
        parts = 1.0 if system.bounds.v_ball else float(max(len(H), 1))
        information.append(share / parts * H.T @ H)
    kept = [1 - share if len(s.H) else 1.0 for s in system.samples]
    if initial is None:
        steps = zip(F[:-1], W[:-1], information, kept, strict=True)
        period = in_turn(CovarianceMap(f / np.sqrt(k), G / k, w) for f, w, G, k in steps)
        X = strong(period, np.eye(n) * DIFFUSE, WALK)
    else:
        S = initial.rows * system.D
        known = S.T @ S / (1.0 if initial.ball else max(len(S), 1)) + np.eye(n) / DIFFUSE
        known[initial.exact, initial.exact] += DIFFUSE
        X = np.asarray(np.linalg.inv(known))
    if not np.all(np.isfinite(X)):
        return None
    for j in range(node + 1):
        X = information_update(X / kept[j], information[j])
        step = j if j < node else -1
        X = propagate(X, F[step], W[step])
    return X if np.all(np.isfinite(X)) else None
