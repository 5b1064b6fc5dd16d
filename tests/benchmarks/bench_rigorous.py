"""Time of the proofs in ball arithmetic, first calls and their tables included."""

import numpy as np
import pytest

from sampling_design import (
    GapRange,
    PeriodicSchedule,
    Plant,
    SpacedWindows,
    certify,
    named_plant,
    window_sigma,
    worst_case_sigma,
)
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.observability.windows.balls import prove_window_sigma
from sampling_design.observability.windows.pieces import window_pieces
from sampling_design.observability.worst_case.balls import prove_worst_sigma

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def three_oscillators():
    A = np.zeros((6, 6))
    for k, speed in enumerate((0.5, 1.0, 2.0)):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0.0, speed], [-speed, 0.0]]
    return Plant(A, [[1.0, 0.0, 1.0, 0.0, 1.0, 0.0]])


def twenty_gaps():
    return PeriodicSchedule(np.random.default_rng(3).uniform(0.3, 1.2, 20))


@pytest.mark.parametrize("factor", [1.0, 1.01], ids=["proven", "refuted"])
def test_twenty_samples_six_states(benchmark, factor):
    made = certify(three_oscillators(), twenty_gaps(), eta=0.1, P2=np.eye(6))
    data = (
        type(made)
        .from_matrices(
            made.plant, made.schedule, P1=made.P1 * factor, P2=made.P2, Qw=made.Qw, R=made.R, Qv=made.Qv, eta=made.eta
        )
        .to_dict()
    )
    verdict = benchmark.pedantic(verify_rigorously, args=(data,), rounds=3)
    assert verdict.verdict == ("proven" if factor == 1.0 else "refuted")


@pytest.mark.parametrize("longest", [1.5, 2.5])
def test_gap_range_of_the_oscillator(benchmark, longest):
    family = GapRange(0.5, longest)
    data = certify(OSCILLATOR, family, Qw=np.eye(2), R=[[1.0]], Qv=[[1.0]], eta=0.1).to_dict()
    assert benchmark.pedantic(verify_rigorously, args=(data,), rounds=3).verdict == "proven"


def test_tidal_gauge_eleven_states(benchmark):
    plant, schedule = named_plant("tidal_gauge"), PeriodicSchedule(np.random.default_rng(1).uniform(8, 14, 16))
    guess = window_sigma(plant, schedule, 168.0).lower
    pieces = window_pieces(schedule, 168.0)
    assert benchmark.pedantic(prove_window_sigma, args=(plant, schedule, pieces, guess), rounds=3).lower > 0


def test_worst_case_of_two_oscillators(benchmark):
    A = [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -9.0, 0.0]]
    plant, family = Plant(A, [[1.0, 0.0, 1.0, 0.0]]), SpacedWindows(4.0, 7, 0.4)
    found = worst_case_sigma(plant, family, rtol=0.05)
    args = (plant, family, found.lower, found.witness)
    assert benchmark.pedantic(prove_worst_sigma, args=args, rounds=3).lower > 0.12
