"""Files that are read in blocks and written row by row are those of the whole record, to the last byte."""

import json
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.cli import estimate
from sampling_design.cli.estimate import EstimateOptions
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.estimators.online import in_order
from sampling_design.estimators.online.history import InputHistory
from sampling_design.estimators.records import measurement_table
from sampling_design.estimators.records.measurement_table import MeasurementTable
from sampling_design.records import file_io
from sampling_design.records.file_io import to_json
from sampling_design.validation import schedule_log
from sampling_design.validation.schedule_log import _paired_times
from tests.cases import few

PLANT = sd.Plant(
    [[0.0, 1.0], [-1.0, 0.0]],
    [[1.0, 0.0], [0.0, 1.0]],
    B=[[0.0], [1.0]],
    time_unit="h",
    states=["level", "rate"],
    outputs=["gauge", "flow"],
    inputs=["pump"],
)
BOUNDS = {"w_bound": 0.01, "v_bound": 0.2, "initial_error": 1.5}
ELLIPSOIDS = EstimateOptions("ellipsoids")


def drawn_file(rng, path, rows=60, dates=False, awkward=True):
    """A file with blanks, held inputs, limits, late rows and rows that come twice."""
    times = np.round(np.cumsum(rng.uniform(0.2, 0.9, rows)), 3)
    lines = []
    for t in times:
        stamp = f"2026-01-05T{int(t) % 24:02d}:{int(t * 60) % 60:02d}:00" if dates else repr(float(t))
        cells = [f"{np.cos(t):.6f}", "" if rng.random() < 0.3 else f"{-np.sin(t):.6f}", "", stamp]
        if awkward and rng.random() < 0.1:
            cells[0] = "<2.5"
        if awkward and rng.random() < 0.1:
            cells[1] = '"0.1"' if rng.random() < 0.5 else " -0.0 "
        if not lines or rng.random() < 0.3:
            cells[2] = f"{rng.normal():.3e}"
        lines.append(",".join(cells))
    if awkward:
        lines[20], lines[21] = lines[21], lines[20].replace(",,", ",,0.5,", 0)
        held = lines[30].split(",")
        lines[30] = ",".join([*held[:2], held[2] or "0.25", held[3]])
        lines.insert(33, lines[30])
    path.write_text("gauge,flow,pump," + ("date" if dates else "time") + "\n" + "\n".join(lines) + "\n")
    return path


def read(path, monkeypatch, block, plain):
    with monkeypatch.context() as patched:
        patched.setattr(measurement_table, "BLOCK", block)
        if not plain:
            patched.setattr(MeasurementTable, "_plain", lambda self, lines: None)
        try:
            found = sd.read_measurements(path, PLANT)
        except FileFormatError as error:
            return str(error)
    return [found.times.tobytes(), found.y.tobytes(), found.u.tobytes(), found.censored, found.origin]


@pytest.mark.parametrize("seed", few(range(12), 0, 5, 8, 11))
def test_blocks_are_read_as_single_rows_are(tmp_path, monkeypatch, seed):
    rng = np.random.default_rng(seed)
    path = drawn_file(rng, tmp_path / "y.csv", dates=seed % 3 == 2, awkward=seed % 4 > 0)
    whole = read(path, monkeypatch, 10_000, plain=False)
    for block in (1, 7, 10_000):
        assert read(path, monkeypatch, block, plain=True) == whole
    lines = path.read_text().splitlines()
    at = int(rng.integers(1, len(lines)))
    for spoilt in ("nan", "1_0", "1e-999", "1e999", "٣", "0x1", "", '"'):
        cells = lines[at].split(",")
        cells[int(rng.integers(0, 4))] = spoilt
        path.write_text("\n".join([*lines[:at], ",".join(cells), *lines[at + 1 :]]) + "\n")
        assert read(path, monkeypatch, 7, plain=True) == read(path, monkeypatch, 10_000, plain=False)


@pytest.mark.parametrize("radii", few(["intervals", "centred", "ellipsoids"], 0, 2))
def test_estimates_written_one_by_one_are_those_of_the_record(tmp_path, monkeypatch, capsys, radii):
    monkeypatch.setattr(in_order, "MOST_INTERVALS", 5)
    path = drawn_file(np.random.default_rng(3), tmp_path / "y.csv", rows=12, awkward=False)
    record = replace(sd.read_measurements(path, PLANT), origin="2026-03-01")

    def estimator():
        return sd.MovingHorizonEstimator(PLANT, horizon=3.0, cost=sd.CostFunction(eta=0.1), **BOUNDS)

    whole = estimator().run(record)
    if radii == "centred":
        whole = whole.centred()
    moved = sd.estimators.EstimateRecord(**{**{k: getattr(whole, k) for k in whole.__dataclass_fields__}})
    if radii == "ellipsoids":
        object.__setattr__(moved, "radii", whole.ellipsoid_radii)
        moved.__dict__["estimates"] = tuple(replace(each, proof=None) for each in whole.estimates)
    settings = Settings("estimate", output=tmp_path / "out", as_json=True, quiet=True)
    tally = estimate.followed(settings, estimator(), record, EstimateOptions(radii), "words", BOUNDS)
    printed = capsys.readouterr().out
    expected = {**moved.to_dict(), "radii_of": radii, "guarantee": "words", "horizon": 3.0}
    assert printed == to_json(settings.named(expected)) == (tmp_path / "out/estimates.json").read_text()
    file = sd.estimators.write_estimates(moved, tmp_path / "whole.csv", origin="2026-03-01")
    assert (tmp_path / "out/estimates.csv").read_bytes() == file.read_bytes()
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"estimates.csv", "estimates.json", "estimates.png"}
    assert tally.rows()[2:] == moved._rows()
    assert json.loads(printed)["states"] == ["level", "rate"]


def test_an_error_in_a_later_row_leaves_no_file(tmp_path):
    record = sd.Measurements(PLANT, [1.0, 50.0, 2.0], [[1.0, 0.0]] * 3, [[0.0]] * 3)
    settings, estimator = (
        Settings("estimate", output=tmp_path / "out", quiet=True), sd.MovingHorizonEstimator(PLANT, horizon=3.0)
    )  # fmt: skip
    with pytest.raises(ArgumentError, match="goes back beyond the window"):
        estimate.followed(settings, estimator, record, ELLIPSOIDS, "words", BOUNDS)
    assert list((tmp_path / "out").iterdir()) == []
    with pytest.raises(ArgumentError, match="`radii` must be one of intervals, centred, ellipsoids, got 'ellipses'"):
        estimate.followed(settings, estimator, record, EstimateOptions("ellipses"), "", BOUNDS)


def test_memory_does_not_grow_with_the_record():
    """A thousand rows more hold no more than their numbers: 40 bytes each, with room to spare."""

    def held(rows):
        times = np.arange(1.0, rows + 1)
        record = sd.Measurements(PLANT, times, np.stack([np.cos(times), -np.sin(times)], axis=1))
        settings = Settings("estimate", quiet=True)
        tracemalloc.start()
        estimator = sd.MovingHorizonEstimator(PLANT, horizon=3.0, cost=sd.CostFunction(eta=0.1), **BOUNDS)
        estimate.followed(settings, estimator, record, ELLIPSOIDS, "words", BOUNDS)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak

    held(50)
    assert held(250) - held(100) < 150 * 600  # flows and nodes that are kept for a while are larger than that


def test_inputs_are_added_without_a_copy_of_those_before():
    first = InputHistory([(0.0, np.zeros(1))])
    second, third = first.added(1, 1.0, np.ones(1)), first.added(1, 2.0, np.ones(1))
    assert second._log is first._log
    assert third._log is not first._log  # another future of the same past
    assert [t for t, _ in second] == [0.0, 1.0]
    assert [t for t, _ in third] == [0.0, 2.0]
    assert [t for t, _ in second.added(1, 0.5, np.ones(1))] == [0.0, 0.5, 1.0]
    assert [t for t, _ in second.since(1)] == [1.0]
    assert second[-1][0] == 1.0
    with pytest.raises(IndexError, match="2"):
        second[2]


@pytest.mark.parametrize("together", [1, 3, 50_000])
def test_planned_samples_are_matched_as_one_by_one(monkeypatch, together):
    monkeypatch.setattr(schedule_log, "MATCHED", together)
    rng = np.random.default_rng(0)
    for _ in range(200):
        planned = np.unique(np.round(rng.uniform(0, 10, rng.integers(1, 12)), 1))
        actual = np.unique(np.round(planned[rng.random(planned.size) < 0.8] + rng.uniform(-0.6, 0.6), 1))
        actual = np.unique([*actual, *np.round(rng.uniform(0, 10, rng.integers(1, 4)), 1)])
        assert _paired_times(planned, actual).tolist() == one_by_one(planned, actual)


@pytest.mark.parametrize("endless", [True, False])
def test_a_long_record_is_judged_in_stretches_as_a_whole(monkeypatch, endless):
    rng = np.random.default_rng(1)
    plan = sd.PeriodicSchedule([1.0, 1.3, 0.9], time_unit="h")
    plant = replace(PLANT, states=sd.plants.Signals(["level", "rate"], scales=[0.1, 3.0]))
    times = plan.between(0, 60.0).times
    times = (times + rng.uniform(-0.2, 0.2, times.size))[rng.random(times.size) > 0.1]
    masks = rng.random((times.size, 2)) < 0.8
    masks[~masks.any(axis=1)] = True
    asked = (plant, plan if endless else plan.between(0.0, 61.0), times, 4.0)
    whole = sd.compare_schedule(*asked, outputs=masks)
    monkeypatch.setattr(schedule_log, "STRETCH", 7)
    monkeypatch.setattr(schedule_log, "AROUND", 5)
    parts = sd.compare_schedule(*asked, outputs=masks)
    for one, other in ((whole.planned_sigma, parts.planned_sigma), (whole.actual_sigma, parts.actual_sigma)):
        assert other.closed
        assert other.upper == pytest.approx(one.upper, rel=1.1e-3)
        assert max(one.lower, other.lower) <= min(one.upper, other.upper)
        assert other.lower >= (1 - 1.1e-3) * one.lower
        seen = other.profile  # of the windows around the worst actual one, for both
        assert seen.t.min() <= parts.actual_sigma.witness.t <= seen.t.max()
        assert np.ptp(seen.t) < 25
    assert parts.actual_sigma.profile.sigma.min() == pytest.approx(parts.actual_sigma.upper, rel=1e-3)


def test_a_hole_in_any_stretch_is_found_and_what_is_left_open_stays_open(monkeypatch):
    monkeypatch.setattr(schedule_log, "STRETCH", 7)
    times = np.arange(1.0, 60.0)
    for hole in (3.0, 31.0, 58.0):
        log = sd.compare_schedule(PLANT, sd.PeriodicSchedule([1.0], time_unit="h"), times[times != hole], 3.0)
        assert log.actual_sigma.upper < 0.99 * log.planned_sigma.lower
        assert hole <= log.actual_sigma.witness.t <= hole + 4
    sigma = log.actual_sigma
    unfinished = replace(sigma, lower=0.5 * sigma.lower, status="budget")
    for joint in (schedule_log._joint(sigma, unfinished), schedule_log._joint(unfinished, sigma)):
        assert (joint.lower, joint.upper) == (unfinished.lower, sigma.upper)
        assert (joint.closed, joint.status) == (False, "budget")


def test_json_in_pieces_is_the_json(monkeypatch):
    monkeypatch.setattr(file_io, "PIECES", 3)
    data = {"a": [1.0, 2.5e-300], "b": {"c": None, "d": ["ä", True]}}
    assert "".join(file_io.json_pieces(data)) == to_json(data)
    listed = {"a": [1.0, None], "b": {"c": [], "d": [[-0.0, 1.0, 2.0, 3.0], {}]}}
    arrays = {"a": np.array([1.0, np.nan]), "b": {"c": np.zeros(0), "d": [np.array([-0.0, 1.0, 2.0, 3.0]), {}]}}
    assert "".join(file_io.json_pieces(arrays)) == to_json(listed)
    with pytest.raises(TypeError, match="set has no JSON"):
        list(file_io.json_pieces({"a": {1.0}}))


def one_by_one(planned, actual):
    gaps = np.diff(planned)
    before, after = np.append(np.inf, gaps) / 2, np.append(gaps, np.inf) / 2
    if gaps.size:
        before[0], after[-1] = after[0], before[-1]
    match = []
    for k, t in enumerate(planned):
        its = [j for j, a in enumerate(actual) if -before[k] <= a - t < after[k] and j not in match]
        match.append(min(its, key=lambda j: abs(actual[j] - t), default=-1))
    return match


@pytest.mark.parametrize("kind", ["window", "filter"])
def test_times_told_ahead_change_nothing_but_the_cost(kind):
    """Also where some of them never come, and others come late."""
    rng = np.random.default_rng(5)
    times = np.cumsum(rng.uniform(0.2, 0.9, 60))

    def estimator():
        cost = sd.CostFunction(eta=0.1)
        if kind == "filter":
            return sd.KalmanFilter(PLANT, cost=cost, maximum_delay=2.0, **BOUNDS)
        return sd.MovingHorizonEstimator(PLANT, horizon=3.0, cost=cost, **BOUNDS)

    told, untold = estimator(), estimator()
    told.expect([*times, -5.0, times[7] + 0.01])
    made = len(told.table)
    for k, t in enumerate(times):
        row = (float(t), [np.cos(t), -np.sin(t)], [0.001 * k])
        one, other = told.update(*row), untold.update(*row)
        assert np.allclose(one.x, other.x, rtol=1e-12, atol=1e-12)
        assert np.allclose(one.covariance, other.covariance, rtol=1e-11)
        assert one.radius == pytest.approx(other.radius, rel=1e-9, nan_ok=True)
    assert made > 60
    assert len(told.table) <= made + 60
    with pytest.raises(ArgumentError, match="`times` must"):
        told.expect([np.nan])
