"""Law: a bound kappa on the samples per window is needed, it is no convenience of the proof.

An oscillator measured in clusters at multiples of half its period, cluster length d, 4/d^2 samples each: every cluster
keeps the same sigma, and yet the information kept between clusters falls without bound as d shrinks.
"""

import numpy as np

from sampling_design import PeriodicSchedule, Plant, certify
from sampling_design.observability.windows.sampled import sigma_min

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def clusters(length):
    count = round(4 / length**2)
    return PeriodicSchedule.from_times(np.linspace(0.0, length, count), np.pi)


def test_sigma_stays_while_lambda_grows():
    lengths = (0.8, 0.5, 0.3)
    sigmas = [sigma_min(OSCILLATOR, clusters(d).times) for d in lengths]
    floors = []
    for d in lengths:
        made = certify(OSCILLATOR, clusters(d), eta=0.4, P2=1e2 * np.eye(2))
        floors.append(1 / np.linalg.eigvalsh(made.P1)[0])
    assert max(sigmas) / min(sigmas) < 1.2
    assert floors[0] < floors[1] < floors[2]
    assert floors[2] > 1.5 * floors[0]
