"""The figures of Section VI show what the run holds."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from sampling_design.errors import ArgumentError
from sampling_design.nonlinear.report import PatientRun
from sampling_design.nonlinear.thyroid import SCALING
from sampling_design.plotting import style

RNG = np.random.default_rng(0)
TIMES = np.arange(5) / 12
STATES = [(1 + RNG.random((5, 6))) / SCALING for _ in range(3)]
RUN = PatientRun("per_day", 0, TIMES, STATES[0], STATES[0][:, [1, 2, 4]], TIMES == 0, *STATES[1:], (), ())


@pytest.mark.parametrize(("number", "states"), [(2, (1, 2, 4)), (3, (0, 3, 5))])
def test_states_are_drawn_scaled_with_both_estimates(number, states):
    axes = RUN.figure(number).plot()
    assert len(axes) == 3
    for ax, state in zip(axes, states, strict=True):
        drawn = [line.get_ydata() for line in ax.lines]
        for values, column in zip((RUN.truth, RUN.standard, RUN.sample_based), drawn, strict=True):
            assert column == pytest.approx(values[:, state] * SCALING[state])
    assert [t.get_text() for t in axes[0].get_legend().get_texts()] == ["truth", "standard, every 2 h", "sample-based"]


def test_samples_are_marked_on_the_outputs():
    axes = RUN.figure(1).plot()
    marks = axes[0].lines[1]
    assert marks.get_xdata() == pytest.approx([0.0])
    assert marks.get_ydata() == pytest.approx(RUN.outputs[:1, 0] * SCALING[1])


def test_a_run_has_six_rows_and_fits_no_single_axes():
    assert len(RUN.plot()) == 6
    single = Figure().subplots()
    assert RUN.figure(1).plot(single) is single
    with pytest.raises(ArgumentError, match="`ax` cannot hold a run: it has six rows"):
        RUN.plot(single)


def test_schemes_are_not_drawn_in_a_colour_that_says_how_sure_something_is():
    taken = {style.PROVEN, style.ATTAINED, style.FAILED, style.MEASURED}
    drawn = {line.get_color() for number in (2, 3) for ax in RUN.figure(number).plot() for line in ax.lines}
    assert len(drawn) == 3
    assert not drawn & taken


def test_titles_and_insets_lie_within_their_figure():
    for picture in (RUN.figure(2).plot(), RUN.figure(3).plot(), RUN.plot()):
        whole = picture[0].figure
        whole.canvas.draw()
        box = whole._suptitle.get_window_extent()
        assert 0 <= box.x0 < box.x1 <= whole.bbox.width
