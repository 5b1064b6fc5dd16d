"""The independent checker of detectability certificates: needs numpy, json and the standard library alone.

    python dissipation_checker.py < certificate.json

It proves, for the very doubles in the file, P > 0 and N > 0,

    N = [[c_y C'C - A'P - PA - (1 + margin) eta P, -PG], [-G'P, c_w I]],

so that d/dt x'Px <= -eta x'Px + c_w |w|^2 + c_y |Cx|^2 along x' = Ax + Gw.
1. Each row and column is divided by the root of the size of its diagonal's terms: eigenvalues are relative to them.
2. The least eigenvalue is found in floats, with a bound of all rounding: of the entries, and of the eigenvalues.
3. Where the bound leaves the sign open, L D L' in rational numbers decides, without any rounding.
"""

import hashlib
import json
import sys
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np

EPS = float(np.finfo(float).eps)
EIGENVALUES = 8  # those of an (n, n) matrix M are computed to within this times n eps |M|_F
PLAIN = 1e-70, 1e70  # numbers of this size: no product of four underflows or overflows
INEQUALITY = "[[A'P + PA + (1 + margin) eta P - c_y C'C, PG], [G'P, -c_w I]] < 0"


class Refused(Exception):
    """The first thing that is wrong: inequality, reason and, where known, amount (relative) and direction."""


def check(data: dict[str, Any]) -> dict[str, Any]:
    """Return the verdict on the plain data of a certificate, in the form of `checker.check`, with a direction."""
    verdict = {"passed": False, "time": None, "start": None, "amount": 0.0, "direction": None}
    try:
        rest = {key: value for key, value in data.items() if key != "digest"}
        text = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
        if data["digest"] != hashlib.sha256(text.encode("utf-8")).hexdigest():
            raise Refused("digest", "the digest does not fit the content: something was altered")
        if data["claim"] != "detectability":
            raise Refused("claim", f"no proof is known here for the claim {data['claim']!r}")
        slack, how = detectability(data)
        reason = f"P > 0 and {INEQUALITY}, {how}"
        return {**verdict, "passed": True, "inequality": INEQUALITY, "amount": slack, "reason": reason}
    except Refused as refused:
        return {**verdict, **dict(zip(("inequality", "reason", "amount", "direction"), refused.args, strict=False))}
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, np.linalg.LinAlgError) as error:
        return {**verdict, "inequality": "form", "reason": f"the data are no certificate ({error!r})"}


def detectability(data: dict[str, Any]) -> tuple[float, str]:
    """Prove P > 0 and the dissipation inequality; return the relative slack of the latter, and how it was proven."""
    c = numbers(data)
    found = 1.0, "no states"
    for name in ("P > 0", INEQUALITY) if c.n else ():
        found = in_floats(name, c) or in_rationals(name, rational(c))
    return found


def forms(name: str, c: Any) -> tuple[Any, Any]:
    """The matrix that must be positive definite, and the sizes of its terms, summed."""
    A, C, G, P = (abs(X) for X in (c.A, c.C, c.G, c.P))
    if name == "P > 0":
        return c.P, P
    rate = (1 + c.margin) * c.eta
    return negative(c.A, c.C, c.G, c.P, c.c_y, c.c_w, rate, -1), negative(A, C, G, P, c.c_y, c.c_w, rate, 1)


def negative(A: Any, C: Any, G: Any, P: Any, c_y: Any, c_w: Any, rate: Any, sign: int) -> Any:
    """N for sign = -1; for sign = 1 and the sizes of all numbers, the sum of the sizes of its terms."""
    drift, off = A.T @ P, sign * (P @ G)
    corner = c_y * (C.T @ C) + sign * (drift + drift.T + rate * P)
    return np.block([[corner, off], [off.T, np.diag([c_w] * G.shape[1])]])


def numbers(data: dict[str, Any]) -> SimpleNamespace:
    """The numbers of a certificate as doubles, each checked for what it must be."""
    m = data["plant"]["matrices"]
    c = SimpleNamespace(n=len(m["A"]))
    c.A, c.C = np.array(m["A"], float).reshape(c.n, c.n), np.array(m["C"], float).reshape(len(m["C"]), c.n)
    c.G = np.array(m.get("G", np.eye(c.n)), float).reshape(c.n, len(m["G"][0]) if c.n and "G" in m else c.n)
    c.P = np.array(data["P"], float).reshape(c.n, c.n)
    for name in ("A", "C", "G", "P"):
        if not np.isfinite(getattr(c, name)).all():
            raise Refused(f"{name} finite", f"{name} is not finite")
    if np.any(np.abs(c.P - c.P.T) > 1e-12 * np.abs(c.P).max(initial=0.0)):
        raise Refused("P symmetric", "P is not symmetric")
    c.given, c.P = c.P, c.P / 2 + c.P.T / 2
    for name, least in (("eta", 5e-324), ("c_w", 5e-324), ("c_y", 5e-324), ("margin", 0.0)):
        setattr(c, name, float(data[name]))
        if not least <= getattr(c, name) < np.inf:
            raise Refused(f"{name} > 0", f"{name} must be positive, got {data[name]!r}")
    return c


def rational(c: Any) -> SimpleNamespace:
    """The same numbers without rounding; P is the symmetric part."""
    e = SimpleNamespace(**{name: Fraction(getattr(c, name)) for name in ("eta", "c_w", "c_y", "margin")})
    for name, X in (("A", c.A), ("C", c.C), ("G", c.G), ("P", c.given)):
        setattr(e, name, np.array([Fraction(x) for x in X.ravel().tolist()], dtype=object).reshape(X.shape))
    e.P = (e.P + e.P.T) / 2
    return e


def in_floats(name: str, c: Any) -> tuple[float, str] | None:
    """The slack if floats prove the inequality, Refused if they disprove it, None if rounding leaves it open."""
    numbers = np.abs(np.concatenate([*(X.ravel() for X in (c.A, c.C, c.G, c.P)), [c.eta, c.c_w, c.c_y, 1 + c.margin]]))
    if np.any((numbers != 0) & ((numbers < PLAIN[0]) | (numbers > PLAIN[1]))) or np.any(np.diag(c.P) == 0):
        return None
    N, terms = forms(name, c)
    size = np.sqrt(np.diag(terms))
    M = N / size / size[:, None]
    values, vectors = np.linalg.eigh(M)
    # each at most EPS/2: P = (P + P')/2, sums of n or p products, c_y, rate, four terms, the division by sizes
    roundings = c.n + len(c.C) + 12
    bound = EPS * (roundings * np.linalg.norm(terms / size / size[:, None]) + EIGENVALUES * len(M) * np.linalg.norm(M))
    how = f"rounding below {bound:.1g}"
    if values[0] < -bound:
        raise failure(name, float(values[0]), vectors[:, 0] / size, how)
    return (float(values[0]), f"by {values[0]:.3g} of the size of its terms ({how})") if values[0] > bound else None


def in_rationals(name: str, e: Any) -> tuple[float, str]:
    """The same without rounding; a proven inequality is nearer to tight than floats can tell."""
    N, terms = forms(name, e)
    x, value = downhill(N)
    if x is None:
        return 0.0, "by less of the size of its terms than floats can tell (proven in rational numbers)"
    size = np.diag(terms) @ (x * x)
    raise failure(name, float(value / size) if size else 0.0, (x / max(abs(x))).astype(float), "in rational numbers")


def downhill(N: Any) -> tuple[Any, Any]:
    """x with x'Nx <= 0 and this value, from the first pivot of L D L' that is not positive; None, None if N > 0."""
    n = len(N)
    N, X = N[::-1, ::-1].copy(), np.array([[Fraction(i == j) for j in range(n)] for i in range(n)])  # w comes first
    for k in range(n):
        if N[k, k] <= 0:
            return X[k, ::-1], N[k, k]
        factor = N[k + 1 :, k] / N[k, k]
        N[k + 1 :] -= np.outer(factor, N[k])
        X[k + 1 :] -= np.outer(factor, X[k])
    return None, None


def failure(name: str, amount: float, direction: Any, how: str) -> Refused:
    """What to say of an inequality that fails by `amount` along `direction`."""
    along = (direction / np.linalg.norm(direction)).tolist()
    shown = ", ".join(f"{x:.3g}" for x in along[:8]) + (", ..." if len(along) > 8 else "")
    reason = f"{name} fails by {-amount:.3g}, an eigenvalue relative to the size of its terms ({how}), along [{shown}]"
    return Refused(name, reason, amount, along)


if __name__ == "__main__":
    outcome = check(json.load(sys.stdin))
    print(outcome["reason"])
    sys.exit(0 if outcome["passed"] else 1)
