"""How a check ends."""

from collections.abc import Callable
from dataclasses import asdict, dataclass

MOST_WORK = 1e7  # of one check


class WorkLimit:
    """Operations that are left, in units of about a microsecond; what a share of it spends counts here too."""

    def __init__(
        self, most: float, whole: "WorkLimit | None" = None, price: float = 1.0, stop: Callable[[], bool] | None = None
    ) -> None:
        self.left, self.whole, self.price = most, whole, price  # what one unit costs the whole
        inherited: Callable[[], bool] | None = None if whole is None else whole.stop
        self.stop: Callable[[], bool] | None = inherited if stop is None else stop  # says when time is over

    def spend(self, amount: float) -> None:
        """Count what is about to be done."""
        self.left -= amount
        if self.whole is not None:
            self.whole.spend(self.price * amount)

    def share(self, most: float) -> "WorkLimit":
        """A part of what is left, at most this much."""
        return WorkLimit(min(most, self.left), self)

    @property
    def over(self) -> bool:
        """Whether nothing is left."""
        return self.left <= 0 or (self.stop is not None and self.stop())


PROVEN, REFUTED, UNDECIDED, BAD_FILE = "proven", "refuted", "undecided", "bad file"
EXIT_CODES = {PROVEN: 0, REFUTED: 1, BAD_FILE: 2, UNDECIDED: 3}


class Refused(Exception):
    """The first inequality that fails: its name, one sentence and, where known, amount, time, window, direction."""

    verdict = REFUTED

    def __init__(
        self,
        inequality: str,
        reason: str,
        amount: float = 0.0,
        time: float | None = None,
        start: float | None = None,
        direction: list[float] | None = None,
    ) -> None:
        super().__init__(reason)
        self.inequality, self.reason, self.amount = inequality, reason, amount
        self.time, self.start, self.direction = time, start, direction


class Undecided(Refused):
    """What these floats can neither prove nor disprove: it is tight, or rounding is as large as what is left."""

    verdict = UNDECIDED


@dataclass(frozen=True)
class Verdict:
    """The verdict on one file.

    `amount` is the least slack found, relative (negative: how far the inequality is violated); `time` and `start` say
    when it fails in which window, `direction` along which states and disturbances, each where that is known.
    """

    verdict: str
    inequality: str
    reason: str
    amount: float = 0.0
    time: float | None = None
    start: float | None = None
    direction: list[float] | None = None

    @property
    def passed(self) -> bool:
        """Whether the certificate is proven."""
        return self.verdict == PROVEN

    def __bool__(self) -> bool:
        if self.verdict == UNDECIDED:
            raise Undecided(self.inequality, "an undecided verdict is neither true nor false: ask `.verdict`")
        return self.passed

    @property
    def exit_code(self) -> int:
        """0 proven, 1 the mathematics says no, 2 bad file, 3 undecided."""
        return EXIT_CODES[self.verdict]

    def to_dict(self) -> dict[str, object]:
        """Plain data."""
        return {"passed": self.passed, **asdict(self)}


def holds(inequality: str, slack: float, subject: str) -> Verdict:
    """The verdict that an inequality is proven for its subject."""
    return Verdict(PROVEN, inequality, f"{inequality} for {subject}, slack {slack:.3g}", slack)


def refused(error: Refused) -> Verdict:
    """The verdict that an exception carries."""
    where = error.amount, error.time, error.start, error.direction
    return Verdict(error.verdict, error.inequality, error.reason, *where)
