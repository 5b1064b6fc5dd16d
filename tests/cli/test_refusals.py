"""What the command line itself refuses, in its own words."""

from pathlib import Path

import pytest

from sampling_design.cli import reading
from sampling_design.cli.plan import design
from sampling_design.cli.settings import Settings
from sampling_design.cli.what_if import _counts
from sampling_design.errors import ArgumentError, FileFormatError

OSCILLATOR = Path(__file__).parents[2] / "examples" / "plants" / "oscillator.toml"


def test_counts():
    assert _counts("2,4-6") == [2, 4, 5, 6]
    with pytest.raises(ArgumentError, match="`--counts` must look like 8,10,12 or 8-16"):
        _counts("3-")
    with pytest.raises(ArgumentError, match="`--counts` must name at least one number"):
        _counts("")


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ArgumentError, match="cannot be made a folder"):
        Settings(output=tmp_path / "file" / "out").folder()


def test_a_calendar_without_a_folder():
    with pytest.raises(ArgumentError, match="writes a calendar, so it needs a folder"):
        design(Settings(quiet=True), OSCILLATOR, samples=3, start="2026-01-05")


FOLDERS = ("plants", "requirements", "data", "plans")
PLANTS, REQUIREMENTS, DATA, PLANS = (OSCILLATOR.parents[1] / folder for folder in FOLDERS)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("info", REQUIREMENTS / "oscillator.toml"), "is a requirement file, expected a plant file"),
        (("design", REQUIREMENTS / "oscillator.toml", OSCILLATOR), "is a requirement file, expected a plant file"),
        (("design", OSCILLATOR, OSCILLATOR), "is a plant file, expected a requirement file"),
        (("plan", OSCILLATOR), "is a plant file, expected a plan requirement file"),
        (("next", OSCILLATOR), "is a plant file, expected a plan file"),
        (("info", PLANS / "oscillator.toml"), "is a plan requirement file, expected a plant file"),
        (("sigma", OSCILLATOR, OSCILLATOR), "is a plant file, expected a schedule file"),
        (("sigma", OSCILLATOR, DATA / "satellite.csv"), "is a measurement file, expected a schedule file"),
        (("estimate", PLANTS / "satellite.toml", OSCILLATOR), "is a plant file, expected a measurement file"),
        (("certify", DATA / "satellite.csv", OSCILLATOR), "is a measurement file, expected a plant file"),
        (("robustness", OSCILLATOR, OSCILLATOR), "is a plant file, expected a certificate file"),
        (("verify", REQUIREMENTS / "oscillator.toml"), "is a requirement file, expected a certificate file"),
    ],
)
def test_files_in_the_wrong_place_are_named_as_what_they_are(shell, arguments, words):
    result = shell(*arguments, "--quiet")
    assert result.code == 2
    assert words in result.err
    assert "Are the arguments in their order?" in result.err


def test_a_file_in_the_wrong_place_is_an_error_of_the_file():
    with pytest.raises(FileFormatError, match="is a plant file, expected a schedule file"):
        reading.schedule(OSCILLATOR)
