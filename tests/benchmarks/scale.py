"""How the cost of each verb grows with its plant, its schedule and its record, and what breaks first.

python -m tests.benchmarks.scale [ROW ...] writes docs/scaling.md, or those rows in it
"""

from __future__ import annotations

import multiprocessing
import resource
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

import sampling_design as sd
from sampling_design.plants import library
from sampling_design.plants.sparse import split_sparse
from tests.benchmarks.arena.scaling import large
from tests.benchmarks.pages import MeasuredPage, Table

LONGEST, ENOUGH = 3, 0.3
"""CPU seconds after which a call is too long, and which all calls of one size fill together."""
MOST = 100
"""Calls of one size."""
STATES = (2, 10, 50, 200)
SAMPLES = (4, 12, 40, 400)
OUTPUTS = (1, 2, 4, 8)
RETAINED = (2, 4, 6, 8)
ROWS = (1_000, 10_000, 100_000, 1_000_000)
RADIANS = (10, 100, 1000, 10_000, 100_000)
SPARSE = (100, 1024, 10_000)
WORKERS = (1, 2)
BOUNDS = {"w_bound": 0.1, "v_bound": 0.1}
GAPS = (0.7, 1.6, 0.9, 2.0)
WorkLimit = Callable[[], object]
Prepared = Callable[[], tuple[WorkLimit, float]]
"""What a call needs is made before it is timed: the call, and how many of what is counted it does."""


def tones(n: int, outputs: int = 1) -> sd.Plant:
    """n/2 oscillators of 1, 2, ... rad/s; outputs are sums of their places, each with other weights."""
    A = np.kron(np.diag(np.arange(1.0, n // 2 + 1)), [[0.0, 1.0], [-1.0, 0.0]])
    weights = 1 + 0.5 * np.cos(np.outer(np.arange(outputs), np.arange(n // 2)))
    return sd.Plant(A, np.kron(weights, [[1.0, 0.0]]))


def uneven(samples: int, period: float = 2 * np.pi) -> sd.PeriodicSchedule:
    """So many samples in a period, none of its gaps like another."""
    gaps = np.random.default_rng(samples).uniform(0.5, 1.5, samples)
    return sd.PeriodicSchedule(gaps * period / gaps.sum())


def split(plant: sd.Plant, schedule: sd.PeriodicSchedule) -> Prepared:
    return lambda: (lambda: sd.plants.split_modes(plant), 1)


def sigma(plant: sd.Plant, schedule: sd.PeriodicSchedule) -> Prepared:
    return lambda: (lambda: sd.window_sigma(sd.plants.split_modes(plant).retained, schedule, schedule.period), 1)


def designed(plant: sd.Plant, schedule: sd.PeriodicSchedule) -> Prepared:
    period, samples = schedule.period, len(schedule)
    asked = sd.Requirement(window=period, period=period, spacing=period / (4 * samples), samples=samples)
    return lambda: (lambda: sd.design_schedule(plant, asked, starts=2, branches=0), 1)


def certified(plant: sd.Plant, schedule: sd.PeriodicSchedule) -> Prepared:
    return lambda: (lambda: sd.certify(plant, schedule), 1)


def verified(plant: sd.Plant, schedule: sd.PeriodicSchedule) -> Prepared:
    def prepared() -> tuple[WorkLimit, float]:
        made = sd.certify(plant, schedule, eta=0.2, P2=np.eye(plant.n_states))
        return lambda: made.verify(rigorous=True), 1

    return prepared


def accurate(plant: sd.Plant, schedule: sd.PeriodicSchedule) -> Prepared:
    return lambda: (lambda: sd.guaranteed_accuracy(plant, schedule, of=[plant.states.names[0]], **BOUNDS), 1)


def updated(plant: sd.Plant, schedule: sd.PeriodicSchedule, box: bool = False) -> Prepared:
    """One update of an estimator whose window is a period, once it is full."""
    held = sd.Constraints(x=(np.full(plant.n_states, -0.1), np.full(plant.n_states, 0.1))) if box else sd.Constraints()

    def prepared() -> tuple[WorkLimit, float]:
        mhe = sd.MovingHorizonEstimator(plant, horizon=schedule.period, cost=sd.CostFunction(eta=0.1), constraints=held)
        times = schedule.between(0.0, 60 * schedule.period).times
        rows = iter([(t, np.sin(t * np.arange(1, plant.n_outputs + 1))) for t in times.tolist()])
        for _ in schedule.gaps:
            mhe.update(*next(rows))
        return lambda: mhe.update(*next(rows)), 1

    return prepared


def planned(plant: sd.Plant, schedule: sd.PeriodicSchedule) -> Prepared:
    """A calendar on a grid of so many steps as the schedule has samples; the search itself has a second."""
    period = schedule.period
    sensors = {name: {"noise_bound": 0.2} for name in plant.outputs.names}
    asked = sd.PlanRequirement(
        {plant.states.names[0]: 0.7}, period=period, grid=period / len(schedule), w_bound=0.02, sensors=sensors
    )
    return lambda: (lambda: sd.plan_samples(plant, asked, search_seconds=1.0, certificate=False, robustness=False), 1)


def validated(plant: sd.Plant, schedule: sd.PeriodicSchedule) -> Prepared:
    def prepared() -> tuple[WorkLimit, float]:
        made = sd.certify(plant, schedule, eta=0.2, P2=np.eye(plant.n_states))
        return lambda: sd.validate(plant, schedule, made, runs=4, scenarios=["random"]), 4

    return prepared


VERBS = {
    "modes": split,
    "sigma over all windows": sigma,
    "design (2 starts, no cuts)": designed,
    "certify": certified,
    "verify in balls, weights given": verified,
    "accuracy of one state": accurate,
    "an update": updated,
    "an update with a box that binds": partial(updated, box=True),
    "a trial of validate": validated,
    "plan (1 s of search)": planned,
}
Asked = dict[str, Callable[[int], Prepared]]


def asked(of: Callable[[int], tuple[sd.Plant, sd.PeriodicSchedule]], *left_out: str) -> Asked:
    """Every verb, as a function of the size."""
    return {name: lambda size, v=verb: v(*of(size)) for name, verb in VERBS.items() if name not in left_out}


def records(kind: str) -> Callable[[int], Prepared]:
    """Estimates of a whole record, row by row."""

    def of(rows: int) -> Prepared:
        plant = library.oscillator()
        times = np.cumsum(np.random.default_rng(1).uniform(0.8, 1.6, rows))
        ys = np.sin(times)[:, None]
        maker = sd.KalmanFilter if kind == "filter" else partial(sd.MovingHorizonEstimator, horizon=6.0)
        begun = partial(maker, plant, cost=sd.CostFunction(eta=0.1))
        return lambda: (lambda: sum(1 for _ in begun().stream(zip(times.tolist(), ys, strict=True))), 1)

    return of


def compared(rows: int) -> Prepared:
    """Planned against actual times."""
    plan, actual = sd.PeriodicSchedule([1.0], time_unit="s"), np.arange(1.0, rows + 1)
    actual = actual + np.random.default_rng(1).uniform(-0.1, 0.1, rows)
    return lambda: (lambda: sd.compare_schedule(library.oscillator(), plan, actual, 6.0), 1)


def shared(workers: int) -> Prepared:
    """Trials that processes of a Dask cluster on this machine share: seconds by the clock."""
    from distributed import Client, LocalCluster

    def prepared() -> tuple[WorkLimit, float]:
        client = Client(LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None))
        plant, schedule = library.oscillator(), sd.PeriodicSchedule([0.7, 1.6], time_unit="s")
        made, pool = sd.certify(plant, schedule), client.get_executor()
        sd.validate(plant, schedule, made, runs=8, workers=pool)
        return lambda: sd.validate(plant, schedule, made, runs=400, scenarios=["random"], workers=pool), 1

    return prepared


def tried(prepared: Prepared, clock: Callable[[], float], told: Connection) -> None:
    """In a process of its own: seconds of what is counted, and what went wrong ("": nothing)."""
    resource.setrlimit(resource.RLIMIT_CPU, (3 * LONGEST, 3 * LONGEST))
    try:
        work, count = prepared()
        began, calls = clock(), 0
        while clock() - began < ENOUGH and calls < MOST:
            work()
            calls += 1
        each = (clock() - began) / calls
        told.send((each / count, "" if each < LONGEST or clock is time.perf_counter else f"over {LONGEST} s"))
    except Exception as error:
        words = " ".join(str(error).replace("|", "").split())
        told.send((np.nan, f"{type(error).__name__}: {words[:90]}{'...' * (len(words) > 90)}"))


def measured(sizes: Sequence[int], of: Callable[[int], Prepared], clock: Callable[[], float]) -> list[str]:
    """The seconds of each size, the slope of log(seconds) over log(size), and what broke first."""
    times: list[float] = []
    broken = "nothing"
    for size in sizes:
        receive, send = multiprocessing.get_context("fork").Pipe(False)
        process = multiprocessing.get_context("fork").Process(target=tried, args=(of(size), clock, send))
        process.start()
        send.close()
        try:
            seconds, words = receive.recv()
        except EOFError:
            seconds, words = np.nan, f"over {LONGEST} s"
        process.join()
        times += [seconds] if np.isfinite(seconds) else []
        if words:
            broken = f"{size:,}: {words}"
            break
    cells = [f"{1e3 * t:.3g}" for t in times] + [""] * (len(sizes) - len(times))
    slope = np.polyfit(np.log(sizes[: len(times)]), np.log(times), 1)[0] if len(times) > 1 else np.nan
    return [*cells, f"{slope:.2f}", broken]


def table(what: str, sizes: Sequence[int], rows: Asked, above: str, clock: Any = time.process_time) -> Table:
    columns = (what, *(f"{size:,}" for size in sizes), "exponent", "breaks first")
    return Table(columns, tuple(rows), lambda name: measured(sizes, rows[name], clock), above, frozenset(columns[1:]))


def plate(states: int) -> Prepared:
    plant = library.heat_plate(round(states**0.5))
    return lambda: (lambda: split_sparse(plant), 1)


def grid(states: int) -> Prepared:
    plant = library.droop_network(states)
    return lambda: (lambda: split_sparse(plant), 1)


def window(length: int) -> Prepared:
    return lambda: (
        lambda: sd.window_sigma(library.oscillator(), sd.PeriodicSchedule(GAPS, time_unit="s"), float(length)),
        1,
    )


def worst(length: int) -> Prepared:
    family, plant = sd.SpacedWindows(float(length), 4, 0.5), sd.Plant([[0.0, 1.0], [-1.0, 0.0]], np.diag([1.0, 0.3]))
    return lambda: (lambda: sd.worst_case_sigma(plant, family), 1)


def spread_out(n: int) -> tuple[sd.Plant, sd.PeriodicSchedule]:
    return large(n), sd.PeriodicSchedule(GAPS)


RECORDS = {
    "filter": records("filter"),
    "moving horizon of five samples": records("mhe"),
    "planned against actual times": compared,
}
TABLES = (
    table(
        "states, two retained",
        STATES,
        asked(spread_out, "plan (1 s of search)"),
        "**States**: an oscillator among modes that decay, mixed; four samples a period.",
    ),
    table(
        "states, all retained",
        RETAINED,
        asked(lambda n: (tones(n), uneven(2 * n))),
        "**Retained states**: oscillators of 1, 2, ... rad/s behind one output, twice as many samples a period.",
    ),
    table(
        "samples a period",
        SAMPLES,
        asked(lambda k: (tones(4), uneven(k))),
        "**Samples**: four states, one output; of a plan the steps of its grid.",
    ),
    table(
        "outputs",
        OUTPUTS,
        asked(lambda p: (tones(8, p), uneven(12)), "plan (1 s of search)"),
        "**Outputs**: eight states, twelve samples a period.",
    ),
    table("rows", ROWS, RECORDS, "**Rows** of a record of an oscillator."),
    table(
        "radians in a window",
        RADIANS,
        {"sigma over all windows": window, "worst spaced schedule": worst},
        "**Long windows** of an oscillator.",
    ),
    table(
        "states of a sparse plant",
        SPARSE,
        {"modes of a heat plate": plate, "modes of a power grid": grid},
        "**Sparse plants**: modes near and right of the line, and the proof that none was missed.",
    ),
    table(
        "workers",
        WORKERS,
        {"400 trials": shared},
        "**Dask workers**: by the clock, on two cores that had other work too.",
        time.perf_counter,
    ),
)
PAGE = MeasuredPage(
    "scaling.md",
    "How the cost grows",
    "How the cost of each verb grows with its plant, its schedule and its record, and what breaks first.",
    "python -m tests.benchmarks.scale",
    f"""Milliseconds of one thread, the mean of as many calls as fill {ENOUGH} s, each size in a process of its own. The
exponent is the slope of log(time) over log(size): 1 is linear growth. Sizes grow until a verb refuses, or takes over
{LONGEST} s. Other programs ran beside on that day: rows
measured twice differed by a factor of up to 2.""",
    TABLES,
)

if __name__ == "__main__":
    PAGE.run(sys.argv[1:])
