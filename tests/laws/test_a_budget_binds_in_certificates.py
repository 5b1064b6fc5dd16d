"""A budget binds: what takes one in the room of certificates ends within 1.5 times it plus 2 s, with what it has."""

from __future__ import annotations

import time

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, certify, robustness

WIDE = Plant(
    np.diag([0.05, -0.3, 0.0, -1.0]) + np.diag([1.0, 0.5, 0.2], 1), [[1.0, 0.5, 0.2, 1.0], [0.0, 1.0, 0.0, 1.0]]
)
SCHEDULE = PeriodicSchedule([0.7, 1.0, 0.4])


@pytest.mark.parametrize("budget", [0.2, 1.5])
def test_robustness_ends_in_time(budget):
    planned = certify(WIDE, SCHEDULE, eta=0.2, P2=np.eye(4))
    begun = time.process_time()
    found = robustness(WIDE, planned, budget=budget)
    assert time.process_time() - begun <= 1.5 * budget + 2
    assert not found.closed
    assert found.radius == 0 or found.jittered.verify().passed


def test_a_verdict_in_balls_ends_in_time():
    planned = certify(WIDE, SCHEDULE, eta=0.2, P2=np.eye(4))
    begun = time.process_time()
    assert planned.verify(rigorous=True, budget=0.3).verdict in ("proven", "undecided")
    assert time.process_time() - begun <= 1.5 * 0.3 + 2
