"""What a design says it keeps if samples are late or lost is what the schedules themselves prove."""

from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.design.losses import without_sample
from sampling_design.observability.windows.window_sigma import SHARE, deviations_of
from sampling_design.records.record import below

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


@pytest.fixture(scope="module")
def design():
    return sd.design_schedule(OSCILLATOR, sd.Requirement(window=2 * np.pi, period=2 * np.pi, spacing=0.2, samples=4))


def test_a_design_says_what_late_and_lost_samples_leave(design):
    found = design.deviations
    assert found.tolerance.radius == pytest.approx(SHARE * np.pi / 2)
    assert found.late == pytest.approx(1.0, rel=0.03)  # three of four samples
    assert found.late_wider == pytest.approx(design.sigma, rel=0.02)
    assert found.late < found.late_wider < design.sigma
    assert found.lost == pytest.approx(1.0, rel=0.02)
    text, rows = str(design), design.explain()
    assert "if up to 0.015708 s early or late" in text
    assert "if one sample is lost" in text
    assert below(found.late) in rows
    assert design.to_dict()["deviations"] == found.to_dict()
    assert found.explain() in rows


def test_what_is_lost_is_what_the_losses_say(design):
    losses = sd.design.sample_losses(design)
    assert design.deviations.lost == pytest.approx(losses.lower.min(), rel=0.02)
    assert design.deviations.lost <= losses.upper.min() * (1 + 1e-9)
    assert losses.deviations == design.deviations
    assert design.deviations.explain() in losses.explain()
    assert "if up to 0.015708 s early or late" in str(losses)


def test_a_log_says_what_the_plan_keeps(design):
    log = sd.compare_schedule(OSCILLATOR, design.schedule, np.arange(9) * np.pi / 2 + 0.2, window=2 * np.pi)
    assert log.planned_sigma.deviations.lost == pytest.approx(design.deviations.lost, rel=0.02)
    assert "planned, if one sample is lost" in str(log)
    assert f"Of the plan: {log.planned_sigma.deviations.explain()}" in log.explain()


def test_times_that_were_asked_for_are_not_named_twice():
    kept = sd.worst_case_sigma(OSCILLATOR, sd.SpacedWindows(4.0, 3, 0.5), timing_tolerance=0.05, rtol=0.2)
    text = str(kept)
    assert text.count("0.05 s early or late") == 2  # what it is about, and how samples come
    assert "if up to" not in text
    assert "if one sample is lost" in text


def test_what_is_left_takes_as_many_seconds_as_the_search_was_given(design, monkeypatch):
    short = sd.design_schedule(OSCILLATOR, design.requirement, starts=1, branches=0, budget=50.0)
    assert (design.seconds, short.seconds) == (np.inf, 50.0)
    monkeypatch.setattr("sampling_design.observability.windows.window_sigma.sigma_of_pieces", None)  # nothing is judged
    assert replace(design, seconds=0.0).deviations is None


def test_nothing_is_said_where_nothing_is_observed():
    stable = sd.design_schedule(sd.Plant([[-1.0]], [[1.0]]))
    assert stable.deviations is None
    assert stable.to_dict()["deviations"] is None


def test_one_sample_a_period():
    plant = sd.Plant([[0.0]], [[1.0]])
    found = deviations_of(plant, sd.PeriodicSchedule([1.0]), 1.0)
    assert found.late == 0.0  # the one sample of a window may come just before it
    assert found.late_wider == pytest.approx(1.0)
    assert found.lost == 0.0
    assert without_sample(sd.PeriodicSchedule([1.0]), 0, 1) is None
    assert deviations_of(plant, sd.PeriodicSchedule([10.0]), 0.1).late == 0.0


def test_what_ball_arithmetic_proves_has_the_same_beside_it_or_nothing():
    """Where growth hides sigma from doubles, these say nothing, which is no cliff."""
    schedule = sd.PeriodicSchedule([0.7, 1.1])
    plain, proven = (sd.window_sigma(OSCILLATOR, schedule, 4.0, rigorous=asked) for asked in (False, True))
    assert proven.rigorous
    assert proven.deviations.lost == pytest.approx(plain.deviations.lost, rel=0.02)
    assert proven.deviations.late == pytest.approx(plain.deviations.late, rel=0.02)
    S = np.array([[1.0, 0.3], [-0.2, 1.0]])
    grown = sd.Plant(np.linalg.solve(S, np.diag([20.0, 0.0]) @ S), [[1.0, 0.4]])
    found = sd.window_sigma(grown, sd.PeriodicSchedule([2.5]), 10.0)
    assert found.rigorous
    assert found.lower > 0.1
    assert found.deviations is None


@pytest.mark.parametrize("start", [None, 1.0, 1.05])
@pytest.mark.parametrize("tolerance", [0.0, 0.1, (0.0, 0.2)])
def test_a_finite_schedule_of_one_window_says_what_is_left_wherever_it_starts(start, tolerance):
    """Longer windows hold what was planned in the shorter ones, so they begin before `start` by the time they allow."""
    schedule = sd.Schedule([1.0, 2.0, 3.5, 4.0, 6.0])
    window = schedule.times[-1] - (start or 1.0)
    found = sd.window_sigma(OSCILLATOR, schedule, window, start=start, timing_tolerance=tolerance)
    left = found.to_dict()["deviations"]
    assert 0 < left["late"] <= left["late_wider"] <= found.lower
