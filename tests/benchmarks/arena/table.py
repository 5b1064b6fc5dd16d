"""What a task returns, how it is timed, and which peers are there."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

Cell = str | float | int | None
PINS = dict(line.split("==") for line in (Path(__file__).parent / "peers.txt").read_text().splitlines() if "==" in line)


@dataclass
class Table:
    """One task: its question, a row per method, what was found, and figures by name."""

    title: str
    question: str
    columns: tuple[str, ...]
    rows: list[tuple[Cell, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)

    def add(self, *cells: Cell) -> None:
        """Append a row."""
        if len(cells) != len(self.columns):
            raise ValueError(f"{len(self.columns)} cells expected, got {len(cells)}")
        self.rows.append(cells)

    def missing(self, case: str, peer: str, module: str) -> bool:
        """Append a row that says that a peer is not installed, and return whether that is so."""
        gone = find_spec(module) is None
        if gone:
            self.add(case, f"{peer}: not installed", *[None] * (len(self.columns) - 2))
        return gone


def named(peer: str) -> str:
    """Return a peer's name with its version, and the pinned one where it differs."""
    try:
        found = version(peer)
    except PackageNotFoundError:
        return f"{peer} (not installed)"
    pinned = PINS.get(peer, found)
    return f"{peer} {found}" + ("" if found == pinned else f" (pinned {pinned})")


def seconds_of(work: Callable[[], Any], least: int = 3, budget: float = 1.0) -> float:
    """Return the median processor time of a call, over as many calls as the budget allows, at least `least`."""
    times: list[float] = []
    while len(times) < least or (sum(times) < budget and len(times) < 200):
        before = time.process_time()
        work()
        times.append(time.process_time() - before)
    return statistics.median(times)


def duration(seconds: float) -> str:
    """Return a time with a unit that suits it."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"
