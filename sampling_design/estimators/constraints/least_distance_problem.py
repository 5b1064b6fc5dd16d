"""The least-distance problem that constraints leave to do, whole or for some of its rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sampling_design.estimators.constraints.constrained_signals import ConstrainedSignal, ConstraintRows, rows_of
from sampling_design.estimators.window.window_estimate import EstimateDeviations
from sampling_design.records.arrays import Array, Mask

Cone = tuple[Array, Array, float]
"""M, c, r of |M z + c| <= r."""


@dataclass(frozen=True, eq=False)
class LeastDistance:
    """min |z|^2 subject to lower <= A z <= upper and |M_i z + c_i| <= r_i: what the constraints leave to do.

    Rows have unit norm: bounds count in posterior standard deviations; `scales` turn slack back into the signal's
    unit. `blocks` and `cone_owners` remember which signal and place each row or cone belongs to.
    """

    size: int
    A: Array
    lower: Array
    upper: Array
    cones: list[Cone]
    scales: Array
    blocks: list[ConstraintRows]
    cone_owners: list[tuple[ConstrainedSignal, int]]

    def row_label(self, index: int, below: bool) -> str:
        """Say in words what row `index` asks, of its lower bound where `below`."""
        ends = np.cumsum([block.places.size for block in self.blocks])
        k = int(np.searchsorted(ends, index, side="right"))
        block = self.blocks[k]
        return block.label(index - int(ends[k]) + block.places.size, below)

    def cone_label(self, index: int) -> str:
        """Say in words what cone `index` asks."""
        signal, place = self.cone_owners[index]
        return f"a ball of {signal.name} at t = {signal.times[place]:.6g}"


class ConstraintDemands:
    """What the constraints ask of all trajectories around the minimiser without them.

    x = x* + T z for the smoother's `spread` T; where signals have noise of their own, z has that after it.
    """

    def __init__(self, spread: EstimateDeviations, signals: Sequence[ConstrainedSignal], nodes: int, n: int):
        self.spread, self.signals = spread, signals
        self.rows = [rows for signal in signals for rows in rows_of(signal)]
        noisy = [signal.own.shape[::2] for signal in signals if signal.own is not None]
        self.states, self.noise_shape = nodes * n, noisy[0] if noisy else (0, 0)
        self.size = self.states + self.noise_shape[0] * self.noise_shape[1]

    def values(self, z: Array | None = None) -> list[Array]:
        """Return the signals at a point (default: at the minimiser without constraints)."""
        if z is None:
            return [signal.base for signal in self.signals]
        dx, noise = self.spread.states(z[: self.states]), z[self.states :].reshape(self.noise_shape)
        return [signal.values(dx, noise) for signal in self.signals]

    def violated(self, values: list[Array], tolerance: float) -> list[Mask]:
        """Return, per block of rows, those that `values` break by more than `tolerance` times their entries' sizes."""
        by_signal, found = dict(zip(self.signals, values, strict=True)), []
        for rows in self.rows:
            value = by_signal[rows.signal]
            value_there, limit = rows.of(value), tolerance * rows.reach(rows.signal.sizes(value))
            found.append((rows.lower - value_there > limit) | (value_there - rows.upper > limit))
        return found

    def balls_hold(self, values: list[Array], tolerance: float) -> bool:
        """Whether `values` keep all balls, up to `tolerance` times the signal's size."""
        return all(s.keeps_balls(value, tolerance) for s, value in zip(self.signals, values, strict=True))

    @property
    def has_balls(self) -> bool:
        """Whether there are norm balls."""
        return any(chosen.round_balls for signal in self.signals if not signal.boxed for chosen in signal.sets)

    def pose(self, chosen: list[Mask] | None = None) -> LeastDistance:
        """Return the whole problem, or that of the rows `chosen` per block, without balls."""
        blocks = self.rows
        if chosen is not None:
            blocks = [rows.only(mask) for rows, mask in zip(self.rows, chosen, strict=True) if mask.any()]
        cones = self._cones() if chosen is None else []
        parts = [self._gradients(rows) for rows in blocks]
        A = np.concatenate([np.zeros((0, self.size)), *parts]) if len(parts) != 1 else parts[0]
        base, lower, upper = np.zeros((3, A.shape[0]))
        if blocks:
            base = np.concatenate([rows.of(rows.signal.base) for rows in blocks])
            lower, upper = (np.concatenate([getattr(rows, side) for rows in blocks]) for side in ("lower", "upper"))
        norms = np.sqrt(np.einsum("ij,ij->i", A, A))
        scales = np.where(norms > 0, norms, 1.0)
        lower, upper = (lower - base) / scales, (upper - base) / scales
        return LeastDistance(
            self.size,
            A / scales[:, None],
            lower,
            upper,
            [cone for cone, _ in cones],
            scales,
            blocks,
            [of for _, of in cones],
        )

    def _gradients(self, rows: ConstraintRows) -> Array:
        """The rows over z: those over the states times T, those over the noise as they are."""
        found = rows.gradients(self.states, self.size)
        if self.size == self.states:
            return self.spread.rows(found)
        found[:, : self.states] = self.spread.rows(found[:, : self.states])
        return found

    def _cones(self) -> list[tuple[Cone, tuple[ConstrainedSignal, int]]]:
        """The balls as cones over z, with the signal and the place of each."""
        cones: list[tuple[Cone, tuple[ConstrainedSignal, int]]] = []
        for signal in self.signals:
            sets = () if signal.boxed else signal.groups()
            balls = [(ball, k) for chosen, at in sets for ball in chosen.round_balls for k in at.tolist()]
            if not balls:
                continue
            sizes = [len(ball.shape) for ball, _ in balls]
            places = np.repeat([k for _, k in balls], sizes)
            none, mix = np.zeros(places.size), np.vstack([ball.shape for ball, _ in balls])
            over = self._gradients(ConstraintRows(signal, places, places, none, none, mix))
            for (ball, k), M in zip(balls, np.split(over, np.cumsum(sizes)[:-1]), strict=True):
                cones.append(((M, ball.shape @ (signal.base[k] - ball.centre), ball.radius), (signal, k)))
        return cones
