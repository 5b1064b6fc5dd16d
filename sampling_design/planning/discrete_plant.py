"""The plant on the grid, in coordinates in which a well measured state is of size one, whatever the units."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.linalg import schur

from sampling_design.accuracy.bounds import SignalBounds
from sampling_design.accuracy.sampled_system import periodic_system
from sampling_design.accuracy.undetectable import known_part
from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.numerics.linalg import forced_flow, right_directions
from sampling_design.planning.problem import MOST_STEPS, PlanProblem
from sampling_design.plants.clusters import eigenvalue_clusters, format_eigenvalue
from sampling_design.records.arrays import Array, Mask
from sampling_design.records.record import short
from sampling_design.records.units import spoken

CELLS = 6  # cells of constant disturbance in a gap, unless it holds several turns of an oscillation

TURN = np.pi / 4
"""Radians of the quickest oscillation in a cell, at most: a disturbance drives it on only if it turns with it."""

GOLDEN = (np.sqrt(5.0) - 1) / 2  # section of a search on one variable
SPREAD = (7, 24)  # samples of the schedule that chooses the coordinates, at least and at most
HIDDEN = 1e-9  # a direction is hidden from rows of norm one that show less than this share of it

GROWTH = 200.0
"""Logarithm of the growth beyond which nothing is followed: what has grown so much broke its tolerance long before."""

FINER = (2, 3, 4, 5, 6, 7)  # parts of a step that are tried
STAYS = 1e-6  # a mode that loses no more than this share in a period never decays


@dataclass(frozen=True, eq=False)
class DiscretePlant:
    """x = T z on the grid: z_{i+1} = F z_i + Gamma w_i, |w_i| <= 1, |H z_i| <= 1 where measured."""

    T: Array  # (n, r): fewer columns than states where the plant has parts that no sensor ever shows
    A: Array  # A, G: per unit of time, G in units of the bound on w
    G: Array
    H: Array  # (p, n): in units of the noise bounds; 0 where there is none
    # N, S, (n, q) and (p, n): G in units of the root of the noise's intensity, outputs in units of the noise's
    # deviation
    N: Array
    S: Array
    step: float
    ball: bool  # whether |w| is Euclidean
    parts: int = 1  # of each step of the grid: so many times as many cells of w
    _flows: dict[float, Array] = field(default_factory=dict, init=False)
    _gaps: dict[float, tuple[Array, Array, Array]] = field(default_factory=dict, init=False)
    _grids: dict[object, tuple[Array, Array, float]] = field(default_factory=dict, init=False)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    @cached_property
    def longest(self) -> int:
        """Steps without a sample that are followed: e^GROWTH at most."""
        rate = float(np.max(np.linalg.eigvals(self.A).real, initial=0.0)) * self.step
        return max(1, int(min(GROWTH / rate, MOST_STEPS))) if rate > 0 else MOST_STEPS

    def finer(self, parts: int) -> DiscretePlant:
        """The same in steps of which so many are one."""
        return replace(self, step=self.step / parts, parts=self.parts * parts)

    @cached_property
    def _turned(self) -> float:
        """Radians by which the quickest oscillation turns in a step."""
        return float(np.max(np.abs(np.linalg.eigvals(self.A).imag), initial=0.0)) * self.step

    def rows(self, rows: Array) -> Array:
        """Rows of x as rows of z."""
        return np.asarray(rows @ self.T)

    @property
    def F(self) -> Array:
        """Of one step."""
        return self.flow(1)[:, : self.n]

    @property
    def Gamma(self) -> Array:
        """Of one step."""
        return self.flow(1)[:, self.n :]

    def flow(self, steps: float) -> Array:
        """[F, Gamma] of so many steps, or a part of one, with constant w."""
        if steps not in self._flows:
            self._flows[steps] = np.asarray(forced_flow(self.A, self.G, [steps * self.step])[0])
        return self._flows[steps]

    def gap(self, steps: float) -> tuple[Array, Array, Array]:
        """F of a gap, Gamma (n, m q) of its cells, and the steps of each cell, in order of time."""
        if steps not in self._gaps:
            self._gaps[steps] = self._cut(steps)
        return self._gaps[steps]

    def over(self, rows: Array, steps: int) -> tuple[Array, Array, float]:
        """Rows of z at each of so many steps as rows of z at the first, of norm one; F over all of them, and a scale.

        That is F over e^scale: only directions are asked for, and growth may overflow.
        """
        key = rows.tobytes(), steps
        if key not in self._grids:
            found, power, log = np.empty((steps, *rows.shape)), np.eye(self.n), 0.0
            for i in range(steps):
                found[i] = rows @ power
                power = self.F @ power
                size = max(float(np.abs(power).max()), np.finfo(float).tiny)
                power, log = power / size, log + float(np.log(size))
            self._grids[key] = _even(found), power, log
        return self._grids[key]

    def _cut(self, steps: float) -> tuple[Array, Array, Array]:
        number = min(self.parts * max(CELLS, int(np.ceil(steps * self._turned / TURN))), int(np.ceil(steps)))
        edges = np.linspace(0, steps, number + 1)
        n, cells = self.n, np.diff(np.round(edges) if steps % 1 == 0 else edges)
        F, blocks = np.eye(n), []
        for width in reversed(cells.tolist()):
            joint = self.flow(width)
            blocks.append(F @ joint[:, n:])
            F = F @ joint[:, :n]
        return F, np.hstack(blocks[::-1]) if blocks else np.zeros((n, 0)), cells


@dataclass(frozen=True, eq=False)
class UndetectedModes:
    """Trajectories that do not decay and that a choice never sees."""

    where: Mask  # (M, p): where they show: any choice that measures nowhere on the mask hides them, too
    states: Array  # (n, k): z at step 0 of such trajectories, orthonormal


def hidden_at(
    discrete: DiscretePlant, chosen: Mask, rows: Array, always: Mask, outputs: Array | None = None
) -> UndetectedModes | None:
    """Return the trajectories that do not decay and that a choice never sees.

    None if there are none, or if they are hidden at all times, not only at those of the grid, and of no account to
    the rows of z, at any time to those that are `always` wanted; whether another sensor would show them is nothing
    to these rows. `outputs`: those of z that are read, default H.
    """
    outputs_at, power, log = discrete.over(discrete.H if outputs is None else outputs, len(chosen))
    moved, _, _ = discrete.over(rows, len(chosen))
    stays = (1 - STAYS) * np.exp(-max(log, -700.0))
    later = [outputs_at[chosen]]
    for _ in range(discrete.n - 1):
        later.append(_even(later[-1] @ power))
    sizes, right = right_directions(np.vstack([np.zeros((discrete.n, discrete.n)), *later]))
    N = right[sizes <= HIDDEN * max(float(sizes[0]), 1.0)].T
    if not N.shape[1]:
        return None
    _, Z, stay = schur(N.T @ power @ N, output="real", sort=lambda re, im: bool(np.hypot(re, im) >= stays))
    N = N @ Z[:, :stay]
    where = np.asarray(np.linalg.norm(outputs_at @ N, axis=2) > HIDDEN)
    reached = np.vstack([moved.reshape(-1, discrete.n), *_derivatives(discrete.A, rows[always])])
    moved_on = discrete.A @ N  # where it is hidden at samples only, what nobody knows differs from time to time
    turns = float(np.linalg.norm(moved_on - N @ (N.T @ moved_on))) > HIDDEN * float(np.linalg.norm(discrete.A))
    matters = turns or float(np.abs(reached @ N).max(initial=0.0)) > HIDDEN
    return UndetectedModes(where, N) if stay and matters else None


def _derivatives(A: Array, rows: Array) -> list[Array]:
    """Directions of rows A^k: what none of them sees, no row sees at any time."""
    found = [_even(rows)]
    for _ in range(len(A) - 1):
        found.append(_even(found[-1] @ A))
    return found


def _even(rows: Array) -> Array:
    """Rows of norm one, or zero."""
    size = np.linalg.norm(rows, axis=-1, keepdims=True)
    return np.asarray(rows / np.where(size > 0, size, 1.0))


def discretize(problem: PlanProblem) -> DiscretePlant:
    """Return the plant of a problem on its grid; coordinates from a spread-out schedule with every sensor.

    Raises ArgumentError if a mode grows so much in a step of the grid that no sample helps; InfeasibleRequirementError
    if a goal depends on what no sensor ever shows.
    """
    plant = problem.plant
    fastest = max(np.linalg.eigvals(plant.A).tolist(), key=lambda value: value.real)
    if fastest.real * problem.step > GROWTH / 2:
        raise ArgumentError(
            f"`grid` is too coarse: from one of its steps to the next (here {spoken(problem.step, plant.time_unit)}) "
            f"the mode {format_eigenvalue(fastest)} grows by e^{fastest.real * problem.step:.3g}, so that a sample "
            f"says nothing of the next step; take at most {short(GROWTH / 8 / fastest.real)} {plant.time_unit}."
        )
    count = int(np.clip(problem.steps, *SPREAD))
    count = int(max(count, np.ceil(max(fastest.real, 0.0) * problem.period / (GROWTH / 2))))
    gaps = 1 + np.arange(count) * GOLDEN % 1.0  # uneven: no mode is missed by its period
    gaps *= problem.period / gaps.sum()
    guarantees = any(not goal.stochastic for goal in problem.goals)
    sizes = problem.v_bound if guarantees else problem.v_deviation
    bound_on_w = problem.requirement.w_bound if guarantees else np.sqrt(problem.w_intensity)
    measured = [np.flatnonzero(np.isfinite(np.minimum(problem.v_bound, problem.v_deviation)))] * count
    known = known_part(plant, np.cumsum(gaps) - gaps[0], problem.period, measured)
    for goal in problem.goals:
        if known.touches(goal.row):
            raise InfeasibleRequirementError(
                f"No sensor ever shows {', '.join(known.modes)}, on which {goal.name} depends and which never decays: "
                "no plan can keep its tolerance. Add a sensor, or a `noise_bound` to one that has none.",
                "accuracy",
            )
    noise = np.where(np.isfinite(sizes), sizes, np.minimum(problem.v_bound, problem.v_deviation))
    read = np.isfinite(noise)
    bounds = SignalBounds.of(known.plant, count, np.tile(read, (count, 1)), bound_on_w, np.where(read, noise, 1.0))
    system = periodic_system(known.plant, gaps, bounds)
    own = system.D[:, None] * system.L[0]
    C = known.plant.C @ own
    A = np.linalg.solve(own, known.plant.A @ own)
    G = np.linalg.solve(own, known.plant.G * bounds.w)
    T = known.lift @ own
    return DiscretePlant(
        T,
        np.asarray(A),
        np.asarray(G),
        np.asarray(C / problem.v_bound[:, None]),
        np.asarray(np.linalg.solve(own, known.plant.G * np.sqrt(problem.w_intensity))),
        np.asarray(C / problem.v_deviation[:, None]),
        problem.step,
        bool(bounds.w_ball),
    )


def modes_of(discrete: DiscretePlant, undetected: UndetectedModes) -> str:
    """Return the modes that hidden trajectories are made of, in words."""
    names = []
    scale = max(float(np.linalg.norm(discrete.A, 2)), np.finfo(float).tiny)
    clusters = eigenvalue_clusters(discrete.A)
    for cluster in clusters:
        value = complex(cluster.value)
        others = [complex(c.value) for c in clusters if c is not cluster]
        part = undetected.states.astype(np.complex128)
        for other in others:  # what is left after every other mode is taken out, as often as it may be repeated
            for _ in range(discrete.n - len(others)):
                part = (discrete.A - other * np.eye(discrete.n)) @ part / (scale + abs(other))
        if np.linalg.norm(part) > HIDDEN and value.imag >= 0:
            names.append(format_eigenvalue(value, grain=STAYS / discrete.step))
    return f"a trajectory of the mode{'s' if len(names) > 1 else ''} {', '.join(names)}" if names else "a trajectory"


def finer_grid(problem: PlanProblem, discrete: DiscretePlant, rows: Array) -> float | None:
    """Return a grid that shows all that never decays, in the hours that there are; None if none was found."""
    always = np.array([goal.at == "all times" for goal in problem.goals], dtype=bool)
    for parts in FINER:
        if problem.steps * parts > MOST_STEPS:
            break
        finer = discrete.finer(parts)
        allowed = np.repeat(problem.allowed, parts, axis=0)
        if hidden_at(finer, allowed, rows, always) is None:
            return problem.step / parts
    return None
