"""Are samples where the certificate's schedule says? Asked one sample at a time, in constant time.

A family that remembers all gaps is asked about all that are kept.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from functools import cached_property
from typing import overload

import numpy as np

from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.online.estimator import GuaranteeWarning
from sampling_design.estimators.online.history import EstimatorState, HistoryNode
from sampling_design.estimators.records.measurement_table import moved_origin
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.schedules.family import AnySchedule, Leeway, SamplingFamily
from sampling_design.schedules.jitter import Timing, TimingTolerance
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

WEIGHTLESS = 240.0
"""Exponent of the discount beyond which a horizon is not followed: no digit of an estimate shows a weight of e^-240.
Windows that slide hold discounts up to e^300 (`WIDEST` of `window/sliding.py`); longer ones are solved anew."""


def choose_horizon(
    certificate: SampledCertificate | None, horizon: float | None, cost: CostFunction, theorem: str
) -> tuple[float, str]:
    """Return the horizon and, in words, why there is no a-priori claim ("" if there is one).

    A discounted horizon reaches back to `WEIGHTLESS` at most. With the paper's cost M must exceed the lesser of two:
    the paper's theorem asks 4 lam_samples^2 e^{-eta M} < 1, the sharper one 2 lam e^{-eta M} < 1. Raises ArgumentError
    if there is neither a certificate nor a horizon.

    Parameters
    ----------
    certificate : Certificate, FamilyCertificate or InclusionCertificate, optional
    horizon : float, optional [time]
        Default: the one that the certificate recommends.
    cost : CostFunction
        Weights that are given and differ from the certificate's leave no claim.
    theorem : str
        The one that the estimator's cost needs, as `certificate.horizon` takes it.

    Warns
    -----
    GuaranteeWarning
        If the horizon is not longer than the certificate allows.
    """
    if certificate is None:
        if horizon is None:
            raise ArgumentError("`horizon` must be given where there is no certificate to take it from.")
        return _followed(checks.positive("horizon", horizon), cost.eta), "No a-priori claim: no certificate was given."
    own = certificate.horizon(theorem)
    length = own.length if horizon is None else checks.positive("horizon", horizon)
    length = _followed(length, certificate.eta if cost.eta is None else cost.eta)
    differ = [key for key in cost.given if not np.array_equal(getattr(cost, key), getattr(certificate, key))]
    if differ:
        return length, f"No a-priori claim: {', '.join(differ)} differ from the certificate's."
    least = own.minimum
    if theorem == "paper":
        least = min(least, math.log(2 * certificate.lam_proven) / certificate.eta)
    if cost.arrival != "fixed" or length > least:
        return length, ""
    note = f"No a-priori claim: the horizon {length:.6g} must exceed {least:.6g} for this certificate."
    warnings.warn(note, GuaranteeWarning, stacklevel=4)
    return length, note


def _followed(horizon: float, eta: float | None) -> float:
    """The part of a horizon whose beginning has a weight."""
    return min(horizon, WEIGHTLESS / eta) if eta else horizon


ROUNDINGS = 4.0
"""Units in the last place of a time stamp within which it may have been rounded: stamp, period and their product."""

SHARE_OF_GAP = 1e-6  # share of the schedule's least gap that counts as no difference: sums of many gaps are rounded too


class ScheduleWatch:
    """Answers for a finite or periodic schedule, or a family of schedules, in the plant's time unit.

    A sample is on schedule within `tolerance` of its planned time (beyond the family's own leeway), and within what
    rounding can do to the times given: differences count, whatever the clock's zero is. `zero` is what the clock shows
    at time 0 of the schedule.
    """

    def __init__(
        self, schedule: AnySchedule | SamplingFamily | None, time_unit: str, tolerance: float = 0.0, zero: float = 0.0
    ):
        if isinstance(schedule, (Schedule, PeriodicSchedule)) and schedule.time_unit not in (None, time_unit):
            schedule = schedule.in_unit(time_unit)
        if schedule is None or isinstance(schedule, SamplingFamily):
            family, plan = schedule, None if schedule is None else schedule.leeway
        else:
            family, plan = None, Leeway(schedule)
        self.family = family if plan is None else None
        self.nominal: AnySchedule | None = None
        self.zero = zero
        self.tolerance, self.losses, gap = tolerance, (0, 1), 0.0
        if plan is not None:
            self.nominal = plan.schedule
            self.tolerance, self.losses = tolerance + plan.radius, (plan.most, plan.of)
            gap = float(plan.schedule.gaps.min()) if plan.schedule.gaps.size else 0.0
        elif family is not None:
            gap = family.min_gap
        self._grain = SHARE_OF_GAP * gap

    def sample_fits(self, times: Sequence[float], mask: Array, first: bool) -> bool:
        """Whether the last of `times` (those kept so far) is as planned; `first` if only the prior lies before it.

        `mask` says which outputs it measured; more than planned is as good. A family plans all of them.
        """
        if self.nominal is None:
            return self._family_fits(times, first) and (self.family is None or bool(np.all(mask > 0)))
        before, t = float(times[-2]) - self.zero, float(times[-1]) - self.zero
        k = self._nearest(t)
        if k is None or abs(self._planned(k) - t) > self._room(t):
            return False
        wanted = self.nominal.outputs
        read = mask if wanted is None else mask[wanted[k % len(self.nominal)]]
        if not bool(np.all(read > 0)):
            return False
        missed = k - self._next_scheduled(before, first)
        return missed == 0 or (0 < missed <= self.losses[0] and self._few_lost(times, k, first))

    def nothing_missed(self, times: Sequence[float], t: float, first: bool) -> bool:
        """Whether no sample was due after the last of `times` and ahead of t."""
        if self.nominal is None:
            return t - times[-1] <= self._longest_next(times, None) + self._room(t)
        before, t = times[-1] - self.zero, t - self.zero
        last = self._next_scheduled(before, first) + self.losses[0]
        if not self.nominal.endless and last >= len(self.nominal):
            return False
        return self._planned(last) >= t - self._room(t)

    def _room(self, t: float) -> float:
        """How far from its planned time a sample at t may lie."""
        return self.tolerance + self._grain + ROUNDINGS * float(np.spacing(abs(t) + abs(self.zero)))

    def _planned(self, k: int) -> float:
        """Planned time of sample k, counted from 0."""
        assert self.nominal is not None
        periods, place = divmod(k, len(self.nominal))
        period = self.nominal.period if self.nominal.endless else 0.0
        return float(self.nominal.times[place]) + periods * period

    def _first_from(self, t: float) -> int:
        """Number of the first sample planned at t or later."""
        assert self.nominal is not None
        cycle, periods = self.nominal.times, 0
        if self.nominal.endless:
            period = self.nominal.period
            periods = max(0, int(np.floor((t - float(cycle[0])) / period)))
            t = t - periods * period
        return periods * len(self.nominal) + int(np.searchsorted(cycle, t))

    def _nearest(self, t: float) -> int | None:
        """Number of the sample planned nearest to t; None if there is none."""
        assert self.nominal is not None
        after = self._first_from(t)
        if not self.nominal.endless and after >= len(self.nominal):
            return len(self.nominal) - 1 if len(self.nominal) else None
        near = [k for k in (after - 1, after) if k >= 0]
        return min(near, key=lambda k: abs(self._planned(k) - t))

    def _next_scheduled(self, before: float, first: bool) -> int:
        """Number of the sample due after the one taken at `before` (at or after a prior there)."""
        if first:
            return self._first_from(before - self._room(before) + self.tolerance)
        near = self._nearest(before)
        return 0 if near is None else near + 1

    def _few_lost(self, times: Sequence[float], k: int, first: bool) -> bool:
        """Whether few enough of the samples planned up to number k were lost, among those still remembered."""
        most, of = self.losses
        taken = {self._nearest(float(t) - self.zero) for t in times[1 if first else 0 :]}
        start = self._next_scheduled(float(times[0]) - self.zero, True)
        lost = np.array([j not in taken for j in range(max(start, k - 2 * of), k + 1)], dtype=int)
        total = np.concatenate([[0], np.cumsum(lost)])
        return bool(np.all(total[of:] - total[:-of] <= most)) if lost.size >= of else bool(total[-1] <= most)

    def _family_fits(self, times: Sequence[float], first: bool) -> bool:
        family = self.family
        if family is None:
            return True
        gap, room = float(times[-1] - times[-2]), self._room(float(times[-1]))
        if gap > self._longest_next(times, -1) + room:
            return False
        if first:
            return True
        if gap < family.min_gap - room:
            return False
        if not (family.remembers and family.judges_pieces):  # the gaps before were looked at when they came
            return True
        samples = self._counted(times)
        return self.tolerance > 0 or samples.size < 2 or family.contains(Schedule(samples))

    def _longest_next(self, times: Sequence[float], end: int | None) -> float:
        """Longest gap that may follow the times up to a place; a family that does not remember gets none."""
        if self.family is None:
            return np.inf
        return self.family.longest_next(self._counted(times[:end]) if self.family.remembers else np.zeros(0))

    @staticmethod
    def _counted(times: Sequence[float]) -> Array:
        """Times of samples, counted from the oldest node."""
        return np.asarray(times[1:], dtype=float) - times[0]


class ScheduleClaim:
    """What a certificate says a priori, as long as the samples are on its schedule; `note` says why it says nothing."""

    def __init__(
        self,
        note: str = "",
        schedule: AnySchedule | SamplingFamily | None = None,
        time_unit: str = "",
        timing_tolerance: Timing = 0.0,
        schedule_zero: float = 0.0,
    ):
        self.note = note
        late = TimingTolerance.of(timing_tolerance, unit=time_unit)
        late.require_together("a claim for a schedule")
        begun = checks.number("schedule_zero", schedule_zero)
        tolerance, zero = late.radius, begun + late.shift
        apart = schedule.by_output if isinstance(schedule, SamplingFamily) else ()
        each: dict[int | None, AnySchedule | SamplingFamily | None] = dict(enumerate(apart)) or {None: schedule}
        # of each output by itself where they are read at times of their own; of None: of whole samples
        self.watches = {
            i: ScheduleWatch(part, time_unit, tolerance, zero) for i, part in each.items() if part is not None
        }
        dated = (w.nominal.origin for w in self.watches.values() if w.nominal is not None)
        zero_date = next(filter(None, dated), "")
        self.origin = moved_origin(zero_date, -begun, time_unit) if zero_date and begun else zero_date

    @property
    def stands(self) -> bool:
        """Whether there is a claim before any sample."""
        return not self.note and bool(self.watches)

    def nothing_missed(self, nodes: Sequence[HistoryNode], t: float) -> bool:
        """Whether no sample was due after the last of some nodes and ahead of t."""
        return all(self._none_missed(i, nodes, t) for i in self.watches)

    def _none_missed(self, i: int | None, nodes: Sequence[HistoryNode], t: float) -> bool:
        taken = _TakenTimes(i, nodes)
        return taken.last is not None and self.watches[i].nothing_missed(taken, t, taken.first)

    def fits(self, state: EstimatorState, t: float, mask: Array) -> bool:
        """Whether everything up to and with a sample at t is on schedule.

        A sample without a number, of limits and means alone, is none for the schedule: the claim is about numbers.
        """
        scheduled = state.nodes[-1].scheduled
        if not scheduled or not self.watches:
            return scheduled
        if not mask.any():
            return self.nothing_missed(state.nodes, t)
        for i, watch in self.watches.items():
            read = mask if i is None else mask[i : i + 1]
            if not read.any():
                fit = self._none_missed(i, state.nodes, t)
            else:
                taken = _TakenTimes(i, state.nodes, t)
                fit = taken.last is not None and watch.sample_fits(taken, read, taken.first)
            if not fit:
                return False
        return True


class _TakenTimes(Sequence[float]):
    """Times of the prior and the samples that count, of output i alone if it is one, and perhaps of one ahead of them.

    Most ask for the last ones alone, and these are found from the end. Where all samples of an output are too old to be
    known, the oldest node stands for the prior.
    """

    def __init__(self, i: int | None, nodes: Sequence[HistoryNode], *ahead: float):
        self._i, self._nodes, self._ahead = i, nodes, ahead
        self.last = next(filter(self._own, reversed(nodes)), None) or next(filter(_counts, nodes), None)

    def _own(self, node: HistoryNode) -> bool:
        return _counts(node) and (self._i is None or node.sample.y is None or bool(node.mask[self._i]))

    @property
    def first(self) -> bool:
        """Whether only the prior is known."""
        last = self.last
        return last is not None and (last.sample.y is None or not (self._i is None or bool(last.mask[self._i])))

    @cached_property
    def _all(self) -> list[float]:
        own = [node.t for node in self._nodes if self._own(node)]
        return [*(own or [node.t for node in (self.last,) if node is not None]), *self._ahead]

    @overload
    def __getitem__(self, at: int) -> float: ...
    @overload
    def __getitem__(self, at: slice) -> list[float]: ...
    def __getitem__(self, at: int | slice) -> float | list[float]:
        if at == -1 and self._ahead:
            return self._ahead[0]
        if self.last is not None and at == -1 - len(self._ahead):
            return self.last.t
        return self._all[at]

    def __len__(self) -> int:
        return len(self._all)


def _counts(node: HistoryNode) -> bool:
    """Whether a node is the prior or holds a number: what a certificate's schedule is about."""
    return not node.sample.censored or bool(node.mask.any())
