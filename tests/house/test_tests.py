"""The tests themselves: each one can fail, and none is skipped."""

import ast
from pathlib import Path

import pytest

from tests.conftest import spread
from tests.house.sources import nodes, parsed

TESTS = Path(__file__).parents[1]
FILES = sorted((*TESTS.rglob("test_*.py"), *TESTS.rglob("bench_*.py")))


def claims(node):
    """Whether a function asserts anything itself, or has numpy do so."""
    inside = list(ast.walk(node))
    used = {getattr(n, "attr", getattr(n, "id", "")) for n in inside}
    return any(isinstance(n, ast.Assert) for n in inside) or any(
        name in ("raises", "warns") or name.startswith("assert_") for name in used
    )


@pytest.mark.long
def test_every_test_asserts_and_none_is_skipped():
    helpers = [node for file in TESTS.rglob("*.py") for node in nodes(file) if isinstance(node, ast.FunctionDef)]
    checking = {node.name for node in helpers if node.name.startswith("check_")}
    assert [node.name for node in helpers if node.name in checking and not claims(node)] == []
    for path, node in [(file, node) for file in FILES for node in nodes(file)]:
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            inside = list(ast.walk(node))
            used = {getattr(n, "attr", getattr(n, "id", "")) for n in inside}
            assert claims(node) or used & checking, f"{path}: {node.name} asserts nothing"
            skipped = used & {"skip", "skipif", "xfail", "importorskip"}
            assert not skipped, f"{path}: {node.name} is skipped or expected to fail"


@pytest.mark.long
def test_what_takes_long_is_marked_in_the_words_by_which_it_is_found():
    """`--long` reads no file in which they do not stand."""
    marks = [node for path in FILES for node in nodes(path) if isinstance(node, ast.Attribute) and node.attr == "long"]
    assert marks
    assert {ast.unparse(node) for node in marks} == {"pytest.mark.long"}


def unordered(cases):
    """Whether they come out of a set, which has another order in each process."""
    if isinstance(cases, ast.BinOp):
        return unordered(cases.left) or unordered(cases.right)
    if isinstance(cases, (ast.ListComp, ast.GeneratorExp)):
        return unordered(cases.generators[0].iter)
    if isinstance(cases, ast.Call):
        name = ast.unparse(cases.func)
        return name in ("set", "frozenset") or (name != "sorted" and any(map(unordered, cases.args)))
    return isinstance(cases, (ast.Set, ast.SetComp))


@pytest.mark.long
def test_processes_that_share_a_run_have_the_cases_in_one_order():
    assert unordered(ast.parse("few(set(MAKERS) - {'plan'}, 1)", mode="eval").body)
    assert not unordered(ast.parse("[{'a'}, *sorted({'b'})]", mode="eval").body)
    for path in FILES:
        for node in nodes(path):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "pytest.mark.parametrize":
                assert not unordered(node.args[1]), f"{path}:{node.lineno}: sort the cases"


@pytest.mark.long
def test_every_law_is_a_sentence_in_a_file_of_its_own():
    for path in (TESTS / "laws").glob("*.py"):
        assert path.name.startswith("test_")
        assert path.stem.count("_") >= 3, f"{path.name} is no sentence"
        assert ast.get_docstring(parsed(path)), f"{path.name} does not state its law"


def test_the_share_of_what_takes_long_is_spread_over_the_cases_of_each_test():
    cases = [("a", k) for k in range(10)] + [("b", 0), ("c", 0), ("c", 1)]
    assert spread(cases, lambda case: case[0], 1) == [("a", 5), ("b", 0), ("c", 1)]
    assert spread(cases, lambda case: case[0], 3) == [("a", 1), ("a", 5), ("a", 8), ("b", 0), ("c", 0), ("c", 1)]
    assert spread(cases, lambda case: case[0], 10) == cases
    assert spread(cases, lambda case: case[0], 1, {"a"}) == [("b", 0), ("c", 1)]  # those that have a short one


@pytest.mark.long
def test_no_test_is_timed_by_the_machine():
    """Budgets are judged by `tests/counted_clock.py`, which counts what is done."""
    for path in TESTS.rglob("test_*.py"):
        read = {node.attr for node in nodes(path) if isinstance(node, ast.Attribute)}
        assert not read & {"process_time", "thread_time", "perf_counter_ns"}, path
