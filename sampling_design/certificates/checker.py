"""The independent checker of certificate files (`python checker.py < certificate.json`): numpy, json, hashlib alone.

It proves Pi = Y^-1 >= target for every real window start, Y(start) = P2^-1, and every later t; Y' = A Y + Y A' + eta Y
+ G Qw^-1 G', at a sample Y+ = Y - Y C'(C Y C' + R^-1 + Qv^-1)^-1 C Y; in coordinates where the target is I: Y <= I.
1. Between samples Y'' = F Y''(0) F': on a step of length d, Y <= chord + (d^2/8) sup|Y''| I. So it is along the starts.
2. With one window's gains, Y of another start is at most affine in its first value: two ends cover a cell of starts.
3. The recursion is monotone: a window below a family B_i that it maps below itself need not be followed any further.
"""

import hashlib
import json
import runpy
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np

RESOLUTION = 1e-3  # lam and lam_samples are right to within this fraction
CELLS = 4  # start cells per gap at first
ROUNDS = 60  # halvings of a cell or of a time step: below the resolution of a double
MAX_OPEN = 100_000  # open cells or steps at once
LAPS = 1000  # along one window, or until a family settles; a tenth where there is no family to fall below
INFLATION = 1e-2  # noise added per gap, where the target is I, to find the family B_i; then less and less


class Refused(Exception):
    """The first thing that is wrong: inequality, reason and, where known, amount (relative), time, window start."""


def check(data: dict[str, Any]) -> dict[str, Any]:
    """Return the verdict on the plain data of a certificate: passed, inequality, reason, amount, time, start."""
    verdict = {"passed": False, "time": None, "start": None, "amount": 0.0}
    try:
        rest = {key: value for key, value in data.items() if key != "digest"}
        text = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
        if data["digest"] != hashlib.sha256(text.encode("utf-8")).hexdigest():
            raise Refused("digest", "the digest does not fit the content: something was altered")
        if (claim := (data["claim"], data["times"]["kind"])) not in CLAIMS:
            raise Refused("claim", f"no proof is known for the claim {claim[0]!r} on times {claim[1]!r}")
        inequality, slack = CLAIMS[claim](data)
        reason = f"{inequality} for every real window start and every later t, slack {slack:.3g}"
        return {**verdict, "passed": True, "inequality": inequality, "amount": slack, "reason": reason}
    except Refused as refused:
        return {**verdict, **dict(zip(("inequality", "reason", "amount", "time", "start"), refused.args, strict=False))}
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, np.linalg.LinAlgError) as error:
        return {**verdict, "inequality": "form", "reason": f"the data are no certificate ({error!r})"}


def assumption_7(data: dict[str, Any]) -> tuple[str, float]:
    """Prove P1 and lam over all real starts, lam_samples over sample starts, and the witness; return the slack."""
    c = numbers(data)
    resolved = (1 - RESOLUTION) * c.P2
    targets = [((1 + c.margin) * c.P1, "(1 + margin) P1 <= Pi(t)"), (resolved / c.lam, "(1 - 1e-3) P2 <= lam Pi(t)")]
    inequality = " and ".join(name for _, name in targets)
    if not c.n:
        return inequality, 1.0
    for k in (0, 1):  # a target that lies below the other is proven with it
        if len(targets) == 2 and np.linalg.eigvalsh(targets[1 - k][0] - targets[k][0])[0] >= 0:
            targets.pop(k)
    slack = min(Proof(c, target, name).prove() for target, name in targets)
    Proof(c, resolved / c.lam_samples, "(1 - 1e-3) P2 <= lam_samples Pi(t), sample starts").prove(samples=True)
    if data["witness"] is not None:
        Proof(c, c.P2, "witness").attained(data["witness"])
    return inequality, slack


CLAIMS = {("assumption-7", "periodic"): assumption_7, ("assumption-7", "finite"): assumption_7}


def numbers(data: dict[str, Any]) -> SimpleNamespace:
    """The numbers of a certificate, each checked for what it must be."""
    m, times = data["plant"]["matrices"], data["times"]
    c = SimpleNamespace(n=len(m["A"]), periodic=times["kind"] == "periodic")
    c.A, c.C = np.array(m["A"], float).reshape(c.n, c.n), np.array(m["C"], float).reshape(len(m["C"]), c.n)
    c.G = np.array(m.get("G", np.eye(c.n)), float).reshape(c.n, len(data["Qw"]))
    for name, size in {"P1": c.n, "P2": c.n, "R": len(c.C), "Qv": len(c.C), "Qw": len(data["Qw"])}.items():
        X = np.array(data[name], float).reshape(size, size)
        if not np.isfinite(X).all() or np.any(np.abs(X - X.T) > 1e-12 * np.abs(X).max(initial=0.0)):
            raise Refused(f"{name} symmetric", f"{name} is not symmetric and finite")
        least = float(np.linalg.eigvalsh(X)[0]) if size else 1.0
        if least < -1e-15 * np.abs(X).max(initial=0.0) or (least <= 0 and name != "Qw"):
            raise Refused(f"{name} > 0", f"{name} is not positive definite: least eigenvalue {least:.3g}", least)
        setattr(c, name, X)
    for name, least in (("eta", 5e-324), ("lam", 5e-324), ("lam_samples", 5e-324), ("margin", 0.0)):
        setattr(c, name, float(data[name]))
        if not least <= getattr(c, name) < np.inf:
            raise Refused(f"{name} > 0", f"{name} must be positive, got {data[name]!r}")
    c.gaps = np.array(times["gaps"] if c.periodic else np.diff(times["times"], prepend=0.0), float)
    c.N, c.period, c.first = c.gaps.size, c.gaps.sum(), float(times["first"] if c.periodic else c.gaps[0])
    c.seen = np.ones((c.N, len(c.C)), bool) if times["outputs"] is None else np.array(times["outputs"]).astype(bool)
    if not (np.all(c.gaps[not c.periodic :] > 0) and 0 <= c.first <= c.period < np.inf and c.seen.any(axis=1).all()):
        raise Refused("times", "times must increase strictly, the first within the period, and each measure an output")
    c.times = c.first + np.concatenate([[0.0], np.cumsum(c.gaps[1:])])
    c.reach = np.maximum(c.gaps, np.where(np.arange(c.N) == 0, c.first, 0.0))
    return c


def turned(M: Any) -> Any:
    """Transpose of each matrix of a stack."""
    return np.swapaxes(M, -1, -2)


def largest(U: Any, limit: float = 0.0) -> Any:
    """Largest eigenvalue of each matrix of a stack, or an upper bound of it where that is below `limit` already."""
    mean = np.trace(U, axis1=-2, axis2=-1) / U.shape[-1]
    spread = np.maximum(np.einsum("...ij,...ij->...", U, U) / U.shape[-1] - mean**2, 0.0)
    bound = mean + np.sqrt((U.shape[-1] - 1) * spread)
    close = ~(bound < limit)
    bound[close] = np.linalg.eigvalsh(U[close])[..., -1]
    return bound


class Proof:
    """Proof of Y <= I in the coordinates of one target."""

    def __init__(self, c: Any, target: Any, inequality: str) -> None:
        self.c, self.inequality, self.I = c, inequality, np.eye(c.n)
        self.L = L = np.linalg.cholesky(target)
        self.A = L.T @ np.linalg.solve(L, c.A.T).T + c.eta / 2 * self.I
        weights, vectors = np.linalg.eigh(c.Qw)
        live = weights > weights.size * np.finfo(float).eps * weights.max(initial=0.0)
        if np.linalg.norm(c.G @ vectors[:, ~live]) > 1e-12 * np.linalg.norm(c.G):
            raise Refused("Qw > 0", "Qw is singular in a direction that drives the plant")
        drive = L.T @ (c.G @ vectors[:, live]) / np.sqrt(weights[live])
        self.S, self.Y0 = drive @ drive.T, L.T @ np.linalg.solve(c.P2, L)
        self.rows, V = np.zeros((c.N, len(c.C), c.n)), np.linalg.inv(c.R) + np.linalg.inv(c.Qv)
        for i, seen in enumerate(c.seen):
            root = np.linalg.cholesky(V[np.ix_(seen, seen)])
            self.rows[i, : seen.sum()] = np.linalg.solve(root, np.linalg.solve(L, c.C[seen].T).T)
        self.square, self.bend = self.A @ self.A, self.A @ self.S + self.S @ self.A.T
        poles, modes = np.linalg.eig(self.A)
        self.growth = max(poles.real.max(), 0.0), max(np.linalg.eigvalsh(self.A + self.A.T)[-1] / 2, 0.0)
        self.skew, self.reached, self.known = np.linalg.cond(modes), 0.0, dict[float, Any]()
        self.F, self.W = self.flow(c.gaps)

    def flow(self, durations: Any) -> tuple[Any, Any]:
        """F and W, Y -> F Y F' + W, of each duration; one that came before is remembered."""
        asked = np.ravel(durations).tolist()
        if new := [h for h in dict.fromkeys(asked) if h not in self.known]:
            self.known.update(zip(new, np.stack(self.doubled(np.array(new)), 1), strict=True))
        both = np.array([self.known[h] for h in asked]).reshape(-1, 2, self.c.n, self.c.n)
        return both[:, 0], both[:, 1]

    def moved(self, Y: Any, durations: Any) -> Any:
        """F Y F' + W for each duration."""
        F, W = self.flow(durations)
        return F @ Y @ turned(F) + W

    def doubled(self, h: Any) -> tuple[Any, Any]:
        """F and W by the (8, 8) Pade approximant of Van Loan's block on a short step, then doubling."""
        n, norm = self.c.n, np.fmax(np.linalg.norm(self.A, 1), 1e-300)
        doublings = np.maximum(0, np.ceil(np.log2(np.maximum(2 * h * norm, 1e-300)))).astype(int)
        size = np.fmax(np.linalg.norm(self.S, 1), 1e-300) / norm
        X = np.block([[-self.A, self.S / size], [0 * self.A, self.A.T]]) * np.ldexp(h, -doublings)[:, None, None]
        term = top = bottom = np.broadcast_to(np.eye(2 * n), X.shape)
        for k in range(1, 9):
            term = term @ X * ((9 - k) / (k * (17 - k)))
            top, bottom = top + term, bottom + (-1) ** k * term
        E = np.linalg.solve(bottom, top)
        F = turned(E[:, n:, n:]).copy()
        W = size * F @ E[:, :n, n:]
        for s in range(int(doublings.max(initial=0))):
            k = doublings > s
            W[k], F[k] = W[k] + F[k] @ W[k] @ turned(F[k]), F[k] @ F[k]
        return F, (W + turned(W)) / 2

    def curvature(self, Y: Any, step: Any) -> Any:
        """A bound of (d^2/8) |Y''| over the step d that begins at Y."""
        second = self.square @ Y + 2 * self.A @ Y @ self.A.T + Y @ self.square.T + self.bend
        flow = np.exp(np.minimum(np.minimum(np.log(self.skew) + self.growth[0] * step, self.growth[1] * step), 300))
        return (step * flow) ** 2 / 8 * np.linalg.norm(second, axis=(-2, -1))

    def sample(self, Y: Any, at: Any) -> tuple[Any, Any]:
        """Y after sample `at` (Joseph's form), and the map I - K C."""
        C = self.rows[at]
        K = turned(np.linalg.solve(np.eye(C.shape[-2]) + C @ Y @ turned(C), C @ Y))
        left = self.I - K @ C
        return left @ Y @ turned(left) + K @ turned(K), left

    def stretch(self, U: Any, duration: Any) -> Any:
        """For each U: is F U F' + W <= I proven all along `duration`? Halves the time steps that are not yet."""
        good, owner, step, left = np.ones(len(U), bool), np.arange(len(U)), np.array(duration, float), largest(U, 0.5)
        good[left > 1] = False
        for _ in range(ROUNDS):
            U, owner, step, left = (part[good[owner]] for part in (U, owner, step, left))
            if not owner.size or owner.size > MAX_OPEN:
                break
            right = largest(self.moved(U, step), 0.5)
            bound = np.maximum(left, right) + self.curvature(U, step)
            self.reached = max(self.reached, bound[bound <= 1].max(initial=0.0))
            good[owner[right > 1]] = False
            U, owner, step, left = (part[~(bound <= 1)] for part in (U, owner, step, left))
            U = np.concatenate([U, self.moved(U, step / 2)])
            middle = largest(U[len(left) :], 0.5)
            good[owner[middle > 1]] = False
            owner, step, left = np.tile(owner, 2), np.tile(step / 2, 2), np.append(left, middle)
        good[owner] = False
        return good

    def prove(self, samples: bool = False) -> float:
        """Prove Y <= I from all real starts (or from sample starts only) to all later times; return the slack."""
        c = self.c
        if not (before := self.stretch(self.Y0[None], [c.reach.max()])[0]):
            last = np.array([c.reach.argmax()])
            self.violated(self.Y0[None], c.reach[last], c.times[last] - c.reach[last], 0.0)
        family, index = self.family(), np.repeat(np.arange(c.N), CELLS)
        low, high = (c.reach[index] * ((np.arange(index.size) % CELLS + k) / CELLS) for k in (0, 1))
        if samples:
            index = np.append(np.arange(c.N), 0)
            low = high = np.append(c.gaps, c.first)
        for _ in range(ROUNDS if before else 0):
            left = ~self.windows(index, high, low, family)
            if not left.any():
                return float(1 - self.reached)
            if samples or index.size > MAX_OPEN or (family is None and c.periodic):  # without B_i no lap closes
                break
            index, low, high = np.tile(index[left], 2), low[left], high[left]
            low, high = np.append(low, (low + high) / 2), np.append((low + high) / 2, high)
        raise Refused(self.inequality, f"{self.inequality} could not be decided: it is tight or nearly so")

    def windows(self, index: Any, high: Any, low: Any, family: Any) -> Any:
        """For each cell of starts: is Y <= I proven from sample `index` on? Refused if the start `high` violates it."""
        c, (Y, other) = self.c, np.split(self.moved(self.Y0, np.concatenate([high, low])), 2)
        rest = self.curvature(other, high - low)[:, None, None] * self.I
        ends, Phi, at = np.stack([rest, other - Y + rest]), np.broadcast_to(self.I, Y.shape), index
        good, alive, now, start = high >= low, np.arange(index.size), c.times[index], c.times[index] - high
        for _ in range((LAPS if family is not None else LAPS // 10) * c.N):
            Y, left = self.sample(Y, at)
            Phi = left @ Phi
            U = Y + Phi @ ends @ turned(Phi)
            going = np.ones(at.size, bool) if c.periodic else at + 1 < c.N
            if family is not None:
                going &= np.linalg.eigvalsh(family[at] - U)[..., 0].min(axis=0) < 0
            Y, Phi, ends, U, alive = Y[going], Phi[going], ends[:, going], U[:, going], alive[going]
            at, now = (at[going] + 1) % c.N, now[going]
            closed = self.stretch(U.reshape(-1, c.n, c.n), np.tile(c.gaps[at], 2)).reshape(2, -1).all(axis=0)
            self.violated(Y[~closed], c.gaps[at[~closed]], start[alive[~closed]], now[~closed] - start[alive[~closed]])
            good[alive[~closed]] = False
            if not closed.any():
                return good
            Y, Phi, ends, alive, at = Y[closed], Phi[closed], ends[:, closed], alive[closed], at[closed]
            now, F = now[closed] + c.gaps[at], self.F[at]
            Y, Phi = F @ Y @ turned(F) + self.W[at], F @ Phi
        good[alive] = False
        return good

    def violated(self, Y: Any, duration: Any, start: Any, since: Any) -> None:
        """Refused if some true Y exceeds I along `duration`, which begins `since` after its window's start."""
        moments = np.outer(duration, np.arange(33) / 32)
        values = largest(self.moved(np.repeat(Y, 33, axis=0), moments), 1.0).reshape(-1, 33)
        if np.any(values > 1):
            row, column = divmod(int(np.argmax(values)), 33)
            begin = float(start[row] + (self.c.period if start[row] < 0 and self.c.periodic else 0.0))
            time = float(begin + np.broadcast_to(since, start.shape)[row] + duration[row] * column / 32)
            amount, where = float(1 / values.max() - 1), f"at time {time:.6g} in the window from {begin:.6g}"
            raise Refused(self.inequality, f"{self.inequality} fails by {-amount:.3g} {where}", amount, time, begin)

    def family(self) -> Any:
        """B_i after each sample, which the recursion maps below itself and which stays below I; None if not found."""
        c, after = self.c, (np.arange(self.c.N) + 1) % self.c.N
        worst, inflation = np.float64(3.0), 10 * INFLATION
        while inflation > 1e-12:
            inflation *= min(0.1, 0.3 / worst)
            Z, Y = np.zeros((c.N, c.n, c.n)), self.Y0
            for _ in range(LAPS if c.periodic else 1):
                before = Y
                for i in range(c.N):
                    Z[i] = Y = self.sample(self.F[i] @ Y @ self.F[i].T + self.W[i] + inflation * self.I, i)[0]
                if np.linalg.norm(Y - before) <= inflation / 2:  # then one lap maps Z below itself
                    break
            worst = max(largest(Z).max(), largest(self.moved(Z, c.gaps[after])).max())
            for scale in (1 / worst) ** np.array([0.95, 0.8, 0.5, 0.2, 0.0]) if worst < 1 else ():
                B = scale * Z
                below = np.linalg.eigvalsh(B[after] - self.sample(self.moved(B, c.gaps[after]), after)[0])[:, 0] >= 0
                if (below & self.stretch(B, c.gaps[after]))[: None if c.periodic else -1].all():
                    return B
        return None

    def attained(self, witness: dict[str, Any]) -> None:
        """Replay the witness: x'P2x / x'Pi(t)x at its start, time and direction must reach the stated ratio."""
        c, x = self.c, self.L.T @ np.array(witness["direction"], float)
        now, t, stated = (float(witness[key]) for key in ("start", "t", "ratio"))
        if not 0 <= now <= t < (100 * LAPS * c.period if c.periodic else c.times[-1] * (1 + 1e-9)):
            raise Refused("witness", "the witness must have 0 <= start <= t within the schedule")
        laps = np.arange(int(t / c.period) + 2 if c.periodic else 1)
        times, Y, near = (c.times + c.period * laps[:, None]).ravel(), self.Y0, 1e-9 * t
        for k in np.flatnonzero((times > now + near) & (times < t - near)):
            Y, now = self.sample(self.moved(Y, times[k] - now)[0], k % c.N)[0], times[k]
        if not (ratio := float(x @ x / (x @ np.linalg.solve(self.moved(Y, t - now)[0], x)))) >= stated * (1 - 1e-6):
            raise Refused("witness", f"the witness reaches {ratio:.6g}, not {stated:.6g}", ratio / stated - 1, t)


if __name__ == "__main__":
    data = json.load(sys.stdin)
    kind = {"family": "family_", "detectability": "dissipation_"}.get(str(isinstance(data, dict) and data.get("claim")))
    outcome = runpy.run_path(__file__.removesuffix("checker.py") + (kind or "") + "checker.py")["check"](data)
    print(outcome["reason"])
    sys.exit(0 if outcome["passed"] else 1)
