"""The command thyroid in short runs."""

import inspect
import json
import subprocess
import sys

import pytest

from sampling_design.cli.thyroid import thyroid
from sampling_design.nonlinear.experiment import thyroid_experiment
from tests.cases import few

WITHOUT = """
import sys
sys.modules["casadi"] = None
from sampling_design.cli import main
if __name__ == "__main__":
    main()
"""


def test_the_command_and_the_function_have_the_same_defaults():
    command, verb = (inspect.signature(each).parameters for each in (thyroid, thyroid_experiment))
    shared = command.keys() & verb.keys() - {"workers"}
    assert {"runs", "days", "degree"} <= shared
    assert {key: command[key].default for key in shared} == {key: verb[key].default for key in shared}


def test_thyroid_writes_runs_report_and_figures_and_refuses_another_experiments_file(shell, tmp_path):
    result = shell("thyroid", "--days", 0.25, "--reading", "per_day", "--workers", 1, "-o", tmp_path)
    assert result.code == 0
    assert "what is done instead" in result.out
    assert "ratio 1.014" in result.out
    assert {p.name for p in tmp_path.iterdir()} == {"runs.jsonl", "thyroid.md", "thyroid.json", "figures"}
    page = (tmp_path / "thyroid.md").read_text()
    for number in (1, 2, 3):
        name = f"figures/thyroid_figure{number}.png"
        assert f"]({name})" in page
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")
    data = json.loads((tmp_path / "thyroid.json").read_text())
    assert data["cases"]["per_day"]["standard"]["problems"] == 4
    again = shell("thyroid", "--days", 0.25, "--reading", "per_day", "--workers", 1, "-o", tmp_path, "--json")
    assert json.loads(again.out)["cases"] == data["cases"]
    assert json.loads(again.out)["format"] == data["format"] == "sampling-design/thyroid/1"
    result = shell("thyroid", "--days", 0.25, "--seed", 5, "--workers", 1, "-o", tmp_path)
    assert result.code == 2
    assert "holds runs with seed = 0, asked for 5" in result.err
    assert shell("thyroid", "--reading", "per_week").code == 2


@pytest.mark.parametrize("workers", few([1, 2], 1))
def test_without_the_extra_it_ends_in_one_sentence_that_names_it(tmp_path, workers):
    (tmp_path / "without.py").write_text(WITHOUT)
    flags = ["--days", "0.25", "--runs", "2", "--workers", str(workers), "-o", "out"]
    done = subprocess.run(
        [sys.executable, "without.py", "thyroid", *flags], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "pip install 'sampling-design[nonlinear]'" in done.stderr
    assert not done.stdout
    assert not (tmp_path / "out").exists()
