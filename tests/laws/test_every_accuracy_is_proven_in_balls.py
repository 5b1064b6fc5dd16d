"""Both sides of every accuracy hold in ball arithmetic, on drawn plants, schedules and bounds; forged ones do not.

`python -m tests.laws.test_every_accuracy_is_proven_in_balls 200` draws as many.
"""

import sys
from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from tests.cases import few

pytest.importorskip("flint")


def drawn(seed):
    """A plant with poles on both sides of the axis, a schedule of one to three samples, balls or boxes."""
    rng = np.random.default_rng([14, seed])
    n = int(rng.integers(1, 3))
    A = rng.normal(size=(n, n)) * 0.6
    plant = sd.Plant(A, rng.normal(size=(int(rng.integers(1, 3)), n)), G=rng.normal(size=(n, n)))
    schedule = sd.PeriodicSchedule(rng.uniform(0.3, 1.2, int(rng.integers(1, 4))))
    w, v = float(rng.uniform(0.01, 0.1)), float(rng.uniform(0.05, 0.5))
    bounds = {"w_bound": w, "v_bound": v}
    if seed % 2:
        bounds = {"w_bound": w * rng.uniform(0.5, 2, n), "v_bound": v * rng.uniform(0.5, 2, plant.n_outputs)}
    return sd.guaranteed_accuracy(plant, schedule, of=rng.normal(size=(1, n)), rtol=0.1, **bounds)


@pytest.mark.parametrize("seed", few(range(20), 0, 1, 2, 3, 4))
def test_both_sides_are_proven(seed):
    found = drawn(seed)
    assert found.verify(rigorous=True)
    if seed < 4:
        assert not replace(found, upper=found.upper * 0.999).verify(rigorous=True)
        assert not replace(found, lower=found.lower * 1.001).verify(rigorous=True)


def test_what_is_decided_numerically_is_not_called_proven():
    plant = sd.Plant([[0.0]], [[1.0]])
    found = sd.guaranteed_accuracy(plant, sd.Schedule([0.0, 1.0]), w_bound=0.1, v_bound=0.1)
    with pytest.raises(sd.errors.ArgumentError, match="`rigorous` is for endless schedules that show every mode"):
        found.verify(rigorous=True)


@pytest.mark.parametrize(("A", "G"), [([[0.3]], [[1.0]]), ([[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]])])
def test_an_exact_sensor_is_decided_only_where_it_shows_a_state_at_rest(A, G):
    plant = sd.Plant(A, np.eye(1, len(A)), G=G)
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=0.1, v_bound=0.0, rtol=0.1)
    assert found.closed.all()
    assert found.verify()
    moved = any(witness.states.any() for witness in found.witnesses)
    assert found.verify(rigorous=True) is not moved
    assert moved or len(A) == 1


if __name__ == "__main__":
    count = int(sys.argv[1])
    proven = sum(drawn(seed).verify(rigorous=True) for seed in range(count))
    print(f"{proven} of {count} proven in ball arithmetic")
