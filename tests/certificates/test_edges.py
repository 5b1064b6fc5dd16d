"""What doubles cannot follow is said in one sentence, before or after it was tried; nothing raw, no warning."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from sampling_design import GapRange, PeriodicSchedule, Plant, Schedule, certify
from sampling_design.certificates.compare.tradeoff import tradeoff_curve
from sampling_design.certificates.exact import efforts, precise, proof, weight_choice
from sampling_design.certificates.exact.canonical import canonical, evened
from sampling_design.certificates.families.certify_family import certify_family
from sampling_design.certificates.paper import proof_constants
from sampling_design.certificates.paper.proof_constants import certify_from_proof
from sampling_design.errors import ArgumentError, SolverError, UndecidedError
from tests.cases import few

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
EACH = PeriodicSchedule([1.0])


@pytest.mark.parametrize("growth", [200.0, 400.0, 800.0])
@pytest.mark.parametrize("given", [{}, {"eta": 0.4}, {"eta": 0.4, "P2": [[1.0]]}], ids=["free", "rate", "weights"])
def test_growth_beyond_doubles_is_undecided_before_it_is_tried(growth, given):
    with pytest.raises(UndecidedError, match=r"the squared error may grow by e\^.* before the next sample, beyond"):
        certify(Plant([[growth]], [[1.0]]), EACH, **given)


@pytest.mark.parametrize("given", [{}, {"eta": 0.4}, {"P2": np.eye(2)}], ids=["free", "rate", "weights"])
@pytest.mark.parametrize("mode", [0.0, -0.1])
def test_dated_times_are_asked_for_their_origin(given, mode):
    turning = Plant([[mode, 1.0], [-1.0, mode]], [[1.0, 0.0]])
    with pytest.raises(UndecidedError, match=r"Times count from 0: should the schedule begin there\?"):
        certify(turning, Schedule(1.7e9 + np.arange(5.0)), **given)


def test_far_times_keep_their_gaps_in_canonical_units():
    schedule = Schedule(1.7e9 + 1e-3 * np.arange(5.0))
    gaps = np.diff(evened(canonical(OSCILLATOR, schedule, (np.eye(2), np.eye(1), np.eye(1)))).schedule.times)
    np.testing.assert_allclose(gaps / gaps[0], 1.0, rtol=1e-3)


@pytest.mark.parametrize("key", ["A", "C"])
def test_numbers_too_far_apart_are_refused(key):
    matrices = {"A": OSCILLATOR.A, "C": OSCILLATOR.C}
    with pytest.raises(ArgumentError, match=f"`{key}` holds numbers too far apart for doubles"):
        certify(Plant(**{**matrices, key: 1e200 * matrices[key]}), EACH)


@pytest.mark.parametrize("given", few([{}, {"eta": 0.4}, {"eta": 0.4, "P2": np.eye(2)}], 2))
def test_what_is_large_but_can_be_done_is_done(given):
    stiff = Plant([[0, 1, 0], [-1, 0, 0], [0, 0, -1e9]], [[1, 0, 1]])
    more = {**given, "P2": np.diag([1.0, 1.0, 1e-9])} if "P2" in given else given
    assert certify(stiff, EACH, **more).lam > 1
    assert certify(Plant([[-1e4]], [[1.0]]), EACH, **{**given, **({"P2": [[1.0]]} if "P2" in given else {})}).lam == 1.0
    heavy = {**given, "P2": 1e300 * np.eye(2), "Qw": 1e300 * np.eye(2), "R": [[1e300]]} if "P2" in given else given
    assert certify(OSCILLATOR, EACH, **heavy).lam > 1


def test_a_noise_gain_that_no_shape_keeps_is_undecided():
    with pytest.raises(UndecidedError, match=r"no weights of noise gain .* could be followed in doubles"):
        certify(OSCILLATOR, EACH, eta=0.4, noise_gain=1 + 1e-12)


def test_noise_gains_of_a_curve_are_above_one():
    with pytest.raises(ArgumentError, match=r"`noise_gains` must be above 1, got 0\.5"):
        tradeoff_curve(OSCILLATOR, EACH, 0.4, [0.5, 2.0])


def test_what_fails_at_every_rate_is_undecided(monkeypatch):
    def unsettled(problem, work=None):
        raise SolverError("the information did not settle", status="unsettled")

    monkeypatch.setattr(weight_choice.WindowSet, "of", unsettled)
    monkeypatch.setattr(precise, "find_spec", lambda name: None)
    with pytest.raises(UndecidedError, match="at no rate that was tried could the information"):
        certify(OSCILLATOR, EACH)


def test_what_fails_with_given_weights_is_undecided(monkeypatch):
    def lost(problem, finer=1, deadline=None):
        return (proof.RiccatiPeak(np.inf, 0, 0.0, 0, 1.0),) * 2

    def unsettled(problem, finer=1, deadline=None):
        raise SolverError("the information did not settle", status="unsettled")

    monkeypatch.setattr(proof, "supremum", lost)
    with pytest.raises(UndecidedError, match="the information kept by some window is below what doubles can hold"):
        certify(OSCILLATOR, EACH, eta=0.4, P2=np.eye(2))
    monkeypatch.setattr(proof, "supremum", unsettled)
    with pytest.raises(UndecidedError, match="undecided: the information did not settle"):
        certify(OSCILLATOR, EACH, eta=0.4, P2=np.eye(2))


def test_a_proof_that_does_not_close_is_undecided(monkeypatch):
    def low(peaks):
        return tuple(proof.RiccatiPeak(peak.value / 2, *list(vars(peak).values())[1:]) for peak in peaks)

    found = proof.ScheduleProof.peaks_on
    monkeypatch.setattr(proof.ScheduleProof, "peaks_on", lambda self, finer: low(found(self, finer)))
    monkeypatch.setattr(efforts, "CHECK_WORK", 0.0)
    with pytest.raises(UndecidedError, match="the proof of the certificate did not close"):
        certify(OSCILLATOR, EACH, eta=0.4, P2=np.eye(2))


def test_memory_is_for_families():
    made = certify(OSCILLATOR, GapRange(0.5, 1.0), eta=0.1, P2=np.eye(2), memory=0)
    assert made.lam == certify_family(OSCILLATOR, GapRange(0.5, 1.0), eta=0.1, P2=np.eye(2), memory=0).lam
    with pytest.raises(ArgumentError, match="`memory` is for families of schedules, got 1 with a PeriodicSchedule"):
        certify(OSCILLATOR, EACH, memory=1)


@pytest.mark.unproven("refuted", "one of them is made false on purpose")
def test_constants_of_the_proof_that_doubles_cannot_hold_are_undecided(monkeypatch):
    def with_P1(P1):
        made = proof_constants.constants_from_proof(OSCILLATOR, EACH)
        monkeypatch.setattr(proof_constants, "constants_from_proof", lambda *a, **k: dataclasses.replace(made, P1=P1))
        return lambda: certify_from_proof(OSCILLATOR, EACH)

    with pytest.raises(UndecidedError, match="the weights that the proof gives cannot be held in doubles: `P1`"):
        with_P1(np.diag([1.0, -1.42]))()
    monkeypatch.undo()
    with pytest.raises(UndecidedError, match="the certificate with the proof's constants is not proven in doubles"):
        with_P1(1e9 * np.eye(2))()


@pytest.mark.long
@pytest.mark.parametrize("size", few([1e-200, 1e-300], 1))
def test_a_disturbance_of_hardly_any_effect_is_easy(size):
    plain = certify(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1e-40]]), EACH, eta=0.4)
    made = certify(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [size]]), EACH, eta=0.4)
    assert made.horizon().minimum == pytest.approx(plain.horizon().minimum, rel=2e-3)


def test_two_exact_gauges_of_one_state_are_no_singular_matrix():
    """C Y C' is of rank one and 1e24: the gain counts one output after the other."""
    made = certify(Plant([[2.464e-4]], [[11.07e12], [-0.1219e12]]), PeriodicSchedule([1470.0, 1387.0]), eta=2.6e-3)
    assert made.verify(rigorous=True).passed
