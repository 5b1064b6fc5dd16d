"""The same lines of code stand once: what is said twice drifts apart.

Texts that describe, imports and the heads of functions and classes are not counted, nor the checkers, which repeat on
purpose what the rest computes by another route.
"""

import ast
import re
from collections import defaultdict
from pathlib import Path

import pytest

from tests.house.sources import PACKAGE, SOURCES, nodes, parsed

pytestmark = pytest.mark.long  # a lint, which the style step of .ci/run runs

MOST = 5
"""Lines of code that may stand in two places; never raise it."""
LEAST = 4
"""Characters of a line that says something: brackets alone do not."""


def heads(path: Path) -> set[int]:
    """Lines of imports, of the heads of functions and classes, and of texts."""
    found: set[int] = set()
    for node in nodes(path):
        if isinstance(node, ast.Import | ast.ImportFrom):
            found |= set(range(node.lineno, node.end_lineno + 1))
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            first = min([node.lineno, *(each.lineno for each in node.decorator_list)])
            found |= set(range(first, node.body[0].lineno))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            found |= set(range(node.lineno, node.end_lineno + 1))
    return found


def spoken(text: str, left_out: set[int]) -> list[tuple[int, str]]:
    """Lines of code that say something, with their numbers."""
    lines = ((k, line.strip()) for k, line in enumerate(text.splitlines(), 1) if k not in left_out)
    return [(k, line) for k, line in lines if len(line) >= LEAST and not line.startswith("#")]


def repeated(sources: dict[str, list[tuple[int, str]]]) -> list[str]:
    """Places at which more than `MOST` lines stand that stand elsewhere too."""
    seen = defaultdict(list)
    for name, lines in sources.items():
        for i in range(len(lines) - MOST):
            seen[tuple(line for _, line in lines[i : i + MOST + 1])].append(f"{name}:{lines[i][0]}")
    return [" and ".join(places) for places in seen.values() if len(places) > 1]


def test_no_six_lines_of_code_stand_twice():
    own = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] != "checkers"]
    sources = {str(path.relative_to(PACKAGE)): spoken(path.read_text(), heads(path)) for path in own}
    assert repeated(sources) == []


def test_a_kind_of_array_is_named_once():
    """`Array` and its like stand in one file, and no other file writes out what they stand for."""
    named = PACKAGE / "records" / "arrays.py"
    kinds = {ast.unparse(node.value) for node in parsed(named).body if isinstance(node, ast.Assign)}
    assert len(kinds) >= 5
    own = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] != "checkers" and path != named]
    texts = {str(path): path.read_text() for path in own}
    assert [(path, kind) for path, text in texts.items() for kind in kinds if kind in text] == []


LISTED = {
    "AccuracyProfile", "EstimateAssumptions", "Contradiction", "DateException", "ErrorBounds", "EstimatorState",
    "GoalDeadline", "HorizonRow", "MeanRows", "OptimalTrajectory", "PlanBound", "Timeline",  # what users get
    "Budget", "CostWeights", "GapFlow", "ModalFlow", "RecordCones", "SpacedRows", "StageSolution",
}  # fmt: skip
"""Inner classes whose docstring lists attributes: users meet them, or no field stands in the class."""


def test_fields_of_inner_records_are_said_once():
    """Beside the field: a list of them in the docstring says every name again, and lags behind."""
    offered = set(re.findall(r"\w+", " ".join(path.read_text() for path in PACKAGE.rglob("__init__.py*"))))
    found = {
        node.name
        for path in SOURCES
        for node in nodes(path)
        if isinstance(node, ast.ClassDef) and node.name not in offered
        if all(ast.unparse(base) == "NamedTuple" for base in node.bases)
        and "Attributes\n" in (ast.get_docstring(node) or "")
    }
    assert found - LISTED == set()
    assert len(found) > 5  # they were read


@pytest.mark.parametrize(("shared", "found"), [(MOST, []), (MOST + 1, ["a:1 and b:2"])])
def test_what_stands_twice_is_found(shared, found):
    lines = [f"x{k} = f({k})" for k in range(shared)]
    sources = {"a": "\n".join([*lines, "a = 1"]), "b": "\n".join(["b = 1", *lines])}
    assert repeated({name: spoken(text, set()) for name, text in sources.items()}) == found


def fields(node: ast.ClassDef) -> tuple[str, ...]:
    """What a record holds; texts about arguments (`TypedDict`) and about what others hold (`Protocol`) hold nothing."""
    if {"TypedDict", "Protocol"} & {base.id for base in node.bases if isinstance(base, ast.Name)}:
        return ()
    named = [each for each in node.body if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name)]
    return tuple(sorted(each.target.id for each in named if "ClassVar" not in ast.unparse(each.annotation)))


def alike(classes: list[tuple[str, ast.ClassDef]]) -> list[str]:
    """Records of two fields or more whose fields are those of another."""
    seen = defaultdict(list)
    for place, node in classes:
        if len(held := fields(node)) > 1:
            seen[held].append(f"{place}: {node.name}")
    return [" and ".join(places) for places in seen.values() if len(places) > 1]


def test_no_two_records_hold_the_same_fields():
    """One of them is the other, or its base."""
    own = [path for path in SOURCES if path.relative_to(PACKAGE).parts[0] != "checkers"]
    kinds = [(str(path.relative_to(PACKAGE)), n) for path in own for n in nodes(path) if isinstance(n, ast.ClassDef)]
    assert alike(kinds) == []


def test_records_that_hold_the_same_are_found():
    two = "class A:\n    x: int\n    y: int\nclass B:\n    y: str\n    x: str\n"
    text = two + "class C(TypedDict):\n    x: int\n    y: int"
    assert alike([("here", node) for node in ast.parse(text).body]) == ["here: A and here: B"]
