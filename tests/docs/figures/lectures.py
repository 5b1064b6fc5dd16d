"""examples/notebooks: what their texts say of what their cells print."""

import sampling_design as sd
from tests.docs.figures import Figure

NOTEBOOKS = "../examples/notebooks"
EVEN, BUNCHES = [0.5, 2.0, 3.5, 5.0], [1.0, 1.05, 1.1, 2.5, 2.55, 2.6]


def worse():
    """By how much six readings in two bunches leave more error than four even ones, at least and at most."""
    swing, more = sd.named_plant("oscillator"), []
    schedules = [sd.PeriodicSchedule.from_times(times, 6.0, time_unit="s") for times in (EVEN, BUNCHES)]
    for w_bound in (0.02, 0.05):
        even, bunches = (sd.guaranteed_accuracy(swing, s, w_bound=w_bound, v_bound=0.1).upper for s in schedules)
        more += (100 * (bunches / even - 1)).tolist()
    return min(more), max(more)


def horizons():
    """The horizon of the proof's constants, in certified ones."""
    plant, schedule = sd.named_plant("double_integrator"), sd.PeriodicSchedule([1.0])
    paper = sd.certificates.constants_from_proof(plant, schedule).horizon
    return (paper / sd.certify(plant, schedule).horizon().minimum,)


FIGURES = (
    Figure(f"{NOTEBOOKS}/07_what_anybody_can_know.ipynb", r"\*worse\*, by (\d+) % to (\d+) %", worse, slow=True),
    Figure(
        f"{NOTEBOOKS}/03_from_detectability_to_a_certificate.ipynb",
        r"here: (\d+) times the certified horizon",
        horizons,
        slow=True,
    ),
)
