"""Whatever the files and the flags, a command ends with 0, 1, 2 or 3 and says why: never a traceback, never a hang.

`python -m tests.command_lines 300 7` runs as many as one likes.
"""

import pytest

from sampling_design.cli.app import app
from tests import command_lines


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_random_command_lines_end_in_order(seed, tmp_path, monkeypatch):
    lines = command_lines.drawn(10, seed)
    monkeypatch.chdir(tmp_path)
    raw = {" ".join(line): found for line in lines if (found := command_lines.run(line).raw())}
    assert raw == {}


def test_every_command_is_among_them():
    assert set(command_lines.COMMANDS) == {command.name for command in app.registered_commands}


def test_the_sweep_sees_what_is_raw():
    assert command_lines.Ended(70, "", "x").raw()
    assert command_lines.Ended(1, "", "").raw()
    assert command_lines.Ended(2, "", "Traceback (most recent call last)").raw()
    assert not command_lines.Ended(2, "", "one sentence").raw()
