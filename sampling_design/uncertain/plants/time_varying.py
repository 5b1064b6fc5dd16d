"""Linear plants that vary in time, on a finite horizon, from functions or tables: their transitions."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.integrate import solve_ivp

from sampling_design.errors import ArgumentError, SolverError
from sampling_design.plants.plant import Plant, Signals
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.budget import ENDLESS, Budget
from sampling_design.records.record import Record, counted, short
from sampling_design.records.units import check_time_unit

TERMS = 22  # of each Taylor series
LENGTH = 0.5  # |A| times a step at most
MOST_STEPS = 200_000  # over one gap; what asks for more cannot be followed in doubles
LARGEST_ERROR = 1e100  # of a transition: it says nothing, and the squares of what comes of it are still numbers
EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class MatrixTable:
    """Matrices (N, ., .) at N increasing times, straight in between."""

    times: Array
    stack: Array

    def __call__(self, t: float) -> Array:
        k = min(max(int(self.times.searchsorted(t, side="right")) - 1, 0), self.times.size - 2)
        share = (t - self.times[k]) / (self.times[k + 1] - self.times[k])
        return np.asarray((1 - share) * self.stack[k] + share * self.stack[k + 1])

    def in_units(self, rows: Array, columns: Array) -> MatrixTable:
        """The matrices of scaled vectors."""
        return MatrixTable(self.times, self.stack * columns / rows[:, None])

    def knots(self, a: float, b: float) -> list[float]:
        """a, the times of the table in between, b: the matrices run straight from each to the next."""
        inner = self.times[(self.times > a) & (self.times < b)]
        return [a, *inner.tolist(), b]


def table_flow(A: MatrixTable, a: float, b: float, clock: Budget = ENDLESS) -> tuple[Array, float]:
    """Transition over [a, b], and a proven bound of its error (spectral norm).

    On a straight piece A_0 + A_1 s its coefficients obey (k + 1) F_{k+1} = A_0 F_k + A_1 F_{k-1}. With norms in place
    of matrices the recursion majorises itself, which bounds the terms left out; each product of matrices rounds by at
    most (n + 2) eps of its factors' norms. Raises SolverError if the matrices are so large that the steps do not come
    to an end.
    """
    n = A.stack.shape[1]
    F, error = np.eye(n), 0.0
    ends = A.knots(a, b)
    for p, q in pairwise(ends):
        low, high = A(p), A(q)
        size = max(float(np.linalg.norm(low)), float(np.linalg.norm(high)))
        count = max(1, int(np.ceil(min(size * (q - p) / LENGTH, 2.0 * MOST_STEPS))))
        if count > MOST_STEPS or not np.isfinite(size):
            raise SolverError(
                f"the integration comes to a stop at t = {p:.6g}: |A| reaches {size:.3g} there, too much for doubles.",
                status="integration failed",
            )
        h, slope = (q - p) / count, (high - low) / (q - p)
        for k in range(count):
            clock.check()
            step, own = _series(low + (high - low) * (k / count), slope, h)
            own += 2 * EPS * abs(q) * size * np.exp(size * h)  # the ends of the step are rounded, too
            before, reach = length_of(F), length_of(step)
            error = reach * error + own * (before + error) + 2 * n * n * EPS * reach * before
            if not error < LARGEST_ERROR:
                raise SolverError(
                    f"the integration comes to a stop at t = {p + (k + 1) * h:.6g}: its error is bounded by {error:.3g}"
                    " only. Are states in units far apart? Give their scales.", status="integration failed",
                )  # fmt: skip
            F = step @ F
    return F, error


def length_of(matrix: Array) -> float:
    """The largest singular value, rounded up."""
    return float(np.linalg.norm(matrix, 2) * (1 + 8 * max(matrix.shape) * EPS))


def _series(A: Array, slope: Array, h: float) -> tuple[Array, float]:
    """Flow over a step of a straight piece, and the bound of its error."""
    n = len(A)
    A, slope = A * h, slope * h**2
    sizes = float(np.linalg.norm(A)), float(np.linalg.norm(slope))
    term, before = np.eye(n), np.zeros((n, n))
    bound, behind = float(np.sqrt(n)), 0.0
    F, whole = term, bound
    for k in range(TERMS):
        term, before = (A @ term + slope @ before) / (k + 1), term
        bound, behind = (sizes[0] * bound + sizes[1] * behind) / (k + 1), bound
        F, whole = F + term, whole + bound
    left_out = 2 * max(bound, behind)  # later terms fall by more than a half each: |A| + |A'| < TERMS / 2
    return F, left_out + (TERMS * (n + 6) + 16) * EPS * whole


MatrixOfTime = Callable[[float], npt.ArrayLike]

TOLERANCE = 1e-9  # relative tolerance of the transitions, in scaled states
CLOSER = 1e-2  # the same transitions at this share of the tolerance say how far off they are

ONE_STEP = 1e-13
"""Share of the time within which rounding alone sets ends apart: one step is exact there, and LSODA begins none."""

MOST_EVALUATIONS = 20000
"""Of the right side over one stretch; where an integrator needs more, the solution escapes or is not smooth."""


def integrated(
    rate: Callable[[float, Array], Array],
    a: float,
    b: float,
    begin: Array,
    tolerance: float,
    clock: Budget = ENDLESS,
    *,
    dense: bool = False,
) -> tuple[Array, Callable[[float], Array]]:
    """The solution z' = rate(t, z) at b from `begin` at a, by LSODA, and where `dense` all of it.

    Raises SolverError if it escapes or needs too many evaluations.
    """
    count, last = 0, a
    if abs(b - a) <= ONE_STEP * max(abs(a), abs(b)):
        slope = rate(a, begin)
        return begin + (b - a) * slope, lambda t: begin + (t - a) * slope

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
        clock.check()
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

    F (K-1, n, n) carries a state over each gap; C (K, p, n) at the times. errors (K-1,) : how far each F is off at
    most in the spectral norm; `proven` of tables, else an estimate, its change at a hundredth of the tolerance.
    """

    F: Array
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
        """The plant that stands still as this one is at time t: with its names, units and sizes."""
        A, C = (np.asarray(part(t), dtype=float) for part in (self.A, self.C))
        G = np.zeros((self.n_states, 0)) if self.G is None else np.asarray(self.G(t), dtype=float)
        return Plant(A, C, G=G, time_unit=self.time_unit, states=self.states, outputs=self.outputs,
                     disturbances=self.disturbances, name=self.name)  # fmt: skip

    def transitions(self, times: npt.ArrayLike, clock: Budget = ENDLESS) -> TransitionTable:
        """Return the transitions between increasing times in [0, horizon].

        Parameters
        ----------
        times : (K,) array [time]
        clock : Budget
            Looked at before every step.

        Raises
        ------
        ArgumentError
            If the times are not increasing, or lie outside the horizon.
        SolverError
            If the integration fails.
        BudgetSpentError
            If the clock says that it is over.

        Notes
        -----
        *Claim.* Of a table `errors` are proven, truncation and rounding counted; of functions they are an estimate.
        *Method.* Phi' = A Phi: of tables by Taylor series on each straight piece, of functions by LSODA to 1e-9, and
        once more to 1e-11.
        """
        grid = checks.increasing("times", times)
        if not grid.size or grid[-1] > self.horizon * (1 + 1e-12):
            raise ArgumentError(f"`times` must lie in [0, {self.horizon:.6g}], one at least.")
        n, unit = self.n_states, self.states.scales
        outputs = np.array([np.asarray(self.C(t), dtype=float) for t in grid.tolist()]) * unit
        outputs = outputs / self.outputs.scales[:, None]
        if isinstance(self.A, MatrixTable):
            own = self.A.in_units(unit, unit)
            found = [table_flow(own, a, b, clock) for a, b in pairwise(grid.tolist())]
            F = np.array([flow for flow, _ in found]).reshape(-1, n, n)
            return TransitionTable(F, outputs, np.array([error for _, error in found]), True)
        coarse, fine = (self._flow_along(grid, tolerance, clock) for tolerance in (TOLERANCE, CLOSER * TOLERANCE))
        return TransitionTable(fine, outputs, np.linalg.norm(fine - coarse, ord=2, axis=(1, 2)), False)

    def _flow_along(self, grid: Array, tolerance: float, clock: Budget) -> Array:
        """Phi for each gap, scaled, (K-1, n, n)."""
        n, unit = self.n_states, self.states.scales

        def rate(t: float, flat: Array) -> Array:
            A = np.asarray(self.A(t), dtype=float) * unit / unit[:, None]
            if not np.isfinite(A).all():
                raise ArgumentError(
                    f"`A` must be finite on the whole horizon, got {A.ravel()[:4].tolist()} at t = {t!r}."
                )
            return np.asarray((A @ flat.reshape(n, n)).ravel())

        ends = [integrated(rate, a, b, np.eye(n).ravel(), tolerance, clock)[0] for a, b in pairwise(grid.tolist())]
        return np.array(ends).reshape(-1, n, n)

    def explain(self) -> str:
        """Say what the plant is."""
        name = self.name or "A plant that varies in time"
        sizes = f"{counted(self.n_states, 'state')}, {counted(len(self.outputs), 'output')}"
        return f"{name}: {sizes}, over {short(self.horizon)} {self.time_unit}."
