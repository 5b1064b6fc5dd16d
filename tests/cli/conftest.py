"""Runs the command line in this process, as a shell would see it."""

import sys
from collections import namedtuple

import pytest

Outcome = namedtuple("Outcome", "code out err")


@pytest.fixture
def shell(capsys, monkeypatch):
    """Return run(*arguments) -> Outcome(exit code, stdout, stderr)."""
    from sampling_design.cli import main

    def run(*arguments) -> Outcome:
        monkeypatch.setattr(sys, "argv", ["sampling-design", *map(str, arguments)])
        with pytest.raises(SystemExit) as stop:
            main()
        out, err = capsys.readouterr()
        return Outcome(stop.value.code or 0, out, err)

    return run
