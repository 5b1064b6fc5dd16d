"""Past states and a stated number of wild samples on the command line: each row is what the data leave possible."""

import csv
import json

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.cli.estimate import EstimateOptions
from sampling_design.errors import ArgumentError
from sampling_design.estimators.record_intervals import estimates_despite_outliers
from tests.cases import few

PLANT = sd.Plant(
    [[0.0, 1.0], [-1.0, -0.1]], np.eye(2), time_unit="d", states=["level", "flow"], outputs=["gauge", "lab"]
)
TIMES = np.arange(1.0, 7.0)
BOUNDS = {"w_bound": 0.1, "v_bound": [0.1, 0.1], "initial_error": [1.0, 1.0]}
FLAGS = ("--w", 0.1, "--v", "0.1,0.1", "--initial-error", "1,1", "--horizon", 6, "--no-picture")


def truth(t):
    return PLANT.transition(t) @ [0.5, 0.3]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wild")
    sd.plants.write_plant(PLANT, folder / "plant.toml")
    rows = [(t, *truth(t)) for t in TIMES]
    rows[2] = (rows[2][0], rows[2][1] + 2.0, rows[2][2])
    lines = ["time,gauge,lab", *(",".join(map(repr, map(float, row))) for row in rows)]
    (folder / "seen.csv").write_text("\n".join(lines) + "\n")
    return folder, [(t, np.array(y)) for t, *y in rows]


def table(shell, files, *flags):
    folder = files[0]
    found = shell("estimate", folder / "plant.toml", folder / "seen.csv", *FLAGS, *flags, "-o", folder / "out")
    with (folder / "out" / "estimates.csv").open() as file:
        return found, list(csv.DictReader(file))


@pytest.mark.parametrize("smooth", few([False, True], 0))
def test_each_row_holds_whichever_sample_is_wild(shell, files, smooth):
    found, rows = table(shell, files, "--outliers", "1", *(["--smooth"] if smooth else []))
    assert found.code == 0
    assert "Radii hold if at most 1 of the samples are outliers." in found.out
    assert len(rows) == len(TIMES)
    for k, (row, t) in enumerate(zip(rows, TIMES.tolist(), strict=True)):
        if k == 0 and not smooth:
            assert row["level_radius"] == ""  # the only sample may be the wild one
            continue
        data = files[1] if smooth else files[1][: k + 1]
        same = sd.state_interval(PLANT, data, t, outliers=1, prior_time=1.0, **BOUNDS)
        x = np.array([float(row["level"]), float(row["flow"])])
        radii = np.array([float(row["level_radius"]), float(row["flow_radius"])])
        assert x == pytest.approx((same.lower + same.upper) / 2, abs=1e-6)
        assert radii == pytest.approx((same.upper - same.lower) / 2, abs=1e-6)
        assert np.all(np.abs(x - truth(t)) <= radii + 1e-9)


def test_more_than_were_said_to_be_wild_contradict_the_bounds(shell, files):
    found, rows = table(shell, files)
    assert found.code == 1  # none is allowed to be
    assert rows[-1]["certified"] == "0"
    folder, data = files
    twice = [(t, y + ([0.0, 3.0] if t == 5.0 else [0.0, 0.0])) for t, y in data]
    lines = ["time,gauge,lab", *(",".join(map(repr, map(float, (t, *y)))) for t, y in twice)]
    (folder / "twice.csv").write_text("\n".join(lines) + "\n")
    asked = ("estimate", folder / "plant.toml", folder / "twice.csv", *FLAGS, "--json", "--outliers")
    broken = shell(*asked, "1")
    assert broken.code == 1
    told = json.loads(broken.out)
    assert told["status"][-1] == "bounds disproved"
    assert told["contradictions"][0]["alone"] is False
    assert shell(*asked, "2:6").code == 0


def test_smoothed_states_are_those_of_the_filter_and_hold(shell, files):
    found, rows = table(shell, files, "--leave-out", "3", "--smooth")
    assert found.code == 0
    assert len(rows) == len(TIMES) - 1
    before = table(shell, files, "--leave-out", "3")[1]
    for row, late in zip(before, rows, strict=True):
        for k, name in enumerate(("level", "flow")):
            off = abs(float(late[name]) - truth(float(late["time"]))[k])
            assert off <= float(late[f"{name}_radius"]) <= float(row[f"{name}_radius"]) * 1.3
    assert float(rows[0]["flow_radius"]) <= float(before[0]["flow_radius"]) * (1 + 1e-6)  # solved twice
    assert table(shell, files, "--leave-out", "3", "--smooth", "--radii", "centred")[0].code == 0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"outliers": "one"}, "`--outliers` must be Q or Q:M, 1 or 1:10, got 'one'"),
        ({"outliers": "1:2:3"}, "must be Q or Q:M"),
        ({"outliers": "0"}, "must be Q or Q:M"),
        ({"outliers": "1", "radii": "ellipsoids"}, "`--radii` ellipsoids does not go with --outliers"),
    ],
)
def test_what_is_no_number_of_outliers_is_refused(given, words):
    with pytest.raises(ArgumentError, match=words):
        assert EstimateOptions(**given).most_outliers
    assert EstimateOptions(outliers="1:10").most_outliers == (1, 10)


def test_a_tube_is_of_estimates_as_they_came(shell, files):
    folder = files[0]
    asked = ("estimate", folder / "plant.toml", folder / "seen.csv", "-o", folder / "tube", "--tube")
    refused = shell(*asked, "--smooth")
    assert refused.code == 2
    assert "`--tube` is of estimates as they came: leave it out with --outliers and --smooth." in refused.err
    record = sd.Measurements(PLANT, TIMES, [y for _, y in files[1]])
    estimator = sd.MovingHorizonEstimator(PLANT, horizon=6.0, **BOUNDS)
    (*_, last), *_ = estimates_despite_outliers(estimator, record, BOUNDS, 1)
    with pytest.raises(ArgumentError, match="`outliers` are of the rows alone"):
        last.proof.tube(TIMES, np.zeros((6, 2)))
