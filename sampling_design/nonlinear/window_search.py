"""From one window's data to its solution: warm start, second chances, other starts, and a finer grid where needed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sampling_design.nonlinear.collocation import Collocation, WindowSolver
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.nlp import WindowProgram
from sampling_design.nonlinear.region import StateRegion
from sampling_design.nonlinear.simulation import Integrator
from sampling_design.nonlinear.weights import NonlinearWeights
from sampling_design.nonlinear.window_forms import (
    ProgramPoint,
    WindowCovariances,
    WindowData,
    WindowSlopes,
    WindowSolution,
    window_covariances,
)
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import processor_seconds

SAME_NODE = 1e-9  # two nodes closer than this share of the window are one


def open_loop_guess(edges: Array, states: Array, points: Array, sizes: tuple[int, int, int]) -> WindowSolution:
    """Return w = 0, v = 0 and the trajectory through the scaled `states` at the edges; sizes of w, v and y."""
    K, n, degree = edges.size - 1, states.shape[1], points.size
    q, r, p = sizes
    zero = ProgramPoint(np.zeros(n), np.zeros((K + 1, r)), np.zeros((K, q)), np.zeros((K, degree, n)))
    point = zero._replace(z0=states[0], z=_at(edges, states, _collocation_times(edges, points)))
    rows, outputs = np.zeros((K, degree * n)), np.zeros((K + 1, p))
    return WindowSolution(
        edges=edges,
        point=point,
        bound_multipliers=zero,
        row_multipliers=rows,
        output_multipliers=outputs,
        cost=np.nan,
        status="solver failed",
        message="not solved",
        iterations=0,
        seconds=0.0,
    )


def moved(previous: WindowSolution, guess: WindowSolution, points: Array, before: Array) -> WindowSolution:
    """Return `guess` with all that `previous` knows about the times they share, multipliers included.

    Beyond the end of `previous` the guess is kept. `points` are the collocation points of the guess, `before` those of
    `previous`; where they differ, the multipliers of the intervals are left out.
    """
    old, new = previous.edges, guess.edges
    node, same = _same_nodes(old, new)
    middle = (new[:-1] + new[1:]) / 2
    piece, inside = np.searchsorted(old, middle) - 1, (middle > old[0]) & (middle < old[-1])
    times = _collocation_times(new, points)
    known = np.concatenate([old[:1], _collocation_times(old, before).ravel()])
    path = np.vstack([previous.point.z0[None], previous.point.z.reshape(-1, previous.point.z0.size)])
    late = times > old[-1]
    alike = points.size == before.size
    point = ProgramPoint(
        _at(known, path, new[:1])[0] if new[0] <= old[-1] else guess.point.z0,
        _rows_where(previous.point.v, node, same),
        _rows_where(previous.point.w, piece, inside),
        np.where(late[:, :, None], guess.point.z, _at(known, path, times)),
    )
    force = previous.bound_multipliers
    bound = ProgramPoint(
        np.zeros_like(force.z0),
        _rows_where(force.v, node, same),
        _rows_where(force.w, piece, inside),
        _rows_where(force.z, piece, inside) if alike else guess.bound_multipliers.z,
    )
    return guess._replace(
        point=point,
        bound_multipliers=bound,
        row_multipliers=_rows_where(previous.row_multipliers, piece, inside) if alike else guess.row_multipliers,
        output_multipliers=_rows_where(previous.output_multipliers, node, same),
    )


def _rows_where(rows: Array, index: Index, chosen: Mask) -> Array:
    """Return rows[index] where chosen, else 0."""
    result = np.zeros((index.size, *rows.shape[1:]))
    result[chosen] = rows[index[chosen]]
    return result


def _same_nodes(old: Array, new: Array) -> tuple[Index, Mask]:
    """For each new node the nearest old one, and whether it is the same."""
    right = np.clip(np.searchsorted(old, new), 0, old.size - 1)
    left = np.clip(right - 1, 0, old.size - 1)
    nearest = np.where(np.abs(new - old[left]) < np.abs(new - old[right]), left, right)
    length = max(float(new[-1] - new[0]), float(old[-1] - old[0]))
    return nearest, np.abs(old[nearest] - new) <= SAME_NODE * length


def _collocation_times(edges: Array, points: Array) -> Array:
    return edges[:-1, None] + np.diff(edges)[:, None] * points


def _at(times: Array, states: Array, wanted: Array) -> Array:
    """Return the states (len(times), n) at `wanted`, linear in between, constant beyond the ends."""
    return np.stack([np.interp(wanted, times, states[:, i]) for i in range(states.shape[1])], axis=-1)


DEGREES = (2, 3, 5, 7, 9)  # Degrees that are tried in turn where the discretisation costs too much
HALVINGS = 3  # after the last degree the pieces are halved so often

FLOOR = 1e-7
"""Errors of the discretisation below this share of the window's largest state are none: the solver stops there."""

OUT_OF_LINE = 4.0  # a cost beyond so many times what the noise of the samples explains is looked at from other starts
REACH = 2.0  # other starts lie so many standard deviations of the arrival weight from the prior
BETTER = 0.99  # another start is better where it costs less than this share
LONGEST_WAIT = 16  # windows without other starts after some that found nothing, at most
WHOLE = 1e-9  # a gap this much longer than a multiple of `w_step`, relatively, still counts as that multiple


class WindowAnswer(NamedTuple):
    """A solved window; `error`: what the discretisation costs, in deviations of the estimate (0: not looked)."""

    solution: WindowSolution
    attempts: int
    slopes: WindowSlopes | None = None
    covariances: WindowCovariances | None = None
    jumps: Array | None = None
    error: float = 0.0


class WindowSearch:
    """Holds the program of the windows, and all that makes one solve from the one before."""

    def __init__(
        self,
        plant: NonlinearPlant,
        weights: NonlinearWeights,
        collocation: Collocation,
        horizon: float,
        solver: WindowSolver,
        region: StateRegion,
        huber: float | None,
    ) -> None:
        self.plant, self.weights, self.collocation, self.region, self.huber = plant, weights, collocation, region, huber
        self.solver = solver
        self.w_step = horizon / 60 if collocation.w_step is None else collocation.w_step
        self.degree, self.halvings, self.builds = collocation.degree, 0, 0
        self.scales = plant.scales
        self.integrator = Integrator(plant)
        pieces = int(np.ceil(horizon / self.w_step * (1 - WHOLE))) + 1
        self.build(collocation.capacity or pieces)
        self.forget()

    def build(self, capacity: int) -> None:
        """Build the program for windows of so many pieces."""
        self.program = WindowProgram(
            self.plant,
            self.weights,
            capacity,
            self.degree,
            self.solver.tolerance,
            self.solver.max_iterations,
            region=self.region,
            huber=self.huber,
        )
        self.builds += 1

    def forget(self) -> None:
        """Start again without what the last window knew."""
        self.window: WindowSolution | None = None
        self._points: Array = self.program.points
        self._wait, self._pause = 0, 1
        self._newton_wait, self._newton_pause = 0, 1

    def __getstate__(self) -> dict[str, object]:
        """Everything but what casadi holds in memory."""
        state = {key: value for key, value in self.__dict__.items() if key not in ("program", "integrator")}
        return {**state, "capacity": self.program.capacity}

    def __setstate__(self, state: dict[str, object]) -> None:
        capacity = state.pop("capacity")
        self.__dict__.update(state)
        self.integrator = Integrator(self.plant)
        builds = self.builds
        self.build(int(str(capacity)))
        self.builds = builds

    def refine(self) -> bool:
        """Make the grid finer for this window and all that follow; False where it is as fine as it gets."""
        finer = [degree for degree in DEGREES if degree > self.degree]
        capacity = self.program.capacity
        if finer:
            self.degree = finer[0]
        elif self.halvings < HALVINGS:
            self.halvings += 1
            self.w_step, capacity = self.w_step / 2, 2 * capacity
        else:
            return False
        self.build(capacity)
        return True

    def guess(self, edges: Array, states: Array) -> WindowSolution:
        """The open loop through scaled states at the edges."""
        sizes = (self.plant.n_disturbances, self.program.n_noises, self.plant.n_outputs)
        return open_loop_guess(edges, states, self.program.points, sizes)

    def solve(self, data: WindowData, guess: WindowSolution) -> WindowAnswer:
        """Solve from the last solution, if that fails from the open loop, and from elsewhere if the cost is too large.

        Seconds and iterations add up over all attempts.
        """
        if data.edges.size - 1 > self.program.capacity:
            self.build(max(data.edges.size - 1, int(1.25 * self.program.capacity)))
            self.window = None
        attempts, slopes = 1, None
        if self.window is None:
            found = self.program.solve(data, guess, warm=False)
        else:
            start = moved(self.window, guess, self.program.points, self._points)
            started = processor_seconds()
            near = self._near(data, start)
            if near is not None:
                found, slopes = near
            else:
                tried, found = processor_seconds() - started, self.program.solve(data, start, warm=True)
                found = found._replace(seconds=tried + found.seconds)
            if found.status != "ok":
                found, attempts = _added(found, self.program.solve(data, guess, warm=False)), 2
        if found.status != "ok" or self._out_of_line(data, found):
            found, attempts = self._from_elsewhere(data, found, attempts)
            slopes = None
        self.window = found if found.status == "ok" else None
        self._points = self.program.points
        answer = WindowAnswer(found, attempts, slopes)
        return self._checked(data, answer) if found.status == "ok" else answer

    def _near(self, data: WindowData, start: WindowSolution) -> tuple[WindowSolution, WindowSlopes] | None:
        """Return what Newton's method finds next to a start, unless it found nothing lately."""
        if self._newton_wait > 0:
            self._newton_wait -= 1
            return None
        found = self.program.near(data, start)
        if found is None:
            self._newton_wait, self._newton_pause = self._newton_pause, min(2 * self._newton_pause, LONGEST_WAIT)
        else:
            self._newton_pause = 1
        return found

    def _out_of_line(self, data: WindowData, found: WindowSolution) -> bool:
        """Whether the weights, read as inverse covariances, do not explain the cost."""
        return bool(found.cost > OUT_OF_LINE * (np.count_nonzero(data.mask) + OUT_OF_LINE))

    def _from_elsewhere(self, data: WindowData, found: WindowSolution, attempts: int) -> tuple[WindowSolution, int]:
        """Solve from starts beside the prior, unless that found nothing lately."""
        if self._wait > 0 or not self.solver.starts:
            self._wait -= 1
            return found, attempts
        before = found.cost if found.status == "ok" else np.inf
        for start in self._starts(data)[: self.solver.starts]:
            states = self._propagated(data, start)
            if states is None:
                continue
            other = self.program.solve(data, self.guess(data.edges, states), warm=False)
            attempts += 1
            better = other.status == "ok" and (found.status != "ok" or other.cost < BETTER * found.cost)
            found = _added(found, other) if better else _added(other, found)
            if found.status == "ok" and not self._out_of_line(data, found):
                break
        if found.status == "ok" and found.cost < BETTER * before:
            self._pause = 1
        else:
            self._wait, self._pause = self._pause, min(2 * self._pause, LONGEST_WAIT)
        return found, attempts

    def _starts(self, data: WindowData) -> list[Array]:
        """Scaled states about the prior, along the axes of what it leaves unknown, the longest first."""
        root = np.linalg.solve(data.root, np.eye(data.prior.size))
        axes, sizes, _ = np.linalg.svd(root)
        lower, upper = (bound[: data.prior.size] for bound in self.program.boxes)
        steps = [sign * REACH * size * axes[:, k] for k, size in enumerate(sizes) for sign in (1.0, -1.0)]
        return [np.clip(data.prior + step, lower, upper) for step in steps]

    def _propagated(self, data: WindowData, start: Array) -> Array | None:
        """Scaled states at the edges, open loop from one; None where that cannot be followed."""
        states = [start * self.scales["states"]]
        still = np.zeros((1, self.plant.n_disturbances))
        for k in range(data.edges.size - 1):
            ends = data.edges[k : k + 2]
            (x,) = self.integrator.steps(states[-1][None], data.inputs[k : k + 1], data.later[k : k + 1], still, ends)
            if not np.isfinite(x).all():
                return None
            states.append(x)
        return np.asarray(np.array(states) / self.scales["states"])

    def _checked(self, data: WindowData, answer: WindowAnswer) -> WindowAnswer:
        """Add the covariances, and what the discretisation costs: each piece integrated anew from where it begins."""
        solution, weights = answer.solution, self.weights
        slopes = answer.slopes or self.program.linearised(data, solution)
        jumps = None if self.collocation.accuracy is None else self.jumps(data, solution)
        known = jumps is not None and bool(np.isfinite(jumps).all())
        covariances = window_covariances(data.edges, slopes, data.root, weights, jumps if known else None)
        answer = answer._replace(slopes=slopes, covariances=covariances, jumps=jumps)
        if not known:
            return answer if jumps is None else answer._replace(error=np.inf)
        deviation = np.sqrt(np.einsum("ij,ij->i", covariances.filtered[-1], covariances.filtered[-1]))
        moved_by = np.maximum(np.abs(covariances.bias) - FLOOR * np.abs(solution.nodes).max(axis=0), 0.0)
        with np.errstate(divide="ignore"):
            error = float(np.max(np.divide(moved_by, deviation, out=np.zeros_like(deviation), where=moved_by > 0)))
        return answer._replace(error=error)

    def jumps(self, data: WindowData, solution: WindowSolution) -> Array:
        """Where each piece really ends, seen from the next node, scaled; NaN where it cannot be integrated."""
        nodes = solution.nodes
        if len(nodes) == 1:
            return np.zeros((0, nodes.shape[1]))
        x, w = nodes[:-1] * self.scales["states"], solution.point.w * self.scales["disturbances"]
        ends = self.integrator.steps(x, data.inputs[:-1], data.later, w, data.edges)
        return np.asarray(ends / self.scales["states"] - nodes[1:])


def _added(first: WindowSolution, second: WindowSolution) -> WindowSolution:
    """The second solution, with the seconds and iterations of both."""
    return second._replace(seconds=first.seconds + second.seconds, iterations=first.iterations + second.iterations)
