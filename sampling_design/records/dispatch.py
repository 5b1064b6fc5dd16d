"""Verbs that stay open: what a ring does for a kind of its own, registered beside the verbs of the core.

    registered("window_sigma", plant, SigmaBracket)  ->  the function that does it for such a plant

A kind is a class, with all that is derived from it, or a word that stands in a file (its claim, its format). A ring
registers in its `__init__`, as places that are opened when they are asked for, so that a kind costs nothing before it
is used and no file of the core names a file of a ring.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Protocol, TypeVar, cast, runtime_checkable

Result = TypeVar("Result")

RINGS = ("uncertain", "plotting")  # the rings that register; one that is not installed registers nothing
VERBS = frozenset({
    "certificate_exists", "certify", "constants_from_proof", "estimate", "guaranteed_accuracy", "picture", "plot",
    "read_certificate", "read_plant", "validate", "verify_rigorously", "window_sigma", "worst_case_sigma",
    "zero_count_bound",
})  # fmt: skip
"""What is asked of kinds; each is a function that is opened, or a word that a reader or a picture asks with."""

_OFFERED: dict[tuple[str, str], str | Callable[..., object]] = {}


@runtime_checkable
class OpenPlant(Protocol):
    """A plant of any kind, as far as the verbs of the core know it."""

    @property
    def time_unit(self) -> str:
        """Of its times and rates."""


def register(verb: str, kind: type | str, does: str | Callable[..., object]) -> None:
    """Let `verb` do what `does` says for a kind.

    Parameters
    ----------
    verb : str
        Name of the function of the core, such as "window_sigma".
    kind : type or str
        A class; its place, "package.module.Class", where it should not be imported yet; or a word of a file.
    does : callable or str
        Takes what the verb takes; or its place, "package.module:function".

    Raises
    ------
    ArgumentError
        If nothing asks for such a verb.
    """
    if verb not in VERBS:
        from sampling_design.checkers.strict import likely
        from sampling_design.errors import ArgumentError

        raise ArgumentError(f"`verb` must be one that is asked of kinds, got {verb!r}. {likely(verb, sorted(VERBS))}")
    _OFFERED[verb, kind if isinstance(kind, str) else _place(kind)] = does


def offered(verb: str, thing: object, result: type[Result]) -> Callable[..., Result] | None:
    """Return what `verb` does for the kind of `thing`, with a `result`; None where nobody registered that."""
    kinds = [thing] if isinstance(thing, str) else [_place(each) for each in type(thing).__mro__]
    if not any((verb, kind) in _OFFERED for kind in kinds):
        _ask_rings()
    answering = next((_OFFERED[verb, kind] for kind in kinds if (verb, kind) in _OFFERED), None)
    if isinstance(answering, str):
        module, _, function = answering.partition(":")
        answering = getattr(import_module(module), function)
    return cast("Callable[..., Result] | None", answering)


def registered(verb: str, plant: object, result: type[Result]) -> Callable[..., Result]:
    """Return what `verb` does for a plant that is no `Plant`.

    Raises ArgumentError if no kind of plant that it is of takes part in that verb.
    """
    function = offered(verb, plant, result)
    if function is None:
        from sampling_design.errors import ArgumentError

        raise ArgumentError(f"`plant` must be a Plant, got {type(plant).__name__}.")
    return function


@cache
def _ask_rings() -> None:
    """Let every ring register, those too of whose kinds nothing was made yet."""
    for ring in RINGS:
        place = f"sampling_design.{ring}"
        try:
            import_module(place)
        except ModuleNotFoundError as error:
            if error.name != place:
                raise


def _place(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"
