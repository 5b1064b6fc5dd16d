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


SCRIPTS = [
    path for path in sorted((Path(__file__).parents[2] / "examples").glob("0*.py")) if "sd.certify(" in path.read_text()
]


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.stem)
def test_every_certificate_that_a_lecture_makes_is_one_too(path, monkeypatch, capsys):
    import runpy

    import sampling_design as sd

    made, certify_plainly = [], sd.certify

    def kept(*arguments, **options):
        made.append(certify_plainly(*arguments, **options))
        return made[-1]

    monkeypatch.setattr(sd, "certify", kept)
    runpy.run_path(str(path))["main"]()
    assert made
    for certificate in made:
        assert certificate.verify(rigorous=True).verdict == "proven"
