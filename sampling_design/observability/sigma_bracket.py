"""What every bracket of sigma shows and says, and what is left of it if samples are late or lost."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.plants.functional import FunctionalPlant
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.record import PlainRecord, above, below, short
from sampling_design.schedules.jitter import TimingTolerance

UNSETTLED = ("budget", "interrupted", "rounding", "units", "timing", "too many states", "sampled")
"""Of a search: what ends it with a bracket that is wider than was asked."""
SHARE = 0.01  # of the least gap: how early or late samples are taken to be where nobody says
Bracket = TypeVar("Bracket", bound="SigmaBracket")


class _Searched(Protocol):
    @property
    def status(self) -> str: ...


Found = TypeVar("Found", bound=_Searched)


def uninterrupted(found: Found) -> Found:
    """What a search beside sigma found; raises KeyboardInterrupt again if one ended it, so that all beside it ends."""
    if found.status == "interrupted":
        raise KeyboardInterrupt
    return found


class ProvenSigma(NamedTuple):
    """What balls proved: sigma >= lower over every window, its ends moved outward by `slack`; "closed" or why not."""

    lower: float
    slack: float
    status: str


@dataclass(frozen=True, repr=False)
class SigmaDeviations(PlainRecord):
    """Proven sigma of schedules that are not kept to the letter; of functions of time `sampled`, and nothing is proven.

    Attributes
    ----------
    tolerance : TimingTolerance
        How early or late each sample may be.
    late : float
        Sigma over windows of the stated length for all such times; of a rule with a tolerance that was asked for, over
        those that are early and late together longer than its own.
    late_wider : float
        The same over windows that are early and late together longer: they hold every sample that was planned in the
        shorter one.
    lost : float
        Sigma if any one sample is lost once.
    lost_sample : int or None
        Which loss leaves that, counted from 0; None where it is that of any schedule of a family.
    time_unit : str
    in_sigma : bool
        Whether sigma itself is then proven for such times.
    sampled : bool
        Whether these are the least of windows, times and losses that were looked at.
    """

    tolerance: TimingTolerance
    late: float
    late_wider: float
    lost: float
    lost_sample: int | None
    time_unit: str
    in_sigma: bool = False
    sampled: bool = False

    _plain = "tolerance:tolerance.plain in_sigma late late_wider lost lost_sample time_unit strength?:_strength"

    def _strength(self) -> str | None:
        return "sampled" if self.sampled else None

    def _rows(self) -> list[tuple[str, str]]:
        wider = f"windows {short(2 * self.tolerance.radius)} {self.time_unit} longer"
        which = "" if self.lost_sample is None else f" (sample {self.lost_sample + 1})"
        looked = ", sampled" if self.sampled else ""
        lost = ("if one sample is lost", below(self.lost) + which + looked)
        if self.in_sigma:  # sigma itself is then of such times
            return [lost]
        late = f"{below(self.late)}; {below(self.late_wider)} in {wider}{looked}"
        return [(f"if {self.tolerance.describe(self.time_unit)}", late), lost]

    def explain(self) -> str:
        """Say what is left of sigma; of late samples only where they were not asked for."""
        lost = f"If one sample is lost, {_at_least(self.lost)}."
        if self.in_sigma:
            return lost
        wider = f"{short(2 * self.tolerance.radius)} {self.time_unit}"
        if self.sampled:
            return (
                f"Of samples that come {self.tolerance.describe(self.time_unit)}, sigma was seen to fall to "
                f"{below(self.late)}, and to {below(self.late_wider)} over windows that are {wider} longer; of one "
                f"lost sample to {below(self.lost)}. None of this is proven."
            )
        return (
            f"If samples come {self.tolerance.describe(self.time_unit)}, {_at_least(self.late)}; over windows that are "
            f"{wider} longer, {_at_least(self.late_wider)}. {lost}"
        )


def _at_least(sigma: float) -> str:
    return f"sigma is at least {below(sigma)}" if sigma > 0 else "no sigma above 0 is proven"


@dataclass(frozen=True, eq=False, repr=False)
class SigmaBracket(PlainRecord):
    """A proven lower and an attained upper bound of sigma, with why the search between them ended.

    `beside` works out `deviations`, where that is possible.
    """

    lower: float = field(kw_only=True)
    upper: float = field(kw_only=True)
    status: str = field(kw_only=True)
    rtol: float = field(kw_only=True)
    coordinates: str = field(default="physical", kw_only=True)
    rigorous: bool = field(default=False, kw_only=True)
    beside: Callable[[], SigmaDeviations | None] | None = field(default=None, kw_only=True)

    _good = "sigma at least {_at_least}, {_value_attained} ({coordinates} coordinates, state at the window's start)"
    _balls = "`rigorous=True` proves `lower` in ball arithmetic; {at} attains `upper`"

    @cached_property
    def deviations(self) -> SigmaDeviations | None:
        """What is left of `lower` if samples come early or late or one is lost, worked out when it is asked for.

        In doubles, also of what ball arithmetic proves. None where sigma is nothing or doubles do not show it, where
        too little of a budget (over a box of ten times what the bracket took) is left, and after an interrupt (of this
        work, too), which asks for no more. Along a plant that varies in time as functions say they are `sampled`, as
        sigma itself.
        """
        if self.status == "interrupted":
            return None
        sigma = self.upper if self.status == "sampled" else self.lower
        try:
            return self.beside() if self.beside is not None and 0 < sigma < np.inf else None
        except KeyboardInterrupt:  # the bracket is proven, and is said
            return None

    def _rows(self) -> list[tuple[str, str]]:
        return [*super()._rows(), *([] if self.deviations is None else self.deviations._rows())]

    @property
    def closed(self) -> bool:
        """Whether lower >= (1 - rtol) upper, or sigma is zero: exactly, or below rounding."""
        return self.status not in UNSETTLED

    @property
    def _is_undecided(self) -> bool:
        """Whether 0 is all that is known: the search has not come to a bound yet."""
        return self.lower == 0 and not self.closed

    def _at_least(self) -> str:
        return "0, undecided" if self._is_undecided else below(self.lower)

    def _value_attained(self) -> str:
        if self._is_undecided and np.isinf(self.upper):
            return "none is attained yet"
        return f"{above(self.upper)} is attained"

    @property
    def _grounds(self) -> str:
        if self._is_undecided:
            return "nothing is proven"
        return "proven in ball arithmetic" if self.rigorous else "proven"

    def _concluded(self, claim: str, where: str, reasons: dict[str, str]) -> str:
        """The claim, what is attained and where; why the bracket did not close, if `reasons` knows the status.

        And what is left of it if samples are late or lost.
        """
        if self._is_undecided and self.status in reasons:
            return (
                f"Nothing is proven yet, whether sigma is positive is undecided: {self._value_attained()}, and "
                f"{reasons[self.status]}. {where}."
            )
        reached = f" and {self._value_attained()}"
        if self.status in reasons:
            reached = f"; {self._value_attained()}, and {reasons[self.status]}"
        left = "" if self.deviations is None else f" {self.deviations.explain()}"
        return f"{claim}{reached}. {where}.{left}"


def in_balls(found: Bracket, proof: ProvenSigma, room: float = 1.0) -> Bracket:
    """Return a bracket with the lower bound that ball arithmetic proves; `room`: how much wider it may stay."""
    status = found.status
    if proof.status == "interrupted":  # what floats have proven stands
        return replace(found, status=proof.status)
    if status == "closed" and not proof.lower >= (1 - room * found.rtol) * found.upper:
        status = proof.status if proof.status != "closed" else "rounding"
    return replace(found, lower=proof.lower, status=status, rigorous=True)


def coordinates_of(plant: Plant, retained: Plant | None = None) -> str:
    """Which coordinates sigma of a plant refers to: those of its scales, where it has any, or of chosen rows.

    Of what is `retained` of it "modal": an orthonormal basis of that.
    """
    if isinstance(plant, FunctionalPlant):
        return "functional"
    if retained is not None and retained is not plant:
        return "modal"
    return "scaled" if plant.has_scales else "physical"


def rtol_and_seconds(rtol: float, budget: float | None) -> tuple[float, float]:
    """Return the width of a bracket and the seconds for it, checked; no budget is no limit.

    Raises ArgumentError if a number is out of range.
    """
    width = checks.positive("rtol", rtol)
    if width >= 1:
        raise ArgumentError(f"`rtol` must be less than 1, got {width!r}.")
    return width, np.inf if budget is None else checks.nonnegative("budget", budget)


NO_STATES = "The plant has no states: there is nothing to observe, and sigma is infinite."
