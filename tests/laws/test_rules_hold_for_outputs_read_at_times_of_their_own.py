"""No schedule of a rule sees less than is proven, whenever each of its outputs is read within its tolerance."""

from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import Plant
from sampling_design.observability.worst_case.balls import prove_worst_sigma
from sampling_design.observability.worst_case.worst_case_sigma import worst_case_sigma
from sampling_design.schedules.jitter import TimingTolerance
from sampling_design.schedules.spaced_windows import SpacedWindows
from tests.cases import few
from tests.oracles.worst_case import is_admissible, least_of_readings, sigma_of_readings

SHARES = (0.01, 0.05, 0.1, 0.3)


def random_case(seed):
    """A plant, a rule, and how early and late each output may be: apart in some, some outputs on time."""
    rng = np.random.default_rng([7, seed])
    n, p, count = 2 + seed % 2, 2 + seed // 2 % 2, 1 + (seed + 1) // 3 % 3
    A, C, window = rng.normal(size=(n, n)), rng.normal(size=(p, n)), rng.uniform(1.0, 3.0)
    spacing = window / count * rng.uniform(0.3, 0.9)
    early, late = SHARES[seed % 4] * spacing * rng.uniform(0.5, 1.0, (2, p)) * (rng.uniform(size=(2, p)) < 0.8)
    return A, C, SpacedWindows(window, count, spacing), early, late, rng


def table(early, late):
    if len(early) == 1:
        return float(early[0]), float(late[0])
    return {f"y{i + 1}": pair for i, pair in enumerate(zip(early.tolist(), late.tolist(), strict=True))}


def holds(found, A, C, family, early, late, least):
    """`lower` is below what a search found, and `upper` is what the readings see, which are allowed."""
    assert found.lower <= least
    on_time = np.tile(found.witness[:, None], len(C))
    readings = on_time if found.readings is None else found.readings
    assert found.upper == pytest.approx(sigma_of_readings(A, C, readings), rel=1e-7)
    assert is_admissible(found.witness - early.max(), family.window, family.spacing, 1e-8 * family.window)
    apart = readings - on_time
    assert np.all((apart >= -early - 1e-8 * family.window) & (apart <= late + 1e-8 * family.window))


@pytest.mark.parametrize("seed", few(range(40), 0, 6))
def test_no_reading_sees_less_than_is_proven_and_what_is_attained_is_read(seed):
    A, C, family, early, late, rng = random_case(seed)
    early, late = (side[: 1 if seed % 5 == 0 else None] for side in (early, late))  # one pair: read together
    found = worst_case_sigma(Plant(A, C), family, timing_tolerance=table(early, late), budget=20.0)
    rule = family.window, family.count, family.spacing
    least, _ = least_of_readings(A, C, *rule, early, late, rng, 16, 1)
    holds(found, A, C, family, early, late, least)
    assert found.closed
    assert found.lower >= 0.99 * found.upper or found.status == "below rounding"
    assert found.upper <= least * (1 + 1e-6)


@pytest.mark.parametrize("unit", [1e-9, 1e12])
def test_units_of_time_and_of_readings_change_nothing(unit):
    A, C, family, early, late, _ = random_case(6)
    found = worst_case_sigma(Plant(A, C), family, timing_tolerance=table(early, late))
    rule = SpacedWindows(family.window * unit, family.count, family.spacing * unit)
    scaled = worst_case_sigma(Plant(A / unit, C * unit), rule, timing_tolerance=table(early * unit, late * unit))
    assert (scaled.lower, scaled.upper) == pytest.approx((found.lower * unit, found.upper * unit), rel=1e-6)
    holds(scaled, A / unit, C * unit, rule, early * unit, late * unit, np.inf)


def test_what_is_on_time_is_on_time_and_more_tolerance_is_never_better():
    A, C, family, early, late, _ = random_case(6)
    exact = worst_case_sigma(Plant(A, C), family)
    assert exact.to_dict().keys().isdisjoint({"readings", "timing_tolerance"})
    for none in (0.0, {}, table(0 * early, 0 * late)):
        again = worst_case_sigma(Plant(A, C), family, timing_tolerance=none)
        assert (again.lower, again.upper, again.readings) == (exact.lower, exact.upper, None)
    last, late = exact.upper, late + 0.1 * family.spacing
    for share in (1e-6, 0.3, 1.0):  # a window begins as much before what is planned as the earliest output may be
        found = worst_case_sigma(Plant(A, C), family, timing_tolerance=table(0 * early, share * late))
        assert found.lower <= found.upper <= last * (1 + 1e-9)
        last = found.upper
    for i in range(len(late)):
        one = worst_case_sigma(Plant(A, C), family, timing_tolerance={f"y{i + 1}": (0.0, late[i])})
        assert found.upper <= one.upper <= exact.upper * (1 + 1e-9)
    # one output has no other to fall apart from; outputs that are read together see no less than those that are not
    few, many = (
        worst_case_sigma(Plant(A, C[:1]), family, timing_tolerance=d) for d in ({"y1": (0.0, 0.1)}, (0.0, 0.1))
    )
    assert (few.lower, few.upper) == (many.lower, many.upper)
    both = worst_case_sigma(Plant(A, C), family, timing_tolerance=(0.0, 0.1))
    assert np.ptp(both.readings, axis=1).max() == 0
    apart = worst_case_sigma(Plant(A, C), family, timing_tolerance=table(np.zeros(3), np.full(3, 0.1)))
    assert apart.lower <= both.upper <= exact.upper * (1 + 1e-9)
    fewer = replace(family, count=family.count - 1)
    lost = worst_case_sigma(Plant(A, C), fewer, timing_tolerance=table(0 * early, late)).lower
    said = found.deviations
    assert (said.late, said.late_wider, said.lost) == pytest.approx((found.lower, found.lower, lost), rel=1e-9)
    # samples that may change places are a wider rule than real times keep, and show less
    loose = worst_case_sigma(Plant(A, C), replace(family, window=family.window + 0.1, spacing=family.spacing - 0.1))
    assert loose.upper < both.lower


@pytest.mark.long
def test_a_continuum_of_times_is_met_between_the_points_that_are_looked_at():
    """One sample of two outputs: each has a zero of its own within its times, at no even part of them."""
    A, C = np.array([[0.0, 1.0], [-1.0, 0.0]]), np.eye(2)
    found = worst_case_sigma(Plant(A, C), SpacedWindows(1.0, 1, 2.5), timing_tolerance={"y1": 1.2, "y2": 1.1})
    # the rows are (cos, sin) and (-sin, cos): at times a and b sigma is sqrt(1 - |sin(b - a)|), 0 a quarter turn apart
    assert found.upper < 1e-7
    assert found.lower == 0.0
    near = worst_case_sigma(Plant(A, C), SpacedWindows(1.0, 1, 2.5), rtol=0.05, timing_tolerance={"y1": 0.7, "y2": 0.8})
    assert 0.95 * near.upper <= near.lower <= np.sqrt(1 - np.sin(1.5)) == pytest.approx(near.upper, rel=1e-9)


def test_a_rule_with_one_schedule_alone_leaves_its_readings_free():
    A, C, _, _, _, rng = random_case(6)
    early, late, family = np.array([0.05, 0.0, 0.02]), np.array([0.0, 0.1, 0.02]), SpacedWindows(1.0, 3, 0.5)
    found = worst_case_sigma(
        Plant(A, C[[0, 1, 1]] + [[0.0], [0.0], [0.3]]), family, timing_tolerance=table(early, late)
    )
    least, _ = least_of_readings(A, C[[0, 1, 1]] + [[0.0], [0.0], [0.3]], 1.0, 3, 0.5, early, late, rng, 16, 1)
    assert 0.98 * least <= found.lower <= least
    assert found.lower >= 0.99 * found.upper


@pytest.mark.long
def test_balls_prove_it_and_a_box_holds_its_plants():
    A, C, family, early, late, _ = random_case(6)
    plain, tolerance = worst_case_sigma(Plant(A, C), family, timing_tolerance=table(early, late)), table(early, late)
    balls = worst_case_sigma(Plant(A, C), family, timing_tolerance=tolerance, rigorous=True)
    assert balls.closed
    assert plain.lower * (1 - 2e-6) <= balls.lower <= plain.lower
    late, above = TimingTolerance.of(tolerance, ("y1", "y2", "y3")), plain.upper * (1 + 1e-5) / (1 - 1e-6)
    assert prove_worst_sigma(Plant(A, C), family, above, plain.witness, late=late).lower < plain.upper
    box = sd.UncertainPlant(Plant(A, C), [sd.UncertainParameter("a", -0.01, 0.01, A=np.eye(len(A)))])
    over = worst_case_sigma(box, family, rtol=0.2, timing_tolerance=tolerance)
    assert over.closed
    for a in (-0.01, 0.003, 0.01):
        assert over.lower <= worst_case_sigma(box.at([a]), family, timing_tolerance=tolerance).upper
    worst = box.at(list(over.worst.values()))
    assert over.upper == pytest.approx(sigma_of_readings(worst.A, worst.C, over.readings), rel=1e-7)
    proven = worst_case_sigma(box, family, rtol=0.2, timing_tolerance=tolerance, rigorous=True)
    assert 0.9 * over.lower <= proven.lower <= over.lower
