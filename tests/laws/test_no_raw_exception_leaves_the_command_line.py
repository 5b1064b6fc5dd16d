"""Whatever the files and the flags, a command ends with 0, 1, 2 or 3 and says why: never a traceback, never a hang.

`python -m tests.command_lines 300 7 wrong` runs as many as one likes.
"""

import pytest

from sampling_design.cli.app import COMMANDS
from tests import command_lines


def raw(lines):
    """The command lines that do not end in order, and what they said."""
    return {" ".join(line): found for line in lines if (found := command_lines.run(line).raw())}


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_random_command_lines_end_in_order(seed, tmp_path, monkeypatch):
    lines = command_lines.drawn(10, seed)
    monkeypatch.chdir(tmp_path)
    assert raw(lines) == {}


QUICK = {"info", "verify", "compare"}
"""Commands that end at once."""


def test_what_is_wrong_with_a_command_line_is_said(tmp_path, monkeypatch):
    """Something wrong in each, drawn from the arguments and options that the commands declare."""
    monkeypatch.chdir(tmp_path)
    lines = [line for line in command_lines.wrong(20, 8) if line[0] in QUICK][:3]
    assert raw(lines) == {}


@pytest.mark.long
@pytest.mark.parametrize("part", range(30))
def test_what_is_wrong_with_any_command_line_is_said(part, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert raw(command_lines.wrong(300, 7)[10 * part : 10 * part + 10]) == {}


def test_every_option_of_every_command_is_spoilt():
    drawn = command_lines.wrong(8000, 8)
    for name in command_lines.COMMANDS:
        spoilt = {part.split("=")[0] for line in drawn if line[0] == name for part in line}
        assert {flag for option in command_lines.options(name) for flag in option.opts} <= spoilt, name


def test_every_command_is_among_them():
    assert set(command_lines.COMMANDS) == set(COMMANDS)


def test_the_sweep_sees_what_is_raw():
    assert command_lines.Ended(70, "", "x").raw()
    assert command_lines.Ended(1, "", "").raw()
    assert command_lines.Ended(2, "", "Traceback (most recent call last)").raw()
    assert not command_lines.Ended(2, "", "one sentence").raw()
