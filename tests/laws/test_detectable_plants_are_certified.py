"""Nearly every detectable plant gets its certificate, whatever its modes, coordinates and units; the rest is told why.

A slice of `tests/benchmarks/bench_certify_random.py` that takes seconds, with what once was left undecided among it.
"""

from __future__ import annotations

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, certify
from sampling_design.certificates import certify as room
from sampling_design.certificates.exact import weight_choice
from sampling_design.certificates.form.verdict import verdict_of
from sampling_design.errors import UndecidedError
from tests.benchmarks.bench_certify_random import drawn

QUICK = (3, 5, 6, 7)
"""One to three states in mixed units; 5: two gauges, 1e12 apart, of one state."""


@pytest.mark.parametrize("seed", QUICK)
def test_a_drawn_plant_is_certified(seed):
    plant, schedule = drawn(seed)
    made = certify(plant, schedule)
    assert made.verify().passed
    assert np.isfinite(made.horizon().minimum)


def test_outputs_that_are_nearly_exact_in_the_plants_units(monkeypatch):
    """Eight states, noises 1e-30 of what a unit disturbance does: composed periods once settled nowhere."""
    monkeypatch.setattr(weight_choice, "SEARCH_WORK", 2e5)  # the best first guess will do
    plant, schedule = drawn(16)
    assert certify(plant, schedule).verify().passed


def test_weights_of_a_large_condition_are_proven_in_floats():
    """P2 of condition 1e10 in random coordinates: its inverse loses twenty digits of Y, Z with Y = Z'Z loses ten."""
    rng = np.random.default_rng(4)
    Q = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    plant = Plant(Q @ np.diag([-0.1, -0.2, -0.3]) @ Q.T, np.eye(3) @ Q.T)
    P2 = Q @ np.diag([1.0, 1e-5, 1e-10]) @ Q.T
    made = certify(plant, PeriodicSchedule([1.0]), eta=0.1, P2=(P2 + P2.T) / 2)
    assert verdict_of(made.to_dict()).passed


def test_where_the_best_rate_cannot_be_proven_another_is(monkeypatch):
    """The least horizon may ask for a rate and a lambda that no proof in doubles reaches."""
    monkeypatch.setattr(weight_choice, "SEARCH_WORK", 1e5)
    plant, schedule = drawn(2)
    plain = certify(plant, schedule)
    failing = plain.eta
    closed = room._Proof.closed

    def fails(proof, solver, plainly=False):
        if proof.eta == pytest.approx(failing, rel=0.2):
            raise UndecidedError("undecided: the proof is made to fail")
        return closed(proof, solver, plainly)

    monkeypatch.setattr(room._Proof, "closed", fails)
    spare = certify(plant, schedule)
    assert spare.eta != pytest.approx(failing, rel=0.2)
    assert "at the best rate no proof closed" in spare.solver.details["weights"]
    assert spare.horizon().minimum >= plain.horizon().minimum * (1 - 1e-3)


def test_what_cannot_be_followed_is_undecided_with_its_reason():
    """Four modes within 4e-6 of each other, seen by one output: no rounding tells them apart."""
    plant, schedule = drawn(64)
    with pytest.raises(UndecidedError, match="the schedule is on the edge of what can be certified"):
        certify(plant, schedule)
