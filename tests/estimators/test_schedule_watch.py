"""Samples are held against a schedule one at a time, its first sample at time 0 included."""

import numpy as np
import pytest

from sampling_design import MovingHorizonEstimator, PeriodicSchedule, Plant, Schedule, certify

PLANT = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
TIMES = [0.0, 0.9, 2.0, 3.1]


@pytest.mark.parametrize(
    "schedule", [Schedule(TIMES), PeriodicSchedule.from_times(TIMES, 4.0)], ids=["finite", "periodic"]
)
def test_a_first_sample_at_zero_is_not_due_twice(schedule):
    certificate = certify(PLANT, schedule, eta=0.3, P2=np.eye(2))
    mhe = MovingHorizonEstimator(PLANT, certificate)
    assert [mhe.update(t, [0.0]).on_schedule for t in TIMES] == [True] * 4
    late = MovingHorizonEstimator(PLANT, certificate)
    assert [late.update(t, [0.0]).on_schedule for t in (0.0, 0.9, 2.01)] == [True, True, False]
