"""Accuracy of every state of every library plant to one per cent.

python -m tests.benchmarks.library_accuracy [PLANT ...] writes docs/library_accuracy.md, or the rows of those plants in
it. Each plant has the period and the number of samples of its example requirement, evenly spaced; the tidal gauge's
thirty readings pass through the hours of daylight, since one a day at one clock time would alias. w is bounded by the
plant's own scales of its disturbances, the noise by a twentieth of each output's scale.
"""

import sys
import time

import numpy as np

from sampling_design import PeriodicSchedule, guaranteed_accuracy
from sampling_design.plants import library
from tests.benchmarks.pages import MeasuredPage, Table

SCHEDULES = {
    "double_integrator": (4, 10.0),
    "triple_integrator": (6, 10.0),
    "oscillator": (4, 2 * np.pi),
    "satellite": (12, 5554.0),
    "cart_pendulum": (5, 0.5),
    "three_compartment": (4, 240.0),
    "helicopter_he1": (5, 5.0),
}
NOISE = 0.05


def schedule_of(name):
    """The period and number of samples of the example requirement, evenly spaced."""
    if name == "tidal_gauge":
        hours = 24 * np.arange(30.0) + 7 + 12 * (np.arange(30) * (np.sqrt(5) - 1) / 2 % 1)
        return PeriodicSchedule.from_times(hours, 720.0)
    count, period = SCHEDULES[name]
    return PeriodicSchedule(np.full(count, period / count))


def measured(name, rtol=0.01):
    """Accuracy of all states and the process time that it took."""
    plant = getattr(library, name)()
    before = time.process_time()
    found = guaranteed_accuracy(
        plant,
        schedule_of(name),
        w_bound=plant.disturbances.scales,
        v_bound=NOISE * plant.outputs.scales,
        rtol=rtol,
    )
    return found, time.process_time() - before


def cells(name):
    """The columns of a plant after its name."""
    found, taken = measured(name)
    loose = float(np.max(found.upper / found.lower)) - 1
    rows = ", ".join(
        f"{row} {low:.5g} to {high:.5g}"
        for row, low, high in zip(found.rows.names, found.lower, found.upper, strict=True)
    )
    return str(len(found.schedule.gaps)), rows, f"{100 * loose:.2f} %", f"{taken:.1f}"


WHAT = """How well every state of the library's plants can be known at the worst time: evenly spaced samples of its
example period (the tidal gauge's pass through the hours of daylight), $w$ bounded by the scales of the disturbances and
$v$ by a twentieth of those of the outputs, asked to 1 %; [accuracy](#accuracy-library)."""
PAGE = MeasuredPage(
    "library_accuracy.md",
    "What samples tell of the library's plants",
    WHAT,
    "python -m tests.benchmarks.library_accuracy",
    "Both ends are proven. Rows that a run does not name stay as an earlier run left them.",
    [Table(("plant", "samples", "worst errors", "widest bracket", "CPU s"), [*SCHEDULES, "tidal_gauge"], cells)],
)

if __name__ == "__main__":
    PAGE.run(sys.argv[1:])
