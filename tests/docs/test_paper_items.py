"""Every numbered item of the paper and every correction has a theory entry, a function or a reason, and a test."""

import ast
import builtins
import importlib
import re
import symtable
import tomllib
from functools import cache
from pathlib import Path

import sampling_design
from tests.front_door import public

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
ITEMS = tomllib.loads((DOCS / "paper_items.toml").read_text())["item"]
NUMBERED = {
    *(f"def-{n}" for n in (1, 2, 3, 6, 11)),
    *(f"ass-{n}" for n in (4, 7)),
    *(f"thm-{n}" for n in (5, 9, 10, 14, 16, 17)),
    *(f"rem-{n}" for n in (8, 13, 15)),
    "lemma-12",
    *(f"eq-{n}" for n in range(1, 30)),
    *(f"eq-A{n}" for n in range(1, 10)),
    "appendix-proof",
    "appendix-equivalence",
    "section-6",
    *(f"E{n}" for n in range(1, 38)),
}
CELL = r"```\{code-cell\} python\n(.*?)```"
KEYS = {"id", "kind", "label", "title", "theory", "functions", "no_function", "tests", "printed", "no_test"}


@cache
def anchors() -> set[str]:
    """All targets `(name)=` of the pages that people wrote."""
    pages = [p for p in DOCS.rglob("*.md") if not {"_build", "made"} & set(p.relative_to(DOCS).parts)]
    return {name for page in pages for name in re.findall(r"^\(([\w-]+)\)=$", page.read_text(), re.MULTILINE)}


@cache
def functions_in(path: str) -> set[str]:
    return {node.name for node in ast.parse((ROOT / path).read_text()).body if isinstance(node, ast.FunctionDef)}


def missing(scope: symtable.SymbolTable) -> set[str]:
    """Names that code asks for from outside its functions."""
    own = {s.get_name() for s in scope.get_symbols() if s.is_global() or scope.get_type() == "module"}
    return own.union(*(missing(child) for child in scope.get_children()))


def opened(name: str) -> object:
    """A name of the front door, or a dotted one below the package."""
    if "." not in name:
        return public()[name]
    module, last = name.rsplit(".", 1)
    return getattr(importlib.import_module(f"sampling_design.{module}"), last)


def test_every_numbered_item_and_every_correction_is_listed_once():
    names = [item["id"] for item in ITEMS]
    assert len(names) == len(set(names))
    assert sorted(NUMBERED - set(names)) == []


def test_every_entry_has_its_theory():
    for item in ITEMS:
        assert set(item) <= KEYS, item["id"]
        assert item["theory"] in anchors(), f"no page has ({item['theory']})="


def test_every_entry_has_functions_or_says_why_not():
    for item in ITEMS:
        assert bool(item.get("functions")) != bool(item.get("no_function")), item["id"]
        for name in item.get("functions", ()):
            assert callable(opened(name)), (item["id"], name)


def test_every_entry_has_tests_or_says_why_not():
    for item in ITEMS:
        named = [*item.get("tests", ()), *item.get("printed", ())]
        assert named or item.get("no_test"), item["id"]
        for name in named:
            path, function = name.split("::")
            assert function in functions_in(path), f"{path} has no {function}"


def test_a_correction_has_a_test_of_the_printed_formula_or_there_is_none_to_evaluate():
    for item in [item for item in ITEMS if item["kind"] == "erratum"]:
        assert item["theory"] == f"errata-{item['id'].lower()}"
        assert bool(item.get("printed")) != bool(item.get("no_test")), item["id"]


def test_few_corrections_are_left_to_reasons():
    """Only unstated assumptions, notation, and a printed statement that is right cannot be put in and shown to fail."""
    assert [i["id"] for i in ITEMS if i["kind"] == "erratum" and i.get("no_test")] == ["E34", "E35", "E36"]


def test_every_item_is_worked_out_in_ten_lines():
    """The build executes them; one that needed more would no longer be what a reader types."""
    text = (DOCS / "paper.md").read_text()
    sections = dict(re.findall(r"^### (.+)\n((?:(?!^#).*\n)*)", text, re.MULTILINE))
    cells = [cell.strip().splitlines() for cell in re.findall(CELL, text, re.DOTALL)]
    assert max(len([line for line in cell if line.strip()]) for cell in cells) <= 10
    assert all("```{code-cell}" in body for body in sections.values())
    worked = set()
    for heading in sections:
        name = re.sub(r"[Ee]quations? ", "", heading.split(":")[0])
        ends = [int(n) for n in re.findall(r"\((?:A\.)?(\d+)\)", name)] if " to " in name else [1, 0]
        letter = "A." if "(A." in name else ""
        worked |= {*re.split(", | and ", name), *(f"({letter}{n})" for n in range(ends[0], ends[1] + 1))}
    assert sorted({item["label"] for item in ITEMS if item["kind"] != "erratum"} - worked) == []


def test_a_chapter_needs_the_head_and_what_stands_above_in_it():
    """As the page says: who copies one cell copies those above it in its chapter, and no other."""
    text = (DOCS / "paper.md").read_text()
    head, *chapters = [re.findall(CELL, part, re.DOTALL) for part in re.split(r"^## ", text, flags=re.MULTILINE)]
    assert len(head) == 3
    for cells in chapters:
        assert cells
        scope = symtable.symtable("\n".join([*head, *cells]), "chapter", "exec")
        made = {s.get_name() for s in scope.get_symbols() if s.is_assigned() or s.is_imported() or s.is_namespace()}
        assert sorted(missing(scope) - made - set(dir(builtins))) == []


def test_every_correction_stands_under_the_item_that_it_mends():
    linked = re.findall(r"\[(E\d+)\]\(#errata-e\d+\)", (DOCS / "paper.md").read_text())
    assert sorted(linked) == sorted(item["id"] for item in ITEMS if item["kind"] == "erratum")


def test_theory_that_docstrings_cite_by_number_has_a_page():
    headings = "\n".join(p.read_text() for p in (DOCS / "theory").glob("*.md"))
    known = set(re.findall(r"^#+ (\d+(?:\.\d+)?) ", headings, re.MULTILINE))
    cited = set()
    for path in (ROOT / "sampling_design").rglob("*.py"):
        for numbers in re.findall(r"[Tt]heory(?: sections?)? ((?:\d+(?:\.\d+)?(?:, | and )?)+)", path.read_text()):
            cited |= {(path.name, n) for n in re.findall(r"\d+(?:\.\d+)?", numbers)}
    assert cited
    assert sorted(pair for pair in cited if pair[1] not in known) == []


def test_pages_name_only_what_the_front_door_has():
    pages = [p for p in DOCS.rglob("*.md") if "_build" not in p.parts and "made" not in p.parts]
    named = {(p.name, n) for p in pages for n in re.findall(r"\{py:obj\}`~?sampling_design\.(\w+)`", p.read_text())}
    assert named
    assert sorted(pair for pair in named if pair[1] not in sampling_design.__all__) == []
