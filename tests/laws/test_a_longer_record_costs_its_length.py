"""Law: what is done with a record or a schedule takes twice the steps and the memory where that is twice as long."""

import sys
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.estimators import write_measurements
from sampling_design.schedules import write_calendar_csv, write_schedule
from tests.cases import few

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], B=[[0.0], [1.0]], time_unit="s")
BOUNDS = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}
FIRST, LONG = 32, 256  # rows of the shorter one, of which steps are counted and of which memory is
MORE = 1.1
"""Factor beyond the length's own that steps may take: what is quadratic in a third of them takes 1.3."""


def record(rows: int, mixed: bool = False) -> sd.Measurements:
    rng = np.random.default_rng(rows)
    times = np.cumsum(rng.uniform(0.5, 1.5, rows))
    at = rng.permutation(rows) if mixed else np.arange(rows)
    return sd.Measurements(PLANT, times[at], 0.1 * np.cos(times[at])[:, None], np.ones((rows, 1)))


def schedule(rows: int) -> sd.PeriodicSchedule:
    times = np.cumsum(np.random.default_rng(rows).uniform(0.5, 1.5, rows))
    return sd.PeriodicSchedule.from_times(times, rows * 2.0, time_unit="s")


def simulated(rows: int, _: object) -> object:
    inputs = [(float(t), [1.0]) for t in range(rows)]
    return sd.simulate_record(PLANT, sd.PeriodicSchedule([1.0]), float(rows), inputs=inputs, rng=0)


def everything(rows: int, _: object) -> object:
    """No window forgets: its discount would be e^(20 rows)."""
    cost = sd.CostFunction(eta=20.0)
    return sd.MovingHorizonEstimator(PLANT, horizon=1e6, cost=cost, **BOUNDS).run(record(rows))


def on_file(mixed: bool) -> Callable[..., object]:
    def written(rows, folder):
        path = write_measurements(record(rows, mixed), folder / "record.csv")
        return sd.read_measurements(path, PLANT)

    return written


def compared(rows: int, _: object) -> object:
    return sd.compare_schedule(PLANT, sd.PeriodicSchedule([1.0]), np.arange(1.0, rows + 1), window=7.0)


WORK = {
    "merged with itself": lambda rows, _: record(rows).merged(record(rows)),
    "simulated with inputs": simulated,
    "all samples in one window": everything,
    "read out of order": on_file(mixed=True),
    "read in order": on_file(mixed=False),
    "a part": lambda rows, _: record(rows, mixed=True).between(3.0, 0.7 * rows),
    "without a quarter": lambda rows, _: record(rows).without(*range(1, rows // 4)),
    "filtered": lambda rows, _: sd.KalmanFilter(PLANT, **BOUNDS, cost=sd.CostFunction(eta=0.2)).run(record(rows)),
    "smoothed": lambda rows, _: sd.KalmanFilter(PLANT, **BOUNDS, cost=sd.CostFunction(eta=0.2)).smooth(record(rows)),
    "interval": lambda rows, _: sd.state_interval(PLANT, record(rows), **BOUNDS),
    "of any start": lambda rows, _: sd.state_interval(PLANT, record(rows), w_bound=0.1, v_bound=0.1),
    "schedule on file": lambda rows, folder: sd.read_schedule(write_schedule(schedule(rows), folder / "schedule.csv")),
    "dates": lambda rows, folder: write_calendar_csv(schedule(rows), folder / "dates.csv", "2026-01-05T00:00+00:00"),
    "compared with its plan": compared,
}


def steps(call: Callable[[], object]) -> int:
    """Instructions of Python that a call takes."""
    count = 0

    def step(frame, event, _):
        nonlocal count
        frame.f_trace_opcodes, frame.f_trace_lines = True, False
        count += event == "opcode"
        return step

    before = sys.gettrace()
    sys.settrace(step)
    try:
        call()
    finally:
        sys.settrace(before)
    return count


@pytest.mark.parametrize("name", few(WORK, 1))
def test_twice_the_length_takes_twice_the_steps(name, tmp_path):
    work = WORK[name]
    work(2 * FIRST, tmp_path)  # what is loaded or kept for the next call is not counted
    short, long = (steps(lambda rows=rows: work(rows, tmp_path)) for rows in (FIRST, 2 * FIRST))
    assert long <= 2 * MORE * short


@pytest.mark.parametrize("name", few(WORK, 1))
def test_twice_the_length_takes_twice_the_memory(name, tmp_path):
    """A square of the length in a singular vector for each row took gigabytes of a record of ten thousand."""
    work, peaks = WORK[name], []
    work(FIRST, tmp_path)
    for rows in (LONG, 2 * LONG):
        tracemalloc.start()
        work(rows, tmp_path)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] <= 2 * MORE * peaks[0]


def test_steps_show_a_loop_over_all_that_came_before():
    def quadratic(rows):
        return [j for k in range(rows) for j in range(k)]

    assert steps(lambda: quadratic(2 * FIRST)) > 2 * MORE * steps(lambda: quadratic(FIRST))
