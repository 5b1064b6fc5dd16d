"""Files are read with one sentence on failure and written whole or not at all."""

from __future__ import annotations

import csv
import json
import math
import os
import re
import tempfile
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import accumulate, islice
from pathlib import Path

import numpy as np

from sampling_design.checkers import strict
from sampling_design.checkers.strict import Reader, Tree, is_list, nearest
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.records.arrays import Array

PIECES = 1 << 14  # tokens of JSON that are written at a time

FRAME = "the frame"  # where rows stand that no file holds
STAMPS = ("time", "date")  # names of the column that says when a row was measured
SINCE = "_since"  # ending of the column that says where a composite sample of an output began
UNTIL = "_until"  # ending of the column that says until when a row may have been measured
MISSING = ("", "-", "--", "nan", "na", "n/a", "#n/a", "nat", "null", "none")  # how programs write: not measured
_DECIMAL = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_WITH_UNIT = re.compile(r"[+-]?[\d.,]+(e[+-]?\d+)? ?[^\W\d_].*", re.ASCII | re.IGNORECASE)
_THOUSANDS = re.compile(r"[+-]?\d{1,3}([., ']\d{3})+([.,]\d+)?", re.ASCII)
_MINUS = "\N{MINUS SIGN}"  # that typesetters write
_DECIMAL_COMMA = re.compile(r"[<>]?[+-]?\d*,\d+([eE][+-]?\d+)?")
_MARKED = {  # a cell between separators that holds a number with this decimal mark
    mark: re.compile(
        rf'(?:^|[;\t])[ "]*(?:[<>] *)?[+-]?\d*{re.escape(mark)}\d+(?:[eE][+-]?\d+)?[ "]*(?:$|(?=[;\t]))', re.MULTILINE
    )
    for mark in ",."
}

_SEMICOLONS = re.compile(r"=\s*\[[^\]\"']*;")  # a matrix as other programs write it: [0 1; -1 0]
_BLANKS = re.compile(r"=\s*\[+\s*[-+]?[\d.]+[ \t]+[-+]?[\d.]")  # a row as other programs write it: [1 0]


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """Return the content of a file. Raises FileFormatError if the file is missing, is a folder, or cannot be read."""
    where = os.fspath(path)
    try:
        return Path(where).read_bytes()
    except OSError as error:
        raise _unreadable(where, error) from None


def read_text(path: str | os.PathLike[str]) -> str:
    """Return the text of a UTF-8 file, line ends as newlines.

    Raises FileFormatError if it is not text, or as in `read_bytes`.
    """
    content = read_bytes(path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise _no_text(os.fspath(path), content) from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _no_text(where: str, content: bytes) -> FileFormatError:
    """What a file that is no text seems to be, and what to do about it."""
    if content.startswith(b"PK"):
        words = "is a workbook (Excel) or another zip file. Save the table as csv (UTF-8)"
    else:
        words = "is not a text file (not UTF-8). Save it as UTF-8"
    return FileFormatError(f"{where}: {words}.", where)


def has_cells(line: str) -> bool:
    """Whether a line of a table holds anything: no comment, no line sep=; of a spreadsheet, not only empty cells."""
    return bool(line.strip(' \t\r\n;,"')) and not line.lstrip().startswith("#") and not line.startswith("sep=")


def text_lines(path: str | os.PathLike[str]) -> Iterator[str]:
    """Yield the lines of a UTF-8 file, without their ends; only the one that is read is held.

    Raises FileFormatError as `read_text`, where it comes to that.
    """
    where = os.fspath(path)
    try:
        with open(where, encoding="utf-8-sig") as stream:
            for line in stream:
                yield line.removesuffix("\n")
    except UnicodeDecodeError:
        raise _no_text(where, read_bytes(path)) from None
    except OSError as error:
        raise _unreadable(where, error) from None


def _unreadable(where: str, error: OSError) -> FileFormatError:
    match error:
        case FileNotFoundError():
            return FileFormatError(f"{where}: no such file.{_nearby(where)}", where)
        case IsADirectoryError():
            return FileFormatError(f"{where}: is a folder, expected a file.", where)
    return FileFormatError(f"{where}: cannot be read ({error.strerror}).", where)


def _nearby(where: str) -> str:
    """The file in the same folder that may have been meant."""
    with suppress(OSError, ValueError):
        names = [path.name for path in Path(where).parent.iterdir() if path.is_file()]
        name, stem, ending = Path(where).name, Path(where).stem, Path(where).suffix
        # an ending makes no two names alike, and a name with another ending must be the same
        named = [each for each in names if Path(each).suffix == ending or Path(each).stem in (name, stem) or not ending]
        stems = {Path(each).stem: each for each in sorted(named, reverse=True)}
        near = name if name in stems else nearest(stem, stems)
        return f" Did you mean {Path(where).with_name(stems[near])}?" if near else ""
    return ""


def is_column(name: str, *taken: str) -> bool:
    """Whether a CSV file gives this name of a column back, beside those that are taken."""
    return bool(name) and name == name.strip() and name not in taken and not any(c in name for c in "\r\n")


def check_columns(argument: str, names: Sequence[str]) -> None:
    """Refuse names of sensors that a form or a schedule would not give back as columns of their own.

    Raises ArgumentError where a name is taken by the times, or by the beginnings of another sensor's composite samples.
    """
    taken = [*STAMPS, *(stamp + UNTIL for stamp in STAMPS), *(name + SINCE for name in names)]
    for name in names:
        if not is_column(name, *taken) or name.startswith("#"):
            raise ArgumentError(
                f"`{argument}`: {name!r:.60} cannot be the column of a sensor in a CSV file. Taken are time and date, "
                "these with _until, and the name of a sensor with _since; # begins a comment, and a name has one line."
            )


def separator(header: str) -> str:
    """What separates the cells of a CSV file with this header: a comma, a semicolon or a tab."""
    return max(",;\t", key=header.count) if header.count(",") == 0 else ","


def csv_rows(lines: Iterable[tuple[int, str]], where: str, mark: str = "") -> list[tuple[int, list[str]]]:
    """Return the cells of numbered lines of a CSV file, the first of which is its header unless `mark` separates cells.

    Cells are separated by what separates the header: a comma, a semicolon or a tab. Spreadsheets in many languages
    write semicolons and then a decimal comma; there a cell such as 0,5 is the number 0.5. Raises FileFormatError if a
    quote is left open, a cell is beyond all measure, or a file has decimal commas and decimal points.
    """
    rows: list[tuple[int, list[str]]] = []
    lines = list(lines)
    if not mark and lines:
        mark = separator(lines[0][1])
        one_decimal_mark(lines, where, mark)
    for number, line in lines:
        try:
            row = next(csv.reader([line], delimiter=mark, strict=True))
        except csv.Error as error:
            why = "a line ends within a cell" if "new-line" in str(error) else error
            raise FileFormatError(
                f"{where}, {row_name(where, number)}: cannot be read as cells ({why}). Was a quote left open?", where
            ) from None
        cells = [cell.strip() for cell in row]
        if mark != ",":
            cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
        rows.append((number, cells))
    return rows


def one_decimal_mark(
    lines: Sequence[tuple[int, str]], where: str, separated: str, before: frozenset[str] = frozenset()
) -> frozenset[str]:
    """Return which of comma and point the numbers of a file have, up to and with these lines.

    Where a comma separates no cells, it may be a decimal one. Raises FileFormatError for 1.234 beside 0,5, which may be
    1234 or 1.234.
    """
    if separated == ",":
        return before
    marks = before | _decimal_marks("\n".join(line for _, line in lines))
    if len(marks) > 1:
        so_far = accumulate((_decimal_marks(line) for _, line in lines), frozenset.union, initial=before)
        number = next(
            number for (number, _), found in zip(lines, islice(so_far, 1, None), strict=True) if len(found) > 1
        )
        raise FileFormatError(
            f"{where}: {row_name(where, number)} has a decimal point where others have a decimal comma, or the other "
            "way round, so that one may stand for thousands. Write all numbers in one way.",
            where,
        )
    return marks


def _decimal_marks(text: str) -> frozenset[str]:
    """Those that stand in cells which hold nothing but a number or its limit."""
    return frozenset(mark for mark, number in _MARKED.items() if number.search(text))


def row_name(where: str, line: int) -> str:
    """What a message calls a line: of a frame, whose header is no row, the row, counted from 1."""
    return f"row {line - 1}" if where == FRAME else f"line {line}"


def csv_cell(text: str) -> str:
    """Return text as a cell of a CSV file: in quotes where it holds a comma, a quote or the end of a line."""
    return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\n\r') else text


def decimal(cell: str) -> float | None:
    """Return the number in a cell; None where there is none, or none that a double holds.

    Stricter than `float`: no words (nan, inf), no underscores, no digits of other scripts, no zero by underflow.
    """
    try:
        return strict.real(cell) if _DECIMAL.fullmatch(cell) else None
    except strict.BadFile:
        return None


def number_slip(cell: str, where: str = "") -> str:
    """The likely slip in a cell that holds no number."""
    if (point := cell.replace(",", ".")) != cell and decimal(point) is not None:
        if where == FRAME:
            return (
                f" Write {point}: pandas reads a file of such numbers with decimal=',', polars with decimal_comma=True."
            )
        return f" Write {point}, or separate cells by semicolons: then a comma is a decimal one."
    if (minus := cell.replace(_MINUS, "-")) != cell and decimal(minus) is not None:
        return f" Write {minus}: its minus is another sign, a dash of print."
    if _DECIMAL.fullmatch(cell):
        return " No double is so large, or so small."
    if _THOUSANDS.fullmatch(cell):
        return " Thousands are not separated."
    return " A cell holds the number alone; its unit stands in the plant." if _WITH_UNIT.fullmatch(cell) else ""


def decimals(cells: Sequence[str], commas: bool, blank: bool) -> Array | None:
    """Return the numbers of a column of cells, NaN for an empty one where `blank`; None where `decimal` finds none.

    With `commas` a cell may hold a decimal comma.
    """
    if commas:
        cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
    number = _DECIMAL.fullmatch
    if not all(number(cell) or (blank and not cell) for cell in cells):
        return None
    values = np.array([float(cell) if cell else np.nan for cell in cells])
    if np.isinf(values).any() or any(decimal(cells[k]) is None for k in map(int, np.flatnonzero(values == 0))):
        return None
    return values


@contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Callable[[bytes], None]]:
    """Open a file that is written piece by piece beside its place, and stands there whole or not at all.

    What this yields adds to it. At the end it is renamed into place, on any error it is removed. Raises FileFormatError
    if the folder is missing or cannot be written.
    """
    target = Path(path)
    with _writing(target):
        handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
        stream = os.fdopen(handle, "wb")

    def write(content: bytes) -> None:
        with _writing(target):
            stream.write(content)

    try:
        yield write
        with _writing(target):
            stream.flush()
            os.fsync(stream.fileno())
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(temporary, 0o666 & ~umask)
            os.replace(temporary, target)
    finally:
        with suppress(OSError):  # what could not be flushed is removed below
            stream.close()
        Path(temporary).unlink(missing_ok=True)


@contextmanager
def _writing(target: Path) -> Iterator[None]:
    """Say of an error of the disk which file it is of."""
    try:
        yield
    except OSError as error:
        raise FileFormatError(f"{target}: cannot be written ({error.strerror}).", str(target)) from None


def write_bytes(path: str | os.PathLike[str], content: bytes) -> Path:
    """Write `content` to a temporary file beside `path`, then rename it into place.

    Raises FileFormatError if the folder is missing or cannot be written.
    """
    with atomic_file(path) as write:
        write(content)
    return Path(path)


def write_text(path: str | os.PathLike[str], text: str) -> Path:
    """Write `text` as UTF-8, whole or not at all (see `write_bytes`)."""
    return write_bytes(path, text.encode("utf-8"))


def to_json(data: Mapping[str, object]) -> str:
    """Return `data` as indented JSON; floats as shortest repr, NaN and infinity refused."""
    return json.dumps(data, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def json_pieces(data: Mapping[str, object]) -> Iterator[str]:
    """Yield the text of `to_json` piece by piece, for data that are larger than their text should be held.

    A vector is written as the list of its numbers, null where one is not finite; no list of them is held for long.
    """
    arrays: list[Array] = []

    def kept(value: object) -> str:
        if not isinstance(value, np.ndarray):
            raise TypeError(f"{type(value).__name__} has no JSON")
        arrays.append(value)
        return _ARRAY

    tokens = json.JSONEncoder(indent=2, allow_nan=False, ensure_ascii=False, default=kept).iterencode(data)
    depth, held = "", list[str]()
    for token in tokens:
        if arrays:  # the token that stands for the vector that was met last
            yield "".join(held)
            held = []
            yield from _listed(arrays.pop(), depth)
            continue
        if "\n" in token:
            depth = token[token.rindex("\n") :]
        held.append(token)
        if len(held) >= PIECES:
            yield "".join(held)
            held = []
    yield "".join([*held, "\n"])


_ARRAY = ""  # what stands for a vector until its numbers are written


def _listed(values: Array, depth: str) -> Iterator[str]:
    """The numbers of a vector as a file holds them, on lines of their own one step in from `depth`."""
    mark = f"{depth}  "
    for low in range(0, values.size, PIECES):
        numbers = values[low : low + PIECES].tolist()
        texts = [repr(number) if math.isfinite(number) else "null" for number in numbers]
        yield ("[" if low == 0 else ",") + mark + f",{mark}".join(texts)
    yield f"{depth}]" if values.size else "[]"


def from_json(text: str, where: str) -> Tree:
    """Return the object in a JSON text.

    Raises FileFormatError if it is cut off, is not JSON, is no object, repeats a key, or holds NaN or infinity.
    """

    try:
        _small(text)
        return strict.from_json(text)
    except strict.BadFile as error:
        raise FileFormatError(error.said(where), where) from None


def from_toml(text: str, where: str) -> Tree:
    """Return the tree in a TOML text.

    Raises FileFormatError if it is cut off, is not TOML, repeats a key, or holds what is no text, truth value or finite
    number.
    """
    try:
        _small(text)
        strict.shallow(text)
        return {key: strict.anything(value, key) for key, value in tomllib.loads(text, parse_float=strict.real).items()}
    except strict.BadFile as error:
        raise FileFormatError(error.said(where), where) from None
    except tomllib.TOMLDecodeError as error:
        slip = "Was the file cut off?"
        if _SEMICOLONS.search(text):
            slip = "Rows stand in brackets of their own: A = [[0.0, 1.0], [-1.0, 0.0]]."
        elif _BLANKS.search(text):
            slip = "Numbers have commas between, and a row stands in two brackets: C = [[1.0, 0.0]]."
        raise FileFormatError(f"{where}: is not valid TOML ({error}). {slip}", where) from None
    except (RecursionError, ValueError):
        said = f"{where}: is nested too deeply, or holds a number of thousands of digits."
        raise FileFormatError(said, where) from None


def _small(text: str) -> None:
    if len(text) > strict.MOST_BYTES:
        raise strict.refuse("", f"is too large: {len(text)} characters, expected at most {strict.MOST_BYTES}")


def exactly(read: strict.Reader, data: Mapping[str, object]) -> None:
    """Refuse plain data whose types are not exactly those of its grammar (no booleans or texts as numbers).

    Raises
    ------
    ArgumentError
        With the sentence of the strict reader.
    """
    try:
        read(data, "")
    except strict.BadFile as error:
        raise ArgumentError(error.said()) from None


def read_tree(path: str | os.PathLike[str]) -> dict[str, object]:
    """Return the tree of a `.json` file, or of a TOML file with any other ending.

    Raises FileFormatError if the file is missing or cut off.
    """
    where = os.fspath(path)
    content = read_text(where)
    return (from_json if Path(where).suffix.lower() == ".json" else from_toml)(content, where)


def write_tree(path: str | os.PathLike[str], data: Mapping[str, object], what: str) -> Path:
    """Write a tree as `.toml` or `.json`, whole or not at all; `what` it is, with its article, for messages.

    Raises FileFormatError if the ending is neither, or the file cannot be written.
    """
    ending = Path(path).suffix.lower()
    if ending == ".json":
        return write_text(path, to_json(data))
    if ending != ".toml":
        raise FileFormatError(f"{path}: {what} file ends in .toml or .json, got {ending!r}.", os.fspath(path))
    import tomli_w

    return write_text(path, tomli_w.dumps(data))


def by_kind(kinds: Mapping[type, Reader], other: Reader) -> Reader:
    """Return what reads a value that may be of several kinds, each with its reader, and whatever else with `other`."""

    def read(value: object, place: str) -> object:
        return next((reader for kind, reader in kinds.items() if isinstance(value, kind)), other)(value, place)

    return read


def by_first(kinds: Mapping[type, Reader], other: Reader) -> Reader:
    """Return what reads a list of things that may be of several kinds, by its first entry, and whatever else."""

    def read(value: object, place: str) -> object:
        first = value[0] if is_list(value) and value else None
        return next((reader for kind, reader in kinds.items() if isinstance(first, kind)), other)(value, place)

    return read


def of_format(read: Reader, data: Mapping[str, object], name: str) -> Tree:
    """Return what a grammar reads of plain data that begin with the line `format`, without that line.

    Raises ArgumentError if that line is missing; strict.BadFile if the data do not keep to the grammar.
    """
    if data and "format" not in data:
        raise ArgumentError(f'`format` is missing: the file begins with the line format = "{name}".')
    tree: Tree = read(data, "")
    del tree["format"]
    return tree


@contextmanager
def usable(where: str) -> Iterator[None]:
    """Say of what is refused inside that it stands in the file `where`, which cannot be used.

    Raises
    ------
    FileFormatError
        With the sentence of the strict reader or of the argument that was refused.
    """
    try:
        yield
    except strict.BadFile as error:
        raise FileFormatError(error.said(f"{where}: cannot be used"), where) from None
    except ArgumentError as error:
        raise FileFormatError(f"{where}: cannot be used: {error}", where) from None
