"""A refusal names a schedule of the family, and its equations can be checked."""

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design import GapRange, Jitter, LostSamples, PeriodicSchedule, Plant, SpacedWindows
from sampling_design.errors import CertificateError, UndecidedError
from tests.counted_clock import Counted
from tests.oracles.families import largest_lambda

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
BIASED = Plant(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]), [[1.0, 0.0, 1.0]])


def counterexample_of(plant, family, eta=0.1):
    with pytest.raises(CertificateError, match=r"no certificate with rate .* exists for this family") as caught:
        sd.certify(plant, family, eta=eta)
    assert not isinstance(caught.value, UndecidedError)
    assert caught.value.exit_code == 1
    found = caught.value.details["counterexample"]
    assert family.contains(found.schedule)
    assert caught.value.details["gaps"] == tuple(found.schedule.gaps)
    return found


@pytest.mark.parametrize("gaps", [(3.0, 3.3), (0.5, 4.0), (np.pi, np.pi), (1.0, 100.0)])
def test_an_oscillator_with_a_range_that_holds_pi_returns_pi(gaps):
    found = counterexample_of(OSCILLATOR, GapRange(*gaps))
    assert found.schedule.gaps == pytest.approx([np.pi], rel=1e-15)
    assert abs(found.eigenvalue) == pytest.approx(1.0)
    assert found.verify()


def test_the_equations_of_a_counterexample_hold_by_themselves():
    found = counterexample_of(OSCILLATOR, GapRange(3.0, 3.3))
    v, mu = np.array(found.direction), found.multiplier
    M = expm(OSCILLATOR.A * np.pi)
    assert np.linalg.norm(M @ v - mu * v) < 1e-12
    assert abs(OSCILLATOR.C @ M @ v)[0] < 1e-12
    assert abs(mu) >= np.exp(-found.eta * np.pi / 2)
    assert "aliased" in found.explain()
    assert "3.14159" in str(found)


def test_lambda_grows_without_bound_along_a_counterexample():
    found = counterexample_of(OSCILLATOR, GapRange(3.0, 3.3), eta=0.4)
    weights = (np.eye(2), np.eye(1), np.eye(1))
    lams = [
        largest_lambda(
            OSCILLATOR, weights, 0.4, np.eye(2), found.schedule.period * np.arange(1, k + 1), starts=1, parts=1
        )
        for k in (2, 4, 8)
    ]
    # no certificate: the unseen direction grows like e^{eta t}
    assert lams[2] / lams[1] > np.exp(0.4 * 4 * np.pi) * 0.9
    assert lams[1] > 10 * lams[0]


def test_units_of_the_states_neither_make_nor_hide_a_counterexample():
    scale = np.array([2.0**30, 2.0**-20])
    D = np.diag(scale)
    there = Plant(D @ OSCILLATOR.A @ np.linalg.inv(D), OSCILLATOR.C / scale, G=D)
    found = counterexample_of(there, GapRange(3.0, 3.3))
    assert found.schedule.gaps == pytest.approx([np.pi])
    assert found.verify()
    assert sd.certificates.find_counterexample(there, GapRange(0.5, 1.5), 0.1)[0] is None


def test_a_false_counterexample_is_not_believed():
    found = counterexample_of(OSCILLATOR, GapRange(3.0, 3.3))
    from dataclasses import replace

    assert not replace(found, schedule=PeriodicSchedule([3.1])).verify()
    assert not replace(found, direction=(1.0 + 0j, 0j)).verify()
    assert not replace(found, multiplier=0.5 * found.multiplier).verify()
    assert not replace(found, direction=(0j, 0j)).verify()
    assert replace(found, residual=1e-3).verify()
    for wrong in (
        {"residual": -1e-3},
        {"eigenvalue": 2j},
        {"partners": ()},
        {"partners": (2j,)},
        {"partners": 2 * found.partners},
        {"reason": "every mode is observable"},
    ):
        assert not replace(found, **wrong).verify(), wrong


def test_losses_that_leave_a_blind_pattern_are_named():
    found = counterexample_of(OSCILLATOR, LostSamples(PeriodicSchedule([np.pi / 2]), 1, 2))
    assert found.schedule.period == pytest.approx(np.pi)
    # one loss in three leaves a pair a quarter turn apart: certified
    assert sd.certify(OSCILLATOR, LostSamples(PeriodicSchedule([np.pi / 2]), 1, 3), eta=0.1).verify().passed


def test_words_of_several_gaps_are_found():
    # an oscillator with a bias: two samples per turn alias all three modes, whatever the gaps between them
    found = counterexample_of(BIASED, GapRange(2.0, 2.0 * np.pi - 2.0 + 1e-9))
    assert len(found.schedule) in (1, 2)
    assert found.schedule.period == pytest.approx(2 * np.pi, rel=1e-9) or found.schedule.period == pytest.approx(np.pi)
    only_pairs = GapRange(3.1, 3.12), GapRange(2.9, 3.13)
    for family in only_pairs:
        assert not family.contains(PeriodicSchedule([np.pi]))
    pair = counterexample_of(BIASED, SpacedWindows(2 * np.pi, 2, 1.0))
    assert pair.schedule.period == pytest.approx(2 * np.pi) or pair.schedule.period == pytest.approx(np.pi)


def test_an_unseen_mode_is_a_counterexample_at_every_schedule():
    plant = Plant(np.diag([-0.1, 0.0]), [[0.0, 1.0]])
    found = counterexample_of(plant, Jitter(PeriodicSchedule([1.0]), 0.2), eta=0.3)
    assert found.eigenvalue == pytest.approx(-0.1)
    assert sd.certify(plant, Jitter(PeriodicSchedule([1.0]), 0.2), eta=0.15).verify().passed


def test_without_a_counterexample_the_least_margin_is_told():
    found, (margin, schedule, _) = sd.certificates.find_counterexample(OSCILLATOR, GapRange(0.5, 3.0), 0.1)
    assert found is None
    assert margin == pytest.approx(sd.certificate_exists(OSCILLATOR, schedule, 0.1).margin)
    assert GapRange(0.5, 3.0).contains(schedule)
    found, (margin, schedule, _) = sd.certificates.find_counterexample(
        OSCILLATOR, Jitter(PeriodicSchedule([1.0]), 0.3), 0.1
    )
    assert found is None
    assert margin > 0.01
    assert Jitter(PeriodicSchedule([1.0]), 0.3).contains(schedule)


def test_narrowed_families_lie_inside():
    assert GapRange(1.0, 3.0).narrowed(0.5).to_dict() == GapRange(1.5, 2.5).to_dict()
    assert Jitter(PeriodicSchedule([1.0]), 0.2).narrowed(0.5).timing_tolerance == 0.1
    assert SpacedWindows(4.0, 2, 0.5).narrowed(0.5) is None


@pytest.mark.parametrize("longest", [3.1e11, 3e11])
def test_gaps_of_ten_thousand_years_are_decided_at_once(longest):
    """Twenty million turns fit into every word: a few hundred periods are tried, and the search says so."""
    tide = Plant([[0.0, 1.4e-4, 0.0], [-1.4e-4, 0.0, 0.0], [0.0, 0.0, 0.0]], [[1.0, 0.0, 1.0]])
    with Counted().running() as clock:
        found, near = sd.certificates.find_counterexample(tide, GapRange(3e11, longest), 1e-12, quick=True)
    assert clock.read() < 10
    assert found is None or found.verify()
    assert "periods at which modes alias were tried" in near.searched


def test_a_search_ends_within_its_budget_and_says_so():
    with Counted().running() as clock:
        found, near = sd.certificates.find_counterexample(
            OSCILLATOR, LostSamples(PeriodicSchedule([1.0]), 3, 12), 0.1, budget=0.05
        )
    assert clock.read() < 2
    assert found is None
    assert "the search ended after 0.05 s" in near.searched


@pytest.mark.parametrize("period", [1e-7, 1e-9, 1e-10, 1e-12, 1e-15])
def test_dense_samples_are_never_called_aliased(period):
    """The two modes of the oscillator part by 2e-9 rad in a period: rounding hides it, no sample misses anything."""
    if period < 1e-9:
        with pytest.raises(UndecidedError, match="its samples are so dense that"):
            sd.certificate_exists(OSCILLATOR, PeriodicSchedule([period]), 0.4)
    else:
        assert "do not distinguish them" in sd.certificate_exists(OSCILLATOR, PeriodicSchedule([period]), 0.4).reason
    assert sd.certificates.find_counterexample(OSCILLATOR, GapRange(period, period), 0.4)[0] is None


def test_what_no_output_sees_is_missed_by_dense_samples_too():
    blind = Plant(np.diag([0.0, 0.1]), [[1.0, 0.0]])
    assert not sd.certificate_exists(blind, PeriodicSchedule([1e-12]), 0.4).exists
