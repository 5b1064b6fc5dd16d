"""What functions of small arrays answered last, kept by what the arrays hold."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numpy as np
import numpy.typing as npt

P = ParamSpec("P")
T = TypeVar("T")
Content = tuple[bytes, tuple[int, ...], str]
ANSWERS = 128  # of one function: windows, samples and searches ask for those of one plant again and again
ENTRIES = 256  # of the largest array that so many are kept by: the answers stay below 5 MB
LARGE = (8, 6400)  # answers of one function, and entries, where arrays are larger: those of one plant that is at work


def kept(function: Callable[P, T]) -> Callable[P, T]:
    """Return `function`, with its last answers kept: it depends on nothing but its arguments, arrays and numbers.

    Arrays of an answer, alone or in a tuple or a dataclass, are read-only, since all who ask share them. Calls by
    keyword and with larger arrays are worked out anew.
    """

    def found_for(*contents: object) -> T:
        found = function(*map(_filled, contents))  # type: ignore[call-arg,arg-type]
        parts = vars(found).values() if hasattr(found, "__dict__") else found if isinstance(found, tuple) else (found,)
        for part in parts:
            if isinstance(part, np.ndarray):
                part.flags.writeable = False
        return found

    known, large = (functools.lru_cache(maxsize=size)(found_for) for size in (ANSWERS, LARGE[0]))

    @functools.wraps(function)
    def asked(*arguments: P.args, **named: P.kwargs) -> T:
        contents: list[object] = []
        most = 0
        for each in arguments:
            if isinstance(each, np.ndarray):
                most = max(most, each.size)
                if most > LARGE[1]:
                    return function(*arguments, **named)
                contents.append((each.tobytes(), each.shape, each.dtype.char))
            else:
                contents.append(each)
        if named:
            return function(*arguments, **named)
        return (known if most <= ENTRIES else large)(*contents)

    return asked


def _filled(content: object) -> object:
    if not isinstance(content, tuple):
        return content
    held, shape, kind = cast(Content, content)
    array: npt.NDArray[np.generic] = np.frombuffer(held, dtype=kind).reshape(shape)
    return array
