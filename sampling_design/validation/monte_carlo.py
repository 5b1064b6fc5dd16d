"""Random trials in blocks, here or on other machines, bit for bit the same wherever they run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sampling_design._workers import Workers, mapped
from sampling_design.validation.error_map import ErrorMap, Inputs
from sampling_design.validation.promise import Promise
from sampling_design.validation.scenario import ScenarioBounds, draw_inputs

Array = npt.NDArray[np.float64]

BLOCK = 64
"""Runs that are computed together. Fixed, since the rounding of a product may depend on how many share it."""


@dataclass(frozen=True, eq=False)
class RunBlock:
    """Runs with these seeds through one error map. Small enough to send, and it carries all it needs."""

    found: ErrorMap
    bounds: ScenarioBounds
    promise: Promise | None
    measure: Array
    seeds: tuple[np.random.SeedSequence, ...]


class Trials(NamedTuple):
    """What was seen, one row per run.

    size : (r, R) |measure e| at every row of the map; promised : (r,) largest ratio of |e|^2 to what was promised;
    ellipsoid : (r, R) |e|^2_Pi / radius; plain : (blocks, R) largest Euclidean |e| of each block.
    """

    size: Array
    promised: Array
    ellipsoid: Array
    plain: Array


def run_block(block: RunBlock) -> Trials:
    """Draw, apply and compare one block."""
    found, line = block.found, block.found.timeline
    return measured(found, block.promise, block.measure, draw_inputs(line, block.bounds, block.seeds))


def measured(found: ErrorMap, promise: Promise | None, measure: Array, inputs: Inputs) -> Trials:
    """Compare the errors of a batch with the promise (if there is one) and with the ellipsoids."""
    errors = found.apply(inputs)
    size = np.sqrt(np.sum((errors.e @ measure.T) ** 2, axis=2))
    promised = np.full(size.shape[0], np.nan)
    if promise is not None:
        promised = np.max(ratio(promise.size(errors.e), promise.along(found.timeline, found.rows, inputs)), axis=1)
    plain = np.max(np.linalg.norm(errors.e, axis=2), axis=0)[None]
    return Trials(size, promised, found.ellipsoid_ratio(errors), plain)


def ratio(observed: Array, promised: Array) -> Array:
    """Return observed / promised; 0 where both are zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(observed > 0, observed / promised, 0.0)


def monte_carlo(
    found: ErrorMap,
    bounds: ScenarioBounds,
    promise: Promise | None,
    measure: Array,
    seeds: Sequence[np.random.SeedSequence],
    workers: Workers = None,
    progress: Callable[[float, str], None] | None = None,
) -> Trials:
    """Return the trials of one run per seed, in the order of the seeds.

    Parameters
    ----------
    found, bounds, promise, measure
        As in `RunBlock`.
    seeds : sequence of SeedSequence
        A run depends on its own seed alone.
    workers : Executor, Client, int or str, optional
        See `Workers`.
    progress : callable, optional

    Returns
    -------
    Trials

    Raises
    ------
    ArgumentError
        If `workers` is none of these.
    """
    blocks = [
        RunBlock(found, bounds, promise, measure, tuple(seeds[k : k + BLOCK])) for k in range(0, len(seeds), BLOCK)
    ]
    parts = []
    for part in mapped(run_block, blocks, workers):
        parts.append(part)
        if progress is not None:
            progress(len(parts) / len(blocks), f"{min(len(parts) * BLOCK, len(seeds))} of {len(seeds)} runs")
    return Trials(*(np.concatenate(column) for column in zip(*parts, strict=True)))
