"""How the time grows: with the states, with the samples, with the retained dimension."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from scipy.linalg import block_diag

import sampling_design as sd
from sampling_design.plotting import style

from .searching import tones
from .seeing import loop_rows
from .table import Table, duration, seconds_of

LINES = ("o-", "s--", "^-", "D:", "v--")  # colours of evidence say nothing of times
HOLLOW = "sD"
Curves = dict[str, list[tuple[float, float]]]


def large(n: int) -> sd.Plant:
    """Return a plant of n states of which an undamped oscillator is retained; the rest decays and is mixed in."""
    rng = np.random.default_rng(n)
    A = block_diag([[0.0, 1.0], [-1.0, 0.0]], np.diag(-np.linspace(0.5, 5.0, n - 2)))
    mixed = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return sd.Plant(mixed @ A @ mixed.T, np.ones((1, n)) @ mixed.T)


def run(quick: bool = False) -> list[Table]:
    """Return the tables of this task."""
    return [states(quick), samples(quick), retained(quick)]


def states(quick: bool) -> Table:
    """Return the table of times against the number of states."""
    table = Table(
        "Scaling: states from 2 to 200, two of them retained",
        "What must be seen is split off first; everything after it costs the same.",
        (
            "states",
            "modal split",
            "window sigma of the retained part",
            "certificate of the retained part",
            "expm loop, 12 samples",
        ),
    )
    curves: Curves = {name: [] for name in table.columns[1:]}
    schedule = sd.PeriodicSchedule([0.7, 1.6, 0.9, 2.0])
    for n in (2, 10) if quick else (2, 5, 10, 20, 50, 100, 200):
        plant = large(n)
        part = sd.plants.split_modes(plant).retained
        work = [
            lambda p=plant: sd.plants.split_modes(p),
            lambda p=part: sd.window_sigma(p, schedule, 4.0),
            lambda p=part: sd.certify(p, schedule, eta=0.2),
            lambda p=plant: loop_rows(p, np.linspace(0.0, 4.0, 12)),
        ]
        row(table, curves, n, work)
    table.figures["arena_states"] = drawn(curves, "states")
    return table


def samples(quick: bool) -> Table:
    """Return the table of times against the number of samples."""
    table = Table(
        "Scaling: samples from 10 to 100 000",
        "Oscillator, irregular samples; window of 4 s where there is one. Estimators: time of the whole record.",
        ("samples", "sigma of all samples", "expm loop", "window sigma", "Kalman filter", "moving horizon"),
    )
    curves: Curves = {name: [] for name in table.columns[1:]}
    plant, rng = sd.named_plant("oscillator"), np.random.default_rng(0)
    weights = {"P2": np.eye(2), "Qw": np.eye(2), "R": [[2.0]], "Qv": [[2.0]], "eta": 0.2}
    for count in (10, 100) if quick else (10, 100, 1000, 10_000, 100_000):
        gaps = rng.uniform(0.5, 1.5, count)
        times = np.cumsum(gaps)
        y = (plant.transition(times) @ [1.0, 0.0])[:, :1]
        record = [(t, v) for t, v in zip(times.tolist(), y, strict=True)]
        work = [
            lambda t=times: sd.observability.sigma_min(plant, t),
            lambda t=times: loop_rows(plant, t),
            lambda g=gaps: sd.window_sigma(plant, sd.PeriodicSchedule(g), 4.0),
            lambda r=record: sd.KalmanFilter(plant, cost=sd.CostFunction(**weights)).run(r),
            lambda r=record: sd.MovingHorizonEstimator(plant, horizon=8.0, cost=sd.CostFunction(**weights)).run(r),
        ]
        row(table, curves, count, work)
    table.figures["arena_samples"] = drawn(curves, "samples")
    return table


def retained(quick: bool) -> Table:
    """Return the table of times against the retained dimension."""
    table = Table(
        "Scaling: retained dimension from 2 to 8",
        "Undamped oscillations 1, 2, 3, 4 rad/s (and a constant for odd dimensions), one output, period 2 pi, "
        "n + 2 samples.",
        ("retained", "design", "window sigma", "certificate", "gap of the design", "bracket of the worst case in 10 s"),
    )
    curves: Curves = {name: [] for name in table.columns[1:4]}
    for n in (2, 3) if quick else range(2, 9):
        plant = tones(*range(1, n // 2 + 1))
        if n % 2:
            plant = sd.Plant(block_diag(np.zeros((1, 1)), plant.A), np.hstack([[[1.0]], plant.C]))
        wish = sd.Requirement(window=2 * np.pi, period=2 * np.pi, spacing=0.2, samples=n + 2)
        before = time.process_time()
        design = sd.design_schedule(plant, wish, budget=None if quick else 30.0)
        spent = time.process_time() - before
        work = [
            lambda p=plant, d=design: sd.window_sigma(p, d.schedule, 2 * np.pi),
            lambda p=plant, d=design: sd.certify(p, d.schedule, eta=0.2),
        ]
        found = [seconds_of(call, least=1, budget=0.3) for call in work]
        worst = sd.worst_case_sigma(plant, sd.SpacedWindows(4.0, n + 1, 0.3), budget=1.0 if quick else 10.0)
        for name, value in zip(table.columns[1:4], (spent, *found), strict=True):
            curves[name].append((n, value))
        bracket = f"{worst.lower:.4g} to {worst.upper:.4g} ({worst.status})"
        table.add(n, *(duration(v) for v in (spent, *found)), f"{100 * design.gap:.1f} %", bracket)
    table.figures["arena_retained"] = drawn(curves, "retained states", log=False)
    return table


def row(table: Table, curves: Curves, size: int, work: Sequence[Callable[[], Any]]) -> None:
    """Time the calls, add them as a row and to the curves."""
    found = [seconds_of(call, least=1, budget=0.2) for call in work]
    for name, value in zip(table.columns[1:], found, strict=True):
        curves[name].append((size, value))
    table.add(size, *map(duration, found))


def drawn(curves: Curves, label: str, log: bool = True) -> Any:
    """Return the figure of the curves; its title says how much longer the last size takes than the first."""
    ax = style.new_axes(width=8.0, height=3.6)
    for (name, points), line in zip(curves.items(), LINES, strict=False):
        shade = style.ALLOWED if line[0] in HOLLOW else style.TRUTH
        filled = "white" if line[0] in HOLLOW else None
        ax.plot(*zip(*points, strict=True), line, color=shade, markerfacecolor=filled, markersize=5, label=name)
    ax.set(xlabel=label, ylabel="processor time [s]", yscale="log", xscale="log" if log else "linear")
    ax.grid(alpha=0.3)
    ax.set_title(grown(curves, label), loc="left", fontsize="medium")
    ax.legend(frameon=False, fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return ax.figure


def grown(curves: Curves, label: str) -> str:
    """Say what grows least and what most from the first size to the last."""
    times = {name: points[-1][1] / points[0][1] for name, points in curves.items()}
    least, most = min(times, key=lambda name: times[name]), max(times, key=lambda name: times[name])
    first, last = next((points[0][0], points[-1][0]) for points in curves.values())
    said = {f"{name} takes {float(f'{times[name]:.2g}'):g} times as long": None for name in (least, most)}
    return f"{last} {label} instead of {first}: " + ",\n".join(said)
