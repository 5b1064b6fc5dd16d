"""A window that slides, of which only the ends are put together anew, says what the whole of it says.

Units of 1e-12 to 1e12, clocks at 1.7e9, plants that grow by e^400 over the record, directions that nothing shows,
discounts of e^1000, missing outputs, late samples, inputs, histories side by side: the same estimate to nine digits and
a radius that is no wider, wherever the sliding window answers at all. Where sharp readings make costs cancel it always
does; under constraints where none acts, and nowhere else.
"""

from __future__ import annotations

from itertools import pairwise, product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.estimators.constraints.constraints import Constraints, WindowConstraints
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.mhe import MovingHorizonEstimator
from tests.cases import few
from tests.rescale import Units

SAME = 1e-9
BOUNDS = {"w_bound": 0.3, "v_bound": 0.4, "initial_error": 2.0}


class Watched(MovingHorizonEstimator):
    """Answers as ever, and compares both ways at every sample."""

    slid = 0
    worst = 0.0
    terms = np.nan

    def _judged(self, state, new, terms, dual, held=0.0):
        self.terms = terms
        return super()._judged(state, new, terms, dual, held)

    def _slid_window(self, state, start, new):
        found, band = super()._slid_window(state, start, new)
        if found is not None:
            whole = self._solved(state, start, new)
            self.slid += 1
            self.worst = max(self.worst, difference(found, whole, self.terms - whole.cost))
        return found, band


def difference(one, other, least):
    """The largest difference, in standard deviations, in shares of the radius, and of the covariance's own size.

    A radius is off by what it is wider than the whole one's, or narrower than `least`, which has no margin at all: the
    whole one's margin is a share of what its reference costs, and may show where that is far off.
    """
    size = np.sqrt(np.diag(other.Y))
    off = [np.max(np.abs(one.x - other.x) / np.maximum(size, SAME * np.abs(other.x)))]
    off.append(np.max(np.abs(one.Y - other.Y) / np.outer(size, size)))
    off.append(abs(one.cost - other.cost) / max(other.cost, 1e-300))
    if np.isfinite(other.beta):
        off.append(max(one.beta - other.beta, least - one.beta) / other.beta)
    assert one.status == other.status
    return float(max(off))


def spring(growth=-0.1):
    return sd.Plant([[0.0, 1.0], [-4.0, 2 * growth]], [[1.0, 0.0]], B=[[0.0], [1.0]])


def record(plant, count=60, regular=False, start=0.0, seed=0, inputs=False, lost=0.0, noise=0.2):
    """Samples of a plant under bounded w and v, in its own units."""
    rng = np.random.default_rng(seed)
    x, t, u, rows = rng.normal(size=plant.n_states) * plant.states.scales, start, np.zeros(plant.n_inputs), []
    for _ in range(count):
        h = 1.0 if regular else rng.uniform(0.2, 1.8)
        w = rng.uniform(-0.1, 0.1, plant.n_disturbances) * plant.disturbances.scales
        F, E = plant.transition(h), plant.transition(h / 2)
        x, t = F @ x + h * (E @ (plant.G @ w + plant.B @ u)), t + h
        y = plant.C @ x + rng.uniform(-noise, noise, plant.n_outputs) * plant.outputs.scales
        if plant.n_outputs > 1 and rng.random() < lost:
            y[rng.integers(plant.n_outputs)] = np.nan
        u = rng.normal(size=plant.n_inputs) if inputs else u
        rows.append((t, y, u if inputs else None))
    return rows


DYADIC = {"P2": np.eye(2), "Qw": np.eye(2), "R": [[2.0]], "Qv": [[2.0]]}
"""Weights that multiply without rounding, which is all that a state of 1e180 would show of others."""

CASES = {
    "irregular": (spring(), {}, {}),
    "regular": (spring(), {"regular": True}, {}),
    "regular, inputs": (spring(), {"regular": True, "inputs": True}, {"eta": 2.0}),
    "inputs": (spring(), {"inputs": True}, {}),
    "undiscounted": (spring(), {}, {"eta": 0.0}),
    "filtered": (spring(), {}, {"arrival": "filtered"}),
    "the paper's": (spring(), {"regular": True}, {"form": "paper"}),
    "from samples": (spring(), {"inputs": True}, {"begins": "sample"}),
    "from samples, filtered": (spring(), {}, {"begins": "sample", "arrival": "filtered"}),
    "from samples, the paper's": (spring(), {}, {"begins": "sample", "form": "paper"}),
    "a far clock": (spring(), {"start": 1.7e9}, {"prior_time": 1.7e9}),
    "an unbounded one": (spring(), {}, {"w_bound": None}),
    "years of discounts": (spring(), {"count": 320}, {"eta": 2.5, "horizon": 4.0}),
    "growth": (spring(1.7), {"count": 230}, {"eta": 1.0, "horizon": 6.0, **DYADIC}),
    "nothing shows it": (sd.Plant(np.diag([-0.2, -0.3, 0.05]), [[1.0, 1.0, 0.0]]), {}, {}),
    "lost outputs": (sd.Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0], [1.0, 1.0]]), {"lost": 0.6}, {}),
}


def sets(plant, size):
    """Boxes, a ball and half-spaces of a size, each on one signal; the last on all, with a bounded disturbance."""
    n, p, q = plant.n_states, plant.n_outputs, plant.n_disturbances
    slab = ConvexSet.halfspaces(np.vstack([np.ones(p), -np.ones(p)]), [size, size])
    lost = slab & ConvexSet.box(np.full(p, -size), np.full(p, size))
    return {
        "x": Constraints(x=(-size, size)),
        "x between samples": Constraints(x=(-size, size), check_spacing=0.4),
        "x in a ball": Constraints(x=ConvexSet.ball(size, dimension=n)),
        "y": Constraints(y=lost),
        "v": Constraints(v=lost),
        "w": Constraints(w=(-size, size)),
        "w in a ball": Constraints(w=ConvexSet.ball(size, dimension=q)),
        "all": Constraints(x=(-2 * size, 2 * size), y=slab, v=(-size, size), w=(-size, size)),
    }


CONSTRAINED = ("irregular", "regular, inputs", "from samples, the paper's", "lost outputs", "a far clock")


@pytest.mark.parametrize(("kind", "case"), few(product(sets(spring(), 1.0), CONSTRAINED), *range(0, 40, 9)))
def test_under_constraints_that_never_act(case, kind, monkeypatch):
    """No window is put together to find that out, but those that a free one needs."""
    plant, drawn, given = CASES[case]
    rows, built = record(plant, **drawn), []
    put_together = MovingHorizonEstimator._window
    monkeypatch.setattr(MovingHorizonEstimator, "_window", lambda *a: built.append(a) or put_together(*a))
    free = MovingHorizonEstimator(plant, **settings(plant, given))
    free.run(rows)
    needed, built[:] = len(built), []
    mhe = MovingHorizonEstimator(plant, constraints=sets(plant, 1e4)[kind], **settings(plant, given))
    mhe.run(rows)
    assert len(built) == needed
    watched = Watched(plant, constraints=sets(plant, 1e4)[kind], **settings(plant, given))
    watched.run(rows)
    assert watched.slid == len(rows) - needed
    assert watched.worst < SAME


@pytest.mark.parametrize("kind", few(sets(spring(), 1.0), 0, 3, 7))
def test_under_constraints_that_act_now_and_then(kind):
    """Where the window slides no constraint acts in the whole one, and it slides wherever none does."""
    plant, _, given = CASES["lost outputs"]
    rows, slid = record(plant, count=24, lost=0.6), 0
    free = Watched(plant, **settings(plant, given))
    free.run(rows)
    low, high = 0.01, 10.0
    while slid in (0, free.slid):  # until some windows slide, and some do not
        assert high > 1.01 * low
        size = float(np.sqrt(low * high))
        mhe = Watched(plant, constraints=sets(plant, size)[kind], **settings(plant, given))
        engines = [mhe.update(*row).engine for row in rows]
        slid = mhe.slid
        assert 0 <= engines.count("banded") - slid <= len(rows) - free.slid
        assert mhe.worst < SAME
        low, high = (low, size) if slid else (size, high)


def settings(plant, given):
    """Those of an estimator, what belongs to the cost in its own record."""
    given = {"horizon": 8.0, "eta": 0.2, **BOUNDS, **given}
    cost = {key: given.pop(key) for key in ("eta", "form", "arrival", "begins", *DYADIC) if key in given}
    return {**given, "cost": CostFunction(**cost)}


@pytest.mark.parametrize("case", CASES)
def test_a_sliding_window_is_the_whole_one(case):
    plant, drawn, given = CASES[case]
    rows = record(plant, **drawn)
    mhe = Watched(plant, **settings(plant, given))
    found = mhe.run(rows)
    assert mhe.slid > 0.4 * len(rows)
    assert mhe.worst < SAME
    assert found.times.size == len(rows)


@pytest.mark.parametrize("regular", [True, False])
def test_costs_that_cancel(regular):
    plant, sharp = spring(), [[2e10]]
    rows = record(plant, 40, regular=regular, noise=1e-5)
    mhe = Watched(plant, **settings(plant, {"R": sharp, "Qv": sharp, "v_bound": 1e-5}))
    mhe.run(rows)
    assert mhe.slid == len(rows)
    assert mhe.worst < SAME


@pytest.mark.parametrize("seed", range(4))
def test_in_any_units(seed):
    """The default weights are those of the scales, which go with the units."""
    plant = CASES["lost outputs"][0]
    units = Units.drawn(np.random.default_rng(seed), plant)
    moved = [(units.time * t, y * units.outputs, u) for t, y, u in record(plant, 40, lost=0.4)]
    cost = CostFunction(Qw=units.disturbance_weight(np.eye(2)), eta=0.2 / units.time)
    mhe = Watched(units.plant(plant), horizon=8.0 * units.time, cost=cost)
    mhe.run(moved)
    assert mhe.slid > 30
    assert mhe.worst < SAME


def test_what_was_read_stands_in_every_window(monkeypatch):
    """Readings are put down when constraints first ask for them, whichever nodes were dropped meanwhile."""
    plant, _, given = CASES["lost outputs"]
    rows, asked, turn = record(plant, 90, lost=0.6), [], [0]
    held = WindowConstraints.hold

    def hold(self, path, samples):
        turn[0] += 1
        asked[:] = [] if turn[0] % 7 else [samples()]
        return held(self, path, lambda: asked[0]) if asked else True

    monkeypatch.setattr(WindowConstraints, "hold", hold)
    mhe = MovingHorizonEstimator(plant, constraints=Constraints(v=(-1e4, 1e4)), **settings(plant, given))
    for k, row in enumerate(rows):
        asked.clear()
        mhe.update(*row)
        if asked:
            y, masks, _ = asked[0]
            expected = np.array([each for _, each, _ in rows[k + 1 - len(y) : k + 1]])
            np.testing.assert_array_equal(np.where(masks > 0, y, np.nan), expected)
    assert turn[0] > 80


LOST = (18, 19, 31, 44)


def test_a_regular_record_that_breaks_off():
    """The factor of the window before serves only while gaps and outputs are the same for all of one, and after."""
    plant = CASES["lost outputs"][0]
    rows = [(t, y, None) for t, y, _ in record(plant, 80, regular=True)]
    for k in LOST:
        rows[k][1][1] = np.nan
    rows = [*rows[:50], *((t - 0.25, y, None) for t, y, _ in rows[50:])]
    mhe, found, before = Watched(plant, **settings(plant, {})), set(), None
    for k, row in enumerate(rows):
        Y = mhe.update(*row).covariance
        if Y is before:
            found.add(k)
        before = Y
    assert mhe.worst < SAME
    assert found.isdisjoint({at + since for at in LOST for since in range(8)} | set(range(50, 58)))
    assert {28, 29, 30, 41, 42, 43, 60, 70, 79} <= found


@pytest.mark.parametrize("given", [{}, {"form": "paper"}, {"begins": "sample", "form": "paper"}])
def test_the_factor_of_a_regular_record_serves_again(given):
    """Also where a sample stands at the window's start."""
    mhe = Watched(spring(), **settings(spring(), given))
    found = [mhe.update(*row).covariance for row in record(spring(), 30, regular=True)]
    assert all(one is other for one, other in pairwise(found[20:]))
    assert mhe.worst < SAME


def test_a_sample_at_the_prior_and_late_ones():
    plant = spring()
    mhe = Watched(plant, **settings(plant, {}))
    rows = record(plant, 30)
    mhe.update(0.0, [1.0])
    for t, y, _ in rows[:20]:
        mhe.update(t, y)
    for t, y, _ in rows[15:19]:
        mhe.update(t - 0.1, y)
    slid = mhe.slid
    mhe.run(rows[20:])
    assert slid > 20
    assert mhe.slid == slid + 10
    assert mhe.worst < SAME


def test_histories_side_by_side_and_one_twice():
    plant = spring()
    mhe, alone = Watched(plant, **settings(plant, {})), []
    runs = [record(plant, 12, seed=seed) for seed in range(2)]
    for rows in runs:
        mhe.start()
        alone.append(mhe.run(rows).x)
    states = [mhe.initial_state() for _ in runs]
    for k in range(12):
        for i, rows in enumerate(runs):
            _, first = mhe.step(states[i], rows[k])
            mhe.step(states[i], (rows[k][0] + 0.01, rows[k][1] + 1.0))
            states[i], again = mhe.step(states[i], rows[k])
            assert np.allclose(first.x, alone[i][k], rtol=0, atol=1e-12)
            assert np.allclose(again.x, alone[i][k], rtol=0, atol=1e-12)
    assert mhe.worst < SAME


def test_a_measurement_too_large_to_be_weighed_goes_the_whole_way():
    plant = spring()
    mhe = Watched(plant, **settings(plant, {}))
    rows = record(plant, 10)
    mhe.run(rows)
    assert mhe.update(rows[-1][0] + 1.0, [1e200]).status == "bounds disproved"
    assert mhe.update(rows[-1][0] + 2.0, [0.1]).status == "bounds disproved"
