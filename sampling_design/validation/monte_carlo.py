"""Random trials in blocks, here or on other machines, bit for bit the same wherever they run."""

from __future__ import annotations

from base64 import b64decode, b64encode
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from sampling_design.checkers.strict import count, list_of, refuse, table, text
from sampling_design.records.arrays import Array
from sampling_design.records.file_io import usable
from sampling_design.records.sweeps import Journal
from sampling_design.records.workers import Workers, numbered
from sampling_design.validation.apriori_bound import AprioriBound
from sampling_design.validation.error_map import ErrorMap
from sampling_design.validation.scenario import ErrorSources, ScenarioBounds, draw_inputs

BLOCK = 64  # runs that are computed together. Fixed, since the rounding of a product may depend on how many share it


class MonteCarloTrials(NamedTuple):
    """What was observed, one row per run.

    size : (r, R) |measure e| at every row of the map; promised : (r,) largest ratio of |e|^2 to what was promised;
    ellipsoid : (r, R) |e|^2_Pi / radius; plain : (blocks, R) largest Euclidean |e| of each block.
    """

    size: Array
    promised: Array
    ellipsoid: Array
    plain: Array


def run_block(
    error_map: ErrorMap,
    bounds: ScenarioBounds,
    apriori: AprioriBound | None,
    measure: Array,
    seeds: Sequence[np.random.SeedSequence],
) -> MonteCarloTrials:
    """Draw runs with these seeds, apply one error map and compare."""
    return measured(error_map, apriori, measure, draw_inputs(error_map.timeline, bounds, seeds))


def measured(
    error_map: ErrorMap, apriori: AprioriBound | None, measure: Array, inputs: ErrorSources
) -> MonteCarloTrials:
    """Compare the errors of a batch with the promise (if there is one) and with the ellipsoids."""
    errors = error_map.apply(inputs)
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.sqrt(np.sum((errors.e @ measure.T) ** 2, axis=2))
        promised = np.full(size.shape[0], np.nan)
        if apriori is not None:
            promised = np.max(ratio(apriori.size(errors.e), apriori.along(error_map.timeline, inputs)), axis=1)
        plain = np.max(np.linalg.norm(errors.e, axis=2), axis=0)[None]
    return MonteCarloTrials(size, promised, error_map.ellipsoid_ratio(errors), plain)


def ratio(observed: Array, promised: Array) -> Array:
    """Return observed / promised; 0 where both are zero, NaN where one is no number or both are infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(observed == 0, np.where(np.isnan(promised), np.nan, 0.0), observed / promised)


def growth(size: Array, times: Array) -> Array:
    """Return the largest error of the second half of each run over that of the first, of sizes (r, R, ...) at times."""
    early = times <= times[-1] / 2
    return ratio(size[:, ~early].max(axis=1), size[:, early].max(axis=1))


def own_growth(w: Array, times: Array) -> Array:
    """Return likewise by how much disturbances (r, T, q) grow by themselves, 1 at least: slower than a run, they do."""
    return np.asarray(growth(np.abs(w), times).max(axis=1, initial=1.0))


def monte_carlo(
    error_map: ErrorMap,
    bounds: ScenarioBounds,
    apriori: AprioriBound | None,
    measure: Array,
    seeds: Sequence[np.random.SeedSequence],
    workers: Workers = None,
    progress: Callable[[float, str], None] | None = None,
    journal: Journal[MonteCarloTrials] | None = None,
    name: str = "",
) -> MonteCarloTrials:
    """Return the trials of one run per seed, in the order of the seeds.

    Raises ArgumentError if `workers` is none of these.

    Parameters
    ----------
    error_map : ErrorMap
    bounds : ScenarioBounds
        Within which inputs are drawn.
    apriori : AprioriBound or None
    measure : (k, n) array
        Of errors, before their length is taken.
    seeds : sequence of SeedSequence
        A run depends on its own seed alone.
    workers : Executor, Client, int or str, optional
        See `Workers`.
    journal : Journal, optional
        Where blocks are written down under `name` as they are finished; what it holds is not computed again.
    """
    blocks = [seeds[k : k + BLOCK] for k in range(0, len(seeds), BLOCK)]
    known = {} if journal is None else journal.known
    parts = {k: known[f"{name} {k}"] for k in range(len(blocks)) if f"{name} {k}" in known}
    for k, part in parts.items():
        _fits(part, len(blocks[k]), error_map.timeline.rows.times.size, str(journal and journal.path))
    todo = [k for k in range(len(blocks)) if k not in parts]
    run = partial(run_block, error_map, bounds, apriori, measure)
    for place, part in numbered(run, [blocks[k] for k in todo], workers):
        k = todo[place]
        parts[k] = part
        if journal is not None:
            journal.add(f"{name} {k}", _plain(part))
        if progress is not None:
            progress(len(parts) / len(blocks), f"{min(len(parts) * BLOCK, len(seeds))} of {len(seeds)} runs")
    whole = [parts[k] for k in range(len(blocks))]
    return MonteCarloTrials(*(np.concatenate(column) for column in zip(*whole, strict=True)))


def _fits(part: MonteCarloTrials, runs: int, rows: int, where: str) -> None:
    """Refuse trials of a journal that are not of so many runs and rows of a map."""
    shapes = ((runs, rows), (runs,), (runs, rows), (1, rows))
    with usable(where):
        for key, shape in zip(MonteCarloTrials._fields, shapes, strict=True):
            if getattr(part, key).shape != shape:
                raise refuse(key, f"must be of shape {shape}, got {getattr(part, key).shape}")


def _plain(trials: MonteCarloTrials) -> dict[str, object]:
    """MonteCarloTrials as plain data, every bit of them: shapes, and the bytes of the numbers."""
    return {
        key: {"shape": list(value.shape), "bytes": b64encode(np.asarray(value, dtype="<f8").tobytes()).decode()}
        for key, value in trials._asdict().items()
    }


def read_trials(value: object, place: str) -> MonteCarloTrials:
    """Trials as a journal holds them: every entry a size or a ratio, or NaN where nothing was promised."""
    return MonteCarloTrials(**table(dict.fromkeys(MonteCarloTrials._fields, _array))(value, place))


def _array(value: object, place: str) -> Array:
    packed = table({"shape": list_of(count), "bytes": text})(value, place)
    try:
        numbers = np.frombuffer(b64decode(packed["bytes"], validate=True), dtype="<f8").reshape(packed["shape"])
    except ValueError:
        raise refuse(place, f"must hold the numbers of an array of shape {tuple(packed['shape'])}") from None
    if (numbers < 0).any():
        raise refuse(place, "must hold no negative number")
    return numbers
