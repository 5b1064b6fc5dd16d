"""The version, printed before anything that reads the other flags is imported."""

from __future__ import annotations

import sys

from sampling_design import __version__


def show_version(asked: bool) -> None:
    """Print the version and leave, where it was asked for."""
    if asked:
        sys.stdout.write(f"sampling-design {__version__}\n")
        sys.stdout.flush()
        sys.exit(0)
