"""One unit of time and one list of outputs where a plant meets a schedule."""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule
from sampling_design.errors import ArgumentError
from sampling_design.observability.alignment import align

PLANT = Plant(np.diag([-1.0, -2.0]), np.eye(2), time_unit="h", outputs=["T3", "T4"])


def test_nothing_to_put_in_order():
    for schedule in (Schedule([0.0, 1.0]), PeriodicSchedule([1.0], time_unit="h", output_names=["T3", "T4"])):
        assert align(PLANT, schedule) is schedule


def test_columns_follow_the_plant():
    schedule = Schedule([0.0, 1.0], [[1, 0], [1, 1]], output_names=["T4", "T3"])
    aligned = align(PLANT, schedule)
    assert aligned.output_names == ("T3", "T4")
    assert aligned.outputs.tolist() == [[False, True], [True, True]]


def test_an_output_that_is_not_named_is_never_measured():
    aligned = align(PLANT, PeriodicSchedule.from_times([0.5, 1.0], 2.0, output_names=["T4"]))
    assert aligned.outputs.tolist() == [[False, True], [False, True]]
    assert aligned.times.tolist() == [0.5, 1.0]
    assert aligned.period == 2.0


def test_units_must_agree():
    with pytest.raises(ArgumentError, match=r"in min and the plant in h. Convert it: schedule.in_unit\(\"h\"\)"):
        align(PLANT, Schedule([0.0], time_unit="min"))


def test_masks_must_fit():
    with pytest.raises(ArgumentError, match="mask for 3 outputs and the plant has 2"):
        align(PLANT, Schedule([0.0], [[1, 1, 0]]))


def test_unknown_output():
    with pytest.raises(ArgumentError, match=r"unknown key 'T5' in `schedule.output_names`. Known: 'T3', 'T4'"):
        align(PLANT, Schedule([0.0], output_names=["T3", "T5"]))


def test_a_schedule_that_measures_nothing_of_the_plant_is_another_plants():
    words = "`schedule` measures 'radial', 'along', and the plant's outputs are 'T3', 'T4'. Is it another plant's"
    with pytest.raises(ArgumentError, match=words):
        align(PLANT, Schedule([0.0], output_names=["radial", "along"]))


def test_times_are_no_schedule():
    with pytest.raises(ArgumentError, match=r"got list. Did you pass times\? Use Schedule\(times\)"):
        align(PLANT, [0.0, 1.0])
