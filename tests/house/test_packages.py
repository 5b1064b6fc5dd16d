"""What is shipped is the package with its types and READMEs, and nothing else."""

import tomllib

import pytest

from tests.house.packages import PACKAGE, faults, wanted

ABOUT = {"sampling_design-0.1.0.dist-info/METADATA", "sampling_design-0.1.0.dist-info/licenses/LICENSE"}


def test_a_whole_wheel_has_no_fault():
    assert faults(wanted(PACKAGE) | ABOUT, PACKAGE) == []


@pytest.mark.parametrize("name", ["py.typed", "__init__.pyi", "checkers/check.py", "plants/README.md"])
def test_a_wheel_that_lacks_a_file_is_found_out(name):
    assert faults(wanted(PACKAGE) - {f"sampling_design/{name}"}, PACKAGE) == [f"lacks sampling_design/{name}"]


def test_a_wheel_with_tests_is_found_out():
    names = {"tests/test_any.py", "sampling_design/plants/__pycache__/plant.cpython-311.pyc"}
    assert faults(wanted(PACKAGE) | names, PACKAGE) == [f"holds {name}" for name in sorted(names)]


def test_ci_builds_and_judges_both():
    lines = (PACKAGE.parent / ".ci" / "run").read_text()
    assert "-m build -q" in lines
    assert "tests/house/packages.py" in lines


def test_the_oldest_versions_are_those_that_are_promised():
    project = tomllib.loads((PACKAGE.parent / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    promised = [
        *project["dependencies"],
        *(r for name in ("nonlinear", "rigorous", "distributed", "dataframes", "datasets") for r in extras[name]),
    ]
    lines = [line for line in (PACKAGE.parent / "tests" / "oldest.txt").read_text().splitlines() if line[0] != "#"]
    oldest = dict(line.split("==") for line in lines)
    for requirement in promised:
        name, version = requirement.split(">=")
        assert f"{oldest.pop(name)}.".startswith(f"{version}."), name
    assert oldest == {}
