"""Inputs without samples take linear time, in the estimators and from a file: counted in calls, not by a clock."""

import sys

import numpy as np
import pytest

import sampling_design as sd

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], B=[[0.0], [1.0]])
GIVEN = {"w_bound": 0.01, "v_bound": 0.1, "initial_error": 1.0}
MAKERS = {
    "moving horizon": lambda: sd.MovingHorizonEstimator(PLANT, horizon=1e3, cost=sd.CostFunction(eta=0.7), **GIVEN),
    "filter": lambda: sd.KalmanFilter(PLANT, cost=sd.CostFunction(eta=0.7), **GIVEN),
}
ROUNDS = (40, 80, 160)
SEARCHED = 1.1
"""Twice as many more may cost so much more than twice: a time is found by halving. Quadratic work would be 2."""


def calls(work):
    """How many functions were called, ours and those of libraries."""
    count = 0

    def one_more(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(one_more)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


def is_linear(work):
    """Whether twice as many more inputs are about twice as many more calls."""
    few, some, many = (calls(lambda n=n: work(n)) for n in ROUNDS)
    return many - some <= SEARCHED * 2 * (some - few)


def quadratic(n):
    for k in range(n):
        for _ in range(k):
            len(())


@pytest.mark.parametrize("maker", MAKERS)
def test_an_estimator_takes_them_one_by_one(maker):
    def work(n):
        estimator = MAKERS[maker]()
        for k in range(1, n + 1):
            estimator.update(1e-3 * k, None, [0.1 * np.sin(k)])
        estimator.update(1e-3 * (n + 1), [0.1])

    work(10)
    assert is_linear(work)
    assert not is_linear(quadratic)


def test_a_record_takes_them_as_a_whole():
    def work(n):
        t = 1e-3 * np.arange(1, n + 1)
        y = np.where(t[:, None] < t[-1], np.nan, 0.1)
        record = sd.Measurements(PLANT, t, y, np.sin(t)[:, None])
        assert MAKERS["moving horizon"]().run(record).certified.all()

    work(10)
    assert is_linear(work)
