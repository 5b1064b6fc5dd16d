"""At most q of the last m samples may show anything: the interval is that of all that some choice of them leaves."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError
from tests.cases import few
from tests.oracles.records import WholeRecord

WITHIN = 0.01
"""Share of the width that an interval may be wider: what its cells and its solver leave open."""

WALK = sd.Plant([[0.0]], [[1.0]])
BOUNDS = {"w_bound": 0.1, "v_bound": 0.3, "initial_error": 5.0, "prior_time": 0.0}


@pytest.mark.parametrize("seed", few(range(40), 0))
def test_it_is_the_hull_of_what_linear_programs_without_some_samples_say(seed):
    """Of random plants in random units, clocks at 1.7e9, with a bound for each sample, and wild samples among them."""
    rng = np.random.default_rng(seed)
    n, p, most = int(rng.integers(1, 4)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    A, C, G = rng.normal(size=(n, n)) - np.eye(n), rng.normal(size=(p, n)), rng.normal(size=(n, 1))
    times = [0.0, *np.cumsum(rng.uniform(0.3, 0.9, 6)).tolist()]
    whole = WholeRecord(A, np.zeros((n, 0)), C, np.zeros((p, 0)), G, times, np.zeros(n), (), 8)
    v, c = rng.uniform(0.05, 0.3, (len(times), p)), rng.normal(size=n)
    truth = np.append(
        np.concatenate([np.ones(n), np.full(whole.width - n, 0.2)]) * rng.uniform(-1, 1, whole.width), 1.0
    )
    y = np.array([[whole.row(t, i) @ truth for i in range(p)] for t in times]) + v * rng.uniform(-1, 1, v.shape)
    wild = rng.choice(np.arange(2, len(times)), most, replace=False)  # of the last five
    y[wild, 0] += rng.choice([-1, 1], most) * 4
    found = []
    for out in combinations(range(2, len(times)), most):
        kept = [k for k in range(len(times)) if k not in out]
        rows = [(whole.row(times[k], i), y[k, i] - v[k, i], y[k, i] + v[k, i]) for k in kept for i in range(p)]
        found.append(whole.ends(c, times[-1], rows, [(-1, 1)] * n + [(-0.2, 0.2)] * (whole.width - n)))
    low, high = (
        function(ends) for function, ends in zip((min, max), zip(*filter(None, found), strict=True), strict=True)
    )
    x, unit, origin = 10.0 ** rng.integers(-6, 7, n), 10.0 ** rng.integers(-6, 7), 1.7e9 * (seed % 2)
    plant = sd.Plant(A * x[:, None] / x, C / x * unit, G=G * x[:, None])
    record = [(origin + t, own * unit, None) for t, own in zip(times, y, strict=True)]
    given = {"w_bound": 0.2, "v_bound": v * unit, "initial_error": x, "of": (c / x)[None], "outliers": (most, 5)}
    said = sd.state_interval(plant, record, **given)
    assert said.verify()
    width = high - low
    assert -1e-6 * width <= low - said.lower[0] <= WITHIN * width
    assert -1e-6 * width <= said.upper[0] - high <= WITHIN * width
    assert said.lower[0] <= c @ whole.state[times[-1]] @ truth <= said.upper[0]
    assert not replace(said, upper=said.upper - WITHIN * width).verify()


def test_of_a_walk_it_is_known_by_hand_and_believing_all_samples_is_a_contradiction():
    """Of 1, 1 and 4 in steps of one second the last is wild, or both others are; one of three leaves the first two."""
    rows = [(1.0, [1.0]), (2.0, [1.0]), (3.0, [4.0])]
    assert np.isnan(sd.state_interval(WALK, rows, **BOUNDS).upper).all()
    one = sd.state_interval(WALK, rows, outliers=1, **BOUNDS)
    assert (one.lower[0], one.upper[0]) == pytest.approx((0.6, 1.4), rel=1e-5)
    assert one.verify()
    assert one.holds([1.4 - 1e-6])
    two = sd.state_interval(WALK, rows, outliers=2, **BOUNDS)
    assert (two.lower[0], two.upper[0]) == pytest.approx((0.5, 4.3), rel=1e-5)
    none = sd.state_interval(WALK, [(0.5, [1.0]), (1.0, [9.0]), (1.5, [1.0]), (2.0, [4.0])], outliers=(1, 2), **BOUNDS)
    assert np.isnan(none.upper).all()  # the second is believed, and the first contradicts it
    assert none.verify()
    assert none.contradiction > 1
    assert "contradict" in none.explain()


def test_times_that_are_not_known_are_resolved_by_the_samples_that_are_believed():
    swing = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])

    def truth(t):
        return np.array([np.cos(t), -np.sin(t)])

    rows = [(0.5, [9.0]), *(((t, t + 0.2), [truth(t + 0.1)[0]]) for t in (1.0, 2.0, 3.0))]
    given = {"w_bound": 0.01, "v_bound": 0.05, "initial_error": 0.5, "prior": [1.0, 0.0], "prior_time": 0.0}
    assert sd.state_interval(swing, rows, 3.2, outliers=1, **given).holds(truth(3.2))


@pytest.mark.parametrize("error", [None, 5.0])
@pytest.mark.parametrize("wild", range(3))
def test_the_input_of_a_sample_that_is_left_out_was_applied_all_the_same(wild, error):
    """x' = u in steps of 5 from the second sample on, and an input that was there before all samples."""
    walk = sd.Plant([[0.0]], [[1.0]], B=[[1.0]])
    rows = [(0.0, 3.0, [0.0]), (1.0, 3.0, [5.0]), (2.0, 8.0, None)]
    record = [(-1.0, None, [0.0]), *((t, [y + 40.0 * (k == wild)], u) for k, (t, y, u) in enumerate(rows))]
    given = {"w_bound": 0.01, "v_bound": 0.1, "initial_error": error, "outliers": 1}
    found = sd.state_interval(walk, record, 3.0, **given)
    assert found.verify()
    assert found.holds([13.0])
    assert found.radii[0] < 0.2


def test_what_is_no_number_of_samples_is_refused():
    rows = [(float(t), [0.0]) for t in range(60)]
    for outliers, words in (
        (60, "must be of the 60 samples and leave one of them, got 60"),
        ((3, 2), r"must be of the 60 samples and leave one of them, got \(3, 2\)"),
        (-1, "must be a whole number of at least 0, got -1"),
        ((1, 2, 3), r"a pair \(how many, of the last so many\), got \(1, 2, 3\)"),
        ((1, 2.5), "`outliers` must be a whole number"),
        (4, "may be 487635 sets, more than 3000: say of how many of the last samples"),
    ):
        with pytest.raises(ArgumentError, match=words):
            sd.state_interval(WALK, rows, outliers=outliers, **BOUNDS)
    with pytest.raises(ArgumentError, match="each of the `cases` has its own"):
        sd.state_interval(WALK, rows[:3], outliers=1, **BOUNDS).save("found.json")
