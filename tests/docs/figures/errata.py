"""docs/theory/errata.md: how often a printed partition does not exist."""

import numpy as np

from tests.docs.figures import Figure
from tests.oracles.proof_constants import partition_exists


def without_partition(t_star):
    """Share of the times in (t*, 6 t*) that have no partition, samples at whole times."""
    ends, samples = np.linspace(t_star, 6 * t_star, 400)[1:], np.arange(1.0, 7 * t_star)
    return np.mean([not partition_exists(samples, t, t_star, last_may_be_short=False) for t in ends])


def extremes():
    shares = [100 * without_partition(count + 0.5) for count in (1, 10, 50)]
    return min(shares), max(shares)


FIGURES = (Figure("theory/errata.md", r"it fails for (\d+) to (\d+) % of all", extremes),)
