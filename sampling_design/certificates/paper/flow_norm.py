"""The largest |M e^{As} N| over a whole interval of s, bounded from above: proven over the continuum, not sampled.

Every constant of the proof that is "a maximum over [0, T]" (k_w, the growth before the first restart) comes from here.
"""

from __future__ import annotations

import numpy as np

from sampling_design.numerics.linalg import expm_batch
from sampling_design.records.arrays import Array

RTOL = 1e-3
"""Room left between the proven bound and the largest value met: a thousandth of a constant costs no horizon."""
CELLS = 20_000  # most cells ever opened; a stiffer plant keeps a proven but looser bound instead of running for ever
MODAL_CONDITION = 1e8  # modal coordinates are used only where their basis keeps half of the digits


def largest_flow(
    M: Array, A: Array, N: Array, duration: float, rtol: float = RTOL, cells: int = CELLS
) -> tuple[float, float, float]:
    """Bound the spectral norm of M e^{As} N over s in [0, duration]: upper, lower bound, and where that is attained.

    Notes
    -----
    *Method.* Bisection of cells. With X = M e^{Ac} N, Y = M e^{Ac} A N at a cell's centre c and half-width h,
    |M e^{A(c+d)} N| <= max |X +- hY| + |M e^{Ac}| |A^2 N| h^2/2 e^{m h} for all |d| <= h: the line X + dY is convex
    in d, and the remainder is Taylor's with |e^{Ad}| <= e^{m|d|}, m = max(mu(A), mu(-A)), mu the logarithmic norm.
    Where this is worse than |M e^{Aa} V| e^{m' 2h} |V^{-1} N| from the left end a (stiff plants after their fast
    modes died; V = I or the eigenvectors, m' = mu(V^{-1}AV)^+), that one is taken. A cell closes when its bound is
    within `rtol` of the largest value met.
    *Numerical aspects.* When `cells` are used up the open cells keep their bounds: looser, still proven. A final
    factor 1 + 64 n eps covers rounding.
    """
    size = max(M.shape[0], N.shape[1], A.shape[0])
    if min(M.shape[0], N.shape[1], A.shape[0]) == 0:
        return 0.0, 0.0, 0.0
    half = duration / 2
    starts = np.array([0.0])
    best, at, upper, used = 0.0, 0.0, 0.0, 0
    while starts.size:
        bounds, values, places = _cells(M, A, N, starts, half)
        top = int(np.argmax(values))
        if values[top] > best:
            best, at = float(values[top]), float(places[top])
        used += starts.size
        open_ = bounds > (1 + rtol) * best
        if used + 2 * int(open_.sum()) > cells or half <= np.finfo(float).eps * duration:
            upper = max(upper, float(bounds.max()))
            break
        upper = max(upper, float(bounds[~open_].max(initial=0.0)))
        starts = np.concatenate([starts[open_], starts[open_] + half])
        half /= 2
    return max(upper, best) * (1 + 64 * size * np.finfo(float).eps), best, at


def _cells(M: Array, A: Array, N: Array, starts: Array, half: float) -> tuple[Array, Array, Array]:
    """Proven bound of every cell [a, a + 2 half], the largest value met in it, and where."""
    left = M @ expm_batch(A, starts)
    centre = left @ expm_batch(A, half)[0]
    right = centre @ expm_batch(A, half)[0]
    X, Y = centre @ N, centre @ (A @ N)
    growth, decay = _log_norm(A), _log_norm(-A)
    with np.errstate(over="ignore", invalid="ignore"):
        remainder = (
            _norms(centre) * _norms(A @ A @ N) * half**2 / 2 * np.exp(min(max(growth, decay, 0.0) * half, 700.0))
        )
        second = np.maximum(_norms(X + half * Y), _norms(X - half * Y)) + remainder
        zeroth = _norms(left) * _norms(N) * np.exp(min(max(growth, 0.0) * 2 * half, 700.0))
        zeroth = np.fmin(zeroth, _modal_bound(left, A, N, 2 * half))
    norms = np.stack([_norms(left @ N), _norms(X), _norms(right @ N)])
    which = np.argmax(norms, axis=0)
    return np.fmin(second, zeroth), norms.max(axis=0), starts + which * half


def _modal_bound(left: Array, A: Array, N: Array, length: float) -> Array:
    """Bound of |left e^{As} N| for s in [0, length] in modal coordinates: mu is there the spectral abscissa."""
    _, V = np.linalg.eig(A)
    if np.linalg.cond(V) > MODAL_CONDITION:
        return np.full(left.shape[0], np.inf)
    inverse_N = np.linalg.solve(V, N.astype(V.dtype))
    growth = _log_norm(np.linalg.solve(V, A @ V))
    with np.errstate(over="ignore", invalid="ignore"):
        grown = np.exp(min(max(growth, 0.0) * length, 700.0))
        return np.asarray(_norms(left @ V) * float(np.linalg.norm(inverse_N, 2)) * grown)


def _norms(matrices: Array) -> Array:
    """Spectral norms of a stack."""
    return np.asarray(np.linalg.norm(matrices, 2, axis=(-2, -1)))


def _log_norm(A: Array) -> float:
    """The logarithmic norm mu(A): |e^{As}| <= e^{mu(A) s} for s >= 0."""
    return float(np.linalg.eigvalsh((A + A.conj().T) / 2)[-1])
