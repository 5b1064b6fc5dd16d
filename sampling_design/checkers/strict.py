"""Strict reading: text to plain data, and plain data to values of one exact type each. Standard library and numpy only.

A reader is a function of (value, place) that returns what the value means, or raises BadFile with one sentence that
names the place. No reader guesses: a boolean or a text is no number, a number is finite, a key is known and there once.
"""

import difflib
import json
import math
import re
from collections.abc import Callable, Collection, Mapping
from itertools import islice
from typing import Any, TypeGuard
from unicodedata import category

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Index = npt.NDArray[np.intp]
Reader = Callable[[object, str], Any]
Tree = dict[str, Any]
"""A table as a file holds it or a reader made it; the type of each key's value is not what a dictionary can say."""

MOST_BYTES = 100_000_000  # of one file; a family certificate of 400 nodes and 20 states has 5 million
MOST_ITEMS = 20_000_000  # values of one file
MOST_DEPTH = 20  # lists and tables inside each other; certificates have six levels
MOST_WHOLE = 2**53  # beyond it a double does not hold every whole number
NEAR = 0.6  # twice the letters that two words share over all of theirs: from here on one is a slip for the other
ALIKE = 0.5  # the same of two words that begin alike
PART = 3  # letters from which on a word that stands in another says that it is meant, and two words begin alike
CONTROLS = ("Cc", "Zl", "Zp", "Cs")  # Unicode's controls, ends of lines and half letters: no line holds them
LONGEST_NAME = 60  # letters of a name that a sentence repeats
MOST_LISTED = 12  # names that a sentence lists
ELSEWHERE: dict[str, list[str]] = {}
"""What others call a key, with ours: of messages only, and empty where an auditor stands alone."""


class BadFile(Exception):
    """Data that are not what the grammar of their file allows: one sentence that names the place.

    What is `broken` is their form, or the digest, which does not fit them.
    """

    def __init__(self, sentence: str, broken: str = "form") -> None:
        super().__init__(sentence)
        self.broken = broken

    def said(self, where: str = "") -> str:
        """The whole sentence, of the file `where`."""
        return (f"{where}: {self}" if where else f"{self}") + "." * (not f"{self}".endswith(("?", ".")))


def refuse(place: str, what: str) -> BadFile:
    """Return the sentence `place` `what` as an exception."""
    return BadFile(f"`{place}` {what}" if place else what)


def printed(value: object) -> str:
    """What came, in a few words."""
    names = {bool: "a boolean", str: "a text", dict: "a table", list: "a list", tuple: "a list"}
    if value is None:
        return "nothing (null)"
    kind = names.get(type(value), "")
    try:
        long = is_whole(value) and abs(value) > MOST_WHOLE
        text = "a whole number of many digits" if long else " ".join(repr(value).split())
    except (ValueError, RecursionError):  # the interpreter writes no number of thousands of digits, and no deep list
        text = ""
    return f"{kind} {text[:40]}{'...' * (len(text) > 40)}".strip() or f"a {type(value).__name__}"


# --- kinds of plain data ---------------------------------------------------------------------------------------------


def is_text(value: object) -> TypeGuard[str]:
    """Whether it is a text."""
    return isinstance(value, str)


def is_flag(value: object) -> TypeGuard[bool]:
    """Whether it is true or false."""
    return isinstance(value, (bool, np.bool_))


def is_whole(value: object) -> TypeGuard[int]:
    """Whether it is a whole number, written without a point; a truth value is none."""
    return isinstance(value, (int, np.integer)) and not is_flag(value)


def is_number(value: object) -> TypeGuard[float]:
    """Whether it is a real number, finite or not; a truth value is none."""
    return isinstance(value, (float, np.floating)) or is_whole(value)


def is_list(value: object) -> TypeGuard[list[object] | tuple[object, ...]]:
    """Whether it is a list."""
    return isinstance(value, (list, tuple))


def is_table(value: object) -> TypeGuard[Mapping[str, object]]:
    """Whether it is a table of keys and values."""
    return isinstance(value, Mapping)


# --- plain data ------------------------------------------------------------------------------------------------------


def plain(value: Mapping[str, object]) -> dict[str, object]:
    """The same data in tables, lists, texts, truth values, null and finite numbers, whatever Python held them in.

    BadFile for anything else: what holds itself or is too deep or large, numbers that no double holds.
    """
    if not is_table(value):
        raise refuse("", f"must hold one table, got {type(value).__name__}")
    found = _plain(value, "", [], [0])
    return dict(found) if is_table(found) else {}


def _plain(value: object, place: str, around: list[int], items: list[int]) -> object:
    items[0] += 1
    if items[0] > MOST_ITEMS:
        raise refuse("", f"holds more than {MOST_ITEMS} values")
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if value is None or is_flag(value):
        return value
    if is_number(value):
        found = number(value, place)
        return int(value) if is_whole(value) else found
    if is_text(value):
        return unicode(str(value))
    if not is_table(value) and not is_list(value):
        raise refuse(place, f"must be plain data, got a {type(value).__name__}")
    if id(value) in around:
        raise refuse(place, "must not hold itself")
    if len(around) >= MOST_DEPTH:
        raise refuse("", f"is nested more than {MOST_DEPTH} levels deep")
    inside = [*around, id(value)]
    if not is_table(value):
        return [_plain(item, f"{place}[{k}]", inside, items) for k, item in enumerate(value)]
    keys = [unicode(text(key, f"a key of {place or 'the file'}")) for key in value]
    return {
        key: _plain(item, f"{place}.{key}" if place else key, inside, items)
        for key, item in zip(keys, value.values(), strict=True)
    }


# --- text ------------------------------------------------------------------------------------------------------------


def decoded(content: bytes) -> str:
    """Return the text of a file's bytes."""
    if len(content) > MOST_BYTES:
        raise refuse("", f"is too large: {len(content)} bytes, expected at most {MOST_BYTES}")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise refuse("", "is not a text file (not UTF-8)") from None


def from_json(text: str) -> Tree:
    """Return the object in a JSON text: finite numbers, no key twice, no more than `MOST_DEPTH` levels."""
    shallow(text)
    try:
        data = json.loads(text, object_pairs_hook=unique, parse_constant=no_constant, parse_float=real, parse_int=whole)
    except json.JSONDecodeError as error:
        if not text.strip():
            raise refuse("", "is empty, expected one JSON object") from None
        line = f"line {error.lineno} ({error.msg})"
        raise refuse("", f"is not valid JSON at {line}. Was the file cut off?") from None
    if not is_table(data):
        raise refuse("", f"must hold one JSON object, got {type(data).__name__}")
    return dict(data)


def shallow(text: str) -> None:
    """Refuse more than `MOST_DEPTH` open brackets, texts between quotes left out."""
    depth = 0
    for bracket in re.findall(r"[][{}]", re.sub(r'"(?:[^"\\]|\\.)*"', "", text)):
        depth += 1 if bracket in "[{" else -1
        if depth > MOST_DEPTH:
            raise refuse("", f"is nested more than {MOST_DEPTH} levels deep")


def unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """A table whose keys occur once."""
    result = dict(pairs)
    if len(result) < len(pairs):
        keys = [key for key, _ in pairs]
        raise refuse("", f"key {next(key for key in keys if keys.count(key) > 1)!r} occurs twice")
    for word in (word for pair in pairs for word in pair if is_text(word)):
        unicode(word)
    return result


def unicode(word: str) -> str:
    """The text, if it is one that a file can hold."""
    if not word.isascii() and any("\ud800" <= letter <= "\udfff" for letter in word):
        raise refuse("", f"holds the text {word[:40]!a}, which is not Unicode")
    return word


def no_constant(word: str) -> float:
    """NaN and infinities."""
    raise refuse("", f"holds {word}, which is not allowed")


def real(word: str) -> float:
    """The double nearest to a decimal number, unless that is infinite, or zero by underflow."""
    value = float(word)
    if not math.isfinite(value):
        raise refuse("", f"holds {word[:40]}, which is not a finite double")
    if value == 0 and re.search("[1-9]", re.split("[eE]", word)[0]):
        raise refuse("", f"holds {word[:40]}, which is too small for a double")
    return value


def whole(word: str) -> int:
    """A whole number that a double holds."""
    if len(word) > 17 or abs(int(word)) > MOST_WHOLE:
        raise refuse(
            "", f"holds {word[:20]}{'...' * (len(word) > 20)}, a whole number beyond 2^53: write it with a point"
        )
    return int(word)


# --- single values ---------------------------------------------------------------------------------------------------


def number(value: object, place: str) -> float:
    """A finite number."""
    if type(value) is float and math.isfinite(value):  # nearly all of a long file
        return value
    if not is_number(value):
        raise refuse(place, f"must be a number, got {printed(value)}")
    if is_whole(value) and abs(value) > MOST_WHOLE:
        raise refuse(place, f"must be a number that a double holds, got {printed(value)}")
    if not math.isfinite(value):
        raise refuse(place, f"must be finite, got {value}")
    return float(value)


def positive(value: object, place: str) -> float:
    """A finite number > 0."""
    found = number(value, place)
    if found <= 0:
        raise refuse(place, f"must be positive, got {found!r}")
    return found


def nonnegative(value: object, place: str) -> float:
    """A finite number >= 0."""
    found = number(value, place)
    if found < 0:
        raise refuse(place, f"must not be negative, got {found!r}")
    return found


def count(value: object, place: str) -> int:
    """A whole number >= 0, written without a point."""
    if not is_whole(value) or not 0 <= value <= MOST_WHOLE:
        raise refuse(place, f"must be a whole number, got {printed(value)}")
    return int(value)


def bit(value: object, place: str) -> bool:
    """0 or 1, written as a number."""
    if not is_whole(value) or value not in (0, 1):
        raise refuse(place, f"must be 1 (measured) or 0, got {printed(value)}")
    return bool(value)


def flag(value: object, place: str) -> bool:
    """true or false."""
    if not is_flag(value):
        raise refuse(place, f"must be true or false, got {printed(value)}")
    return bool(value)


def text(value: object, place: str) -> str:
    """A text."""
    if not is_text(value):
        raise refuse(place, f"must be a string, got {printed(value)}")
    return str(value)


def is_line(text: str) -> bool:
    """Whether a text is one line of characters that are written: none that controls a terminal or ends a line."""
    return not any(category(character) in CONTROLS for character in text)


def line(value: object, place: str) -> str:
    """A text of one line."""
    if not is_line(found := text(value, place)):
        raise refuse(place, f"must be one line without control characters, got {found!r:.60}")
    return found


def label(value: object, place: str) -> str:
    """A name: a line that is not blank."""
    if not (found := line(value, place)).strip():
        raise refuse(place, f"must not be blank, got {found!r:.60}")
    return found


def word(*known: str) -> Reader:
    """Reader of one of these words."""

    def read(value: object, place: str) -> str:
        if not is_text(value) or value not in known:
            expected = repr(known[0]) if len(known) == 1 else f"one of {', '.join(known)}"
            came = f"{value!r:.60}" if is_text(value) else printed(value)
            sentence = f"must be {expected}, got {came}"
            raise refuse(place, sentence)
        return str(value)

    return read


def anything(value: object, place: str) -> object:
    """Plain data of any shape, numbers finite: provenance that decides nothing."""
    if is_table(value):
        return {text(key, place): anything(item, f"{place}.{key}") for key, item in value.items()}
    if is_list(value):
        return [anything(item, f"{place}[{k}]") for k, item in enumerate(value)]
    if value is not None and type(value) is not bool and not is_text(value):
        number(value, place)
    return value


def or_nothing(read: Reader) -> Reader:
    """Reader of null, or of what `read` reads."""
    return lambda value, place: None if value is None else read(value, place)


# --- lists, matrices, tables -----------------------------------------------------------------------------------------


def list_of(read: Reader, length: int | None = None) -> Reader:
    """Reader of a list whose items `read` reads, of that length if given."""

    def read_list(value: object, place: str) -> list[object]:
        if isinstance(value, np.ndarray):
            value = value.tolist()
        if not is_list(value):
            raise refuse(place, f"must be a list, got {printed(value)}")
        if length is not None and len(value) != length:
            raise refuse(place, f"must have a length of {length}, got {len(value)}")
        return [read(item, f"{place}[{k}]") for k, item in enumerate(value)]

    return read_list


def matrix(rows: int | None = None, columns: int | None = None) -> Reader:
    """Reader of a list of rows of finite numbers, all of one length; without rows it has the columns asked for."""

    def read(value: object, place: str) -> Array:
        if is_list(value) and value and not any(map(is_list, value)):
            raise refuse(place, f"must be a list of rows, got {printed(value)}. One row is [[...]], in two brackets")
        table = list_of(list_of(number))(value, place)
        wide = columns if columns is not None else len(table[0]) if table else 0
        if (rows is not None and len(table) != rows) or any(len(row) != wide for row in table):
            widths = sorted({len(row) for row in table})
            came = f"{len(table)} rows of {' or '.join(map(str, widths)) or 0} numbers"
            raise refuse(place, f"must have {'all' if rows is None else rows} rows of {wide} numbers, got {came}")
        return np.array(table, dtype=np.float64).reshape(len(table), wide)

    return read


def likely(word: str, known: Collection[str]) -> str:
    """What a word that is not known may have meant: what others call so, the nearest one, or all where none is near."""
    near = next((name for name in ELSEWHERE.get(word, ()) if name in known), nearest(word, known))
    return f"Did you mean {near!r}?" if near else f"Known: {listed(known)}."


def nearest(word: str, known: Collection[str]) -> str:
    """The name that a word is a slip for or a part of, or "": one letter names nothing but itself."""
    near, best = "", 0.0
    asked = word[:LONGEST_NAME].casefold()
    for name in known:
        found = name.casefold()
        share = difflib.SequenceMatcher(None, found, asked).ratio()
        long = min(len(found), len(asked)) >= PART
        part = found.startswith(asked) or (long and (found in asked or asked in found))
        slip = share >= (ALIKE if long and found[:PART] == asked[:PART] else NEAR)
        if share > best and (part or slip) and (len(found) > 1 or {*found} == {*asked}):
            near, best = name, share
    return near


def listed(names: Collection[str]) -> str:
    """Names side by side, the first few of many."""
    first = [repr(name[:LONGEST_NAME]) for name in islice(names, MOST_LISTED)]
    return ", ".join(first) + (f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else "")


def a_table(value: object, place: str) -> Mapping[str, object]:
    """Refuse what is no table."""
    if not is_table(value):
        raise refuse(place, f"must be a table of keys and values, got {printed(value)}")
    return value


def by_name(read: Reader) -> Reader:
    """Reader of a table whose keys are names of the writer's own, and whose items `read` reads."""
    return lambda value, place: {
        text(name, place): read(item, f"{place}.{name}") for name, item in a_table(value, place).items()
    }


def known_keys(
    value: object, place: str, needed: Collection[str], optional: Collection[str], whole: str
) -> Mapping[str, object]:
    """Refuse what is no table, an unknown key (naming the nearest known one), or one that is missing."""
    where = f"`{place}`" if place else whole
    found = a_table(value, place)
    for key in found:
        if key not in needed and key not in optional:
            slip = likely(str(key), [*needed, *optional])
            raise refuse("", f"unknown key {str(key)[:LONGEST_NAME]!r} in {where}. {slip}")
    for key in needed:
        if key not in found:
            raise refuse("", f"`{key}` is missing in {where}. Was the file cut off?")
    return found


def table(
    needed: Mapping[str, Reader], optional: Mapping[str, Reader] | None = None, whole: str = "the file"
) -> Reader:
    """Reader of a table with these keys, no more; optional ones may be left out; `whole` names one in no other."""
    readers = {**needed, **(optional or {})}

    def read(value: object, place: str) -> Tree:
        found = known_keys(value, place, needed, optional or (), whole)
        return {key: readers[key](item, f"{place}.{key}" if place else key) for key, item in found.items()}

    return read
