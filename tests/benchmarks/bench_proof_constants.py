"""Benchmarks of detectability and of the proof's constants; the first call of each is not counted."""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, named_plant
from sampling_design.certificates.detectability.best_rate import certify_detectability
from sampling_design.certificates.paper.proof_constants import constants_from_proof


@pytest.mark.parametrize("name", ["oscillator", "satellite", "tidal_gauge"])
def test_certify_detectability(benchmark, name):
    plant = named_plant(name)
    assert certify_detectability(plant).verify().passed
    benchmark(certify_detectability, plant)


@pytest.mark.parametrize("variant", ["paper", "tightened"])
def test_constants_from_proof(benchmark, variant):
    plant, schedule = named_plant("oscillator"), PeriodicSchedule([1.0])
    assert np.isfinite(constants_from_proof(plant, schedule, variant=variant).horizon)
    benchmark(constants_from_proof, plant, schedule, variant=variant)
