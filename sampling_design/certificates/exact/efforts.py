"""How much the search for one certificate may do: counted, not timed, the same on every machine."""

from __future__ import annotations

from collections.abc import Iterator
from math import log

from sampling_design.checkers.outcome import WorkLimit

LOOK_WORK = 2e6
"""Work, about microseconds, in which the windows of one choice of weights are followed, and of all choices twice that;
what they have met by then is tried."""
CHECK_WORK, ONE_CHECK = 6e6, 2.5e6
"""Work of the proofs in floats, for all choices of weights together, and of one of them."""
BALL_WORK, ONE_IN_BALLS = 2.7e6, 2.5e6
"""Likewise in balls, where eight and nine states take up to 2.4e6, and one of it about two microseconds; a
later group may do one."""
LATER = 0.7
"""Share of that in floats for the spare choices, and for the round ones; one of their checks may do as much as one
of the first ones, or what takes much work would never be proven."""
ALL_WORK, BALL_PRICE = 13e6, 1.7
"""Work of all proofs after the search of weights, where balls count so many times: then a call ends, if need be with
none. It holds nine states to about twenty seconds of an ordinary processor core."""
PARTS = 0.42, 0.55
"""Share of what is left of it that the first group of choices may do, and each later one: the next has its turn."""
PRECISE_WORK, PRECISE_PROOF = 2e6, 6e6
"""Work of the search in more digits than doubles have; of one of its proofs, twice that of
all."""
SPARE_WORK = 5e6  # of one fast rate in more digits, where all other proofs have left nothing
FINER = 4  # how much finer the second look for a missed peak is than the first
HIGHER = 1 + 1e-6
"""By which factor lambda is higher so that a proof is tried again: P1 is stated a thousandth lower than it is."""
ATTEMPTS = 8  # how often a window that the checker found may raise lambda before the proof is given up
ROOM = (1.003, 1.03, 1.3, 3.0)
"""Factors by which lambda is stated above the largest that was met, one after the other, where the checker's bound of
its own rounding leaves no other proof."""
WIDE = 1.3  # from which of them on a proof takes much less work: tried next where one has ended for its work alone
BEYOND = 16 * log(10)
"""ln of the lambda from which on P1 = P2/lambda is lost in the rounding of doubles: tried where nothing less is."""
SEARCHED = 0.5  # share of the seconds of a call that the search of weights may take; the others are for proofs


def wider(rooms: Iterator[float], work: WorkLimit, tried: float) -> float:
    """The next room for a proof that did not close with this work, 0 if there is none; a wide one if that is over."""
    enough = WIDE if work.over else 1.0
    least = WIDE if work.over and tried < WIDE else 0.0
    return next((room for room in rooms if room >= enough and room > tried), least)


class SearchEffort:
    """What the looks and proofs for a group of choices may do; one choice `alone` may do all of it."""

    def __init__(
        self, total: WorkLimit | None = None, share: float = 1.0, balls: float | None = None, *, alone: bool = False
    ) -> None:
        self.total = WorkLimit(ALL_WORK) if total is None else total
        self.whole = self.total if alone else self.total.share(PARTS[balls is not None] * self.total.left)
        self.of_one_check = (CHECK_WORK, BALL_WORK) if alone else (ONE_CHECK, ONE_IN_BALLS)
        self.looks = WorkLimit(2 * share * LOOK_WORK, stop=self.total.stop)
        self.floats = WorkLimit(share * CHECK_WORK, self.whole)
        self.balls = WorkLimit(BALL_WORK if balls is None else balls, self.whole, BALL_PRICE)

    def later(self) -> SearchEffort:
        """Those of the next group: of what is left."""
        return SearchEffort(self.total, LATER, ONE_IN_BALLS)

    @property
    def over(self) -> bool:
        """Whether no proof can follow."""
        return self.floats.over or self.whole.over

    def check(self) -> WorkLimit:
        """What the next check in floats may do."""
        return self.floats.share(min(self.of_one_check[0], self.whole.left))

    def check_in_balls(self) -> WorkLimit:
        """What the next check in balls may do."""
        return self.balls.share(min(self.of_one_check[1], self.whole.left / BALL_PRICE))
