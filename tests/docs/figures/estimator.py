"""docs/theory/estimator.md: the least cost of a disturbance over one gap, and what other signs would give."""

import numpy as np

from tests.docs.figures import NUMBER, Figure


def costs(steps=20_000):
    """The least int e^{-eta (h - tau)} |w|^2 with int w = 1, of w constant on fine steps; what other signs give."""
    tau = (np.arange(steps) + 0.5) / steps
    least, forms = 1 / np.mean(np.exp(1 - tau)), [1 / np.mean(np.exp(sign * tau)) for sign in (1, 0, -1)]
    assert abs(least - forms[0]) < 1e-9
    return forms[0], forms[1], forms[2]


FIGURES = (
    Figure(
        "theory/estimator.md",
        rf"the least cost is {NUMBER}; without the factor the form gives (\d), with \$e\^\{{-\\eta s\}}\$ {NUMBER}",
        costs,
    ),
)
