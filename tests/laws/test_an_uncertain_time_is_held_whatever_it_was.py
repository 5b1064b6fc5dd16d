"""Readings whose time is known only to an interval: what is said holds for every time in it, and for no less.

The times are those that a search finds worst, the truth is that of a linear program of the whole record at those times,
w, v and the start at their worst: no end of it lies outside, and the record with its times believed is outside.
"""

from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.readings import CompositeReading
from sampling_design.errors import ArgumentError
from tests.cases import few
from tests.oracles.records import WholeRecord

ROUNDED = 1e-6
"""Share of the width that rounding and the solvers may take."""


WITHIN = 0.01
"""Share of the width that an interval may be wider: what its cells and its solver leave open."""


class Case:
    """A random plant with inputs, exact and uncertain readings, in random units, and the program of any real times."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        n, p, q, m = (int(rng.integers(1, high)) for high in (4, 3, 3, 2))
        m = m if rng.uniform() < 0.5 else 0
        A, B, C, D, G = (rng.normal(size=s) for s in ((n, n), (n, m), (p, n), (p, m), (n, q)))
        A = A - np.eye(n) * (np.linalg.eigvals(A).real.max() + rng.choice([-0.2, 0.0, 0.5]))
        self.plain, self.start = (A, B, C, D, G), rng.uniform(0.3, 2, n)
        self.w, self.v, self.c = rng.uniform(0.01, 0.3, q), rng.uniform(0.02, 0.2, p), rng.normal(size=n)
        self.x, self.y, self.t = (
            10.0 ** rng.integers(-6, 7, n),
            10.0 ** rng.integers(-6, 7, p),
            10.0 ** rng.integers(-3, 4),
        )
        if rng.uniform() < 0.5:
            self.x, self.y, self.t = np.ones(n), np.ones(p), 1.0
        self.origin = 1.7e9 if self.t >= 1 and rng.uniform() < 0.3 else 0.0
        middles = np.cumsum(rng.uniform(0.4, 1.2, 4))
        half = np.where(rng.uniform(size=4) < 0.6, rng.uniform(0.02, 0.4, 4), 0.0)
        half[rng.integers(4)] = 0.3
        self.spans, self.end = np.array([middles - half, middles + half]).T, float(middles[-1] + 0.5)
        self.spans[0] = np.maximum(self.spans[0], 0.0)
        self.inputs = [(float(s), rng.normal(size=m)) for s in rng.uniform(0, self.end, 2) if m]
        self.inputs.sort(key=lambda pair: pair[0])
        self.outputs, real = rng.integers(p, size=4), rng.uniform(*self.spans.T)
        whole, self.real = self.whole(real), real
        most = np.concatenate([self.start, np.resize(self.w, whole.width - n)])
        truth = np.append(most * rng.choice([-1, -0.3, 0.5, 1], most.size), 1.0)
        noise = self.v[self.outputs] * rng.uniform(-1, 1, 4)
        self.read = [whole.row(s, i) @ truth + e for s, i, e in zip(real, self.outputs, noise, strict=True)]

    def whole(self, times):
        marks = sorted({0.0, self.end, *map(float, times), *(s for s, _ in self.inputs)})
        return WholeRecord(*self.plain, marks, np.zeros(len(self.start)), self.inputs, 6)

    def ends(self, times):
        """What those times leave possible of c'x at the end; None where they contradict the bounds."""
        whole = self.whole(times)
        rows = [
            (whole.row(s, i), y - self.v[i], y + self.v[i])
            for s, i, y in zip(map(float, times), self.outputs, self.read, strict=True)
        ]
        size = np.concatenate([self.start, np.resize(self.w, whole.width - len(self.start))])
        return whole.ends(self.c, self.end, rows, [(-a, a) for a in size])

    def worst(self, sign):
        """The end that is farthest out over all real times: ends, middles and the true ones, then one at a time."""

        def far(times):
            found = self.ends(times)
            return -np.inf if found is None else sign * found[sign > 0]

        grid = [np.unique([a, (a + b) / 2, b]) for a, b in self.spans]
        best = max((self.real, *(np.array(times) for times in product(*grid))), key=far)
        for k in np.flatnonzero(np.ptp(self.spans, axis=1)):
            for share in (0.25, 0.75, 0.9, 0.1):
                moved = best.copy()
                moved[k] = self.spans[k] @ [1 - share, share]
                best = moved if far(moved) > far(best) else best
        return sign * far(best)

    def plant(self):
        (A, B, C, D, G), x = self.plain, self.x[:, None]
        more = {"B": B * x / self.t, "D": D * self.y[:, None]} if B.shape[1] else {}
        return sd.Plant(A * x / self.x / self.t, C / self.x * self.y[:, None], G=G * x / self.t, **more)

    def bounds(self):
        return {"w_bound": self.w, "v_bound": self.v * self.y, "initial_error": self.start * self.x}

    def rows(self, exact=False):
        """As typed; inputs are rows of their own."""
        p, clock = len(self.v), lambda s: self.origin + s * self.t
        rows = [(clock(s), None, u) for s, u in self.inputs]
        for (a, b), i, y in zip(self.spans, self.outputs, self.read, strict=True):
            when = clock((a + b) / 2) if exact else (clock(a), clock(b))
            rows.append((when, [y * self.y[i] if j == i else np.nan for j in range(p)], None))
        return sorted(rows, key=lambda row: np.mean(row[0]))


class Unknown(Case):
    """The same with a start of which nothing is known, and no reading whose time is."""

    def __init__(self, seed):
        super().__init__(seed)
        rng, n = np.random.default_rng(seed), len(self.start)
        middles = np.cumsum(rng.uniform(0.4, 1.2, 6))
        half = rng.uniform(0.01, 0.08, 6)
        self.spans, self.end = np.array([middles - half, middles + half]).T, float(middles[-1] + 0.5)
        self.outputs, real = rng.integers(len(self.v), size=6), rng.uniform(*self.spans.T)
        whole = self.whole(real)
        most = np.concatenate([self.start, np.resize(self.w, whole.width - n)])
        truth = np.append(most * rng.choice([-1, -0.3, 0.5, 1], most.size), 1.0)
        noise = self.v[self.outputs] * rng.uniform(-1, 1, 6)
        self.read = [whole.row(s, i) @ truth + e for s, i, e in zip(real, self.outputs, noise, strict=True)]
        self.start = np.full(n, np.inf)

    def bounds(self):
        return {"w_bound": self.w, "v_bound": self.v * self.y}

    def worst(self, sign):
        """The end that is farthest out: times drawn, then one after the other at its ends and in the middle."""

        def far(times):
            found = self.ends(times)
            return -np.inf if found is None else sign * found[sign > 0]

        rng = np.random.default_rng(1)
        best, top = self.spans.mean(axis=1), far(self.spans.mean(axis=1))
        tried = [np.where(rng.uniform(size=6) < 0.5, *self.spans.T) for _ in range(5)]
        for k in range(6):
            for share in (0.0, 1.0, None):
                drawn = tried.pop() if share is None and tried else best
                moved = drawn.copy()
                moved[k] = moved[k] if share is None else self.spans[k] @ [1 - share, share]
                best, top = max([(best, top), (moved, far(moved))], key=lambda pair: pair[1])
        return sign * top


def makers(case):
    given, prior = case.bounds(), {"prior_time": case.origin}
    yield sd.SetMembershipEstimator(case.plant(), **given, **prior)
    cost = sd.CostFunction(eta=0.2 / case.t)
    yield sd.MovingHorizonEstimator(case.plant(), horizon=50 * case.t, cost=cost, **given, **prior)


@pytest.mark.parametrize("seed", few(range(200), 5))
def test_no_real_times_and_no_noise_lead_out_of_what_is_said(seed):
    case = Case(seed)
    low, high = case.worst(-1), case.worst(1)
    room, last = ROUNDED * (high - low), case.origin + case.end * case.t
    row = (case.c / case.x)[None]
    batch = sd.state_interval(case.plant(), case.rows(), last, of=row, prior_time=case.origin, **case.bounds())
    assert batch.verify()
    said = [batch]
    for estimator in makers(case):
        for t, y, u in case.rows():
            estimator.update(t, y, u)
        found = estimator.predict(last)
        assert found.certified
        said.append(found.interval(row))
        reach = np.sqrt(found.radius * np.vdot(row[0], found.covariance @ row[0]))
        assert row[0] @ found.x - reach <= low + room
        assert row[0] @ found.x + reach >= high - room
    for found in said:
        assert found.lower <= low + room
        assert found.upper >= high - room
        assert found.upper - found.lower <= 20 * (high - low)


@pytest.mark.parametrize("seed", few(range(60), 0))
def test_an_unknown_start_is_held_by_readings_of_uncertain_times_alone(seed):
    case = Unknown(seed)
    row = (case.c / case.x)[None]
    last = case.origin + case.end * case.t
    low, high = case.worst(-1), case.worst(1)
    online = []
    for estimator in makers(case):
        for t, y, u in case.rows():
            estimator.update(t, y, u)
        online.append(estimator.predict(last).interval(row))
    try:
        said = [sd.state_interval(case.plant(), case.rows(), last, of=row, **case.bounds()), *online]
    except ArgumentError:  # too few readings of what must be seen, or times too long for how fast it moves
        with pytest.raises(ArgumentError, match="nothing that is known by then bounds how far"):
            sd.state_interval(case.plant(), case.rows(), last, of=row, **case.bounds())
        assert all(found.lower == -np.inf and found.upper == np.inf for found in online)
        return
    assert said[0].verify()
    for found in said:
        assert found.lower <= low + ROUNDED * (high - low)
        assert found.upper >= high - ROUNDED * (high - low)
        assert found.upper - found.lower <= 20 * (high - low)


@pytest.mark.long
@pytest.mark.parametrize("seed", few(range(30), 1))
def test_an_unknown_start_is_held_by_readings_that_come_in_any_order(seed):
    case, rng = Unknown(seed), np.random.default_rng(seed)
    row, last = (case.c / case.x)[None], case.origin + case.end * case.t
    low, high = case.worst(-1), case.worst(1)
    estimator = sd.SetMembershipEstimator(
        case.plant(), **case.bounds(), prior_time=case.origin, maximum_delay=20 * case.t
    )
    for k in rng.permutation(len(case.rows())):
        estimator.update(*case.rows()[k])
    found = estimator.predict(last).interval(row)
    if not np.isfinite(found.upper):  # as above: nothing then bounds anything, in whatever order they come
        with pytest.raises(ArgumentError, match="nothing that is known by then bounds how far"):
            sd.state_interval(case.plant(), case.rows(), last, of=row, **case.bounds())
        return
    assert found.lower <= low + ROUNDED * (high - low)
    assert found.upper >= high - ROUNDED * (high - low)
    assert found.upper - found.lower <= 20 * (high - low)


def swung(t):
    return np.array([np.cos(t), -np.sin(t)])


SWING = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], B=[[0.0], [1.0]])


@pytest.mark.parametrize("origin", few([0.0, 1.7e9], 1))
@pytest.mark.parametrize("change", few(["withdraw", "correct", "input"], 1, 2))
def test_what_later_readings_told_of_earlier_ones_goes_with_them(change, origin):
    """Nothing is known of the start: two readings of uncertain times prove each other, and what came then was wrong."""

    def read(t, by=0.0):
        return (origin + t - 0.1, origin + t + 0.1), [swung(t + 0.1)[0] + by]

    def estimator():
        known = {"w_bound": 1e-3, "v_bound": 1e-2, "prior_time": origin}
        return sd.SetMembershipEstimator(SWING, maximum_delay=9.0, **known)

    once, never = estimator(), estimator()
    once.update(*read(1.0)), never.update(*read(1.0))
    assert np.isinf(once.predict(origin + 1.0).interval().upper).all()
    if change == "input":
        once.update(origin + 1.4, None, [80.0]), never.update(origin + 1.4, None, [0.0])
        once.update(origin + 1.5, None, [0.0]), never.update(origin + 1.5, None, [0.0])
    found = once.update(*read(2.0, 0.0 if change == "input" else 8.0)).interval()
    assert np.isfinite(found.upper).all()
    assert not found.holds(swung(2.0))
    if change == "withdraw":
        once.withdraw(read(2.0)[0])
    else:
        once.correct(*read(2.0)) if change == "correct" else once.correct(origin + 1.4, None, [0.0])
        never.update(*read(2.0))
    for t in (3.0, 4.0):
        found, other = (each.update(*read(t)).interval() for each in (once, never))
        assert found.holds(swung(t))
        np.testing.assert_allclose(found.upper - found.lower, other.upper - other.lower, rtol=1e-5)


def test_a_reading_whose_meaning_rests_on_one_that_is_taken_back_must_still_be_known():
    estimator = sd.SetMembershipEstimator(SWING, w_bound=1e-3, v_bound=1e-2, maximum_delay=0.5)
    estimator.remembered = 0
    for t in (1.0, 2.0):
        estimator.update((t - 0.1, t + 0.1), [swung(t)[0]])
    rested = estimator.state
    assert [node.t for node in rested.nodes] == pytest.approx([1.0, 2.0])
    with pytest.raises(ArgumentError, match="the oldest snapshot kept"):
        estimator.withdraw((1.9, 2.1))
    assert estimator.state is rested


def test_an_interval_may_hold_what_none_of_the_times_leaves():
    """The reading counts as limits at the middle of its span: of values inside is claimed less than of known times."""
    swing = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2))

    def at_the_end(since, until):
        record = sd.Measurements(swing, [[since, until]], [[1.0, 0.0]])
        start = {"prior": [0.0, 0.0], "prior_time": -1.0, "initial_error": [2.0, 2.0]}
        found = sd.state_interval(swing, record, 6.5, w_bound=0.0, v_bound=[0.1, 0.1], of="x1", **start)
        return float(found.lower[0]), float(found.upper[0])

    every = [at_the_end(t, t) for t in np.linspace(2.5, 3.5, 21)]
    lower, upper = at_the_end(2.5, 3.5)
    assert lower < min(low for low, _ in every)
    assert max(high for _, high in every) < -0.43 < 0 < upper


def test_a_time_that_is_believed_is_outside_and_a_walk_is_held_exactly():
    """x' = w: v + w h about the reading at the middle, v + w (t - first) later. A swing read late is missed."""
    walk, bounds = sd.Plant([[0.0]], [[1.0]]), {"w_bound": 0.1, "v_bound": 0.3, "initial_error": 5.0}
    estimator = sd.SetMembershipEstimator(walk, **bounds)
    assert estimator.update((1.0, 2.0), [1.0]).radii == pytest.approx([0.35], rel=1e-6)
    assert estimator.predict(2.0).radii == pytest.approx([0.4], rel=1e-6)
    swing, bounds = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), {"w_bound": 1e-3, "v_bound": 1e-2}
    truth, c = lambda t: np.array([np.cos(t), -np.sin(t)]), np.eye(2)
    rows = [((t, t + 0.5), [truth(t + 0.5)[0]]) for t in (1.0, 3.0, 4.5)]
    given = bounds | {"initial_error": 0.5, "prior": [1.0, 0.0], "prior_time": 0.0, "of": c}
    assert sd.state_interval(swing, rows, 6.0, **given).holds(truth(6.0))
    assert not sd.state_interval(swing, [(t[0] + 0.25, y) for t, y in rows], 6.0, **given).holds(truth(6.0))


@pytest.mark.parametrize(("side", "jump"), few(product(["right", "left"], [1.0, 1.5, 1.8, 2.0]), 1))
def test_an_input_that_jumps_at_either_end_or_in_the_middle_is_held_on_both_sides(side, jump):
    """y = x + u, read at any time from 1 to 2, both included, where u jumps: there u is that of the stated side."""
    plant = sd.Plant([[0.0]], [[1.0]], B=[[0.0]], D=[[1.0]])
    given, inputs = {"w_bound": 1e-3, "v_bound": 1e-2, "initial_error": 20.0}, [(0.0, None, [0.0]), (jump, None, [3.0])]
    for real in (1.0, 1.5, 2.0):
        read = ((1.0, 2.0), [5.0 + 3.0 * (real > jump or (real == jump and side == "right"))], None)
        rows = [inputs[0], *sorted([inputs[1], read], key=lambda row: np.mean(row[0]))]
        said = [sd.state_interval(plant, rows, 2.0, prior_time=0.0, **given)] if side == "right" else []
        horizon = {"horizon": 5.0, "cost": sd.CostFunction(eta=0.1)}
        for kind, more in ((sd.SetMembershipEstimator, {"maximum_delay": 5.0}), (sd.MovingHorizonEstimator, horizon)):
            for came in (rows, [inputs[0], read, inputs[1]]):  # the input is told of before, or afterwards
                estimator = kind(plant, input_side=side, **given, **more)
                for row in came:
                    estimator.update(*row)
                found = estimator.predict(2.0)
                assert abs(found.x[0] - 5.0) <= np.sqrt(found.radius * found.covariance[0, 0]) * (1 + ROUNDED)
                said.append(found.interval())
        for each in said:
            assert each.holds([5.0])
            assert each.radii[0] < 3.1


@pytest.mark.parametrize(
    ("x", "y"), few([([1e6, 1e-12], [1e-12, 1e6]), ([1e-12, 1e12], [1.0, 1e12]), ([1.0, 1e12], [1e12, 1.0])], 1)
)
def test_what_times_tell_of_an_unknown_start_is_the_same_in_any_units(x, y):
    """A growing swing, both states read in turn at times known to 0.1: states and outputs in units of their own."""
    A, C, W, V = np.array([[0.3, 1.0], [-1.0, 0.3]]), np.array([[1.0, 0.4], [-0.2, 1.0]]), 0.01, np.array([0.01, 0.02])
    ends = []
    for own, out in ((np.ones(2), np.ones(2)), (np.array(x), np.array(y))):
        plant = sd.Plant(A * own[:, None] / own, C / own * out[:, None], G=np.diag(own))
        rows = [
            ((t, t + 0.1), np.where(np.arange(2) == k % 2, C @ (np.exp(0.3 * t) * swung(t)) * out, np.nan))
            for k, t in enumerate((1.0, 1.7, 2.5, 3.1))
        ]
        found = sd.state_interval(plant, rows, 3.1, w_bound=W, v_bound=V * out)
        assert found.holds(np.exp(0.3 * 3.1) * swung(3.1) * own)
        ends.append(np.array([found.lower, found.upper]) / own)
    assert np.isfinite(ends[0]).all()
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(("n", "unit", "span"), [(3, 1e6, 8.0), (5, 1e4, 4.0)])
def test_poles_that_are_equal_but_for_rounding_are_held_in_any_units(n, unit, span):
    """A chain of tanks, .1 + .2 beside .3: there the `expm` of scipy is wrong by its own size."""
    chain = np.eye(n, k=1) - np.diag([0.3, 0.1 + 0.2, 0.3, 0.1 + 0.2, 0.3][:n])
    ends = []
    for x in (np.ones(n), unit ** np.arange(n)[::-1]):
        plant = sd.Plant(chain * x[:, None] / x, np.eye(n)[:1] / x[0], G=np.diag(x))
        rows = [((t, t + span), [y]) for t, y in ((1.0, 0.6), (1.5, 0.7))]
        given = {"w_bound": 1e-3, "v_bound": 0.01, "initial_error": 0.3 * x, "prior": x, "prior_time": 0.0}
        found = sd.state_interval(plant, rows, 1.5 + span / 2, **given)
        ends.append(np.array([found.lower, found.upper]) / x)
    assert np.isfinite(ends[0]).all()
    np.testing.assert_allclose(ends[1], ends[0], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("seed", few(range(30), 3))
def test_late_corrected_and_withdrawn_readings_of_uncertain_times_are_as_in_order(seed):
    """Also an input that is told of afterwards, in the middle of a time that is uncertain."""
    case = Case(seed)
    rows, rng = case.rows(), np.random.default_rng(seed)
    for straight, shuffled in zip(makers(case), makers(case), strict=True):
        if isinstance(shuffled, sd.KalmanFilter):
            shuffled = sd.SetMembershipEstimator(
                case.plant(), **case.bounds(), prior_time=case.origin, maximum_delay=20 * case.t
            )
        for t, y, u in rows:
            straight.update(t, y, u)
        for k in rng.permutation(len(rows)):
            t, y, u = rows[k]
            shuffled.update(t, y if y is None else [2 * each for each in y], u)
        for t, y, _ in rows:
            if y is not None:
                shuffled.correct(t, y)
        shuffled.update(case.origin + (case.end + 1) * case.t, [1e3 * case.y[0], *[np.nan] * (len(case.y) - 1)])
        found = shuffled.withdraw(case.origin + (case.end + 1) * case.t)
        last = case.origin + case.end * case.t
        assert found.t == max(np.mean(t) for t, y, _ in rows if y is not None)
        one, other = straight.predict(last).interval(), shuffled.predict(last).interval()
        np.testing.assert_array_less(np.abs(one.lower - other.lower), WITHIN * (one.upper - one.lower))
        np.testing.assert_array_less(np.abs(one.upper - other.upper), WITHIN * (one.upper - one.lower))


def test_what_is_said_once_more_beside_another_output_is_held_once():
    """Also by the row that a merged sample leaves, whatever was found of its time before."""
    swing = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.eye(2))
    estimator = sd.SetMembershipEstimator(swing, w_bound=0.1, v_bound=0.1, initial_error=1.0, maximum_delay=5.0)
    estimator.update((1.0, 2.0), [0.3, np.nan])
    estimator.update((1.0, 2.0), [0.3, 0.1])
    assert [each.output for each in estimator.state.last.sample.censored] == [0, 1]


def test_where_nothing_is_known_or_a_time_is_needed_it_is_said():
    swing = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], B=[[0.0], [1.0]])
    known = sd.SetMembershipEstimator(swing, w_bound=0.1, v_bound=0.1, initial_error=1.0, prior_time=1.0)
    plain = sd.MovingHorizonEstimator(swing, horizon=5.0, cost=sd.CostFunction(eta=0.1))
    mean = CompositeReading(0.5, 1.0)
    exact = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}
    for call, words in (
        (lambda: sd.state_interval(swing, [((1.0, 2.0), [1.0])], w_bound=0.1, v_bound=0.1), "how far y1 may move"),
        (lambda: known.update((0.5, 2.0), [1.0]), "must not begin before 1.0, the oldest time kept"),
        (lambda: known.update((2.0, 1.0), [1.0]), r"a time or a pair \(first, last\) in order, got \(2.0, 1.0\)"),
        (lambda: known.update((1.0, 2.0), [1.0], [0.0]), "an input needs its time"),
        (lambda: known.update((1.0, 2.0), [mean]), "of a mean must be one time, its end"),
        (lambda: plain.update((1.0, 2.0), [1.0]), "must be given for the limit, mean or uncertain time"),
        (lambda: sd.state_interval(swing, [((1.0, 2.0), [1.0], [0.0])], **exact), "an input needs its time"),
        (lambda: sd.state_interval(swing, [((1.0, 2.0), [1.0])], prior_time=1.5, **exact), "where an uncertain time"),
        (
            lambda: sd.state_interval(swing, [((1.0, 2.0), [1.0])], **exact | {"v_bound": lambda t: 0.1}),
            "`v_bound` must not depend on time",
        ),
    ):
        with pytest.raises(ArgumentError, match=words):
            call()
