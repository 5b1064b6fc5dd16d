"""Measured pages say what the program says today: rows are measured anew, all columns but those that a clock makes."""

import importlib
import re
from pathlib import Path

import pytest
from PIL import Image

import sampling_design as sd
from examples import pareto_satellite
from tests.benchmarks import bench_design_search, bench_worst_case, plan_search
from tests.cases import few

DOCS, EXAMPLES = (Path(__file__).parents[2] / folder for folder in ("docs", "examples"))
SHORT = (
    ("bench_design_search", "fixed times, two"),
    ("bench_worst_case", "double integrator k=2"),
    ("design_bounds", "fixed times, two"),
    ("inclusion_figures", "oscillator, frequency varying by 0 %, gaps .5 to 1.5, eta .1"),
    ("late_samples", "0.01 of a gap"),
    ("library_accuracy", "double_integrator"),
    ("plans", "double integrator, place"),
)
LONG = (
    ("plans", "activated_sludge"),
    ("plans", "thyroid_month"),
    ("plans", "tide_gauge"),
    ("plans", "satellite_passes"),
    ("plans", "cart_pendulum"),
    ("plans", "oscillator, velocity"),
    ("bench_design_search", "satellite, 12 samples"),
    ("bench_design_search", "oscillator, closed times"),  # in the middle, which a quick look at long tests takes
    ("bench_worst_case", "chain of five k=7, 1 %"),
    ("bench_worst_case", "random, six states, seed 0, k=8, 20 %"),
    ("design_bounds", "spiral e^20"),
    ("inclusion_figures", "oscillator, frequency within 10 %, eta .02, 8 pieces"),
    ("inclusion_figures", "pendulum, all angles, gaps to 1, eta .4"),
    ("late_samples", "satellite, 1 %"),
    ("late_samples", "gauge at once, laboratory 1.5 of 4 s"),
    ("late_samples", "tight weekly plan, 10 %"),
    ("library_accuracy", "satellite"),
    ("library_accuracy", "three_compartment"),
)
PAGES = {name: importlib.import_module(f"tests.benchmarks.{name}").PAGE for name in {module for module, _ in SHORT}}
NUMBER = r"-?\d*\.?\d+(?:e[+-]?\d+)?"


def apart(before, now):
    """Whether two texts differ, or a number by more than two of its last digit."""
    if re.sub(NUMBER, "#", before) != re.sub(NUMBER, "#", now):
        return True
    for a, b in zip(re.findall(NUMBER, before), re.findall(NUMBER, now), strict=True):
        mantissa, _, power = a.partition("e")
        if abs(float(a) - float(b)) > 2.001 * 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2])):
            return True
    return False


def stale(table, said, cells):
    """Columns that are others today."""
    told = zip(table.columns[1:], said[1:], cells, strict=True)
    return [each for each in told if each[0] not in table.clocked and apart(*each[1:])]


@pytest.mark.parametrize(
    ("module", "name"), [*few(SHORT, 1, 3, 4, 5), *(pytest.param(*row, marks=pytest.mark.long) for row in LONG)]
)
def test_a_row_of_a_measured_page_is_what_the_program_says(module, name, monkeypatch):
    for searching in (bench_design_search, bench_worst_case, plan_search):
        monkeypatch.setattr(searching, "TIMES", 0.5)
    page = PAGES[module]
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


@pytest.mark.long
@pytest.mark.parametrize("count", [6, 12])
def test_the_front_of_the_satellite_is_that_of_its_page(count):
    said = (DOCS / "pareto_satellite.md").read_text().splitlines()
    (row,) = pareto_satellite.rows(pareto_satellite.front_of([count]))
    before = next(line for line in said if line.startswith(row[:5]))
    assert not apart(before, row), row


def test_the_picture_of_the_front_is_that_of_its_page():
    explained = Image.open(DOCS / "figures" / "pareto_satellite.png").text["Description"]
    assert explained in (DOCS / "pareto_satellite.md").read_text()


@pytest.mark.long
def test_the_picture_of_the_readme_is_that_of_its_main_job():
    plant, requirement = (EXAMPLES / kind / "satellite.toml" for kind in ("plants", "requirements"))
    design = sd.design_schedule(sd.read_plant(plant), sd.read_requirement(requirement))
    said = Image.open(DOCS / "figures" / "design_satellite.png").text["Description"]
    assert not apart(said, design.explain())
