"""Independent checkers of certificate files: standard library and numpy only, copyable as this folder stands."""

from .check import check, verdict

__all__ = ["check", "verdict"]
