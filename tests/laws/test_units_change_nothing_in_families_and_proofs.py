"""Units change nothing in certificates of families, of proof and detectability, nor in what is compared of them."""

from __future__ import annotations

import os

import numpy as np
import pytest

from sampling_design import (
    GapRange,
    Jitter,
    LostSamples,
    PeriodicSchedule,
    Plant,
    SpacedWindows,
    UncertainParameter,
    UncertainPlant,
    certify,
    robustness,
)
from sampling_design.certificates.compare.four_horizons import four_horizons
from sampling_design.certificates.detectability.best_rate import certify_detectability, detectability_from_proof
from sampling_design.certificates.exact.bound_weights import weights_from_bounds
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.families.certify_family import FamilySearch, certify_family
from sampling_design.certificates.families.graphs import in_plant_terms
from sampling_design.certificates.paper.proof_constants import certify_from_proof, constants_from_proof
from sampling_design.errors import SamplingDesignError
from sampling_design.plants.plant import Signals
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion
from tests.cases import few
from tests.rescale import Units

EXACT = 1e-6
OSCILLATOR = [[0.0, 1.0], [-1.0, 0.0]]
PLANTS = (
    Plant(OSCILLATOR, [[1.0, 0.3]], G=[[0.0], [1.0]]),
    Plant([[0.1, 1.0], [0.0, -0.4]], [[1.0, 0.2], [0.0, 1.0]]),
    Plant([[-0.2, 0.3], [0.0, 0.05]], [[0.4, 1.0]]),
)
SEEDS = range(int(os.environ.get("UNIT_SEEDS", "3")))
"""A benchmark may ask for more; what takes a second or more is asked of one."""


def changed(seed, **limits):
    plant = PLANTS[seed % len(PLANTS)]
    units = Units.drawn(np.random.default_rng([14, seed]), plant, **limits)
    return plant, units, units.plant(plant)


def given(plant, units=None):
    """Weights, in the old units or in the new ones."""
    own = units or Units(*map(np.ones, (plant.n_states, plant.n_outputs, 0, plant.n_disturbances)))
    return {
        "P2": own.state_weight(np.eye(plant.n_states) + 0.2),
        "Qw": own.disturbance_weight(np.eye(plant.n_disturbances) + 0.1),
        "R": own.output_weight(2.0 * np.eye(plant.n_outputs)),
    }


def outcome(verb):
    """What a verb decides: its answer, or the kind of its refusal."""
    try:
        return verb()
    except SamplingDesignError as error:
        return type(error)


def families(c):
    return {
        "gap range": GapRange(0.5 * c, 0.9 * c),
        "jitter": Jitter(PeriodicSchedule([0.8 * c]), 0.05 * c),
        "lost": LostSamples(PeriodicSchedule([0.4 * c]), 1, 4),
        "spaced": SpacedWindows(2.4 * c, 3, 0.5 * c),
        "blind": GapRange(0.9 * np.pi * c, 1.1 * np.pi * c),
    }


@pytest.mark.parametrize(
    ("seed", "kind"), few([(k + s, kind) for s in SEEDS[::3] for k, kind in enumerate(families(1.0))], 0, 4)
)
def test_families(seed, kind):
    plant, units, other = changed(seed)
    here = outcome(lambda: certify_family(plant, families(1.0)[kind], eta=0.1, **given(plant)))
    family = families(units.time)[kind]
    there = outcome(lambda: certify_family(other, family, eta=0.1 / units.time, **given(plant, units)))
    if isinstance(here, type) or isinstance(there, type):
        assert there is here
        return
    assert there.lam == pytest.approx(here.lam, rel=EXACT)
    assert there.horizon().minimum == pytest.approx(units.time * here.horizon().minimum, rel=EXACT)


@pytest.mark.parametrize("prior", [False, True])
@pytest.mark.parametrize("kind", list(families(1.0))[:-1])
@pytest.mark.parametrize("seed", SEEDS)
def test_the_program_of_a_family_is_the_same_to_the_last_bit(seed, kind, prior):
    """Rounding of the units alone took a solver elsewhere: one lambda was six times another, or none was found."""
    plant, units, other = changed(seed)
    made = []
    for here, c, weights in ((plant, 1.0, given(plant)), (other, units.time, given(plant, units))):
        P2, noise = weights["P2"] if prior else None, weights_of(here, weights["Qw"], weights["R"], None)
        search = FamilySearch(here, in_plant_terms(here, families(c)[kind]), noise, P2, 3.0)
        program = search.program(0.1 / c, search.graph(0))
        rows = [program.dynamics.rows[edge.outputs] for edge in program.graph.edges]
        numbers = program.dynamics.A, program.dynamics.noise, *rows, program.unit, *([program.P2] if prior else [])
        made.append(([M.tobytes() for M in numbers], program.dynamics.eta, program.edge_times, program.node_times))
    assert made[1] == made[0]


@pytest.mark.parametrize("factor", [7.0, 1e-6])
@pytest.mark.parametrize("plant", PLANTS[:2])
def test_a_common_factor_of_all_weights_changes_no_program(plant, factor):
    """Cost and information are counted in it: the rate hung on how the solver rounded."""
    made = []
    for c in (1.0, factor):
        Qw, R = c * (np.eye(plant.n_disturbances) + 0.1), c * 2.0 * np.eye(plant.n_outputs)
        family = in_plant_terms(plant, families(1.0)["jitter"])
        search = FamilySearch(plant, family, weights_of(plant, Qw, R, None), None, 3.0)
        program = search.program(0.1, search.graph(0))
        made.append([M.tobytes() for M in (program.dynamics.A, program.dynamics.noise, program.unit)])
    assert made[1] == made[0]


@pytest.mark.parametrize("seed", SEEDS[1:2])
def test_robustness_of_a_certificate(seed):
    plant, units, other = changed(seed)
    c, schedule = units.time, PeriodicSchedule([0.4])
    here = certify(plant, schedule, eta=0.3, **given(plant))
    there = certify(other, units.schedule(schedule), eta=0.3 / c, **given(plant, units))
    one, two = (robustness(p, made, longest=2, budget=1e3) for p, made in ((plant, here), (other, there)))
    assert one.closed
    assert two.closed
    assert one.radius > 0
    assert (two.radius, two.broken) == pytest.approx((c * one.radius, c * one.broken), rel=EXACT)
    assert [t.survives for t in two.trials] == [t.survives for t in one.trials]
    tried = [[(x.family.most, x.family.of, x.survives) for x in found.losses] for found in (one, two)]
    assert tried[1] == tried[0]
    assert two.tolerated == one.tolerated


@pytest.mark.parametrize(("seed", "variant"), [(s, ("paper", "tightened")[s % 2]) for s in SEEDS[1:]])
def test_constants_of_the_proof(seed, variant):
    plant, units, other = changed(seed)
    c, schedule = units.time, PeriodicSchedule([0.5, 0.8])
    here = outcome(lambda: constants_from_proof(plant, schedule, variant=variant))
    there = outcome(lambda: constants_from_proof(other.scaled(), units.schedule(schedule), variant=variant))
    if isinstance(here, type) or isinstance(there, type):
        assert there is here
        return
    assert there.horizon == pytest.approx(c * here.horizon, rel=EXACT)
    assert there.lam == pytest.approx(here.lam, rel=EXACT)
    assert there.eta * c == pytest.approx(here.eta, rel=EXACT)
    if seed == 1:
        one = certify_from_proof(plant, schedule, variant=variant)
        two = certify_from_proof(other.scaled(), units.schedule(schedule), variant=variant)
        assert two.lam == pytest.approx(one.lam, rel=EXACT)
        assert two.horizon("paper").minimum == pytest.approx(c * one.horizon("paper").minimum, rel=EXACT)


@pytest.mark.parametrize("seed", SEEDS[1:2])
def test_four_horizons(seed):
    plant, units, other = changed(seed)
    c, schedule = units.time, PeriodicSchedule([0.5, 0.8])
    moved = units.schedule(schedule)
    here = four_horizons(plant, schedule, certify(plant, schedule, eta=0.3, **given(plant)))
    there = four_horizons(other, moved, certify(other, moved, eta=0.3 / c, **given(plant, units)))
    for one, two in zip(here.rows[1:], there.rows[1:], strict=True):
        assert two.minimum == pytest.approx(c * one.minimum, rel=EXACT), one.name
    assert there.radius == pytest.approx(here.radius, rel=EXACT)


@pytest.mark.parametrize("rate", [None, 0.1])
@pytest.mark.parametrize("seed", SEEDS)
def test_detectability(seed, rate):
    plant, units, other = changed(seed)
    c = units.time
    here = outcome(lambda: certify_detectability(plant, rate))
    there = outcome(lambda: certify_detectability(other.scaled(), None if rate is None else rate / c))
    if isinstance(here, type) or isinstance(there, type):
        assert there is here
        return
    assert c * there.eta == pytest.approx(here.eta, rel=EXACT)
    assert c * there.c_w == pytest.approx(here.c_w, rel=EXACT)
    assert c * there.c_y == pytest.approx(here.c_y, rel=EXACT)
    assert np.abs(there.P - here.P).max() < EXACT * np.abs(here.P).max()


@pytest.mark.parametrize("seed", SEEDS)
def test_detectability_of_the_proof(seed):
    plant, units, other = changed(seed)
    here, there = (outcome(lambda p=p: detectability_from_proof(p)) for p in (plant, other.scaled()))
    if isinstance(here, type) or isinstance(there, type):
        assert there is here
        return
    size = there.P[0, 0] / here.P[0, 0]  # Lyapunov's equation has P grow with the unit of time
    assert size == pytest.approx(units.time, rel=EXACT)
    assert np.abs(there.P / size - here.P).max() < EXACT * np.abs(here.P).max()
    assert units.time * there.eta == pytest.approx(here.eta, rel=EXACT)
    assert units.time * there.c_y == pytest.approx(size * here.c_y, rel=EXACT)


@pytest.mark.parametrize("seed", SEEDS)
def test_weights_from_bounds(seed):
    plant, units, other = changed(seed)
    n, p, q = plant.n_states, plant.n_outputs, plant.n_disturbances
    one = weights_from_bounds(plant, 0.4, np.full(q, 0.2), np.full(p, 0.1), np.full(n, 2.0))
    two = weights_from_bounds(
        other, 0.4 / units.time, 0.2 * units.disturbances, 0.1 * units.outputs, 2.0 * units.states
    )
    assert two["P2"] == pytest.approx(units.state_weight(one["P2"]), rel=EXACT, abs=0)
    assert two["Qw"] == pytest.approx(units.disturbance_weight(one["Qw"]), rel=EXACT, abs=0)
    for key in ("R", "Qv"):
        assert two[key] == pytest.approx(units.output_weight(one[key]), rel=EXACT, abs=0)


@pytest.mark.long
@pytest.mark.parametrize("seed", few(SEEDS, 0))
def test_families_with_weights_of_their_own(seed):
    plant, units, other = changed(seed)
    Qw = units.disturbance_weight(weights_of(plant, None, None, None)[0])  # the default counts energy per unit of time
    here = outcome(lambda: certify(plant, families(1.0)["gap range"], eta=0.1))
    there = outcome(lambda: certify(other, families(units.time)["gap range"], eta=0.1 / units.time, Qw=Qw))
    if isinstance(here, type) or isinstance(there, type):
        assert there is here
        return
    assert there.horizon().minimum == pytest.approx(units.time * here.horizon().minimum, rel=EXACT)


@pytest.mark.parametrize("D", few([1.0, 7.0, 1e-5, 1e8], 2))
def test_units_cost_an_inclusion_no_information(D):
    """A rate in [.6, 1.4] leaves P < 1.2 - eta at lambda = 1, of which a turn that narrows nothing gave up a third."""
    plant = Plant([[-1.0]], [[1 / D]], G=[[D]], states=Signals(("x",), (), [D]))
    model = UncertainPlant(plant, [UncertainParameter("rate", -0.4, 0.4, A=[[1.0]], nominal=0.0)])
    found = certify_inclusion(model, GapRange(0.7, 0.9), eta=0.3, pieces=3)
    assert found.lam < 1 + 1e-4
    assert 0.89 < found.P[0, 0, 0] * D**2 < 0.9
