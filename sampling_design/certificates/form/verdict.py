"""The verdict on a certificate, given by the independent checkers (room `checkers`) from its plain data alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sampling_design.checkers import verdict
from sampling_design.checkers.check import verdict_on
from sampling_design.checkers.outcome import UNDECIDED, Proven, Refused
from sampling_design.checkers.sampled import proven, replay
from sampling_design.checkers.schedule_file import Sampled
from sampling_design.checkers.work import Work
from sampling_design.records.record import PlainRecord, YesOrNo


@dataclass(frozen=True, eq=False, repr=False)
class Verification(YesOrNo, PlainRecord):
    """The verdict of `verify` on a certificate; true if it is proven, false if not, and neither where it is undecided.

    Attributes
    ----------
    passed : bool
    inequality : str
        The inequality that was proven, or the first one that fails.
    time : float or None
        Where it fails, if it fails at a time.
    start : float or None
        Start of the window in which it fails.
    amount : float
        By how much: the least relative slack found (negative: how far it is violated).
    reason : str
        One sentence.
    direction : list of float or None
        Along which it fails, if that is known: of unit length; states, then disturbances.
    verdict : str
        "proven"; "refuted": some inequality fails; "undecided": neither, it is tight or as near to failing as rounding;
        "bad file": the data are no certificate.
    """

    passed: bool
    inequality: str
    time: float | None
    start: float | None
    amount: float
    reason: str
    direction: list[float] | None = None
    verdict: str = "undecided"

    _asked: ClassVar[str] = "verdict"

    _table = {
        "passed": "{passed}",
        "inequality": "{inequality}",
        "time": "{time}",
        "window from": "{start}",
        "direction": "{direction:3}",
        "slack": "{amount:3}",
        "reason": "{reason}",
    }

    def _answer(self) -> bool | None:
        return None if self.verdict == UNDECIDED else self.passed

    def explain(self) -> str:
        """Say the verdict."""
        return f"{self.verdict.capitalize()}: {self.reason}"


def replays(content: Sampled) -> bool:
    """Whether the checker finds the witness of a certificate on one schedule to reach its ratio, beyond rounding."""
    try:
        with np.errstate(all="ignore"):
            replay(content)
    except (Refused, np.linalg.LinAlgError, OverflowError):
        return False
    return True


def verdict_of(data: Mapping[str, object], work: Work | None = None) -> Verification:
    """Return the verdict of the independent checker on the plain data of a certificate; it does at most this work."""
    found = verdict(data, work)
    return Verification(passed=found.passed, **vars(found))


def verdict_on_content(content: object, prove: Callable[..., Proven], work: Work | None = None) -> Verification:
    """The same of what a file would hold, while it is sought, as its claim proves it."""
    found = verdict_on(content, prove, work)
    return Verification(passed=found.passed, **vars(found))


def verdict_on_schedule(content: Sampled, work: Work) -> Verification:
    """The same of a file on one schedule."""
    return verdict_on_content(content, proven, work)
