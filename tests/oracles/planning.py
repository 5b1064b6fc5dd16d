"""Slow, plain references for plans: what a schedule leaves unknown, as one linear program of scipy, or one recursion.

Nothing here knows the code it judges. Bounds are boxes: |w_k(t)| <= w_k, |v_j| <= v_j; a sample is a time and the
outputs that are read then.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog
from scipy.sparse import coo_array


def _step(A, G, h):
    """e^{Ah} and the integral of e^{As} G over [0, h]."""
    n, q = G.shape
    block = np.zeros((n + q, n + q))
    block[:n, :n], block[:n, n:] = A, G
    joint = expm(block * h)
    return joint[:n, :n], joint[:n, n:]


@lru_cache(maxsize=4096)
def _cells(A, G, n, h, cells):
    """e^{Ah}, what a constant w does over h, and over each of its cells; of the same gap once."""
    A, G = (np.frombuffer(each).reshape(n, -1) for each in (A, G))
    part = _step(A, G, h / cells)[1]
    return (*_step(A, G, h), [expm(A * h * (cells - 1 - m) / cells) @ part for m in range(cells)])


def hidden(A, C, G, times, seen, c, end, w, v, cells=6, rest=True):
    """Largest c'x(end) of a motion that no sample (times, seen) up to `end` shows; (value, nodes, x there, w of cells).

    w is constant on `cells` equal parts of each gap. At the first time x is 0 (`rest`), a bound from below on what
    anybody can guarantee on an endless schedule; or free, where many samples back it is one from above but for w.
    """
    A, C, G, c = (np.asarray(m, float) for m in (A, C, G, c))
    times, seen = np.asarray(times, float), np.asarray(seen, bool)
    keep = times <= end + 1e-12 * max(1.0, abs(end))
    times, seen = times[keep], seen[keep]
    nodes = times if times[-1] >= end - 1e-12 * max(1.0, abs(end)) else np.append(times, end)
    n, q = G.shape
    K = len(nodes)
    # unknowns: the state at each node in units of what w does in a gap, then w of each cell in units of its bound
    flows = [_cells(A.tobytes(), (G * w).tobytes(), n, float(f"{h:.12g}"), cells) for h in np.diff(nodes)]
    spread = np.array([np.abs(whole).sum(axis=1) for _, whole, _ in flows])
    unit = np.maximum(spread.max(axis=0), 1e-9 * spread.max())
    rows, cols, values, right, at = [], [], [], [], 0

    def put(block, row, column):
        i, j = np.nonzero(block)
        rows.extend((i + row).tolist())
        cols.extend((j + column).tolist())
        values.extend(block[i, j].tolist())

    for k, (F, _, parts) in enumerate(flows):
        put(-np.eye(n), at, (k + 1) * n)
        put(F * unit / unit[:, None], at, k * n)
        for m, part in enumerate(parts):
            put(part / unit[:, None], at, K * n + (k * cells + m) * q)
        at += n
    equal = coo_array((values, (rows, cols)), shape=(at, K * n + (K - 1) * cells * q))
    rows, cols, values, at = [], [], [], 0
    for k in range(len(times)):
        for j in np.flatnonzero(seen[k]):
            put(np.vstack([C[j] * unit, -C[j] * unit]) / v[j], at, k * n)
            right += [1.0, 1.0]
            at += 2
    below = coo_array((values, (rows, cols)), shape=(at, equal.shape[1]))
    cost = np.zeros(equal.shape[1])
    size = np.abs(c * unit).max()
    cost[(K - 1) * n : K * n] = -c * unit / size
    free = (None, None)
    bounds = [(0.0, 0.0) if rest and i < n else free for i in range(K * n)] + [(-1.0, 1.0)] * ((K - 1) * cells * q)
    found = linprog(cost, below, right, equal, np.zeros(equal.shape[0]), bounds, method="highs")
    if found.status:  # its simplex gives up now and then
        found = linprog(cost, below, right, equal, np.zeros(equal.shape[0]), bounds, method="highs-ipm")
    assert found.status == 0, found.message
    states = found.x[: K * n].reshape(K, n) * unit
    return -found.fun * size, nodes, states, found.x[K * n :].reshape(-1, cells, q) * w


def at_the_time(system, times, seen, delays, c, t, w, v, cells=6, rest=True):
    """The same at a time `t` where results come `delays` (p,) or (K, p) after their samples: of those in by then."""
    A, C, G = system
    came = np.asarray(times, float)[:, None] + np.broadcast_to(delays, np.shape(seen))
    known = np.asarray(seen, bool) & (came <= t + 1e-9 * max(1.0, abs(t)))
    return hidden(A, C, G, times, known, c, t, w, v, cells, rest)[0]


def from_now(system, times, seen, rows, now, until, step, w, v):
    """Times of a grid from `now` until some time, and the worst of the rows there, each over its tolerance.

    Twice at a sample: the moment before it, and after it. From rest long ago, so a little less than what is unknown.
    """
    A, C, G = system
    found, tiny = [], 1e-9 * step
    for t in np.arange(np.ceil(now / step - 1e-9), np.floor(until / step + 1e-9) + 1) * step:
        keeps = [times <= t + tiny]
        if t > now + tiny and np.any(keeps[0] & (times >= t - tiny)):
            keeps.insert(0, times < t - tiny)
        for keep in keeps:
            each = [hidden(A, C, G, times[keep], seen[keep], c, t, w, v, cells=3)[0] for c in rows]
            found.append((float(t), max(each)))
    return found


def flown(A, G, nodes, u):
    """States at the nodes when the w of `hidden` is flown from rest: no solver had a hand in them."""
    A, G = np.asarray(A, float), np.asarray(G, float)
    x, found = np.zeros(len(A)), [np.zeros(len(A))]
    for h, parts in zip(np.diff(nodes), u, strict=True):
        F, Gamma = _step(A, G, h / len(parts))
        for one in parts:
            x = F @ x + Gamma @ one
        found.append(x)
    return np.array(found)


def worst_truth(system, planned, seen, delays, c, span, w, v, late=0.0, early=None, moved=4):
    """The largest error of c'x within a time `span` that is flown, whatever the real times are.

    Those lie within [planned - early, planned + late], (K,) each, `early` as late if not given. Looked at just
    before each result can come, at the latest, and between; at the worst of these the `moved` last samples come early,
    on time or late, one after the other, as long as that makes it worse.
    """
    A, C, G = system
    planned, seen, (since, until) = np.asarray(planned, float), np.asarray(seen, bool), span
    late = np.broadcast_to(late, planned.shape)
    early = late if early is None else np.broadcast_to(early, planned.shape)
    comes = (planned + late)[:, None] + np.where(seen, delays, np.nan)
    ends = np.append(comes[(comes > since) & (comes < until)], until) - 1e-9 * (until - since)
    ends = np.append(ends, since)
    ends = np.sort(np.append(ends, (ends[1:] + ends[:-1]) / 2))

    def attained(real, end):
        kept = real <= end
        known = (seen & (real[:, None] + delays <= end))[kept]
        _, nodes, _, u = hidden(A, C, G, real[kept], known, c, end, w, v, cells=4)
        x = flown(A, G, nodes, u)
        shown = np.abs(x[: len(known)] @ np.asarray(C).T / v)[known]
        return float(np.dot(c, x[-1])) / max(1.0, float(np.max(np.abs(u / w))), float(shown.max(initial=0.0)))

    def out(end):
        """Real times of which all is out at a time that may be; the others as planned."""
        return planned + late * (np.nan_to_num(comes, nan=-np.inf).max(axis=1) > end)

    error, end = max((attained(out(end), end), float(end)) for end in ends)
    real = out(end)
    for k in np.flatnonzero((planned <= end) & (early + late > 0))[::-1][:moved]:
        for e in (-early[k], 0.0, late[k]):
            trial = np.where(np.arange(len(real)) == k, planned[k] + e, real)
            found = 0.0 if np.array_equal(trial, real) else attained(trial, end)
            error, real = (found, trial) if found > error else (error, real)
    return error


def deviation(A, C, G, times, seen, period, c, at, W, v, periods=400):
    """Standard deviation of c'x at times `at` of a periodic schedule, by the plain filter run for many periods.

    Each of `at` lies in [0, period); a sample at the very time counts.
    """
    A, C, G, c = (np.asarray(m, float) for m in (A, C, G, c))
    n, W = len(A), np.diag(np.broadcast_to(W, G.shape[1]))

    def flow(h):
        block = np.zeros((2 * n, 2 * n))
        block[:n, :n], block[:n, n:], block[n:, n:] = -A, G @ W @ G.T, A.T
        joint = expm(block * h)
        F = joint[n:, n:].T
        return F, F @ joint[:n, n:]

    marks = sorted({*np.asarray(times, float).tolist(), *np.asarray(at, float).tolist(), period})
    flows = [flow(h) for h in np.diff([0.0, *marks])]
    P, last = np.eye(n) * 1e6, None
    for _ in range(periods):
        found = {}
        for t, (F, Q) in zip(marks, flows, strict=True):
            P = F @ P @ F.T + Q
            for k in np.flatnonzero(np.isclose(times, t)):
                for j in np.flatnonzero(seen[k]):
                    gain = P @ C[j] / (C[j] @ P @ C[j] + v[j] ** 2)
                    P = P - np.outer(gain, C[j] @ P)
                P = (P + P.T) / 2
            found[t] = float(np.sqrt(c @ P @ c))
        now = np.array([found[t] for t in np.asarray(at, float).tolist()])
        if last is not None and np.allclose(now, last, rtol=1e-10):
            break
        last = now
    return now


def remeasured(data, samples=60, looks=5, pasts=(True, False)):
    """Goals of a plan file's tree: (name, reached as it says, from below, from above but for w constant on cells).

    One side for each of `pasts`: from rest, which is from below, and with any past.
    """
    plant, asked, schedule = data["plant"], data["requirement"], data["schedule"]
    A, C = (np.array(plant["matrices"][key], float) for key in ("A", "C"))
    G = np.array(plant["matrices"].get("G", np.eye(len(A))), float)
    w = np.broadcast_to(np.asarray(asked["w_bound"], float), G.shape[1])
    assert np.ndim(asked["w_bound"]) or G.shape[1] == 1, "one number bounds a norm: no linear program"
    bounds = [asked["sensors"].get(name, {}).get("noise_bound") for name in plant["outputs"]["names"]]
    v = np.array([np.inf if b is None else b for b in bounds], float)
    times, period = np.array(schedule["times"], float), float(schedule["period"])
    masks = np.ones((len(times), len(C)), bool) if schedule["outputs"] is None else np.array(schedule["outputs"], bool)
    periods = -(-samples // len(times)) + 1
    every = (np.arange(periods)[:, None] * period + times).ravel()
    seen = np.tile(masks, (periods, 1)) & np.isfinite(v)
    names, found = [*plant["states"]["names"], *plant["outputs"]["names"]], []
    for (name, goal), reached in zip(asked["accuracy"].items(), data["reached"], strict=True):
        row = np.vstack([np.eye(len(A)), C])[names.index(name)] if "row" not in goal else np.array(goal["row"], float)
        sides = np.zeros(len(pasts))
        for k in range(len(every) - 1 - len(times), len(every) - 1):
            ends = np.linspace(every[k], every[k + 1], looks)
            if goal["at"] == "after each sample":
                ends = ends[:1]
            elif goal["at"] not in ("all times", "until the next"):
                ends = [t for t in np.add.outer(np.arange(periods) * period, goal["at"]).ravel() if every[k] <= t]
                ends = [t for t in ends if t <= every[k + 1]]
            for end in ends:
                parts = A, C, G, every[: k + 1], seen[: k + 1], row, end, w, v
                sides = np.maximum(sides, [hidden(*parts, rest=rest)[0] for rest in pasts])
        found.append((name, reached, *sides.tolist()))
    return found


def deviations(data, looks=60):
    """Goals of a plan file whose goals are standard deviations at all times: (name, reached as it says, found)."""
    plant, asked, schedule = data["plant"], data["requirement"], data["schedule"]
    A, C = (np.array(plant["matrices"][key], float) for key in ("A", "C"))
    G = np.array(plant["matrices"].get("G", np.eye(len(A))), float)
    times, period = np.array(schedule["times"], float), float(schedule["period"])
    masks = np.ones((len(times), len(C)), bool) if schedule["outputs"] is None else np.array(schedule["outputs"], bool)
    v = [asked["sensors"].get(name, {}).get("noise_deviation", np.inf) for name in plant["outputs"]["names"]]
    ends = np.append(times, times[0] + period)
    gaps = [np.linspace(a, b, looks) for a, b in pairwise(ends)]
    at = np.unique(np.concatenate(gaps) % period)
    names, found = [*plant["states"]["names"], *plant["outputs"]["names"]], []
    for (name, goal), reached in zip(asked["accuracy"].items(), data["reached"], strict=True):
        assert goal["at"] == "all times", "only the worst of all times is looked for"
        row = np.vstack([np.eye(len(A)), C])[names.index(name)] if "row" not in goal else np.array(goal["row"], float)
        worst = deviation(A, C, G, times, masks & np.isfinite(v), period, row, at, asked["w_intensity"], v).max()
        found.append((name, reached, worst))
    return found


def main(paths):
    """Print what each plan file says, and what this program finds."""
    import json
    from pathlib import Path

    for path in paths:
        data = json.loads(Path(path).read_text())
        if "w_intensity" in data["requirement"]:
            for name, reached, worst in deviations(data):
                print(f"{path}: {name}: {reached:.5g} in the file; {worst:.5g} with the plain filter")
                assert worst <= reached * (1 + 1e-6)
            continue
        for name, reached, below, above in remeasured(data):
            print(f"{path}: {name}: {reached:.5g} in the file; {below:.5g} from rest, {above:.5g} with any past")
            assert below <= reached * (1 + 1e-6)


if __name__ == "__main__":
    import sys

    main(sys.argv[1:])
