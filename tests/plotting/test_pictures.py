"""Pictures: what they show is what the record says, and they are written whole or not at all."""

import struct

import matplotlib.pyplot as plt
import numpy as np
import pytest

import sampling_design as sd
from sampling_design import plotting
from sampling_design.errors import ArgumentError

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
SCHEDULE = sd.PeriodicSchedule([0.7, 1.6, 0.9], time_unit="s")


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
    assert min(np.min(y) for y in drawn) == pytest.approx(result.lower)
    assert any(f"{result.lower:.4g}" in t.get_text() for t in ax.get_legend().get_texts())


def test_a_design_has_two_rows_and_its_bounds(tmp_path):
    design = sd.design_schedule(OSCILLATOR, sd.Requirement(window=4.0, samples=3, forbidden=[[1.0, 1.5]]))
    top, bottom = plotting.draw(design)
    assert top.figure is bottom.figure
    assert top.figure.get_suptitle().count(f"{design.sigma:.4g}") == 1
    for suffix, magic in (("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")):
        path = plotting.save(design, tmp_path / f"design.{suffix}")
        assert path.read_bytes().startswith(magic)


def test_a_certificate_is_drawn_above_its_promise():
    certificate = sd.certify(OSCILLATOR, SCHEDULE)
    ax = certificate.plot()
    assert ax.get_yscale() == "log"
    assert ax.lines[0].get_ydata().min() >= 1.0
    assert "touches" not in ax.get_ylabel()


def test_four_horizons_are_bars_with_their_lengths():
    horizons = sd.four_horizons(OSCILLATOR, SCHEDULE)
    top, bottom = plotting.draw(horizons)
    drawn = [bar.get_width() for bar in top.patches]
    assert drawn == pytest.approx([row.minimum for row in horizons.rows])
    assert [t.get_text() for t in top.get_yticklabels()] == [row.name for row in horizons.rows]
    assert bottom.has_data()


def test_a_worst_case_shows_the_worst_times():
    result = sd.worst_case_sigma(OSCILLATOR, sd.SpacedWindows(4.0, 3, 0.5))
    ax = result.plot()
    assert [s[0][0] for s in ax.collections[0].get_segments()] == pytest.approx(result.witness)


def test_fronts_and_losses_are_drawn_and_an_empty_front_refused():
    requirement = sd.Requirement(window=4.0)
    front = sd.pareto(OSCILLATOR, requirement, [2, 3])
    ax = front.plot()
    assert list(ax.lines[1].get_ydata()) == [p.sigma for p in front.points]
    losses = sd.sample_losses(sd.design_schedule(OSCILLATOR, requirement.replace(samples=3)))
    assert len(losses.plot().collections[0].get_segments()) == 3
    with pytest.raises(ArgumentError, match="`record` has no point to draw"):
        sd.pareto(OSCILLATOR, sd.Requirement(window=4.0, spacing=3.0), [5]).plot()


def test_pictures_are_drawn_on_given_axes():
    from matplotlib.figure import Figure

    axes = Figure().subplots(3, 1)
    design = sd.design_schedule(OSCILLATOR, sd.Requirement(window=4.0, samples=3))
    for record, ax in zip((SCHEDULE, design, design.window), axes, strict=True):
        assert record.plot(ax) is ax
        assert ax.has_data()


def test_a_notebook_shows_the_axes_that_plot_returns():
    one = SCHEDULE.plot()
    several = sd.four_horizons(OSCILLATOR, SCHEDULE).plot()
    assert isinstance(several, list)
    for shown in (one, several):
        width, height = struct.unpack(">II", shown._repr_png_()[16:24])
        assert shown._repr_png_().startswith(b"\x89PNG")
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
