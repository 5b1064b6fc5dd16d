"""Imports go down only: never up a floor, never sideways between rooms of one floor."""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from tests.house.sources import PACKAGE, nodes

pytestmark = pytest.mark.long  # a lint, which the style step of .ci/run runs

FLOORS = {
    "checkers": 0,
    "plants": 1,
    "schedules": 1,
    "observability": 2,
    "accuracy": 3,
    "certificates": 3,
    "design": 3,
    "estimators": 4,
    "planning": 4,
    "explorer": 5,
    "uncertain": 5,
    "validation": 5,
    "nonlinear": 6,
    "plotting": 7,
    "cli": 8,
    "__main__": 8,
}
"""Each room on the lowest floor that what it imports allows; `__main__` is the same door as `cli`."""
MOST_FLOORS = 9
GROUND = {"errors", "numerics", "records"}
RINGS = {"uncertain", "nonlinear", "planning", "cli", "plotting", "explorer"}
"""What stands around the core, which imports nothing of it: a ring registers with the verbs (`records/dispatch.py`)."""


def room_of(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


@cache
def imports(path: Path) -> list[str]:
    found = []
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            if path.parent.name == "checkers" and node.level == 1:
                continue  # a folder that is copied out of the house names only itself
            assert node.level == 0, f"{path}: relative imports hide the floor"
            if node.module == "sampling_design":
                found += [f"sampling_design.{alias.name}" for alias in node.names]
            else:
                found.append(node.module or "")
    return found


def sources():
    return sorted(p for p in PACKAGE.rglob("*.py") if p != PACKAGE / "__init__.py")


def test_imports_go_down_only():
    for path in sources():
        here = path.relative_to(PACKAGE)
        room = here.parts[0].removesuffix(".py")
        assert room in FLOORS or room in GROUND, f"{room} is on no floor"
        floor = FLOORS.get(room, 0)
        for module in imports(path):
            other = room_of(module) if module.startswith("sampling_design") else ""
            if other in ("", "__version__") or other == room or (room, other) == ("__main__", "cli"):
                continue
            target = FLOORS.get(other, 0)
            assert other in FLOORS or other in GROUND, f"{here} imports {module}, which is on no floor"
            assert target < floor or (target == floor == 0), f"{here} (floor {floor}) imports {module} (floor {target})"


def lowest(below: dict[str, set[str]]) -> dict[str, int]:
    """The lowest floor of each: one above the highest that it imports."""
    found: dict[str, int] = {}
    while ready := [one for one, others in below.items() if one not in found and others & set(below) <= found.keys()]:
        found |= {one: 1 + max((found[other] for other in below[one] & set(below)), default=-1) for one in ready}
    return found


def test_nine_floors_and_no_room_higher_than_it_must_be():
    below = {room: set[str]() for room in FLOORS.keys() - {"__main__"}}
    for path in sources():
        here = path.relative_to(PACKAGE).parts[0]
        if here in below:
            others = {room_of(module) for module in imports(path) if module.startswith("sampling_design.")} - {here}
            below[here] |= {"checkers" if other in GROUND else other for other in others}
    assert lowest(below) == {room: floor for room, floor in FLOORS.items() if room != "__main__"}
    assert len(set(FLOORS.values())) <= MOST_FLOORS


MOST_INSIDE = 5


def test_inside_a_room_the_rooms_stand_on_few_floors():
    inside = {place: others for place, others in arrows().items() if "/" in place}
    for room in FLOORS:
        own = {place: others for place, others in inside.items() if place.startswith(f"{room}/")}
        assert max(lowest(own).values(), default=0) < MOST_INSIDE, (room, lowest(own))


def test_the_core_imports_no_ring():
    for path in sources():
        here = path.relative_to(PACKAGE)
        if here.parts[0].removesuffix(".py") not in RINGS | {"__main__"}:
            found = {other.split("/")[0] for other in every_import(path)} & RINGS
            assert not found, f"{here} imports {found}"


def test_a_plant_and_a_schedule_never_meet_below_observability():
    for room, other in (("plants", "schedules"), ("schedules", "plants")):
        found = [m for p in (PACKAGE / room).rglob("*.py") for m in imports(p) if room_of(m) == other]
        assert found == []


@pytest.mark.parametrize(
    ("library", "door"),
    [
        ("matplotlib", {"plotting"}),
        ("cvxpy", {"estimators/constraints/qp.py"}),
        ("typer", {"cli"}),
        ("flint", {"numerics/balls.py"}),
        ("pandas", {"records/record.py"}),
        ("xarray", {"records/record.py"}),
    ],
)
def test_a_library_has_one_door(library, door):
    for path in sources():
        here = str(path.relative_to(PACKAGE))
        if any(here == d or here.startswith((f"{d}/", f"{d}.py")) for d in door):
            continue
        assert not [m for m in imports(path) if m.split(".")[0] == library], f"{here} imports {library}"


def place_of(module: str) -> str:
    """The innermost room that holds a module: "certificates/exact", or "_checks" for a file on the ground."""
    path = PACKAGE.joinpath(*module.split(".")[1:])
    inner = path if path.is_dir() else path.parent
    return str(inner.relative_to(PACKAGE)) if inner != PACKAGE else path.name


def arrows() -> dict[str, set[str]]:
    """Which innermost room imports from which."""
    found: dict[str, set[str]] = {}
    for path in sources():
        here = place_of(".".join(("sampling_design", *path.relative_to(PACKAGE).with_suffix("").parts)))
        for module in imports(path):
            parts = module.split(".")
            if parts[0] == "sampling_design" and len(parts) > 1:
                found.setdefault(here, set()).add(place_of(module))
    return {here: others - {here} for here, others in found.items()}


def file_of(module: str) -> str:
    """The file that a module is, or the folder's own; "" for none of the house."""
    if not module.startswith("sampling_design."):
        return ""
    path = PACKAGE.joinpath(*module.split(".")[1:])
    found = next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)
    return "" if found is None else str(found.relative_to(PACKAGE))


def every_import(path: Path) -> set[str]:
    """Files of the house that a file imports anywhere: at its top, inside functions, for the type checker alone."""
    package = ["sampling_design", *path.relative_to(PACKAGE).parent.parts]
    found = set()
    for node in nodes(path):
        if isinstance(node, ast.Import):
            found |= {file_of(alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            own = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join([*own, *([node.module] if node.module else [])])
            found |= {file_of(f"{base}.{alias.name}") or file_of(base) for alias in node.names}
    return found - {"", str(path.relative_to(PACKAGE))}


def in_a_circle(below: dict[str, set[str]]) -> list[str]:
    """What is left once everything that stands on what stands is taken away."""
    stands: set[str] = set()
    while free := {one for one, others in below.items() if one not in stands and others & set(below) <= stands}:
        stands |= free
    return sorted(set(below) - stands)


def test_no_room_or_sub_room_stands_in_a_circle():
    assert in_a_circle(arrows()) == []


def test_no_file_stands_in_a_circle():
    assert in_a_circle({str(path.relative_to(PACKAGE)): every_import(path) for path in sources()}) == []


def test_circles_are_found_wherever_the_import_stands(tmp_path, monkeypatch):
    monkeypatch.setattr(f"{__name__}.PACKAGE", tmp_path)
    room = tmp_path / "room"
    room.mkdir()
    (room / "low.py").write_text("if TYPE_CHECKING:\n    from sampling_design.room.high import High\n")
    (room / "high.py").write_text("def f():\n    from sampling_design.room import low\n")
    (room / "near.py").write_text("from .low import f\nimport numpy\n")
    below = {path.name: {Path(other).name for other in every_import(path)} for path in room.iterdir()}
    assert below == {"low.py": {"high.py"}, "high.py": {"low.py"}, "near.py": {"low.py"}}
    assert in_a_circle(below) == ["high.py", "low.py", "near.py"]
    assert in_a_circle(below | {"low.py": set()}) == []


def test_every_room_and_sub_room_has_a_readme_of_5_to_40_lines_on_files_that_exist():
    folders = {p.parent for p in sources() if p.parent != PACKAGE}
    for folder in sorted(folders):
        text = (folder / "README.md").read_text()
        count = len(text.splitlines())
        assert 5 <= count <= 40, f"{folder.relative_to(PACKAGE)}/README.md has {count} lines"
        for name in re.findall(r"`([a-z_/]+\.py)`", text):
            homes = (folder, folder.parent, PACKAGE, *folder.iterdir(), PACKAGE.parent)
            assert any((home / name).exists() for home in homes), f"{folder.name}/README.md names {name}"
