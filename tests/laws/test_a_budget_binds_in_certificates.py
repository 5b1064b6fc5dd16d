"""A budget binds: what takes one in the room of certificates ends within 1.5 times it plus 2 s, with what it has."""

from __future__ import annotations

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, certify, robustness
from tests.cases import few
from tests.counted_clock import Counted

WIDE = Plant(
    np.diag([0.05, -0.3, 0.0, -1.0]) + np.diag([1.0, 0.5, 0.2], 1), [[1.0, 0.5, 0.2, 1.0], [0.0, 1.0, 0.0, 1.0]]
)
SCHEDULE = PeriodicSchedule([0.7, 1.0, 0.4])


@pytest.mark.parametrize("budget", few([0.05, 0.2, 0.5], 0))
def test_robustness_ends_in_time(budget):
    planned = certify(WIDE, SCHEDULE, eta=0.2, P2=np.eye(4))
    with Counted().running() as clock:
        found = robustness(WIDE, planned, budget=budget)
    assert clock.read() <= 1.5 * budget + 2
    assert not found.closed
    assert found.radius == 0 or found.jittered.verify().passed


def test_a_verdict_in_balls_ends_in_time():
    planned = certify(WIDE, SCHEDULE, eta=0.2, P2=np.eye(4))
    with Counted().running() as clock:
        assert planned.verify(rigorous=True, budget=0.3).verdict in ("proven", "undecided")
    assert clock.read() <= 1.5 * 0.3 + 2
