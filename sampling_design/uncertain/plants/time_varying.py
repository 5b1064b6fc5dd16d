"""Linear plants that vary in time, on a finite horizon, from functions or tables: their transitions."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from sampling_design.errors import ArgumentError, SolverError
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.plant import Plant, Signals
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import Record, counted, short
from sampling_design.records.units import check_time_unit
from sampling_design.uncertain.plants.time_table import MatrixTable, table_flow

MatrixOfTime = Callable[[float], npt.ArrayLike]

TOLERANCE = 1e-9  # relative tolerance of the transitions, in scaled states
CLOSER = 1e-2  # the same transitions at this share of the tolerance say how far off they are

MOST_EVALUATIONS = 20000
"""Of the right side over one stretch; where an integrator needs more, the solution escapes or is not smooth."""


def integrated(
    rate: Callable[[float, Array], Array], a: float, b: float, begin: Array, tolerance: float, *, dense: bool = False
) -> tuple[Array, Callable[[float], Array]]:
    """The solution z' = rate(t, z) at b from `begin` at a, by LSODA, and where `dense` all of it.

    Raises SolverError if it escapes or needs too many evaluations.
    """
    count, last = 0, a

    def stopped() -> SolverError:
        return SolverError(
            f"the integration comes to a stop at t = {last:.6g}: the trajectory escapes or is not smooth there.",
            status="integration failed",
        )

    def counted_rate(t: float, z: Array) -> Array:
        nonlocal count, last
        count, last = count + 1, t
        if count > MOST_EVALUATIONS:
            raise stopped()
        return rate(t, z)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the status says the same
        options = {"dense_output": dense, "rtol": tolerance, "atol": tolerance}
        path = solve_ivp(counted_rate, (a, b), begin, "LSODA", t_eval=None if dense else [b], **options)
    if not path.success:
        raise stopped()
    return path.y[:, -1], path.sol


class TransitionTable(NamedTuple):
    """What a plant does between increasing times, scaled.

    F (K-1, n, n) and W (K-1, n, n) carry a state, and what white noise on w adds, over each gap; C (K, p, n) at the
    times. errors (K-1,) : how far each F is off at most in the spectral norm; `proven` of tables, else an estimate,
    its change at a hundredth of the tolerance.
    """

    F: Array
    W: Array
    C: Array
    errors: Array
    proven: bool

    @property
    def error(self) -> float:
        """The largest of the errors."""
        return float(self.errors.max(initial=0.0))


@dataclass(frozen=True, eq=False, repr=False)
class TimeVaryingPlant(Record):
    """A linear plant that varies in time.

        x' = A(t) x + G(t) w,    y = C(t) x + v,    0 <= t <= horizon

    Parameters
    ----------
    A, C, G : callables t -> matrix
        G may be left out: no disturbance.
    horizon : float [time]
    states, outputs, disturbances : Signals, optional
        With scales.
    time_unit, name : str

    Raises
    ------
    ArgumentError
        If a matrix has another size or is not finite at 0, or the horizon is not positive.

    Examples
    --------
    >>> swing = TimeVaryingPlant(lambda t: [[0.0, 1.0], [-1 - 0.5 * np.cos(t), 0.0]], lambda t: [[1.0, 0.0]], horizon=6)
    >>> swing.transitions([0.0, 1.0]).F.shape
    (1, 2, 2)
    """

    A: MatrixOfTime
    C: MatrixOfTime
    G: MatrixOfTime | None = None
    horizon: float = field(default=0.0, kw_only=True)
    time_unit: str = field(default="s", kw_only=True)
    states: Signals = field(default=None, kw_only=True)  # type: ignore[assignment]
    outputs: Signals = field(default=None, kw_only=True)  # type: ignore[assignment]
    disturbances: Signals = field(default=None, kw_only=True)  # type: ignore[assignment]
    name: str = field(default="", kw_only=True)

    _table = {
        "name": "{name:or -}",
        "states": "{states.names}",
        "outputs": "{outputs.names}",
        "horizon": "{horizon} {time_unit}",
    }

    def __post_init__(self) -> None:
        check_time_unit(self.time_unit)
        self._hold(horizon=checks.positive("horizon", self.horizon))
        for key, matrix in (("A", self.A), ("C", self.C), ("G", self.G)):
            if not callable(matrix) and not (key == "G" and matrix is None):
                raise ArgumentError(
                    f"`{key}` must be a function of time that returns a matrix, got {checks.described(matrix)}."
                )
        n = len(checks.matrix("A(0)", self.A(0.0)))
        checks.matrix("A(0)", self.A(0.0), n, n)
        p = len(checks.matrix("C(0)", self.C(0.0), None, n))
        q = 0 if self.G is None else checks.matrix("G(0)", self.G(0.0), n, None).shape[1]
        for key, size, prefix in (("states", n, "x"), ("outputs", p, "y"), ("disturbances", q, "w")):
            given = getattr(self, key)
            given = Signals(checks.names(key, None, size, prefix)) if given is None else given
            if len(given) != size:
                raise ArgumentError(f"`{key}` must have {size} entries, got {len(given)}.")
            self._hold(**{key: given})

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
        grid = checks.increasing("times", times)
        if grid.size < 2 or grid[0] != 0.0:
            raise ArgumentError("`times` must begin at 0 and go on.")
        tables: dict[str, MatrixOfTime] = {}
        for key, value in (("A", A), ("C", C), ("G", G)):
            if value is None:
                continue
            stack = checks.floats(key, value)
            if stack.ndim != 3 or len(stack) != grid.size or not np.isfinite(stack).all():
                raise ArgumentError(f"`{key}` must hold one finite matrix for each of the {grid.size} times.")
            tables[key] = MatrixTable(grid, stack)
        return cls(tables["A"], tables["C"], tables.get("G"), horizon=float(grid[-1]), **details)  # type: ignore[arg-type]

    @cached_property
    def n_states(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def tabled(self) -> bool:
        """Whether it is a table, straight in between, of which more can be proven than of functions."""
        return isinstance(self.A, MatrixTable)

    @property
    def has_scales(self) -> bool:
        """Whether states or outputs have scales other than 1."""
        return bool(np.any(self.states.scales != 1) or np.any(self.outputs.scales != 1))

    def at(self, t: float) -> Plant:
        """The plant that stands still as this one is at time t: names, units and sizes, and no motion."""
        A, C = (np.asarray(part(t), dtype=float) for part in (self.A, self.C))
        G = np.zeros((self.n_states, 0)) if self.G is None else np.asarray(self.G(t), dtype=float)
        return Plant(A, C, G=G, time_unit=self.time_unit, states=self.states, outputs=self.outputs,
                     disturbances=self.disturbances, name=self.name)  # fmt: skip

    def transitions(self, times: npt.ArrayLike, w_spread: npt.ArrayLike | None = None) -> TransitionTable:
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
        *Claim.* Of a table `errors` are proven, truncation and rounding counted; of functions they are an estimate.
        *Method.* Phi' = A Phi and W' = A W + W A' + G S G': of tables by Taylor series on each straight piece, of
        functions by LSODA to 1e-9, and once more to 1e-11.
        """
        grid = checks.increasing("times", times)
        if grid[0] < 0 or grid[-1] > self.horizon * (1 + 1e-12):
            raise ArgumentError(f"`times` must lie in [0, {self.horizon:.6g}].")
        spread = None if w_spread is None or self.G is None else checks.vector("w_spread", w_spread, None) ** 2
        n, unit = self.n_states, self.states.scales
        outputs = np.array([np.asarray(self.C(t), dtype=float) for t in grid.tolist()]) * unit
        outputs = outputs / self.outputs.scales[:, None]
        if isinstance(self.A, MatrixTable):
            own = self.A.in_units(unit, unit)
            driven = self.G.in_units(unit, np.ones(len(self.disturbances))) if isinstance(self.G, MatrixTable) else None
            gaps = zip(grid[:-1].tolist(), grid[1:].tolist(), strict=True)
            found = [table_flow(own, None if spread is None else driven, spread, a, b) for a, b in gaps]
            F, W = (np.array([part[k] for part in found]).reshape(-1, n, n) for k in (0, 1))
            return TransitionTable(F, W, outputs, np.array([part[2] for part in found]), True)
        coarse, fine = (self._flow_along(grid, spread, tolerance) for tolerance in (TOLERANCE, CLOSER * TOLERANCE))
        errors = np.linalg.norm(fine[:, :n] - coarse[:, :n], ord=2, axis=(1, 2))
        return TransitionTable(fine[:, :n], fine[:, n:], outputs, errors, False)

    def _flow_along(self, grid: Array, spread: Array | None, tolerance: float) -> Array:
        """Phi over W for each gap, scaled, (K-1, 2n, n)."""
        n, unit = self.n_states, self.states.scales

        def rate(t: float, flat: Array) -> Array:
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
            both = integrated(rate, a, b, begin, tolerance)[0].reshape(2 * n, n)
            found.append(np.vstack([both[:n], symmetrise(both[n:])]))
        return np.array(found).reshape(-1, 2 * n, n)

    def explain(self) -> str:
        """Say what the plant is."""
        name = self.name or "A plant that varies in time"
        sizes = f"{counted(self.n_states, 'state')}, {counted(len(self.outputs), 'output')}"
        return f"{name}: {sizes}, over {short(self.horizon)} {self.time_unit}."
