"""How the command line ends: one sentence on stderr, an exit code, and an interrupt that is one at any moment.

Only what Python itself has loaded is imported here, so that an interrupt while everything else loads is caught too.
"""

from __future__ import annotations

import atexit
import codecs
import io
import os
import signal
import sys
from typing import NoReturn, TextIO

from sampling_design.cli.version import show_version

DEFECT = 70  # exit code of an error that is none of ours: a defect of this program, with its traceback
INTERRUPTED = 130  # exit code of an interrupt, as shells have it
SIGNALS = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
"""What interrupts a command, where nobody has taken it yet: Ctrl-C, and what ends programs (`kill`, batch systems)."""
ESCAPED = "sampling-design"  # how letters are written that an encoding has not
ONE_THREAD = "OPENBLAS_NUM_THREADS"
"""Matrices here have 2 to 20 rows: a second thread of the BLAS waits, and takes half as many seconds again."""


class _InterruptHandler:
    """Remembers that it was rung: some libraries turn KeyboardInterrupt into errors of their own, or swallow it."""

    def __init__(self) -> None:
        self.rung = False
        self.before, self.hook = {each: signal.getsignal(each) for each in SIGNALS}, sys.unraisablehook
        for each in SIGNALS:
            if self.before[each] is SIGNALS[each]:  # not where a parent ignores it for us
                signal.signal(each, self._ring)
                sys.unraisablehook = self._unraisable

    def _ring(self, *_: object) -> None:
        self.rung = True
        raise KeyboardInterrupt

    def _unraisable(self, found: sys.UnraisableHookArgs) -> None:
        if self.rung:
            self.end()
        sys.__unraisablehook__(found)

    def close(self) -> None:
        """Give back what was there before; after an interrupt a second one must not show Python's way out.

        Nor must one that comes on that way: the work is done, and the exit code says of it what it is.
        """
        handler, sys.unraisablehook = self.before[signal.SIGINT], self.hook
        signal.signal(signal.SIGTERM, self.before[signal.SIGTERM])
        signal.signal(signal.SIGINT, signal.SIG_IGN if self.rung else handler)
        if handler is signal.default_int_handler:
            atexit.unregister(_ignore_interrupts)
            atexit.register(_ignore_interrupts)  # the last that is registered is the first that is called

    @staticmethod
    def end() -> NoReturn:
        """Leave at once: what still runs (threads, half-loaded libraries) has nothing to say any more."""
        _say("interrupted.")
        os._exit(INTERRUPTED)


def _ignore_interrupts() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def main() -> None:
    """Run the command line; every expected error is one sentence on stderr."""
    os.environ.setdefault(ONE_THREAD, "1")  # read by the BLAS when numpy is imported, here and in worker processes
    interrupt = _InterruptHandler()
    try:
        _write_all_letters()
        code = _run()
        if interrupt.rung:
            raise KeyboardInterrupt
    except BaseException as error:
        code = _ending(KeyboardInterrupt() if interrupt.rung else error)
    finally:
        interrupt.close()
    sys.exit(code)


def _write_all_letters() -> None:
    """Let a letter that the output's encoding has not (a pipe of Windows, LANG=C) be written as JSON escapes it."""
    codecs.register_error(ESCAPED, _escaped)
    for stream in (sys.stdout, sys.stderr):
        match stream:
            case io.TextIOWrapper():
                stream.reconfigure(errors=ESCAPED)


def _escaped(error: UnicodeError) -> tuple[str, int]:
    import json

    match error:
        case UnicodeEncodeError():
            return json.dumps(error.object[error.start : error.end])[1:-1], error.end
    raise error


def _run() -> int:
    try:
        show_version(sys.argv[1:] == ["--version"])  # before anything that reads the other flags is imported
        from sampling_design.cli import app

        app.app(standalone_mode=True)
    except SystemExit as stop:
        match stop.__context__:
            case KeyboardInterrupt():
                raise KeyboardInterrupt from None
            case OSError() as error:
                raise error from None
        return stop.code if isinstance(stop.code, int) else int(stop.code is not None)
    return 0


def _ending(error: BaseException) -> int:
    """Say what went wrong, and return the exit code."""
    match error:
        case KeyboardInterrupt():  # before anything is imported: numpy, left in the middle, does not load again
            _say("interrupted.")
            if (processes := sys.modules.get("multiprocessing")) is not None:
                for each in processes.active_children():  # who have not got the signal
                    each.terminate()
            exec("")  # Python remembers one that left an `exec`, as in namedtuple, and would end by the signal itself
            return INTERRUPTED
    from sampling_design.errors import SamplingDesignError

    match error:
        case SamplingDesignError():
            _say(str(error))
            return error.exit_code
        case BrokenPipeError():  # whoever read us has seen enough
            _drop(sys.stdout)
            return 0
        case OSError(filename=None):
            _drop(sys.stdout)
            _say(f"the output cannot be written ({error.strerror or error}).")
            return 2
        case MemoryError():
            _say(f"this needs more memory than there is ({str(error) or 'none left'}).")
            return 3
    import traceback

    traceback.print_exception(error)
    _say(f"a defect of this program, please report it: {type(error).__name__} ({str(error).splitlines()[:1]}).")
    return DEFECT


def _say(text: str) -> None:
    try:
        sys.stderr.write(f"sampling-design: {text}\n")
        sys.stderr.flush()
    except (OSError, ValueError):  # nobody listens
        pass


def _drop(stream: TextIO) -> None:
    """Let what is still in a stream's buffer go nowhere: Python would complain on its way out."""
    try:
        hole = os.open(os.devnull, os.O_WRONLY)
        os.dup2(hole, stream.fileno())
    except (OSError, ValueError):
        pass
