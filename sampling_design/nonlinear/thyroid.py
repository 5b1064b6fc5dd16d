"""The pituitary-thyroid loop of the paper's Section VI: six hormone concentrations, three of them measurable.

The paper cites its model and does not print it. Each parameter below says whether its value was found
(in public code of the same model) or reconstructed from the paper's own numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.plants.plant import Signals
from sampling_design.records import checks

if TYPE_CHECKING:
    from casadi import SX

    Dynamics = Callable[[SX, SX, SX], list[SX]]

DAY = 86400.0  # seconds in a day; every rate below is per second


@dataclass(frozen=True)
class ModelConstant:
    """A constant of the model: value, unit, and whether it was found or reconstructed."""

    value: float
    unit: str
    status: Literal["found", "reconstructed"]
    note: str = ""


_RATIO = 0.32425  # l/s: outflow of T4 over T4 in the thyroid, from the balances at rest
_K_MCT8 = 4.7e-6  # [mol/l], of the transporter into the thyroid

PARAMETERS: Mapping[str, ModelConstant] = {
    "TBG": ModelConstant(3e-7, "mol/l", "found"),
    "TBPA": ModelConstant(4.5e-6, "mol/l", "found"),
    "IBS": ModelConstant(8e-6, "mol/l", "found"),
    "K30": ModelConstant(2e9, "l/mol", "found"),
    "K31": ModelConstant(2e9, "l/mol", "found"),
    "K41": ModelConstant(2e10, "l/mol", "found"),
    "K42": ModelConstant(2e8, "l/mol", "found"),
    "TRH": ModelConstant(6.9e-9, "mol/l", "found", "constant; its daily swing is left out"),
    "G_H": ModelConstant(473.0214, "mU/s", "found", "a tabulated 817 is excluded by the paper's x(0)"),
    "D_H": ModelConstant(4.7e-8, "mol/l", "found"),
    "S_S": ModelConstant(100.0, "l/mU", "found"),
    "D_S": ModelConstant(50.0, "mU/l", "found"),
    "L_S": ModelConstant(1.6879e6, "l/mol", "found", "1.68e6 in tables"),
    "G_R": ModelConstant(1.0, "mol/s", "found"),
    "D_R": ModelConstant(1e-10, "mol/l", "found"),
    "alpha_S": ModelConstant(0.4, "1/l", "found"),
    "beta_S": ModelConstant(2.3e-4, "1/s", "found"),
    "alpha_S2": ModelConstant(2.6e5, "1/l", "found"),
    "beta_S2": ModelConstant(140.0, "1/s", "found", "the ratio to alpha_S2 is confirmed by the paper's x(0)"),
    "G_T": ModelConstant(3.375e-12, "mol/s", "found", "healthy; the patient has an eighth (reconstructed from x(0))"),
    "D_T": ModelConstant(2.75, "mU/l", "found"),
    "G_T3": ModelConstant(1.8882e-13, "mol/s", "found", "not reduced in the patient; 3.94e-13 does not fit x(0)"),
    "k_Dio": ModelConstant(1.0, "mU/l", "found"),
    "G_D1": ModelConstant(2.3527e-8, "mol/s", "found"),
    "K_M1": ModelConstant(5e-7, "mol/l", "found"),
    "G_D2": ModelConstant(4.3e-15, "mol/s", "found"),
    "K_M2": ModelConstant(1e-9, "mol/l", "found"),
    "alpha_T": ModelConstant(0.1, "1/l", "found"),
    "beta_T": ModelConstant(1.1e-6, "1/s", "found"),
    "alpha_31": ModelConstant(2.6e-2, "1/l", "found"),
    "beta_31": ModelConstant(8e-6, "1/s", "found"),
    "alpha_32": ModelConstant(1.3e5, "1/l", "found"),
    "beta_32": ModelConstant(8.3e-4, "1/s", "found"),
    "K_MCT8": ModelConstant(_K_MCT8, "mol/l", "reconstructed", "only G_MCT8/K_MCT8 acts, since T4_th is far below it"),
    "G_MCT8": ModelConstant(
        _RATIO * _K_MCT8, "mol/s", "reconstructed", "the ratio 0.32425 l/s closes the balances at rest"
    ),
    "alpha_th": ModelConstant(250.0, "1/l", "reconstructed", "weak: no data constrain it"),
    "beta_th": ModelConstant(4.4e-6, "1/s", "reconstructed", "weak: irrelevant at rest"),
}

PATIENT_SECRETION = 1 / 8
"""Share of the healthy secretory capacity G_T that the hypothyroid patient has (reconstructed)."""

SCALING = np.array([1e12, 1e7, 1e9, 1e8, 1.0, 1.0])
"""The paper's transformation z = T x; its weights and errors are meant in z."""

TRUE_START = np.array([4.4e-13, 2.1e-8, 9.6e-10, 2.1e-9, 4.5, 4.8])
PRIOR_START = np.array([7.4e-13, 1.4e-8, 4.2e-10, 9e-10, 7.7, 8.2])
PROCESS_BOUND = np.array([1e-13, 0.6])
NOISE_BOUND = np.array([5e-10, 3e-11, 0.05])

_STATES = Signals(("T4_th", "T4", "T3_p", "T3_c", "TSH", "TSH_c"), ("mol/l",) * 4 + ("mU/l",) * 2, 1 / SCALING)
_OUTPUTS = Signals(("T4", "T3_p", "TSH"), ("mol/l", "mol/l", "mU/l"), 1 / SCALING[[1, 2, 4]])
_INPUTS = Signals(("u_T4", "u_T3"), ("mol/s", "mol/s"), np.array([1e-12, 1e-13]))


def rates(x: SX, u: SX, w: SX | tuple[SX, SX], p: Mapping[str, float]) -> list[SX]:
    """Return dx/dt in 1/s: the equations, term by term; `u` = absorbed (T4, T3) [mol/s], `w` = (w1, w6) per second."""
    T4_th, T4, T3_p, T3_c, TSH, TSH_c = (x[i] for i in range(6))
    FT4 = T4 / (1 + p["K41"] * p["TBG"] + p["K42"] * p["TBPA"])
    T3_N = T3_c / (1 + p["K31"] * p["IBS"])
    T3_R = p["G_R"] * T3_N / (p["D_R"] + T3_N)
    synthesis = TSH / (TSH + p["D_T"])
    shared = T4_th * TSH / (TSH + p["k_Dio"])
    conversion = p["G_D1"] * shared / (p["K_M1"] + shared) + p["G_D2"] * shared / (p["K_M2"] + shared)
    outflow = p["G_MCT8"] * T4_th / (p["K_MCT8"] + T4_th)
    feedback = (1 + p["S_S"] * TSH_c / (TSH_c + p["D_S"])) * (1 + p["L_S"] * T3_R)
    release = p["G_H"] * p["TRH"] / ((p["TRH"] + p["D_H"]) * feedback)
    deiodination = p["G_D1"] * FT4 / (p["K_M1"] + FT4) + p["G_D2"] * FT4 / (p["K_M2"] + FT4)
    peripheral = deiodination + p["G_T3"] * synthesis + conversion + u[1]
    return [
        p["alpha_th"] * (p["G_T"] * synthesis - outflow - conversion) - p["beta_th"] * T4_th + w[0],
        p["alpha_T"] * (outflow + u[0]) - p["beta_T"] * T4,
        p["alpha_31"] * peripheral - p["beta_31"] * T3_p,
        p["alpha_32"] * p["G_D2"] * FT4 / (p["K_M2"] + FT4) - p["beta_32"] * T3_c,
        p["alpha_S"] * release - p["beta_S"] * TSH,
        p["alpha_S2"] * release - p["beta_S2"] * TSH_c + w[1],
    ]


def thyroid(
    patient: bool = True, *, w_reading: Literal["per_second", "per_day"] = "per_second", **changes: float
) -> NonlinearPlant:
    """Return the pituitary-thyroid loop with time in days.

    Raises ArgumentError if `w_reading` is another word or a parameter has another name.

    Parameters
    ----------
    patient : bool
        True: hypothyroid, an eighth of the secretory capacity; False: healthy.
    w_reading : "per_second" or "per_day"
        The paper prints bounds on w1 [mol/l] and w6 [mU/l] without a unit of time; this says which
        one they are read with.
    **changes : float
        Other values of `PARAMETERS`, for example alpha_th=3e-5.

    Returns
    -------
    NonlinearPlant
        Inputs: absorbed L-T4 and L-T3 [mol/s]. Disturbances (w1, w6) in the unit of `w_reading`, noises
        on the three outputs; all boxes as in the paper, states and outputs non-negative.

    Notes
    -----
    *Assumptions.* No dead times, constant TRH; see `PARAMETERS` for what is found and what is
    reconstructed. *Numerical aspects.* Time constants from 4 ms to 9 days.

    References
    ----------
    The paper, Section VI.

    Examples
    --------
    >>> plant = thyroid()
    >>> rest = plant.equilibrium(TRUE_START, [0.0, 0.0])
    >>> float(f"{rest[1]:.3e}")
    2.161e-08
    """
    values, unit = constants_of(patient, w_reading, changes)

    def dynamics(x: SX, u: SX, w: SX) -> list[SX]:
        return [DAY * rate for rate in rates(x, u, (w[0] * unit, w[1] * unit), values)]

    return loop(
        dynamics,
        lambda x, u, v: [x[1] + v[0], x[2] + v[1], x[4] + v[2]],
        patient,
        unit,
        _STATES,
        {"states": (0.0, np.inf)},
    )


def constants_of(
    patient: bool, w_reading: Literal["per_second", "per_day"], changes: Mapping[str, float]
) -> tuple[dict[str, float], float]:
    """Values of the parameters, and seconds per unit of time of w."""
    checks.word("w_reading", w_reading, ("per_second", "per_day"))
    checks.known_keys("the parameters of the model", changes, PARAMETERS)
    values = {key: parameter.value for key, parameter in PARAMETERS.items()}
    if patient:
        values["G_T"] *= PATIENT_SECRETION
    values.update(changes)
    unit = 1.0 if w_reading == "per_second" else 1 / DAY
    return values, unit


def loop(
    dynamics: Dynamics,
    measurement: Dynamics,
    patient: bool,
    unit: float,
    states: Signals,
    bounds: Mapping[str, tuple[float, float]],
) -> NonlinearPlant:
    """The loop with its signals and boxes."""
    return NonlinearPlant(
        dynamics,
        measurement,
        {"states": 6, "inputs": 2, "disturbances": 2, "outputs": 3, "noises": 3},
        time_unit="d",
        name="pituitary-thyroid loop" + (" (hypothyroid)" if patient else " (healthy)"),
        source="structure and constants from public implementations of the loop; what is reconstructed is marked",
        signals={
            "states": states,
            "outputs": _OUTPUTS,
            "inputs": _INPUTS,
            "disturbances": Signals(
                ("w1", "w6"), ("mol/l/s", "mU/l/s") if unit == 1 else ("mol/l/d", "mU/l/d"), PROCESS_BOUND
            ),
            "noises": Signals(("v1", "v2", "v3"), _OUTPUTS.units, NOISE_BOUND),
        },
        bounds={
            **bounds,
            "outputs": (0.0, np.inf),
            "disturbances": (-PROCESS_BOUND, PROCESS_BOUND),
            "noises": (-NOISE_BOUND, NOISE_BOUND),
        },
    )
