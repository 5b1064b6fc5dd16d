"""Uncertain plants and their files: ranges, parameters, vertices, and one sentence for everything else."""

import json

import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.checkers.strict import BadFile
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.uncertain.nominal_filter import NominalFilter
from sampling_design.uncertain.plants.plant_files import UncertainParameter, ends
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], name="oscillator")
STIFFNESS = UncertainParameter("omega^2", 0.81, 1.21, A=[[0.0, 0.0], [-1.0, 0.0]], nominal=1.0)
TOML = """
format = "sampling-design/uncertain-plant/1"
name = "oscillator"
time_unit = "s"
varying = true
[matrices]
A = [[0.0, 1.0], ["-1.0 +- 0.25", [-0.5, 0.0]]]
C = [[1.0, 0.0]]
[states]
names = ["x", "v"]
[[parameters]]
name = "gain"
range = [0.5, 2.0]
nominal = 1.0
C = [[1.0, 0.0]]
"""


def test_a_file_with_ranges_is_read_as_it_stands(tmp_path):
    path = tmp_path / "plant.toml"
    path.write_text(TOML)
    plant = UncertainPlant.read(path)
    assert [each.name for each in plant.parameters] == ["A[1, 0]", "A[1, 1]", "gain"]
    assert plant.low.tolist() == [-1.25, -0.5, 0.5]
    assert plant.high.tolist() == [-0.75, 0.0, 2.0]
    assert plant.varying
    assert plant.at({"gain": 2.0}).C.tolist() == [[2.0, 0.0]]
    assert plant.at(plant.high).A.tolist() == [[0.0, 1.0], [-0.75, 0.0]]


@pytest.mark.parametrize("suffix", ["toml", "json"])
@pytest.mark.parametrize(
    "plant",
    [
        UncertainPlant(OSCILLATOR, [STIFFNESS], varying=True),
        UncertainPlant(OSCILLATOR, vertices=[OSCILLATOR, Plant([[0.0, 1.0], [-2.0, 0.1]], [[1.0, 0.0]])]),
        UncertainPlant.from_intervals(([[0.1, 1.0]] * 2, [[0.3, 1.0], [0.7, 1.0]]), [[1.0, 0.0]], name="n"),
    ],
    ids=["parameters", "vertices", "intervals"],
)
def test_files_round_trip_exactly(plant, suffix, tmp_path):
    path = plant.save(tmp_path / f"plant.{suffix}")
    assert UncertainPlant.read(path).to_tree() == plant.to_tree()


def changed(**keys):
    tree = UncertainPlant(OSCILLATOR, [STIFFNESS]).to_tree()
    return {**json.loads(json.dumps(tree)), **keys}


@pytest.mark.parametrize(
    ("tree", "match"),
    [
        (changed(varying=1), "must be true or false"),
        (changed(parameters=[]), "`parameters` or `vertices` must be given"),
        (changed(parametres=[]), "unknown key 'parametres'"),
        (changed(parameters=[{"name": "k", "range": 1.0}]), r"`parameters\[0\].range` must be a range"),
        (changed(parameters=[{"name": "k", "range": [2.0, 1.0]}]), "must be a range with low <= high"),
        (changed(parameters=[{"name": "k", "range": [1.0]}]), "must be a range of two numbers"),
        (
            changed(parameters=[{"name": "k", "range": "1 +/- 2"}]),
            r'must be a number, a range \[low, high\] or "middle',
        ),
        (changed(parameters=[{"name": "k", "range": [0.0, 1.0]}]), "must move an entry of A, C or G"),
        (changed(matrices={"A": [[1.0], [1.0, 2.0]], "C": [[1.0]]}), "must have rows of one length"),
        (changed(format="sampling-design/plant/1"), "`format` must be 'sampling-design/uncertain-plant/1'"),
        (changed(matrices={"A": [["1e999 +- 1"]], "C": [[1.0]]}), "must be finite"),
    ],
)
def test_everything_else_is_refused_in_one_sentence(tree, match):
    with pytest.raises(FileFormatError, match=match):
        UncertainPlant.from_tree(tree)


def test_files_of_other_kinds_are_refused(tmp_path):
    (tmp_path / "plant.mat").write_bytes(b"MATLAB 5.0\x00\xff\xfe")
    with pytest.raises(FileFormatError, match=r"plant\.mat: is not a text file"):
        UncertainPlant.read(tmp_path / "plant.mat")
    with pytest.raises(FileFormatError, match=r"an uncertain plant file ends in \.toml or \.json, got '\.npz'"):
        UncertainPlant(OSCILLATOR, [STIFFNESS]).save(tmp_path / "plant.npz")


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: UncertainParameter("", 0, 1, A=[[1.0]]), "`name` of a parameter must be a text"),
        (lambda: UncertainParameter("k", 2, 1, A=[[1.0]]), "`high` of k must be at least `low`"),
        (lambda: UncertainParameter("k", 0, 1, A=[[1.0]], nominal=2), "`nominal` of k must lie in"),
        (lambda: UncertainParameter("k", 0, 1), "parameter 'k' must move an entry"),
        (lambda: UncertainPlant(OSCILLATOR), "`parameters` or `vertices` must be given"),
        (lambda: UncertainPlant(3, [STIFFNESS]), "`nominal` must be a Plant"),
        (lambda: UncertainPlant(OSCILLATOR, [3]), "`parameters` must be a list of UncertainParameter"),
        (lambda: UncertainPlant(OSCILLATOR, [STIFFNESS], varying="no"), "`varying` must be True or False"),
        (
            lambda: UncertainPlant(OSCILLATOR, [UncertainParameter("k", 0, 1, A=[[1.0]])]),
            r"`A` of k must have shape \(2, 2\) of the plant, got",
        ),
        (
            lambda: UncertainPlant(OSCILLATOR, vertices=[Plant([[1.0]], [[1.0]])]),
            r"`vertices\[0\]` must have the sizes",
        ),
        (lambda: UncertainPlant(OSCILLATOR, [STIFFNESS]).at([2.0]), "`values` must lie in the ranges"),
        (lambda: UncertainPlant(OSCILLATOR, vertices=[OSCILLATOR] * 2).at([1.0, 1.0]), "must be shares that sum to 1"),
        (lambda: UncertainPlant(OSCILLATOR, [STIFFNESS]).within([0.5], [1.0]), "must be ranges inside those"),
        (lambda: UncertainPlant(OSCILLATOR, [STIFFNESS]).moves("nosuch"), "`key` must be "),
        (lambda: UncertainPlant.from_intervals(([[1.0]], [[0.0]]), [[1.0]]), "lower entries at most the upper ones"),
    ],
)
def test_wrong_arguments_are_refused(make, match):
    with pytest.raises(ArgumentError, match=match):
        make()


def test_every_drawn_plant_lies_between_the_corners():
    plant = UncertainPlant(OSCILLATOR, [STIFFNESS, UncertainParameter("d", 0.0, 0.2, A=[[0.0, 0.0], [0.0, -1.0]])])
    members, rng = plant.members(np.random.default_rng(0)), np.random.default_rng(1)
    assert members.complete
    assert len(members.dynamics) == 4
    low, high = members.dynamics.min(axis=0)[:, :2], members.dynamics.max(axis=0)[:, :2]
    for _ in range(20):
        A = plant.draw(rng).A
        assert np.all((low - 1e-15 <= A) & (high + 1e-15 >= A))
    narrow = plant.within([0.9, 0.0], [1.0, 0.1])
    np.testing.assert_allclose(narrow.at([1.0, 0.1]).A, plant.at([1.0, 0.1]).A)


def test_a_box_of_many_parameters_draws_corners():
    many = [UncertainParameter(f"k{i}", -1.0, 1.0, A=np.eye(12) * (np.arange(12) == i)) for i in range(12)]
    found = UncertainPlant(Plant(np.zeros((12, 12)), np.eye(12)), many).members(np.random.default_rng(0))
    assert not found.complete
    assert 900 < len(found.dynamics) == len(np.unique(found.dynamics, axis=0)) <= 1024  # what is drawn twice, once
    assert set(np.abs(found.dynamics[:, :, :12][:, np.eye(12, dtype=bool)]).ravel()) == {1.0}


def test_the_record_shows_and_explains_itself():
    plant = UncertainPlant(OSCILLATOR, [STIFFNESS])
    assert "omega^2" in str(plant)
    assert "between 0.81 and 1.21" in plant.explain()
    assert "2 vertices" in UncertainPlant(OSCILLATOR, vertices=[OSCILLATOR] * 2).explain()


def test_long_texts_in_files_are_read_once():
    """Two ways to split digits would be a million ways to fail; a text that is code is a text."""
    for text in ("1" * 100_000, "1 +- " + "2" * 100_000 + "x", '__import__("os").getcwd()'):
        with pytest.raises(BadFile, match='"middle \\+- half", got a text'):
            ends(text, "`A[0][0]`")
    assert ends(" -1.5e3 +- .5e3", "") == (-2000.0, -1000.0)


def test_a_filter_of_the_nominal_plant_needs_one_that_is_not_exactly_known():
    with pytest.raises(ArgumentError, match="`plant` must be an UncertainPlant, got Plant"):
        NominalFilter(Plant([[0.0]], [[1.0]]))
