"""Window positions cut into pieces on which the window holds the same samples.

A window [s, s + T] gains a sample at s = tau - T and loses one just after s = tau. Between two such
events its set of samples S is fixed. At an event it holds at least as much as on either side, so that
the least sigma over all real positions is the least over the *closed* pieces, limits included.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, replace
from functools import partial

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.records.arrays import Array, Integers, Mask
from sampling_design.records.record import Record, counted, moment, short
from sampling_design.schedules.jitter import ON_TIME, TimingTolerance
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

# events closer than this, relative to the largest time, are one event: sums of gaps and differences
# with the window length round in the last bits, and a sample that leaves as another arrives is common
SAME_TIME = 32 * float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False, repr=False)
class WindowWitness(Record):
    """The window at which the attained sigma was found.

    Attributes
    ----------
    t : float
        End of the window [t - T, t].
    side : str
        "at" t; "after", the limit from above, just after a sample has left; "before", the limit from
        below, just before a sample arrives.
    samples : (k,) array
        Times of the samples that it holds.
    direction : (n,) array
        Unit state at the window's start that is observed least.
    sigma : float
        |O x| for that direction.
    """

    t: float
    side: str
    samples: Array
    direction: Array
    sigma: float

    _table = {"window end": "{position}", "samples": "{samples}", "direction": "{direction}", "sigma": "{sigma:up}"}

    @property
    def position(self) -> str:
        """The end of the window in words, such as 'at 3' or 'just after 3'."""
        return {"at": "at ", "after": "just after ", "before": "just before "}[self.side] + moment(self.t)

    def explain(self) -> str:
        """Say which window it is and what it sees least."""
        return (
            f"The window that ends {self.position} holds {counted(self.samples.size, 'sample')}; the initial state "
            f"{short(self.direction)} is least observable there."
        )


@dataclass(frozen=True)
class WindowPieces:
    """Window starts in [left[g], right[g]] hold the samples times[first[g]:stop[g]] and no other.

    They stand for every window that begins at `start` or later (and ends with the last sample of a finite schedule).
    With a `timing_tolerance` `times` are the centres, and these are the samples that it holds at all real times.
    """

    left: Array
    right: Array
    first: Integers
    stop: Integers
    _: KW_ONLY
    times: Array
    mask: Mask | None
    window: float
    tolerance: float
    start: float
    timing_tolerance: TimingTolerance = ON_TIME

    def __len__(self) -> int:
        return self.left.size

    def widened(self, late: TimingTolerance) -> WindowPieces:
        """The windows that are wider by the radius at both ends, and what these hold of samples at their centres."""
        by, shift = late.radius, late.shift
        return replace(
            self, left=self.left + (shift - by), right=self.right + (shift - by), window=self.window + 2 * by,
            times=self.times + shift, timing_tolerance=late,
        )  # fmt: skip

    def losing(self, k: int, outputs: int) -> WindowPieces | None:
        """The windows that hold sample k, without what it measures; None where none holds it."""
        on = (self.first <= k) & (k < self.stop)
        if not on.any():
            return None
        mask = np.ones((len(self.times), outputs), dtype=bool) if self.mask is None else self.mask.copy()
        mask[k] = False
        left, right = self.left[on], self.right[on]
        return replace(self, left=left, right=right, first=self.first[on], stop=self.stop[on], mask=mask)

    def samples(self, g: int) -> Array:
        """Times of the samples on piece g."""
        return self.times[self.first[g] : self.stop[g]]

    def side(self, g: int, start: float) -> str:
        """ "at", or "after" or "before" where the closed window at `start` itself holds more samples."""
        ends = np.array([start - self.tolerance, start + self.window + self.tolerance])
        first, stop = np.searchsorted(self.times, ends)
        if stop - first == self.stop[g] - self.first[g]:
            return "at"
        return "after" if start - self.left[g] < self.right[g] - start else "before"

    def witness(self, g: int, start: float, direction: Array, sigma: float) -> WindowWitness:
        """The window that starts there on piece g, which sees a state so well."""
        return WindowWitness(start + self.window, self.side(g, start), self.samples(g), direction, sigma)

    def measured(self, g: int) -> Mask | None:
        """Mask of the samples on piece g."""
        return None if self.mask is None else self.mask[self.first[g] : self.stop[g]]


def window_pieces(
    schedule: Schedule | PeriodicSchedule, window: float, start: float | None = None, late: TimingTolerance = ON_TIME
) -> WindowPieces:
    """Return the pieces of all full windows that begin at `start` or later.

    With samples that may come early or late, those of windows that are by the radius shorter at both ends: a window
    from `start` on holds for sure what was planned `back` after it at least.

    A finite schedule is judged from its first sample unless `start` says otherwise: where a clock has its zero is no
    property of the schedule. An endless one is judged from time 0 on. One period stands for all windows in its rhythm;
    if its first sample comes later than that rhythm has one, the windows that miss what came before are judged too.
    """
    asked, window, back = window, window - 2 * late.radius, late.radius - late.shift
    if schedule.endless:
        start = 0.0 if start is None else start
        high, missed = schedule.first + schedule.period, schedule.first - float(schedule.gaps[0])
        low = min(start + back, schedule.first) if start + back < missed - SAME_TIME * high else schedule.first
        slack = SAME_TIME * (high + window)
        near = schedule.between(low - late.radius, high + window + slack + late.radius)
    else:
        near = schedule
        first, last = (float(schedule.times[0]), float(schedule.times[-1])) if len(schedule) else (0.0, 0.0)
        low = first if start is None else start + back
        high = last - window
        if high < low - SAME_TIME * max(window, abs(last)):
            spans = f"spans {short(last - low)}" if start is None else f"ends {short(last - start)} after `start`"
            more = (
                f"{short(late.radius)} more at both ends" if start is None else f"{short(2 * late.radius - back)} more"
            )
            spans += f" with up to {more}" if late else ""
            raise ArgumentError(
                f"`window` must fit into the schedule, which {spans}, got {short(asked)}. "
                "A finite schedule is judged from its first full window to its last."
            )
        start, high = first if start is None else start, max(high, low)
    found = _cut(near.times, near.outputs, low, high, window, start)
    return found.widened(late) if late else found


def _cut(times: Array, mask: Mask | None, low: float, high: float, window: float, start: float) -> WindowPieces:
    """Pieces of the window starts [low, high]; one piece of no width where there is one position only."""
    tolerance = SAME_TIME * max(abs(high) + window, float(np.max(times, initial=0.0)))
    pieces = partial(WindowPieces, times=times, mask=mask, window=window, tolerance=tolerance, start=start)
    if high - low <= tolerance:
        ends = np.array([low - tolerance, low + window + tolerance])
        counts = np.searchsorted(times, ends)
        here = np.array([low])
        return pieces(here, here, counts[:1], counts[1:])
    events = np.sort(np.concatenate([times, times - window]))
    events = events[(events > low + tolerance) & (events < high - tolerance)]
    cuts = np.concatenate([[low], events[np.diff(events, prepend=low) > tolerance], [high]])
    leaves = np.searchsorted(cuts, times - tolerance)  # first cut at which a sample may be gone
    enters = np.searchsorted(cuts, times - window - tolerance)
    index = np.arange(cuts.size - 1)
    first = np.searchsorted(leaves, index + 1)
    stop = np.maximum(first, np.searchsorted(enters, index, side="right"))
    return pieces(cuts[:-1], cuts[1:], first, stop)
