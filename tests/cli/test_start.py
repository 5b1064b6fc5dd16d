"""The command line starts at once: a command and what it needs are imported when it is called, not before."""

import inspect
import os
import subprocess
import sys
from pathlib import Path

import pytest

from sampling_design.cli import app

COMMAND_LINE = """
import sys
sys.argv[0] = "sampling-design"
from sampling_design.cli import main
try:
    main()
finally:
    loaded = {n if n.startswith("sampling_design") else n.partition(".")[0] for n in sys.modules}
    sys.stderr.write("\\nloaded " + " ".join(sorted(loaded)))
"""
STANDARD = {*sys.stdlib_module_names, "__mp_main__", "sitecustomize"}
ENDING = {
    "sampling_design",
    "sampling_design.records",
    "sampling_design.records.lazy",
    *(f"sampling_design.{n}" for n in ("cli", "cli.exit_codes", "cli.version")),
}
LISTED = {*ENDING, "sampling_design.cli.app", "typer", "shellingham", "click", "annotated_doc", "typing_extensions"}
PARSING = {"pydantic", "pydantic_core", "annotated_types", "typing_inspection"}
"""What newer versions of typer read flags with."""
PLANT = Path(__file__).parents[2] / "examples" / "plants" / "oscillator.toml"
OTHER_ROOMS = (
    *(f"sampling_design.{room}." for room in ("accuracy", "design", "estimators", "planning", "validation")),
    *("sampling_design.plotting.", "matplotlib", "cvxpy", "clarabel", "control", "pandas"),
)
"""What the command `info` does without."""
COMPLETING = {"_SAMPLING_DESIGN_COMPLETE": "complete_bash", "COMP_WORDS": "sampling-design ce", "COMP_CWORD": "1"}


def loaded_by(*arguments, **environment):
    """What a call of the command line imports beside the standard library."""
    done = subprocess.run(
        [sys.executable, "-I", "-c", f"import sys; sys.path[:0] = {sys.path!r}\n{COMMAND_LINE}", *arguments],
        capture_output=True, text=True, check=False, env={**os.environ, **environment},
    )  # fmt: skip
    told = done.stderr.rpartition("\nloaded ")[2].split()
    return {name for name in told if name not in STANDARD and not name.startswith(("_", "encodings"))}, done.stdout


def test_the_version_needs_nothing():
    found, told = loaded_by("--version")
    assert told.startswith("sampling-design ")
    assert found <= ENDING


@pytest.mark.parametrize(
    ("arguments", "environment", "more"),
    [
        (["--help"], {}, set()),
        (
            [],
            {"_SAMPLING_DESIGN_COMPLETE": "complete_bash", "COMP_WORDS": "sampling-design ce", "COMP_CWORD": "1"},
            PARSING,
        ),
    ],
    ids=["help", "completion"],
)
def test_what_the_list_of_commands_may_import(arguments, environment, more):
    found, told = loaded_by(*arguments, **environment)
    assert "certify" in told
    assert found <= LISTED | more


def test_a_plant_is_shown_without_what_designs_proves_and_draws():
    found, told = loaded_by("info", str(PLANT))
    assert "zero count" in told
    other = [name for name in found if name.startswith(OTHER_ROOMS)]
    assert not other


@pytest.mark.parametrize("name", app.COMMANDS)
def test_the_line_of_a_command_is_the_first_sentence_of_its_docstring(name):
    paragraph = (inspect.getdoc(app.function_of(name)) or "").partition("\n\n")[0]
    assert " ".join(paragraph.split()).startswith(app.lines()[name])
    assert app.lines()[name].endswith(".")


def test_help_lists_every_command_once_under_its_question(shell):
    told = shell("--help").out
    places = [told.index(f"{panel}:\n") for panel in app.PANELS]
    assert places == sorted(places)
    listed = [line.split()[0] for line in told.splitlines() if line[:2] == "  " and line[2:3].islower()]
    assert [name for name in listed if name in app.COMMANDS] == list(app.COMMANDS)
