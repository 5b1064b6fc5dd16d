"""The example files of docs/formats.md are read by the functions that they explain."""

import re
from pathlib import Path

import numpy as np

from sampling_design import Plant, read_certificate, read_measurements, read_plant, read_requirement, read_schedule
from sampling_design.plants.plant import Signals

PAGE = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()


def example(heading: str, language: str) -> str:
    section = PAGE.split(f"## {heading}", 1)[1].split("\n## ", 1)[0]
    return re.search(rf"```{language}\n(.*?)```", section, re.DOTALL).group(1)


def test_the_plant(tmp_path):
    path = tmp_path / "plant.toml"
    path.write_text(example("Plant", "toml"))
    plant = read_plant(path)
    assert (plant.name, plant.time_unit, plant.states.names) == ("oscillator", "s", ("x", "v"))
    np.testing.assert_array_equal(plant.A, [[0.0, 1.0], [-1.0, 0.0]])
    np.testing.assert_array_equal(plant.G, np.eye(2))


def test_the_requirement(tmp_path):
    path = tmp_path / "requirement.toml"
    path.write_text(example("Requirement", "toml"))
    requirement = read_requirement(path)
    assert requirement.window == 5554.0
    np.testing.assert_array_equal(requirement.forbidden, [[0.0, 600.0]])
    np.testing.assert_array_equal(requirement.fixed, [700.0])
    assert requirement.sensors["radial"].price == 2.0


def test_the_schedule(tmp_path):
    path = tmp_path / "schedule.csv"
    path.write_text(example("Schedule", "text"))
    schedule = read_schedule(path)
    assert (schedule.period, schedule.time_unit) == (168.0, "h")
    np.testing.assert_array_equal(schedule.times, [8.5, 57.25])
    np.testing.assert_array_equal(schedule.outputs, [[True, True], [False, True]])


def test_the_measurements(tmp_path):
    path = tmp_path / "measurements.csv"
    path.write_text(example("Measurements", "text"))
    plant = Plant([[-0.1]], [[1.0]], B=[[1.0]], time_unit="h", outputs=Signals(["blood"]), inputs=Signals(["dose"]))
    found = read_measurements(path, plant)
    np.testing.assert_allclose(np.diff(found.times), [10.75])  # 08:30 to 19:15, both in UTC
    np.testing.assert_array_equal(np.isnan(found.y[:, 0]), [False, True])
    np.testing.assert_array_equal(found.u[:, 0], [0.0, 50.0])


def test_the_detectability_certificate(tmp_path):
    path = tmp_path / "certificate.json"
    path.write_text(example("Certificate (JSON)", "json"))
    found = read_certificate(path, plant=Plant([[1.0]], [[1.0]]))
    assert (found.eta, found.c_w, found.c_y, found.margin, found.method) == (1.0, 1.0, 4.5, 0.01, "given")
    assert found.verify().passed
