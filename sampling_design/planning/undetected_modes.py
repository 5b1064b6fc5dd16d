"""What a grid or hours hide for ever, in words: which modes, and which finer grid would show them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sampling_design.planning.discrete_plant import HIDDEN, STAYS, DiscretePlant, UndetectedModes, hidden_at
from sampling_design.planning.problem import MOST_STEPS, PlanProblem
from sampling_design.plants.clusters import eigenvalue_clusters, format_eigenvalue
from sampling_design.records.arrays import Array

FINER = (2, 3, 4, 5, 6, 7)  # parts of a step that are tried


def modes_of(discrete: DiscretePlant, undetected: UndetectedModes) -> str:
    """Return the modes that hidden trajectories are made of, in words."""
    names = []
    scale = max(float(np.linalg.norm(discrete.A, 2)), np.finfo(float).tiny)
    clusters = eigenvalue_clusters(discrete.A)
    for cluster in clusters:
        value = complex(cluster.value)
        others = [complex(c.value) for c in clusters if c is not cluster]
        part = undetected.states.astype(np.complex128)
        for other in others:  # what is left after every other mode is taken out, as often as it may be repeated
            for _ in range(discrete.n - len(others)):
                part = (discrete.A - other * np.eye(discrete.n)) @ part / (scale + abs(other))
        if np.linalg.norm(part) > HIDDEN and value.imag >= 0:
            names.append(format_eigenvalue(value, grain=STAYS / discrete.step))
    return f"a trajectory of the mode{'s' if len(names) > 1 else ''} {', '.join(names)}" if names else "a trajectory"


def finer_grid(problem: PlanProblem, discrete: DiscretePlant, rows: Array) -> float | None:
    """Return a grid that shows all that never decays, in the hours that there are; None if none was found."""
    always = np.array([goal.at == "all times" for goal in problem.goals], dtype=bool)
    for parts in FINER:
        if problem.steps * parts > MOST_STEPS:
            break
        finer = replace(discrete, step=discrete.step / parts, _flows={})
        allowed = np.repeat(problem.allowed, parts, axis=0)
        if hidden_at(finer, allowed, rows, always) is None:
            return problem.step / parts
    return None
