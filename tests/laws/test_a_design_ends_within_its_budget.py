"""Law: a budget binds: design, front and losses end within 1.5 times it plus 2 s, with a bound and a proof.

Time is the process's own, so that a busy machine fails nothing.
"""

import re

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule, pareto_front
from sampling_design.design import sample_losses
from sampling_design.plants import library
from tests.cases import few
from tests.counted_clock import Counted

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
THREE = Plant(
    np.kron(np.diag([1.0, 1.7, 2.9]), [[0.0, 1.0], [-1.0, 0.0]]) + 0.1 * np.eye(6), [[0.1, -0.1, 0.6, 0.1, -0.5, 0.4]]
)
DAYLIGHT = np.array([0.0, *(24.0 * day + hour for day in range(30) for hour in (7.0, 19.0)), 720.0]).reshape(-1, 2)
LARGE = {
    "many cycles": (OSCILLATOR, {"window": 1000.0}),
    "a hundred thousand cycles": (OSCILLATOR, {"window": 6e5, "samples": 8}),
    "closed times": (
        library.tidal_gauge(),
        {"window": 720.0, "period": 720.0, "spacing": 5.0, "samples": 30, "forbidden": DAYLIGHT},
    ),
    "costs": (
        OSCILLATOR,
        {"window": 60.0, "samples": {"at_most": 20}, "sensors": {"y1": {"price": 1.0}}, "cost_limit": 15},
    ),
    "many states": (THREE, {"window": 12.0, "spacing": 0.1, "samples": 80}),
    "a target": (OSCILLATOR, {"window": 60.0, "spacing": 0.5, "target_sigma": 6.0}),
}
SMALL = Requirement(window=4.0, spacing=0.5, samples=3)
THOROUGH = {"starts": 50, "branches": 500}


def spent(function):
    with Counted(1e-6).running() as clock:
        result = function()
    return result, clock.read()


@pytest.mark.parametrize("budget", few([0.0, 1.0], 0))
@pytest.mark.parametrize("name", few(LARGE, 3))
def test_a_design_ends_in_time_with_what_it_has(name, budget):
    plant, asked = LARGE[name]
    design, seconds = spent(
        lambda: design_schedule(plant, Requirement(**asked), budget=budget, starts=50, branches=500)
    )
    assert seconds <= 1.5 * budget + 2
    assert 0 <= design.sigma <= design.upper_bound < np.inf
    assert design.status in ("budget", "complete")


@pytest.mark.long
def test_a_front_shares_its_budget_among_the_counts():
    front, seconds = spent(
        lambda: pareto_front(
            OSCILLATOR, Requirement(window=60.0, spacing=0.5), range(4, 20), budget=0.5, starts=50, branches=500
        )
    )
    assert seconds <= 1.5 * 0.5 + 2
    assert [p.samples for p in front.points] == list(range(4, 20))
    assert sum(p.sigma > 0 for p in front.points) >= 3


@pytest.mark.long
def test_losses_end_in_time():
    plant, asked = LARGE["closed times"]
    design = design_schedule(plant, Requirement(**asked), budget=0.0)
    losses, seconds = spent(lambda: sample_losses(design, budget=1.0))
    assert seconds <= 1.5 * 1.0 + 2
    assert np.all(losses.lower <= losses.bound)
    assert np.all(np.isfinite(losses.bound))


def interrupted_at(call):
    """A design whose progress is interrupted at a call, and how often it was called."""
    calls = []

    def progress(fraction, message):
        calls.append(message)
        if len(calls) == call:
            raise KeyboardInterrupt

    return design_schedule(OSCILLATOR, SMALL, rng=0, starts=1, branches=2, progress=progress), calls


def test_an_interrupt_at_any_call_leaves_a_design_that_proves_itself():
    whole, calls = interrupted_at(0)
    assert len(calls) > 4
    for call in range(1, len(calls)):  # at the last one all work is done, and only the proof is left
        design, _ = interrupted_at(call)
        assert design.status == "interrupted"
        assert 0 < design.sigma <= design.upper_bound
        assert design.sigma <= whole.upper_bound
        assert design.upper_bound >= whole.sigma
        assert design.verify()


def test_progress_tells_sigma_and_bound_from_the_first_call_on():
    whole, calls = interrupted_at(0)
    assert calls[0].startswith("sigma ")
    told = [re.match(r"sigma (\S+), bound (\S+), gap (\S+) %", call) for call in calls[1:]]
    assert all(told)
    assert all(float(one[1]) <= whole.upper_bound * (1 + 1e-4) for one in told)
    assert all(float(one[2]) >= whole.sigma * (1 - 1e-4) for one in told)
