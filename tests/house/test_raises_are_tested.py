"""Every `raise` of the package has a test with `match=` that quotes its words, and a whole run raises it."""

import ast
import builtins
import re
from functools import cache
from types import SimpleNamespace

import pytest

from tests import raised
from tests.house.sources import PACKAGE, ROOT, SOURCES, nodes, parsed

SHORTEST_QUOTE = 8


def words(node: ast.AST) -> list[str]:
    """The fixed pieces of the strings inside a node, in order."""
    return [n.value for n in ast.walk(node) if isinstance(n, ast.Constant) and isinstance(n.value, str)]


def raises():
    for path in SOURCES:
        for node in nodes(path):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                name = getattr(node.exc.func, "id", getattr(node.exc.func, "attr", ""))
                if name not in {"NotImplementedError", "AttributeError", "Exit"} and words(node.exc):
                    yield f"{path.relative_to(ROOT)}:{node.lineno}", [w for w in words(node.exc) if len(w) > 2]


@cache
def quotes() -> list[str]:
    """Fixed words of every `match=` of the tests, and of every string in a file whose `match=` is given by cases."""
    found: list[str] = []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        patterns = [k for n in nodes(path) if isinstance(n, ast.Call) for k in n.keywords if k.arg == "match"]
        for keyword in patterns:
            found += words(keyword.value)
        if any(not words(k.value) for k in patterns):
            found += words(parsed(path))
    fixed = [re.split(r"\.\*|\.\+|\[.*?\]|\(|\)|\||\^|\$", re.sub(r"\\(.)", r"\1", q)) for q in found]
    return sorted({part.strip() for parts in fixed for part in parts if len(part.strip()) >= SHORTEST_QUOTE})


def is_quoted(pieces: list[str]) -> bool:
    return any(text in piece or (len(piece) >= 12 and piece.strip() in text) for text in quotes() for piece in pieces)


@pytest.mark.long  # a lint, as others of this folder
def test_every_raise_is_quoted_by_a_test():
    found = list(raises())
    assert len(found) > 600
    assert [place for place, pieces in found if not is_quoted(pieces)] == []


@pytest.mark.long  # a lint, as others of this folder
def test_every_exception_of_the_house_is_watched():
    kinds = {node.name: (node, path) for path in SOURCES for node in nodes(path) if isinstance(node, ast.ClassDef)}
    errors = {name for name, kind in vars(builtins).items() if isinstance(kind, type) and issubclass(kind, Exception)}
    errors -= {name for name in errors if issubclass(getattr(builtins, name), Warning)}
    errors.add("KeyboardInterrupt")
    roots, known = {}, set(errors)
    for _ in kinds:
        for name, (node, path) in kinds.items():
            bases = {ast.unparse(base).split(".")[-1] for base in node.bases}
            if name not in known and bases & known:
                known.add(name)
                if not bases & (known - errors):
                    roots[".".join(path.relative_to(PACKAGE).with_suffix("").parts)] = name
    assert roots == raised.ROOTS


TELLING = """
class Wrong(Exception):
    pass

def refused(word):
    return Wrong(
        word
    )

def check(number):
    if number < 0:
        raise Wrong(
            "below zero"
        )
    if number == 0:
        raise refused("zero")
    if number > 9:
        raise Wrong
    try:
        return 1 // (number - 5)
    except ZeroDivisionError:
        raise
"""


@pytest.fixture
def told(tmp_path, monkeypatch):
    path = tmp_path / "telling.py"
    path.write_text(TELLING)
    names = {"__name__": "telling"}
    exec(compile(TELLING, str(path), "exec"), names)
    monkeypatch.setattr(raised, "SEEN", set())
    names["Wrong"].__new__ = raised._noting(names["Wrong"])
    return path, names


@pytest.mark.parametrize(("number", "left"), [(-1, [16, 18]), (0, [12, 18]), (10, [12, 16]), (1, [12, 16, 18])])
def test_a_raise_counts_where_it_was_raised(number, left, told):
    path, names = told
    if number == 1:
        names["check"](1)
    else:
        with pytest.raises(names["Wrong"]):
            names["check"](number)
    found = raised.unraised([path], raised.SEEN)
    assert [int(place.split(":")[1]) for place in found] == left


@pytest.mark.parametrize("whole", [True, False])
def test_a_whole_run_that_leaves_a_raise_fails(whole, told, monkeypatch):
    path, _ = told
    monkeypatch.setattr(raised, "PACKAGE", path.parent)
    monkeypatch.setattr(raised, "MOST_UNRAISED", 0)
    plugin = raised.Raised(whole)
    worker = SimpleNamespace(workeroutput={"raised": [[str(path), 12], [str(path), 16]]})
    plugin.pytest_testnodedown(worker)
    session = SimpleNamespace(config=SimpleNamespace(), exitstatus=0)
    plugin.pytest_sessionfinish(session)
    assert session.exitstatus == int(whole)
    plugin.pytest_testnodedown(SimpleNamespace(workeroutput={"raised": [[str(path), 18]]}))
    session.exitstatus = 0
    plugin.pytest_sessionfinish(session)
    assert session.exitstatus == 0
    handed = SimpleNamespace(config=SimpleNamespace(workeroutput={}))
    plugin.pytest_sessionfinish(handed)
    assert len(handed.config.workeroutput["raised"]) == 3
