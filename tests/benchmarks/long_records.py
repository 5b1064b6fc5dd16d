"""Long records on the command line: seconds and memory of `log` and `estimate` against the rows of the file.

python -m tests.benchmarks.long_records [COMMAND ROWS ...] writes docs/long_records.md, or those rows in it
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from datetime import date
from pathlib import Path

import numpy as np

HERE = Path(__file__).parents[2]
PAGE = HERE / "docs" / "long_records.md"
PLANT = HERE / "examples" / "plants" / "oscillator.toml"
SIZES = {"log": (10_000, 100_000, 300_000, 1_000_000), "estimate": (10_000, 100_000)}
SCHEDULE = "# sampling-design schedule; time_unit=s; period=1.0\ntime\n1.0\n"
LOOP = 5_000_000


def recorded(command: str, rows: int, path: Path) -> None:
    """A record of the oscillator: samples within a tenth of whole seconds, one in a thousand missed; or any gaps."""
    rng = np.random.default_rng(1)
    if command == "log":
        t = np.arange(1.0, rows + 1)
        t = t[rng.random(rows) > 1e-3]
        t = t + rng.uniform(-0.1, 0.1, t.size)
    else:
        t = np.cumsum(rng.uniform(0.8, 1.6, rows))
    y = np.sin(t) + (0.05 * rng.standard_normal(t.size) if command == "estimate" else 0.0)
    with path.open("w") as file:
        file.write("time,position,force_per_mass\n0.0,,0.0\n")
        file.writelines(f"{float(a)!r},{float(b)!r},0.0\n" for a, b in zip(t, y, strict=True))


def spent(arguments: list[str]) -> tuple[float, float]:
    """Processor seconds and the most memory, in MB, of one run of the command line."""
    with subprocess.Popen(
        [sys.executable, "-m", "sampling_design", *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    ) as process:
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, arguments
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def loop() -> float:
    """Processor seconds of an empty loop: how fast the machine is just now."""
    began = time.process_time()
    for _ in range(LOOP):
        pass
    return time.process_time() - began


def row(command: str, rows: int) -> str:
    """One row of the table."""
    with tempfile.TemporaryDirectory() as folder:
        record, schedule = Path(folder) / "record.csv", Path(folder) / "schedule.csv"
        recorded(command, rows, record)
        schedule.write_text(SCHEDULE)
        plan = [str(schedule)] if command == "log" else []
        seconds, size = spent([command, str(PLANT), *plan, str(record), "-o", str(Path(folder) / "out")])
    return (
        f"| `{command}` | {rows:,} | {seconds:.1f} s | {1e6 * seconds / rows:.0f} µs | {size:.0f} MB | {loop():.2f} s |"
    )


def main(given: list[str]) -> None:
    """Measure all rows, or those that are named, and write the page; the others stay as they are."""
    every = [(command, rows) for command, sizes in SIZES.items() for rows in sizes]
    asked = list(zip(given[::2], map(int, given[1::2]), strict=True)) or every
    lines = PAGE.read_text().splitlines() if PAGE.exists() else []
    known = {
        tuple(line.replace("`", "").replace(",", "").split(" | ")[:2]): line for line in lines if line[:3] == "| `"
    }
    for command, rows in asked:
        line = row(command, rows)
        print(line, flush=True)
        known[f"| {command}", str(rows)] = line
        text = ["# Long records", "", __doc__.split("\n\n")[0], ""]
        text += [f"Made by `python -m tests.benchmarks.long_records`, last on {date.today()}; with pictures and files"]
        text += [
            f"(`-o`), two states, {os.cpu_count()} cores, one BLAS thread. Processor seconds; the last column is what"
        ]
        text += [
            f"an empty loop of {LOOP:,} turns took just after, by which figures of other days can be compared.",
            "",
        ]
        text += ["| command | rows | processor time | per row | most memory | loop |", "|---|---|---|---|---|---|"]
        text += [known[f"| {c}", str(n)] for c, n in every if (f"| {c}", str(n)) in known]
        PAGE.write_text("\n".join(text) + "\n")


if __name__ == "__main__":
    main(sys.argv[1:])
