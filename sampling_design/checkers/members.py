"""Which matrices a model holds, and whether all of them are positive: each least eigenvalue with a bound of rounding.

A box of parameters and a list of vertices are both B + sum x_k M_k: x between the corners of a box, or shares that sum
to one. A matrix that fails is named by its parameters.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from .inclusion_file import Box, Inclusion, Parameter, Vertices
from .numbers import EPS
from .outcome import Refused, Undecided
from .slopes import Parts
from .strict import Array, Mask

EIGENVALUES = 8  # those of an (n, n) matrix M are computed to within this times n eps |M|_F
MOST_PARAMETERS = 10  # of a box whose corners are tried one by one; beyond that multipliers are needed


def bounds(form: Array, terms: Array, radius: Array | None = None) -> Parts:
    """Lower and upper bounds of the least eigenvalue of each matrix, relative to the size of its diagonal's terms."""
    d = np.sqrt(np.einsum("kii->ki", terms))
    d = np.where(d > 0, d, 1.0)
    scale = d[:, :, None] * d[:, None, :]
    M, m = form / scale, form.shape[-1]
    values = np.linalg.eigvalsh(M)[:, 0]
    rounding = EPS * (
        (m + 16) * np.linalg.norm(terms / scale, axis=(1, 2)) + EIGENVALUES * m * np.linalg.norm(M, axis=(1, 2))
    )
    if radius is not None:
        rounding = rounding + np.linalg.norm(radius / scale, axis=(1, 2))
    rounding = np.where(np.isfinite(rounding), rounding, np.inf)
    return values - rounding, values + rounding


def least(
    name: str,
    form: Array,
    terms: Array,
    times: Array | None = None,
    radius: Array | None = None,
    who: Callable[[int], str] = lambda k: "",
) -> float:
    """The least slack of matrices that are all members of the claim; Refused or Undecided where one is not positive.

    `who` says of which plant the k-th is.
    """
    below, above = bounds(form, terms, radius)
    k = int(np.argmin(above))
    when = None if times is None else float(times[k])
    at = "" if when is None else f" at tau = {when:.6g}"
    if above[k] < 0:
        what = f"{name} fails by {-above[k]:.3g} of the size of its terms{at}{who(k)}"
        raise Refused(name, what, float(above[k]), when)
    k = int(np.argmin(below))
    if not below[k] > 0:
        when = None if times is None else float(times[k])
        raise Undecided(name, f"{name} could not be decided: it is tight or nearly so", float(below[k]), when)
    return float(below[k])


@dataclass(frozen=True)
class Members:
    """All base + sum_k x_k parts[k], x in the hull of the rows of `points` (V, d)."""

    base: Array
    parts: Array
    points: Array
    model: Box | Vertices
    acting: tuple[Parameter, ...]

    def at(self, points: Array) -> Parts:
        """The matrices at some points, and the rounding of each entry."""
        size = np.abs(self.base) + np.tensordot(np.abs(points), np.abs(self.parts), 1)
        exact = self.model.kind == "vertices" and np.all((points == 0) | (points == 1))
        rounding = 0.0 if exact else (len(self.parts) + 4) * EPS
        return self.base + np.tensordot(points, self.parts, 1), rounding * size

    def rows(self, measured: Mask) -> "Members":
        """Those rows alone."""
        return replace(self, base=self.base[measured], parts=self.parts[:, measured])

    def name(self, point: Array) -> str:
        """Which plant it is, in words."""
        if self.acting:
            values = (f"{each.name} = {each.nominal + x:.6g}" for each, x in zip(self.acting, point, strict=True))
            return f" where {', '.join(values)}"
        if self.model.kind == "box":
            return ""
        shares = ", ".join(f"{x:.6g} of vertex {k}" for k, x in enumerate(point.tolist()) if x)
        return f" where the plant is {shares}"

    def halves(self, points: Array) -> Iterator[Array]:
        """Two hulls that together hold that of some points: a box is halved, or the longest side of a simplex."""
        if self.model.kind == "box":
            low, high = points.min(axis=0), points.max(axis=0)
            k = int(np.argmax((high - low) * np.sqrt(np.square(self.parts).sum(axis=(1, 2)))))
            middle = low[k] / 2 + high[k] / 2
            for ends in ((low[k], middle), (middle, high[k])):
                sides = np.stack([low, high], axis=1)
                sides[k] = ends
                yield np.array(list(product(*sides)))
            return
        M = self.at(points)[0]
        far = np.square(M[:, None] - M[None]).sum(axis=(2, 3))
        i, j = divmod(int(np.argmax(far)), len(points))
        for one in (i, j):
            other = points.copy()
            other[one] = points[i] / 2 + points[j] / 2
            yield other


def members(
    c: Inclusion, base: Array, part: Callable[[Parameter], Array], stack: Callable[[Vertices], Array]
) -> Members:
    """The matrices of one kind in a model that is a box or a list."""
    if c.model.kind == "vertices":
        found = stack(c.model)
        return Members(np.zeros_like(base), found, np.eye(len(found)), c.model, ())
    assert c.model.kind == "box"
    acting = tuple(each for each in c.model.parameters if part(each).any() and each.low < each.high)
    if len(acting) > MOST_PARAMETERS:
        raise Undecided("corners", f"{len(acting)} parameters have too many corners: the file has no multipliers")
    ends = list(product(*((each.low - each.nominal, each.high - each.nominal) for each in acting)))
    parts = np.array([part(each) for each in acting]).reshape(len(acting), *base.shape)
    return Members(base, parts, np.array(ends).reshape(2 ** len(acting), len(acting)), c.model, acting)


def joint(c: Inclusion) -> Members:
    """(A, G) side by side."""
    return members(
        c,
        np.hstack([c.plant.A, c.plant.G]),
        lambda each: np.hstack([each.A, each.G]),
        lambda model: np.concatenate([model.A, model.G], axis=2),
    )


def outputs(c: Inclusion) -> Members:
    """C."""
    return members(c, c.plant.C, lambda each: each.C, lambda model: model.C)
