"""What every bracket of sigma shows and says, of one schedule or of the worst of a family."""

from __future__ import annotations

from typing import Protocol

from sampling_design.records.record import Record, short


class SigmaBracket(Record):
    """A proven lower and an attained upper bound of sigma, with why the search between them ended."""

    lower: float
    upper: float
    status: str
    rigorous: bool
    coordinates: str

    @property
    def _grounds(self) -> str:
        if self.status == "sampled":
            return "nothing is proven"
        return "proven in ball arithmetic" if self.rigorous else "proven"

    def _between(self, *inside: tuple[str, str]) -> list[tuple[str, str]]:
        """The rows of the table: both bounds, and those of the kind."""
        where = f"{self.coordinates} coordinates, state at the window's start"
        return [
            ("sigma at least", f"{short(self.lower)} ({self._grounds}; {where})"),
            ("sigma at most", f"{short(self.upper)} (attained)"),
            *inside,
        ]

    def _concluded(self, claim: str, where: str, reasons: dict[str, str]) -> str:
        """The claim, what is attained and where; why the bracket did not close, if `reasons` knows the status."""
        if self.status not in reasons:
            return f"{claim} and {short(self.upper)} is attained. {where}."
        return f"{claim}; {short(self.upper)} is attained, and {reasons[self.status]}. {where}."


class HasScales(Protocol):
    """A plant of any kind that says whether its states have scales."""

    @property
    def has_scales(self) -> bool:
        """Whether they have."""


def coordinates_of(plant: HasScales) -> str:
    """Which coordinates sigma of a plant refers to: those of its scales, where it has any."""
    return "scaled" if plant.has_scales else "physical"


NO_STATES = "The plant has no states: there is nothing to see, and sigma is infinite."
