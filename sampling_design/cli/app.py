"""The application: its commands."""

from __future__ import annotations

from typing import Annotated

import typer

from sampling_design.cli import accuracy, explore, new, plan, planning, prove, thyroid, track, what_if
from sampling_design.cli.settings import _version, with_common_flags

app = typer.Typer(
    name="sampling-design",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="When to measure a plant that is measured rarely, what that proves, and what the state is.",
    epilog="Exit codes: 0 done and the claim holds; 1 the mathematics says no; 2 bad input or usage; "
    "3 a solver failed or a budget ran out; 70 a defect of this program; 130 interrupted.",
)
for command in (
    *new.COMMANDS,
    *plan.COMMANDS,
    *planning.COMMANDS,
    *prove.COMMANDS,
    *what_if.COMMANDS,
    *accuracy.COMMANDS,
    *explore.COMMANDS,
    *track.COMMANDS,
    *thyroid.COMMANDS,
):
    app.command(name=command.__name__.replace("_", "-"))(with_common_flags(command))


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Design sampling schedules, certify them, and estimate the state from rare measurements."""
