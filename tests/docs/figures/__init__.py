"""Figures in the running text of pages and what each comes from: a module per page, its `FIGURES`."""

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules

TABLE = r"\| {} \| (\d*\.?\d+) \|"
NUMBER = r"(\d*\.?\d+)"


@dataclass(frozen=True)
class Figure:
    """Numbers in the text of a page: each group of the pattern is one, and `made` returns them.

    A blank of the pattern is any white space: a sentence may be broken anew. `slow` is what takes over .2 s.
    """

    page: str
    pattern: str
    made: Callable[[], tuple[float, ...]]
    slow: bool = False


def all_figures() -> tuple[Figure, ...]:
    """What the modules beside this one list."""
    modules = (import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__))
    return tuple(figure for module in modules for figure in module.FIGURES)
