"""The command, and the one door for plain data: `verdict(data)`.

    python -m checkers certificate.json          from the folder that holds this one
    python checkers/check.py < certificate.json  from anywhere

One sentence on standard output. Exit code 0: proven; 1: the mathematics says no; 2: bad file; 3: undecided (tight, or
as near to failing as rounding); 130: interrupted.
"""

import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

if not __package__:  # run as a file: its folder is the package
    here = Path(__file__).resolve().parent
    sys.path[:] = [str(here.parent), *(entry for entry in sys.path if Path(entry or ".").resolve() != here)]
    __package__ = here.name
    __import__(__package__)

if TYPE_CHECKING:
    from .outcome import Verdict, WorkLimit


def verdict(data: Mapping[str, object], work: "WorkLimit | None" = None) -> "Verdict":
    """Return the `Verdict` on the plain data of a certificate file of any claim; `work` is what it may do."""
    from .claims import certificate, claim_of
    from .outcome import BAD_FILE, Verdict
    from .strict import BadFile

    try:
        return verdict_on(certificate(data), claim_of(data).prove, work)
    except BadFile as error:
        return Verdict(BAD_FILE, error.broken, "the data are no certificate: " * (error.broken == "form") + str(error))


def verdict_on(content: object, prove: "Callable[..., Verdict]", work: "WorkLimit | None" = None) -> "Verdict":
    """Return the `Verdict` on the judged content of a file, as its claim proves it."""
    import numpy as np

    from .outcome import MOST_WORK, UNDECIDED, Refused, Verdict, WorkLimit, refused
    from .parts import of_whole_plant

    try:
        with np.errstate(all="ignore"):  # what overflows is compared, and never below a bound
            return of_whole_plant(content, prove(content, WorkLimit(MOST_WORK) if work is None else work))
    except Refused as error:
        return refused(error)
    except (np.linalg.LinAlgError, OverflowError) as error:
        return Verdict(UNDECIDED, "range", f"these numbers are beyond the range of doubles ({error})")


def check(data: Mapping[str, object], work: "WorkLimit | None" = None) -> dict[str, object]:
    """Return the verdict as plain data; the check does at most this `work` (`work.MOST_WORK` unless told)."""
    return verdict(data, work).to_dict()


def main(arguments: list[str]) -> int:
    """Check the file that is named, or standard input; print one sentence and return the exit code."""
    from .strict import BadFile, decoded, from_json

    try:
        if len(arguments) > 1 or arguments[:1] in (["-h"], ["--help"]):
            print(__doc__.strip())
            return 0 if arguments[:1] in (["-h"], ["--help"]) else 2
        content = Path(arguments[0]).read_bytes() if arguments else sys.stdin.buffer.read()
        found = verdict(from_json(decoded(content)))
    except BadFile as error:
        print(f"the data are no certificate: the file {error}".replace("the file `", "`"))
        return 2
    except OSError as error:
        print(f"{arguments[0]}: cannot be read ({error.strerror})")
        return 2
    print(found.reason)
    return int(found.exit_code)


def run() -> None:
    """Run the command: 130 if it is interrupted, no complaint if nobody reads its output."""
    try:
        status = main(sys.argv[1:])
        sys.stdout.flush()
    except KeyboardInterrupt:
        status = 130
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 2
    sys.exit(status)


if __name__ == "__main__":
    run()
