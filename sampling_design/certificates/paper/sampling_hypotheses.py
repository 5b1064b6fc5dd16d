"""The hypotheses of Theorem 14, measured on a schedule: window, sigma_bar, kappa(T), d_max."""

from __future__ import annotations

import numpy as np

from sampling_design.certificates.paper.observable_case import SamplingHypotheses
from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.observability.windows.window_sigma import window_sigma
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.record import short
from sampling_design.schedules.sampling_set import SamplingSet
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

LONGEST_WINDOW = 4
"""Windows are tried up to this many times the number of states, in samples (plus one period of a periodic schedule)."""


def measure_hypotheses(
    plant: Plant,
    schedule: Schedule | PeriodicSchedule,
    window: float | None = None,
    sigma_bar: float | None = None,
    kappa: int | None = None,
) -> SamplingHypotheses:
    """Return T, kappa(T), sigma_bar and d_max of a schedule for an observable plant.

    Without `window`: the shortest sum of consecutive gaps (the largest over their position) with sigma_bar > 0. Raises
    ArgumentError if the schedule has no samples, or a given number is out of range; CertificateError if sigma_bar is 0
    for the window given, or for every window tried.
    """
    if not len(schedule):
        raise ArgumentError("`schedule` must have at least one sample.")
    sampling, plant = SamplingSet(schedule), plant.unscaled()  # weights and constants of a proof are physical
    tried = _windows(schedule, plant.n_states) if window is None else [checks.positive("window", window)]
    for T in tried:
        sigma = _sigma(plant, schedule, T) if sigma_bar is None else checks.positive("sigma_bar", sigma_bar)
        if sigma > 0:
            count = sampling.kappa(T) if kappa is None else checks.whole("kappa", kappa, 1)
            return SamplingHypotheses(float(T), count, sigma, float(sampling.d_max))
    length = f"windows of {short(tried[0])}" if len(tried) == 1 else f"windows up to {short(tried[-1])}"
    raise CertificateError(
        f"Theorem 14 does not apply: {length} {plant.time_unit} do not all make every retained state "
        "observable (sigma_bar = 0). "
        "Take a longer window, or other gaps: a gap may be a multiple of half an oscillation.",
        windows=list(map(float, tried)),
    )


def _windows(schedule: Schedule | PeriodicSchedule, states: int) -> list[float]:
    """Largest sum of j consecutive gaps, j = 1, 2, ...: the least T for which every window holds j samples or more."""
    periodic = schedule.endless
    most = LONGEST_WINDOW * states + (len(schedule) if periodic else 0)
    gaps = np.tile(schedule.gaps, most // len(schedule) + 2) if periodic else schedule.gaps
    sums = np.concatenate([[0.0], np.cumsum(gaps)])
    start = 0.0 if periodic else float(schedule.times[0])  # K_1 begins with the time to the first sample
    sums = sums + start if periodic else np.concatenate([[0.0], start + sums])
    longest = [float(np.max(sums[j:] - sums[:-j])) for j in range(1, min(most, sums.size - 1) + 1)]
    return [T for T in longest if T > 0]


def _sigma(plant: Plant, schedule: Schedule | PeriodicSchedule, T: float) -> float:
    """Proven lower bound over all real windows, those that begin before the first sample included."""
    return float(window_sigma(plant, schedule, T, start=0.0).lower)
