"""Units of states, outputs, inputs, disturbances and time change no decision about modes, counts and schedules."""

import numpy as np
import pytest

from sampling_design import zero_count_bound
from sampling_design.errors import NotDetectableError, NotObservableError
from sampling_design.observability.count.functional import part_for
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.plants.functional import split_needed
from sampling_design.plants.modes import split_modes
from tests.cases import few
from tests.oracles.existence import drawn, unseen_count
from tests.rescale import Units

RATES = (0.0, 0.4, 3.0)


def counted(plant, duration):
    """The counts, or the unseen eigenvalues by which they are refused."""
    try:
        found = zero_count_bound(plant, duration)
    except NotObservableError as refusal:
        return len(refusal.eigenvalues), None
    return (found.samples_needed, found.samples_least, found.samples, found.order), found


@pytest.mark.parametrize("seed", few(range(24), *range(0, 24, 4)))
def test_units_change_no_decision_about_modes_and_counts(seed):
    rng = np.random.default_rng(seed)
    known = drawn(rng)
    plant, units = known.plant, Units.drawn(rng, known.plant)
    other = units.plant(plant)
    here, there = unobservable_modes(plant), unobservable_modes(other)
    assert len(here) == len(there) == unseen_count(known)
    np.testing.assert_allclose(
        np.sort_complex(there.eigenvalues * units.time), np.sort_complex(here.eigenvalues), rtol=1e-6, atol=1e-6
    )
    for rate in RATES:
        one, two = split_modes(plant, rate), split_modes(other, rate / units.time)
        assert two.retained.n_states == one.retained.n_states
        assert two.near_line.size == one.near_line.size
        assert [(c.multiplicity, c.index, c.sure) for c in two.clusters] == [
            (c.multiplicity, c.index, c.sure) for c in one.clusters
        ]
        assert len(unobservable_modes(plant, rate)) == len(unobservable_modes(other, rate / units.time))
    if plant.n_states > 5:  # the critical length of a large plant takes seconds
        return
    (decided, one), (again, two) = counted(plant, 2.0), counted(other, 2.0 * units.time)
    assert again == decided
    if one is not None:
        assert two.value == pytest.approx(one.value, rel=1e-6)
        assert two.frequency_spread * units.time == pytest.approx(one.frequency_spread, rel=1e-6, abs=1e-9)
        if one.critical_length is not None:
            assert two.critical_length / units.time == pytest.approx(one.critical_length, rel=1e-6)


def needed(plant, row, rate):
    """How many states that do not decay a row needs; None where a mode enters it that no output shows."""
    try:
        return split_needed(part_for(plant, [row], decay_rate=rate), rate).retained.n_states
    except NotDetectableError:
        return None


@pytest.mark.parametrize("seed", few(range(24), 6, 12))
def test_units_change_no_decision_about_what_a_row_needs(seed):
    rng = np.random.default_rng(seed)
    plant = drawn(rng).plant
    units = Units.drawn(rng, plant)
    for row in plant.states.names[:2]:
        for rate in RATES:
            assert needed(units.plant(plant), row, rate / units.time) == needed(plant, row, rate)
