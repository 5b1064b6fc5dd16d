"""The region of a nonlinear plant, and what its Jacobians are there: a box, cut by half-spaces."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.half_spaces import holds_a_point
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.declarations import Converted, above, below, frozen, plain
from sampling_design.records.record import Plain, Record

Box = tuple[Array, Array]

FAR = 10.0  # scales beyond zero up to which an unbounded entry is looked at: sampling only, proofs take it as unbounded


@frozen
class StateRegion(Record):
    """A convex set of states: lower <= x <= upper and rows x <= offsets.

    Parameters
    ----------
    lower, upper : (n,) arrays
        Infinite entries mean no bound.
    rows : (m, n) array, optional
    offsets : (m,) array, optional
    about : (n,) array, optional
        Where certificates linearise; default the middle of the box. It decides what a sample is taken to show of a
        nonlinear output: with C0 there, 2 C'R~C0 - C0'R~C0 stands for C'R~C, so that C0 should not be the larger one.

    Raises
    ------
    ArgumentError
        If sizes differ, no state is in the box and the half-spaces, or `about` lies outside of the box.
    """

    lower: Converted[npt.ArrayLike, Array]
    upper: Converted[npt.ArrayLike, Array]
    rows: Converted[npt.ArrayLike | None, Array] = None  # type: ignore[assignment]
    offsets: Converted[npt.ArrayLike | None, Array] = None  # type: ignore[assignment]
    about: Converted[npt.ArrayLike | None, Array] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        lower, upper = (checks.floats(key, getattr(self, key)) for key in ("lower", "upper"))
        wrong = lower.ndim != 1 or lower.shape != upper.shape or np.isnan([lower, upper]).any()
        if wrong or np.any(lower > upper):
            raise ArgumentError("`lower` and `upper` of a region must be vectors of one length, lower <= upper.")
        n = lower.size
        rows = checks.matrix("rows", np.zeros((0, n)) if self.rows is None else self.rows, None, n)
        offsets = checks.vector("offsets", () if self.offsets is None else self.offsets, len(rows))
        self._hold(lower=freeze(lower), upper=freeze(upper), rows=rows, offsets=offsets)
        if not (some := holds_a_point(lower, upper, rows, offsets)):
            empty, many = "hold a state: none is in its box and its half-spaces", "have fewer half-spaces to be judged"
            raise ArgumentError(f"`rows` and `offsets` of a region must {many if some is None else empty}.")
        about = self.middle if self.about is None else checks.vector("about", self.about, n)
        if not (np.all(lower <= about) and np.all(about <= upper)):
            raise ArgumentError("`about` must lie between `lower` and `upper` of the region.")
        self._hold(about=freeze(about))

    def holds(self, x: npt.ArrayLike) -> Mask:
        """Whether states (..., n) lie in the region."""
        points = checks.floats("x", x)
        inside = np.all((points >= self.lower) & (points <= self.upper), axis=-1)
        return np.asarray(inside & np.all(points @ self.rows.T <= self.offsets, axis=-1))

    @property
    def middle(self) -> Array:
        """The middle of the box; of an unbounded side the number nearest to 0."""
        whole = np.isfinite(self.lower) & np.isfinite(self.upper)
        with np.errstate(invalid="ignore"):
            return np.where(whole, self.lower / 2 + self.upper / 2, np.clip(0.0, self.lower, self.upper))

    def to_dict(self) -> dict[str, Plain]:
        """Plain data; unbounded ends are None."""
        return {
            "x": {"low": plain(self.lower), "high": plain(self.upper)},
            "rows": self.rows.tolist(),
            "offsets": self.offsets.tolist(),
        }

    def _rows(self) -> list[tuple[str, str]]:
        rows = [("lower", above(self.lower)), ("upper", below(self.upper))]
        return [*rows, *([("half-spaces", str(len(self.rows)))] if len(self.rows) else [])]

    def explain(self) -> str:
        """Say which states belong."""
        more = f" and {len(self.rows)} half-spaces" if len(self.rows) else ""
        return f"States between {above(self.lower)} and {below(self.upper)}{more}."


def _side(key: str, value: object, size: int) -> Array:
    side = checks.floats(f"bounds[{key!r}]", value)
    if side.shape not in ((), (size,)):
        raise ArgumentError(f"`bounds[{key!r}]` must be a pair (lower, upper) of numbers or of {size} entries each.")
    return np.broadcast_to(side, (size,)).copy()


def own_box(key: str, box: object, size: int) -> Box:
    """Return (lower, upper) as frozen vectors; infinite where there is no bound.

    Raises ArgumentError if lengths differ, a bound is NaN, or lower exceeds upper.
    """
    if box is None:
        box = (np.full(size, -np.inf), np.full(size, np.inf))
    pair = box.tolist() if hasattr(box, "tolist") else box
    sides = checks.entries(f"bounds[{key!r}]", pair, (2,), "a pair (lower, upper)")
    lower, upper = (_side(key, side, size) for side in sides)
    if np.any(np.isnan(lower)) or np.any(np.isnan(upper)) or np.any(lower > upper):
        raise ArgumentError(f"`bounds[{key!r}]` must be (lower, upper) with lower <= upper.")
    lower.flags.writeable = upper.flags.writeable = False
    return lower, upper


def drawn(lower: Array, upper: Array, scales: Array, count: int, rng: np.random.Generator) -> Array:
    """Points of a box: corners (up to 64), the middle, faces, and random ones; unbounded sides reach `FAR` scales."""
    below, above = np.isfinite(lower), np.isfinite(upper)
    low = np.where(below, lower, np.minimum(-FAR * scales, np.where(above, upper - FAR * scales, 0.0)))
    high = np.where(above, upper, np.maximum(FAR * scales, np.where(below, lower + FAR * scales, 0.0)))
    n = low.size
    signs = rng.random((64, n)) < 0.5 if n > 6 else (np.arange(2**n)[:, None] >> np.arange(n)) % 2 == 1
    corners = np.where(signs, high, low)
    inside = low + rng.random((count, n)) * (high - low)
    onto = rng.random((count, n)) < 0.4
    faces = np.where(onto, np.where(rng.random((count, n)) < 0.5, low, high), inside)
    return np.vstack([corners, (low + high)[None] / 2, inside, faces])
