"""The least bounds that a record does not disprove: by hand, on both sides of the factor, and in other units."""

from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.interval import prove
from sampling_design.accuracy.record_bounds import bounds_from_record
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.errors import ArgumentError
from sampling_design.plants.rows import wanted_rows

WALK = sd.Plant([[0.0]], [[1.0]])
STEPS = [(0.0, [0.0], None), (1.0, [1.0], None), (2.0, [0.0], None)]
OSCILLATOR = sd.named_plant("oscillator")


def noisy_record(seed, noise):
    rng = np.random.default_rng(seed)
    return [(float(t), [np.sin(t) + rng.uniform(-noise, noise)], None) for t in np.cumsum(rng.uniform(0.4, 1.5, 12))]


def test_by_hand():
    """A walk 0, 1, 0: |w| = 1 with exact readings; |v| = 1/2 at rest; both together 1/3."""
    assert bounds_from_record(WALK, STEPS, w_bound=0.5, v_bound=0.0).factor == pytest.approx(2.0, rel=1e-6)
    assert bounds_from_record(WALK, STEPS, w_bound=0.0, v_bound=0.25).factor == pytest.approx(2.0, rel=1e-6)
    both = bounds_from_record(WALK, STEPS, w_bound=1.0, v_bound=1.0)
    assert both.factor == pytest.approx(1 / 3, rel=1e-6)
    assert both.w_bound == pytest.approx([1 / 3], rel=1e-6)
    assert both.v_bound == pytest.approx([1 / 3] * 3, rel=1e-6)
    noise = bounds_from_record(WALK, STEPS, w_bound=0.5, v_bound=1.0, grow="v")
    assert noise.factor == pytest.approx(0.25, rel=1e-6)
    assert noise.w_bound == pytest.approx([0.5])


def test_no_multiple_explains_what_nothing_pushes():
    found = bounds_from_record(WALK, STEPS, w_bound=0.0, v_bound=0.1, grow="w")
    assert np.isinf(found.factor)
    assert "No multiple of the bound on w" in found.explain()
    assert found.to_dict()["factor"] is None


def multiplied(found, factor):
    """The readings of a record under a multiple of its bounds."""
    readings = found.readings
    if found.grow != "v":
        readings = replace(readings, push=replace(readings.push, root=readings.push.root * factor))
    if found.grow == "both" and readings.start.root is not None:
        readings = replace(readings, start=replace(readings.start, root=readings.start.root * factor))
    if found.grow != "w":
        rows = tuple(tuple(row._replace(size=row.size * factor) for row in rows) for rows in readings.rows)
        readings = replace(readings, rows=rows)
    return readings


@pytest.mark.parametrize("grow", ["both", "w", "v"])
def test_below_the_factor_it_is_disproved_and_above_it_is_not(grow):
    record = noisy_record(1, 0.3)
    found = bounds_from_record(OSCILLATOR, record, w_bound=0.02, v_bound=0.1, grow=grow)
    assert found.verify()
    assert found.factor <= found.enough <= 1.02 * found.factor
    assert not replace(found, factor=1.01 * found.enough).verify()
    rows = wanted_rows(OSCILLATOR)
    below = prove(RecordProgram(multiplied(found, 0.99 * found.factor)), record[-1][0], rows)
    above = prove(RecordProgram(multiplied(found, 1.01 * found.enough)), record[-1][0], rows)
    assert below.contradiction > 1
    assert not above.contradiction
    assert "no more than that" in found.explain()


def test_the_factor_never_exceeds_what_made_the_record():
    for seed in range(6):
        found = bounds_from_record(OSCILLATOR, noisy_record(seed, 0.3), w_bound=0.0, v_bound=0.3)
        assert 0 < found.factor <= 1


def test_units_change_nothing():
    record = noisy_record(2, 0.3)
    small = sd.Plant(OSCILLATOR.A, 1e-9 * OSCILLATOR.C, G=OSCILLATOR.G)
    moved = [(t, [1e-9 * y[0]], u) for t, y, u in record]
    one = bounds_from_record(OSCILLATOR, record, w_bound=0.02, v_bound=0.1).factor
    two = bounds_from_record(small, moved, w_bound=0.02, v_bound=1e-10).factor
    assert two == pytest.approx(one, rel=1e-6)


def test_what_may_grow_has_a_name():
    with pytest.raises(ArgumentError, match="`grow` must be one of both, w, v"):
        bounds_from_record(WALK, STEPS, w_bound=1.0, v_bound=1.0, grow="all")
