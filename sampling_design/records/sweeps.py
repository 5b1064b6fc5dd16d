"""One question asked of many things, by one process or by many machines, and taken up again after a kill."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar

import numpy as np

from sampling_design import __version__
from sampling_design.checkers.strict import a_table, is_text, or_nothing, refuse, table, text
from sampling_design.errors import ArgumentError, FileFormatError, SamplingDesignError
from sampling_design.records import checks, file_io
from sampling_design.records.budget import Progress
from sampling_design.records.file_io import from_json, to_json
from sampling_design.records.record import Plain, PlainRecord
from sampling_design.records.signatures import checked
from sampling_design.records.workers import Workers, check_workers, numbered

FORMAT = "sampling-design/journal/2"
Kept = TypeVar("Kept")


def digest_of(*parts: object) -> str:
    """Digest of what results depend on: plain data, arrays, records, functions by their names, and who computes them.

    Raises ArgumentError of a function that no module holds: another one may have its name.
    """
    whole = [*parts, __version__, np.__version__]
    return hashlib.sha256(json.dumps(whole, sort_keys=True, default=_digestible).encode()).hexdigest()


def _digestible(value: object) -> object:
    """What a digest takes for a thing that is no plain data."""
    if isinstance(value, partial):
        return [_digestible(value.func), list(value.args), value.keywords]
    if isinstance(value, np.random.Generator):
        return value.bit_generator.state
    for way in ("to_dict", "tolist"):
        if hasattr(value, way) and not isinstance(value, type):
            return getattr(value, way)()
    if hasattr(value, "__qualname__"):
        if "<" in value.__qualname__:
            raise ArgumentError(
                f"`resume` needs a function of a module, or functools.partial of one, got {value.__qualname__}: its "
                "name does not say what it does."
            )
        own = getattr(value, "__self__", None)
        return [f"{getattr(value, '__module__', '')}.{value.__qualname__}", own]
    if is_dataclass(value):  # what it prints is rounded, and cut off
        return [type(value).__qualname__, {each.name: getattr(value, each.name) for each in fields(value)}]
    return dict(value.items()) if hasattr(value, "items") else repr(value)


class Journal(Generic[Kept]):
    """Plain results by name; a line that was cut off by a kill is written again.

    Raises FileFormatError if the file is no journal, belongs to other data, holds a line that is no result or was
    changed, or cannot be written.

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
        self._key = key
        head = {"format": FORMAT, "key": key}
        where = os.fspath(path)
        lines = file_io.read_text(path).split("\n") if self.path.exists() else []
        whole, cut = lines[:-1], lines[-1] if lines else ""
        if whole:
            self._check(file_io.from_json(whole[0], where), head, where)
            entry = table({"name": text, "result": read, "digest": text})
            with file_io.usable(where):
                for k, line in enumerate(whole[1:], 2):
                    data = file_io.from_json(line, where)
                    answered = entry(data, f"line {k}")
                    if answered["digest"] != digest_of(key, answered["name"], data["result"]):
                        raise refuse(f"line {k}", "was changed since it was written")
                    self.known[answered["name"]] = answered["result"]
        if cut or not whole:
            kept = whole or [json.dumps(head)]
            file_io.write_text(path, "".join(line + "\n" for line in kept))

    @staticmethod
    def _check(found: Mapping[str, object], head: Mapping[str, str], where: str) -> None:
        if found.get("format") != FORMAT:
            raise FileFormatError(f"{where}: `format` must be {FORMAT!r}, got {found.get('format')!r}.", where)
        if found != head:
            raise FileFormatError(
                f"{where}: belongs to other data, options or versions. Name another file to resume from.", where
            )

    def add(self, name: str, result: Mapping[str, object]) -> None:
        """Write down a result; it is on disk when this returns."""
        entry = {"name": name, "result": result, "digest": digest_of(self._key, name, result)}
        line = json.dumps(entry, allow_nan=False) + "\n"
        try:
            with self.path.open("a", encoding="utf-8") as stream:
                stream.write(line)
                stream.flush()
                os.fsync(stream.fileno())
        except OSError as error:
            where = str(self.path)
            raise FileFormatError(f"{where}: cannot be written ({error.strerror}).", where) from None


Item = TypeVar("Item")


Answer: TypeAlias = tuple[dict[str, Plain] | None, str]
"""An answer as plain data, or None and what stands in its way."""


@dataclass(frozen=True, eq=False, repr=False)
class Sweep(PlainRecord):
    """Answers to one question, as plain data, in the order in which things were given.

    Attributes
    ----------
    names : tuple of str
    answers : tuple of dict or None
        `to_dict` of each answer; None where there is none.
    obstacles : tuple of str
        Why there is none: the error's sentence; else "".
    """

    names: tuple[str, ...]
    answers: tuple[dict[str, Plain] | None, ...]
    obstacles: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __getitem__(self, name: str) -> dict[str, Plain]:
        """Return the answer of that name. Raises ArgumentError if there is none; with the reason."""
        if name not in self.names:
            raise ArgumentError(f"`name` must be one of {', '.join(self.names)}, got {name!r}.")
        k = self.names.index(name)
        answer = self.answers[k]
        if answer is None:
            raise ArgumentError(f"`name` = {name!r} has no answer: {self.obstacles[k]}")
        return answer

    def _rows(self) -> list[tuple[str, str]]:
        return [(name, obstacle or "answered") for name, obstacle in zip(self.names, self.obstacles, strict=True)]

    def explain(self) -> str:
        """Say how many were answered."""
        return f"{sum(each is not None for each in self.answers)} of {len(self)} were answered."


@checked
def sweep(
    question: Callable[[Item], object],
    items: Mapping[str, Item] | Iterable[Item],
    *,
    workers: Workers = None,
    resume: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
) -> Sweep:
    """Ask one question of many things: designs of requirements, certificates of families, accuracies of schedules.

    Parameters
    ----------
    question : callable
        Takes one thing and returns a record with `to_dict`. Other processes must be able to import it: a function of a
        module or `functools.partial` of one.
    items : mapping from names, or iterable
        What is asked about; without names they are "0", "1", ...
    workers : Executor, Client, int or str, optional
        Any `concurrent.futures.Executor`, a Dask client, a number of processes (-1: one per core), or the name of a
        joblib backend. Default: one after the other. Answers are those of the question whoever asks it; a worker
        that is killed takes nothing with it.
    resume : path, optional
        A journal to which every answer is written as it comes; what it holds already is not asked again.
    progress : callable, optional
        Called with the fraction done and a message.

    Returns
    -------
    Sweep
        An error of this package (an impossible requirement, a family that cannot be certified) is an obstacle, not an
        end; any other error ends the sweep.

    Raises
    ------
    ArgumentError
        If `items` is empty, a name is not a text, an answer has no `to_dict`, or `workers` is nobody.
    FileFormatError
        If `resume` belongs to another question or to other things.

    Examples
    --------
    >>> from functools import partial
    >>> from sampling_design import PeriodicSchedule, Plant, window_sigma
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> found = sweep(partial(window_sigma, plant, window=4.0), {f"{h} s": PeriodicSchedule([h]) for h in (0.5, 1.0)})
    >>> found["1.0 s"]["closed"]
    True
    """
    named = items if isinstance(items, Mapping) else {str(k): item for k, item in enumerate(items)}
    if not named or not all(map(is_text, named)):
        raise ArgumentError("`items` must hold at least one thing, and their names must be texts.")
    check_workers(workers)
    names = tuple(named)
    journal = None
    if resume is not None:
        journal = Journal(resume, digest_of(question, {name: named[name] for name in names}), _read)
    known: dict[str, Answer] = dict(journal.known) if journal is not None else {}
    todo = [name for name in names if name not in known]
    for place, answer in numbered(_answered, [(question, named[name]) for name in todo], workers):
        name = todo[place]
        known[name] = answer
        if journal is not None:
            journal.add(name, {"answer": answer[0], "obstacle": answer[1]})
        if progress is not None:
            progress(len(known) / len(names), f"{name}: {answer[1] or 'answered'}")
    answers, obstacles = zip(*(known[name] for name in names), strict=True)
    return Sweep(names, answers, obstacles)


def _answered(job: tuple[Callable[[Item], object], Item]) -> Answer:
    """The answer as plain data, the same as it would be after a way through a file."""
    question, item = job
    try:
        answer = question(item)
    except SamplingDesignError as error:
        return None, str(error) or type(error).__name__
    if not hasattr(answer, "to_dict"):
        raise ArgumentError(f"`question` must return a record with to_dict, got {checks.described(answer)}.")
    return from_json(to_json(answer.to_dict()), "the answer"), ""


def _read(value: object, place: str) -> Answer:
    """An answer as a journal holds it, or what stands in its way."""
    found = table({"answer": or_nothing(a_table), "obstacle": text})(value, place)
    if (found["answer"] is None) != bool(found["obstacle"]):
        raise refuse(place, "must hold an answer or an obstacle, and not both")
    return found["answer"], found["obstacle"]
