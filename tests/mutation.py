"""Mutants of the package: one operator or constant made into another, and whether the tests of its room notice.

`python -m tests.mutation 40 7` draws 40 of them from seed 7 over the rooms of `CORE`, each in a copy of the house. It
runs the tests of the room first, and those marked long where none of the others failed: what only these catch is what
the short suite has lost. A mutant that nothing catches may be none (`<` for `<=` between doubles).
"""

from __future__ import annotations

import ast
import copy
import random
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
CORE = ("plants", "schedules", "observability", "accuracy", "design", "certificates", "estimators", "planning")
OTHER = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
SECONDS = 1800


def mutants(source: str) -> Iterator[tuple[int, str]]:
    """(line, source) of every mutant: operators and comparisons turned round, numbers made larger."""
    tree = ast.parse(source)
    for place, node in enumerate(ast.walk(tree)):
        fresh = None
        if isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in OTHER:
            fresh = {"op": OTHER[type(node.op)]()}
        elif isinstance(node, ast.Compare) and type(node.ops[0]) in OTHER:
            fresh = {"ops": [OTHER[type(node.ops[0])](), *node.ops[1:]]}
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float) and node.value:
            fresh = {"value": node.value + 1 if isinstance(node.value, int) else node.value * 1.5}
        if fresh is not None:
            other = copy.deepcopy(tree)
            found = next(each for k, each in enumerate(ast.walk(other)) if k == place)
            for name, value in fresh.items():
                setattr(found, name, value)
            yield node.lineno, ast.unparse(other)


def drawn(count: int, seed: int) -> Iterator[tuple[Path, int, str]]:
    """So many mutants, as many of each room: file, line, source."""
    rng = random.Random(seed)
    for k in range(count):
        files = sorted((ROOT / "sampling_design" / CORE[k % len(CORE)]).rglob("*.py"))
        made: list[tuple[int, str]] = []
        while not made:
            path = rng.choice(files)
            made = list(mutants(path.read_text()))
        yield path, *rng.choice(made)


def caught(house: Path, room: str, *options: str) -> bool:
    """Whether a test of the room fails."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:xdist", *options, f"tests/{room}"]
    try:
        done = subprocess.run(command, cwd=house, capture_output=True, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return True
    return done.returncode not in (0, 5)


def main(count: int, seed: int) -> None:
    """Try them, and print one line for each and the sums."""
    told: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        house = Path(folder) / "house"
        shutil.copytree(ROOT, house, ignore=shutil.ignore_patterns(".git", "__pycache__", "_build", ".mypy_cache"))
        for path, line, source in drawn(count, seed):
            here = house / path.relative_to(ROOT)
            room = path.relative_to(ROOT / "sampling_design").parts[0]
            here.write_text(source)
            found = "short" if caught(house, room) else "long" if caught(house, room, "--long") else "none"
            here.write_text(path.read_text())
            told[found] += 1
            print(f"{found:6}{path.relative_to(ROOT)}:{line}", flush=True)
    print(dict(told))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
