"""Certificates for inclusions in ball arithmetic: the inequalities of P(tau) for every plant of a model.

Corners of a box are formed in balls, without any rounding that is not counted. A nonlinear plant's program is
evaluated, with its derivatives, in balls over cells of the region, by another route than the checkers' intervals; where
the balls of a cell leave an inequality open, the corners of its Jacobian are tried, and then the cell is halved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from itertools import product

import numpy as np
import numpy.typing as npt

from sampling_design._ball_flow import Clock
from sampling_design._balls import Ball, Matrix, ball, definite, flint, floats, identity, matrix, symmetric
from sampling_design.certificates.form.seal import RESOLUTION
from sampling_design.certificates.rigorous.ball_problem import REFUTED, UNDECIDED, Decision, Unproven, positive_definite
from sampling_design.checkers.claims import certificate
from sampling_design.checkers.inclusion import FLOW, JUMP
from sampling_design.checkers.inclusion_file import Box, Inclusion, Region, Vertices, moved
from sampling_design.checkers.programs import Instruction

Array = npt.NDArray[np.float64]
Slopes = dict[tuple[str, int], Ball]
SUBJECT = "every plant of the model, all gaps in the range and every real window start"
SHARES = (0.9, 0.0)
"""Parts of the guessed least eigenvalue that are tried as a proven slack."""
WIDE = 1e-9
"""Radii of a Jacobian beyond this share of the largest have their ends tried apart."""
CORNERS = 5
DEPTH = 60
"""Halvings of a cell."""
FAR = 1e9
"""Half the width of what stands for an unbounded number: sine and cosine are between -1 and 1 there."""


def inclusion(data: Mapping[str, object], clock: Clock) -> Decision:
    """Prove all inequalities of a certificate for an inclusion; what was proven, for what, and the least slack.

    Raises
    ------
    Unproven
        If one of them certainly fails, or nothing is certain at this precision.
    """
    c = certificate(data)
    assert isinstance(c, Inclusion)
    name = f"{FLOW}, {JUMP}"
    if not c.plant.n:
        return Decision(name, SUBJECT, 1.0)
    w, P = c.weights, [symmetric(M) for M in c.P]
    P1, P2, Qw, R, Qv = (symmetric(M) for M in (w.P1, w.P2, w.Qw, w.R, w.Qv))
    for key, M in (("P1", P1), ("Qw", Qw), ("R", R), ("Qv", Qv)):
        positive_definite(key, M)
    low = P1 * (ball(1.0) + ball(w.margin))
    slacks = [positive("(1 + margin) P1 < P(tau)", M - low, M) for M in P]
    slacks += [positive("P(tau) < P2", P2 - M, P2) for M in P]
    top = P1 * ball(w.lam)
    slacks.append(positive("(1 - 1e-3) P2 < lam P1", top - P2 * (ball(1.0) - ball(RESOLUTION)), top))
    Rt = R * (R + Qv).solve(Qv)
    slacks.append(jumps(c, P, Rt, clock))
    slacks.append(flows(c, P, Qw, clock))
    return Decision(name, SUBJECT, min(slacks))


def positive(name: str, form: Matrix, size: Matrix, when: float | None = None) -> float:
    """A proven slack of form > 0 relative to the diagonal of `size`; Unproven where there is none."""
    n = form.nrows()
    roots = [abs(size[i, i]).sqrt() if abs(size[i, i]) > 0 else ball(1.0) for i in range(n)]
    M = flint().arb_mat([[form[i, j] / roots[i] / roots[j] for j in range(n)] for i in range(n)])
    guess = float(np.linalg.eigvalsh(floats(M))[0])
    for share in SHARES if guess > 0 else (0.0,):
        if definite(M - identity(n) * ball(share * guess)):
            return share * guess
    if definite(M) is False:
        raise Unproven(REFUTED, name, f"{name} certainly fails by {-guess:.3g}", amount=guess, time=when)
    raise Unproven(UNDECIDED, name, f"{name} could not be decided: it is tight or nearly so", amount=guess, time=when)


# --- members of a box or a list --------------------------------------------------------------------------------------


def members(c: Inclusion, keys: str) -> Iterator[list[Matrix]]:
    """The matrices of these keys at every vertex of the model that moves them."""
    if isinstance(c.model, Vertices):
        yield from ([matrix(getattr(c.model, key)[k]) for key in keys] for k in range(len(c.model.A)))
        return
    assert isinstance(c.model, Box)
    acting = [each for each in c.model.parameters if any(getattr(each, key).any() for key in keys)]
    for ends in product(*(sorted({each.low, each.high}) for each in acting)):
        found = [matrix(getattr(c.plant, key)) for key in keys]
        for each, end in zip(acting, ends, strict=True):
            by = ball(end) - ball(each.nominal)
            found = [M + matrix(getattr(each, key)) * by for M, key in zip(found, keys, strict=True)]
        yield found


def ends_of(c: Inclusion, P: list[Matrix]) -> list[tuple[Matrix, Matrix, float]]:
    """P, slope and tau at both ends of every piece."""
    found = []
    for i in range(len(P) - 1):
        slope = (P[i + 1] - P[i]) / (ball(c.nodes[i + 1]) - ball(c.nodes[i]))
        found += [(P[i], slope, float(c.nodes[i])), (P[i + 1], slope, float(c.nodes[i + 1]))]
    return found


def flow(P: Matrix, slope: Matrix, A: Matrix, G: Matrix, Qw: Matrix, eta: Ball) -> Matrix:
    """[-(P' + A'P + PA + eta P), -PG; -G'P, Qw]."""
    drift, off = P * A, P * G
    corner = (slope + drift + drift.transpose() + P * eta).tolist()
    side, n, q = off.tolist(), P.nrows(), Qw.nrows()
    rows = [[*(-x for x in corner[i]), *(-x for x in (side[i] if q else []))] for i in range(n)]
    rows += [[*(-side[i][k] for i in range(n)), *Qw.tolist()[k]] for k in range(q)]
    return flint().arb_mat(rows)


def sized(P: Matrix, slope: Matrix, A: Matrix, Qw: Matrix, eta: Ball) -> Matrix:
    """A diagonal with the size of the terms of each entry."""
    n, q = P.nrows(), Qw.nrows()
    values = []
    for i in range(n):
        drift = sum((abs(A[j, i]) * abs(P[j, i]) for j in range(n)), ball(0.0))
        values.append(abs(slope[i, i]) + 2 * drift + eta * abs(P[i, i]))
    values += [Qw[k, k] for k in range(q)]
    return flint().arb_mat([[values[i] if i == j else ball(0.0) for j in range(n + q)] for i in range(n + q)])


def flows(c: Inclusion, P: list[Matrix], Qw: Matrix, clock: Clock) -> float:
    """The flow condition for every member."""
    eta, every = ball(c.weights.eta), ends_of(c, P)
    if isinstance(c.model, Region):

        def judge(A: Matrix, G: Matrix) -> Iterator[Matrix]:
            return (flow(p, slope, A, G, Qw, eta) for p, slope, _ in every)

        return Cells(c, c.model, clock).prove(FLOW, lambda M: judge(*parted(M, c.plant.n)), True)
    if c.multipliers is not None:
        return multiplied(c, every, Qw, clock)
    slack = 1.0
    for A, G in members(c, "AG"):
        for p, slope, tau in every:
            clock.check()
            slack = min(slack, positive(FLOW, flow(p, slope, A, G, Qw, eta), sized(p, slope, A, Qw, eta), tau))
    return slack


def multiplied(c: Inclusion, every: list[tuple[Matrix, Matrix, float]], Qw: Matrix, clock: Clock) -> float:
    """The flow condition with multipliers; see `checkers/inclusion.py`."""
    assert isinstance(c.model, Box)
    assert c.multipliers is not None
    n, q = c.plant.n, Qw.nrows()
    middle, columns, chosen = matrix(np.hstack([c.plant.A, c.plant.G])), [], []
    for each in c.model.parameters:
        M = np.hstack([each.A, each.G])
        middle += matrix(M) * ((ball(each.low) - ball(each.nominal) + ball(each.high) - ball(each.nominal)) / 2)
        half = (ball(each.high) - ball(each.low)) / 2
        for k in moved(each):
            columns.append(matrix(M[:, [k]]) * half)
            chosen.append(k)
    A, G = parted(middle, n)
    eta, slack, m = ball(c.weights.eta), 1.0, len(columns)
    for (p, slope, tau), weights in zip(every, c.multipliers.reshape(len(every), m), strict=True):
        clock.check()
        form, size = flow(p, slope, A, G, Qw, eta).tolist(), sized(p, slope, A, Qw, eta).tolist()
        for k, z in enumerate(chosen):
            form[z][z] -= ball(weights[k])
            size[z][z] += ball(weights[k])
        sides = [(p * column).entries() for column in columns]
        rows = [[*form[i], *(-side[i] if i < n else ball(0.0) for side in sides)] for i in range(n + q)]
        sizes = [[*size[i], *([ball(0.0)] * m)] for i in range(n + q)]
        for k, side in enumerate(sides):
            own = [ball(weights[k]) if j == k else ball(0.0) for j in range(m)]
            rows.append([*(-side[i] if i < n else ball(0.0) for i in range(n + q)), *own])
            sizes.append([*([ball(0.0)] * (n + q)), *own])
        slack = min(slack, positive(FLOW, flint().arb_mat(rows), flint().arb_mat(sizes), tau))
    return slack


def jumps(c: Inclusion, P: list[Matrix], Rt: Matrix, clock: Clock) -> float:
    """The jump condition for every member."""
    C0 = matrix(c.plant.C)
    own = C0.transpose() * Rt * C0
    later = [(M, float(t)) for M, t in zip(P, c.nodes, strict=True) if c.shortest <= t <= c.longest]

    def form(M: Matrix, C: Matrix) -> Matrix:
        cross = C.transpose() * Rt * C0
        return M - P[0] + cross + cross.transpose() - own

    if isinstance(c.model, Region):
        return Cells(c, c.model, clock).prove(JUMP, lambda C: (form(M, C) for M, _ in later), False)
    slack = 1.0
    for (C,) in members(c, "C"):
        for M, tau in later:
            clock.check()
            slack = min(slack, positive(JUMP, form(M, C), M + P[0] + own, tau))
    return slack


def parted(M: Matrix, n: int) -> tuple[Matrix, Matrix]:
    """The first n columns and the others."""
    rows, q = M.tolist(), M.ncols() - n
    empty = flint().arb_mat(len(rows), 0, [])
    A = flint().arb_mat([row[:n] for row in rows])
    return A, flint().arb_mat([row[n:] for row in rows]) if q else empty


# --- the cells of a nonlinear plant's region -------------------------------------------------------------------------


class Cells:
    """The region, halved until all forms are positive for the Jacobians of every cell."""

    def __init__(self, c: Inclusion, region: Region, clock: Clock) -> None:
        self.c, self.region, self.clock = c, region, clock
        self.keys = [(key, k) for key in ("x", "u", "w") for k in range(len(region.low[key]))]
        root = np.sqrt(np.einsum("kii->i", c.P) / len(c.P))
        self.root = root

    def prove(self, name: str, forms: Callable[[Matrix], Iterator[Matrix]], of_f: bool) -> float:
        """Raise Unproven unless every form is positive; the slack is not measured: 0 stands for "some"."""
        low = np.concatenate([self.region.low[key] for key in ("x", "u", "w")])
        high = np.concatenate([self.region.high[key] for key in ("x", "u", "w")])
        pending = [(low, high, 0)]
        while pending:
            self.clock.check()
            a, b, depth = pending.pop()
            if self.outside(a, b):
                continue
            found = self.assembly(a, b, of_f)
            if found is not None and self.holds(found, forms, of_f):
                continue
            self.refute(name, a, b, forms, of_f)
            side = self.side(a, b, of_f)
            if side is None or depth >= DEPTH:
                raise Unproven(UNDECIDED, name, f"{name} could not be decided: it is tight or nearly so")
            middle = a[side] / 2 + b[side] / 2
            left, right = b.copy(), a.copy()
            left[side] = right[side] = middle
            pending += [(a, left, depth + 1), (right, b, depth + 1)]
        return 0.0

    def holds(self, found: Assembly, forms: Callable[[Matrix], Iterator[Matrix]], of_f: bool) -> bool:
        """Whether all forms are positive for all matrices of a cell: as they are, else at ends of the widest slopes."""
        if all(definite(form) is True for form in forms(found.matrix({}))):
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
            if not all(definite(form) is True for form in forms(found.matrix(ends))):
                return False
        return True

    def refute(self, name: str, a: Array, b: Array, forms: Callable[[Matrix], Iterator[Matrix]], of_f: bool) -> None:
        """Raise Unproven(REFUTED) if a form certainly fails in the middle of a cell that lies in the region."""
        with np.errstate(invalid="ignore"):
            at = np.where(np.isfinite(a) & np.isfinite(b), a / 2 + b / 2, np.clip(0.0, a, b))
        n = self.c.plant.n
        if np.any(self.region.rows @ at[:n] > self.region.offsets):
            return
        M = self.jacobian(at, at, of_f)
        if M is not None and any(definite(form) is False for form in forms(M)):
            where = ", ".join(f"{x:.6g}" for x in at[:n])
            raise Unproven(REFUTED, name, f"{name} fails at x = [{where}]")

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

    def assembly(self, a: Array, b: Array, of_f: bool) -> Assembly | None:
        """(A, G) or C over a cell as what its slopes make of it; None where it is not finite."""
        inputs = {key: hull(low, high) for key, low, high in zip(self.keys, a.tolist(), b.tolist(), strict=True)}
        n, q = self.c.plant.n, self.c.plant.G.shape[1]
        program = self.region.f if of_f else self.region.h
        columns = [("x", k) for k in range(n)] + [("w", k) for k in range(q if of_f else 0)]
        found = Assembly(program.code, program.outputs, columns, differentiated(program.code, inputs))
        return found if all(x.is_finite() for x in found.matrix({}).entries()) else None


class Assembly:
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
        return flint().arb_mat([[made[k].get(column, zero) for column in self.columns] for k in self.outputs])

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
    value = x * x
    return value.nonnegative_part() if hasattr(value, "nonnegative_part") else value


def powered(x: Ball, exponent: float) -> tuple[Ball, Ball]:
    """x to a constant."""
    if exponent == int(exponent):
        k = int(exponent)
        return x**k, ball(exponent) * x ** (k - 1)
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
