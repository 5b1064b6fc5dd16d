"""A certificate is about A, C, G in one time unit: every door that takes one asks the same question."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from sampling_design import (
    MovingHorizonEstimator,
    PeriodicSchedule,
    Plant,
    certify,
    read_certificate,
    robustness,
    validate,
)
from sampling_design.certificates.compare.four_horizons import four_horizons
from sampling_design.certificates.detectability.best_rate import certify_detectability
from sampling_design.certificates.paper.proof_constants import certify_from_proof, constants_from_proof
from sampling_design.errors import SamplingDesignError
from sampling_design.plants.plant import first_difference
from tests.cases import few

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], time_unit="h")
SCHEDULE = PeriodicSchedule([1.0])
OTHERS = {
    "its time unit is 'h', not 's'": {"time_unit": "s"},
    r"its A\[0, 1\] is 1.0, not 1.0000000000000002": {"A": [[0.0, np.nextafter(1.0, 2.0)], [-1.0, 0.0]]},
    r"its C has shape \(1, 2\), not \(2, 2\)": {"C": np.eye(2), "D": None, "outputs": None},
    r"its G\[1, 1\] is 1.0, not 2.0": {"G": np.diag([1.0, 2.0])},
}


@pytest.mark.parametrize(("words", "change"), few(OTHERS.items(), 1))
def test_every_door_refuses_a_certificate_of_another_plant_and_names_the_first_difference(words, change, tmp_path):
    certificate = certify(OSCILLATOR, SCHEDULE, eta=0.4, P2=np.eye(2))
    other = dataclasses.replace(OSCILLATOR, **change)
    path = certificate.save(tmp_path / "certificate.json")
    proof = constants_from_proof(OSCILLATOR, SCHEDULE)
    detectable = certify_detectability(OSCILLATOR, 0.1)
    doors = [
        lambda: read_certificate(path, other),
        lambda: robustness(other, certificate),
        lambda: four_horizons(other, SCHEDULE, certificate),
        lambda: four_horizons(other, SCHEDULE, proof_constants=proof),
        lambda: certify_from_proof(other, SCHEDULE, detectability=detectable),
        lambda: MovingHorizonEstimator(other, certificate),
        lambda: validate(other, SCHEDULE, certificate, runs=1),
    ]
    for door in doors:
        with pytest.raises(SamplingDesignError, match=words):
            door()
    assert not other.same_dynamics(OSCILLATOR)


@pytest.mark.long
def test_names_inputs_scales_and_source_do_not_enter():
    driven = Plant(OSCILLATOR.A, OSCILLATOR.C, B=[[0.0], [1.0]], time_unit="h", name="driven", states=["x", "v"])
    assert driven.same_dynamics(OSCILLATOR)
    assert first_difference(driven, OSCILLATOR) == ""
    assert robustness(driven, certify(OSCILLATOR, SCHEDULE, eta=0.4, P2=np.eye(2)), longest=2).jittered is not None
