"""Matrix exponentials through modal blocks: one matrix product for all times.

Balanced A = V blockdiag(mu_b I + N_b) W with W V = I, one block per cluster of eigenvalues, so that

    e^{A t} = sum_b sum_k e^{mu_b t} t^k/k! (V_b N_b^k W_b):

scalar coefficients times fixed matrices. Clusters are merged until V is well conditioned. V and N are
refined in extended precision: in a defective block a rounding of eps grows like t^{2m-1}, m its size.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from sampling_design.numerics.linalg import expm_batch
from sampling_design.records.arrays import Array, Index, Integers, Mask

Entries = npt.NDArray[Any]  # real or complex

CONDITION_LIMIT = 1e3  # of V with orthonormal columns per block: the factor by which rounding may grow
_RADIUS = 1e-8  # eigenvalues nearer than this times |A| always share a block (a double one splits by sqrt(eps))
_SPREAD = 0.5  # |t| times a block's spread of eigenvalues up to which its polynomial is used
_EXTRA_TERMS = 14  # beyond the block's size: 0.5^15/15! is below eps
_FAR = 1e4  # |t||A| up to which a block of equal eigenvalues gets as many terms as it needs
_CANCELLED = 200.0  # terms this much larger than their sum are added up by scaling and squaring instead
_LARGEST = 256  # states above which the dense route is taken: storage and refinement grow like n^3
_LONG = float(np.finfo(np.longdouble).eps)


@dataclass(frozen=True)
class _SpectralBlock:
    """One cluster: mean, remainder N, its columns V and rows W (physical coordinates), weight 2 for a pair."""

    mean: complex
    N: Entries
    V: Entries
    W: Entries
    weight: float
    reach: float
    terms: tuple[Entries, ...]


class ModalFlow:
    """e^{A t} for one matrix at many times.

    Attributes
    ----------
    route : str
        "modal" (polynomials in modal blocks), "mixed" (some block is so wide that it goes through
        scaling and squaring beyond a |t| below 1e4/|A|), or "dense" (scaling and squaring of balanced A).
    condition : float
        |V||W| of the modal transformation, infinity on the dense route.
    reason : str
        Why the dense route was taken; empty otherwise.
    """

    def __init__(self, A: Array) -> None:
        self.A = np.array(A, dtype=np.float64)
        self.n = self.A.shape[0]
        self._scale, self._balanced = _balance(self.A)
        blocks, self.condition, self.reason = _modal_blocks(self._balanced, self._scale)
        if self.reason and np.any(self._scale != 1):
            # balancing a reducible matrix has no end: it may hide a coupling that matters
            plain, condition, reason = _modal_blocks(self.A, np.ones(self.n))
            if not reason and not _wide(plain, self.A):
                blocks, self.condition, self.reason = plain, condition, ""
        self._blocks = blocks
        self._wide = [b for b, block in enumerate(blocks) if np.isfinite(block.reach)]
        self.route = "dense" if self.reason else ("mixed" if _wide(blocks, self._balanced) else "modal")
        self._layout()
        if self.route == "mixed" and not self._agrees():
            self.route, self.reason = "dense", "a wide block loses what the whole matrix keeps"

    def _agrees(self) -> bool:
        """Whether wide blocks and the dense route agree at |t||A| = 3 and 30, where the latter is good."""
        t = np.array([3.0, 30.0]) / np.linalg.norm(self._balanced)
        dense = self._dense(None, t)
        difference = np.linalg.norm(self(t) - dense, axis=(1, 2))
        return bool(np.all(difference <= 5e-13 * np.linalg.norm(dense, axis=(1, 2))))

    def _layout(self) -> None:
        """Flatten the blocks' matrices into one basis, a row of coefficients for each."""
        entries, pair = [], 0
        for b, block in enumerate(self._blocks):
            for k, term in enumerate(block.terms):
                entries.append((b, k, 2 * pair, block.weight * term.real))
                if block.weight == 2:
                    entries.append((b, k, 2 * pair + 1, -block.weight * term.imag))
            pair += block.weight == 2
        plain = 2 * pair  # the row of ones that real blocks use for their cosine
        self._index = np.array([b for b, *_ in entries], dtype=int)
        self._degree = np.array([k for _, k, *_ in entries], dtype=int)
        self._wave = np.array([w if self._blocks[b].weight == 2 else plain for b, _, w, _ in entries], dtype=int)
        self._basis = np.array([m for *_, m in entries], dtype=np.float64).reshape(len(entries), self.n, self.n)
        self._blocks = [replace(block, terms=()) for block in self._blocks]  # complex ones, twice as large
        self._growth = np.array([b.mean.real for b in self._blocks])
        self._frequency = np.array([b.mean.imag for b in self._blocks if b.weight == 2])
        self._sizes = _norms(self._basis)
        # |V_b e^{..} W_b| <= |V_b W_b| |e^{At}|: terms cancel at most by the sum of the projectors' norms
        self._delicate = bool(np.sum(self._sizes[self._degree == 0]) > _CANCELLED)

    def __call__(self, times: npt.ArrayLike) -> Array:
        """Return e^{A t} for every t, (N, n, n)."""
        return self.rows(None, times)

    def rows(self, C: Array | None, times: npt.ArrayLike) -> Array:
        """Return C e^{A t} for every t, (N, p, n); on the modal route without forming e^{A t}."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if self.route == "dense" or t.size == 0 or self.n == 0:
            return self._dense(C, t)
        basis = self._basis if C is None else C @ self._basis
        coefficients = self._coefficients(t)
        flat = coefficients.T @ basis.reshape(len(basis), -1)
        result = flat.reshape(t.size, -1, self.n)
        for block in (self._blocks[b] for b in self._wide):
            far = np.flatnonzero(np.abs(t) > block.reach)
            if far.size:
                inner = expm_batch(block.N, t[far]) * np.exp(block.mean * t[far])[:, None, None]
                result[far] += block.weight * ((block.V if C is None else C @ block.V) @ inner @ block.W).real
        if self._delicate:
            terms = (self._sizes if C is None else _norms(basis)) @ np.abs(coefficients)
            lost = terms > _CANCELLED * np.sqrt(np.einsum("ij,ij->i", flat, flat))
            lost &= np.abs(t) * np.linalg.norm(self._balanced) <= _FAR
            if lost.any():
                result[lost] = self._dense(C, t[lost])
        return np.asarray(result)

    def _dense(self, C: Array | None, t: Array) -> Array:
        """Scaling and squaring of the balanced matrix."""
        flow = expm_batch(self._balanced, t) * (self._scale[:, None] / self._scale)
        return np.asarray(flow if C is None else C @ flow)

    def _coefficients(self, t: Array) -> Array:
        """e^{Re mu t} t^k/k! cos or sin (Im mu t), one row per matrix of the basis."""
        growth = np.exp(self._growth[:, None] * t)
        for b in self._wide:
            growth[b, np.abs(t) > self._blocks[b].reach] = 0.0
        rows = growth[self._index]
        if self._frequency.size:
            waves = np.ones((2 * self._frequency.size + 1, t.size))
            angle = self._frequency[:, None] * t
            np.cos(angle, out=waves[:-1:2])
            np.sin(angle, out=waves[1::2])
            rows *= waves[self._wave]
        top = int(self._degree.max())
        if top:
            powers = np.ones((top + 1, t.size))
            for k in range(1, top + 1):
                np.multiply(powers[k - 1], t / k, out=powers[k])
            rows *= powers[self._degree]
        return np.asarray(rows)


def exponential(A: Array) -> ModalFlow:
    """Return the `ModalFlow` of A; built once per matrix and kept."""
    owned = np.ascontiguousarray(A, dtype=np.float64)
    return _cached(owned.shape[0], owned.tobytes())


@lru_cache(maxsize=128)
def _cached(n: int, data: bytes) -> ModalFlow:
    return ModalFlow(np.frombuffer(data).reshape(n, n))


def _norms(matrices: Array) -> Array:
    """Those of Frobenius, without a copy."""
    return np.asarray(np.sqrt(np.einsum("kij,kij->k", matrices, matrices)))


def _wide(blocks: list[_SpectralBlock], A: Array) -> list[_SpectralBlock]:
    """Blocks whose polynomial ends before |t||A| = 1e4."""
    near = 0.99 * _FAR / max(float(np.linalg.norm(A)), 1e-300)
    return [block for block in blocks if block.reach < near]


def _balance(A: Array) -> tuple[Array, Array]:
    """Diagonal d (powers of two) and A with rows divided and columns multiplied by d, |A| about least."""
    if A.shape[0] < 2:
        return np.ones(A.shape[0]), A
    from scipy.linalg import matrix_balance

    _, (scale, _) = matrix_balance(A, permute=False, separate=True)
    return np.asarray(scale), A * scale / scale[:, None]


def _modal_blocks(A: Array, scale: Array) -> tuple[list[_SpectralBlock], float, str]:
    """Blocks of a balanced A, the condition of their basis, and a reason where there are none."""
    n = A.shape[0]
    if n == 0:
        return [], 1.0, ""
    if n > _LARGEST:
        return [], np.inf, f"more than {_LARGEST} states"
    from scipy.linalg import schur

    T, Q = schur(A, output="complex")
    values = _conjugate_pairs(np.diag(T))
    norm = float(np.linalg.norm(A))
    for labels in _clusterings(values, _RADIUS * norm):
        if np.all(labels == labels[0]):
            break
        V, sizes, order = _block_basis(T, Q, labels)
        if V is None:
            continue
        condition = float(np.linalg.norm(V, 2) * np.linalg.norm(np.linalg.inv(V), 2))
        if condition <= CONDITION_LIMIT:
            return _refined(A, scale, V, sizes, values[order], condition)
    # one block only, nothing to separate: the coordinates stay as they are
    return _refined(A, scale, np.eye(n, dtype=complex), [n], values, 1.0)


def _conjugate_pairs(values: Entries) -> Entries:
    """The eigenvalues of a real matrix, made an exactly symmetric set."""
    paired, free = np.array(values), list(range(len(values)))
    while free:
        i = free.pop(int(np.argmax([abs(values[j].imag) for j in free])))
        if free:
            j = min(free, key=lambda j: abs(values[j] - np.conj(values[i])))
            if abs(values[j] - np.conj(values[i])) < abs(values[i].imag):
                free.remove(j)
                mean = (values[i] + np.conj(values[j])) / 2
                paired[i], paired[j] = mean, np.conj(mean)
                continue
        paired[i] = values[i].real
    return paired


def _clusterings(values: Entries, radius: float) -> Iterator[Index]:
    """Labels of single-linkage clusters, from fine to coarse, until everything is one cluster.

    Which eigenvalues are one is not asked here (`plants/clusters.py` does): blocks are coarsened until their basis is
    well conditioned, whatever their eigenvalues.
    """
    distance = np.abs(values[:, None] - values[None, :])
    while True:
        near = distance <= radius
        for _ in range(int(np.ceil(np.log2(len(values)))) + 1):
            near = near @ near
        labels = np.argmax(near, axis=1)
        yield labels
        between = distance[labels[:, None] != labels[None, :]]
        if not between.size:
            return
        radius = float(between.min()) * (1 + 1e-9)


def _block_basis(T: Entries, Q: Entries, labels: Integers) -> tuple[Entries | None, list[int], list[int]]:
    """Columns V, orthonormal within each block, with A V = V blockdiag: swaps, then Sylvester equations."""
    from scipy.linalg.lapack import ztrexc, ztrsyl

    n, order = len(labels), list(range(len(labels)))
    sizes: list[int] = []
    for label in dict.fromkeys(labels):
        place = sum(sizes)
        members = [i for i in order[place:] if labels[i] == label]
        for target, i in enumerate(members, start=place):
            source = order.index(i)
            if source != target:
                T, Q, info = ztrexc(T, Q, source + 1, target + 1)
                if info:
                    return None, sizes, order
                order.insert(target, order.pop(source))
        sizes.append(len(members))
    V = np.zeros((n, n), dtype=complex)
    low = 0
    for size in sizes:
        high = low + size
        columns = Q[:, low:high].copy()
        if low:
            X, factor, info = ztrsyl(T[:low, :low], T[low:high, low:high], -T[:low, low:high], isgn=-1)
            if info < 0 or factor == 0 or not np.isfinite(X).all():
                return None, sizes, order
            columns += Q[:, :low] @ (X / factor)
        V[:, low:high] = np.linalg.qr(columns)[0]
        low = high
    return V, sizes, order


def _refined(
    A: Array, scale: Array, V: Entries, sizes: list[int], values: Entries, condition: float
) -> tuple[list[_SpectralBlock], float, str]:
    """The blocks after Newton steps in extended precision, or the reason why these do not end well."""
    ends = np.cumsum([0, *sizes])
    parts = [slice(a, b) for a, b in pairwise(ends)]
    same = np.zeros(A.shape, dtype=bool)
    for part in parts:
        same[part, part] = True
    long, V, W = A.astype(np.longdouble), V.astype(np.clongdouble), np.linalg.inv(V).astype(np.clongdouble)
    norm = max(float(np.linalg.norm(A)), 1e-300)
    goal = 64 * _LONG * condition * norm
    allowed = np.finfo(float).eps * float(np.linalg.norm(scale[:, None] * A / scale))
    for _ in range(6):
        for _ in range(2):
            W = W + W @ (np.eye(len(A)) - V @ W)
        S = W @ (long @ V)
        off = np.where(same, 0, S)
        if np.linalg.norm(off.astype(complex)) <= goal:
            physical = scale[:, None] * (V @ off @ W) / scale
            if np.linalg.norm(physical.astype(complex)) <= allowed:
                break
        V = V + V @ _decoupling(np.where(same, S, 0), off, values, parts, same)
    else:
        return [], np.inf, "the modal blocks do not separate"
    if _LONG > 1e-18 and max(sizes) > 1:
        return [], np.inf, "no extended precision for blocks of repeated eigenvalues"
    blocks = [_block(S[p, p], scale[:, None] * V[:, p], W[p] / scale, values[p], _FAR / norm) for p in parts]
    kept = [b for b in blocks if b is not None]
    mixed = _wide(kept, A) if len(parts) > 1 else []
    if any(np.linalg.norm(b.V) * np.linalg.norm(b.W) > CONDITION_LIMIT for b in mixed):
        return [], np.inf, "a wide block of badly scaled states"
    return kept, condition, ""


def _decoupling(T: Entries, off: Entries, values: Entries, parts: list[slice], same: Mask) -> Entries:
    """X with T X - X T = -off outside the blocks of T, by iteration around the blocks' means."""
    means = np.concatenate([np.full(p.stop - p.start, np.mean(values[p])) for p in parts])
    gap = np.where(same, 1, means[:, None] - means[None, :])
    N = (T - np.diag(means)).astype(complex)
    right = off.astype(complex)
    X = np.zeros_like(right)
    for _ in range(8 * max(p.stop - p.start for p in parts)):  # exact after 2m - 1 steps where N^m = 0
        last, X = X, np.where(same, 0, (-right - N @ X + X @ N) / gap)
        if np.linalg.norm(X - last) <= 1e-3 * np.linalg.norm(X):
            break
    return X.astype(np.clongdouble)


def _block(T: Entries, V: Entries, W: Entries, values: Entries, far: float) -> _SpectralBlock | None:
    """One block; None for the lower of two conjugate ones, which the upper one stands for."""
    m = len(T)
    real = np.min(np.abs(values.imag)) == 0 or np.any(np.isin(np.conj(values), values))
    if not real and values[0].imag < 0:
        return None
    mean = np.trace(T) / m
    mean = mean.real + 0j if real else mean
    N = T - mean * np.eye(m)
    powers = [np.eye(m, dtype=np.clongdouble)]
    while len(powers) <= m > 1:
        powers.append(powers[-1] @ N)
    terms = [(V @ P @ W).astype(complex) for P in powers]
    spread, nilpotent = float(np.max(np.abs(np.linalg.eigvals(N.astype(complex))))), m == 1
    if not nilpotent:  # but for the rounding of its products it may be
        rounding = np.abs(V) @ np.linalg.matrix_power(np.abs(N).astype(float), m) @ np.abs(W)
        nilpotent = bool(np.linalg.norm(terms[m]) <= 8 * m * _LONG * float(np.linalg.norm(rounding.astype(float))))
    if not nilpotent:
        for _ in range(_EXTRA_TERMS):
            powers.append(powers[-1] @ N)
            terms.append((V @ powers[-1] @ W).astype(complex))
    kept, reach = (m, np.inf) if nilpotent else _polynomial(terms, m, spread, far)
    narrow = (N.astype(complex), V.astype(complex), W.astype(complex))
    return _SpectralBlock(complex(mean), *narrow, 1.0 if real else 2.0, reach, tuple(terms[:kept]))


def _polynomial(terms: list[Entries], m: int, spread: float, far: float) -> tuple[int, float]:
    """How many terms of a block of size m its polynomial needs, and the |t| up to which they suffice."""
    if spread * far > _SPREAD:
        return m + _EXTRA_TERMS, _SPREAD / spread
    degree = np.arange(len(terms))
    with np.errstate(divide="ignore"):
        logs = np.log([np.linalg.norm(M) for M in terms])
    logs += degree * np.log(far) - np.cumsum(np.log(np.maximum(degree, 1)))
    floor = float(np.max(logs[:m])) + np.log(np.finfo(float).eps / 8)
    return int(np.max(np.flatnonzero(logs > floor))) + 1, far
