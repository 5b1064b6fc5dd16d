"""What every bracket of sigma shows and says, of one schedule or of the worst of a family."""

from __future__ import annotations

from sampling_design._record import Record, short


class SigmaBracket(Record):
    """A proven lower and an attained upper bound of sigma, with why the search between them ended."""

    lower: float
    upper: float
    status: str
    rigorous: bool

    @property
    def _grounds(self) -> str:
        if self.status == "sampled":
            return "nothing is proven"
        return "proven in ball arithmetic" if self.rigorous else "proven"

    def _between(self, *inside: tuple[str, str], scaled: SigmaBracket | None) -> list[tuple[str, str]]:
        """The rows of the table: both bounds, those of the kind, and sigma in scaled coordinates where there is one."""
        rows = [
            ("sigma at least", f"{short(self.lower)} ({self._grounds}, state at the window's start)"),
            ("sigma at most", f"{short(self.upper)} (attained)"),
            *inside,
        ]
        if scaled is not None:
            rows.append(("sigma, scaled", f"{short(scaled.lower)} to {short(scaled.upper)}"))
        return rows

    def _concluded(self, claim: str, where: str, reasons: dict[str, str]) -> str:
        """The claim, what is attained and where; why the bracket did not close, if `reasons` knows the status."""
        if self.status not in reasons:
            return f"{claim} and {short(self.upper)} is attained. {where}."
        return f"{claim}; {short(self.upper)} is attained, and {reasons[self.status]}. {where}."


NO_STATES = "The plant has no states: there is nothing to see, and sigma is infinite."
