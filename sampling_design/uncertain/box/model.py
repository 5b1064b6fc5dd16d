"""A box of constant parameters as arrays, in balanced coordinates of the scaled plant."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.numerics.balancing import balance
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Integers
from sampling_design.records.record import short
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant


@dataclass(frozen=True, eq=False)
class BoxModel:
    """A(theta) = A + sum_k (theta_k - nominal_k) A_k, likewise C, for low <= theta <= high; states x/s_x = unit z."""

    plant: UncertainPlant
    A: Array  # (n, n)
    C: Array  # (p, n)
    parts_A: Array  # (m, n, n)
    # (m, p, n): what a change of a parameter by its own half-width adds; parameters that move neither are left out
    parts_C: Array
    nominal: Array  # nominal, half, (m,): in the parameters' own units; theta = middle + half u with |u| <= 1
    middle: Array  # (m,)
    half: Array
    unit: Array  # (n,): the states of which z are the multiples
    states: Array  # states, outputs, (n,), (p,): what the plant's own states and outputs are multiples of: their scales
    outputs: Array
    place: Integers  # (m,): which parameters of the plant these are

    @classmethod
    def of(cls, plant: UncertainPlant, name: str, span: float) -> BoxModel:
        """The box of a plant; `name` is the verb that asks, for its refusals, `span` the time over which it asks.

        Raises ArgumentError if the plant lies between vertices, or its parameters vary.
        """
        require_constant_box(plant, name)
        P = plant.nominal
        A, C, each = plant.moves("A"), plant.moves("C"), plant.parameters
        own = [k for k in range(len(each)) if each[k].low < each[k].high and (A[k].any() or C[k].any())]
        x, y = P.states.scales, P.outputs.scales
        low, high = plant.low[own], plant.high[own]
        half, middle = high / 2 - low / 2, low / 2 + high / 2
        # of chains alone only time says how fast they are
        d = balance(P.A * (span or 1.0) * x / x[:, None], P.C * x / y[:, None]).d
        to_z, rows = x * d, y[:, None]
        parts_A = np.array([A[k] for k in own]).reshape(len(own), *P.A.shape)
        parts_C = np.array([C[k] for k in own]).reshape(len(own), *P.C.shape)
        return cls(
            plant=plant, A=P.A * to_z / to_z[:, None], C=P.C * to_z / rows,
            parts_A=half[:, None, None] * parts_A * to_z / to_z[:, None],
            parts_C=half[:, None, None] * parts_C * to_z / rows,
            nominal=np.array([each[k].nominal for k in own]), middle=middle, half=half, unit=d,
            states=x, outputs=y, place=np.array(own, dtype=int),
        )  # fmt: skip

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def m(self) -> int:
        """Number of parameters that matter."""
        return len(self.half)

    @property
    def start(self) -> Array:
        """u of the nominal values."""
        return (self.nominal - self.middle) / self.half if self.m else np.zeros(0)

    def at(self, u: Array) -> tuple[Array, Array]:
        """A and C, (K, n, n) and (K, p, n), at u (K, m)."""
        move = u - self.start
        return self.A + np.tensordot(move, self.parts_A, 1), self.C + np.tensordot(move, self.parts_C, 1)

    def balanced_at(self, u: Array) -> Plant:
        """The plant at one u in balanced coordinates z."""
        A, C = self.at(u[None])
        return Plant(A[0], C[0])

    def values(self, u: Array) -> dict[str, float]:
        """The parameters at one u, all of the plant's by name, inside of their ranges."""
        found = {each.name: each.nominal for each in self.plant.parameters}
        for k, value in zip(self.place.tolist(), (self.middle + self.half * u).tolist(), strict=True):
            each = self.plant.parameters[k]
            found[each.name] = float(np.clip(value, each.low, each.high))
        return found


def at_parameters(values: Mapping[str, float]) -> str:
    """The parameters in words, such as "omega^2 = 1.21"."""
    return ", ".join(f"{name} = {short(value)}" for name, value in values.items()) or "the nominal plant"


def require_constant_box(plant: UncertainPlant, name: str) -> None:
    """Raise where a question about each plant of a box has no meaning.

    Raises ArgumentError if the plant lies between vertices, or its parameters vary.
    """
    if plant.vertices:
        raise ArgumentError(
            f"`plant` must have parameters in a box for {name}, got one between vertices. "
            "Ask about each vertex, or use UncertainPlant.from_intervals."
        )
    if plant.varying:
        raise ArgumentError(
            f"`plant` must have constant parameters for {name}, got ones that vary in time. "
            "Use varying=False, or certify, which holds for varying ones."
        )
