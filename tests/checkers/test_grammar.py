"""The grammar of certificate files: one sentence with the place for everything that is not exactly right."""

import dataclasses
import json
import re
from contextlib import suppress
from functools import cache

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, certify, read_certificate
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.checkers import check, claims, parts, sampled, strict
from sampling_design.checkers.cover import need
from sampling_design.checkers.frame import Frame
from sampling_design.checkers.numbers import definite, problem
from sampling_design.checkers.outcome import Refused, Undecided
from sampling_design.checkers.strict import BadFile
from sampling_design.errors import ArgumentError, FileFormatError

PLANT = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


@cache
def text():
    return json.dumps(certify(PLANT, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2)).to_dict())


def redigested(data):
    return {**data, "digest": parts.digest(data)}


CASES = [
    (lambda d: d.update(eta=True), "`eta` must be a number, got a boolean True"),
    (lambda d: d.update(eta="0.4"), "`eta` must be a number, got a text '0.4'"),
    (lambda d: d.update(eta=None), "`eta` must be a number, got nothing (null)"),
    (lambda d: d.update(eta=10**400), "`eta` must be a number that a double holds, got a whole number of many digits"),
    (lambda d: d["P1"][0].__setitem__(0, "1"), "`P1[0][0]` must be a number, got a text '1'"),
    (lambda d: d["P1"].pop(), "`P1` must have shape (2, 2), got (1, 2)"),
    (lambda d: d["P1"][0].pop(), "`P1` must have all rows of 1 numbers, got 2 rows of 1 or 2 numbers"),
    (lambda d: d.update(P1={}), "`P1` must be a list, got a table {}"),
    (lambda d: d["times"].update(gaps=[]), "`times` must hold at least one sample"),
    (lambda d: d["times"].update(first=2.0), "must increase strictly, the first sample within the period"),
    (lambda d: d["times"].update(outputs=[[True]]), "`times.outputs[0][0]` must be 1 (measured) or 0, got a boolean"),
    (lambda d: d["times"].update(outputs=[[0]]), "0 or 1, each row with a 1"),
    (lambda d: d["times"].update(outputs=[[1, 1]]), "`times.outputs[0]` must have a length of 1, got 2"),
    (lambda d: d["times"].update(outputs=[[1], [1]]), "0 or 1, each row with a 1"),
    (lambda d: d["plant"]["states"]["names"].pop(), "`plant.states.names` must have a length of 2, got 1"),
    (lambda d: d["plant"]["states"].update(names=["a", "a"]), "`plant.states.names` must be distinct"),
    (lambda d: d["plant"]["states"].update(names=["a", ""]), "`plant.states.names[1]` must not be blank, got ''"),
    (lambda d: d["plant"].update(name="a\0"), "`plant.name` must be one line without control characters, got 'a\\x00'"),
    (lambda d: d["plant"]["states"].update(scales=[1.0]), "`plant.states.scales` must have a length of 2, got 1"),
    (lambda d: d["plant"]["matrices"].update(B=[[1.0]]), "`plant.matrices.B` must have shape (2, 1), got (1, 1)"),
    (lambda d: d["plant"]["matrices"].update(D=[[1.0]]), "`plant.matrices.D` must have shape (1, 0), got (1, 1)"),
    (lambda d: d.update(times=[1.0]), "must be a table of keys and values, got a "),
    (lambda d: d["times"].update(gap=1.0), "unknown key 'gap' in `times`. Did you mean 'gaps'?"),
    (
        lambda d: d.update(claim="guess"),
        "`claim` must be 'assumption-7', 'family', 'detectability', 'inclusion', 'interval' here, got 'guess'",
    ),
    (lambda d: d.update(format="sampling-design/plant/1"), "`format` must be 'sampling-design/certificate/1'"),
    (lambda d: d["plant"].update(format="x"), "`plant.format` must be 'sampling-design/plant/1', got 'x'"),
    (
        lambda d: d["plant"].update(time_unit="year"),
        "`plant.time_unit` must be one of ms, s, min, h, d, wk, got 'year'",
    ),
    (lambda d: d["plant"].pop("time_unit"), "`plant.time_unit` is missing"),
    (lambda d: d["plant"]["matrices"].update(C=[[1.0]]), "`plant.matrices` must have n columns in C and n rows in G"),
    (lambda d: d["witness"].update(direction=[0.0, 0.0]), "`witness.direction` must have 2 entries, not all zero"),
    (lambda d: d["witness"].update(start=1e3), "`witness` must have 0 <= start <= t within the schedule"),
    (lambda d: d["P2"][0].__setitem__(1, 0.1), "`P2` must be symmetric"),
    (lambda d: d["solver"].update(iterations=1.5), "`solver.iterations` must be a whole number, got 1.5"),
    (lambda d: d["solver"].update(details={"x": float("inf")}), "`solver.details.x` must be finite, got inf"),
    (lambda d: d["tool"].update(name=3), "`tool.name` must be a string, got 3"),
    (lambda d: d.pop("lam"), "`lam` is missing in the certificate. Was the file cut off?"),
]


@pytest.mark.parametrize(("change", "words"), CASES, ids=lambda v: v if isinstance(v, str) else "")
def test_what_is_not_exactly_right_is_refused_with_its_place(change, words, tmp_path):
    data = json.loads(text())
    change(data)
    with suppress(ValueError):  # an infinity has no digest, and is refused before it is asked for
        data = redigested(data)
    with pytest.raises(BadFile, match=re.escape(words)):
        claims.certificate(data)
    assert check(data)["verdict"] == "bad file"
    with pytest.raises((ArgumentError, FileFormatError), match=re.escape(words)):
        raise_as_a_file(data, tmp_path)
    found = verify_rigorously(data)
    assert found.verdict == "bad file"
    assert found.reason.startswith("the data are no certificate: ")


def raise_as_a_file(data, folder):
    from sampling_design.certificates.files import certificate_from_dict

    return certificate_from_dict(data)


def test_what_is_no_table_or_altered_is_refused(tmp_path):
    with pytest.raises(BadFile, match="must hold one table, got list"):
        claims.certificate([])
    altered = json.loads(text()) | {"eta": 0.3}
    with pytest.raises(BadFile, match="the digest does not fit the content: something was altered"):
        claims.certificate(altered)
    path = tmp_path / "c.json"
    path.write_text(json.dumps(altered))
    with pytest.raises(FileFormatError, match="the digest does not fit the content") as caught:
        read_certificate(path)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"\xff\xfe", "is not a text file (not UTF-8)"),
        (b'{"a": 1e999}', "holds 1e999, which is not a finite double"),
        (b'{"a": 1e-999}', "holds 1e-999, which is too small for a double"),
        (b'{"a": NaN}', "holds NaN, which is not allowed"),
        (b'{"a": 99999999999999999999}', "a whole number beyond 2^53: write it with a point"),
        (b"[1]", "must hold one JSON object, got list"),
        (b'{"a": 1, "a": 2}', "key 'a' occurs twice"),
        (b'{"a": "\\udc00"}', "holds the text '\\udc00', which is not Unicode"),
        (b"[" * 50, "is nested more than 20 levels deep"),
        (b'{"a"', "is not valid JSON at line 1"),
    ],
)
def test_texts_are_read_strictly(content, words):
    with pytest.raises(BadFile, match=re.escape(words)):
        strict.from_json(strict.decoded(content))


def test_an_enormous_file_is_refused_before_it_is_read(monkeypatch):
    monkeypatch.setattr(strict, "MOST_BYTES", 10)
    with pytest.raises(BadFile, match="is too large: 11 bytes, expected at most 10"):
        strict.decoded(b"x" * 11)


def test_brackets_in_texts_are_no_levels():
    assert strict.from_json('{"a": "' + "[" * 100 + '\\"{"}') == {"a": "[" * 100 + '"{'}


def test_single_values():
    for read, value, words in (
        (strict.nonnegative, -1.0, "must not be negative, got -1.0"),
        (strict.positive, 0.0, "must be positive, got 0.0"),
        (strict.flag, 1, "must be true or false, got 1"),
        (strict.list_of(strict.number), "ab", "must be a list, got a text 'ab'"),
        (strict.list_of(strict.number, 2), [1.0], "must have a length of 2, got 1"),
        (strict.matrix(2, 2), [[1.0, 2.0]], "must have 2 rows of 2 numbers, got 1 rows of 2 numbers"),
        (strict.table({}), [], "must be a table of keys and values, got a list []"),
    ):
        with pytest.raises(BadFile, match=re.escape(words)):
            read(value, "x")
    assert strict.flag(True, "x") is True
    assert strict.matrix()(np.eye(2), "x").tolist() == [[1.0, 0.0], [0.0, 1.0]]


def test_what_floats_can_not_decide_says_so():
    made = claims.certificate(json.loads(text()))
    numbers, measured = problem(made.plant, made.weights), made.schedule.measured
    with pytest.raises(Undecided, match="its left side is nearly singular"):
        Frame(numbers, -np.eye(2), "x", measured)
    with pytest.raises(Undecided, match="its coordinates are too ill-conditioned for doubles"):
        Frame(numbers, np.array([[1.0, 1.0], [1.0, 1 + 4e-16]]), "x", measured)
    with pytest.raises(Undecided, match="R and Qv are nearly singular"):
        Frame(dataclasses.replace(numbers, V=-np.eye(1)), np.eye(2), "x", measured)
    windows = sampled.Windows(numbers, made.schedule, numbers.P2, "x")
    with pytest.raises(Undecided, match="the information along the witness is beyond doubles"):
        windows.ratio(np.eye(2), 2 * np.eye(2), np.ones(2))
    with pytest.raises(Undecided, match="the rounding along the witness is beyond doubles"):
        windows.ratio(np.eye(2), np.full((2, 2), np.inf), np.ones(2))
    windows.start_band = 0.1 * np.eye(2)
    with pytest.raises(Undecided, match="but rounding leaves"):
        windows.attained(made.witness)
    with pytest.raises(Undecided, match="could not be decided: it is nearly singular"):
        definite("P", np.eye(41) - 1 / 41, np.ones(41))
    with pytest.raises(Refused, match="the graph does not hold the family: at node 3, why"):
        need(False, 3, "why")


def _deep(levels):
    found = []
    for _ in range(levels):
        found = [found]
    return found


def _itself():
    found = []
    found.append(found)
    return found


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        (_itself(), "must not hold itself"),
        ({"a": _itself()}, "must not hold itself"),
        (_deep(30), "is nested more than 20 levels deep"),
        (_deep(5000), "is nested more than 20 levels deep"),
        ([[10**5000, 1.0]], "must be a number that a double holds, got a whole number of many digits"),
        (-(10**5000), "must be a number that a double holds, got a whole number of many digits"),
        ([float("nan")], "must be finite, got nan"),
        (np.float64("nan"), "must be finite, got nan"),
        (np.array([[1.0, np.inf]]), "must be finite, got inf"),
        (1j, "must be plain data, got a complex"),
        (object(), "must be plain data, got a object"),
        ({1, 2}, "must be plain data, got a set"),
        ({1: 2.0}, "must be a string, got 1"),
        ("\ud800", "which is not Unicode"),
    ],
    ids=lambda value: "" if isinstance(value, str) else type(value).__name__,
)
@pytest.mark.parametrize(
    "place", [("more",), ("lam",), ("times",), ("plant", "matrices", "A"), ("solver", "details", "x")]
)
def test_what_only_python_can_hold_is_a_sentence(place, value, sentence):
    """Data need not come from a file: what no file holds is refused as what a file holds wrongly."""
    table = altered = json.loads(text())
    for key in place[:-1]:
        table = table[key]
    table[place[-1]] = value
    found = check(altered)
    assert found["verdict"] == "bad file"
    assert sentence in found["reason"]
    assert "\n" not in found["reason"]
    for holds in (value, [value], {"a": value}):
        assert "\n" not in strict.printed(holds)  # readers of other files show it too


def test_numbers_of_arrays_are_those_of_lists():
    altered = json.loads(text())
    for key in ("P1", "P2", "Qw", "R", "Qv"):
        altered[key] = np.array(altered[key])
    altered["eta"] = np.float64(altered["eta"])
    assert check(altered)["passed"]


def test_data_of_too_many_values_are_refused(monkeypatch):
    data = json.loads(text())
    monkeypatch.setattr(strict, "MOST_ITEMS", 10)
    assert "holds more than 10 values" in check(data)["reason"]


def test_weights_that_no_factor_holds_are_undecided():
    made = claims.certificate(json.loads(text()))
    numbers = problem(made.plant, made.weights)
    frame = Frame(numbers, numbers.P2, "x", np.ones((1, 1), bool))
    with pytest.raises(Undecided, match="a weight is nearly singular"):
        frame.inverse_of(-np.eye(2)[None])
    with pytest.raises(Undecided, match="a weight is too ill-conditioned for doubles"):
        frame.inverse_of(np.array([[[1.0, 1.0], [1.0, 1 + 4e-16]]]))
