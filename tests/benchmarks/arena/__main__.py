"""Run the arena and write its page: `python -m tests.benchmarks.arena [--quick] [--only NAME] [-o DIR]`."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tests import kept_certificates

from . import nonlinear, page, proving, radii, records, scaling, searching, seeing, windows

TASKS = {
    task.__name__.rsplit(".", 1)[-1]: task
    for task in (seeing, searching, proving, windows, records, radii, nonlinear, scaling)
}
DOCS = Path(__file__).parents[3] / "docs"


def main(arguments: list[str] | None = None) -> int:
    """Run the tasks and write the page."""
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.arena", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small sizes, under a minute")
    parser.add_argument("--only", choices=TASKS, action="append", help="run this task alone; may be repeated")
    parser.add_argument("-o", type=Path, default=DOCS, metavar="DIR", help="where the page goes (default: docs)")
    chosen = parser.parse_args(arguments)
    kept_certificates.watch()
    (chosen.o / "figures").mkdir(parents=True, exist_ok=True)
    tables, before = [], time.process_time()
    for name in chosen.only or TASKS:
        since = time.process_time()
        tables += TASKS[name].run(chosen.quick)
        print(f"{name}: {time.process_time() - since:.0f} s", file=sys.stderr)
    print(page.written(tables, chosen.o, time.process_time() - before, chosen.quick))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
