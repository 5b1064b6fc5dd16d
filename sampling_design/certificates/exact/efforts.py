"""How much the search for one certificate may do: counted, not timed, the same on every machine."""

from __future__ import annotations

from sampling_design.checkers.work import Work

LOOK_WORK = 2e6
"""Work, about microseconds, in which the windows of one choice of weights are followed, and of all choices twice that;
what they have met by then is tried."""
CHECK_WORK, BALL_WORK, ONE_CHECK = 5e6, 2e6, 2.5e6
"""Work of the proofs in floats and in balls, for all choices of weights together, and of one check in floats; once more
as much for the spare choices."""


class Efforts:
    """What all the looks and proofs for one certificate may do together."""

    def __init__(self) -> None:
        self.looks, self.floats, self.balls = Work(2 * LOOK_WORK), Work(CHECK_WORK), Work(BALL_WORK)

    def check(self) -> Work:
        """What the next check in floats may do."""
        return self.floats.share(ONE_CHECK)
