"""A guaranteed radius with every sample, at what price? An update with precomputed gains over a plain Kalman step.

n = 4, a period of four samples. Promised: under 3 times a Kalman step written down in numpy with nothing around it.
`python -m tests.benchmarks.bench_accuracy` prints the ratio: medians of process time, both in one run.
"""

import time

import numpy as np

from sampling_design import PeriodicSchedule, Plant, guaranteed_accuracy
from sampling_design.accuracy.recursion import PeriodicGains
from sampling_design.numerics.linalg import discounted_flow

A = np.array([[0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1], [0, 0, -4, -0.1]], float)
PLANT = Plant(A, [[1.0, 0.0, 1.0, 0.0]])
SCHEDULE = PeriodicSchedule([0.7, 1.6, 0.9, 1.1])


def kalman_steps():
    """One predict and update after the other; the flows are there already."""
    F, W = discounted_flow(PLANT.A, PLANT.G @ PLANT.G.T * 0.02**2, SCHEDULE.gaps)
    C, R, eye = PLANT.C, np.array([[0.09]]), np.eye(4)
    x, P, j = np.zeros(4), np.eye(4), 0

    def step(y):
        nonlocal x, P, j
        x, P = F[j] @ x, F[j] @ P @ F[j].T + W[j]
        K = np.linalg.solve(C @ P @ C.T + R, C @ P).T
        x = x + K @ (y - C @ x)
        P = (eye - K @ C) @ P
        P = (P + P.T) / 2
        j = (j + 1) % len(F)
        return x

    return step


def settled_gains():
    """The update of precomputed gains, after its start is forgotten."""
    gains = PeriodicGains(guaranteed_accuracy(PLANT, SCHEDULE, w_bound=0.02, v_bound=0.3, rtol=0.05), initial_error=1.0)
    while not gains.settled:
        gains.update([0.0])
    return gains.update


def ratio(rounds=21, count=400):
    """Median process time of an update over that of a Kalman step, rounds interleaved."""
    y, steps, taken = np.array([0.1]), (settled_gains(), kalman_steps()), [[], []]
    for _ in range(rounds):
        for step, times in zip(steps, taken, strict=True):
            before = time.process_time()
            for _ in range(count):
                step(y)
            times.append((time.process_time() - before) / count)
    ours, plain = (float(np.median(times)) for times in taken)
    return ours / plain, ours, plain


def test_update_with_a_radius(benchmark):
    step = settled_gains()
    found = benchmark(step, np.array([0.1]))
    assert np.isfinite(found.radii).all()
    assert (found.radii > 0).all()


def test_plain_kalman_step(benchmark):
    step = kalman_steps()
    assert np.isfinite(benchmark(step, np.array([0.1]))).all()


if __name__ == "__main__":
    factor, ours, plain = ratio()
    print(f"update with a radius {1e6 * ours:.1f} us, plain Kalman step {1e6 * plain:.1f} us, ratio {factor:.2f}")
