"""Does `certify` close for nearly every detectable plant? `python tests/benchmarks/bench_certify_random.py`.

Random plants of one to nine states: Jordan clusters, integrators, oscillators, fast and slow stable modes, one to three
outputs, some of which see no stable mode, in random coordinates and mixed units (1e-12 to 1e12, time 1e-9 to 1e9; half
of them say so by their scales, half do not); periodic and finite schedules, some with outputs missing.
One line of the record file per plant, so that a run goes on where it stopped; CPU seconds of one process.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import json
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from sampling_design import PeriodicSchedule, Plant, Schedule, certify
from sampling_design.errors import SamplingDesignError, UndecidedError
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.plants.plant import Signals
from tests.rescale import Units

LONG = 20.0
"""CPU seconds that no plant should take."""
RIGOROUS_EACH = 10
"""One plant in so many is decided in ball arithmetic too."""


def jordan(rng: np.random.Generator, n: int) -> np.ndarray:
    """A real block diagonal matrix of about n states, rates in units of the mean gap."""
    blocks, left = [], n
    while left:
        kind = rng.choice(["stable", "slow", "growing", "integrator", "oscillator", "spiral", "fast"])
        size = int(rng.integers(1, min(left, 3) + 1))
        if kind in ("oscillator", "spiral") and left >= 2:
            size = 2 * max(1, size // 2)
            real = 0.0 if kind == "oscillator" else float(rng.uniform(-0.5, 0.2))
            omega = float(rng.uniform(0.1, 2.5))
            turn = np.array([[real, omega], [-omega, real]])
            block = np.kron(np.eye(size // 2), turn) + np.eye(size, k=2)
        else:
            value = {
                "stable": -float(rng.uniform(0.1, 3.0)),
                "slow": -float(10 ** rng.uniform(-3, -1)),
                "growing": float(rng.uniform(0.01, 0.3)),
                "fast": -float(10 ** rng.uniform(1, 2.5)),
            }.get(str(kind), 0.0)
            size = 1 if kind == "fast" else size
            block = value * np.eye(size) + np.eye(size, k=1)
        blocks.append(block)
        left -= size
    A = np.zeros((n, n))
    at = 0
    for block in blocks:
        A[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return A


def times_of(rng: np.random.Generator, outputs: int) -> Any:
    """A schedule of mean gap about one."""
    periodic = rng.random() < 0.75
    count = int(rng.integers(1, 7)) if periodic else int(rng.integers(2, 31))
    gaps = rng.uniform(0.3, 1.7, count)
    mask = None
    if outputs > 1 and rng.random() < 0.3:
        mask = rng.random((count, outputs)) < 0.6
        mask[np.arange(count), rng.integers(0, outputs, count)] = True
    return PeriodicSchedule(gaps, outputs=mask) if periodic else Schedule(np.cumsum(gaps), mask)


def drawn(seed: int) -> tuple[Plant, Any]:
    """The plant and schedule of a seed; its modes are seen, or decay."""
    rng = np.random.default_rng([2024, seed])
    while True:
        n, p, q = (int(rng.integers(1, most + 1)) for most in (9, 3, 3))
        J = jordan(rng, n)
        S = np.linalg.qr(rng.standard_normal((n, n)))[0] @ np.diag(np.exp(rng.uniform(-1, 1, n)))
        C, G = rng.standard_normal((p, n)), rng.standard_normal((n, q))
        if rng.random() < 0.3:
            C[:, np.diagonal(J) < -0.2] = 0.0  # no output observes these
        if not C.any():
            continue
        plain = Plant(S @ J @ np.linalg.inv(S), C @ np.linalg.inv(S), G=G if rng.random() < 0.7 else None)
        if not len(unobservable_modes(plain, 0.0)):
            break
    schedule = times_of(rng, p)
    units = Units.drawn(rng, plain)
    plant = units.plant(plain)
    if rng.random() < 0.5:
        groups = {key: Signals(getattr(plant, key).names) for key in ("states", "outputs", "inputs", "disturbances")}
        plant = dataclasses.replace(plant, **groups)
    return plant, units.schedule(schedule)


def judged(seed: int, rigorous: bool, alarm: float = 3 * LONG) -> dict[str, Any]:
    """What `certify` says of one seed, and how long it takes."""
    plant, schedule = drawn(seed)
    begun = time.process_time()
    found: dict[str, Any] = {"seed": seed, "states": plant.n_states}
    signal.signal(signal.SIGVTALRM, _stop)
    signal.setitimer(signal.ITIMER_VIRTUAL, alarm)
    try:
        made = certify(plant, schedule)
        found |= {"outcome": "certified", "M": made.horizon().minimum, "lam": made.lam}
    except UndecidedError as error:
        found |= {"outcome": "undecided", "reason": str(error)}
    except SamplingDesignError as error:
        found |= {"outcome": "refused", "reason": f"{type(error).__name__}: {error}"}
    except Exception as error:
        found |= {"outcome": "raw", "reason": f"{type(error).__name__}: {error}"}
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
    found["seconds"] = round(time.process_time() - begun, 2)
    if rigorous and found["outcome"] == "certified":
        found["rigorous"] = made.verify(rigorous=True).verdict
    return found


def _stop(number: int, frame: Any) -> None:
    raise TimeoutError("stopped by the sweep")


def main(arguments: list[str] | None = None) -> None:
    """Run the seeds that the record does not hold yet, and print what it then says."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--count", type=int, default=500)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--record", type=Path, default=Path("certify_random.jsonl"))
    options.add_argument("--seconds", type=float, default=np.inf, help="stop after so much CPU time")
    given = options.parse_args(arguments)
    known = {}
    if given.record.exists():
        known = {entry["seed"]: entry for entry in map(json.loads, given.record.read_text().splitlines())}
    for seed in range(given.first, given.first + given.count):
        if seed not in known and time.process_time() < given.seconds:
            known[seed] = judged(seed, seed % RIGOROUS_EACH == 0)
            with given.record.open("a") as record:
                record.write(json.dumps(known[seed]) + "\n")
    report([entry for seed, entry in known.items() if given.first <= seed < given.first + given.count])


def report(found: list[dict[str, Any]]) -> None:
    """Print counts, what is not certified and the slowest plants."""
    counts = collections.Counter(entry["outcome"] for entry in found)
    decided = collections.Counter(entry["rigorous"] for entry in found if "rigorous" in entry)
    slow = [entry for entry in found if entry["seconds"] > LONG]
    print(f"{len(found)} plants: {dict(counts)}; over {LONG:g} s: {len(slow)}; in balls: {dict(decided)}")
    for entry in found:
        if entry["outcome"] != "certified" or entry.get("rigorous", "proven") != "proven":
            print(f"  {entry['seed']}: {entry['outcome']}, {entry.get('reason', entry.get('rigorous'))}"[:300])
    for entry in sorted(found, key=lambda entry: -entry["seconds"])[:5]:
        print(f"  slowest {entry['seed']}: {entry['seconds']} s, {entry['states']} states")


if __name__ == "__main__":
    main(sys.argv[1:])
