import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sampling_design import ArgumentError, PeriodicSchedule, Plant, Schedule, read_schedule, window_sigma
from sampling_design.errors import FileFormatError
from sampling_design.schedules.files import schedule_from_dict, write_schedule

floats = st.floats(1e-3, 1e9)
details = {"time_unit": "h", "origin": "2026-01-05T00:00", "output_names": ("TSH", "T3")}


def same(a, b):
    assert type(a) is type(b)
    assert a.to_dict() == b.to_dict()
    np.testing.assert_array_equal(a.times, b.times)


def test_a_csv_file_reads_as_the_page_of_formats_says(tmp_path):
    path = tmp_path / "week.csv"
    schedule = PeriodicSchedule.from_times([0.0, 7.5, 24.0], 168.0, [[1, 0], [1, 1], [0, 1]], **details)
    assert write_schedule(schedule, path) == path
    assert path.read_text() == (
        "# sampling-design schedule; time_unit=h; period=168.0; origin=2026-01-05T00:00\n"
        "time,TSH,T3\n0.0,1,0\n7.5,1,1\n24.0,0,1\n"
    )
    same(read_schedule(path), schedule)
    path.write_text("# sampling-design schedule; time_unit=h; period=168\ntime\n1\n2.5\n")
    back = read_schedule(path)
    assert back.times.tolist() == [1.0, 2.5]
    assert back.period == 168.0
    assert back.outputs is None


@settings(max_examples=20)
@given(st.lists(floats, min_size=1, max_size=8, unique=True), st.sampled_from(["ms", "h", "wk"]))
def test_times_come_back_to_the_last_bit(tmp_path_factory, times, unit):
    folder = tmp_path_factory.mktemp("schedule")
    times = np.sort(times)
    period = float(times[-1] * 1.1)
    gaps = np.diff(times, prepend=0.0)
    for schedule in (
        Schedule(times, time_unit=unit),
        PeriodicSchedule.from_times(times, period, time_unit=unit),
        PeriodicSchedule(np.maximum(gaps, 1e-3), time_unit=unit),
    ):
        write_schedule(schedule, folder / "a.json")
        back = read_schedule(folder / "a.json")
        same(back, schedule)
        if isinstance(schedule, PeriodicSchedule):
            np.testing.assert_array_equal(back.gaps, schedule.gaps)
        write_schedule(schedule, folder / "a.csv")
        from_csv = read_schedule(folder / "a.csv")
        np.testing.assert_array_equal(from_csv.times, schedule.times)
        if isinstance(schedule, PeriodicSchedule):
            assert (from_csv.period, from_csv.first) == (schedule.period, schedule.first)


def test_outputs_without_names_get_columns_and_all_ones_stay_unmasked(tmp_path):
    path, nameless = tmp_path / "a.csv", Schedule([1.0, 2.0], [[1, 0], [1, 1]], time_unit="s")
    write_schedule(nameless, path)
    assert path.read_text().splitlines()[1] == "time,#1,#2"
    same(read_schedule(path), nameless)
    plant = Plant(
        np.diag([0.1, 0.2]), np.eye(2), outputs=["level", "speed"]
    )  # of whatever names, as before it was written
    assert window_sigma(plant, read_schedule(path), 1.0).lower == window_sigma(plant, nameless, 1.0).lower > 0
    write_schedule(Schedule([1.0], time_unit="s", output_names=["a"]), path)
    back = read_schedule(path)
    assert (back.outputs, back.output_names) == (None, ("a",))
    write_schedule(Schedule([], time_unit="s"), path)
    assert len(read_schedule(path)) == 0


def test_comments_blank_lines_and_windows_line_ends_are_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"# sampling-design schedule; time_unit=s\r\ntime\r\n# night\r\n1.5\r\n\r\n2.5\r\n")
    assert read_schedule(path).times.tolist() == [1.5, 2.5]


HEAD = "# sampling-design schedule; time_unit=h"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time\n1\n", 'line 1: must begin with "# sampling-design schedule; time_unit='),
        ("# sampling-design schedule\ntime\n1\n", "line 1: `time_unit` is missing"),
        (f"{HEAD}; perod=3\ntime\n1\n", r"line 1: unknown key 'perod' in the first line. Did you mean 'period'\?"),
        (f"{HEAD}; period=\ntime\n1\n", r"line 1: expected period=\.\.\. exactly once\."),
        (f"{HEAD}; time_unit=d\ntime\n1\n", r"line 1: expected time_unit=\.\.\. exactly once\."),
        (f"{HEAD}; period=week\ntime\n1\n", "`period` must be a number, got 'week'"),
        (f"{HEAD.replace('=h', '=year')}\ntime\n1\n", "`time_unit` must be one of"),
        (HEAD, r"line 2: expected the header `time\[,output names\]`. Was the file cut off\?"),
        (f"{HEAD}\ndate\n1\n", "line 2: the first column must be `time`, got 'date'"),
        (f"{HEAD}\ntime,a\n1,1\n2.5", r"line 4: does not end in a line break. Was the file cut off\?"),
        (f"{HEAD}\ntime,a\n1,1\n2\n", "line 4: expected 2 cells, got 1"),
        (f"{HEAD}\ntime\n1\nnoon\n", "line 4: the time must be a finite number, got 'noon'"),
        (f"{HEAD}\ntime\n1\n1_000\n", "line 4: the time must be a finite number, got '1_000'"),
        (f"{HEAD}\ntime\n1\nTrue\n", "line 4: the time must be a finite number, got 'True'"),
        (f"{HEAD}\ntime\n1\n\u0662\n", "line 4: the time must be a finite number, got"),
        (f"{HEAD}\ntime\n1e-999\n", "line 3: the time must be a finite number, got '1e-999'"),
        (f"{HEAD}\ntime\n{'9' * 5000}\n", "line 3: the time must be a finite number, got '9{59}[.]"),
        (f"{HEAD}\ntime\n{'9' * 200_000}\n", "line 3: cannot be read as cells"),
        (f"{HEAD}\ntime\n-1\n", "line 3: the time must not be negative, got -1"),
        (f"{HEAD}\ntime,a,a\n1,1,1\n", "`output_names` must be distinct, got 'a' twice"),
        (f"{HEAD}\ntime,a,time\n1,1,1\n", "line 2: the column `time` occurs twice"),
        (f"{HEAD}\ntime,a,\n1,1,1\n", "line 2: an output has no name"),
        (f"{HEAD}\ntime,a\n1,1,1\n", "line 3: expected 2 cells, got 3"),
        (f"{HEAD}; period=1_0\ntime\n1\n", "`period` must be a number, got '1_0'"),
        (f"{HEAD}; period=inf\ntime\n1\n", "`period` must be a number, got 'inf'"),
        (f"{HEAD}\ntime\n1\ninf\n", "line 4: the time must be a finite number, got 'inf'"),
        (f"{HEAD}\ntime\n# night\n2\n1\n", "line 5: times must increase strictly, got 1.0 after 2.0"),
        (f"{HEAD}\ntime,a\n1,yes\n", r"line 3: cells after the time must be 1 \(measured\) or 0, got yes"),
        (f"{HEAD}\ntime,a\n1,0\n", "must measure at least one output at each sample"),
        (f"{HEAD}; period=2\ntime\n1\n3\n", "must span less than one period"),
    ],
)
def test_bad_csv(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=message) as caught:
        read_schedule(path)
    assert caught.value.path == str(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "sampling-design/plant/1"}, '`format` must be "sampling-design/schedule/1"'),
        ({"time_unit": None}, "`time_unit` is missing"),
        ({"kind": "weekly"}, '`kind` of a schedule must be "finite" or "periodic", got \'weekly\''),
        ({"kind": "finite", "gaps": None, "first": None, "period": None, "times": None}, "needs `times`"),
        ({"tmes": [1.0]}, r"unknown key 'tmes' in a periodic schedule. Did you mean 'times'\?"),
        ({"period": None}, "needs `times` and `period` together"),
        ({"gaps": None, "times": None, "period": None}, "needs `gaps`, or `times` and `period`"),
        ({"gaps": [1.0, 2.5]}, "`gaps` and `times` of a periodic schedule contradict each other"),
        ({"gaps": [3.0]}, "`gaps` and `times` of a periodic schedule contradict each other"),
        ({"first": 1.5}, "contradict each other"),
    ],
)
def test_bad_json(tmp_path, change, message):
    path = tmp_path / "bad.json"
    write_schedule(PeriodicSchedule([1.0, 2.0], time_unit="h"), path)
    data = {k: v for k, v in (json.loads(path.read_text()) | change).items() if v is not None}
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match=message):
        read_schedule(path)


def test_a_json_file_cut_off(tmp_path):
    path = tmp_path / "a.json"
    write_schedule(PeriodicSchedule([1.0, 2.0], time_unit="h"), path)
    path.write_text(path.read_text()[:-20])
    with pytest.raises(FileFormatError, match=r"is not valid JSON .* Was the file cut off\?"):
        read_schedule(path)


def test_gaps_alone_or_times_alone_are_enough():
    assert schedule_from_dict({"kind": "periodic", "gaps": [1.0, 2.0], "first": 0.5}).times.tolist() == [0.5, 2.5]
    assert schedule_from_dict({"kind": "periodic", "times": [0.5, 2.5], "period": 3.0}).gaps.tolist() == [1.0, 2.0]


def test_what_cannot_be_written_leaves_the_old_file(tmp_path):
    path = tmp_path / "a.csv"
    write_schedule(Schedule([1.0], time_unit="h"), path)
    before = path.read_bytes()
    with pytest.raises(ArgumentError, match="`schedule` must have a time unit to be written"):
        write_schedule(Schedule([1.0]), path)
    with pytest.raises(ArgumentError, match=r"'#b' cannot be a column of a CSV file. Write .json instead"):
        write_schedule(Schedule([1.0], time_unit="h", output_names=["#b"]), path)
    with pytest.raises(ArgumentError, match=r"`path` must end in .csv or .json, got '.*a.txt'"):
        write_schedule(Schedule([1.0], time_unit="h"), tmp_path / "a.txt")
    with pytest.raises(ArgumentError, match=r"`path` must end in .csv or .json, got '.*test_files.py'"):
        read_schedule(__file__)
    with pytest.raises(ArgumentError, match="must be a Schedule or a PeriodicSchedule, got list"):
        write_schedule([1.0], path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.csv"]
    with pytest.raises(FileFormatError, match="no such file"):
        read_schedule(tmp_path / "none.csv")
    with pytest.raises(FileFormatError, match="cannot be written"):
        write_schedule(Schedule([1.0], time_unit="h"), tmp_path / "none" / "a.csv")
