"""Law: the certificate of every example plant is proven in ball arithmetic, not only in floats."""

from pathlib import Path

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, certify, default_window, read_plant, split_modes

PLANTS = sorted((Path(__file__).parents[2] / "examples" / "plants").glob("*.toml"))
SAMPLES = {"tidal_gauge": 14}


@pytest.mark.parametrize("path", PLANTS, ids=lambda path: path.stem)
def test_the_certificate_is_a_theorem_about_its_numbers(path):
    plant = read_plant(path)
    window = default_window(split_modes(plant)) or 4 / float(np.linalg.norm(plant.A, 2))
    count = SAMPLES.get(path.stem, 6)
    gaps = np.full(count, window / count) * np.linspace(0.8, 1.2, count)
    certificate = certify(plant, PeriodicSchedule(gaps, time_unit=plant.time_unit), eta=1 / window)
    verdict = certificate.verify(rigorous=True)
    assert verdict.passed, verdict.reason
    assert verdict.verdict == "proven"
