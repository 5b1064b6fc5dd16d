"""What answers yes or no is true or false as it says; where it is undecided `bool()` refuses, and says how to ask."""

import dataclasses
import importlib
import inspect
import pkgutil

import numpy as np
import pytest

import sampling_design
from sampling_design import GapRange, PeriodicSchedule, certificate_exists
from sampling_design.certificates.compare.robustness import FamilyTrial
from sampling_design.certificates.form.verdict import Verification
from sampling_design.checkers.outcome import Undecided, Verdict
from sampling_design.errors import UndecidedError
from sampling_design.nonlinear.detectability import DetectabilityEvidence
from sampling_design.plants import library
from sampling_design.uncertain.existence.existence_over_box import ExistenceOverBox
from sampling_design.validation.report import ClaimCheck, ValidationReport

ANSWERS = {"exists", "passed", "holds", "survives", "verdict"}
"""Attributes that are a yes or no, and not a property of something that is more: a plan, an estimate, a bound."""


def classes():
    """Every class of the package, where it is defined."""
    for module in pkgutil.walk_packages(sampling_design.__path__, "sampling_design."):
        if not module.name.endswith("__main__"):
            found = vars(importlib.import_module(module.name)).values()
            yield from (each for each in found if inspect.isclass(each) and each.__module__ == module.name)


def answers(kind):
    """The attributes of a class that answer yes or no without being asked about anything: fields and properties."""
    fields = {f.name for f in dataclasses.fields(kind)} if dataclasses.is_dataclass(kind) else set()
    fields |= set(getattr(kind, "_fields", ()))
    return ANSWERS & (fields | {name for name, thing in vars(kind).items() if isinstance(thing, property)})


def test_every_class_that_answers_yes_or_no_is_true_or_false():
    asked = [kind for kind in classes() if answers(kind) and not kind.__name__.startswith("_")]
    assert [kind.__qualname__ for kind in asked if not hasattr(kind, "__bool__")] == []
    assert {Verification, ExistenceOverBox, ClaimCheck, FamilyTrial, Verdict} <= set(asked)


def report(*checks):
    return ValidationReport(library.oscillator(), checks, np.zeros(0), None, "")


HELD, BROKEN = ClaimCheck("a", "b", 2.0, 1.0), ClaimCheck("a", "b", 1.0, 2.0)
OPEN = ClaimCheck("a", "b", 1.0, np.nan, checked=False)


def evidence(ratio):
    return DetectabilityEvidence(ratio, 1.0, 0.0, 1.0, np.ones(1), 1, 0, 0.1, 1.0, "s", None, None)


def verification(kind, verdict, **more):
    return kind(verdict == "proven", "an inequality", None, None, 0.0, "because", verdict=verdict, **more)


DECIDED = {
    "existence": (certificate_exists(library.oscillator(), PeriodicSchedule([1.0]), 0.4), True),
    "no existence": (certificate_exists(library.oscillator(), PeriodicSchedule([np.pi]), 0.4), False),
    "existence over a box": (ExistenceOverBox(True, {}, 1.0, "", 1, None), True),
    "no existence over a box": (ExistenceOverBox(False, {}, 0.0, "", 1, None), False),
    "proven": (verification(Verification, "proven"), True),
    "refuted": (verification(Verification, "refuted"), False),
    "a bad file": (verification(Verification, "bad file"), False),
    "proven in balls": (verification(Verification, "proven", bits=160), True),
    "refuted in balls": (verification(Verification, "refuted", bits=160), False),
    "proven by the checker": (Verdict("proven", "an inequality", "because"), True),
    "refuted by the checker": (Verdict("refuted", "an inequality", "because"), False),
    "evidence": (evidence(1.0), True),
    "refuted along a pair": (evidence(0.9), False),
    "a promise held": (HELD, True),
    "a promise broken": (BROKEN, False),
    "a report": (report(HELD, HELD), True),
    "a report of what is broken": (report(HELD, OPEN, BROKEN), False),
    "a family borne": (FamilyTrial(GapRange(0.9, 1.1), 2.0, True), True),
    "a family not borne": (FamilyTrial(GapRange(0.9, 1.1), 2.0, False), False),
}


@pytest.mark.parametrize("name", DECIDED)
def test_an_answer_is_what_it_says(name):
    answer, yes = DECIDED[name]
    assert bool(answer) is yes


@pytest.mark.parametrize(
    ("answer", "ask"),
    [
        (verification(Verification, "undecided"), "verdict"),
        (verification(Verification, "undecided", bits=160), "verdict"),
        (OPEN, "verdict"),
        (report(HELD, OPEN), "checks"),
        (report(), "checks"),
    ],
)
def test_what_is_undecided_is_neither(answer, ask):
    with pytest.raises(UndecidedError, match=f"is neither true nor false: ask `.{ask}`, and `.explain") as told:
        bool(answer)
    assert type(answer).__name__ in str(told.value)
    assert getattr(answer, ask) is not None
    assert not answer.passed


def test_an_undecided_verdict_of_the_checkers_is_neither():
    with pytest.raises(Undecided, match=r"is neither true nor false: ask `\.verdict`"):
        bool(Verdict("undecided", "an inequality", "because"))
