"""Random plants and schedules: does `certificate_exists` say what 50 digits say? `bench_existence.py [count] [first]`.

Plants of up to 9 states with Jordan blocks, stiff modes and hidden modes, one or two outputs, in random coordinates
and units (1e-12 to 1e12 for every state and output, 1e-9 to 1e9 for time); a third of the schedules alias something.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from sampling_design import certificate_exists
from sampling_design.errors import UndecidedError
from tests.oracles.existence import drawn, least_seen, schedule_drawn
from tests.rescale import Units

CLEAR = 1e-6
"""A margin in 50 digits from which a mode is plainly seen; below `NOTHING` it is plainly not."""
NOTHING = 1e-12


def verdicts(seed: int) -> tuple[str, float, float, float]:
    """The verdict, the margin in 50 digits, the margin found, and the seconds of CPU that it took."""
    rng = np.random.default_rng(seed)
    known = drawn(rng)
    schedule = schedule_drawn(rng, known)
    eta = float(rng.choice([0.0, 0.05, 0.3, 1.0]))
    truth = least_seen(known, schedule, eta)
    units = Units.drawn(rng, known.plant)
    began = time.process_time()
    try:
        found = certificate_exists(units.plant(known.plant), units.schedule(schedule), eta / units.time)
    except UndecidedError as undecided:
        return "undecided", truth, float(undecided.details["margin"]), time.process_time() - began
    spent = time.process_time() - began
    if truth >= CLEAR and not found.exists:
        return "false no", truth, found.margin, spent
    if truth <= NOTHING and found.exists:
        return "false yes", truth, found.margin, spent
    return (
        ("yes" if found.exists else "no") + (" (near)" if NOTHING < truth < CLEAR else ""),
        truth,
        found.margin,
        spent,
    )


def main(count: int, first: int = 0) -> None:
    """Print the counts of the seeds from `first` on."""
    counts: Counter[str] = Counter()
    slowest = 0.0
    for seed in range(first, first + count):
        verdict, truth, margin, spent = verdicts(seed)
        counts[verdict] += 1
        slowest = max(slowest, spent)
        if verdict in ("false no", "false yes", "undecided"):
            print(f"seed {seed}: {verdict}, 50 digits {truth:.3g}, found {margin:.3g}")
    print(", ".join(f"{k} {v}" for k, v in sorted(counts.items())), f"of {count}; slowest {slowest:.2f} s of CPU")


if __name__ == "__main__":
    main(*(int(word) for word in sys.argv[1:3] or ["500"]))
