"""Sigma over every position of a window along a plant that varies in time, on a finite schedule."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.observability.alignment import align
from sampling_design.observability.sigma_bracket import SigmaDeviations
from sampling_design.observability.windows.pieces import WindowPieces
from sampling_design.observability.windows.window_record import WindowSigma, checked_pieces, record_of
from sampling_design.observability.windows.window_sigma import left_of_sigma, lost_one_by_one
from sampling_design.records import checks
from sampling_design.records.budget import Budget
from sampling_design.records.progress import Progress
from sampling_design.schedules.schedule import Schedule
from sampling_design.uncertain.observability.bracket_varying import bracket_varying
from sampling_design.uncertain.plants.time_varying import MatrixTable, TimeVaryingPlant

RTOL = 0.01  # default width of the bracket, relative
ROUGH = 1.0  # of what is beside it where nothing is proven: no interval is halved


def window_sigma_varying(
    plant: TimeVaryingPlant,
    schedule: object,
    window: float,
    rtol: float | None = None,
    budget: float | None = None,
    progress: Progress | None = None,
    rigorous: bool = False,
    start: float | None = None,
) -> WindowSigma:
    """Bound sigma over all positions of a window, rows C(tau) Phi(tau, t - T): see `window_sigma`.

    `deviations`, `sampled` of functions, are of real times within the horizon; windows that are longer by it may begin
    before the horizon, of the state at its beginning.

    Raises ArgumentError if balls are asked for, or the schedule is not finite or leaves the plant's horizon.
    """
    if rigorous:
        raise ArgumentError("`rigorous` is for plants that do not vary: of a table all rounding is counted anyway.")
    if not isinstance(schedule, Schedule):
        raise ArgumentError(
            f"`schedule` must be a Schedule within the plant's horizon, got {checks.described(schedule)}."
        )
    aligned = align(plant.at(0.0), schedule)
    outside = [t for t in aligned.times.tolist() if not 0 <= t <= plant.horizon]
    if outside:
        raise ArgumentError(
            f"`schedule` must lie within the plant's horizon [0, {plant.horizon:.6g}], got a sample at {outside[0]!r}."
        )
    pieces, tolerance, seconds = checked_pieces(aligned, window, start, RTOL if rtol is None else rtol, budget)
    limit = Budget(seconds)
    flows = cache(plant.transitions)
    bracket = bracket_varying(plant, pieces, tolerance, seconds, flows)
    found = record_of(bracket, tolerance, plant.time_unit, "scaled" if plant.has_scales else "physical")
    proven = plant.tabled and isinstance(plant.C, MatrixTable)  # between samples other C are only looked at
    rough = tolerance if proven else max(tolerance, ROUGH)

    def least(pieces: WindowPieces, seconds: float, _: float) -> tuple[float, float]:
        # windows that are longer may begin before the horizon: the state is that at its beginning
        left, right = np.maximum(pieces.left, 0.0), np.maximum(pieces.right, 0.0)
        found = bracket_varying(plant, replace(pieces, left=left, right=right), rough, seconds, flows)
        return found.lower if proven else found.witness.sigma, found.witness.sigma

    def beside() -> SigmaDeviations | None:
        lost = partial(lost_one_by_one, least, len(plant.outputs), len(aligned))
        sigma = found.lower if proven else found.upper
        left = left_of_sigma(
            aligned, window, least, lost, plant.time_unit, sigma=sigma, start=start, seconds=seconds_left
        )
        return left if proven or left is None else replace(left, sampled=True)

    seconds_left = limit.left
    return replace(found, beside=beside)
