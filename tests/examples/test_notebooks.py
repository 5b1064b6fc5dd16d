"""The notebooks: stripped in the repository, run whole, with widgets and without, taught in the same order."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests import rigour
from tests.examples import notebooks

TOOL = Path(notebooks.__file__)
LECTURES = sorted(notebooks.FOLDER.glob("*.ipynb"))
CERTIFICATES = {"03": 9, "04": 1, "06": 25}
"""How many different certificates a lecture makes at least."""


def run(verb, path):
    done = subprocess.run(
        [sys.executable, str(TOOL), verb, str(path)], cwd=TOOL.parents[2], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-3000:]
    return int(done.stdout.split("pictures:")[1].split()[0])


def test_there_are_six_and_each_has_its_script():
    scripts = {path.stem for path in (notebooks.FOLDER.parent).glob("0*.py")}
    assert len(LECTURES) == 6
    assert {path.stem for path in LECTURES} == scripts


@pytest.mark.parametrize("path", LECTURES, ids=lambda p: p.stem)
def test_notebook_is_stored_without_what_a_run_leaves_behind(path):
    text = path.read_text()
    assert text == notebooks.stripped(json.loads(text)), f"run: python {TOOL.name} strip"


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


@pytest.mark.parametrize("path", LECTURES, ids=lambda p: p.stem)
def test_notebook_runs_and_each_of_its_certificates_is_proven_rigorously(path, monkeypatch, tmp_path):
    monkeypatch.setenv(rigour.FOLDER, str(tmp_path))
    assert run("run", path) >= 2, "a lecture shows at least two pictures"
    rigour.check_proven(tmp_path, CERTIFICATES.get(path.stem[:2], 0))
    assert (".certify" in path.read_text()) == (path.stem[:2] in CERTIFICATES)


def test_sliders_and_kernels_are_optional():
    assert run("plain", LECTURES[0]) >= 4
