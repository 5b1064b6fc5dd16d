"""Records that are tables become pandas frames, and frames of measurements are read like files."""

import csv
import importlib
import io
import pkgutil
import sys
import warnings
from datetime import datetime, timedelta
from functools import cache
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pandas
import pytest
import xarray

import sampling_design
import sampling_design as sd
from sampling_design import plotting
from sampling_design.accuracy.deviation import standard_deviation
from sampling_design.accuracy.limit import accuracy_limit
from sampling_design.accuracy.sample_counts import accuracy_by_count
from sampling_design.certificates.compare.robustness import FamilyTrial, Robustness
from sampling_design.errors import ArgumentError, CallError, FileFormatError, MissingExtraError
from sampling_design.estimators import estimator_for
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.records.record import CurveRecord, ListRecord, Record, TableRecord
from sampling_design.uncertain.plants.time_varying import TimeVaryingPlant
from tests import front_door

OSCILLATOR = sd.plants.library.oscillator()
SCHEDULE = sd.PeriodicSchedule([0.7, 1.6, 0.9], time_unit="s")
REQUIREMENT = sd.Requirement(window=4.0, samples=3)
BOUNDS = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}
READINGS = "time,position,force_per_mass\n0.0,,0.0\n0.7,0.31234567890123,\n2.3,-0.5,1.5\n3.2,0.125,\n"


@cache
def estimates():
    mhe = sd.MovingHorizonEstimator(OSCILLATOR, horizon=5.0, **BOUNDS)
    return mhe.run([(0.7, [0.3], None), (2.3, [-0.5], None), (3.2, [0.1], None)])


def smoothed():
    mhe = sd.NonlinearMovingHorizonEstimator(
        sd.nonlinear.from_linear(OSCILLATOR), horizon=5.0, cost=sd.CostFunction(P2=np.eye(2), Qw=np.eye(2), R=np.eye(1))
    )
    mhe.run([(0.7, [0.3], [0.0]), (2.3, [-0.5], [0.0])])
    return mhe.smoothed()


TANK = sd.Plant([[0.0]], [[1.0]], time_unit="h", name="tank", outputs=["gauge"])


@cache
def certificate():
    return sd.certify(OSCILLATOR, SCHEDULE, eta=0.2, P2=np.eye(2))


@cache
def plan(start=None):
    wanted = sd.PlanRequirement(
        {"x1": 1.0}, period=24.0 if start is None else "1 d", grid="6 h", w_bound=0.05,
        sensors={"gauge": {"noise_bound": 0.5, "price": 1.0}}, calendar=start and {"start": start},
    )  # fmt: skip
    return sd.plan_samples(TANK, wanted, certificate=False)


def record():
    return sd.simulate_record(OSCILLATOR, SCHEDULE, 5.0, w_bound=0.1, v_bound=0.1, rng=1)


def thing(name):
    return lambda: front_door.things()[name]


MAKERS = {
    "Schedule": lambda: sd.Schedule([0.5, 1.0, 2.5]),
    "PeriodicSchedule": lambda: sd.PeriodicSchedule([1.0, 2.0], outputs=[[1, 0], [1, 1]], output_names=["a", "b"]),
    "Signals": lambda: OSCILLATOR.states,
    "UnobservableModes": lambda: unobservable_modes(sd.Plant(np.diag([0.0, 1.0, 2.0]), [[1.0, 0.0, 0.0]])),
    "ModalSplit": lambda: sd.plants.split_modes(OSCILLATOR),
    "Measurements": lambda: record().measurements,
    "SimulatedRecord": record,
    "Interval": lambda: estimates()[-1].interval(),
    "Accuracy": lambda: sd.guaranteed_accuracy(OSCILLATOR, SCHEDULE, w_bound=0.1, v_bound=0.1, rtol=0.2),
    "StandardDeviation": lambda: standard_deviation(OSCILLATOR, SCHEDULE, w_intensity=0.1, v_deviation=0.1),
    "AccuracyLimit": lambda: accuracy_limit(OSCILLATOR, w_bound=0.1, v_bound=0.1),
    "AccuracyByCount": lambda: accuracy_by_count(TANK, (0, 1), period=2.0, w_bound=0.1, v_bound=0.1),
    "AccuracyOverBox": lambda: sd.guaranteed_accuracy(
        sd.UncertainPlant(TANK, [sd.UncertainParameter("k", -0.1, 0.0, A=[[1.0]])]),
        sd.PeriodicSchedule([1.0], time_unit="h"),
        w_bound=[0.1],
        v_bound=[0.1],
        rtol=0.5,
        of=[[1.0], [2.0]],
    ),
    "AccuracyAlong": lambda: sd.guaranteed_accuracy(
        TimeVaryingPlant.from_table([0.0, 5.0], [TANK.A] * 2, [TANK.C] * 2, [TANK.G] * 2),
        sd.Schedule([1.0, 2.0]),
        w_bound=0.1,
        v_bound=0.1,
        of=[[1.0], [2.0]],
        rtol=0.5,
    ),
    "InformationCurve": thing("curve"),
    "ScheduleLog": lambda: sd.compare_schedule(OSCILLATOR, SCHEDULE.between(0, 8), SCHEDULE.between(0, 8).times, 4.0),
    "Robustness": lambda: Robustness(
        certificate(),
        length=1.0,
        limit=1.0,
        radius=0.1,
        broken=0.2,
        losses=(),
        jittered=None,
        thinned=(),
        others=(),
        trials=tuple(FamilyTrial(sd.Jitter(SCHEDULE, late), lam, lam < 3) for late, lam in ((0.1, 2.0), (0.2, np.inf))),
        closed=True,
    ),
    "ValidationReport": thing("report"),
    "Plan": plan,
    "PlanRobustness": lambda: plan().robustness,
    "PlanDates": lambda: plan("2026-03-23").dates(2),
    "PlanComparison": lambda: plan().compare(plan()),
    "EstimateRecord": estimates,
    "ParetoFront": lambda: sd.pareto_front(OSCILLATOR, REQUIREMENT, [1, 2], starts=1, branches=0),
    "SampleLosses": thing("losses"),
    "FourHorizons": thing("horizons"),
    "WindowSigma": thing("sigma"),
    "SmoothedWindow": smoothed,
    "TradeoffCurve": thing("tradeoff"),
}


@cache
def made(kind):
    return MAKERS[kind]()


@pytest.mark.parametrize("kind", MAKERS)
def test_a_frame_has_the_columns_of_its_record(kind):
    record = made(kind)
    frame = record.to_frame()
    columns = record._columns()
    assert type(record).__name__ == kind
    assert [frame.index.name, *frame.columns] == list(columns)
    for name, column in columns.items():
        shown = frame.index if name == frame.index.name else frame[name]
        assert len(column) == len(shown) > 1
        for mine, theirs in zip(column, shown, strict=True):
            assert mine == theirs or (pandas.isna(mine) and pandas.isna(theirs))


def test_every_table_is_in_this_list():
    assert callable(sd.NonlinearMovingHorizonEstimator)  # a room opens on first use
    for room in pkgutil.walk_packages(sampling_design.__path__, "sampling_design."):
        importlib.import_module(room.name) if not room.name.endswith("__main__") else None
    kinds, open_ = set(), [ListRecord]
    while open_:
        below = open_.pop().__subclasses__()
        kinds |= {kind.__name__ for kind in below if not kind.__subclasses__() or kind.__name__ in MAKERS}
        open_ += below
    assert kinds == set(MAKERS)
    sized, open_ = set(), [Record]
    while open_:
        below = open_.pop().__subclasses__()
        sized |= {kind for kind in below if hasattr(kind, "__len__") and not issubclass(kind, ListRecord)}
        open_ += below
    assert {kind.__name__ for kind in sized} == {"Sweep"}  # answers by the names of what was asked about


def test_what_is_drawn_can_be_had_as_numbers():
    """A picture whose record is no table and no curve is named here with what has its numbers."""
    elsewhere = {
        "SamplingFamily", "Projection", "Certificate", "FamilyCertificate", "InclusionCertificate", "Counterexample",
        "WorstCaseSigma", "ScheduleDesign", "EstimateCurve", "EstimateEnvelope", "PatientRun", "PatientFigure",
    }  # fmt: skip
    assert set(plotting._PICTURES) - set(MAKERS) - set(CURVES) == elsewhere


@pytest.mark.parametrize("kind", [kind for kind in MAKERS if kind != "PeriodicSchedule"])
def test_a_record_of_rows_is_counted_indexed_and_iterated(kind):
    record = made(kind)
    listed = list(record)
    assert bool(record)
    assert len(record) == len(listed) > 0
    if isinstance(record, TableRecord):
        assert [list(row) for row in listed] == [list(record._columns())] * len(record.to_frame())
        assert not [each for row in listed for each in row.values() if isinstance(each, np.generic)]
    for place in (0, -1, len(record) - 1, np.int64(0), slice(1, None), slice(None, None, -1)):
        assert str(record[place]) == str(listed[place])
    for outside in (len(record), -len(record) - 1):
        with pytest.raises(IndexError, match=rf"`place` = {outside} is outside: this {kind} has {len(record)} row"):
            record[outside]
    for wrong in ("time", 0.0, True, None):
        with pytest.raises(CallError, match="`place` must be a whole number or a slice, got"):
            record[wrong]


def test_an_entry_that_is_asked_for_by_name_is_told_where_it_stands():
    states = sd.named_plant("oscillator").states
    with pytest.raises(CallError, match=r"got str 'velocity'. It is entry 1: names.index\('velocity'\).$"):
        states["velocity"]
    with pytest.raises(CallError, match=r"got str 'velocty'. Did you mean 'velocity'\?$"):
        states["velocty"]
    table = MAKERS["AccuracyByCount"]()
    column = next(iter(table._columns()))
    with pytest.raises(CallError, match=rf"A row has it: \[0\]\['{column}'\]; all rows: to_frame\(\).$"):
        table[column]
    assert column in table[0]


def test_a_schedule_without_end_is_no_list():
    schedule = MAKERS["PeriodicSchedule"]()
    for ask in (list, lambda each: each[0], lambda each: each[:2]):
        with pytest.raises(CallError, match=r"repeats without end.*`schedule.between\(start, end\)` lists"):
            ask(schedule)
    assert list(schedule.between(0.0, 7.0)) == [1.0, 3.0, 4.0, 6.0, 7.0]
    assert len(schedule) == 2


def test_a_schedule_is_no_array_of_times():
    """It says which outputs are measured, too, and these would be lost."""
    for given in (MAKERS["Schedule"](), MAKERS["PeriodicSchedule"]()):
        with pytest.raises(ArgumentError, match="`times` must hold real numbers, got"):
            sd.Schedule(given)


def test_estimates_and_proofs_stand_in_their_rows():
    record = estimates()
    frame = record.to_frame()
    name = OSCILLATOR.states.names[1]
    assert frame.loc[2.3, name] == record.x[1, 1]
    assert frame.loc[2.3, f"{name} radius"] == record.radii[1, 1]
    sigma = sd.window_sigma(OSCILLATOR, SCHEDULE, 4.0)
    profile = sigma.to_frame()
    assert profile["proven"].min() == sigma.lower
    assert (profile["proven"] <= profile["sigma"]).all()


def test_a_frame_is_read_like_its_file(tmp_path):
    path = tmp_path / "readings.csv"
    path.write_text(READINGS)
    told = sd.read_measurements(path, OSCILLATOR)
    frame = pandas.read_csv(path)
    for given in (frame, frame.set_index("time"), frame[["force_per_mass", "time", "position"]]):
        found = sd.read_measurements(given, OSCILLATOR)
        for key in ("times", "y", "u"):
            np.testing.assert_array_equal(getattr(found, key), getattr(told, key))


def test_a_frame_is_estimated_from_like_its_file(tmp_path):
    path = tmp_path / "readings.csv"
    path.write_text(READINGS)
    frame = pandas.read_csv(path)
    for make in (
        lambda: sd.MovingHorizonEstimator(OSCILLATOR, horizon=5.0, **BOUNDS),
        lambda: sd.KalmanFilter(OSCILLATOR, **BOUNDS),
    ):
        told = make().run(sd.read_measurements(path, OSCILLATOR))
        for given in (frame, frame.set_index("time")):
            found = make().run(given)
            np.testing.assert_array_equal(found.times, told.times)
            np.testing.assert_array_equal(found.x, told.x)
    told, found = (sd.KalmanFilter(OSCILLATOR).smooth(r) for r in (sd.read_measurements(path, OSCILLATOR), frame))
    np.testing.assert_array_equal(found.x, told.x)
    estimator = sd.MovingHorizonEstimator(OSCILLATOR, horizon=5.0)
    with pytest.raises(FileFormatError, match="the frame: column 'position' is missing"):
        estimator.run(frame.drop(columns="position"))


def test_dates_of_a_frame_count_from_the_first(tmp_path):
    dates = pandas.date_range("2026-01-05T08:00", periods=3, freq="90s", name="date", tz="UTC")
    frame = pandas.DataFrame({"position": [1.0, 2.0, 3.0], "force_per_mass": 0.0}, index=dates)
    found = sd.read_measurements(frame, OSCILLATOR)
    assert found.times.tolist() == [0.0, 90.0, 180.0]
    assert found.origin.startswith("2026-01-05T08:00")


@pytest.mark.parametrize("name", [None, "Time", "Date", "t", "when"])
def test_an_index_of_dates_is_the_date_whatever_its_name(name):
    index = pandas.DatetimeIndex(["2026-01-05 00:00", "2026-01-05 06:00", "2026-01-05 12:00"], name=name)
    plant = sd.Plant([[0.0]], [[1.0]], time_unit="h", outputs=["gauge"])
    frame = pandas.DataFrame({"gauge": [1.0, np.nan, 2.0]}, index=index)  # an empty row, as `resample` leaves it
    for given in (frame, frame.reset_index().rename(columns={frame.reset_index().columns[0]: "time"})):
        found = sd.read_measurements(given, plant)
        assert found.times.tolist() == [0.0, 12.0]
        assert found.origin == "2026-01-05T00:00:00+00:00"


@pytest.mark.parametrize("name", ["Time", "t", "TIME"])
def test_an_index_of_numbers_may_be_the_time(name):
    plant = sd.Plant([[0.0]], [[1.0]], outputs=["gauge"])
    frame = pandas.DataFrame({"gauge": [1.0, 2.0]}, index=pandas.Index([0.5, 1.5], name=name))
    assert sd.read_measurements(frame, plant).times.tolist() == [0.5, 1.5]


TANK = sd.Plant([[0.0]], [[1.0]], time_unit="h", outputs=["gauge"])


def test_an_index_of_numbers_without_a_name_is_the_time_unless_it_counts_the_rows():
    frame = pandas.DataFrame({"gauge": [1.0, 2.0]}, index=[0.0, 6.5])
    for given in (frame, frame["gauge"], frame["gauge"].rename(None)):
        assert sd.read_measurements(given, TANK).times.tolist() == [0.0, 6.5]
    for given in (frame.reset_index(drop=True), pandas.Series([1.0, 2.0], name="gauge")):
        with pytest.raises(FileFormatError, match="the frame: has no column `time` or `date`, and its index counts"):
            sd.read_measurements(given, TANK)
    estimates = sd.KalmanFilter(TANK, w_bound=0.1, v_bound=0.1, initial_error=1.0).run(frame["gauge"])
    assert estimates.times.tolist() == [0.0, 6.5]


def test_spans_of_time_are_times_in_the_unit_of_the_plant_and_other_indices_say_none():
    spans = pandas.to_timedelta(["0 min", "390 min", "27 h"])
    frame = pandas.DataFrame({"gauge": [1.0, 2.0, 3.0]}, index=spans)
    for given in (frame, frame["gauge"], frame.reset_index(names="time"), frame.reset_index(names="Time")):
        assert sd.read_measurements(given, TANK).times.tolist() == [0.0, 6.5, 27.0]
    polars = _Polars(time=[timedelta(0), timedelta(hours=6, minutes=30)], gauge=[1.0, 2.0])
    assert sd.read_measurements(polars, TANK).times.tolist() == [0.0, 6.5]
    months = frame.set_axis(pandas.period_range("2026-01", periods=3, freq="M"))
    with pytest.raises(FileFormatError, match=r"and its index of period\[M\] says no times"):
        sd.read_measurements(months, TANK)


def test_the_only_column_of_dates_is_the_date_whatever_its_name():
    stamps = pandas.to_datetime(["2026-03-02 08:00", "2026-03-02 14:30"])
    frame = pandas.DataFrame({"when": stamps, "gauge": [1.0, 2.0]})
    found = sd.read_measurements(frame, TANK, origin=stamps[0].normalize(), zone="Europe/Berlin")
    assert found.times.tolist() == [8.0, 14.5]
    with pytest.raises(FileFormatError, match="the header must hold `time` or `date`, got when, gauge, then"):
        sd.read_measurements(frame.assign(then=stamps), TANK)


class _Polars:
    """What reading asks of a frame of polars, which the tests do not install."""

    class _Column(list):
        def __init__(self, cells):
            super().__init__(cells)
            self.spans = any(isinstance(cell, timedelta) for cell in cells)
            dated = any(isinstance(cell, datetime) for cell in cells)
            kind = type("Duration" if self.spans else "Other", (SimpleNamespace,), {})
            self.dtype = kind(is_temporal=lambda: dated or self.spans)  # printed as "Duration(...)"

        def __array__(self, dtype=None, copy=None):
            return np.array(list(self), "timedelta64[us]" if self.spans else dtype)

    def __init__(self, **columns):
        self.columns, self.cells = list(columns), {k: self._Column(v) for k, v in columns.items()}

    def __getitem__(self, name):
        return _Polars(**{each: self.cells[each] for each in name}) if isinstance(name, list) else self.cells[name]

    def fill_nan(self, value):
        return _Polars(**{k: [value if c != c else c for c in v] for k, v in self.cells.items()})

    def with_columns(self, **columns):
        return _Polars(**{**self.cells, **columns})

    def write_csv(self):
        def said(cell):
            if isinstance(cell, timedelta):
                raise RuntimeError("datatype duration cannot be written to CSV")
            return "" if cell is None else f"{cell:%Y-%m-%dT%H:%M:%S.%f}" if isinstance(cell, datetime) else cell

        text = io.StringIO()
        rows = [self.columns, *zip(*self.cells.values(), strict=True)]
        csv.writer(text, lineterminator="\n").writerows([said(cell) for cell in row] for row in rows)
        return text.getvalue()


def frames():
    """A frame of two sensors as pandas and as polars have it."""
    stamps = [datetime(2026, 3, 2, 8), datetime(2026, 3, 2, 14, 30), datetime(2026, 3, 3, 8)]
    columns = {"when": stamps, "low": [1.0, np.nan, 2.0], "high": ["<0.5", "4.0", None]}
    polars = pytest.importorskip("polars") if find_spec("polars") else None
    return [
        pandas.DataFrame(columns),
        _Polars(**columns),
        *([polars.DataFrame(columns, strict=False)] if polars else []),
    ]


def test_frames_of_pandas_and_polars_say_the_same():
    plant = sd.Plant([[0.0]], [[1.0], [1.0]], time_unit="h", outputs=["low", "high"])
    for frame in frames():
        found = sd.read_measurements(frame, plant)
        assert found.times.tolist() == [0.0, 6.5, 24.0]
        np.testing.assert_array_equal(found.y, [[1.0, np.nan], [np.nan, 4.0], [2.0, np.nan]])
        assert [len(row) for row in found.censored] == [1, 0, 0]
        estimates = sd.KalmanFilter(plant, w_bound=0.1, v_bound=0.1, initial_error=9.0).run(frame)
        assert list(estimates.to_frame().index) == list(found.to_frame().index)


class Lazy:
    """A frame of polars that is not computed yet, and warns where anything but its schema is asked for."""

    def __init__(self, frame):
        self.frame = frame

    @property
    def columns(self):
        warnings.warn("resolving the schema is costly: use `collect_schema()`", stacklevel=2)
        return self.frame.columns

    def collect_schema(self):
        return {}

    def __getitem__(self, name):
        raise TypeError(name)

    def collect(self):
        return self.frame


def test_a_dataset_and_a_lazy_frame_are_the_frames_that_they_turn_into():
    frame = pandas.DataFrame({"time": [0.5, 1.5], "gauge": [1.0, np.nan]}).set_index("time")
    dataset = xarray.Dataset({"gauge": ("time", frame["gauge"])}, coords={"time": frame.index})
    for given in (dataset, dataset["gauge"], Lazy(frame)):
        np.testing.assert_array_equal(sd.read_measurements(given, TANK).y, [[1.0]])
        assert sd.MovingHorizonEstimator(TANK, horizon=3.0).run(given).times.tolist() == [0.5]
        assert estimator_for(TANK, given, horizon=3.0).estimator.run(given).times.tolist() == [0.5]
    with pytest.raises(FileFormatError, match="the frame: column 'gauge' is missing"):
        estimator_for(TANK, frame.drop(columns="gauge"))
    with pytest.raises(ArgumentError, match="`record` must be"):
        estimator_for(TANK, [(0.5, [1.0])])


def test_a_stamp_that_is_missing_is_said_to_be_missing():
    for name in ("time", "date"):
        with pytest.raises(FileFormatError, match=f"the frame: the {name} in row 1 is missing."):
            sd.read_measurements(pandas.DataFrame({name: [None], "gauge": [1.0]}), TANK)


class Columns:
    """A frame of another library, whose columns are no names."""

    columns = ([0.0], [1.0])

    def __getitem__(self, name):
        raise TypeError(name)


@pytest.mark.parametrize("given", [Columns(), pandas.DataFrame, pandas.Series])
def test_frames_of_other_libraries_and_classes_are_refused_by_name(given):
    told = r"(a frame of pandas or polars, got Columns|, got the class (DataFrame|Series): make one)"
    with pytest.raises(ArgumentError, match=f"`path` must be a.*{told}"):
        sd.read_measurements(given, TANK)
    with pytest.raises(ArgumentError, match=r"`record` must be Measurements, a DataFrame or a list of .* got"):
        sd.KalmanFilter(TANK).run(given)


def test_what_ends_a_line_or_begins_a_comment_in_a_file_is_a_cell_of_a_frame():
    plant = sd.Plant([[0.0]], [[1.0]], outputs=['# a "b"'])
    told = r"the frame(: .* in row {0} is not a number: '|, row {0}: cannot be read as cells .a line ends within)"
    for frame in (pandas.DataFrame, lambda columns: _Polars(**columns)):
        given = frame({plant.outputs.names[0]: [1.0, 2.0], "time": [0.5, 1.5]})
        np.testing.assert_array_equal(sd.read_measurements(given, plant).times, [0.5, 1.5])
        for cell in ("#1", " # 1", "1\n2,5.0", "1\r2", "1\u20282", "1\x852", '1"'):
            with pytest.raises(FileFormatError, match=told.format(2)):
                sd.read_measurements(frame({"time": [1.0, cell], "gauge": [2.0, 3.0]}), TANK)
            with pytest.raises(FileFormatError, match=told.format(1)):
                sd.read_measurements(frame({"time": [1.0], "gauge": [cell]}), TANK)


def test_a_column_that_no_file_can_say_is_named():
    beyond = np.array(["12345-01-01", "0001-01-01"], "M8[s]")
    columns = {"date": beyond, "gauge": [1.0, 2.0]}
    lengths = _Polars(gauge=[timedelta(1), timedelta(2)], time=[1.0, 2.0])
    for given, name in (
        (pandas.DataFrame(columns), "date"),
        (pandas.Series([1.0, 2.0], beyond), "date"),
        (lengths, "gauge"),
    ):
        with pytest.raises(
            FileFormatError, match=f"the frame: column '{name}' must hold numbers, texts or dates of the"
        ):
            sd.read_measurements(given, TANK)


def test_an_interval_says_how_a_frame_is_given():
    frame = pandas.DataFrame({"time": [0.0], "gauge": [1.0]})
    with pytest.raises(ArgumentError, match=r"`record` must hold rows .*: give it as `read_measurements\(frame, plant"):
        sd.state_interval(TANK, frame, w_bound=0.1, v_bound=0.1, initial_error=1.0)


def test_a_bad_frame_is_refused_in_the_words_of_a_file():
    with pytest.raises(FileFormatError, match="the frame: column 'position' is missing"):
        sd.read_measurements(pandas.DataFrame({"time": [0.0], "force_per_mass": [0.0]}), OSCILLATOR)
    with pytest.raises(ArgumentError, match=r"`path` must be .* or a DataFrame .* or an xarray .*, got int 3"):
        sd.read_measurements(3, OSCILLATOR)


def test_without_pandas_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match="dataframes"):
        estimates().to_frame()


CURVES = {
    "EstimateRecord": estimates,
    "WindowSigma": MAKERS["WindowSigma"],
    "SmoothedWindow": smoothed,
    "Accuracy": lambda: sd.guaranteed_accuracy(OSCILLATOR, SCHEDULE, w_bound=0.1, v_bound=0.1, rtol=0.2),
}


def test_every_record_with_curves_is_in_this_list():
    assert callable(sd.guaranteed_accuracy)  # a room opens on first use
    assert {c.__name__ for c in CurveRecord.__subclasses__()} == set(CURVES)


@pytest.mark.parametrize("kind", CURVES)
def test_curves_become_a_dataset_with_axes_and_units(kind):
    record = CURVES[kind]()
    data = record.to_xarray()
    assert data.attrs["record"] == kind
    for name, variable in record._variables().items():
        shown = data[name]
        assert shown.dims == variable.axes
        assert shown.attrs.get("units", "") == variable.unit
        np.testing.assert_array_equal(shown.values, np.asarray(variable.values))


def test_curves_are_read_by_name():
    record = estimates()
    data, name = record.to_xarray(), OSCILLATOR.states.names[1]
    assert data.x.sel(time=2.3, state=name) == record.x[1, 1]
    assert data.time.attrs["units"] == "s"
    assert data.covariance.sel(time=2.3, state=name, other_state=name) == record.covariance[1, 1, 1]
    bounds = CURVES["Accuracy"]()
    curve = bounds.to_xarray().sel(row=OSCILLATOR.states.names[0])
    assert float(curve.lower.max()) <= bounds.upper[0]
    assert bool((curve.lower <= curve.upper).all())
    sigma = MAKERS["WindowSigma"]()
    assert float(sigma.to_xarray().proven.min()) == sigma.lower


def test_without_xarray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(MissingExtraError, match="datasets"):
        estimates().to_xarray()
