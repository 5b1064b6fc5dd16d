"""Nonlinear plants: what they compute, what they refuse."""

import casadi
import numpy as np
import pytest

from sampling_design import Plant
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear.model import NonlinearPlant, from_linear
from sampling_design.nonlinear.thyroid import TRUE_START, thyroid
from sampling_design.plants.plant import Signals

SIZES = {"states": 2, "inputs": 1, "disturbances": 1, "outputs": 1}


def dynamics(x, u, w):
    return [x[1] * x[0], -(x[0] ** 3) + u[0] * x[1] + w[0]]


def output(x, u, v):
    return [x[0] ** 2 + u[0] + v[0]]


def plant(**details):
    return NonlinearPlant(dynamics, output, SIZES, **details)


@pytest.mark.parametrize(
    ("subject", "x", "u"), [(plant(), [0.7, -1.2], [0.4]), (thyroid(), TRUE_START, [1e-12, 1e-13])]
)
def test_the_linearisation_is_the_slope_of_small_steps(subject, x, u):
    linear, (sx, su, sw) = (
        subject.linearise(x, u),
        (subject.signals[key].scales for key in ("states", "inputs", "disturbances")),
    )
    for matrix, scale, shift in (
        (linear.A, sx, lambda d: subject.f(x + d, u)),
        (linear.B, su, lambda d: subject.f(x, u + d)),
        (linear.G, sw, lambda d: subject.f(x, u, d)),
        (linear.C, sx, lambda d: subject.h(x + d, u)),
        (linear.D, su, lambda d: subject.h(x, u + d)),
    ):
        for i in range(scale.size):
            step = 1e-5 * scale * np.eye(scale.size)[i]
            slope = (shift(step) - shift(-step)) / 2e-5
            assert matrix[:, i] * scale[i] == pytest.approx(slope, rel=1e-6, abs=1e-6 * np.abs(slope).max() + 1e-30)


def test_a_linear_plant_stays_what_it_is():
    linear = Plant(
        [[0.0, 1.0], [-2.0, -0.1]], [[1.0, 0.5]], B=[[0.0], [3.0]], D=[[0.7]], outputs=Signals(("y",), ("m",), [2.0])
    )
    back = from_linear(linear).linearise([0.3, 0.4], [0.1])
    for key in "ABCDG":
        assert np.array_equal(getattr(back, key), getattr(linear, key))
    assert from_linear(linear).signals["noises"].scales.tolist() == [2.0]
    assert from_linear(linear, noises=False).n_noises == 0


def test_an_equilibrium_is_found_or_refused():
    assert plant().equilibrium([0.9, 0.1], [1.0]) == pytest.approx([0.0, 0.0], abs=1e-6)
    adrift = NonlinearPlant(lambda x, u, w: [1.0 + x[0] ** 2], lambda x, u, v: [x[0]], {"states": 1, "outputs": 1})
    with pytest.raises(SolverError, match="no equilibrium found near `guess`") as caught:
        adrift.equilibrium([0.3])
    assert caught.value.status == "diverged"


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: NonlinearPlant(dynamics, output, {"states": 2}), "`sizes` must give the number of outputs"),
        (lambda: NonlinearPlant(dynamics, output, {**SIZES, "state": 2}), "unknown key 'state'"),
        (lambda: NonlinearPlant(dynamics, output, {**SIZES, "states": 3}), "`dynamics` must return 3 entries, got 2"),
        (
            lambda: NonlinearPlant(dynamics, output, {**SIZES, "outputs": 2}),
            "`measurement` must return 2 entries, got 1",
        ),
        (lambda: plant(time_unit="fortnight"), "`time_unit`"),
        (
            lambda: plant(bounds={"states": (1.0, 0.0)}),
            r"`bounds\['states'\]` must be \(lower, upper\) with lower <= upper",
        ),
        (
            lambda: plant(bounds={"states": ([0.0], [1.0])}),
            r"must be a pair \(lower, upper\) of numbers or of 2 entries",
        ),
        (lambda: plant(signals={"states": Signals(("a",))}), r"`signals\['states'\]` must have 2 entries, got 1"),
        (lambda: plant().with_bounds(state=None), "unknown key 'state' in `with_bounds`"),
        (lambda: plant().f([1.0], [0.0]), "`x` must have 2 entries"),
        (lambda: plant().linearise([0.0, 0.0], [1.0, 2.0]), "`u` must have 1 entry, got 2"),
    ],
)
def test_what_makes_no_plant_is_refused(make, words):
    with pytest.raises(ArgumentError, match=words):
        make()


def test_a_value_that_is_no_number_is_refused_with_the_place():
    root = NonlinearPlant(lambda x, u, w: [casadi.sqrt(x[0])], lambda x, u, v: [x[0]], {"states": 1, "outputs": 1})
    with pytest.raises(
        ArgumentError, match=r"`dynamics` returns \[nan\] at x = \[-1.0\]: the model is not finite there"
    ):
        root.f([-1.0])


def test_boxes_are_replaced_and_the_plant_stays():
    first = plant(bounds={"states": (-1.0, 1.0)})
    other = first.with_bounds(states=None, noises=(-0.1, 0.1))
    assert np.all(np.isinf(other.bounds["states"][0]))
    assert other.bounds["noises"][1].tolist() == [0.1]
    assert first.bounds["states"][0].tolist() == [-1.0, -1.0]


def test_a_plant_says_what_it_is():
    assert "2 states, 1 output" in plant().explain()
    assert "x1, x2" in str(plant(name="toy"))
