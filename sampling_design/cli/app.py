"""The application: its commands, and how every error ends (one sentence on stderr and an exit code)."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from sampling_design.cli import explore, plan, prove, thyroid, track
from sampling_design.cli.settings import _version, with_common_flags
from sampling_design.errors import SamplingDesignError

app = typer.Typer(
    name="sampling-design",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="When to measure a plant that is measured rarely, what that proves, and what the state is.",
    epilog="Exit codes: 0 done and the claim holds; 1 the mathematics says no; 2 bad input or usage; "
    "3 a solver failed or a budget ran out; 130 interrupted.",
)
for command in (*plan.COMMANDS, *explore.COMMANDS, *prove.COMMANDS, *track.COMMANDS, *thyroid.COMMANDS):
    app.command(name=command.__name__.replace("_", "-"))(with_common_flags(command))


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Design sampling schedules, certify them, and estimate the state from rare measurements."""


def main() -> None:
    """Run the command line; every expected error is one sentence on stderr."""
    try:
        app(standalone_mode=True)
    except SamplingDesignError as error:
        sys.stderr.write(f"sampling-design: {error}\n")
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.stderr.write("sampling-design: interrupted.\n")
        sys.exit(130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)
