"""How a record's declarations are read: templates of its table, and names of what its plain data holds."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import date
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar, cast, dataclass_transform

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_list, is_text
from sampling_design.records.arrays import Array

Plain: TypeAlias = "str | float | bool | Sequence[Plain] | Mapping[str, Plain] | None"
"""Plain data, as it stands in a file: texts, numbers, and lists and tables of them."""

Column: TypeAlias = "Sequence[object] | npt.NDArray[np.generic]"  # one column of a table

LARGE = 1e5  # of a time, in whatever unit: beyond it six digits leave less than a whole unit and a digit
ONE = 8 * np.finfo(float).eps  # of their size: times so near are one, up to the rounding of sums of gaps
PLAIN = 1e4  # below it a number is written without an exponent, however few of its digits are asked for
SHOWN = 8  # entries of an array that a line of a table holds

Converting = TypeVar("Converting")
Held = TypeVar("Held")
RecordClass = TypeVar("RecordClass")


@dataclass_transform(frozen_default=True, eq_default=False, field_specifiers=(field,))
def frozen(kind: type[RecordClass]) -> type[RecordClass]:
    """Make a frozen dataclass of a record with `Converted` fields."""
    return dataclass(frozen=True, eq=False, repr=False)(kind)


class Converted(Generic[Converting, Held]):
    """The kind of a field that `__post_init__` converts: it is given as one kind and held as another.

        times: Converted[npt.ArrayLike, Array]

    For the type checker it is a descriptor; when the program runs, the annotation is the kind that is held.
    """

    if TYPE_CHECKING:

        def __get__(self, record: object, kind: object = None) -> Held: ...
        def __set__(self, record: object, value: Converting) -> None: ...

    else:

        def __class_getitem__(cls, kinds):
            return kinds[1]


STEP = re.compile(r"-?\w+")
PLACE = re.compile(r"\{([\w.\[\]-]+)(?::(\d*)(up|down)?(?:or ([^}]*))?)?\}")
"""A place of a template: the path, the number of digits, which way it is rounded, and the word for what is absent."""
BOUNDS = {
    **dict.fromkeys(
        ("upper", "upper_bound", "lam", "lam_samples", "minimum", "C_x", "C_w", "C_v", "c_w", "c_y", "overshoot",
         "radii", "sigma_attained", "outer", "frequency_spread", "broken", "residual"), True,
    ),
    **dict.fromkeys(
        ("lower", "sigma", "late", "late_wider", "lost", "eta", "eta_tilde", "margin", "critical_length", "inner",
         "share", "kept", "level"), False,
    ),
}  # fmt: skip
"""Which way bounds are rounded where they are printed, by their names: up, so that no more is said than is proven."""
ITEM = re.compile(r"(\w+)(\?)?(?::([\w.\[\]-]+))?(?:\{([^{}]*)\})?")
"""An entry of plain data: the key, whether it may be left out, the path, and what of it is said."""


def said(record: object, template: str) -> str | None:
    """Return a template with what its places name, or None where one of them is None.

    Parameters
    ----------
    template : str
        "{eta} 1/{plant.time_unit}", "{margin:3}" with so many digits, "{name:or -}" with a word for what is None or
        empty (none: the line is left out), "{radius:down}" a bound that is not among `BOUNDS`.
    """
    absent = False

    def at(place: re.Match[str]) -> str:
        nonlocal absent
        path, digits, way, other = place.groups()
        value = _reached(record, path)
        if value is None or (other is not None and _empty(value)):
            absent = absent or not other
            return other or ""
        name = [step for step in STEP.findall(path) if step.isidentifier()][-1]
        up = BOUNDS.get(name) if way is None else way == "up"
        return in_words(value, int(digits or 6), up)

    text = PLACE.sub(at, template)
    return None if absent else text


def selected(record: object, what: str) -> dict[str, Plain]:
    """Return some attributes as plain data.

    Parameters
    ----------
    what : str
        Their names, "eta margin". "key:plant.time_unit" is one that stands elsewhere, "cost?" is left out where it is
        None or empty, and of "rows{names matrix}", or of each of them, no more than that is said.
    """
    return dict(_selection(record, what))


def columns(record: object, what: str) -> dict[str, Column]:
    """Return some attributes as the columns of a table, each as it is.

    Parameters
    ----------
    what : str
        "time:times lower upper", as `selected` reads names; of "points{samples sigma}" a column for each name.
    """
    columns: dict[str, Column] = {}
    for key, _, path, inner in ITEM.findall(what):
        value = cast("Sequence[object]", _reached(record, path or key))
        if not inner:
            columns[key] = value
        for name, _, own, _ in ITEM.findall(inner):
            columns[name] = [_reached(each, own or name) for each in value]
    return columns


def _selection(record: object, what: str) -> Iterator[tuple[str, Plain]]:
    for key, optional, path, inner in ITEM.findall(what):
        value = _reached(record, path or key)
        if not inner or value is None:
            if not (optional and _empty(value)):
                yield key, plain(value)
        elif is_list(value):
            yield key, [selected(each, inner) for each in value]
        else:
            yield key, selected(value, inner)


def _reached(value: object, path: str) -> object:
    """What stands at "plant.time_unit" or "times[-1]"; a method is asked, and None has nothing inside."""
    for step in STEP.findall(path):
        if value is None:
            return None
        value = getattr(value, step) if step.isidentifier() else cast("Sequence[object]", value)[int(step)]
        value = value() if callable(value) else value
    return value


def _empty(value: object) -> bool:
    if value is None or not hasattr(value, "__len__"):
        return value is None
    shape = getattr(value, "shape", None)
    return not value if shape is None else shape != () and not len(value)


def short(value: object, digits: int = 6, up: bool | None = None) -> str:
    """Return a number, or a short list of numbers, as text of `digits` significant digits.

    Parameters
    ----------
    up : bool, optional
        What is read back is no less than the number (an upper bound), or no more (False); None: the nearest.
    """
    numbers = np.asarray(value, dtype=float)
    if numbers.ndim == 0:
        return _digits(float(numbers), digits, up)
    flat = numbers.ravel()
    listed = ", ".join(_digits(float(v), digits, up) for v in flat[:SHOWN])
    return f"[{listed}{', ...' if flat.size > SHOWN else ''}]"


def _digits(value: float, digits: int, up: bool | None) -> str:
    nearest = f"{value:.{digits}g}"
    if up is None or not math.isfinite(value) or (float(nearest) >= value if up else float(nearest) <= value):
        return _plain(nearest)
    outward = Context(prec=digits, rounding=ROUND_CEILING if up else ROUND_FLOOR).create_decimal(value)
    return _plain(f"{float(outward):.{digits}g}")


def _plain(text: str) -> str:
    """The same number without an exponent that only says how few digits it has."""
    return f"{float(text):g}" if "e+" in text and abs(float(text)) < PLAIN else text


def below(value: object, digits: int = 6) -> str:
    """A lower bound as text: rounded down, so that it says no more than is proven."""
    return short(value, digits, up=False)


def above(value: object, digits: int = 6) -> str:
    """An upper bound as text: rounded up, so that it says no more than is proven."""
    return short(value, digits, up=True)


def probability(value: float, digits: int = 6, up: bool = False) -> str:
    """A probability as text that never says more than is so: rounded down, or up where it is an upper bound.

    Of one near 1 as many digits as leave two of what is missing: 1 is said of what is certain only.
    """
    missing = 1.0 - value
    digits = min(2 - math.floor(math.log10(missing)), 17) if 0 < missing < 10.0**-digits else digits
    return short(value, digits, up)


def moment(value: object, beside: npt.ArrayLike = ()) -> str:
    """A time, or a short list of times, as text: six digits, of large ones a thousandth of their unit as well.

    As many more as tell it from its neighbours in the list and in `beside`, such as the times at which a place closes,
    where these differ by more than rounding. Where clocks count seconds from 1970 on, six digits are twenty minutes.
    """
    times = np.asarray(value, dtype=float).ravel()
    size = float(np.max(np.abs(times), initial=0.0))
    least = min(int(np.log10(size)) + 4, 16) if LARGE <= size < np.inf else 6
    every = np.sort(np.concatenate([times, np.ravel(np.asarray(beside, dtype=float))]))
    every = every[np.isfinite(every)]
    every = every[np.append(True, np.diff(every) > ONE * np.abs(every[1:]))[: every.size]]
    at = np.searchsorted(every, times[: SHOWN + 1])[:, None] + np.array([-1, 0, 1])
    near = every[np.unique(np.clip(at, 0, every.size - 1))] if every.size else every
    told = (digits for digits in range(least, 17) if len({f"{t:.{digits}g}" for t in near}) == near.size)
    return short(value, next(told, 17))


_LETTERS = "αβγδεζηθικλμνξπρστυφχψωΓΔΘΛΞΠΣΦΨΩµ"
_NAMES = [
    "alpha", "beta", "gamma", "delta", "varepsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu", "nu",
    "xi", "pi", "rho", "sigma", "tau", "upsilon", "varphi", "chi", "psi", "omega", "Gamma", "Delta", "Theta", "Lambda",
    "Xi", "Pi", "Sigma", "Phi", "Psi", "Omega", "mu",
]  # fmt: skip

LATEX = str.maketrans(
    {c: rf"\{c}" for c in "&%$#_{}"}
    | {c: f"${c}$" for c in "<>|"}
    | {c: rf"$\{name}$" for c, name in zip(_LETTERS, _NAMES, strict=True)}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)
"""What LaTeX would read as a command, and what its oldest text fonts show as another sign."""


def in_latex(text: str) -> str:
    """Return text, a name as a user typed it too, as LaTeX shows it; a line's end is a blank."""
    return " ".join(text.translate(LATEX).split())


def latex_number(value: float, digits: int = 6, up: bool | None = None) -> str:
    """Return a number for LaTeX's mathematics, 1.6e-07 as a power of ten, rounded as by `short`."""
    text = short(value, digits, up)
    mantissa, _, power = text.partition("e")
    return rf"{mantissa} \cdot 10^{{{int(power)}}}" if power else text.replace("inf", r"\infty")


LINE, SMALL_LINE = 48, 78
"""Signs in a row of a matrix that a column of text holds, in its own size and in that of indices."""


def latex_matrix(values: Array) -> str:
    """Return a matrix for LaTeX's mathematics with six digits, in small type where its rows are long.

    With four digits where that is not enough, and "" where no page holds it.
    """
    for digits in (6, 4):
        cells = [[latex_number(float(v), digits) for v in row] for row in values]
        listed = [[re.sub(r"[\\{}^ ]|cdot", "", cell) for cell in row] for row in cells]
        width = sum(2 + max(map(len, column)) for column in zip(*listed, strict=True))
        if width <= SMALL_LINE:
            rows = " \\\\ ".join(map(" & ".join, cells))
            kind, columns = ("array", f"{{{'r' * len(cells[0])}}}") if width <= LINE else ("smallmatrix", "")
            return rf"\left[\begin{{{kind}}}{columns} {rows} \end{{{kind}}}\right]"
    return ""


def latex_table(head: Sequence[str], rows: Sequence[Sequence[str]], columns: str) -> str:
    """Return a `tabular` of cells that are LaTeX already."""
    lines = [rf"\begin{{tabular}}{{{columns}}}", f"  {' & '.join(head)} \\\\ \\hline"]
    lines += [f"  {' & '.join(row)} \\\\" for row in rows]
    return "\n".join([*lines, r"\end{tabular}"]) + "\n"


def in_words(value: object, digits: int = 6, up: bool | None = None) -> str:
    """Return a value as a table says it: numbers short, truths as yes or no, names and named values in a row."""
    match value:
        case bool() | np.bool_():
            return "yes" if value else "no"
        case float() | np.floating() | np.ndarray():
            return short(value, digits, up)
        case tuple() | list():
            return ", ".join(map(str, value)) if all(is_text(each) for each in value) else short(value, digits, up)
        case Mapping():
            return ", ".join(f"{name} = {in_words(each, digits, up)}" for name, each in value.items())
    return str(value)


def plain(value: object) -> Plain:
    """Return a value as plain data: arrays are lists, numbers that are not finite are None, records their `to_dict`."""
    match value:
        case np.ndarray() | np.generic():
            whole = value.dtype.kind != "f" or bool(np.isfinite(value).all())
            return cast("Plain", value.tolist()) if whole and value.dtype.kind != "c" else plain(value.tolist())
        case float():
            return value if math.isfinite(value) else None
        case complex():
            return [value.real, value.imag]
        case date():
            return value.isoformat()
        case Mapping():
            return {str(key): plain(each) for key, each in value.items()}
    if hasattr(value, "to_dict"):
        return cast("Plain", value.to_dict())
    if is_list(value):
        return [plain(each) for each in value]
    if is_dataclass(value):
        return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
    return cast("Plain", value)
