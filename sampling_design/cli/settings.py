"""The flags that every command has, and where results, messages and progress go."""

from __future__ import annotations

import functools
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.models import OptionInfo

from sampling_design.cli.version import show_version
from sampling_design.errors import ArgumentError
from sampling_design.records.budget import Progress, progress_bar
from sampling_design.records.checks import positive, whole
from sampling_design.records.file_io import atomic_file, json_pieces

if TYPE_CHECKING:
    from rich.table import Table

    from sampling_design.plants.plant import Plant
    from sampling_design.records.record import Record


ONLY: dict[str, tuple[str, ...]] = {
    "seed": ("design", "pareto", "losses", "validate", "thyroid"),
    "budget": ("design", "losses", "sigma", "worst-case", "certify", "verify", "robustness", "compare", "next"),
    "decay_rate": ("info", "design", "pareto", "losses", "sigma", "worst-case", "compare", "explore"),
    "of": (
        "info",
        "design",
        "pareto",
        "losses",
        "sigma",
        "worst-case",
        "certify",
        "robustness",
        "estimate",
        "validate",
        "compare",
    ),
}
"""Flags of those commands alone that draw at random; that end early with what they have (the others' work is given by
their arguments, or they have a limit of their own: what ends by the clock depends on how many share the work); and
that ask for observability of some modes, or of some rows alone (`accuracy` has its own --of)."""

WITHOUT: dict[str, tuple[str, ...]] = {"no_picture": ("info", "verify", "next", "explore", "new"), "output": ("new",)}
"""Flags that every command has but these: they draw nothing, or are given their folder."""


def flags_of(command: str) -> list[str]:
    """Return the names of the common flags that a command takes."""
    return [
        name for name in COMMON_FLAGS if command in ONLY.get(name, (command,)) and command not in WITHOUT.get(name, ())
    ]


@dataclass
class Settings:
    """The common flags of one call, with the two streams: results on stdout, all else on stderr."""

    command: str = ""
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Folder for files.", metavar="DIR")] = None
    seed: Annotated[int, typer.Option(help="Seed of everything random.")] = 0
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, no notices.")] = False
    no_picture: Annotated[bool, typer.Option("--no-picture", help="With -o: all files but the picture.")] = False
    budget: Annotated[float, typer.Option(help="Seconds a search may take, by the clock.", metavar="SECONDS")] = 60.0
    decay_rate: Annotated[
        float | None,
        typer.Option(
            help="Retain modes whose squared error decays slower [1/time unit]; default: 0, or the requirement's."
        ),
    ] = None
    of: Annotated[
        str | None,
        typer.Option(
            help="Only these rows of the state: names of states or outputs, with commas between; default: all."
        ),
    ] = None
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=show_version, is_eager=True)
    ] = False
    files: list[Path] = field(default_factory=list)
    made: list[Path] = field(default_factory=list)

    def notice(self, text: str) -> None:
        """Say something on stderr unless --quiet."""
        if not self.quiet:
            from rich.console import Console

            with suppress(OSError):  # nobody listens
                Console(stderr=True, soft_wrap=True, highlight=False).print(text, markup=False)

    def folder(self) -> Path | None:
        """Return the output folder, made if it is missing."""
        if self.output is None:
            return None
        try:
            self.made += [each for each in (self.output, *self.output.parents) if not each.exists()]
            self.output.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ArgumentError(f"`--output` {self.output} cannot be made a folder ({error.strerror}).") from None
        if not os.access(self.output, os.W_OK):
            raise ArgumentError(f"`--output` {self.output} is a folder in which nothing can be written.")
        return self.output

    def leave_no_empty_folder(self) -> None:
        """Take away the folders that were made and in which nothing was written."""
        for each in self.made:
            with suppress(OSError):
                each.rmdir()

    @property
    def rows(self) -> list[str] | None:
        """The names after --of; None where all states are meant."""
        return None if self.of is None else [name.strip() for name in self.of.split(",")]

    def part(self, plant: Plant) -> Plant:
        """Return the plant, or with --of what those rows of its state need."""
        from sampling_design.observability.count.functional import part_for

        part = part_for(plant, self.rows)
        if part is not plant:
            self.notice(part.explain())
        return part

    def wrote(self, *paths: Path, notes: Sequence[str] = ()) -> None:
        """Remember written files, so that they are named at the end, and say what is to be noted of them."""
        self.files += paths
        for note in notes:
            self.notice(note)

    def draw(self, record: object, name: str, **beside: Any) -> None:
        """Draw a record into the output folder, if there is one, with what the picture shows beside it."""
        folder = self.folder()
        if folder is not None and not self.no_picture:
            from sampling_design import plotting  # late: only a picture needs the plotting library

            self.wrote(plotting.save(record, folder / f"{name}.png", **beside))

    def named(self, data: Mapping[str, object]) -> dict[str, object]:
        """Return `data` with the name of its format first: its own, else that of what this command answers."""
        return {"format": f"sampling-design/{self.command}/1", **data}

    def write_json(self, data: Mapping[str, object], name: str) -> None:
        """Write a result with the name of its format into the output folder, if there is one."""
        folder = self.folder()
        if folder is not None:
            with atomic_file(folder / f"{name}.json") as write:
                for piece in json_pieces(self.named(data)):
                    write(piece.encode())
            self.wrote(folder / f"{name}.json")

    def finish(self, record: Record, data: Mapping[str, object], name: str, *tables: Table | str) -> None:
        """Write what a record holds and show it: its table, others, and what it says in words."""
        self.write_json(data, name)
        self.show(data, record_table(record), *tables, record.explain())

    def finish_early(self, data: Mapping[str, object], name: str, words: str) -> None:
        """Write and show what there is to say where the question does not arise."""
        self.write_json(data, name)
        self.show(data, words)

    def show(self, data: Mapping[str, object], *tables: Table | str) -> None:
        """Print the result on stdout: `data` with --json, else the tables; name the written files on stderr."""
        if self.as_json:
            sys.stdout.writelines(json_pieces(self.named(data)))
        self.show_tables(*tables)

    def show_tables(self, *tables: Table | str) -> None:
        """Print tables on stdout, unless JSON was asked for; name the written files on stderr."""
        if not self.as_json:
            from rich.console import Console

            # units in brackets are no markup, which would take them out
            console = Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else 110)
            for table in tables:
                if isinstance(table, str):  # a command to copy stays one line
                    console.print(table, soft_wrap=table.startswith("Next: "))
                else:
                    console.print(table)
        sys.stdout.flush()  # a full disk is found out here, not on Python's way out
        if self.files:
            self.notice("Written: " + ", ".join(str(f) for f in self.files))

    @contextmanager
    def progress(self, label: str) -> Iterator[Progress]:
        """Yield a callback (fraction, message) that draws a bar on stderr, if that is a terminal, unless --quiet."""
        if self.quiet:
            yield lambda fraction, message: None
            return
        with progress_bar(label) as report:
            yield report


def table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """Return a rich table; numbers to the right, words to the left."""
    from rich.table import Table

    result = Table(title=title, title_justify="left", header_style="bold")
    for i, name in enumerate(columns):
        numeric = bool(rows) and all(_is_number(row[i]) for row in rows)
        result.add_column(name, justify="right" if numeric else "left")
    for row in rows:
        result.add_row(*row)
    return result


def record_table(record: Record) -> Table:
    """Return the table of a record: of a result what it is, its evidence and how good it is, then the rows."""
    return rows_table(type(record).__name__, [*record._answered(3), *record._rows()])


def rows_table(title: str, rows: Sequence[tuple[str, str]]) -> Table:
    """Return a table of labels and values."""
    from rich.table import Table

    result = Table(title=title, title_justify="left", show_header=False)
    result.add_column(style="bold")
    result.add_column()
    for label, value in rows:
        result.add_row(label, value)
    return result


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return text in ("", "-")
    return True


def with_common_flags(function: Callable[..., None], command_name: str) -> Callable[..., None]:
    """Give `function(settings, ...)` the common flags in place of its first parameter, and a record's in its place."""
    declared = list(inspect.signature(function, eval_str=True).parameters.values())[1:]
    groups = {p.name: p.annotation for p in declared if isinstance(p.annotation, type) and is_dataclass(p.annotation)}
    own = [flag for p in declared for flag in (_flags(p.annotation) if p.name in groups else [p])]
    flags_of_this = flags_of(command_name)
    common = [COMMON_FLAGS[name] for name in flags_of_this]

    @functools.wraps(function)
    def from_flags(**arguments: Any) -> None:
        given = dict(arguments)
        flags = {name: arguments.pop(name) for name in flags_of_this}
        settings = Settings(command_name, **flags)
        try:
            settings.folder()  # that nothing can be written is said before the work, not after it
            if "seed" in flags:
                whole("seed", flags["seed"])
            if "budget" in flags:
                positive("budget", flags["budget"])
            for name, kind in groups.items():
                arguments[name] = kind(**{field.name: arguments.pop(field.name) for field in fields(kind)})
            function(settings, **arguments)
        except ArgumentError as error:  # what is wrong in a file is named by its key
            in_file = given.get("requirement_file") is not None
            _rename(error, [p for p in parameters if not in_file or given[p.name] != p.default])
            raise
        finally:
            settings.leave_no_empty_folder()

    keyword = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in own]
    parameters = [*keyword, *common]
    for flag in (*keyword, *common):
        _read_in_words(flag.annotation)
    # one unbroken line to copy: the mark keeps the paragraph from being filled
    from_flags.__doc__ = (function.__doc__ or "").replace("    Example: ", "    \b\n    Example: ")
    from_flags.__signature__ = inspect.Signature(keyword + common)  # type: ignore[attr-defined]
    from_flags.__annotations__ = {p.name: p.annotation for p in keyword + common}
    return from_flags


def _as_typed(parameter: inspect.Parameter) -> str:
    """The flag of a parameter as one types it; "" of one that is given by its place."""
    for mark in get_args(parameter.annotation):
        if isinstance(mark, OptionInfo):
            said = (mark.default, *(mark.param_decls or ()))  # the first name stands where a default would
            long = [each for each in said if isinstance(each, str) and each.startswith("--")]
            return (long[0] if long else "--" + parameter.name.replace("_", "-")).split("/")[0]
    return ""


def _rename(error: ArgumentError, parameters: Sequence[inspect.Parameter]) -> None:
    """Let the words of an error name the flags as they are typed, where the verb below named its own arguments."""
    text = str(error).replace("`path`", "the file")  # it is an argument of readers, and has no name where one types
    text = text.replace("a `record`", "MEASUREMENTS")
    for each in parameters:
        if flag := _as_typed(each):
            text = re.sub(rf"`{each.name}(?=[`\[.])", f"`{flag}", text)  # of one entry, too: `name[1]`, `name.key`
    error.args = (text, *error.args[1:])


def _read_in_words(annotation: object) -> None:
    """Let a flag that takes one number say in plain words what it was given instead."""
    kind, *marks = get_args(annotation) or (annotation,)
    kinds = set(get_args(kind) or (kind,)) - {NoneType}
    for mark in marks:
        if isinstance(mark, OptionInfo) and kinds in ({int}, {float}):
            whole_one = kinds == {int}
            mark.parser = _whole_number if whole_one else _number
            mark.metavar = mark.metavar or ("<int>" if whole_one else "<float>")


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        hint = (
            " Times stand in the plant's unit, without a letter; decimals have a point." if text[:1].isdigit() else ""
        )
        raise typer.BadParameter(f"{text!r:.60} is not a number.{hint}") from None


def _whole_number(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r:.60} is not a whole number.") from None


def _flags(kind: type) -> list[inspect.Parameter]:
    """The fields of a record as flags of their own."""
    hints = get_type_hints(kind, include_extras=True)
    return [
        inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=hints[f.name])
        for f in fields(kind)
        if get_origin(hints[f.name]) is Annotated
    ]


COMMON_FLAGS = {each.name: each for each in _flags(Settings)}
