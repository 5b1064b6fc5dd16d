"""Work counted, never timed: a search that stops after so much work finds the same plan on every machine, however busy.

The unit is about a second of an ordinary processor core, worked out from the sizes of what is solved.
"""

from __future__ import annotations

CONE = (1e-3, 1e-6)
"""Work of a cone program, and for each entry that is not zero."""

STAGES = (3e-2, 3e-5)
"""Of a program over stages, and for each of them, with n states, n^1.5 times."""

FAINT = (2e-3, 4e-6)
"""The same where every output is a variable."""

COVER = (5e-3, 2e-5)
"""Of an integer program, and for each entry and node of its tree."""

WEIGHED = 6e-4
"""For each attack, of weighing what may take the place of a measurement."""

FILTER = (4e-5, 1e-7)
"""Of each step of a filter, and for each choice, step and state."""


class Work:
    """A budget of work and what is spent of it."""

    def __init__(self, limit: float = float("inf")) -> None:
        self.limit, self.budget, self.spent = limit, limit, 0.0

    @property
    def over(self) -> bool:
        """Whether the budget is spent."""
        return self.spent > self.limit

    def add(self, price: tuple[float, float], size: float) -> None:
        """Count a program of so many entries."""
        self.spent += price[0] + price[1] * size

    def extend(self, share: float) -> None:
        """Let a share of the budget be spent from now on, if no more is left."""
        if self.limit < float("inf"):
            self.limit = max(self.limit, self.spent + share * self.budget)
