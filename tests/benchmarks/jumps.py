"""Where a call costs far more than its neighbour: every verb over sizes that double and options that cross.

python -m tests.benchmarks.jumps [VERB ...] [--long] prints processor seconds, and each step between neighbours that
costs over twice as much: with the exponent of its size, or, for an option, as times the call without it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np

import sampling_design as sd
from sampling_design.observability import observability_matrix

Call = Callable[[], object]

JUMP = 2.0
LEAST = 0.02
"""Processor seconds of one timing: what is shorter is repeated."""

SIZES = {"states": (1, 2, 4, 8, 16, 32, 64), "samples": (5, 10, 20, 40, 80, 160, 320), "outputs": (1, 2, 4, 8)}
SHORT = {"states": 16, "samples": 40, "outputs": 4}
FEW = {"states": 4, "samples": 20, "outputs": 2}
SLOW = dict.fromkeys(("certify", "accuracy", "finite accuracy", "counts"), FEW) | {"worst case": FEW | {"states": 2}}
"""What these take at most unless it is to be `--long`: a point of them is seconds."""

MIDDLE = {"states": 2, "samples": 20, "outputs": 1}
"""The sizes that stay where another one changes."""


def plant(states: int, outputs: int) -> sd.Plant:
    """Oscillators (and a decay) of other frequencies, each of which every output shows in another mixture."""
    A, rng = np.zeros((states, states)), np.random.default_rng(states)
    for k in range(0, states - 1, 2):
        A[k : k + 2, k : k + 2] = [[-0.02, 1.0 + 0.37 * k / states], [-1.0 - 0.37 * k / states, -0.02]]
    if states % 2:
        A[-1, -1] = -0.1
    return sd.Plant(A, rng.normal(size=(outputs, states)))


def times(samples: int, regular: bool) -> np.ndarray:
    """As many sample times, one a unit of time."""
    return np.cumsum(np.ones(samples) if regular else np.random.default_rng(1).uniform(0.5, 1.5, samples))


def schedule(samples: int, regular: bool) -> sd.PeriodicSchedule:
    at = times(samples, regular)
    return sd.PeriodicSchedule.from_times(at, float(at[-1]) + (0.0 if regular else 0.4))


def matrix(states: int, samples: int, outputs: int, regular: bool = True) -> Call:
    of, at = plant(states, outputs), times(samples, regular)
    return lambda: observability_matrix(of, at)


def sigma(states: int, samples: int, outputs: int, regular: bool = True, late: float = 0.0) -> Call:
    of, at = plant(states, outputs), schedule(samples, regular)
    options = {"timing_tolerance": late} if late else {}
    return lambda: sd.window_sigma(of, at, window=float(min(samples, 4 * states) + 1), **options)


def certified(states: int, samples: int, outputs: int, regular: bool = True, rate: float | None = None) -> Call:
    of, at = plant(states, outputs), schedule(samples, regular)
    return lambda: sd.certify(of, at, eta=rate, budget=60)


def accuracy(states: int, samples: int, outputs: int, regular: bool = True, ball: bool = False) -> Call:
    of, at = plant(states, outputs), schedule(samples, regular)
    v = 0.1 if ball else np.full(outputs, 0.1)
    return lambda: sd.guaranteed_accuracy(of, at, w_bound=0.1, v_bound=v, budget=60)


def finite_accuracy(states: int, samples: int, outputs: int, regular: bool = True, **given: object) -> Call:
    """The same over samples that end, from a first error that is bounded."""
    of, at = plant(states, outputs), sd.Schedule(times(samples, regular))
    known = {"w_bound": 0.1, "v_bound": np.full(outputs, 0.1), "initial_error": np.ones(states)} | given
    return lambda: sd.guaranteed_accuracy(of, at, budget=60, **known)


def accuracy_of_counts(states: int, samples: int, outputs: int, regular: bool = True, of: object = None) -> Call:
    del regular
    known = plant(states, outputs)
    asked = {"period": float(samples), "w_bound": 0.1, "v_bound": np.full(outputs, 0.1), "budget": 60, "of": of}
    return lambda: sd.accuracy.accuracy_by_count(known, (samples // 2, samples), **asked)


def worst_case(
    states: int, samples: int, outputs: int, regular: bool = True, late: float = 0.0, apart: bool = False
) -> Call:
    """As many samples as twice the states, whatever is asked for: the search grows with each."""
    del regular, samples
    of, count = plant(states, outputs), 2 * states
    tolerance = dict.fromkeys(of.outputs.names, late) if apart else late
    family = sd.SpacedWindows(2.0 * count, count, 0.5)
    return lambda: sd.worst_case_sigma(of, family, timing_tolerance=tolerance, budget=30)


def interval(states: int, samples: int, outputs: int, regular: bool = True, **given: object) -> Call:
    of, rng = plant(states, outputs), np.random.default_rng(0)
    record = [(float(t), 0.1 * rng.uniform(-1, 1, outputs), None) for t in times(samples, regular)]
    known = {"w_bound": 0.2, "v_bound": np.full(outputs, 0.2)} | given
    return lambda: sd.state_interval(of, record, **known)


class OpenLoop:
    """An estimator that takes no sample in: what a trial costs without one."""

    def __init__(self, of: sd.Plant):
        self.plant = of

    def start(self, prior: np.ndarray, prior_time: float = 0.0) -> None:
        self.t, self.x = prior_time, np.asarray(prior, dtype=float)

    def update(self, t: float, y: object, u: object = None) -> np.ndarray:
        del y, u
        self.x, self.t = self.predict(t), t
        return self.x

    def predict(self, t: float) -> np.ndarray:
        return self.plant.transition(t - self.t) @ self.x


def validated(states: int, samples: int, outputs: int, regular: bool = True, own: bool = False) -> Call:
    """Four trials."""
    of, at = plant(states, outputs), schedule(samples, regular)
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}
    mhe = sd.MovingHorizonEstimator(of, horizon=float(samples), cost=sd.CostFunction(eta=0.2), **bounds)
    chosen = OpenLoop(of) if own else mhe
    return lambda: sd.validate(of, at, estimator=chosen, runs=4, duration=2.0 * samples, rng=0, **bounds)


def estimated(states: int, samples: int, outputs: int, regular: bool = True, **given: object) -> Call:
    """One update with a full window; the record goes on from call to call."""
    of, rng = plant(states, outputs), np.random.default_rng(0)
    kept = {key: given[key] for key in given if key in ("x", "v", "y", "w", "check_spacing")}
    cost = sd.CostFunction(eta=0.2, **{key: given[key] for key in given if key not in kept})
    chosen = sd.Constraints(**kept) if kept else None
    bounds = {"w_bound": 0.5, "v_bound": 0.5, "initial_error": 3.0}
    mhe = sd.MovingHorizonEstimator(of, horizon=float(samples), cost=cost, constraints=chosen, **bounds)

    def rows() -> Iterator[tuple[float, np.ndarray]]:
        t = 0.0
        while True:
            t += 1.0 if regular else rng.uniform(0.5, 1.5)
            yield t, 0.3 * rng.normal(size=outputs)

    source = rows()
    for row in islice(source, 2 * samples + 4):
        mhe.update(*row)
    return lambda: mhe.update(*next(source))


@dataclass(frozen=True)
class Verb:
    """What makes a call of some sizes ready, and the options that are crossed with the middle sizes."""

    ready: Callable[..., Call]
    options: dict[str, dict[str, object]]


IRREGULAR: dict[str, object] = {"regular": False}
VERBS = {
    "matrix": Verb(matrix, {"irregular": IRREGULAR}),
    "sigma": Verb(sigma, {"irregular": IRREGULAR, "late samples": {"late": 0.01}}),
    "certify": Verb(certified, {"irregular": IRREGULAR, "rate given": {"rate": 0.05}}),
    "accuracy": Verb(accuracy, {"irregular": IRREGULAR, "noise in a ball": {"ball": True}}),
    "finite accuracy": Verb(
        finite_accuracy,
        {
            "irregular": IRREGULAR,
            "noise in a ball": {"v_bound": 0.1},
            "start unknown": {"initial_error": None},
            "late samples": {"timing_tolerance": 0.05, "start": 0.0, "end": 21.0},
        },
    ),
    "counts": Verb(accuracy_of_counts, {"one state": {"of": "x1"}}),
    "worst case": Verb(worst_case, {"late": {"late": 0.02}, "late by output": {"late": 0.02, "apart": True}}),
    "interval": Verb(
        interval,
        {
            "irregular": IRREGULAR,
            "noise in a ball": {"v_bound": 0.2},
            "from a start": {"initial_error": 3.0},
            "an outlier": {"outliers": 1},
        },
    ),
    "validate": Verb(validated, {"irregular": IRREGULAR, "own estimator": {"own": True}}),
    "estimate": Verb(
        estimated,
        {
            "irregular": IRREGULAR,
            "filtered": {"arrival": "filtered"},
            "the paper's": {"form": "paper"},
            "x free": {"x": (-1e3, 1e3)},
            "v free": {"v": (-1e3, 1e3)},
            "w free": {"w": (-1e3, 1e3)},
            "x checked": {"x": (-1e3, 1e3), "check_spacing": 0.5},
            "x acts": {"x": (-0.1, 0.1)},
            "w acts": {"w": (-0.01, 0.01)},
        },
    ),
}


def spent(call: Call) -> float:
    """Processor seconds of a call: the median of three timings of as many calls as make them long enough."""
    begun = time.process_time()
    call()
    first = time.process_time() - begun
    count = max(1, min(64, int(LEAST / max(first, 1e-5))))
    if first > 1.0:
        return first
    found = []
    for _ in range(3):
        begun = time.process_time()
        for _ in range(count):
            call()
        found.append((time.process_time() - begun) / count)
    return float(np.median(found))


def swept(name: str, long: bool) -> Iterator[str]:
    """Yield the lines of one verb."""
    verb = VERBS[name]
    most = {key: max(values) for key, values in SIZES.items()} if long else SHORT | SLOW.get(name, {})
    for options, own in {"": {}, "irregular": IRREGULAR}.items():
        for size, every in SIZES.items():
            values = [value for value in every if value <= most[size]]
            taken = [spent(verb.ready(**{**MIDDLE, size: value}, **own)) for value in values]
            told = ", ".join(f"{value} {1e3 * seconds:.3g}" for value, seconds in zip(values, taken, strict=True))
            yield f"{name} {options} ms by {size}: {told}"
            for (a, before), (b, after) in pairwise(zip(values, taken, strict=True)):
                power = np.log(after / before) / np.log(b / a)
                if max(after, before) > JUMP * min(after, before):
                    yield f"  JUMP {size} {a} to {b}: {after / before:.2g} times, power {power:.1f}"
    plain = spent(verb.ready(**MIDDLE))
    for option, given in verb.options.items():
        seconds = spent(verb.ready(**MIDDLE, **given))
        mark = "  JUMP" if seconds > JUMP * plain else " "
        yield f"{mark} {name}, {option}: {1e3 * seconds:.3g} ms, {seconds / plain:.1f} times {1e3 * plain:.3g}"


def main(given: list[str]) -> None:
    """Sweep the verbs that are named, or all."""
    for name in [each for each in given if each in VERBS] or list(VERBS):
        for line in swept(name, "--long" in given):
            print(line, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
