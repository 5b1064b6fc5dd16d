from datetime import datetime

import numpy as np
import pytest

from sampling_design import ArgumentError
from sampling_design.errors import FileFormatError
from sampling_design.estimators import read_measurements
from sampling_design.plants import Plant
from sampling_design.records.dates import parse_date
from sampling_design.schedules.time_stamps import import_time_stamps


@pytest.fixture
def table(tmp_path):
    def write(text):
        path = tmp_path / "stamps.csv"
        path.write_text(text)
        return path

    return write


def test_dates_are_counted_from_the_first_naive_means_utc(table):
    schedule = import_time_stamps(table("# log\ndate,y\n2026-01-05T08:00,1\n2026-01-05T09:30:00,2\n"), "h")
    assert schedule.times.tolist() == [0.0, 1.5]
    assert schedule.origin == "2026-01-05T08:00:00+00:00"
    assert schedule.time_unit == "h"
    assert schedule.assumed_zone == "UTC"
    assert "dates without a zone  read in UTC" in str(schedule)


@pytest.mark.parametrize(
    ("origin", "zone", "hours", "assumed"),
    [
        (None, "Europe/Berlin", [0.0, 23.0, 23.5], "Europe/Berlin"),  # clocks go forward in between
        (None, None, [0.0, 24.0, 24.5], "UTC"),
        ("2026-03-28T00:00+01:00", None, [12.0, 36.0, 36.5], "UTC+01:00"),
        ("2026-03-28[Europe/Berlin]", None, [12.0, 35.0, 35.5], "Europe/Berlin"),
        ("2026-03-28", "Europe/Berlin", [12.0, 35.0, 35.5], "Europe/Berlin"),
    ],
)
def test_dates_without_a_zone_are_read_as_measurements_read_them_and_the_record_says_where(
    table, origin, zone, hours, assumed
):
    path = table("date,y\n2026-03-28T12:00,1\n2026-03-29T12:00,2\n2026-03-29T12:30,2\n")
    plant = Plant([[0.0]], [[1.0]], time_unit="h", outputs=["y"])
    measured = read_measurements(path, plant, origin=origin, zone=zone)
    for found in (import_time_stamps(path, "h", origin, zone=zone), measured):
        assert found.times.tolist() == hours
        assert found.assumed_zone == assumed
        assert f"read in {assumed}" in str(found)
    zoned = table("date,y\n2026-03-28T12:00+01:00,1\n")
    assert import_time_stamps(zoned, "h", zone=zone).assumed_zone == ""


def test_a_date_that_clocks_skip_is_refused_with_its_line(table):
    path = table("date\n2026-03-29T01:30\n2026-03-29T02:30\n")
    with pytest.raises(
        FileFormatError, match=r"line 3: `date` = .* is skipped or repeated by the clocks of Europe/Berlin"
    ):
        import_time_stamps(path, "h", zone="Europe/Berlin")
    with pytest.raises(ArgumentError, match="Did you mean 'Europe/Berlin'"):
        import_time_stamps(path, "h", zone="Berlin")


def test_offsets_are_honoured(table):
    """A clock change: 02:30 summer time comes before 02:15 winter time."""
    path = table("date\n2026-10-25T02:30+02:00\n2026-10-25T02:15+01:00\n")
    assert import_time_stamps(path, "min").times.tolist() == [0.0, 45.0]
    with_origin = import_time_stamps(path, "min", origin="2026-10-25", zone="UTC")
    assert with_origin.times.tolist() == [30.0, 75.0]
    assert import_time_stamps(path, "min", origin=datetime(2026, 10, 25), zone="UTC").times.tolist() == [30.0, 75.0]


def test_numbers_are_times_in_the_unit(table):
    schedule = import_time_stamps(table("time,y\n0.5,1\n2.25,3\n"), "d")
    assert schedule.times.tolist() == [0.5, 2.25]
    assert schedule.origin is None


def test_another_column_may_hold_the_times(table):
    path = table('sample,"taken at"\nA,2026-01-01\nB,2026-01-08\n')
    assert import_time_stamps(path, "wk", column="taken at").times.tolist() == [0.0, 1.0]


def test_microseconds_are_kept_over_years(table):
    path = table("date\n1990-01-01T00:00:00.000001\n2026-01-01T00:00:00.000002\n")
    times = import_time_stamps(path, "ms").times
    assert times[1] == (datetime(2026, 1, 1) - datetime(1990, 1, 1)).days * 86400000.0 + 0.001


def test_cells_say_which_outputs_were_measured(table):
    path = table("time,TSH,T3,note\n0,1.2,,a\n1,,,b\n2,nan,3.1,c\n3,1,2,\n")
    schedule = import_time_stamps(path, "d", outputs=["TSH", "T3"])
    assert schedule.times.tolist() == [0.0, 2.0, 3.0]
    np.testing.assert_array_equal(schedule.outputs, [[True, False], [False, True], [True, True]])
    assert schedule.output_names == ("TSH", "T3")
    assert len(import_time_stamps(path, "d")) == 4


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("", {}, "is empty, expected a header and rows"),
        ("stamp\n1\n", {}, "no column 'time' or 'date'; there are stamp"),
        ("time\n1\n", {"column": "t"}, "no column 't'; there are time"),
        ("time\n1\n", {"outputs": ["y"]}, "no column 'y'; there are time"),
        ("time,y\n1,2\n2\n", {}, r"line 3: expected 2 cells, got 1. Was the file cut off\?"),
        ("time\n# note\n2\n1\n", {}, "line 4: times must increase strictly, got one not later."),
        ("date\n2026-01-02\n2026-01-02\n", {}, "line 3: times must increase strictly"),
        ("time\n-1\n", {}, "line 2: a time must be finite and not negative, got -1"),
        ("time\ninf\n", {}, "line 2: a time must be finite and not negative, got inf"),
        ("date\nyesterday\n", {}, "line 2: `date` must be a date like 2026-01-05T08:00 .*, got 'yesterday'"),
        ("date\n2026-01-02\n", {"origin": "2026-01-03"}, r"line 2: 2026-01-02 comes before the origin 2026-01-03"),
        ("time\n1_000\n", {}, "line 2: `date` must be a date like .*, got '1_000'"),
        ("time\nTrue\n", {}, "line 2: `date` must be a date like .*, got 'True'"),
        ("time,time\n1,2\n", {}, "column 'time' occurs twice"),
        ("time,y,y\n1,2,\n", {"outputs": ["y"]}, "column 'y' occurs twice"),
        ("time,y\n1,2,3\n", {}, r"line 2: expected 2 cells, got 3. Was the file cut off\?"),
        ('time,y\n1,"a\nb"\n', {}, "Was a quote left open"),
    ],
)
def test_bad_files(table, text, options, message):
    with pytest.raises(FileFormatError, match=message):
        import_time_stamps(table(text), "h", **options)


def test_bad_arguments(table):
    path = table("time\n1\n")
    with pytest.raises(ArgumentError, match="`time_unit` must be one of"):
        import_time_stamps(path, "hours")
    for text in ("Monday", "2026-03-02T08:00[Europe/Berlin"):
        with pytest.raises(ArgumentError, match="must be a date like"):
            import_time_stamps(path, "h", origin=text)
    with pytest.raises(ArgumentError, match="`origin` must be a text or a datetime, got int 5"):
        import_time_stamps(path, "h", origin=5)


class Missing(datetime):
    """A date that is missing, as pandas has it: a datetime that equals nothing."""

    def __ne__(self, other):
        return True


def test_a_missing_date_is_no_date():
    with pytest.raises(ArgumentError, match="`start` must be a date like 2026-01-05T08:00"):
        parse_date("start", Missing(2026, 1, 5))


@pytest.mark.parametrize("blank", ["", "-", "NaN", "NA", "n/a", "null", "None"])
def test_a_cell_that_says_missing_is_no_sample(tmp_path, blank):
    path = tmp_path / "stamps.csv"
    path.write_text(f"time,a,b\n0,1,{blank}\n1,{blank},{blank}\n2,{blank},x\n")
    found = import_time_stamps(path, "h", outputs=["a", "b"])
    assert found.times.tolist() == [0.0, 2.0]
    assert found.outputs.tolist() == [[True, False], [False, True]]


def test_a_file_of_stamps_has_one_decimal_mark(tmp_path):
    path = tmp_path / "stamps.csv"
    for text in ("time;a\n0,5;1\n1.234;2\n", "time\ta\n0.5\t1\n1,234\t2\n"):
        path.write_text(text)
        with pytest.raises(FileFormatError, match="line 3 has a decimal point where others have a decimal comma"):
            import_time_stamps(path, "h")
    path.write_text("time;a\n0,5;1\n1,234;2\n")
    assert import_time_stamps(path, "h").times.tolist() == [0.5, 1.234]
