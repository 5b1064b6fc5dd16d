"""The independent checker of family certificates: needs numpy, json, hashlib and its neighbour `checker` alone.

    python -m sampling_design.certificates.family_checker < certificate.json

1. Every schedule of the family, from every window start, is a path in the graph: judged from words and edges alone.
2. Edge u -> v: U(h) = (I - KC) Y(h) (I - KC)' + K V K' <= P_v^-1 for all h in [low, high], Y(h) = F P_u^-1 F' + W,
   for any gain K: with one K on a cell of length d, U is affine in Y, and Y <= chord + (d^2/8) sup|Y''| I.
3. Node u: Y(s) <= target^-1 likewise, without a sample, up to the longest edge that leaves u.
"""

import hashlib
import json
import sys
from types import SimpleNamespace
from typing import Any

import numpy as np

from sampling_design.certificates.checker import RESOLUTION, Proof, Refused, largest, turned

CELLS = 8  # cells per interval at first
ROUNDS = 40  # halvings of a cell
MOST_CELLS = 400_000  # cells of one target, all rounds together
OUTWARD = 4 * float(np.finfo(float).eps)  # a sum of times is rounded: what must be covered reaches this much farther
SUBJECT = "for every schedule of the family, every real window start and every later t"


def check(data: dict[str, Any]) -> dict[str, Any]:
    """Return the verdict on the plain data of a family certificate, in the form of `checker.check`."""
    verdict = {"passed": False, "time": None, "start": None, "amount": 0.0}
    try:
        rest = {key: value for key, value in data.items() if key != "digest"}
        text = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
        if data["digest"] != hashlib.sha256(text.encode("utf-8")).hexdigest():
            raise Refused("digest", "the digest does not fit the content: something was altered")
        claim = (data["claim"], data["times"]["kind"])
        if claim[0] != "family" or claim[1] not in COVERED:
            raise Refused("claim", f"no proof is known for the claim {claim[0]!r} on times {claim[1]!r}")
        inequality, slack = family(data)
        reason = f"{inequality} {SUBJECT}, slack {slack:.3g}"
        return {**verdict, "passed": True, "inequality": inequality, "amount": slack, "reason": reason}
    except Refused as refused:
        return {**verdict, **dict(zip(("inequality", "reason", "amount", "time", "start"), refused.args, strict=False))}
    except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, np.linalg.LinAlgError) as error:
        return {**verdict, "inequality": "form", "reason": f"the data are no certificate ({error!r})"}


def family(data: dict[str, Any]) -> tuple[str, float]:
    """Prove that the graph holds the family, and every edge and node; return the slack."""
    c = numbers(data)
    COVERED[data["times"]["kind"]](c, data["times"])
    targets = [
        ((1 + c.margin) * c.P1, "(1 + margin) P1 <= Pi(t)"),
        ((1 - RESOLUTION) * c.P2 / c.lam, "(1 - 1e-3) P2 <= lam Pi(t)"),
    ]
    inequality = " and ".join(name for _, name in targets)
    if not c.n:
        return inequality, 1.0
    slack = 1.0
    for v in sorted({e.target for e in c.edges}):
        entering = [e for e in c.edges if e.target == v]
        cells = Cells(c, c.P[v], f"Phi(P_u) + C'R~C >= P_{v}")
        rows = np.stack([cells.sampled(e.outputs) for e in entering])
        ends = np.array([[e.low, e.high] for e in entering])
        slack = min(slack, cells.prove(c.P[[e.source for e in entering]], rows, ends[:, 0], ends[:, 1]))
    none = np.zeros((len(c.P), len(c.C), c.n))
    for target, name in targets:
        slack = min(slack, Cells(c, target, name).prove(c.P, none, 0 * c.tops, c.tops))
    return inequality, slack


def numbers(data: dict[str, Any]) -> SimpleNamespace:
    """The numbers of a certificate, each checked for what it must be."""
    m, graph = data["plant"]["matrices"], data["graph"]
    c = SimpleNamespace(n=len(m["A"]), p=len(m["C"]))
    c.A, c.C = np.array(m["A"], float).reshape(c.n, c.n), np.array(m["C"], float).reshape(c.p, c.n)
    c.G = np.array(m.get("G", np.eye(c.n)), float).reshape(c.n, len(data["Qw"]))
    # states in units of powers of two, which changes no digit, so that P2 has a diagonal near 1
    unit = np.ldexp(1.0, -np.frexp(np.sqrt(np.abs(np.diag(np.array(data["P2"], float).reshape(c.n, c.n)))))[1])
    c.A, c.C, c.G = c.A * unit / unit[:, None], c.C * unit, c.G / unit[:, None]
    for name, size in (("P1", unit), ("P2", unit), ("R", c.p), ("Qv", c.p), ("Qw", len(data["Qw"]))):
        setattr(c, name, symmetric(name, data[name], size))
    for name, least in (("eta", 5e-324), ("lam", 5e-324), ("lam_samples", 5e-324), ("margin", 0.0)):
        setattr(c, name, float(data[name]))
        if not least <= getattr(c, name) < np.inf:
            raise Refused(f"{name} > 0", f"{name} must be positive, got {data[name]!r}")
    if c.lam_samples < c.lam:
        raise Refused("lam <= lam_samples", "a family holds windows from samples to any first gap: lam_samples is lam")
    if data["witness"] is not None:
        raise Refused("witness", "a family certificate has no witness")
    c.words = [list(word) for word in graph["words"]]
    c.P = np.stack([c.P2, *(symmetric("P", matrix, unit) for matrix in graph["P"])])
    c.edges = [edge(item, len(c.words), c.p) for item in graph["edges"]]
    if len(c.P) != len(c.words):
        raise Refused("graph", "the graph must have one matrix per word")
    c.tops = np.array([max((e.high for e in c.edges if e.source == u), default=0.0) for u in range(len(c.P))])
    c.leaving = [[e for e in c.edges if e.source == u] for u in range(len(c.P))]
    return c


def symmetric(name: str, value: Any, unit: Any) -> Any:
    """A positive definite matrix in these units of the states (a number: its size); Qw may be semidefinite."""
    unit = np.ones(unit) if np.ndim(unit) == 0 else unit
    size = unit.size
    X = np.array(value, float).reshape(size, size) * unit * unit[:, None]
    if not np.isfinite(X).all() or np.any(np.abs(X - X.T) > 1e-12 * np.abs(X).max(initial=0.0)):
        raise Refused(f"{name} symmetric", f"{name} is not symmetric and finite")
    least = float(np.linalg.eigvalsh(X)[0]) if size else 1.0
    if least < -1e-15 * np.abs(X).max(initial=0.0) or (least <= 0 and name != "Qw"):
        raise Refused(f"{name} > 0", f"{name} is not positive definite: least eigenvalue {least:.3g}", least)
    return X


def edge(item: Any, nodes: int, p: int) -> SimpleNamespace:
    """One edge of the graph, checked."""
    source, target, low, high, outputs = item
    e = SimpleNamespace(
        source=source, target=target, low=float(low), high=float(high), outputs=[bool(on) for on in outputs]
    )
    if not (0 <= source < nodes and 0 < target < nodes and 0 <= e.low <= e.high < np.inf and len(e.outputs) == p):
        raise Refused("graph", f"{item!r} is no edge")
    return e


def need(condition: bool, u: int, what: str) -> None:
    """Refused if a schedule could leave the graph at node u."""
    if not condition:
        raise Refused("graph", f"the graph does not hold the family: at node {u}, {what}")


def covers(parts: Any, low: float, high: float) -> bool:
    """Whether closed intervals together cover [low, high]."""
    for a, b in sorted(parts):
        if a > low:
            break
        if b >= high:
            return True
        low = max(low, b)
    return False


def gap_range(c: Any, times: dict[str, Any]) -> None:
    """From the start every gap up to the longest has an edge, elsewhere every gap of the range."""
    shortest, longest = float(times["shortest"]), float(times["longest"])
    for u, edges in enumerate(c.leaving):
        low = shortest if u else 0.0
        need(
            covers([(e.low, e.high) for e in edges if all(e.outputs)], low, longest), u, f"gaps from {low} to {longest}"
        )


def spaced_windows(c: Any, times: dict[str, Any]) -> None:
    """Words are lower bounds of the last gaps, newest first; any k gaps in a row sum to at most T."""
    T, k, spacing = float(times["window"]), int(times["count"]), float(times["spacing"])
    for u, edges in enumerate(c.leaving):
        word = [float(low) for low in c.words[u]]
        most = min(T - sum(word[:i]) - (k - 1 - i) * spacing for i in range(min(len(word), k - 1) + 1)) + OUTWARD * T
        known = []
        for e in edges:
            bounds, claimed = [e.low, *word], c.words[e.target]
            fits = len(claimed) <= len(bounds) and all(x <= y for x, y in zip(claimed, bounds, strict=False))
            known += [(e.low, e.high)] if fits and all(e.outputs) else []
        low = spacing if u else 0.0
        need(most < low or covers(known, low, most), u, f"gaps from {low} to {most}")


def lap(c: Any, schedule: dict[str, Any]) -> tuple[Any, Any, Any]:
    """Gaps, reach before each sample, and outputs of each sample of a periodic nominal schedule."""
    if schedule.get("output_names") is not None:
        raise Refused("times", "the columns of the nominal schedule must be the plant's outputs, without names")
    gaps = [float(gap) for gap in schedule["gaps"]]
    first = float(schedule.get("first", gaps[0]))
    seen = schedule.get("outputs") or [[1] * c.p] * len(gaps)
    outputs = [[bool(on) for on in row] for row in seen]
    if not (all(gap > 0 for gap in gaps) and 0 <= first <= sum(gaps) and all(len(row) == c.p for row in outputs)):
        raise Refused("times", "the nominal schedule must have positive gaps and one column per output")
    return gaps, [max(gaps[0], first), *gaps[1:]], outputs


def lost_samples(c: Any, times: dict[str, Any]) -> None:
    """Words are the phase and which of the last samples were lost (1), newest first."""
    gaps, reach, outputs = lap(c, times["schedule"])
    most, of = int(times["most"]), int(times["of"])
    for u, edges in enumerate(c.leaving):
        phases = [(int(c.words[u][0]) + 1) % len(gaps)] if u else range(len(gaps))
        bits = [int(bit) for bit in c.words[u][1:]] if u else []
        for j in phases:
            low, high = (gaps[j], gaps[j]) if u else (0.0, reach[j])
            for lost in (0, 1):
                if lost and sum(bits[: of - 1]) >= most:
                    continue
                found = []
                for e in edges:
                    phase, *claimed = c.words[e.target]
                    true = [lost, *bits]
                    fits = phase == j and e.outputs == ([False] * c.p if lost else outputs[j])
                    fits = (
                        fits and len(claimed) <= len(true) and all(x <= y for x, y in zip(claimed, true, strict=False))
                    )
                    found += [(e.low, e.high)] if fits else []
                need(covers(found, low, high), u, f"sample {j} of the lap, {'lost' if lost else 'taken'}")


def jitter(c: Any, times: dict[str, Any]) -> None:
    """Words are the phase and the ends of the last deviation from the nominal time."""
    gaps, reach, outputs = lap(c, times["schedule"])
    radius = float(times["radius"])
    for u, edges in enumerate(c.leaving):
        phases = [(int(c.words[u][0]) + 1) % len(gaps)] if u else range(len(gaps))
        before = [float(end) for end in c.words[u][1:]] if u else []
        for j in phases:
            cells = []
            for e in edges:
                phase, a, b = c.words[e.target]
                wide = OUTWARD * (gaps[j] + radius)
                low, high = (gaps[j] + a - before[1], gaps[j] + b - before[0]) if u else (0.0, reach[j] + radius + b)
                if phase == j and e.outputs == outputs[j] and e.low <= max(low - wide, 0.0) and high + wide <= e.high:
                    cells.append((a, b))
            need(covers(cells, -radius, radius), u, f"deviations of sample {j} of the lap")


COVERED = {"gap-range": gap_range, "spaced-windows": spaced_windows, "lost-samples": lost_samples, "jitter": jitter}


class Cells(Proof):
    """Proof of U(h) <= I over intervals of h, in the coordinates of one target."""

    def __init__(self, c: Any, target: Any, inequality: str) -> None:
        gaps, reach = np.ones(1), np.ones(1)
        plain = {"N": 1, "gaps": gaps, "reach": reach, "seen": np.ones((1, c.p), bool)}
        super().__init__(SimpleNamespace(**{**vars(c), **plain}), target, inequality)

    def sampled(self, outputs: Any) -> Any:
        """Whitened rows of a sample of some outputs, padded with zero rows."""
        seen, rows = np.array(outputs, bool), np.zeros((self.c.p, self.c.n))
        if seen.any():
            V = (np.linalg.inv(self.c.R) + np.linalg.inv(self.c.Qv))[np.ix_(seen, seen)]
            rows[: seen.sum()] = np.linalg.solve(np.linalg.cholesky(V), np.linalg.solve(self.L, self.c.C[seen].T).T)
        return rows

    def gain(self, Y: Any, C: Any) -> Any:
        """The gain of the least U."""
        return turned(np.linalg.solve(np.eye(C.shape[-2]) + C @ Y @ turned(C), C @ Y))

    def after(self, Y: Any, C: Any, K: Any) -> tuple[Any, Any]:
        """U of Y with gain K, and I - KC."""
        left = self.I - K @ C
        return left @ Y @ turned(left) + K @ turned(K), left

    def prove(self, P: Any, rows: Any, low: Any, high: Any) -> float:  # type: ignore[override]
        """Prove U <= I on every interval; return the slack. Refused where it fails or cannot be decided."""
        Y0 = self.L.T @ np.linalg.solve(P, self.L)
        owner = np.repeat(np.arange(len(P)), CELLS)
        cuts = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, CELLS + 1)
        cuts[:, -1] = high
        a, b, total, top = cuts[:, :-1].ravel(), cuts[:, 1:].ravel(), 0, 0.0
        for _ in range(ROUNDS):
            total += owner.size
            if not owner.size or total > MOST_CELLS:
                break
            ends, where = np.unique(np.concatenate([a, b, (a + b) / 2]), return_inverse=True)
            F, W = (part[where] for part in self.flow(ends))
            Y = F @ np.tile(Y0[owner], (3, 1, 1)) @ turned(F) + W
            C = rows[owner]
            self.violated_at(Y, np.tile(C, (3, 1, 1)), np.concatenate([a, b, (a + b) / 2]))
            first, last, middle = np.split(Y, 3)
            K = self.gain(middle, C)
            (U, left), (other, _) = self.after(first, C, K), self.after(last, C, K)
            size = np.linalg.norm(left, axis=(-2, -1)) ** 2
            bound = np.maximum(largest(U, 0.5), largest(other, 0.5)) + size * self.curvature(first, b - a)
            top = max(top, bound[bound <= 1].max(initial=0.0))
            rest = ~(bound <= 1)
            owner, a, b = owner[rest], a[rest], b[rest]
            owner, a, b = np.tile(owner, 2), np.append(a, (a + b) / 2), np.append((a + b) / 2, b)
        if owner.size:
            raise Refused(self.inequality, f"{self.inequality} could not be decided: it is tight or nearly so")
        return float(1 - top)

    def violated_at(self, Y: Any, C: Any, h: Any) -> None:
        """Refused if the least U exceeds I at some h."""
        values = largest(self.after(Y, C, self.gain(Y, C))[0], 1.0)
        k = int(np.argmax(values))
        if values[k] > 1:
            amount = float(1 / values[k] - 1)
            raise Refused(
                self.inequality, f"{self.inequality} fails by {-amount:.3g} at gap {h[k]:.6g}", amount, float(h[k])
            )


if __name__ == "__main__":
    outcome = check(json.load(sys.stdin))
    print(outcome["reason"])
    sys.exit(0 if outcome["passed"] else 1)
