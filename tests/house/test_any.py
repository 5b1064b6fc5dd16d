"""`Any` switches the type checker off, and `isinstance` asks what a type should say: their numbers only go down."""

import ast
from collections import Counter
from collections.abc import Iterable

import pytest

from tests.house.sources import PACKAGE, SOURCES, nodes, parsed

pytestmark = pytest.mark.long  # a lint, which the style step of .ci/run runs

CEILING = 62
"""How often `Any` stands in code today. Lower it whenever a room needs fewer; never raise it."""
TREES = 75
"""How often `Tree` does, the one name for a table of plain data whose values the checker does not know."""
KINDS = 179
"""How often `isinstance` is called: kinds of plain data have a predicate each (`checkers/strict.py`)."""


def uses(inside: Iterable[ast.AST]) -> Counter[str]:
    """How often each name stands in the code of a file; its import, comments and docstrings do not count."""
    return Counter(node.id for node in inside if isinstance(node, ast.Name))


def test_any_is_counted_where_it_stands():
    code = 'from typing import Any\n"Any"\ndef f(a: Any, b: dict[str, Any]) -> Any: return a  # Any'
    assert uses(ast.walk(ast.parse(code)))["Any"] == 3


def test_the_number_of_any_only_goes_down():
    ceilings = {"Any": CEILING, "Tree": TREES, "isinstance": KINDS}
    rooms = {name: Counter() for name in ceilings}
    for path in SOURCES:
        used = uses(nodes(path))
        for name, found in rooms.items():
            found[path.relative_to(PACKAGE).parts[0]] += used[name]
    assert CEILING + TREES < 150
    for name, ceiling in ceilings.items():
        told = ", ".join(f"{room} {count}" for room, count in rooms[name].most_common() if count)
        assert rooms[name].total() <= ceiling, f"{rooms[name].total()} uses of `{name}`: {told}"


def test_nothing_else_is_any_by_another_name():
    found = {}
    for path in SOURCES:
        for node in parsed(path).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                target = node.targets[0] if isinstance(node, ast.Assign) else node.target
                value = ast.unparse(node.value)
                if isinstance(target, ast.Name) and value in ("Any", "dict[str, Any]"):
                    found[target.id] = path.name
    # a double or a Fraction; a table; what changes in a problem
    assert set(found) == {"Number", "Tree", "Change"}, found
