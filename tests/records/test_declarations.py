"""What a record says once: its table and its plain data are made from it, and name what is there."""

import importlib
import json
import pkgutil
from dataclasses import dataclass, field, fields
from datetime import date
from typing import NamedTuple

import numpy as np
import pytest

import sampling_design
from sampling_design.records.declarations import (
    ITEM,
    PLACE,
    STEP,
    above,
    below,
    in_words,
    plain,
    said,
    selected,
    short,
)
from sampling_design.records.record import PlainRecord, Record


class Pair(NamedTuple):
    low: float
    high: float


@dataclass(frozen=True, eq=False, repr=False)
class Part(PlainRecord):
    unit: str
    values: np.ndarray
    of: tuple[Pair, ...] = ()
    note: str = ""
    limit: float | None = None

    _table = {"values": "{values:2} {unit}", "least": "{values[0]}", "note": "{note:or }", "limit": "{limit} {unit}"}

    def least(self):
        return float(self.values.min())

    def explain(self):
        return "A part."


PART = Part("s", np.array([1.234, np.inf]), (Pair(0.0, 1.0), Pair(2.0, np.nan)))


def test_a_table_is_its_templates_and_leaves_out_what_is_none_or_unsaid():
    assert PART._rows() == [("values", "[1.2, inf] s"), ("least", "1.234")]
    assert Part("s", np.array([1.0]), note="late", limit=2.0)._rows()[2:] == [("note", "late"), ("limit", "2 s")]


@pytest.mark.parametrize(
    ("template", "text"),
    [
        ("{least} of {of[-1].low}", "1.234 of 2"),
        ("{note:or -}", "-"),
        ("{limit:3or none}", "none"),
        ("{limit.unit:or none}", "none"),
        ("{limit} s", None),
        ("{least:2}, {least:2up}, {least:2down}", "1.2, 1.3, 1.2"),
        ("{least:upor -}, {of[-1].high:down}", "1.234, nan"),
    ],
)
def test_a_template_reaches_attributes_parts_and_methods(template, text):
    assert said(PART, template) == text


def test_values_in_words():
    words = [in_words(each) for each in (True, np.False_, 3, 1e-9, np.float64(0.5), ("a", "b"), [1.0, 2.0], {"k": 0.1})]
    assert words == ["yes", "no", "3", "1e-09", "0.5", "a, b", "[1, 2]", "k = 0.1"]


@pytest.mark.parametrize("digits", [1, 3, 6])
def test_what_is_read_back_of_a_bound_is_on_its_side_and_next_to_it(digits):
    rng = np.random.default_rng(digits)
    drawn = rng.standard_normal(300) * 10.0 ** rng.integers(-320, 308, 300)
    for value in [*drawn, *np.nextafter([0.1, 0.3, 7.0, 1e300], np.inf), 0.0, 0.1, 5e-324, 9.9999999, -np.inf]:
        up, down = above(value, digits), below(value, digits)
        assert float(down) <= value <= float(up)
        assert short(value, digits) in (up, down)
        assert (up == down) == (float(short(value, digits)) == value)
    assert (above(1.7e308, 1), below(-1.7e308, 1), above(np.nan)) == ("2e+308", "-2e+308", "nan")


def test_bounds_of_a_template_are_rounded_by_their_names():
    @dataclass
    class Bracket:
        lower: float = 0.12345678
        upper: np.ndarray = field(default_factory=lambda: np.array([0.12345641, 0.2]))

    assert said(Bracket(), "{lower} to {upper}, {upper[0]:3}") == "0.123456 to [0.123457, 0.2], 0.124"
    assert said(Bracket(), "{lower:3up}") == "0.124"


def test_plain_data_is_all_fields_where_nothing_is_said():
    data = PART.to_dict()
    assert list(data) == [field.name for field in fields(Part)]
    assert data["values"] == [1.234, None]
    assert data["of"] == [[0.0, 1.0], [2.0, None]]


def test_plain_data_selects_renames_and_leaves_out():
    found = selected(PART, "unit least_value:least of{low} whole:of[0] limit? note?")
    assert found == {"unit": "s", "least_value": 1.234, "of": [{"low": 0.0}, {"low": 2.0}], "whole": [0.0, 1.0]}
    assert selected(PART, "limit{unit}") == {"limit": None}


def test_plain_data_can_be_written():
    data = plain(
        {"z": np.array([1 + 2j]), "n": np.int64(3), "m": np.array([True]), "d": date(2025, 1, 2), "p": PART, 1: 1j}
    )
    assert json.loads(json.dumps(data, allow_nan=False)) == {
        "z": [[1.0, 2.0]], "n": 3, "m": [True], "d": "2025-01-02", "p": PART.to_dict(), "1": [0.0, 1.0]
    }  # fmt: skip


def records(of=Record):
    for kind in of.__subclasses__():
        yield kind
        yield from records(kind)


def test_every_declaration_names_what_its_record_has():
    """A name that is mistyped would end in an AttributeError only where somebody prints that record."""
    for module in pkgutil.walk_packages(sampling_design.__path__, "sampling_design."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    declared, missing = 0, []
    for kind in {each for each in records() if each.__module__.startswith("sampling_design.")}:
        paths = [place[0] for text in kind._table.values() for place in PLACE.findall(text)]
        if issubclass(kind, PlainRecord):
            paths += [path or key for key, _, path, _ in ITEM.findall(kind._plain)]
        known = {name for base in kind.__mro__ for name in (*vars(base), *getattr(base, "__annotations__", {}))}
        declared += len(paths)
        missing += [f"{kind.__name__}: {path}" for path in paths if STEP.findall(path)[0] not in known]
        wrong = [text for text in kind._table.values() if "{" in PLACE.sub("", text) or "}" in PLACE.sub("", text)]
        missing += [f"{kind.__name__}: {text}" for text in wrong]
    assert declared > 200
    assert not missing
