"""Whether a certificate exists is decided as in 50 digits, in any coordinates and units; a "no" is never wrong."""

import numpy as np
import pytest

from sampling_design import GapRange, PeriodicSchedule, Plant, certificate_exists, certify
from sampling_design.certificates.existence import periodic
from sampling_design.certificates.existence.counterexample import find_counterexample
from sampling_design.certificates.existence.periodic import judged, smallest_repair, stays_bounded
from sampling_design.errors import UndecidedError
from tests.benchmarks.bench_existence import CLEAR, NOTHING
from tests.cases import few
from tests.oracles.existence import drawn, least_seen, schedule_drawn
from tests.rescale import Units

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


@pytest.mark.parametrize("seed", few(range(30), *range(0, 30, 5)))
def test_existence_agrees_with_fifty_digits_in_any_units(seed):
    rng = np.random.default_rng(seed)
    known = drawn(rng, largest=6)
    schedule = schedule_drawn(rng, known)
    eta = float(rng.choice([0.0, 0.05, 0.3, 1.0]))
    truth = least_seen(known, schedule, eta)
    here = certificate_exists(known.plant, schedule, eta)
    if truth > CLEAR or truth < NOTHING:
        assert here.exists == (truth > CLEAR)
    for _ in range(3):
        units = Units.drawn(rng, known.plant)
        there = certificate_exists(units.plant(known.plant), units.schedule(schedule), eta / units.time)
        assert there.exists == here.exists
        if not here.exists:
            assert there.eigenvalue * units.time == pytest.approx(here.eigenvalue, rel=1e-6, abs=1e-6)
            assert len(there.partners) == len(here.partners)


@pytest.mark.parametrize("spectrum", [(0.0, -3.0, 1j), (0.0, 0.1, -3.0), (0.0, -0.05, -3.0)])
@pytest.mark.parametrize("seed", range(8))
def test_plainly_detectable_plants_are_not_refused(spectrum, seed):
    rng = np.random.default_rng(seed)
    J = np.diag([complex(v).real for v in spectrum])
    if spectrum[-1] == 1j:
        J = np.block([[J[:2, :2], np.zeros((2, 2))], [np.zeros((2, 2)), np.array([[0.0, 1.0], [-1.0, 0.0]])]])
    S = rng.standard_normal(J.shape)
    C = rng.uniform(0.5, 2.0, (1, len(J)))
    plant = Plant(S @ J @ np.linalg.inv(S), C @ np.linalg.inv(S))
    units = Units.drawn(rng, plant)
    schedule = units.schedule(PeriodicSchedule([0.8]))
    assert certificate_exists(units.plant(plant), schedule, 0.4 / units.time).exists


@pytest.mark.parametrize("coupling", [0.0, 1e-16, 1e-9])
def test_an_entry_at_the_edge_of_rounding_does_not_decide(coupling):
    plant = Plant([[0.1, 1.0], [0.0, coupling]], [[1.0, 1.0]])
    found = certificate_exists(plant, PeriodicSchedule([0.8]), 0.4)
    assert found.exists
    assert found.margin > 1e-2


@pytest.mark.parametrize("factor", [1e-10, 1.0, 1e10, 1e30])
def test_two_outputs_in_far_units(factor):
    plant = Plant([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.2]], [[1.0, 0.0, 0.0], [0.0, 0.0, factor]])
    assert certificate_exists(plant, PeriodicSchedule([0.8]), 0.4).margin == pytest.approx(
        certificate_exists(Plant(plant.A, np.eye(3)[[0, 2]]), PeriodicSchedule([0.8]), 0.4).margin, rel=1e-9
    )


@pytest.mark.parametrize("seed", range(4))
def test_repairs_and_counterexamples_follow_the_units(seed):
    rng = np.random.default_rng(seed)
    A = np.zeros((3, 3))
    A[:2, :2] = [[0.0, 1.0], [-1.0, 0.0]]
    plant = Plant(A, [[1.0, 0.0, 1.0]])
    units = Units.drawn(rng, plant)
    other = units.plant(plant)
    here = smallest_repair(plant, PeriodicSchedule([np.pi]), 0.1)
    there = smallest_repair(other, units.schedule(PeriodicSchedule([np.pi])), 0.1 / units.time)
    assert there["gap"] == here["gap"]
    assert there["to"] / units.time == pytest.approx(here["to"], rel=1e-9)
    one, (least, *_) = find_counterexample(plant, GapRange(3.0, 3.3), 0.1)
    two, (other_least, *_) = find_counterexample(other, GapRange(3.0 * units.time, 3.3 * units.time), 0.1 / units.time)
    assert one.schedule.gaps == pytest.approx([np.pi])
    assert two.schedule.gaps / units.time == pytest.approx(one.schedule.gaps)
    assert one.verify()
    assert two.verify()
    assert max(least, other_least) < 1e-9


def test_a_no_that_a_bounded_run_contradicts_is_said_to_be_undecided(monkeypatch):
    monkeypatch.setattr(periodic, "UNOBSERVED_TOLERANCE", 0.9)
    monkeypatch.setattr(periodic, "REPAIRED", 0.95)
    with pytest.raises(
        UndecidedError, match=r"is undecided: .* yet the discounted covariance .* stays bounded"
    ) as caught:
        certificate_exists(OSCILLATOR, PeriodicSchedule([1.0]), 0.4)
    assert caught.value.exit_code == 3
    assert caught.value.details["margin"] == judged(OSCILLATOR, PeriodicSchedule([1.0]), 0.4).margin


def test_the_run_that_checks_a_no():
    assert stays_bounded(OSCILLATOR, PeriodicSchedule([1.0]), 0.4)
    for unit in (1e-8, 1e8):
        chain = Plant(np.eye(4, k=1) / unit, np.eye(1, 4))
        assert stays_bounded(chain, PeriodicSchedule([0.5 * unit, 0.7 * unit]), 0.3 / unit)
    assert not stays_bounded(OSCILLATOR, PeriodicSchedule([np.pi]), 0.4)
    assert not stays_bounded(OSCILLATOR, PeriodicSchedule([np.pi]), 0.0)
    # a slow linear growth beside something a million times larger
    plant = Plant(np.diag([0.0, 0.0, -1e-6]), [[1.0, 1.0, 1.0]])
    assert not stays_bounded(plant, PeriodicSchedule([1.0]), 0.0)
    assert not stays_bounded(Plant([[400.0]], [[1.0]]), PeriodicSchedule([10.0]), 0.0)


def test_near_aliasing_is_seen_and_its_margin_says_how_near():
    margins = []
    for off in (1e-2, 1e-4, 1e-6, 1e-8):
        found = certificate_exists(OSCILLATOR, PeriodicSchedule([np.pi * (1 + off)]), 0.4)
        assert found.exists
        margins.append(found.margin / off)
        if off < 1e-2:
            assert "observable, but barely" in found.reason
            assert "aliased with 0-1i" in found.reason
    assert np.ptp(margins) < 0.1 * margins[0]


def test_the_first_sample_may_lie_at_time_zero():
    found = certificate_exists(OSCILLATOR, PeriodicSchedule([1.0], 0.0), 0.4)
    assert found.exists
    assert found.margin == certificate_exists(OSCILLATOR, PeriodicSchedule([1.0]), 0.4).margin
    here, there = (certify(OSCILLATOR, PeriodicSchedule([1.0], first), eta=0.4) for first in (0.0, 1.0))
    assert here.verify().passed
    assert here.lam == pytest.approx(there.lam, rel=1e-4)


@pytest.mark.parametrize("growth", [40.0, 400.0])
def test_growth_beyond_all_numbers_within_a_lap(growth):
    plant = Plant([[growth, 0.0], [0.0, 0.1]], [[1.0, 1.0]])
    assert certificate_exists(plant, PeriodicSchedule([3.0, 7.0]), 0.4).exists
    blind = Plant([[growth, 0.0], [0.0, 0.1]], [[1.0, 0.0]])
    found = certificate_exists(blind, PeriodicSchedule([3.0, 7.0]), 0.4)
    assert not found.exists
    assert found.eigenvalue == pytest.approx(0.1)


def test_a_covariance_that_rounding_makes_singular_has_not_settled():
    assert periodic._change(np.ones((2, 2)), np.eye(2)) == np.inf
    assert periodic._change(np.eye(2), 1.5 * np.eye(2)) == pytest.approx(0.5)
