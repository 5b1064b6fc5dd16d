"""What is shipped is the package with its types and READMEs, and nothing else."""

import importlib.util
import re
import tomllib

import pytest

from tests.benchmarks import installation
from tests.house.packages import PACKAGE, beside, faults, wanted

ROOT = PACKAGE.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
OPTIONAL = ("control", "modelling", "nonlinear", "rigorous", "distributed", "dataframes", "datasets")
PAGE = (ROOT / "docs" / "installation.md").read_text()

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
    extras = PROJECT["optional-dependencies"]
    promised = [
        *PROJECT["dependencies"],
        *(r for name in OPTIONAL for r in extras[name]),
    ]
    lines = [line for line in (PACKAGE.parent / "tests" / "oldest.txt").read_text().splitlines() if line[0] != "#"]
    oldest = dict(line.split("==") for line in lines)
    for requirement in promised:
        name, version = requirement.split(">=")
        assert f"{oldest.pop(name)}.".startswith(f"{version}."), name
    assert oldest == {}


def test_a_source_distribution_has_what_the_readme_names():
    named = re.findall(r"(?:examples|docs|tests)/[\w./]+\.\w+", (ROOT / "README.md").read_text())
    assert len(named) > 5
    assert beside(ROOT) >= {*named, ".ci/run"}


def names(requirements):
    return {installation.plain(each) for each in requirements}


def test_the_table_of_costs_has_each_dependency_and_no_other():
    extras = PROJECT["optional-dependencies"]
    assert set(installation.CORE) == names(PROJECT["dependencies"])
    told = {(extra, name) for name, (extra, *_) in installation.EXTRAS.items()}
    for_users = set(extras) - {"browser", "docs", "test", "dev"}
    assert told == {(extra, name) for extra in for_users for name in names(extras[extra])}
    for name, (_, purpose) in installation.CORE.items():
        assert f"| {name} | {purpose} | " in PAGE
    for name, (extra, _, purpose) in installation.EXTRAS.items():
        assert f"| {name} (`{extra}`) | {purpose} | " in PAGE
    assert len(re.findall(r"^\| .* \| \d+ \| \d\.\d\d \|$", PAGE, re.M)) == len(told) + len(installation.CORE) + 1


def test_the_table_of_extras_is_that_of_the_package():
    rows = re.findall(r"^\| `([^|]*)` \| [^|]* \| [^|]* \|$", PAGE, flags=re.MULTILINE)
    assert [name for row in rows for name in row.split("`, `")] == list(PROJECT["optional-dependencies"])


def test_every_missing_extra_is_one_that_there_is():
    raised = set()
    for path in PACKAGE.rglob("*.py"):
        raised |= set(re.findall(r'MissingExtraError\("([\w-]+)", "(\w+)"\)', path.read_text()))
    assert len(raised) == 8
    for package, extra in raised:
        assert {package, package.removeprefix("python-")} & names(PROJECT["optional-dependencies"][extra])


def test_an_index_shows_no_link_that_leads_nowhere():
    spec = importlib.util.spec_from_file_location("index_page", ROOT / "setup.py")
    setup = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(setup)
    shown = setup.for_an_index((ROOT / "README.md").read_text())
    assert not re.findall(r"\]\((?!https:)", shown)
    assert "three journeys (`docs/journeys.md`)" in shown
    assert setup.for_an_index("![a](b.png)\n\n[c](https://d.org) [e](f.md)") == "[c](https://d.org) e (`f.md`)"


def test_the_citation_names_this_version_and_the_paper():
    import sampling_design

    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {PROJECT['version']}\n" in citation
    assert PROJECT["version"] == sampling_design.__version__
    title = re.search(r"@misc\{krauss2026,\s+title = \{(.*)\}", (ROOT / "docs" / "references.bib").read_text())[1]
    assert f'title: "{title}"' in citation
    released = "(not yet released)" not in (ROOT / "docs" / "changelog.md").read_text()
    assert ("date-released" in citation) == released
