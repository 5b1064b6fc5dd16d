"""The sample-based observability matrix (Def 11), its n-th singular value and its Gramian."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import smallest_singular
from sampling_design.numerics.modal_flow import exponential
from sampling_design.observability.alignment import align
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule


@checked
def observability_matrix(plant: Plant, times: npt.ArrayLike | Schedule, outputs: npt.ArrayLike | None = None) -> Array:
    """Return the sample-based observability matrix O_s.

        O_s = [C e^{A tau_1}; ...; C e^{A tau_N}]

    Parameters
    ----------
    plant : Plant
    times : (N,) array [plant.time_unit], or Schedule
        Times tau_i, relative to the instant whose state is meant. An array may hold any real times in
        any order: a negative one asks what a sample says about a later state.
    outputs : (N, p) array of bool, optional
        Which outputs each sample measures; default those of the schedule, or all. Rows that are not
        measured are left out.

    Returns
    -------
    (R, n) array
        R = N p where everything is measured; rows in order of time index, then output.

    Raises
    ------
    ArgumentError
        If a time is not finite or so far that e^{A t} overflows, the mask has the wrong shape, a schedule
        is endless or in another unit of time, or a mask is given although the schedule has its own.

    Notes
    -----
    *Method.* Rows C e^{A tau} come from the plant's flow, cached per matrix (see `modal_flow.exponential`).
    *Numerical aspects.* Each e^{A tau} is accurate normwise, to some 1e-12 of its norm.

    References
    ----------
    The paper, Definition 11, equation (20).

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    >>> observability_matrix(plant, [0.0, 1.0, 3.0])
    array([[1., 0.],
           [1., 1.],
           [1., 3.]])
    """
    tau, mask = _times_and_mask(plant, times, outputs)
    with np.errstate(over="ignore", invalid="ignore"):
        rows = exponential(plant.A).rows(plant.C, tau)
    if not np.isfinite(rows).all():
        far = float(tau[np.argmax(~np.isfinite(rows).all(axis=(1, 2)))])
        raise ArgumentError(f"`times` must keep e^(A t) a number, got {far!r}, where unstable modes overflow.")
    return rows.reshape(tau.size * plant.n_outputs, plant.n_states) if mask is None else rows[mask]


@checked
def sigma_min(plant: Plant, times: npt.ArrayLike | Schedule, outputs: npt.ArrayLike | None = None) -> float:
    """Return sigma_n(O_s), the n-th singular value of the sample-based observability matrix.

        sigma = min over |x| = 1 of (sum_i |C e^{A tau_i} x|^2)^{1/2}

    Parameters
    ----------
    plant, times, outputs
        As for `observability_matrix`.

    Returns
    -------
    float
        0 where there are fewer rows than states; infinity for a plant without states.

    Raises
    ------
    ArgumentError
        As for `observability_matrix`.

    Notes
    -----
    *Numerical aspects.* The least singular value of a wide matrix is not this one: one row in two
    dimensions has least singular value |row| and leaves a direction unobserved. Values below n eps |O_s|
    are rounding. Sigma refers to the state at time 0 of `times` and is not invariant under scaling.

    References
    ----------
    The paper, Theorem 14.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> sigma_min(plant, [0.0])
    0.0
    >>> round(sigma_min(plant, [0.0, np.pi / 2]), 12)
    1.0
    """
    return float(smallest_singular(observability_matrix(plant, times, outputs)))


@checked
def observability_gramian(plant: Plant, times: npt.ArrayLike | Schedule, outputs: npt.ArrayLike | None = None) -> Array:
    """Return the sampled observability Gramian.

        W = sum_i (C e^{A tau_i})' C e^{A tau_i} = O_s' O_s

    Parameters
    ----------
    plant, times, outputs
        As for `observability_matrix`.

    Returns
    -------
    (n, n) array
        Symmetric, positive semidefinite.

    Raises
    ------
    ArgumentError
        As for `observability_matrix`.

    Notes
    -----
    *Numerical aspects.* Squares the condition: use `sigma_min` for the least singular value, never the
    root of the least eigenvalue of this matrix.

    References
    ----------
    The paper, Definition 11.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    >>> observability_gramian(plant, [0.0, 1.0])
    array([[2., 1.],
           [1., 1.]])
    """
    rows = observability_matrix(plant, times, outputs)
    with np.errstate(over="ignore", invalid="ignore"):
        gramian = np.asarray(rows.T @ rows)
    if not np.isfinite(gramian).all():
        raise ArgumentError(
            f"`plant` and `times` must give rows whose squares are numbers, got {np.max(np.abs(rows)):.3g}. "
            "Use sigma_min, which does not square them, or other units."
        )
    return gramian


def _times_and_mask(
    plant: Plant, times: npt.ArrayLike | Schedule, outputs: npt.ArrayLike | None
) -> tuple[Array, Mask | None]:
    """Times as a vector, and the mask that holds for them."""
    match times:
        case PeriodicSchedule():
            raise ArgumentError(
                "`times` must be finitely many, got a PeriodicSchedule. Use schedule.between(start, end), "
                "or window_sigma for all windows at once."
            )
        case Schedule():
            if outputs is not None and times.outputs is not None:
                raise ArgumentError("`outputs` must be left out where the schedule has its own mask.")
            schedule = align(plant, times)
            tau, mask = schedule.times, schedule.outputs
        case _:
            tau, mask = checks.vector("times", times), None
    if outputs is not None:
        mask = checks.output_mask("outputs", outputs, tau.size)
        if mask is not None and mask.shape[1] != plant.n_outputs:
            raise ArgumentError(
                f"`outputs` must have one column per output, ({tau.size}, {plant.n_outputs}), got shape {mask.shape}."
            )
    return tau, mask
