"""Every result that a program reads names its format, on stdout and in the file."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from sampling_design import PlanRequirement, Plant, certify, plan_samples, read_plant, read_schedule
from sampling_design.planning.requirement_file import write_plan_requirement
from sampling_design.plants import write_plant
from tests.cases import few

EXAMPLES = Path(__file__).parents[2] / "examples"
OSCILLATOR = EXAMPLES / "plants" / "oscillator.toml"
RULE = ("--window", 4.0, "--count", 3, "--spacing", 0.5)
COMMANDS = {
    "info": (OSCILLATOR,),
    "plan": ("tank.toml", "wanted.toml", "--search-seconds", 0.2),
    "next": ("plan.json", "--now", 7),
    "design": (OSCILLATOR, "--window", 4.0, "--samples", 3, "--branches", 0),
    "sigma": (OSCILLATOR, "schedule.csv", "--window", 4.0),
    "worst-case": (OSCILLATOR, *RULE),
    "pareto": (OSCILLATOR, "requirement.toml", "--counts", "3"),
    "losses": (OSCILLATOR, "requirement.toml"),
    "certify": (OSCILLATOR, "schedule.csv", "--eta", 0.4),
    "verify": ("certificate.json",),
    "accuracy": (OSCILLATOR, "schedule.csv", "--w", 0.02, "--v", 0.4),
    "robustness": (OSCILLATOR, "certificate.json", "--longest", 2, "--budget", 0.3),
    "estimate": (OSCILLATOR, "readings.csv", "--horizon", 3),
    "validate": (OSCILLATOR, "schedule.csv", "--runs", 3, "--eta", 0.4, "--duration", 6),
    "compare": (OSCILLATOR, "schedule.csv", "readings.csv"),
}
NAMED = {
    "design": "design",
    "certify": "certificate",
    "validate": "validation",
    "compare": "schedule-log",
    "estimate": "estimate",
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The files that commands read, made once."""
    made = tmp_path_factory.mktemp("made")
    (made / "schedule.csv").write_text("# sampling-design schedule; time_unit=s; period=2.0\ntime\n0.5\n1.3\n")
    (made / "requirement.toml").write_text('format = "sampling-design/requirement/1"\nwindow = 4.0\nsamples = 3\n')
    (made / "readings.csv").write_text("time,position,force_per_mass\n0.5,1.0,0.0\n1.3,0.5,0.0\n2.5,0.1,0.0\n")
    tank = Plant([[0.0]], [[1.0]], states=["level"], outputs=["gauge"])
    read = {"gauge": {"noise_bound": 0.1}}
    wanted = PlanRequirement({"level": 0.52}, period=8.0, grid=1.0, w_bound=0.1, sensors=read)
    write_plant(tank, made / "tank.toml")
    write_plan_requirement(wanted, made / "wanted.toml")
    plan_samples(tank, wanted, certificate=False, robustness=False, from_start=False).save(made / "plan.json")
    certify(read_plant(OSCILLATOR), read_schedule(made / "schedule.csv"), eta=0.4, P2=np.eye(2)).save(
        made / "certificate.json"
    )
    return made


@pytest.fixture
def folder(tmp_path, monkeypatch, made):
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("command", few(COMMANDS, 0, 2, 4, 8, 9, 11, 14))
def test_a_command_names_the_format_of_what_it_prints_and_writes(command, folder, shell):
    done = shell(command, *COMMANDS[command], "--json", "--quiet", "-o", "out")
    assert done.code in (0, 1), done.err
    shown = json.loads(done.out)
    assert next(iter(shown)) == "format"
    assert shown["format"] == f"sampling-design/{NAMED.get(command, command)}/1"
    for path in (folder / "out").glob("*.json"):
        assert re.fullmatch(r"sampling-design/[a-z-]+/1", json.loads(path.read_text())["format"]), path.name


def test_no_command_was_forgotten():
    from sampling_design.cli import app

    assert set(app.COMMANDS) == {*COMMANDS, "thyroid", "new", "explore"}  # looked at in files of their own


ALONE = ["sigma", "accuracy --w 0.1 --v 0.1", "validate --runs 1 --duration 30", "certify"]


def test_no_command_of_a_schedule_refuses_a_plan_alone():
    from sampling_design.cli import app

    takes = {name for name in app.COMMANDS if any(p.metavar == "SCHEDULE" for p in app.loaded(name).params)}
    assert takes == {"compare", *(line.split()[0] for line in ALONE)}  # compare in a file of its own


@pytest.mark.parametrize("command", ALONE)
def test_a_plan_stands_for_plant_and_schedule(shell, folder, command):
    name, *flags = command.split()
    one, two = (shell(name, *["plan.json"] * count, *flags, "--json") for count in (1, 2))
    assert (one.code, one.out) == (two.code, two.out)
    missing = shell(name, "tank.toml", *flags)
    assert missing.code == 2
    assert "`SCHEDULE` is missing: give its file, or a plan (plan.json) for PLANT" in missing.err
