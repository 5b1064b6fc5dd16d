"""Whether any schedule meets a requirement; if none does, what is in the way and the nearest that works."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from sampling_design.design.problem.design_problem import SLACK, DesignProblem
from sampling_design.errors import InfeasibleRequirementError
from sampling_design.records.arrays import Array
from sampling_design.records.record import counted
from sampling_design.schedules.sensor import complement

_REPAIRS = 5  # constraints that may have to give way together
_SHARE = 1 - 1e-3  # of the room that is just enough: a schedule with no freedom at all is hard to find
Change = dict[str, Any]  # arguments of a problem and what they become: each has a type of its own


InfeasibleConstraint = tuple[str, str, tuple[Change, ...]]
"""Which constraint is in the way, in words, and single changes of the problem that may get it out."""


def check_feasible(problem: DesignProblem) -> None:
    """Raise where no schedule exists; the error carries the obstacle and changes that work, each and together."""
    found = obstacle(problem)
    if found is None:
        return
    nearest: Change = {}
    ways: dict[frozenset[str], str] = {}
    name, obstructed, changes = found
    for change in changes:
        whole = _completed(problem, change)
        if whole is not None and obstacle(changed(problem, {**nearest, **whole})) is None:
            nearest |= whole
            parts = [_said(key, value) for key, value in whole.items()]
            ways.setdefault(frozenset(parts), " and ".join(parts))
    words = " or ".join(ways.values())
    tail = f" The nearest that works: {words}." if words else ""
    raise InfeasibleRequirementError(obstructed + tail, name, nearest)


def changed(problem: DesignProblem, change: Change) -> DesignProblem:
    """The problem with some of its numbers changed; the plant's rows are kept."""
    result = DesignProblem(**{f.name: change.get(f.name, getattr(problem, f.name)) for f in fields(problem)})
    if "rows" in problem.__dict__:
        result.__dict__["rows"] = problem.rows
    return result


def without_hours(problem: DesignProblem) -> DesignProblem:
    """The problem with every time allowed: of windows that are counted from a sample, wherever that lies."""
    return changed(problem, {"forbidden": np.zeros((0, 2)), "available": (None,) * problem.plant.n_outputs})


def obstacle(problem: DesignProblem) -> InfeasibleConstraint | None:
    """The first constraint that no schedule meets."""
    return _fixed(problem) or _room(problem) or _too_few(problem) or _too_dear(problem)


def _completed(problem: DesignProblem, change: Change) -> Change | None:
    """The change with whatever else it takes; None where that does not end."""
    for _ in range(_REPAIRS):
        found = obstacle(changed(problem, change))
        if found is None:
            return change
        more = next((c for c in found[2] if not set(c) & set(change)), None)
        if more is None:
            return None
        change = {**change, **more}
    return None


def _said(key: str, value: Any) -> str:
    if key in ("samples", "spacing", "cost_limit"):
        return f"{key} {value:g}"
    if key == "fixed":
        return f"fixed {[round(float(t), 6) for t in value]}"
    if key == "closest":
        return f"timing_tolerance {value:g} early and late together"
    return {"forbidden": "shorter forbidden times", "available": "outputs available for longer"}[key]


def _fixed(problem: DesignProblem) -> InfeasibleConstraint | None:
    fixed, eps, period = problem.fixed, problem.spacing, problem.period
    if not fixed.size:
        return None
    closed = np.flatnonzero(~problem.mask(fixed).any(axis=-1))
    if closed.size:
        t = float(fixed[int(closed[0])])
        words = f"`fixed` time {t:g} is forbidden or no output is available then. Remove it or open that time."
        return ("fixed", words, ({"fixed": np.delete(fixed, closed)},))
    gaps = np.diff(np.append(fixed, fixed[0] + period))
    if gaps.min() < eps * (1 - SLACK):
        i = int(np.argmin(gaps))
        words = (
            f"`fixed` times {fixed[i]:g} and {fixed[(i + 1) % fixed.size]:g} lie {gaps[i]:g} apart, closer than "
            f"`spacing` {eps:g}."
        )
        return ("fixed", words, (_narrower(problem, _rounded_down(float(gaps[i]))),))
    if fixed.size > problem.samples:
        words = f"`fixed` names {fixed.size} times, `samples` allows {problem.samples}."
        return ("fixed", words, ({"samples": int(fixed.size)},))
    return None


def _room(problem: DesignProblem) -> InfeasibleConstraint | None:
    k, eps, period = problem.samples, problem.spacing, problem.period
    room = problem.capacity()
    if k <= room:
        return None
    opened = _opened(problem)
    if not problem.intervals.size:
        words = "`forbidden` and the outputs' availability leave no time to sample at all."
        return ("forbidden", words, opened)
    widest = _widest_spacing(problem)
    limited = int(np.floor(period / eps * (1 + SLACK))) > room
    what = "`forbidden` and `fixed` times leave" if limited else f"`spacing` {eps:g} leaves"
    words = f"{what} room for {counted(room, 'sample')} in the period {period:g}, {k} are asked for."
    changes: tuple[Change, ...] = (
        *(({"samples": room},) if room else ()),
        *((_narrower(problem, widest),) if widest > 0 else ()),
    )
    return ("forbidden" if limited else "spacing", words, (*changes, *(opened if widest == 0 else ())))


def fewest_samples(problem: DesignProblem) -> int:
    """Fewest samples per period with which every window holds as many measurements as there are states."""
    return int(np.ceil(_least(problem) * problem.period / problem.window - SLACK))


def _least(problem: DesignProblem) -> int:
    """Samples that a window needs at least."""
    return int(np.ceil(problem.plant.n_states / problem.plant.n_outputs))


def _too_few(problem: DesignProblem) -> InfeasibleConstraint | None:
    k, period, least = problem.samples, problem.period, _least(problem)
    per_window = int(np.floor(k * problem.window / period + SLACK))
    if per_window >= least:
        return None
    needed = fewest_samples(problem)
    window = problem.window + 2 * problem.late
    words = (
        f"`samples` {k} per period {period:g} leave some window {window:g} with {per_window} samples, and "
        f"{problem.plant.n_states} states with {problem.plant.n_outputs} outputs need at least {least}."
    )
    return ("samples", words, ({"samples": needed},))


def _too_dear(problem: DesignProblem) -> InfeasibleConstraint | None:
    if problem.costs is None:
        return None
    least = float(problem.costs.min())
    cheapest = least * problem.samples
    if cheapest <= problem.cost_limit * (1 + SLACK):
        return None
    affordable = int(problem.cost_limit / least * (1 + SLACK))
    words = f"`cost_limit` {problem.cost_limit:g} is less than {problem.samples} of the cheapest measurements cost."
    fewer: tuple[Change, ...] = ({"samples": affordable},) if affordable else ()
    return ("cost_limit", words, (*fewer, {"cost_limit": cheapest}))


def _widest_spacing(problem: DesignProblem) -> float:
    """Widest spacing with room for all samples, by bisection, in six digits rounded down; 0 if there is none."""
    low, high = 0.0, problem.spacing
    for _ in range(60):
        middle = (low + high) / 2
        if problem.capacity(middle) >= problem.samples:
            low = middle
        else:
            high = middle
        if high - low < 1e-9 * problem.spacing:
            break
    whole = len(problem.intervals) == 1 and not problem.fixed.size
    return _rounded_down(low * (1 - 1e-8) if whole else low * _SHARE)


def _narrower(problem: DesignProblem, spacing: float) -> Change:
    """A narrower spacing, and samples so near to their times that they keep their order."""
    return {"spacing": spacing} | ({} if spacing > problem.closest else {"closest": _rounded_down(spacing * _SHARE)})


def _rounded_down(value: float) -> float:
    """Six digits, never more than `value`."""
    if value <= 0:
        return 0.0
    unit = 10.0 ** (np.floor(np.log10(value)) - 5)
    return float(f"{np.floor(value / unit) * unit:.10g}")


def _opened(problem: DesignProblem) -> tuple[Change, ...]:
    """Closed times cut at their ends, all by the same share, as little as makes room: forbidden ones or all."""
    tries = [_shrunk_forbidden, _shrunk_all] if problem.forbidden.size else [_shrunk_all]
    for shrunk in tries:
        low, high = 0.0, 1.0
        if not _has_room(problem, shrunk(problem, 0.0)):
            continue
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (middle, high) if _has_room(problem, shrunk(problem, middle)) else (low, middle)
        return (shrunk(problem, low * _SHARE),)
    return ()


def _has_room(problem: DesignProblem, change: Change) -> bool:
    return changed(problem, change).capacity() >= problem.samples


def _shrunk_forbidden(problem: DesignProblem, share: float) -> Change:
    return {"forbidden": _shrunk(problem.forbidden, share)}


def _shrunk_all(problem: DesignProblem, share: float) -> Change:
    P = problem.period
    spans = tuple(None if a is None else complement(_shrunk(complement(a, P), share), P) for a in problem.available)
    return {"available": spans, **(_shrunk_forbidden(problem, share) if problem.forbidden.size else {})}


def _shrunk(spans: Array, share: float) -> Array:
    """Intervals cut at their ends to a share of their length."""
    stops = spans[:, 0] + share * (spans[:, 1] - spans[:, 0])
    return np.stack([spans[:, 0], stops], axis=1)[stops > spans[:, 0]]
