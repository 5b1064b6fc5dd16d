"""Law: whatever observable plant, schedule, gain and window, the proof's constants satisfy Assumption 7 exactly."""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant
from sampling_design.certificates.detectability.best_rate import certify_detectability
from sampling_design.certificates.paper.proof_constants import constants_from_proof
from tests.cases import few
from tests.oracles.proof_constants import riccati_margin


@pytest.mark.parametrize("seed", few(range(10), 1, 3))
def test_information_stays_above_p1(seed):
    rng = np.random.default_rng(100 + seed)
    n = int(rng.integers(1, 4))
    A = rng.normal(size=(n, n)) * rng.uniform(0.2, 1.5)
    A += (0.01 - min(0.0, np.min(np.linalg.eigvals(A).real))) * np.eye(n)  # everything is retained
    plant = Plant(A, rng.normal(size=(int(rng.integers(1, 3)), n)), G=rng.normal(size=(n, int(rng.integers(1, 3)))))
    gaps = rng.uniform(0.2, 1.0, int(rng.integers(1, 4)))
    given = certify_detectability(plant) if seed % 2 else None
    proof = constants_from_proof(plant, PeriodicSchedule(gaps), variant="tightened", detectability=given)
    weights = (proof.P1, proof.P2, proof.Qw, proof.R, proof.Qv, proof.eta)
    for first in range(gaps.size):
        turned = np.roll(gaps, -first)
        for start in (0.0, 0.4 * turned[0]):
            assert riccati_margin(plant.A, plant.C, plant.G, turned, *weights, start=start) > 1
    broken = riccati_margin(plant.A, plant.C, plant.G, gaps, 1e6 * proof.P1, *weights[1:])
    assert broken < 1
