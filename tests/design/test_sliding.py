"""Windows from running sums are the plain sums over their samples, whatever window, period and plant."""

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.design.problem.positions import positions, window_grams, worst_sigma2
from tests.cases import few
from tests.oracles.design import random_schedule, window_sigma_scan

PLANTS = {
    "three states, two outputs": ([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.1]], [[1.0, 0, 1], [0, 1, 0]]),
    "fast growth and fast decay": ([[2.0, 1.0], [0.0, -2.0]], [[1.0, 1.0]]),
    "chain of three": (np.eye(3, k=1), np.eye(1, 3)),
}


def posed(name, window, period, samples, spans=None):
    A, C = (np.array(M, dtype=float) for M in PLANTS[name])
    none = np.zeros((0, 2))
    available = spans or (None,) * C.shape[0]
    return DesignProblem(Plant(A, C), window, period, 0.05, samples, none, np.zeros(0), available)


def plain(problem, times, mask, a, left):
    """sum of c'c over the periods of samples in (a, a + T], or [a, a + T); (a, a + T) where none repeats in T."""
    A, C, S = problem.plant.A, problem.plant.C, problem.rows.S
    total, tiny = np.zeros((A.shape[0],) * 2), 1e-10 * problem.period
    ratio = problem.window / problem.period
    begin, end = (tiny, -tiny) if ratio != round(ratio) else (-tiny, -tiny) if left else (tiny, tiny)
    for t, measured in zip(times, mask, strict=True):
        for k in range(-3, 9):
            r = t + k * problem.period - a
            if begin < r < problem.window + end:
                c = C[measured] @ expm(A * r) @ S
                total += c.T @ c
    return total


@pytest.mark.parametrize(
    ("window", "period", "name"),
    few(
        [
            (*lengths, name)
            for lengths in [(4.0, 4.0), (4.0, 3.0), (2.5, 4.0), (4.0, 1.1), (0.7, 4.0)]
            for name in PLANTS
        ],
        *(0, 4, 8, 9, 13),
    ),
)
def test_every_window_is_the_plain_sum(name, window, period):
    rng = np.random.default_rng(3)
    problem = posed(name, window, period, 6)
    times = np.array([random_schedule(rng, period, 0.05, 6) for _ in range(3)] + [np.arange(6) * period / 6])
    used = rng.random((4, 6, problem.plant.n_outputs)) < 0.7
    where = positions(problem, times)
    found = window_grams(problem, times, where, used)
    for b in range(4):
        for q in range(0, where.at.shape[1], 2):
            wanted = plain(problem, times[b], used[b], where.at[b, q], where.left[q])
            assert np.allclose(found[b, q], wanted, rtol=0, atol=1e-8 * max(np.trace(wanted), 1.0))


def test_the_worst_sigma_is_that_of_a_scan():
    rng = np.random.default_rng(4)
    for name, (A, C) in PLANTS.items():
        problem = posed(name, 4.0, 4.0, 7)
        times = random_schedule(rng, 4.0, 0.05, 7)
        scan = window_sigma_scan(A, C, times, 4.0, 4.0, places=1)
        assert worst_sigma2(problem, times[None])[0] == pytest.approx(scan**2, rel=1e-6)


def test_a_batch_is_its_schedules_one_by_one():
    rng = np.random.default_rng(5)
    problem = posed("chain of three", 4.0, 4.0, 9)
    times = np.array([random_schedule(rng, 4.0, 0.05, 9) for _ in range(60)])
    together = worst_sigma2(problem, times)
    assert np.allclose(together, [worst_sigma2(problem, t[None])[0] for t in times], rtol=1e-9)


def test_a_window_without_samples_sees_nothing():
    problem = posed("fast growth and fast decay", 1.0, 4.0, 2)
    assert worst_sigma2(problem, np.array([[0.0, 0.5], [0.0, 2.0]])).tolist() == [0.0, 0.0]


def test_a_sample_that_enters_as_another_leaves_is_not_counted_on():
    problem = posed("chain of three", 4.0, 3.0, 6)
    even = np.arange(6) / 2
    shaken = even + 1e-7 * np.random.default_rng(1).normal(size=6)
    found = worst_sigma2(problem, np.stack([even, shaken]))
    assert found[0] == pytest.approx(found[1], rel=1e-4)
    later = even.copy()
    later[2] += 1e-3
    assert worst_sigma2(problem, later[None])[0] == pytest.approx(found[0], rel=0.05)


@pytest.mark.long
@pytest.mark.parametrize("period", few([3.0, 3.5], 0))
def test_even_spacing_is_proven_where_its_times_are_exact(period):
    plant = Plant(np.kron(np.diag([1.0, 2.0]), [[0.0, 1.0], [-1.0, 0.0]]), [[1.0, 0.0, 1.0, 0.0]])
    samples = int(2 * period)
    design = design_schedule(plant, Requirement(window=4.0, period=period, spacing=0.3, samples=samples), starts=1)
    assert np.array_equal(design.schedule.gaps, np.full(samples, 0.5))
    assert design.gap < 0.005
    assert design.verify()
