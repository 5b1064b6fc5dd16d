"""Intervals hold the truth, to fifty digits; programs hold every derivative."""

import mpmath
import numpy as np
import pytest

from sampling_design.checkers import intervals as iv
from sampling_design.checkers import programs
from sampling_design.checkers.intervals import Interval
from sampling_design.checkers.strict import BadFile

FUNCTIONS = {
    "exp": (iv.exponential, mpmath.exp, 20.0),
    "sin": (iv.sine, mpmath.sin, 1e4),
    "cos": (iv.cosine, mpmath.cos, 50.0),
    "atan": (iv.arctangent, mpmath.atan, 30.0),
    "tanh": (iv.tangent_hyperbolic, mpmath.tanh, 3.0),
    "log": (iv.logarithm, mpmath.log, 1e3),
    "sqrt": (iv.root, mpmath.sqrt, 1e3),
    "square": (iv.square, lambda x: x * x, 1e3),
    "inverse": (iv.inverse, lambda x: 1 / x, 1e3),
    "power": (lambda x: iv.power(x, -3), lambda x: x**-3, 10.0),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_at_single_points_are_inside(name):
    function, truth, scale = FUNCTIONS[name]
    rng = np.random.default_rng(0)
    x = rng.normal(size=120) * scale * rng.choice([1, 1e-3, 1e-6], 120)
    x = np.abs(x) if name in ("log", "sqrt") else x
    found = function(Interval(x, x))
    with mpmath.workdps(50):
        for at, low, high in zip(x.tolist(), found.low.tolist(), found.high.tolist(), strict=True):
            exact = truth(mpmath.mpf(at))
            assert mpmath.mpf(low) <= exact <= mpmath.mpf(high)
            assert high - low <= 1e-6 * (abs(float(exact)) + 1e-3)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_values_inside_a_cell_are_inside(name):
    function, truth, scale = FUNCTIONS[name]
    rng = np.random.default_rng(1)
    low = rng.normal(size=60) * scale * rng.choice([1, 1e-2], 60)
    low = np.abs(low) if name in ("log", "sqrt") else low
    high = low + rng.exponential(size=60) * rng.choice([1e-3, 0.1, 2.0], 60)
    found = function(Interval(low, high))
    with mpmath.workdps(50):
        for k in range(60):
            for share in (0.0, 0.3, 0.6, 1.0):
                at = low[k] + share * (high[k] - low[k])
                if at != 0:
                    exact = truth(mpmath.mpf(float(min(at, high[k]))))
                    assert mpmath.mpf(float(found.low[k])) <= exact <= mpmath.mpf(float(found.high[k]))


def test_what_is_not_defined_says_nothing():
    x = Interval(np.array([-1.0]), np.array([1.0]))
    for function in (iv.inverse, iv.logarithm, iv.root):
        assert not np.isfinite(function(x).high).any()
    far = Interval(np.array([1e17]), np.array([1e17]))
    assert (iv.sine(far).low, iv.sine(far).high) == (-1.0, 1.0)
    free = Interval(np.array([-np.inf]), np.array([np.inf]))
    assert (iv.cosine(free).low, iv.cosine(free).high) == (-1.0, 1.0)


CODE = [["x", 0], ["x", 1], ["w", 0], ["constant", 2.5], ["mul", 0, 1], ["sin", 4], ["div", 5, 3], ["exp", 1]]
CODE += [["sub", 6, 7], ["power", 3, 0.5], ["mul", 8, 9], ["abs", 0], ["add", 10, 11], ["twice", 2], ["add", 12, 13]]
CODE += [["tanh", 0], ["cosh", 1], ["mul", 15, 16], ["square", 0], ["inverse", 3], ["neg", 18], ["atan", 20]]
CODE += [
    ["sqrt", 3],
    ["log", 3],
    ["tan", 15],
    ["sinh", 1],
    ["add", 21, 24],
    ["mul", 25, 26],
    ["cos", 22],
    ["add", 17, 27],
]
SIZES = {"x": 2, "u": 0, "w": 1}


@pytest.mark.long
def test_derivatives_over_a_cell_hold_differences():
    program = programs.read({"code": CODE, "outputs": [14, 29]}, "f", SIZES)
    rng = np.random.default_rng(2)
    low = np.array([0.2, -0.4, 0.0])
    high = np.array([0.5, 0.1, 0.3])

    def value(z):
        point = [Interval(np.array([v]), np.array([v])) for v in z]
        done = programs.every(program, {"x": point[:2], "w": point[2:]}, ())
        return np.array([done[k][0].middle[0] for k in program.outputs])

    cell = [Interval(np.array([a]), np.array([b])) for a, b in zip(low, high, strict=True)]
    done = programs.every(program, {"x": cell[:2], "w": cell[2:]}, ("x", "w"))
    found = [done[k] for k in program.outputs]
    for _ in range(6):
        z, step = rng.uniform(low, high - 1e-5), 1e-6
        for j, key in enumerate([("x", 0), ("x", 1), ("w", 0)]):
            slope = (value(z + step * np.eye(3)[j]) - value(z)) / step
            for i, (_, slopes) in enumerate(found):
                part = slopes.get(key, Interval(np.zeros(1), np.zeros(1)))
                assert part.low[0] - 1e-5 <= slope[i] <= part.high[0] + 1e-5


@pytest.mark.parametrize(
    ("data", "match"),
    [
        ({"code": [["x", 2]], "outputs": []}, "must be one of 2 inputs x, got number 2"),
        ({"code": [["sin", 0]], "outputs": []}, "must use earlier results only"),
        ({"code": [["import", 0]], "outputs": []}, "must be a known instruction"),
        ({"code": [["add", 0]], "outputs": []}, "must be a known instruction"),
        ({"code": ["x"], "outputs": []}, "must be a list of a word and numbers"),
        ({"code": [["constant", True]], "outputs": []}, "must be a number"),
        ({"code": [["constant", 1.0]], "outputs": [1]}, "must be places among 1 instructions"),
        ({"code": [["constant", 1.0]] * 20001, "outputs": []}, "must have at most 20000 instructions"),
    ],
)
def test_a_program_is_a_grammar(data, match):
    with pytest.raises(BadFile, match=match):
        programs.read(data, "f", SIZES)
