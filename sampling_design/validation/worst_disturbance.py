"""The worst that can be done to an estimator: its linear error map, run backwards."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.records.arrays import Array
from sampling_design.validation.error_map import ErrorMap, SolveWindow
from sampling_design.validation.promise import Promise
from sampling_design.validation.scenario import ErrorSources, ScenarioBounds, most_along

MOST_TARGETS = 60  # rows at which the worst energy is computed; they are spread evenly where there are more


def sensitivity(found: ErrorMap, row: int) -> ErrorSources:
    """Return what the error at a row is made of, by going back from it through the windows in charge.

    e(row) = e0 E0' + sum_c E_w,c w_c + sum_j E_v,j v_j.
    """
    line = found.timeline
    n, q, p = line.plant.n_states, line.plant.n_disturbances, line.plant.n_outputs
    result = ErrorSources(np.zeros((n, n)), np.zeros((line.cells, n, q)), np.zeros((line.samples.size, n, p)))
    place = {int(b): k for k, b in enumerate(line.events)}
    solves = {window.end: window for window in found.windows}
    b, after, functional = int(found.rows.at[row]), bool(found.rows.after[row]), np.eye(n)
    while True:
        k = place.get(b)
        if after and k in solves:
            functional = _through_window(found, solves[k], functional, result)
            if solves[k].given:
                break
            b = int(line.events[solves[k].start])
            continue
        if b == 0:
            break
        functional = _through_cell(found, b - 1, functional, result)
        b, after = b - 1, True
    result.e0[:] = functional
    return result


def _through_cell(found: ErrorMap, c: int, functional: Array, result: ErrorSources) -> Array:
    result.w[c] -= functional @ found.timeline.gamma[c]
    return np.asarray(functional @ found.timeline.F[c])


def _through_window(found: ErrorMap, window: SolveWindow, functional: Array, result: ErrorSources) -> Array:
    events = found.timeline.events
    for k in range(window.end, window.start - 1, -1):
        absorb = window.absorbs.get(k)
        if absorb is not None:
            j = absorb.sample
            result.v[j] += functional @ absorb.gain @ found.weigh[j]
            functional = functional - functional @ absorb.gain @ found.H[j]
        if k > window.start:
            for c in range(events[k] - 1, events[k - 1] - 1, -1):
                functional = _through_cell(found, c, functional, result)
    return functional


class WorstEnergy(NamedTuple):
    """The largest |e|^2_P1 that a promised unit allows, the row where it is reached, and inputs that reach it."""

    ratio: float
    row: int
    inputs: ErrorSources


def worst_energy(found: ErrorMap, promise: Promise) -> WorstEnergy:
    """Return the worst ratio of |e|^2 to what is promised, over all e0, v and w constant on cells.

        max e'P e / (|e0|^2 + int |w|^2 + sum |v|^2, each discounted)  =  lambda_max(P^1/2 (sum E D^-1 E') P^1/2)

    At most MOST_TARGETS rows are looked at, always the last ones before and after a sample among them.
    """
    ends = np.sort(np.concatenate([found.rows.samples, found.rows.samples - 1]))
    chosen = ends[np.unique(np.linspace(0, ends.size - 1, min(MOST_TARGETS, ends.size)).astype(int))]
    best: tuple[float, int, Array, ErrorSources] | None = None
    for row in chosen:
        parts = sensitivity(found, int(row))
        total = sum(E @ D @ np.swapaxes(E, -1, -2) for E, D in _weighted(found, promise, int(row), parts))
        values, vectors = np.linalg.eigh(promise.root @ total @ promise.root.T)
        if best is None or values[-1] > best[0]:
            best = float(values[-1]), int(row), promise.root.T @ vectors[:, -1], parts
    assert best is not None
    ratio, row, direction, parts = best
    e0, w, v = (
        D @ (np.swapaxes(E, -1, -2) @ direction)[..., None] for E, D in _promise_terms(found, promise, row, parts)
    )
    return WorstEnergy(ratio, row, ErrorSources(*(part[None, ..., 0] for part in (e0, w, v))))


def _promise_terms(found: ErrorMap, promise: Promise, row: int, parts: ErrorSources) -> list[tuple[Array, Array]]:
    """Each part with the inverse of its weight in the promise at that row."""
    line, t = found.timeline, found.rows.times[row]
    inside, rate = line.times[1:] <= t * (1 + 1e-15), promise.rate
    faded = np.exp(-rate * np.maximum(t - line.times[1:], 0)) * discounted_length(rate, line.lengths)
    cost = np.where(inside, faded, np.inf)
    decay = np.exp(rate * np.maximum(t - line.times[line.samples], 0))
    unit = np.linalg.inv(promise.w)
    weights = promise.sample_weights(line.masks)
    blank = np.einsum("ja,ab->jab", 1 - line.masks, np.eye(line.masks.shape[1]))
    return [
        (parts.e0, np.linalg.inv(promise.prior) * np.exp(rate * t) / promise.gain),
        (parts.w, unit / cost[:, None, None] / promise.gain),
        (parts.v, np.linalg.inv(weights + blank) * decay[:, None, None] / promise.gain),
    ]


def _weighted(found: ErrorMap, promise: Promise, row: int, parts: ErrorSources) -> list[tuple[Array, Array]]:
    """The same as two-dimensional blocks, so that their sum is one matrix."""
    flat = []
    for E, D in _promise_terms(found, promise, row, parts):
        if E.ndim == 2:
            flat.append((E, D))
        else:
            scaled = np.einsum("kab,kbc,kdc->ad", E, D, E)
            flat.append((np.eye(E.shape[1]), scaled))
    return flat


def worst_disturbance(found: ErrorMap, bounds: ScenarioBounds, root: Array) -> ErrorSources:
    """Return the inputs within the bounds that make the last error largest, along each axis of |root e|, both ends.

    A linear functional over boxes and balls is largest at a corner or on the sphere, cell by cell: bang-bang.
    """
    rows = [int(found.rows.samples[-1]), int(found.rows.at.size - 1)]
    runs = []
    for row in rows:
        parts = sensitivity(found, row)
        for axis in root:
            aims = [np.swapaxes(E, -1, -2) @ axis for E in parts]
            runs.append([most_along(b, aim) for b, aim in zip((bounds.e0, bounds.w, bounds.v), aims, strict=True)])
    e0, w, v = (np.array(part) for part in zip(*runs, strict=True))
    return ErrorSources(e0, w, v * found.timeline.masks)
