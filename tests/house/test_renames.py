"""Every earlier name says what it is now, leads to something that exists, and stands in the changelog."""

import ast
import dataclasses
import inspect
import re
from pathlib import Path

import pytest

import sampling_design as sd
from sampling_design._renamed import ARGUMENTS, ATTRIBUTES, MOVED_ARGUMENTS, NAMES
from sampling_design.design.losses import SampleLosses
from sampling_design.errors import ArgumentError
from sampling_design.nonlinear.collocation import WindowSolver

GROUPS = {
    kind.__name__: kind for kind in (sd.CostFunction, sd.Constraints, sd.Collocation, WindowSolver)
}  # what an earlier keyword became a part of
CHANGELOG = (Path(__file__).parents[2] / "docs" / "changelog.md").read_text()
RENAMED = CHANGELOG.split("### Renamed")[1].split("###")[0]


def doors():
    """Every function of the front door, every `__init__` and every method there, by its qualified name."""
    for name in sd.__all__:
        thing = getattr(sd, name)
        members = vars(thing).values() if inspect.isclass(thing) else [thing]
        for member in members:
            inner = getattr(member, "__func__", member)
            if inspect.isfunction(inner) and "door" in vars(inner):
                yield inner.__qualname__, inner


DOORS = dict(doors())


def takers(old):
    """Functions that take now what `old` became."""
    new = ARGUMENTS[old].split("=")[0]
    takes = {name: inspect.signature(f).parameters for name, f in DOORS.items()}
    return [name for name, given in takes.items() if new in given and old not in given]


@pytest.mark.parametrize("old", ARGUMENTS)
def test_every_earlier_keyword_says_what_it_is_now(old):
    assert takers(old), f"nothing takes what `{old}` became"
    for name in takers(old):
        with pytest.raises(ArgumentError, match=re.escape(f"`{old}` is now `{ARGUMENTS[old]}`.")):
            DOORS[name](**{old: None})


@pytest.mark.parametrize(("function", "old"), MOVED_ARGUMENTS)
def test_every_keyword_that_left_a_function_says_what_does_it_now(function, old):
    assert old not in inspect.signature(DOORS[function]).parameters
    with pytest.raises(ArgumentError, match=re.escape(f"`{old}` is now `{MOVED_ARGUMENTS[function, old]}`.")):
        DOORS[function](**{old: None})


@pytest.mark.parametrize(("record", "old"), ATTRIBUTES)
def test_every_earlier_attribute_says_what_it_is_now(record, old):
    names = {kind.__name__: kind for kind in (sd.FamilyCertificate, SampleLosses)}
    made = object.__new__(names[record])
    with pytest.raises(AttributeError, match=f"'{record}' object has no attribute '{old}': it is now `(\\w+)`") as told:
        getattr(made, old)
    assert f"`{ATTRIBUTES[record, old]}`" in str(told.value)
    assert ATTRIBUTES[record, old] in {field.name for field in dataclasses.fields(names[record])}
    assert not hasattr(made, "nonsense")


@pytest.mark.parametrize("new", [*ARGUMENTS.values(), *MOVED_ARGUMENTS.values()])
def test_what_it_is_now_exists(new):
    call = ast.parse(new.split("=", 1)[1] if re.match(r"\w+=", new) else new, mode="eval").body
    if isinstance(call, ast.Name):
        assert any(call.id in inspect.signature(f).parameters for f in DOORS.values())
        return
    named = ast.unparse(call.func)
    group = sd.Certificate if named == "dataclasses.replace" else GROUPS[named]
    known = {f.name for f in dataclasses.fields(group)} if dataclasses.is_dataclass(group) else {}
    assert {word.arg for word in call.keywords} <= set(known)


@pytest.mark.parametrize("old", [*ARGUMENTS, *(name for _, name in [*MOVED_ARGUMENTS, *ATTRIBUTES]), *NAMES])
def test_every_earlier_name_stands_in_the_changelog(old):
    assert re.search(rf"\b{old}\b", RENAMED), f"`{old}` is not in the table of docs/changelog.md"
