"""What no disturbance drives is known as well as a linear program of the state alone says, soon; 0 is closed, too."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.accuracy.search import GainSearch
from sampling_design.accuracy.witness import attains
from tests.cases import few
from tests.oracles.accuracy import adversary, flown, undriven

PLANTS = {
    "level": ([[0.0]], [1.0]),
    "drift": ([[0.0, 1.0], [0.0, 0.0]], [1.0, 0.0]),
    "oscillator": ([[0.0, 1.0], [-1.0, 0.0]], [1.0, 0.0]),
    "decaying": ([[-0.1, 0.0], [0.0, -0.2]], [1.0, 0.0]),
    "growing": ([[0.1, 0.0], [1.0, -0.2]], [1.0, 0.0]),
    "two growing": ([[0.1, 0.0], [0.0, 0.3]], [1.0, 1.0]),
    "level and rhythm": ([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]], [1.0, 1.0, 0.0]),
    "defective": ([[-0.3, 1.0, 0.0], [0.0, -0.3, 0.0], [0.0, 0.0, 0.05]], [1.0, 0.0, 1.0]),
}
GAPS = {"one": [6.4], "two alike": [3.2, 3.2], "uneven": [0.8, 1.6, 4.0]}
CASES = [(plant, gaps, unit) for unit in (1.0, 1e-9, 1e12) for gaps in GAPS for plant in PLANTS]
KEPT = [CASES.index(case) for case in (
    ("drift", "one", 1.0), ("decaying", "two alike", 1.0), ("growing", "uneven", 1e-9), ("defective", "one", 1e12),
    ("level and rhythm", "one", 1.0))]  # fmt: skip
MOST = 150
"""Programs for a row of few states: a search that finds nothing to attain asked 2000."""


def counted(monkeypatch):
    """Searches that are made from now on."""
    made, begin = [], GainSearch.__init__

    def noted(self, *given, **named):
        begin(self, *given, **named)
        made.append(self)

    monkeypatch.setattr(GainSearch, "__init__", noted)
    return made


@pytest.mark.parametrize(("name", "gaps", "unit"), few(CASES, *KEPT))
def test_what_nothing_drives_is_known_as_a_linear_program_says(name, gaps, unit, monkeypatch):
    A, c = PLANTS[name]
    steps = np.array(GAPS[gaps])
    plant, made = sd.Plant(A, [c]), counted(monkeypatch)
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule(steps), w_bound=0.0, v_bound=0.1 * unit, of="x1")
    assert [search.solves <= MOST for search in made] == [True] * (name != "decaying")
    assert found.closed.all()
    assert found.verify()
    before = np.cumsum(np.tile(steps[::-1], 400 // steps.size))
    fastest = -min(np.linalg.eigvals(A).real.min(), 0.0)
    before = before[before * fastest <= 20]  # what has decayed by e^20 is 0 by then
    row, worst = np.eye(len(A))[0], 0.0
    for j, h in enumerate(steps):  # h lies behind sample j
        past = np.concatenate([[0.0], np.cumsum(np.roll(steps, -j)[::-1])[:-1]])
        ages = np.unique(
            np.concatenate([past, *(past + k * steps.sum() for k in range(1, 1 + before.size // steps.size))])
        )
        for d in np.linspace(0.0, h, 9):
            worst = max(worst, undriven(A, [c], ages + d, row, 0.1 * unit))
    below, above = float(found.lower[0]), float(found.upper[0])
    assert below <= worst * (1 + 1e-6)
    if name in ("decaying", "defective"):  # an endless past leaves nothing
        assert below == above == 0.0
        assert "x1 within 0 (none less than 0)" in found.explain()
    else:
        assert worst <= above * 1.02  # with 400 samples, where for ever is meant
        assert above <= worst * 1.02


def test_a_motion_that_was_beyond_its_noise_before_is_no_witness():
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=0.0, v_bound=0.1, of="x1")
    (witness,) = found.witnesses
    assert "From an admissible start" in witness.explain()
    for start in ([0.1, 0.01], [0.2, 0.0]):  # one has drifted there, one was too large
        forged = replace(witness, states=witness.states + (np.array(start) - witness.states[0]), value=start[0])
        assert not replace(found, witnesses=(forged,), lower=np.array([start[0]])).verify()


BESIDE = {
    "speed": ([[0.0, 1.0], [0.0, 0.0]], [1.0, 0.0]),
    "level": ([[-0.4, 0.0], [0.0, 0.0]], [1.0, 1.0]),
    "oscillator": ([[-0.4, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]], [1.0, 1.0, 0.0]),
}


@pytest.mark.parametrize(("name", "units"), few(product(BESIDE, [1.0, 1e6]), 0, 3, 4))
def test_what_is_driven_beside_it_is_attained_from_rest(name, units):
    """A state that w can hold at the sensor's noise is off by as much; what is not driven stays at rest meanwhile."""
    A, c = np.array(BESIDE[name][0]), np.array(BESIDE[name][1])
    sizes = np.where(np.arange(len(A)) % 2, units, 1 / units)
    plant = sd.Plant(A * sizes[:, None] / sizes, [c / sizes], G=sizes[:, None] * np.eye(len(A))[:, :1])
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([0.9]), w_bound=0.1, v_bound=0.2, of="x1")
    assert found.lower[0] >= 0.99 * 0.2 * sizes[0]
    assert found.verify()


EXACT = {
    "driven": ([[0.0, 1.0], [0.0, 0.0]], [[0.36, 0.006]], [[-0.9], [0.17]], [0.7]),
    "one of two": (
        np.diag([-4.3, -0.07, -0.08]),
        [[2.0, -0.5, 2.0], [0.7, -0.6, 0.5]],
        [[-1.5], [-0.5], [0.03]],
        [0.6],
    ),
}


@pytest.mark.parametrize("unit", [1.0, 1e9])
@pytest.mark.parametrize("name", EXACT)
def test_an_exact_sensor_is_the_limit_of_a_nearly_exact_one(name, unit):
    A, C, G, gaps = EXACT[name]
    plant, schedule = sd.Plant(A, np.asarray(C) * unit, G=G), sd.PeriodicSchedule(gaps)
    below, above = 0.0, 0.0
    for size in (0.0, 1e-9, 1e-4):
        noise = unit * np.array([size, 0.2])[: len(C)]
        found = sd.guaranteed_accuracy(plant, schedule, w_bound=0.1, v_bound=noise, of="x1")
        assert found.upper[0] >= max(0.98 * above, below)
        assert found.upper[0] <= 1.02 * above + 2e-3 or not above
        below, above = float(found.lower[0]), float(found.upper[0])
        assert 0 < below <= above


COUPLED = {
    "level": ([[0.09, -1.3], [0.0, 0.0]], [1.1, 0.4], 0.05),
    "growing": ([[-0.15, 0.9], [0.0, 0.43]], [0.8, -1.1], 0.05),
    "apart": ([[0.16, 0.0], [0.0, 0.0]], [0.86, 0.6], 0.1),
    "two": ([[-1.2, 0.5, 0.7], [0.0, 0.26, 0.0], [0.0, 0.0, 0.12]], [0.6, 1.0, -0.7], 0.05),
    "oscillator": ([[0.19, 0.98, 0.4], [0.0, 0.0, 1.76], [0.0, -1.76, 0.0]], [0.9, -0.5, 0.3], 1.0),
}


def of_twenty_samples(found, A, c, G, row, w, noise):
    """What twenty samples leave open of a state, by the oracle, at the time at which the record has its worst."""
    t, turns, schedule = float(found.worst[0]), np.arange(20, -3, -1), found.schedule
    past = (schedule.times - schedule.period * turns[:, None]).ravel()
    past = past[past < t - 1e-9][-20:]
    later, row = t - float(past[-1]), np.eye(len(A))[row]
    most, _, _ = adversary(A, [c], G, past, row @ expm(np.array(A) * later), w, noise, 4)
    return most + flown(A, G, row, later, w)


@pytest.mark.parametrize(("name", "unit"), few(product(COUPLED, [1.0, 1e9]), 0))
def test_what_is_driven_beside_it_hides_it_as_long_as_it_can(name, unit):
    """The adversary is the best of all that went on for ever and then turned: no other leaves more open."""
    A, c, noise = COUPLED[name]
    gaps, sizes = np.array([0.5, 0.8]), np.where(np.arange(len(A)) % 2, unit, 1 / unit)
    G = np.eye(len(A))[:, :1]
    plant = sd.Plant(np.array(A) * sizes[:, None] / sizes, [c / sizes], G=sizes[:, None] * G)
    schedule = sd.PeriodicSchedule(gaps)
    found = sd.guaranteed_accuracy(plant, schedule, w_bound=0.1, v_bound=noise, of="x1", rtol=0.1)
    most = of_twenty_samples(found, A, c, G, 0, 0.1, noise)
    assert 0.93 * most <= found.lower[0] / sizes[0] <= most * 1.01
    assert found.upper[0] / sizes[0] >= 0.97 * most  # of so many samples, where for ever is meant
    assert found.closed.all()
    assert found.verify()


@pytest.mark.parametrize(("turn", "unit"), few(product([1.76, 0.9], [1.0, 1e9]), 3))
def test_odd_multiples_of_its_rate_hide_an_undamped_mode(turn, unit):
    """At its own rate alone a disturbance hides a sixth and a ninth less; what goes on for ever is proven anew."""
    A, c, G = (
        np.array([[-0.4, 0.0, 0.0], [0.0, 0.0, turn], [0.0, -turn, 0.0]]),
        np.array([1.0, 1.0, 0.0]),
        np.eye(3)[:, :1],
    )
    sizes = np.array([1 / unit, unit, 1.0])
    plant = sd.Plant(A * sizes[:, None] / sizes, [c / sizes], G=sizes[:, None] * G)
    asked = {"w_bound": 1.0, "v_bound": 0.1, "of": "x2", "rtol": 0.03}
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([0.5, 0.8]), **asked)
    assert found.closed.all()
    assert found.verify()
    most = of_twenty_samples(found, A, c, G, 1, 1.0, 0.1)
    assert 0.9 * most <= found.lower[0] / unit <= most  # of so many samples, where for ever is meant
    (witness,) = found.witnesses
    begun = witness.past
    assert {1, 3, 5} == set(begun.multiples)
    assert "makes the one sample read zero" in replace(witness, samples=np.zeros(1)).explain()
    for forged in (
        replace(witness, past=None),
        replace(witness, past=begun.scaled(1.1), states=1.1 * witness.states),
        replace(witness, past=replace(begun, multiples=begun.multiples + 1)),
        replace(witness, past=replace(begun, rates=1.1 * begun.rates)),
        replace(witness, past=replace(begun, w=0.9 * begun.w)),
    ):
        assert not replace(found, witnesses=(forged,)).verify()


@pytest.mark.parametrize("seed", few(range(24), 1, 4))
def test_what_decays_beside_what_no_sample_shows_is_known_in_the_end(seed):
    """What no sample shows leaves rows alone that it does not enter, also where nothing drives the plant."""
    rng = np.random.default_rng(seed)
    hidden, decaying = rng.uniform(0.0, 0.2, 1 + seed % 2), -rng.uniform(0.2, 3.0, 2)
    order, rates = rng.permutation(2 + len(hidden)), np.append(decaying, hidden)
    plant = sd.Plant(np.diag(rates)[np.ix_(order, order)], [np.append(rng.normal(size=2), 0 * hidden)[order]])
    decays, noise = rates[order] < 0, rng.uniform(0.1, 0.5)
    schedule = sd.PeriodicSchedule(rng.uniform(0.4, 1.5, 2))
    for w in (0.0, 0.1):
        found = sd.guaranteed_accuracy(plant, schedule, w_bound=w, v_bound=noise)
        stds = sd.accuracy.standard_deviation(plant, schedule, w_intensity=w, v_deviation=noise).worst
        assert np.isfinite(found.upper).tolist() == np.isfinite(stds).tolist() == decays.tolist()
        assert found.verify()
        assert w or not (found.upper[decays].any() or stds[decays].any())


def drawn(seed, unit):
    """An oscillator that nothing drives beside two states that w drives, in coordinates of any units."""
    rng = np.random.default_rng([31, seed])
    turn, sizes = rng.uniform(0.5, 4), np.array([1.0, unit, 1 / unit, 1.0])
    A, G = np.zeros((4, 4)), np.eye(4)[:, 3:]
    A[0, 1], A[1, 0], A[2, 3], A[3, 3] = turn, -turn, 1.0, -rng.choice([0.0, 0.6])
    C, T = rng.standard_normal((1 + seed % 2, 4)), np.linalg.qr(rng.standard_normal((4, 4)))[0]
    A, G, C = sizes[:, None] * (T @ A @ T.T) / sizes, sizes[:, None] * (T @ G), C @ T.T / sizes
    schedule = sd.PeriodicSchedule.from_times(np.sort(rng.uniform(0, 3, 4)), 3.0)
    return sd.Plant(A, C, G=G), schedule, sizes, rng.uniform(0.2, 1.0, 2)


def flown_past(found, witness, periods):
    """x and w of a past at the samples and on the cells of so many periods, from its first sample, by other formulas.

    w is a signal that moves by itself, e^{mu t} of each amplitude; x follows from the first state alone.
    """
    past, plant = witness.past, witness.plant
    count, cells = past.w.shape[:2]
    first = (witness.last - len(witness.samples) + 1) % count
    gaps = np.roll(np.diff(found.question.nodes, append=found.question.end), -first - 1)
    exponents = past.rates.real + 1j * past.multiples * past.rates.imag
    n, q = plant.A.shape[0], plant.G.shape[1]
    x, shown, signals = np.zeros(n), [], []
    for m, mu in enumerate(exponents):
        move = np.block([[plant.A, plant.G], [np.zeros((q, n)), mu * np.eye(q)]])
        steps = [expm(move * gap / cells) for gap in gaps]
        age = gaps.sum() * periods
        states, now = [past.x[-1, :, m] * np.exp(-mu * age)], []
        for k in np.roll(np.arange(count), 1).tolist() * periods:
            for cell in range(cells):
                w = past.w[k, cell, :, m] * np.exp(-mu * age)
                both = steps[k] @ np.concatenate([states[-1], w])
                states.append(both[:n])
                age -= gaps[k] / cells
                now += [w, both[n:]]
        x = x + states[-1].real
        shown.append(np.array(states).real[::cells] @ plant.C.T)
        signals.append(np.array(now).real)
    return x, np.sum(shown, axis=0), np.sum(signals, axis=0)


@pytest.mark.parametrize(("seed", "unit"), few(product([0, 2, 7], [1.0, 1e6]), 1))
def test_what_hides_a_mode_may_change_within_a_period(seed, unit):
    """Both sides meet; the past keeps its bounds however long it has gone on, and no other is taken for it."""
    plant, schedule, sizes, (w, v) = drawn(seed, unit)
    row = np.array([[0.3, 1.0, -0.5, 0.7]]) / sizes
    found = sd.guaranteed_accuracy(plant, schedule, w_bound=w, v_bound=v, of=row, rtol=0.05)
    assert found.upper[0] <= 1.06 * found.lower[0]
    assert found.verify()
    (witness,) = found.witnesses
    past = witness.past
    x, shown, signals = flown_past(found, witness, 20)
    assert np.all(np.linalg.norm(shown, axis=1) <= v * (1 + 1e-6))
    assert np.all(np.linalg.norm(signals, axis=1) <= w * (1 + 1e-6))
    assert np.all(np.abs(x - witness.states[0]) <= 1e-7 * np.abs(past.x[-1]).sum(axis=1))
    spoilt_x, spoilt_w = past.x.copy(), past.w.copy()
    spoilt_x[0] *= 0.9
    spoilt_w[0, 0] *= 0.9
    for forged in (
        past.scaled(1.1),
        replace(past, x=spoilt_x),
        replace(past, w=spoilt_w),
        replace(past, x=np.roll(past.x, 1, axis=0), w=np.roll(past.w, 1, axis=0)),
        replace(past, x=past.x[-1:], w=past.w[-1:, -1:]),
        replace(past, x=past.x[1:], w=past.w[1:]),
        replace(past, rates=1.1 * past.rates),
    ):
        begun = replace(witness, past=forged, states=np.vstack([forged.state, witness.states[1:]]))
        assert attains(begun, found.bounds, None, found.question.gaps)[1] > 1.01
    assert not replace(found, witnesses=(begun,)).verify()
