"""The door: what every public function and method asks of its arguments before it begins, read off its annotations.

An argument of another kind than the annotation says ends in one sentence (the grammar of `checks`), not in whatever it
breaks inside; so does a call that does not fit, which names the nearest keyword. Arrays pass: their owners check shape
and content. A number that leaves double precision or memory in the middle of a verb ends in one sentence too.
"""

from __future__ import annotations

import collections.abc
import functools
import inspect
import math
import numbers
import os
import threading
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Concatenate, Literal, NamedTuple, ParamSpec, Protocol, TypeVar, Union, overload

import numpy as np

from sampling_design.checkers.strict import is_flag, is_list, is_text
from sampling_design.errors import ArgumentError, CallError, SolverError
from sampling_design.records import checks
from sampling_design.records.checks import described, is_unicode, meant, of_file, takes, unmet_protocol
from sampling_design.records.dispatch import OpenPlant, registered

P = ParamSpec("P")
T = TypeVar("T")
Kind = TypeVar("Kind", contravariant=True)
Own = TypeVar("Own", covariant=True)
Common = TypeVar("Common", covariant=True)
Check = Callable[[object], object]

_NO = object()
_CALLED = {
    "Client": "a Dask client",
    "Executor": "a concurrent.futures.Executor",
    "Dataset": "an xarray Dataset",
    "Generator": "a numpy.random.Generator",
    "HasSchedule": "a ScheduleDesign",
    "MeasuredPlant": "a NonlinearPlant",
    "OnlineEstimator": "an estimator of this package",
    "OpenPlant": "a plant of another kind",
    "SampledCertificate": "a Certificate or FamilyCertificate",
    "Series": "a pandas Series",
}
"""Classes whose bare name would not tell a caller what to pass."""
TOO_BIG = ("array is too big", "Maximum allowed dimension exceeded", "Maximum allowed size exceeded")
"""What numpy says, as a ValueError, of an array beyond every memory."""

_inside = threading.local()


class OpenVerb(Protocol[Kind, P, Own, Common]):
    """A function of a plant that rings do for plants of other kinds, with a result that they have in common."""

    @overload
    def __call__(self, plant: Kind, *arguments: P.args, **options: P.kwargs) -> Own: ...
    @overload
    def __call__(self, plant: OpenPlant, *arguments: P.args, **options: P.kwargs) -> Common: ...


def open_verb(result: type[Common]) -> Callable[[Callable[Concatenate[Kind, P], Own]], OpenVerb[Kind, P, Own, Common]]:
    """Open a function to rings: a plant that is no `Kind` goes to what is registered for its own kind.

    The arguments are those that the function documents, and they are checked once (`checked`); what a ring registers
    takes them as they came.

    Parameters
    ----------
    result : type
        What the results for all kinds of plants have in common.
    """

    def opened(function: Callable[Concatenate[Kind, P], Own]) -> OpenVerb[Kind, P, Own, Common]:
        own: list[type] = []

        def chosen(plant: object) -> Callable[..., object]:
            if not own:
                own.append(typing.cast(type, hints_of(function)["plant"]))
            return function if isinstance(plant, own[0]) else registered(function.__name__, plant, result)

        return typing.cast(OpenVerb[Kind, P, Own, Common], _behind_a_door(function, chosen))

    return opened


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Return `function` behind a door: arguments are checked against its annotations before it begins.

    Raises ArgumentError if an argument is of another kind than its annotation says; CallError if the call does not fit:
    an unknown keyword, an argument missing, given twice, or one too many; SolverError if a number leaves the range of
    double precision, or an array does not fit into memory, inside.
    """
    return typing.cast(Callable[P, T], _behind_a_door(function))


def _arguments(
    function: Callable[..., object], open_: bool
) -> Callable[[tuple[object, ...], dict[str, object]], tuple[list[object], dict[str, object]]]:
    """What checks the arguments of a call, by place and by name; `open_`: the first one may be any kind of plant."""
    checks: dict[str, Check] = {}
    places: list[tuple[int, Check]] = []
    ready, known = list[bool](), set[str]()

    def prepare() -> None:
        hints, parameters = hints_of(function), list(inspect.signature(function).parameters.values())
        if keywords := _unpacked(hints, parameters):
            parameters += keywords
            known.update(each.name for each in parameters)
        for place, parameter in enumerate(parameters):
            if parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL):
                hint = hints.get(parameter.name, Any)
                check = _check(parameter, typing.cast(type, hint) | OpenPlant if open_ and not place else hint)
                if check is not None:
                    checks[parameter.name] = check
                    if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD):
                        places.append((place, check))
        ready.append(True)

    def enter(arguments: tuple[object, ...], options: dict[str, object]) -> tuple[list[object], dict[str, object]]:
        if not ready:
            prepare()
        given, named, foreign, count = list(arguments), options, False, len(arguments)
        for place, check in places:
            if place >= count:
                break
            try:
                given[place] = value = check(given[place])
            except ArgumentError as error:
                raise ArgumentError(f"{error}{_exchanged(function, places, arguments, place)}") from None
            foreign = foreign or type(value) is _ForeignSystem
        if known and not known.issuperset(options):
            raise misfit(function, arguments, options, TypeError())
        if options:
            named = {key: checks[key](value) if key in checks else value for key, value in options.items()}
            foreign = foreign or any(type(value) is _ForeignSystem for value in named.values())
        if foreign:
            unit = _unit_of((*given, *named.values()))
            given = [_taken(value, unit) for value in given]
            named = {key: _taken(value, unit) for key, value in named.items()}
        return given, named

    return enter


def _behind_a_door(
    function: Callable[..., object], chosen: Callable[[object], Callable[..., object]] | None = None
) -> Callable[..., object]:
    """The door; `chosen` says who does it for the plant that came as the first argument."""
    is_open = chosen is not None
    enter = _arguments(function, is_open)

    def of_its_kind(given: Sequence[object], named: dict[str, object]) -> Callable[..., object]:
        plant = given[0] if given else named.get("plant", _NO)
        if chosen is None or plant is _NO:
            return function
        found = chosen(plant)
        if found is not function:
            _for_this_kind(function, found, plant, named)
        return found

    inside, failures, worded = _inside, (ArithmeticError, np.linalg.LinAlgError, MemoryError), _worded
    too_big, unfit = _too_big, misfit

    def entered(*arguments: Any, **options: Any) -> object:
        given, named = enter(arguments, options)
        if getattr(inside, "door", False):
            return (of_its_kind(given, named) if is_open else function)(*given, **named)
        inside.door = True
        try:
            return (of_its_kind(given, named) if is_open else function)(*given, **named)
        except failures as error:
            raise worded(function.__name__, error) from error
        except TypeError as error:
            if error.__traceback__ is None or error.__traceback__.tb_next is not None:
                raise
            raise unfit(function, arguments, options, error) from None
        except ValueError as error:
            if not too_big(error):
                raise
            raise worded(function.__name__, MemoryError(*error.args)) from error
        finally:
            inside.door = False

    # with the globals of its module, so that doctest still finds the function where it is defined
    code, closure = entered.__code__, entered.__closure__
    own = types.FunctionType(code, function.__globals__, function.__name__, None, closure)
    functools.update_wrapper(own, function)
    vars(own)["checked"] = True
    return own


def _for_this_kind(
    verb: Callable[..., object], does: Callable[..., object], plant: object, named: dict[str, object]
) -> None:
    """Refuse what a verb takes of its own plants and not of a ring's; as it stands by default, it is left out."""
    taken, known = inspect.signature(does).parameters, inspect.signature(verb).parameters
    if any(each.kind is each.VAR_KEYWORD for each in taken.values()):
        return
    for key in [key for key in named if key in known and key not in taken]:
        value, default = named.pop(key), known[key].default
        if value is not default and not (isinstance(value, numbers.Real) and value == default):
            raise ArgumentError(
                f"`{key}` is for exactly known plants, got {described(value)} with a plant of another kind: "
                f"{type(plant).__name__}."
            )


def within() -> bool:
    """Whether a verb of the house is at work: what does not fit inside of it is a defect of ours."""
    return bool(getattr(_inside, "door", False))


def misfit(
    function: Callable[..., object], given: Sequence[object], named: Mapping[str, object], error: TypeError
) -> CallError:
    """The sentence for a call that Python could not bind; `given` has the instance or class first for a method."""
    taken = list(inspect.signature(function).parameters.values())
    name = function.__qualname__.removesuffix(".__init__").rpartition("<locals>.")[2]
    own = bool(taken) and taken[0].name in ("self", "cls")
    kind = getattr(given[0], "__name__", type(given[0]).__name__) if own and "." in name else ""
    name = f"{kind}.{function.__name__}" if kind else name
    order = f" {said}" if own and (said := getattr(given[0], "_order", "")) else ""
    absent, taken, given = getattr(given[0], "_absent", {}) if own else {}, taken[own:], given[own:]
    every = (*taken, *_unpacked(hints_of(function), taken))
    known = [each.name for each in every if each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)]
    placed = [each.name for each in taken if each.kind in (each.POSITIONAL_ONLY, each.POSITIONAL_OR_KEYWORD)]
    for key in (each for each in named if each not in known):
        slip = absent.get(key) or meant(key, known, hints_of(function))
        return CallError(f"`{name}` has no argument `{key}`. {slip}")
    if len(given) > len(placed):
        count, places = f"{len(placed)} argument{'s' * (len(placed) != 1)}", f" ({', '.join(placed)})" if placed else ""
        return CallError(f"`{name}` takes {count} by place{places}, got {len(given)}: the others have names.{order}")
    for key in (each for each in placed[: len(given)] if each in named):
        return CallError(f"`{name}` got `{key}` twice, by place and by name.{order}")
    there = {*named, *placed[: len(given)]} | {each.name for each in taken if each.default is not each.empty}
    missing = [f"`{each.name}`" for each in taken if each.name in known and each.name not in there]
    return CallError(f"`{name}` needs {' and '.join(missing)}." if missing else str(error))


def _unpacked(hints: dict[str, object], parameters: Sequence[inspect.Parameter]) -> list[inspect.Parameter]:
    """The keywords of a `**options: Unpack[...]`, their annotations put beside the others; none where any pass."""
    hint = next((hints.get(each.name) for each in parameters if each.kind is each.VAR_KEYWORD), None)
    own = typing.get_type_hints(typing.get_args(hint)[0]) if typing.get_origin(hint) is typing.Unpack else {}
    hints |= own
    return [inspect.Parameter(key, inspect.Parameter.KEYWORD_ONLY, default=None) for key in own]


def hints_of(function: Callable[..., Any]) -> dict[str, object]:
    """The annotations of the parameters, those apart that name what only a type checker imports."""
    hints, known = {}, getattr(function, "__globals__", {})
    for name, hint in inspect.get_annotations(function).items():
        try:
            hints[name] = eval(hint, known) if is_text(hint) else hint
        except NameError:
            continue
    return hints


def checked_methods(cls: type[T]) -> type[T]:
    """Put a door before `__init__` and every public method that a class defines itself and that takes arguments."""
    for name, member in list(vars(cls).items()):
        kind = type(member) if isinstance(member, (classmethod, staticmethod)) else None
        inner = member.__func__ if kind else member
        private = name.startswith("_") and name != "__init__"
        if private or not inspect.isfunction(inner) or "checked" in vars(inner):
            continue
        if len(inspect.signature(inner).parameters) > (kind is not staticmethod):
            setattr(cls, name, kind(checked(inner)) if kind else checked(inner))
    return cls


def _exchanged(
    function: Callable[..., object], places: list[tuple[int, Check]], given: Sequence[object], failed: int
) -> str:
    """The sentence for two arguments that stand in each other's place, if that is the slip.

    One of them is enough, where it does not belong where it stands: what came for it may be of a third kind.
    """

    def fits(check: Check | None, value: object) -> bool:
        if check is None:  # what becomes an array, which nothing of ours does
            return not checks.is_ours(type(value))
        try:
            check(value)
        except ArgumentError:
            return False
        return True

    asked, names = dict(places), list(inspect.signature(function).parameters)
    for place in range(len(given)):
        check = asked.get(place)
        if place == failed or names[place] == "self" or not fits(asked[failed], given[place]):
            continue
        if fits(check, given[place]) and (check is None or not fits(check, given[failed])):
            continue
        one, other = sorted((place, failed))
        called = function.__name__ if function.__name__ != "__init__" else function.__qualname__.split(".")[-2]
        order = ", ".join(name for name in names[: other + 1] if name not in ("self", "cls"))
        more = ", ..." * (len(names) > other + 1)
        return f" `{names[one]}` and `{names[other]}` are exchanged: it is {called}({order}{more})."
    return ""


class _ForeignSystem(NamedTuple):
    """A system of another library on its way to being what the annotation says, once the unit of time is known."""

    take: Callable[[object, str], object]
    value: object


def _taken(value: object, unit: str) -> object:
    return value.take(value.value, unit) if isinstance(value, _ForeignSystem) else value


def _unit_of(values: tuple[object, ...]) -> str:
    """The unit of time that the other arguments state, else seconds."""
    for value in values:
        for holder in (value, getattr(value, "plant", None)):
            unit = getattr(holder, "time_unit", None)
            if is_text(unit):
                return unit
    return "s"


def _too_big(error: ValueError) -> bool:
    return any(words in str(error) for words in TOO_BIG)


def _worded(name: str, error: BaseException) -> SolverError:
    if isinstance(error, MemoryError):
        return SolverError(f"`{name}` needs more memory than there is ({_line(error) or 'none left'}).", "memory")
    return SolverError(
        f"`{name}` leaves what double precision can hold ({_line(error)}): are the sizes and units as meant?",
        "overflow",
    )


def _line(error: BaseException) -> str:
    return " ".join(str(error).split()).rstrip(".")


def _check(parameter: inspect.Parameter, hint: object) -> Check | None:
    """What turns an argument into one of the annotated kind, or raises; None if anything may pass."""
    if (kinds := _kinds(hint)) is None:
        return None
    name, default = parameter.name, parameter.default
    words = " or ".join(dict.fromkeys(word for word, _ in kinds if word != "None")) or "None"
    slips = [next((f" {said}" for kind in _classes(hint) if (said := find(kind))), "") for find in (_slip, _reader)]
    is_path = any(typing.get_origin(kind) is os.PathLike for kind in _classes(hint))
    is_number = any(take is _number for _, take in kinds)

    def check(value: object) -> object:
        if value is default or (type(value) is float and is_number and value == value):
            return value
        if is_path and (is_text(value) or _path(value)):
            return of_file(name, value)  # type: ignore[arg-type]
        for _, take in kinds:
            taken = take(name, value)
            if taken is not _NO and not unmet(value):
                return taken
        seeds, files = (list, tuple, np.ndarray, int), (str, os.PathLike, collections.abc.Mapping)
        likely = slips[0] if isinstance(value, seeds) else slips[1] or slips[0] if isinstance(value, files) else ""
        raise ArgumentError(f"`{name}` must be {words}, got {described(value)}.{likely or beside(value)}")

    asked = [kind for kind in _classes(hint) if kind is not type(None)]
    alone = asked[0] if len(asked) == 1 and getattr(asked[0], "_is_protocol", False) else object
    unmet = unmet_protocol(alone)
    own = tuple(each for kind in asked if checks.is_ours(each := typing.get_origin(kind) or kind))
    maker = next((f" {said} makes one." for kind in own if (said := getattr(kind, "_maker", ""))), "")

    def beside(value: object) -> str:
        """What a value lacks; of a record of ours in the place of another, which part is meant, or who makes one."""
        return unmet(value) or checks.held_in(name, value, own) or (maker if checks.is_ours(type(value)) else "")

    return check


def _slip(kind: object) -> str:
    """The likely slip where something that is no `kind` came for one."""
    return str(getattr(kind, "_slip", ""))


def _reader(kind: object) -> str:
    """The function that makes a `kind` of the file whose path or plain data came for one."""
    reader = getattr(kind, "_reader", "")
    return f"Use {reader} for a file." if reader else ""


def _classes(hint: object) -> tuple[object, ...]:
    return typing.get_args(hint) or (hint,)


def _kinds(hint: object) -> list[tuple[str, Callable[[str, object], object]]] | None:
    """The words and the test of every alternative of an annotation; None of one that says nothing to be checked."""
    origin = typing.get_origin(hint)
    if origin in (Union, types.UnionType):
        members = [_kinds(member) for member in typing.get_args(hint)]
        return None if None in members else [kind for kinds in members for kind in kinds or ()]
    if origin is Literal:
        allowed = typing.get_args(hint)
        return [(f"one of {', '.join(map(repr, allowed))}", lambda _, v: v if _among(v, allowed) else _NO)]
    if hint is None or hint is type(None):
        return [("None", lambda _, v: None if v is None else _NO)]
    plain = {float: ("a number", _number), int: ("a whole number", _whole), bool: ("True or False", _truth)}
    if hint in plain:
        return [plain[hint]]
    kind = origin or hint
    if kind is collections.abc.Callable:
        asked = next(iter(typing.get_args(hint)), ...)
        if not isinstance(asked, list):
            return [("a function", lambda _, v: v if callable(v) else _NO)]
        words = f"a function of {len(asked)} argument{'s' if len(asked) > 1 else ''}"
        return [(words, lambda _, v: v if callable(v) and takes(v, len(asked)) else _NO)]
    if kind is os.PathLike:
        return [("a path", lambda _, v: v if _path(v) else _NO)]
    if isinstance(kind, type) and kind in _HELD:
        listed = kind
        return [(_HELD[kind], lambda _, v: _as_typed(v, listed))]
    if not isinstance(kind, type) or kind in (Any, object, np.ndarray) or kind.__module__.startswith("numpy._typing"):
        return None  # an array, or what becomes one
    return [_instance(kind)]


_HELD: dict[object, str] = {
    collections.abc.Sequence: "a list",
    collections.abc.Iterable: "a list",
    collections.abc.Mapping: "a table of names and values",
    list: "a list",
    tuple: "a tuple",
    dict: "a table of names and values",
}


def _as_typed(value: object, kind: type) -> object:
    if isinstance(value, (str, bytes)) or (isinstance(value, np.ndarray) and not value.ndim):
        return _NO
    if isinstance(value, np.ndarray) and value.ndim == 1 and kind in (list, tuple, collections.abc.Sequence):
        return value.tolist()
    if kind in (list, tuple):
        return value if is_list(value) else _NO
    return value if isinstance(value, kind) else _NO


def _instance(kind: type) -> tuple[str, Callable[[str, object], object]]:
    name = kind.__name__
    label = "a text" if kind is str else _CALLED.get(name, f"{'an' if name[0] in 'AEIOU' else 'a'} {name}")
    foreign = getattr(kind, "_foreign", None)

    def take(argument: str, value: object) -> object:
        if isinstance(value, kind):
            if isinstance(value, type) and getattr(kind, "_is_protocol", False):  # a class has the methods, too
                raise ArgumentError(
                    f"`{argument}` must be {label}, got the class {value.__name__}: make one, {value.__name__}(...)."
                )
            return value if kind is not str or is_unicode(str(value)) else _NO
        maker = None if foreign is None else foreign(value)
        return _NO if maker is None else _ForeignSystem(maker, value)

    return label, take


def _among(value: object, allowed: tuple[object, ...]) -> bool:
    return isinstance(value, (str, int)) and value in allowed


def _path(value: object) -> bool:
    return isinstance(value, os.PathLike) and is_text(os.fspath(value))


def _truth(_: str, value: object) -> object:
    return bool(value) if is_flag(value) else _NO


def _number(name: str, value: object) -> Any:
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value.item()
    if is_flag(value) or not isinstance(value, numbers.Real):
        return _NO
    try:
        result = float(value)
    except OverflowError:
        raise ArgumentError(f"`{name}` must be a number of double precision, got one above 1e308.") from None
    except TypeError:  # numpy counts a span of time among whole numbers
        return _NO
    if math.isnan(result):
        raise ArgumentError(f"`{name}` must be finite, got nan.")
    return value if isinstance(value, (int, float)) else result


def _whole(name: str, value: object) -> object:
    number = _number(name, value)
    if number is _NO or math.isinf(number) or number != int(number):
        return _NO
    return int(number)
