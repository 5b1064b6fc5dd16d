"""How a plant and a schedule go from file to file: `python tests/benchmarks/ways.py`.

Three calls are watched while they run. A file counts as entered when one of its functions is called with the plant, or
the schedule, among its arguments; it is returned to when that happens again after another file was.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

import sampling_design as sd

PACKAGE = Path(sd.__file__).parent


def way(call: Callable[[], object], *followed: object) -> list[str]:
    """The files through which any of these things went as an argument, in order, each stay once."""
    seen: list[str] = []

    def watched(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        if event != "call" or not code.co_filename.startswith(str(PACKAGE)):
            return
        names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
        if any(frame.f_locals.get(name) is each for name in names for each in followed):
            file = str(Path(code.co_filename).relative_to(PACKAGE))
            seen.extend([file] if seen[-1:] != [file] else [])

    sys.setprofile(watched)
    try:
        call()
    finally:
        sys.setprofile(None)
    return [file for file in seen if not file.startswith("records")]  # what checks every call is no way


def main() -> None:
    """Print files entered, and returns to a file that was left, for each of the three."""
    plant = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    schedule = sd.PeriodicSchedule([0.7, 1.6, 0.9])
    asked = sd.Requirement(window=4.0, spacing=0.4, samples=3)
    accuracy = getattr(sd, "guaranteed_accuracy", None) or sd.accuracy
    ways = {
        "certify": lambda: sd.certify(plant, schedule, eta=0.3),
        "design_schedule": lambda: sd.design_schedule(plant, asked, starts=1, budget=5.0),
        "guaranteed_accuracy": lambda: accuracy(plant, schedule, w_bound=0.1, v_bound=0.1, rtol=0.1),
    }
    for name, call in ways.items():
        call()  # what is imported on first use has been
        stays = way(call, plant, schedule)
        stays = [file for k, file in enumerate(stays) if k == 0 or stays[k - 1] != file]
        print(f"{name}: {len(set(stays))} files, {len(stays) - len(set(stays))} returns")


if __name__ == "__main__":
    main()
