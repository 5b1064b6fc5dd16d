"""docs/theory/errata.md: least singular values, a partition that does not exist, and a horizon of Section VI."""

import numpy as np

import sampling_design as sd
from sampling_design.observability.windows.sampled import sigma_min
from tests.docs.figures import NUMBER, Figure
from tests.oracles.proof_constants import partition_exists


def without_partition(t_star):
    """Share of the times in (t*, 6 t*) that have no partition, samples at whole times."""
    ends, samples = np.linspace(t_star, 6 * t_star, 400)[1:], np.arange(1.0, 7 * t_star)
    return np.mean([not partition_exists(samples, t, t_star, last_may_be_short=False) for t in ends])


def extremes():
    shares = [100 * without_partition(count + 0.5) for count in (1, 10, 50)]
    return min(shares), max(shares)


def half_gaps():
    plant = sd.Plant([[0.0, np.pi], [-np.pi, 0.0]], [[1.0, 0.0]])
    return (sigma_min(plant, sd.PeriodicSchedule([0.5]).between(0.0, 5.0)),)


PAGE = "theory/errata.md"
FIGURES = (
    Figure(PAGE, rf"and {NUMBER} over 5 s with gaps", half_gaps),
    Figure(
        PAGE,
        rf"\$\\sigma_2\$ is {NUMBER} at every integer \$t\$",
        lambda: (sigma_min(sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]]), [0.0, 1.0]),),
    ),
    Figure(PAGE, r"it fails for (\d+) to (\d+) % of all", extremes),
    Figure(
        PAGE,
        rf"needs \$\\lambda\$ below {NUMBER}, and \$M\$ above {NUMBER} days",
        lambda: (np.exp(0.35 * 5 / 2) / 2, 2 * np.log(2) / 0.35),
    ),
)
