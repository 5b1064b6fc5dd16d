"""The upper bound as evidence: multipliers in the plant's own coordinates, checked without any solver."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from sampling_design._linalg import expm_batch
from sampling_design.design.averaged import averaged_bound, relax_averaged
from sampling_design.design.bound import placed_bound
from sampling_design.design.largest_gap import applies, gap_range, relax_zones, zone_bound
from sampling_design.design.problem import DesignProblem
from sampling_design.design.relaxation import Relaxation
from sampling_design.errors import ArgumentError

Array = npt.NDArray[np.floating[Any]]
Method = Literal["placed", "averaged", "largest gap"]
Progress = Callable[[float, str], None]

_NEGLIGIBLE = 1e-7  # multipliers below this share of the total are left out: the bound holds with any of them
_SPREAD = 4  # parts into which a multiplier is spread over the time to the next window start

_PATIENCE = 2  # splits in a row that win less than a fiftieth of the gap: more would be waste
_FIRST_CUTS = (1.2, 1.3, 1.45, 2.0)  # of the largest gap, in mean gaps: about there the two bounds change places


@dataclass(frozen=True, eq=False)
class BoundPart:
    """Multipliers that bound all schedules whose largest gap lies in [low, high].

    `weights` (M, n, n) are psd in the coordinates of the designed plant with traces that sum to one, for
    windows that start at `starts`; `tilt` (k-1,) only for the method "averaged". "placed" bounds all
    schedules, whatever their gaps, and is the only method that knows forbidden and several fixed times;
    `price` is its multiplier of the cost limit.
    """

    method: Method
    low: float
    high: float
    starts: Array
    weights: Array
    tilt: Array
    value: float = np.inf
    price: float = 0.0

    def value_for(self, problem: DesignProblem) -> float:
        """The bound that these multipliers prove for `problem`; infinite where they prove nothing."""
        total = float(np.trace(self.weights, axis1=1, axis2=2).sum())
        least = float(np.linalg.eigvalsh(self.weights).min(initial=0.0))
        sound = np.all(np.isfinite(self.tilt)) and np.isfinite(self.price) and self.price >= 0
        if not total > 0 or least < -1e-12 * total or not sound:
            return np.inf
        R = problem.rows.R
        Z = R @ (self.weights / total) @ R.T
        if self.method == "placed":
            return placed_bound(problem, self.starts, Z, self.price)
        if not applies(problem):
            return np.inf
        if self.method == "averaged":
            if self.tilt.size != problem.samples - 1:
                return np.inf
            return averaged_bound(problem, self.starts, Z, self.tilt, self.high)
        return zone_bound(problem, self.starts, Z, self.low, self.high)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        plain = {key: getattr(self, key).tolist() for key in ("starts", "weights", "tilt")}
        return {
            "method": self.method,
            "low": self.low,
            "high": self.high,
            "value": self.value,
            "price": self.price,
            **plain,
        }


@dataclass(frozen=True, eq=False)
class UpperBound:
    """The sigma that no admissible schedule over all real times can beat, with the multipliers that prove it.

    Attributes
    ----------
    value : float
        The largest of the parts' bounds.
    parts : tuple of BoundPart
        One part that covers all schedules, or several that cover every size of the largest gap.
    """

    value: float
    parts: tuple[BoundPart, ...]

    @property
    def method(self) -> str:
        """Which argument proves it: that of the part with the largest bound."""
        return max(self.parts, key=lambda p: p.value).method

    def value_for(self, problem: DesignProblem) -> float:
        """Work the bound out anew from the multipliers; infinite where the parts leave schedules uncovered."""
        if not _covers(self.parts, problem):
            return np.inf
        return max(part.value_for(problem) for part in self.parts)

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {"value": self.value, "parts": [part.to_dict() for part in self.parts]}

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> UpperBound:
        """The inverse of `to_dict`.

        Raises
        ------
        ArgumentError
            If a part names an unknown method.
        """
        parts = []
        for entry in data["parts"]:
            if entry["method"] not in ("placed", "averaged", "largest gap"):
                raise ArgumentError(
                    f"a bound's `method` must be placed, averaged or largest gap, got {entry['method']!r}."
                )
            arrays = {key: np.array(entry[key], dtype=float) for key in ("starts", "weights", "tilt")}
            parts.append(BoundPart(**{**entry, **arrays}))
        return cls(float(data["value"]), tuple(parts))


def _covers(parts: tuple[BoundPart, ...], problem: DesignProblem) -> bool:
    """Whether the parts leave no schedule out."""
    if len(parts) == 1 and parts[0].method == "placed":
        return True
    low, high = gap_range(problem)
    reached = low
    for part in sorted(parts, key=lambda p: p.low):
        start = low if part.method == "averaged" else part.low  # "averaged" holds for all gaps up to `high`
        if start > reached * (1 + 1e-12):
            return False
        reached = max(reached, part.high)
    return bool(parts) and reached >= high * (1 - 1e-12)


def _part(
    problem: DesignProblem,
    method: Method,
    starts: Array,
    Z: Array,
    low: float = 0.0,
    high: float = 0.0,
    tilt: Array | None = None,
) -> BoundPart:
    """A part from multipliers in the scaled basis."""
    S = problem.rows.S
    weights = S @ Z @ S.T
    values, vectors = np.linalg.eigh((weights + np.swapaxes(weights, 1, 2)) / 2)
    weights = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    traces = np.trace(weights, axis1=1, axis2=2)
    kept = traces > _NEGLIGIBLE * traces.sum()
    weights, starts = weights[kept] / traces[kept].sum(), starts[kept]
    slope = np.zeros(0) if tilt is None else tilt * (traces.sum() / traces[kept].sum())
    bare = BoundPart(method, low, high, starts, weights, slope)
    return BoundPart(method, low, high, starts, weights, slope, bare.value_for(problem))


def placed_part(problem: DesignProblem, found: Relaxation) -> BoundPart:
    """Bound from the relaxation over sample times, its multipliers as they are or spread out in time."""
    step = problem.period / found.starts.size
    shifts = np.arange(_SPREAD) * (step / _SPREAD)
    spread = np.concatenate([found.starts + shift for shift in shifts])
    carried = [E @ found.Z @ E.T for E in expm_batch(problem.rows.A, shifts)]  # the same states, seen from later starts
    parts = [
        _part(problem, "placed", found.starts, found.Z),
        _part(problem, "placed", spread, np.concatenate([found.Z] * _SPREAD)),
        _part(problem, "placed", spread, np.concatenate(carried)),
    ]
    best = min(parts, key=lambda p: p.value)
    return _priced(problem, best, found.price) if problem.is_costly else best


def _priced(problem: DesignProblem, part: BoundPart, guess: float) -> BoundPart:
    """The same multipliers with the price of cost that makes the bound least; it is convex in the price."""
    from scipy.optimize import minimize_scalar

    def value(price: float) -> float:
        return replace(part, price=price).value_for(problem)

    unit = guess if guess > 0 else part.value**2 / problem.cost_limit
    found = minimize_scalar(lambda s: value(unit * s), bounds=(0.0, 2.5), method="bounded", options={"maxiter": 10})
    tried = [(value(price), price) for price in (0.0, unit, unit * float(found.x))]
    best, price = min(tried)
    return replace(part, price=price, value=best)


def averaged_part(problem: DesignProblem, low: float, high: float) -> BoundPart:
    """Bound from windows after every sample, for all schedules without a gap above `high`."""
    found, tilt = relax_averaged(problem, high)
    first = found.starts >= problem.period * (1 - 1e-6)
    step = problem.period / max(found.starts.size - 1, 1)
    alone = first | (found.starts == 0.0)
    moved = [found.starts[~alone] + q * step / _SPREAD for q in range(_SPREAD)]
    spread = np.concatenate([found.starts[alone], *moved])
    Z = np.concatenate([found.Z[alone], *([found.Z[~alone] / _SPREAD] * _SPREAD)])
    parts = [
        _part(problem, "averaged", found.starts, found.Z, low, high, tilt),
        _part(problem, "averaged", spread, Z, low, high, tilt),
    ]
    return min(parts, key=lambda p: p.value)


def zone_part(problem: DesignProblem, low: float, high: float) -> BoundPart:
    """Bound for the schedules whose largest gap lies in [low, high], turned so that it comes first."""
    found = relax_zones(problem, low, high)
    return _part(problem, "largest gap", found.starts, found.Z, low, high)


def first_bound(problem: DesignProblem, placed: Relaxation, deadline: float = np.inf) -> UpperBound:
    """The smaller of the bounds that cover all schedules at once; after `deadline` the first one alone."""
    parts = [placed_part(problem, placed)]
    if applies(problem) and time.perf_counter() <= deadline:
        parts.append(averaged_part(problem, *gap_range(problem)))
    best = min(parts, key=lambda p: p.value)
    return UpperBound(best.value, (best,))


def narrowed(
    problem: DesignProblem,
    bound: UpperBound,
    target: float,
    steps: int,
    deadline: float = np.inf,
    progress: Progress | None = None,
    rtol: float = 2e-3,
) -> UpperBound:
    """Branch on the largest gap until the bound is within `rtol` of `target`, `steps` are done or time is up."""
    priced = any(part.price > 0 for part in bound.parts)  # branches know no price: they would only lose
    if not applies(problem) or priced or bound.value <= target * (1 + rtol):
        return bound
    low, high = gap_range(problem)
    cuts = [low, *(c * low for c in _FIRST_CUTS if c * low < 0.95 * high), high]
    parts: list[BoundPart] = []
    for a, b in pairwise(cuts):
        if time.perf_counter() > deadline:
            return bound
        parts.append(_better(problem, a, b, target, bound.parts))
    stalled = 0
    for step in range(steps):
        worst = max(range(len(parts)), key=lambda i: parts[i].value)
        top = parts[worst]
        done = top.value <= target * (1 + rtol) or top.high - top.low < 1e-3 * low
        if done or stalled == _PATIENCE or time.perf_counter() > deadline:
            break
        middle = top.low + (0.25 if top.low <= low else 0.5) * (top.high - top.low)
        halves = ((top.low, middle), (middle, top.high))
        parts[worst : worst + 1] = [_better(problem, a, b, target, (top,)) for a, b in halves]
        gain = top.value - max(part.value for part in parts)
        stalled = stalled + 1 if gain < 0.02 * (top.value - target) else 0
        if progress:
            progress((step + 1) / steps, f"bound {max(p.value for p in parts):.6g}, found {target:.6g}")
    value = max(part.value for part in parts)
    return UpperBound(value, tuple(parts)) if value < bound.value else bound


def _better(
    problem: DesignProblem, low: float, high: float, target: float, known: tuple[BoundPart, ...] = ()
) -> BoundPart:
    """The smallest bound for one interval; multipliers known from a wider one hold there too, and may be the better.

    The averaged bound is worked out only where the first is not enough.
    """
    inherited = [part for part in known if part.method != "placed"]
    parts = [zone_part(problem, low, high), *(_narrower(problem, part, low, high) for part in inherited)]
    best = min(parts, key=lambda p: p.value)
    return best if best.value <= target else min(best, averaged_part(problem, low, high), key=lambda p: p.value)


def _narrower(problem: DesignProblem, part: BoundPart, low: float, high: float) -> BoundPart:
    """The same multipliers for a part of the interval."""
    bare = replace(part, low=low, high=high)
    return replace(bare, value=bare.value_for(problem))
