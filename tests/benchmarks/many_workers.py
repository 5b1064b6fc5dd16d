"""How much a second worker saves, measured, and how much many would, simulated.

python -m tests.benchmarks.many_workers [--quick] [QUESTION ...] writes docs/many_workers.md, or those rows in it

One process works alone, and an executor that does each job where it is handed out notes how long each takes. The
simulation hands the same jobs, in the same order, to m workers, each job to whoever is free first, with what starting
the workers and handing over a job take here; at two workers it stands beside the measurement.
"""

from __future__ import annotations

import argparse
import heapq
import os
import pickle
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass, field
from datetime import date
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from joblib.externals.loky import get_reusable_executor

import sampling_design as sd
from sampling_design.plants import library
from sampling_design.records.sweeps import sweep

PAGE = Path(__file__).parents[2] / "docs" / "many_workers.md"
SIMULATED = (2, 4, 8, 16, 64)
ROUNDS = 3
INTEGRATORS, CART = library.triple_integrator(), library.cart_pendulum()
ASKED = sd.Requirement(window=4.0, spacing=0.2, samples=5)
NOTE = """Seconds by the clock, medians of {rounds} rounds that take turns; {cores} cores, one BLAS thread. *Alone* is
without `workers`; *two* has processes that run already (starting two takes {start:.1f} s, once). *Simulated* says how
many times as fast m workers are: the same jobs in the same order, each to whoever is free first, {handing:.1f} ms to
hand one over and what packing it takes; that the cores of one processor slow each other down is not in it. What limits
them is the longest job, and what is done before and after the jobs: the last two columns, as shares of the time alone.
Answers of one and of two workers were compared, and are the same to the last bit."""
HEADS = ("what is asked", "jobs", "alone", "two", "times as fast", "simulated for two", *map(str, SIMULATED[1:]))


class Noting(Executor):
    """Does each job at once, here, and notes its seconds, and those of packing it for another process."""

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self.packing = 0.0

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        began = time.perf_counter()
        pickle.loads(pickle.dumps((function, args, kwargs)))
        packed = time.perf_counter()
        future.set_result(function(*args, **kwargs))
        self.seconds.append(time.perf_counter() - packed)
        self.packing += packed - began
        return future


def simulated(jobs: Sequence[float], workers: int, handing: float) -> float:
    """Seconds until the last job is done: each goes, in order, to whoever is free first, once it is handed over.

    Jobs are handed over one after another by the process that gives them out.
    """
    free = [0.0] * workers
    for place, job in enumerate(jobs):
        heapq.heappush(free, max(heapq.heappop(free), (place + 1) * handing) + job)
    return max(free)


@dataclass
class Measured:
    """One question: seconds alone and with two workers, by rounds; the jobs' seconds and what is around them."""

    alone: list[float] = field(default_factory=list)
    two: list[float] = field(default_factory=list)
    jobs: list[float] = field(default_factory=list)
    around: float = 0.0
    packing: float = 0.0

    def expected(self, workers: int, handing: float) -> float:
        """Simulated seconds."""
        return self.around + simulated(self.jobs, workers, handing + self.packing)

    def row(self, name: str, handing: float) -> str:
        """One line of the table."""
        alone, two = median(self.alone), median(self.two)
        whole = self.around + sum(self.jobs)
        faster = [whole / self.expected(m, handing) for m in SIMULATED]
        cells = [name, str(len(self.jobs)), f"{alone:.1f} s", f"{two:.1f} s", f"{alone / two:.2f}"]
        cells += [f"{each:.2f}" for each in faster[:1]] + [f"{each:.1f}" for each in faster[1:]]
        cells += [f"{100 * max(self.jobs) / whole:.0f} %", f"{100 * self.around / whole:.0f} %"]
        return f"| {' | '.join(cells)} |"


def questions(quick: bool) -> dict[str, Callable[[Any], Any]]:
    """What is asked, as functions of `workers`."""
    few, some = (3, 2) if quick else (16, 8)
    schedules = {f"{k}": sd.PeriodicSchedule([0.3 + 0.02 * k, 0.5, 0.9], time_unit="s") for k in range(few)}
    asked = {f"{k}": ASKED.replace(spacing=0.1 + 0.02 * k) for k in range(some)}
    gaps = {f"{k}": sd.GapRange(0.2, 0.3 + 0.02 * k, time_unit="s") for k in range(few)}
    regular = sd.PeriodicSchedule([0.5], time_unit="s")
    certificate = sd.certify(CART, regular)
    counts, runs = range(4, 4 + some), 20 if quick else 4000
    each_design = partial(sd.design_schedule, INTEGRATORS)
    each_certificate = partial(sd.certify, INTEGRATORS, eta=0.05)
    each_accuracy = partial(sd.guaranteed_accuracy, CART, w_bound=0.01, v_bound=0.1)
    return {
        f"`pareto`: {some} counts of samples": lambda w: sd.pareto_front(INTEGRATORS, ASKED, counts, workers=w),
        f"`sweep`: designs of {some} requirements": lambda w: sweep(each_design, asked, workers=w),
        f"`sweep`: certificates of {few} families of gaps": lambda w: sweep(each_certificate, gaps, workers=w),
        f"`sweep`: accuracies of {few} schedules": lambda w: sweep(each_accuracy, schedules, workers=w),
        f"`validate`: {runs} trials": lambda w: sd.validate(
            CART, regular, certificate, runs=runs, scenarios=["random"], workers=w
        ),
    }


def timed(question: Callable[[Any], Any], workers: Any) -> tuple[float, str]:
    """Seconds by the clock, and the answer to the last bit."""
    began = time.perf_counter()
    answer = question(workers).to_dict()
    return time.perf_counter() - began, repr(answer)


def measured(question: Callable[[Any], Any], rounds: int) -> Measured:
    """A question asked of one and of two, in turns."""
    found = Measured()
    timed(question, 2)  # processes load what they need
    for _ in range(rounds):
        seconds, one = timed(question, None)
        found.alone.append(seconds)
        seconds, other = timed(question, 2)
        found.two.append(seconds)
        assert other == one, "the number of workers changed the answer"
    noting = Noting()
    whole, _ = timed(question, noting)
    found.jobs, found.packing = noting.seconds, noting.packing / len(noting.seconds)
    found.around = whole - sum(noting.seconds) - noting.packing
    return found


def overheads() -> tuple[float, float]:
    """Seconds to start two workers that can answer, and to hand over one job."""
    began = time.perf_counter()
    pool = get_reusable_executor(max_workers=2, reuse=False)
    list(pool.map(sd.plants.split_modes, [CART, CART]))
    start, many = time.perf_counter() - began, 400
    began = time.perf_counter()
    list(pool.map(abs, range(many)))
    handing = (time.perf_counter() - began) / many
    pool.shutdown()
    return start, handing


def main() -> None:
    """Measure all questions, or those that are named, and write the page; rows of others stay as they are."""
    parser = argparse.ArgumentParser()
    parser.add_argument("names", nargs="*")
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args()
    start, handing = overheads()
    heads = [*HEADS, "longest job", "around the jobs"]
    lines = PAGE.read_text().splitlines() if PAGE.exists() and not given.quick else []
    rows = {line.split("|")[1].strip(): line for line in lines if line.startswith("| `")}
    asked = questions(given.quick)
    for name, question in asked.items():
        if given.names and not any(each in name for each in given.names):
            continue
        rows[name] = measured(question, 1 if given.quick else ROUNDS).row(name, handing)
        print(rows[name], flush=True)
    note = NOTE.format(rounds=ROUNDS, cores=os.cpu_count(), start=start, handing=1e3 * handing)
    made = f"Made by `python -m tests.benchmarks.many_workers`, last on {date.today()}."
    table = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *(rows[name] for name in asked if name in rows)]
    if not given.quick:
        PAGE.write_text("\n".join(["# What more workers save", "", made, note, "", *table]) + "\n")


if __name__ == "__main__":
    main()
