"""Units change nothing in certificates: no decision, and numbers only as the unit says."""

from __future__ import annotations

import dataclasses
import os

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, certify
from sampling_design.certificates.compare import arrival_patterns
from sampling_design.certificates.compare.random_arrivals import random_arrivals
from sampling_design.certificates.compare.tradeoff import tradeoff_curve
from sampling_design.certificates.exact.canonical import canonical
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.exact.information import information_curve
from sampling_design.certificates.exact.retained_part import search_units
from sampling_design.certificates.exact.riccati import supremum
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.errors import SamplingDesignError
from tests.cases import few
from tests.rescale import Units

SEEDS = range(int(os.environ.get("UNIT_SEEDS", "6")))
"""A benchmark may ask for more."""
EXACT = 1e-6
SEARCHED = 2e-3
"""A descent ends within its own precision, wherever rounding leads it."""


def case(seed: int) -> tuple[Plant, PeriodicSchedule, np.random.Generator]:
    rng = np.random.default_rng([11, seed])
    n, p = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    A = rng.standard_normal((n, n))
    A -= (np.max(np.linalg.eigvals(A).real) - rng.choice([-0.3, 0.0, 0.2])) * np.eye(n)
    plant = Plant(A, rng.standard_normal((p, n)), G=rng.standard_normal((n, 2)))
    return plant, PeriodicSchedule(rng.uniform(0.3, 1.5, int(rng.integers(1, 4)))), rng


def spd(rng: np.random.Generator, n: int) -> np.ndarray:
    root = rng.standard_normal((n, n))
    return root @ root.T + 0.1 * np.eye(n)


def outcome(verb):
    """What a verb decides: its answer, or the kind of its refusal."""
    try:
        return verb()
    except SamplingDesignError as error:
        return type(error)


@pytest.mark.parametrize("seed", SEEDS)
def test_given_weights(seed):
    plant, schedule, rng = case(seed)
    units = Units.drawn(rng, plant)
    P2, Qw, R = spd(rng, plant.n_states), spd(rng, 2), spd(rng, plant.n_outputs)
    here = outcome(lambda: certify(plant, schedule, eta=0.3, P2=P2, Qw=Qw, R=R))
    moved = {"P2": units.state_weight(P2), "Qw": units.disturbance_weight(Qw), "R": units.output_weight(R)}
    there = outcome(lambda: certify(units.plant(plant), units.schedule(schedule), eta=0.3 / units.time, **moved))
    if isinstance(here, type):
        assert there is here
        return
    assert there.lam == pytest.approx(here.lam, rel=EXACT)
    assert there.lam_samples == pytest.approx(here.lam_samples, rel=EXACT)
    assert there.horizon().minimum == pytest.approx(units.time * here.horizon().minimum, rel=EXACT)
    curves = information_curve(here, start=0.0), information_curve(there, start=0.0)
    assert curves[1].t == pytest.approx(units.time * curves[0].t, rel=EXACT)
    assert curves[1].least == pytest.approx(curves[0].least, rel=EXACT)


@pytest.mark.parametrize("finite", [False, True])
@pytest.mark.parametrize("seed", SEEDS)
def test_weights_are_sought_in_the_same_units(seed, finite):
    """Of a finite schedule nothing settles: its windows begin with the balanced sizes, which know no units either."""
    plant, schedule, rng = case(seed)
    units, weights = Units.drawn(rng, plant), weights_of(plant, None, None, None)
    moved = weights._replace(
        Qw=units.disturbance_weight(weights.Qw), **dict.fromkeys(("R", "Qv"), units.output_weight(weights.R))
    )
    times = schedule.between(0.0, 4.0) if finite else schedule
    found = [
        search_units(*problem, (canonical(*problem).time * eta,) * 2)[0].plant
        for *problem, eta in (
            (plant, times, weights, 0.3),
            (units.plant(plant), units.schedule(times), moved, 0.3 / units.time),
        )
    ]
    for key in "ACG":
        assert getattr(found[1], key) == pytest.approx(getattr(found[0], key), rel=EXACT, abs=EXACT)


@pytest.mark.parametrize("seed", SEEDS)
def test_lambda_over_the_whole_range_of_units(seed):
    """States, outputs and disturbances by 1e-12 to 1e12 each, time by 1e-9 to 1e9."""
    plant, schedule, rng = case(seed)
    units = Units.drawn(rng, plant)
    P2, weights = spd(rng, plant.n_states), weights_of(plant, spd(rng, 2), spd(rng, plant.n_outputs), None)
    moved = units.disturbance_weight(weights[0]), *(units.output_weight(W) for W in weights[1:])

    def lam(plant, schedule, weights, P2, eta):
        canon = canonical(plant, schedule, weights, P2)
        problem = window_problem(canon.plant, canon.schedule, canon.inside(P2), *canon.weights, eta * canon.time)
        return supremum(problem)[0].value

    here = lam(plant, schedule, weights, P2, 0.3)
    there = lam(units.plant(plant), units.schedule(schedule), moved, units.state_weight(P2), 0.3 / units.time)
    assert there == pytest.approx(here, rel=EXACT)


@pytest.mark.long
@pytest.mark.parametrize("rate", [0.3, None], ids=["at a rate", "rate chosen"])
@pytest.mark.parametrize("seed", SEEDS)
def test_chosen_weights(seed, rate):
    plant, schedule, rng = case(seed)
    units = Units.drawn(rng, plant)
    here = outcome(lambda: certify(plant, schedule, eta=rate))
    eta = None if rate is None else rate / units.time
    Qw = units.disturbance_weight(weights_of(plant, None, None, None)[0])  # the default counts energy per unit of time
    there = outcome(lambda: certify(units.plant(plant), units.schedule(schedule), eta=eta, Qw=Qw))
    if isinstance(here, type):
        assert there is here
        return
    assert there.horizon().minimum == pytest.approx(units.time * here.horizon().minimum, rel=SEARCHED)


@pytest.mark.parametrize("seed", few(SEEDS[:2], 0))
def test_tradeoff_curves(seed):
    plant, schedule, rng = case(seed)
    units = Units.drawn(rng, plant)
    here = outcome(lambda: tradeoff_curve(plant, schedule, 0.3, [1.5, 5.0]))
    Qw, moved = units.disturbance_weight(weights_of(plant, None, None, None)[0]), units.schedule(schedule)
    there = outcome(lambda: tradeoff_curve(units.plant(plant), moved, 0.3 / units.time, [1.5, 5.0], Qw=Qw))
    if isinstance(here, type):
        assert there is here
        return
    assert there.horizons == pytest.approx(units.time * here.horizons, rel=SEARCHED)


@pytest.mark.parametrize("seed", SEEDS)
def test_powers_of_two_change_no_bit(seed):
    """The internal problem of a plant in other units of powers of two is the same to the last bit."""
    plant, schedule, rng = case(seed)
    units = Units.drawn(rng, plant)
    units = dataclasses.replace(
        units,
        **{key: np.exp2(np.rint(np.log2(getattr(units, key)))) for key in ("states", "outputs", "disturbances")},
        time=float(np.exp2(np.rint(np.log2(units.time) / 2) * 2)),
    )
    P2, weights = spd(rng, plant.n_states), weights_of(plant, spd(rng, 2), spd(rng, plant.n_outputs), None)
    moved = units.disturbance_weight(weights[0]), *(units.output_weight(W) for W in weights[1:])
    here = canonical(plant, schedule, weights, P2)
    there = canonical(units.plant(plant), PeriodicSchedule(units.time * schedule.gaps), moved, units.state_weight(P2))
    for key in "ACG":
        assert np.array_equal(getattr(here.plant, key), getattr(there.plant, key))
    assert np.array_equal(here.inside(P2), there.inside(units.state_weight(P2)))
    assert np.array_equal(here.schedule.gaps, there.schedule.gaps)


ROTATING = Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0]], G=[[0.0], [1.0]])
SINKING = Plant([[-0.05]], [[0.6], [-0.4]], G=[[0.5]])


@pytest.mark.parametrize(
    ("plant", "chance"), few([(ROTATING, {"arrival_rate": 1.3, "horizon": 6.0}), (SINKING, {"horizon": 12.0})], 1)
)
def test_units_change_nothing_of_what_chance_leaves(plant, chance, monkeypatch):
    """Patterns that are equally likely are told apart by rounding alone: none of it may decide which become one."""
    monkeypatch.setattr(arrival_patterns, "MOST_CLASSES", 32)
    found = []
    for t in (1.0, 1 / 7):
        own = Plant(plant.A / t, plant.C, G=plant.G / np.sqrt(t))
        weights = np.eye(len(plant.C))
        made = certify(
            own, PeriodicSchedule(np.array([0.5, 1.5]) * t), eta=0.3 / t, P2=np.eye(len(plant.A)), Qw=[[1.0]],
            R=weights, Qv=weights,
        )  # fmt: skip
        scaled = {key: value * t if key == "horizon" else value / t for key, value in chance.items()}
        said = random_arrivals(made, 0.1, **scaled)
        found.append(np.concatenate([said.probability.ravel(), said.factor.ravel()]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-11)
