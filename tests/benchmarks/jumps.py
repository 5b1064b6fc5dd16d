"""Where a call costs far more than its neighbour: every verb over sizes that double and options that cross, and what
is done with records, schedules and what is made of them over lengths from a hundred to a hundred thousand.

python -m tests.benchmarks.jumps [VERB ...] [--long] prints processor seconds, and each step between neighbours that
costs over twice as much (of lengths: over twice its share): with the exponent of its size, or, for an option, as times
the call without it.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, is_dataclass, replace
from functools import cache
from itertools import islice, pairwise
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

import sampling_design as sd
from sampling_design import accuracy as accuracy_room
from sampling_design import certificates, design, estimators, observability, plants, plotting, schedules, uncertain
from sampling_design.checkers.check import verdict
from sampling_design.design.bounds.relaxation import sigma_of_moved
from sampling_design.design.problem.design_problem import DesignProblem
from sampling_design.observability import observability_matrix

Call = Callable[[], object]

JUMP = 2.0
LEAST = 0.02
"""Processor seconds of one timing: what is shorter is repeated."""
SHORTEST, LONGEST = 2.0, 20.0
"""Processor seconds that a length may be expected to take, and under `--long`."""

SIZES = {"states": (1, 2, 4, 8, 16, 32, 64), "samples": (5, 10, 20, 40, 80, 160, 320), "outputs": (1, 2, 4, 8)}
SHORT = {"states": 16, "samples": 40, "outputs": 4}
FEW = {"states": 4, "samples": 20, "outputs": 2}
BOXED = ("family", "sigma of a box", "certify a box", "accuracy of a box", "largest box")
SLOW = dict.fromkeys(("certify", "checker", "accuracy", "finite accuracy", "counts", *BOXED), FEW)
SLOW |= dict.fromkeys(
    ("existence", "horizons", "tradeoff", "robustness", "information", "contraction", "arrivals", "latex", "plan"), FEW
)
SLOW |= dict.fromkeys(
    ("next sample", "plan file", "plan proof", "plan picture", "inclusion file", "inclusion proof"), FEW
)
SLOW |= {"worst case": FEW | {"states": 2}}
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


def designed(states: int, samples: int, outputs: int, regular: bool = True, losses: bool = False) -> Call:
    """Of oscillators that no output sees decay."""
    del regular
    pairs = max(1, states // 2)
    A = np.kron(np.diag(1.0 + 0.7 * np.arange(pairs)), [[0.0, 1.0], [-1.0, 0.0]])
    of = sd.Plant(A, plant(2 * pairs, outputs).C)
    wanted = sd.Requirement(window=2 * np.pi, samples=samples, spacing=0.04 * np.pi)
    made_of = sd.design_schedule(of, wanted) if losses else None
    return lambda: sd.design_schedule(of, wanted) if made_of is None else design.sample_losses(made_of)


def asked(work: Callable[[sd.Plant, sd.PeriodicSchedule], object], **own: object) -> Callable[..., Call]:
    """What is asked of a plant and a schedule that keep nothing of an earlier call."""

    def ready(states: int, samples: int, outputs: int, regular: bool = True, **given: object) -> Call:
        return lambda: work(plant(states, outputs), schedule(samples, regular), **{**own, **given})

    return ready


def of_certificate(work: Callable[[sd.Plant, sd.Certificate], object]) -> Callable[..., Call]:
    def ready(states: int, samples: int, outputs: int, regular: bool = True) -> Call:
        of = plant(states, outputs)
        known = sd.certify(of, schedule(samples, regular), eta=0.05, budget=60)
        return lambda: work(of, known)

    return ready


def audited(states: int, samples: int, outputs: int, regular: bool = True) -> Call:
    """What the standalone checker does with a certificate."""
    made_of = sd.certify(plant(states, outputs), schedule(samples, regular), eta=0.05, budget=60).to_dict()
    return lambda: verdict(made_of)


def family(states: int, samples: int, outputs: int, regular: bool = True, late: float = 0.01) -> Call:
    of, jitter = plant(states, outputs), sd.Jitter(schedule(samples, regular), late)
    return lambda: sd.certify(of, jitter, eta=0.02, budget=60)


def box(states: int, parameters: int, width: float) -> sd.UncertainPlant:
    """The same plant, of which some entries of A are known within a width."""
    parts = np.zeros((parameters, states, states))
    parts[range(parameters), [k % states for k in range(parameters)], [(k + 1) % states for k in range(parameters)]] = 1
    known = [sd.UncertainParameter(f"p{k}", -width, width, A=part, nominal=0.0) for k, part in enumerate(parts)]
    return sd.UncertainPlant(plant(states, 1), known)


def over_box(work: Callable[[sd.UncertainPlant, sd.PeriodicSchedule], object]) -> Callable[..., Call]:
    def ready(
        states: int, samples: int, outputs: int, regular: bool = True, parameters: int = 1, width: float = 1e-3
    ) -> Call:
        del outputs
        of, at = box(states, parameters, width), schedule(samples, regular)
        return lambda: work(of, at)

    return ready


def accuracy(
    states: int, samples: int, outputs: int, regular: bool = True, ball: bool = False, late: float = 0.0
) -> Call:
    of, at = plant(states, outputs), schedule(samples, regular)
    v = 0.1 if ball else np.full(outputs, 0.1)
    return lambda: sd.guaranteed_accuracy(of, at, w_bound=0.1, v_bound=v, timing_tolerance=late, budget=60)


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


def deviation(states: int, samples: int, outputs: int, regular: bool = True) -> Call:
    of, at = plant(states, outputs), schedule(samples, regular)
    return lambda: sd.accuracy.standard_deviation(of, at, w_intensity=0.1, v_deviation=0.1)


def moved(states: int, samples: int, outputs: int, regular: bool = True, late: float = 0.2) -> Call:
    """Windows of a design whose samples are early, late or on time."""
    at, open_ = times(samples, regular), (None,) * outputs
    window, period = float(min(samples, 4 * states) + 1), float(at[-1]) + 0.4
    problem = DesignProblem(
        plant(states, outputs),
        window,
        period,
        0.1,
        samples,
        np.zeros((0, 2)),
        np.zeros(0),
        open_,
        late=late,
    )
    return lambda: sigma_of_moved(problem, at, problem.mask(at))


@cache
def kept(kind: str, states: int, samples: int, outputs: int, regular: bool = True) -> object:
    """What goes on file and into a picture: a plan of as many steps, a certificate of detectability or of a box."""
    of = plant(states, outputs)
    if kind == "detectability":
        return sd.certificates.certify_detectability(of)
    if kind == "inclusion":
        gaps = sd.GapRange(0.5, 1.0) if regular else sd.Jitter(schedule(samples, False), 0.01)
        return sd.certify(box(states, 1, 1e-3), gaps, eta=0.02, budget=60)
    white = kind == "deviations"
    noise, by = ("noise_deviation", "w_intensity") if white else ("noise_bound", "w_bound")
    goal = {"tolerance": 1e3, "kind": "standard deviation" if white else "guaranteed"}
    steps = {"period": float(samples), "grid": 1.0, "samples": samples // 2, "aim": "most accurate"}
    sensors = {name: {noise: 0.1} for name in of.outputs.names}
    wanted = sd.PlanRequirement({"x1": goal}, sensors=sensors, **{by: 0.1}, **steps)
    return sd.plan_samples(of, wanted, search_seconds=2.0, certificate=False, robustness=False, from_start=False)


READERS = {"detectability": sd.read_certificate, "inclusion": sd.read_certificate}


def planned_samples(states: int, samples: int, outputs: int, regular: bool = True, kind: str = "plan") -> Call:
    return lambda: kept.__wrapped__(kind, states, samples, outputs, regular)


def of_kept(work: Callable[[object], object], usual: str) -> Callable[..., Call]:
    def ready(states: int, samples: int, outputs: int, regular: bool = True, kind: str = usual) -> Call:
        known = kept(kind, states, samples, outputs, regular)
        return lambda: work(known)

    return ready


def on_file(kind: str) -> Callable[[object], object]:
    return lambda known: READERS.get(kind, sd.read_plan)(known.save(folder() / f"{kind}.json"))


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


BOUNDS = {"w_bound": 0.5, "v_bound": 0.5, "initial_error": 3.0}
COST = sd.CostFunction(eta=0.2)
ORIGIN = "2026-01-05T00:00+00:00"
ESTIMATORS = {
    "window": lambda of: sd.MovingHorizonEstimator(of, horizon=10.0, cost=COST, **BOUNDS),
    "all samples": lambda of: sd.MovingHorizonEstimator(of, horizon=1e9, cost=COST, **BOUNDS),
    "filter": lambda of: sd.KalmanFilter(of, cost=COST, **BOUNDS),
    "late samples": lambda of: sd.KalmanFilter(of, cost=COST, maximum_delay=1e9, **BOUNDS),
    "sets": lambda of: sd.SetMembershipEstimator(of, **BOUNDS),
}


def recorded(
    length: int, outputs: int = 1, regular: bool = False, mixed: bool = False, dated: bool = False, inputs: int = 0
) -> sd.Measurements:
    """A record, with a cell in three missing where there are several outputs."""
    rng, bare = np.random.default_rng(0), plant(2, outputs)
    of = sd.Plant(bare.A, bare.C, B=np.ones((2, inputs)), D=np.zeros((outputs, inputs)), time_unit="min")
    y, u = 0.1 * rng.uniform(-1, 1, (length, outputs)), 0.1 * rng.uniform(-1, 1, (length, inputs))
    y[:, 1:][rng.random((length, outputs - 1)) < 0.3] = np.nan
    at = rng.permutation(length) if mixed else np.arange(length)
    return sd.Measurements(of, times(length, regular)[at], y[at], u[at], origin=ORIGIN if dated else "")


def planned(length: int, regular: bool = False, finite: bool = False) -> sd.Schedule | sd.PeriodicSchedule:
    at = np.cumsum(np.ones(length) if regular else np.random.default_rng(1).integers(1, 4, length)).astype(float)
    whole = sd.PeriodicSchedule.from_times(at, float(at[-1]) + 1.0, time_unit="min")
    return sd.Schedule(at, time_unit="min") if finite else whole


@cache
def made(kind: str, length: int) -> object:
    """What a verb returns, of that length, for its tables, files and pictures."""
    of = recorded(1).plant
    match kind:
        case "estimates":
            return ESTIMATORS["filter"](of).run(recorded(length))
        case "certificate":
            return sd.certify(of, planned(length, regular=True), eta=0.05)
        case "log":
            plan = sd.PeriodicSchedule([1.0], time_unit="min")
            return sd.compare_schedule(of, plan, times(length, True) + 0.05, window=7.0)
        case "interval":
            return sd.state_interval(of, recorded(length), **BOUNDS)
        case "sigma":
            return sd.window_sigma(of, planned(length), 7.0)
        case "report":
            plan = sd.PeriodicSchedule([1.0], time_unit="min")
            return sd.validate(of, plan, estimator=ESTIMATORS["window"](of), runs=4, duration=length, rng=0, **BOUNDS)
        case "trials":
            plan = sd.PeriodicSchedule([1.0], time_unit="min")
            return sd.validate(of, plan, estimator=OpenLoop(of), runs=length, duration=5.0, rng=0, **BOUNDS)
    return recorded(length) if kind == "record" else planned(length)


def simulated(length: int, inputs: bool = False) -> Call:
    of = recorded(1, inputs=1).plant
    given = {"inputs": [(float(t), [1.0]) for t in range(length)]} if inputs else {}
    plan = sd.PeriodicSchedule([1.0], time_unit="min")
    return lambda: sd.simulate_record(of, plan, float(length), w_bound=0.1, v_bound=0.1, rng=0, **given)


def ran(length: int, by: str = "window", **how: object) -> Call:
    of_record = recorded(length, **how)
    return lambda: ESTIMATORS[by](of_record.plant).run(of_record)


def of_record(work: Callable[[sd.Measurements], object]) -> Callable[..., Call]:
    def ready(length: int, **how: object) -> Call:
        known = recorded(length, **how)
        return lambda: work(known)

    return ready


def of_schedule(work: Callable[[object], object]) -> Callable[..., Call]:
    def ready(length: int, **how: object) -> Call:
        known = planned(length, **how)
        return lambda: work(known)

    return ready


def of_result(work: Callable[[object], object], usual: str = "record") -> Callable[..., Call]:
    """Each call of a copy, which keeps nothing of an earlier one."""

    def ready(length: int, kind: str = usual) -> Call:
        known = made(kind, length)
        return lambda: work(copy(known))

    return ready


@cache
def folder() -> Path:
    return Path(mkdtemp(prefix="jumps-"))


def copy(known: object) -> object:
    return replace(known) if is_dataclass(known) and not isinstance(known, type) else known


def said(known: object) -> object:
    return repr(known), str(known), known._repr_html_(), known.explain()


@dataclass(frozen=True)
class Verb:
    """What makes a call of some sizes ready, and the options that are crossed with the middle sizes."""

    ready: Callable[..., Call]
    options: dict[str, dict[str, object]]
    lengths: bool = False
    """Whether it takes a length alone, and so may cost its share."""


IRREGULAR: dict[str, object] = {"regular": False}
STOCHASTIC: dict[str, dict[str, object]] = {"of deviations": {"kind": "deviations"}}
BOXES: dict[str, dict[str, object]] = {
    **{f"{count} parameters": {"parameters": count} for count in (2, 3)},
    **{f"within {width:g}": {"width": width} for width in (1e-8, 1e-5, 1e-2, 0.05)},
}
VERBS = {
    "matrix": Verb(matrix, {"irregular": IRREGULAR}),
    "sigma": Verb(sigma, {"irregular": IRREGULAR, "late samples": {"late": 0.01}}),
    "certify": Verb(certified, {"irregular": IRREGULAR, "rate given": {"rate": 0.05}}),
    "accuracy": Verb(
        accuracy, {"irregular": IRREGULAR, "noise in a ball": {"ball": True}, "late samples": {"late": 0.05}}
    ),
    "checker": Verb(audited, {"irregular": IRREGULAR}),
    "family": Verb(family, {"irregular": IRREGULAR} | {f"late by {x:g}": {"late": x} for x in (1e-6, 1e-3, 0.1)}),
    "sigma of a box": Verb(over_box(lambda of, at: sd.window_sigma(of, at, 7.0, budget=20)), BOXES),
    "certify a box": Verb(over_box(lambda of, at: sd.certify(of, sd.GapRange(0.5, 1.0), eta=0.02, budget=20)), BOXES),
    "accuracy of a box": Verb(
        over_box(
            lambda of, at: sd.guaranteed_accuracy(of, at, w_bound=[0.1] * of.nominal.n_states, v_bound=[0.1], budget=20)
        ),
        BOXES,
    ),
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
    "deviation": Verb(deviation, {"irregular": IRREGULAR}),
    "moved": Verb(moved, {"irregular": IRREGULAR, "on time": {"late": 0.0}}),
    "next sample": Verb(of_kept(lambda known: sd.next_sample(known, now=0.0, budget=20), "plan"), STOCHASTIC),
    "plan file": Verb(of_kept(on_file("plan"), "plan"), STOCHASTIC),
    "plan proof": Verb(of_kept(lambda known: known.verify(), "plan"), STOCHASTIC),
    "plan picture": Verb(of_kept(lambda known: plotting.save(known, folder() / "plan.svg"), "plan"), STOCHASTIC),
    "design": Verb(designed, {"losses": {"losses": True}}),
    "modes": Verb(asked(lambda of, at: plants.split_modes(of)), {}),
    "undetected": Verb(asked(lambda of, at: observability.unobservable_modes(of)), {}),
    "zero count": Verb(
        asked(lambda of, at, duration: sd.zero_count_bound(of, duration), duration=7.0), {"long": {"duration": 700.0}}
    ),
    "losses borne": Verb(asked(observability.loss_tolerance), {"irregular": IRREGULAR}),
    "existence": Verb(asked(sd.certificate_exists, eta=0.02), {"irregular": IRREGULAR, "rate": {"eta": 1.0}}),
    "proof constants": Verb(
        asked(certificates.constants_from_proof, variant="paper"),
        {"irregular": IRREGULAR, "tightened": {"variant": "tightened"}},
    ),
    "horizons": Verb(asked(certificates.four_horizons, budget=20), {"irregular": IRREGULAR}),
    "tradeoff": Verb(asked(certificates.tradeoff_curve, eta=0.05, noise_gains=(3.0, 10.0)), {"irregular": IRREGULAR}),
    "limit": Verb(asked(lambda of, at: accuracy_room.accuracy_limit(of, w_bound=0.1, v_bound=0.1, budget=20)), {}),
    "robustness": Verb(of_certificate(lambda of, known: sd.robustness(of, known, budget=20)), {"irregular": IRREGULAR}),
    "information": Verb(
        of_certificate(lambda of, known: certificates.information_curve(known)), {"irregular": IRREGULAR}
    ),
    "contraction": Verb(
        of_certificate(lambda of, known: certificates.least_contracting(known)), {"irregular": IRREGULAR}
    ),
    "arrivals": Verb(
        of_certificate(lambda of, known: certificates.random_arrivals(known, 0.1)), {"irregular": IRREGULAR}
    ),
    "latex": Verb(of_certificate(lambda of, known: known.to_latex()), {"irregular": IRREGULAR}),
    "plan": Verb(planned_samples, STOCHASTIC),
    "largest box": Verb(over_box(lambda of, at: uncertain.largest_box(of, at, eta=0.02, budget=20)), BOXES),
    "detectability": Verb(
        lambda states, samples, outputs, regular=True: (
            lambda: sd.certificates.certify_detectability(plant(states, outputs))
        ),
        {},
    ),
    **{f"{kind} file": Verb(of_kept(on_file(kind), kind), {}) for kind in READERS},
    **{f"{kind} proof": Verb(of_kept(lambda known: known.verify(), kind), {}) for kind in READERS},
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


ROWS = {"regular": {"regular": True}, "3 outputs": {"outputs": 3}, "dates": {"dated": True}, "inputs": {"inputs": 1}}
MIXED = ROWS | {"mixed": {"mixed": True}}
PLANS = {"regular": {"regular": True}, "finite": {"finite": True}}
KINDS = {kind: {"kind": kind} for kind in ("schedule", "estimates", "certificate", "log", "sigma", "report", "trials")}
LENGTHS = {
    "run": Verb(ran, ROWS | {name: {"by": name} for name in ESTIMATORS}, lengths=True),
    "smooth": Verb(of_record(lambda known: ESTIMATORS["filter"](known.plant).smooth(known)), ROWS, lengths=True),
    "state interval": Verb(
        of_record(lambda known: sd.state_interval(known.plant, known, **BOUNDS)), ROWS, lengths=True
    ),
    "part": Verb(of_record(lambda known: known.between(3.0, 0.7 * len(known))), MIXED, lengths=True),
    "merge": Verb(of_record(lambda known: known.merged(known)), MIXED, lengths=True),
    "frame": Verb(of_record(lambda known: sd.read_measurements(known.to_frame(), known.plant)), MIXED, lengths=True),
    "measurement file": Verb(
        of_record(
            lambda known: sd.read_measurements(
                estimators.write_measurements(known, folder() / "record.csv"), known.plant
            )
        ),
        MIXED,
        lengths=True,
    ),
    "simulate": Verb(simulated, {"inputs": {"inputs": True}}, lengths=True),
    "schedule file": Verb(
        of_schedule(lambda known: sd.read_schedule(schedules.write_schedule(known, folder() / "plan.csv"))),
        PLANS,
        lengths=True,
    ),
    "calendar": Verb(
        of_schedule(lambda known: schedules.write_ics(known, folder() / "plan.ics", ORIGIN)), PLANS, lengths=True
    ),
    "dates": Verb(
        of_schedule(lambda known: schedules.write_calendar_csv(known, folder() / "dates.csv", ORIGIN)),
        PLANS,
        lengths=True,
    ),
    "sigma of all": Verb(
        of_schedule(lambda known: sd.window_sigma(recorded(1).plant, known, 7.0)), PLANS, lengths=True
    ),
    "picture": Verb(of_result(lambda known: plotting.save(known, folder() / "picture.svg")), KINDS, lengths=True),
    "words": Verb(of_result(said), KINDS | {"interval": {"kind": "interval"}}, lengths=True),
    "trials": Verb(
        lambda length: (
            lambda: sd.validate(
                recorded(1).plant,
                sd.PeriodicSchedule([1.0]),
                estimator=OpenLoop(recorded(1).plant),
                runs=length,
                duration=5.0,
                rng=0,
                **BOUNDS,
            )
        ),
        {},
        lengths=True,
    ),
    "log": Verb(
        lambda length, window=7.0: (
            lambda: sd.compare_schedule(
                recorded(1).plant,
                sd.PeriodicSchedule([1.0], time_unit="min"),
                times(length, True) + 0.05,
                window=window,
            )
        ),
        {"long window": {"window": 50.0}},
        lengths=True,
    ),
    "proof": Verb(
        of_result(lambda known: known.verify(), "certificate"), {"interval": {"kind": "interval"}}, lengths=True
    ),
    "interval file": Verb(
        of_result(lambda known: type(known).read(known.save(folder() / "interval.json")), "interval"),
        {},
        lengths=True,
    ),
    "interval checked": Verb(of_result(lambda known: known.verify(rigorous=True), "interval"), {}, lengths=True),
    "curve": Verb(
        of_record(lambda known: estimators.estimate_curve(ESTIMATORS["filter"](known.plant), known)), ROWS, lengths=True
    ),
    "estimate file": Verb(
        of_result(lambda known: estimators.write_estimates(known, folder() / "estimates.csv"), "estimates"),
        {},
        lengths=True,
    ),
    "radii of all": Verb(
        of_record(lambda known: ESTIMATORS["filter"](known.plant).run(known).to_frame()), ROWS, lengths=True
    ),
}
VERBS |= LENGTHS


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


def compared(size: str, points: list[tuple[int, float]], lengths: bool) -> Iterator[str]:
    """Yield each step between neighbouring sizes that costs far more."""
    for (a, before), (b, after) in pairwise(points):
        most = JUMP * (b / a if lengths else 1.0)
        if after > most * before or before > JUMP * after:
            power = np.log(after / before) / np.log(b / a)
            yield f"  JUMP {size} {a} to {b}: {after / before:.2g} times, power {power:.1f}"


def listed(points: list[tuple[int, float]]) -> str:
    return ", ".join(f"{value} {1e3 * seconds:.3g}" for value, seconds in points)


def of_lengths(name: str, long: bool) -> Iterator[str]:
    """Yield the lines of a verb over lengths, until one would take too long."""
    verb, plain = VERBS[name], dict[int, float]()
    for option, given in {"": {}, **verb.options}.items():
        points: list[tuple[int, float]] = []
        verb.ready(100, **given)()  # what is loaded is not counted
        for length in (100, 300, 1000, 3000, 10_000, 30_000, 100_000):
            try:
                points.append((length, spent(verb.ready(length, **given))))
            except sd.SamplingDesignError as error:
                yield f"{name} {option}: of {length} {error}"
                break
            if 4.0 * points[-1][1] > (LONGEST if long else SHORTEST):
                break
        yield f"{name} {option} ms by length: {listed(points)}"
        yield from compared("length", points, True)
        plain = plain or dict(points)
        both = [(length, seconds / plain[length]) for length, seconds in points if length in plain]
        if both and both[-1][1] > JUMP:
            yield f"  JUMP {name}, {option}: of {both[-1][0]} {both[-1][1]:.2g} times without it"


def swept(name: str, long: bool) -> Iterator[str]:
    """Yield the lines of one verb."""
    verb = VERBS[name]
    if verb.lengths:
        yield from of_lengths(name, long)
        return
    most = {key: max(values) for key, values in SIZES.items()} if long else SHORT | SLOW.get(name, {})
    for options, own in {"": {}, "irregular": IRREGULAR}.items():
        for size, every in SIZES.items():
            values = [value for value in every if value <= most[size]]
            points = [(value, spent(verb.ready(**{**MIDDLE, size: value}, **own))) for value in values]
            yield f"{name} {options} ms by {size}: {listed(points)}"
            yield from compared(size, points, False)
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
