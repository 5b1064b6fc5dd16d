"""Writes the stubs `__init__.pyi` of front door and rooms from their tables: `python -m tests.house.front_door`."""

from importlib import import_module
from pathlib import Path
from types import ModuleType

import sampling_design

PACKAGE = Path(sampling_design.__file__).parent


def lazy_rooms() -> dict[str, ModuleType]:
    """The rooms that open their names on first use, by name."""
    found = {room: import_module(f"sampling_design.{room}") for room in sampling_design._ROOMS}
    return {room: module for room, module in found.items() if hasattr(module, "_NAMES")}


def stubs() -> dict[Path, str]:
    """The front door and each room as editors and type checkers read them: every name, imported from where it lives."""
    found = {PACKAGE / "__init__.pyi": stub("sampling_design", sampling_design._FRONT_DOOR, sampling_design._ROOMS)}
    for room, module in lazy_rooms().items():
        inside = {name for names in module._NAMES.values() for name in names}
        files = tuple(name for name in module.__all__ if name not in inside)
        found[PACKAGE / room / "__init__.pyi"] = stub(f"sampling_design.{room}", module._NAMES, files)
    return found


def stub(package: str, names: dict[str, tuple[str, ...]], modules: tuple[str, ...]) -> str:
    """One package."""
    lines = ["# Written from the table in __init__.py by `python -m tests.house.front_door`."]
    lines += [f"from {package} import {name} as {name}" for name in sorted(modules)]
    for place, found in sorted(names.items()):
        lines += [f"from {package}.{place} import {name} as {name}" for name in sorted(found)]
    return "\n".join([*lines, "", *(["__version__: str", ""] if package == "sampling_design" else [])])


if __name__ == "__main__":
    for path, text in stubs().items():
        path.write_text(text)
