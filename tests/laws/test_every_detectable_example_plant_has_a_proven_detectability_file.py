"""Law: every example plant has a detectability certificate that is written, read, verified and proven in balls."""

from pathlib import Path

import pytest

from sampling_design import read_certificate, read_plant
from sampling_design.certificates.detectability.best_rate import certify_detectability, detectability_from_proof
from tests.oracles.dissipation import holds

PLANTS = sorted((Path(__file__).parents[2] / "examples" / "plants").glob("*.toml"))


@pytest.mark.parametrize("path", PLANTS, ids=lambda path: path.stem)
@pytest.mark.parametrize("make", [certify_detectability, detectability_from_proof], ids=["riccati", "proof"])
def test_the_file_is_a_theorem_about_its_numbers(path, make, tmp_path):
    plant = read_plant(path)
    found = read_certificate(make(plant).save(tmp_path / "certificate.json"), plant)
    assert found.verify().passed
    assert found.verify(rigorous=True).verdict == "proven"
    assert holds(found.to_dict())
