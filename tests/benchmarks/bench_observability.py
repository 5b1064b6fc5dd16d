"""O_s at 1000 times and sigma over windows; run with `pytest tests/benchmarks/bench_observability.py --benchmark-only`.

First calls (modal form built) are a benchmark of their own.
"""

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import PeriodicSchedule, Plant, window_sigma
from sampling_design.numerics.modal_flow import ModalFlow
from sampling_design.observability.windows.sampled import observability_matrix
from sampling_design.plants import library

RNG = np.random.default_rng(0)
SATELLITE = library.satellite()
RANDOM = Plant(RNG.standard_normal((6, 6)), RNG.standard_normal((3, 6)))
PLANTS = {"satellite": SATELLITE, "random": RANDOM}
TIMES = {"satellite": np.linspace(0, 5554, 1000), "random": np.linspace(0, 8, 1000)}


def loop(plant, times):
    return np.concatenate([plant.C @ expm(plant.A * t) for t in times])


@pytest.mark.parametrize("name", PLANTS)
def test_rows_by_a_loop_over_scipy(benchmark, name):
    rows = benchmark(loop, PLANTS[name], TIMES[name])
    np.testing.assert_array_equal(rows[: PLANTS[name].n_outputs], PLANTS[name].C)


@pytest.mark.parametrize("name", PLANTS)
def test_rows_through_modal_blocks(benchmark, name):
    rows = benchmark(observability_matrix, PLANTS[name], TIMES[name])
    np.testing.assert_allclose(rows, loop(PLANTS[name], TIMES[name]), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", PLANTS)
def test_rows_through_modal_blocks_first_call(benchmark, name):
    plant = PLANTS[name]
    rows = benchmark(lambda: ModalFlow(plant.A).rows(plant.C, TIMES[name]))
    np.testing.assert_allclose(np.reshape(rows, (-1, plant.n_states)), loop(plant, TIMES[name]), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", PLANTS)
def test_rows_by_scaling_and_squaring(benchmark, name):
    plant, flow = PLANTS[name], ModalFlow(PLANTS[name].A)
    rows = benchmark(lambda: flow._dense(plant.C, TIMES[name]))
    np.testing.assert_allclose(np.reshape(rows, (-1, plant.n_states)), loop(plant, TIMES[name]), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("name", PLANTS)
def test_window_sigma_of_20_samples(benchmark, name):
    period = TIMES[name][-1]
    schedule = PeriodicSchedule.from_times(np.sort(np.random.default_rng(1).uniform(0, period, 20)), period)
    result = benchmark(window_sigma, PLANTS[name], schedule, 0.8 * period)
    assert result.closed
