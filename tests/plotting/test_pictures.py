"""Pictures: what they show is what the record says, and they are written whole or not at all."""

import itertools
import struct
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

import sampling_design as sd
from sampling_design import plotting
from sampling_design.accuracy.readings import CensoredReading
from sampling_design.certificates.compare.robustness import FamilyTrial
from sampling_design.errors import ArgumentError, CertificateError
from sampling_design.estimators.online.curve import EstimateEnvelope
from sampling_design.planning.evidence import PlanBound
from sampling_design.planning.plan_record import Plan
from sampling_design.planning.problem import pose_plan
from sampling_design.plotting import style
from sampling_design.plotting.designs import draw_pareto
from sampling_design.plotting.plans import draw_sensors, mark_days, whole
from sampling_design.records.record import above, below
from sampling_design.schedules.lost_samples import LostSamples
from tests.cases import few

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
SCHEDULE = sd.PeriodicSchedule([0.7, 1.6, 0.9], time_unit="s")


@cache
def horizons():
    """What two tests draw."""
    return sd.certificates.four_horizons(OSCILLATOR, SCHEDULE, sd.certify(OSCILLATOR, SCHEDULE, eta=0.4, P2=np.eye(2)))


def test_a_schedule_is_drawn_with_one_stem_per_sample_and_a_second_lap():
    ax = SCHEDULE.plot()
    stems = [c.get_segments() for c in ax.collections]
    assert [len(s) for s in stems] == [3, 3]
    assert [s[0][0] for s in stems[0]] == pytest.approx(SCHEDULE.times)
    assert ax.get_xlabel() == "time [s]"


def test_a_mask_has_one_row_per_output():
    mask = np.array([[1, 0], [1, 1], [0, 1]])
    schedule = sd.Schedule([0.0, 1.0, 2.0], mask, output_names=("tsh", "t3"))
    ax = schedule.plot()
    assert [label.get_text() for label in ax.get_yticklabels()] == ["tsh", "t3"]
    assert [len(c.get_segments()) for c in ax.collections] == [2, 2]


def test_sigma_is_drawn_with_its_proven_bound():
    result = sd.window_sigma(OSCILLATOR, SCHEDULE, 4.0)
    ax = result.plot()
    drawn = [line.get_ydata() for line in ax.lines]
    assert min(np.nanmin(y) for y in drawn) == pytest.approx(min(result.deviations.late, result.deviations.lost))
    assert any(np.nanmin(y) == pytest.approx(result.lower) for y in drawn)
    curve, jumps = drawn[0], np.count_nonzero(np.diff(result.profile.piece))
    assert np.count_nonzero(np.isnan(curve)) == jumps > 0  # the pen is lifted where a sample comes or goes
    assert list(curve[np.isfinite(curve)]) == list(result.profile.sigma)
    assert any(below(result.lower, 4) in t.get_text() for t in ax.get_legend().get_texts())


@pytest.mark.parametrize(("name", "formula"), [(r"$\foo$", False), ("$x_1$", True), ("5 $", True)])
def test_a_name_with_dollars_is_a_formula_or_stands_as_it_was_typed(name, formula, tmp_path):
    plant = sd.Plant([[0.0]], [[1.0]], states=[name], outputs=["y"])
    found = sd.guaranteed_accuracy(plant, sd.PeriodicSchedule([1.0]), w_bound=0.1, v_bound=0.1, rtol=0.5)
    ax = np.ravel(found.plot())[0]
    ax.figure.savefig(tmp_path / "named.png")
    labels = [
        each for each in ax.figure.findobj(lambda each: hasattr(each, "get_parse_math")) if name in each.get_text()
    ]
    assert labels
    assert all(each.get_parse_math() is formula for each in labels)


def test_so_it_does_where_it_stands_at_a_tick(tmp_path):
    schedule = sd.PeriodicSchedule([1.0, 2.0], outputs=[[1, 0], [1, 1]], output_names=[r"$\foo$", "$x_1$"])
    ax = np.ravel(schedule.plot())[0]
    ax.figure.savefig(tmp_path / "named.png", dpi=30)
    assert {each.get_text(): each.get_parse_math() for each in ax.get_yticklabels()} == {
        r"$\foo$": False,
        "$x_1$": True,
    }


def test_a_design_has_two_rows_and_its_bounds(tmp_path):
    design = sd.design_schedule(
        OSCILLATOR, sd.Requirement(window=4.0, samples=3, forbidden=[[1.0, 1.5]]), starts=1, branches=1
    )
    top, bottom = plotting.draw(design)
    assert top.figure is bottom.figure
    assert top.figure.get_suptitle().count(below(design.sigma, 4)) == 1
    for suffix, magic in (("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")):
        path = plotting.save(design if suffix != "pdf" else design.schedule, tmp_path / f"design.{suffix}", dpi=40)
        assert path.read_bytes().startswith(magic)
    assert Image.open(tmp_path / "design.png").text == {"Description": design.explain()}
    assert design.explain().partition(";")[0].replace(">", "&gt;") in (tmp_path / "design.svg").read_text()


def test_a_certificate_is_drawn_above_its_promise():
    certificate = sd.certify(OSCILLATOR, SCHEDULE, eta=0.4, P2=np.eye(2))
    ax = certificate.plot()
    assert ax.get_yscale() == "log"
    assert ax.lines[0].get_ydata().min() >= 1.0
    assert "touches" not in ax.get_ylabel()


def test_four_horizons_are_dots_at_their_lengths_and_say_why_one_is_missing():
    found = horizons()
    top, bottom = plotting.draw(found)
    drawn = [line.get_xdata()[0] for line in top.lines]
    assert drawn == pytest.approx([row.minimum for row in found.rows])
    low, high = top.get_xlim()
    assert low < min(drawn)
    assert max(drawn) < high
    first = replace(found.rows[0], minimum=None, note="the hypotheses fail")
    one = plotting.draw(replace(found, rows=(first, *found.rows[1:])), Figure().subplots())
    assert len(one.lines) == 3
    assert "not available: the hypotheses fail" in [t.get_text() for t in one.texts]
    assert [t.get_text() for t in top.get_yticklabels()] == [row.name for row in found.rows]
    assert bottom.has_data()


def test_a_worst_case_shows_the_worst_times():
    result = sd.worst_case_sigma(OSCILLATOR, sd.SpacedWindows(4.0, 3, 0.5))
    ax = result.plot()
    assert [s[0][0] for s in ax.collections[0].get_segments()] == pytest.approx(result.witness)


@pytest.mark.long
def test_fronts_and_losses_are_drawn_and_an_empty_front_refused():
    requirement = sd.Requirement(window=4.0)
    front = sd.pareto_front(OSCILLATOR, requirement, [2, 3])
    top, bottom = front.plot()
    assert list(top.lines[1].get_ydata()) == [p.sigma for p in front.points]
    gaps = [100 * (1 - p.sigma / p.upper_bound) for p in front.points]
    assert [bar.get_height() for bar in bottom.patches] == pytest.approx(gaps)
    three = sd.design_schedule(OSCILLATOR, requirement.replace(samples=3))  # command, page and picture say one gap
    assert f"can exceed {above(three.upper_bound)}, an optimality gap of {above(gaps[1], 3)} %." in three.explain()
    drawn = front.plot(Figure().subplots()).lines
    assert list(drawn[2].get_ydata()) == [p.deviations.late for p in front.points]
    assert list(drawn[3].get_ydata()) == [p.deviations.lost for p in front.points]
    losses = sd.design.sample_losses(
        sd.design_schedule(OSCILLATOR, requirement.replace(samples=3), starts=1, branches=0)
    )
    drawn = losses.plot()
    assert len(drawn.collections[0].get_segments()) == 3
    lost = [f"{100 * (low / losses.sigma - 1):+.0f} %" for low in losses.lower]
    assert [text.get_text() for text in drawn.texts] == lost
    with pytest.raises(ArgumentError, match="`record` has no point to draw"):
        sd.pareto_front(OSCILLATOR, sd.Requirement(window=4.0, spacing=3.0), [5]).plot()


def test_pictures_are_drawn_on_given_axes():
    axes = Figure().subplots(3, 1)
    design = sd.design_schedule(OSCILLATOR, sd.Requirement(window=4.0, samples=3), starts=1, branches=0)
    for record, ax in zip((SCHEDULE, design, design.window), axes, strict=True):
        assert record.plot(ax) is ax
        assert ax.has_data()


def test_a_notebook_shows_the_axes_that_plot_returns():
    one = SCHEDULE.plot()
    several = horizons().plot()
    assert isinstance(several, list)
    for shown in (one, several):
        picture = shown._repr_png_()
        width, height = struct.unpack(">II", picture[16:24])
        assert picture.startswith(b"\x89PNG")
        assert width > height > 200
    assert type(one).__name__ == "Axes"
    assert plt.get_fignums() == []  # nothing of it is known to pyplot, so a script shows nothing


def test_what_has_no_picture_is_refused(tmp_path):
    with pytest.raises(ArgumentError, match="`record` has no picture"):
        plotting.draw(OSCILLATOR)
    with pytest.raises(ArgumentError, match=r"`path` must end in \.png, \.svg or \.pdf"):
        plotting.save(SCHEDULE, tmp_path / "a.gif")
    nothing = sd.design_schedule(sd.Plant([[-1.0]], [[1.0]]))
    with pytest.raises(ArgumentError, match="`record` has no schedule to draw"):
        plotting.draw(nothing)
    assert list(tmp_path.iterdir()) == []


def linear(colour):
    value = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


SIGHTS = {
    "full": np.eye(3),
    "without green": [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]],
    "without red": [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]],
}
"""What is left of linear red, green and blue (Machado, Oliveira and Fernandes 2009, severity 1)."""


@pytest.mark.parametrize("sight", SIGHTS)
def test_the_colours_differ_for_every_sight_and_stand_out_from_white(sight):
    names = ("MEASURED", "PROVEN", "ATTAINED", "ESTIMATE", "FAILED", "TRUTH", "ALLOWED")
    colours = [linear(getattr(style, name)) for name in names]
    assert all(1.05 / (np.dot(c, [0.2126, 0.7152, 0.0722]) + 0.05) >= 4.5 for c in colours)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])

    def lab(c):
        ratio = to_xyz @ np.clip(np.array(SIGHTS[sight]) @ c, 0, 1) / [0.9505, 1.0, 1.089]
        x, y, z = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16 / 116)
        return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])

    apart = [np.linalg.norm(lab(a) - lab(b)) for k, a in enumerate(colours) for b in colours[:k]]
    assert min(apart) > 15


def shown_legends(axes):
    for ax in axes if isinstance(axes, list) else [axes]:
        if ax.get_legend() is not None:
            ax.figure.canvas.draw()
            yield ax, ax.get_legend().get_window_extent(), ax.get_window_extent()


def alike_in_grey(ax):
    """Curves of a legend that differ by their colour alone, printed without it."""
    named = [line for line in ax.lines if not line.get_label().startswith("_")]
    looks = [(line.get_linestyle(), line.get_marker(), line.get_markerfacecolor() == "none") for line in named]
    widths = [line.get_linewidth() for line in named]
    greys = [np.dot(to_rgb(line.get_color()), [0.299, 0.587, 0.114]) for line in named]
    return [
        (named[i].get_label(), named[k].get_label())
        for k in range(len(named))
        for i in range(k)
        if looks[i] == looks[k] and abs(widths[i] - widths[k]) < 0.4 and abs(greys[i] - greys[k]) < 0.15
    ]


@pytest.mark.long
def test_no_legend_lies_on_a_curve_and_curves_differ_without_colours():
    design = sd.design_schedule(OSCILLATOR, sd.Requirement(window=4.0, samples=3), starts=1, branches=0)
    certificate = sd.certify(OSCILLATOR, SCHEDULE, eta=0.4, P2=np.eye(2))
    worst = sd.worst_case_sigma(OSCILLATOR, sd.SpacedWindows(4.0, 3, 0.5))
    known = sd.guaranteed_accuracy(OSCILLATOR, SCHEDULE, w_bound=0.1, v_bound=0.1, rtol=0.1)
    projection = known.projection("x1", "x2", directions=4)
    seen = 0
    front = sd.pareto_front(OSCILLATOR, sd.Requirement(window=4.0), [2, 3])
    times = SCHEDULE.between(0.0, 12.0).times
    log = sd.compare_schedule(OSCILLATOR, SCHEDULE, times[times != times[4]], 4.0)
    family = sd.certify(OSCILLATOR, sd.GapRange(0.5, 1.5), eta=0.2, P2=np.eye(2))
    terms = {"sensors": {"y1": {"noise_bound": 0.1}}, "w_bound": 0.02, "period": 6.4, "grid": 0.8}
    plan = sd.plan_samples(sd.Plant([[-0.02]], [[1.0]]), sd.PlanRequirement({"x1": 0.3}, **terms), search_seconds=1.0)
    others = (sd.robustness(OSCILLATOR, certificate, budget=0.3), front, log, family, plan)
    for record in (
        design,
        design.window,
        certificate,
        worst,
        sd.design.sample_losses(design),
        known,
        projection,
        *others,
    ):
        for ax, legend, inside in shown_legends(record.plot()):
            seen += 1
            assert legend.y0 >= inside.y1 - 2, type(record).__name__
            assert alike_in_grey(ax) == []
            title = ax._left_title.get_window_extent()
            assert not ax.get_title(loc="left") or title.y0 >= legend.y1 - 4, type(record).__name__
    assert seen == 12


def test_the_axis_begins_below_the_curve_and_not_far_from_it():
    design = sd.design_schedule(OSCILLATOR, sd.Requirement(window=4.0, samples=3), starts=1, branches=0)
    bottom = design.plot()[1]
    low, high = bottom.get_ylim()
    curve = np.concatenate([line.get_ydata() for line in bottom.lines])
    assert low <= np.nanmin(curve)
    assert np.nanmax(curve) <= high
    assert np.nanmin(curve) < low + 0.75 * (high - low)


def test_a_schedule_of_one_sample_has_its_line_in_a_picture_of_accuracy():
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}
    found = sd.guaranteed_accuracy(OSCILLATOR, sd.Schedule([1.0], time_unit=OSCILLATOR.time_unit), **bounds)
    for ax in found.plot():
        assert [1.0, 1.0] in [list(line.get_xdata()) for line in ax.lines]


def test_dates_are_written_where_the_time_of_zero_is_known():
    made = {"time_unit": "h", "origin": "2026-03-02T08:00:00+00:00"}
    ax = sd.Schedule([0.0, 24.0, 60.0], **made).plot()
    ax.figure.canvas.draw()
    labels = [t.get_text() for t in ax.get_xticklabels()]
    assert "Tue 03 Mar" in labels
    ticks = dict(zip(labels, ax.get_xticks(), strict=True))
    assert ticks["Tue 03 Mar"] == pytest.approx(16.0)  # midnight, sixteen hours after eight o'clock
    assert "2026-03-02" in ax.get_xlabel()
    assert sd.Schedule([0.0, 1.0], time_unit="h").plot().get_xlabel() == "time [h]"


def test_dates_are_written_at_hours_where_a_day_is_shown_and_by_month_over_years():
    day = sd.Schedule([0.0, 5.0, 10.0], time_unit="h", origin="2026-03-02T08:00:00+01:00").plot()
    years = sd.Schedule([0.0, 700.0], time_unit="d", origin="2026-03-02T00:00:00+00:00").plot()
    for ax, said in ((day, "Mon 12:00"), (years, "02 Mar 2026")):
        ax.figure.canvas.draw()
        texts = [t.get_text() for t in ax.get_xticklabels()]
        assert said in texts
        assert len(texts) <= 11
    ticks = dict(zip([t.get_text() for t in day.get_xticklabels()], day.get_xticks(), strict=True))
    assert ticks["Mon 12:00"] == pytest.approx(4.0)
    assert "2026" not in sd.Schedule([0.0, 1.0], time_unit="s", origin="2026-03-02T08:00:00+00:00").plot().get_xlabel()


def test_a_design_has_dates_where_its_origin_is_given():
    day = sd.Plant([[0, 0.26], [-0.26, 0]], [[1.0, 0.0]], time_unit="h")
    design = sd.design_schedule(day, sd.Requirement(window=24.0, period=24.0, samples=3), starts=1, branches=0)
    for ax in plotting.draw(design, origin="2026-03-02T00:00:00+01:00"):
        ax.figure.canvas.draw()
        assert "Tue 12:00" in [t.get_text() for t in ax.get_xticklabels()]


def grey(ax):
    """What is closed: (row, start, stop)."""
    boxes = [p.get_extents() for c in ax.collections if hasattr(c, "get_paths") for p in c.get_paths()]
    return sorted((round((b.y0 + b.y1) / 2), b.x0, b.x1) for b in boxes if round(b.y1 - b.y0, 6) == 1.0)


def test_what_is_closed_is_grey_in_designs_and_in_plans_and_once():
    two = sd.Plant(OSCILLATOR.A, np.eye(2), outputs=["near", "far"])
    hours = {"far": {"available": [[0.0, 2.0], [3.0, 5.0]]}}
    wish = sd.Requirement(window=6.0, period=6.0, samples=3, forbidden=[[4.5, 5.5]], sensors=hours)
    line = sd.design_schedule(two, wish, starts=1, branches=0).plot(Figure().subplots())
    once = [(0, 4.5, 5.5), (1, 2.0, 3.0), (1, 4.5, 6.0)]
    assert grey(line) == sorted(once + [(k, a + 6.0, b + 6.0) for k, a, b in once])
    assert "grey: closed" in line.get_title(loc="left")
    hours = {"Mon-Sun": [("06:00", "12:00")]}
    slow = sd.Plant([[-0.02]], [[1.0]], time_unit="h")
    terms = {"sensors": {"y1": {"noise_bound": 0.1}}, "w_bound": 0.02, "period": 24.0, "grid": 3.0}
    calendar = {"start": "2026-03-02", "hours": hours}
    wish = sd.PlanRequirement({"x1": 2.0}, **terms, calendar=calendar)
    found = sd.plan_samples(slow, wish, search_seconds=2.0)
    assert grey(found.plot(Figure().subplots())) == [(0, 0.0, 6.0), (0, 12.0, 24.0)]
    odd = sd.PlanRequirement({"x1": 2.0}, **terms, calendar={**calendar, "hours": {"Mon-Sun": [("07:00", "13:30")]}})
    shown = draw_sensors(replace(found, requirement=odd), Figure().subplots())  # a grid of 3 h: open at 9 and at 12
    assert grey(shown) == [(0, 0.0, 7.0), (0, 13.5, 24.0)]


@pytest.mark.parametrize("days", few([1, 2, 7, 14, 28, 56], 0, 3, 5))
def test_dates_below_a_plan_do_not_overlap(days):
    wish = sd.PlanRequirement(
        {"x1": 2.0}, period=f"{days} d", grid="12 h", w_bound=1e-4, sensors={"y1": {"noise_bound": 0.1}},
        calendar={"start": "2026-10-12", "zone": "Europe/Berlin"},
    )  # fmt: skip
    problem = pose_plan(sd.Plant([[-0.02]], [[1.0]], time_unit="h"), wish)
    chosen = np.arange(problem.steps)[:, None] == 0
    plan = Plan(problem.plant, wish, problem.schedule(chosen), None, np.zeros(0), PlanBound((), None, None))
    figure, (ax,) = style.new_figure(1)
    draw_sensors(plan, ax)
    ax.set_xlim(*whole(plan))
    mark_days(plan, ax)
    figure.draw_without_rendering()
    boxes = [t.get_window_extent() for t in ax.get_xticklabels() if t.get_text() and t.get_visible()]
    assert len(boxes) >= 3
    assert all(a.x1 < b.x0 for a, b in itertools.pairwise(sorted(boxes, key=lambda b: b.x0)))


def test_a_short_log_axis_has_plain_numbers():
    certificate = sd.certify(OSCILLATOR, SCHEDULE, eta=0.4, P2=np.eye(2))
    ax = certificate.plot()
    ax.figure.canvas.draw()
    low, high = ax.get_ylim()
    shown = [t.get_text() for t, at in zip(ax.get_yticklabels(), ax.get_yticks(), strict=True) if low <= at <= high]
    assert {"1", "2", "5"} <= set(shown)


def test_robustness_shows_no_empty_panel():
    trial = FamilyTrial(sd.Jitter(SCHEDULE, 0.1), 2.0, True)
    lost = FamilyTrial(LostSamples(SCHEDULE, 1, 3), np.inf, False)
    borne = FamilyTrial(LostSamples(SCHEDULE, 1, 8), 3.0, True)
    certificate = sd.certify(OSCILLATOR, SCHEDULE, eta=0.4, P2=np.eye(2))
    known = sd.robustness(OSCILLATOR, certificate, budget=1e-9)
    none = replace(known, trials=(trial,), losses=(lost,))
    some = replace(known, trials=(trial,), losses=(lost, borne))
    assert len(none.plot()) == 1
    assert len(some.plot()) == 2


def test_a_wide_start_does_not_rule_the_axis_of_estimates():
    certificate = sd.certify(OSCILLATOR, SCHEDULE, eta=0.4, P2=np.eye(2))
    record = sd.simulate_record(OSCILLATOR, SCHEDULE, 30.0, v_bound=0.1, w_bound=0.01, rng=np.random.default_rng(0))
    bounds = {"w_bound": 0.01, "v_bound": 0.1, "initial_error": 100.0}
    estimates = sd.MovingHorizonEstimator(OSCILLATOR, certificate, **bounds).run(record.measurements)
    low, high = estimates.plot()[1].get_ylim()  # of the speed, which the first sample does not show
    wide, later = estimates.ellipsoid_radii[0, 1], estimates.ellipsoid_radii[len(estimates.times) // 2 :, 1].max()
    assert wide > 100
    assert high - low < wide
    assert high >= later


def test_a_row_that_has_no_estimate_is_not_counted():
    tank, one = sd.Plant([[-1.0]], [[1.0]]), np.ones((1, 1))
    found = EstimateEnvelope.over(tank, [0.0, 1.0]).including(one[0], one, one, one[0] > 0, one[0] < 0)
    assert found.plot()[0].get_title(loc="left") == "error bounds are proven for 1 of 1 estimate"


def test_what_was_read_and_estimated_at_a_wide_start_is_in_the_picture():
    """A tank that runs empty: the first level lies far above what the later bands would show."""
    tank = sd.Plant([[-1.0]], [[1.0]], states=["level"])
    found = EstimateEnvelope.over(tank, np.arange(8.0))
    x = 10 * np.exp(-np.arange(8.0))[:, None]
    flags = np.ones(8, dtype=bool)
    found = found.including(
        np.arange(8.0), x, np.full((8, 1), 0.1) + 90 * (np.arange(8.0) == 0)[:, None], flags, ~flags
    )
    read = sd.Measurements(tank, np.arange(8.0), x + np.eye(8)[:, :1])
    high = plotting.draw(found, measurements=read)[0].get_ylim()[1]
    assert 11.0 < high < 20.0
    assert plotting.draw(found)[0].get_ylim()[1] > 10.0


def test_measurements_show_numbers_limits_and_means():
    said = [
        (),
        (CensoredReading(0, -np.inf, 0.1),),
        (CensoredReading(0, 0.6, np.inf),),
        (CensoredReading(0, -0.5, -0.5, since=1.0),),
    ]
    y = [[0.9], [np.nan], [np.nan], [np.nan]]
    given = {"origin": "2026-03-02T00:00:00+00:00", "censored": said}
    (ax,) = sd.Measurements(OSCILLATOR, [0.0, 1.0, 2.0, 3.0], y, **given).plot()
    marks = [(line.get_marker(), line.get_xdata()[0], line.get_ydata()[0]) for line in ax.lines[1:]]
    assert marks == [("v", 1.0, 0.1), ("^", 2.0, 0.6), ("_", 3.0, -0.5)]
    assert [s.tolist() for s in ax.collections[0].get_segments()] == [[[1.0, -0.5], [3.0, -0.5]]]
    both = sd.Plant(OSCILLATOR.A, np.eye(2), outputs=["a", "b"])
    two = sd.Measurements(both, [0.0, 1.0], [[1.0, np.nan], [2.0, 3.0]])
    assert [ax.get_ylabel() for ax in two.plot()] == ["a", "b"]
    own = style.new_axes()
    assert two.plot(own) is own


def test_a_simulated_record_shows_the_truth_and_what_was_read_of_it():
    record = sd.simulate_record(OSCILLATOR, SCHEDULE, 8.0)
    first, second = record.plot()
    assert first.lines[0].get_ydata() == pytest.approx(record.states[:, 0])
    assert first.lines[1].get_ydata() == pytest.approx(record.measurements.y[:, 0])
    assert len(second.collections[0].get_segments()) == len(record.measurements)
    own = style.new_axes()
    assert record.plot(own) is own


def test_a_counterexample_is_zero_wherever_a_sample_is_taken():
    turn = sd.Plant([[0.0, 3.0, 0.0], [-3.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [[1.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    for plant, gaps in ((OSCILLATOR, (3.0, 3.3)), (turn, (1.0, 1.1))):
        with pytest.raises(CertificateError, match="no certificate with rate") as refused:
            sd.certify(plant, sd.GapRange(*gaps), eta=0.1)
        found = refused.value.details["counterexample"]
        *curves, samples = found.plot().lines
        for curve in curves:
            assert np.interp(samples.get_xdata(), *curve.get_data()) == pytest.approx(0.0, abs=1e-3)
        assert max(np.abs(curve.get_ydata()).max() for curve in curves) == pytest.approx(1.0)


def test_a_split_has_its_line_between_what_is_kept_and_what_fades():
    plant = sd.Plant(np.diag([-2.0, -0.1, -0.1]), np.eye(3))
    kept, rest, line, _ = sd.plants.split_modes(plant, 1.0).plot().lines
    assert line.get_xdata()[0] == -0.5
    assert (kept.get_xdata() > -0.5).all()
    assert (rest.get_xdata() < -0.5).all()
    assert [text.get_text() for text in line.axes.texts] == ["2"]  # a double eigenvalue is one point


def test_a_smoothed_window_shows_its_deviations():
    cost = sd.CostFunction(P2=np.eye(2), Qw=np.eye(2), R=np.eye(1))
    scheme = sd.NonlinearMovingHorizonEstimator(sd.nonlinear.from_linear(OSCILLATOR), horizon=5.0, cost=cost)
    scheme.run([(0.7, [0.3], None), (2.3, [-0.5], None)])
    window = scheme.smoothed()
    first, second = window.plot()
    assert second.lines[0].get_ydata() == pytest.approx(window.x[:, 1])
    band = first.collections[0].get_paths()[0].vertices[:, 1]
    assert band.max() == pytest.approx((window.x[:, 0] + window.deviation[:, 0]).max())
    assert len(first.collections[1].get_segments()) == 2
    own = style.new_axes()
    assert window.plot(own) is own


def test_a_front_without_points_is_not_drawn():
    with pytest.raises(ArgumentError, match="`record` has no point to draw: none of the counts can be met"):
        draw_pareto(SimpleNamespace(points=[]))


def test_the_worst_time_is_marked_on_the_curve_it_is_of():
    """Just before the first sample is at the end of the period that is shown; samples lie in it."""
    plant = sd.Plant([[0.0]], [[1.0]], time_unit="h", states=["level"], outputs=["lab"])
    schedule = sd.PeriodicSchedule.from_times([1.0, 3.0], 5.0, time_unit="h")
    late = {"lab": sd.schedules.Sensor(noise_bound=0.1, result_delay=1.5)}
    for noise in (0.1, late):
        found = sd.guaranteed_accuracy(plant, schedule, w_bound=0.1, v_bound=noise)
        (ax,) = found.plot()
        begun, ended = found.profile.edges[[0, -1]]
        (worst,) = [line.get_xdata()[0] for line in ax.lines if line.get_marker() == "o"]
        k = np.searchsorted(found.profile.edges, worst, side="left") - 1
        assert k >= 0
        assert found.profile.lower[0, min(k, found.profile.lower.shape[1] - 1)] >= 0.98 * found.lower[0]
        samples = [
            line.get_xdata()[0] for line in ax.lines if len(line.get_xdata()) == 2 and line.get_color() == style.ALLOWED
        ]
        assert len(samples) == 2
        assert all(begun <= t < ended for t in samples)
        assert ax.get_title(loc="left").startswith("guaranteed within ")


def test_horizons_count_in_a_unit_that_people_read():
    minutes = sd.Plant(OSCILLATOR.A / 60, OSCILLATOR.C, time_unit="s", states=["position", "velocity"])
    schedule = sd.PeriodicSchedule(60 * SCHEDULE.gaps, time_unit="s")
    found = sd.certificates.four_horizons(minutes, schedule, sd.certify(minutes, schedule, eta=0.2 / 60, P2=np.eye(2)))
    top = found.plot()[0]
    assert top.get_xlabel() == "horizon M must exceed [min]"
    dots = {round(float(line.get_xdata()[0]), 6) for line in top.lines}
    assert dots == {round(row.minimum / 60, 6) for row in found.rows if row.minimum is not None}
    assert f"{above(found.rows[2].minimum / 60, 4)} min is proven" in top.get_title(loc="left")


@pytest.mark.parametrize("loc", ["left", "center"])
def test_a_title_of_ones_own_stands_above_the_legend(loc):
    ax = sd.window_sigma(OSCILLATOR, sd.PeriodicSchedule([0.9, 1.4]), 4.0).plot()
    mine = ax.set_title("mine", loc=loc)
    ax.figure.draw_without_rendering()
    assert mine.get_window_extent().y0 >= ax.get_legend().get_window_extent().y1
    assert ax.set_title("lower", loc=loc, pad=1.0) is mine
    ax.figure.draw_without_rendering()
    assert mine.get_window_extent().y0 < ax.get_legend().get_window_extent().y1
