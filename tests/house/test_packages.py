"""What is shipped is the package with its types and READMEs, and nothing else."""

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
