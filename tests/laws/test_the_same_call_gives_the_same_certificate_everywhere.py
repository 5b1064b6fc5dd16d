"""What `certify` finds depends on its arguments alone: work is counted, so that a slow machine finds the same bits."""

import functools
import json
import time

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Requirement, certify, design_schedule, read_certificate
from sampling_design.certificates.exact import efforts, weight_choice
from sampling_design.certificates.exact.canonical import canonical
from sampling_design.certificates.exact.given_weights import default_weights
from sampling_design.certificates.form.verdict import verdict_of
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.checkers.check import check
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.checkers.parts import digest
from sampling_design.errors import UndecidedError
from sampling_design.records.budget import Budget, BudgetSpentError

CLOCKS = ("thread_time", "process_time", "perf_counter", "monotonic")
RNG = np.random.default_rng(5)
LARGE = Plant(RNG.standard_normal((6, 6)) / 3, RNG.standard_normal((2, 6)))
UNEVEN = PeriodicSchedule([1.0, 0.4, 0.7])


def slowed(clock):
    """A clock by which everything takes 1e5 times as long."""
    return lambda: 1e5 * clock()


def certified(**given):
    """The certificate's whole file, its digest included."""
    return certify(LARGE, UNEVEN, **given).to_dict()


@pytest.mark.long
@pytest.mark.parametrize("given", [{}, {"P2": np.eye(6)}], ids=["weights are sought", "a rate is sought"])
def test_a_slow_clock_changes_no_bit(given, monkeypatch):
    monkeypatch.setattr(weight_choice, "SEARCH_WORK", 3e5)  # the search ends early, and at the same place
    monkeypatch.setattr(weight_choice, "RATE_WORK", 2e4)
    plain = certified(**given)
    for name in CLOCKS:
        monkeypatch.setattr(time, name, slowed(getattr(time, name)))
    assert certified(**given) == plain


def test_a_search_ends_where_its_work_does(monkeypatch):
    canon = canonical(LARGE, UNEVEN, default_weights(LARGE), np.eye(6))
    met = []
    monkeypatch.setattr(weight_choice, "RATE_WORK", 4e3)
    found = weight_choice.choose_rate(canon, np.eye(6), (0.1, 2.0), lambda share, message: met.append(message))
    assert len(met) < weight_choice.SCAN
    assert any(message == f"rate {found:.3g}" for message in met)


@functools.cache
def made():
    return certify(LARGE, UNEVEN, eta=0.3, P2=np.eye(6)).to_dict()


def test_a_check_ends_where_its_work_does():
    data = made()
    short = verdict_of(data, WorkLimit(100.0))
    assert short.verdict == "undecided"
    assert "it takes more work than one check may do" in short.reason
    assert verdict_of(data).passed


def test_what_a_share_spends_counts_for_the_whole():
    whole = WorkLimit(10.0)
    part = whole.share(4.0)
    part.spend(5.0)
    assert part.over
    assert not whole.over
    assert whole.share(100.0).left == whole.left == 5.0


def test_balls_end_where_their_work_does():
    data = made()
    short = verify_rigorously(data, work=WorkLimit(100.0))
    assert short.verdict == "undecided"
    assert short.reason == "it takes more work than was handed over"
    with pytest.raises(BudgetSpentError, match="the work ran out"):
        Budget(work=WorkLimit(10.0)).check(11.0)


def test_a_proof_that_may_do_nothing_is_undecided(monkeypatch):
    for name in ("CHECK_WORK", "BALL_WORK"):
        monkeypatch.setattr(efforts, name, 1.0)
    with pytest.raises(UndecidedError, match="it takes more work than one check may do"):
        certify(LARGE, UNEVEN, eta=0.3, P2=np.eye(6))


@pytest.mark.long
def test_two_calls_write_one_file_and_a_file_of_before_still_holds(tmp_path):
    plant, schedule = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([1.0])
    one, two = (certify(plant, schedule).save(tmp_path / name).read_bytes() for name in ("one.json", "two.json"))
    assert one == two
    asked = Requirement(window=6.0, spacing=0.5, samples=3)
    assert design_schedule(plant, asked).to_dict() == design_schedule(plant, asked).to_dict()
    before = json.loads(one)
    before["solver"]["seconds"] = 0.25  # as it was written once
    before["digest"] = digest({key: value for key, value in before.items() if key != "digest"})
    (tmp_path / "before.json").write_text(json.dumps(before))
    found = read_certificate(tmp_path / "before.json")
    assert found.to_dict() == before
    assert found.verify().passed
    assert check(before)["verdict"] == "proven"
