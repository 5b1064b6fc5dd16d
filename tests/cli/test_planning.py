"""plan: from one file to a plan, its files and its picture."""

import json
import signal
from pathlib import Path
from types import SimpleNamespace

import pytest

from sampling_design.cli.planning import _now, plan
from sampling_design.cli.planning import next_sample as next_command
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError
from sampling_design.planning.search import PlanSearch

EXAMPLES = Path(__file__).parents[2] / "examples"
SMALL = """format = "sampling-design/plan-requirement/1"
period = 6.4
grid = 0.8
w_bound = 0.02
initial_error = 0.05
[accuracy]
position = 0.5
[sensors.position]
noise_bound = 0.2
"""


@pytest.mark.long
def test_a_plan_becomes_files_that_other_commands_take(shell, tmp_path):
    (tmp_path / "wanted.toml").write_text(SMALL)
    out = tmp_path / "out"
    result = shell("plan", EXAMPLES / "plants" / "oscillator.toml", tmp_path / "wanted.toml", "-o", out)
    assert result.code == 0
    assert "keep position within" in " ".join(result.out.split())
    data = json.loads((out / "plan.json").read_text())
    assert data["format"] == "sampling-design/plan/1"
    assert data["reached"][0] <= 0.5
    assert (out / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert shell("accuracy", out / "plant.toml", out / "schedule.csv", "--w", "0.02", "--v", "0.2").code == 0
    plan_file = tmp_path / "out" / "plan.json"
    result = shell("next", plan_file, "--now", "0.5", "-o", tmp_path / "out")
    assert result.code == 0
    assert "Next sample by " in result.out
    assert json.loads((tmp_path / "out" / "next.json").read_text())["proven"]
    other = ("-o", tmp_path / "b", "--compare", plan_file)
    again = shell("plan", tmp_path / "out" / "plant.toml", tmp_path / "wanted.toml", *other)
    assert "Both cost the same" in " ".join(again.out.split())
    assert (tmp_path / "b" / "comparison.png").read_bytes().startswith(b"\x89PNG")
    assert set(json.loads((tmp_path / "b" / "comparison.json").read_text())) >= {"before", "now"}
    wrong = shell("next", plan_file, "--now", "tomorrow")
    assert wrong.code == 2
    with pytest.raises(ArgumentError, match="`--now` must be a number of"):
        next_command(Settings("next"), plan_file, now="tomorrow")


def test_a_requirement_without_a_plant_needs_one(shell, tmp_path):
    (tmp_path / "wanted.toml").write_text(SMALL)
    result = shell("plan", tmp_path / "wanted.toml")
    assert result.code == 2
    assert "`PLANT` is missing" in result.err
    assert "Did you mean" not in result.err
    (tmp_path / "plant.toml").write_text("")
    near = f"Did you mean {tmp_path / 'plant.toml'} {tmp_path / 'wanted.toml'}?"
    assert near in shell("plan", tmp_path / "wanted.toml").err
    with pytest.raises(ArgumentError, match="is a requirement that holds no plant"):
        plan(Settings("plan"), tmp_path / "wanted.toml")


def test_an_interrupt_writes_the_files_of_what_the_search_holds(shell, tmp_path, monkeypatch):
    keep = PlanSearch.keep

    def kept(search, chosen, worst):
        keep(search, chosen, worst)
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(PlanSearch, "keep", kept)
    (tmp_path / "wanted.toml").write_text(SMALL)
    before = signal.getsignal(signal.SIGINT)
    result = shell("plan", EXAMPLES / "plants" / "oscillator.toml", tmp_path / "wanted.toml", "-o", tmp_path / "out")
    signal.signal(signal.SIGINT, before)
    assert result.code == 130
    assert "certificate.json is not written: interrupted." in " ".join(result.err.split())
    assert json.loads((tmp_path / "out" / "plan.json").read_text())["status"] == "interrupted"
    assert (tmp_path / "out" / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_a_plan_without_dates_takes_no_date():
    undated = SimpleNamespace(requirement=SimpleNamespace(calendar=None), plant=SimpleNamespace(time_unit="s"))
    with pytest.raises(ArgumentError, match="`--now` must be a number of s, got 'tomorrow'"):
        _now(Settings("next"), undated, "tomorrow")
