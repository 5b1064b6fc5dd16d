"""Every command that draws can leave its picture out, by the same flag."""

import pytest

import sampling_design as sd
from sampling_design.cli import estimate as estimate_command
from sampling_design.cli.estimate import EstimateOptions
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError


def test_the_flag_leaves_out_the_picture_and_nothing_else(shell, tmp_path):
    schedule = sd.schedules.write_schedule(sd.PeriodicSchedule([1.0, 1.2], time_unit="s"), tmp_path / "schedule.csv")
    for name, words in {
        "sigma": ("examples/plants/oscillator.toml", schedule),
        "worst-case": ("examples/plants/oscillator.toml", "--window", "4", "--count", "3", "--spacing", "0.5"),
    }.items():
        outcome = [
            shell(name, *words, "-o", tmp_path / f"{name}{flag}", *flag.split()).code for flag in ("", "--no-picture")
        ]
        files = [{p.name for p in (tmp_path / f"{name}{flag}").iterdir()} for flag in ("", "--no-picture")]
        assert outcome[0] == outcome[1]
        assert files[0] - files[1] == {p for p in files[0] if p.endswith(".png")} != set()


def test_a_tube_without_a_picture_is_refused(tmp_path):
    for settings in (Settings("estimate"), Settings("estimate", output=tmp_path, no_picture=True)):
        with pytest.raises(ArgumentError, match="`--tube` is for the picture: give a folder for it"):
            estimate_command.estimate(
                settings, tmp_path / "plant.toml", tmp_path / "y.csv", how=EstimateOptions(tube=True)
            )
