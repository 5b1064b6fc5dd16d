"""Every `raise` of the package has a test with `match=` that quotes its words."""

import ast
import re
from functools import cache

from tests.house.sources import ROOT, SOURCES, nodes, parsed

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


def test_every_raise_is_quoted_by_a_test():
    found = list(raises())
    assert len(found) > 600
    assert [place for place, pieces in found if not is_quoted(pieces)] == []
