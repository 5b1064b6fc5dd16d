"""The only door to Clarabel for linear matrix inequalities and second-order cones.

A solver's word is provenance, never evidence: whoever calls this re-checks the numbers it brings back
(a passed `verify`, weak duality with projected multipliers, ...). Strict inequalities are asked with a
stated margin. The solver is not loaded before the first problem is posed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from sampling_design.records.arrays import Array, Index
from sampling_design.records.budget import Budget
from sampling_design.records.record import SolverRecord

if TYPE_CHECKING:
    from clarabel import DefaultSettings, DefaultSolver
    from scipy.sparse import csc_matrix


TOLERANCE = 1e-9  # gap and feasibility asked of the solver; what comes back may still miss it by some digits

NEARLY = 10.0
"""Multiple of the tolerance within which the two sides of an unrefined solve must be, where feasibility stops it: its
multipliers, which are exact to many more digits, then prove all but that much."""

LARGE = 20000  # entries of a program from which on a few digits are wanted of it, where its caller says how few

THREADS = 1
"""Of the solver: more of them wait busily for each other, for up to twice the work, and change no bit of a point."""

SOLVED, INACCURATE, INFEASIBLE, UNBOUNDED, BUDGET, FAILED, TOO_LARGE, NO_TIME = (
    "solved",
    "inaccurate",
    "infeasible",
    "unbounded",
    "budget",
    "failed",
    "too large",
    "no time",
)
USABLE = (SOLVED, INACCURATE, BUDGET)
"""Statuses after which there may be a point worth checking."""

MOST_NUMBERS = 1.2e7
"""Numbers in the scalings of the semidefinite cones beyond which a program is not posed: the solver
takes 70 to 100 bytes for each, a gigabyte here, and would take all that a machine has where states double."""
SETTING_UP = 1.2e-7
"""Seconds for each of them before the solver looks at its time limit: a program that needs all that is left for it
would end without a point."""
LEAST_SET_UP = 0.05  # seconds of it that any program may take, whatever is left


def clarabel() -> ModuleType:
    """Return the solver, loaded on first use."""
    return import_module("clarabel")


def quiet_settings(tolerance: float | None = None, iterations: int | None = None) -> DefaultSettings:
    """Return the solver's own settings, but silent, in one thread, and of this tolerance and most iterations."""
    settings = clarabel().DefaultSettings()
    settings.verbose = False
    settings.max_threads = THREADS
    if tolerance is not None:
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = settings.tol_ktratio = tolerance
    if iterations is not None:
        settings.max_iter = iterations
    return settings


def usable(record: SolverRecord) -> bool:
    """Whether the variables may hold a point worth checking."""
    return record.status in USABLE


@dataclass(frozen=True, eq=False)
class ConeSolution:
    """Point and multipliers of a cone program, as the solver left them (unchecked)."""

    x: Array
    z: tuple[Array, ...]  # one per cone; psd ones as symmetric matrices
    record: SolverRecord = field(repr=False)


def _cones() -> dict[str, Callable[[int], object]]:
    cl = clarabel()
    return {"zero": cl.ZeroConeT, "nonnegative": cl.NonnegativeConeT, "second order": cl.SecondOrderConeT}


def svec(matrices: Array) -> Array:
    """Stack the upper triangles of (..., n, n) symmetric matrices column by column, off-diagonals times sqrt(2).

    The inner product of two such vectors is the trace product of the matrices.
    """
    rows, columns, scale = _triangle(matrices.shape[-1])
    return np.asarray(matrices[..., rows, columns] * scale)


def smat(vectors: Array) -> Array:
    """Undo `svec`: symmetric (..., n, n) matrices from (..., n(n+1)/2) vectors."""
    n = _order(vectors.shape[-1])
    rows, columns, scale = _triangle(n)
    result = np.zeros((*vectors.shape[:-1], n, n))
    result[..., rows, columns] = vectors / scale
    result[..., columns, rows] = vectors / scale
    return result


@cache
def _triangle(n: int) -> tuple[Index, Index, Array]:
    """Rows, columns (i <= j, column after column) and scale, 1 on the diagonal and sqrt(2) off it."""
    columns, rows = np.tril_indices(n)
    return rows, columns, np.where(rows == columns, 1.0, np.sqrt(2.0))


def too_large(sizes: Iterable[int], budget: float | None = None, beside: float = 0.0) -> SolverRecord | None:
    """The record of a program that is not posed, by the sizes m = n(n+1)/2 of its semidefinite cones: m^2 numbers each,
    and so many `beside` them.

    None where the solver's memory holds it, and the seconds that are left hold what comes before its first step.
    """
    numbers = beside + float(sum(size**2 for size in sizes))
    if numbers <= MOST_NUMBERS and (budget is None or SETTING_UP * numbers <= max(budget, LEAST_SET_UP)):
        return None
    return SolverRecord(
        "Clarabel", status=TOO_LARGE if numbers > MOST_NUMBERS else NO_TIME, details={"numbers": numbers}
    )


def solve_cone_program(
    cost: Array,
    blocks: Sequence[tuple[str, Any, Array]],
    *,
    tolerance: float = TOLERANCE,
    budget: float | None = None,
    iterations: int = 200,
    refined: bool = True,
) -> ConeSolution:
    """Minimise cost'x subject to b - A x in a cone, for every block (kind, A, b).

    Kinds are "zero", "nonnegative", "second order" (the first entry is the bound) and "psd", whose rows are `svec` of
    its matrices. A is dense or scipy-sparse with len(cost) columns.
    The multipliers z satisfy cost + sum A'z = 0 up to the solver's tolerance. Where the tolerance is coarse,
    steps need not be `refined` to the last digit, which saves a third; what does not end as solved is solved again
    with that.
    """
    from scipy import sparse

    if any(sparse.issparse(A) for _, A, _ in blocks):
        A = sparse.vstack([sparse.csc_matrix(A) for _, A, _ in blocks], format="csc")
    else:  # converted once, not block by block: small problems are posed by the hundred
        A = sparse.csc_matrix(np.vstack([A for _, A, _ in blocks]))
    cones = [(kind, b) for kind, _, b in blocks]
    return solve_cone_program_of(
        cost, A, cones, tolerance=tolerance, budget=budget, iterations=iterations, refined=refined
    )


def solve_cone_program_of(
    cost: Array,
    A: csc_matrix,
    blocks: Sequence[tuple[str, Array]],
    *,
    tolerance: float = TOLERANCE,
    budget: float | None = None,
    iterations: int = 200,
    refined: bool = True,
) -> ConeSolution:
    """The same for A in one piece, sparse, whose rows are those of the blocks (kind, b) in their order."""
    from scipy import sparse

    cl = clarabel()
    kinds = _cones() | {"psd": cl.PSDTriangleConeT}
    sizes = [np.asarray(b).size for _, b in blocks]
    cones = [kinds[kind](_order(m) if kind == "psd" else m) for (kind, _), m in zip(blocks, sizes, strict=True)]
    b = np.concatenate([np.asarray(b, dtype=float).ravel() for _, b in blocks])
    settings = quiet_settings(tolerance, iterations)
    settings.iterative_refinement_enable = refined
    if budget is not None:
        settings.time_limit = float(budget)
    parts = sparse.csc_matrix((len(cost), len(cost))), np.asarray(cost, dtype=float), A, b, cones
    given = Budget(budget)
    found = cl.DefaultSolver(*parts, settings).solve()
    if not refined and str(found.status) not in ("Solved", "MaxTime"):
        settings.iterative_refinement_enable = True
        if budget is not None:
            settings.time_limit = given.left
        found = cl.DefaultSolver(*parts, settings).solve()
    raw = str(found.status)
    record = SolverRecord(
        name="Clarabel", version=str(cl.__version__), status=_CLARABEL_STATUS.get(raw, FAILED),
        iterations=int(found.iterations),
        details={"raw_status": raw, "tolerance": tolerance, "rows": int(b.size), "columns": len(cost)},
    )  # fmt: skip
    pieces = np.split(np.asarray(found.z, dtype=float), np.cumsum(sizes)[:-1])
    z = tuple(smat(p) if kind == "psd" else p for (kind, _), p in zip(blocks, pieces, strict=True))
    return ConeSolution(np.asarray(found.x, dtype=float), z, record)


_CLARABEL_STATUS = {
    "Solved": SOLVED,
    "AlmostSolved": INACCURATE,
    "InsufficientProgress": INACCURATE,
    "PrimalInfeasible": INFEASIBLE,
    "AlmostPrimalInfeasible": INFEASIBLE,
    "DualInfeasible": UNBOUNDED,
    "AlmostDualInfeasible": UNBOUNDED,
    "MaxIterations": BUDGET,
    "MaxTime": BUDGET,
}


def _order(length: int) -> int:
    """n of a triangle of n(n+1)/2 entries."""
    return int((np.sqrt(8 * length + 1) - 1) / 2)


class ConeSolver:
    """Minimise cost'x subject to b - A x in a cone, many times: A stays, `cost` and b may change.

    Parameters
    ----------
    A : scipy sparse (m, k) matrix
    cones : sequence of ("zero" | "nonnegative" | "second order", size)
        In the order of the rows of A.
    tolerance : float
    iterations : int
    scaled : bool
        Entries are of size one: no equilibration, and steps are not refined, which saves half of the time. What ends
        with its two sides further apart than `NEARLY` times the tolerance is solved again with both, and so is
        everything after it: what is hard for one cost is hard for others, and the solver's memory is held once.
    rough : float, optional
        Tolerance that is enough where A has more than `LARGE` entries: steps are not refined there, which saves three
        fifths. What does not end as solved is solved again as any other, and so is everything after it.
    """

    def __init__(
        self,
        A: csc_matrix,
        cones: Sequence[tuple[str, int]],
        *,
        tolerance: float = TOLERANCE,
        iterations: int = 200,
        scaled: bool = False,
        rough: float | None = None,
    ) -> None:
        from scipy import sparse

        kinds, hasty = _cones(), rough is not None and A.nnz > LARGE
        settings = quiet_settings(rough if hasty else tolerance, iterations)
        settings.presolve_enable = False  # what is solved again must keep its rows
        settings.iterative_refinement_enable = not (scaled or hasty)
        if scaled:
            settings.equilibrate_enable = False
            settings.reduced_tol_gap_abs = settings.reduced_tol_gap_rel = NEARLY * tolerance
        self._again = partial(ConeSolver, A, tuple(cones), tolerance=tolerance, iterations=iterations)
        self._scaled, self._rough, self._unrefined = scaled, rough, scaled or hasty
        self._careful: ConeSolver | None = None
        self._rows, self._columns = A.shape
        self._parts = (
            sparse.csc_matrix((self._columns, self._columns)),
            sparse.csc_matrix(A),
            [kinds[kind](size) for kind, size in cones],
            settings,
        )
        self._solver: DefaultSolver | None = None

    def solve(self, cost: Array, b: Array) -> tuple[Array, Array, str]:
        """Return the point, the multipliers (cost + A'z = 0) and how the solver ended; all of it unchecked."""
        if self._careful is not None:
            return self._careful.solve(cost, b)
        if self._solver is None:
            P, A, cones, settings = self._parts
            self._solver = clarabel().DefaultSolver(
                P, np.asarray(cost, float), A, np.asarray(b, float), cones, settings
            )
        else:
            self._solver.update(q=np.asarray(cost, float), b=np.asarray(b, float))
        found = self._solver.solve()
        status = _CLARABEL_STATUS.get(str(found.status), FAILED)
        if self._unrefined and str(found.status) not in ("Solved", "AlmostSolved"):
            self._careful, self._solver = self._again(), None
            return self._careful.solve(cost, b)
        return np.asarray(found.x), np.asarray(found.z), status

    def __reduce__(self) -> tuple[object, ...]:
        """Another process sets it up anew: Clarabel's own objects stay where they are."""
        return partial(self._again, scaled=self._scaled, rough=self._rough), ()
