"""The example of blood samples in office hours does what its text says."""

import importlib.util
from pathlib import Path

import pytest

from sampling_design.nonlinear import thyroid

PATH = Path(__file__).parents[2] / "examples" / "thyroid.py"
SPEC = importlib.util.spec_from_file_location("example_thyroid", PATH)
EXAMPLE = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(EXAMPLE)
PATIENT = thyroid.thyroid()


@pytest.fixture(scope="module")
def design():
    return EXAMPLE.design_week(PATIENT)


def test_samples_fall_on_weekdays_from_8_to_17_h(design):
    times = design.schedule.times
    assert times.size == 3
    assert all(any(start <= t < stop for start, stop in EXAMPLE.OFFICE) for t in times)
    assert design.split.retained.n_states == 2
    assert design.sigma > 0.8 * design.upper_bound


def test_the_week_is_certified_at_the_papers_rate_and_horizon(design):
    certificate = EXAMPLE.certify_week(PATIENT, design.schedule)
    assert certificate.verify().passed
    assert certificate.eta == 0.35
    # the sharp theorem covers the paper's horizon of 5 days
    assert certificate.horizon().length < EXAMPLE.HORIZON


@pytest.mark.long
def test_the_nonlinear_estimator_runs_on_it(tmp_path):
    page = EXAMPLE.compare(2, 1, tmp_path, pairs=1)
    assert "slower than 0.35 a day: 1 of 6 modes; slower than 1.5 a day: 2 of 6 modes" in page
    rows = [[cell.strip() for cell in line.split("|")[1:5]] for line in page.splitlines() if line.startswith("| ")][2:]
    assert [row[:2] for row in rows] == [["designed", "3"], ["Mon, Tue, Wed at 8 h", "3"], ["every day at 8 h", "7"]]
    assert all(float(row[2]) < 0.06 and row[3] == "0" for row in rows)
    assert "evidence, not proof" in page
    assert (tmp_path / "thyroid_week.md").read_text() == page + "\n"
    assert (tmp_path / "blood_samples.ics").read_bytes().startswith(b"BEGIN:VCALENDAR")
    assert (tmp_path / "certificate.json").exists()


@pytest.mark.long
def test_assumption_7_with_the_papers_weights_asks_for_more_than_5_days():
    # T4 and T3 drive TSH, whose scaled difference grows before the first sample is taken
    evidence = EXAMPLE.assumption_7(PATIENT, 4)
    assert evidence.least_lambda > 2
    assert evidence.least_horizon() > EXAMPLE.HORIZON
