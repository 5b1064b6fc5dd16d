"""Time axes have dates where the date of zero is known, and else numbers in a unit in which they are short."""

from datetime import UTC, datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.plotting import style


def axis(unit, length, start=0.0, origin=None):
    ax = style.new_axes()
    ax.plot([start, start + length], [0.0, 1.0])
    ax.margins(x=0.0)
    style.time_axis(ax, unit, origin=origin)
    ax.figure.canvas.draw()
    low, high = ax.get_xlim()
    ticks = [t for t in ax.get_xticks() if low <= t <= high]
    return ax.get_xlabel(), ticks, ax.xaxis.get_major_formatter().format_ticks(ticks)


@pytest.mark.parametrize(
    ("unit", "length", "shown", "seconds"),
    [
        ("s", 11108.0, "h", 3600.0), ("s", 100.0, "s", 1.0), ("s", 1000.0, "min", 60.0), ("h", 168.0, "d", 86400.0),
        ("ms", 5000.0, "s", 1.0), ("d", 400.0, "d", 86400.0), ("s", 1e6, "d", 86400.0), ("min", 119.0, "min", 60.0),
    ],
)  # fmt: skip
def test_the_unit_is_one_in_which_numbers_are_short(unit, length, shown, seconds):
    label, ticks, said = axis(unit, length)
    assert label == f"time [{shown}]"
    assert 3 <= len(ticks) <= 12
    own = {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0, "d": 86400.0}[unit]
    assert [float(text.replace("\N{MINUS SIGN}", "-")) for text in said] == pytest.approx(
        np.array(ticks) * own / seconds
    )


def test_dates_stay_dates():
    label, _, said = axis("s", 3 * 86400.0, origin="2026-03-02T00:00:00+00:00")
    assert label == "date, from 2026-03-02"
    assert said[0] == "Mon 02 Mar"


@pytest.mark.parametrize("unit", ["s", "h", "d"])
@pytest.mark.parametrize("change", ["2026-03-28T08:00", "2026-10-24T08:00"])  # clocks of Berlin: 29 March, 25 October
@pytest.mark.parametrize("days", [2.5, 5.0, 30.0])
def test_dates_stand_at_midnight_and_at_whole_hours_on_both_sides_of_a_change_of_clocks(unit, change, days):
    own = {"s": 1.0, "h": 3600.0, "d": 86400.0}[unit]
    ax = style.new_axes()
    ax.set_xlim(0.0, days * 86400.0 / own)
    style.dates(ax, unit, f"{change}[Europe/Berlin]")
    zero = datetime.fromisoformat(change).replace(tzinfo=ZoneInfo("Europe/Berlin"))
    low, high = ax.get_xlim()
    offsets = set()
    for ticks, every in ((ax.get_xticks(), 24), (ax.get_xticks(minor=True), 6 if days < 4 else 24)):
        shown = [t for t in ticks if low <= t <= high]
        dates = [(zero.astimezone(UTC) + timedelta(seconds=float(t) * own)).astimezone(zero.tzinfo) for t in shown]
        assert {each.hour % every for each in dates} <= {0}
        assert not {(each.minute, each.second) for each in dates} - {(0, 0)}
        offsets |= {each.utcoffset() for each in dates}
        texts = ax.xaxis.get_major_formatter().format_ticks(shown)
        assert texts == [f"{each:%a %d %b}" for each in dates]
    assert len(offsets) == 2


def test_hours_are_not_marked_twice_where_clocks_skip_one():
    ax = style.new_axes()
    ax.set_xlim(0.0, 7.0)
    style.dates(ax, "h", "2026-03-29T00:00[Europe/Berlin]")
    ticks = [t for t in ax.get_xticks() if 0 <= t <= 7]
    assert np.diff(ticks).tolist() == [1.0] * 7
    assert ax.xaxis.get_major_formatter().format_ticks(ticks)[:4] == [
        "Sun 00:00",
        "Sun 01:00",
        "Sun 03:00",
        "Sun 04:00",
    ]


def test_a_time_without_a_unit_is_only_named():
    assert axis(None, 1e5)[0] == "time"


def test_a_band_of_the_start_is_cut_on_both_sides_or_on_none():
    ax, t = style.new_axes(), np.linspace(0.0, 10.0, 101)
    half = np.where(t < 2.0, 20.0, np.where(t < 2.5, 1.4, 1.0))
    style.not_ruled_by_the_start(ax, t, -0.1 - half, 0.4 + half)
    low, high = ax.get_ylim()
    for end in (2.2, 6.0):
        at = int(np.searchsorted(t, end))
        assert low <= -0.1 - half[at]
        assert high >= 0.4 + half[at]
    assert max(-low, high) < 20.0


def test_panels_below_each_other_show_the_same_time():
    plant = sd.Plant(np.diag([-1.0, -2.0]), np.eye(2), time_unit="h", outputs=["early", "late"])
    readings = [[1.0, np.nan], [2.0, np.nan], [np.nan, 3.0], [np.nan, 4.0]]
    early, late = sd.Measurements(plant, [0.0, 1.0, 8.0, 9.0], readings).plot()
    assert early.get_xlim() == late.get_xlim()
    assert early.get_xlim()[0] <= 0.0
    assert early.get_xlim()[1] >= 9.0


def test_a_moment_is_told_in_the_unit_of_its_axis():
    plant = sd.named_plant("satellite")
    schedule = sd.PeriodicSchedule.from_times(np.arange(12) * 5554.0 / 12, 5554.0, time_unit="s")
    found = sd.window_sigma(plant, schedule, 5554.0)
    ax = found.plot()
    (worst,) = (text.get_text() for text in ax.get_legend().get_texts() if "attained" in text.get_text())
    assert ax.get_xlabel().endswith("[h]")
    assert worst.endswith(" h")
    told = float(worst.split()[-2])
    assert told == pytest.approx(found.witness.t / 3600, rel=1e-4)
    low, high = np.array(ax.get_xlim()) / 3600
    assert low <= told <= high
    assert schedule.plot().get_title(loc="left") == "12 samples, every 462.8 s"
    uneven = sd.PeriodicSchedule.from_times([0.0, 60.0, 180.0], 300.0, time_unit="s")
    assert uneven.plot().get_title(loc="left") == "3 samples, gaps 60 to 120 s"


@pytest.mark.parametrize(
    ("unit", "length", "said"), [("s", 7200.0, "0.5 h"), ("h", 100.0, "1800 h"), (None, 1e5, "1800")]
)
def test_moments_with_and_without_a_longer_unit(unit, length, said):
    ax = style.new_axes()
    ax.set_xlim(0.0, length)
    assert style.moment(ax, 1800.0, unit) == said


def test_a_moment_on_an_axis_of_dates_is_a_date():
    ax = style.new_axes()
    ax.set_xlim(0.0, 48.0)
    assert style.moment(ax, 45.3, "h", origin="2026-03-02T00:00:00+00:00") == "Tue 03 Mar 21:18"
