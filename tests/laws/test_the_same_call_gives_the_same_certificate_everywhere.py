"""What `certify` finds depends on its arguments alone: work is counted, so that a slow machine finds the same bits."""

import dataclasses
import time

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, certify
from sampling_design._ball_flow import OutOfTime
from sampling_design.certificates.exact import efforts, weight_choice
from sampling_design.certificates.exact.canonical import canonical
from sampling_design.certificates.exact.given_weights import default_weights
from sampling_design.certificates.form.verdict import verdict_of
from sampling_design.certificates.rigorous.decide import CountedClock, verify_rigorously
from sampling_design.checkers.work import Work
from sampling_design.errors import UndecidedError

CLOCKS = ("thread_time", "process_time", "perf_counter", "monotonic")
RNG = np.random.default_rng(5)
LARGE = Plant(RNG.standard_normal((6, 6)) / 3, RNG.standard_normal((2, 6)))
UNEVEN = PeriodicSchedule([1.0, 0.4, 0.7])


def slowed(clock):
    """A clock by which everything takes 1e5 times as long."""
    return lambda: 1e5 * clock()


def certified(**given):
    """The certificate without the seconds that it took."""
    made = certify(LARGE, UNEVEN, **given)
    return dataclasses.replace(made, solver=dataclasses.replace(made.solver, seconds=0.0)).to_dict()


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


def test_a_check_ends_where_its_work_does():
    data = certify(LARGE, UNEVEN, eta=0.3, P2=np.eye(6)).to_dict()
    short = verdict_of(data, Work(100.0))
    assert short.verdict == "undecided"
    assert "it takes more work than one check may do" in short.reason
    assert verdict_of(data).passed


def test_what_a_share_spends_counts_for_the_whole():
    whole = Work(10.0)
    part = whole.share(4.0)
    part.spend(5.0)
    assert part.over
    assert not whole.over
    assert whole.share(100.0).left == whole.left == 5.0


def test_balls_end_where_their_work_does():
    data = certify(LARGE, UNEVEN, eta=0.3, P2=np.eye(6)).to_dict()
    short = verify_rigorously(data, work=Work(100.0))
    assert short.verdict == "undecided"
    assert short.reason == "it takes more work than was handed over"
    with pytest.raises(OutOfTime, match="the work ran out"):
        CountedClock(np.inf, Work(10.0)).check(11.0)


def test_a_proof_that_may_do_nothing_is_undecided(monkeypatch):
    for name in ("CHECK_WORK", "BALL_WORK"):
        monkeypatch.setattr(efforts, name, 1.0)
    with pytest.raises(UndecidedError, match="it takes more work than one check may do"):
        certify(LARGE, UNEVEN, eta=0.3, P2=np.eye(6))
