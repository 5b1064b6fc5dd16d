"""The upper bound as evidence: multipliers in the plant's own coordinates, checked without any solver."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from sampling_design.design.bounds.gap_bound import gap_bound, relax_gaps
from sampling_design.design.bounds.local_bound import local_bound, relax_local
from sampling_design.design.bounds.relaxation import (
    JUST_BESIDE,
    LEAST_SECONDS,
    Relaxation,
    grams_at,
    psd_part,
    relax_placed,
)
from sampling_design.design.bounds.weak_duality import alone_bound, bound_by_price, clear_of_ends, placed_bound
from sampling_design.design.bounds.zone_bound import matters, relax_zones, zone_bound
from sampling_design.design.bounds.zones import (
    TINY,
    Cut,
    Side,
    begins,
    covered,
    flow_of,
    ordered_bound,
    region_of,
    regions,
    relax_ordered,
    sides,
    tightened,
    zoned,
)
from sampling_design.design.problem.canonical import CanonicalDesign
from sampling_design.design.problem.design_problem import DesignProblem, affordable_choices
from sampling_design.design.problem.feasible import changed, without_hours
from sampling_design.design.problem.gram import MANY_STATES
from sampling_design.numerics.linalg import expm_batch, psd_root, symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import ENDLESS, Budget
from sampling_design.records.record import Plain
from sampling_design.records.signatures import checked_methods

Method = Literal["placed", "alone", "zones", "local", "ordered", "gaps"]

_NEGLIGIBLE = 1e-7  # multipliers below this share of the total are left out: the bound holds with any of them
_LOOKED_AT, _CLOSER = 128, 16  # windows of one sample, and how often the least seen of them is looked at closer
_FAR = 4.0  # exponent by which modes grow more than others over a window: from there on these are looked at alone
_AIMS, _AIMED = 2, 1.02  # how often a bound by gaps is sought, and beyond what share of the aim once more
_SPREAD = 4  # parts into which a multiplier is spread over the time to the next window start


def _none() -> Array:
    return np.zeros((0, 2))


def _any() -> Mask:
    return np.zeros((0, 0), dtype=bool)


@dataclass(frozen=True, eq=False)
class BoundPart:
    """Multipliers that bound all schedules whose samples lie in `zones` (k, 2).

    `weights` (M, n, n) are psd in the coordinates of the designed plant with traces that sum to one, for windows that
    start at `starts`. The zones count from the sample after which all others come "late", or "early", or from a fixed
    one, or the first of the period ("sorted": `side`). "placed" bounds all schedules, wherever their samples lie;
    `price` is its multiplier of the cost limit. "alone" bounds all schedules of one sample, which are one schedule
    shifted: its windows count from the sample. "local" bounds the schedules of small zones by windows that follow their
    samples: the rows of `tied` (see `tied_windows`) say which, `starts` are of no account, and `tilt` (k,) are the
    multipliers of the spacing. "ordered" bounds those of its zones by windows that begin just before each sample:
    `weights` has one for each (see `ordered_bound`). Where cost is limited, `chosen` (k, p) says what each sample
    measures at most, in the schedules that are meant. "gaps" bounds all schedules by windows that begin at each sample:
    `starts` are the gaps after it at which `weights` are given, and `tilt` the function of distances that adds up to
    nothing.
    """

    method: Method
    starts: Array
    weights: Array
    zones: Array = field(default_factory=_none)
    tilt: Array = field(default_factory=lambda: np.zeros(0))
    side: Side = "late"
    value: float = np.inf
    price: float = 0.0
    tied: Index = field(default_factory=lambda: np.zeros((0, 4), dtype=np.intp))
    chosen: Mask = field(default_factory=_any)

    def judged(self, problem: DesignProblem) -> BoundPart:
        """The part with the bound that it proves for `problem`."""
        return replace(self, value=self.value_for(problem))

    def value_for(self, problem: DesignProblem) -> float:
        """The bound that these multipliers prove for `problem`; infinite where they prove nothing.

        A window that sees no x by less than sigma times |counted x| sees <W, O'O> >= sigma^2 tr(counted W counted').
        """
        total = float(np.trace(self.weights, axis1=1, axis2=2).sum())
        least = float(np.linalg.eigvalsh(self.weights).min(initial=0.0))
        if self.chosen.size and problem.chosen is None:
            if self.chosen.shape != (problem.samples, problem.plant.n_outputs):
                return np.inf
            problem = changed(problem, {"chosen": self.chosen})
        sound = np.all(np.isfinite(self.tilt)) and np.isfinite(self.price) and self.price >= 0
        if not total > 0 or least < -1e-12 * total or not sound:
            return np.inf
        bare = psd_root(self.weights)  # any psd weights prove something: those of the roots
        roots = problem.rows.carried(bare)
        if not np.all(np.isfinite(roots)):
            return np.inf
        Z = roots @ np.swapaxes(roots, 1, 2)
        sizes = np.sum(bare**2, axis=(1, 2))
        counted = sizes if problem.counted is None else np.sum((problem.counted @ bare) ** 2, axis=(1, 2))
        if self.method == "gaps":
            return gap_bound(problem, self.starts, Z, self.tilt, counted / sizes.sum())
        share = float(counted.sum() / sizes.sum())
        return self._of_all_states(problem, roots, Z) / math.sqrt(share) if share > 0 else np.inf

    def _of_all_states(self, problem: DesignProblem, roots: Array, Z: Array) -> float:
        """The bound on the least |O x| over |x|, all entries of x, from multipliers that are no `gaps`."""
        if self.method == "placed":
            decided = problem.chosen is None or problem.fixed.size == problem.samples  # else of no known sample
            return placed_bound(problem, self.starts, Z, self.price) if decided else np.inf
        if self.method == "alone":
            return alone_bound(problem, self.starts, Z)
        if not zoned(problem) or self.zones.shape != (problem.samples, 2) or self.side not in sides(problem):
            return np.inf
        zones = tightened(problem, self.zones, self.side)
        if zones is None:
            return 0.0
        if self.method == "ordered":
            return self._of_order(problem, zones)
        if self.method == "local":
            k, tied = problem.samples, self.tied
            fits = tied.shape == (len(roots), 4) and self.tilt.size == k and np.all(self.tilt >= 0)
            if not fits or np.any(tied[:, :3] < 0) or np.any(tied[:, 0] >= k) or np.any(tied[:, 1:3] > 1):
                return np.inf
            far = k * (np.ceil(problem.window / problem.period) + 2)
            return np.inf if np.any(np.abs(tied[:, 3]) > far) else local_bound(problem, zones, tied, roots, self.tilt)
        return zone_bound(problem, self.starts, Z, zones)

    def _of_order(self, problem: DesignProblem, zones: Array) -> float:
        """The bound of schedules in `zones` from multipliers of the windows before each sample."""
        flow = flow_of(problem)
        if flow is None or len(self.weights) != problem.samples:
            return np.inf
        total = np.trace(self.weights, axis1=1, axis2=2).sum()
        return ordered_bound(problem, flow, self.weights / total, zones)

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        plain = {key: getattr(self, key).tolist() for key in ("starts", "weights", "zones", "tilt", "tied", "chosen")}
        return {"method": self.method, "side": self.side, "value": self.value, "price": self.price, **plain}


@checked_methods
@dataclass(frozen=True, eq=False)
class UpperBound:
    """The sigma that no admissible schedule over all real times can beat, with the multipliers that prove it.

    Attributes
    ----------
    value : float
        The largest of the parts' bounds.
    parts : tuple of BoundPart
        One part that covers all schedules, or several of one side whose zones cover them.
    """

    value: float
    parts: tuple[BoundPart, ...]

    @property
    def method(self) -> str:
        """Which argument proves it: that of the part with the largest bound."""
        return max(self.parts, key=lambda p: p.value).method

    def value_for(self, problem: DesignProblem) -> float:
        """Work the bound out anew from the multipliers; infinite where the parts leave schedules uncovered."""
        if not self._covers(problem):
            return np.inf
        return max(part.value_for(problem) for part in self.parts)

    def _covers(self, problem: DesignProblem) -> bool:
        """Whether the parts leave no schedule out."""
        everywhere = ("placed", "alone", "gaps")
        if any(part.method in everywhere for part in self.parts):
            wanted = {chosen.tobytes() for chosen in affordable_choices(problem)} or {b""}
            masks = {part.chosen.tobytes() for part in self.parts if part.method in everywhere}
            return len(masks) == len(self.parts) and masks in ({b""}, wanted)
        fits = all(part.zones.shape == (problem.samples, 2) for part in self.parts)
        found = {part.side for part in self.parts}
        if len(found) != 1 or not fits or not zoned(problem):
            return False
        side = found.pop()
        if side not in sides(problem):
            return False
        whole = regions(problem, side)
        boxes: dict[bytes, dict[int, list[Array]]] = {}
        for part in self.parts:
            home = region_of(problem, side, part.zones)
            if home is None:
                return False
            boxes.setdefault(part.chosen.tobytes(), {}).setdefault(home, []).append(part.zones)
        posed = {b"": problem}  # whatever is measured
        if b"" not in boxes:
            posed = {c.tobytes(): changed(problem, {"chosen": c}) for c in affordable_choices(problem)}
        return set(boxes) <= set(posed) and all(
            covered(case, region, boxes.get(chosen, {}).get(home, []), side)
            for chosen, case in posed.items()
            for home, region in enumerate(whole)
        )

    def brought_back(self, canon: CanonicalDesign) -> UpperBound:
        """The multipliers found in canonical units as a bound of the problem itself, worked out for it anew."""
        inner = {part.side: regions(canon.inside, part.side) for part in self.parts if part.zones.size}
        outer = {side: regions(canon.outside, side) for side in inner}
        parts = []
        for part in self.parts:
            zones = part.zones
            if zones.size:
                home = region_of(canon.inside, part.side, zones)
                if home is None or len(inner[part.side]) != len(outer[part.side]):  # nothing is proven of it outside
                    return UpperBound(np.inf, tuple(replace(part, value=np.inf) for part in self.parts))
                shift = begins(canon.outside, part.side)
                zones = canon.spans(zones, inner[part.side][home], outer[part.side][home], shift)
            else:
                shift = canon.shift if part.method == "placed" else 0.0
            starts = part.starts * canon.time + shift
            earlier = int(np.sum(canon.outside.fixed < canon.shift - TINY * canon.outside.period))  # last ones inside
            bare = replace(
                part,
                starts=starts if part.method in ("alone", "gaps") else clear_of_ends(canon.outside, starts),
                zones=zones,
                chosen=np.roll(part.chosen, earlier, axis=0) if part.method == "placed" else part.chosen,
                tilt=part.tilt * canon.size**2 if part.method == "gaps" else part.tilt / canon.time,
                price=part.price * canon.size**2,
            )
            parts.append(bare.judged(canon.outside))
        return UpperBound(max(part.value for part in parts), tuple(parts))

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        return {"value": self.value, "parts": [part.to_dict() for part in self.parts]}


def _part(
    problem: DesignProblem, method: Method, starts: Array, Z: Array, zones: Array | None = None, side: Side = "late"
) -> BoundPart:
    """A part from multipliers in the scaled basis, with what it proves."""
    return _unjudged(problem, method, starts, Z, zones, side).judged(problem)


def _unjudged(
    problem: DesignProblem, method: Method, starts: Array, Z: Array, zones: Array | None = None, side: Side = "late"
) -> BoundPart:
    """The same before it is looked at."""
    S = problem.rows.S
    weights = psd_part(symmetrise(S @ Z @ S.T))
    traces = np.trace(weights, axis1=1, axis2=2)
    kept = traces > _NEGLIGIBLE * traces.sum()
    weights, starts = weights[kept] / traces[kept].sum(), starts[kept]
    starts = starts if method == "alone" else clear_of_ends(problem, starts)
    zones = _none() if zones is None else zones
    return BoundPart(method, starts, weights, zones, side=side, chosen=chosen_in(problem))


def chosen_in(problem: DesignProblem) -> Mask:
    """What each sample measures where that is decided, as a part says it."""
    return _any() if problem.chosen is None else problem.chosen


def quick_bound(problem: DesignProblem, found: Relaxation) -> UpperBound:
    """A bound of all schedules from a relaxation's multipliers as they are."""
    part = _part(problem, "placed", found.starts, found.Z)
    return UpperBound(part.value, (part,))


def bound_of_count(canon: CanonicalDesign, found: Relaxation) -> UpperBound:
    """A bound of the problem itself from multipliers made for another count of samples: one look, no relaxation."""
    part = _unjudged(canon.inside, "placed", found.starts, found.Z)
    return UpperBound(part.value, (part,)).brought_back(canon)


def placed_part(problem: DesignProblem, found: Relaxation, budget: Budget = ENDLESS) -> BoundPart:
    """Bound from the relaxation over sample times, its multipliers as they are or spread out in time."""
    first = _part(problem, "placed", found.starts, found.Z)
    if budget.over:
        return first
    step = problem.period / found.starts.size
    shifts = np.arange(_SPREAD) * (step / _SPREAD)
    spread = np.concatenate([found.starts + shift for shift in shifts])
    carried = [E @ found.Z @ E.T for E in expm_batch(problem.rows.A, shifts)]  # the same states, seen from later starts
    parts = [
        first,
        _part(problem, "placed", spread, np.concatenate([found.Z] * _SPREAD)),
        _part(problem, "placed", spread, np.concatenate(carried)),
    ]
    best = min(parts, key=lambda p: p.value)
    return _priced(problem, best, found.price) if problem.is_costly else best


def _priced(problem: DesignProblem, part: BoundPart, guess: float) -> BoundPart:
    """The same multipliers with the price of cost that makes the bound least; it is convex in the price."""
    from scipy.optimize import minimize_scalar

    roots = problem.rows.carried(psd_root(part.weights))
    value = bound_by_price(problem, part.starts, roots @ np.swapaxes(roots, 1, 2))
    unit = guess if guess > 0 else part.value**2 / problem.cost_limit
    found = minimize_scalar(lambda s: value(unit * s), bounds=(0.0, 2.5), method="bounded", options={"maxiter": 10})
    return replace(part, price=min((0.0, unit, unit * float(found.x)), key=value)).judged(problem)


def slow_part(problem: DesignProblem, budget: Budget = ENDLESS) -> BoundPart | None:
    """Bound from the states that grow slowly alone, where others grow by far more; None where there are none such.

    Whoever starts among them stays there, so that they are a smaller plant with the same schedules, of which no window
    is seen better. The multipliers of the whole plant have to balance growth that leaves a solver no digits.
    """
    slow = slow_states(problem)
    if slow is None or budget.over:
        return None
    A, C = slow.T @ problem.plant.A @ slow, problem.plant.C @ slow
    smaller = replace(problem, plant=Plant(A, C), costs=None, cost_limit=np.inf)
    seconds = budget.seconds_left(LEAST_SECONDS, 1 / 3)
    found = relax_placed(smaller, seconds=seconds)
    part = placed_part(smaller, found, budget)
    whole = replace(part, weights=slow @ part.weights @ slow.T).judged(problem)
    return _priced(problem, whole, 0.0) if problem.is_costly else whole


def slow_states(problem: DesignProblem) -> Array | None:
    """Basis (n, m) at right angles of the modes that grow by far less over a window than the next; None without."""
    from scipy.linalg import schur

    grown = np.sort(np.linalg.eigvals(problem.plant.A).real) * problem.window
    steps = np.diff(grown) * (grown[1:] > 0)
    if not steps.size or steps.max() < _FAR:
        return None
    place = int(np.argmax(steps))
    border = (grown[place] + grown[place + 1]) / (2 * problem.window)
    _, basis, count = schur(problem.plant.A, sort=lambda real, imaginary=0.0: real < border)
    return np.asarray(basis[:, :count]) if 0 < count < len(grown) else None


def zone_part(
    problem: DesignProblem, zones: Array, side: Side, hints: Array | None = None, budget: Budget = ENDLESS
) -> tuple[BoundPart, Relaxation, Cut] | None:
    """Bound for the schedules in `zones`, the relaxation behind it, and the cut that divides most.

    None where no schedule lies there.
    """
    tight = tightened(problem, zones, side)
    if tight is None:
        return None
    relaxed, cut = relax_zones(problem, tight, np.zeros(0) if hints is None else hints, budget)
    part = _part(problem, "zones", relaxed.starts, relaxed.Z, zones, side=side)
    slow = slow_states(problem)
    if slow is not None:
        alone = replace(part, weights=slow @ (slow.T @ part.weights @ slow) @ slow.T)
        part = min(part, alone.judged(problem), key=lambda p: p.value)
    return part, relaxed, cut


def ordered_part(
    problem: DesignProblem, zones: Array, side: Side, aim: float, budget: Budget = ENDLESS
) -> tuple[BoundPart, Cut]:
    """Bound for the schedules of a box by their order (`flow_of`), near a sigma that is aimed at, and the next cut."""
    flow, tight = flow_of(problem), tightened(problem, zones, side)
    assert flow is not None
    assert tight is not None
    Z, cut = relax_ordered(problem, flow, tight, aim, budget)
    return BoundPart("ordered", np.zeros(0), Z, zones, side=side).judged(problem), cut


def local_part(
    problem: DesignProblem, zones: Array, side: Side, aim: float, budget: Budget = ENDLESS
) -> tuple[BoundPart, int] | None:
    """Bound for the schedules of a small box, near a sigma that is aimed at, and which sample's zone to cut next.

    None where nothing came out.
    """
    tight = tightened(problem, zones, side)
    left = budget.seconds_left(LEAST_SECONDS)
    found = None if tight is None else relax_local(problem, tight, aim, left)
    if found is None:
        return None
    windows, roots, nu, index = found
    weights = problem.rows.S @ roots
    weights = weights @ np.swapaxes(weights, 1, 2)
    weights = weights / np.trace(weights, axis1=1, axis2=2).sum()
    bare = BoundPart("local", np.zeros(0), weights, zones, nu, side, tied=windows, chosen=chosen_in(problem))
    return bare.judged(problem), index


def gap_bounded(problem: DesignProblem, known: UpperBound, sigma: float, budget: Budget = ENDLESS) -> UpperBound:
    """The bound of all schedules by their gaps, near a `sigma` that is aimed at, unless what is known is smaller.

    What comes out far above it is aimed at once more, half way.
    """
    for _ in range(_AIMS):
        found = None if budget.over else relax_gaps(problem, sigma, budget.seconds_left(LEAST_SECONDS))
        if found is None:
            break
        gaps, Z, potential = found
        weights = symmetrise(problem.rows.S @ Z @ problem.rows.S.T)
        total = float(np.trace(weights, axis1=1, axis2=2).sum())
        part = BoundPart("gaps", gaps, weights / total, tilt=potential / total).judged(problem)
        known = UpperBound(part.value, (part,)) if part.value < known.value else known
        if not sigma * _AIMED < part.value < np.inf:
            break
        sigma = (sigma + known.value) / 2
    return known


def alone_part(problem: DesignProblem) -> BoundPart:
    """Bound of one sample a period: the window, counted from the sample, that sees some state least."""
    all_outputs = np.ones((1, problem.plant.n_outputs), dtype=bool)
    chosen = all_outputs if problem.chosen is None else problem.chosen
    return _least_observable(without_hours(problem), "alone", np.zeros(1), chosen)


def _placed_by_itself(problem: DesignProblem) -> list[tuple[BoundPart, ...]]:
    """Bounds where no time is left to choose: of one sample, or of samples that are all fixed.

    Where cost is limited, what each sample measures is left to choose: a part for every choice, unless there are many.
    """
    choices = affordable_choices(problem) if problem.is_costly else []
    cases = [changed(problem, {"chosen": chosen}) for chosen in choices] or [problem]
    found = [tuple(alone_part(case) for case in cases)] if problem.samples == 1 else []
    if problem.fixed.size == problem.samples and (choices or not problem.is_costly):
        found.append(tuple(_least_observable(each, "placed", each.fixed, each.measured(each.fixed)) for each in cases))
    return found


def _least_observable(problem: DesignProblem, method: Method, times: Array, mask: Mask) -> BoundPart:
    """The part of one window: that in which samples at `times` see some state least."""
    P = problem.period
    beside = (times[:, None] + np.array([-JUST_BESIDE, 0.0, JUST_BESIDE]) * P).ravel()
    even = np.arange(_LOOKED_AT) * (P / _LOOKED_AT)
    starts = np.unique(np.mod(np.concatenate([beside, beside - problem.window, even]), P))

    def sigma2(at: Array) -> tuple[Array, Array]:
        return problem.rows.least(grams_at(problem, times, at, mask).sum(axis=1))

    width = P / _LOOKED_AT
    for _ in range(_CLOSER):  # the least of a smooth curve between two jumps: ever finer around the best so far
        best = starts[int(np.argmin(sigma2(starts)[0]))]
        starts = np.append(np.mod(best + np.linspace(-width, width, 2 * _SPREAD + 1), P), best)
        width /= _SPREAD
    values, z = sigma2(starts)
    least = int(np.argmin(values))
    return _part(problem, method, starts[[least]], np.outer(z[least], z[least])[None])


def first_bound(problem: DesignProblem, placed: Relaxation, budget: Budget = ENDLESS) -> UpperBound:
    """The least of the bounds that cover all schedules at once; after `budget` the first one alone."""
    found = [(placed_part(problem, placed, budget),), *_placed_by_itself(problem)]
    slow = slow_part(problem, budget)
    found += [] if slow is None else [(slow,)]
    if zoned(problem) and problem.least_shift == 0 and not budget.over:
        many = problem.plant.n_states > MANY_STATES  # one side of zones, and of it the windows that matter anyway
        hints = matters(problem, placed) if many else None
        for side in sides(problem)[: 1 if many else 2] if sides(problem) != ("sorted",) else ():
            if not budget.over:
                root = zone_part(problem, regions(problem, side)[0], side, hints, budget)
                found += [] if root is None else [(root[0],)]
    bounds = [UpperBound(max(part.value for part in parts), parts) for parts in found]
    return min(bounds, key=lambda bound: bound.value)
