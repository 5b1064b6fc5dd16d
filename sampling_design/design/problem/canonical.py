"""A design problem in canonical units, in which bounds are sought and schedules are searched.

Time is counted in windows, or in parts of it where the period is a whole number of them too, so that samples that
leave a window at the instant at which others enter do so to the last bit. Outputs are counted in the largest entry of
C, and every number is cut to forty binary digits: what other units change is the last digits, so that the same problem
in any units is the same to the last bit, and so is every step of the search. Nothing is claimed of it: what it finds
is brought back and proven for the problem itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from sampling_design.design.problem.numbers import DesignProblem
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]

BITS = 40
"""Binary digits that are kept: far above rounding, far below the tolerance of every search."""

_SAME_RATIO = 1e-11  # relative: window/period counts as a ratio of whole numbers where it is one to rounding
_MOST_PARTS = 64  # of a window or a period: larger ratios are met by chance
_BESIDE = 1e-11  # of the period: a time so near to an end of an interval, or to a fixed one, is meant to lie on it


@dataclass(frozen=True, eq=False)
class CanonicalDesign:
    """`inside` is the problem in canonical units, `outside` as it was posed; a time inside takes `time` outside."""

    outside: DesignProblem
    inside: DesignProblem
    time: float
    size: float

    def times(self, found: Array) -> Array:
        """Times of the inside, outside; on fixed times and on the beginnings of intervals to the last bit."""
        problem = self.outside
        t, near = np.array(found * self.time), _BESIDE * problem.period
        for a in problem.intervals[:, 0]:
            t[(t < a) & (t > a - near)] = a
        for a in problem.fixed:
            t[np.argmin(np.abs(t - a))] = a
        return np.sort(tied_again(problem, t))

    def spans(self, zones: Array, inner: Array, outer: Array) -> Array:
        """Zones of the inside, outside: what are ends of `inner`, from which they were cut, are ends of `outer`."""
        return np.asarray(np.where(zones == inner, outer, zones * self.time))


def canonical(problem: DesignProblem) -> CanonicalDesign:
    """Return the problem in canonical units."""
    plant = problem.plant
    windows, periods = ratio_of(problem) or (1, 0)
    time = problem.window / windows
    size = float(np.max(np.abs(plant.C), initial=0.0)) or 1.0

    def spans(times: Array) -> Array:
        return _cut(times / time)

    spacing = _cut(problem.spacing / time)
    inside = replace(
        problem,
        plant=Plant(_cut(plant.A * time), _cut(plant.C / size)),
        window=float(windows),
        period=float(periods or _cut(problem.period / time)),
        spacing=float(spacing - np.ldexp(0.5, int(np.frexp(spacing)[1]) - BITS + 1)),  # never wider than was asked
        forbidden=spans(problem.forbidden),
        fixed=spans(problem.fixed),
        available=tuple(None if a is None else spans(a) for a in problem.available),
    )
    return CanonicalDesign(problem, inside, time, size)


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
        near = np.flatnonzero(np.abs(apart - np.rint(apart)) * part <= _BESIDE * problem.period)
        if near.size and not np.isin(t[i], problem.fixed):
            t[i] = t[order[near[0]]] + np.rint(apart[near[0]]) * part
    return t


def ratio_of(problem: DesignProblem) -> tuple[int, int] | None:
    """Window and period as small whole multiples of one time; None where they are none."""
    ratio = problem.window / problem.period
    if not 1 / _MOST_PARTS <= ratio <= _MOST_PARTS:
        return None
    near = Fraction(ratio).limit_denominator(_MOST_PARTS)
    same = abs(float(near) - ratio) <= _SAME_RATIO * ratio and near.numerator <= _MOST_PARTS
    return (near.numerator, near.denominator) if same else None


def _cut(numbers: npt.ArrayLike) -> Array:
    """The numbers with `BITS` binary digits."""
    part, exponent = np.frexp(numbers)
    return np.asarray(np.ldexp(np.rint(np.ldexp(part, BITS)), exponent - BITS))
