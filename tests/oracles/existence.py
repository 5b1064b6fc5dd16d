"""Plants of known spectrum in awkward coordinates, and in exact terms what a periodic schedule sees of them.

Everything is decided where the plant was made, in Jordan form with 50 digits; nothing of the package is used but the
records that hold a plant and a schedule.
"""

from __future__ import annotations

from dataclasses import dataclass

import mpmath
import numpy as np
from scipy.linalg import block_diag

from sampling_design import PeriodicSchedule, Plant

DIGITS = 50
REALS = (0.0, 0.0, 0.1, 0.2, -0.05, -0.3, -1.0, -3.0, 0.5)
SPEEDS = (0.5, 1.0, 2.0, 3.7)


@dataclass(frozen=True)
class Known:
    """A plant with its Jordan form: blocks (eigenvalue, size), C there, and S with A = S J S^-1."""

    plant: Plant
    blocks: list[tuple[complex, int]]
    J: np.ndarray
    C: np.ndarray


def drawn(rng: np.random.Generator, largest: int = 9, stiff: bool = True) -> Known:
    """Up to `largest` states, Jordan blocks of up to three, one or two outputs, perhaps a column of C of zeros."""
    blocks: list[tuple[complex, int]] = []
    size, wanted = 0, int(rng.integers(1, largest + 1))
    while size < wanted:
        value = complex(rng.choice(REALS), 0.0 if rng.random() < 0.5 else rng.choice(SPEEDS))
        if stiff and rng.random() < 0.1:
            value = complex(-(10.0 ** rng.integers(1, 4)), 0.0)
        block = int(rng.choice([1, 1, 1, 2, 3])) if abs(value.real) < 10 else 1
        step = block * (1 if value.imag == 0 else 2)
        if size + step > largest:
            continue
        blocks.append((value, block))
        size += step
    J = block_diag(*(_real_block(v, m) for v, m in blocks))
    outputs = int(rng.integers(1, 3))
    C = rng.uniform(0.5, 2.0, (outputs, size)) * rng.choice([-1.0, 1.0], (outputs, size))
    if rng.random() < 0.2:
        C[:, rng.integers(size)] = 0.0
    kind = rng.integers(4)
    if kind == 0:
        order = rng.permutation(size)
        return Known(Plant(J[np.ix_(order, order)], C[:, order], G=np.ones((size, 1))), blocks, J, C)
    S = rng.standard_normal((size, size)) if kind == 1 else np.linalg.qr(rng.standard_normal((size, size)))[0]
    inverse = np.linalg.inv(S)
    return Known(Plant(S @ J @ inverse, C @ inverse, G=S @ np.ones((size, 1))), blocks, J, C)


def _real_block(value: complex, size: int) -> np.ndarray:
    if value.imag == 0:
        return value.real * np.eye(size) + np.eye(size, k=1)
    pair = np.array([[value.real, value.imag], [-value.imag, value.real]])
    return np.kron(np.eye(size), pair) + np.eye(2 * size, k=2)


def unseen_count(known: Known) -> int:
    """How many independent eigenvectors no output observes: in Jordan form these are first columns of blocks."""
    count = 0
    for value in {v for v, _ in known.blocks}:
        columns, at = [], 0
        for v, m in known.blocks:
            if v == value:
                first = known.C[:, at].astype(complex)
                columns.append(first if v.imag == 0 else first + 1j * known.C[:, at + 1])
            at += m * (1 if v.imag == 0 else 2)
        lost = len(columns) - np.linalg.matrix_rank(np.array(columns).T, tol=1e-9)
        count += int(lost) * (1 if value.imag == 0 else 2)
    return count


def schedule_drawn(rng: np.random.Generator, known: Known) -> PeriodicSchedule:
    """One to four samples a period; every third period holds turns of a difference of speeds, perhaps gaps too."""
    count = int(rng.choice([1, 1, 2, 3, 4]))
    speeds = sorted({abs(v.imag - w.imag) for v, _ in known.blocks for w, _ in known.blocks} - {0.0})
    speeds += [2 * v.imag for v, _ in known.blocks if v.imag > 0]
    gaps = rng.uniform(0.2, 1.5, count)
    if speeds and rng.random() < 0.4:
        turn = 2 * np.pi / float(rng.choice(speeds))
        if rng.random() < 0.5:
            gaps = np.full(count, turn / count if rng.random() < 0.5 else turn)
        else:
            gaps *= turn / gaps.sum()
    return PeriodicSchedule(gaps)


def least_seen(known: Known, schedule: PeriodicSchedule, eta: float) -> float:
    """Least singular value of the lifted pencil over modes that do not fade at rate eta, in Jordan form, 50 digits.

    Rows of the flow are divided by the size of their own block, samples by the growth of each block over the period.
    """
    with mpmath.workdps(DIGITS):
        period = mpmath.mpf(float(schedule.period))
        periods, rows = [], []
        for value, size in known.blocks:
            rate = mpmath.mpc(value.real, value.imag)
            for one in [rate] if value.imag == 0 else [rate, mpmath.conj(rate)]:
                periods.append((one, size))
        times = [mpmath.mpf(float(t)) - mpmath.mpf(float(schedule.times[0])) for t in schedule.times]
        C = _complex_rows(known)
        n, at = sum(m for _, m in periods), 0
        seen = mpmath.zeros(len(times) * len(known.C), n)
        for rate, size in periods:
            grown = mpmath.exp(max(rate.real, 0) * period)
            for i, t in enumerate(times):
                flow = _flow(rate, size, t)
                for o in range(len(known.C)):
                    for k in range(size):
                        value = mpmath.fsum(C[o][at + j] * flow[j, k] for j in range(size)) / grown
                        seen[i * len(known.C) + o, at + k] = value
            at += size
        least = mpmath.inf
        for mu_rate, _ in periods:
            if mu_rate.real < -mpmath.mpf(eta) / 2:
                continue
            mu, at = mpmath.exp(mu_rate * period), 0
            pencil = mpmath.zeros(n + seen.rows, n)
            for rate, size in periods:
                flow = _flow(rate, size, period)
                top = max(abs(mu), abs(mpmath.exp(rate * period)))
                for j in range(size):
                    for k in range(j, size):
                        pencil[at + j, at + k] = (flow[j, k] - (mu if j == k else 0)) / top
                at += size
            for r in range(seen.rows):
                for k in range(n):
                    pencil[n + r, k] = seen[r, k]
            rows = mpmath.svd_c(pencil, compute_uv=False)
            least = min(least, min(abs(s) for s in rows))
        return float(least)


def _flow(rate: mpmath.mpc, size: int, t: mpmath.mpf) -> mpmath.matrix:
    """e^{J t} of one Jordan block."""
    flow = mpmath.zeros(size, size)
    for j in range(size):
        for k in range(j, size):
            flow[j, k] = mpmath.exp(rate * t) * t ** (k - j) / mpmath.factorial(k - j)
    return flow


def _complex_rows(known: Known) -> list[list[mpmath.mpc]]:
    """C in complex Jordan form: a pair (a, b) of real columns becomes a + ib and a - ib, block after block."""
    result = []
    for row in known.C:
        entries, at = [], 0
        for value, size in known.blocks:
            if value.imag == 0:
                entries += [mpmath.mpc(float(row[at + k])) for k in range(size)]
                at += size
            else:
                pair = [mpmath.mpc(float(row[at + 2 * k]), float(row[at + 2 * k + 1])) for k in range(size)]
                entries += pair + [mpmath.conj(z) for z in pair]
                at += 2 * size
        result.append(entries)
    return result
