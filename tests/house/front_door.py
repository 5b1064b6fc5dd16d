"""Writes `sampling_design/__init__.pyi` from the table of the front door: `python -m tests.house.front_door`."""

from pathlib import Path

import sampling_design

STUB = Path(sampling_design.__file__).with_suffix(".pyi")


def stub() -> str:
    """The front door as editors and type checkers read it: every name, imported from where it lives."""
    lines = ["# Written from the table in __init__.py by `python -m tests.house.front_door`."]
    lines += [f"from sampling_design import {room} as {room}" for room in sampling_design._ROOMS]
    for room, names in sorted(sampling_design._FRONT_DOOR.items()):
        lines += [f"from sampling_design.{room} import {name} as {name}" for name in sorted(names)]
    return "\n".join([*lines, "", "__version__: str", ""])


if __name__ == "__main__":
    STUB.write_text(stub())
