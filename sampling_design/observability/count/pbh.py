"""Modes that no output sees: the Popov-Belevitch-Hautus test, scaled, with its tolerance named."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._record import Record, short
from sampling_design.errors import NotObservableError
from sampling_design.plants.clusters import EigenvalueCluster, balanced_schur, eigenvalue_clusters, format_eigenvalue
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

RANK_TOLERANCE = 1e-10
"""A singular value of the scaled pencil below this counts as zero: above the error of a computed eigenvalue
(its condition number times eps, 1e-12 for a condition of 1e4), far below the coupling of any plant that its
outputs see in practice."""


@dataclass(frozen=True, eq=False, repr=False)
class UnseenModes(Record):
    """Modes of a plant that no output sees, however often it is sampled.

    Attributes
    ----------
    eigenvalues : (m,) complex array [1/time]
        One entry per independent unseen eigenvector.
    directions : (n, m) complex array
        Those eigenvectors in the plant's own coordinates, of norm 1: A d = lambda d, C d = 0.
    margin : float
        Least singular value of the scaled pencil [(A - lambda I)/|A|; C/|C|] over the eigenvalues that were
        judged *seen*; infinite if there is none. Near the tolerance the verdict is in doubt.
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

    def __len__(self) -> int:
        return self.eigenvalues.size

    def describe(self) -> str:
        """Name each unseen eigenvalue with its direction."""
        return "; ".join(
            f"{format_eigenvalue(value)} along {_direction(d, self.names)}"
            for value, d in zip(self.eigenvalues, self.directions.T, strict=True)
            if value.imag >= 0
        )

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("unseen", str(len(self))),
            ("modes", self.describe() or "-"),
            ("margin", short(self.margin, 3)),
            ("tolerance", short(self.tolerance, 3)),
        ]

    def explain(self) -> str:
        """Say which modes are unseen."""
        if not len(self):
            return f"Every mode is seen by some output (least scaled singular value {short(self.margin, 3)})."
        return f"No output sees {self.describe()}."


def unseen_modes(plant: Plant, rate: float | None = None, *, rtol: float = RANK_TOLERANCE) -> UnseenModes:
    """Return the eigenvalues and directions of a plant that no output sees.

        A d = lambda d,    C d = 0,    d != 0

    Parameters
    ----------
    plant : Plant
    rate : float, optional
        Report only modes with Re lambda >= -rate/2 (those that keep the squared error from decaying at
        `rate`); None reports all.
    rtol : float
        Relative rank tolerance, see Notes.

    Returns
    -------
    UnseenModes
        Empty if every (such) mode is seen.

    Raises
    ------
    ArgumentError
        If `rate` is negative or `rtol` not positive.

    Notes
    -----
    *Method.* A is balanced by a diagonal similarity, the columns of C go with it, then A is divided by its
    norm and each row of C by its own. A mode is unseen if [A - lambda I; C], lambda the mean of a group of
    eigenvalues that rounding cannot tell apart, has a singular value below `rtol`. *Numerical aspects.*
    The mean of a group is known far better than its members, which a defective eigenvalue scatters by eps^{1/m}.

    References
    ----------
    Hautus, Controllability and observability conditions of linear autonomous systems (1969).

    Examples
    --------
    >>> modes = unseen_modes(Plant([[0.0, 1.0], [0.0, 0.0]], [[0.0, 1.0]], states=["position", "velocity"]))
    >>> modes.explain()
    'No output sees 0 along position.'
    """
    offset = None if rate is None else _checks.nonnegative("rate", rate) / 2
    tolerance = _checks.positive("rtol", rtol)
    A, C, d = _scaled_pair(plant.A, plant.C)
    n, norm = plant.n_states, float(np.linalg.norm(A))
    values: list[complex] = []
    vectors: list[Complex] = []
    margin = np.inf
    for cluster in eigenvalue_clusters(plant.A):
        if offset is not None and cluster.value.real < -offset - 1e-8 * norm:
            continue
        pencil = np.vstack([(A - cluster.value * np.eye(n)) / (norm or 1.0), C])
        _, sizes, right = np.linalg.svd(pencil)
        null = sizes < tolerance
        if not null.any():
            margin = min(margin, float(sizes[-1]))
        found = right.conj().T[:, null] * d[:, None]
        vectors.extend((v / np.linalg.norm(v)).astype(complex) for v in found.T)
        values.extend([cluster.value] * int(null.sum()))
    directions = np.column_stack(vectors) if vectors else np.zeros((n, 0), dtype=complex)
    return UnseenModes(np.array(values, dtype=complex), directions, margin, tolerance, plant.states.names)


def require_observable(plant: Plant, purpose: str, *, rtol: float = RANK_TOLERANCE) -> None:
    """Raise if some mode is seen by no output.

    Parameters
    ----------
    plant : Plant
    purpose : str
        What needs it; begins the message.
    rtol : float
        As for `unseen_modes`.

    Returns
    -------
    None

    Raises
    ------
    NotObservableError
        If a mode is unseen; carries the eigenvalues and directions.
    """
    unseen = unseen_modes(plant, rtol=rtol)
    if len(unseen):
        raise NotObservableError(
            f"{purpose} needs every mode to be seen by some output; unseen: {unseen.describe()}. "
            "Add an output that sees it, or split it off (split_modes) if it decays.",
            unseen.eigenvalues,
            unseen.directions,
        )


def observable_rank(plant: Plant, outputs: list[int], *, rtol: float = RANK_TOLERANCE) -> int:
    """Return the dimension of what the given outputs see together, the rank of [C; CA; ...; CA^{n-1}].

    Notes
    -----
    *Method.* An orthonormal basis of the row space grows by A' in balanced coordinates; powers of A are
    never formed. *Numerical aspects.* Directions below `rtol` |A| are dropped.
    """
    A, C, _ = _scaled_pair(plant.A, plant.C[outputs])
    n = plant.n_states
    norm = float(np.linalg.norm(A)) or 1.0
    basis = np.zeros((n, 0))
    fresh = C.T
    while fresh.shape[1]:
        for _ in range(2):  # the second pass removes what rounding left of the first
            fresh = fresh - basis @ (basis.T @ fresh)
        left, sizes, _ = np.linalg.svd(fresh, full_matrices=False)
        left = left[:, sizes > rtol]
        basis = np.hstack([basis, left])
        fresh = A.T @ left / norm
    return basis.shape[1]


def _scaled_pair(A: Array, C: Array) -> tuple[Array, Array, Array]:
    """Balanced A, C with rows of norm 1 (zero rows stay), and d with x = diag(d) x_balanced."""
    if not A.shape[0]:
        return A, C, np.ones(0)
    d = balanced_schur(A).d
    scaled = C * d
    size = np.linalg.norm(scaled, axis=1, keepdims=True)
    return A * d / d[:, None], scaled / np.where(size > 0, size, 1.0), d


def _direction(vector: Complex, names: tuple[str, ...]) -> str:
    """The states that take part in an unseen direction, the largest first."""
    size = np.abs(vector)
    order = np.argsort(-size, kind="stable")
    part = [int(i) for i in order if size[i] > 1e-6 * size[order[0]]]
    if len(part) == 1:
        return names[part[0]]
    lead = vector / vector[part[0]]
    terms: list[Any] = [f"{format_eigenvalue(complex(np.round(lead[i], 6)), 4)} {names[i]}" for i in part[:6]]
    return ", ".join(terms) + (", ..." if len(part) > 6 else "")


def spectrum(clusters: tuple[EigenvalueCluster, ...]) -> Complex:
    """Return the eigenvalues, each group's mean repeated by its multiplicity."""
    return np.array([c.value for c in clusters for _ in range(c.multiplicity)], dtype=complex)
