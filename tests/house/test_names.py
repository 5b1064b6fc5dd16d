"""A name means one thing in the house; the checkers, copied out of it as they stand, are a house of their own."""

import ast
import builtins
import re
from collections import defaultdict
from pathlib import Path

import pytest

from tests.house.sources import PACKAGE, SOURCES, nodes, parsed

pytestmark = pytest.mark.long  # a lint, which the style step of .ci/run runs


def places() -> dict[tuple[bool, str], list[str]]:
    """Where each class name is defined, apart for the checkers."""
    found = defaultdict(list)
    for path in SOURCES:
        here = path.relative_to(PACKAGE)
        for node in nodes(path):
            if isinstance(node, ast.ClassDef):
                found[here.parts[0] == "checkers", node.name].append(f"{here}:{node.lineno}")
    return found


def test_no_two_classes_share_a_name():
    assert {name: where for (_, name), where in places().items() if len(where) > 1} == {}


def aliases() -> dict[tuple[bool, str], dict[str, list[str]]]:
    """What each name of a type stands for, and where, apart for the checkers."""
    found = defaultdict(lambda: defaultdict(list))
    for path in SOURCES:
        here = path.relative_to(PACKAGE)
        for node in parsed(path).body:
            target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
            if isinstance(target, ast.Name) and re.fullmatch(r"[A-Z]\w*[a-z]\w*", target.id) and node.value:
                if "typer." in ast.unparse(node.value):
                    continue  # an option or argument of one command, whose help is its own
                found[here.parts[0] == "checkers", target.id][ast.unparse(node.value)].append(str(here))
    return found


def test_no_name_stands_for_two_types():
    several = {name: dict(meanings) for (_, name), meanings in aliases().items() if len(meanings) > 1}
    assert several == {}
    assert set(aliases()) & set(places()) == set()


def root(name: str) -> str:
    """A word without the ending that alone would tell it from another."""
    return re.sub(r"(ing|ed|es|s|e)$", "", name)


def test_no_two_files_of_a_room_differ_by_an_ending():
    """bound and bounds, posed and posing: a stranger mistakes one for the other."""
    for room in [path for path in PACKAGE.iterdir() if path.is_dir()]:
        found = defaultdict(list)
        for path in [*room.rglob("*.py"), *(inner for inner in room.rglob("*") if inner.is_dir())]:
            if not path.stem.startswith("__"):
                found[root(path.stem)].append(str(path.relative_to(room)))
        inside = {name: where for name, where in found.items() if len({Path(path).stem for path in where}) > 1}
        assert inside == {}, room.name


FORMER = r"\b(laps?|steady_lap|gap_graph|survival|carried_weight)\b"
"""Words that the field has others for."""


def test_words_that_the_field_has_others_for_are_gone():
    root = PACKAGE.parent
    texts = [p for folder in ("sampling_design", "tests", "examples", "docs") for p in (root / folder).rglob("*")]
    told = {"test_names.py", "test_front_door.py", "test_door.py"}
    for path in [*texts, root / "README.md"]:
        if path.suffix in (".py", ".md", ".ipynb", ".toml") and path.name not in told and "_build" not in path.parts:
            assert not re.search(FORMER, path.read_text()), path.relative_to(root)


LEFT = {"held": 1}
"""Functions, methods and classes that still have a name on the left of the table of words: none is added."""


def former_words() -> set[str]:
    """The left side of the table of words."""
    table = (PACKAGE.parent / "docs/conventions.md").read_text().partition("## Words")[2].partition("## Evidence")[0]
    sides = [row.split("|")[1] for row in table.splitlines() if row.startswith("| ") and not row.startswith("| not |")]
    return {word.strip() for side in sides for word in side.split(",") if word.strip().isidentifier()}


def test_what_is_defined_takes_the_words_of_the_table():
    words, found = former_words(), defaultdict(int)
    assert {"told", "faint", "attack", "shadow"} <= words  # the table was read
    for path in SOURCES:
        for node in nodes(path):
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)) and (name := node.name.strip("_").lower()) in words:
                found[name] += 1
    assert {word: count for word, count in found.items() if count > LEFT.get(word, 0)} == {}


GONE = ("told", "lacking", "wishes", "heard", "seen", "unseen", "shown", "faint", "atoms", "motion", "due", "flight")
PARTS = dict.fromkeys(GONE, 0)
"""How many functions, classes, fields and attributes still have such a word as a part of their name: only fewer."""


def test_names_are_not_made_of_words_of_the_table():
    found = defaultdict(set)
    for path in SOURCES:
        if "checkers" in path.parts:
            continue  # whose records have the keys of files
        for node in nodes(path):
            match node:
                case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.AnnAssign(target=ast.Name(id=name)):
                    pass
                case ast.Attribute(attr=name, ctx=ast.Store()):
                    pass
                case _:
                    continue
            for part in re.findall(r"[a-z]+|[A-Z][a-z]*", name):
                if part.lower() in PARTS:
                    found[part.lower()].add((path.stem, name))
    assert {word: sorted(names) for word, names in found.items() if len(names) > PARTS[word]} == {}


FOREIGN = {"Generator", "SeedSequence"}
"""Classes of numpy that docstrings name with their module."""
NAMED = r"`([A-Z]\w*[a-z]\w*)(?=[`(.])|(?:^[\w, ]+ : | of | or )([A-Z][a-z]\w*)(?=$| or |,)"


def test_classes_that_docstrings_name_exist():
    """`Below(0.5)` for what is called BelowDetection: a name that was changed stays behind where nobody runs it."""
    known, named = set(FOREIGN) | set(dir(builtins)), defaultdict(set)
    for path in SOURCES:
        for node in nodes(path):
            if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
                known.add(node.name)
            elif isinstance(node, ast.Name):
                known.add(node.id)
            elif isinstance(node, ast.alias):
                known.add(node.name.rpartition(".")[2])
            if isinstance(node, (ast.ClassDef, ast.FunctionDef, ast.Module)) and (text := ast.get_docstring(node)):
                lines = [line for line in text.splitlines() if re.match(r"[\w, ]+ : ", line) or "`" in line]
                found = re.findall(NAMED, "\n".join(lines), re.M)
                named[f"{path.name}:{getattr(node, 'name', '')}"] |= {one or other for one, other in found}
    assert {where: names - known for where, names in named.items() if names - known} == {}
    assert sum(map(len, named.values())) > 400  # the docstrings were read
