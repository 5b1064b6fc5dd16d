"""What every bracket of sigma shows and says, of one schedule or of the worst of a family."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.plants.functional import FunctionalPlant
from sampling_design.plants.modes import ModalSplit
from sampling_design.records import checks
from sampling_design.records.record import PlainRecord, short

UNSETTLED = ("budget", "interrupted", "rounding", "timing", "too many states", "sampled")
"""Of a search: what ends it with a bracket that is wider than was asked."""
Bracket = TypeVar("Bracket", bound="SigmaBracket")


class ProvenSigma(NamedTuple):
    """What balls proved: sigma >= lower over every window, its ends moved outward by `slack`; "closed" or why not."""

    lower: float
    slack: float
    status: str


@dataclass(frozen=True, eq=False, repr=False)
class SigmaBracket(PlainRecord):
    """A proven lower and an attained upper bound of sigma, with why the search between them ended."""

    lower: float = field(kw_only=True)
    upper: float = field(kw_only=True)
    status: str = field(kw_only=True)
    rtol: float = field(kw_only=True)
    coordinates: str = field(default="physical", kw_only=True)
    rigorous: bool = field(default=False, kw_only=True)

    _table = {
        "sigma at least": "{_at_least} ({_grounds}; {coordinates} coordinates, state at the window's start)",
        "sigma at most": "{upper} (attained)",
    }

    @property
    def closed(self) -> bool:
        """Whether lower >= (1 - rtol) upper, or sigma is zero: exactly, or below rounding."""
        return self.status not in UNSETTLED

    @property
    def _is_undecided(self) -> bool:
        """Whether 0 is all that is known: the search has not come to a bound yet."""
        return self.lower == 0 and not self.closed

    def _at_least(self) -> str:
        return "undecided" if self._is_undecided else short(self.lower)

    @property
    def _grounds(self) -> str:
        if self._is_undecided:
            return "nothing is proven"
        return "proven in ball arithmetic" if self.rigorous else "proven"

    def _concluded(self, claim: str, where: str, reasons: dict[str, str]) -> str:
        """The claim, what is attained and where; why the bracket did not close, if `reasons` knows the status."""
        if self._is_undecided and self.status in reasons:
            return (
                f"Nothing is proven yet, whether sigma is positive is undecided: {short(self.upper)} is attained, and "
                f"{reasons[self.status]}. {where}."
            )
        if self.status not in reasons:
            return f"{claim} and {short(self.upper)} is attained. {where}."
        return f"{claim}; {short(self.upper)} is attained, and {reasons[self.status]}. {where}."


def in_balls(found: Bracket, proof: ProvenSigma, room: float = 1.0) -> Bracket:
    """Return a bracket with the lower bound that ball arithmetic proves; `room`: how much wider it may stay."""
    status = found.status
    if proof.status == "interrupted":  # what floats have proven stands
        return replace(found, status=proof.status)
    if status == "closed" and not proof.lower >= (1 - room * found.rtol) * found.upper:
        status = proof.status if proof.status != "closed" else "rounding"
    return replace(found, lower=proof.lower, status=status, rigorous=True)


def coordinates_of(has_scales: bool, rows: bool = False) -> str:
    """Which coordinates sigma of a plant refers to: those of its scales, where it has any, or of chosen rows."""
    return "functional" if rows else "scaled" if has_scales else "physical"


def coordinates_in(split: ModalSplit) -> str:
    """Which coordinates sigma of what a split retains refers to; "modal": an orthonormal basis of it."""
    rows, retained = isinstance(split.plant, FunctionalPlant), split.retained
    return "modal" if retained is not split.plant and not rows else coordinates_of(retained.has_scales, rows)


def rtol_and_seconds(rtol: float, budget: float | None) -> tuple[float, float]:
    """Return the width of a bracket and the seconds for it, checked; no budget is no limit.

    Raises ArgumentError if a number is out of range.
    """
    width = checks.positive("rtol", rtol)
    if width >= 1:
        raise ArgumentError(f"`rtol` must be less than 1, got {width!r}.")
    return width, np.inf if budget is None else checks.nonnegative("budget", budget)


NO_STATES = "The plant has no states: there is nothing to see, and sigma is infinite."
