"""The paper's chain of constants against the exact certificate: horizon, gains, time."""

from __future__ import annotations

import numpy as np

import sampling_design as sd

from .table import Table, duration, seconds_of

FOUR = np.zeros((4, 4))
FOUR[0, 0], FOUR[1, 1], FOUR[2:, 2:] = -1.0, 0.1, [[0.0, 1.0], [-1.0, 0.0]]
PLANTS = {
    "double integrator": sd.named_plant("double_integrator"),
    "oscillator": sd.named_plant("oscillator"),
    "four states (-1, 0.1, ±i)": sd.Plant(FOUR, [[1.0, 1.0, 1.0, 0.0]]),
}


def run(quick: bool = False) -> list[Table]:
    """Return the tables of this task."""
    table = Table(
        "What a schedule proves",
        "One sample a second. The horizon that each route asks for, its noise gains, and what is true.",
        ("plant", "route", "horizon must exceed", "C_w", "C_v", "checked", "time to certify"),
    )
    schedule = sd.PeriodicSchedule([1.0])
    for name, plant in list(PLANTS.items())[: 1 if quick else None]:
        exact = sd.certify(plant, schedule)
        spent = seconds_of(lambda p=plant: sd.certify(p, schedule), least=1, budget=0.1)
        checked = {True: "proven again", False: "refused"}[exact.verify().passed]
        for row in sd.certificates.four_horizons(plant, schedule, exact).rows:
            gains = [f"{row.horizon.C_w:.3g}", f"{row.horizon.C_v:.3g}"] if row.horizon else [None, None]
            least = None if row.minimum is None else f"{row.minimum:.4g} s"
            evidence = (checked, duration(spent)) if row.name.startswith("exact") else (None, None)
            table.add(name, row.name, least, *gains, *evidence)
    table.notes.append(
        "The paper's constants are `constants_from_proof(variant='paper')`, the printed formulas corrected; "
        "the last row is the least window for which the estimator's own error map contracts."
    )
    return [table]
