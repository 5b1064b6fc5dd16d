"""On the schedule of period pi an oscillator has no certificate, and a resonant disturbance makes the error grow."""

import numpy as np
import pytest

import sampling_design as sd

PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
BY_HAND = {"horizon": 12.0, "cost": sd.CostFunction(eta=0.1, P2=np.eye(2))}


def judged(period):
    schedule = sd.PeriodicSchedule([period])
    return sd.validate(PLANT, schedule, w_bound=0.1, v_bound=0.1, initial_error=1.0, runs=1, **BY_HAND)


def test_the_error_grows_at_period_pi():
    with pytest.raises(sd.SamplingDesignError, match="no certificate"):
        sd.certify(PLANT, sd.PeriodicSchedule([np.pi]))
    report = judged(np.pi)
    assert not report.passed
    broken = [f for f in report.checks if not f.passed]
    assert [f.claim for f in broken] == ["error does not grow"]
    assert broken[0].observed == pytest.approx(2.0, rel=0.1)  # linear growth doubles from one half to the next
    assert "no certificate" in report.skipped[0]
    assert "promises was broken" in report.explain()


def test_and_not_beside_it():
    report = judged(0.9 * np.pi)
    assert report.passed, report.explain()
