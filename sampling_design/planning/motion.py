"""The plant on the raster, in coordinates in which a well measured state is of size one, whatever the units."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.linalg import schur

from sampling_design._linalg import expm_batch
from sampling_design.planning.problem import PlanProblem
from sampling_design.recovery.bounds import SignalBounds
from sampling_design.recovery.chain import endless_chain

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

CELLS = 6
"""Cells of constant disturbance in a gap, at most."""

SPREAD = (7, 24)
"""Samples of the even schedule that chooses the coordinates, at least and at most."""


HIDDEN = 1e-9
"""A direction is hidden from rows of norm one that show less than this share of it."""

STAYS = 1e-6
"""A mode that loses no more than this share in a period never fades."""


@dataclass(frozen=True, eq=False)
class Motion:
    """z = T^-1 x on the raster: z_{i+1} = F z_i + Gamma w_i, |w_i| <= 1, |H z_i| <= 1 where measured.

    Attributes
    ----------
    T : (n, n) array
    A, G : arrays
        Per unit of time, G in units of the bound on w.
    H : (p, n) array
        In units of the noise bounds.
    step : float
    ball : bool
        Whether |w| is Euclidean.
    """

    T: Array
    A: Array
    G: Array
    H: Array
    step: float
    ball: bool
    _flows: dict[int, Array] = field(default_factory=dict)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    def rows(self, rows: Array) -> Array:
        """Rows of x as rows of z."""
        return np.asarray(rows @ self.T)

    @cached_property
    def _unit(self) -> Array:
        """[F, Gamma] of one step."""
        return self._joint(self.step)

    def _joint(self, length: float) -> Array:
        n, q = self.G.shape
        joint = np.zeros((n + q, n + q))
        joint[:n, :n], joint[:n, n:] = self.A, self.G
        return np.asarray(expm_batch(joint, [length])[0, :n])

    @property
    def F(self) -> Array:
        """Of one step."""
        return self._unit[:, : self.n]

    @property
    def Gamma(self) -> Array:
        """Of one step."""
        return self._unit[:, self.n :]

    def flow(self, steps: int) -> Array:
        """[F, Gamma] of so many steps with constant w."""
        if steps not in self._flows:
            self._flows[steps] = self._joint(steps * self.step)
        return self._flows[steps]

    def gap(self, steps: int) -> tuple[Array, Array, list[int]]:
        """F of a gap, Gamma (n, m q) of its cells, and the steps of each cell, in order of time."""
        number = min(CELLS, steps)
        edges = np.round(np.linspace(0, steps, number + 1)).astype(int)
        n, cells = self.n, np.diff(edges).tolist()
        F, blocks = np.eye(n), []
        for width in reversed(cells):
            joint = self.flow(width)
            blocks.append(F @ joint[:, n:])
            F = F @ joint[:, :n]
        return F, np.hstack(blocks[::-1]) if blocks else np.zeros((n, 0)), cells


def hidden_at(motion: Motion, chosen: Mask, allowed: Mask, rows: Array) -> Mask | None:
    """Return where a choice would have to measure, too, to see a motion that does not fade and that it never sees.

    Any choice that measures nowhere on the mask hides the same motion. None if every such motion is seen, or hidden
    wherever measuring is allowed and of no account to the rows of z.
    """
    steps, p = chosen.shape
    seen = np.empty((steps, p, motion.n))
    moved = np.empty((steps, len(rows), motion.n))
    power, log = np.eye(motion.n), 0.0  # F^i over e^log: only directions are asked for, and growth may overflow
    for i in range(steps):
        seen[i], moved[i] = _even(motion.H @ power), _even(rows @ power)
        power = motion.F @ power
        size = max(float(np.abs(power).max()), np.finfo(float).tiny)
        power, log = power / size, log + float(np.log(size))
    stays = (1 - STAYS) * np.exp(-max(log, -700.0))
    later = [seen[chosen]]
    for _ in range(motion.n - 1):
        later.append(_even(later[-1] @ power))
    _, sizes, right = np.linalg.svd(np.vstack([np.zeros((motion.n, motion.n)), *later]))
    N = right[sizes <= HIDDEN * max(float(sizes[0]), 1.0)].T
    if not N.shape[1]:
        return None
    _, Z, stay = schur(N.T @ power @ N, output="real", sort=lambda re, im: bool(np.hypot(re, im) >= stays))
    N = N @ Z[:, :stay]
    where = np.asarray(np.linalg.norm(seen @ N, axis=2) > HIDDEN)
    matters = bool(np.any(where & allowed)) or float(np.abs(moved @ N).max(initial=0.0)) > HIDDEN
    return where if stay and matters else None


def _even(rows: Array) -> Array:
    """Rows of norm one, or zero."""
    size = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.asarray(rows / np.where(size > 0, size, 1.0))


def motion_of(problem: PlanProblem) -> Motion:
    """Return the plant of a problem on its raster; coordinates from an even schedule with every sensor."""
    plant = problem.plant
    w_bound = problem.requirement.w_bound
    q, p = plant.n_disturbances, plant.n_outputs
    count = int(np.clip(problem.steps, *SPREAD))
    bounded = np.where(np.isfinite(problem.v_bound), problem.v_bound, np.inf)
    bounds = SignalBounds.of(plant, count, np.tile(np.isfinite(bounded), (count, 1)), w_bound, _finite(bounded))
    chain = endless_chain(plant, np.full(count, problem.period / count), bounds)
    T = chain.D[:, None] * chain.L[0]
    H = plant.C @ T / np.where(np.isfinite(bounded) & (bounded > 0), bounded, 1.0)[:, None]
    stand_in = np.zeros(p)
    for sample in chain.samples:
        stand_in[sample.outputs] = sample.size
    exact = (bounded == 0) & (stand_in > 0)
    H[exact] = plant.C[exact] @ T / stand_in[exact, None]
    A = np.linalg.solve(T, plant.A @ T)
    G = np.linalg.solve(T, plant.G * bounds.w)
    assert G.shape[1] == q
    return Motion(T, np.asarray(A), np.asarray(G), np.asarray(H), problem.step, bool(bounds.w_ball))


def _finite(bounds: Array) -> Array:
    """Noise bounds with a number where a sensor has none; such a sensor is masked out."""
    return np.where(np.isfinite(bounds), bounds, 1.0)
