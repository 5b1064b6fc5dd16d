"""Time units."""

import pytest

from sampling_design import ArgumentError
from sampling_design.records.units import SECONDS, check_time_unit, spoken, time_factor


def test_known_units_pass():
    assert [check_time_unit(u) for u in SECONDS] == ["ms", "s", "min", "h", "d", "wk"]


def test_factors():
    assert time_factor("h", "min") == 60.0
    assert time_factor("wk", "d") == 7.0
    assert time_factor("s", "ms") == pytest.approx(1000.0)


@pytest.mark.parametrize("unit", [None, ""])
def test_a_missing_unit_is_said_to_be_missing(unit):
    with pytest.raises(ArgumentError, match=r"`time_unit` is missing\. Give one of ms, s, min, h, d, wk"):
        check_time_unit(unit)


@pytest.mark.parametrize("unit", ["hours", "S", 1])
def test_an_unknown_unit_is_quoted(unit):
    with pytest.raises(ArgumentError, match="`time_unit` must be one of ms, s, min, h, d, wk, got"):
        check_time_unit(unit)


@pytest.mark.parametrize(
    ("length", "unit", "said"),
    [
        (26 / 24, "d", "26 h"),
        (1 / 24, "d", "1 h"),
        (5400.0, "s", "1 h 30 min"),
        (168.0, "h", "7 d"),
        (100.0, "h", "4 d 4 h"),
        (47.75, "h", "47 h 45 min"),
        (1.0, "wk", "7 d"),
        (75.0, "s", "1 min 15 s"),
        (-0.5, "h", "-30 min"),
        (6.4, "s", "6.4 s"),
        (1.083337, "d", "1.08334 d"),
        (1e-12, "d", "1e-12 d"),
        (0.0, "h", "0 h"),
        (float("inf"), "h", "inf h"),
    ],
)
def test_lengths_are_told_in_hours_and_minutes_where_they_are_whole(length, unit, said):
    assert spoken(length, unit) == said
