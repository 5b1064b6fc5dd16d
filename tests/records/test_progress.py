"""A bar for every verb that tells its progress: drawn in a terminal, silent elsewhere."""

import io

import pytest
from rich.console import Console

import sampling_design as sd
from sampling_design.records import budget


@pytest.mark.parametrize("terminal", [False, True])
def test_a_bar_is_drawn_in_a_terminal_only(terminal, monkeypatch):
    written = io.StringIO()
    console = Console(file=written, force_terminal=terminal, width=100)
    monkeypatch.setattr("rich.console.Console", lambda **_: console)
    told = []
    with budget.progress_bar("design") as bar:
        sd.design_schedule(
            sd.named_plant("oscillator"),
            starts=1,
            branches=0,
            progress=lambda share, text: (told.append(text), bar(share, text)),
        )
    assert told
    assert ("design" in written.getvalue()) == terminal
    assert ("bound" in written.getvalue()) == terminal
