"""Sigma of given samples, and of every window position, against a loop over scipy's matrix exponential."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

import sampling_design as sd

from .table import Table, duration, named, seconds_of


def loop_rows(plant: sd.Plant, times: np.ndarray) -> np.ndarray:
    """Return the rows C e^{A tau}, one exponential after the other."""
    return np.vstack([plant.C @ expm(plant.A * tau) for tau in times])


def loop_scan(plant: sd.Plant, schedule: sd.PeriodicSchedule, window: float, points: int) -> float:
    """Return the least sigma over a grid of window positions: what one would write in ten lines."""
    found = []
    for end in np.linspace(window, window + schedule.period, points):
        inside = schedule.between(end - window, end).times - (end - window)
        found.append(np.linalg.svd(loop_rows(plant, inside), compute_uv=False)[plant.n_states - 1])
    return float(min(found))


def run(quick: bool = False) -> list[Table]:
    """Return the tables of this task."""
    plant, rng = sd.named_plant("satellite"), np.random.default_rng(0)
    matrix = Table(
        "Rows at given times",
        "Observability matrix of the satellite (6 states, 3 outputs) at irregular times.",
        ("method", "samples", "time", "times faster", "largest relative difference"),
    )
    for count in (10, 100) if quick else (10, 100, 1000, 10_000):
        times = np.sort(rng.uniform(0.0, 5554.0, count))
        ours = seconds_of(lambda t=times: sd.observability.observability_matrix(plant, t), budget=0.3)
        slow = seconds_of(lambda t=times: loop_rows(plant, t), least=1 if count > 500 else 3, budget=0.3)
        reference = loop_rows(plant, times)
        off = np.abs(sd.observability.observability_matrix(plant, times) - reference).max() / np.abs(reference).max()
        matrix.add("sampling_design", count, duration(ours), f"{slow / ours:.1f}", f"{off:.1e}")
        matrix.add(f"loop, {named('scipy')} expm", count, duration(slow), "1", None)
    return [matrix, windows(quick)]


def windows(quick: bool) -> Table:
    """Return the table of least sigmas over all window positions."""
    table = Table(
        "The least sigma over all window positions",
        "Oscillator, gaps 1.0 1.2 1.801 s, window 4 s: when a sample has left, the next is missing for a millisecond.",
        ("method", "time", "least sigma", "what it is"),
    )
    plant, schedule = sd.named_plant("oscillator"), sd.PeriodicSchedule([1.0, 1.2, 1.801])
    ours = sd.window_sigma(plant, schedule, 4.0, rtol=1e-3)
    spent = seconds_of(lambda: sd.window_sigma(plant, schedule, 4.0, rtol=1e-3), budget=0.5)
    table.add("sampling_design", duration(spent), f"{ours.lower:.5f} to {ours.upper:.5f}", "proven and attained")
    for points in (50,) if quick else (50, 500, 5000):
        spent = seconds_of(lambda p=points: loop_scan(plant, schedule, 4.0, p), least=1, budget=0.3)
        value = loop_scan(plant, schedule, 4.0, points)
        table.add(f"expm loop, {points} positions", duration(spent), f"{value:.5f}", "only sampled")
    return table
