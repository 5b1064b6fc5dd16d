"""Measured pages say what the program says today: rows are measured anew, all columns but those that a clock makes."""

import re

import pytest

from tests.benchmarks import bench_design_search, design_bounds, library_accuracy, plan_search, plans

PAGES = {
    module.__name__.rpartition(".")[2]: module
    for module in (bench_design_search, design_bounds, library_accuracy, plans)
}
SHORT = (
    ("bench_design_search", "fixed times, two"),
    ("design_bounds", "fixed times, two"),
    ("library_accuracy", "double_integrator"),
    ("plans", "double integrator, place"),
)
LONG = (
    ("bench_design_search", "oscillator, closed times"),
    ("design_bounds", "spiral e^20"),
    ("library_accuracy", "satellite"),
    ("plans", "activated_sludge"),
)
NUMBER = r"-?\d*\.?\d+(?:e[+-]?\d+)?"


def stale(table, said, cells):
    """Columns whose text, or a number by more than two of its last digit, is another one today."""
    found = []
    for column, before, now in zip(table.columns[1:], said[1:], cells, strict=True):
        apart = re.sub(NUMBER, "#", before) != re.sub(NUMBER, "#", now)
        for a, b in zip(re.findall(NUMBER, before), re.findall(NUMBER, now), strict=False):
            mantissa, _, power = a.partition("e")
            unit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
            apart |= abs(float(a) - float(b)) > 2.001 * unit
        if apart and column not in table.clocked:
            found.append((column, before, now))
    return found


@pytest.mark.parametrize(("module", "name"), [*SHORT, *(pytest.param(*row, marks=pytest.mark.long) for row in LONG)])
def test_a_row_of_a_measured_page_is_what_the_program_says(module, name, monkeypatch):
    for searching in (bench_design_search, plan_search):
        monkeypatch.setattr(searching, "TIMES", 0.5)
    page = PAGES[module].PAGE
    rows = page.rows()
    tables = [table for table in page.tables if name in table.names]
    assert tables
    for table in tables:
        assert stale(table, rows[table.head, name], list(table.measured(name))) == []


def test_a_stale_row_is_found():
    table, said = bench_design_search.TABLE, ["satellite", "18.2", "0.9014", "0.9213", "2.16 %", "0.9018", "-", "-"]
    assert stale(table, said, ["60.8", "0.9015", "0.9212", "2.16 %", "0.5", "0.6", "-"]) == []
    assert stale(table, said, ["18.2", "0.9014", "0.9213", "2.56 %", "0.9018", "-", "-"]) == [
        ("gap", "2.16 %", "2.56 %")
    ]
    assert stale(table, said, ["18.2", "none", "0.9213", "2.16 %", "0.9018", "-", "-"]) == [
        ("sigma proven", "0.9014", "none")
    ]
