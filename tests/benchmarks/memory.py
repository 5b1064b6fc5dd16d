"""What the commands take: most memory and processor time of each, on the example of its help, on the largest of the
examples, and on long records; and what verbs of Python take of large inputs.

python -m tests.benchmarks.memory [ROW ...] writes docs/memory.md, or those rows in it
"""

from __future__ import annotations

import math
import os
import random
import re
import shlex
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

from tests.benchmarks.pages import MeasuredPage, Table

HERE = Path(__file__).parents[2]
COMMANDS = ("new", "info", "design", "pareto", "losses", "plan", "next", "explore", "sigma", "worst-case", "certify")
COMMANDS += ("robustness", "verify", "accuracy", "estimate", "validate", "compare", "thyroid")
ENDING = {"explore": ["--idle", "0.5", "--no-browser"]}
"""A server ends by itself only when nobody asks for long."""
GAUGE, SATELLITE = (f"examples/plants/{name}.toml" for name in ("tidal_gauge", "satellite"))
TIDAL, ORBITS = (f"{plant} {plant.replace('plants', 'requirements')}" for plant in (GAUGE, SATELLITE))
LARGEST = {
    "info": f"info {GAUGE} -o out",
    "design": f"design {TIDAL} -o out",
    "pareto": f"pareto {ORBITS} --counts 11-12 --budget 20 -o out/front",
    "losses": f"losses {ORBITS} --budget 20",
    "plan": "plan examples/plans/satellite_passes.toml --search-seconds 5 -o out/passes",
    "next": "next out/passes/plan.json",
    "explore": f"explore {TIDAL} -o out",
    "sigma": f"sigma {GAUGE} out/schedule.csv --window 720",
    "worst-case": f"worst-case {SATELLITE} --window 5400 --count 12 --spacing 120 --budget 20",
    "certify": f"certify {SATELLITE} out/orbit/schedule.csv -o out/orbit",
    "robustness": f"robustness {SATELLITE} out/orbit/certificate.json --budget 20 -o out/orbit",
    "verify": "verify out/orbit/certificate.json --rigorous",
    "accuracy": f"accuracy {SATELLITE} out/orbit/schedule.csv --w 1e-6 --v 30 --budget 20 -o out/orbit",
    "estimate": f"estimate {SATELLITE} examples/data/satellite.csv -o out",
    "validate": f"validate {SATELLITE} out/orbit/schedule.csv --runs 50 -o out/orbit",
    "validate, two workers": f"validate {SATELLITE} out/orbit/schedule.csv --runs 50 --workers 2 -o out/orbit",
    "compare": f"compare {SATELLITE} out/orbit/schedule.csv examples/data/satellite.csv -o out/orbit",
    "thyroid": "thyroid --runs 1 --days 5 --reading per_day -o out",
}
"""Eleven tides read in a month, an orbit, a patient; `new` does not depend on the size of the plant."""
RECORDS = {
    f"{command}, {rows:,} rows": (command, rows)
    for command, sizes in {"compare": (10_000, 100_000, 1_000_000), "estimate": (10_000, 100_000)}.items()
    for rows in sizes
}
OSCILLATOR = HERE / "examples" / "plants" / "oscillator.toml"
SCHEDULE = "# sampling-design schedule; time_unit=s; period=1.0\ntime\n1.0\n"
LONGEST = 900.0


def recorded(command: str, rows: int, path: Path) -> None:
    """A record of the oscillator: samples within a tenth of whole seconds, one in a thousand missed; or any gaps."""
    rng, t = random.Random(1), 0.0
    with path.open("w") as file:
        file.write("time,position,force_per_mass\n0.0,,0.0\n")
        for k in range(1, rows + 1):
            t = k + rng.uniform(-0.1, 0.1) if command == "compare" else t + rng.uniform(0.8, 1.6)
            if command == "estimate" or rng.random() > 1e-3:
                y = math.sin(t) + (rng.gauss(0.0, 0.05) if command == "estimate" else 0.0)
                file.write(f"{t!r},{y!r},0.0\n")


CALLS = {
    "`run` of 100,000 rows, a filter": 'ran(100_000, "filter")',
    "`run` of 100,000 rows, a moving horizon": "ran(100_000)",
    "`smooth` of 30,000 rows": 'VERBS["smooth"].ready(30_000)',
    "`state_interval` of 5,000 rows": 'VERBS["state interval"].ready(5_000)',
    "`state_interval` of 5,000 rows, any start": "interval(2, 5_000, 1, False)",
    "`state_interval` of 1,000 rows, eight states": "interval(8, 1_000, 1, False, **BOUNDS)",
    "`state_interval` of 5,000 rows, eight states": "interval(8, 5_000, 1, False, **BOUNDS)",
    "file of an interval of 5,000 rows": 'VERBS["interval file"].ready(5_000)',
    "`certify` of 16 states, 40 samples": "certified(16, 40, 1, False, 0.05)",
    "`guaranteed_accuracy` of eight states, 20 samples": "accuracy(8, 20, 1, False)",
    "`design_schedule` of 40 undamped states, 24 samples": "designed(40, 24, 2)",
    "`standard_deviation` of 10,000 samples": "deviation(2, 10_000, 1, False)",
    "`window_sigma` of 100,000 samples": 'VERBS["sigma of all"].ready(100_000)',
    "`window_sigma` of 200 states, 200 samples": "sigma(200, 200, 50)",
    "`compare_schedule` of 100,000 samples": 'VERBS["log"].ready(100_000)',
    "`validate`, 1,000 trials": 'VERBS["trials"].ready(1_000)',
}
"""Verbs of `jumps.py`, made ready for large inputs."""


def measured(name: str) -> list[str]:
    """The same of one call in Python."""
    seconds, size = spent(["-c", f"from tests.benchmarks.jumps import *\n{CALLS[name]}()"], HERE)
    return [seconds, size]


def commanded(arguments: list[str], folder: Path) -> tuple[str, str]:
    """What one run of the command line takes."""
    return spent(["-m", "sampling_design", *arguments], folder)


def spent(words: list[str], folder: Path) -> tuple[str, str]:
    """Processor seconds and the most memory, in MB, of one run of Python; of several processes the largest.

    This process stays small: what it holds when it starts another counts for that one.
    """
    environment = {**os.environ, "PYTHONPATH": str(HERE), "OPENBLAS_NUM_THREADS": "1"}
    command = ["timeout", str(LONGEST), sys.executable, *words]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=folder, env=environment
    ) as process:
        assert process.stderr is not None
        told = process.stderr.read()
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode in (0, 1, 3), (words, process.returncode, told[-300:])
    return f"{used.ru_utime + used.ru_stime:.1f}", f"{used.ru_maxrss / 1024:.0f}"


def example(command: str) -> str:
    """What the help of a command says to type."""
    words = [sys.executable, "-m", "sampling_design", command, "--help"]
    told = subprocess.run(words, capture_output=True, text=True, check=True, cwd=HERE).stdout
    (line,) = re.findall(r"^ *Example: sampling-design (.*)$", told, re.MULTILINE)
    return str(line)


@cache
def folder(_: str) -> Path:
    """A folder with the examples, in which the commands of one table follow each other."""
    made = Path(tempfile.mkdtemp(prefix="memory-"))
    (made / "examples").symlink_to(HERE / "examples")
    commanded([*shlex.split(f"design {ORBITS} --branches 0 -o out/orbit")], made)
    return made


def of_help(command: str) -> list[str]:
    line = example(command)
    return [f"`{line}`", *commanded([*shlex.split(line), *ENDING.get(command, [])], folder("help"))]


def of_largest(command: str) -> list[str]:
    line = LARGEST[command]
    return [f"`{line}`", *commanded([*shlex.split(line), *ENDING.get(command, [])], folder("largest"))]


def of_record(name: str) -> list[str]:
    command, rows = RECORDS[name]
    place = folder(name)
    recorded(command, rows, place / "record.csv")
    (place / "schedule.csv").write_text(SCHEDULE)
    plan = ["schedule.csv"] if command == "compare" else []
    seconds, size = commanded([command, str(OSCILLATOR), *plan, "record.csv", "-o", "out"], place)
    return [seconds, f"{1e6 * float(seconds) / rows:.0f}", size]


NOTE = """With pictures and files where `-o` stands. What is counted is the most that a process holds at once, with its
libraries, and of several processes that share the work the largest. Rows that a run does not name stay as they were."""
TABLES = (
    Table(("help's example", "what is typed", "CPU s", "MB"), COMMANDS, of_help, "**The example of each help.**"),
    Table(
        ("largest example", "what is typed", "CPU s", "MB"),
        tuple(LARGEST),
        of_largest,
        "**The largest examples.**",
    ),
    Table(
        ("long record", "CPU s", "µs a row", "MB"),
        tuple(RECORDS),
        of_record,
        "**Long records** of two states, with pictures and files.",
    ),
    Table(("large input", "CPU s", "MB"), tuple(CALLS), measured, "**In Python**, of two states where none are named."),
)
PAGE = MeasuredPage(
    "memory.md",
    "What the commands take",
    "Most memory (MB) and processor time of each command.",
    "python -m tests.benchmarks.memory",
    NOTE,
    TABLES,
)

if __name__ == "__main__":
    PAGE.run(sys.argv[1:])
