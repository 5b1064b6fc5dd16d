"""What is read at one time: joined where it comes in parts, corrected, or taken back."""

from __future__ import annotations

import numpy as np

from sampling_design.accuracy.readings import RecordRow
from sampling_design.accuracy.record_rows import readings_of_sample, same_input
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.history import EstimatorState, InputHistory


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
