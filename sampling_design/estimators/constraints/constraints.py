"""What is known of the signals, by a user, in a window, and beside what an interval assumes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeAlias, get_args

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.bounds import BoundedSet
from sampling_design.accuracy.readings import RowReading
from sampling_design.checkers.strict import is_list
from sampling_design.errors import ArgumentError
from sampling_design.estimators.constraints.constrained_signals import ConstrainedSignal, ConstraintDemands
from sampling_design.estimators.constraints.convex_set import ConvexSet, all_inside, convex_set, set_like
from sampling_design.estimators.constraints.disturbance import DisturbanceReach
from sampling_design.estimators.gap_flows.cost_weights import stretches
from sampling_design.estimators.gap_flows.flows import FlowTable
from sampling_design.estimators.online.evidence import EstimateAssumptions
from sampling_design.estimators.window.sliding import OptimalTrajectory
from sampling_design.estimators.window.window_problem import EstimationWindow, WindowEstimate
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import Record, short

SetLike: TypeAlias = "ConvexSet | tuple[npt.ArrayLike, npt.ArrayLike] | None"
WModel = Literal["outer", "constant"]
Engine = Literal["auto", "active set", "conic"]


@dataclass(frozen=True, eq=False, repr=False)
class Constraints(Record):
    """What is known of the signals, for a `MovingHorizonEstimator`: each a ConvexSet or a pair (lower, upper).

        x(t) in X,    C x + D u + v in Y,    v in V,    w(t) in W

    Parameters
    ----------
    x, y, v, w : ConvexSet or (lower, upper), optional
        Of the state x, the modelled output C x + D u + v, the noise v and the disturbance w; in physical units.
        Numbers stand for all entries, infinite ones for no bound.
    check_spacing : float, optional [time]
        Impose those on x also between samples, at points at most this far apart.
    w_model : "outer" or "constant"
        How bounds on w act: as an outer bound on what they can do over a gap, which provably contains the truth, or
        on a disturbance that is constant between nodes, which is not certified.
    engine : "auto", "active set" or "conic"
        What solves a window with active constraints.

    Raises
    ------
    ArgumentError
        If a set is neither, `check_spacing` is not positive, or `w_model` or `engine` is unknown. The sets meet the
        plant's dimensions in the estimator.

    Examples
    --------
    >>> from sampling_design import CostFunction, MovingHorizonEstimator, Plant
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> inside = Constraints(x=(-1.0, 1.0), v=(-0.1, 0.1))
    >>> mhe = MovingHorizonEstimator(plant, horizon=5.0, cost=CostFunction(eta=0.2), constraints=inside)
    >>> bool(abs(mhe.update(0.4, [1.3]).x).max() <= 1.0 + 1e-9)
    True
    """

    x: SetLike = None
    y: SetLike = None
    v: SetLike = None
    w: SetLike = None
    check_spacing: float | None = None
    w_model: WModel = "outer"
    engine: Engine = "auto"

    def __post_init__(self) -> None:
        for key in "xyvw":
            set_like(key, getattr(self, key))
        self._check(check_spacing=checks.positive)
        for key, value, known in (("w_model", self.w_model, WModel), ("engine", self.engine, Engine)):
            checks.word(key, value, get_args(known))

    def _rows(self) -> list[tuple[str, str]]:
        rows = [(key, _bounds_text(getattr(self, key))) for key in "xyvw" if getattr(self, key) is not None]
        if self.check_spacing is not None:
            rows.append(("checked every", short(self.check_spacing)))
        return [*rows, *([("w between nodes", self.w_model)] if self.w is not None else [])]

    def explain(self) -> str:
        """Say what is constrained."""
        named = [key for key in "xyvw" if getattr(self, key) is not None]
        return f"Constraints on {', '.join(named)}." if named else "No constraints."


def _bounds_text(chosen: object) -> str:
    if is_list(chosen) and len(chosen) == 2:
        return f"{short(chosen[0], 4)} to {short(chosen[1], 4)}"
    return repr(chosen)


INSIDE = 1e-12  # share of a box by which a ball may stand out of it and still be taken for what is known


def common(name: str, known: BoundedSet, chosen: ConvexSet | None) -> BoundedSet:
    """Return a set that holds what a bound and a constraint set have in common: a ball within both, else a box.

    Raises ArgumentError if they have nothing in common.
    """
    if chosen is None:
        return known
    reach = known.half_widths
    lower, upper = chosen.bounding_box()
    lower, upper = np.maximum(lower, known.centre - reach), np.minimum(upper, known.centre + reach)
    if np.any(lower > upper):
        raise ArgumentError(f"`{name}_bound` and `constraints.{name}` must have something in common, got none.")
    balls = [known] if known.ball else []
    for part in chosen.round_balls:
        back = part.inverse()
        if back is not None:
            balls.append(BoundedSet(part.centre, part.radius * back, True))
    slack = INSIDE * (upper - lower)
    for one in balls:
        reach = one.half_widths
        if np.all(one.centre - reach >= lower - slack) and np.all(one.centre + reach <= upper + slack):
            return one
    return BoundedSet.box((lower + upper) / 2, (upper - lower) / 2)


def one_sided(chosen: ConvexSet | None) -> tuple[RowReading, ...]:
    """Return the linear inequalities of a set of states: its box (that of its balls, too) and its half-spaces."""
    if chosen is None:
        return ()
    (lower, upper), identity = chosen.bounding_box(), np.eye(chosen.dimension)
    found = [RowReading(row, float(bound), 0.0, True) for row, bound in zip(identity, upper, strict=True)]
    found += [RowReading(-row, -float(bound), 0.0, True) for row, bound in zip(identity, lower, strict=True)]
    found += [RowReading(row, float(bound), 0.0, True) for row, bound in zip(chosen.rows, chosen.offsets, strict=True)]
    return tuple(row for row in found if np.isfinite(row.y))


def narrowed(found: EstimateAssumptions, sets: WindowConstraints) -> EstimateAssumptions:
    """Return assumptions with constraint sets for x, v and w; one for the measured output says nothing new."""
    noise = common("v", found.noise, sets.v)
    size = noise.half_widths
    straight = bool(np.all(noise.root == np.diag(size))) if noise.root.shape == (size.size,) * 2 else False
    noise_bound = BoundedSet.box(noise.centre, size, noise.ball and straight)
    return replace(
        found, disturbance=common("w", found.disturbance, sets.w), noise=noise_bound, state=one_sided(sets.x)
    )


class WindowConstraints:
    """The sets of one estimator, and what they ask of a window."""

    def __init__(self, table: FlowTable, given: Constraints):
        plant = table.weights.plant
        self.plant, self.weights = plant, table.weights
        self.x = convex_set("constraints.x", given.x, plant.n_states)
        self.y = convex_set("constraints.y", given.y, plant.n_outputs)
        self.v = convex_set("constraints.v", given.v, plant.n_outputs)
        self.w = convex_set("constraints.w", given.w, plant.n_disturbances)
        self.keeps_v = self.v is not None or self.y is not None
        self._omega_names = tuple(f"omega{i + 1}" for i in range(plant.n_states))
        self.reach = None if self.w is None else DisturbanceReach(table, self.w)

    @cached_property
    def active(self) -> bool:
        """Whether there is any constraint."""
        return any(s is not None for s in (self.x, self.y, self.v, self.w))

    @property
    def has_balls(self) -> bool:
        """Whether there is any norm ball."""
        return any(s is not None and s.round_balls for s in (self.x, self.y, self.v, self.w))

    def noise(self, y: Array, masks: Array, nodes: Array) -> Array:
        """Return the best v at every node for given states: (R + Qv)^-1 R (y - C x), measured outputs only.

        `y` without what the input adds.
        """
        found: Array = y - nodes @ self.plant.C.T
        for begin, count in zip(*stretches(masks), strict=True):
            found[begin : begin + count] = found[begin : begin + count] @ self.weights.at(masks[begin]).gain.T
        return found

    def hold(self, path: OptimalTrajectory, samples: Callable[[], tuple[Array, Array, Array]]) -> bool:
        """Whether a trajectory keeps all sets, none by rounding alone. `samples` gives y - D u, the masks, and D u."""
        if self.x is not None and not all_inside(self.x, path.nodes):
            return False
        if self.reach is not None and not self.reach.holds(path.flows, path.deviation, path.defect):
            return False
        if not self.keeps_v:
            return True
        y, masks, feedthrough = samples()
        nodes, measured = path.nodes[-len(y) :], masks > 0
        v = self.noise(y, masks, nodes)
        if self.v is not None and not all_inside(self.v, v, measured):
            return False
        return self.y is None or all_inside(self.y, nodes @ self.plant.C.T + feedthrough + v, measured)

    def demands(self, window: EstimationWindow, free: WindowEstimate) -> ConstraintDemands:
        """Return what the constraints ask of all trajectories around the minimiser without them."""
        nodes = free.nodes
        signals = []
        if self.x is not None:
            at = np.arange(window.times.size)
            unit = np.sqrt(np.diag(free.covariance))
            signals.append(
                ConstrainedSignal("constraints.x", window.times, self.plant.states.names, nodes, [self.x], at, unit)
            )
        if self.keeps_v:
            signals += self._noisy_signals(window, free)
        if window.limits is not None:
            signals.append(self._limited_signal(window, free, window.limits))
        if self.reach is not None and window.flows:
            whiten = np.array([flow.whiten for flow in window.flows])
            base, before = _omegas(window, nodes, whiten), -np.matmul(whiten, window.F)
            names, at = self._omega_names[: whiten.shape[1]], np.arange(1, window.times.size)
            sets = self.reach.over(window.flows)
            signals.append(
                ConstrainedSignal(
                    name="constraints.w",
                    times=window.times[1:],
                    entries=names,
                    base=base,
                    sets=sets,
                    at=at,
                    unit=np.ones(len(names)),
                    here=whiten,
                    before=before,
                )
            )
        return ConstraintDemands(free.spread, signals, *nodes.shape)

    def _limited_signal(self, window: EstimationWindow, free: WindowEstimate, limits: Array) -> ConstrainedSignal:
        """C x where limits of detection were read."""
        measured = np.isfinite(limits[:, 0]) | np.isfinite(limits[:, 1])
        at, C = np.flatnonzero(measured.any(axis=1)), self.plant.C
        known = np.sqrt(np.einsum("ij,jk,ik->i", C, free.covariance, C))
        return ConstrainedSignal(
            name="limits of detection",
            times=window.times[at],
            entries=self.plant.outputs.names,
            base=free.nodes[at] @ C.T,
            sets=[ConvexSet.box(*limits[k]) for k in at],
            at=at,
            unit=np.where(known > 0, known, 1.0),
            here=np.broadcast_to(C, (at.size, *C.shape)),
            measured=measured[at],
        )

    def _noisy_signals(self, window: EstimationWindow, free: WindowEstimate) -> list[ConstrainedSignal]:
        """The noise v = gain (y - C x - D u) + its own part, and the output C x + D u + v, at the samples."""
        plant, at, found, nodes = self.plant, window.samples, [], free.nodes
        unit = np.linalg.norm(self.weights.at(np.ones(plant.n_outputs)).v_root, axis=1)
        known = np.sqrt(np.einsum("ij,jk,ik->i", plant.C, free.covariance, plant.C))
        times, names, taken = window.times[at], plant.outputs.names, window.masks[at] > 0
        v = self.noise(window.y - window.feedthrough, window.masks, nodes)[at]
        kinds = self.weights.of(window.masks[at])
        here = -kinds.gain @ plant.C
        own = kinds.v_root / np.sqrt(window.discount[at])[:, None, None]
        if self.v is not None:
            found.append(
                ConstrainedSignal("constraints.v", times, names, v, [self.v], at, unit, here, own=own, measured=taken)
            )
        if self.y is not None:
            y, wide = nodes[at] @ plant.C.T + window.feedthrough[at] + v, unit + known
            both = plant.C + here
            found.append(
                ConstrainedSignal("constraints.y", times, names, y, [self.y], at, wide, both, own=own, measured=taken)
            )
        return found


def _omegas(window: EstimationWindow, nodes: Array, whiten: Array) -> Array:
    """The least omega of every gap for given states, (N, width)."""
    deviation = nodes - window.reference
    moved = deviation[1:] - np.matmul(window.F, deviation[:-1, :, None])[:, :, 0] - window.defect
    return np.asarray(np.matmul(whiten, moved[:, :, None])[:, :, 0])
