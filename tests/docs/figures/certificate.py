"""docs/theory/certificate.md and docs/numerics.md: what a certificate says at samples and between them."""

from functools import cache

import numpy as np

import sampling_design as sd
from tests.docs.figures import Figure


@cache
def inside_a_gap():
    plant = sd.Plant([[0.0, 3.0], [-3.0, 0.0]], [[1.0, 0.0]])
    made = sd.certify(plant, sd.PeriodicSchedule([1.0]), eta=0.5, P2=np.diag([0.1, 1.0]), Qw=100 * np.eye(2))
    return made.lam_samples, made.witness.ratio, made.witness.start


FIGURES = (
    Figure("theory/certificate.md", r"has (\d*\.?\d+) there and (\d*\.?\d+) at (\d*\.?\d+) into", inside_a_gap),
    Figure("numerics.md", r"\| (\d*\.?\d+) where (\d*\.?\d+) is true", lambda: inside_a_gap()[:2]),
)
