"""A design problem in canonical units, in which bounds are sought and schedules are searched.

Time is counted in windows, or in parts of it where the period is a whole number of them too, so that samples that
leave a window at the instant at which others enter do so to the last bit. Outputs are counted in the largest entry of
C, periods begin at an opening or a fixed time, and every number is cut to forty binary digits: what other units, or
another hour of the clock, change is the last digits, so that the same problem in any of them is the same to the last
bit, and so is every step of the search. Nothing is claimed of it: what it finds is brought back and proven for the
problem itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from sampling_design.design.problem.design_problem import ON_AN_END, DesignProblem
from sampling_design.numerics.linalg import BITS, cut
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask
from sampling_design.schedules.sensor import joined

SAME_RATIO = 1e-11  # relative: window/period counts as a ratio of whole numbers where it is one to rounding
_MOST_PARTS = 64  # of a window or a period: larger ratios are met by chance


@dataclass(frozen=True, eq=False)
class CanonicalDesign:
    """`inside` is the problem in canonical units, `outside` as it was posed; a time inside takes `time` outside, where
    time 0 of the inside is `shift`."""

    outside: DesignProblem
    inside: DesignProblem
    time: float
    size: float
    shift: float

    def times(self, found: Array, chosen: Mask) -> tuple[Array, Mask]:
        """Times of the inside and what they measure, outside; on fixed times and openings to the last bit."""
        problem, P = self.outside, self.outside.period
        t = np.mod(found * self.time + self.shift, P)
        edges = problem.breakpoints
        closed = ~np.roll(problem.mask((edges[:-1] + edges[1:]) / 2), 1, axis=0)
        for a in edges[:-1][np.any(problem.mask(edges[:-1]) & closed, axis=1)]:  # of whatever opens
            early = np.mod(a - t, P)
            t[(early > 0) & (early < ON_AN_END * P)] = a
        for a in problem.fixed:
            t[np.argmin(np.abs(np.mod(t - a + P / 2, P) - P / 2))] = a
        t = np.mod(tied_again(problem, t), P)
        order = np.argsort(t, kind="stable")
        return t[order], chosen[order]

    def spans(self, zones: Array, inner: Array, outer: Array, shift: float) -> Array:
        """Zones of the inside, outside: what are ends of `inner`, from which they were cut, are ends of `outer`."""
        return np.asarray(np.where(zones == inner, outer, zones * self.time + shift))


def canonical(problem: DesignProblem) -> CanonicalDesign:
    """Return the problem in canonical units."""
    plant = problem.plant
    windows, periods = ratio_of(problem) or (1, 0)
    time = problem.window / windows
    size = float(np.max(np.abs(plant.C), initial=0.0)) or 1.0

    period = float(periods or cut(problem.period / time))
    origin = problem.origin

    def turned(times: Array) -> Array:
        """Times from the origin on, in [0, period); those beside the origin, to rounding, are there."""
        t = cut(np.mod(times - origin, problem.period) / time)
        return np.where(t > period * (1 - ON_AN_END), 0.0, t)

    def spans(ends: Array) -> Array:
        """Intervals as they are cut by the new end of the period, and joined at the old one."""
        starts = turned(ends[:, 0])
        stops = np.minimum(cut(starts + (ends[:, 1] - ends[:, 0]) / time), starts + period)
        later = stops > period * (1 + ON_AN_END)
        first = np.stack([starts, np.minimum(stops, period)], axis=1)
        rest = np.stack([np.zeros(int(later.sum())), cut(stops[later] - period)], axis=1)
        return joined(np.concatenate([first, rest]), ON_AN_END * period)

    spacing = cut(problem.spacing / time)
    inside = replace(
        problem,
        plant=Plant(cut(plant.A * time), cut(plant.C / size)),
        window=float(windows),
        late=problem.late / time,
        closest=problem.closest / time,
        period=period,
        spacing=float(spacing - np.ldexp(0.5, int(np.frexp(spacing)[1]) - BITS + 1)),  # never wider than was asked
        forbidden=spans(problem.forbidden),
        fixed=np.sort(turned(problem.fixed)),
        available=tuple(None if a is None else spans(a) for a in problem.available),
        counted=None,
    )
    return CanonicalDesign(problem, inside, time, size, origin)


def tied_again(problem: DesignProblem, times: Array) -> Array:
    """The times with those tied to the last bit that are tied to rounding, fixed ones as they are.

    Where the period is a whole number of parts by which the window differs from whole periods, samples that lie that
    far apart leave and enter windows together.
    """
    ratio = ratio_of(problem)
    if ratio is None or ratio[1] < 2:
        return times
    part, t = problem.period / ratio[1], np.array(times)
    order = np.argsort(~np.isin(t, problem.fixed), kind="stable")  # fixed ones lead
    for place, i in enumerate(order):
        apart = (t[i] - t[order[:place]]) / part
        near = np.flatnonzero(np.abs(apart - np.rint(apart)) * part <= ON_AN_END * problem.period)
        if near.size and not np.isin(t[i], problem.fixed):
            t[i] = t[order[near[0]]] + np.rint(apart[near[0]]) * part
    return t


def ratio_of(problem: DesignProblem) -> tuple[int, int] | None:
    """Window and period as small whole multiples of one time; None where they are none."""
    ratio = problem.window / problem.period
    if not 1 / _MOST_PARTS <= ratio <= _MOST_PARTS:
        return None
    near = Fraction(ratio).limit_denominator(_MOST_PARTS)
    same = abs(float(near) - ratio) <= SAME_RATIO * ratio and near.numerator <= _MOST_PARTS
    return (near.numerator, near.denominator) if same else None
