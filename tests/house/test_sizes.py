"""Rooms stay small: files of at most 500 lines, functions of at most 60 lines of code."""

import ast
import io
import re
import tokenize

import pytest

from tests.house.sources import PACKAGE, SOURCES, nodes

pytestmark = pytest.mark.long  # a lint, which the style step of .ci/run runs

FILE_WALL = 500
FUNCTION_WALL = 60


def code_lines(text: str) -> set[int]:
    """Lines that hold code: no blank lines, comments or strings that stand alone (docstrings)."""
    found: set[int] = set()
    quiet = {tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in quiet:
            found.update(range(token.start[0], token.end[0] + 1))
    return found


def docstring_lines(node: ast.AST) -> set[int]:
    body = getattr(node, "body", [])
    if body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
        return set(range(body[0].lineno, body[0].end_lineno + 1))
    return set()


def test_files_stay_small():
    lines = {str(path.relative_to(PACKAGE)): path.read_text().count("\n") for path in SOURCES}
    assert {path: count for path, count in lines.items() if count > FILE_WALL} == {}


def test_functions_stay_small():
    kinds = ast.FunctionDef | ast.AsyncFunctionDef
    for path in SOURCES:
        functions = [n for n in nodes(path) if isinstance(n, kinds) and n.end_lineno - n.lineno >= FUNCTION_WALL]
        code = code_lines(path.read_text()) if functions else set()
        for function in functions:
            inner = [d for d in ast.walk(function) if isinstance(d, ast.FunctionDef | ast.ClassDef)]
            documented = set().union(*(docstring_lines(d) for d in inner))
            body = code & set(range(function.lineno, function.end_lineno + 1)) - documented
            assert len(body) <= FUNCTION_WALL, (
                f"{path}:{function.lineno}: {function.name} has {len(body)} lines of code"
            )


def test_the_way_in_for_a_new_maintainer_is_short():
    """docs/architecture.md lists at most twelve files, under 3 000 lines together, each of them there."""
    page = (PACKAGE.parent / "docs" / "architecture.md").read_text().split("**The way in.**")[1].split("**Adding")[0]
    files = re.findall(r"^\| \d+ \| `([\w/]+\.py)` \|", page, re.MULTILINE)
    assert 8 <= len(files) <= 12
    assert sum((PACKAGE / file).read_text().count("\n") for file in files) < 3000
