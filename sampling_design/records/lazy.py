"""Packages that import a name when it is first asked for, from a table of names and the files that they stand in."""

from __future__ import annotations

import sys
from importlib import import_module

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


def lazy(
    package: str, names: Mapping[str, tuple[str, ...]], modules: tuple[str, ...] = ()
) -> tuple[Callable[[str], object], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package that imports a name when it is first asked for.

    Parameters
    ----------
    package : str
        The `__name__` of the package.
    names : mapping from file to names
        Each file as a dotted place below the package, with what of it is public.
    modules : tuple of str
        Rooms and files below it that are listed beside the names; any other file opens as well.

    Notes
    -----
    The stub `__init__.pyi` beside each such package tells editors and type checkers the same;
    `python -m tests.house.front_door` writes it from the table. An unknown name ends in an AttributeError (an
    ImportError where `from package import name` would swallow its words) that names the nearest one.
    """
    home = {name: place for place, found in names.items() for name in found}
    public = sorted([*home, *modules])

    def attribute(name: str) -> object:
        from importlib.util import find_spec

        if name in home:
            value = getattr(import_module(f"{package}.{home[name]}"), name)
        elif not name.startswith("_") and find_spec(f"{package}.{name}") is not None:
            value = import_module(f"{package}.{name}")
        else:
            raise _absent(package, name, public, modules)
        setattr(sys.modules[package], name, value)
        return value

    return attribute, lambda: public, public


def _absent(package: str, name: str, public: list[str], rooms: tuple[str, ...]) -> AttributeError | ImportError:
    """Return the error for a name that is not there, with the one that was probably meant, or the room that has it."""
    message = f"module {package!r} has no attribute {name!r}"
    if name.startswith("_"):
        return AttributeError(message)
    from sampling_design.checkers.strict import nearest

    own = [room for room in rooms if name in getattr(import_module(f"{package}.{room}"), "__all__", ())]
    longer = [each for each in public if each.startswith(f"{name}_")]
    close = next(iter([f"{room}.{name}" for room in own] or longer), "") or nearest(name, public)
    hint = f"; did you mean {close!r}?" if close else ""
    # `from package import NAME` swallows an AttributeError with its words, and says only "cannot import name"
    importing = bool(hint) and sys._getframe(2).f_code.co_name == "_handle_fromlist"
    if importing:
        return ImportError(message + hint)
    return AttributeError(message + hint, name=name)  # else Python fills it in, and appends a nearest name of its own
