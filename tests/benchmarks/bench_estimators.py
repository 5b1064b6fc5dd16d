"""Window solve, whole updates, and the problem rebuilt in the modelling library at each sample.

n = 4, windows of 20 samples. The ratios that are promised: the solve within 5 times `solveh_banded` on the same
matrix; an update at least 100 times faster than the rebuilt problem, 50 times with active constraints. do-mpc, which
must be 20 times slower on the same window, is in the arena. `python -m tests.benchmarks.bench_estimators` prints how
long updates, free and constrained, and both ends of one row take against `solveh_banded` on that band: medians of
process time; and which share of updates under active constraints the active-set method has, which is all that a warm
start of it could save; and how many updates an estimate in the middle of its interval costs.
"""

import cProfile
import itertools
import pstats
import time

import numpy as np
import pytest
from scipy.linalg import solveh_banded

from sampling_design import Constraints, KalmanFilter, MovingHorizonEstimator, Plant
from sampling_design.accuracy.readings import RecordRow
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.accuracy.record_readings import read_record
from sampling_design.accuracy.record_rows import arrived
from sampling_design.estimators.constraints.qp import problem_as_written
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.window.smoother import information_band, solve_banded, solve_square_root
from sampling_design.estimators.window.window_problem import EstimationWindow

A = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -4, -0.1]], float)
PLANT = Plant(A, [[1.0, 0.0, 1.0, 0.0]])
BOUNDS = {"w_bound": 0.5, "v_bound": 0.5, "initial_error": 3.0}
WIDE = (-1e3, 1e3)
SETS = {
    "free": {},
    "box": {"constraints": Constraints(x=(-0.3, 0.3))},
    "noise": {"constraints": Constraints(w=(-0.2, 0.2))},
}


def samples(irregular=True, seed=0):
    rng, t = np.random.default_rng(seed), 0.0
    while True:
        t += rng.uniform(0.5, 1.5) if irregular else 1.0
        yield t, rng.normal(size=1), None


def warm(estimator, irregular=True, count=60):
    source = samples(irregular)
    for row in itertools.islice(source, count):
        estimator.update(*row)
    return source


def last_window(options=None):
    """The window of the twentieth sample after a warm start, with its estimator."""
    mhe = MovingHorizonEstimator(PLANT, horizon=20.0, cost=CostFunction(eta=0.2), **BOUNDS, **(options or {}))
    t, y, _ = next(warm(mhe))
    state = mhe.state
    return mhe, mhe._window(state, mhe._start(state, t), mhe._incoming(state, RecordRow(t, y)))


def fresh(window):
    """The same window without anything cached on it; the transitions stay, as they do between updates."""
    return EstimationWindow(**{name: getattr(window, name) for name in EstimationWindow.__dataclass_fields__})


def test_banded_solver_alone(benchmark):
    band, right = information_band(last_window()[1])
    assert np.isfinite(benchmark(solveh_banded, band, right, lower=True)).all()


def test_window_solve(benchmark):
    window = last_window()[1]
    assert benchmark(lambda: solve_banded(fresh(window))).status == "ok"


def test_window_solve_by_orthogonal_factors(benchmark):
    window = last_window()[1]
    assert benchmark(solve_square_root, window).status == "ok"


@pytest.mark.parametrize("options", SETS)
@pytest.mark.parametrize("irregular", [True, False], ids=["irregular", "regular"])
def test_update(benchmark, options, irregular):
    mhe = MovingHorizonEstimator(PLANT, horizon=20.0, cost=CostFunction(eta=0.2), **BOUNDS, **SETS[options])
    source = warm(mhe, irregular)
    assert benchmark(lambda: mhe.update(*next(source))).status in ("ok", "bounds disproved")


@pytest.mark.parametrize("options", SETS)
def test_problem_rebuilt_in_the_modelling_library(benchmark, options):
    mhe, window = last_window(SETS[options])

    def rebuilt():
        return problem_as_written(window, mhe.constraints).solve(solver="CLARABEL")

    assert np.isfinite(benchmark.pedantic(rebuilt, rounds=5, warmup_rounds=1))


def test_first_update(benchmark):
    def first():
        return MovingHorizonEstimator(PLANT, horizon=20.0, cost=CostFunction(eta=0.2), **BOUNDS).update(1.0, [0.1])

    assert benchmark(first).status == "ok"


def test_filter_update(benchmark):
    kalman = KalmanFilter(PLANT, cost=CostFunction(eta=0.2), **BOUNDS)
    source = warm(kalman)
    assert benchmark(lambda: kalman.update(*next(source))).engine == "filter"


def test_late_sample_is_replayed(benchmark):
    mhe = MovingHorizonEstimator(PLANT, horizon=20.0, cost=CostFunction(eta=0.2), **BOUNDS)
    warm(mhe)
    state, late = mhe.state, mhe.state.nodes[-6].t + 1e-3
    assert benchmark(lambda: mhe.step(state, (late, [0.1], None)))[1].t == state.last.t


def test_stream_of_one_hundred_thousand_samples_in_flat_memory(benchmark):
    """Resident memory after 10^5 streamed samples is that after 10^4, to a few megabytes."""
    from resource import RUSAGE_SELF, getrusage

    def stream():
        mhe = MovingHorizonEstimator(PLANT, horizon=5.0, cost=CostFunction(eta=0.2), **BOUNDS)
        sizes = []
        for k, _ in enumerate(mhe.stream(itertools.islice(samples(), 100_000))):
            if k in (9_999, 99_999):
                sizes.append(getrusage(RUSAGE_SELF).ru_maxrss)
        return sizes

    early, late = benchmark.pedantic(stream, rounds=1)
    assert late - early < 8 * 1024


def recorded(count=20):
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.3, 1.0, count))
    return [(float(t), [np.sin(t)], None) for t in times]


def test_interval_posed(benchmark):
    record = recorded()
    known = RecordProgram(read_record(PLANT, arrived(record, PLANT), 0.05, 0.5, None, None, None)).table

    def posed():
        program = RecordProgram(read_record(PLANT, arrived(record, PLANT), 0.05, 0.5, None, None, None), known)
        return program.posed()

    assert benchmark(posed).columns > 0


def test_interval_of_one_row(benchmark):
    """Both ends; the goal is two milliseconds on a quiet machine."""
    program = RecordProgram(read_record(PLANT, arrived(recorded(), PLANT), 0.05, 0.5, None, None, None))
    ends = benchmark(program.solve, program.readings.times[-1], np.eye(4)[:1])[0]
    assert ends[0].value > -ends[1].value


def ratios(rounds=300, count=8):
    """Median process times in seconds, rounds interleaved: the banded solver, updates, both ends of one row."""
    band, right = information_band(last_window()[1])
    program = RecordProgram(read_record(PLANT, arrived(recorded(), PLANT), 0.05, 0.5, None, None, None))
    last = program.readings.times[-1]

    def updates(irregular, begins="horizon", **sets):
        chosen, cost = Constraints(**sets) if sets else None, CostFunction(eta=0.2, begins=begins)
        mhe = MovingHorizonEstimator(PLANT, horizon=20.0, cost=cost, constraints=chosen, **BOUNDS)
        rows = iter(list(itertools.islice(warm(mhe, irregular), rounds * count)))
        return lambda: mhe.update(*next(rows))

    steps = {
        "solveh_banded": lambda: solveh_banded(band, right, lower=True),
        "update, regular": updates(False),
        "update, irregular": updates(True),
        "update, irregular, from samples": updates(True, "sample"),
        **{
            f"update, {'irregular' if irregular else 'regular'}, {name} never active": updates(
                irregular, **{name: WIDE}
            )
            for irregular in (False, True)
            for name in "xvw"
        },
        "update, regular, x active": updates(False, x=(-0.3, 0.3)),
        "update, irregular, x active": updates(True, x=(-0.3, 0.3)),
        "interval of one row": lambda: program.solve(last, np.eye(4)[:1]),
    }
    taken = {name: [] for name in steps}
    for _ in range(rounds):
        for name, step in steps.items():
            times = 1 if name.startswith("interval") else count
            before = time.process_time()
            for _ in range(times):
                step()
            taken[name].append((time.process_time() - before) / times)
    return {name: float(np.median(own)) for name, own in taken.items()}


def share_of_the_active_set(rounds=300):
    """What share of the process time of updates with an active box is spent in DAQP: (regular, irregular)."""
    found = []
    for irregular in (False, True):
        constraints = Constraints(x=(-0.3, 0.3))
        mhe = MovingHorizonEstimator(PLANT, horizon=20.0, cost=CostFunction(eta=0.2), constraints=constraints, **BOUNDS)
        rows = list(itertools.islice(warm(mhe, irregular), rounds))
        timed = cProfile.Profile(time.process_time)
        timed.runcall(lambda rows=rows, mhe=mhe: [mhe.update(*row) for row in rows])
        every = pstats.Stats(timed)
        inside = sum(own[3] for (_, _, name), own in every.stats.items() if name == "active_set")
        found.append(inside / every.total_tt)
    return tuple(found)


def price_of_the_middle(samples=20, rounds=12):
    """In updates, by the number of states: what `radii` cost, and `centred()` after them; medians, irregular."""
    found = {}
    for plant in (Plant([[-0.1]], [[1.0]]), Plant([[0.0, 1.0], [-1.0, -0.05]], [[1.0, 0.0]]), PLANT):
        bounds = {"w_bound": 0.02, "v_bound": 0.2, "initial_error": 3.0}
        mhe = MovingHorizonEstimator(plant, horizon=float(samples), cost=CostFunction(eta=0.2), **bounds)
        rng, t, x, taken = np.random.default_rng(0), 0.0, np.ones(plant.n_states), []
        for k in range(3 * samples + rounds):
            h = rng.uniform(0.5, 1.5)
            t, x = t + h, plant.transition(h) @ x + rng.uniform(-0.01, 0.01, plant.n_states)
            y = plant.C @ x + rng.uniform(-0.2, 0.2, 1)
            times = [time.process_time()]
            estimate = mhe.update(t, y)
            times.append(time.process_time())
            if k >= 3 * samples:
                for asked in (lambda e=estimate: e.radii, estimate.centred):
                    asked()
                    times.append(time.process_time())
                taken.append(np.diff(times))
        update, radii, moved = np.median(taken, axis=0)
        found[plant.n_states] = float(radii / update), float(moved / update)
    return found


if __name__ == "__main__":
    for states, (radii, moved) in price_of_the_middle().items():
        print(f"radii, {states} states: {radii:.0f} updates, and centred() after them {moved:.2f}")
    found = ratios()
    print("share of the active-set method, regular and irregular: {:.2f}, {:.2f}".format(*share_of_the_active_set()))
    for name, spent in found.items():
        print(f"{name}: {1e6 * spent:.0f} us, {spent / found['solveh_banded']:.1f} times solveh_banded")
