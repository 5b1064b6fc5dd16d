"""The region of a nonlinear plant in balls: its program, over cells that are halved until all hold."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import product

import numpy as np

from sampling_design.checkers.inclusion_file import Inclusion, Region
from sampling_design.checkers.outcome import Refused, Undecided
from sampling_design.checkers.programs import Instruction
from sampling_design.numerics.balls import Ball, Matrix, ball, definite, flint, floats, matrix, stacked
from sampling_design.numerics.branch_and_bound import all_proven
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Budget

Slopes = dict[tuple[str, int], Ball]
Forms = Callable[[Matrix, Matrix], Iterator[Matrix]]
"""What must be positive for a Jacobian of a cell whose middle is the second matrix."""
WIDE = 1e-9  # radii of a Jacobian beyond this share of the largest have their ends tried apart
CORNERS = 5
DEPTH = 60
"""Halvings of a cell."""
PRICE = 100  # work, about microseconds, of an instruction of the programs over a cell and its halves
FAR = 1e9  # half the width of what stands for an unbounded number: sine and cosine are between -1 and 1 there


def split_columns(M: Matrix, n: int) -> tuple[Matrix, Matrix]:
    """The first n columns and the others."""
    rows = M.tolist()
    return stacked([row[:n] for row in rows]), stacked([row[n:] for row in rows])


def mid(M: Matrix) -> Matrix:
    """The middles of balls."""
    return matrix(floats(M))


RegionCell = tuple[Array, Array, int]


class JacobianCells:
    """The region, halved until all forms are positive for the Jacobians of every cell."""

    def __init__(self, c: Inclusion, region: Region, clock: Budget) -> None:
        self.c, self.region, self.clock = c, region, clock
        self.keys = [(key, k) for key in ("x", "u", "w") for k in range(len(region.low[key]))]
        root = np.sqrt(np.einsum("kii->i", c.P) / len(c.P))
        self.root = root

    def prove(self, name: str, forms: Forms, of_f: bool) -> float:
        """Raise Refused unless every form is positive; the slack is not measured: 0 stands for "some"."""
        low = np.concatenate([self.region.low[key] for key in ("x", "u", "w")])
        high = np.concatenate([self.region.high[key] for key in ("x", "u", "w")])

        def parts_of(cell: RegionCell) -> list[RegionCell]:
            a, b, depth = cell
            if self.outside(a, b):
                return []
            found = self.assembly(a, b, of_f)
            if found is not None and self.holds(found, forms, of_f):
                return []
            self.refute(name, a, b, forms, of_f)
            side = self.side(a, b, of_f)
            if side is None or depth >= DEPTH:
                raise Undecided(name, f"{name} could not be decided: it is tight or nearly so")
            middle = a[side] / 2 + b[side] / 2
            left, right = b.copy(), a.copy()
            left[side] = right[side] = middle
            return [(a, left, depth + 1), (right, b, depth + 1)]

        price = PRICE * (len(self.region.f.code) + len(self.region.h.code))
        all_proven([(low, high, 0)], parts_of, self.clock, price)
        return 0.0

    def holds(self, found: OutputAssembly, forms: Forms, of_f: bool) -> bool:
        """Whether all forms are positive for all matrices of a cell: as they are, else at ends of the widest slopes."""
        whole = found.matrix({})
        middle = mid(whole)
        if all(definite(form) is True for form in forms(whole, middle)):
            return True
        widths = {key: self.effect(size, of_f).max(initial=0.0) for key, size in found.widths().items()}
        top = max(widths.values(), default=0.0)
        wide = [key for key in sorted(widths, key=lambda key: -widths[key])[:CORNERS] if widths[key] > WIDE * top]
        if not wide or not top > 0:
            return False
        for signs in product((-1, 1), repeat=len(wide)):
            ends = {
                key: found.slopes[key].upper() if sign > 0 else found.slopes[key].lower()
                for key, sign in zip(wide, signs, strict=True)
            }
            if not all(definite(form) is True for form in forms(found.matrix(ends), middle)):
                return False
        return True

    def refute(self, name: str, a: Array, b: Array, forms: Forms, of_f: bool) -> None:
        """Raise Refused if a form certainly fails in the middle of a cell that lies in the region."""
        with np.errstate(invalid="ignore"):
            at = np.where(np.isfinite(a) & np.isfinite(b), a / 2 + b / 2, np.clip(0.0, a, b))
        n = self.c.plant.n
        if np.any(self.region.rows @ at[:n] > self.region.offsets):
            return
        M = self.jacobian(at, at, of_f)
        if M is not None and any(definite(form) is False for form in forms(M, M)):
            where = ", ".join(f"{x:.6g}" for x in at[:n])
            raise Refused(name, f"{name} fails at x = [{where}]")

    def outside(self, a: Array, b: Array) -> bool:
        """Whether a cell certainly lies outside of a half-space."""
        for row, offset in zip(self.region.rows, self.region.offsets, strict=True):
            ends = [(ball(r) * ball(low if r > 0 else high)) for r, low, high in zip(row, a, b, strict=False) if r]
            if all(np.isfinite(float(x)) for x in ends) and sum(ends, ball(0.0)) > ball(offset):
                return True
        return False

    def side(self, a: Array, b: Array, of_f: bool) -> int | None:
        """The side whose halving narrows the Jacobian most."""
        best: tuple[float, int | None] = (np.inf, None)
        for j in range(a.size):
            if not (np.isfinite(a[j]) and np.isfinite(b[j]) and a[j] < b[j]):
                continue
            left, right = b.copy(), a.copy()
            left[j] = right[j] = a[j] / 2 + b[j] / 2
            cost = sum(self.width(*ends, of_f) for ends in ((a, left), (right, b)))
            best = min(best, (cost, j), key=lambda item: item[0])
        return best[1]

    def width(self, a: Array, b: Array, of_f: bool) -> float:
        """How wide the Jacobian is over a cell."""
        M = self.jacobian(a, b, of_f)
        if M is None:
            return 1e200
        radii = np.array([float(x.rad()) for x in M.entries()]).reshape(M.nrows(), M.ncols())
        return float(np.square(np.minimum(self.effect(radii, of_f), 1e90)).sum())

    def effect(self, radii: Array, of_f: bool) -> Array:
        """Radii in units in which P is about the identity."""
        n = self.c.plant.n
        left = self.root if of_f else np.ones(radii.shape[0])
        right = np.concatenate([self.root, np.ones(radii.shape[1] - n)])
        return np.asarray(radii * left[:, None] / right)

    def jacobian(self, a: Array, b: Array, of_f: bool) -> Matrix | None:
        """(A, G) or C over a cell; None where it is not finite."""
        found = self.assembly(a, b, of_f)
        return None if found is None else found.matrix({})

    def assembly(self, a: Array, b: Array, of_f: bool) -> OutputAssembly | None:
        """(A, G) or C over a cell as what its slopes make of it; None where it is not finite."""
        inputs = {key: hull(low, high) for key, low, high in zip(self.keys, a.tolist(), b.tolist(), strict=True)}
        n, q = self.c.plant.n, self.c.plant.G.shape[1]
        program = self.region.f if of_f else self.region.h
        columns = [("x", k) for k in range(n)] + [("w", k) for k in range(q if of_f else 0)]
        found = OutputAssembly(program.code, program.outputs, columns, differentiated(program.code, inputs))
        return found if all(x.is_finite() for x in found.matrix({}).entries()) else None


class OutputAssembly:
    """The derivatives of outputs from those of what is not linear in earlier instructions.

    A slope that several outputs share is one and the same number in all of them.
    """

    def __init__(
        self,
        code: tuple[Instruction, ...],
        outputs: tuple[int, ...],
        columns: list[tuple[str, int]],
        done: list[tuple[Ball, Slopes]],
    ) -> None:
        self.code, self.outputs, self.columns, self.done = code, outputs, columns, done
        self.fixed: list[bool] = []
        for each in code:
            inner = each.word not in ("x", "u", "w")
            self.fixed.append(inner and all(self.fixed[k] for k in each.places))
        self.slopes: dict[tuple[int, tuple[str, int]], Ball] = {
            (at, column): slope
            for at, each in enumerate(code)
            if not self.fixed[at] and each.word not in ("x", "u", "w") and not self.linear(each)
            for column, slope in done[at][1].items()
        }

    def linear(self, each: Instruction) -> bool:
        """Whether an instruction is linear in what is not constant among its arguments."""
        if each.word == "mul":
            return any(self.fixed[k] for k in each.places)
        return each.word in ("neg", "twice", "add", "sub") or (each.word == "div" and self.fixed[each.places[1]])

    def matrix(self, ends: Mapping[tuple[int, tuple[str, int]], Ball]) -> Matrix:
        """The derivatives, some slopes replaced by an end of theirs."""
        made: list[Slopes] = []
        for at, each in enumerate(self.code):
            if self.fixed[at] or each.word == "u":
                made.append({})
            elif each.word in ("x", "w"):
                made.append({(each.word, each.places[0]): ball(1.0)})
            elif not self.linear(each):
                made.append({column: ends.get((at, column), slope) for column, slope in self.done[at][1].items()})
            elif each.word in ("neg", "twice"):
                factor = ball(-1.0 if each.word == "neg" else 2.0)
                made.append({key: factor * part for key, part in made[each.places[0]].items()})
            else:
                pair = [(self.done[k][0], made[k]) for k in each.places]
                made.append(joined(each.word, pair[0], pair[1])[1])
        zero = ball(0.0)
        return stacked([[made[k].get(column, zero) for column in self.columns] for k in self.outputs])

    def widths(self) -> dict[tuple[int, tuple[str, int]], Array]:
        """By how much each slope moves the derivatives: its radius times what one of it adds."""
        still = dict.fromkeys(self.slopes, ball(0.0))
        base = floats(self.matrix(still))
        found = {}
        for key, slope in self.slopes.items():
            if float(slope.rad()) > 0:
                found[key] = np.abs(floats(self.matrix({**still, key: ball(1.0)})) - base) * float(slope.rad())
        return found


def hull(low: float, high: float) -> Ball:
    """A ball that holds [low, high]; unbounded ends reach far."""
    a, b = max(low, -FAR), min(high, FAR)
    if low == high:
        return ball(low)
    lower, upper = ball(a), ball(b)
    found = lower.union(upper)
    whole: Ball = flint().arb(0, float("inf"))
    return found if np.isfinite(low) and np.isfinite(high) else whole


def differentiated(code: tuple[Instruction, ...], inputs: dict[tuple[str, int], Ball]) -> list[tuple[Ball, Slopes]]:
    """Values and derivatives of all instructions, in balls."""
    done: list[tuple[Ball, Slopes]] = []
    for each in code:
        name, places = each.word, each.places
        if name == "constant":
            done.append((ball(each.value), {}))
        elif name in ("x", "u", "w"):
            key = (name, places[0])
            done.append((inputs[key], {} if name == "u" else {key: ball(1.0)}))
        elif name in ("add", "sub", "mul", "div"):
            done.append(joined(name, done[places[0]], done[places[1]]))
        else:
            x, slopes = done[places[0]]
            value, slope = powered(x, each.value) if name == "power" else single(name, x)
            done.append((value, {key: slope * part for key, part in slopes.items()}))
    return done


def joined(name: str, a: tuple[Ball, Slopes], b: tuple[Ball, Slopes]) -> tuple[Ball, Slopes]:
    """Sum, difference, product, quotient."""
    (x, dx), (y, dy) = a, b
    if name == "add":
        value, left, right = x + y, ball(1.0), ball(1.0)
    elif name == "sub":
        value, left, right = x - y, ball(1.0), ball(-1.0)
    elif name == "mul":
        value, left, right = x * y, y, x
    else:
        value, left = x / y, 1 / y
        right = -value / y
    slopes = {key: left * part for key, part in dx.items()}
    for key, part in dy.items():
        slopes[key] = slopes.get(key, ball(0.0)) + right * part
    return value, slopes


def squared(x: Ball) -> Ball:
    """x^2, never negative."""
    value: Ball = (x * x).nonnegative_part()
    return value


def whole_power(x: Ball, k: int) -> Ball:
    """x^k; python-flint's own is no number where the middle of x is zero."""
    if k < 0:
        return 1 / whole_power(x, -k)
    found = ball(1.0)
    while k:  # a file may hold exponents of hundreds of digits
        found, x, k = found * x if k % 2 else found, squared(x), k // 2
    return found


def powered(x: Ball, exponent: float) -> tuple[Ball, Ball]:
    """x to a constant."""
    if exponent == int(exponent):
        k = int(exponent)
        return whole_power(x, k), ball(exponent) * whole_power(x, k - 1)
    value = (ball(exponent) * x.log()).exp()
    return value, ball(exponent) * value / x


def single(name: str, x: Ball) -> tuple[Ball, Ball]:
    """A function of one number, and its slope."""
    if name == "abs":
        return abs(x), x.sgn()
    found = {
        "neg": lambda: (-x, ball(-1.0)),
        "twice": lambda: (2 * x, ball(2.0)),
        "square": lambda: (squared(x), 2 * x),
        "inverse": lambda: (1 / x, -1 / squared(x)),
        "sqrt": lambda: (x.sqrt(), 1 / (2 * x.sqrt())),
        "exp": lambda: (x.exp(), x.exp()),
        "log": lambda: (x.log(), 1 / x),
        "sin": lambda: (x.sin(), x.cos()),
        "cos": lambda: (x.cos(), -x.sin()),
        "tan": lambda: (x.tan(), 1 + squared(x.tan())),
        "atan": lambda: (x.atan(), 1 / (1 + squared(x))),
        "tanh": lambda: (x.tanh(), 1 - squared(x.tanh())),
        "sinh": lambda: (x.sinh(), x.cosh()),
        "cosh": lambda: (x.cosh(), x.sinh()),
    }
    return found[name]()
