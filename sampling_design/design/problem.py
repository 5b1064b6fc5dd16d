"""A requirement met with a plant: defaults filled in, allowed times, and whether any schedule exists."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._units import time_factor
from sampling_design.design.gram import ScaledRows
from sampling_design.design.requirement import Requirement
from sampling_design.errors import InfeasibleRequirementError
from sampling_design.observability.zero_count import zero_count_bound
from sampling_design.plants.modes import ModalSplit
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.floating[Any]]
Mask = npt.NDArray[np.bool_]

MOST_DEFAULT_SAMPLES = 24
_SLACK = 1e-9  # relative: gaps are designed this much wider than asked, so that rounding cannot break them


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """All numbers of one design: k samples per period, spacing, windows, allowed times, output masks."""

    plant: Plant  # the retained part, in the coordinates that sigma refers to
    window: float
    period: float
    spacing: float
    samples: int
    forbidden: Array
    fixed: Array
    available: tuple[Array | None, ...]  # per output

    @cached_property
    def rows(self) -> ScaledRows:
        """The plant's rows over one window, in the scaled basis."""
        return ScaledRows(self.plant, self.window)

    @property
    def is_shift_invariant(self) -> bool:
        """Whether a schedule may be moved in time without breaking anything."""
        return not self.forbidden.size and not self.fixed.size and all(a is None for a in self.available)

    @cached_property
    def breakpoints(self) -> Array:
        """Times in [0, period] at which what is allowed changes, 0 and the period included."""
        spans = [self.forbidden, *(a for a in self.available if a is not None)]
        points = np.concatenate([np.array([0.0, self.period]), *(s.ravel() for s in spans)])
        return np.unique(np.clip(points, 0.0, self.period))

    def mask(self, times: Array) -> Mask:
        """Which outputs may be measured at `times` (any shape, mod period): shape (*times.shape, p)."""
        t = np.mod(times, self.period)
        open_ = ~_within(t, self.forbidden)
        parts = [open_ if a is None else open_ & _within(t, a) for a in self.available]
        return np.stack(parts, axis=-1)

    @cached_property
    def intervals(self) -> Array:
        """Maximal half-open intervals [a, b) of [0, period) on which some output may be measured, (m, 2)."""
        edges = self.breakpoints
        open_: list[bool] = np.any(self.mask((edges[:-1] + edges[1:]) / 2), axis=-1).tolist()
        found: list[list[float]] = []
        for a, b, good in zip(edges[:-1], edges[1:], open_, strict=True):
            if good and found and found[-1][1] == a:
                found[-1][1] = float(b)
            elif good:
                found.append([float(a), float(b)])
        return np.array(found).reshape(-1, 2)

    def capacity(self, spacing: float | None = None) -> int:
        """Most samples per period that fixed and allowed times leave room for.

        An optimal packing can be pushed left until some sample lies at the left end of an interval (or
        just after a fixed one), so that greedy placement from each left end finds it.
        """
        gap = self.spacing if spacing is None else spacing
        if self.fixed.size:
            ends = np.append(self.fixed[1:], self.fixed[0] + self.period)
            inner = sum(len(self._greedy(a + gap, b - gap, gap)) for a, b in zip(self.fixed, ends, strict=True))
            return int(self.fixed.size + inner)
        if len(self.intervals) == 1 and np.ptp(self.intervals[0]) == self.period:
            return int(np.floor(self.period / gap * (1 + _SLACK)))
        return max((len(self._greedy(a, a + self.period - gap, gap)) for a, _ in self.intervals), default=0)

    def _greedy(self, start: float, stop: float, gap: float) -> list[float]:
        """Earliest admissible times in [start, stop], at least `gap` apart."""
        tiny = _SLACK * self.period
        laps = range(int(np.floor(start / self.period)), int(np.floor(stop / self.period)) + 1)
        spans = [(a + lap * self.period, b + lap * self.period) for lap in laps for a, b in self.intervals]
        placed: list[float] = []
        t = start
        for a, b in spans:
            t = max(t, a)
            while t < b - tiny and t <= stop + tiny:
                placed.append(t)
                t += gap
        return placed


def _within(t: Array, spans: Array) -> Mask:
    return np.any((t[..., None] >= spans[:, 0]) & (t[..., None] < spans[:, 1]), axis=-1)


def default_window(split: ModalSplit) -> float | None:
    """Return the window that is used where none is given: the slowest oscillation, else 4/|A| of the retained part.

        T = 2 pi / min |Im lambda| over the non-zero ones,    else T = 4/|A_retained|

    Parameters
    ----------
    split : ModalSplit

    Returns
    -------
    float or None
        In the plant's time unit; None where the retained part neither oscillates nor moves.
    """
    rates = np.abs(np.array([c.value.imag for c in split.retained_clusters]))
    rates = rates[rates > 0]
    norm = float(np.linalg.norm(split.retained.A, 2)) if split.retained.n_states else 0.0
    if rates.size:
        return float(2 * np.pi / rates.min())
    return 4 / norm if norm else None


def resolve(split: ModalSplit, requirement: Requirement) -> tuple[Requirement, dict[str, Any]]:
    """Fill in the defaults, in the plant's time unit; return the requirement and the defaults used, with reasons."""
    r = _in_unit(requirement, split.plant.time_unit)
    used: dict[str, Any] = {}
    retained = split.retained
    if r.window is None:
        r = r.replace(window=default_window(split) or r.period or 1.0)
        used["window"] = r.window
    if r.period is None:
        r = r.replace(period=r.window)
        used["period"] = r.period
    if not r.samples:
        needed = zero_count_bound(retained, _known(r.window)).samples
        per_period = max(1, int(np.ceil(needed * _known(r.period) / _known(r.window) - _SLACK)))
        kind = "exactly" if r.target_sigma is None else "at_most"
        count = min(per_period, MOST_DEFAULT_SAMPLES) if r.target_sigma is None else MOST_DEFAULT_SAMPLES
        r = r.replace(samples={kind: max(count, r.fixed.size)})
        used["samples"] = dict(r.samples)
        if r.target_sigma is None and per_period > MOST_DEFAULT_SAMPLES:
            used["notice"] = (
                f"The zero count asks for {per_period} samples per period; {MOST_DEFAULT_SAMPLES} are designed. "
                "Give `samples` to change this."
            )
    if r.spacing is None:
        r = r.replace(spacing=_known(r.window) / (4 * max(r.samples.values())))
        used["spacing"] = r.spacing
    r._check_within(_known(r.period))
    return r, used


def repeated(requirement: Requirement, laps: int) -> Requirement:
    """Return the same constraints on times, over `laps` periods as one; `requirement` is resolved."""
    period = _known(requirement.period)

    def tiled(spans: Array) -> Array:
        return np.asarray((spans[None] + period * np.arange(laps)[:, None, None]).reshape(-1, 2))

    outputs = {
        name: {"available": None if a.available is None else tiled(a.available), "cost": a.cost}
        for name, a in requirement.outputs.items()
    }
    fixed = (requirement.fixed + period * np.arange(laps)[:, None]).ravel()
    changes = {"period": laps * period, "forbidden": tiled(requirement.forbidden), "fixed": fixed, "outputs": outputs}
    return requirement.replace(**changes)


def _known(value: float | None) -> float:
    """A number that was filled in before."""
    assert value is not None
    return value


def _in_unit(requirement: Requirement, unit: str) -> Requirement:
    if requirement.time_unit in (None, unit):
        return requirement.replace(time_unit=unit)
    c = time_factor(str(requirement.time_unit), unit)
    times = {k: v * c for k in ("window", "period", "spacing") if (v := getattr(requirement, k)) is not None}
    outputs = {
        name: {"available": None if a.available is None else a.available * c, "cost": a.cost}
        for name, a in requirement.outputs.items()
    }
    return requirement.replace(
        **times,
        forbidden=requirement.forbidden * c,
        fixed=requirement.fixed * c,
        decay_rate=requirement.decay_rate / c,
        outputs=outputs,
        time_unit=unit,
    )


def pose(plant: Plant, requirement: Requirement, samples: int, check: bool = True) -> DesignProblem:
    """Return the numbers of the design with `samples` per period; `requirement` is resolved.

    Raises
    ------
    InfeasibleRequirementError
        If no schedule meets it; names the obstacle and the nearest requirement that works.
    """
    names = plant.outputs.names
    _checks.known_keys("`outputs` of the requirement", requirement.outputs, names)
    access = [requirement.outputs.get(name) for name in names]
    problem = DesignProblem(
        plant,
        _known(requirement.window),
        _known(requirement.period),
        _known(requirement.spacing),
        samples,
        requirement.forbidden,
        requirement.fixed,
        tuple(None if a is None else a.available for a in access),
    )
    if check:
        check_feasible(problem)
    return problem


def check_feasible(problem: DesignProblem) -> None:
    """Raise where no schedule exists; the error carries the obstacle and a change that works."""
    k, eps, period = problem.samples, problem.spacing, problem.period
    _check_fixed(problem)
    room = problem.capacity()
    if room == 0:
        raise InfeasibleRequirementError(
            "`forbidden` and the outputs' availability leave no time to sample at all.", "forbidden", {"forbidden": []}
        )
    if k > room:
        widest = _widest_spacing(problem)
        limited = int(np.floor(period / eps * (1 + _SLACK))) > room
        what = "`forbidden` and `fixed` times leave" if limited else f"`spacing` {eps:g} leaves"
        change = f" or spacing {widest:.6g}" if widest > 0 else ""
        raise InfeasibleRequirementError(
            f"{what} room for {room} samples in the period {period:g}, {k} are asked for. "
            f"The nearest that works: samples {room}{change}.",
            "forbidden" if limited else "spacing",
            {"samples": room, **({"spacing": widest} if widest > 0 else {})},
        )
    per_window = int(np.floor(k * problem.window / period + _SLACK))
    least = int(np.ceil(problem.plant.n_states / problem.plant.n_outputs))
    if per_window < least:
        needed = int(np.ceil(least * period / problem.window - _SLACK))
        raise InfeasibleRequirementError(
            f"`samples` {k} per period {period:g} leave some window {problem.window:g} with {per_window} samples, and "
            f"{problem.plant.n_states} states with {problem.plant.n_outputs} outputs need at least {least}. "
            f"The nearest that works: samples {needed}.",
            "samples",
            {"samples": needed},
        )


def _check_fixed(problem: DesignProblem) -> None:
    fixed, eps, period = problem.fixed, problem.spacing, problem.period
    if not fixed.size:
        return
    closed = np.flatnonzero(~problem.mask(fixed).any(axis=-1))
    if closed.size:
        t = float(fixed[int(closed[0])])
        raise InfeasibleRequirementError(
            f"`fixed` time {t:g} is forbidden or no output is available then. Remove it or open that time.",
            "fixed",
            {"fixed": [float(v) for i, v in enumerate(fixed) if i not in closed]},
        )
    gaps = np.diff(np.append(fixed, fixed[0] + period))
    if gaps.min() < eps * (1 - _SLACK):
        i = int(np.argmin(gaps))
        raise InfeasibleRequirementError(
            f"`fixed` times {fixed[i]:g} and {fixed[(i + 1) % fixed.size]:g} lie {gaps[i]:g} apart, closer than "
            f"`spacing` {eps:g}. The nearest that works: spacing {gaps[i]:g}.",
            "fixed",
            {"spacing": float(gaps[i])},
        )
    if fixed.size > problem.samples:
        raise InfeasibleRequirementError(
            f"`fixed` names {fixed.size} times, `samples` allows {problem.samples}. "
            f"The nearest that works: samples {fixed.size}.",
            "fixed",
            {"samples": int(fixed.size)},
        )


def _widest_spacing(problem: DesignProblem) -> float:
    """Widest spacing with room for all samples, by bisection; 0 if there is none."""
    low, high = 0.0, problem.spacing
    for _ in range(60):
        middle = (low + high) / 2
        if problem.capacity(middle) >= problem.samples:
            low = middle
        else:
            high = middle
        if high - low < 1e-9 * problem.spacing:
            break
    return low
