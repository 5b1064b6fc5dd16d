"""Figures 1 to 3 of the paper's Section VI: outputs and samples, measured states, unmeasured states."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.errors import ArgumentError
from sampling_design.nonlinear.report import PatientFigure, PatientRun
from sampling_design.nonlinear.thyroid import SCALING
from sampling_design.plotting import style

_STATES = ("T4_th", "T4", "T3_p", "T3_c", "TSH", "TSH_c")
_UNITS = ("pmol/l", "100 nmol/l", "nmol/l", "10 nmol/l", "mU/l", "mU/l")  # of z = T x
_MEASURED = (1, 2, 4)  # states whose panels show measurements
_UNMEASURED = (0, 3, 5)  # states whose panels show no measurements
_ROWS = {1: _MEASURED, 2: _MEASURED, 3: _UNMEASURED}


def draw_figure(figure: PatientFigure, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw one figure in three rows and return the axes; on `ax` alone its first row."""
    states = _ROWS[figure.number]
    if ax is not None:
        return _row(figure.of, figure.number, states[0], ax)
    whole, axes = style.new_figure(len(states), row_height=2.0)
    for state, row in zip(states, axes, strict=True):
        _row(figure.of, figure.number, state, row)
        row.label_outer()
        if figure.number == 3:
            _inset(figure.of, state, row)
    whole.suptitle(figure.explain(), fontsize="medium", wrap=True)
    style.legend(axes[0])
    return axes


def draw_patient_run(run: PatientRun, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw all six states with both estimates and return the axes.

    Raises ArgumentError if `ax` is given: six rows need a figure of their own.
    """
    if ax is not None:
        raise ArgumentError("`ax` cannot hold a run: it has six rows. Draw run.figure(1), (2) or (3) instead.")
    whole, axes = style.new_figure(len(_STATES), row_height=1.6)
    for state, row in enumerate(axes):
        _row(run, 2 if state in _MEASURED else 3, state, row)
        paths = np.array([run.truth[:, state], run.standard[:, state], run.sample_based[:, state]]) * SCALING[state]
        style.not_ruled_by_the_start(row, run.times, paths.min(axis=0), paths.max(axis=0))
        row.label_outer()
    style.legend(axes[0])
    whole.suptitle(run.explain(), fontsize="medium", wrap=True)
    return axes


SETTLED = 1.0  # the inset of figure 3 begins here [d]: before, the prior's error is all that can be seen


def _inset(run: PatientRun, state: int, row: Axes) -> None:
    """Draw the states of a row from day 1 on, where truth and estimates are no longer one line."""
    late = run.times >= SETTLED
    if late.sum() < 2:
        return
    inset = row.inset_axes((0.35, 0.25, 0.63, 0.5))
    paths = [(run.truth, style.TRUTH), (run.standard, style.ALLOWED), (run.sample_based, style.ESTIMATE)]
    for path, colour in paths:
        inset.plot(run.times[late], path[late, state] * SCALING[state], color=colour, linewidth=0.9)
    inset.tick_params(labelsize="x-small")
    inset.set_title(f"from day {SETTLED:g}", fontsize="x-small", pad=2.0)


def _row(run: PatientRun, number: int, state: int, ax: Axes) -> Axes:
    scale = SCALING[state]
    if number == 1:
        column = _MEASURED.index(state)
        y = run.outputs[:, column] * scale
        ax.plot(run.times, y, color=style.ALLOWED, linewidth=1.0, label="noisy output")
        ax.plot(run.times[run.sampled], y[run.sampled], "o", color=style.MEASURED, markersize=5, label="samples")
    else:
        ax.plot(run.times, run.truth[:, state] * scale, color=style.TRUTH, linewidth=1.4, label="truth")
        schemes = (
            (run.standard, style.ALLOWED, "standard, every 2 h"),
            (run.sample_based, style.ESTIMATE, "sample-based"),
        )
        for path, colour, label in schemes:
            ax.plot(run.times, path[:, state] * scale, color=colour, linewidth=1.1, label=label)
    ax.set_ylabel(f"{_STATES[state]} [{_UNITS[state]}]")
    ax.set_xlabel(style.time_label("d"))
    return ax
