"""A plan whose search is cut short is the same on a machine that is slow and on one that jumps in time."""

import json
import time

import numpy as np

import sampling_design as sd

TANK = sd.Plant([[0.0]], [[1.0]], states=["level"], outputs=["y"])
WANTED = sd.PlanRequirement({"level": 0.52}, period=8.0, grid=0.5, w_bound=0.1, sensors={"y": {"noise_bound": 0.1}})


def planned(seconds):
    return sd.plan_samples(TANK, WANTED, search_seconds=seconds, certificate=False, robustness=False)


def test_clocks_that_run_away_change_no_bit_of_a_plan(monkeypatch):
    quiet = planned(0.02)
    rng, clock = np.random.default_rng(7), [time.perf_counter()]

    def busy():
        clock[0] += float(rng.exponential(30.0))
        return clock[0]

    for name in ("perf_counter", "monotonic", "time", "process_time"):
        monkeypatch.setattr(time, name, busy)
    loaded = planned(0.02)
    assert json.dumps(loaded.to_dict()) == json.dumps(quiet.to_dict())
    assert quiet.status == "budget"
