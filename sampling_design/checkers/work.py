"""How much may be done: counted, so that a call ends in the same way on every machine, unless it is told when."""

from collections.abc import Callable

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
