"""A box of constant parameters as arrays, in balanced coordinates of the scaled plant, and its rows over a cell.

Of the rows C(theta) e^{A(theta) r} over a cell of parameters: value, first derivatives, bound of the rest. The first
order is the Frechet derivative; the rest is that of the norms below in coordinates T, the rate there the logarithmic
norm. Several T are tried, none is trusted.

What the plants of a cell are beside its middle, in the norm of one metric: the same in floats and in balls.

With A(theta) = A + E, |E| <= moved, C(theta) = C + F, |C| <= c, |F| <= f, and |e^{A r}| <= e^{rate r},

    |C(theta) e^{A(theta) r} - C e^{A r}|  <=  first + second,    b(x) = e^x - 1 - x,
    first = e^{rate r} (c moved r + f),    second = e^{rate r} (c b(moved r) + f (moved r + b(moved r))),

the first order linear in E and F. A window that begins s later turns all rows by one e^{A(theta) s}.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np
from scipy import linalg

from sampling_design.errors import ArgumentError
from sampling_design.numerics.balls import Ball
from sampling_design.numerics.linalg import balance
from sampling_design.observability.windows.bracket import ALLOWANCE, LARGEST
from sampling_design.observability.windows.timing import lost_to_time
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Complex, Integers, Mask
from sampling_design.records.record import short
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant


@dataclass(frozen=True, eq=False)
class BoxModel:
    """A(theta) = A + sum_k (theta_k - nominal_k) A_k, likewise C, for low <= theta <= high; states x/s_x = unit z."""

    plant: UncertainPlant
    A: Array  # (n, n)
    C: Array  # (p, n)
    parts_A: Array  # (m, n, n)
    # (m, p, n): what a change of a parameter by its own half-width adds; parameters that move neither are left out
    parts_C: Array
    nominal: Array  # nominal, half, (m,): in the parameters' own units; theta = middle + half u with |u| <= 1
    middle: Array  # (m,)
    half: Array
    unit: Array  # (n,): the states of which z are the multiples
    states: Array  # states, outputs, (n,), (p,): what the plant's own states and outputs are multiples of: their scales
    outputs: Array
    place: Integers  # (m,): which parameters of the plant these are

    @classmethod
    def of(cls, plant: UncertainPlant, name: str, span: float) -> BoxModel:
        """The box of a plant; `name` is the verb that asks, for its refusals, `span` the time over which it asks.

        Raises ArgumentError if the plant lies between vertices, or its parameters vary.
        """
        require_constant_box(plant, name)
        P = plant.nominal
        A, C, each = plant.moves("A"), plant.moves("C"), plant.parameters
        own = [k for k in range(len(each)) if each[k].low < each[k].high and (A[k].any() or C[k].any())]
        x, y = P.states.scales, P.outputs.scales
        low, high = plant.low[own], plant.high[own]
        half, middle = high / 2 - low / 2, low / 2 + high / 2
        # of chains alone only time says how fast they are
        d = balance(P.A * (span or 1.0) * x / x[:, None], P.C * x / y[:, None]).d
        to_z, rows = x * d, y[:, None]
        parts_A = np.array([A[k] for k in own]).reshape(len(own), *P.A.shape)
        parts_C = np.array([C[k] for k in own]).reshape(len(own), *P.C.shape)
        return cls(
            plant=plant, A=P.A * to_z / to_z[:, None], C=P.C * to_z / rows,
            parts_A=half[:, None, None] * parts_A * to_z / to_z[:, None],
            parts_C=half[:, None, None] * parts_C * to_z / rows,
            nominal=np.array([each[k].nominal for k in own]), middle=middle, half=half, unit=d,
            states=x, outputs=y, place=np.array(own, dtype=int),
        )  # fmt: skip

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def m(self) -> int:
        """Number of parameters that matter."""
        return len(self.half)

    @property
    def start(self) -> Array:
        """u of the nominal values."""
        return (self.nominal - self.middle) / self.half if self.m else np.zeros(0)

    def at(self, u: Array) -> tuple[Array, Array]:
        """A and C, (K, n, n) and (K, p, n), at u (K, m)."""
        move = u - self.start
        return self.A + np.tensordot(move, self.parts_A, 1), self.C + np.tensordot(move, self.parts_C, 1)

    def balanced_at(self, u: Array) -> Plant:
        """The plant at one u in balanced coordinates z."""
        A, C = self.at(u[None])
        return Plant(A[0], C[0])

    def values(self, u: Array) -> dict[str, float]:
        """The parameters at one u, all of the plant's by name, inside of their ranges."""
        found = {each.name: each.nominal for each in self.plant.parameters}
        for k, value in zip(self.place.tolist(), (self.middle + self.half * u).tolist(), strict=True):
            each = self.plant.parameters[k]
            found[each.name] = float(np.clip(value, each.low, each.high))
        return found


def at_parameters(values: Mapping[str, float]) -> str:
    """The parameters in words, such as "omega^2 = 1.21"."""
    return ", ".join(f"{name} = {short(value)}" for name, value in values.items()) or "the nominal plant"


def require_constant_box(plant: UncertainPlant, name: str) -> None:
    """Raise where a question about each plant of a box has no meaning.

    Raises ArgumentError if the plant lies between vertices, or its parameters vary.
    """
    if plant.vertices:
        raise ArgumentError(
            f"`plant` must have parameters in a box for {name}, got one between vertices. "
            "Ask about each vertex, or use UncertainPlant.from_intervals."
        )
    if plant.varying:
        raise ArgumentError(
            f"`plant` must have constant parameters for {name}, got ones that vary in time. "
            "Use varying=False, or certify, which holds for varying ones."
        )


Number = TypeVar("Number", Ball, Array)


def _beyond_first(x: Array) -> Array:
    return np.where(x < 1e-3, 0.5 * x * x * (1 + 0.34 * x), np.expm1(x) - x + 1e-15 * x)


Arithmetic: TypeAlias = tuple[Callable[[Number], Number], Callable[[Number], Number]]
"""e^x, and e^x - 1 - x for x >= 0: what bounds need beside sums and products, none of it smaller than it is."""
FLOATS: Arithmetic[Array] = (np.exp, _beyond_first)
BALLS: Arithmetic[Ball] = (lambda x: x.exp(), lambda x: x.expm1() - x)


@dataclass(frozen=True, eq=False)
class CellNorms(Generic[Number]):
    """Of every plant of a cell: balls, or floats (K, 1), one for each of K cells."""

    rate: Number  # |e^{A r} x| <= e^{rate r} |x| for the centre's A, r >= 0
    size: Number  # |A x| <= size |x|
    moved: Number  # |(A(theta) - A) x| <= moved |x|
    output_size: Number  # c: |C x| <= c |x|, outputs in the plain norm
    output_moved: Number  # f: |(C(theta) - C) x| <= f |x|
    arithmetic: Arithmetic[Number]

    def rows(self, r: Number, rate: Number) -> tuple[Number, Number]:
        """First order, and what is beyond it, of a sample r >= 0 after the window's start."""
        exp, beyond_first = self.arithmetic
        along, grown = self.moved * r, exp(rate * r)
        beyond = beyond_first(along)
        c, f = self.output_size, self.output_moved
        return grown * (c * along + f), grown * (c * beyond + f * (along + beyond))

    def displaced(self, r: Number, rate: Number, other: Number, late: float) -> Number:
        """What times up to `late` off do to the rows of samples at r beyond what they do to the centre's.

        `other` bounds C(theta) e^{A(theta) r} - C e^{A r}; |e^{A(theta) e} - I| <= e^{(size + moved) |e|} - 1, and the
        terms of its series differ from the centre's by those of e^{(size + moved) |e|} - e^{size |e|} at most.
        """
        exp, _ = self.arithmetic
        whole, own = (exp(x * late) for x in (self.size + self.moved, self.size))
        return self.output_size * exp(rate * r) * (whole - own) + other * (whole - 1)

    def turned(self, h: Number) -> Number:
        """What |e^{A(theta) s} - I - A s| stays below for |s| <= h."""
        return self.moved * h + self.arithmetic[1]((self.size + self.moved) * h)


WORST_BASIS = 1e5
"""A basis of a larger condition is none to bound anything in: its inverse is rounded by this times n eps."""
DEGREE, FOLD = 19, 4  # of the Taylor polynomial at |M| <= 1, and by how many powers it is folded
UP = 1 + 1e-8  # covers the rounding of the bounds themselves, that of the inverse of a basis among it
EPS = float(np.finfo(float).eps)


class BoxCells(NamedTuple):
    """Cells of u (parameters in units of their half-widths) and of window starts s, and the samples each looks at."""

    u: Array  # (K, m)
    half: Array  # (K, m)
    s: Array  # (K,)
    h: Array  # (K,)
    piece: Integers  # (K,)

    def take(self, index: Integers | Mask) -> BoxCells:
        """The cells at `index`."""
        return BoxCells._make(part[index] for part in self)

    def joined(self, *others: BoxCells) -> BoxCells:
        """These cells and others."""
        return BoxCells._make(np.concatenate(parts) for parts in zip(self, *others, strict=True))

    def split(self, most: int) -> list[BoxCells]:
        """The cells in batches of at most so many."""
        every = np.arange(len(self.s))
        return [self.take(every[i : i + most]) for i in range(0, every.size, most)]

    def each(self) -> list[BoxCells]:
        """The cells one by one."""
        return self.split(1)

    @classmethod
    def whole(cls, m: int) -> BoxCells:
        """The box of m parameters as one cell, of one window position."""
        box = np.zeros((1, m))
        return cls(box, box + 1, np.zeros(1), np.zeros(1), np.zeros(1, dtype=int))


def signs(m: int) -> Array:
    """The corners (2^m, m) of [-1, 1]^m."""
    return np.array(list(product((-1.0, 1.0), repeat=m))).reshape(2**m, m)


class ExpansionRemainder(NamedTuple):
    """In one basis T: |rest z|^2 <= z'N z of the rows, and |turn z| <= beyond |T^-1 z| of what moves the window."""

    N: Array  # (K, n, n)
    inverse: Complex  # (K, n, n) of T
    beyond: Array  # (K,) times |unit T|
    effect: Array  # (K, m + 1): relative size of what each parameter, and the position, does to the flow


class RowExpansion(NamedTuple):
    """Rows of K cells in balanced coordinates z: value, derivatives, and bounds of the rest for each basis tried."""

    A: Array  # (K, n, n)
    rows: Array  # (K, R, n)
    slopes: Array  # (K, m, R, n) per parameter, times its half-width in the cell
    rest: tuple[ExpansionRemainder, ...]
    # (K, n, n): |E z|^2 <= z'lost z of what times that are early or late do to the rows of the centre; None: on time
    lost: Array | None = None


def expanded(model: BoxModel, cells: BoxCells, times: Array, measured: Mask, late: float = 0.0) -> RowExpansion:
    """Expand the rows of samples at `times` (K, N) after the cell's window start; `measured` (K, N, p).

    Each sample may be up to `late` early or late: what that does is part of the rest, but for the cell's centre.
    Raises ArgumentError if growth over these times leaves the range of doubles.
    """
    K, N = times.shape
    n, m, p = model.n, model.m, len(model.C)
    A, C = model.at(cells.u)
    block = np.zeros((K, m, 2 * n, 2 * n))
    block[:, :, :n, :n] = block[:, :, n:, n:] = A[:, None]
    block[:, :, :n, n:] = cells.half[:, :, None, None] * model.parts_A
    there: Mask = np.any(measured, axis=2)
    r = np.where(there, np.maximum(times, 0.0), 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        if m:
            wide = exponentials(block[:, :, None] * r[:, None, :, None, None])
            flow, turned = wide[:, 0, :, :n, :n], wide[..., :n, n:]
        else:
            flow, turned = exponentials(A[:, None] * r[..., None, None]), np.zeros((K, 0, N, n, n))
    if not np.max(np.abs(flow), initial=0.0) < LARGEST:
        raise ArgumentError(
            f"`plant` must have e^(A t) that is a number, and its square, up to t = {short(float(r.max()))}: unstable "
            "modes of some plant of the box overflow. Ask for a shorter window or shorter gaps."
        )
    rows = C[:, None] @ flow
    slopes = C[:, None, None] @ turned
    slopes = slopes + (cells.half[:, :, None, None] * model.parts_C)[:, :, None] @ flow[:, None]
    rows = np.where(measured[..., None], rows, 0.0)
    slopes = np.where(measured[:, None, ..., None], slopes, 0.0)
    size = np.linalg.norm(C, axis=(1, 2))[:, None] * np.linalg.norm(flow, axis=(2, 3))
    grade = ALLOWANCE * np.maximum(1.0, np.linalg.norm(A, 1, axis=(1, 2)) * r.max(axis=1, initial=0.0) / 200)
    rounding = 9 * grade**2 * np.sum(np.where(there, size, 0.0) ** 2, axis=1)
    own = 101 * rounding[:, None, None] * np.eye(n)
    rests = []
    for T in bases(A, C, r.max(axis=1, initial=0.0)):
        inverse: Complex = np.asarray(np.linalg.inv(T), dtype=np.complex128)
        squared, beyond, effect = _rest(model, cells, (A, C, T, inverse), r, there, late)
        metric = np.real(np.conj(np.swapaxes(inverse, 1, 2)) @ inverse)
        with np.errstate(over="ignore", invalid="ignore"):
            bound = 1.01 * squared[:, None, None] * (metric + np.swapaxes(metric, 1, 2)) / 2 + own
        bound = np.where(np.isfinite(bound).all(axis=(1, 2))[:, None, None], bound, np.inf)
        beyond = beyond * np.linalg.norm(model.unit[:, None] * T, 2, axis=(1, 2))
        rests.append(ExpansionRemainder(bound, inverse, beyond, effect))
    flat, lost = rows.reshape(K, N * p, n), None
    if late:
        with np.errstate(over="ignore", invalid="ignore"):
            lost = np.nan_to_num(UP * lost_to_time(flat, A, late), nan=np.inf, posinf=np.inf)
    return RowExpansion(A, flat, slopes.reshape(K, m, N * p, n), tuple(rests), lost)


def norms_in(
    model: BoxModel, cells: BoxCells, A: Array, C: Array, T: Complex, inverse: Complex
) -> tuple[CellNorms[Array], Array, Array]:
    """The norms of cells in coordinates T, and what each parameter (K, m) by itself does to A and to C there."""
    B, output_size = inverse @ A @ T, np.linalg.norm(C @ T, 2, axis=(1, 2))
    size = np.linalg.norm(B, 2, axis=(1, 2))
    rate = np.linalg.eigvalsh((B + np.conj(np.swapaxes(B, 1, 2))) / 2)[:, -1]
    rate = rate + 64 * len(model.A) * EPS * np.linalg.cond(T) * size
    parts = np.linalg.norm(inverse[:, None] @ model.parts_A @ T[:, None], 2, axis=(2, 3))
    output_moves = np.linalg.norm(model.parts_C @ T[:, None], 2, axis=(2, 3))
    moved, more = (UP * np.sum(cells.half * each, axis=1)[:, None] for each in (parts, output_moves))
    return CellNorms(rate[:, None], size[:, None], moved, output_size[:, None], more, FLOATS), parts, output_moves


def _rest(
    model: BoxModel, cells: BoxCells, own: tuple[Array, Array, Complex, Complex], r: Array, there: Mask, late: float
) -> tuple[Array, Array, Array]:
    """In coordinates T: the square of the rows' rest, the rest of what moves the window, and relative effects.

    `own` is A, C, T and the inverse of T.
    """
    norms, parts, output_moves = norms_in(model, cells, *own)
    with np.errstate(over="ignore", invalid="ignore"):
        first, rest = norms.rows(r, norms.rate)
        rest = UP * (rest + norms.displaced(r, norms.rate, first + rest, late) if late else rest)
        squared = np.sum(np.where(there, rest, 0.0) ** 2, axis=1)
        beyond = UP * norms.turned(cells.h[:, None])[:, 0]
    effect = cells.half * (
        parts * r.max(axis=1, initial=0.0)[:, None] + output_moves / np.maximum(norms.output_size, 1e-300)
    )
    return squared, beyond, np.column_stack([effect, norms.size[:, 0] * cells.h])


def bases(A: Array, C: Array, longest: Array) -> list[Complex]:
    """Coordinates in which e^{A r} may be bounded: as they are, eigenvectors, a Schur basis with small couplings."""
    K, n = len(A), A.shape[1]
    identity = np.broadcast_to(np.eye(n, dtype=complex), (K, n, n))
    found = [identity]
    _, vectors = np.linalg.eig(A)
    vectors = vectors.astype(complex)
    fine = np.linalg.cond(vectors) < WORST_BASIS
    if fine.any():
        output_size = np.linalg.norm(C @ vectors, axis=1)
        most = output_size.max(axis=1, keepdims=True)
        output_size = np.where(output_size > 1e-6 * most, output_size, np.where(most > 0, most, 1.0))
        found.append(np.where(fine[:, None, None], vectors / output_size[:, None, :], identity))
    if not fine.all() or n > 1:
        found.append(np.array([_schur(M, float(t)) for M, t in zip(A, longest, strict=True)]))
    return found


def _schur(A: Array, longest: float) -> Complex:
    """Q D of A = Q U Q*: the couplings of D^-1 U D are at most about 1/(n longest) where that costs condition."""
    U, Q = linalg.schur(A, output="complex")
    n, d = len(A), np.ones(len(A))
    want = 1 / max(n * longest, 1e-300)
    for j in range(1, n):
        above = np.abs(U[:j, j]) / d[:j]
        worst = float(above.max())
        d[j] = min(d[j - 1], want / worst) if worst > 0 else d[j - 1]
    return np.asarray(Q * np.maximum(d, 1 / WORST_BASIS))


def exponentials(M: Array) -> Array:
    """e^M for a stack: a Taylor polynomial of M / 2^s, squared s times."""
    shape = M.shape
    flat = M.reshape(-1, *shape[-2:])
    size = np.linalg.norm(flat, 1, axis=(1, 2)) if len(flat) else np.zeros(0)
    s = np.maximum(0, np.ceil(np.log2(np.maximum(size, 1e-300)))).astype(int)
    scaled = np.ldexp(flat, -s[:, None, None])
    powers = [np.broadcast_to(np.eye(shape[-1]), flat.shape), scaled]
    for _ in range(FOLD - 1):
        powers.append(powers[-1] @ scaled)
    result = np.zeros_like(flat)
    for k in range(DEGREE // FOLD, -1, -1):  # Horner in M^FOLD
        part = sum(powers[j] / math.factorial(k * FOLD + j) for j in range(FOLD))
        result = result @ powers[FOLD] + part
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(int(s.max(initial=0))):
            todo = s > k
            part = result[todo]
            result[todo] = part @ part
    return np.asarray(result.reshape(shape))
