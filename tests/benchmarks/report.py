"""Run every benchmark and write docs/benchmarks.md: `python tests/benchmarks/report.py`, or some: `... worst_case`.

Times are medians of process time over several rounds of one run on one machine, so that the ratios hold where the
absolute figures do not, beside other work too. First calls are benchmarks of their own.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import numpy as np

HERE = Path(__file__).parent
TARGET = HERE.parents[1] / "docs" / "benchmarks.md"
LIBRARIES = ("numpy", "scipy", "cvxpy", "clarabel", "control")
COMPARED = {
    "rows through modal blocks": "rows by a loop over scipy",
    "rows through modal blocks first call": "rows by a loop over scipy",
    "rows by scaling and squaring": "rows by a loop over scipy",
    "window solve": "window solve by orthogonal factors",
}
"""What answers the same question of the same data, and what it is compared with; first calls prepare later ones."""


def run(path: Path) -> list[dict]:
    """Return the benchmarks of one file; a failing benchmark ends the report."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        command = [sys.executable, "-m", "pytest", "-q", "-o", "addopts=--import-mode=importlib"]
        command += ["--benchmark-timer=time.process_time"]  # by the clock, other work would decide the ratios
        command += ["--benchmark-only", "--benchmark-min-rounds=5", f"--benchmark-json={result}", str(path)]
        subprocess.run(command, check=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, stdout=sys.stderr)
        return json.loads(result.read_text())["benchmarks"]


def duration(seconds: float) -> str:
    """Return a time with a unit that suits it."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def rate(seconds: float) -> str:
    """Return how often that fits into a time that a person knows."""
    for unit, size in (("a second", 1.0), ("a minute", 60.0), ("an hour", 3600.0)):
        if size >= 2 * seconds:
            return f"{round(size / seconds, 1 - int(np.log10(size / seconds))):,.0f} {unit}"
    return ""


def times(ratio: float) -> str:
    """Return a factor as a person says it, in two digits: "1.3 times", "170 times"."""
    said = float(f"{ratio:.2g}")
    return f"{said:,.0f} times" if said >= 10 else f"{said:.2g} times"


class Measured(NamedTuple):
    """One benchmark: its name, its parameters, seconds and rounds."""

    name: str
    case: str
    median: float
    rounds: int


def table(found: list[Measured]) -> list[str]:
    """Return a table, case by case; what answers the same question stands beside what it is compared with."""
    rows = [("what is done", "of what", "one call takes", "calls", "compared", "rounds")]
    for of in dict.fromkeys(each.case for each in found):
        medians = {each.name: each.median for each in found if each.case == of}
        for name, _, median, rounds in (each for each in found if each.case == of):
            other = COMPARED.get(name)
            beside = f"{times(medians[other] / median)} as fast as {other}" if other in medians else ""
            rows.append((name, of, duration(median), rate(median), beside, str(rounds)))
    columns = [column for column in zip(*rows, strict=True) if any(column[1:])]  # an empty one says nothing
    lines = ["| " + " | ".join(row) + " |" for row in zip(*columns, strict=True)]
    return [lines[0], "|" + "---|" * len(columns), *lines[1:]]


def measured(entry: dict) -> Measured:
    """One benchmark as the library for benchmarks tells it."""
    name = entry["name"].split("[")[0].removeprefix("test_").replace("_", " ")
    return Measured(name, case(entry), entry["stats"]["median"], entry["stats"]["rounds"])


def case(entry: dict) -> str:
    """What a benchmark was asked of: its words, or its numbers with their names."""
    told, given = entry["param"] or "", entry["params"] or {}
    if told == "None":
        return f"{next(iter(given))} not given"
    if len(given) == 1 and told[:1].isdigit() and " " not in told:
        return f"{next(iter(given))} {told}"
    return told.replace("-", ", ") if len(given) > 1 else told


def beside(page: str) -> dict[str, list[str]]:
    """What stands after the first table of each section of the page: words of people, their tables and links."""
    found = {}
    for section in page.split("\n## ")[1:]:
        title, *lines = section.rstrip().split("\n")
        rows = [k for k, line in enumerate(lines) if line.startswith("|")]
        end = next((k for k in rows if k + 1 not in rows), len(lines) - 1)  # of the first table: others are of people
        found[title] = lines[end + 1 :]
    return found


def main(asked: list[str]) -> None:
    """Write the page, or the tables that are asked for anew; what people wrote after a table stays there."""
    page = TARGET.read_text() if TARGET.exists() else ""
    kept = beside(page)
    before = {section.split("\n")[0]: section.rstrip().split("\n") for section in page.split("\n## ")[1:]}
    lines = ["# Benchmarks", "", "Made by `python tests/benchmarks/report.py` with the `test` extra installed, "]
    lines[-1] += "all figures of a table within one run; paragraphs with a command of their own were run apart."
    lines += [""]
    lines += [f"Python {platform.python_version()}, {os.cpu_count()} cores, {platform.machine()}; "]
    lines[-1] += ", ".join(f"{name} {version(name)}" for name in LIBRARIES) + ". One BLAS thread."
    for path in sorted(HERE.glob("bench_*.py")):
        if "\ndef test_" not in path.read_text():  # run apart, with a command of its own
            continue
        summary = (path.read_text().split('"""')[1].strip().splitlines() or [""])[0]
        title = path.stem.removeprefix("bench_").replace("_", " ").capitalize()
        if asked and title in before and path.stem.removeprefix("bench_") not in asked:
            lines += ["", f"## {before[title][0]}", *before[title][1:]]
            continue
        lines += ["", f"## {title}", "", f"{summary} Measured on {date.today()}.", ""]
        lines += table([measured(entry) for entry in run(path)])
        lines += kept.get(title, [])
    TARGET.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
