"""How the cost of designs, long windows and large plants grows: docs/scaling.md and docs/figures/scaling_design.png.

python -m tests.benchmarks.scaling_design

CPU seconds of one thread, the least of several runs, one process. The exponent is the slope of log(seconds)
over log(size): 1 is linear growth.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from datetime import date
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from sampling_design import (
    PeriodicSchedule,
    Plant,
    Requirement,
    SpacedWindows,
    design_schedule,
    window_sigma,
    worst_case_sigma,
)
from sampling_design.design.bounds import weak_duality as bound
from sampling_design.design.bounds.relaxation import relax_placed
from sampling_design.design.problem.numbers import DesignProblem
from sampling_design.design.problem.positions import worst_sigma2
from sampling_design.plants import library
from sampling_design.plants.sparse import split_sparse

DOCS = Path(__file__).parents[2] / "docs"
PERIOD = 6.28
COUNTS = (12, 25, 50, 100)
STATES = (2, 4, 6, 8)
GRID = (100, 200, 400, 800)
CELLS = (1200, 2400, 4800, 9600)
WINDOWS = (10, 100, 1000, 10_000, 100_000)
SIDES = (10, 32, 100)
NODES = (100, 1000, 10_000)
CLOSED = np.array([[0.0, 1.5]])


def oscillators(n: int) -> Plant:
    """n/2 oscillators of 1, 2, ... rad/time, one output: their sum."""
    A = np.kron(np.diag(np.arange(1.0, n // 2 + 1)), [[0.0, 1.0], [-1.0, 0.0]])
    return Plant(A, np.tile([[1.0, 0.0]], n // 2))


def posed(n: int, samples: int) -> DesignProblem:
    """A period of which nearly a quarter is closed, so that even spacing is not the answer."""
    spacing = PERIOD / (4 * samples)
    return DesignProblem(oscillators(n), PERIOD, PERIOD, spacing, samples, CLOSED, np.zeros(0), (None,))


def seconds(function: Callable[[], object], rounds: int) -> float:
    """Least CPU time of one call."""
    found = []
    for _ in range(rounds):
        began = time.process_time()
        function()
        found.append(time.process_time() - began)
    return min(found)


def designs(n: int, samples: int) -> Callable[[], object]:
    """A whole design: relaxation, search, proof and bound."""
    requirement = Requirement(window=PERIOD, spacing=PERIOD / (4 * samples), samples=samples, forbidden=CLOSED)
    return lambda: design_schedule(oscillators(n), requirement, starts=3)


def evaluations(samples: int) -> Callable[[], object]:
    """Worst sigma of twenty schedules."""
    problem, rng = posed(4, samples), np.random.default_rng(0)
    times = np.sort(rng.uniform(0, PERIOD, (20, samples)), axis=1)
    worst_sigma2(problem, times)
    return lambda: worst_sigma2(problem, times)


def bounds_of_count(samples: int) -> Callable[[], object]:
    """The bound over all real times from given multipliers."""
    problem = posed(4, samples)
    found = relax_placed(problem)
    return lambda: bound.placed_bound(problem, found.starts, found.Z)


def relaxations(points: int) -> Callable[[], object]:
    """The semidefinite relaxation on a grid."""
    problem = posed(4, 24)
    relax_placed(problem, 24)
    return lambda: relax_placed(problem, points)


def bounds_of_cells(cells: int) -> Callable[[], object]:
    """The bound on a grid of time cells."""
    problem = posed(4, 24)
    found = relax_placed(problem)

    def run() -> None:
        before, bound.CELLS = bound.CELLS, cells
        try:
            bound.placed_bound(problem, found.starts, found.Z)
        finally:
            bound.CELLS = before

    return run


def window_of(length: int) -> Callable[[], object]:
    """Sigma over all positions of a window: four uneven samples in 5.2 s, an oscillator of 1 rad/s."""
    schedule = PeriodicSchedule([0.7, 1.6, 0.9, 2.0], time_unit="s")
    return lambda: window_sigma(library.oscillator(), schedule, float(length))


def worst_of(length: int) -> Callable[[], object]:
    """The worst of all schedules with four samples of place and velocity in the window, half a second apart."""
    family, plant = SpacedWindows(float(length), 4, 0.5), Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.0, 0.3]])
    return lambda: worst_case_sigma(plant, family)


def plate(states: int) -> Callable[[], object]:
    """Modes of a heat plate near and right of the line, and the proof that none was missed."""
    plant = library.heat_plate(round(states**0.5))
    return lambda: split_sparse(plant)


def network(nodes: int) -> Callable[[], object]:
    """The same of a power grid."""
    plant = library.droop_network(nodes)
    return lambda: split_sparse(plant)


CURVES: dict[str, tuple[str, tuple[int, ...], Callable[[int], Callable[[], object]], int]] = {
    "whole design, 4 states": ("samples per period", COUNTS, lambda k: designs(4, k), 2),
    "worst sigma of 20 schedules": ("samples per period", COUNTS, evaluations, 15),
    "bound from given multipliers": ("samples per period", COUNTS, bounds_of_count, 3),
    "relaxation": ("grid times", GRID, relaxations, 9),
    "bound, time cells": ("grid times", CELLS, bounds_of_cells, 3),
    "whole design, 16 samples": ("retained states", STATES, lambda n: designs(n, 16), 2),
    "sigma over all windows, oscillator": ("radians in a window", WINDOWS, window_of, 5),
    "worst spaced schedule, oscillator": ("radians in a window", WINDOWS, worst_of, 3),
    "modes of a heat plate": ("states of a sparse plant", tuple(n * n for n in SIDES), plate, 5),
    "modes of a power grid": ("states of a sparse plant", NODES, network, 5),
}
TICKS = {
    "samples per period": COUNTS,
    "grid times": (100, 1000, 10_000),
    "retained states": STATES,
    "radians in a window": WINDOWS,
    "states of a sparse plant": NODES,
}


def main() -> None:
    """Measure, write the table and the picture."""
    designs(2, 8)()  # the first call loads the solver
    lines = ["# How the cost grows", "", *__doc__.split("\n\n")[2].split("\n"), ""]
    made = f"Made by `python -m tests.benchmarks.scaling_design`, last on {date.today()}; {os.cpu_count()} cores."
    lines[2:2] = [made, ""]
    figure = Figure(figsize=(9.0, 7.4), layout="constrained")
    panels = figure.subplots(2, 3).ravel()
    panels[-1].remove()
    axes = dict(zip(TICKS, panels[:-1], strict=True))
    for name, (what, sizes, make, rounds) in CURVES.items():
        times = [seconds(make(size), rounds) for size in sizes]
        slope = np.polyfit(np.log(sizes), np.log(times), 1)[0]
        lines += [f"## {name}: exponent {slope:.2f}", "", f"| {what} | " + " | ".join(map(str, sizes)) + " |"]
        lines += [
            "|---" * (len(sizes) + 1) + "|",
            "| CPU seconds | " + " | ".join(f"{t:.3g}" for t in times) + " |",
            "",
        ]
        print(
            f"{name:32} {slope:5.2f}  " + "  ".join(f"{s}: {t:.3g} s" for s, t in zip(sizes, times, strict=True)),
            flush=True,
        )
        axes[what].loglog(sizes, times, "o-", label=f"{name} ({slope:.2f})")
    for what, ax in axes.items():
        first, low = min(min(zip(*line.get_data(), strict=True)) for line in ax.get_lines())
        last = TICKS[what][-1]
        ax.loglog([first, last], [low, low * last / first], ":", color="#b8b8b8", label="linear")
        ax.set_xticks(TICKS[what], [f"{size:g}" if size < 1e4 else f"1e{len(str(size)) - 1}" for size in TICKS[what]])
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xlabel(what)
        ax.set_ylabel("CPU time [s]")
        ax.legend(fontsize="x-small", frameon=False, loc="lower left", bbox_to_anchor=(0.0, 1.0))
    (DOCS / "figures").mkdir(exist_ok=True)
    figure.savefig(DOCS / "figures" / "scaling_design.png", dpi=110)
    lines += ["![CPU time over size](figures/scaling_design.png)", ""]
    (DOCS / "scaling.md").write_text("\n".join(lines))


if __name__ == "__main__":
    main()
