"""Arguments become owned, read-only float64 arrays here, once, with one grammar of messages.

The grammar: the argument as typed, what was expected, what came, and the likely slip.
"""

from __future__ import annotations

import numbers
import os
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import MISSING, fields
from inspect import isclass, signature
from typing import Any, TypeAlias, TypeGuard, TypeVar, get_args

import numpy as np
import numpy.typing as npt

from sampling_design.checkers import strict
from sampling_design.checkers.strict import is_flag, is_list, is_number, is_text, is_whole, likely
from sampling_design.errors import ArgumentError
from sampling_design.records.arrays import Array, Mask, freeze

Instance = TypeVar("Instance")
Seed: TypeAlias = np.random.Generator | int | None
"""What random numbers are drawn from: a generator, its seed, or None for the seed 0."""
_OTHERS = {
    "rng seed": "seed random_state random_seed generator",
    "dt step": "Ts sampling_time h",
    "grid dt": "step raster interval resolution",
    "time_unit": "unit units timeunit",
    "window horizon duration": "length T N span",
    "eta decay_rate": "rate decay lam",
    "eta": "decay_rate",
    "decay_rate": "eta",
    "horizon": "window",
    "window": "horizon",
    "calendar": "hours opening_hours opening timezone zone",
    "rtol": "tol tolerance eps reltol",
    "budget": "timeout seconds time_limit max_seconds",
    "workers": "n_jobs jobs processes pool",
    "progress": "callback verbose",
    "path": "file filename fname",
    "w_bound w_intensity": "w disturbance disturbance_bound",
    "v_bound v_deviation": "v noise noise_bound",
    "Qw w_intensity": "W Q",
    "prior x0": "x0 initial_state mean",
    "initial_error": "P0 prior_error",
    "runs": "n_runs trials n_trials",
    "samples count": "n_samples",
    "samples": "count",
    "count": "samples",
    "gaps": "times period",
    "of": "rows wanted",
}
ELSEWHERE = {word: ours.split() for ours, theirs in _OTHERS.items() for word in theirs.split()}
"""What other packages, and the field, call an argument that has another name here; the likeliest of ours first."""
strict.ELSEWHERE.update(ELSEWHERE)  # keys of files are told, too


def takes(function: Callable[..., object], count: int) -> bool:
    """Whether a function can be called with so many arguments; one that does not tell is trusted."""
    try:
        signature(function).bind(*range(count))
    except TypeError:
        return False
    except ValueError:  # written in C, without a signature
        return True
    return True


def unmet_protocol(kind: object) -> Callable[[object], str]:
    """What says which methods of a protocol a value has not, or not with these arguments; "" of any other class."""
    own = vars(kind) if getattr(kind, "_is_protocol", False) else {}
    methods = {key: [*signature(does).parameters][1:] for key, does in own.items() if key[0] != "_"}
    if not methods:
        return lambda _: ""

    def unmet(value: object) -> str:
        if value is None:
            return ""
        if missing := [f"`{key}`" for key in methods if not hasattr(value, key)]:
            return f" It has no {' and no '.join(missing)}."
        wrong = (key for key, names in methods.items() if not takes(getattr(value, key), len(names)))
        return next((f" Its `{key}` does not take ({', '.join(methods[key])})." for key in wrong), "")

    return unmet


def real_array(name: str, value: object, ndim: int) -> Array:
    """Return `value` as a frozen real array of `ndim` dimensions.

    Raises ArgumentError if it is not numeric, complex, of another dimension, or holds NaN or infinity.
    """
    array = floats(name, value)
    if array.ndim != ndim:
        slips = {(2, 1): " One row is [[...]], in two brackets.", (1, 0): " One number is [...], in brackets."}
        slip = slips.get((ndim, array.ndim), "")
        raise ArgumentError(f"`{name}` must have {ndim} dimension{'s' * (ndim != 1)}, got shape {array.shape}.{slip}")
    if not np.all(np.isfinite(array)):
        index = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ArgumentError(f"`{name}` must be finite, got {name}[{', '.join(map(str, index))}] = {array[index]}.")
    return freeze(array)


def _as_reals(name: str, value: object) -> npt.NDArray[Any]:
    if hasattr(value, "_entries"):  # a record that is a list is more than its numbers: a schedule says what is measured
        raise ArgumentError(f"`{name}` must hold real numbers, got {described(value)}.")
    try:
        array = np.asarray(value)
    except ValueError:
        raise ArgumentError(f"`{name}` must be a rectangular array of numbers, got rows of unequal length.") from None
    except Exception:  # whatever a foreign object does when it is asked for an array
        raise ArgumentError(f"`{name}` must hold real numbers, got {described(value)}.") from None
    if array.dtype == object and all(map(is_whole, array.flat)):  # whole numbers of more than 64 bits
        with suppress(OverflowError):
            array = array.astype(float)
    if array.dtype == object or array.dtype.kind not in "biufc":
        raise ArgumentError(f"`{name}` must hold real numbers, got {described(value)}.")
    if array.dtype.kind == "c":
        raise ArgumentError(
            f"`{name}` must be real, got complex entries. Use a real basis (a block [[a, b], [-b, a]] for a +- ib)."
        )
    return array


def floats(name: str, value: object) -> Array:
    """Return `value` as a new float64 array of any shape, NaN and infinity as they are.

    Raises ArgumentError if it is not numeric, ragged or complex.
    """
    with np.errstate(over="ignore"):  # extended precision holds numbers that are infinite here
        return np.array(_as_reals(name, value), dtype=np.float64)


def dimensions(value: object) -> int:
    """0 for a number, 1 for a list, 2 for a table; 1 too for rows of unequal length, which their owner refuses."""
    try:
        return np.asarray(value).ndim
    except (ValueError, TypeError):  # and of what has a length and is no list
        return 1


def described(value: object) -> str:
    """Return what came, on one line: a plain value or container with its type, anything else by its type alone."""
    if value is None:
        return "None"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    name = type(value).__name__
    if not isinstance(value, (str, bytes, int, float, complex, list, tuple, dict, set, np.generic, np.ndarray)):
        return name
    try:
        return f"{name} {' '.join(repr(value).split()):.60}"
    except ValueError:  # an integer of thousands of digits has no text
        return f"{name} of more than 4000 digits"
    except RecursionError:
        return f"{name} of lists inside each other"


def is_ours(kind: object) -> TypeGuard[type]:
    """Whether it is a class of this package."""
    return isclass(kind) and kind.__module__.partition(".")[0] == __package__.partition(".")[0]


def held_in(name: str, value: object, kinds: tuple[type, ...]) -> str:
    """The sentence for a record that holds one of these, under the argument's name or alone: a plan its schedule."""
    held = [key for key, own in getattr(value, "__dict__", {}).items() if isinstance(own, kinds)]
    key = name if name in held else held[0] if len(held) == 1 else ""
    return key and f" Its `.{key}` is one."


def of_kind(name: str, value: object, kind: type[Instance], expected: str = "") -> Instance:
    """Return `value` if it is of a class.

    Raises ArgumentError if it is not; `expected` says what the class is where its name does not.
    """
    if not isinstance(value, kind):
        raise ArgumentError(f"`{name}` must be {expected or f'a {kind.__name__}'}, got {described(value)}.")
    return value


def matrix(name: str, value: object, rows: int | None = None, columns: int | None = None) -> Array:
    """Return `value` as a frozen real matrix, `rows` by `columns` where these are given.

    Raises ArgumentError if the shape differs, or as in `real_array`.
    """
    array = real_array(name, value, 2)
    wanted = array.shape[0] if rows is None else rows, array.shape[1] if columns is None else columns
    turned = array.shape[1] if rows is None else rows, array.shape[0] if columns is None else columns
    if array.shape != wanted:
        slip = " Did you pass the transpose?" if array.shape == turned[::-1] else ""
        raise ArgumentError(f"`{name}` must have shape {turned if slip else wanted}, got {array.shape}.{slip}")
    return array


def vector(name: str, value: object, length: int | None = None) -> Array:
    """Return `value` as a frozen real vector, of `length` entries where that is given.

    Raises ArgumentError if the length differs, or as in `real_array`.
    """
    array = real_array(name, value, 1)
    if length is not None and array.size != length:
        raise ArgumentError(f"`{name}` must have {length} entr{'y' if length == 1 else 'ies'}, got {array.size}.")
    return array


def number(name: str, value: object) -> float:
    """Return `value` as a finite float. Raises ArgumentError if it is not a finite real number."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if isinstance(value, numbers.Rational) and not is_whole(value) and not is_flag(value):
        value = float(value)
    if not is_number(value) and not isinstance(value, (complex, np.complexfloating)):
        raise ArgumentError(f"`{name}` must be a number, got {described(value)}.")
    if is_number(value) and not is_whole(value) and not np.isfinite(value):
        raise ArgumentError(f"`{name}` must be finite, got {value}.")
    return float(real_array(name, [value], 1)[0])


def positive(name: str, value: object) -> float:
    """Return `value` as a finite float > 0. Raises ArgumentError if it is not positive, or as in `number`."""
    result = number(name, value)
    if result <= 0:
        raise ArgumentError(f"`{name}` must be positive, got {result!r}.")
    return result


def nonnegative(name: str, value: object) -> float:
    """Return `value` as a finite float >= 0. Raises ArgumentError if it is negative, or as in `number`."""
    result = number(name, value)
    if result < 0:
        raise ArgumentError(f"`{name}` must not be negative, got {result!r}.")
    return result


def whole(name: str, value: object, least: int = 0) -> int:
    """Return `value` as an int of at least `least`.

    Raises ArgumentError if it is no whole number or less than `least`.
    """
    result = number(name, value)
    if result != int(result) or result < least:
        raise ArgumentError(f"`{name}` must be a whole number of at least {least}, got {value!r}.")
    return int(result)


def at_least_one(name: str, value: object) -> int:
    """Return `value` as a whole number of at least 1."""
    return whole(name, value, 1)


def generator(rng: Seed) -> np.random.Generator:
    """Return the generator that was given, or the one with the seed that was.

    Raises ArgumentError if the seed is negative.
    """
    return rng if isinstance(rng, np.random.Generator) else np.random.default_rng(whole("rng", rng or 0))


def increasing(name: str, value: object, slip: str = "") -> Array:
    """Return `value` as a frozen vector of strictly increasing, non-negative times.

    Raises ArgumentError if a time is negative, repeated or earlier than its predecessor; `slip` is appended.
    """
    array = vector(name, value)
    hint = f" {slip}" if slip else ""
    if array.size and array[0] < 0:
        raise ArgumentError(f"`{name}` must not be negative, got {name}[0] = {float(array[0])!r}.")
    bad = np.flatnonzero(np.diff(array) <= 0)
    if bad.size:
        i = int(bad[0])
        what = "repeats" if array[i + 1] == array[i] else "comes after"
        raise ArgumentError(
            f"`{name}` must increase strictly, got {name}[{i + 1}] = {float(array[i + 1])!r} which {what} "
            f"{name}[{i}] = {float(array[i])!r}.{hint}"
        )
    return array


def symmetric(name: str, value: object, size: int) -> Array:
    """Return `value` as a frozen symmetric matrix (relative tolerance 1e-12), exactly symmetrised.

    Raises ArgumentError if it is not symmetric, or as in `matrix`.
    """
    array = matrix(name, value, size, size)
    with np.errstate(over="ignore"):  # entries of opposite signs whose difference no double holds
        skew = float(np.max(np.abs(array - array.T), initial=0.0))
    if skew > 1e-12 * float(np.max(np.abs(array), initial=0.0)):
        raise ArgumentError(f"`{name}` must be symmetric, got entries that differ from their mirror by {skew:.3g}.")
    return freeze(array / 2 + array.T / 2)


def definite(name: str, value: object, size: int, slip: str = "") -> Array:
    """Return `value` as a frozen symmetric positive definite matrix.

    Judged in units in which its diagonal is about one, so that the answer does not depend on those of the caller.
    Raises ArgumentError if an eigenvalue is not positive there beyond rounding, or as in `symmetric`; `slip` is
    appended.
    """
    array = symmetric(name, value, size)
    hint = f" {slip}" if slip else ""
    low = np.flatnonzero(np.diagonal(array) <= 0)
    if low.size:
        i = int(low[0])
        raise ArgumentError(
            f"`{name}` must be positive definite, got {name}[{i}, {i}] = {float(array[i, i])!r} on its diagonal.{hint}"
        )
    with np.errstate(over="ignore"):  # an entry beyond 4 is indefinite already
        unit = np.clip(unit_diagonal(array)[1], -8.0, 8.0)
    least = float(np.linalg.eigvalsh(unit)[0]) if size else 1.0
    if least <= size * np.finfo(float).eps:
        raise ArgumentError(
            f"`{name}` must be positive definite, got least eigenvalue {least:.3g} once its diagonal is one.{hint}"
        )
    return array


def is_unicode(text: str) -> bool:
    """Whether a file can hold it: half a surrogate pair is no letter."""
    try:
        return text.isascii() or bool(text.encode())
    except UnicodeEncodeError:
        return False


def of_file(name: str, value: str | os.PathLike[str]) -> object:
    """Return a path. Raises ArgumentError if no file can have it: a zero byte, or half a surrogate pair."""
    with suppress(UnicodeEncodeError):
        if b"\0" not in os.fsencode(value):
            return value
    raise ArgumentError(f"`{name}` must be a path that a file can have, got {described(value)}.")


def texts(value: object) -> tuple[str, ...] | None:
    """Return the texts of a list as a tuple; None where it is no list, or holds anything else."""
    found = None if is_text(value) or not holds(value, str) else tuple(str(each) for each in value)
    return None if found is None or not all(map(is_unicode, found)) else found


def holds(value: object, kind: type[Instance]) -> TypeGuard[Sequence[Instance]]:
    """Whether this is a list of things of one kind alone, or an empty one."""
    return isinstance(value, Sequence) and all(isinstance(each, kind) for each in value)


def entries(name: str, value: object, counts: Collection[int], expected: str) -> Sequence[object]:
    """Return the entries of a list that has as many of them as one of `counts`.

    Raises ArgumentError if it is no list or of another length; `expected` ends "`name` must hold ...".
    """
    if not is_list(value) or len(value) not in counts:
        raise ArgumentError(f"`{name}` must hold {expected}, got {described(value)}.")
    return value


def line(name: str, value: object) -> str:
    """Return `value` if it is a text of one line. Raises ArgumentError if it is none, or holds control characters."""
    text = of_kind(name, value, str, "a string")
    if not strict.is_line(text):
        raise ArgumentError(f"`{name}` must be one line without control characters, got {text!r:.60}.")
    return text


def names(name: str, value: object, length: int, prefix: str) -> tuple[str, ...]:
    """Return `value` as a tuple of distinct strings, or `prefix1, prefix2, ...` where it is None.

    Raises ArgumentError if the number is wrong, an entry is no string of one line or blank, or a name occurs twice.
    """
    if value is None:
        return tuple(f"{prefix}{i + 1}" for i in range(length))
    result = texts(value)
    if result is None:
        raise ArgumentError(f"`{name}` must be a list of strings, got {described(value)}.")
    if len(result) != length:
        raise ArgumentError(f"`{name}` must have {length} entr{'y' if length == 1 else 'ies'}, got {len(result)}.")
    for each in result:
        if not line(name, each).strip():
            raise ArgumentError(f"`{name}` must not be blank, got {each!r:.60}.")
    twice = [v for i, v in enumerate(result) if v in result[:i]]
    if twice:
        raise ArgumentError(f"`{name}` must be distinct, got {twice[0]!r} twice.")
    return result


def mapping(name: str, value: object, expected: str = "a table of keys and values") -> Mapping[str, object]:
    """Return `value` if it is a table, an empty one where nothing came. Raises ArgumentError if it is none."""
    return of_kind(name, {} if value is None else value, Mapping, expected)  # type: ignore[type-abstract]


def record(name: str, value: object, kind: type[Instance]) -> Instance:
    """Return `value` if it is a record of a class, or the record that a table of its fields makes.

    Raises ArgumentError if it is neither, a key is unknown, or a field that has no default is missing.
    """
    if isinstance(value, kind):
        return value
    table = of_kind(name, value, Mapping, "a table of keys and values")  # type: ignore[type-abstract]
    entries = fields(kind)  # type: ignore[arg-type]
    known_keys(f"`{name}`", table, [each.name for each in entries])
    for each in entries:
        if each.name not in table and each.default is MISSING:
            raise ArgumentError(f"`{name}.{each.name}` is missing.")
    return kind(**table)


def word(name: str, value: object, known: Iterable[str]) -> str:
    """Return `value` if it is one of the known words. Raises ArgumentError if it is not."""
    words = list(known)
    if is_text(value) and value in words:
        return value
    quoted = [f'"{each}"' if len(words) == 2 or " " in each else each for each in words]
    expected = " or ".join(quoted) if len(words) == 2 else f"one of {', '.join(quoted)}"
    raise ArgumentError(f"`{name}` must be {expected}, got {repr(value) if is_text(value) else described(value)}.")


def known_keys(where: str, found: Iterable[str], known: Iterable[str]) -> None:
    """Refuse a key that is not known, naming the nearest known one, or all where none is near.

    Raises ArgumentError if a key is unknown.
    """
    allowed = list(known)
    for key in found:
        if key not in allowed:
            raise ArgumentError(f"unknown key {key!r} in {where}. {likely(str(key), allowed)}")


def output_mask(name: str, value: object, samples: int) -> Mask | None:
    """Return `value` as a frozen boolean (samples, outputs) mask; None means that every output is measured.

    Raises ArgumentError if the shape is wrong, entries are not 0/1, or a sample measures nothing.
    """
    if value is None:
        return None
    array = _as_reals(name, value)
    if array.ndim != 2 or array.shape[0] != samples or array.shape[1] < 1:
        raise ArgumentError(
            f"`{name}` must have shape ({samples}, number of outputs), one row per sample, got shape {array.shape}."
        )
    if array.dtype != bool and not np.all(np.isin(array, (0, 1))):
        raise ArgumentError(f"`{name}` must hold True/False or 1/0 only.")
    mask = np.array(array, dtype=bool)
    empty = np.flatnonzero(~mask.any(axis=1))
    if empty.size:
        raise ArgumentError(
            f"`{name}` must measure at least one output at each sample, got none at sample {int(empty[0])}."
        )
    mask.flags.writeable = False
    return mask


def unit_diagonal(matrix: Array) -> tuple[Array, Array]:
    """Return d (powers of two) and M with `matrix` = d M d exactly, the diagonal of M in [1, 4): its scale-free form.

    A positive definite matrix keeps its signs and its Cholesky factor L = d L_M to the last bit. Where an entry of the
    diagonal is not positive, d is 1 there.
    """
    diagonal = np.diagonal(matrix)
    _, exponent = np.frexp(np.sqrt(np.where(diagonal > 0, diagonal, 1.0)))
    half = -(exponent - 1)
    return np.ldexp(1.0, exponent - 1), np.ldexp(np.ldexp(matrix, half[:, None]), half[None, :])


def meant(key: str, known: Collection[str], hints: Mapping[str, object] | None = None) -> str:
    """What a keyword that is not known may have meant: what other packages call so, one of a record, the nearest one.

    `hints` are the annotations of a function whose keyword it is.
    """
    if not known:
        return "It takes none."
    ours = [name for name in ELSEWHERE.get(key, ()) if name in known]
    return f"Did you mean {ours[0]!r}?" if ours else _of_a_part(key, hints or {}) or likely(key, known)


def _of_a_part(key: str, hints: Mapping[str, object]) -> str:
    """The sentence for a keyword of a record that is itself an argument, one that is made and not returned; else ""."""
    for name, hint in hints.items():
        for kind in (hint, *get_args(hint)):
            made = isclass(kind) and not getattr(kind, "_answers", ()) and name != "return"
            fields = getattr(kind, "__dataclass_fields__", {}) if made else {}
            own = next((each for each in (key, *ELSEWHERE.get(key, ())) if each in fields), None)
            if own is not None:
                return f"It belongs to `{name}`: {kind.__name__}({own}=...)."
    return ""
