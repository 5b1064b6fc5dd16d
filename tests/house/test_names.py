"""A class name means one thing in the house; the checkers, copied out of it as they stand, are a house of their own."""

import ast
from collections import defaultdict
from pathlib import Path

PACKAGE = Path(__file__).parents[2] / "sampling_design"


def places() -> dict[tuple[bool, str], list[str]]:
    """Where each class name is defined, apart for the checkers."""
    found = defaultdict(list)
    for path in sorted(PACKAGE.rglob("*.py")):
        here = path.relative_to(PACKAGE)
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                found[here.parts[0] == "checkers", node.name].append(f"{here}:{node.lineno}")
    return found


def test_no_two_classes_share_a_name():
    assert {name: where for (_, name), where in places().items() if len(where) > 1} == {}
