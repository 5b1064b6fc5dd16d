"""The command line: each command reads its arguments, calls one verb and prints its record."""

from sampling_design.cli.exit_codes import main

__all__ = ["main"]
