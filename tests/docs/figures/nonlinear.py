"""docs/theory/nonlinear.md: a grid that is refined, and the thyroid patient's figures."""

from functools import cache
from pathlib import Path

import numpy as np
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.nonlinear import thyroid
from sampling_design.nonlinear.collocation import Collocation
from sampling_design.nonlinear.simulation import simulate
from sampling_design.nonlinear.thyroid_logs import DOSE, THERAPY_UPPER, TUBE_LOWER, TUBE_UPPER, logarithmic_thyroid
from tests.docs.figures import NUMBER, Figure
from tests.nonlinear.test_mhe_options import last_error

PAGE = "theory/nonlinear.md"
DATA = Path(__file__).parents[3] / "examples" / "data"
P2 = np.array([1.0, 5.0, 1.0, 1.0, 1.0, 1.0])
"""The paper's, in scaled states."""


def refined():
    """The largest error of the coarse grid; the degree of the refined one, its error from the third sample on."""
    times = np.arange(0.0, 6.0)
    coarse = last_error(times, collocation=Collocation(accuracy=None))[2]
    scheme, _, fine = last_error(times)
    return coarse.max(), scheme.search.degree, 1e4 * fine[2:].max()


@cache
def at_rest():
    plant = thyroid.thyroid()
    return plant.linearise(plant.equilibrium(thyroid.TRUE_START, [0.0, 0.0]))


def grown(days=5.6e-7):
    """By how much a small difference grows in P2, without a disturbance; the horizon of Theorem 9 for that."""
    scaling = thyroid.SCALING * np.sqrt(P2)
    F = expm(at_rest().A * days) * scaling[:, None] / scaling
    largest = np.linalg.norm(F, 2) ** 2
    return largest, 2 * np.log(2 * largest) / 0.35


def within(tube):
    """T4 [nmol/l] at the ends of a tube."""
    plant = logarithmic_thyroid()
    return tuple(1e9 * plant.h([0.0, end[1], 0.0, 0.0, 0.0, 0.0])[0] for end in (TUBE_LOWER, tube))


def after_200_days():
    times = np.arange(0.0, 201.0, 20.0)
    dose = np.tile([DOSE, 0.0], (times.size, 1))
    ends = (simulate(thyroid.thyroid(), start, times, u=dose) for start in (thyroid.TRUE_START, thyroid.PRIOR_START))
    return (1e9 * max(states[-1, 1] for states in ends),)


def proven(name):
    found = sd.read_certificate(DATA / f"thyroid_{name}.json")
    return found.eta, found.horizon("arrival").minimum, found.horizon().minimum, found.lam_proven


def slowest_and_fastest():
    rates = np.abs(np.linalg.eigvals(at_rest().A))
    return rates.min(), rates.max() / 1e7


TUBE = rf"T4 between {NUMBER} and {NUMBER} nmol/l"
FIGURES = (
    Figure(
        PAGE,
        rf"degree 2 is off by {NUMBER} in silence; refined to degree (\d+) it is off by \${NUMBER}\\cdot10\^\{{-4\}}\$",
        refined,
        slow=True,
    ),
    Figure(PAGE, rf"in TSH_c that is {NUMBER} times .*\n\$M>{NUMBER}\$ d", grown),
    Figure(PAGE, rf"{TUBE}, the other states", lambda: within(TUBE_UPPER)),
    Figure(PAGE, rf"{TUBE} \(`patient_under", lambda: within(THERAPY_UPPER)),
    Figure(PAGE, rf"which bring T4 to {NUMBER} nmol/l", after_200_days),
    Figure(
        PAGE,
        rf"at \$\\eta={NUMBER}\$ per day: .*=(\d\.\d\d)\$ d contracts .* one longer than\n.*={NUMBER}\$ d .*"
        rf"\$\\lambda={NUMBER}\$",
        lambda: proven("patient"),
    ),
    Figure(
        PAGE,
        rf"between samples, \$\\eta={NUMBER}\$, \$M>{NUMBER}\$ d with",
        lambda: proven("therapy")[:2],
    ),
    Figure(PAGE, rf"\$\\lambda={NUMBER}\$, \$M>{NUMBER}\$ d with \$P_2\$", lambda: proven("therapy")[:1:-1]),
    Figure(
        "theory/inclusion.md",
        rf"rates from \${NUMBER}\$ to \${NUMBER}\\cdot10\^7\$ per day",
        slowest_and_fastest,
    ),
)
