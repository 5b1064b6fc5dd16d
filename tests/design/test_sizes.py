"""Numbers that overflow and sizes beyond memory are refused in one sentence, before anything is tried."""

import numpy as np
import pytest

from sampling_design import Plant, Requirement, design_schedule
from sampling_design.errors import ArgumentError, InfeasibleRequirementError

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
BASE = {"window": 4.0, "spacing": 0.5, "samples": 3}


def growing(rate, size=1.0):
    return Plant([[rate, 1.0], [-1.0, rate]], [[size, 0.0]])


@pytest.mark.parametrize(
    ("plant", "changes", "words"),
    [
        (OSCILLATOR, {"window": 1e308}, "`window` 1e\\+308 beside a window of 1e\\+308 is out of all proportion"),
        (OSCILLATOR, {"window": 1e-308, "spacing": 1e-309}, "`window` 1e-308 .* out of all proportion"),
        (OSCILLATOR, {"period": 1e308}, "`period` 1e\\+308 beside a window of 4 is out of all proportion"),
        (OSCILLATOR, {"spacing": 1e-308}, "`spacing` 1e-308 .* out of all proportion"),
        (OSCILLATOR, {"samples": 10**9, "spacing": 1e-10}, "`samples` 1e\\+09 .*memory, more than the 4 GB"),
        (OSCILLATOR, {"period": 4e-8, "spacing": 1e-8}, "a window that holds 3e\\+08 samples would take"),
        (growing(1.0), {"window": 800.0}, "grows or decays by e\\^800 over it, .* Give a window of 80 or less"),
        (growing(0.0, 1e308), {}, "`C` has an entry of size 1e\\+308, whose square is no number"),
        (growing(0.0, 1e-308), {}, "`C` has an entry of size 1e-308, whose square is no number"),
    ],
)
def test_what_cannot_be_computed_is_refused_before_it_is_tried(plant, changes, words):
    with pytest.raises(ArgumentError, match=words):
        design_schedule(plant, Requirement(**{**BASE, **changes}))


@pytest.mark.parametrize(
    "options", [{"starts": 0}, {"starts": 1.5}, {"branches": -1}, {"rtol": 0.0}, {"rtol": 1.0}, {"budget": -1.0}]
)
def test_options_out_of_range_are_named(options):
    with pytest.raises(ArgumentError, match=f"`{next(iter(options))}`"):
        design_schedule(OSCILLATOR, Requirement(**BASE), **options)


def test_a_great_number_of_starts_ends():
    design = design_schedule(OSCILLATOR, Requirement(**BASE), starts=1e308, branches=0)
    assert design.status == "complete"
    assert design.gap < 0.01


def test_a_target_beyond_all_measure_is_out_of_reach():
    with pytest.raises(InfeasibleRequirementError, match="`target_sigma` 1e\\+308 is not reached"):
        design_schedule(OSCILLATOR, Requirement(**{**BASE, "target_sigma": 1e308}), starts=1, branches=0)


@pytest.mark.parametrize(
    "change", [{"cost_limit": 1e308, "sensors": {"y1": {"price": 1e300}}}, {"samples": {"at_most": 10**9}}]
)
def test_other_extremes_end_in_a_design(change):
    design = design_schedule(OSCILLATOR, Requirement(**{**BASE, **change}), starts=1, branches=0)
    assert np.isfinite(design.upper_bound)
    assert design.sigma > 0
