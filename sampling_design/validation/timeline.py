"""Break points in time, fine enough for a disturbance, with the exact flow over each cell between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.composed_flow import state_units
from sampling_design.estimators.window.check_points import SAME_TIME_ULPS
from sampling_design.numerics.linalg import forced_flow
from sampling_design.observability.alignment import align
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask, freeze
from sampling_design.schedules.family import AnySchedule
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

CELLS_PER_GAP = 6  # cells of a mean gap: a disturbance may change its mind that often between two samples
CELLS_PER_CYCLE = 16
"""Cells of one cycle of the fastest mode, so that a resonant disturbance keeps 99 per cent of its strength."""
GAPS_TO_SETTLE = 40  # mean gaps in which an error is taken to have settled, whatever the horizon
LONGER = 1.2  # factor by which gaps may get longer from one half to the other where growth of the error is judged
LARGEST = 20_000  # cells of one timeline; a disturbance gets coarser cells rather than more of them


@dataclass(frozen=True, eq=False)
class ErrorRows:
    """Where errors are looked at: every break point, a sample's both before and after it."""

    at: Index
    after: Mask
    times: Array

    @property
    def samples(self) -> Index:
        """Rows just after a sample: those whose break point has a row before."""
        return np.flatnonzero(np.concatenate([[False], self.at[1:] == self.at[:-1]]))


@dataclass(frozen=True, eq=False)
class Timeline:
    """Break points 0 = t_0 < ... < t_T with the exact flow of a w that is constant over each cell.

    Attributes
    ----------
    plant : Plant
    times : (T+1,) array [time]
    F, gamma : (T, n, n) and (T, n, q) arrays
        x(t_{c+1}) = F_c x(t_c) + gamma_c w_c.
    samples : (N,) indices
        Break points at which something is measured.
    masks : (N, p) array
        1.0 where an output is measured.
    starts : (N,) indices
        Break point at which the window of each sample begins (0 while the windows still fill).
    given : (N,) array of bool
        Windows from the given prior; others from time 0 on begin with the estimate of a sample there.
    events : (K+1,) indices
        0, samples, window starts and the end, in order.
    """

    plant: Plant
    times: Array
    F: Array
    gamma: Array
    samples: Index
    masks: Array
    starts: Index
    given: Mask
    events: Index

    @property
    def cells(self) -> int:
        """T."""
        return len(self.F)

    @property
    def lengths(self) -> Array:
        """Lengths of the cells, (T,)."""
        return np.diff(self.times)

    @cached_property
    def sample_at(self) -> dict[int, int]:
        """Which sample is taken at a break point, of those that have one."""
        return {int(b): j for j, b in enumerate(self.samples)}

    @cached_property
    def rarer(self) -> bool:
        """Whether an output is read more rarely in the second half: then errors grow of whatever estimator."""
        end, read = self.times[-1], self.times[self.samples]
        for measured in self.masks.T[self.masks.any(axis=0)] > 0:
            marks = np.concatenate([[0.0], read[measured], [end]])
            gaps, later = np.diff(marks), marks[1:] > end / 2
            early, late = gaps[~later], gaps[later]
            if not early.size or late.max() > LONGER * early.max() or late.mean() > LONGER * early.mean():
                return True
        return False

    @cached_property
    def rows(self) -> ErrorRows:
        """Where errors are looked at."""
        at = np.sort(np.concatenate([np.arange(self.times.size), self.samples]))
        return ErrorRows(at, np.append(at[1:] != at[:-1], True), self.times[at])


def build_timeline(
    plant: Plant, schedule: AnySchedule, duration: float, horizon: float = np.inf, begins: str = "horizon"
) -> Timeline:
    """Return the timeline of [0, duration] for a schedule and windows (t - horizon, t], or from the sample until then.

    Raises ArgumentError if there is no sample in [0, duration], or the schedule does not fit the plant.
    """
    length = checks.positive("duration", duration)
    inside = align(plant, schedule).between(0.0, length)
    if not len(inside):
        raise ArgumentError(f"`schedule` holds no sample in [0, {length!r}]: there is nothing to compare.")
    times = inside.times
    starts = _snapped_to_samples(times - horizon, times, horizon)
    given = starts == 0.0
    if begins == "sample":
        starts = _sampled(starts, times)
        given |= (starts == 0.0) & bool(times[0] > 0.0)
    events = np.unique(np.concatenate([[0.0], times, starts, [length]]))
    breaks = _refined(plant, events, length / max(len(inside), 1))
    masks = np.ones((times.size, plant.n_outputs)) if inside.outputs is None else inside.outputs.astype(np.float64)
    F, gamma = exact_flow(plant, np.diff(breaks), plant.G)
    return Timeline(
        plant=plant,
        times=freeze(breaks),
        F=F,
        gamma=gamma,
        samples=np.searchsorted(breaks, times),
        masks=masks,
        starts=np.searchsorted(breaks, starts),
        given=given,
        events=np.searchsorted(breaks, events),
    )


def default_duration(schedule: Schedule | PeriodicSchedule, horizon: float) -> float:
    """Return three horizons and at least 40 mean gaps (but at most 200); of a finite schedule its last time.

    Raises ArgumentError if that is 0.
    """
    if not schedule.endless:
        if schedule.times[-1] <= 0:
            raise ArgumentError("`schedule` must have a sample after time 0: errors are looked at from there on.")
        return float(schedule.times[-1])
    gap = schedule.period / len(schedule)
    return float(schedule.first + min(max(3 * horizon, GAPS_TO_SETTLE * gap), 200 * gap))


def exact_flow(plant: Plant, lengths: Array, through: Array) -> tuple[Array, Array]:
    """Return e^{Ah} and int_0^h e^{As} ds `through`, one pair per length, from one augmented exponential."""
    n = len(through)
    s = state_units(plant.A, plant.states.scales)
    driven = through / s[:, None]
    size = np.linalg.norm(driven, axis=0)
    c = np.where(size > 0, size, 1.0)
    unique, place = np.unique(lengths, return_inverse=True)
    whole = forced_flow(plant.A * s / s[:, None], driven / c, unique)[place]
    return whole[:, :, :n] * (s[:, None] / s), whole[:, :, n:] * (s[:, None] * c)


def _sampled(starts: Array, times: Array) -> Array:
    """The last sample until each window start, 0 where there is none."""
    known = np.concatenate([[0.0], times])
    return np.asarray(known[np.searchsorted(known, starts, side="right") - 1])


def _snapped_to_samples(starts: Array, times: Array, horizon: float) -> Array:
    """Window starts, at least 0; one that is a sample's time but for rounding becomes it."""
    clipped = np.maximum(starts, 0.0)
    if not np.isfinite(horizon):
        return np.zeros_like(times)
    known = np.concatenate([[0.0], times])
    at = np.clip(np.searchsorted(known, clipped), 1, known.size - 1)
    near = np.where(clipped - known[at - 1] < known[at] - clipped, known[at - 1], known[at])
    return np.where(np.abs(near - clipped) <= SAME_TIME_ULPS * np.spacing(np.maximum(times, horizon)), near, clipped)


def _refined(plant: Plant, events: Array, gap: float) -> Array:
    """Put equal cells between events."""
    fastest = float(np.max(np.abs(np.linalg.eigvals(plant.A).imag), initial=0.0))
    cell = gap / CELLS_PER_GAP
    if fastest > 0:
        cell = min(cell, 2 * np.pi / fastest / CELLS_PER_CYCLE)
    cell = max(cell, float(events[-1]) / LARGEST)
    counts = np.maximum(1, np.ceil(np.diff(events) / cell - 1e-9)).astype(int)
    parts = [a + (b - a) * np.arange(k) / k for a, b, k in zip(events[:-1], events[1:], counts, strict=True)]
    return np.concatenate([*parts, events[-1:]])
