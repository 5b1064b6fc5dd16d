"""Measurement and estimate files: exact round trip, and one sentence for each kind of mistake."""

import csv

import numpy as np
import pandas
import pytest

from sampling_design import Measurements, MovingHorizonEstimator, Plant, read_measurements
from sampling_design.accuracy.readings import CensoredReading
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.estimators.estimate_file import write_estimates
from sampling_design.estimators.records.measurement_table import BLOCK
from sampling_design.estimators.records.measurements import write_measurements
from sampling_design.plotting import style
from sampling_design.records.file_io import MISSING
from sampling_design.records.units import SECONDS
from sampling_design.schedules.time_stamps import import_time_stamps
from tests.cases import few

PLANT = Plant(
    [[0.0, 1.0], [-1.0, 0.0]],
    [[1.0, 0.0], [0.0, 1.0]],
    B=[[0.0], [1.0]],
    time_unit="h",
    states=["level", "rate"],
    outputs=["gauge", "flow"],
    inputs=["pump"],
)
BLIND = Plant([[0.0]], [[1.0]], outputs=["gauge"])
PLANT_IN_HOURS = Plant([[0.0]], [[1.0]], time_unit="h", outputs=["gauge"])


def written(tmp_path, text, name="measurements.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_times_outputs_inputs_blanks_and_comments(tmp_path):
    text = "# a comment\npump,time,flow,gauge\n1.5,0.5,,0.25\n,1.0,-2e-3,\n# another\n\n0,2.5,0.1,0.2\n"
    found = read_measurements(written(tmp_path, text), PLANT)
    assert found.times.tolist() == [0.5, 1.0, 2.5]
    assert np.array_equal(found.y, [[0.25, np.nan], [np.nan, -2e-3], [0.2, 0.1]], equal_nan=True)
    assert found.u.tolist() == [[1.5], [1.5], [0.0]]
    assert "3 rows" in found.explain()
    assert "gauge: 2" in str(found)


def test_dates_are_turned_into_the_plants_unit_and_offsets_are_honoured(tmp_path):
    text = "date,gauge,flow,pump\n2026-01-05T00:30,1,,0\n2026-01-05T03:00+01:00,,2,0\n"
    found = read_measurements(written(tmp_path, text), PLANT, zone="UTC")
    assert found.times.tolist() == [0.0, 1.5]
    assert found.origin == "2026-01-05T00:30:00+00:00"
    from_midnight = read_measurements(written(tmp_path, text), PLANT, origin="2026-01-05", zone="UTC")
    assert from_midnight.times.tolist() == [0.5, 2.0]


def test_rows_of_inputs_only_and_agreeing_repetitions(tmp_path):
    text = "time,gauge,flow,pump\n0,,,1\n1,0.5,,1\n1,0.5,,1\n"
    found = read_measurements(written(tmp_path, text), PLANT)
    assert len(found) == 2
    rows = list(found)
    assert rows[0][1] is None
    assert rows[0][2].tolist() == [1.0]
    record = MovingHorizonEstimator(PLANT, horizon=4.0).run(found)
    assert len(record) == 2
    assert record.status == ("predicted", "ok") or record.status == ("prior", "ok")


@pytest.mark.parametrize("seed", few(range(12), 0, 5))
def test_the_order_of_rows_changes_nothing(seed, tmp_path):
    """A late result with a blank input was measured under the input of its time, not under that of the row before."""
    rng = np.random.default_rng(seed)
    cells = [[f"{k}", *(["", f"{rng.normal()}"][c] for c in rng.integers(2, size=3))] for k in range(9)]
    cells[0][3] = "0.5"
    ends = [f"{k + 1.5}" if k and not row[3] and rng.random() < 0.4 else "" for k, row in enumerate(cells)]
    lines = [",".join([row[0], end, *row[1:]]) + "\n" for row, end in zip(cells, ends, strict=True)]
    head = "time,time_until,gauge,flow,pump\n"
    sorted_rows = list(read_measurements(written(tmp_path, head + "".join(lines)), PLANT).in_order())
    again = [*rng.permutation(lines), *rng.choice(lines, 2)]  # and what stands there twice
    found = list(read_measurements(written(tmp_path, head + "".join(again)), PLANT).in_order())
    assert list(map(str, found)) == list(map(str, sorted_rows))
    held = 0.0
    for row in cells:
        held = float(row[3] or held)
        assert all(u.tolist() == [held] for t, _, u in found if t == float(row[0]))


def test_a_record_without_inputs_is_written_as_under_none(tmp_path):
    times, y = [4.0, 1.0, (2.0, 3.0)], [[1.0, np.nan], [0.5, 2.0], [np.nan, 0.3]]
    spans = [t if isinstance(t, tuple) else (t, t) for t in times]
    given = Measurements(PLANT, spans, y)
    found = read_measurements(write_measurements(given, tmp_path / "again.csv"), PLANT)
    assert [str(row[:2]) for row in found] == [str(row[:2]) for row in given]
    assert found.u[:2].tolist() == [[0.0], [0.0]]
    cost = {"horizon": 4.0, "w_bound": 0.1, "v_bound": 0.2, "initial_error": 3.0}
    ours, theirs = (MovingHorizonEstimator(PLANT, **cost).run(each.in_order()) for each in (given, found))
    assert ours[-1].x == pytest.approx(theirs[-1].x, abs=1e-9)


def test_round_trip_is_exact(tmp_path):
    rng = np.random.default_rng(0)
    times, y, u = np.cumsum(rng.random(7)), rng.normal(size=(7, 2)), rng.normal(size=(7, 1))
    y[2, 1] = y[5, 0] = np.nan
    path = write_measurements(Measurements(PLANT, times, y, u), tmp_path / "again.csv")
    found = read_measurements(path, PLANT)
    assert np.array_equal(found.times, times)
    assert np.array_equal(found.y, y, equal_nan=True)
    assert np.array_equal(found.u, u)


@pytest.mark.parametrize("name", ["time", "date", "time_until", " gauge", "gauge_since"])
def test_a_name_that_no_column_gives_back_is_not_written(tmp_path, name):
    """What is written is read again: the file is refused when it is made, not when it is needed."""
    plant = Plant([[0.0]], [[1.0], [1.0]], outputs=["gauge", name])
    mean = ((), (CensoredReading(0, 0.1, 0.1, 0.2),))
    rows = Measurements(
        plant, np.array([0.5, 1.0]), np.array([[0.1, 0.2], [np.nan, 0.4]]), np.zeros((2, 0)), censored=mean
    )
    with pytest.raises(ArgumentError, match=r"cannot be a column of a CSV file, or is one already\."):
        write_measurements(rows, tmp_path / "file.csv")
    assert not (tmp_path / "file.csv").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty, expected a header"),
        ("gauge,flow,pump\n", "the header must hold `time` or `date`"),
        (
            "time,date,gauge,flow,pump\n",
            r"the header must hold `time` or `date`, .* One of them: a day and an",
        ),
        (
            "time,gauge,pump\n",
            "column 'flow' is missing; the plant names gauge, flow, pump. A sensor that",
        ),
        ("time,gauge,gauge,flow,pump\n", "column 'gauge' occurs twice"),
        ("time,gauge,flow,pump,gague\n", "unknown key 'gague' in the header. Did you mean 'gauge'"),
        ("time,gauge,flow,pump\n0,1,2\n", "line 2 has 3 cells, expected 4"),
        (
            "time,gauge,flow,pump\n0,1,2,3,4\n",
            "line 2 has 5 cells, expected 4. Decimals have a point",
        ),
        ("time,gauge,flow,pump\n0\n", "line 2 has 1 cells, expected 4.$"),
        (
            "time,gauge,flow,pump\n0,1.2 m,2,3\n",
            "gauge in line 2 is not a number: '1.2 m'. A cell holds",
        ),
        ("time;gauge;flow;pump\n0;1.234,5;2;3\n", "'1.234,5'. Thousands are not separated"),
        *(
            (f"time,gauge,flow,pump\n0,{word},2,3\n", "gauge in line 2 is not a number: ")
            for word in ("True", "inf", "-Infinity", "1_000", "\u0661", "0x10", "1e999", "1e-999", "9" * 5000)
        ),
        (f"time,gauge,flow,pump\n0,{'9' * 200_000},2,3\n", "line 2: cannot be read as cells"),
        (
            "#\n" * 15 + "time,gauge,flow,pump\n0,1,high,0\n",
            "flow in line 17 is not a number: 'high'. Leave the cell empty",
        ),
        (
            'time,gauge,flow,pump\n0,"1,9",2,0\n',
            r"gauge in line 2 is not a number: '1,9'\. Write 1\.9, or separate cells",
        ),
        ("time,gauge,flow,pump\n0,\N{MINUS SIGN}1,2,0\n", r"'\N{MINUS SIGN}1'\. Write -1: its minus is another sign"),
        ("time,gauge,flow,pump\n0,1e400,2,0\n", r"'1e400'\. No double is so large"),
        (",time,gauge,flow,pump\n0,0,1,2,0\n", "column .* has no name in the header"),
        ("date,gauge,flow,pump\n2026-03-16 8:00,1,2,0\n", r"'2026-03-16 8:00'\. Write 2026-03-16 08:00"),
        ("time,gauge,flow,pump\n0,1,2,nan\n", "pump in line 2 is not a number"),
        ("time,gauge,flow,pump\nnoon,1,2,0\n", "time in line 2 is not a number: 'noon'"),
        ("date,gauge,flow,pump\nnoon,1,2,0\n", "the date in line 2 is not ISO 8601: 'noon'"),
        ("time,gauge,flow,pump\n0,1,2,\n", "input pump has no value in line 2, the first row"),
        ("time,gauge,flow,pump\n0,1,2,0\n0,1,3,0\n", "line 3 repeats the time of line 2 with other values"),
    ],
)
def test_mistakes_are_named(tmp_path, text, message):
    with pytest.raises(FileFormatError, match=message):
        read_measurements(written(tmp_path, text), PLANT)


@pytest.mark.parametrize("quote", ["", '"'])  # rows at once, and one by one
@pytest.mark.parametrize("word", [*MISSING, "NA", "NaN", "N/A", "#N/A"])
def test_a_word_for_not_measured_is_an_empty_cell_to_every_reader(tmp_path, word, quote):
    table = "time,gauge,flow,pump\n0,1,{0},0\n1,{0},{0},0\n2,{0},2,0\n"
    path = written(tmp_path, table.format(f"{quote}{word}{quote}"))
    found, same = read_measurements(path, PLANT), read_measurements(written(tmp_path, table.format(""), "b.csv"), PLANT)
    assert np.array_equal(found.y, same.y, equal_nan=True)
    assert found.times.tolist() == same.times.tolist()
    stamps = import_time_stamps(path, "h", outputs=["gauge", "flow"])
    np.testing.assert_array_equal(stamps.outputs, np.isfinite(same.y[[0, 2]]))
    with pytest.raises(FileFormatError, match="pump "):  # an input keeps its value, and the first row has one
        read_measurements(written(tmp_path, f"time,gauge,flow,pump\n0,1,2,{quote}{word}{quote}\n", "c.csv"), PLANT)


@pytest.mark.parametrize("mark", ",;")
@pytest.mark.parametrize("quote", ["", '"'])
def test_empty_columns_beyond_the_last_are_those_of_a_spreadsheet(tmp_path, mark, quote):
    own = f"time,gauge,flow,pump\n0,1,{quote}2{quote},0\n1,3,,\n".replace(",", mark)
    same = read_measurements(written(tmp_path, own), PLANT)
    for beyond in (mark, f"{mark} {mark}"):
        rows = "".join(line + beyond + "\n" for line in own.splitlines())
        for text in (rows, own.replace("0\n", f"0{beyond}\n")):
            found = read_measurements(written(tmp_path, text, "b.csv"), PLANT)
            assert np.array_equal(found.y, same.y, equal_nan=True)
            assert found.u.tolist() == same.u.tolist()
    with pytest.raises(FileFormatError, match="line 2 has 5 cells, expected 4"):
        read_measurements(written(tmp_path, own.replace("0\n", f"0{mark}1\n"), "b.csv"), PLANT)


def test_more_mistakes(tmp_path):
    with pytest.raises(FileFormatError, match="in line 2 is skipped or repeated by the clocks of Europe/Berlin"):
        read_measurements(written(tmp_path, "date,gauge\n2026-10-25T02:30,1\n"), BLIND, zone="Europe/Berlin")
    with pytest.raises(FileFormatError, match="the date given as origin is not ISO 8601"):
        read_measurements(written(tmp_path, "date,gauge\n2026-01-01,1\n"), BLIND, origin="yesterday")
    with pytest.raises(FileFormatError, match="no such file"):
        read_measurements(tmp_path / "none.csv", BLIND)
    with pytest.raises(ArgumentError, match=r"`y` must be finite or NaN of shape \(2, 1\)"):
        Measurements(BLIND, [0.0, 1.0], [[1.0]])
    with pytest.raises(ArgumentError, match=r"`y` must be finite or NaN"):
        Measurements(BLIND, [0.0], [[np.inf]])


@pytest.mark.parametrize("rows", [2, 2 * BLOCK])
def test_a_form_is_read_as_far_as_it_is_filled_in(tmp_path, rows):
    taken = "".join(f"{k},{0.1 * k}\n" for k in range(rows))
    later = "".join(f"{rows + k},\n" for k in range(BLOCK + 2))
    found = read_measurements(written(tmp_path, "time,gauge\n" + taken + later), BLIND)
    assert found.times.tolist() == list(range(rows))
    assert found.y[-1] == pytest.approx(0.1 * (rows - 1))
    again = read_measurements(written(tmp_path, "time,gauge\n" + taken + later + f"{2 * rows + BLOCK},1.0\n"), BLIND)
    assert again.times.tolist() == [*range(rows), 2 * rows + BLOCK]  # what lies between was missed


def test_estimates_file(tmp_path):
    mhe = MovingHorizonEstimator(PLANT, horizon=4.0, w_bound=0.1, v_bound=0.1, initial_error=1.0)
    record = mhe.run([(1.0, [0.1, 0.2], [0.0]), (2.0, [0.1, np.nan], [0.0])])
    with open(write_estimates(record, tmp_path / "estimates.csv"), newline="") as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == ["time", "status", "certified", "cost", "level", "level_radius", "rate", "rate_radius"]
    assert rows[1][:3] == ["1.0", "ok", "1"]
    assert float(rows[2][4]) == record.x[1, 0]
    assert float(rows[2][5]) == record.radii[1, 0]
    bare = MovingHorizonEstimator(PLANT, horizon=4.0).run([(1.0, [0.1, 0.2], None)])
    with open(write_estimates(bare, tmp_path / "bare.csv"), newline="") as stream:
        rows = list(csv.reader(stream))
    assert rows[1][2] == "0"
    assert rows[1][5] == rows[1][7] == ""


def test_a_plant_without_inputs_is_measured_too(tmp_path):
    found = read_measurements(written(tmp_path, "time,gauge\n0.5,1\n1.5,2\n"), BLIND)
    assert found.y.tolist() == [[1.0], [2.0]]
    assert found.u.shape == (2, 0)
    assert [row[2] for row in found] == [None, None]
    assert len(read_measurements(written(tmp_path, "time,gauge\n"), BLIND)) == 0


def test_estimates_of_dated_measurements_are_dated(tmp_path):
    estimates = MovingHorizonEstimator(BLIND, horizon=2.0).run([(0.5, [1.0], None), (90000.25, [1.0], None)])
    path = write_estimates(estimates, tmp_path / "e.csv", origin="2026-03-28T00:00:00+01:00")
    rows = list(csv.DictReader(path.read_text().splitlines()))
    assert [row["date"] for row in rows] == ["2026-03-28T00:00:00.500000+01:00", "2026-03-29T01:00:00.250000+01:00"]
    with pytest.raises(ArgumentError, match="lies outside the years 1 to 9999"):
        write_estimates(estimates, tmp_path / "e.csv", origin="9999-12-31T23:00:00")


def test_inputs_without_samples_cost_each_its_own():
    """The work for an input, in pieces of the drift, does not grow with the inputs before it; and the sum is right."""
    plant = Plant([[0.0, 1.0], [-1.0, -0.2]], [[1.0, 0.0]], B=[[0.0], [1.0]])
    quick, pieces = MovingHorizonEstimator(plant, horizon=5.0), []
    asked = quick.table.get
    quick.table.get = lambda gaps: pieces.append(len(gaps)) or asked(gaps)
    times, rng = np.arange(1, 201) * 0.01, np.random.default_rng(0)
    inputs = rng.normal(size=(200, 1))
    for t, u in zip(times, inputs, strict=True):
        quick.update(t, None, u)
    assert sum(pieces[-20:]) <= 1.1 * sum(pieces[20:40])
    x = np.zeros(2)
    for u in inputs[:-1]:
        x = plant.transition(0.01) @ x + np.linalg.solve(plant.A, (plant.transition(0.01) - np.eye(2)) @ plant.B) @ u
    assert quick.predict(2.0).x == pytest.approx(x, abs=1e-12)
    quick.update(1.005, None, [0.3])
    late = MovingHorizonEstimator(plant, horizon=5.0)
    for t, u in sorted([*zip(times.tolist(), inputs.tolist(), strict=True), (1.005, [0.3])]):
        late.update(t, None, u)
    assert quick.predict(2.5).x == pytest.approx(late.predict(2.5).x, abs=1e-12)


def test_a_row_that_measures_nothing_is_a_missed_visit(tmp_path):
    text = "time,gauge\n0,\n1,0.5\n2,\n3,0.25\n4,\n"
    found = read_measurements(written(tmp_path, text), BLIND)
    assert (found.times.tolist(), found.y.tolist()) == ([1.0, 3.0], [[0.5], [0.25]])


@pytest.mark.parametrize(
    ("given", "place"),
    [
        ({}, "UTC"),
        ({"origin": "2026-03-27T00:00:00+01:00"}, "UTC+01:00"),
        ({"origin": "2026-03-27T00:00:00+01:00", "zone": "Europe/Berlin"}, "Europe/Berlin"),
    ],
)
def test_dates_without_a_zone_are_those_of_the_plan(tmp_path, given, place):
    """Over the change of clocks too: the zone knows of it, an offset and UTC do not. Durations are elapsed time."""
    hours = Plant([[0.0]], [[1.0]], time_unit="h", outputs=["gauge"])
    text = "date,gauge\n2026-03-28T12:00,1\n2026-03-29T12:00,2\n"
    for blank in ("", "2026-03-29T13:00,\n"):  # a block of plain rows, and one with a missed visit
        found = read_measurements(written(tmp_path, text + blank), hours, **given)
        assert found.assumed_zone == place
        assert np.diff(found.times).tolist() == [23.0 if place == "Europe/Berlin" else 24.0]
        assert found.times[0] == (36.0 if given else 0.0)
        assert f"read in {place}" in str(found)
    told = read_measurements(written(tmp_path, text.replace(":00,", ":00+01:00,")), hours, **given)
    assert told.assumed_zone == ""
    with pytest.raises(ArgumentError, match="`zone` must be the name of a time zone"):
        read_measurements(written(tmp_path, text), hours, zone="Nowhere")
    with pytest.raises(ArgumentError, match=r"got 'berlin'\. Did you mean 'Europe/Berlin'\?"):
        read_measurements(written(tmp_path, text), hours, zone="berlin")


def test_dates_come_back_as_they_were_typed_over_a_change_of_the_clocks(tmp_path):
    hours = Plant([[-0.1]], [[1.0]], time_unit="h", outputs=["gauge"])
    typed = ["2026-03-28T08:00", "2026-03-29T08:00", "2026-03-30T08:00"]
    text = "date,gauge\n" + "".join(f"{each},1\n" for each in typed)
    found = read_measurements(written(tmp_path, text), hours, origin="2026-03-28", zone="Europe/Berlin")
    assert found.origin == "2026-03-28T00:00:00+01:00[Europe/Berlin]"
    later = found.shifted(-3.0)
    assert later.times.tolist() == [5.0, 28.0, 52.0]
    assert later.rebased(found.origin).times.tolist() == found.times.tolist()
    estimates = MovingHorizonEstimator(hours, horizon=50.0, w_bound=0.1, v_bound=0.1).run(later)
    for table in (found, later, estimates):
        assert [f"{date:%Y-%m-%dT%H:%M}" for date in table._columns()["date"]] == typed
    write_estimates(estimates, tmp_path / "estimates.csv", origin=later.origin)
    lines = (tmp_path / "estimates.csv").read_text().splitlines()
    assert [line[:16] for line in lines[1:]] == typed
    ax = estimates.plot()[0]
    assert ax.get_xlabel() == "date, from 2026-03-28"
    assert style.moment(ax, 28.0, "h", origin=later.origin) == "Sun 29 Mar 08:00"
    with pytest.raises(FileFormatError, match=r"is not ISO 8601: '2026-03-28\[Europe/Berlin'"):
        read_measurements(written(tmp_path, text), hours, origin="2026-03-28[Europe/Berlin")


def test_a_record_is_gone_through_in_order_of_time():
    """Each sample has its estimate: the latest was answered twice, and the earlier never."""
    rows = [(1.0, [0.5]), (3.0, [0.1]), (2.0, [0.3])]
    table = Measurements(BLIND, [t for t, _ in rows], [y for _, y in rows])
    for record in (rows, table):
        found = MovingHorizonEstimator(BLIND, horizon=5.0).run(record)
        assert found.times.tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize("y", [["1.5"], "1.5", [b"1"], [None, "2"]])
def test_text_is_no_measurement(y):
    with pytest.raises(ArgumentError, match="`y` must hold numbers, got"):
        MovingHorizonEstimator(BLIND, horizon=5.0).update(1.0, y)


def test_samples_are_left_out_by_the_numbers_that_a_contradiction_names(tmp_path):
    text = "time,gauge,flow,pump\n0,,,1\n1,0.5,<2,1\n3,7,,2\n2,0.4,,\n"
    found = read_measurements(written(tmp_path, text), PLANT)
    rest = found.without(1, 3)  # the second row is the first sample, the latest one the third
    assert rest.times.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert rest.measured.any(axis=1).tolist() == [False, False, True, False]
    assert rest.u.tolist() == [[1.0], [1.0], [1.0], [2.0]]  # at time 2 it has not changed yet
    assert rest.censored == ((), (), (), ())
    assert len(found.without()) == 4
    blind = Measurements(BLIND, [1.0, 2.0], [[1.0], [2.0]])
    assert blind.without(2).times.tolist() == [1.0]
    for number in (3, 0):
        with pytest.raises(ArgumentError, match="`numbers` must be of the 2 samples, counted from 1, got"):
            blind.without(number)


def test_a_date_without_an_hour_and_a_row_until_are_times_that_are_not_known(tmp_path):
    text = (
        "date,date_until,gauge,flow,pump\n2026-01-05T12:00,,1,,0\n2026-01-06,,2,<3,\n2026-01-07T00:00,2026-01-08,,4,\n"
    )
    found = read_measurements(written(tmp_path, text), PLANT, origin="2026-01-05")
    assert found.times.tolist() == [12.0, 36.0, 72.0]
    assert [found.span_of(k) for k in range(3)] == [None, (24.0, 48.0), (48.0, 96.0)]
    assert [row[0] for row in found] == [12.0, (24.0, 48.0), (48.0, 96.0)]
    assert [row[2] is None for row in found] == [False, True, True]
    assert found.measured.tolist() == [[True, False], [True, True], [False, True]]
    assert found.samples(numbers=True)[0].tolist() == [12.0]
    again = read_measurements(write_measurements(found, tmp_path / "again.csv"), PLANT)
    assert list(map(str, again)) == list(map(str, found))
    assert found.start == 12.0
    assert found.shifted(2.0).start == 14.0
    assert found.shifted(2.0).span_of(1) == (26.0, 50.0)
    assert found.between(24.0, 90.0).times.tolist() == [24.0, 36.0]  # the last reading may lie outside
    assert found.between(24.0, 90.0).u.tolist()[0] == [0.0]
    both = found.merged(found.shifted(0.0))
    assert both.censored == found.censored


def test_a_summer_day_of_the_clocks_has_twenty_three_hours(tmp_path):
    text = "date,gauge,flow,pump\n2026-03-29,1,,\n"
    found = read_measurements(
        written(tmp_path, text),
        Plant([[0.0]], np.ones((2, 1)), outputs=["gauge", "flow"], B=[[1.0]], inputs=["pump"], time_unit="h"),
        zone="Europe/Berlin",
    )
    assert found.span_of(0) == (0.0, 23.0)


def test_dates_of_a_frame_are_times_though_all_of_them_are_midnights():
    frame = pandas.DataFrame({"gauge": [1.0, 2.0]}, index=pandas.to_datetime(["2026-01-05", "2026-01-06"]))
    found = read_measurements(frame, Plant([[0.0]], [[1.0]], outputs=["gauge"], time_unit="h"))
    assert found.times.tolist() == [0.0, 24.0]
    assert found.span_of(1) is None


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time,time_until,gauge,flow,pump\n2,1,1,,0\n", "line 2 ends before it begins: '1'"),
        ("time,time_until,gauge,flow,pump\n0,,1,,0\n1,2,1,,3\n", "changes an input at a time that is not known"),
        ("time,time_until,gauge,gauge_since,flow,pump\n0,,1,,,0\n1,2,1,0.5,,\n", "holds a mean, whose end must"),
        ("time,date_until,gauge,flow,pump\n1,2,1,,0\n", "Take a column that is neither out; the plant names"),
    ],
)
def test_a_row_whose_time_is_not_known_is_refused_in_a_sentence(tmp_path, text, words):
    with pytest.raises(FileFormatError, match=words):
        read_measurements(written(tmp_path, text), PLANT)


def test_measurements_of_uncertain_times_made_by_hand():
    found = Measurements(BLIND, [[1.0, 1.0], [2.0, 4.0]], [[5.0], [6.0]])
    assert found.times.tolist() == [1.0, 3.0]
    assert list(found)[1] == ((2.0, 4.0), [6.0], None)
    assert len(MovingHorizonEstimator(BLIND, horizon=9.0, w_bound=0.1, v_bound=0.1, initial_error=9.0).run(found)) == 2
    with pytest.raises(ArgumentError, match=r"`times` = \(1.0, 2.0\) is uncertain, and an input needs its time"):
        Measurements(PLANT, [[1.0, 2.0]], [[1.0, np.nan]], [[3.0]])


BERLIN, SUMMER = "Europe/Berlin", "date,gauge\n2026-10-25T08:00+01:00,1\n"
PLACES = {
    "an origin of a zone": ({"origin": "2026-10-25T07:00", "zone": BERLIN}, 1.0, BERLIN),
    "an origin with its zone": ({"origin": "2026-10-25T07:00+01:00"}, 1.0, ""),
    "no origin": ({}, 0.0, ""),
}


@pytest.mark.parametrize("case", PLACES)
def test_where_a_date_without_a_zone_was_taken_to_be_is_told_of_the_origin_too(tmp_path, case):
    given, hours, told = PLACES[case]
    found = read_measurements(written(tmp_path, SUMMER), PLANT_IN_HOURS, **given)
    assert (found.times.tolist(), found.assumed_zone) == ([hours], told)
    plain = read_measurements(written(tmp_path, "time,gauge\n8,1\n"), PLANT_IN_HOURS, **given)
    assert (plain.times.tolist(), plain.origin, plain.assumed_zone) == ([8.0], "", "")


@pytest.mark.parametrize("given", [{}, {"origin": "2026-10-25T07:00"}])
@pytest.mark.parametrize("table", [SUMMER, SUMMER + "2026-10-25T09:00,2\n"])
def test_a_date_without_a_zone_beside_one_with_a_zone_is_asked_for_its_own(tmp_path, table, given):
    """Read in UTC, an origin would be off by the offset of the rows, and nobody would know."""
    path = written(tmp_path, table)
    frame = pandas.read_csv(path)
    readers = [
        lambda **how: read_measurements(path, BLIND, **how),
        lambda **how: read_measurements(frame, BLIND, **how),
        lambda **how: import_time_stamps(path, "h", **how),
    ]
    for read in readers:
        assert len(read(zone=BERLIN, **given)) == len(read(origin="2026-10-25T07:00+01:00")) == len(frame)
        if given or table != SUMMER:
            with pytest.raises(FileFormatError, match=r"has no zone, and .* has one: give its offset \(\+01:00\), or"):
                read(**given)


def test_another_origin_without_a_zone_is_by_the_clocks_of_the_own_one(tmp_path):
    found = read_measurements(written(tmp_path, SUMMER), BLIND)
    assert found.rebased("2026-10-25T07:00").times.tolist() == [3600.0 / SECONDS[BLIND.time_unit]]
    with pytest.raises(ArgumentError, match="`origin` must be a date like"):
        found.rebased("soon")


@pytest.mark.parametrize("date", ["2026-10-25T02:30", "2026-03-29T02:30"])
def test_a_date_that_clocks_skip_or_repeat_is_refused_wherever_it_stands(tmp_path, date):
    row, origin = (
        written(tmp_path, f"date,gauge\n{date}[{BERLIN}],1\n"),
        pandas.DataFrame({"date": ["2026-10-25T08:00+01:00"], "gauge": [1.0]}),
    )
    with pytest.raises(
        FileFormatError, match=r"the date in line 2 names no instant: .* is skipped or repeated by the clocks of Eu"
    ):
        read_measurements(row, BLIND)
    for given in ({"origin": date, "zone": BERLIN}, {"origin": f"{date}[{BERLIN}]"}):
        with pytest.raises(FileFormatError, match=r"given as origin.* is skipped or repeated by the clocks of Eu"):
            read_measurements(origin, BLIND, **given)
    with pytest.raises(
        ArgumentError, match=r"`origin` names no instant: .* is skipped or repeated by the clocks of Europe/Berlin"
    ):
        Measurements(BLIND, [0.0], [[1.0]], origin=f"{date}[{BERLIN}]")


def test_the_origin_of_measurements_is_a_date_with_its_zone():
    assert Measurements(BLIND, [0.0], [[1.0]], origin="2026-03-02").origin == "2026-03-02T00:00:00+00:00"
    for origin in ("yesterday", 5):
        with pytest.raises(ArgumentError, match="`origin` must be a date like"):
            Measurements(BLIND, [0.0], [[1.0]], origin=origin)


@pytest.mark.parametrize("mark", [";", "\t"])
@pytest.mark.parametrize("rows", [["0,5", "1.234"], ["1.234", "<0,5"], ["2", '"1,5"', "-1.5e3"]])
def test_a_file_has_one_decimal_mark(tmp_path, mark, rows):
    """1.234 beside 0,5 may be 1234: neither is taken for granted, in whichever block the other one stands."""
    for blank in (0, BLOCK):
        cells = [rows[0], *["3"] * blank, *rows[1:]]
        text = "".join(f"{k}{mark}{cell}\n" for k, cell in enumerate(cells))
        with pytest.raises(FileFormatError, match=f"line {len(cells) + 1} has a decimal point where others have"):
            read_measurements(written(tmp_path, f"time{mark}gauge\n{text}"), BLIND)
        one = text.replace(",", ".")
        assert len(read_measurements(written(tmp_path, f"time{mark}gauge\n{one}"), BLIND)) == len(cells)
