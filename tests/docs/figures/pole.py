"""docs/pole.md: what the example's own functions say of the record."""

import numpy as np

from examples.polar_motion import pole
from tests.docs.figures import NUMBER, Figure

PAGE = "pole.md"
SCALE = rf"that no three years disprove is {NUMBER} when"


def least_scale():
    return (pole.least_scale(pole.read_pole()),)


def turned():
    """Share of a circle by which the Chandler wobble turns forwards in 198 days, and the annual motion backwards."""
    rates = np.abs(np.linalg.eigvals(pole.plant().A).imag)
    chandler, annual = np.unique(np.round(rates[rates > 0], 12)) * 198.0 / (2 * np.pi)
    return chandler % 1.0, -annual % 1.0


FIGURES = (
    Figure(PAGE, SCALE, least_scale, slow=True),
    Figure(PAGE, rf"passes through {NUMBER} of its period, .* annual oscillation through {NUMBER}: they", turned),
)
