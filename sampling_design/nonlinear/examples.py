"""Nonlinear plants from the literature, each with a region in which certificates are asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sampling_design.nonlinear.functions import casadi
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.plants.plant import Signals
from sampling_design.records import checks

if TYPE_CHECKING:
    from casadi import SX

_ONE_NOISE = {"disturbances": 1, "outputs": 1}


def pendulum(stiffness: float = 1.0, largest_angle: float | None = None) -> NonlinearPlant:
    """Return the pendulum x1' = x2, x2' = -stiffness sin(x1) + w, its angle measured; by default at all angles.

    Examples
    --------
    >>> pendulum().centre.A.tolist()
    [[0.0, 1.0], [-1.0, 0.0]]
    """
    ca = casadi()
    plant = NonlinearPlant(
        lambda x, u, w: [x[1], -stiffness * ca.sin(x[0]) + w[0]],
        lambda x, u, v: [x[0] + v[0]],
        {"states": 2, **_ONE_NOISE},
        name="pendulum",
    )
    most = np.inf if largest_angle is None else float(largest_angle)
    return plant.in_region([-most, -np.inf], [most, np.inf])


def van_der_pol(coordinates: str = "lienard", largest: float = 2.1, damping: float = 1.0) -> NonlinearPlant:
    """Return van der Pol's oscillator, x measured, in the coordinates of Lienard or in (x, x').

        lienard:   x1' = x2 - damping (x1^3/3 - x1),    x2' = -x1 + w
        velocity:  x1' = x2,    x2' = damping (1 - x1^2) x2 - x1 + w

    Raises ArgumentError if the coordinates are others.

    Parameters
    ----------
    coordinates : "lienard" or "velocity"
        In Lienard's the Jacobian has one entry that moves, and it is on the diagonal that is measured.
    largest : float
        Of |x1| in the region; |x2| is at most 3 in the coordinates (x, x').
    damping : float
    """
    checks.word("coordinates", coordinates, ("lienard", "velocity"))
    lienard = coordinates == "lienard"

    def dynamics(x: SX, u: SX, w: SX) -> list[SX]:
        if lienard:
            return [x[1] - damping * (x[0] ** 3 / 3 - x[0]), -x[0] + w[0]]
        return [x[1], damping * (1 - x[0] ** 2) * x[1] - x[0] + w[0]]

    plant = NonlinearPlant(
        dynamics, lambda x, u, v: [x[0] + v[0]], {"states": 2, **_ONE_NOISE}, name=f"van der Pol ({coordinates})"
    )
    side = [largest, np.inf if lienard else 3.0]
    return plant.in_region(np.negative(side), side)


def stirred_reactor(spread: float = 5.0, concentration: float = 0.05) -> NonlinearPlant:
    """Return the stirred reactor A -> B with a cooling jacket, its temperature measured, within `spread` K of 350 K.

    Concentration within `concentration` of 0.5 mol/l; unstable at its operating point (0.5, 350), time in minutes.
    """
    ca = casadi()
    flow, volume, feed, warm = 100.0, 100.0, 1.0, 350.0
    speed, energy, heat, capacity, transfer, cold = 7.2e10, 8750.0, 5e4, 239.0, 5e4, 300.0

    def dynamics(x: SX, u: SX, w: SX) -> list[SX]:
        rate = speed * ca.exp(-energy / x[1]) * x[0]
        cooled = transfer / (volume * capacity) * (cold - x[1])
        return [
            flow / volume * (feed - x[0]) - rate + w[0],
            flow / volume * (warm - x[1]) + heat / capacity * rate + cooled + w[1],
        ]

    plant = NonlinearPlant(
        dynamics,
        lambda x, u, v: [x[1] + v[0]],
        {"states": 2, "disturbances": 2, "outputs": 1},
        time_unit="min",
        name="stirred reactor",
        signals={
            "states": Signals(("c", "T"), ("mol/l", "K"), [0.1, 5.0]),
            "outputs": Signals(("T",), ("K",), [5.0]),
            "disturbances": Signals(("w_c", "w_T"), ("mol/l/min", "K/min"), [0.1, 5.0]),
            "noises": Signals(("v",), ("K",), [5.0]),
        },
    )
    low, high = (np.array([0.5, 350.0]) + sign * np.array([concentration, spread]) for sign in (-1, 1))
    return plant.in_region(low, high)


def batch_reactor() -> NonlinearPlant:
    """Return the batch reactor 2A <-> B, total pressure measured: x1' = -2 k1 x1^2 + 2 k2 x2, x2' = k1 x1^2 - k2 x2."""

    def dynamics(x: SX, u: SX, w: SX) -> list[SX]:
        rate = 0.16 * x[0] ** 2 - 0.0064 * x[1]
        return [-2 * rate + w[0], rate + w[1]]

    plant = NonlinearPlant(
        dynamics,
        lambda x, u, v: [x[0] + x[1] + v[0]],
        {"states": 2, "disturbances": 2, "outputs": 1},
        time_unit="min",
        name="batch reactor",
    )
    return plant.in_region([0.1, 0.0], [3.0, 4.5], [[1.0, 2.0]], [9.0])


def quadruple_tank() -> NonlinearPlant:
    """Return four coupled tanks, the levels [cm] of the lower two measured, each between 2 and 20 cm."""
    ca = casadi()
    area, hole, gravity = (28.0, 32.0, 28.0, 32.0), (0.071, 0.057, 0.071, 0.057), 981.0

    def dynamics(x: SX, u: SX, w: SX) -> list[SX]:
        out = [hole[k] * ca.sqrt(2 * gravity * x[k]) for k in range(4)]
        return [
            (-out[0] + out[2] + 0.7 * u[0]) / area[0] + w[0],
            (-out[1] + out[3] + 0.6 * u[1]) / area[1] + w[1],
            (-out[2] + 0.4 * u[1]) / area[2] + w[2],
            (-out[3] + 0.3 * u[0]) / area[3] + w[3],
        ]

    plant = NonlinearPlant(
        dynamics,
        lambda x, u, v: [x[0] + v[0], x[1] + v[1]],
        {"states": 4, "inputs": 2, "disturbances": 4, "outputs": 2},
        name="quadruple tank",
    )
    return plant.in_region([2.0] * 4, [20.0] * 4)


def bioreactor() -> NonlinearPlant:
    """Return a bioreactor whose growth rate is not known: Monod growth, biomass and substrate measured, time in hours.

        b' = mu s/(.5 + s) b - .1 b,    s' = -2 mu s/(.5 + s) b + .1 (20 - s),    mu' = w_mu

    Biomass b within 9 to 10 g/l, substrate s within .4 to .7 g/l, mu (it stands still) within .25 to .35 per h.
    """

    def dynamics(x: SX, u: SX, w: SX) -> list[SX]:
        growth = x[2] * x[1] / (0.5 + x[1]) * x[0]
        return [growth - 0.1 * x[0] + w[0], -2 * growth + 0.1 * (20.0 - x[1]) + w[1], w[2]]

    plant = NonlinearPlant(
        dynamics,
        lambda x, u, v: [x[0] + v[0], x[1] + v[1]],
        {"states": 3, "disturbances": 3, "outputs": 2},
        time_unit="h",
        name="bioreactor",
        signals={
            "states": Signals(("b", "s", "mu"), ("g/l", "g/l", "1/h"), [1.0, 0.2, 0.05]),
            "outputs": Signals(("b", "s"), ("g/l", "g/l"), [1.0, 0.2]),
            "disturbances": Signals(("w_b", "w_s", "w_mu"), (), [0.1, 0.1, 0.01]),
        },
    )
    return plant.in_region([9.0, 0.4, 0.25], [10.0, 0.7, 0.35])


def unicycle(heading: float = 0.5) -> NonlinearPlant:
    """Return a unicycle that drives at .8 to 1.2 m/s, its ranges to three beacons measured.

    Position within 1 m of the origin, heading within `heading` rad of the first axis, beacons 5 m away; speed and
    turning rate are inputs.
    """
    ca = casadi()
    beacons = ((5.0, 0.0), (-2.5, 4.33), (-2.5, -4.33))
    plant = NonlinearPlant(
        lambda x, u, w: [u[0] * ca.cos(x[2]) + w[0], u[0] * ca.sin(x[2]) + w[1], u[1] + w[2]],
        lambda x, u, v: [ca.sqrt((x[0] - a) ** 2 + (x[1] - b) ** 2) + v[k] for k, (a, b) in enumerate(beacons)],
        {"states": 3, "inputs": 2, "disturbances": 3, "outputs": 3},
        name="unicycle",
        bounds={"inputs": ([0.8, -1.0], [1.2, 1.0])},
    )
    return plant.in_region([-1.0, -1.0, -heading], [1.0, 1.0, heading])
