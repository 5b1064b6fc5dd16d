"""What a page shows is there: commands that the program takes, names that the code has, files of the tree."""

import code
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


def refused_at_the_prompt(cell):
    """Lines at which an interpreter that reads line by line, as Python's own up to 3.12 does, refuses a pasted cell."""
    refused, typed = [], []
    for line in [*re.sub(r"\A(---\n.*?---\n|(:.*\n)+|%.*\n)+", "", cell, flags=re.DOTALL).splitlines(), ""]:
        typed.append(line)
        try:
            if code.compile_command("\n".join(typed)) is not None:
                typed = []
        except SyntaxError:
            refused, typed = [*refused, line], []
    return refused


@pytest.mark.filterwarnings("ignore::SyntaxWarning")  # of half a line
def test_what_is_pasted_at_the_prompt_runs():
    """A loop is followed by an empty line; methods of a class stand apart, so that one is for a file or a notebook."""
    pages = [ROOT / "README.md", *(p for p in (ROOT / "docs").rglob("*.md") if not {"made", "_build"} & {*p.parts})]
    cells = {
        (page.name, cell)
        for page in pages
        for cell in re.findall(
            r"^```(?:\{code-cell\} python|python)\n(.*?)^```", page.read_text(), re.DOTALL | re.MULTILINE
        )
        if not re.search(r"^class ", cell, re.MULTILINE)
    }
    assert len(cells) > 150
    assert [(page, line) for page, cell in cells for line in refused_at_the_prompt(cell)] == []
    assert refused_at_the_prompt("for k in (1, 2):\n    print(k)\nprint(3)\n") == ["print(3)"]


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


OURS = {"my_package", "n_times", "states_units"}
"""Names that stand for a reader's own or for a number, or that code puts together of two."""


def lost(text: str, words: set[str]) -> list[str]:
    """Names of code, files and modules in the running text of a page that the tree does not have."""
    text = re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    named = {word for span in re.findall(r"`([^`\n]+)`", text) for word in re.findall(r"[A-Za-z_]\w*", span)}
    compound = {word for word in named if "_" in word.strip("_") or re.match(r"[A-Z][a-z]+[A-Z]", word)}
    files = set(re.findall(r"\b(?:tests|examples|sampling_design)/[\w/.]+\.(?:py|toml|json|txt|csv)\b", text))
    modules = {f"{m.replace('.', '/')}.py" for m in re.findall(r"python -m (tests[\w.]+)", text)}
    gone = {m for m in modules if not (ROOT / m).exists() and not (ROOT / m).with_suffix("").is_dir()}
    return sorted(compound - words - OURS | {name for name in files if not (ROOT / name).exists()} | gone)


@pytest.mark.long
def test_what_a_page_names_is_there():
    tree = [p for room in ("sampling_design", "tests", "examples", "docs") for p in (ROOT / room).rglob("*.py")]
    words = {word for path in tree for word in re.findall(r"\w+", path.read_text())} | {path.stem for path in tree}
    words |= {path.stem for path in (ROOT / "examples").rglob("*.*")}
    found = {page.name: gone for page in PAGES if (gone := lost(page.read_text(), words))}
    assert found == {}


def test_a_name_of_yesterday_is_found():
    page = "`design_lost` and `LostRecord` (`tests/nowhere/test_gone.py`, `python -m tests.benchmarks.gone`), `eta`"
    assert lost(page, {"eta", "tests", "test_gone"}) == [
        "LostRecord", "design_lost", "tests/benchmarks/gone.py", "tests/nowhere/test_gone.py",
    ]  # fmt: skip
