"""docs/theory/families.md: lambda of outputs that come apart, by cells of the last deviation, and what is reached."""

import numpy as np

import sampling_design as sd
from sampling_design.schedules.output_jitter import OutputJitter
from tests.docs.figures import NUMBER, Figure
from tests.oracles.families import adversarial_lambda

PAGE = "theory/families.md"


def lambdas():
    plant, planned, each = sd.Plant([[0.5]], [[1.0], [0.3]]), sd.PeriodicSchedule([1.0], first=0.5), np.full(2, 0.2)
    family = OutputJitter(planned, each, each)
    made = [sd.certify(plant, family, eta=0.3, P2=[[1.0]], memory=k) for k in range(4)]
    weights, seen = (made[0].Qw, made[0].R, made[0].Qv), np.ones((3, 2), bool)
    times, rng = np.array([0.5, 1.5, 2.5]), np.random.default_rng(0)
    found, _ = adversarial_lambda(plant, weights, 0.3, made[0].P2, times, seen, each, each, rng)
    return (*(c.lam for c in made), found)


TEXT = rf"a \$\\lambda\\le {NUMBER},\\,{NUMBER},\\,{NUMBER},\\,{NUMBER}\$ with .* real times reach \${NUMBER}\$"
FIGURES = (Figure(PAGE, TEXT, lambdas, slow=True),)
