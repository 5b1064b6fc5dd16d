"""docs/theory/accuracy.md: reference values, the limit of all schedules, and the set that nobody can exclude."""

from functools import cache

import sampling_design as sd
from tests.docs.figures import NUMBER, Figure

PAGE = "theory/accuracy.md"
OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
INTEGRATOR = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
BRACKETS = rf"{NUMBER}; %s \| {NUMBER} to {NUMBER}; {NUMBER} to {NUMBER} \|"


@cache
def swinging():
    schedule = sd.PeriodicSchedule([0.7, 1.6, 0.9, 2.0])
    return sd.guaranteed_accuracy(OSCILLATOR, schedule, w_bound=0.02, v_bound=0.4)


def reference(found):
    """The position at samples, which is the same at each; the velocity there; both brackets over all times."""
    position, velocity = found.at_samples
    assert max(position) - min(position) < 1e-3
    brackets = (side[row] for row in range(2) for side in (found.lower, found.upper))
    return position[0], *velocity, *brackets


def drifting():
    schedule = sd.PeriodicSchedule([1.0, 0.6, 1.4])
    return reference(sd.guaranteed_accuracy(INTEGRATOR, schedule, w_bound=0.02, v_bound=0.1))


def dense():
    return sd.guaranteed_accuracy(OSCILLATOR, sd.PeriodicSchedule([0.05]), w_bound=0.02, v_bound=0.4).upper


def projection():
    areas = swinging().projection("x1", "x2").areas()
    assert areas.ellipse / areas.inner - areas.ellipse / areas.outer < 0.05
    return (areas.ellipse / areas.outer,)


FIGURES = (
    Figure(
        PAGE, r"\| oscillator, .* \| " + BRACKETS % ", ".join([NUMBER] * 4), lambda: reference(swinging()), slow=True
    ),
    Figure(PAGE, r"\| double integrator, .* \| " + BRACKETS % ", ".join([NUMBER] * 3), drifting),
    Figure(
        PAGE,
        rf"has a limit of {NUMBER} for its position and {NUMBER} for its velocity",
        lambda: tuple(sd.accuracy.accuracy_limit(OSCILLATOR, w_bound=0.02, v_bound=0.4).lower),
        slow=True,
    ),
    Figure(PAGE, rf"samples every \$.05\$ s guarantee {NUMBER} and {NUMBER}", lambda: tuple(dense()), slow=True),
    Figure(PAGE, rf"its area is {NUMBER} times that of the set", projection, slow=True),
)
