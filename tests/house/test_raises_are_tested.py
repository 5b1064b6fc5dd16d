"""Every `raise` of the package has a test with `match=` that quotes its words."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "sampling_design"
SHORTEST_QUOTE = 8


def words(node: ast.AST) -> list[str]:
    """The fixed pieces of the strings inside a node, in order."""
    return [n.value for n in ast.walk(node) if isinstance(n, ast.Constant) and isinstance(n.value, str)]


def raises():
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                name = getattr(node.exc.func, "id", getattr(node.exc.func, "attr", ""))
                if name not in {"NotImplementedError", "AttributeError", "Exit"} and words(node.exc):
                    yield f"{path.relative_to(ROOT)}:{node.lineno}", [w for w in words(node.exc) if len(w) > 2]


def quotes() -> list[str]:
    """Every `match=` pattern of the tests, and every string of a list of cases in a file that uses `match=`."""
    found: list[str] = []
    for path in sorted((ROOT / "tests").rglob("*.py")):
        tree = ast.parse(path.read_text())
        patterns = [k for n in ast.walk(tree) if isinstance(n, ast.Call) for k in n.keywords if k.arg == "match"]
        for keyword in patterns:
            found += words(keyword.value)
        if any(not words(k.value) for k in patterns):
            found += words(tree)
    return [re.sub(r"\\(.)", r"\1", q) for q in found]


QUOTES = quotes()


def is_quoted(pieces: list[str]) -> bool:
    for quote in QUOTES:
        for part in re.split(r"\.\*|\.\+|\[.*?\]|\(|\)|\||\^|\$", quote):
            text = part.strip()
            if len(text) >= SHORTEST_QUOTE and any(
                text in piece or (len(piece) >= 12 and piece.strip() in text) for piece in pieces
            ):
                return True
    return False


@pytest.mark.parametrize(("place", "pieces"), list(raises()), ids=lambda v: v if isinstance(v, str) else "")
def test_every_raise_is_quoted_by_a_test(place, pieces):
    assert is_quoted(pieces), f"{place} is raised by no test with match=: {pieces}"
