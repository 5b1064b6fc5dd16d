"""An interrupt that carries what was held when it came."""

from __future__ import annotations


class DesignInterrupt(KeyboardInterrupt):
    """An interrupt (Ctrl-C) of a step of a design, with the best that the step had by then."""

    def __init__(self, best: object) -> None:
        super().__init__()
        self.best = best
