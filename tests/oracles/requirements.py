"""Small random design problems, and schedules that meet them drawn at random: what every law of designs is tried on.

Nothing here imports what it judges: numpy and scipy only. A problem is plain data (matrices, numbers, spans).
"""

from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from scipy.linalg import block_diag, expm

TIE = 1e-11
"""Events closer than this share of a period are one: rounding, and not the moment before closing, about 1e-9, that a
search keeps to."""


@dataclass
class Problem:
    """One small requirement with its plant, as plain numbers."""

    A: np.ndarray
    C: np.ndarray
    window: float
    period: float
    spacing: float
    samples: object
    forbidden: list = field(default_factory=list)
    fixed: list = field(default_factory=list)
    available: list = field(default_factory=list)  # per output: None or spans
    costs: list = field(default_factory=list)
    cost_limit: float | None = None
    target_sigma: float | None = None

    @property
    def requirement(self):
        """The arguments of `Requirement`."""
        outputs = {
            f"y{i + 1}": {"available": spans, "price": cost}
            for i, (spans, cost) in enumerate(zip(self.available, self.costs, strict=True))
        }
        keys = ("window", "period", "spacing", "samples", "forbidden", "fixed", "cost_limit", "target_sigma")
        return {"sensors": outputs} | {key: getattr(self, key) for key in keys}

    @property
    def counts(self):
        """Least and largest number of samples."""
        if isinstance(self.samples, int):
            return self.samples, self.samples
        if "exactly" in self.samples:
            return (self.samples["exactly"],) * 2
        low = self.samples.get("at_least", 1)
        return low, self.samples.get("at_most", low)

    def open(self, times):
        """(k, p): which outputs may be measured at `times`."""
        t = np.mod(times, self.period)
        closed = np.array([any(a <= s < b for a, b in self.forbidden) for s in t], dtype=bool)
        spans = [[True] * t.size if a is None else [any(u <= s < v for u, v in a) for s in t] for a in self.available]
        return np.array(spans, dtype=bool).T.reshape(t.size, len(self.available)) & ~closed[:, None]


def random_plant(rng):
    """Two or three retained modes or a pair of blocks, in coordinates that may be turned, with one or two outputs."""
    w, v = rng.uniform(0.4, 2.5, 2)
    a = rng.choice([0.0, 0.0, 0.3, -0.0])
    blocks = {
        "oscillator": np.array([[a, w], [-w, a]]),
        "double": np.array([[0.0, 1.0], [0.0, 0.0]]),
        "triple": np.eye(3, k=1),
        "mixed": block_diag([[0.0]], [[0.0, w], [-w, 0.0]]),
        "growing": np.array([[rng.uniform(0.1, 1.5), 1.0], [0.0, rng.uniform(0.0, 0.1)]]),
        "pair": block_diag([[0.0, w], [-w, 0.0]], [[0.0, w + v], [-w - v, 0.0]]),
        "single": np.array([[rng.choice([0.0, 0.2])]]),
    }
    A = blocks[str(rng.choice(list(blocks)))]
    if rng.uniform() < 0.4:
        Q = np.linalg.qr(rng.normal(size=A.shape))[0]
        A = Q @ A @ Q.T
    p = int(rng.choice([1, 1, 2]))
    return A, rng.normal(size=(p, len(A)))


def random_problem(rng):
    """A random requirement: counts, forbidden, fixed and allowed times, costs, targets; some have no answer."""
    A, C = random_plant(rng)
    n, p = len(A), len(C)
    period = float(rng.choice([rng.uniform(1.0, 9.0), 4.0, 2 * np.pi]))
    window = period * float(rng.choice([1.0, 0.5, 1.5, 2.0, 3.0, rng.uniform(0.4, 2.5)]))
    least = int(np.ceil(n / p * period / window))
    k = int(np.clip(least + rng.integers(0, 4), 1, 7))
    spacing = period / k * float(rng.choice([0.02, 0.1, 0.3, 0.6, 0.9, 1.0]))
    problem = Problem(A, C, window, period, spacing, k, available=[None] * p, costs=[0.0] * p)
    kind = rng.uniform(size=6)
    if kind[0] < 0.3:
        ends = np.sort(rng.uniform(0, period, 2))
        problem.forbidden = [[float(ends[0]), float(min(ends[1], ends[0] + 0.5 * period))]]
    if kind[1] < 0.25:
        problem.fixed = sorted(float(t) for t in rng.uniform(0, period, rng.integers(1, 3)))
    if kind[2] < 0.3:
        i = int(rng.integers(p))
        a = float(rng.uniform(0, 0.4)) * period
        problem.available[i] = [[a, float(min(period, a + rng.uniform(0.3, 0.9) * period))]]
    if kind[3] < 0.3:
        problem.costs = [float(c) for c in rng.choice([0.5, 1.0, 2.0, 3.0], p)]
        problem.cost_limit = float(rng.uniform(0.5, 1.0) * k * sum(problem.costs))
    if kind[4] < 0.35:
        problem.samples = [
            {"at_most": k},
            {"at_most": k + 2},
            {"at_least": k},
            {"at_least": max(1, k - 1), "at_most": k},
        ][int(rng.integers(4))]
    if kind[5] < 0.1:
        problem.target_sigma = float(10 ** rng.uniform(-3, 0.3))
    return problem


def random_admissible(rng, problem, tries=40):
    """Times and mask of one schedule that meets the problem, ties between samples a window apart included; or None."""
    low, high = problem.counts
    for _ in range(tries):
        k = int(rng.integers(low, high + 1))
        free = k - len(problem.fixed)
        if free < 0:
            continue
        fold = [b for b in (1, 1, 2, 3) if free % b == 0]
        b = int(rng.choice(fold)) if free else 1
        if rng.uniform() < 0.5 or k * problem.spacing > 0.7 * problem.period:
            slack = problem.period / b - free // b * problem.spacing
            if slack < 0:
                continue
            base = np.sort(rng.uniform(0, slack, free // b)) + problem.spacing * np.arange(free // b)
            base = base + rng.uniform(0, problem.period)
        else:
            base = rng.uniform(0, problem.period / b, free // b)
        drawn = np.mod(base + problem.period / b * np.arange(b)[:, None], problem.period).ravel()
        times = np.sort(np.concatenate([problem.fixed, drawn]))
        gaps = np.diff(np.append(times, times[0] + problem.period)) if times.size else np.zeros(1)
        if not times.size or gaps.min() < problem.spacing * (1 - 1e-12):
            continue
        there = problem.open(times)
        if not there.any(axis=1).all():
            continue
        mask = _afforded(rng, problem, there)
        if mask is not None:
            return times, mask
    return None


def _afforded(rng, problem, there):
    """Measurements dropped at random until the rest can be paid; None where that does not end."""
    mask = there.copy()
    if problem.cost_limit is None:
        return mask
    costs = np.array(problem.costs)
    while np.sum(mask * costs) > problem.cost_limit:
        spare = np.argwhere(mask & (mask.sum(axis=1, keepdims=True) > 1) & (costs > 0))
        if not len(spare):
            return None
        i, j = spare[rng.integers(len(spare))]
        mask[i, j] = False
    return mask


def sigma_of(problem, times, mask, places=5):
    """Least sigma_n over half-open windows, at every event (both limits) and at `places` places between; events that
    coincide to rounding are one."""
    A, C, P, T = problem.A, problem.C, problem.period, problem.window
    n = len(A)
    periods = np.arange(-1, int(np.ceil(T / P)) + 2)
    every = (times[:, None] + P * periods).ravel()
    seen = np.repeat(mask, periods.size, axis=0)
    events = np.sort(np.concatenate([np.mod(times, P), np.mod(times - T, P)]))
    events = events[np.append(True, np.diff(events) > TIE * P)]
    ends = np.append(events, events[0] + P)
    starts = np.concatenate([events, *(ends[:-1] + f * np.diff(ends) for f in np.linspace(0, 1, places + 2)[1:-1])])
    tiny, least = 2 * TIE * P, np.inf
    rows = np.stack([C @ expm(A * (r - P)) for r in every])  # seen from one origin; every start carries them on
    for a in starts:
        across = expm(A * (P - a))
        for low, high in ((tiny, T + tiny), (-tiny, T - tiny)):
            inside = (every - a > low) & (every - a < high)
            O = rows[inside][seen[inside]] @ across
            values = np.linalg.svd(O, compute_uv=False) if len(O) >= n else np.zeros(n)
            least = min(least, values[n - 1])
    return float(least)


def random_hours(rng):
    """A day with closed hours, sometimes with a fixed hour or an output that is there for a part of the day only."""
    w = 2 * np.pi / 24
    turning = np.array([[0.0, w], [-w, 0.0]])
    blocks = {
        "rhythm": turning,
        "level and rhythm": block_diag([[0.0]], turning),
        "two rhythms": block_diag(turning, 2 * turning),
        "growing rhythm": turning + rng.uniform(0.005, 0.05) * np.eye(2),
        "drift": np.array([[0.0, 0.1], [0.0, 0.0]]),
        "growing level and rhythm": block_diag([[0.02]], turning),
    }
    A = blocks[str(rng.choice(list(blocks)))]
    p = int(rng.choice([1, 1, 1, 2]))
    C = np.abs(rng.normal(size=(p, len(A)))) + 0.3
    closed = _closed_hours(rng)
    k = int(rng.integers(2, 6))
    k = max(k, len(A)) if p == 1 else k
    window = 24.0 * float(rng.choice([1.0, 1.0, 1.0, 2.0, 1.5]))
    spacing = float(rng.choice([0.25, 0.5, 1.0, 2.0]))
    problem = Problem(A, C, window, 24.0, spacing, k, closed, available=[None] * p, costs=[0.0] * p)
    open_hours = [t for t in range(24) if problem.open(np.array([float(t)])).any()]
    if rng.uniform() < 0.3:
        problem.fixed = [float(rng.choice(open_hours))]
    if p == 2 and rng.uniform() < 0.5:
        problem.available[1] = [[8.0, 17.0]]
    return problem


def _closed_hours(rng):
    """A night, sometimes a break too; the night may begin before midnight."""
    start, length = int(rng.integers(24)), int(rng.integers(6, 14))
    spans = [(start, start + length)]
    if rng.uniform() < 0.4:
        pause = start + length + int(rng.integers(2, 24 - length - 3))
        spans.append((pause, pause + int(rng.integers(1, 3))))
    return turned_spans(spans, 0.0, 24.0)


def turned_spans(spans, shift, period):
    """Intervals moved by `shift`, cut where they pass the end of the period."""
    found = []
    for a, b in spans:
        a, b = (a + shift) % period, (a + shift) % period + (b - a)
        found += [[float(a), float(min(b, period))]] + ([[0.0, float(b - period)]] if b > period else [])
    return sorted(found)


def best_hours(problem, step=1.0):
    """The best sigma of all schedules on the grid of `step`, and its times: every choice of hours is looked at.

    Windows begin just before and just after each grid time, where samples leave and enter, and once between two.
    """
    P, T, A, C = problem.period, problem.window, problem.A, problem.C
    grid = np.arange(0.0, P, step)
    mask = problem.open(grid)
    grid, mask = grid[mask.any(axis=1)], mask[mask.any(axis=1)]
    k = problem.counts[1]
    chosen = np.array(list(combinations(range(grid.size), k)))
    times = grid[chosen]
    gaps = np.diff(np.concatenate([times, times[:, :1] + P], axis=1), axis=1)
    held = np.all([np.any(np.abs(times - t) < 1e-9, axis=1) for t in problem.fixed], axis=0) if problem.fixed else True
    chosen = chosen[(gaps.min(axis=1) >= problem.spacing - 1e-9) & held]
    least = np.full(len(chosen), np.inf)
    for a in np.arange(0.0, P, step / 2):
        for low, high in ((1e-8, T + 1e-8), (-1e-8, T - 1e-8)):
            grams = np.zeros((grid.size, *A.shape))
            for i, t in enumerate(grid):
                for r in t - a + P * np.arange(-1, int(np.ceil(T / P)) + 2):
                    if low < r < high:
                        rows = (C @ expm(A * r))[mask[i]]
                        grams[i] += rows.T @ rows
            W = sum(grams[chosen[:, j]] for j in range(k))
            least = np.minimum(least, np.linalg.eigvalsh(W)[:, 0])
    best = int(np.argmax(least))
    return float(np.sqrt(max(least[best], 0.0))), grid[chosen[best]]
