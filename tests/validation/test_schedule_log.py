"""Planned against actual times."""

import json

import numpy as np
import pytest

from sampling_design import ArgumentError, PeriodicSchedule, Plant, Schedule, compare_schedule, window_sigma
from sampling_design.plants.modes import split_modes
from sampling_design.records.file_io import to_json
from tests.validation.plants import PLANTS

PLANT, PLAN = PLANTS["oscillator"], PeriodicSchedule([1.0])


def test_a_plan_that_was_kept_costs_nothing():
    log = compare_schedule(PLANT, PLAN, np.arange(1.0, 9.0), window=3.0)
    assert (log.largest_deviation, log.missed.size, log.extra.size) == (0.0, 0, 0)
    assert log.kept == 1.0
    assert log.planned_sigma.lower == window_sigma(PLANT, log.planned, 3.0).lower


def test_late_missed_and_extra_samples_are_told_apart():
    log = compare_schedule(PLANT, PLAN, [1.1, 2.0, 2.2, 4.3, 4.9, 6.0], window=3.0)
    assert log.deviations == pytest.approx([0.1, 0.0, np.nan, 0.3, -0.1, 0.0], nan_ok=True)
    assert log.missed == pytest.approx([3.0])
    assert log.extra == pytest.approx([2.2])
    assert log.largest_deviation == pytest.approx(0.3)
    actual = window_sigma(PLANT, Schedule([1.1, 2.0, 2.2, 4.3, 4.9, 6.0]), 3.0).lower
    assert log.kept == pytest.approx(actual / log.planned_sigma.lower)
    assert log.kept < 1.0
    assert "1 of 6 planned samples were missed" in log.explain()
    data = json.loads(to_json(log.to_dict()))
    assert data["deviations"][2] is None
    assert data["actual_sigma"]["lower"] == actual
    assert "sigma, actual" in str(log)


def test_one_sample_stands_for_one_planned_sample_only():
    log = compare_schedule(PLANT, PLAN, [1.5], window=3.0)
    assert list(log.match) == [-1, 0]  # half-way it belongs to the later one
    both = compare_schedule(PLANT, Schedule([1.0, 2.0, 3.0]), [1.49, 2.51], window=0.5)
    assert list(both.match) == [0, -1, 1]


def test_outputs_that_were_planned_and_not_measured():
    plant = PLANTS["two outputs"]
    plan = Schedule([1.0, 2.0, 3.0], [[1, 1], [1, 0], [1, 1]])
    taken = np.array([[True, False], [True, False], [True, True]])
    log = compare_schedule(plant, plan, [1.0, 2.0, 3.0], window=9.0, outputs=taken)
    assert list(log.incomplete) == [True, False, False]
    assert log.planned_sigma is None
    assert log.kept is None
    assert log.explain().startswith("All 3 planned samples came at their times. The record is shorter than the window")
    assert not compare_schedule(plant, plan, [1.0, 2.0, 3.0], window=9.0).incomplete.any()


def test_a_blind_plan_is_said_to_be_blind():
    log = compare_schedule(PLANT, PeriodicSchedule([np.pi]), np.pi * np.arange(1, 6), window=7.0)
    assert log.kept is None
    assert "does not make every mode observable" in log.explain()


def test_where_every_mode_decays_there_is_no_sigma_to_compare():
    plant = Plant([[-0.5]], [[1.0]])
    log = compare_schedule(plant, PLAN, np.arange(1.0, 9.0), window=3.0, retained=split_modes(plant, 0.0).retained)
    assert log.planned_sigma is None
    assert "every mode decays by itself" in log.explain().lower()
    assert compare_schedule(plant, PLAN, np.arange(1.0, 9.0), window=3.0).planned_sigma.lower > 0


def test_bad_input_is_refused():
    with pytest.raises(ArgumentError, match="`times` must hold at least one sample"):
        compare_schedule(PLANT, PLAN, [], window=3.0)
    with pytest.raises(ArgumentError, match="`schedule` plans no sample up to"):
        compare_schedule(PLANT, Schedule([50.0]), [1.0, 2.0], window=3.0)
    with pytest.raises(ArgumentError, match="`times` must increase strictly"):
        compare_schedule(PLANT, PLAN, [2.0, 1.0], window=3.0)
    dated = 1.7e9 + np.arange(1.0, 9.0)
    with pytest.raises(ArgumentError, match=r"`times` begin at 1700000001, after .* samples of `schedule`"):
        compare_schedule(PLANT, PLAN, dated, window=3.0)
    assert compare_schedule(PLANT, PLAN.between(dated[0], dated[-1]), dated, window=3.0).kept
    with pytest.raises(ArgumentError, match="`window` must be positive"):
        compare_schedule(PLANT, PLAN, [1.0], window=0.0)
