"""The arena: its small version writes the whole page, says who is missing, and its claims hold."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from tests.benchmarks.arena import nonlinear, page, proving, records, searching, seeing, table, windows
from tests.benchmarks.arena.budgeted import evolve, homology

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def arena(tmp_path_factory):
    folder = tmp_path_factory.mktemp("arena")
    command = [sys.executable, "-m", "tests.benchmarks.arena", "--quick", "-o", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return folder


def test_the_arena_takes_any_object_with_the_three_methods():
    class Held:
        """The prior, whatever comes."""

        def start(self, prior, prior_time=0.0):
            self.x = np.asarray(prior)

        def update(self, t, y, u=None):
            return self.x

        def predict(self, t):
            return self.x

    plant = sd.named_plant("oscillator")
    shown = table.Table("title", "question", tuple("abcdefghi"))
    times, states = np.arange(1.0, 9.0), np.ones((8, 2))
    records.add_own(shown, "case", "held", Held(), (plant, times, states, np.ones((8, 1))), np.ones((8, 2)))
    assert [row[3:7] for row in shown.rows] == [(f"{np.sqrt(2):.4f}", "inf", "100%", "no")]


@pytest.mark.long
def test_quick_arena_writes_every_section_figure_and_version(arena):
    text = (arena / "arena.md").read_text()
    titles = ("Rows at given", "The least sigma", "The worst schedule", "The best periodic", "What a schedule proves")
    for title in (
        *titles,
        "One estimation window",
        "A whole record",
        "Scaling: states",
        "Scaling: samples",
        "Scaling: ret",
    ):
        assert f"## {title}" in text
    for peer in table.PINS:
        assert f"| {table.named(peer)} |" in text
    for name in re.findall(r"\(figures/(\w+\.png)\)", text):
        assert (arena / "figures" / name).stat().st_size > 1000
    assert page.COMMAND in text


@pytest.mark.long
def test_a_missing_peer_is_a_row_of_its_own_and_the_others_agree(monkeypatch):
    for module in ("do_mpc", "filterpy"):
        monkeypatch.setitem(sys.modules, module, None)
    monkeypatch.setattr(windows, "seconds_of", lambda work, **_: (work(), 1e-3)[1])
    one = table.Table("title", "question", ("case", "method", "first", "time", "ours", "off", "error", "bound"))
    windows.regular(one, quick=True)
    methods = [row[1] for row in one.rows]
    assert methods.count("do-mpc: not installed") == len(methods) / 2
    assert sum(method.startswith("sampling_design") for method in methods) == len(methods) / 2
    (whole,) = records.run(quick=True)
    assert [row[1] for row in whole.rows].count("filterpy: not installed") == 2
    # and filters of a dozen lines agree with the room's
    error = {row[1]: float(row[3]) for row in whole.rows if row[0] == "irregular" and row[3]}
    plain = error["continuous-discrete Kalman filter, plain"]
    assert error["sampling_design KalmanFilter, the filters' weights, rate 0.01"] == pytest.approx(plain, rel=0.1)
    assert all(row[5] in ("100%", "none", None) for row in whole.rows), "an ellipsoid lost the truth"


def test_the_nonlinear_section_is_that_of_its_run():
    text = (
        (ROOT / "docs" / "arena.md").read_text().partition("## Nonlinear plants of others\n")[2].partition("\n## ")[0]
    )
    assert nonlinear.QUESTION in text
    assert all(note in text for note in nonlinear.NOTES)
    rows = [line.split(" | ")[:2] for line in text.splitlines() if line.startswith("| ")][2:]
    kept = [m for m in nonlinear.METHODS if m != nonlinear.NOMINAL]
    assert [row[0][2:] for row in rows[:: len(kept)]][:3] == list(nonlinear.CASES)[:3]
    assert {row[0][2:] for row in rows} == set(nonlinear.CASES)


def test_a_section_is_renewed_in_its_place(tmp_path):
    first, second = (table.Table(title, "asked", ("a",), [(1,)], ["told"]) for title in ("first", "second"))
    whole = page.written([first, second], tmp_path, 1.0, False).read_text()
    assert page.renewed(first, tmp_path / "arena.md").read_text() == whole
    first.rows[0] = (2,)
    assert page.renewed(first, tmp_path / "arena.md").read_text() == whole.replace("| 1 |", "| 2 |", 1)
    with pytest.raises(ValueError, match=r"no table 'third' in arena\.md"):
        page.renewed(table.Table("third", "", ("a",)), tmp_path / "arena.md")


def test_a_row_of_the_wrong_length_is_refused():
    with pytest.raises(ValueError, match="3 cells expected, got 1"):
        table.Table("title", "question", ("case", "method", "time")).add("alone")


def test_rivals_minimise_the_same_window():
    for box in (None, 1.0):
        task = windows.problem(2, 5, True, box) if box is None else windows.constrained(2, 5)
        estimate = windows.ours(task)[1]
        for parametric in (False, True):
            x = windows.Rebuilt(task, parametric).solve(task)
            assert np.abs(x - estimate.x).max() < 1e-5


def test_loops_agree_with_the_rooms():
    plant = sd.named_plant("satellite")
    times = np.linspace(0.0, 900.0, 7)
    assert np.allclose(
        seeing.loop_rows(plant, times), sd.observability.observability_matrix(plant, times), rtol=1e-10, atol=1e-10
    )


@pytest.mark.long
@pytest.mark.parametrize("search", [evolve, homology])
def test_a_search_stops_on_time_and_keeps_its_best(search):
    found = search(lambda x: float((x - 0.3) @ (x - 0.3)), 2, 0.3)
    assert found.calls > 0
    assert found.best < 1e-3


@pytest.mark.parametrize("name", searching.DESIGNS)
def test_points_of_the_cube_are_admissible_schedules(name):
    plant, wish = searching.DESIGNS[name]
    loss = searching.loss_of_steps(plant, wish, 5)
    values = [loss(x) for x in np.random.default_rng(0).uniform(size=(10, 5))]
    assert min(values) < 0
    assert max(values) <= 0


@pytest.mark.long
def test_horizons_are_ordered_as_the_theorems_say():
    (found,) = proving.run(quick=True)
    paper, exact, sharp, true = (float(row[2].split()[0]) for row in found.rows)
    assert true <= sharp < exact < paper
