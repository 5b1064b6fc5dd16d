"""Cells of a box of plants for the worst schedule: how far sigma can be from that of a cell's centre."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from sampling_design.observability.box.branching import halved
from sampling_design.observability.box.expansion import UP, BoxCells, bases, beyond_first
from sampling_design.observability.box.model import BoxModel
from sampling_design.plants.plant import Plant
from sampling_design.schedules.spaced_windows import SpacedWindows

Array = npt.NDArray[np.float64]
SigmaOfOne = Callable[[Plant, float, float], tuple[float, float, Array]]
"""Of a plant, a tolerance and seconds: proven lower bound, attained upper one and its times."""

FINER = 0.25
"""Share of the tolerance that the bracket of each single plant may take."""


def whole(model: BoxModel) -> BoxCells:
    """The box as one cell."""
    start = np.zeros((1, model.m))
    return BoxCells(start, start + 1, np.zeros(1), np.zeros(1), np.zeros(1, dtype=int))


def parts_of(model: BoxModel, cell: BoxCells, family: SpacedWindows) -> BoxCells:
    """Both halves of a cell, along the parameter that moves the rows most."""
    effect = np.zeros((1, model.m + 1))
    effect[:, :-1] = np.linalg.norm(model.parts_A, axis=(1, 2)) * family.window * cell.half
    effect[:, :-1] += np.linalg.norm(model.parts_C, axis=(1, 2)) * cell.half
    return halved(cell, effect)


def spread_over(model: BoxModel, cell: BoxCells, family: SpacedWindows) -> Array:
    """At least |O(theta) - O(theta_0)| over a cell (1,), for any k times in the window."""
    A, C = model.at(cell.u)
    T_end, found = np.array([family.window]), np.full(1, np.inf)
    for T in bases(A, C, T_end):
        inverse = np.linalg.inv(T)
        B = inverse @ A @ T
        mu = np.linalg.eigvalsh((B + np.conj(np.swapaxes(B, 1, 2))) / 2)[:, -1]
        e = UP * np.sum(cell.half * np.linalg.norm(inverse @ model.parts_A @ T, 2, axis=(1, 2)), axis=1)
        c = UP * np.sum(cell.half * np.linalg.norm(model.parts_C @ T, 2, axis=(1, 2)), axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            grown, along = np.exp(np.maximum(mu, 0.0) * T_end), e * T_end
            row = grown * (np.linalg.norm(C @ T, 2, axis=(1, 2)) * (along + beyond_first(along)) + c * np.exp(along))
            whole = UP * np.sqrt(family.count) * row * np.linalg.norm(inverse / model.unit, 2, axis=(1, 2))
        found = np.fmin(found, whole)
    return np.asarray(found)
