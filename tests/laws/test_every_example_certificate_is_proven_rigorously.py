"""Law: every certificate of an example plant, script or command is proven in ball arithmetic.

Those of the scripts are judged where these are run, those of pages and notebooks by the documentation's build
(`docs/proven_pages.py`), those of all other tests, commands among them, by `tests/rigour.py`.
"""

from pathlib import Path

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, certify, read_plant
from sampling_design.observability.count.zero_count import default_window
from sampling_design.plants.modes import split_modes
from tests import kept_certificates

ROOT = Path(__file__).parents[2]
PLANTS = sorted((ROOT / "examples" / "plants").glob("*.toml"))
SAMPLES = {"tidal_gauge": 14}


@pytest.mark.long
@pytest.mark.parametrize("path", PLANTS, ids=lambda path: path.stem)
def test_the_certificate_is_a_theorem_about_its_numbers(path, monkeypatch, tmp_path):
    monkeypatch.setenv(kept_certificates.FOLDER, str(tmp_path))
    plant = read_plant(path)
    window = default_window(split_modes(plant)) or 4 / float(np.linalg.norm(plant.A, 2))
    count = SAMPLES.get(path.stem, 6)
    gaps = np.full(count, window / count) * np.linspace(0.8, 1.2, count)
    certificate = certify(plant, PeriodicSchedule(gaps, time_unit=plant.time_unit), eta=1 / window)
    (proven,) = kept_certificates.check_proven(tmp_path, 1)
    assert proven == certificate.to_dict()


def test_the_scripts_are_all_that_make_certificates():
    scripts = {path.name for path in (ROOT / "examples").glob("*.py") if "certify" in path.read_text()}
    elsewhere = {"thyroid.py"}  # tests/nonlinear/test_example.py runs it
    assert {name for name in scripts if not name.startswith("0")} == elsewhere
