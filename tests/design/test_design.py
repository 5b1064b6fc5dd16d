"""design_schedule end to end: proven sigma below the bound, constraints kept, defaults told."""

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule, library
from sampling_design.errors import ArgumentError


def oscillator():
    return Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def test_the_oscillator_is_designed_to_its_optimum():
    design = design_schedule(library.oscillator(), Requirement(window=2 * np.pi, spacing=0.2, samples=4))
    assert design.sigma_attained == pytest.approx(np.sqrt(2), rel=1e-6)  # four samples a quarter apart
    assert design.upper_bound == pytest.approx(np.sqrt(2), rel=1e-6)
    assert design.gap < 0.011
    assert design.verify()


def test_constraints_are_kept_and_fixed_times_are_exact():
    requirement = Requirement(window=4.0, spacing=0.4, samples=4, forbidden=[[0.5, 1.0], [3.0, 3.5]], fixed=[0.25])
    design = design_schedule(oscillator(), requirement)
    times = design.schedule.times
    assert 0.25 in times
    assert not np.any((times >= 0.5) & (times < 1.0))
    assert not np.any((times >= 3.0) & (times < 3.5))
    assert design.schedule.gaps.min() >= 0.4
    assert 0 < design.sigma <= design.sigma_attained <= design.upper_bound
    assert design.verify()


def test_nothing_retained_needs_no_samples():
    design = design_schedule(Plant([[-1.0]], [[1.0]]))
    assert design.schedule is None
    assert design.status == "no samples needed"
    assert "decay_rate" in design.explain()
    assert design.verify()


def test_a_plant_or_requirement_of_another_type_is_refused():
    with pytest.raises(ArgumentError, match="`plant` must be a Plant, got str"):
        design_schedule("oscillator")
    with pytest.raises(ArgumentError, match=r"`requirement` must be a Requirement, got dict\. Use read_requirement"):
        design_schedule(oscillator(), {"window": 4.0})
