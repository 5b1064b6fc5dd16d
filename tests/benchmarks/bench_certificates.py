"""Speed of certificates: 20 samples a period, 6 states (given weights, chosen weights, verify); first calls apart."""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, certify


@pytest.fixture(scope="module")
def case():
    rng = np.random.default_rng(1)
    A = rng.normal(size=(6, 6))
    A -= np.eye(6) * np.linalg.eigvals(A).real.max()
    return Plant(A, rng.normal(size=(1, 6))), PeriodicSchedule(rng.uniform(0.3, 0.7, 20))


@pytest.mark.parametrize("prior", [1.0, 0.1, 1e-3])
def test_given_weights(benchmark, case, prior):
    plant, schedule = case
    certify(plant, schedule, eta=0.1, P2=prior * np.eye(6))
    made = benchmark(certify, plant, schedule, eta=0.1, P2=prior * np.eye(6))
    assert made.lam > 1


@pytest.mark.parametrize("eta", [0.2, None])
def test_chosen_weights(benchmark, case, eta):
    made = benchmark.pedantic(certify, case, {"eta": eta}, rounds=2, warmup_rounds=1)
    assert made.lam > 1


@pytest.mark.parametrize("prior", [1.0, 0.1, 1e-3])
def test_verify(benchmark, case, prior):
    made = certify(*case, eta=0.1, P2=prior * np.eye(6))
    assert benchmark(made.verify).passed
