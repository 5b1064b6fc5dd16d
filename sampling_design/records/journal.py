"""Results of a long computation on disk, one line each as they come: a second start goes on where the first ended."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Generic, TypeVar

from sampling_design.checkers.strict import table, text
from sampling_design.errors import FileFormatError
from sampling_design.records import file_io

FORMAT = "sampling-design/journal/1"
Kept = TypeVar("Kept")


def digest(*parts: object) -> str:
    """Digest of what results depend on: plain data, arrays, records, and functions by their names."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=_digestible).encode()).hexdigest()


def _digestible(value: object) -> object:
    """What a digest takes for a thing that is no plain data."""
    if isinstance(value, partial):
        return [_digestible(value.func), list(value.args), value.keywords]
    for way in ("to_dict", "tolist"):
        if hasattr(value, way) and not isinstance(value, type):
            return getattr(value, way)()
    if hasattr(value, "__qualname__"):
        return f"{getattr(value, '__module__', '')}.{value.__qualname__}"
    return repr(value)


class Journal(Generic[Kept]):
    """Plain results by name; a line that was cut off by a kill is written again.

    Raises FileFormatError if the file is no journal, belongs to other data, holds a line that is no result, or cannot
    be written.

    Parameters
    ----------
    path : path
        Made if it is missing.
    key : str
        Digest of everything that the results depend on.
    read : callable
        The grammar of a result.
    """

    def __init__(self, path: str | os.PathLike[str], key: str, read: Callable[[object, str], Kept]):
        self.path = Path(path)
        self.known: dict[str, Kept] = {}
        head = {"format": FORMAT, "key": key}
        where = os.fspath(path)
        lines = file_io.read_text(path).split("\n") if self.path.exists() else []
        whole, cut = lines[:-1], lines[-1] if lines else ""
        if whole:
            self._check(file_io.from_json(whole[0], where), head, where)
            entry = table({"name": text, "result": read})
            with file_io.usable(where):
                for k, line in enumerate(whole[1:], 2):
                    held = entry(file_io.from_json(line, where), f"line {k}")
                    self.known[held["name"]] = held["result"]
        if cut or not whole:
            kept = whole or [json.dumps(head)]
            file_io.write_text(path, "".join(line + "\n" for line in kept))

    @staticmethod
    def _check(found: Mapping[str, object], head: Mapping[str, str], where: str) -> None:
        if found.get("format") != FORMAT:
            raise FileFormatError(f"{where}: `format` must be {FORMAT!r}, got {found.get('format')!r}.", where)
        if found != head:
            raise FileFormatError(
                f"{where}: belongs to other data or options. Name another file to resume from.", where
            )

    def add(self, name: str, result: Mapping[str, object]) -> None:
        """Write down a result; it is on disk when this returns."""
        line = json.dumps({"name": name, "result": result}, allow_nan=False) + "\n"
        try:
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(line)
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            where = str(self.path)
            raise FileFormatError(f"{where}: cannot be written ({error.strerror}).", where) from None
