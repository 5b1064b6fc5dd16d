"""The command `estimate` says of a file what holds, whatever its clock, and never certifies what its data disprove."""

import csv
import json

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.readings import CensoredReading
from tests.cases import few
from tests.laws.test_what_contradicts_the_bounds_is_never_certified_again import ROWS, WALK
from tests.laws.test_where_the_clock_has_its_zero_changes_no_answer import RECORDS, STILL, TIMES


def asked(shell, folder, rows, *more, plant=STILL):
    """Exit code and data of the command on a record."""
    sd.plants.write_plant(plant, folder / "plant.toml")
    sd.estimators.write_measurements(rows, folder / "rows.csv")
    flags = ("--w-bound", "0.01", "--v-bound", "0.02", "--initial-error", "2")
    found = shell("estimate", folder / "plant.toml", folder / "rows.csv", *flags, "--json", *more)
    return found.code, json.loads(found.out)


@pytest.mark.parametrize("kind", few([*RECORDS, "its own times", "a contradiction"], 0))
def test_the_command_answers_the_same_for_a_file_and_its_shift(shell, tmp_path, kind):
    """Also where only the file's own times can be certified, and where a sample contradicts the bounds."""
    rows = sd.Measurements(STILL, TIMES, RECORDS["numbers"].y)
    if kind in RECORDS:
        rows = sd.Measurements(STILL, TIMES, RECORDS[kind].y, censored=RECORDS[kind].censored)
    elif kind == "its own times":
        y = np.array(rows.y)
        y[1::2, 1] = np.nan
        rows = sd.Measurements(STILL, TIMES, y)
    else:
        rows = sd.Measurements(STILL, TIMES, rows.y + 9.0 * (TIMES == 3.5)[:, None])
    code, here = asked(shell, tmp_path, rows)
    assert code == (kind == "a contradiction")
    assert ("file's own times only" in here["guarantee"]) == (kind in ("limits", "means", "its own times"))
    for by in (64.0, -8.0):
        again, there = asked(shell, tmp_path, rows.shifted(by))
        assert again == code
        assert there["guarantee"] == here["guarantee"]
        for key in ("certified", "on_schedule", "status"):
            assert there[key] == here[key]
        for key in ("x", "radii"):
            one, other = (np.array(found[key], dtype=float) for found in (here, there))
            assert other == pytest.approx(one, rel=1e-6, abs=1e-7, nan_ok=True)
        assert np.array(there["times"]) - by == pytest.approx(np.array(here["times"]))
        blamed = [(each["t"] - by, each["output"], each["number"]) for each in there["contradictions"]]
        assert blamed == [(each["t"], each["output"], each["number"]) for each in here["contradictions"]]
    if kind == "a contradiction":
        assert here["contradictions"][0]["t"] == 3.5
        assert "at t = 3.5" in here["notes"][-1]


def test_radii_from_means_hold_the_truth_wherever_the_file_begins(shell, tmp_path):
    """Three of these four missed it: the beginnings of the means had stayed where they were."""
    rows = np.array([0.5, 2.0, 3.5, 5.0])
    y, told = np.full((4, 2), np.nan), [()]
    y[0] = np.cos(0.5), -np.sin(0.5)
    for t, since in zip(rows[1:], (0.6, 2.1, 3.6), strict=True):
        level, rate = (np.sin(t) - np.sin(since)) / (t - since), (np.cos(t) - np.cos(since)) / (t - since)
        told.append((CensoredReading(0, level, level, since), CensoredReading(1, rate, rate, since)))
    _, found = asked(shell, tmp_path, sd.Measurements(STILL, rows, y, censored=tuple(told)))
    assert found["certified"] == [True] * 4
    truth = np.stack([np.cos(rows), -np.sin(rows)], axis=1)
    assert np.all(np.abs(np.array(found["x"]) - truth) <= np.array(found["radii"]))


def test_a_file_may_begin_with_a_mean(shell, tmp_path):
    rows = RECORDS["means"].between(1.9, 9.0)
    assert rows.start == 2.0
    early = sd.Measurements(STILL, [2.0], [[np.nan, -0.9]], censored=((CensoredReading(0, 0.4, 0.4, 0.75),),))
    assert early.start == 0.75
    assert asked(shell, tmp_path, early)[1]["times"] == [2.0]


@pytest.mark.parametrize("radii", few(["intervals", "centred", "ellipsoids"], 0, 2))
@pytest.mark.parametrize("written", few([True, False], 0))
def test_files_and_exit_code_say_it_too(shell, tmp_path, radii, written):
    sd.plants.write_plant(WALK, tmp_path / "walk.toml")
    (tmp_path / "y.csv").write_text("time,gauge\n" + "".join(f"{t},{y}\n" for t, (y,) in ROWS))
    flags = ["--w-bound", "0.1", "--v-bound", "0.2", "--initial-error", "5", "--eta", "0.2", "--radii", radii]
    flags += ["-o", tmp_path] if written else []
    found = shell("estimate", tmp_path / "walk.toml", tmp_path / "y.csv", *flags)
    assert found.code == 1
    words = " ".join(found.out.split())
    assert "2 of 43" in words
    assert "contradict the bounds" in words
    if not written:
        return
    data = json.loads((tmp_path / "estimates.json").read_text())
    with open(tmp_path / "estimates.csv", newline="") as file:
        lines = list(csv.DictReader(file))
    for k, row in enumerate(lines):
        standing = k < 2
        assert (row["certified"] == "1") == data["certified"][k] == standing
        assert (row["level_radius"] != "") == (data["radii"][k] != [None]) == standing
    assert len(data["contradictions"]) == 1


def test_an_estimate_lies_in_the_middle_of_what_is_possible_unless_asked_otherwise(shell, tmp_path):
    """As far from the truth at most as any estimate can guarantee, and not aside of that as the least squares are."""
    plant = sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["gauge"])
    path = sd.plants.write_plant(plant, tmp_path / "plant.toml")
    (tmp_path / "y.csv").write_text("time,gauge\n0.5,0.7\n1.5,0.74\n2.5,0.82\n")
    bounds = ("--w", 0.05, "--v", 0.1, "--initial-error", 1)
    found = {}
    for radii in ((), ("--radii", "intervals")):
        done = shell("estimate", path, tmp_path / "y.csv", *bounds, *radii, "--json", "--quiet")
        assert done.code == 0, done.err
        data = json.loads(done.out)
        found[radii] = np.array(data["x"]), np.array(data["radii"])
        shown = " ".join(shell("estimate", path, tmp_path / "y.csv", *bounds, *radii).out.split())
        assert ("on schedule" in shown) == bool(radii)
        assert ("The last radius with --radii centred: " in shown) == bool(radii)
    record = sd.read_measurements(tmp_path / "y.csv", plant)
    for k, t in enumerate(record.times):
        rows = [row for row in record if row[0] <= t]
        held = sd.state_interval(plant, rows, w_bound=0.05, v_bound=0.1, initial_error=1.0)
        np.testing.assert_allclose(found[()][0][k], held.centre, atol=1e-6)
        np.testing.assert_allclose(found[()][1][k], held.radii, rtol=1e-5)
    assert np.all(found[()][1] <= found["--radii", "intervals"][1] + 1e-12)
    assert np.any(found[()][1] < 0.99 * found["--radii", "intervals"][1])
