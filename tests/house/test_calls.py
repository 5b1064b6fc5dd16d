"""What is handed over in long rows is named: calls and results. Singular vectors that are dropped are not made."""

import ast
import inspect
import re
from collections.abc import Iterable

import pytest

from tests.front_door import public
from tests.house.sources import PACKAGE, SOURCES, nodes, parsed

pytestmark = pytest.mark.long  # a lint, which the style step of .ci/run runs

MOST_BY_PLACE = 8
"""Arguments of one call that are told apart by their place alone."""


def calls_by_place(inside: Iterable[ast.AST]) -> list[ast.Call]:
    return [n for n in inside if isinstance(n, ast.Call) and len(n.args) > MOST_BY_PLACE]


def test_arguments_are_counted_by_place():
    assert len(calls_by_place(ast.walk(ast.parse("f(1, 2, 3, 4, 5, 6, 7, 8, 9)")))) == 1
    assert calls_by_place(ast.walk(ast.parse("f(1, 2, 3, 4, 5, 6, 7, 8, i=9)"))) == []


def test_no_call_tells_many_arguments_apart_by_their_place():
    found = [f"{p}:{call.lineno}: {ast.unparse(call.func)}" for p in SOURCES for call in calls_by_place(nodes(p))]
    assert not found


def drops_left(node: ast.AST) -> bool:
    """Whether left singular vectors, as many numbers as the square of the rows, are made and dropped."""
    call = node.value if isinstance(node, ast.Assign | ast.Subscript) else None
    if not isinstance(call, ast.Call) or not ast.unparse(call.func).endswith("svd") or call.keywords:
        return False
    if isinstance(node, ast.Assign):
        return isinstance(node.targets[0], ast.Tuple) and ast.unparse(node.targets[0].elts[0]) == "_"
    return isinstance(node, ast.Subscript) and ast.unparse(node.slice) != "0"


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("_, s, V = np.linalg.svd(M)", True),
        ("V = np.linalg.svd(M)[2][-1]", True),
        ("s, V = np.linalg.svd(M)[1:]", True),
        ("U = np.linalg.svd(M)[0]", False),
        ("U, s, _ = np.linalg.svd(M)", False),
        ("_, s, V = np.linalg.svd(M, full_matrices=len(M) < n)", False),
    ],
)
def test_singular_vectors_that_are_dropped_are_found(line, found):
    assert any(map(drops_left, ast.walk(ast.parse(line)))) == found


def test_no_left_singular_vectors_are_made_and_dropped():
    """Of ten thousand rows they take a gigabyte: `right_directions` makes the others alone."""
    assert [f"{path}:{node.lineno}" for path in SOURCES for node in nodes(path) if drops_left(node)] == []


def long_tuples(hint: ast.expr | None) -> list[str]:
    """The tuples of three and more different things in an annotation."""
    found = []
    for node in ast.walk(hint) if hint is not None else ():
        if isinstance(node, ast.Subscript) and ast.unparse(node.value) == "tuple" and isinstance(node.slice, ast.Tuple):
            parts = [ast.unparse(part) for part in node.slice.elts]
            if len(parts) > 2 and "..." not in parts:
                found.append(ast.unparse(node))
    return found


def test_long_tuples_are_found_wherever_they_stand():
    hints = ["tuple[int, str, float]", "list[tuple[A, B, C]] | None", "tuple[A, B]", "tuple[A, ...]"]
    assert [len(long_tuples(ast.parse(hint, mode="eval").body)) for hint in hints] == [1, 1, 0, 0]


def public_results() -> dict[str, ast.expr | None]:
    """What doors hand out, and public methods and fields of records and of what stands at the front door."""
    results: dict[str, ast.expr | None] = {}
    for path in SOURCES:
        for node in parsed(path).body:
            bases = [ast.unparse(base) for base in getattr(node, "bases", [])]
            if isinstance(node, ast.FunctionDef) and "checked" in map(ast.unparse, node.decorator_list):
                results[node.name] = node.returns
            if isinstance(node, ast.ClassDef) and (
                {"Record", "TableRecord", "CurveRecord", "SigmaBracket"} & {*bases} or node.name in public()
            ):
                for member in node.body:
                    if isinstance(member, ast.FunctionDef) and not member.name.startswith("_"):
                        results[f"{node.name}.{member.name}"] = member.returns
                    elif isinstance(member, ast.AnnAssign) and not ast.unparse(member.target).startswith("_"):
                        results[f"{node.name}.{ast.unparse(member.target)}"] = member.annotation
    return results


def test_what_a_user_gets_has_names_and_no_places():
    results = public_results()
    assert len(results) > 300  # the walk found them
    assert {name: long_tuples(hint) for name, hint in results.items() if long_tuples(hint)} == {}


MOST_PARAMETERS = 14
"""Of the longest signature, a command's. What belongs together is one record; never raise it."""
EXPLAINED = 10
"""A verb that takes more stands in docs/conventions.md with the reason why they are not fewer."""


def test_every_long_list_of_arguments_has_its_reason():
    long = {}
    for name, thing in public().items():
        made = vars(thing).get("__init__") if inspect.isclass(thing) else thing
        if inspect.isfunction(made) and "checked" in vars(made):
            kinds = [p.kind for key, p in inspect.signature(made).parameters.items() if key != "self"]
            long[name] = len([kind for kind in kinds if kind is not inspect.Parameter.VAR_KEYWORD])
    text = (PACKAGE.parent / "docs" / "conventions.md").read_text().split("## Arguments")[1].split("\n## ")[0]
    told = {name: int(count) for name, count in re.findall(r"^\| `(\w+)` \| (\d+) \|", text, re.MULTILINE)}
    assert told == {name: count for name, count in long.items() if count > EXPLAINED}


ORDER = (
    "prior prior_time constraints w_bound v_bound initial_error of timing_tolerance start end rtol rng workers resume "
    "budget progress"
)
"""Arguments that many verbs take by keyword, in the order in which they document them."""
OTHERWISE = {"stop": "end", "tol": "rtol", "rate": "eta", "seeds": "rng", "n_jobs": "workers", "callback": "progress"}
"""Names that no verb gives to what has another one elsewhere."""


def public_signatures() -> dict[str, list[inspect.Parameter]]:
    """The parameters of every checked verb, `__init__` and public method."""
    found = {}
    for name, thing in public().items():
        for key, member in vars(thing).items() if inspect.isclass(thing) else [("", thing)]:
            inner = getattr(member, "__func__", member)
            if inspect.isfunction(inner) and "checked" in vars(inner):
                found[f"{name} {key}"] = [*inspect.signature(inner).parameters.values()]
    return found


def test_arguments_that_many_verbs_take_stand_in_one_order_under_one_name():
    signatures = public_signatures()
    assert len(signatures) > 150
    asked = {name: [p.name for p in taken if p.kind is p.KEYWORD_ONLY] for name, taken in signatures.items()}
    common = {name: [key for key in keys if key in ORDER.split()] for name, keys in asked.items()}
    assert {name: keys for name, keys in common.items() if keys != sorted(keys, key=ORDER.split().index)} == {}
    assert {key for keys in common.values() for key in keys} == {*ORDER.split()}
    named = {(name, p.name) for name, taken in signatures.items() for p in taken}
    assert {(name, key): OTHERWISE[key] for name, key in named if key in OTHERWISE} == {}


def test_a_bound_on_a_vector_is_taken_by_names_by_every_verb():
    named = {"w_bound", "v_bound", "initial_error", "w_intensity", "v_deviation"}
    hints = [(v, p.name, str(p.annotation)) for v, taken in public_signatures().items() for p in taken]
    asked = [hint for hint in hints if hint[1] in named]
    assert len(asked) > 30
    assert [hint for hint in asked if "ArrayLike" in hint[2]] == []


def test_a_start_is_a_time_and_a_state_at_it_is_x0():
    hints = {
        (name, str(p.annotation)) for name, taken in public_signatures().items() for p in taken if p.name == "start"
    }
    assert {hint for _, hint in hints} <= {"float", "float | None", "PeriodicSchedule"}


def test_no_signature_is_a_list_of_everything():
    found = []
    for path, node in [(source, node) for source in SOURCES for node in nodes(source)]:
        if isinstance(node, ast.FunctionDef):
            asked = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
            count = len([a for a in asked if a not in ("self", "cls")])
            found += [f"{path}:{node.lineno}: {node.name} has {count}"] if count > MOST_PARAMETERS else []
    assert not found
