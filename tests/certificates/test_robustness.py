"""Timing errors and losses under which a certificate survives."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import PeriodicSchedule, Plant, plotting
from sampling_design.certificates.compare.robustness import FamilyTrial, RobustnessSearch
from sampling_design.certificates.families import program
from sampling_design.certificates.families.certify_family import FamilySearch, certified
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.numerics import conic_programs
from sampling_design.records.budget import Budget
from tests.cases import few
from tests.oracles.families import largest_lambda

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


@pytest.fixture(scope="module")
def planned():
    return sd.certify(OSCILLATOR, PeriodicSchedule([1.0]), eta=0.8, P2=[[0.147, -0.037], [-0.037, 0.157]])


@pytest.fixture(scope="module")
def found(planned):
    return sd.robustness(OSCILLATOR, planned, longest=4)


def test_what_survives_is_proven_with_the_same_weights(planned, found):
    assert found.closed
    assert 0 < found.radius < found.broken < 0.5
    for certificate in (found.jittered, *found.thinned):
        assert certificate.verify().passed
        assert certificate.lam_proven < found.limit == pytest.approx(np.exp(0.8 * planned.horizon().length))
        for key in ("P2", "Qw", "R", "Qv", "eta"):
            assert np.array_equal(getattr(certificate, key), getattr(planned, key))
    assert found.jittered.family.timing_tolerance == found.radius
    assert found.tolerated
    assert all(d < w for d, w in found.tolerated)


def test_what_no_proof_closes_for_has_not_survived(monkeypatch, planned, found):
    """At horizons that bear nearly any lambda a solver finds what doubles cannot prove: it ended the search."""
    (most, of), *_ = found.tolerated
    asked = sd.Jitter(planned.schedule, found.radius)

    def refusing(plant, family, *others):
        if getattr(family, "timing_tolerance", 0.0) >= found.radius or getattr(family, "of", np.inf) <= of:
            raise UndecidedError("undecided: the proof of the certificate did not close.")
        return certified(plant, family, *others)

    monkeypatch.setattr("sampling_design.certificates.compare.robustness.certified", refusing)
    less = sd.robustness(OSCILLATOR, planned, longest=4, families=[asked])
    assert 0 < less.radius < less.broken == found.radius
    assert less.jittered.verify().passed
    assert [bool(trial) for trial in less.trials] == [t.family.timing_tolerance <= less.radius for t in less.trials]
    assert (most, of) not in less.tolerated
    assert not any(trial for trial in less.losses if trial.family.of <= of)
    assert [(bool(trial), trial.certificate) for trial in less.others] == [(False, None)]


def test_a_horizon_that_no_double_grows_over_bears_every_certificate(planned):
    found = sd.robustness(OSCILLATOR, planned, horizon=1e19, longest=2, budget=0.2)
    assert found.limit == np.inf
    none = FamilyTrial(sd.Jitter(planned.schedule, 0.45), np.inf, False)
    axes = np.ravel(replace(found, trials=(*found.trials, none)).plot())
    labels = [text for ax in axes for text in ax.get_legend_handles_labels()[1]]
    assert any("not proven" in text for text in labels)
    assert not any("limit" in text for text in labels)
    assert all(np.isfinite(line.get_ydata()).all() for ax in axes for line in ax.lines)
    assert found.to_dict()["limit"] is None


def test_the_certificate_of_a_family_is_sent_to_that_of_a_schedule(found):
    with pytest.raises(ArgumentError, match="must be about one schedule, got a FamilyCertificate, which is itself"):
        sd.robustness(OSCILLATOR, found.jittered)


def test_the_radius_is_nearly_the_largest(planned, found):
    # schedules that are only a little worse break the horizon: a late sample, then early ones, and so on
    weights = (planned.Qw, planned.R, planned.Qv)
    rng, worst = np.random.default_rng(3), 0.0
    for _ in range(12):
        shifts = rng.choice([-1.0, 1.0], 6) * found.broken * 1.1
        times = np.arange(1.0, 7.0) + shifts
        start = 1.0 - found.broken * 1.1  # just after the earliest possible sample
        lam = largest_lambda(OSCILLATOR, weights, 0.8, planned.P2, times - min(start, times[0]), starts=1, parts=4)
        worst = max(worst, lam)
    assert worst > 0.6 * found.limit


def test_losses_agree_with_brute_force(planned, found):
    weights = (planned.Qw, planned.R, planned.Qv)
    worst = {}
    for loss in found.losses:
        if not np.isfinite(loss.lam):
            continue
        top = 0.0
        for code in range(1 << 7):
            lost = [(code >> i) & 1 for i in range(7)]
            if all(sum(lost[i : i + loss.family.of]) <= loss.family.most for i in range(7)):
                times = np.array([i + 1.0 for i in range(7) if not lost[i]])
                top = max(top, largest_lambda(OSCILLATOR, weights, 0.8, planned.P2, times, starts=1, parts=1))
        worst[loss] = top
    assert worst
    for loss, top in worst.items():
        assert top <= loss.lam * (1 + 1e-3)
        assert loss.lam <= top * 1.02
        assert loss.survives == (top < found.limit)


@pytest.mark.long
def test_a_longer_horizon_survives_more(planned, found):
    longer = sd.robustness(OSCILLATOR, planned, horizon=2 * found.length, longest=2)
    assert longer.limit > found.limit
    assert longer.radius > found.radius


def test_what_was_tried_is_in_order_and_drawn(found, tmp_path):
    assert [t.family.timing_tolerance for t in found.trials] == sorted(t.family.timing_tolerance for t in found.trials)
    assert {t.survives for t in found.trials if t.family.timing_tolerance <= found.radius} == {True}
    assert {t.survives for t in found.trials if t.family.timing_tolerance >= found.broken} == {False}
    top, bottom = plotting.draw(found)
    assert top.lines[0].get_xdata()[-1] == found.radius
    assert len([line for line in bottom.lines if len(line.get_xdata()) == 1]) == len(found.losses)
    assert found.plot(top) is top
    assert plotting.save(found, tmp_path / "robustness.svg").read_bytes().startswith(b"<?xml")


def test_it_says_what_may_go_wrong(found):
    assert "early or late" in found.explain()
    assert "are lost" in found.explain()
    assert "losses up to" in str(found)


@pytest.mark.long
def test_a_design_is_certified_first():
    design = sd.design_schedule(OSCILLATOR, sd.Requirement(window=4.0, samples=3), starts=1, branches=0)
    found = sd.robustness(OSCILLATOR, design, longest=2, budget=0.3)
    assert found.certificate.schedule.times == pytest.approx(design.schedule.times)
    assert found.radius >= 0


def test_nothing_may_survive():
    planned = sd.certify(OSCILLATOR, PeriodicSchedule([3.0]), eta=0.3, P2=np.eye(2))
    found = sd.robustness(OSCILLATOR, planned, horizon=planned.horizon().minimum * 1.001, longest=2)
    assert (found.radius, found.tolerated, found.jittered) == (0.0, (), None)
    assert "no timing error and no loss" in found.explain()


def test_the_same_samples_in_longer_periods_survive_as_much_with_as_little_work():
    """Graphs of longer periods took the time of the search, and the radius was half of what it is."""
    plant, schedules = Plant([[0.1]], [[1.0]]), [PeriodicSchedule([1.0, 1.2] * count) for count in (1, 3)]
    found = [sd.robustness(plant, sd.certify(plant, each, eta=0.8, P2=[[0.2]]), longest=2) for each in schedules]
    once, thrice = found
    assert (thrice.radius, thrice.tolerated) == (once.radius, once.tolerated)
    assert len(thrice.jittered.graph.words) == len(once.jittered.graph.words)


@pytest.mark.parametrize("at", [2, 4])
def test_an_interrupt_leaves_what_was_proven(planned, found, monkeypatch, at):
    calls, propose = itertools.count(), FamilySearch.propose

    def interrupted(*given, **named):
        if next(calls) == at:
            raise KeyboardInterrupt
        return propose(*given, **named)

    monkeypatch.setattr(FamilySearch, "propose", interrupted)
    left = sd.robustness(OSCILLATOR, planned, longest=4)
    assert not left.closed
    assert 0 < left.radius <= found.radius
    assert left.jittered.verify().passed
    assert "an interrupt came" in str(left)


def test_an_interrupt_before_anything_is_proven_is_one(planned, monkeypatch):
    def interrupted(*given, **named):
        raise KeyboardInterrupt

    monkeypatch.setattr(FamilySearch, "propose", interrupted)
    with pytest.raises(KeyboardInterrupt):
        sd.robustness(OSCILLATOR, planned, longest=4)


def test_a_budget_that_runs_out_is_said(planned):
    found = sd.robustness(OSCILLATOR, planned, budget=1e-9)
    assert not found.closed
    assert found.radius == 0.0
    assert "budget ran out" in str(found)


@pytest.mark.parametrize("share", few([0.5, 1.0], 1))
def test_what_a_solver_leaves_of_matrices_when_time_is_up_ends_no_search(planned, monkeypatch, share):
    """Out of time it keeps to no cone: Cholesky's factor of what it left was a SolverError now and then."""
    solved, turned = program._solved, np.array([[1.0, 2.0], [2.0, 1.0]])

    def cut_off(cost, blocks, budget):
        found = solved(cost, blocks, budget)
        x = found.x.copy()
        x[:-1] = np.tile(conic_programs.svec((1 - share) * np.eye(2) + share * turned), x.size // 3)
        return replace(found, x=x, record=replace(found.record, status=conic_programs.BUDGET))

    monkeypatch.setattr(program, "_solved", cut_off)
    survived = sd.robustness(OSCILLATOR, planned, longest=3)
    assert (survived.radius, survived.tolerated) == (0.0, ())
    with pytest.raises(UndecidedError, match="no certificate was found"):
        sd.certify(OSCILLATOR, sd.GapRange(0.9, 1.0), eta=0.3)


def test_losses_among_any_number_of_samples_take_as_much_memory_as_there_is(planned):
    search, schedule = RobustnessSearch(planned, 1e9, Budget(), print), PeriodicSchedule([1.0])
    levels = [search._loss_level(sd.LostSamples(schedule, 1, of)) for of in (3, 1000, 10**9)]
    assert levels[0] < levels[1] == levels[2]


def test_what_cannot_be_asked_is_refused(planned):
    with pytest.raises(ArgumentError, match="must be on a PeriodicSchedule"):
        sd.robustness(OSCILLATOR, sd.certify(OSCILLATOR, sd.Schedule([1.0, 2.0, 3.0]), eta=0.3, P2=np.eye(2)))
    with pytest.raises(ArgumentError, match="`certificate` certifies another plant"):
        sd.robustness(Plant([[0.0, 1.0], [-2.0, 0.0]], [[1.0, 0.0]]), planned)
    with pytest.raises(ArgumentError, match="is too short for the planned schedule: it needs M >"):
        sd.robustness(OSCILLATOR, planned, horizon=0.5)


def test_what_is_no_family_is_refused(planned):
    with pytest.raises(ArgumentError, match="`families` must hold families of schedules, got int 0"):
        RobustnessSearch(planned, 1e9, Budget(), print).tried(0)
