"""Modes that no output sees: the Popov-Belevitch-Hautus test, scaled, with its tolerance named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sampling_design.errors import NotObservableError
from sampling_design.numerics.linalg import balanced, balanced_rows, positive_or_one, right_directions
from sampling_design.plants.clusters import (
    CLUSTER_CAP,
    SPREAD,
    EigenvalueCluster,
    SchurForm,
    balanced_schur,
    clusters_of,
    format_eigenvalue,
    invariant_subspace,
)
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Complex
from sampling_design.records.declarations import Column, below
from sampling_design.records.kept import kept
from sampling_design.records.record import ListRecord
from sampling_design.records.signatures import checked

EPS = float(np.finfo(float).eps)
RANK_TOLERANCE = 1e-10
"""A mode counts as unobservable if entries of A and C that are wrong by this part of themselves could hide it: well
above what rounding does to the entries of a plant in awkward coordinates, far below what is known of any plant."""
ROUNDS = 4  # of rescaling by the direction found, until the scales are its own
CUTS = (0.0, 1e-15, 1e-13, 1e-11)  # entries of a direction below these, in its own scales, may be rounding

BARRED = 1e3  # weight of a direction that is already found: beyond all that the pencil weighs
APART = 0.3  # sine of the angle from which a direction is another one


@dataclass(frozen=True, eq=False, repr=False)
class UnobservableModes(ListRecord[complex]):
    """Modes of a plant that no output sees, however often it is sampled.

    Attributes
    ----------
    eigenvalues : (m,) complex array [1/time]
        One entry per independent unobservable eigenvector.
    directions : (n, m) complex array
        Those eigenvectors in the plant's own coordinates, of norm 1: A d = lambda d, C d = 0.
    margin : float
        Least relative change of the entries of A and C, as found, that would hide a mode that was judged *observable*;
        infinite if there is none. At most 1. Near the tolerance the verdict is in doubt.
    tolerance : float
        Below which it counts as zero.
    names : tuple of str
        Names of the states.
    """

    eigenvalues: Complex
    directions: Complex
    margin: float
    tolerance: float
    names: tuple[str, ...]

    _table = {
        "unobservable": "{__len__}",
        "modes": "{describe:or -}",
        "margin": "{margin:3}",
        "tolerance": "{tolerance:3}",
    }

    def _entries(self) -> Sequence[complex]:
        return [complex(each) for each in self.eigenvalues]

    def _columns(self) -> dict[str, Column]:
        return {"eigenvalue": self.eigenvalues, **dict(zip(self.names, self.directions, strict=True))}

    def describe(self) -> str:
        """Name each unobservable eigenvalue with its direction."""
        return "; ".join(
            f"{format_eigenvalue(value)} along {_direction(d, self.names)}"
            for value, d in zip(self.eigenvalues, self.directions.T, strict=True)
            if value.imag >= 0
        )

    def explain(self) -> str:
        """Say which modes are unobservable."""
        if not len(self):
            least = below(self.margin, 3)
            off = f"entries of A and C off by {least} of themselves could hide one"
            return f"Every mode is observable from some output ({off})."
        return f"No output observes the eigenvalue {self.describe()}."


@checked
def unobservable_modes(
    plant: Plant, decay_rate: float | None = None, *, rtol: float = RANK_TOLERANCE
) -> UnobservableModes:
    """Return the eigenvalues and directions of a plant that no output sees.

        A d = lambda d,    C d = 0,    d != 0

    Parameters
    ----------
    plant : Plant
    decay_rate : float, optional
        Report only modes with Re lambda >= -decay_rate/2 (those that keep the squared error from decaying at
        `decay_rate`); None reports all.
    rtol : float
        Relative rank tolerance, see Notes.

    Returns
    -------
    UnobservableModes
        Empty if every (such) mode is seen.

    Raises
    ------
    ArgumentError
        If `decay_rate` is negative or `rtol` not positive.

    Notes
    -----
    *Method.* A mode (lambda, d) is unobservable if |A d - lambda d| <= `rtol` (|A| + |lambda|) |d| and
    |C d| <= `rtol` |C| |d|, entry by entry: then it is an exactly unobservable mode of matrices whose entries differ by
    no more than that part of themselves (Oettli and Prager). Units of states, outputs and time change neither side.
    Candidates d are the least observed directions of the invariant subspace of each group of eigenvalues that rounding
    cannot tell apart, lambda its mean, refined by singular vectors of the pencil [A - lambda I; C] in the scales of
    d itself. *Numerical aspects.* The mean of a group is known far better than its members, which a defective
    eigenvalue scatters by eps^{1/m}. `margin` is what this search finds, within a factor of ten.

    References
    ----------
    Hautus, Controllability and observability conditions of linear autonomous systems (1969).

    Examples
    --------
    >>> modes = unobservable_modes(Plant([[0.0, 1.0], [0.0, 0.0]], [[0.0, 1.0]], states=["position", "velocity"]))
    >>> modes.explain()
    'No output observes the eigenvalue 0 along position.'
    """
    offset = None if decay_rate is None else checks.nonnegative("decay_rate", decay_rate) / 2
    tolerance = checks.positive("rtol", rtol)
    n = plant.n_states
    values: list[complex] = []
    vectors: list[Complex] = []
    margin = np.inf
    form, grouped = _grouped(plant.A, plant.C)
    pair = _BalancedPair(plant, form)
    known: dict[complex, tuple[list[Complex], float]] = {}
    for cluster, group in grouped:
        if offset is not None and cluster.value.real < -offset - 1e-8 * form.speed:
            continue
        mirror = known.get(cluster.value.conjugate()) if cluster.value.imag < 0 else None
        if mirror is None:
            directions, residual = known[cluster.value] = pair.unobservable(cluster, group, tolerance)
        else:
            directions, residual = [d.conj() for d in mirror[0]], mirror[1]
        if not directions:
            margin = min(margin, residual)
        vectors.extend(directions)
        values.extend([pair.value(cluster)] * len(directions))
    found = np.column_stack(vectors) if vectors else np.zeros((n, 0), dtype=complex)
    return UnobservableModes(np.array(values, dtype=complex), found, margin, tolerance, plant.states.names)


@kept
def _grouped(A: Array, C: Array) -> tuple[SchurForm, tuple[tuple[EigenvalueCluster, list[int]], ...]]:
    """The Schur form, and its clusters of eigenvalues with their places on the diagonal."""
    form = balanced_schur(A, C)
    if not len(A):
        return form, ()
    clusters, places = clusters_of(form, len(A) * EPS, CLUSTER_CAP)
    return form, tuple(zip(clusters, places, strict=True))


class _BalancedPair:
    """A and C in balanced coordinates x = diag(d) z."""

    def __init__(self, plant: Plant, form: SchurForm) -> None:
        self.form, self.d = form, form.d
        self.A, self.C = balanced(plant.A, form.d), balanced_rows(plant.C, form.d)
        self.size = np.vstack([np.abs(self.A), np.abs(self.C)])

    def noise(self, cluster: EigenvalueCluster) -> float:
        """What rounding does to the mean of a group of eigenvalues."""
        return SPREAD * len(self.A) * EPS * self.form.norm * cluster.projector_norm

    def value(self, cluster: EigenvalueCluster) -> complex:
        """The mean: a zero that is known to rounding only is zero, and no number to hold entries against."""
        return 0j if abs(cluster.value) <= self.noise(cluster) else cluster.value

    def unobservable(
        self, cluster: EigenvalueCluster, group: list[int], tolerance: float
    ) -> tuple[list[Complex], float]:
        """Independent unobservable directions of one group of eigenvalues; the error of the first observable one."""
        X, T = invariant_subspace(self.form, group)
        noise, value = self.noise(cluster), self.value(cluster)
        inner = T - value * np.eye(len(group))
        size = float(np.linalg.norm(inner))
        reach = np.linalg.norm(X, axis=1)
        terms = np.abs(self.C) @ reach
        small = np.vstack([inner / size if size > noise else 0 * inner, self.C @ X / positive_or_one(terms)[:, None]])
        found: list[Complex] = []
        while len(found) < len(group):
            taken = np.array([X.conj().T @ z for z in found]).reshape(-1, len(group))
            right = right_directions(np.vstack([small, BARRED * taken.conj()]))[1]
            z, error = self._refined(value, X @ right[-1].conj(), reach, found)
            if error > tolerance:
                break
            found.append(z / np.linalg.norm(z))
        physical = [self.d * z for z in found]
        return [x / np.linalg.norm(x) for x in physical], error

    def _refined(self, value: complex, z: Complex, reach: Array, found: list[Complex]) -> tuple[Complex, float]:
        """The direction near z with the least error: singular vectors of the pencil in the scales of z, in rounds."""
        pencil = np.vstack([self.A - value * np.eye(len(self.A)), self.C])
        best, least = z, self.error(value, z) if _apart(z, found, reach) else np.inf
        scale = reach
        for _ in range(ROUNDS):
            w = np.maximum(scale, EPS * np.max(scale))
            rows = positive_or_one(self._entries(value, w))
            scaled = pencil * w / rows[:, None]
            kept = np.array([z.conj() / w for z in found]).reshape(-1, w.size)
            kept /= positive_or_one(np.linalg.norm(kept, axis=1))[:, None]
            u = right_directions(np.vstack([scaled, BARRED * kept]))[1][-1].conj()
            for cut in CUTS:
                candidate = w * np.where(np.abs(u) > cut * np.max(np.abs(u)), u, 0)
                error = self.error(value, candidate)
                if error < least and _apart(candidate, found, reach):
                    best, least = candidate, error
            scale = np.abs(w * u)
        return best, least

    def _entries(self, value: complex, size: Array) -> Array:
        """(|A| + |value|) size and |C| size."""
        total = self.size @ size
        total[: size.size] += abs(value) * size
        return np.asarray(total)

    def error(self, value: complex, z: Complex) -> float:
        """Least relative change of the entries of A and C that makes (value, z) an exactly unobservable mode."""
        left = np.abs(np.concatenate([self.A @ z - value * z, self.C @ z]))
        return float(np.max(left / positive_or_one(self._entries(value, np.abs(z)))))


@checked
def require_observable(plant: Plant, purpose: str, decay_rate: float | None = None) -> None:
    """Raise if some mode is observed by no output.

    Parameters
    ----------
    plant : Plant
    purpose : str
        What needs it; begins the message.
    decay_rate : float
        As for `unobservable_modes`. Instead of a part that was split off ask the plant: the part's coordinates hold
        rounding, which may show what no output observes.

    Returns
    -------
    None

    Raises
    ------
    NotObservableError
        If a mode is unobservable; carries the eigenvalues and directions.
    """
    hidden = unobservable_modes(plant, decay_rate)
    if len(hidden):
        raise NotObservableError(
            f"{purpose} needs every mode to be observable; unobservable: {hidden.describe()}. Add an output that "
            "observes it, split it off (split_modes) if it decays, or ask only `of` rows that it does not enter.",
            hidden.eigenvalues,
            hidden.directions,
        )


def observable_rank(plant: Plant, outputs: list[int]) -> int:
    """Return the dimension of what the given outputs see together, the rank of [C; CA; ...; CA^{n-1}].

    Notes
    -----
    *Method.* The sum over groups of eigenvalues of the rank of [C X; C X N; C X N^2; ...], X a basis of the group's
    invariant subspace and N what A does there beside its mean. *Numerical aspects.* A row counts relative to what
    |C||X| could show, so that neither fast modes nor units of the outputs decide; singular values below
    `RANK_TOLERANCE` are zero.
    """
    form, grouped = _grouped(plant.A, plant.C)
    C = balanced_rows(plant.C[outputs], form.d)
    rank = 0
    for cluster, group in grouped:
        X, T = invariant_subspace(form, group)
        inner = T - cluster.value * np.eye(len(group))
        noise = SPREAD * len(plant.A) * EPS * form.norm * cluster.projector_norm
        size = float(np.linalg.norm(inner))
        N = inner / size if size > noise else 0 * inner
        rows = C @ X / positive_or_one(np.abs(C) @ np.linalg.norm(X, axis=1))[:, None]
        stack = [rows]
        for _ in range(1, len(group)):
            stack.append(stack[-1] @ N)
        rank += int(np.sum(np.linalg.svd(np.vstack(stack), compute_uv=False) > RANK_TOLERANCE))
    return rank


def _apart(z: Complex, found: list[Complex], scale: Array) -> bool:
    """Whether z is more than a combination of those found, in the given scales."""
    if not found:
        return True
    w = np.maximum(scale, np.sqrt(EPS) * np.max(scale))
    basis = np.linalg.qr(np.column_stack([f / w for f in found]))[0]
    u = z / w
    return bool(np.linalg.norm(u - basis @ (basis.conj().T @ u)) > APART * np.linalg.norm(u))


def _direction(vector: Complex, names: tuple[str, ...]) -> str:
    """The states that take part in an unobservable direction, the largest first."""
    size = np.abs(vector)
    order = np.argsort(-size, kind="stable")
    part = [int(i) for i in order if size[i] > 1e-6 * size[order[0]]]
    if len(part) == 1:
        return names[part[0]]
    lead = vector / vector[part[0]]
    terms = [f"{format_eigenvalue(complex(np.round(lead[i], 6)), 4)} {names[i]}" for i in part[:6]]
    return ", ".join(terms) + (", ..." if len(part) > 6 else "")


def spectrum(clusters: tuple[EigenvalueCluster, ...]) -> Complex:
    """Return the eigenvalues, each group's mean repeated by its multiplicity."""
    return np.array([c.value for c in clusters for _ in range(c.multiplicity)], dtype=complex)
