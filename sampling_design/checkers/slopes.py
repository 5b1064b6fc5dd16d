"""The Jacobians of a nonlinear plant over cells of its region: a middle, and what may be added to it.

Entries of a Jacobian do not move alone. A derivative of one instruction that is not linear (an "atom") moves all
outputs in which it occurs, and the derivatives of a product move with its value: those of exp(a) b/c are the value
times a' + b'/b - c'/c, which hardly moves where the value ranges over a decade.
"""

from typing import NamedTuple

import numpy as np

from . import intervals as iv
from . import programs
from .inclusion_file import Region
from .intervals import Interval
from .numbers import EPS
from .strict import Array, Mask

NARROWER = 0.7  # mean share of the radii of derivatives that is left where the value's radius is taken apart
Parts = tuple[Array, Array]


def halves(x: Interval) -> Parts:
    """A middle and a radius of each interval: certainly within; radius 0 where both ends are one number."""
    whole = np.isfinite(x.low) & np.isfinite(x.high)
    with np.errstate(invalid="ignore"):
        middle = np.where(whole, x.low / 2 + x.high / 2, 0.0)
        radius = np.maximum(np.nextafter(x.high - middle, np.inf), np.nextafter(middle - x.low, np.inf))
    return middle, np.where(whole, np.where(x.low == x.high, 0.0, radius), np.inf)


class Rate(NamedTuple):
    """An atom's value in each cell, its derivatives as shares of it, and where that says them more narrowly."""

    middle: Array
    radius: Array
    slopes: programs.Slopes
    used: Mask


def rate_of(both: programs.Both, shares: programs.Slopes) -> Rate | None:
    """The derivatives of an atom as its value times shares: None where there are no two, or nothing is gained."""
    value, slopes = both
    if len(slopes) < 2:
        return None
    v, dv = halves(value)
    far, gain, count = np.abs(v) + dv, np.zeros(len(v)), np.zeros(len(v))
    finite = np.isfinite(dv) & (dv > 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        for key, slope in slopes.items():
            (_, dg), (share, dl) = halves(slope), halves(shares[key])
            finite &= np.isfinite(dg) & np.isfinite(dl) & np.isfinite(share)
            gain += np.where(dg > 0, far * dl / dg, 1.0)
            count += 1
        used = finite & (gain < NARROWER * count)
    return Rate(v, dv, shares, used) if used.any() else None


def enclosed(region: Region, low: Array, high: Array, of_f: bool) -> tuple[Array, Array, Array]:
    """Middles, radii, and matrices (D, cells, rows, columns) of which any multiples in [-1, 1] may be added.

    A derivative of one atom moves all outputs together in which it occurs: one matrix for each, of rank one.
    """
    n, q = len(region.low["x"]), len(region.low["w"])
    order = [(key, k) for key in ("x", "u", "w") for k in range(len(region.low[key]))]
    inputs: dict[str, list[Interval]] = {"x": [], "u": [], "w": []}
    for k, (name, _) in enumerate(order):
        inputs[name].append(Interval(low[:, k], high[:, k]))
    program, along = (region.f, ("x", "w")) if of_f else (region.h, ("x",))
    done = programs.every(program, inputs, along)
    outputs = programs.forms(program, done)
    columns = [("x", k) for k in range(n)] + [("w", k) for k in range(q if of_f else 0)]
    shape = (len(low), len(outputs), len(columns))
    M, E, size, used = np.zeros(shape), np.zeros(shape), np.zeros(shape), np.zeros(shape, bool)
    moved: dict[tuple[str, int, int], Array] = {}
    rates = {at: rate_of(done[at], part) for at, part in enumerate(programs.relative(program, done))}
    for i, form in enumerate(outputs):
        for key, factor in form.items():
            slopes = done[key[1]][1] if key[0] == "atom" else {key: iv.number(1.0, factor)}
            c, dc = halves(factor)
            rate = rates[key[1]] if key[0] == "atom" else None
            for column, slope in slopes.items():
                if column not in columns:
                    continue
                j, (g, dg) = columns.index(column), halves(slope)
                top, left = np.abs(g) + dg, dg
                if rate is not None:
                    share, off = halves(rate.slopes[column])
                    with np.errstate(invalid="ignore"):
                        v, dv, far = rate.middle, rate.radius, np.abs(rate.middle) + rate.radius
                        g, left = np.where(rate.used, v * share, g), np.where(rate.used, far * off, dg)
                        top = np.where(rate.used, far * (np.abs(share) + off), top)
                        joint = np.where(rate.used, c * dv * share, 0.0)
                    moved.setdefault(("rate", key[1], 0), np.zeros(shape))[:, i, j] += joint
                    used[:, i, j] |= rate.used
                M[:, i, j] += c * g
                size[:, i, j] += np.abs(c) * top
                E[:, i, j] += np.where(dc > 0, dc * top, 0.0)
                if np.any(left > 0):
                    alone = sum(key in other for other in outputs) == 1
                    if alone:  # slopes that nothing ties together: their sizes add up
                        moved.setdefault(("row", i, j), np.zeros(shape))[:, i, j] += np.abs(c) * left
                    else:
                        moved.setdefault((*key, j), np.zeros(shape))[:, i, j] += c * left
    moving = np.array(list(moved.values())).reshape(len(moved), *shape)
    with np.errstate(invalid="ignore"):
        terms = EPS * (len(program.code) + 4) * size
    still = (E == 0) & (np.abs(moving).sum(axis=0) == 0) & ~used
    exact = still & single(outputs, done, columns)
    return M, E + np.where(exact, 0.0, np.where(np.isnan(terms), np.inf, terms)), moving


def single(outputs: list[programs.Form], done: list[programs.Both], columns: list[tuple[str, int]]) -> Mask:
    """Entries (rows, columns) that one product with a factor of 1 or -1, or none, makes: these are not rounded."""
    count = np.zeros((len(outputs), len(columns)))
    for i, form in enumerate(outputs):
        for key, factor in form.items():
            for column in done[key[1]][1] if key[0] == "atom" else (key,):
                if column in columns:
                    one = factor.known() and abs(factor.low[0]) == 1 if len(factor.low) else True
                    bare = key[0] != "atom" and factor.known() if len(factor.low) else True
                    count[i, columns.index(column)] += 1 if one or bare else 2
    found: Mask = count <= 1
    return found
