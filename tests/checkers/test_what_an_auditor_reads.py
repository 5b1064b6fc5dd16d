"""What is opened for a claim is what decides it, and the room's README counts it."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import checkers
from sampling_design.checkers import claims
from tests.cases import few

ROOM = Path(checkers.__file__).parent
README = (ROOM / "README.md").read_text(encoding="utf-8")
NEAR = 0.02
"""Share by which a count of the README may be off: who reads for an hour does not mind a minute."""


def neighbours(name: str) -> set[str]:
    """Files of the room that a file opens, other than for the type checker."""
    tree = ast.parse((ROOM / f"{name}.py").read_text(encoding="utf-8"))
    typed = {
        id(n)
        for part in ast.walk(tree)
        if isinstance(part, ast.If) and ast.unparse(part.test) == "TYPE_CHECKING"
        for n in ast.walk(part)
    }
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 1 and id(node) not in typed:
            found |= {node.module} if node.module else {each.name for each in node.names}
    return found


def opened(claim: str) -> set[str]:
    """Files that judge a file of the claim: the command's, the claim's, and all that these open."""
    todo, found = ["check", claims.CLAIMS[claim]], set[str]()
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += neighbours(name)
    return found


def size(names: set[str]) -> tuple[int, int]:
    """Lines, and of these the ones that are code: no blank, no comment alone, no text that only describes."""
    lines = code = 0
    for name in names:
        text = (ROOM / f"{name}.py").read_text(encoding="utf-8")
        lines += len(text.splitlines())
        bare = {k for k, line in enumerate(text.splitlines(), 1) if not line.strip() or line.lstrip().startswith("#")}
        for node in ast.walk(ast.parse(text)):
            if (
                isinstance(node, ast.Expr)
                and isinstance(node.value, ast.Constant)
                and isinstance(node.value.value, str)
            ):
                bare |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        code += len(text.splitlines()) - len(bare)
    return lines, code


def row(claim: str) -> tuple[set[str], tuple[int, int]]:
    """Files and lines that the README states for a claim."""
    found = re.search(rf"\| `?{claim}`? \|[^|]*\|([^|]*)\| ([\d ]+) \| ([\d ]+) \|", README)
    assert found is not None
    files, *counts = found.groups()
    lines, code = (int(count.replace(" ", "")) for count in counts)
    return set(re.findall(r"`(\w+)\.py`", files)), (lines, code)


@pytest.mark.parametrize("claim", few(list(claims.CLAIMS), 0, 1, 2))
def test_the_readme_lists_and_counts_what_is_opened_for_a_claim(claim):
    files, counts = row(claim)
    assert row("any")[0] | files == opened(claim)
    assert counts == pytest.approx(size(opened(claim)), rel=NEAR)


def test_what_all_claims_share_is_counted_once():
    shared = set.intersection(*(opened(claim) for claim in claims.CLAIMS))
    files, counts = row("any")
    assert files == shared
    assert counts == pytest.approx(size(shared), rel=NEAR)


def test_no_file_of_the_room_is_read_for_nothing():
    files = {path.stem for path in ROOM.glob("*.py")} - {"__init__", "__main__"}
    assert set().union(*(opened(claim) for claim in claims.CLAIMS)) == files


@pytest.mark.parametrize("claim", few(["assumption-7", "detectability"], 1))
def test_what_another_claim_needs_is_not_opened(claim, tmp_path):
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    if claim == "detectability":
        sd.certificates.certify_detectability(plant).save(tmp_path / "c.json")
    else:
        sd.certify(plant, sd.PeriodicSchedule([0.8, 1.3]), eta=0.4, P2=np.diag([0.5, 0.2])).save(tmp_path / "c.json")
    code = f"""
import sys
sys.path.insert(0, {str(ROOM.parent)!r})
import json
from checkers import check
assert check(json.load(open({str(tmp_path / "c.json")!r})))["passed"]
print(*sorted(name[9:] for name in sys.modules if name.startswith("checkers.")))
"""
    ran = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path)
    assert set(ran.stdout.split()) == opened(claim)
