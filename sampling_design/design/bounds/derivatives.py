"""Derivatives of what outputs see of a multiplier, g(t) = C e^{At} Y e^{A't} C', one by one.

Norms bound them all at once: |g^(q)| <= |C|^2 e^{2|A|t} |q-th derivative of Y|. Where the outputs see little of a large
Y, as of many integrators, that is too much by orders of magnitude. By Taylor's formula the lower derivatives are known
from those at one time, and only one of high order is left to the norms, with a factor h^q/q!. Time is counted in 1/|A|,
to a power of two: high powers of A are no numbers in other units, or 0.
"""

from __future__ import annotations

from math import comb, factorial

import numpy as np

from sampling_design.records.arrays import Array, Index

_ORDER = 16  # up to which derivatives of a form over the range of a lag are worked out
_ORDER_OF_BEND, _TOGETHER = 9, 4096  # the same over a piece, which is short; pieces that are worked out at once


def _rate(A: Array) -> float:
    """A power of two near the largest entry of A; 1 where all are 0."""
    return float(np.ldexp(1.0, int(np.frexp(np.max(np.abs(A), initial=0.0))[1])))


def remainder_of_bend(A: Array, Y: Array, order: int, node: Index, width: Array, growth: Array) -> Array:
    """How much g'' may change over a piece by its derivatives from an order q of g on: h^(q-2)/(q-2)! sup |g^(q)|."""
    unit = np.max(np.abs(Y), axis=(1, 2))  # squares of what has grown are no numbers
    Y, rate = Y / np.maximum(unit, np.finfo(float).tiny)[:, None, None], _rate(A)
    A = A / rate
    for _ in range(order):
        Y = A @ Y + Y @ A.T
    with np.errstate(over="ignore"):  # where nothing is known of a piece its roof is infinite
        size = unit * np.linalg.norm(Y, axis=(1, 2))
        scaled = (size[node] * rate**2 * (rate * width) ** (order - 2) / factorial(order - 2))[:, None]
        known = (scaled > 0) & (growth > 0)  # else it is 0, whatever the other is
        return np.asarray(np.multiply(growth, scaled, out=np.zeros(known.shape), where=known))


def change_of_bend(A: Array, c: Array, Y: Array, node: Index, width: Array, growth: Array) -> Array:
    """How much g'' = (c e^{At} Y e^{A't} c')'' may change over pieces of that `width` that begin with the rows c."""
    rate = _rate(A)
    slopes = _slopes_of_bend(A / rate, c, Y, node, rate * width)
    return np.asarray(rate**2 * slopes + remainder_of_bend(A, Y, _ORDER_OF_BEND, node, width, growth))


def _slopes_of_bend(A: Array, c: Array, Y: Array, node: Index, width: Array) -> Array:
    """How much g'' may change over a piece by the third and higher derivatives of g at its beginning.

    The q-th is the sum of binom(q, i) (c A^i) Y (c A^(q-i))'.
    """
    found = np.zeros(c.shape[:2])
    for low in range(0, len(c), _TOGETHER):
        part = slice(low, low + _TOGETHER)
        rows = [c[part]]
        for _ in range(1, _ORDER_OF_BEND):
            rows.append(rows[-1] @ A)
        row_derivatives = [row @ Y[node[part]] for row in rows]
        for q in range(3, _ORDER_OF_BEND):
            derivative = sum(comb(q, i) * np.sum(row_derivatives[i] * rows[q - i], axis=2) for i in range(q + 1))
            found[part] += np.abs(derivative) * (width[part, None] ** (q - 2) / factorial(q - 2))
    return found


def largest_derivatives(A: Array, C: Array, F: Array, reach: Array) -> Array:
    """Bounds of the derivatives 0 to 3 of |C e^{At} F|^2 over |t| <= reach: from those at 0 up to a higher order.

    What is left is bounded by norms. That alone says little where C sees little of what is large in F.
    """
    rate = _rate(A)
    A, reach = A / rate, rate * reach
    row_derivatives, state = [C @ F], F
    for _ in range(1, _ORDER):
        state = A @ state
        row_derivatives.append(C @ state)
    unit = np.maximum(np.max(np.abs(F), axis=(1, 2)), np.finfo(float).tiny)
    F = F / unit[:, None, None]
    Y = F @ np.swapaxes(F, 1, 2)
    for _ in range(_ORDER):
        Y = A @ Y + Y @ A.T
    with np.errstate(over="ignore"):
        last = np.einsum("spn,spn->s", C, C) * np.linalg.norm(Y, axis=(1, 2)) * unit**2
        growth = np.exp(2 * float(np.linalg.norm(A, 2)) * reach)
        last = np.multiply(last, growth, out=np.zeros_like(last), where=last != 0)  # 0 however much it grows
    found = np.zeros((4, len(F)))
    for q in range(_ORDER + 1):
        pairs = (comb(q, i) * np.einsum("spr,spr->s", row_derivatives[i], row_derivatives[q - i]) for i in range(q + 1))
        size = last if q == _ORDER else np.abs(sum(pairs))
        for p in range(min(q, 3) + 1):
            found[p] += size * reach ** (q - p) / factorial(q - p)
    return np.asarray(found * (rate ** np.arange(4.0))[:, None])
