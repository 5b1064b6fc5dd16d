"""Nonlinear plants in certificate files: cells of the region are proven, and a point where it fails is named."""

import json
from fractions import Fraction

import numpy as np
import pytest

from sampling_design import GapRange, Plant, read_certificate
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.checkers import check, half_spaces
from sampling_design.checkers.claims import certificate
from sampling_design.checkers.parts import digest
from sampling_design.checkers.strict import BadFile
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.numerics.balls import rational
from sampling_design.uncertain.inclusion import region_balls
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests.cases import few

NOWHERE = {"low": [], "high": []}
SINE = {"code": [["x", 0], ["sin", 0], ["w", 0], ["add", 1, 2]], "outputs": [3]}
TWICE = {
    "code": [
        *(["x", 0], ["constant", 0.5], ["mul", 0, 1], ["sin", 2], ["cos", 2], ["mul", 3, 4], ["twice", 5]),
        *(["constant", 0.9], ["mul", 6, 7], ["w", 0], ["add", 8, 9]),
    ],
    "outputs": [10],
}
OUTPUT = {"code": [["x", 0]], "outputs": [0]}


@pytest.fixture(scope="module")
def slopes():
    """x' = theta x, |theta| <= 1, which holds x' = sin x for all x."""
    model = UncertainPlant(Plant([[0.0]], [[1.0]]), [UncertainParameter("theta", -1.0, 1.0, A=[[1.0]])])
    return certify_inclusion(model, GapRange(0.1, 0.2), eta=0.5, pieces=4).to_dict()


def nonlinear(data, f=SINE, h=OUTPUT, low=None, high=None, rows=(), offsets=(), **model):
    box = {"low": [low], "high": [high]}
    model = {
        "kind": "nonlinear", "f": f, "h": h, "x": box, "u": NOWHERE, "w": {"low": [None], "high": [None]},
        "rows": list(rows), "offsets": list(offsets), **model,
    }  # fmt: skip
    data = json.loads(json.dumps({**data, "model": model}))
    return {**data, "digest": digest(data)}


def scaled(factor):
    return {"code": [*SINE["code"], ["constant", factor], ["mul", 1, 4], ["add", 5, 2]], "outputs": [6]}


def both(data):
    found = check(data)["verdict"], verify_rigorously(data).verdict
    assert found[0] == found[1], found
    return found[0]


def test_a_sine_lies_between_its_slopes(slopes):
    assert both(nonlinear(slopes)) == "proven"
    assert both(nonlinear(slopes, low=-2.0, high=2.0)) == "proven"


def test_the_region_decides(slopes):
    cubic = {
        "code": [["x", 0], ["power", 0, 3.0], ["constant", 3.0], ["div", 1, 2], ["w", 0], ["add", 3, 4]],
        "outputs": [5],
    }
    assert both(nonlinear(slopes, cubic, low=-1.0, high=1.0)) == "proven"
    assert both(nonlinear(slopes, cubic, low=-1.2, high=1.0)) == "refuted"
    assert both(nonlinear(slopes, cubic, low=-1.0, high=3.0, rows=[[2.0]], offsets=[2.0])) == "proven"
    assert both(nonlinear(slopes, cubic, low=-1.0, high=3.0, rows=[[2.0]], offsets=[2.5])) == "refuted"


@pytest.mark.parametrize("k", range(-3, 6))
@pytest.mark.parametrize("ends", [(-1.0, 1.0), (-1.0, 2.0), (-3.0, -2.0), (0.5, 0.75), (0.0, 1.0), (-1e-9, 1e9)])
def test_a_power_in_balls_holds_that_of_every_number(ends, k):
    value, slope = region_balls.powered(region_balls.hull(*ends), float(k))
    if k < 0 and ends[0] <= 0 <= ends[1]:
        assert not value.is_finite()
        return
    for t in map(Fraction, np.linspace(*ends, 9).tolist()):
        assert value.overlaps(rational(t**k))
        assert slope.overlaps(rational(k * t ** (k - 1) if k else Fraction(0)))
    if k > 0:
        assert value.abs_upper() <= max(map(abs, ends)) ** k * (1 + 1e-6)


def test_a_power_in_balls_of_an_exponent_as_large_as_doubles_go_ends():
    value, slope = region_balls.powered(region_balls.hull(-0.5, 0.25), 1e308)
    assert value.abs_upper() < 1e-300
    assert slope.is_finite()
    assert region_balls.powered(region_balls.hull(1.0, 1.0), -1e308)[0].contains(1.0)


def test_dependent_numbers_are_cut_into_cells(slopes):
    # sin x cos x + sin x cos x = sin 2x: interval by interval twice as wide as it is
    assert both(nonlinear(slopes, TWICE, low=-4.0, high=4.0)) == "proven"


def test_too_steep_is_refused_at_a_point(slopes):
    data = nonlinear(slopes, scaled(1.05), low=-1.0, high=1.5)
    verdict = check(data)
    assert verdict["verdict"] == "refuted"
    assert "of its terms at x = [" in verdict["reason"]
    assert "fails at x = [" in verify_rigorously(data).reason


def test_a_function_that_is_not_defined_is_undecided(slopes):
    data = nonlinear(
        slopes, {"code": [["x", 0], ["sqrt", 0], ["w", 0], ["add", 1, 2]], "outputs": [3]}, low=0.0, high=1.0
    )
    assert both(data) in ("undecided", "refuted")


@pytest.mark.parametrize(
    ("code", "low", "high"),
    few(
        [
            ([["x", 0], ["power", 0, 1e308], ["w", 0], ["add", 1, 2]], 0.5, 2.0),  # slopes overflow
            ([["x", 0], ["w", 0], ["mul", 0, 1], ["twice", 2]], -1.0, 1.0),  # w has no bound, and so no slope
        ],
        1,
    ),
)
def test_slopes_without_a_bound_are_undecided_and_halving_ends(code, low, high, slopes):
    found = check(nonlinear(slopes, {"code": code, "outputs": [3]}, low=low, high=high))
    assert found["verdict"] == "undecided"
    assert "cells of the region are left" in found["reason"]


def bent(by):
    return {"code": [["x", 0], ["constant", by], ["sin", 0], ["mul", 1, 2], ["add", 0, 3]], "outputs": [4]}


def test_outputs_may_bend(slopes):
    assert both(nonlinear(slopes, h=bent(0.05))) == "proven"
    assert (
        both(nonlinear(slopes, h=bent(0.95), low=-4.0, high=4.0)) == "refuted"
    )  # a slope of 0.05 shows next to nothing


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"x": {"low": [1.0], "high": [0.0]}}, "must have low <= high"),
        ({"x": {"low": [], "high": []}}, "must have 1 entries, got 0"),
        ({"rows": [[1.0, 2.0]], "offsets": [1.0]}, "must have 1 columns, and one of `offsets` per row"),
        ({"f": {"code": [["x", 0]], "outputs": []}}, "must have 1 entries, got 0"),
        ({"h": {"code": [["w", 0]], "outputs": [0]}}, "must be one of 0 inputs w"),
    ],
)
def test_the_model_is_a_grammar(change, match, slopes, tmp_path):
    data = nonlinear(slopes, **change)
    assert check(data)["verdict"] == "bad file"
    path = tmp_path / "c.json"
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match=match):
        read_certificate(path)


def test_the_file_is_read_as_it_stands(slopes, tmp_path):
    path = tmp_path / "c.json"
    path.write_text(json.dumps(nonlinear(slopes)))
    found = read_certificate(path)
    assert found.kind == "nonlinear"
    assert found.verify().passed
    assert "stay in the plant's region" in str(found.claim)


@pytest.mark.parametrize(
    ("most", "words"), [(300_000, "has an empty region: no state is in its box"), (0, "has too many half-spaces to be")]
)
def test_a_region_without_a_state_is_a_bad_file_and_refused_at_the_door(slopes, most, words, monkeypatch):
    from sampling_design.nonlinear.region import StateRegion

    monkeypatch.setattr(half_spaces, "MOST_ENTRIES", most)
    data = nonlinear(slopes, low=1.0, high=2.0, rows=[[1.0]], offsets=[1 - 1e-12])
    with pytest.raises(BadFile, match=words):
        certificate(data)
    assert both(data) == "bad file"
    with pytest.raises(ArgumentError, match="`rows` and `offsets` of a region must "):
        StateRegion([1.0], [2.0], [[1.0]], [1 - 1e-12])


def test_a_cell_that_no_halving_decides_is_undecided(slopes, monkeypatch):
    from sampling_design.uncertain.inclusion import region_balls

    monkeypatch.setattr(region_balls, "DEPTH", 0)
    found = verify_rigorously(nonlinear(slopes, TWICE, low=-4.0, high=4.0))
    assert (found.verdict, "could not be decided: it is tight or nearly so" in found.reason) == ("undecided", True)
