"""Law: an interrupt (Ctrl-C), whenever it comes, leaves the bracket that was proven by then, of plants of every kind;
where nothing is proven yet the record says "undecided", and never 0 as if that were found."""

import contextlib
import sys
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.observability.worst_case import spaced_search
from sampling_design.uncertain.plants.time_varying import TimeVaryingPlant
from tests.cases import few

PACKAGE = str(Path(sd.__file__).parent)
OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
TURNING = sd.Plant([[0.3, 1.0, 0.0], [-1.5, 0.1, 0.6], [0.2, 0.9, -0.4]], [[1.0, 0.2, -0.7]])
BOX = sd.UncertainPlant(OSCILLATOR, [sd.UncertainParameter("k", -0.1, 0.1, A=[[0.0, 0.0], [1.0, 0.0]])])
SLOPES = [[[0.0, 1.0], [-k, 0.0]] for k in (1.0, 2.0, 1.2)]
VARYING = TimeVaryingPlant.from_table([0.0, 4.0, 8.0], SLOPES, [[[1.0, 0.0]]] * 3)
RHYTHM, NINE = sd.PeriodicSchedule([0.9, 1.4]), sd.Schedule(np.arange(0.3, 8.0, 0.9))
UNEVEN, FEW = sd.PeriodicSchedule([0.9, 1.4, 1.1]), sd.SpacedWindows(4.0, 3, 0.5)
VERBS = {
    "window": ("bracket.py", lambda: sd.window_sigma(TURNING, UNEVEN, 4.0, 1e-9)),
    "late samples": ("bracket.py", lambda: sd.window_sigma(TURNING, UNEVEN, 4.0, 1e-9, timing_tolerance=0.01)),
    "window, box": ("branch_and_bound.py", lambda: sd.window_sigma(BOX, RHYTHM, 4.0, 0.1)),
    "window, varying": ("bracket_varying.py", lambda: sd.window_sigma(VARYING, NINE, 3.0, 1e-5)),
    "first windows, varying": ("time_varying.py", lambda: sd.window_sigma(VARYING, NINE, 3.0, 0.9)),
    "worst case": ("spaced_sphere.py", lambda: sd.worst_case_sigma(OSCILLATOR, FEW, 1e-4)),
    "worst case, box": ("spaced_sphere.py", lambda: sd.worst_case_sigma(BOX, FEW, 0.1)),
}
"""Where each searches, and the call."""
PLACES = 4


class Interrupt:
    """Raises at one call of a function of the package, or of one of its files; counts them."""

    def __init__(self, at: int, place: str = "") -> None:
        self.at, self.place, self.calls = at, place, 0

    def step(self, frame, event, _):
        name = frame.f_code.co_filename
        if event == "call" and name.startswith(PACKAGE) and name.endswith(self.place):
            self.calls += 1
            if self.calls == self.at:
                raise KeyboardInterrupt  # Python forgets the profiler then

    @contextlib.contextmanager
    def running(self):
        sys.setprofile(self.step)
        try:
            yield self
        finally:
            sys.setprofile(None)


@pytest.mark.parametrize("verb", few(VERBS, 0, 2, 4))
def test_an_interrupt_leaves_the_bracket(verb):
    where, call = VERBS[verb]
    call()  # what is kept for the next call is not counted
    with Interrupt(0, where).running() as counted:
        whole = call()
    kept = 0
    for place in range(1, PLACES):
        with Interrupt(counted.calls * place // PLACES, where).running(), contextlib.suppress(KeyboardInterrupt):
            left = call()
            assert (left.status, left.closed) == ("interrupted", False)
            assert left.lower <= whole.upper * (1 + 1e-9)
            assert whole.lower * (1 - 1e-9) <= left.upper
            assert "interrupted before the bracket closed" in left.explain()
            assert left.deviations is None  # whoever interrupts waits for nothing more
            assert ("undecided" in left.explain()) == ("undecided" in str(left)) == (left.lower == 0)
            kept += 1
    assert kept >= PLACES / 2


@pytest.mark.parametrize("verb", few([each for each in VERBS if each != "first windows, varying"], 0, 2, 4))
def test_an_interrupt_of_what_stands_beside_sigma_leaves_sigma(verb):
    """Late and lost samples are judged when a record is shown: what it had proven was thrown away with them."""
    where, call = VERBS[verb]
    found = call()
    assert call().deviations is not None
    with Interrupt(5, where).running():
        assert found.deviations is None
    assert (found.status, "sample is lost" in found.explain()) == (call().status, False)


def test_a_proof_in_balls_that_is_interrupted_leaves_what_floats_have_proven():
    call = lambda: sd.window_sigma(OSCILLATOR, RHYTHM, 4.0, rigorous=True)  # noqa: E731
    call()
    with Interrupt(0).running() as counted:
        call()
    with Interrupt(counted.calls * 3 // 4).running():
        left = call()
    assert (left.status, left.rigorous) == ("interrupted", False)
    assert left.lower == sd.window_sigma(OSCILLATOR, RHYTHM, 4.0).lower


def test_however_long_the_search_took_the_proof_has_its_share(monkeypatch):
    import time

    clock, found = [0.0], spaced_search.search_worst

    def slow(*arguments):
        clock[0] += 100.0
        return found(*arguments)

    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(spaced_search, "search_worst", slow)
    assert sd.worst_case_sigma(OSCILLATOR, FEW, budget=60.0).closed


@pytest.mark.parametrize("plant", [OSCILLATOR, BOX])
def test_without_any_time_for_a_bound_it_is_undecided(plant):
    found = sd.worst_case_sigma(plant, sd.SpacedWindows(4.0, 5, 0.2), rtol=1e-3, budget=0.0)
    assert (found.lower, found.status) == (0.0, "budget")
    assert "sigma at least 0, undecided" in str(found)
    assert "whether sigma is positive is undecided" in found.explain()
