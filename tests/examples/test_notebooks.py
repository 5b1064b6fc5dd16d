"""The notebooks: stripped in the repository, taught in the same order; the documentation executes all of them."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.examples import notebooks

TOOL = Path(notebooks.__file__)
LECTURES = sorted(notebooks.FOLDER.glob("*.ipynb"))
SOLUTIONS = sorted((notebooks.FOLDER.parent / "teachers").glob("*.ipynb"))


def run(verb, *paths):
    done = subprocess.run(
        [sys.executable, str(TOOL), verb, *map(str, paths)],
        cwd=TOOL.parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return sum(int(part.split()[0]) for part in done.stdout.split("pictures:")[1:])


def test_there_are_eight_and_each_has_its_script():
    scripts = {path.stem for path in (notebooks.FOLDER.parent).glob("0*.py")}
    assert len(LECTURES) == 8
    assert {path.stem for path in LECTURES} == scripts


@pytest.mark.parametrize("path", [*LECTURES, *SOLUTIONS], ids=lambda p: f"{p.parent.name}-{p.stem}")
def test_notebook_is_stored_without_what_a_run_leaves_behind(path):
    text = path.read_text()
    assert text == notebooks.stripped(json.loads(text)), f"run: python {TOOL.name} strip"


@pytest.mark.parametrize("path", [*LECTURES, *SOLUTIONS], ids=lambda p: f"{p.parent.name}-{p.stem}")
def test_no_cell_prints_a_line_in_parts(path):
    """A kernel sends what is printed in pieces, and a page begins a line with each of them."""
    assert not re.search(r"\bend *= *[\\]?[\"']", path.read_text())


def test_stripping_removes_outputs_counts_and_metadata():
    used = {
        "cells": [
            {
                "cell_type": "code",
                "source": "1 + 1\n",
                "outputs": [{"x": 1}],
                "execution_count": 7,
                "metadata": {"a": 1},
            }
        ],
        "metadata": {"signature": "someone"},
    }
    left = json.loads(notebooks.stripped(used))
    assert left["cells"][0] == {
        "cell_type": "code",
        "execution_count": None,
        "id": "c00",
        "metadata": {},
        "outputs": [],
        "source": ["1 + 1"],
    }
    assert "signature" not in left["metadata"]


@pytest.mark.parametrize("path", LECTURES, ids=lambda p: p.stem)
def test_notebook_asks_first_teaches_by_failure_and_ends_with_what_to_take_away(path):
    words = ["".join(c["source"]) for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "markdown"]
    assert "**The question.**" in words[0]
    assert any("## Exercises" in text for text in words)
    assert words[-1].startswith("## What to take away")
    assert any("hange " in text for text in words), "nothing to change"


def test_every_lecture_has_a_slider_that_may_be_missing_and_no_plumbing():
    for path in LECTURES:
        code = ["".join(c["source"]) for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "code"]
        with_slider = [cell for cell in code if "interact" in cell]
        assert with_slider, path.stem
        assert all("except ImportError" in cell for cell in with_slider), path.stem
        assert not any("def picture" in cell or "plt.close" in cell for cell in code), path.stem


def test_no_slider_draws_before_it_is_moved():
    # a program that executes notebooks answers each picture in a widget, and may miss the end of the cell meanwhile
    for path in LECTURES:
        for cell in json.loads(path.read_text())["cells"]:
            if "interact" in (code := "".join(cell["source"])):
                assert 'interact.options(manual=True, manual_name="draw")(show, ' in code, path.stem
                assert 'slider.observe(show.widget.update, "value")' in code, path.stem


@pytest.mark.long
def test_a_slider_draws_when_it_is_moved():
    drawn = []

    def show(gap):
        drawn.append(gap)

    cell = next(
        "".join(c["source"]) for c in json.loads(LECTURES[0].read_text())["cells"] if "interact" in "".join(c["source"])
    )
    names = {"show": show}
    exec(cell, names)
    assert drawn == []
    names["slider"].value = 1.5
    assert drawn == [1.5]


@pytest.mark.long
def test_pictures_show_by_themselves_in_a_kernel():
    assert run("run", LECTURES[0]) >= 3


def test_every_exercise_has_its_solution():
    assert [path.name for path in SOLUTIONS] == [path.name for path in LECTURES]
    for lecture, solved in zip(LECTURES, SOLUTIONS, strict=True):
        asked, answered = (
            ["".join(c["source"]) for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "markdown"]
            for path in (lecture, solved)
        )
        exercises = next(text for text in asked if "## Exercises" in text)
        for number in range(1, 9):
            assert (f"\n{number}. " in exercises) == any(f"**{number}.**" in text for text in answered), solved.stem


@pytest.mark.long
@pytest.mark.parametrize("begin", [0, 3, 6])
def test_every_solution_holds(begin):
    assert len(SOLUTIONS) <= 9  # in pieces of three
    run("plain", *SOLUTIONS[begin : begin + 3])
