"""Which `raise` of the package a test run has raised: a whole run tells those that none of its tests has.

The house's exceptions note from where they are made; the `raise` is the statement in which that line lies, there or up
to four calls above (`raise refused(...)`). What a run starts in processes of its own does not count.
"""

from __future__ import annotations

import ast
import functools
import importlib
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest

PACKAGE = Path(__file__).parents[1] / "sampling_design"
ROOTS = {
    "errors": "SamplingDesignError",
    "checkers.strict": "BadFile",
    "checkers.outcome": "Refused",
    "explorer.server": "ConnectionOver",
    "records.budget": "BudgetSpentError",
    "design.problem.interrupt": "DesignInterrupt",
}
"""Every exception that the house defines is one of these or inherits from one (a test walks the package)."""
OTHERS = {"NotImplementedError", "AttributeError", "KeyboardInterrupt", "typer.Exit", "typer.BadParameter"}
OTHERS |= {"_absent", "TypeError", "ArithmeticError", "OverflowError", "IndexError", "np.linalg.LinAlgError"}
"""Exceptions of others, and a function that returns one: they note nothing."""
BLOCKS = ("body", "handlers", "orelse", "finalbody", "cases")
"""Where a statement, or a part of one, holds others."""
RAISE = re.compile(r"\braise\s+\S")
"""In every line in which one of the statements begins, and in others."""
DEEP = 5
MOST_UNRAISED = 0
"""Of a whole run; never raise it."""
Place = tuple[str, int]
SEEN: set[Place] = set()


def watch() -> None:
    """Note from now on from where the house's exceptions are made."""
    for module, name in ROOTS.items():
        kind = getattr(importlib.import_module(f"sampling_design.{module}"), name)
        if "__new__" not in vars(kind):
            kind.__new__ = _noting(kind)


def _noting(kind: type) -> Any:
    @functools.wraps(vars(kind).get("__init__", kind.__init__))  # what the class takes, as it says itself
    def made(cls: type, *arguments: Any, **named: Any) -> Any:
        frame: Any = sys._getframe(1)
        for _ in range(DEEP):
            if frame is None:
                break
            SEEN.add((frame.f_code.co_filename, frame.f_lineno))
            frame = frame.f_back
        return super(kind, cls).__new__(cls, *arguments)  # type: ignore[misc]

    return made


def statements(tree: ast.AST) -> Iterator[ast.Raise]:
    """Every `raise` that makes an exception of the house: not one again, and not one that it caught or was handed."""
    inside = [tree]
    for node in inside:  # no expression holds a statement: to walk them all took eight times as long
        inside += [part for name in BLOCKS for part in getattr(node, name, ())]
        if isinstance(node, ast.Raise) and node.exc is not None:
            made = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            name = ast.unparse(made)
            of_a_class = isinstance(node.exc, ast.Call | ast.IfExp) or name.lstrip("_")[:1].isupper()
            if of_a_class and name not in OTHERS:
                yield node


def raises(text: str) -> Iterator[set[int]]:
    """The lines of everything that may be a `raise`: what follows further in, and a bracket that closes, belong to it.

    Never more than the statement has; where it has more, the file is parsed.
    """
    lines = text.split("\n")
    for first, line in enumerate(lines):
        if RAISE.search(line):
            indent, last = line[: len(line) - len(line.lstrip())], first
            while last + 1 < len(lines) and re.match(rf"{indent}(\s+\S|[)\]}}])", lines[last + 1]):
                last += 1
            yield set(range(first + 1, last + 2))


def unraised(paths: Iterable[Path], seen: set[Place]) -> list[str]:
    """Every `raise` in these files in which no line lies that was seen."""
    found, lines_of = [], defaultdict(set)
    for name, line in seen:
        lines_of[name].add(line)
    for path in paths:
        lines, text = lines_of[str(path)], path.read_text()
        if all(lines & places for places in raises(text)):  # so it is for most; to parse them all takes a second
            continue
        for node in statements(ast.parse(text)):
            if not lines & set(range(node.lineno, (node.end_lineno or node.lineno) + 1)):
                found.append(
                    f"{path.relative_to(PACKAGE.parent) if path.is_relative_to(PACKAGE) else path.name}:{node.lineno}"
                )
    return found


class Raised:
    """The pytest plugin: gathers what the processes of a run have seen, and judges a whole one."""

    def __init__(self, whole: bool) -> None:
        self.whole, self.missing = whole, list[str]()

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any) -> None:
        """Take over what a process of a distributed run has seen."""
        SEEN.update((name, line) for name, line in getattr(node, "workeroutput", {}).get("raised", ()))

    def pytest_deselected(self) -> None:
        """Note that this is no whole run."""
        self.whole = False

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Hand over what was seen, or judge it."""
        if hasattr(session.config, "workeroutput"):
            here = str(PACKAGE)
            session.config.workeroutput["raised"] = [place for place in SEEN if place[0].startswith(here)]
        elif self.whole:
            self.missing = unraised(sorted(PACKAGE.rglob("*.py")), SEEN)
            if len(self.missing) > MOST_UNRAISED:
                session.exitstatus = pytest.ExitCode.TESTS_FAILED

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Name them."""
        if self.missing:
            terminalreporter.section("raised by no test")
            for place in self.missing:
                terminalreporter.line(place, red=len(self.missing) > MOST_UNRAISED)


def register(config: pytest.Config, runs_tests: bool = True) -> None:
    """Watch a run of everything, in this process and in those of pytest-xdist."""
    told = getattr(config, "workerinput", None)
    everything = config.args_source == config.ArgsSource.TESTPATHS and not config.getoption("--long")
    if told["everything"] if told is not None else everything:
        if runs_tests:
            watch()
        config.pluginmanager.register(Raised(told is None), "raised")
