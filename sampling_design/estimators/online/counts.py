"""What many estimates come to, counted as they come."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from sampling_design.estimators.online.estimate import FAILURES, Contradiction, Estimate, Status
from sampling_design.estimators.records.measurement_table import time_or_date
from sampling_design.records.record import counted


@dataclass
class EstimateCounts:
    """Counts of estimates in order of time; no a-priori claim is about those that were `moved` into their intervals."""

    time_unit: str
    moved: bool = False
    origin: str = ""
    count: int = 0
    first: float = 0.0
    last: float = 0.0
    status: Counter[Status] = field(default_factory=Counter)
    certified: int = 0
    on_schedule: int = 0
    contradictions: dict[Contradiction, None] = field(default_factory=dict)

    def add(self, t: float, estimate: Estimate) -> None:
        """Count one estimate more, at t."""
        self.take(t, estimate.status, estimate.certified, estimate.on_schedule, estimate.contradiction)

    def take(
        self, t: float, status: Status, certified: bool, on_schedule: bool, contradiction: Contradiction | None
    ) -> None:
        """Count what is said of one estimate more."""
        if not self.count:
            self.first = t
        self.count += 1
        self.last = t
        self.status[status] += 1
        self.certified += bool(certified)
        self.on_schedule += bool(on_schedule)
        if contradiction is not None:
            self.contradictions.setdefault(contradiction)

    @property
    def what(self) -> str:
        """How many estimates there are, of which times, and where they lie."""
        first, last = (time_or_date(self.origin, t, self.time_unit) for t in (self.first, self.last))
        span = f" from {first.removesuffix(f' {self.time_unit}')} to {last}" if self.count else ""
        where = ", in the middle of what data and bounds allow" if self.moved else ""
        return f"{counted(self.count, 'estimate')} of the state{span}{where}"

    @property
    def evidence(self) -> str:
        """Of how many a radius is proven."""
        many = f"the radii of {self.certified} of {self.count}, where the bounds hold"
        return f"proven: {many}" if self.certified else "nothing is proven"

    def rows(self) -> list[tuple[str, str]]:
        """Rows of a table."""
        return [
            ("what", self.what),
            ("evidence", self.evidence),
            ("status", ", ".join(f"{k}: {v}" for k, v in self.status.items()) or "-"),
            *([] if self.moved else [("on schedule", f"{self.on_schedule} of {self.count}")]),
            *(("contradiction", str(each)) for each in self.contradictions),
        ]

    def explain(self) -> str:
        """Say how many estimates there are and what they promise."""
        failed = sum(count for status, count in self.status.items() if status in FAILURES)
        trouble = f" {failed} failed; their notes say why." if failed else ""
        for each in self.contradictions:
            trouble += f" The data contradict the bounds: {each}."
        where = ", each in the middle of what data and bounds allow" * self.moved
        return f"{counted(self.count, 'estimate')}{where}, {self.certified} of them with a proven radius.{trouble}"
