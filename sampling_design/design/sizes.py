"""Whether a problem can be computed at all: numbers that overflow and sizes beyond memory are refused before a try."""

from __future__ import annotations

import numpy as np

from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.errors import ArgumentError

MOST_GROWTH = 80.0
"""Exponent of growth over a window up to which a bound comes out as a number: beyond, products of rows lose them."""

MOST_MEMORY = 4.0e9  # bytes that one array of a design may take
_LARGEST, _SMALLEST = 1e120, 1e-120  # entries between them have squares and products of squares that are numbers
_LIKELY_PERIODS = 1e6  # periods that a window may hold: their times still differ by more than rounding
_BYTES = 8.0  # of a double


def check_size(problem: DesignProblem) -> None:
    """Refuse what overflows, and what takes more memory than `MOST_MEMORY`, with what it would take.

    Raises ArgumentError in one sentence, with what would be possible.
    """
    _check_numbers(problem)
    for size, what in _sizes(problem):
        if size <= MOST_MEMORY:
            continue
        raise ArgumentError(
            f"{what} would take {size / 1e9:.3g} GB of memory, more than the {MOST_MEMORY / 1e9:g} GB that a design "
            "may take. Ask for fewer samples, or a shorter window or period."
        )


def _check_numbers(problem: DesignProblem) -> None:
    window, plant = problem.window + 2 * problem.late, problem.plant
    for name, value in (("window", window), ("period", problem.period), ("spacing", problem.spacing)):
        ratio = value / window
        if not (_SMALLEST < value < _LARGEST and 1 / _LIKELY_PERIODS**2 < ratio < _LIKELY_PERIODS**2):
            raise ArgumentError(
                f"`{name}` {value:g} beside a window of {window:g} is out of all proportion: times differ by less than "
                "rounding. Give window, period and spacing of comparable size."
            )
    sizes = np.abs(plant.C[plant.C != 0])
    if sizes.size and not (sizes.max() < _LARGEST and sizes.min() > _SMALLEST):
        extreme = sizes.max() if sizes.max() >= _LARGEST else sizes.min()
        raise ArgumentError(
            f"`C` has an entry of size {extreme:.3g}, whose square is no number. Give the output or the state in "
            "another unit, or scales."
        )
    growth = float(np.max(np.abs(np.linalg.eigvals(plant.A).real), initial=0.0)) * window
    if growth > MOST_GROWTH:
        raise ArgumentError(
            f"`window` {window:g} is too long for this plant: a mode grows or decays by e^{growth:.4g} over it, and "
            f"a bound has digits up to e^{MOST_GROWTH:g}. Give a window of {window * MOST_GROWTH / growth:.4g} or less."
        )


def _sizes(problem: DesignProblem) -> list[tuple[float, str]]:
    """The largest arrays of a design in bytes, and what asks for them."""
    k, n, p = float(problem.samples), float(problem.plant.n_states), float(problem.plant.n_outputs)
    periods = np.ceil(problem.window / problem.period) + 2
    return [
        (3 * k * k * _BYTES, f"`samples` {problem.samples:g}"),
        (k * periods * n * n * _BYTES * 4, f"a window that holds {k * periods:.3g} samples"),
        (2 * k * k * periods * n * p * _BYTES, f"{2 * k:g} windows with {k * periods:.3g} samples each"),
        (32 * 960 * periods * n * p * _BYTES, f"a window of {periods:.3g} periods"),
    ]
