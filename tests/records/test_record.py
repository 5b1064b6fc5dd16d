"""What all records share."""

from dataclasses import dataclass

import numpy as np
import pytest

from sampling_design import plotting
from sampling_design.errors import ArgumentError
from sampling_design.records import record
from sampling_design.records.record import Claim, Record, SolverRecord, short


@dataclass(frozen=True, eq=False, repr=False)
class Sample(Record):
    value: float

    def _rows(self):
        return [("the value", short(self.value)), ("a <tag>", "x & y"), ("c", "3"), ("d", "4"), ("e", "5")]

    def explain(self):
        return f"The value is {self.value}."


def test_repr_is_one_line_of_the_first_rows():
    assert repr(Sample(0.5)) == "Sample(the_value=0.5, a_<tag>=x & y, c=3, d=4)"


def test_str_is_a_table():
    first, *rows = str(Sample(0.5)).splitlines()
    assert first == "Sample"
    assert rows == ["  the value  0.5", "  a <tag>    x & y", "  c          3", "  d          4", "  e          5"]


def test_html_is_escaped():
    html = Sample(0.5)._repr_html_()
    assert "a &lt;tag&gt;" in html
    assert "x &amp; y" in html


def test_plot_hands_over_to_the_plotting_room(monkeypatch):
    seen = []
    monkeypatch.setattr(plotting, "draw", lambda record, ax: seen.append((record, ax)) or "axes")
    record = Sample(1.0)
    assert record.plot() == "axes"
    assert record.plot("mine") == "axes"
    assert seen == [(record, None), (record, "mine")]


def test_a_bare_record_asks_for_its_rows():
    with pytest.raises(NotImplementedError):
        str(Record())
    with pytest.raises(NotImplementedError):
        Record().explain()


def test_short_numbers():
    assert short(1 / 3) == "0.333333"
    assert short(1e-9, 3) == "1e-09"
    assert short([1.0, 2.5]) == "[1, 2.5]"
    assert [short(v, 2) for v in (480.0, -4812.0, 99.96, 12345.0)] == ["480", "-4800", "100", "1.2e+04"]
    assert short(np.arange(10.0)) == "[0, 1, 2, 3, 4, 5, 6, 7, ...]"


def test_claims_say_how_strong_they_are():
    claim = Claim("sigma is at least 0.1", "Theorem 17", ("no sample is lost",), "proven")
    assert str(claim) == "proven: sigma is at least 0.1 [Theorem 17] given no sample is lost"
    assert claim.to_dict()["assumptions"] == ["no sample is lost"]
    assert str(Claim("x", strength="sampled")) == "sampled: x"


def test_solver_records_are_plain_data():
    told = {"name": "clarabel", "version": "0.9", "status": "Solved", "iterations": 7, "details": {}}
    assert SolverRecord("clarabel", "0.9", "Solved", 7).to_dict() == told
    assert SolverRecord(**told, seconds=0.1).to_dict()["seconds"] == 0.1


def test_a_record_that_nothing_draws_says_so(monkeypatch):
    monkeypatch.setattr(record, "offered", lambda *asked: None)
    with pytest.raises(ArgumentError, match="`record` has no picture: nothing that draws a int is installed"):
        record.draw(3)


def test_arrays_of_a_record_are_copies_that_nobody_writes_to():
    """Who made a record by hand goes on with arrays of their own: an estimator steps its state in place."""
    state = np.array([1.0, 2.0])
    made = Sample(state)
    state += 1.0
    assert made.value.tolist() == [1.0, 2.0]
    with pytest.raises(ValueError, match="read-only"):
        made.value[0] = 3.0
    assert Sample(made.value).value is made.value  # what nobody can write to is not copied again
