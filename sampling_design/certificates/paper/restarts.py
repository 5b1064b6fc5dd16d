"""Where the proof of Theorem 5 restarts its bound, and Lemma 12's matrix: the two pieces of the chain one can draw."""

from __future__ import annotations

import numpy as np

from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.observability.alignment import align
from sampling_design.observability.windows.sampled import observability_matrix
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule


@checked
def restart_times(schedule: Schedule | PeriodicSchedule, t: float, t_star: float) -> Array:
    """Return k_1 = t* < k_2 < ... < t, the partition of [t*, t] in the repaired proof of Theorem 5.

        k_j - t* is a sample time for interior j;  t* <= k_{j+1} - k_j <= 2 t* except for the last interval, (0, 2 t*]

    Parameters
    ----------
    schedule : Schedule or PeriodicSchedule
        One sampling set K_i, times from its start.
    t : float [time]
        End, later than `t_star`.
    t_star : float [time]
        At least the longest gap, the one before the first sample included.

    Returns
    -------
    (m,) array
        Increasing, from t_star to t.

    Raises
    ------
    ArgumentError
        If t <= t_star.
    CertificateError
        If some interval of length t_star that the proof needs holds no sample (t_star < d_max).

    Notes
    -----
    *Claim.* Half-open windows (k_j - t*, k_{j+1}] cover no time more than twice. *Method.* Greedy: from k_j go to
    t* after the first sample at or after k_j. The paper asks that also the last interval be at least t* long; for
    some t no such partition exists, however large t* is (E4).

    References
    ----------
    The paper, proof of Theorem 5; theory E4, E5, E6.

    Examples
    --------
    >>> restart_times(PeriodicSchedule([1.0]), t=9.25, t_star=2.0)
    array([2.  , 4.  , 6.  , 9.25])
    """
    t, t_star = checks.positive("t", t), checks.positive("t_star", t_star)
    if t <= t_star:
        raise ArgumentError(f"`t` must be later than `t_star`, got t = {t!r} and t_star = {t_star!r}.")
    times = schedule.between(0.0, t).times
    points = [t_star]
    while t - points[-1] > 2 * t_star:
        here = int(np.searchsorted(times, points[-1] * (1 - 1e-12)))
        if here == times.size or times[here] > points[-1] + t_star:
            raise CertificateError(
                f"No sample in [{points[-1]:.6g}, {points[-1] + t_star:.6g}]: "
                "`t_star` must be at least the longest gap.",
                start=points[-1],
            )
        points.append(float(times[here]) + t_star)
    return np.array([*points, t])


@checked
def output_predictor(plant: Plant, schedule: Schedule | PeriodicSchedule, t: float, window: float) -> Array:
    """Return Lemma 12's H: the output at the window's end from the samples inside, without disturbance.

        C e^{AT} = H O,   rows of O: C e^{A (tau - (t - T))},  tau in [t - T, t];   |H| <= |C e^{AT}|/sigma_n(O)

    Parameters
    ----------
    plant : Plant
    schedule : Schedule or PeriodicSchedule
    t, window : float [time]
        End t and length T of the window.

    Returns
    -------
    (p, m) array
        One block of columns per sample, in the order of `observability_matrix`.

    Raises
    ------
    CertificateError
        If the samples in the window do not determine the state.

    References
    ----------
    The paper, Lemma 12, equation (21).

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    >>> output_predictor(plant, PeriodicSchedule([1.0]), t=2.5, window=2.0).round(9)
    array([[-0.5,  1.5]])
    """
    window = checks.positive("window", window)
    inside = align(plant, schedule).window(checks.number("t", t), window)
    O = observability_matrix(plant, inside.times - (t - window), inside.outputs)
    left, sizes, right = np.linalg.svd(O, full_matrices=False)
    n = plant.n_states
    if n and (sizes.size < n or sizes[-1] <= n * np.finfo(float).eps * sizes[0]):
        raise CertificateError(
            f"The {len(inside)} samples in the window that ends at {t:.6g} do not determine the state.", t=t
        )
    return np.asarray(plant.C @ plant.transition(window) @ (right.T / sizes) @ left.T)
