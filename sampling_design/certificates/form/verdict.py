"""The verdict on a certificate, given by the independent checkers (room `checkers`) from its plain data alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sampling_design.checkers import verdict
from sampling_design.checkers.check import verdict_on
from sampling_design.checkers.outcome import UNDECIDED, Refused, Verdict, WorkLimit
from sampling_design.checkers.sampled import prove, replay
from sampling_design.checkers.schedule_file import Sampled
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
    bits : int
        Precision of the ball arithmetic that gave the verdict, then a theorem about the doubles in the file, or none
        within the budget; 0: the floats of the checker gave it.
    seconds : float
        That the balls took.
    """

    passed: bool
    inequality: str
    time: float | None
    start: float | None
    amount: float
    reason: str
    direction: list[float] | None = None
    verdict: str = "undecided"
    bits: int = 0
    seconds: float = 0.0

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

    def _rows(self) -> list[tuple[str, str]]:
        return [("verdict", self.verdict)] * bool(self.bits) + super()._rows()

    def explain(self) -> str:
        """Say the verdict."""
        return f"{self.verdict.capitalize()}{' in ball arithmetic' if self.bits else ''}: {self.reason.rstrip('.')}."


def replays(content: Sampled) -> bool:
    """Whether the checker finds the witness of a certificate on one schedule to reach its ratio, beyond rounding."""
    try:
        with np.errstate(all="ignore"):
            replay(content)
    except (Refused, np.linalg.LinAlgError, OverflowError):
        return False
    return True


def verdict_of(data: Mapping[str, object], work: WorkLimit | None = None) -> Verification:
    """Return the verdict of the independent checker on the plain data of a certificate; it does at most this work."""
    return verification(verdict(data, work))


def verdict_on_content(content: object, prove: Callable[..., Verdict], work: WorkLimit | None = None) -> Verification:
    """The same of what a file would hold, while it is sought, as its claim proves it."""
    return verification(verdict_on(content, prove, work))


def verification(verdict: Verdict, bits: int = 0, seconds: float = 0.0) -> Verification:
    """A verdict as a record, of balls of so many bits or of the checker's floats."""
    return Verification(passed=verdict.passed, **vars(verdict), bits=bits, seconds=seconds)


def verdict_on_schedule(content: Sampled, work: WorkLimit) -> Verification:
    """The same of a file on one schedule."""
    return verdict_on_content(content, prove, work)
