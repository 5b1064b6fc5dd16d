"""The Earth's pole: withheld days of the real record lie in what readings prove, and bad schedules prove nothing."""

import numpy as np
import pytest

import sampling_design as sd
from examples.polar_motion import pole as p

SCALE = 1.15 * 0.125


@pytest.fixture(scope="module")
def pole():
    return p.read_pole()


def test_the_record_is_the_daily_one_since_1962(pole):
    assert pole.days[0] == 37665
    assert np.all(np.diff(pole.days) == 1)
    assert pole.days[-1] > 61000
    assert 500 < np.abs(pole.xy).max() < 700
    assert pole.error.max() == 30.0


def test_the_wobble_turns_forwards(pole):
    """Of both senses of turning the plant's one explains the record's years before 2000 by far."""
    t = (pole.days - p.JUDGED_FROM)[pole.days < p.JUDGED_FROM]
    z = (pole.xy @ [1, 1j])[pole.days < p.JUDGED_FROM]
    strength = [abs(np.mean((z - z.mean()) * np.exp(s * 2j * np.pi * t / p.CHANDLER))) for s in (1, -1)]
    assert strength[0] > 10 * strength[1]
    x = p.plant().transition(p.CHANDLER / 4) @ np.eye(8)[2]
    assert x[3] == pytest.approx(-1.0)


def test_withheld_days_lie_in_what_monthly_readings_prove(pole):
    found = p.coverage(pole, p.SCHEDULES[0], SCALE, 5, seed=1)
    assert found.inside == 1.0
    assert found.widest < 60
    assert found.worst < found.widest


@pytest.mark.long
def test_what_300_days_prove_and_198_do_not(pole):
    some, none = (p.coverage(pole, p.SCHEDULES[k], SCALE, 2) for k in (2, 3))
    assert some.inside == 1.0
    assert some.widest < 350
    assert none.radius > 1000


def test_fixed_dates_are_blind_by_sigma_too():
    for schedule in p.SCHEDULES[-2:]:
        assert sd.observability.sigma_min(p.plant(), schedule.gap * np.arange(schedule.kept)) < 1e-9


@pytest.mark.long
def test_bounds_too_small_are_disproved_and_those_that_are_used_are_not(pole):
    days = 48_020 - 10 * np.arange(110)[::-1]
    small = p.proven(pole, days, 0.05, days[-1])
    assert small.contradiction > 1.0
    assert small.verify()
    assert p.proven(pole, days, SCALE, days[-1]).contradiction == 0.0


@pytest.mark.long
def test_the_scale_is_the_least_that_is_not_disproved(pole):
    """The rule on the one stretch that decides it, asked again on both sides of what it found."""
    last = 48_020
    rows = slice(int(pole.at(last - 37 * 30)), int(pole.at(last + 1)))
    part = p.Pole(pole.days[rows], pole.xy[rows], pole.error[rows])
    found = p.least_scale(part, last + 1, every=30)
    asked = last - 30 * np.arange(37)[::-1]
    assert 0.05 < found < 0.13
    assert p.proven(pole, asked, found, last).contradiction == 0.0
    assert p.proven(pole, asked, found - 0.006, last).contradiction > 1.0


def test_sinusoids_that_were_fitted_before_2000_are_lost_after(pole):
    rms, worst = p.sinusoids_error(pole)
    assert rms > 100
    assert worst > 200
