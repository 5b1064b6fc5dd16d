"""Intervals of random plants and records, in random units, are those of one linear program of the whole record.

Plain readings, limits of detection, composite samples, missing outputs, a bound for each sensor and sample, inputs, a
start of which nothing is known: the program's ends lie inside the interval, and within a hundredth of its width of it.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.accuracy.interval import state_interval
from sampling_design.accuracy.readings import AboveRange, BelowDetection, CompositeReading
from tests.cases import few
from tests.oracles.records import WholeRecord

WITHIN = 0.01
"""Share of the width that an interval may be wider: what its cells and its solver leave open."""

ROUNDED = 1e-7
"""Share of the width that rounding and the other solver may take."""

EXTREME = {
    "nothing drives": lambda w, v: (0 * w, v),
    "exact": lambda w, v: (w, v * (np.arange(v.shape[1]) > 0)),
    "all but noise is small": lambda w, v: (1e-6 * w, 1e3 * v),
    "all but disturbances are small": lambda w, v: (1e3 * w, 1e-3 * v),
}
"""What becomes of the bounds."""


def dynamics(rng, n):
    A, kind = rng.normal(size=(n, n)), rng.integers(5)
    if kind == 0:
        return A - np.eye(n) * (np.linalg.eigvals(A).real.max() + rng.uniform())
    if kind == 1:
        return np.diag(np.ones(n - 1), 1)
    if kind == 2:
        return A - A.T
    if kind == 3:  # grows
        return A - np.eye(n) * (np.linalg.eigvals(A).real.max() - 0.3)
    return np.diag(-(10.0 ** rng.uniform(-2, 1.2, n))) + 0.3 * np.triu(A, 1)  # stiff


def reading(rng, value, size, spans):
    """What is typed of a value, and the limits that it means: plain, under or over a limit."""
    got, kind = value + size * rng.uniform(-1, 1), rng.uniform()
    if kind < 0.15:
        limit = got + rng.uniform()
        return lambda unit: BelowDetection(limit * unit), -np.inf, limit + size
    if kind < 0.25:
        limit = got - rng.uniform()
        return lambda unit: AboveRange(limit * unit), limit - size, np.inf
    return lambda unit: got * unit, got - size, got + size


def drawn(seed, cells=16, extreme=lambda w, v: (w, v)):
    """A plant and a record as typed, with the program that knows all about them in plain units."""
    rng = np.random.default_rng(seed)
    n, p, q, m = (int(rng.integers(low, high)) for low, high in ((1, 5), (1, 3), (1, 3), (0, 2)))
    A, B, C, D, G = dynamics(rng, n), *(rng.normal(size=shape) for shape in ((n, m), (p, n), (p, m), (n, q)))
    wild = rng.uniform() < 0.6  # units of states, outputs, disturbances and of time
    x, y, w, t = (10.0 ** rng.integers(-6, 7, k) if wild else np.ones(k) for k in (n, p, q, 1))
    origin = 1.7e9 if t >= 1 and rng.uniform() < 0.4 else 0.0
    typed = origin + np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 1.2, rng.integers(2, 10)))]) * t
    times = ((typed - origin) / t).tolist()
    w_bound, v_bound = extreme(rng.uniform(0.01, 1, q), rng.uniform(0.05, 0.6, (len(times), p)))
    start = rng.uniform(0.1, 3, n) if rng.uniform() < 0.5 else None
    inputs = [(s, rng.normal(size=m)) for s in times if m and rng.uniform() < 0.4]
    whole = WholeRecord(A, B, C, D, G, times, np.zeros(n), inputs, cells)
    most = np.concatenate([np.ones(n) if start is None else start, np.resize(w_bound, whole.width - n)])
    truth = np.append(most * rng.choice([-1, -0.3, 0.5, 1], most.size), 1.0)
    rows, record, busy = [], [], np.full(p, times[0])
    for k, s in enumerate(times):
        found = []
        for i in range(p):
            since = rng.choice([a for a in times if busy[i] <= a < s]) if s > busy[i] and rng.uniform() < 0.2 else None
            if since is None and k + 1 < len(times) and i and rng.uniform() < 0.2:
                found.append(np.nan)
                continue
            own = whole.row(s, i, since)
            said, low, high = reading(rng, own @ truth, v_bound[k, i], since)
            rows.append((own, low, high))
            busy[i] = busy[i] if since is None else s
            say = said(y[i])
            found.append(say if since is None else CompositeReading(say, since=typed[times.index(since)]))
        record.append((typed[k], found, next((u for a, u in inputs if a == s), None)))
    free = [(None, None)] * n if start is None else [(-a, a) for a in start]
    bounds = free + [(-a, a) for a in np.resize(w_bound, whole.width - n)]
    c = rng.normal(size=n)
    in_x = x[:, None]
    plant = Plant(
        A * in_x / x / t,
        C / x * y[:, None],
        G=G * in_x / w / t,
        B=B * in_x / t if m else None,
        D=D * y[:, None] if m else None,
    )
    given = {"w_bound": w_bound * w, "v_bound": v_bound * y, "of": (c / x)[None]}
    if start is not None:
        given |= {"initial_error": start * x}
    return plant, record, given, whole.ends(c, times[-1], rows, bounds)


def wrong(seed, **named):
    """What of an interval is not as the program says."""
    plant, record, given, ends = drawn(seed, **named)
    found = state_interval(plant, record, **given)
    known = [abs(end) for end in ends if np.isfinite(end)]
    width = ends[1] - ends[0] if len(known) == 2 else max([1.0, *known])
    said = [] if found.disproof is None and found.verify() else ["not proven"]
    for own, end, sign in zip((*found.lower, *found.upper), ends, (-1.0, 1.0), strict=True):
        right = own == end if np.isinf(end) else -ROUNDED * width <= sign * (own - end) <= WITHIN * width
        said += [] if right else [f"{own} where the program has {end}"]
    return said


@pytest.mark.parametrize("seed", few(range(12), 0, 3, 5, 8, 10))
def test_an_interval_is_what_a_linear_program_of_the_record_says(seed):
    assert wrong(seed) == []


@pytest.mark.parametrize("extreme", EXTREME)
def test_so_it_is_where_bounds_are_0_or_far_apart(extreme):
    assert {seed: said for seed in range(100, 104) if (said := wrong(seed, extreme=EXTREME[extreme]))} == {}


@pytest.mark.long
@pytest.mark.parametrize("begin", [12, 62])
def test_so_is_that_of_fifty_more(begin):
    assert {seed: said for seed in range(begin, begin + 50) if (said := wrong(seed))} == {}


@pytest.mark.parametrize("left", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_what_data_at_the_edge_of_the_bounds_leave_is_no_wider(order, left):
    """A chain of integrators pushed as far as it goes: the reading leaves `left` of it, less than integrals once lost.

    From |x_i(0)| <= 1 with |w| <= 1/2 the first state comes to sum T^k/k! + T^n/(2 n!) at most, exactly.
    """
    T, noise = 1.5, 0.125
    plant = Plant(np.diag(np.ones(order - 1), 1), np.eye(order)[:1], G=np.eye(order)[:, -1:])
    most = sum(T**k / math.factorial(k) for k in range(order)) + T**order / (2 * math.factorial(order))
    record = [(T, [most + noise - left])]
    bounds = {"w_bound": [0.5], "v_bound": noise, "initial_error": [1.0] * order, "prior_time": 0.0}
    found = state_interval(plant, record, of=np.eye(order)[:1], **bounds)
    ends = found.lower[0], found.upper[0]
    assert ends == pytest.approx((most - left, most), abs=WITHIN * left)
    assert ends[0] <= most - left * (1 - 1e-9)
    assert ends[1] >= most * (1 - 1e-15)
    assert found.verify()
    assert found.verify(rigorous=True)


def test_ends_a_hundredth_off_are_told(monkeypatch):
    """The judge itself: what it is told is wider, narrower or infinite is named."""
    plant, record, given, (low, high) = drawn(0)
    found, more = state_interval(plant, record, **given), 0.02 * (high - low)
    for lower, upper in ((found.lower - more, found.upper), (found.lower, found.upper - more), (found.lower, [np.inf])):
        other = replace(found, lower=np.asarray(lower), upper=np.asarray(upper))
        monkeypatch.setitem(globals(), "state_interval", lambda *record, other=other, **given: other)
        assert len([each for each in wrong(0) if "where the program has" in each]) == 1
