"""The plant split in two: the modes that must be observed, and those that decay by themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import numpy.typing as npt
from scipy.linalg import lapack, qr, solve_triangular

from sampling_design.errors import MathematicsError
from sampling_design.plants.clusters import (
    CLUSTER_CAP,
    EigenvalueCluster,
    SchurForm,
    balanced_schur,
    clusters_of,
    eigenvalue_clusters,
    format_eigenvalue,
)
from sampling_design.plants.plant import Plant, Signals, replace_matrices
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Complex, freeze
from sampling_design.records.record import PlainRecord, TableRecord, counted, short
from sampling_design.records.signatures import checked

__all__ = ["EigenvalueCluster", "ModalSplit", "eigenvalue_clusters", "split_modes"]

Bases = tuple[Array, Array, Array]
"""Right and left basis of a part in the plant's own coordinates, and the part's A."""
NOTHING = 4.0  # times the rounding of a basis: entries of a part's C below are zero, as an unobservable mode's are
MOST_NOTHING = 1e-10  # entries wrong by no more could hide a mode, wherever modes are called unobservable
OFFSET = 1e-8  # stability margin in units of |A|: the spread of a double eigenvalue under rounding


@dataclass(frozen=True, eq=False, repr=False)
class ModalSplit(TableRecord, PlainRecord):
    """A plant split into a retained and a residual part.

        x = basis_retained z_r + basis_residual z_s,    z_r = left_retained x,    z_s = left_residual x

    Attributes
    ----------
    plant : Plant
        What was split.
    decay_rate : float
        Rate asked of the *squared* error [1/time]; the line is Re = -decay_rate/2.
    retained, residual : Plant
        z_r' = A_r z_r + ..., y_r = C_r z_r + D u; and z_s' = A_s z_s + ..., y_s = C_s z_s (its D is
        zero, so that y = y_r + y_s). Either may have no states. If nothing is residual, `retained` is
        the plant itself in its own coordinates.
    basis_retained, basis_residual : (n, n_r), (n, n_s) arrays
        Right bases in the plant's own coordinates, orthonormal where each state is counted in its scale: the length of
        z_r is that of the state basis_retained z_r, in units of the scales.
    left_retained, left_residual : (n_r, n), (n_s, n) arrays
        Left bases; together the inverse of the right ones.
    separation : float
        Estimate (LAPACK, 1-norm, within a factor sqrt(n_r n_s)) of sep(A_r, A_s) = min |A_r X - X A_s|/|X|
        in balanced coordinates [1/time]; inf if a part is empty.
    condition : float
        Condition number of the transformation in balanced coordinates, 1 at best.
    near_line : (m,) complex array
        Eigenvalues too near the line to be sure on which side they lie.
    offset : float
        The stability offset that was used [1/time].
    clusters : tuple of EigenvalueCluster
        All groups of eigenvalues of the plant.
    retained_clusters : tuple of EigenvalueCluster
        Those that are retained.
    """

    plant: Plant
    decay_rate: float
    retained: Plant
    residual: Plant
    basis_retained: Array
    basis_residual: Array
    left_retained: Array
    left_residual: Array
    separation: float
    condition: float
    near_line: Complex
    offset: float
    clusters: tuple[EigenvalueCluster, ...]
    retained_clusters: tuple[EigenvalueCluster, ...]

    _frame = "clusters{eigenvalue:value multiplicity index radius uncertainty}"
    _plain = (
        "decay_rate retained_states:retained.n_states residual_states:residual.n_states "
        "modes:_modes near_line separation condition"
    )

    def _modes(self) -> list[dict[str, object]]:
        """The clusters, for plain data."""
        kept = self.retained_clusters
        return [
            {"eigenvalue": c.value, "multiplicity": c.multiplicity, "index": c.index, "retained": c in kept}
            for c in self.clusters
        ]

    def _rows(self) -> list[tuple[str, str]]:
        near = (format_eigenvalue(value, grain=1e-4 * self.offset) for value in self.near_line)
        return [
            ("retained", f"{self.retained.n_states} of {self.plant.n_states} states"),
            ("line", f"Re >= {short(0.0 - self.decay_rate / 2)} 1/{self.plant.time_unit}"),
            ("eigenvalues retained", _listed(self.retained_clusters)),
            ("eigenvalues residual", _listed(c for c in self.clusters if c not in self.retained_clusters)),
            ("too near the line", ", ".join(near) or "none"),
            ("separation", short(self.separation, 3)),
            ("condition", short(self.condition, 3)),
        ]

    def explain(self) -> str:
        """Say what is retained and what that means."""
        if self.retained.n_states == 0:
            return (
                "Nothing is retained: every mode decays at the rate asked for, so no samples are needed. "
                "Ask for a faster decay with `decay_rate` (--decay-rate) to have slow modes observed."
            )
        said = (
            f"{self.retained.n_states} of {self.plant.n_states} states must be observed; the others decay by "
            "themselves at the rate asked for."
        )
        if not self.near_line.size:
            return said
        kept = np.isin(self.near_line, np.concatenate([cluster.members for cluster in self.retained_clusters])).all()
        consequence = "retained, which is the safe side" if kept else "not all of them retained"
        many, verb = self.near_line.size, "lies" if self.near_line.size == 1 else "lie"
        return f"{said} {counted(many, 'eigenvalue')} {verb} at that rate within rounding: {consequence}."


def _listed(clusters: object) -> str:
    words = []
    for c in clusters:  # type: ignore[attr-defined]
        words.append(c.label() + (f" (x{c.multiplicity}, index {c.index})" * (c.multiplicity > 1)))
    return ", ".join(words) or "none"


@checked
def split_modes(
    plant: Plant,
    decay_rate: float = 0.0,
    *,
    offset: float | None = None,
    rounding: float | None = None,
    cluster_cap: float = CLUSTER_CAP,
) -> ModalSplit:
    """Split a plant into the modes that must be observed and those that decay fast enough by themselves.

        retained:  Re lambda >= -decay_rate/2 - offset

    Parameters
    ----------
    plant : Plant
    decay_rate : float [1/time_unit]
        Rate of the *squared* error, >= 0: the error of a residual mode falls at least like
        e^{-decay_rate t/2}. Zero retains what is not asymptotically stable.
    offset : float, optional [1/time_unit]
        Width of the strip left of the line that is retained too. Default 1e-8 |A|, |A| the Frobenius
        norm after balancing.
    rounding : float, optional
        Relative backward error of A, default n eps (see `eigenvalue_clusters`).
    cluster_cap : float
        Widest group of eigenvalues that may count as one, as a fraction of |A|.

    Returns
    -------
    ModalSplit

    Raises
    ------
    ArgumentError
        If `decay_rate` or `offset` is negative.
    MathematicsError
        If LAPACK cannot reorder the Schur form (parts too close to be told apart).

    Notes
    -----
    *Claim.* A basis_retained = basis_retained A_r and A basis_residual = basis_residual A_s to rounding
    times `condition`. *Method.* Balance by powers of two, real Schur form, group the eigenvalues, move
    the retained ones to the top, and solve A_r X - X A_s = -A_12 for the decoupling; never a Jordan
    form. *Numerical aspects.* A group of
    eigenvalues is never torn: it is retained if its mean or any member is at or right of the line less
    the offset, because a retained decaying mode costs samples and a residual non-decaying one costs
    the proof. `near_line` lists every eigenvalue whose uncertainty (offset plus rounding times its
    group's condition) reaches across the line, and whole groups with members on both sides.

    References
    ----------
    The paper, Section V, coordinates (25) of the unstable part.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [0.0, -2.0]], [[1.0, 0.0]])
    >>> split = split_modes(plant)
    >>> split.retained.A, split.residual.A
    (array([[0.]]), array([[-2.]]))
    >>> split_modes(plant, decay_rate=4.0).retained is plant
    True
    """
    decay_rate = checks.nonnegative("decay_rate", decay_rate)
    n = plant.n_states
    error = n * np.finfo(float).eps if rounding is None else checks.positive("rounding", rounding)
    checks.positive("cluster_cap", cluster_cap)
    if n == 0:
        nothing = partial(ModalSplit, offset=0.0, clusters=(), retained_clusters=(), near_line=np.zeros(0, complex))
        return _split(plant, decay_rate, nothing)
    form = balanced_schur(plant.A)
    strip = OFFSET * form.speed if offset is None else checks.nonnegative("offset", offset)
    clusters, positions = clusters_of(form, error, cluster_cap)
    line = 0.0 - decay_rate / 2
    select = np.zeros(n, dtype=np.int32)
    kept, near = [], [np.zeros(0, dtype=complex)]
    for cluster, where in zip(clusters, positions, strict=True):
        if max(cluster.value.real, float(np.max(cluster.members.real))) >= line - strip:
            select[where] = 1
            kept.append(cluster)
        doubt = strip + cluster.uncertainty
        if abs(cluster.value.real - line) <= doubt or np.ptp(np.sign(cluster.members.real - line)) > 0:
            near.append(cluster.members)
    found = partial(
        ModalSplit, offset=strip, clusters=clusters, retained_clusters=tuple(kept), near_line=np.concatenate(near)
    )
    if select.all() or not select.any():
        return _split(plant, decay_rate, found, whole=bool(select.all()))
    parts, separation, condition = _decoupled(form, select)
    orthonormal = [_orthonormal(*part, plant.states.scales) for part in parts]
    slight = min(NOTHING * error * condition * (1 + form.speed / separation), MOST_NOTHING)
    return _split(plant, decay_rate, found, orthonormal, separation, condition, nothing=slight)


def _orthonormal(V: Array, L: Array, A: Array, scales: Array) -> Bases:
    """V R^-1, R L and R A R^-1, with the R that makes the columns of V R^-1, divided by `scales`, orthonormal."""
    Q, R = np.linalg.qr(V / scales[:, None])
    signs = np.where(np.diagonal(R) < 0, -1.0, 1.0)
    R = R * signs[:, None]
    return scales[:, None] * Q * signs, R @ L, solve_triangular(R, (R @ A).T, trans="T").T


def _decoupled(form: SchurForm, select: npt.NDArray[np.int32]) -> tuple[list[Bases], float, float]:
    """Reorder the Schur form, decouple its two blocks, and undo the balancing; their separation and condition."""
    n, r = select.size, int(select.sum())
    work = max(1, 2 * r * (n - r))
    T, Q, _, _, m, _, separation, info = lapack.dtrsen(select, form.T, form.Q, job="B", lwork=work, liwork=work)
    if info != 0 or m != r:
        raise MathematicsError(
            "the eigenvalues on the two sides of the line are too close to be separated in rounding. "
            "Move the line with `decay_rate` or `offset`."
        )
    X, scale, _ = lapack.dtrsyl(T[:r, :r], T[r:, r:], -T[:r, r:], isgn=-1)
    X = X / scale
    top, rest = Q[:, :r], Q[:, r:]
    complement, R = qr(top @ X + rest, mode="economic")
    A_s = solve_triangular(R, (R @ T[r:, r:]).T, trans="T").T
    condition = float(np.linalg.cond(np.hstack([top, complement])))
    d = form.d
    slow = d[:, None] * top, (top.T - X @ rest.T) / d, T[:r, :r]
    return [slow, (d[:, None] * complement, R @ rest.T / d, A_s)], float(separation), condition


def _split(
    plant: Plant, decay_rate: float, found: Callable[..., ModalSplit], parts: Sequence[Bases] = (),
    separation: float = np.inf, condition: float = 1.0, whole: bool = True, nothing: float = 0.0,
) -> ModalSplit:  # fmt: skip
    """Make the two plants and the record, which lacks them and their bases; without `parts` one is the whole plant."""
    n = plant.n_states
    undivided = (np.eye(n), np.eye(n), plant.A), (np.zeros((n, 0)), np.zeros((0, n)), np.zeros((0, 0)))
    (V_r, L_r, A_r), (V_s, L_s, A_s) = parts or (undivided if whole else undivided[::-1])
    return found(
        plant=plant, decay_rate=decay_rate, separation=separation, condition=condition,
        retained=plant if len(L_r) == n else _part(plant, A_r, V_r, L_r, "retained", plant.D, nothing),
        residual=_part(plant, A_s, V_s, L_s, "residual", np.zeros_like(plant.D), nothing),
        basis_retained=freeze(V_r), basis_residual=freeze(V_s), left_retained=freeze(L_r), left_residual=freeze(L_s),
    )  # fmt: skip


def _part(plant: Plant, A: Array, V: Array, L: Array, what: str, D: Array, nothing: float) -> Plant:
    """Return one part as a plant; its states carry no scales, since its basis is orthonormal in those of x.

    What an output shows of a state is zero where that is no more than `nothing` of what was added up, the rounding of
    the basis: left as it is, an unobservable mode would seem to be observed weakly.
    """
    C = plant.C @ V
    states = plant.states if A is plant.A else Signals(tuple(f"z{i + 1}" for i in range(L.shape[0])))
    C[np.abs(C) <= nothing * (np.abs(plant.C) @ np.abs(V))] = 0.0
    return replace(replace_matrices(plant, A, C, L, states), D=D, name=f"{plant.name} ({what})".strip())
