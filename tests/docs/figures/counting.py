"""docs/theory/counting.md: critical lengths and losses that schedules tolerate."""

import numpy as np

import sampling_design as sd
from sampling_design.observability.count.loss_tolerance import loss_tolerance
from tests.docs.figures import TABLE, Figure

PAGE = "theory/counting.md"
SPIRAL = sd.Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.0]])
QUARTER = np.pi / 2


def critical_length(*eigenvalues):
    A = np.vstack([np.eye(len(eigenvalues))[1:], -np.real(np.poly(eigenvalues))[:0:-1]])
    return lambda: (sd.zero_count_bound(sd.Plant(A, np.eye(1, len(A))), 1.0).critical_length,)


def tolerated(*gaps):
    return lambda: (loss_tolerance(SPIRAL, sd.PeriodicSchedule(gaps)).lower,)


def moved():
    """Sixteen even samples of four periods, each moved on its own: one of them is hidden from a direction."""
    times = QUARTER * (np.arange(16) + 0.5) + np.random.default_rng(0).uniform(-0.3, 0.3, 16)
    return (loss_tolerance(SPIRAL, sd.PeriodicSchedule.from_times(times, 16 * QUARTER)).lower,)


FIGURES = (
    Figure(PAGE, TABLE.format(r"\$\\pm i\$"), critical_length(1j, -1j)),
    Figure(PAGE, TABLE.format(r"\$0,\\pm i\$; \$0,0,\\pm i\$"), critical_length(0, 1j, -1j)),
    Figure(PAGE, r"\$0,0,\\pm i\$ \| (\d*\.?\d+) \|", critical_length(0, 0, 1j, -1j)),
    Figure(PAGE, TABLE.format(r"\$0,0,0,\\pm i\$"), critical_length(0, 0, 0, 1j, -1j)),
    Figure(PAGE, r"\$\\pm i,\\pm2i\$.* \| (\d*\.?\d+) \|", critical_length(1j, -1j, 2j, -2j)),
    Figure(PAGE, r"\\pm i,\\pm3i\$; .* \| (\d*\.?\d+) \|", critical_length(1j, -1j, 3j, -3j)),
    Figure(PAGE, r"\$0,\\pm i,\\pm3i\$ \| (\d*\.?\d+) \|", critical_length(0, 1j, -1j, 3j, -3j)),
    Figure(PAGE, TABLE.format(r"\$-1,-2,0.1\\pm i\$"), critical_length(-1, -2, 0.1 + 1j, 0.1 - 1j)),
    Figure(PAGE, r"evenly spaced samples tolerate (\d*\.?\d+)", tolerated(*[QUARTER] * 4)),
    Figure(
        PAGE,
        r"uneven ones to a period (\d*\.?\d+), no schedule as dense (\d*\.?\d+)",
        lambda: (*tolerated(*QUARTER * np.array([0.6, 1.1, 0.8, 1.5]))(), np.exp(-0.1 * np.pi)),
    ),
    Figure(PAGE, r"within one period tolerate more than (\d*\.?\d+)", lambda: (np.exp(-0.2 * 4 * QUARTER / (4 - 1)),)),
    Figure(PAGE, r"a single sample of sixteen is hidden: (\d*\.?\d+)", moved),
)
