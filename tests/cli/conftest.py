"""Runs the command line in this process, as a shell would see it."""

import sys
from collections import namedtuple

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imsave

Outcome = namedtuple("Outcome", "code out err")


@pytest.fixture
def pixels():
    """Pictures of this test are painted, every letter of them."""


@pytest.fixture(autouse=True)
def _drawn(request, monkeypatch):
    """Pictures are drawn whole; but to paint one takes .2 s, and what is painted is one point where nobody looks."""
    if "pixels" not in request.fixturenames:
        point = np.zeros((1, 1, 3))
        monkeypatch.setattr(Figure, "savefig", lambda _, file, metadata, **how: imsave(file, point, metadata=metadata))


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
