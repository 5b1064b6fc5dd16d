"""How a long verb tells what it has so far: a function of the fraction done and a message, or a bar that shows both."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

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
    ...     design = sd.design_schedule(sd.named_plant("oscillator"), progress=progress)
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
