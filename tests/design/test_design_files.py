"""The files of a design: its schedule, and calendars where time 0 has a date."""

from dataclasses import replace

import pytest

from sampling_design import Plant, Requirement, design_schedule, read_schedule
from sampling_design.design.design_files import write_design
from sampling_design.errors import ArgumentError


def test_a_design_is_written_with_its_calendars(tmp_path):
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], time_unit="h")
    design = design_schedule(plant, Requirement(window=4.0, spacing=0.4, samples=3), starts=1, budget=5.0)
    files, notes = write_design(design, tmp_path)
    assert ([path.name for path in files], notes) == (["schedule.csv"], [])
    files, notes = write_design(design, tmp_path, origin="2026-03-02", zone="Europe/Berlin")
    assert [path.name for path in files] == ["schedule.csv", "calendar.csv", "schedule.ics"]
    assert (read_schedule(files[0]).origin, notes) == ("2026-03-02", [])
    with pytest.raises(ArgumentError, match="`design` must be a ScheduleDesign with a schedule"):
        write_design(replace(design, schedule=None), tmp_path)
