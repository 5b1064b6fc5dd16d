"""Worst case and design against global searches with equal time, and against regular and random samples."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

import sampling_design as sd
from tests.benchmarks.baselines import periodic_at_equal_cost

from .budgeted import Budgeted, evolve, homology
from .table import Table, duration, named

SEARCHES: dict[str, Callable[..., Budgeted]] = {"differential evolution": evolve, "SHGO": homology}


def tones(*rates: float) -> sd.Plant:
    """Return undamped oscillators whose sum is measured."""
    return sd.Plant(np.kron(np.diag(rates), [[0.0, 1.0], [-1.0, 0.0]]), np.tile([[1.0, 0.0]], len(rates)))


def daylight() -> tuple[sd.Plant, sd.Requirement]:
    """Return a mean level with a solar and a lunar tide, and ten readings in fifteen days, by day."""
    plant = tones(2 * np.pi / 12.0, 2 * np.pi / 12.4206)
    A = np.zeros((5, 5))
    A[1:, 1:] = plant.A
    nights = [[0.0, 7.0], *([24.0 * day + 19.0, 24.0 * day + 31.0] for day in range(14)), [355.0, 360.0]]
    wish = sd.Requirement(window=360.0, period=360.0, spacing=4.0, samples=10, forbidden=nights)
    return sd.Plant(A, np.hstack([[[1.0]], plant.C])), wish


WORST = {
    "oscillator, 3 in 4 s": (tones(1.0), sd.SpacedWindows(4.0, 3, 0.5), 0.01),
    "triple integrator, 3 in 4 s": (sd.named_plant("triple_integrator"), sd.SpacedWindows(4.0, 3, 0.5), 0.01),
    "1 and 2 rad/s, 6 in 4 s": (tones(1.0, 2.0), sd.SpacedWindows(4.0, 6, 0.3), 0.05),
}
DESIGNS = {
    "oscillator, 3 in 4 s": (tones(1.0), sd.Requirement(window=4.0, spacing=0.5, samples=3)),
    "1 and 2.7 rad/s, 8 in 7 s": (tones(1.0, 2.7), sd.Requirement(window=7.0, spacing=0.3, samples=8)),
    "1 and 2 rad/s, 5 in 6.28 s": (tones(1.0, 2.0), sd.Requirement(window=2 * np.pi, spacing=0.3, samples=5)),
    "tides by daylight, 10 in 15 d": daylight(),
}


def sigma_of_steps(plant: sd.Plant, family: sd.SpacedWindows) -> Callable[[np.ndarray], float]:
    """Return sigma as a function of points of the unit cube: sorted, stretched and spaced they are admissible times."""
    spacing = family.spacing * np.arange(family.count)
    slack = family.window - spacing[-1]

    def sigma(steps: np.ndarray) -> float:
        times = slack * np.sort(np.clip(steps, 0.0, 1.0)) + spacing
        rows = (plant.C @ plant.transition(times)).reshape(-1, plant.n_states)
        return float(np.linalg.svd(rows, compute_uv=False)[plant.n_states - 1])

    return sigma


def loss_of_steps(plant: sd.Plant, wish: sd.Requirement, count: int) -> Callable[[np.ndarray], float]:
    """Return minus the sigma of a periodic schedule as a function of points of the unit cube.

    Without forbidden times every point is admissible; with them a point whose times are too close counts as sigma 0.
    """
    window, spacing = float(wish.window or 0.0), float(wish.spacing or 0.0)
    edges = np.concatenate([[0.0], wish.forbidden.ravel(), [window]]).reshape(-1, 2)
    starts, lengths = edges[:, 0], edges[:, 1] - edges[:, 0]
    filled = np.concatenate([[0.0], np.cumsum(lengths)])

    def loss(steps: np.ndarray) -> float:
        steps = np.sort(np.clip(steps, 0.0, 1.0 - 1e-9))
        if len(wish.forbidden):
            inside = np.searchsorted(filled, steps * filled[-1], side="right") - 1
            times = starts[inside] + steps * filled[-1] - filled[inside]
            if np.diff(np.append(times, times[0] + window)).min() < spacing:
                return 0.0
        else:
            times = (window - count * spacing) * steps + spacing * np.arange(count)
        return -sd.window_sigma(plant, sd.PeriodicSchedule.from_times(times, window), window, rtol=0.02).upper

    return loss


def run(quick: bool = False) -> list[Table]:
    """Return the tables of this task."""
    return [worst_case(quick), design(quick)]


def worst_case(quick: bool) -> Table:
    """Return the table of worst cases."""
    table = Table(
        "The worst schedule of a family",
        "The least sigma over all schedules that keep count and spacing. Searches get the time that the proof took, "
        "at least a second, on the same fast sigma; a search finds an upper bound (and may go on without calls).",
        ("case", "method", "time", "found (attained)", "proven lower bound"),
    )
    least = 0.2 if quick else 1.0
    for search in SEARCHES.values():
        search(lambda steps: float(steps @ steps), 2, 0.5)  # imports and tables are not timed
    for name, (plant, family, rtol) in list(WORST.items())[: 1 if quick else None]:
        sd.worst_case_sigma(plant, family, rtol=0.5)  # imports are not timed
        before = time.process_time()
        ours = sd.worst_case_sigma(plant, family, rtol=rtol)
        spent = time.process_time() - before
        table.add(name, "sampling_design", duration(spent), f"{ours.upper:.6f}", f"{ours.lower:.6f}")
        goal = sigma_of_steps(plant, family)
        for label, search in SEARCHES.items():
            found = search(goal, family.count, max(spent, least))
            method = f"{label}, {named('scipy')}, {found.calls} calls"
            table.add(
                name, method, duration(found.spent), f"{found.best:.6f}" if found.calls else "nothing yet", "none"
            )
    return table


def design(quick: bool) -> Table:
    """Return the table of designs."""
    table = Table(
        "The best periodic schedule",
        "The largest sigma over all window positions. Searches get the time of the design, at least a second, and this "
        "toolbox's own window sigma as objective (a loop over expm would give them a hundredth of the calls).",
        ("case", "method", "time", "sigma", "no schedule exceeds", "proven gap"),
    )
    least, rng = (0.3 if quick else 1.0), np.random.default_rng(0)
    for name, (plant, wish) in list(DESIGNS.items())[: 1 if quick else None]:
        before = time.process_time()
        ours = sd.design_schedule(plant, wish)
        spent = time.process_time() - before
        count = len(ours.schedule)
        bound, gap = f"{ours.upper_bound:.5f}", f"{100 * ours.gap:.2f} %"
        table.add(name, "sampling_design", duration(spent), f"{ours.sigma:.5f} (proven)", bound, gap)
        goal = loss_of_steps(plant, wish, count)
        for label, search in SEARCHES.items():
            found = search(goal, count, max(spent, least))
            method = f"{label}, {named('scipy')}, {found.calls} calls"
            table.add(
                name,
                method,
                duration(found.spent),
                f"{0.0 - found.best:.5f}" if found.calls else "nothing yet",
                "none",
                "none",
            )
        drawn = [-goal(rng.uniform(size=count)) for _ in range(20 if quick else 100)]
        table.add(name, f"best of {len(drawn)} random schedules", None, f"{max(drawn):.5f}", "none", "none")
        regular = sd.window_sigma(plant, periodic_at_equal_cost(ours.schedule), float(wish.window or 0.0))
        table.add(name, "regular samples, equal number", None, f"{regular.upper:.5f}", "none", "none")
    return table
