"""Weights that follow from what is known about noise and prior, for radii instead of the shortest horizon."""

from __future__ import annotations

from typing import TypedDict

import numpy as np
import numpy.typing as npt

from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant, Signals
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Progress
from sampling_design.records.signatures import checked
from sampling_design.records.vector_bounds import VectorBound, vector_bound

LARGEST = 1e140
"""Bounds beyond it, or below its inverse, have squares that leave no room in a double for a rate beside them."""


@checked
def weights_from_bounds(
    plant: Plant, eta: float, w_bound: VectorBound, v_bound: VectorBound, initial_error: VectorBound
) -> dict[str, Array]:
    """Return the weights with which prior, disturbance and each sample's noise cost at most one.

        |e0|^2_P2 <= 1,    int e^{-eta s} |w|^2_Qw ds <= 1,    |v|^2_R~ <= 1

    Parameters
    ----------
    plant : Plant
    eta : float [1/time]
        Discount rate that the certificate will have.
    w_bound, v_bound, initial_error : float or array
        A number bounds the Euclidean norm, a vector bounds each entry. Positive.

    Returns
    -------
    dict
        P2, Qw, R and Qv, as `certify(plant, schedule, w_bound=..., ...)` takes them.

    Raises
    ------
    ArgumentError
        If a bound is not positive, has another length, or its weight or the rate is beyond double precision.

    Notes
    -----
    *Claim.* None by itself; the certificate that is made with the weights proves what it says. The default weights of
    `certify` are chosen for the shortest horizon and give ellipsoids that can be wide in states that the
    outputs see late; these balance the three terms of the online radius.

    References
    ----------
    The paper, Assumption 7 (any positive definite weights) and Remark 8.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> weights = weights_from_bounds(plant, 0.5, w_bound=0.1, v_bound=[0.2], initial_error=[1.0, 2.0])
    >>> weights["P2"].tolist(), round(float(weights["Qw"][0, 0]), 9)
    ([[0.5, 0.0], [0.0, 0.125]], 50.0)
    """
    rate = checks.positive("eta", eta)
    if rate > LARGEST:
        raise ArgumentError(f"`eta` must be at most {LARGEST:g}, got {eta!r}.")
    noise = 2.0 * _unit_ball("v_bound", v_bound, plant.outputs.names)
    return {
        "P2": _unit_ball("initial_error", initial_error, plant.states.names),
        "Qw": rate * _unit_ball("w_bound", w_bound, plant.disturbances.names),
        "R": noise,
        "Qv": noise.copy(),
    }


class ErrorBoundArguments(TypedDict, total=False):
    """Bounds as verbs take them: a number bounds the norm, a vector or a mapping from names each entry."""

    w_bound: VectorBound
    v_bound: VectorBound
    initial_error: VectorBound


class CertifyOptions(TypedDict, total=False):
    """What `certify` takes of every plant."""

    eta: float | None
    Qw: npt.ArrayLike | None
    R: npt.ArrayLike | None
    Qv: npt.ArrayLike | None
    noise_gain: float
    budget: float | None
    progress: Progress | None


class BoundedOptions(CertifyOptions, ErrorBoundArguments, total=False):
    """The same with bounds, which stand for the weights of an exactly known plant."""


def weights_within(plant: Plant, eta: float, bounds: ErrorBoundArguments) -> tuple[Array, Array, Array, Array]:
    """P2, Qw, R and Qv of bounds, the plant's scales in place of one that is None or zero.

    Raises ArgumentError if a bound is negative or has another length.
    """
    w = _or_scales("w_bound", bounds.get("w_bound"), plant.disturbances)
    v = _or_scales("v_bound", bounds.get("v_bound"), plant.outputs)
    weights = weights_from_bounds(
        plant, eta, w, v, _or_scales("initial_error", bounds.get("initial_error"), plant.states)
    )
    return weights["P2"], weights["Qw"], weights["R"], weights["Qv"]


def _or_scales(name: str, bound: VectorBound, signals: Signals) -> VectorBound:
    """A bound, or the scales where there is none or it is zero: nothing can be weighed by 1/0."""
    if bound is None:
        return signals.scales
    return bound if vector_bound(name, bound, signals.names).all() else signals.scales


def _unit_ball(name: str, bound: VectorBound, names: tuple[str, ...]) -> Array:
    """Q with |z|^2_Q <= 1 wherever the bound holds."""
    size, entries = len(names), vector_bound(name, bound, names)
    if entries.ndim == 0:
        return np.eye(size) / _weighable(name, np.array([checks.positive(name, entries)])) ** 2
    if np.any(entries <= 0):
        raise ArgumentError(f"`{name}` must be positive in every entry, got {entries.tolist()}.")
    return np.diag(1.0 / (size * _weighable(name, entries) ** 2))


def _weighable(name: str, entries: Array) -> Array:
    if entries.size and not 1 / LARGEST <= entries.min() <= entries.max() <= LARGEST:
        raise ArgumentError(
            f"`{name}` must lie between {1 / LARGEST:g} and {LARGEST:g}, or double precision cannot hold its weight "
            f"1/bound^2, got {entries.tolist()}."
        )
    return entries
