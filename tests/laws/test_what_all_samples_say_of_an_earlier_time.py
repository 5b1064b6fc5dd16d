"""Past states: the interval at an earlier time is that of a linear program of the whole record, whatever the units."""

from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError
from tests.cases import few
from tests.oracles.records import WholeRecord

WITHIN = 0.01
"""Share of the width that an interval may be wider: what its cells and its solver leave open."""


@pytest.mark.parametrize("seed", few(range(60), 0, 1, 2))
def test_an_interval_at_an_earlier_time_is_what_a_linear_program_says(seed):
    """At a sample and between two, of plants that grow or decay, with inputs and a start that is known or not."""
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    A, B, C, G = (rng.normal(size=s) for s in ((n, n), (n, 1), (p, n), (n, 1)))
    A -= np.eye(n) * (np.linalg.eigvals(A).real.max() + rng.choice([-0.4, 0.3]))
    later, origin = [0.0, *np.cumsum(rng.uniform(0.3, 0.9, 6)).tolist()], 1.7e9 * (seed % 2)
    times = [origin + t - origin for t in later]  # as a record holds them
    at = times[3] if seed % 2 else times[2] + 0.2
    inputs = [(times[1], rng.normal(size=1)), (times[4], rng.normal(size=1))]
    marks = sorted({*times, at})
    whole = WholeRecord(A, B, C, np.zeros((p, 1)), G, marks, np.zeros(n), inputs, 10)
    c, free = rng.normal(size=n), seed % 3 == 0
    truth = np.append(
        np.concatenate([np.ones(n), np.full(whole.width - n, 0.2)]) * rng.uniform(-1, 1, whole.width), 1.0
    )
    y = np.array([[whole.row(t, i) @ truth for i in range(p)] for t in times]) + rng.uniform(-0.1, 0.1, (len(times), p))
    rows = [(whole.row(t, i), y[k, i] - 0.1, y[k, i] + 0.1) for k, t in enumerate(times) for i in range(p)]
    start = [(None, None) if free else (-1, 1)] * n
    low, high = whole.ends(c, at, rows, start + [(-0.2, 0.2)] * (whole.width - n))
    x, unit = 10.0 ** rng.integers(-6, 7, n), 10.0 ** rng.integers(-6, 7)
    plant = sd.Plant(A * x[:, None] / x, C / x * unit, B=B * x[:, None], G=G * x[:, None])
    u = dict(inputs)
    record = [(origin + t, own * unit, u.get(t)) for t, own in zip(times, y, strict=True)]
    given = {"w_bound": 0.2, "v_bound": np.full(p, 0.1 * unit), "of": (c / x)[None], "prior_time": origin}
    said = sd.state_interval(plant, record, origin + at, **given, **({} if free else {"initial_error": x}))
    assert said.verify()
    width, slack = high - low, 1e-6 * (high - low)
    assert -slack <= low - said.lower[0] <= WITHIN * width
    assert -slack <= said.upper[0] - high <= WITHIN * width
    assert said.lower[0] <= c @ whole.state[at] @ truth <= said.upper[0]
    assert not replace(said, upper=said.upper - 2 * WITHIN * width).verify()


def test_what_comes_later_narrows_the_past_and_what_no_file_holds_is_said():
    """x' = w: of the level at 1 readings at 1 and 2 leave what both do, w in between at most."""
    walk, bounds = sd.Plant([[0.0]], [[1.0]]), {"w_bound": 0.1, "v_bound": 0.3, "prior_time": 0.0}
    rows = [(1.0, [1.0]), (2.0, [1.5])]
    past = sd.state_interval(walk, rows, 1.0, **bounds)
    assert (past.lower[0], past.upper[0]) == pytest.approx((1.1, 1.3), rel=1e-6)
    assert sd.state_interval(walk, rows, 1.5, **bounds).radii == pytest.approx([0.1], rel=1e-5)
    wild = sd.state_interval(walk, [*rows, (3.0, [9.0])], 1.0, outliers=1, **bounds)
    assert (wild.lower[0], wild.upper[0]) == pytest.approx((1.1, 1.3), rel=1e-6)
    with pytest.raises(ArgumentError, match=r"of its last sample or later: of earlier times call verify\(\)"):
        past.save("past.json")
    with pytest.raises(ArgumentError, match=r"`t` must not lie before the start 0\.0, got -1\.0"):
        sd.state_interval(walk, rows, -1.0, **bounds)
