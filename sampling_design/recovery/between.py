"""Between samples: rho(c; t_i + d) = rho(Phi(d)'c; t_i) + int_0^d h_W(G'Phi(s)'c) ds, and its closure over all real d.

rho(.; t_i) is a norm. Between two offsets whose rows have been bounded, Phi(d)'c lies on their chord but for a rest of
at most delta^2/8 sup|A'^2 Phi'c|, and the norm of the rest is at most the filter's reach.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design._linalg import expm_batch
from sampling_design.recovery.chain import SampleChain

Array = npt.NDArray[np.float64]

GRID = (64, 2048)
"""Least and largest number of panels of a gap on which the profile stands."""

FINENESS = 0.1
"""Length of such a panel times |A| in scaled coordinates."""


@dataclass(frozen=True, eq=False)
class Open:
    """One wanted row after sample j, on a grid of offsets d.

    Attributes
    ----------
    d : (N+1,) array
    mu : (N+1, n) array
        Phi(d)'c in the coordinates of z_j.
    above, below : (N+1,) arrays
        Bounds on int_0^d h_W(G'Phi(s)'c) ds.
    turn : (N,) array
        On each panel, a bound on reach'|d^2 mu/dd^2|.
    """

    d: Array
    mu: Array
    above: Array
    below: Array
    turn: Array

    def bound(self, a: int, b: int, at_a: float, at_b: float) -> Array:
        """Return bounds on rho on the panels from d[a] to d[b]; `at_a`, `at_b` bound rho(Phi(d)'c; t_j) at the ends."""
        d = self.d[a : b + 1]
        length = d[-1] - d[0]
        part = (d - d[0]) / length
        chord = at_a + (at_b - at_a) * part
        rest = part * (1 - part)  # on a panel at most the larger of its ends and the square of half its part, and 1/4
        sag = np.minimum(np.maximum(rest[1:], rest[:-1]) + (np.diff(part) / 2) ** 2, 0.25) * length**2 / 2
        worst = np.maximum(chord[1:], chord[:-1]) + sag * np.max(self.turn[a:b]) + self.above[a + 1 : b + 1]
        return np.asarray(worst)

    def between(self, a: int, b: int, at_a: float, at_b: float) -> tuple[float, int]:
        """Return the largest of these bounds and its panel."""
        bound = self.bound(a, b, at_a, at_b)
        k = int(np.argmax(bound))
        return float(bound[k]), a + k


def open_row(chain: SampleChain, j: int, row: Array) -> Open:
    """Return one row (n,) of x after sample j, over the whole gap."""
    gap, A = chain.gaps[j], chain.A
    size = float(np.linalg.norm(A, 2))
    number = int(np.clip(np.ceil(size * gap.length / FINENESS), *GRID))
    d = np.linspace(0.0, gap.length, number + 1)
    step = gap.length / number
    above, below, flown, middle = _open_integrals(chain, d, row)
    L, reach = chain.L[j], chain.reach[j]
    turning = np.abs(flown @ (A @ A) @ L)
    drift = step / 2 * middle[:, None] * np.linalg.norm(L, axis=0)
    turn = (np.maximum(turning[1:], turning[:-1]) + drift) @ reach
    return Open(d, flown @ L, above, below, turn)


def _open_integrals(chain: SampleChain, d: Array, row: Array) -> tuple[Array, Array, Array, Array]:
    """Bounds on int_0^d h_W(G'Phi(s)'c) ds from above and below, rows c'Phi(d), and bounds on |c'Phi A^3| per panel."""
    A, G, n = chain.A, chain.G, chain.D.size
    step = float(d[-1] - d[0]) / (d.size - 1)
    flown = (row * chain.D) @ expm_batch(A, d)
    p, bend = flown @ G, flown @ (A @ A @ G)
    turned = (row * chain.D) @ expm_batch(A, (d[1:] + d[:-1]) / 2) @ (A @ A @ A)
    middle = np.linalg.norm(turned, axis=1) * np.exp(float(np.linalg.norm(A, 2)) * step / 2)
    third = middle * np.linalg.norm(G, 2)
    joint = np.zeros((n + G.shape[1], n + G.shape[1]))
    joint[:n, :n], joint[:n, n:] = A, G
    mean = flown[:-1] @ expm_batch(joint, [step])[0, :n, n:]
    if chain.bounds.w_ball:
        value, curve, least = np.linalg.norm(p, axis=1), np.linalg.norm(bend, axis=1), np.linalg.norm(mean, axis=1)
        curve = np.maximum(curve[1:], curve[:-1]) + step / 2 * third
    else:
        value, least = np.abs(p).sum(axis=1), np.abs(mean).sum(axis=1)
        curve = np.maximum(np.abs(bend[1:]), np.abs(bend[:-1])).sum(axis=1) + G.shape[1] * step / 2 * third
    most = step / 2 * (value[1:] + value[:-1]) + step**3 / 12 * curve
    return _sums(most), _sums(np.asarray(least)), flown, middle


def _sums(x: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(x)])


def open_integral(chain: SampleChain, length: float, row: Array) -> float:
    """Return a bound on int_0^length h_W(G'Phi(s)'c) ds for a row (n,) of x."""
    size = float(np.linalg.norm(chain.A, 2))
    number = int(np.clip(np.ceil(size * length / FINENESS), *GRID))
    return float(_open_integrals(chain, np.linspace(0.0, length, number + 1), row)[0][-1])
