"""What the command line itself refuses, in its own words."""

from pathlib import Path

import pytest

from sampling_design.cli.explore import _counts
from sampling_design.cli.plan import design
from sampling_design.cli.settings import Settings
from sampling_design.errors import ArgumentError

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
