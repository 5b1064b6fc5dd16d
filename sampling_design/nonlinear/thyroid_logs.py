"""The pituitary-thyroid loop in logarithms of its concentrations, and a region of patients for certificates.

In concentrations the Jacobian of the patient moves by orders of magnitude over the region that a course of the paper's
example passes through; in logarithms what flows in per unit of a state is a rate, and how it depends on the others
hardly moves at all. The fast states follow the slow ones, so that the region is a thin tube: its coordinates are the
logarithm of T4 and by how much the others are away from what T4 makes of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np
import numpy.typing as npt

from sampling_design.errors import ArgumentError
from sampling_design.nonlinear.functions import casadi
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.thyroid import DAY, constants_of, loop
from sampling_design.plants.plant import Signals
from sampling_design.records import checks
from sampling_design.records.arrays import Array

if TYPE_CHECKING:
    from casadi import SX


REST = np.array([7.33e-13, 2.161e-8, 9.583e-10, 2.102e-9, 4.698, 5.017])
"""About the untreated patient's rest: the unit of each logarithm."""

TUBE = np.array(
    [
        [1.0, 0.2, 0.0, 0.0, 0.0, 0.0],
        [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [0.0, -1.0, 1.0, 0.0, 0.0, 0.0],
        [0.0, -1.0, 0.0, 1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.55, 1.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, -1.0, 1.0],
    ]
)
"""Coordinates of the tube are TUBE log(x/REST): T4 stays, T3_p and T3_c are compared with it, TSH with T3_c, TSH_c
with TSH; the numbers are the gains at rest, rounded."""


def inflows(
    power: Callable[..., SX], u: SX, w: SX | tuple[SX, SX], p: Mapping[str, float]
) -> list[tuple[list[tuple[float, SX]], SX | float]]:
    """Return for each state what flows in per unit of it, as constants and terms, and the share lost, per second.

    d(log x)/dt = sum of constants times terms - loss. `power(a, b, ...)` is T4_th^a T4^b T3_p^c T3_c^d TSH^e TSH_c^f;
    `u` = absorbed (T4, T3) [mol/s], `w` = (w1, w6) per second.
    """
    T4_th, T4, T3_c, TSH, TSH_c = (power(*row) for row in np.eye(6)[[0, 1, 3, 4, 5]])
    bound = 1 + p["K41"] * p["TBG"] + p["K42"] * p["TBPA"]  # T4 over its free part; likewise T3
    nuclear = 1 / (1 + p["K31"] * p["IBS"])
    synthesis, active = 1 / (TSH + p["D_T"]), 1 / (TSH + p["k_Dio"])  # per unit of TSH
    shared = T4_th * TSH * active
    conversion = p["G_D1"] / (p["K_M1"] + shared) + p["G_D2"] / (p["K_M2"] + shared)
    outflow = p["G_MCT8"] / (p["K_MCT8"] + T4_th)
    deiodination = (p["G_D1"] / (p["K_M1"] + T4 / bound) + p["G_D2"] / (p["K_M2"] + T4 / bound)) / bound
    taken = p["G_D2"] / (p["K_M2"] + T4 / bound) / bound
    # 1/(1 + S TSH_c/(TSH_c + D)) and 1/(1 + L R/(D + R)) with 1/TSH_c and 1/T3_c taken out
    short = (TSH_c + p["D_S"]) / (1 + p["S_S"] + p["D_S"] * power(0, 0, 0, 0, 0, -1))
    bound_share = p["D_R"] + nuclear * T3_c
    long = bound_share / ((1 + p["L_S"] * p["G_R"]) * nuclear + p["D_R"] * power(0, 0, 0, -1, 0, 0))
    release = p["G_H"] * p["TRH"] / (p["TRH"] + p["D_H"])
    made = p["alpha_31"]
    return [
        (
            [(p["alpha_th"] * p["G_T"], power(-1, 0, 0, 0, 1, 0) * synthesis), (1.0, w[0] * power(-1, 0, 0, 0, 0, 0))],
            p["alpha_th"] * (outflow + TSH * active * conversion) + p["beta_th"],
        ),
        (
            [(p["alpha_T"], power(1, -1, 0, 0, 0, 0) * outflow), (p["alpha_T"], u[0] * power(0, -1, 0, 0, 0, 0))],
            p["beta_T"],
        ),
        (
            [
                (made, power(0, 1, -1, 0, 0, 0) * deiodination),
                (made * p["G_T3"], power(0, 0, -1, 0, 1, 0) * synthesis),
                (made, power(1, 0, -1, 0, 1, 0) * active * conversion),
                (made, u[1] * power(0, 0, -1, 0, 0, 0)),
            ],
            p["beta_31"],
        ),
        ([(p["alpha_32"], power(0, 1, 0, -1, 0, 0) * taken)], p["beta_32"]),
        ([(p["alpha_S"] * release, power(0, 0, 0, -1, -1, -1) * short * long)], p["beta_S"]),
        (
            [
                (p["alpha_S2"] * release, power(0, 0, 0, -1, 0, -2) * short * long),
                (1.0, w[1] * power(0, 0, 0, 0, 0, -1)),
            ],
            p["beta_S2"],
        ),
    ]


def logarithms(x: npt.ArrayLike, basis: npt.ArrayLike = TUBE) -> Array:
    """Return the coordinates basis log(x/REST) of concentrations x (..., 6) [mol/l, mU/l]."""
    return np.asarray(np.log(checks.floats("x", x) / REST) @ checks.floats("basis", basis).T)


def logarithmic_thyroid(
    patient: bool = True,
    *,
    basis: npt.ArrayLike = TUBE,
    w_reading: Literal["per_second", "per_day"] = "per_second",
    **changes: float,
) -> NonlinearPlant:
    """Return the loop of `thyroid` with the states basis log(x/REST).

    Raises ArgumentError as `thyroid`, or if the basis is singular.

    Parameters
    ----------
    patient, w_reading, changes
        As for `thyroid`; inputs, disturbances, outputs and noises are the same.
    basis : (6, 6) array
        Invertible. Rates are written in the coordinates, so that intervals of them are as narrow as those of the tube.

    Returns
    -------
    NonlinearPlant

    Examples
    --------
    >>> logarithmic_thyroid().n_states
    6
    """
    rows = checks.matrix("basis", basis, 6, 6)
    values, unit = constants_of(patient, w_reading, changes)
    if np.linalg.matrix_rank(rows) < 6:
        raise ArgumentError("`basis` must be invertible: each state is some product of powers of the coordinates.")
    back = np.asarray(np.linalg.inv(rows), dtype=np.float64)
    back[np.abs(back) < 1e-12] = 0.0  # a zero that is not exact would tie all coordinates together

    def dynamics(z: SX, u: SX, w: SX) -> list[SX]:
        power = powers(z, back)
        found = []
        for terms, loss in inflows(power, u, (w[0] * unit, w[1] * unit), values):
            found.append(sum(DAY * constant * term for constant, term in terms) - DAY * loss)
        return [sum(c * rate for c, rate in zip(row, found, strict=True) if c) for row in rows.tolist()]

    def measurement(z: SX, u: SX, v: SX) -> list[SX]:
        power = powers(z, back)
        return [power(*np.eye(6)[k]) + v[i] for i, k in enumerate((1, 2, 4))]

    names = tuple(f"s{k + 1}" for k in range(6))
    return loop(dynamics, measurement, patient, unit, Signals(names), {})


def powers(z: SX, back: Array) -> Callable[..., SX]:
    """The function that gives products of powers of the concentrations, each one exponential of the coordinates."""
    ca = casadi()

    def power(*exponents: float) -> SX:
        row = np.array(exponents) @ back
        scale = float(np.prod(REST ** np.array(exponents)))
        inner = [float(c) * z[k] for k, c in enumerate(row) if abs(c) > 1e-12]
        found: SX = scale * ca.exp(sum(inner[1:], inner[0]))
        return found

    return power


TUBE_LOWER = (-0.56, -0.5, -0.45, -0.46, -0.08, -0.2)
TUBE_UPPER = (0.1, 0.05, 0.16, 0.06, 0.2, 0.08)
"""The tube about the untreated patient, T4 from 13.1 to 22.7 nmol/l: the paper's x(0), its prior, their way to rest."""
LEAST_OUTPUTS = (0.0, TUBE_LOWER[1], TUBE_LOWER[2], -0.2, TUBE_LOWER[4], 0.0)
"""Where each output is least: a sample is taken to show what it shows there."""


def patient_in_tube() -> NonlinearPlant:
    """Return the untreated patient in the region for which `examples/data/thyroid_patient.json` is a theorem.

    No hormone is taken. A sample is taken to show of each output what it shows where the output is least.

    Examples
    --------
    >>> patient_in_tube().region.holds(logarithms([4.4e-13, 2.1e-8, 9.6e-10, 2.1e-9, 4.5, 4.8])).item()
    True
    """
    return logarithmic_thyroid().with_bounds(inputs=(0.0, 0.0)).in_region(TUBE_LOWER, TUBE_UPPER, about=LEAST_OUTPUTS)


THERAPY_UPPER = (0.1, 0.48, 0.16, 0.06, 0.2, 0.08)  # the upper end of the tube under therapy, T4 up to 34.9 nmol/l
DOSE = 1.5e-13  # of L-T4 absorbed at most [mol/s]: 10 micrograms a day, four fifths of the smallest tablet


def patient_under_therapy() -> NonlinearPlant:
    """Return the patient who may take L-T4, in the region for which `examples/data/thyroid_therapy.json` is a theorem.

    What is absorbed may vary between nothing and `DOSE` in any way. The first 20 days of any such course from the
    paper's x(0), and from its prior, stay within the region; the full dose, taken for 200 days, brings T4 to 33.4
    nmol/l.

    Examples
    --------
    >>> patient_under_therapy().region.holds(logarithms([6.8e-13, 3.2e-8, 1.14e-9, 3.1e-9, 3.8, 4.05])).item()
    True
    """
    plant = logarithmic_thyroid().with_bounds(inputs=(np.zeros(2), np.array([DOSE, 0.0])))
    return plant.in_region(TUBE_LOWER, THERAPY_UPPER, about=LEAST_OUTPUTS)
