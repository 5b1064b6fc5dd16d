"""Window problems of the thyroid patient: solves with and without a look at the grid, one build, a week simulated."""

import numpy as np
import pytest

from sampling_design.nonlinear.collocation import Collocation
from sampling_design.nonlinear.experiment import DEGREE, HORIZON, STEP, paper_weights
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.simulation import simulate
from sampling_design.nonlinear.thyroid import PRIOR_START, TRUE_START, thyroid

PLANT = thyroid()
TIMES = STEP * np.arange(85)
KINDS = {
    "standard": (1, None),
    "standard, grid checked": (1, 0.01),
    "sample-based": (12, None),
    "sample-based, grid checked": (12, 0.01),
}
"""Every so many steps a sample, and the `accuracy` of the collocation: 0.01 by default, None where nobody looks."""
TRUTH = simulate(PLANT, TRUE_START, TIMES)
Y = TRUTH[:, [1, 2, 4]]


def build(accuracy=None):
    return NonlinearMovingHorizonEstimator(
        PLANT,
        horizon=HORIZON,
        prior=PRIOR_START,
        collocation=Collocation(w_step=STEP, capacity=60, degree=DEGREE, accuracy=accuracy),
        cost=paper_weights(),
    )


@pytest.mark.parametrize("kind", KINDS)
def test_one_solve_with_a_full_window(benchmark, kind):
    every, accuracy = KINDS[kind]
    scheme = build(accuracy)
    scheme.run((t, y) for t, y in zip(TIMES[:-1:every], Y[:-1:every], strict=True))
    before, warm = scheme.state, scheme.window

    def rewind():
        scheme.state, scheme.search.window = before, warm

    estimate = benchmark.pedantic(lambda: scheme.update(TIMES[-1], Y[-1]), setup=rewind, rounds=20, warmup_rounds=1)
    assert estimate.status == "ok"


def test_build_and_first_solve(benchmark):
    estimate = benchmark.pedantic(lambda: build().update(0.0, Y[0]), rounds=3)
    assert estimate.status == "ok"


def test_simulate_a_week(benchmark):
    states = benchmark.pedantic(lambda: simulate(PLANT, TRUE_START, TIMES), rounds=3)
    assert states.shape == (85, 6)
