"""Every command line that a page shows is one that the program takes: no flag of yesterday, no word too many."""

import importlib
import re
import shlex
from pathlib import Path

import pytest

from sampling_design.cli.app import loaded

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "theory").glob("*.md"))]


def command_lines(text):
    """The lines of the shell blocks that call the program, without what stands around them."""
    for block in re.findall(r"```sh\n(.*?)```", text, re.DOTALL):
        for line in block.replace("\\\n", " ").splitlines():
            for part in line.split("&&"):
                words = shlex.split(part, comments=True)
                if words and words[0].rpartition("/")[2] == "sampling-design":
                    yield words[1:]


def taken(words):
    """Whether the program would take these words; nothing is run."""
    if words[:1] == ["--version"]:
        return True
    command = loaded(words[0])
    return command.make_context(words[0], list(words[1:]), resilient_parsing=False) is not None


@pytest.mark.parametrize("page", [p for p in PAGES if list(command_lines(p.read_text()))], ids=lambda p: p.name)
def test_the_program_takes_every_command_of_a_page(page):
    for words in command_lines(page.read_text()):
        assert taken(words), words


def test_a_wrong_flag_would_be_found():
    assert taken(["info", "plant.toml"])
    with pytest.raises(Exception, match="--nosuch"):
        taken(["info", "plant.toml", "--nosuch"])


def test_pages_with_commands_are_found():
    assert sum(len(list(command_lines(page.read_text()))) for page in PAGES) > 20


def imported(text: str) -> set[tuple[str, str]]:
    """Every (module, name) of the package that a page or a notebook imports."""
    lines = text.replace("\\n", "\n")
    found = re.findall(r"from (sampling_design[\w.]*) import ([\w, ]+)", lines)
    return {(module, name.strip().split(" as ")[0]) for module, names in found for name in names.split(",") if name}


def test_what_a_page_imports_is_there():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "examples").rglob("*.ipynb")]
    pages = [page for page in pages if "made" not in page.parts and "_build" not in page.parts]
    asked = {(page.name, *pair) for page in pages for pair in imported(page.read_text())}
    assert len(asked) > 40
    opened = {pair: hasattr(importlib.import_module(pair[0]), pair[1]) for pair in {pair[1:] for pair in asked}}
    assert sorted(place for place in asked if not opened[place[1:]]) == []
