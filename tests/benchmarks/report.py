"""Run every benchmark and write docs/benchmarks.md: `python tests/benchmarks/report.py`.

Times are medians over several rounds of one run on one machine, so that the ratios hold where the absolute
figures do not. First calls are benchmarks of their own.
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from collections import defaultdict
from datetime import date
from importlib.metadata import version
from pathlib import Path

HERE = Path(__file__).parent
TARGET = HERE.parents[1] / "docs" / "benchmarks.md"
LIBRARIES = ("numpy", "scipy", "cvxpy", "clarabel", "control")


def run(path: Path) -> list[dict]:
    """Return the benchmarks of one file; a failing benchmark ends the report."""
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        command = [sys.executable, "-m", "pytest", "-q", "-o", "addopts=--import-mode=importlib"]
        command += ["--benchmark-only", "--benchmark-min-rounds=5", f"--benchmark-json={result}", str(path)]
        subprocess.run(command, check=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, stdout=sys.stderr)
        return json.loads(result.read_text())["benchmarks"]


def duration(seconds: float) -> str:
    """Return a time with a unit that suits it."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds * 1e9:.3g} ns"


def table(benchmarks: list[dict]) -> list[str]:
    """Return a table; ratios are against the slowest benchmark with the same parameters."""
    groups = defaultdict(list)
    for entry in benchmarks:
        groups[entry["param"] or ""].append(entry)
    lines = [
        "| benchmark | case | median | times faster than the slowest of the case | rounds |",
        "|---|---|---|---|---|",
    ]
    for case, entries in groups.items():
        slowest = max(e["stats"]["median"] for e in entries)
        for e in entries:
            name = e["name"].split("[")[0].removeprefix("test_").replace("_", " ")
            median = e["stats"]["median"]
            ratio = f"{slowest / median:.3g}" if len(entries) > 1 else ""
            lines.append(f"| {name} | {case} | {duration(median)} | {ratio} | {e['stats']['rounds']} |")
    return lines


def main() -> None:
    """Write the page."""
    lines = ["# Benchmarks", "", "Made by `python tests/benchmarks/report.py` with the `test` extra installed, "]
    lines[-1] += f"on {date.today()}."
    lines += [""]
    lines += [f"Python {platform.python_version()}, {os.cpu_count()} cores, {platform.machine()}; "]
    lines[-1] += ", ".join(f"{name} {version(name)}" for name in LIBRARIES) + ". One BLAS thread."
    for path in sorted(HERE.glob("bench_*.py")):
        summary = (path.read_text().split('"""')[1].strip().splitlines() or [""])[0]
        title = path.stem.removeprefix("bench_").replace("_", " ").capitalize()
        lines += ["", f"## {title}", "", summary, "", *table(run(path))]
    TARGET.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
