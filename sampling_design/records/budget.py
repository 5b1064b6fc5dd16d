"""What a computation may take: seconds of the house's one clock, or counted where a record must be the same everywhere.

Whoever works on looks whether its budget is `over`, or lets `check` raise, and answers with what is proven by then.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import numpy as np

from sampling_design.checkers.outcome import WorkLimit
from sampling_design.records.signatures import checked

Progress = Callable[[float, str], None]  # Called with the fraction done, and what is known by then


@checked
def progress_bar(label: str = "") -> AbstractContextManager[Progress]:
    """Return a context that yields a `progress` for any verb: a bar with seconds and message, in terminal or notebook.

    In a terminal it stands on stderr and leaves no trace; where stderr is no terminal and there is no notebook, nothing
    is drawn.

    Parameters
    ----------
    label : str
        What stands before the bar.

    Returns
    -------
    context manager
        What it yields is a function of the fraction done and a message, for the argument `progress`.

    Examples
    --------
    >>> import sampling_design as sd
    >>> with sd.records.progress_bar("design") as progress:
    ...     design = sd.design_schedule(sd.named_plant("oscillator"), branches=0, progress=progress)
    """
    return _bar(label)


@contextmanager
def _bar(label: str) -> Iterator[Progress]:
    from rich.console import Console

    console = Console(stderr=True)
    if not (console.is_terminal or console.is_jupyter):
        yield lambda fraction, message: None
        return
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TextColumn("{task.fields[note]}"))
    with Bar(*columns, console=console, transient=True) as bar:
        task = bar.add_task(label, total=1.0, note="")
        yield lambda fraction, message: bar.update(task, completed=fraction, note=message)


def now() -> float:
    """Seconds of the one clock that is read in this package; only differences count."""
    return time.perf_counter()


def processor_seconds() -> float:
    """Seconds that the processor has worked for this thread: for reports, whatever else the machine does."""
    return time.thread_time()


class BudgetSpentError(Exception):
    """There is nothing left for what is being done."""


class Budget:
    """Seconds that may be taken from now on.

    Parameters
    ----------
    seconds : float, optional
        None: without end.
    counted : bool
        Seconds are not those of the clock, but those that `spend` and `add` count: about what an ordinary processor
        core takes, and the same on every machine, however busy.
    work : WorkLimit, optional
        Operations of a checker, which are counted by `check` beside the seconds; it ends with the first of both.
    whole : Budget, optional
        What this is a part of: it ends no later.

    Attributes
    ----------
    seconds : float
        What was given.
    limit : float
        What may be spent by now: more than that after `extend`, less after `stop`.
    firm : bool
        Whether what does not fit in is refused where it is counted.
    """

    def __init__(
        self,
        seconds: float | None = None,
        *,
        counted: bool = False,
        work: WorkLimit | None = None,
        whole: Budget | None = None,
    ) -> None:
        self.seconds = self.limit = np.inf if seconds is None else float(seconds)
        self.counted, self.work, self.whole, self.firm = counted, work, whole, False
        self._began = 0.0 if counted else now()
        self._counted = 0.0

    @property
    def spent(self) -> float:
        """Seconds since it began, or those that were counted."""
        return self._counted if self.counted else now() - self._began

    @property
    def left(self) -> float:
        """Seconds that are left, never below zero."""
        own = max(self.limit - self.spent, 0.0)
        return own if self.whole is None else min(own, self.whole.left)

    @property
    def over(self) -> bool:
        """Whether it is spent."""
        if self.work is not None and self.work.over:
            return True
        return self.spent > self.limit or (self.whole is not None and self.whole.over)

    def seconds_left(self, least: float = 0.0, share: float = 1.0) -> float | None:
        """A share of what is left, at least so much, as solvers take it: None where there is no end."""
        left = self.left
        return max(share * left, least) if np.isfinite(left) else None

    def share(self, fraction: float) -> Budget:
        """A fraction of what is left, from now on."""
        return Budget(fraction * self.left, counted=self.counted, whole=self)

    def check(self, price: float = 0.0) -> None:
        """Raise once it is spent; `price` counts operations of about a microsecond.

        Raises BudgetSpentError if nothing is left.
        """
        if self.work is not None:
            self.work.spend(price)
            if self.work.over:
                raise BudgetSpentError("the work ran out")
        if self.over:
            raise BudgetSpentError("the budget ran out")

    def spend(self, seconds: float) -> None:
        """Count what is about to be done, if seconds are counted.

        Raises BudgetSpentError if it does not fit in, and the limit is firm.
        """
        if not self.counted:
            return
        if self.firm and self.spent + seconds > self.limit:
            raise BudgetSpentError("it does not fit into what is left")
        self._counted += seconds
        if self.whole is not None:
            self.whole.spend(seconds)

    def add(self, price: tuple[float, float], size: float) -> None:
        """Count a program of so many entries, by its price and that of each entry."""
        self.spend(price[0] + price[1] * size)

    def extend(self, share: float, seconds: float, *, firm: bool = False) -> None:
        """Let so much be spent in all beyond what was given: a share of it, and seconds."""
        self.limit, self.firm = (1 + share) * self.seconds + seconds, firm

    def stop(self) -> None:
        """Let it be over: after an interrupt what is proven is the answer."""
        self.limit, self.firm = min(self.limit, -1.0), False

    @property
    def stopped(self) -> bool:
        """Whether it was."""
        return self.limit < 0

    def __getstate__(self) -> dict[str, object]:
        """What travels to another process or machine, whose clock counts from elsewhere."""
        return {**vars(self), "_sent": (self.spent, time.time())}

    def __setstate__(self, state: dict[str, object]) -> None:
        """The same budget by this machine's clock, less the time on the way."""
        vars(self).update(state)
        spent, sent = vars(self).pop("_sent")
        if not self.counted:
            self._began = now() - spent - max(time.time() - sent, 0.0)


ENDLESS = Budget()  # what a computation may take that was given no budget
