"""How much the search for one certificate may do: counted, not timed, the same on every machine."""

from __future__ import annotations

from math import log

from sampling_design.checkers.work import Work

LOOK_WORK = 2e6
"""Work, about microseconds, in which the windows of one choice of weights are followed, and of all choices twice that;
what they have met by then is tried."""
CHECK_WORK, ONE_CHECK = 6e6, 4e6
"""Work of the proofs in floats, for all choices of weights together, and of one of them."""
BALL_WORK, ONE_IN_BALLS = 4e6, 2e6
"""Likewise in balls, where nine states and four samples a period take 1.3e6, and one of it about two microseconds;
later ones may take as much each."""
LATER = 0.7
"""Share of that for the spare choices, and for the round ones; one of their checks in floats may do as much as one of
the first ones, or what takes much work would never be proven."""
PRECISE_WORK, PRECISE_PROOF = 4e6, 2e6
"""Work of the search in more digits than doubles have, and of its proofs together; of one of them."""
FINER = 4
"""How much finer the second look for a missed peak is than the first."""
HIGHER = 1 + 1e-6
"""By which factor lambda is higher so that a proof is tried again: P1 is stated a thousandth lower than it is."""
ATTEMPTS = 8
"""How often a window that the checker found may raise lambda before the proof is given up."""
ROOM = (1.003, 1.03, 1.3, 3.0)
"""Factors by which lambda is stated above the largest that was met, one after the other, where the checker's bound of
its own rounding leaves no other proof."""
BEYOND = 16 * log(10)
"""ln of the lambda from which on P1 = P2/lambda is lost in the rounding of doubles: tried where nothing less is."""


class Efforts:
    """What all the looks and proofs for one certificate may do together, or those of later choices."""

    def __init__(self, share: float = 1.0) -> None:
        self.looks, self.floats = Work(2 * share * LOOK_WORK), Work(share * CHECK_WORK)
        self.balls, self.one = Work(max(share * BALL_WORK, ONE_IN_BALLS)), ONE_CHECK

    def check(self) -> Work:
        """What the next check in floats may do."""
        return self.floats.share(self.one)

    def check_in_balls(self) -> Work:
        """What the next check in balls may do."""
        return self.balls.share(ONE_IN_BALLS)
