"""docs/theory/inclusion.md: certificates that its text names, and what the thyroid patient's rates are."""

from functools import cache

import numpy as np

import sampling_design as sd
from tests.docs.figures import NUMBER, Figure

PAGE = "theory/inclusion.md"


@cache
def swinging():
    """An oscillator of pi rad/s within 1 %, on gaps of which the longest alone would alias."""
    plant = sd.Plant([[0.0, 1.0], [-(np.pi**2), 0.0]], [[1.0, 0.0]])
    ends = ((np.pi * (1 + share)) ** 2 for share in (-0.01, 0.01))
    box = sd.UncertainPlant(plant, [sd.UncertainParameter("omega^2", *ends, A=[[0, 0], [-1, 0]], nominal=np.pi**2)])
    return sd.certify(box, sd.PeriodicSchedule([0.5, 0.5, 1.0]), eta=0.35)


FIGURES = (
    Figure(
        PAGE,
        rf"is certified \(\$\\eta={NUMBER}\$, \$\\lambda\$ {NUMBER}\), although",
        lambda: (swinging().eta, swinging().lam),
        slow=True,
    ),
)
