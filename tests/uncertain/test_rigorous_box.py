"""Sigma over a box of constant parameters in ball arithmetic: fifty digits, where it is tight, where it must fail."""

import sys

import mpmath
import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, SpacedWindows, window_sigma, worst_case_sigma
from sampling_design.errors import MissingExtraError
from sampling_design.numerics.balls import ball, floats, matrix, precision
from sampling_design.observability.windows.balls import exact_times
from sampling_design.observability.windows.pieces import window_pieces
from sampling_design.plants.plant import Signals
from sampling_design.records.budget import Budget
from sampling_design.uncertain.box.balls import BallBox, largest_over
from sampling_design.uncertain.box.model import BALLS, BoxCells, BoxModel, CellNorms, bases, norms_in
from sampling_design.uncertain.observability import window_sigma_over_box, worst_case_over_box
from sampling_design.uncertain.observability.window_sigma_over_box import WindowCells, WindowsOverBox, prove_over_box
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests.cases import few
from tests.observability.test_rigorous_sigma import sigma_at
from tests.oracles.boxes import drawn_values, matrices, random_box

KEYS = ("rate", "size", "moved", "output_size", "output_moved")
OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
FREQUENCY = UncertainParameter("omega^2", 0.81, 1.21, A=[[0.0, 0.0], [-1.0, 0.0]], nominal=1.0)
GAIN = UncertainParameter("gain", 0.9, 1.1, C=[[1.0, 0.0]], nominal=1.0)
TWO = Plant([[0.0, 1.0], [-1.0, 0.1]], np.eye(2))
UNITS = Plant(
    [[0.0, 1e9], [-1e-9, 0.0]], [[1e-4, 0.0]], states=Signals(["x", "v"], (), [1e4, 1e-5]), outputs=Signals(["y"])
)
CASES = {
    "frequency": (UncertainPlant(OSCILLATOR, [FREQUENCY]), PeriodicSchedule([1.0, 0.7]), 3.0),
    "frequency and gain": (UncertainPlant(OSCILLATOR, [FREQUENCY, GAIN]), PeriodicSchedule([1.0]), 3.0),
    "partial outputs": (
        UncertainPlant(TWO, [UncertainParameter("d", -0.02, 0.03, A=[[0.0, 0.0], [0.3, 1.0]])]),
        PeriodicSchedule([0.7, 0.4], outputs=[[1, 0], [0, 1]]),
        2.0,
    ),
    "nothing unknown": (
        UncertainPlant(OSCILLATOR, [UncertainParameter("k", 1.0, 1.0, A=OSCILLATOR.A, nominal=1.0)]),
        PeriodicSchedule([0.5, 1.3, 0.9]),
        4.0,
    ),
    "scales": (
        UncertainPlant(UNITS, [UncertainParameter("k", -0.02, 0.03, A=[[0.0, 0.0], [-1e-9, 0.0]])]),
        PeriodicSchedule([0.9]),
        3.0,
    ),
}


@pytest.mark.parametrize("name", few(CASES, 0))
def test_lower_is_proven_and_gives_hardly_anything_away(name):
    plant, schedule, window = CASES[name]
    plain = window_sigma(plant, schedule, window, rtol=0.1)
    proven = window_sigma(plant, schedule, window, rtol=0.1, rigorous=True)
    assert proven.rigorous
    assert proven.closed
    assert plain.lower * (1 - 2e-6) <= proven.lower <= plain.lower
    assert 0 <= proven.slack <= 1e-13
    assert "ball arithmetic" in proven.claim.theorem
    assert "proven in ball arithmetic" in proven.explain()
    assert proven.to_dict()["rigorous"] is True
    assert proven.coordinates == plain.coordinates


def cells(plant, schedule, window):
    """The proof of a box and a schedule, and what it is about."""
    asked = WindowsOverBox(BoxModel.of(plant, "window_sigma", window), window_pieces(schedule, window))
    return WindowCells(asked, schedule, exact_times(schedule, asked.pieces), Budget(60.0)), asked


def test_a_bound_too_high_by_1e_9_is_never_proven_and_one_just_below_is():
    """Without unknown parameters and positions the proof is as sharp as its numbers."""
    plant = UncertainPlant(OSCILLATOR, [UncertainParameter("k", 1.0, 1.0, A=OSCILLATOR.A, nominal=1.0)])
    schedule = PeriodicSchedule([0.5, 1.3, 0.9]).between(0.0, 3.5)
    window = float(schedule.times[-1] - schedule.times[0])
    search, asked = cells(plant, schedule, window)
    exact = float(sigma_at(OSCILLATOR, schedule.times, mpmath.mpf(float(schedule.times[0]))))
    with precision():
        assert not search.proves(exact * (1 + 1e-9))
    assert prove_over_box(asked, schedule, exact * (1 - 1e-9), 60.0).lower == exact * (1 - 1e-9) * (1 - 1e-6)


def test_a_bound_above_one_plant_of_the_box_is_never_proven():
    plant, schedule, window = CASES["frequency and gain"]
    worst = window_sigma(plant, schedule, window, rtol=0.1).upper
    search, _ = cells(plant, schedule, window)
    with precision():
        assert not search.proves(worst * 1.01)


@pytest.mark.parametrize("seed", few([0, 6], 0))
def test_no_plant_of_a_box_lies_below_in_fifty_digits(seed):
    rng = np.random.default_rng(seed)
    plant, schedule = random_box(rng), PeriodicSchedule(rng.uniform(0.3, 1.0, 2))
    window = float(rng.uniform(1.5, 2.5) * plant.n_states)
    found = window_sigma(plant, schedule, window, rtol=0.3, budget=2.0, rigorous=True)
    assert found.lower > 0
    for _ in range(3):
        one = Plant(*matrices(plant, drawn_values(plant, rng)))
        for start in rng.uniform(0, schedule.period, 2):
            times = schedule.between(float(start), float(start) + window).times
            assert sigma_at(one, times, mpmath.mpf(float(start))) >= found.lower


def test_the_worst_case_over_a_box_is_proven_too():
    near = UncertainParameter("omega^2", 0.97, 1.03, A=FREQUENCY.A, nominal=1.0)
    plant, family = UncertainPlant(OSCILLATOR, [near]), SpacedWindows(4.0, 3, 0.8)
    plain = worst_case_sigma(plant, family, rtol=0.3, budget=None)
    found = worst_case_sigma(plant, family, rtol=0.3, rigorous=True)
    assert found.closed
    assert plain.lower * (1 - 2e-6) <= found.lower <= plain.lower
    assert "ball arithmetic" in found.claim.theorem
    assert found.to_dict()["rigorous"] is True
    for omega2 in (0.97, 1.03):
        one = plant.at([omega2])
        assert sigma_at(one, worst_case_sigma(one, family).witness, 0) >= found.lower


def test_a_norm_too_small_is_never_proven():
    """The metric of a skew matrix: e^{At} keeps lengths, so that the rate is zero and nothing below it is proven."""
    with precision():
        box = BallBox(BoxModel.of(CASES["frequency"][0], "window_sigma", 1.0))
        for _, norms, _ in box.metrics(box.cell(np.zeros(1), np.ones(1)), 3.0):
            assert float(norms.rate) >= -1e-15
            assert float(norms.moved) >= 0.19
        W = matrix(np.diag([1.0, 4.0]))
        assert float(largest_over(matrix(np.diag([3.0, 4.0])), W)) == pytest.approx(3.0, rel=1e-11)
        assert largest_over(W, matrix(np.diag([1.0, -1.0]))) is None
        assert floats(W)[1, 1] == 4.0


def test_what_is_not_proven_says_so(monkeypatch):
    plant, schedule, window = CASES["frequency"]
    _, asked = cells(plant, schedule, window)
    assert prove_over_box(asked, schedule, 0.1, -1.0)[::2] == (0.0, "budget")
    assert prove_over_box(asked, schedule, 0.0, 60.0)[::2] == (0.0, "closed")
    few = window_sigma(plant, schedule, 0.5, rigorous=True)
    assert (few.lower, few.status, few.closed) == (0.0, "too few samples", True)
    attained = window_sigma(plant, schedule, window, rtol=0.1).upper
    monkeypatch.setattr(window_sigma_over_box, "SMALLEST", 2.0)
    assert prove_over_box(asked, schedule, attained * 2, 60.0)[::2] == (0.0, "rounding")
    family = SpacedWindows(4.0, 3, 0.8)
    monkeypatch.setattr(worst_case_over_box, "SMALLEST", 2.0)
    monkeypatch.setattr(worst_case_over_box, "_pulse_sizes", lambda *_: None)
    rough = worst_case_sigma(plant, family, rtol=0.6, rigorous=True)
    assert (rough.lower, rough.status) == (0.0, "rounding")
    late = worst_case_sigma(plant, family, rtol=0.6, budget=0.0, rigorous=True)
    assert (late.lower, late.status) == (0.0, "budget")


def test_without_the_extra_the_refusal_names_it(monkeypatch):
    plant, schedule, window = CASES["frequency"]
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(MissingExtraError, match="python-flint, which is not installed"):
        window_sigma(plant, schedule, window, rigorous=True)
    with pytest.raises(MissingExtraError, match="python-flint, which is not installed"):
        worst_case_sigma(plant, SpacedWindows(4.0, 3, 0.8), rtol=0.6, rigorous=True)


@pytest.mark.parametrize("name", few(CASES, 1))
def test_norms_of_a_cell_in_floats_are_those_of_balls(name):
    """One formula for both: what it makes of the same numbers agrees, and floats give no smaller bound than balls."""
    model = BoxModel.of(CASES[name][0], "window_sigma", 1.0)
    cell = BoxCells.whole(model.m)._replace(half=np.full((1, model.m), 0.5))
    (A, C), longest = model.at(cell.u), 3.0
    inverses = [np.linalg.inv(T).astype(complex) for T in bases(A, C, np.array([longest]))]
    every = [
        norms_in(model, cell, A, C, T, inverse)[0]
        for T, inverse in zip(bases(A, C, np.array([longest])), inverses, strict=True)
    ]
    with precision():
        box = BallBox(model)
        metrics = box.metrics(box.cell(cell.u[0], cell.half[0]), longest)
        for norms, (_, in_balls, _) in zip(every, metrics, strict=True):
            for key in KEYS:
                own, size = float(getattr(norms, key)[0, 0]), float(norms.size[0, 0])
                assert own == pytest.approx(float(getattr(in_balls, key)), rel=3e-5, abs=2e-5 * size), key
            for r in (0.0, 1e-9, 1e-3, 1.0, 40.0):
                same = CellNorms(*(ball(float(getattr(norms, k)[0, 0])) for k in KEYS), BALLS)
                found = [*norms.rows(np.array([[r]]), norms.rate), norms.turned(np.array([[r]]))]
                proven = [*same.rows(ball(r), same.rate), same.turned(ball(r))]
                for value, exact in zip(found, proven, strict=True):
                    assert float(exact) * (1 - 1e-13) <= float(value[0, 0]) <= float(exact) * (1 + 1e-3)
