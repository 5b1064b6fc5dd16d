"""Imports go down only: never up a floor, never sideways between rooms of one floor."""

import ast
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "sampling_design"
FLOORS = {
    "plants": 1,
    "schedules": 1,
    "observability": 2,
    "design": 3,
    "certificates": 3,
    "estimators": 4,
    "nonlinear": 5,
    "validation": 5,
    "plotting": 6,
    "cli": 7,
}
GROUND = {
    "errors",
    "evidence",
    "_checks",
    "_linalg",
    "_conic",
    "_record",
    "_files",
    "_units",
    "_modal",
    "_balls",
    "_ball_flow",
}
LATE_UPWARD_CALLS = {("_record.py", "plotting")}


def room_of(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


def imports(path: Path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide the floor"
            if node.module == "sampling_design":
                yield from (f"sampling_design.{alias.name}" for alias in node.names)
            else:
                yield node.module or ""


def sources():
    return sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")


@pytest.mark.parametrize("path", sources(), ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_go_down_only(path):
    here = path.relative_to(PACKAGE)
    room = here.parts[0].removesuffix(".py")
    assert room in FLOORS or room in GROUND, f"{room} is on no floor"
    floor = FLOORS.get(room, 0)
    for module in imports(path):
        if not module.startswith("sampling_design"):
            continue
        other = room_of(module)
        if other in ("", "__version__") or other == room or (here.name, other) in LATE_UPWARD_CALLS:
            continue
        target = FLOORS.get(other, 0)
        assert other in FLOORS or other in GROUND, f"{here} imports {module}, which is on no floor"
        assert target < floor or (target == floor == 0), f"{here} (floor {floor}) imports {module} (floor {target})"


def test_a_plant_and_a_schedule_never_meet_below_observability():
    for room, other in (("plants", "schedules"), ("schedules", "plants")):
        found = [m for p in (PACKAGE / room).rglob("*.py") for m in imports(p) if room_of(m) == other]
        assert found == []


@pytest.mark.parametrize(
    ("library", "door"),
    [
        ("matplotlib", {"plotting"}),
        ("cvxpy", {"_conic.py", "estimators/qp.py"}),
        ("typer", {"cli"}),
        ("flint", {"_balls.py"}),
    ],
)
def test_a_library_has_one_door(library, door):
    for path in sources():
        here = str(path.relative_to(PACKAGE))
        if any(here == d or here.startswith((f"{d}/", f"{d}.py")) for d in door):
            continue
        assert not [m for m in imports(path) if m.split(".")[0] == library], f"{here} imports {library}"


def test_every_room_has_a_readme_of_5_to_40_lines():
    for room in FLOORS:
        folder = PACKAGE / room
        if folder.is_dir():
            lines = (folder / "README.md").read_text().splitlines()
            assert 5 <= len(lines) <= 40, f"{room}/README.md has {len(lines)} lines"
