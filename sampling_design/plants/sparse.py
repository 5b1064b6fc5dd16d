"""Plants with thousands of states: the modes that must be observed, with a proof that none was missed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import ArpackError, eigsh, splu

from sampling_design.errors import ArgumentError, SolverError
from sampling_design.plants.modes import OFFSET
from sampling_design.plants.plant import ORDER, Plant, Signals
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.record import PlainRecord, short
from sampling_design.records.signatures import checked
from sampling_design.records.units import check_time_unit

EPS = float(np.finfo(float).eps)
MOST_STATES = 200_000
"""Factorisations beyond it take more memory than is usual."""
MOST_RETAINED = 100  # beyond, neither schedules nor certificates are worked out in bearable time
SHIFTS = 12  # of the line, until no eigenvalue is too near it to be counted
FURTHER = 4.0  # by how much a shift grows from one try to the next


@frozen
class SparsePlant(PlainRecord):
    """A linear plant with many states and sparse matrices.

        M x'(t) = A x(t) + B u(t) + G w(t),    y(t) = C x(t) + D u(t) + v(t)

    Parameters
    ----------
    A : (n, n) sparse or dense matrix
    C : (p, n) matrix
    mass : (n,) array, optional
        The diagonal of M, positive (capacities, masses lumped at nodes). Default ones.
    B : (n, m) matrix, optional
        Default: no inputs.
    D : (p, m) array, optional
        Default zero.
    G : (n, q) matrix, optional
        Default: a disturbance on every retained mode, in the modes' own coordinates.
    time_unit, name : str
    outputs, inputs, disturbances : Signals or sequence of str, optional
        As for `Plant`.

    Raises
    ------
    ArgumentError
        If shapes do not fit, an entry is no finite real number or `mass` is not positive.

    Notes
    -----
    Rates and times are in `time_unit`. What is proven of it needs a symmetric A (diffusion, conduction, networks
    of droop-controlled sources, RC circuits), or one whose diagonal outweighs the rest; see `split_sparse`.

    Examples
    --------
    >>> from scipy.sparse import diags_array
    >>> rod = SparsePlant(diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(500, 500)), [[1.0] + 499 * [0.0]])
    >>> rod.n_states
    500
    """

    _order: ClassVar[str] = ORDER.replace("Plant", "SparsePlant")
    A: Converted[npt.ArrayLike | sparse.sparray, sparse.csc_array]
    C: Converted[npt.ArrayLike | sparse.sparray, sparse.csr_array]
    _: KW_ONLY
    mass: Converted[npt.ArrayLike | None, Array] = None  # type: ignore[assignment]
    B: Converted[npt.ArrayLike | sparse.sparray | None, sparse.csr_array] = None  # type: ignore[assignment]
    D: Converted[npt.ArrayLike | None, Array] = None  # type: ignore[assignment]
    G: Converted[npt.ArrayLike | sparse.sparray | None, sparse.csr_array | None] = None  # type: ignore[assignment]
    time_unit: str = "s"
    name: str = ""
    outputs: Converted[Signals | Sequence[str] | None, Signals] = None  # type: ignore[assignment]
    inputs: Converted[Signals | Sequence[str] | None, Signals] = None  # type: ignore[assignment]
    disturbances: Converted[Signals | Sequence[str] | None, Signals | None] = None  # type: ignore[assignment]
    n_states: int = field(init=False)

    _plain = "name states:n_states entries:A.nnz outputs:outputs.names time_unit"

    def __post_init__(self) -> None:
        A = sparse.csc_array(_sparse("A", self.A))
        n = A.shape[0]
        if A.shape != (n, n) or not n:
            raise ArgumentError(f"`A` must be square with at least one state, got {A.shape[0]} x {A.shape[1]}.")
        if n > MOST_STATES:
            raise ArgumentError(f"`A` must have at most {MOST_STATES} states, got {n}.")
        C = _sparse("C", self.C)
        B = sparse.csr_array((n, 0)) if self.B is None else _sparse("B", self.B)
        G = None if self.G is None else _sparse("G", self.G)
        if C.shape[1] != n or not C.shape[0]:
            raise ArgumentError(f"`C` must have {n} columns and at least one row, got {C.shape[0]} x {C.shape[1]}.")
        for key, matrix in (("B", B), ("G", G)):
            if matrix is not None and matrix.shape[0] != n:
                raise ArgumentError(f"`{key}` must have {n} rows, got {matrix.shape[0]}.")
        mass = checks.vector("mass", np.ones(n) if self.mass is None else self.mass, n)
        if np.any(mass <= 0):
            raise ArgumentError(f"`mass` must be positive, got {short(float(mass.min()))}.")
        check_time_unit(self.time_unit)
        small = Plant(  # checks what a small plant checks, and holds the names
            np.zeros((0, 0)),
            np.zeros((C.shape[0], 0)),
            B=np.zeros((0, B.shape[1])),
            D=self.D,
            G=None if G is None else np.zeros((0, G.shape[1])),
            time_unit=self.time_unit,
            name=self.name,
            outputs=self.outputs,
            inputs=self.inputs,
            disturbances=None if G is None else self.disturbances,
        )
        values = {"A": A, "C": C, "mass": mass, "B": B, "D": small.D, "G": G, "n_states": n}
        names = {"outputs": small.outputs, "inputs": small.inputs}
        self._hold(**{**values, **names, "disturbances": None if G is None else small.disturbances})

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("states", str(self.n_states)),
            ("entries of A", str(self.A.nnz)),
            ("outputs", ", ".join(self.outputs.labels()[:8])),
            ("time unit", self.time_unit),
        ]

    def explain(self) -> str:
        """Say how large it is and what to do with it."""
        return (
            f"{self.n_states} states; `split_sparse` finds the modes that must be observed, as a plant to design for."
        )


@dataclass(frozen=True, eq=False, repr=False)
class SparseSplit(PlainRecord):
    """The modes of a sparse plant that do not decay fast enough, and the proof that there are no others.

        x = basis z + a part whose error decays at least like e^{-decay_rate t/2},    z = left x

    Attributes
    ----------
    plant : SparsePlant
    decay_rate : float
        Rate asked of the *squared* error [1/time].
    retained : Plant
        z' = diag(eigenvalues) z + ..., y = C basis z + D u; may have no states.
    basis : (n, r) array
        M-orthonormal: basis' M basis = I.
    left : (r, n) array
        basis' M.
    eigenvalues : (r,) array
        Descending [1/time].
    line : float
        All other eigenvalues lie left of it [1/time]; at most -decay_rate/2. Proven.
    proof : str
        "inertia" (as many positive pivots of A - line M as eigenvalues found) or "dominance" (weighted diagonal
        dominance: no eigenvalue right of the line).
    perturbation : float
        What rounding can move an eigenvalue by in that proof, residuals included [1/time]; `line` allows for it.
    clearance : float
        From the line to the nearest retained eigenvalue [1/time], larger than `perturbation`; inf
        where nothing is retained.
    """

    plant: SparsePlant
    decay_rate: float
    retained: Plant
    basis: Array
    left: Array
    eigenvalues: Array
    line: float
    proof: str
    perturbation: float
    clearance: float

    _table = {
        "retained": "{eigenvalues.size} of {plant.n_states} modes",
        "eigenvalues retained": "{eigenvalues:or none}",
        "all others left of": "{line} 1/{plant.time_unit}",
        "proof": "{proof}",
        "rounding moves by": "{perturbation:3}",
    }
    _plain = "states:plant.n_states decay_rate eigenvalues line proof perturbation clearance"

    def explain(self) -> str:
        """Say what is retained and why nothing else is."""
        kept = f"{self.eigenvalues.size} of {self.plant.n_states} modes must be observed"
        why = {
            "inertia": f"A - ({short(self.line)}) M has exactly as many positive pivots",
            "dominance": "a weighted diagonal dominance keeps every eigenvalue left of the line",
        }
        return f"{kept}; the others decay by themselves at the rate asked for ({why[self.proof]})."


@checked
def split_sparse(plant: SparsePlant, decay_rate: float = 0.0, *, offset: float | None = None) -> SparseSplit:
    """Find the modes of a sparse plant that must be observed, and prove that none was missed.

        retained:  lambda >= line,    line <= -decay_rate/2 - offset,    A v = lambda M v

    Parameters
    ----------
    plant : SparsePlant
        A symmetric; or, where nothing is to be retained, any A whose diagonal outweighs its rows in some weights.
    decay_rate : float [1/time_unit]
        Rate of the *squared* error, >= 0, as for `split_modes`.
    offset : float, optional [1/time_unit]
        Width of the strip left of the line that is retained too. Default 1e-8 |A|.

    Returns
    -------
    SparseSplit
        `retained` is a small `Plant`: count, design, certify and estimate with it.

    Raises
    ------
    ArgumentError
        If `decay_rate` or `offset` is negative, if more than 100 modes would be retained, or if A is not
        symmetric and no dominance shows that all of its modes decay.
    SolverError
        If eigenvalues crowd around the line or the eigenvalue solver does not find as many as there are.

    Notes
    -----
    *Claim.* All but the listed eigenvalues lie left of `line`. *Proof by inertia.* S = M^-1/2 A M^-1/2 is
    symmetric; P (S - line I) P' = L D L' + R with a computed R, so that by Sylvester and Weyl the number of
    positive pivots D is that of the eigenvalues of S right of the line, unless one lies within |R| of it; as
    many orthonormal vectors with Rayleigh quotients further away than their residuals are all there are.
    *Proof by dominance.* With v > 0 and Re a_ii v_i + sum |a_ij| v_j < -s v_i in every row, every eigenvalue has
    Re < -s (Gershgorin in the weights v; for a Metzler matrix this is its Perron certificate). *Numerical
    aspects.* Factors by SuperLU without pivoting off the diagonal; shift-and-invert Lanczos right of the
    spectrum; norms of R include what rounding can hide in it. The bounds are evaluated in doubles.

    References
    ----------
    Parlett, The Symmetric Eigenvalue Problem, 1998, chapters 3 and 4 (inertia, residual bounds).

    Examples
    --------
    >>> from scipy.sparse import diags_array
    >>> laplacian = diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(400, 400)).tolil()
    >>> laplacian[0, 0] = laplacian[-1, -1] = -1.0  # insulated ends: the mean temperature stays
    >>> split = split_sparse(SparsePlant(laplacian, [[1.0] + 399 * [0.0]]), decay_rate=1e-4)
    >>> split.eigenvalues.size, split.proof
    (1, 'inertia')
    """
    decay_rate = checks.nonnegative("decay_rate", decay_rate)
    root = np.sqrt(plant.mass)
    scale = sparse.diags_array(1 / root)
    S = sparse.csc_array(scale @ plant.A @ scale)
    size = float(np.max(abs(S).sum(axis=1)))
    strip = OFFSET * size if offset is None else checks.nonnegative("offset", offset)
    skew = float(np.max(abs(S - S.T).sum(axis=1)))  # half of it bounds what the skew part moves eigenvalues by
    symmetric = skew <= 4 * EPS * size
    line = -decay_rate / 2 - strip
    if not symmetric:
        if not _dominated(plant, -line):
            raise ArgumentError(
                f"`plant` has an A that is not symmetric (by {short(skew / size, 2)} of its size, in units "
                "of the masses) and no weighted diagonal dominance shows that all modes decay: nothing would prove "
                "that no mode was missed. Use a dense Plant and split_modes, or state A in symmetric form."
            )
        return _record(plant, decay_rate, np.zeros((plant.n_states, 0)), np.zeros(0), line, "dominance", 0.0)
    S = sparse.csc_array((S + S.T) / 2)
    forming = 4 * EPS * size  # of S itself
    step = max(strip, 64 * forming) or 1.0  # A is zero: any line left of it will do
    problem = ""
    for _ in range(SHIFTS):
        count, lost = _above(S, line)
        if count > MOST_RETAINED:
            raise ArgumentError(
                f"`decay_rate` {short(decay_rate)} would retain {count} modes, more than {MOST_RETAINED}: ask for a "
                "slower decay."
            )
        if np.isfinite(lost):
            values, vectors, residual = _rightmost(S, count, line, size)
            clearance = float(np.min(values, initial=np.inf)) - line
            apart = lost + forming + residual
            if values.size == count and clearance > 2 * apart and line + apart <= -decay_rate / 2:
                return _record(plant, decay_rate, vectors / root[:, None], values, line + apart, "inertia", apart)
            problem = (
                f"{count} eigenvalues are right of {short(line)}, {values.size} were found, rounding hides {apart:.1e}"
            )
        line -= step
        step *= FURTHER
    raise SolverError(f"The modes near the line could not be told apart from it: {problem}.", "crowded")


def _sparse(key: str, value: object) -> sparse.csr_array:
    matrix = sparse.csr_array(value) if sparse.issparse(value) else np.atleast_2d(checks.floats(key, value))
    if matrix.ndim != 2 or matrix.dtype.kind not in "fiu":
        raise ArgumentError(f"`{key}` must be a real matrix, got {matrix.ndim} dimensions of {matrix.dtype}.")
    matrix = sparse.csr_array(matrix.astype(np.float64))
    matrix.sum_duplicates()
    if not np.all(np.isfinite(matrix.data)):
        raise ArgumentError(f"`{key}` must hold finite numbers only.")
    matrix.data.flags.writeable = False
    return matrix


def _above(S: sparse.csc_array, line: float) -> tuple[int, float]:
    """How many eigenvalues of a symmetric S lie right of the line, and how far rounding moves them (inf: unknown)."""
    n = S.shape[0]
    shifted = sparse.csc_array(S - line * sparse.eye_array(n))
    try:
        lu = splu(
            shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True, "Equil": False}
        )
    except RuntimeError:  # exactly singular
        return 0, np.inf
    pivots = lu.U.diagonal()
    if not np.array_equal(lu.perm_r, lu.perm_c) or np.any(pivots == 0):
        return 0, np.inf
    order = np.argsort(lu.perm_c)
    L, D = sparse.csr_array(lu.L), sparse.diags_array(pivots)
    R = shifted[order][:, order] - (L @ D) @ L.T
    # each entry of L D L' is a sum of at most as many products as its row of L has entries; |L||D||L|' <= their sum
    longest = int(np.max(np.diff(L.indptr)))
    products = float(np.sum((L.multiply(L) @ abs(D)).data))
    lost = float(sparse.linalg.norm(R)) + (longest + 3) * EPS * products
    return int(np.sum(pivots > 0)), lost


def _rightmost(S: sparse.csc_array, count: int, line: float, size: float) -> tuple[Array, Array, float]:
    """The `count` rightmost eigenvalues with orthonormal vectors, and a bound on the error of all of them together."""
    n = S.shape[0]
    if not count:
        return np.zeros(0), np.zeros((n, 0)), 0.0
    if n <= 2 * MOST_RETAINED or count >= n // 2:
        values, vectors = np.linalg.eigh(S.toarray())
        values, vectors = values[-count:], vectors[:, -count:]
    else:
        right = _beyond(S, line, size)
        try:
            values, vectors = eigsh(S, k=count, sigma=right, which="LM", v0=np.ones(n), tol=0)
        except ArpackError as error:
            raise SolverError(f"The eigenvalue solver stopped: {error}", "arpack") from None
    V = np.linalg.qr(vectors)[0]
    H = V.T @ (S @ V)
    values, turn = np.linalg.eigh((H + H.T) / 2)
    V = V @ turn
    residual = np.asarray(S @ V - V * values)
    # V'V = I to rounding: Rayleigh quotients move by no more than that times |S|
    lost = float(np.linalg.norm(residual)) + float(np.linalg.norm(V.T @ V - np.eye(count))) * size
    return values[::-1].copy(), V[:, ::-1].copy(), lost


def _beyond(S: sparse.csc_array, line: float, size: float) -> float:
    """A number right of the whole spectrum, near it: where inverse iteration finds the rightmost modes first."""
    diagonal = S.diagonal()
    right = float(np.max(diagonal + np.asarray(abs(S).sum(axis=1)).ravel() - np.abs(diagonal)))  # Gershgorin
    right += max(OFFSET * size, 1e-3 * (right - line))
    while True:  # nearer, by halves, while it stays right of everything
        middle = line + (right - line) / 4
        count, lost = _above(S, middle)
        if count or not np.isfinite(lost) or right - line < OFFSET * size:
            return right
        right = middle


def _dominated(plant: SparsePlant, rate: float) -> bool:
    """Whether positive weights v with diag(A) v + |rest| v < -rate M v exist, and so every mode decays faster."""
    A = plant.A
    diagonal = A.diagonal()
    comparison = sparse.csc_array(abs(A - sparse.diags_array(diagonal)) + sparse.diags_array(diagonal))
    shifted = sparse.csc_array(comparison + rate * sparse.diags_array(plant.mass))
    try:
        v = splu(shifted).solve(-plant.mass)
    except RuntimeError:
        return False
    if not np.all(v > 0):
        return False
    rounding = 8 * EPS * (np.diff(comparison.tocsr().indptr).max() + 2) * (abs(shifted) @ v + rate * plant.mass * v)
    return bool(np.all(shifted @ v + rounding < 0))


def _record(
    plant: SparsePlant, decay_rate: float, basis: Array, values: Array, line: float, proof: str, lost: float
) -> SparseSplit:
    left = basis.T * plant.mass
    r = values.size
    retained = Plant(
        np.diag(values), np.asarray(plant.C @ basis).reshape(plant.C.shape[0], r),
        B=np.asarray((plant.B.T @ basis).T).reshape(r, plant.B.shape[1]), D=plant.D,
        G=None if plant.G is None else np.asarray((plant.G.T @ basis).T).reshape(r, plant.G.shape[1]),
        time_unit=plant.time_unit, name=f"{plant.name} (retained)".strip(), outputs=plant.outputs, inputs=plant.inputs,
        disturbances=plant.disturbances,
    )  # fmt: skip
    return SparseSplit(
        plant=plant, decay_rate=decay_rate, retained=retained, basis=freeze(basis), left=freeze(left),
        eigenvalues=freeze(values), line=float(line), proof=proof, perturbation=float(lost),
        clearance=float(np.min(values, initial=np.inf) - line),
    )  # fmt: skip
