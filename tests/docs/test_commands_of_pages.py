"""Every command line that a page shows is one that the program takes: no flag of yesterday, no word too many."""

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
