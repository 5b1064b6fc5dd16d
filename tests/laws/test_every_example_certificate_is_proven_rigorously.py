"""Law: every certificate of an example plant, script or command is proven in ball arithmetic.

Those of the scripts are judged where these are run, those of pages and notebooks by the documentation's build
(`docs/proven_pages.py`), those of all other tests by `tests/rigour.py`.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, certify, read_plant, split_modes, write_schedule
from sampling_design.observability.count.default_window import default_window
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


MAKING = {
    "certify": ["certify examples/plants/oscillator.toml --gap-range 0.5 1.5 -o out"],
    "estimate": ["estimate examples/plants/satellite.toml examples/data/satellite.csv -o out"],
    "validate": ["validate examples/plants/satellite.toml out/schedule.csv -o out"],
    "survive": [
        "design examples/plants/oscillator.toml examples/requirements/oscillator.toml -o out",
        "certify examples/plants/oscillator.toml out/schedule.csv -o out",
        "survive examples/plants/oscillator.toml out/certificate.json -o out",
    ],
}
"""Commands that make certificates, on the example plants; those of the help are run by `tests/cli/test_help.py`."""


@pytest.mark.long
@pytest.mark.parametrize("name", MAKING)
def test_commands_make_proven_certificates(name, monkeypatch, tmp_path, capsys):
    from sampling_design.cli import main

    monkeypatch.setenv(kept_certificates.FOLDER, str(tmp_path / "made"))
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    orbit = PeriodicSchedule(np.full(12, 5554 / 12), first=0.0, time_unit="s")
    (tmp_path / "out").mkdir()
    write_schedule(orbit, "out/schedule.csv")
    for command in MAKING[name]:
        monkeypatch.setattr(sys, "argv", ["sampling-design", *command.split()])
        with pytest.raises(SystemExit) as stop:
            main()
        assert not stop.value.code, capsys.readouterr().err
    kept_certificates.check_proven(tmp_path / "made", 1)
