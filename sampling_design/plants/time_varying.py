"""Linear plants that vary in time, on a finite horizon: from functions, tables, or along a nonlinear trajectory."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from sampling_design import _checks
from sampling_design._linalg import symmetrise
from sampling_design._record import Record, counted, short
from sampling_design._units import check_time_unit
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear._casadi import casadi
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.plants.plant import Signals

Array = npt.NDArray[np.float64]
MatrixOfTime = Callable[[float], npt.ArrayLike]

TOLERANCE = 1e-9
"""Relative tolerance of the transitions, in scaled states."""

CLOSER = 1e-2
"""The same transitions at this share of the tolerance say how far off they are."""


MOST_EVALUATIONS = 20000
"""Of the right side over one stretch; where an integrator needs more, the solution escapes or is not smooth."""


class _Spent:
    """Evaluations over one stretch."""

    count = 0

    def one_more(self, t: float) -> None:
        """Count one.

        Raises
        ------
        SolverError
            If there were too many.
        """
        self.count += 1
        if self.count > MOST_EVALUATIONS:
            raise SolverError(
                f"the integration comes to a stop at t = {t:.6g}: the motion escapes or is not smooth there.",
                status="integration failed",
            )


class TransitionTable(NamedTuple):
    """What a plant does between increasing times, scaled.

    F (K-1, n, n) and W (K-1, n, n) carry a state, and what white noise on w adds, over each gap; C (K, p, n) at the
    times; error : the largest change of F at a hundredth of the tolerance.
    """

    F: Array
    W: Array
    C: Array
    error: float


@dataclass(frozen=True, eq=False, repr=False)
class TimeVaryingPlant(Record):
    """A linear plant that varies in time.

        x' = A(t) x + G(t) w,    y = C(t) x + v,    0 <= t <= horizon

    Parameters
    ----------
    A, C, G : callables t -> matrix
        G may be left out: no disturbance.
    horizon : float [time]
    states, outputs : Signals, optional
        With scales.
    time_unit : str

    Raises
    ------
    ArgumentError
        If a matrix has another size or is not finite at 0, or the horizon is not positive.

    Examples
    --------
    >>> swing = TimeVaryingPlant(lambda t: [[0.0, 1.0], [-1 - 0.5 * np.cos(t), 0.0]], lambda t: [[1.0, 0.0]], horizon=6)
    >>> swing.motion([0.0, 1.0]).F.shape
    (1, 2, 2)
    """

    A: MatrixOfTime
    C: MatrixOfTime
    G: MatrixOfTime | None = None
    horizon: float = field(default=0.0, kw_only=True)
    time_unit: str = field(default="s", kw_only=True)
    states: Signals = field(default=None, kw_only=True)  # type: ignore[assignment]
    outputs: Signals = field(default=None, kw_only=True)  # type: ignore[assignment]
    name: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        check_time_unit(self.time_unit)
        object.__setattr__(self, "horizon", _checks.positive("horizon", self.horizon))
        n = len(_checks.matrix("A(0)", self.A(0.0)))
        _checks.matrix("A(0)", self.A(0.0), n, n)
        p = len(_checks.matrix("C(0)", self.C(0.0), None, n))
        if self.G is not None:
            _checks.matrix("G(0)", self.G(0.0), n, None)
        for key, size, prefix in (("states", n, "x"), ("outputs", p, "y")):
            given = getattr(self, key)
            given = Signals(_checks.names(key, None, size, prefix)) if given is None else given
            if len(given) != size:
                raise ArgumentError(f"`{key}` must have {size} entries, got {len(given)}.")
            object.__setattr__(self, key, given)

    @classmethod
    def from_table(
        cls, times: npt.ArrayLike, A: npt.ArrayLike, C: npt.ArrayLike, G: npt.ArrayLike | None = None, **details: object
    ) -> TimeVaryingPlant:
        """Return the plant of matrices (N, ., .) at increasing times from 0, straight in between.

        Raises
        ------
        ArgumentError
            If the times do not begin at 0, or a table has another number of matrices.
        """
        grid = _checks.increasing("times", times)
        if grid.size < 2 or grid[0] != 0.0:
            raise ArgumentError("`times` must begin at 0 and go on.")
        tables: dict[str, MatrixOfTime] = {}
        for key, value in (("A", A), ("C", C), ("G", G)):
            if value is None:
                continue
            stack = _checks.floats(key, value)
            if stack.ndim != 3 or len(stack) != grid.size or not np.isfinite(stack).all():
                raise ArgumentError(f"`{key}` must hold one finite matrix for each of the {grid.size} times.")
            tables[key] = _Table(grid, stack)
        return cls(tables["A"], tables["C"], tables.get("G"), horizon=float(grid[-1]), **details)  # type: ignore[arg-type]

    @classmethod
    def along(
        cls, plant: NonlinearPlant, start: npt.ArrayLike, horizon: float, u: npt.ArrayLike = ()
    ) -> TimeVaryingPlant:
        """Return the small deviations from a nonlinear plant's trajectory from `start`, with constant u and w = 0.

        Raises
        ------
        ArgumentError
            If a size differs.
        SolverError
            If the trajectory cannot be followed.
        """
        x0 = _checks.vector("start", start, plant.n_states)
        control = _checks.vector("u", np.zeros(plant.n_inputs) if not np.size(u) else u, plant.n_inputs)
        end, scale = _checks.positive("horizon", horizon), plant.states.scales
        still = np.zeros(plant.n_disturbances)

        spent = _Spent()

        def rate(t: float, z: Array) -> Array:
            spent.one_more(t)
            return np.array(plant.rate_casadi(z * scale, control, still, t)).ravel() / scale

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the status says the same
            path = solve_ivp(
                rate, (0.0, end), x0 / scale, "LSODA", dense_output=True, rtol=TOLERANCE / 100, atol=TOLERANCE / 100
            )
        if not path.success:
            raise SolverError("the nominal trajectory cannot be followed to the horizon.", status="integration failed")
        ca = casadi()
        x, t = ca.SX.sym("x", plant.n_states), ca.SX.sym("t")
        w, v = ca.SX.sym("w", plant.n_disturbances), ca.SX.sym("v", plant.n_noises)
        f, h = plant.rate_casadi(x, control, w, t), plant.shown_casadi(x, control, v, t)
        slopes = [
            ca.Function("slope", [x, t], [ca.densify(ca.substitute(ca.jacobian(y, by), z, ca.SX.zeros(z.numel())))])
            for y, by, z in ((f, x, w), (h, x, v), (f, w, w))
        ]

        def at(which: int) -> MatrixOfTime:
            return lambda t: np.array(slopes[which](path.sol(t) * scale, t))

        return cls(
            at(0),
            at(1),
            at(2) if plant.n_disturbances else None,
            horizon=end,
            time_unit=plant.time_unit,
            states=plant.states,
            outputs=plant.outputs,
            name=plant.name,
        )

    @cached_property
    def n_states(self) -> int:
        """Number of states."""
        return len(self.states)

    def motion(self, times: npt.ArrayLike, w_spread: npt.ArrayLike | None = None) -> TransitionTable:
        """Return the transitions between increasing times in [0, horizon].

        Parameters
        ----------
        times : (K,) array [time]
        w_spread : (q,) array, optional
            Square roots of the intensities of white noise on w; default none.

        Raises
        ------
        ArgumentError
            If the times are not increasing, or lie outside the horizon.
        SolverError
            If the integration fails.

        Notes
        -----
        *Method.* Phi' = A Phi and W' = A W + W A' + G S G' by LSODA to 1e-9, and once more to 1e-11: `error` is how far
        they differ. That is an estimate, no proof.
        """
        grid = _checks.increasing("times", times)
        if grid[0] < 0 or grid[-1] > self.horizon * (1 + 1e-12):
            raise ArgumentError(f"`times` must lie in [0, {self.horizon:.6g}].")
        spread = None if w_spread is None or self.G is None else _checks.vector("w_spread", w_spread, None) ** 2
        coarse, fine = (self._flown(grid, spread, tolerance) for tolerance in (TOLERANCE, CLOSER * TOLERANCE))
        n, unit = self.n_states, self.states.scales
        error = float(np.abs(fine[:, :n] - coarse[:, :n]).max(initial=0.0))
        shown = np.array([np.asarray(self.C(t), dtype=float) for t in grid.tolist()])
        return TransitionTable(fine[:, :n], fine[:, n:], shown * unit / self.outputs.scales[:, None], error)

    def _flown(self, grid: Array, spread: Array | None, tolerance: float) -> Array:
        """Phi over W for each gap, scaled, (K-1, 2n, n)."""
        n, unit = self.n_states, self.states.scales

        spent = _Spent()

        def rate(t: float, flat: Array) -> Array:
            spent.one_more(t)
            both = flat.reshape(2 * n, n)
            A = np.asarray(self.A(t), dtype=float) * unit / unit[:, None]
            if not np.isfinite(A).all():
                raise ArgumentError(
                    f"`A` must be finite on the whole horizon, got {A.ravel()[:4].tolist()} at t = {t!r}."
                )
            half = A @ both[n:]
            grown = half + half.T
            if spread is not None and self.G is not None:
                G = np.asarray(self.G(t), dtype=float) / unit[:, None]
                grown = grown + G * spread @ G.T
            return np.vstack([A @ both[:n], grown]).ravel()

        begin = np.vstack([np.eye(n), np.zeros((n, n))]).ravel()
        found = []
        for a, b in zip(grid[:-1].tolist(), grid[1:].tolist(), strict=True):
            spent.count = 0
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                path = solve_ivp(rate, (a, b), begin, "LSODA", t_eval=[b], rtol=tolerance, atol=tolerance)
            if not path.success:
                raise SolverError(f"the transition over [{a:.6g}, {b:.6g}] fails.", status="integration failed")
            both = path.y[:, -1].reshape(2 * n, n)
            found.append(np.vstack([both[:n], symmetrise(both[n:])]))
        return np.array(found).reshape(-1, 2 * n, n)

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("name", self.name or "-"),
            ("states", ", ".join(self.states.names)),
            ("outputs", ", ".join(self.outputs.names)),
            ("horizon", f"{short(self.horizon)} {self.time_unit}"),
        ]

    def explain(self) -> str:
        """Say what the plant is."""
        name = self.name or "A plant that varies in time"
        sizes = f"{counted(self.n_states, 'state')}, {counted(len(self.outputs), 'output')}"
        return f"{name}: {sizes}, over {short(self.horizon)} {self.time_unit}."


@dataclass(frozen=True)
class _Table:
    """Matrices at times, straight in between."""

    times: Array
    stack: Array

    def __call__(self, t: float) -> Array:
        k = int(np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, self.times.size - 2))
        share = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        return np.asarray((1 - share) * self.stack[k] + share * self.stack[k + 1])
