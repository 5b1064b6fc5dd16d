"""A designed and certified schedule keeps every promise: satellite, unstable pendulum, oscillator."""

from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.mark.long
@pytest.mark.parametrize("name", ["satellite", "oscillator", "cart_pendulum"])
def test_every_promise_holds(name):
    plant = sd.read_plant(EXAMPLES / "plants" / f"{name}.toml")
    requirement = sd.read_requirement(EXAMPLES / "requirements" / f"{name}.toml")
    schedule = sd.design_schedule(plant, requirement, budget=3.0).schedule
    report = sd.validate(plant, schedule, sd.certify(plant, schedule), runs=100)
    assert report.passed, report.explain()
    assert not report.skipped
    found = {(f.claim, f.scenario): f for f in report.checks}
    assert len(found) == len(report.checks) == 27
    worst = found["inequality (16)", "worst pair"]
    assert 0.98 < worst.observed <= 1.0  # tight: one pair nearly uses up what is promised
    ellipsoids = [f.observed for f in report.checks if f.claim == "online ellipsoid"]
    assert 0.5 < max(ellipsoids) <= 1.0 + 1e-8
    assert found["error does not grow", "resonant disturbance"].observed < 1.1
    assert found["a-priori bound", "worst energy"].observed >= found["a-priori bound", "random noise"].observed
    assert np.isfinite(report.bound).all()
