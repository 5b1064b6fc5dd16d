"""Time units."""

import pytest

from sampling_design import ArgumentError
from sampling_design._units import SECONDS, check_time_unit, time_factor


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
    with pytest.raises(ArgumentError, match="`unit` must be one of ms, s, min, h, d, wk, got"):
        check_time_unit(unit, "unit")
