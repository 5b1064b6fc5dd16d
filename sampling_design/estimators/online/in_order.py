"""From samples as they come to estimates: order, lateness, repetition. What a sample is worth is the child's job.

What is read at one time is joined where it comes in parts, corrected, or taken back.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.readings import (
    CensoredReading,
    RecordRow,
    time_or_span,
)
from sampling_design.accuracy.record_rows import merge, read_row, readings_of_sample, refuse_truth, same_input
from sampling_design.checkers.strict import is_list, is_number
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostWeights
from sampling_design.estimators.online.estimate import Estimate
from sampling_design.estimators.online.estimator import EstimateRecord, Sample
from sampling_design.estimators.online.history import EstimatorState, HistoryNode, InputHistory
from sampling_design.estimators.records.measurement_table import MeasuredPlant
from sampling_design.estimators.records.measurements import Measurements, on_clock
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Progress
from sampling_design.records.record import Displayable
from sampling_design.records.signatures import checked_methods


def with_input(state: EstimatorState, sample: RecordRow) -> EstimatorState:
    """Return the state that also knows the input from `sample.t` on."""
    at = state.inputs.before(sample.t)
    if at < len(state.inputs) and state.inputs[at][0] == sample.t:
        same_input(*state.inputs[at], sample.u)
        return state
    reached = state.reached if at == len(state.inputs) else None
    return EstimatorState(state.nodes, state.inputs.added(at, sample.t, sample.u), reached)


def corrected(old: RecordRow, new: RecordRow) -> RecordRow:
    """The old sample with the readings of the new one in place of its own."""
    now = readings_of_sample(new)
    for output in now.keys() - readings_of_sample(old).keys():
        raise ArgumentError(
            f"`y` corrects output {output + 1} at t = {old.t!r}, where it was not read. A new reading is for update."
        )
    y = np.where([output in now for output in range(len(old.y))], new.y, old.y)
    y.flags.writeable = False
    censored = (*(each for each in old.censored if each.output not in now), *new.censored)
    return RecordRow(old.t, y, None, tuple(sorted(censored, key=lambda each: each.output)))


def without(old: RecordRow, output: int, name: str) -> list[RecordRow]:
    """The sample without one reading; none where it has no other."""
    read = readings_of_sample(old)
    if output not in read:
        raise ArgumentError(f"`output` = {name!r} was not read at t = {old.t!r}.")
    if len(read) == 1:
        return []
    y = old.y.copy()
    y[output] = np.nan
    y.flags.writeable = False
    return [RecordRow(old.t, y, None, tuple(each for each in old.censored if each.output != output))]


def corrected_inputs(inputs: InputHistory, sample: RecordRow) -> InputHistory:
    """Inputs with another value at a time at which there is one."""
    at = inputs.before(sample.t)
    if at == len(inputs) or inputs[at][0] != sample.t:
        raise ArgumentError(f"`u` corrects an input at t = {sample.t!r}, where none was given. It is for update.")
    return InputHistory((*inputs[:at], (sample.t, sample.u), *inputs[at + 1 :]))


AHEAD = 512  # samples of a record whose gaps are made at once
MOST_INTERVALS, FEW_STATES = 1000, 4
"""Rows up to which estimates lie in the middle of their intervals by default, and states up to which that holds."""


def few_intervals(rows: int, states: int) -> bool:
    """Whether intervals of so many estimates take little: the work of one grows with the cube of the states."""
    return rows * max(1.0, states / FEW_STATES) ** 3 <= MOST_INTERVALS


@checked_methods
class OnlineEstimator(Displayable, ABC):
    """Base of the estimators: a pure `step(state, sample)`, and `update`, `predict`, `run`, `stream` around it."""

    _order: ClassVar[str] = "Times and values make one record: Measurements(plant, times, y)."

    plant: Plant
    weights: CostWeights
    horizon: float
    memory: float
    maximum_delay: float
    input_side: str
    state: EstimatorState
    remembered: int = 0
    """Nodes that are kept beside those that `memory` [time] keeps."""
    centres: bool = False
    """Whether `run` moves estimates into the middle of what data and bounds allow, by default."""

    _table: ClassVar[Mapping[str, str]] = {
        "plant": "{plant.name:or -}",
        "states": "{plant.states.names}",
        "horizon": "{horizon} {plant.time_unit}",
        "latest": "{state.last.t} {plant.time_unit}",
    }

    clock_origin = ""
    """Date of the estimator's time 0, where the schedule of its certificate has one."""
    _dated = ""

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        checked_methods(cls)

    @abstractmethod
    def _advance(self, state: EstimatorState, sample: RecordRow) -> HistoryNode:
        """Return the node of a checked sample that is later than all nodes of `state` (or at the prior's time)."""

    def _resolved(self, state: EstimatorState, sample: RecordRow) -> RecordRow:
        """Return a sample with what readings of uncertain times say of its time."""
        del state
        return sample

    def _settled(self, nodes: tuple[HistoryNode, ...], inputs: InputHistory) -> tuple[HistoryNode, ...]:
        """Return nodes in which readings of uncertain times say what all of them together tell."""
        del inputs
        return nodes

    @abstractmethod
    def _predict(self, state: EstimatorState, t: float) -> Estimate:
        """Return the estimate at t, at or after the first node of `state`."""

    def keep_for_late(self, maximum_delay: float | None) -> None:
        """Keep what late samples need, as far back as asked (default: a horizon), of an estimator with a `horizon`."""
        self.maximum_delay = (
            self.horizon if maximum_delay is None else checks.nonnegative("maximum_delay", maximum_delay)
        )
        self.memory = self.horizon + self.maximum_delay

    def step(self, state: EstimatorState, sample: Sample | tuple[object, ...]) -> tuple[EstimatorState, Estimate]:
        """Return the state after `sample` and the estimate at the latest sample; `state` itself stays as it was.

        Parameters
        ----------
        state : EstimatorState
            From `initial_state` or an earlier `step`.
        sample : (t, y, u)
            y (p,) with NaN for "not measured", None for no measurement; u (m,) holds from t on, None for unchanged.

        Raises
        ------
        ArgumentError
            If t lies further back than late samples are kept, y or u has the wrong length, u holds NaN, all of
            y is NaN, or t was already given with other values.

        Notes
        -----
        *Method.* A late sample is inserted and everything after it is replayed from the snapshot before it, so
        that the result is that of the samples in order; estimates that were handed out stay what they were.
        """
        return self._taken_in(state, *triple(sample))

    def _taken_in(self, state: EstimatorState, time: object, y: object, u: object) -> tuple[EstimatorState, Estimate]:
        checked = self._check(state, time, y, u)
        if checked.u is not None:
            state = with_input(state, checked)
        if checked.t > state.nodes[-1].t and not (checked.u is not None and _touched(state, checked.t)):
            if checked.y is None:
                state = self._after_input(state, checked.t)
                return state, self._predict(state, checked.t)
            node = self._advance(state, self._resolved(state, checked))
            # what is settled may rest on more than is kept after it
            nodes = self._settled((*state.nodes, node), state.inputs)
            state = EstimatorState.kept(nodes, state.inputs, self.memory, self.remembered)
            return state, self._handed_out(state, len(state.nodes) - 1)
        return self._late(state, checked)

    @abstractmethod
    def _handed_out(self, state: EstimatorState, node: int) -> Estimate:
        """Return the estimate of a node as a caller gets it."""

    def _after_input(self, state: EstimatorState, t: float) -> EstimatorState:
        """Return the state after an input at t, ahead of all nodes, with what makes the next one cheap."""
        return state

    def _late(self, state: EstimatorState, sample: RecordRow) -> tuple[EstimatorState, Estimate]:
        """Insert a sample (or an input) at or before the last node and replay what comes after it."""
        at = state.node_before(sample.t)
        first = [sample]
        if state.nodes[at].t == sample.t and state.nodes[at].sample.y is not None:
            merged = merge(state.nodes[at].sample, sample)
            if merged is None:
                return state, self._handed_out(state, len(state.nodes) - 1)
            first, at = [merged], at - 1
        elif sample.y is None:
            first = []
        return self._replay(state, at, first, sample.t, forced=sample.u is not None)

    def _replay(
        self, state: EstimatorState, at: int, first: list[RecordRow], t: float, *, forced: bool, taken: bool = False
    ) -> tuple[EstimatorState, Estimate]:
        """Go on from the node `at` with other samples at t, `forced` with another input from then on.

        What contradicted the bounds still does, if nothing is `taken` away and the input is what it was.
        """
        least = -1 if taken or forced else 0
        back = min([at, *(k - 1 for k in _touched(state, t) if forced), *(max(k, least) for k in _resting(state, t))])
        first, at = [*(node.sample for node in state.nodes[back + 1 : at + 1]), *first], back
        if at < 0:
            raise ArgumentError(f"`t` = {t!r} is the oldest snapshot kept: there is nothing before it to replay from.")
        later = [node.sample for node in state.nodes[at + 1 :] if node.t > t]
        replayed = EstimatorState(tuple(node.known_by(t) for node in state.nodes[: at + 1]), state.inputs)
        for item in [*first, *later]:
            node = self._advance(replayed, self._resolved(replayed, item))
            node = node._replace(until=replayed.last.until) if replayed.last.until >= node.t else node
            replayed = EstimatorState((*replayed.nodes, node), state.inputs)
        nodes = self._settled(replayed.nodes, state.inputs)
        replayed = EstimatorState.kept(nodes, state.inputs, self.memory, self.remembered)
        old, new = state.last, replayed.last
        if not (taken or forced) and (proven := old.branch.contradiction(old.number)) is not None:
            new.branch.record(new.number, proven)  # a sample more does not make the others agree
        return replayed, self._handed_out(replayed, len(replayed.nodes) - 1)

    def _check(self, state: EstimatorState, time: object, values: object, given: object) -> RecordRow:
        sample = read_row(time, values, given, self.plant.n_outputs, self.plant.n_inputs)
        self._refuse_too_late(sample.t, state)
        if sample.censored:
            self._check_censored(state, sample.t, sample.censored)
        return sample

    def _refuse_too_late(self, t: float, state: EstimatorState) -> None:
        first, last = state.nodes[0], state.nodes[-1].t
        oldest = max(first.t, last - self.maximum_delay)
        if last - self.memory < first.t and first.sample.y is not None:
            # samples that are withdrawn do not bring back what was let go when they came
            oldest = max(oldest, first.t + (self.memory - self.maximum_delay))
        if t < oldest:
            raise ArgumentError(
                f"`t` must be at least {oldest!r}, got {t!r}: it goes back beyond the window that is kept for late "
                f"samples (latest sample at {last!r}). `maximum_delay` keeps more, `start()` forgets all."
            )

    def _check_censored(self, state: EstimatorState, t: float, limits: tuple[CensoredReading, ...]) -> None:
        """Refuse limits, means and uncertain times that say nothing here."""
        if limits[0].stamp is not None:
            raise ArgumentError(f"`t` = {limits[0].span!r} is uncertain: this estimator takes exact times only.")
        raise ArgumentError(f"`y` holds a limit or a mean at t = {t!r}: this estimator takes plain numbers only.")

    def update(self, t: float | tuple[float, float], y: object = None, u: object = None) -> Estimate:
        """Take in a sample and return the estimate at the latest sample; see `step`. On an error nothing changes."""
        self.state, estimate = self._taken_in(self.state, t, y, u)
        return estimate

    def correct(self, t: float | tuple[float, float], y: object = None, u: object = None) -> Estimate:
        """Replace what was said of a time, and return the estimate at the latest sample: as if it had come so at first.

        Parameters
        ----------
        t : float
            Of a sample (of an input, where u is corrected), not further back than late samples are kept.
        y : (p,) array, optional
            Right readings (numbers, limits or means); NaN where what was read stands.
        u : (m,) array, optional
            Right inputs from t on.

        Raises
        ------
        ArgumentError
            As `step`, or if that output or input was not given at t.

        Notes
        -----
        On an error nothing changes. What contradicted the bounds only together with a corrected reading or input, no
        longer does.
        """
        state, sample = self.state, self._check(self.state, t, y, u)
        at = state.node_before(sample.t)
        if sample.u is not None:
            state = state._replace(inputs=corrected_inputs(state.inputs, sample), reached=None)
        if sample.y is None:
            first: list[RecordRow] = []
            if self._is_sample(state, at, sample.t):
                first, at = [state.nodes[at].sample], at - 1
        else:
            first, at = [corrected(self._sample_at(state, at, sample.t), sample)], at - 1
        self.state, estimate = self._replay(state, at, first, sample.t, forced=sample.u is not None, taken=True)
        return estimate

    def withdraw(self, t: float | tuple[float, float], output: str | None = None) -> Estimate:
        """Take back a sample, and return the estimate at the latest one: as if it had never come.

        Parameters
        ----------
        t : float
            Of the sample, not further back than late samples are kept; inputs from t on stand.
        output : str, optional
            Of its readings the only one that is taken back. Default: all.

        Raises
        ------
        ArgumentError
            If there is no such sample or reading, or it lies too far back.

        Notes
        -----
        On an error nothing changes. What contradicted the bounds only together with this sample, no longer does:
        `withdraw(found.t, found.output)` leaves out what a `Contradiction` names.
        """
        when, _ = time_or_span(t)
        self._refuse_too_late(when, self.state)
        at = self.state.node_before(when)
        rest = self._sample_at(self.state, at, when)
        if output is None:
            first: list[RecordRow] = []
        else:
            names = self.plant.outputs.names
            first = without(rest, names.index(checks.word("output", output, names)), output)
        self.state, estimate = self._replay(self.state, at - 1, first, when, forced=False, taken=True)
        return estimate

    @staticmethod
    def _is_sample(state: EstimatorState, at: int, t: float) -> bool:
        return at >= 0 and state.nodes[at].t == t and state.nodes[at].sample.y is not None

    def _sample_at(self, state: EstimatorState, at: int, t: float) -> RecordRow:
        """The sample of a node that is that of t."""
        if not self._is_sample(state, at, t):
            raise ArgumentError(f"`t` must be the time of a sample that is kept, got {t!r}. A new one is for update.")
        return state.nodes[at].sample

    def predict(self, t: float) -> Estimate:
        """Return the online estimate at t, open loop from the last sample at or before t.

        Raises
        ------
        ArgumentError
            If t lies before the oldest snapshot kept.
        """
        when = checks.number("t", t)
        first = self.state.nodes[0].t
        if when < first:
            raise ArgumentError(f"`t` must be at least {first!r}, the oldest time kept, got {when!r}.")
        return self._predict(self.state, when)

    def expect(self, times: npt.ArrayLike) -> None:
        """Prepare for samples at some times: all gaps to come are known at once, at a fraction of the cost of each.

        Estimates are the same without it, but for rounding.

        Parameters
        ----------
        times : (N,) array
            Those that come next; what is not later than the last sample is passed over.
        """
        given = checks.vector("times", times)
        later = given[given > self.state.last.t]
        if later.size:
            self._expect(np.unique(later))

    def _expect(self, times: Array) -> None:
        """Prepare for samples at increasing times after the last: here they need no preparation."""
        del times

    def stream(self, samples: Iterable[object]) -> Iterator[Estimate]:
        """Yield the estimate after each (t, y, u); nothing but the last two windows is kept."""
        for item in samples:
            yield self.update(*triple(item))

    def run(self, record: object, *, centred: bool | None = None, progress: Progress | None = None) -> EstimateRecord:
        """Take in a whole record of samples and return all estimates.

            x_i = (lower_i + upper_i)/2 of the values that data and bounds allow, or the estimator's own x

        Parameters
        ----------
        record : Measurements, DataFrame or iterable of (t, y, u)
            A frame of pandas or polars is read by `read_measurements`. Dates count from the origin of the certificate's
            schedule, else as in the record before, else from the first. It is gone through in order of time, so that
            every sample has its estimate; `update` and `stream` take samples as they come, and return the estimator's
            own.
        centred : bool, optional
            Whether each estimate is moved into the middle of its interval (`Estimate.centred`), where no other has a
            smaller radius: some milliseconds each, which its `radii` take anyway. Default: of a moving horizon
            estimator that has bounds and no `cost`, for up to 1000 rows (of more than four states: fewer). Who gives
            a cost asks for what minimises it.
        progress : callable, optional
            Called with a fraction in [0, 1] and a message after each hundredth of the record.

        Returns
        -------
        EstimateRecord

        Raises
        ------
        ArgumentError
            If the record cannot be gone through, or estimates are to be centred and no bound on w or v was given.
        """
        known = self._dated if len(self.state.nodes) > 1 else ""
        samples, self._dated = listed(record, self.plant, self.clock_origin or known)
        every = max(1, len(samples) // 100)
        moves = self.centres and few_intervals(len(samples), self.plant.n_states)
        moves = moves if centred is None else centred
        found = []
        for k, item in enumerate(samples):
            if k % AHEAD == 0:
                self.expect(_stamps(samples[k : k + AHEAD]))
            estimate = self.update(*triple(item))
            found.append(estimate.centred() if moves else estimate)
            if progress is not None and ((k + 1) % every == 0 or k + 1 == len(samples)):
                progress((k + 1) / len(samples), f"{k + 1} of {len(samples)} samples")
        return EstimateRecord.collect(self.plant, found, self._dated)


def _touched(state: EstimatorState, t: float) -> list[int]:
    """The nodes before t with readings that may have been taken at t or later."""
    nodes = state.nodes[: state.node_before(t) + 1] if np.isfinite(state.last.limited) else ()
    stamps = ((k, each.stamp) for k, node in enumerate(nodes) for each in node.sample.censored)
    return [k for k, stamp in stamps if stamp is not None and stamp.last >= t]


def _resting(state: EstimatorState, t: float) -> list[int]:
    """The nodes from which on what uncertain times tell rests on samples at t or later."""
    if not np.isfinite(state.last.limited):
        return []
    nodes = list(enumerate(state.nodes))
    return [k for k, node in nodes if node.boxed_until >= t] + [k - 1 for k, node in nodes if node.until >= t]


def _stamp(item: object) -> float:
    """The time stamp of a sample, the middle of one that is uncertain; NaN where it says nothing."""
    t = item[0] if is_list(item) and item else None
    if is_list(t) and len(t) == 2 and is_number(t[0]) and is_number(t[1]):
        return float(t[0] + (t[1] - t[0]) / 2)
    return float(t) if is_number(t) else np.nan


def _stamps(samples: list[object]) -> list[float]:
    """The time stamps of samples, where they say something."""
    return [t for t in map(_stamp, samples) if math.isfinite(t)]


def listed(record: object, plant: MeasuredPlant, origin: str = "") -> tuple[list[object], str]:
    """The samples of a record in order of time, and the date of its time 0; a frame is read like a file of `plant`.

    Dates count from `origin`, where one is known.

    Raises ArgumentError if it cannot be gone through; FileFormatError if it is a frame that holds no measurements of
    this plant.
    """
    refuse_truth(record)
    record = on_clock(record, plant, origin)
    origin = record.origin if isinstance(record, Measurements) else ""
    if isinstance(record, Iterable) and not isinstance(record, (str, bytes)) and getattr(record, "ndim", True):
        found = list(record)
        times = _stamps(found)
        return (sorted(found, key=_stamp) if len(times) == len(found) and times != sorted(times) else found), origin
    raise ArgumentError(
        f"`record` must be Measurements, a DataFrame or a list of (t, y, u), got {checks.described(record)}."
    )


def triple(item: object) -> Sample:
    """One sample of a record. Raises ArgumentError if it is no (t, y), (t, y, u)."""
    if not is_list(item) or not 1 <= len(item) <= 3:
        raise ArgumentError(f"`sample` must be (t, y) or (t, y, u), got {checks.described(item)}.")
    return Sample(*item)
