"""What all records share: a one-line repr, a small table, an HTML table, words, and a picture.

A record says once, beside its fields, what its table shows (`_table`) and what its plain data holds (`_plain`); text,
HTML and `to_dict` are made from that. A record that computes a line overrides `_rows`, or `to_dict`.

    _table = {"eta": "{eta} 1/{plant.time_unit}", "margin": "{margin:3}", "critical length": "{critical_length:or -}"}
    _plain = "eta margin time_unit:plant.time_unit rows{names matrix} claim"

What a verb of the front door returns says five things first, in one order and under one set of labels (`ANSWERS`):
`_answers` holds the first four, the last is known from what draws it.

What stands behind a number: a claim with its theorem, and a record of the solver that found it.
"""

from __future__ import annotations

import inspect
from abc import ABCMeta
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from html import escape
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, NamedTuple, Self, TypeVar, overload

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.parts import FORMAT, digest
from sampling_design.checkers.strict import Tree, is_text, is_whole, likely
from sampling_design.errors import ArgumentError, CallError, MissingExtraError, UndecidedError
from sampling_design.records import checks
from sampling_design.records.declarations import Column, columns, plain, said, selected
from sampling_design.records.declarations import Plain as Plain
from sampling_design.records.declarations import above as above
from sampling_design.records.declarations import below as below
from sampling_design.records.declarations import moment as moment
from sampling_design.records.declarations import probability as probability
from sampling_design.records.declarations import short as short
from sampling_design.records.dispatch import offered
from sampling_design.records.signatures import checked_methods, misfit, within

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

Strength = Literal["proven", "attained", "sampled"]


@dataclass(frozen=True)
class Claim:
    """A statement with its source and its strength.

    `strength` is "proven" (a theorem and a computed bound), "attained" (a witness reaches it) or
    "sampled" (only looked at in places; evidence, not proof).
    """

    statement: str
    theorem: str = ""
    assumptions: tuple[str, ...] = ()
    strength: Strength = "proven"
    citation: str = ""

    def to_dict(self) -> dict[str, Plain]:
        """Plain data; tuples become lists."""
        data = asdict(self)
        data["assumptions"] = list(self.assumptions)
        return data

    @property
    def evidence(self) -> str:
        """How strong it is, and by which theorem."""
        return f"{self.strength}: {self.theorem}" if self.theorem else self.strength

    def __str__(self) -> str:
        source = f" [{self.theorem}]" if self.theorem else ""
        given = f" given {'; '.join(self.assumptions)}" if self.assumptions else ""
        return f"{self.strength}: {self.statement}{source}{given}"


@dataclass(frozen=True)
class SolverRecord:
    """Which solver ran and how it ended. Never evidence, only provenance.

    `seconds` is what files of before say; how long it took is not written any more, so that the same call gives the
    same file.
    """

    name: str
    version: str = ""
    status: str = ""
    iterations: int = 0
    details: Mapping[str, Plain] = field(default_factory=dict)
    seconds: float | None = None

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        return {key: value for key, value in asdict(self).items() if value is not None}


def with_digest(plant: object, parts: Mapping[str, object], **after: object) -> Tree:
    """Return the plain data of a certificate: what every claim's file holds around its own `parts`, digest included."""
    from sampling_design import __version__  # which stands above every room

    data: Tree = {
        "format": FORMAT,
        "plant": plain(plant),
        **{key: plain(part) for key, part in parts.items()},
        "tool": {"name": "sampling_design", "version": __version__},
        **{key: plain(part) for key, part in after.items()},
    }
    data["digest"] = digest(data)
    return data


Listed = TypeVar("Listed")
ANSWERS = ("what", "evidence", "how good", "how to check", "how to draw")
"""What every result says, in this order; evidence is proven, attained or sampled (`Claim.strength`), or none."""


class _RecordType(ABCMeta):
    """The class of the classes of records: a call that does not fit their fields ends in one sentence."""

    @property
    def __signature__(cls) -> inspect.Signature:
        """What the fields take: help and editors would show the call below, which takes anything."""
        own = inspect.signature(cls.__init__)  # type: ignore[misc]  # of a class, which a metaclass sees as an instance
        return own.replace(parameters=list(own.parameters.values())[1:])

    if not TYPE_CHECKING:  # a checker would take every call for one that fits

        def __call__(cls, *arguments: object, **options: object) -> object:
            try:
                made = super().__call__(*arguments, **options)
            except TypeError as error:
                if within() or error.__traceback__.tb_next is not None:
                    raise
                raise misfit(cls.__init__, (cls, *arguments), options, error) from None
            for name, value in vars(made).items():  # whoever made it may go on with an array of their own
                if type(value) is np.ndarray and value.flags.writeable:
                    vars(made)[name] = owned = value.copy()
                    owned.flags.writeable = False
            return made


class Displayable:
    """What shows itself: `repr` in one line, `str` as a small table, `_repr_html_` for notebooks."""

    _answers: ClassVar[tuple[str, ...]] = ()
    """Of a result: the first four of `ANSWERS`, templates as `said` reads them."""
    _table: ClassVar[Mapping[str, str]] = {}
    """Label and value of each line, templates as `said` reads them."""

    def _answered(self, most: int = len(ANSWERS)) -> list[tuple[str, str]]:
        """The first so many of `ANSWERS` with what a result says; none of what is no result."""
        if not self._answers:
            return []
        picture = offered("picture", self, object)
        drawn = "`.plot()`" if picture is not None and picture(self) else "no picture of its own"
        texts = (*(said(self, each) for each in self._answers), drawn)
        return [(label, text) for label, text in zip(ANSWERS[:most], texts, strict=False) if text]

    def _lines(self) -> list[tuple[str, str]]:
        """What is shown: what it is, its evidence and how good it is; the rows; how to check and to draw it."""
        first = self._answered()
        return [*first[:3], *self._rows(), *first[3:]]

    def _rows(self) -> list[tuple[str, str]]:
        """Label and value of each line of the table, in order; a line about what is None is left out."""
        if not self._table:
            raise NotImplementedError
        lines = ((said(self, label), said(self, value)) for label, value in self._table.items())
        return [(label, value) for label, value in lines if label is not None and value is not None]

    def _title(self) -> str:
        return type(self).__name__

    def __repr__(self) -> str:
        first = [text for _, text in self._answered(3)[2:]]
        rows = [
            f"{label.replace(',', '').replace(' ', '_')}={value}" for label, value in self._rows()[: 4 - len(first)]
        ]
        inside = ", ".join([*first, *rows])
        return f"{self._title()}({inside})".replace("\n", " ")

    def __str__(self) -> str:
        rows = self._lines()
        width = max((len(label) for label, _ in rows), default=0)
        return "\n".join([self._title(), *(f"  {label:<{width}}  {value}" for label, value in rows)])

    def _repr_html_(self) -> str:
        body = "".join(
            f"<tr><th style='text-align:left'>{escape(label)}</th><td style='text-align:left'>{escape(value)}</td></tr>"
            for label, value in self._lines()
        )
        return f"<table><caption>{escape(self._title())}</caption>{body}</table>"


class Record(Displayable, metaclass=_RecordType):
    """Base of the frozen records: `repr` one line, `str` a small table, `_repr_html_` for notebooks.

    Every public method of a record has a door before it (see `signatures`).
    """

    def __init_subclass__(cls, **options: object) -> None:
        super().__init_subclass__(**options)
        checked_methods(cls)

    def _hold(self, **values: object) -> None:
        """Set fields of a record that is being made; afterwards it is frozen."""
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _check(self, **asked: Callable[[str, object], object]) -> None:
        """Hold each of these fields as its check returns it; None, where nothing need be said, stays None."""
        said = {name: getattr(self, name) for name in asked}
        unsaid = {each.name for each in fields(self) if each.default is None or "None" in each.type}  # type: ignore[arg-type]
        held = {name: value for name, value in said.items() if value is not None or name not in unsaid}
        self._hold(**{name: asked[name](name, value) for name, value in held.items()})

    def explain(self) -> str:
        """Say in one or two sentences what this record means."""
        raise NotImplementedError

    def plot(self, ax: object = None, **beside: object) -> Any:
        """Draw this record on `ax` (a new figure if None) and return the axes; `beside`: what else it shows."""
        return draw(self, ax, **beside)


class PlainRecord(Record):
    """Base of the records that are plain data too, for files and other programs."""

    _plain: ClassVar[str] = ""
    """What the data holds, as `selected` reads it; all fields where nothing is said."""

    def to_dict(self) -> dict[str, Plain]:
        """Plain data: arrays are lists, what is infinite or no number is None."""
        return selected(self, self._plain or " ".join(each.name for each in fields(self)))  # type: ignore[arg-type]


class WrittenRecord(PlainRecord):
    """Base of the records that a user writes by hand, and changes entry by entry."""

    _written: ClassVar[str]
    """What it is called in messages."""

    def replace(self, **changes: object) -> Self:
        """Return a copy with some entries changed.

        Raises
        ------
        ArgumentError
            If an entry is unknown, or as for the record itself.
        """
        known = {each.name: getattr(self, each.name) for each in fields(self)}  # type: ignore[arg-type]
        checks.known_keys(self._written, changes, known)
        return type(self)(**{**known, **changes})


class YesOrNo(Record):
    """Base of the records that answer yes or no: `bool()` is the answer, and an undecided one refuses to be either.

    `_asked` names the attribute that tells the three apart.
    """

    _asked: ClassVar[str]

    def _answer(self) -> bool | None:
        """The answer; None where the question stayed undecided."""
        raise NotImplementedError

    def __bool__(self) -> bool:
        answer = self._answer()
        if answer is None:
            raise UndecidedError(
                f"An undecided {type(self).__name__} is neither true nor false: ask `.{self._asked}`, and `.explain()` "
                "for what is open."
            )
        return answer


class ListRecord(Record, Generic[Listed]):
    """Base of the records that are a list: `len(record)`, `record[-1]`, `record[2:5]`, `for each in record`."""

    _frame: ClassVar[str] = ""
    """The columns, as `columns` reads them; a record that computes one overrides `_columns`."""

    def _columns(self) -> Mapping[str, Column]:
        """Every column by its name, all of one length; the first one tells the rows apart."""
        return columns(self, self._frame)

    def to_frame(self) -> DataFrame:
        """Return the rows as a pandas DataFrame (extra `dataframes`), indexed by the first column, in physical units.

        For polars: `polars.DataFrame(record.to_frame().reset_index().to_dict("list"))`.

        Raises
        ------
        MissingExtraError
            If pandas is not installed.
        """
        try:
            import pandas
        except ImportError:
            raise MissingExtraError("pandas", "dataframes") from None
        columns = self._columns()
        return pandas.DataFrame(columns).set_index(next(iter(columns)))

    def _entries(self) -> Sequence[Listed]:
        """What is counted and iterated."""
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self._entries())

    def __iter__(self) -> Iterator[Listed]:
        return iter(self._entries())

    def _where(self, name: str) -> str:
        """What leads to an entry of this name, or to that which was meant, in a sentence, or nothing."""
        return ""

    @overload
    def __getitem__(self, place: int) -> Listed: ...
    @overload
    def __getitem__(self, place: slice) -> list[Listed]: ...
    def __getitem__(self, place: int | slice) -> Listed | list[Listed]:
        entries = self._entries()
        if isinstance(place, slice):
            return list(entries[place])
        if not is_whole(place):
            where = self._where(place) if is_text(place) else ""
            raise CallError(f"`place` must be a whole number or a slice, got {checks.described(place)}.{where}")
        if not -len(entries) <= place < len(entries):
            raise IndexError(
                f"`place` = {place} is outside: this {type(self).__name__} has {counted(len(entries), 'row')}."
            )
        return entries[place]


class TableRecord(ListRecord[dict[str, object]]):
    """Base of the records that are a table, one row per estimate, sample, count or window: a list of its rows."""

    def _entries(self) -> Sequence[dict[str, object]]:
        """Each row by the names of its columns."""
        names = tuple(columns := self._columns())
        plain = (getattr(column, "tolist", lambda column=column: column)() for column in columns.values())
        return [dict(zip(names, row, strict=True)) for row in zip(*plain, strict=True)]

    def _where(self, name: str) -> str:
        known = [*self._columns()]
        return f" A row has it: [0][{name!r}]; all rows: to_frame()." if name in known else f" {likely(name, known)}"

    def __bool__(self) -> bool:
        return True  # a result is there, however many rows it has


class Variable(NamedTuple):
    """An array with a name for each of its axes, and the unit of its entries ("" where there is none or several)."""

    axes: tuple[str, ...]
    values: npt.ArrayLike
    unit: str = ""


class CurveRecord(Record):
    """Base of the records that hold curves: over time, over a period, or over the positions of a window."""

    def _variables(self) -> dict[str, Variable]:
        """The arrays by their names; one that is named like its only axis is that axis's coordinate."""
        raise NotImplementedError

    def to_xarray(self) -> Dataset:
        """Return the curves as an xarray Dataset (extra `datasets`): axes by name, units as attributes, physical units.

        Raises
        ------
        MissingExtraError
            If xarray is not installed.
        """
        try:
            import xarray
        except ImportError:
            raise MissingExtraError("xarray", "datasets") from None
        made = {
            name: (list(v.axes), np.asarray(v.values), {"units": v.unit} if v.unit else {})
            for name, v in self._variables().items()
        }
        axes = {name for name, v in self._variables().items() if v.axes == (name,)}
        return xarray.Dataset(
            {name: value for name, value in made.items() if name not in axes},
            {name: value for name, value in made.items() if name in axes},
            {"record": type(self).__name__},
        )


def draw(record: object, ax: object = None, **beside: object) -> Any:
    """Hand `record` to the ring that draws.

    Raises ArgumentError if it is not there, or has no picture for this kind of record.
    """
    drawn = offered("plot", record, object)
    if drawn is None:
        raise ArgumentError(f"`record` has no picture: nothing that draws a {type(record).__name__} is installed.")
    return drawn(record, ax, **beside)


def counted(number: int, what: str) -> str:
    """Return "1 sample", "2 samples"."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def markdown_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table in markdown, without the end of its last line."""
    lines = [heads, ["---"] * len(heads), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
