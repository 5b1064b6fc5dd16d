"""Bounds on the disturbance and on the measurement noise, as the programs need them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._checks import freeze
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class SignalBounds:
    """|w(t)| <= w and |v_j| <= v_j in the Euclidean norm ("ball"), or entry by entry ("box").

    Attributes
    ----------
    w : (q,) array
        Half-widths; equal ones for a ball.
    w_ball : bool
    v : (N, p) array
        One row for each sample; infinite where an output is not measured.
    v_ball : bool
        The norm is over the outputs that a sample measures.
    """

    w: Array
    w_ball: bool
    v: Array
    v_ball: bool

    @classmethod
    def of(
        cls, plant: Plant, samples: int, mask: Mask | None, w_bound: npt.ArrayLike | None, v_bound: npt.ArrayLike | None
    ) -> SignalBounds:
        """Return the bounds as typed by a user: numbers (Euclidean), vectors (boxes), or for v one row per sample.

        Raises
        ------
        ArgumentError
            If one is missing, negative, not a number, or of another shape.
        """
        w, w_ball = _bound("w_bound", w_bound, plant.disturbances.names, None)
        v, v_ball = _bound("v_bound", v_bound, plant.outputs.names, samples)
        v = np.broadcast_to(v, (samples, plant.n_outputs)).copy()
        if mask is not None:
            v[~mask] = np.inf
        return cls(freeze(w), w_ball and w.size > 1, _read_only(v), v_ball and plant.n_outputs > 1)

    def measured(self, sample: int) -> npt.NDArray[np.intp]:
        """Outputs that a sample measures."""
        return np.flatnonzero(np.isfinite(self.v[sample]))


def _read_only(array: Array) -> Array:
    array.flags.writeable = False
    return array


def _bound(name: str, value: npt.ArrayLike | None, names: tuple[str, ...], samples: int | None) -> tuple[Array, bool]:
    if value is None:
        raise ArgumentError(
            f"`{name}` is missing: without a bound on {', '.join(names)} nothing can be guaranteed. "
            "Give 0 where there is none."
        )
    if np.ndim(value) == 0:
        return np.full(len(names), _checks.nonnegative(name, value)), True
    if samples is not None and np.ndim(value) == 2:
        array = np.array(_checks.matrix(name, value, samples, len(names)))
    else:
        array = np.array(_checks.vector(name, value, len(names)))
    if np.any(array < 0):
        raise ArgumentError(f"`{name}` must not be negative, got {float(array.min())!r}.")
    return array, False
