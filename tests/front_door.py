"""Calls of the front door with arguments of right and wrong kinds, for the law that nothing raw comes out.

Every public function, class and method has valid arguments here, found by the parameter's name; a call replaces one or
two of them by something wrong. `python -m tests.front_door 2000 7` makes 2000 calls from seed 7 and prints what is raw.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
import io
import os
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

import sampling_design as sd
from sampling_design.errors import SamplingDesignError
from tests.house.front_door import lazy_rooms


@functools.cache
def public() -> dict[str, Any]:
    """Everything that is public: the front door, and what its verbs return and take, in their rooms."""
    rooms = [module for room, module in lazy_rooms().items() if room != "explorer"]
    found = {name: getattr(sd, name) for names in sd._FRONT_DOOR.values() for name in names}
    found |= {name: getattr(room, name) for room in rooms for names in room._NAMES.values() for name in names}
    return found


def doors() -> Iterator[tuple[str, Any]]:
    """Every function of the front door, every `__init__` and every method there, by its qualified name."""
    for thing in public().values():
        for member in vars(thing).values() if inspect.isclass(thing) else [thing]:
            inner = getattr(member, "__func__", member)
            if inspect.isfunction(inner) and "checked" in vars(inner):
                yield inner.__qualname__, inner


DOORS = dict(doors())
EXAMPLES = Path(__file__).parents[1] / "examples"
SECONDS = 20
"""A call of this small plant that takes longer hangs."""
MEMORY = 8 * 2**30
"""Bytes that a process of calls may take: a size that cannot be done must be refused before it is tried."""


@functools.cache
def things() -> dict[str, Any]:
    """One valid object of each kind, all about the same oscillator."""
    plant = sd.read_plant(EXAMPLES / "plants" / "oscillator.toml")
    schedule = sd.PeriodicSchedule([0.7, 1.6, 0.9], time_unit="s")
    requirement = sd.Requirement(window=4.0, spacing=0.5, samples=3)
    weights = {"eta": 0.4, "P2": np.eye(2)}
    certificate = sd.certify(plant, schedule, **weights)
    gaps = sd.GapRange(0.9, 1.1, time_unit="s")
    family = sd.certify(plant, gaps, eta=0.2, P2=np.eye(2))
    design = sd.design_schedule(plant, requirement, starts=1, branches=0)
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 2.0}
    record = sd.simulate_record(plant, schedule, 6.0)
    nonlinear = sd.nonlinear.from_linear(plant)
    cost = sd.CostFunction(P2=np.eye(2), Qw=np.eye(2), R=np.eye(1), eta=0.2)
    box = ([-1.0, -1.0], [1.0, 1.0])
    evidence = sd.nonlinear.check_detectability(
        nonlinear, schedule, box, cost=cost, P1=np.eye(2) / 40, duration=1.5, dt=0.1, pairs=2
    )
    terms = {"position": {"noise_bound": 0.2}}
    wanted = sd.PlanRequirement({"position": 0.6}, period=6.4, grid=1.6, w_bound=0.02, sensors=terms)
    return {
        "wanted": wanted,
        "plant": plant,
        "schedule": schedule,
        "finite": sd.Schedule([0.5, 1.3, 2.0], time_unit="s"),
        "requirement": requirement,
        "certificate": certificate,
        "detectability": sd.certificates.certify_detectability(plant),
        "spaced": sd.SpacedWindows(4.0, 3, 0.5),
        "gaps": gaps,
        "jitter": sd.Jitter(schedule, 0.05),
        "apart": sd.schedules.OutputJitter(schedule, [0.05], [0.05]),
        "lost": sd.LostSamples(schedule, 1, 4),
        "family": family,
        "design": design,
        "estimate": sd.MovingHorizonEstimator(plant, certificate, **bounds).update(0.7, [0.9]),
        "estimates": sd.KalmanFilter(plant, certificate, **bounds).run(record.measurements),
        "record": record,
        "nonlinear": nonlinear,
        "split": sd.plants.split_modes(plant),
        "part": sd.observability.functional_plant(plant, plant.states.names[0]),
        "losses": sd.design.sample_losses(design),
        "pareto": sd.pareto_front(plant, requirement, [2], starts=1, branches=0),
        "sigma": sd.window_sigma(plant, schedule, 4.0),
        "worst": sd.worst_case_sigma(plant, sd.SpacedWindows(4.0, 3, 0.5)),
        "count": sd.zero_count_bound(plant, 4.0),
        "robustness": sd.robustness(plant, certificate, longest=2, budget=0.2),
        "horizons": sd.certificates.four_horizons(plant, schedule, certificate),
        "proof": sd.certificates.constants_from_proof(plant, schedule),
        "tradeoff": sd.certificates.tradeoff_curve(plant, schedule, 0.4, [2.0, 8.0]),
        "curve": sd.certificates.information_curve(certificate),
        "report": sd.validate(plant, schedule, certificate, runs=2, duration=4.0, scenarios=["random"]),
        "log": sd.compare_schedule(plant, schedule, [0.7, 2.4], 4.0),
        "evidence": evidence,
        "unseen": sd.observability.unobservable_modes(plant),
        "counterexample": sd.certificates.find_counterexample(plant, sd.GapRange(1.0, 4.0), 0.1)[0],
        "set": sd.estimators.ConvexSet.box([-1.0, -1.0], [1.0, 1.0]),
        "held": sd.Constraints(x=(-1.0, 1.0)),
        "cost": sd.CostFunction(eta=0.2),
        "pieces": sd.nonlinear.Collocation(w_step=0.5),
        "uncertain": sd.UncertainPlant(plant, [_stiffness()]),
        "inclusion": sd.uncertain.certify_inclusion(
            sd.UncertainPlant(plant, [_stiffness(0.1)]), schedule, eta=0.1, pieces=2
        ),
        "sparse": sd.plants.SparsePlant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], time_unit="s"),
    }


def _stiffness(share: float = 1.0) -> sd.UncertainParameter:
    return sd.UncertainParameter("stiffness", -0.2 * share, 0.1 * share, A=[[0.0, 0.0], [-1.0, 0.0]])


@functools.cache
def _small_plan() -> Any:
    return sd.plan_samples(
        things()["plant"], things()["wanted"], search_seconds=2.0, certificate=False, robustness=False, from_start=False
    )


@functools.cache
def _plan_file() -> Path:

    return _small_plan().save(folder() / "plan.json")


@functools.cache
def _uncertain_file() -> Path:
    return things()["uncertain"].save(folder() / "uncertain.toml")


FILES = ("plant.toml", "schedule.csv", "requirement.toml", "certificate.json", "measurements.csv", "stamps.csv")


@functools.cache
def folder() -> Path:
    """A folder with one valid file of each kind."""
    place, t = Path(tempfile.mkdtemp(prefix="front-door-")), things()
    sd.plants.write_plant(t["plant"], place / "plant.toml")
    sd.schedules.write_schedule(t["schedule"], place / "schedule.csv")
    sd.design.write_requirement(t["requirement"], place / "requirement.toml")
    t["certificate"].save(place / "certificate.json")
    sd.estimators.write_measurements(t["record"].measurements, place / "measurements.csv")
    (place / "stamps.csv").write_text("time\n2026-01-01T00:00:00\n2026-01-01T00:00:01\n")
    return place


def named() -> dict[str, Any]:
    """A valid argument for each name of a parameter, wherever it occurs."""
    t, eye = things(), np.eye(2)
    plant, certificate = t["plant"], t["certificate"]
    made = {
        "A": plant.A, "C": plant.C, "B": np.ones((2, 1)), "D": np.zeros((1, 1)), "G": eye, "time_unit": "s",
        "name": "oscillator", "states": ["p", "v"], "outputs": None, "inputs": None, "disturbances": None,
        "source": "a book", "names": ["a", "b"], "units": ["m", "s"], "scales": [1.0, 2.0],
        "system": plant.to_control(),
        "t": 1.5, "T": 2.0, "start": 0.0, "end": 3.0, "closed": "both", "unit": "min", "times": [0.5, 1.0, 2.2],
        "gaps": [0.7, 0.9], "first": 0.2, "period": 2.0, "origin": "2026-01-01T00:00:00", "output_names": ["y1"],
        "window": 4.0, "count": 3, "spacing": 0.5, "shortest": 0.9, "longest": 3, "most": 1, "of": 4,
        "timing_tolerance": 0.1,
        "rng": np.random.default_rng(1), "duration": 4.0, "samples": 3, "schedule": t["schedule"], "plant": plant,
        "requirement": t["requirement"], "certificate": certificate, "design": t["design"], "split": t["split"],
        "family": t["gaps"], "eta": 0.4, "P1": np.eye(2) / 10, "P2": eye, "Qw": np.eye(plant.n_disturbances),
        "R": np.eye(1), "Qv": np.eye(1), "P": eye, "lam": 8.0, "lam_samples": 6.0, "margin": 0.0, "c_w": 4.0,
        "c_y": 4.0, "witness": None, "budget": 2.0, "search_seconds": 2.0, "rigorous": False,
        "progress": lambda fraction, message: None,
        "path": folder() / "out", "theorem": "improved", "length": 6.0, "e0": [1.0, 0.0], "w_bound": 0.1,
        "v_bound": 0.1, "initial_error": 1.0, "rate": 0.2, "rtol": 0.01, "decay_rate": 0.1, "offset": 0.0,
        "rounding": None, "cluster_cap": 0.01,
        "cap": 0.01, "variant": "paper", "gain": None, "Q": None, "sigma_bar": None, "kappa": None,
        "noise_gains": [2.0], "points": 8, "t_star": 0.5, "purpose": "design", "hints": (), "quick": True, "starts": 1,
        "branches": 1, "every_period": False, "counts": [2, 3], "workers": None, "resume": None, "runs": 2, "data": {},
        "where": "file", "column": None, "span": 5.0, "summary": "Sample", "record": t["record"].measurements,
        "measurements": t["record"].measurements, "x0": [1.0, 0.0], "y": [0.3], "u": None, "sample": (1.2, [0.3], None),
        "state": None, "prior": [0.0, 0.0], "prior_time": 0.0, "horizon": 5.0, "cost": sd.CostFunction(eta=0.1),
        "collocation": sd.nonlinear.Collocation(), "constraints": None, "lower": [-1.0, -1.0],
        "upper": [1.0, 1.0], "rows": [[1.0, 0.0]], "offsets": [1.0], "dimension": 2, "centre": None, "shape": None,
        "value": [0.1, 0.2], "values": [[0.1, 0.2]], "tolerance": 0.0, "truth": [0.9, 0.0], "i": 1, "noises": True,
        "input_side": "right", "norm": "P2", "scenarios": ["random"], "method": "riccati", "floor": 1e-3,
        "memory": None, "retained": None, "pairs": 2, "dt": 0.1, "cases": ["per_second"], "days": 0.25, "seed": 0,
        "x": [0.1, 0.2], "w": None, "v": None, "guess": [0.0, 0.0], "case": "per_second", "scheme": "standard",
        "forbidden": [[1.0, 1.2]], "fixed": [0.5], "target_sigma": None, "cost_limit": None, "available": [[0.0, 3.0]],
        "proof_constants": None, "estimates": [t["estimate"]], "samples_needed": 3, "changes": {}, "details": {},
        "ax": None, "detectability": None, "dynamics": lambda x, u, w: -x, "measurement": lambda x, u, v: x[:1] + v,
        "sizes": {"x": 2, "u": 0, "w": 2, "v": 1, "y": 1}, "signals": {}, "bounds": {}, "slack": 0.0,
    }  # fmt: skip
    return made


def special() -> dict[str, dict[str, Any]]:
    """Arguments that one callable needs otherwise than their names say."""
    t, place, plant, cost = things(), folder(), things()["plant"], things()["cost"]
    noises = {"w_bound": 0.1, "v_bound": 0.1, "w_intensity": 0.01, "v_deviation": 0.1}
    suffixes = {"write_plant": "p.toml", "write_requirement": "r.toml", "write_schedule": "s.csv"}
    return {
        **{name: {"path": place / ("made_" + file)} for name, file in suffixes.items()},
        "MovingHorizonEstimator": {"certificate": None, "cost": cost, "horizon": 5.0},
        **dict.fromkeys(("guaranteed_accuracy", "state_interval", "accuracy_limit", "accuracy_by_count"), noises),
        "SetMembershipEstimator": noises | {"initial_error": 1.0},
        "NonlinearPlant": {
            "sizes": {"states": 2, "inputs": 0, "disturbances": 2, "noises": 1, "outputs": 1}, "signals": {},
            "bounds": {},
        },
        "FamilyCertificate.from_matrices": {"schedule": t["gaps"], "P1": np.eye(2) / 40, "lam": None},
        "output_predictor": {"t": 8.0},
        "ConstantList.named": {"name": "eta"},
        "ConvexSet.ball": {"radius": 1.0, "dimension": 2},
        "GapRange": {"shortest": 0.9, "longest": 1.1},
        "LostSamples": {"schedule": t["schedule"]},
        "read_plant": {"path": place / "plant.toml"},
        "read_schedule": {"path": place / "schedule.csv"},
        "plan_samples": {"requirement": t["wanted"], "search_seconds": 5.0},
        "next_sample": {"plan": _small_plan(), "record": None, "now": 0.0},
        "read_plan": {"path": _plan_file()},
        "UncertainParameter": {"low": 0.0, "high": 0.1, "A": np.eye(2)},
        "UncertainPlant": {"nominal": plant, "parameters": [_stiffness()]},
        "UncertainPlant.from_intervals": {"plant": plant, "A": {}},
        "UncertainPlant.from_tree": {"data": t["uncertain"].to_tree()},
        "UncertainPlant.within": {"low": [0.0], "high": [0.05]},
        "UncertainPlant.at": {"values": [0.0]},
        "UncertainPlant.read": {"path": _uncertain_file()},
        "largest_box": {"plant": t["uncertain"], "schedule": t["schedule"], "window": 6.0},
        "PlanRequirement": {"accuracy": {"position": 0.6}, "window": None},
        "PlanRequirement.replace": {"changes": {"grid": 0.8}},
        "read_plan_requirement": {"path": EXAMPLES / "plans" / "oscillator.toml"},
        "read_requirement": {"path": place / "requirement.toml"},
        "read_certificate": {"path": place / "certificate.json"},
        "read_measurements": {"path": place / "measurements.csv", "origin": None},
        "import_time_stamps": {"path": place / "stamps.csv", "origin": None},
        "named_plant": {"name": "oscillator"},
        "worst_case_sigma": {"family": t["spaced"]},
        "family_from_dict": {"data": t["gaps"].to_dict()},
        "schedule_from_dict": {"data": t["schedule"].to_dict()},
        "requirement_from_dict": {"data": t["requirement"].to_dict()},
        "write_estimates": {"record": t["estimates"]},
        "check_detectability": {"plant": t["nonlinear"], "x0": ([-1.0, -1.0], [1.0, 1.0]), "duration": 2.0},
        "NonlinearMovingHorizonEstimator": {"plant": t["nonlinear"], "horizon": 2.0, "cost": cost},
        "calendar": {"start": "2026-01-01", "schedule": t["schedule"]},
        "write_calendar_csv": {"start": "2026-01-01"},
        "write_ics": {"start": "2026-01-01"},
        "find_counterexample": {"eta": 0.1},
        "Jitter.contains": {"schedule": t["finite"]},
        "OutputJitter.contains": {"schedule": t["finite"]},
        "OutputJitter": {"early": [0.05], "late": [0.05]},
        "weights_from_bounds": {},
        "information_curve": {"samples": 2},
        "simulate_record": {"inputs": ()},
        "estimator_for": {"certificate": None},
        "estimate_curve": {"estimator": owner("KalmanFilter"), "points": 2},
        "error_map": {"cost": "certificate"},
        "plant_along": {"plant": t["nonlinear"], "x0": [0.5, 0.2], "duration": 1.0},
        "sweep": {"question": sd.plants.split_modes, "items": [plant]},
        "Measurements": {"times": [0.5, 1.0], "y": [[0.1], [0.2]]},
        "Signals": {},
        "Constraints": {"y": None},
        "Plant": {"A": plant.A, "C": plant.C, "B": np.ones((2, 1)), "states": ["p", "v"], "outputs": ["y"],
                  "inputs": ["u"], "disturbances": ["a", "b"]},
        "FunctionalPlant": {"whole": plant, "map": t["part"].map, "rows": 1, "A": t["part"].A, "C": t["part"].C,
                            "G": t["part"].G},
        "FunctionalPlant.of_part": {"part": t["part"], "whole": plant, "onto": t["part"].map, "rows": 1},
        "FunctionalPlant.beside": {"window": 4.0},
        "FunctionalPlant.augmented": {"bias": ["y"]},
        "Plant.augmented": {"bias": ["y"]},
        "Certificate.from_matrices": {"P1": np.eye(2) / 40, "Qw": np.eye(plant.n_disturbances)},
        "DetectabilityCertificate": {"gain": None, "constants": (), "solver": None, "method": "given"},
        "observability_matrix": {"outputs": None},
        "Requirement": {"samples": 3, "sensors": None, "forbidden": None, "fixed": None},
        "robustness": {"longest": 2},
        "thyroid_experiment": {"runs": 1, "path": None, "workers": 1, "days": 0.1},
        "ThyroidReport": {"lines": ()},
        "NonlinearPlant.f": {"u": (), "w": None},
        "NonlinearPlant.h": {"u": (), "v": None},
        "NonlinearPlant.equilibrium": {"u": ()},
        "NonlinearPlant.linearise": {"u": ()},
        "constants_from_proof": {"window": None},
        "certify_from_proof": {"window": None},
        "Requirement.replace": {"changes": {"spacing": 0.4}},
        "validate": {"duration": 4.0},
        "compare_schedule": {"times": [0.7, 2.4]},
        "UpperBound.value_for": {"problem": None},
        **{f"{name}.step": {"state": owner(name).initial_state()} for name in STATEFUL},
        **{f"{name}.stream": {"samples": [(1.2, [0.3])]} for name in STATEFUL},
    }  # fmt: skip


OWNERS = {
    "Plant": "plant", "Signals": None, "Schedule": "finite", "PeriodicSchedule": "schedule", "SpacedWindows": "spaced",
    "GapRange": "gaps", "Jitter": "jitter", "OutputJitter": "apart",
    "LostSamples": "lost", "SamplingSet": None, "Requirement": "requirement",
    "PlanRequirement": "wanted", "SigmaDeviations": None, "Sensor": None, "OpeningCalendar": None,
    "Certificate": "certificate", "FamilyCertificate": "family", "DetectabilityCertificate": "detectability",
    "ScheduleDesign": "design", "Estimate": "estimate", "EstimateRecord": "estimates", "SimulatedRecord": "record",
    "Measurements": None, "NonlinearPlant": "nonlinear", "ModalSplit": "split", "FunctionalPlant": "part",
    "SampleLosses": "losses", "RandomArrivals": None,
    "ParetoFront": "pareto", "WindowSigma": "sigma", "WorstCaseSigma": "worst", "ZeroCountBound": "count",
    "Robustness": "robustness", "FourHorizons": "horizons", "ProofConstants": "proof", "TradeoffCurve": "tradeoff",
    "InformationCurve": "curve", "ValidationReport": "report", "ScheduleLog": "log",
    "DetectabilityEvidence": "evidence",
    "UnobservableModes": "unseen", "Counterexample": "counterexample", "ConvexSet": "set",
    "Constraints": "held", "Sweep": None, "CostFunction": "cost", "Collocation": "pieces",
    "SparsePlant": "sparse", "UncertainPlant": "uncertain", "UncertainParameter": None,
    "TimeVaryingPlant": None, "InclusionCertificate": "inclusion",
    "Horizon": None, "ClaimCheck": None,
    "Verification": None, "UpperBound": None, "WindowWitness": None, "EigenvalueCluster": None, "ConstantList": None,
    "SamplingFamily": "gaps", "MovingHorizonEstimator": None, "KalmanFilter": None,
    "NonlinearMovingHorizonEstimator": None, "ThyroidReport": None,
}  # fmt: skip


def owner(name: str) -> Any:
    """A valid instance of a public class, made afresh where it has a state."""
    t = things()
    plant, certificate = t["plant"], t["certificate"]
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 2.0}
    fresh: dict[str, Callable[[], Any]] = {
        "Signals": lambda: plant.states,
        "SigmaDeviations": lambda: t["sigma"].deviations,
        "Sensor": sd.schedules.Sensor,
        "OpeningCalendar": lambda: sd.schedules.OpeningCalendar("2026-03-23"),
        "SamplingSet": lambda: sd.schedules.SamplingSet(t["schedule"]),
        "Measurements": lambda: t["record"].measurements,
        "Horizon": certificate.horizon,
        "ClaimCheck": lambda: t["report"].checks[0],
        "Verification": certificate.verify,
        "UpperBound": lambda: t["design"].bound,
        "UncertainParameter": _stiffness,
        "TimeVaryingPlant": lambda: public()["TimeVaryingPlant"](
            lambda t: -np.eye(2), lambda t: np.eye(2), horizon=6.0
        ),
        "WindowWitness": lambda: t["sigma"].witness,
        "EigenvalueCluster": lambda: public()["eigenvalue_clusters"](plant.A)[0],
        "ConstantList": lambda: certificate.constants,
        "MovingHorizonEstimator": lambda: sd.MovingHorizonEstimator(plant, certificate, **bounds),
        "KalmanFilter": lambda: sd.KalmanFilter(plant, certificate, **bounds),
        "NonlinearMovingHorizonEstimator": lambda: sd.NonlinearMovingHorizonEstimator(
            t["nonlinear"], horizon=2.0, cost=sd.CostFunction(P2=np.eye(2), Qw=np.eye(2), R=np.eye(1))
        ),
        "ThyroidReport": lambda: _thyroid_report(),
        "RandomArrivals": lambda: sd.certificates.random_arrivals(certificate, 0.1),
        "Sweep": lambda: sd.records.sweep(sd.plants.split_modes, [plant]),
    }
    key = OWNERS[name]
    return t[key] if key else fresh[name]()


kept = functools.cache(owner)
"""The same instance each time, for what asks it nothing."""


@functools.cache
def _thyroid_report() -> Any:
    return sd.nonlinear.thyroid_experiment(1, cases=["per_second"], days=0.25, workers=1)


NEEDED = {"y", "span", "budget", "starts", "branches", "pairs"}
"""Optional parameters that a valid call gives: without them it would be refused, or slow."""
UNCALLED = {"library", "thyroid", "Estimator", "SamplingFamily", "GuaranteeWarning", "Sample", "RecordEstimator"}
"""Modules, protocols and plain tuples: nothing of ours runs when they are called."""
STATEFUL = {"MovingHorizonEstimator", "KalmanFilter", "NonlinearMovingHorizonEstimator"}
INHERITED = {"count", "index", "add_note", "with_traceback"}


@dataclass(frozen=True)
class Door:
    """One public callable with valid arguments."""

    name: str
    arguments: dict[str, Any]

    def target(self, made: Callable[[str], Any] = owner) -> Callable[..., Any]:
        """The callable itself, a method of a valid instance."""
        head, _, method = self.name.partition(".")
        thing = public()[head]
        if not method:
            return thing
        inner = inspect.getattr_static(thing, method)
        return getattr(thing if isinstance(inner, (classmethod, staticmethod)) else made(head), method)


@functools.cache
def doors() -> tuple[Door, ...]:
    """Every public function, class and method; those without a valid argument are an error of this file."""
    names = [n for n in public() if n not in UNCALLED]
    for name in list(names):
        thing = public()[name]
        if inspect.isclass(thing) and name in OWNERS:
            names += [
                f"{name}.{key}"
                for key in dir(thing)
                if not key.startswith("_") and key not in INHERITED and callable(getattr(thing, key))
            ]
    own = special()
    return tuple(Door(name, arguments(name, own.get(name, {}))) for name in names)


def arguments(name: str, own: dict[str, Any]) -> dict[str, Any]:
    """Valid arguments of a public callable: its required parameters, and the optional ones with a known name."""
    head, _, method = name.partition(".")
    thing = getattr(public()[head], method) if method else public()[head]
    if inspect.isclass(thing) and issubclass(thing, (Exception, tuple)):
        return {}
    usual = named()
    given = {}
    for key, parameter in inspect.signature(thing).parameters.items():
        if key == "self" or parameter.kind is inspect.Parameter.VAR_POSITIONAL:
            continue
        if parameter.kind is inspect.Parameter.VAR_KEYWORD:
            given |= own.get(key, {})
        elif key in own:
            given[key] = own[key]
        elif parameter.default is inspect.Parameter.empty or key in NEEDED:
            given[key] = usual.get(key, 1.0)
    return given


def optional(name: str) -> list[str]:
    """All parameters of a public callable that an argument can be wrong for."""
    head, _, method = name.partition(".")
    thing = getattr(public()[head], method) if method else public()[head]
    if inspect.isclass(thing) and issubclass(thing, (Exception, tuple)):
        return []
    kinds = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
    found = [k for k, p in inspect.signature(thing).parameters.items() if k != "self" and p.kind not in kinds]
    return found


class Odd:
    """An object of a foreign kind."""


def wrong() -> dict[str, Callable[[], Any]]:
    """Arguments that are wrong for most parameters, made afresh for each call."""
    t = things()
    import pandas as pd
    import scipy.signal

    return {
        "None": lambda: None, "True": lambda: True, "text": lambda: "nosuch", "empty text": lambda: "",
        "bytes": lambda: b"\x00\xff", "complex": lambda: 1 + 2j, "nan": lambda: float("nan"),
        "inf": lambda: float("inf"), "-inf": lambda: -float("inf"), "1e308": lambda: 1e308, "1e-308": lambda: 1e-308,
        "-1": lambda: -1, "0": lambda: 0, "-2.5": lambda: -2.5, "huge int": lambda: 10**400, "1e18": lambda: 10**18,
        "numpy int": lambda: np.int32(3), "numpy bool": lambda: np.bool_(True), "fraction": lambda: Fraction(3, 2),
        "[]": lambda: [], "()": lambda: (), "{}": lambda: {}, "empty array": lambda: np.zeros((0, 0)),
        "ragged": lambda: [[1.0, 2.0], [3.0]], "list of text": lambda: ["a", "b"], "matrix": lambda: np.ones((3, 2)),
        "vector": lambda: [1.0, -2.0, 3.0], "cube": lambda: np.ones((2, 2, 2)), "nan array": lambda: [np.nan, 1.0],
        "nan matrix": lambda: np.full((2, 2), np.nan), "inf array": lambda: [np.inf, 1.0],
        "huge matrix": lambda: np.full((2, 2), 1e308), "tiny matrix": lambda: np.full((2, 2), 1e-308),
        "complex array": lambda: np.eye(2) * 1j, "objects": lambda: np.array([object(), None], dtype=object),
        "object": Odd, "class": lambda: Odd, "generator": lambda: (v for v in (1.0, 2.0)), "set": lambda: {1.0, 2.0},
        "dict": lambda: {"a": 1, "x": [1, 2]}, "function": lambda: (lambda *a, **k: None),
        "plant": lambda: t["plant"], "schedule": lambda: t["finite"], "certificate": lambda: t["certificate"],
        "family certificate": lambda: t["family"], "requirement": lambda: t["requirement"],
        "detectability": lambda: t["detectability"],
        "scipy system": lambda: scipy.signal.StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]]),
        "discrete system": lambda: scipy.signal.StateSpace([[-0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1),
        "empty schedule": lambda: sd.Schedule([]), "nothing to observe": lambda: sd.Plant([[1.0]], [[0.0]]),
        "no states": lambda: sd.Plant(np.zeros((0, 0)), np.zeros((1, 0))),
        "folder": lambda: str(folder()), "module": lambda: np, "range": lambda: range(3),
        "pair of arrays": lambda: (np.ones(2), np.ones(2)), "one-sided pair": lambda: (0.1, np.inf),
        "0-d array": lambda: np.array(3.0), "0-d text": lambda: np.array("x"), "no date": lambda: pd.NaT,
        "span of time": lambda: np.timedelta64(3, "h"), "extended": lambda: np.longdouble("1e400"),
        "date": lambda: datetime(2026, 1, 1), "date and number": lambda: [datetime(2026, 1, 1), 3.0],
        "zero byte": lambda: "a\0b", "half a letter": lambda: "\ud800", "text in text": lambda: {"Mon": {"x": 1}},
        "deep": lambda: functools.reduce(lambda inner, _: [inner], range(5000), [1.0]),
        "masked": lambda: np.ma.array([1.0, 2.0], mask=[True, False]), "same names": lambda: ["position", "position"],
        "frame": lambda: pd.DataFrame([[1.0, 2.0]], columns=["position", "position"]),
        "mixed": lambda: [1.0, "2", None],
    }  # fmt: skip


@dataclass(frozen=True)
class Call:
    """One call with the wrong arguments by parameter."""

    door: Door
    faults: tuple[tuple[str, str], ...]

    def __str__(self) -> str:
        return f"{self.door.name}({', '.join(f'{k}={v}' for k, v in self.faults)})"

    def raw(self) -> str:
        """What came out that must not ("": a value, or an error of ours in one sentence, and no RuntimeWarning)."""
        given = dict(self.door.arguments)
        kinds = wrong()
        for key, kind in self.faults:
            given[key] = kinds[kind]()
        try:
            with warnings.catch_warnings(record=True) as warned, _alarm(), _quiet():
                warnings.simplefilter("ignore")
                warnings.simplefilter("always", RuntimeWarning)
                value = self.door.target()(**given)
                if inspect.isgenerator(value):
                    list(value)
        except SamplingDesignError as error:
            text = str(error)
            return "" if text.strip() and "\n" not in text else f"no one sentence: {text[:200]!r}"
        except _Hang:
            return f"hangs: over {SECONDS} s\n{traceback.format_exc(limit=-3)}"
        except Exception as error:
            return f"{type(error).__name__}: {str(error)[:160]}\n{traceback.format_exc(limit=-3)}"
        return next((f"{w.category.__name__}: {w.message}\n  File {w.filename}:{w.lineno}" for w in warned), "")


class _Hang(BaseException):
    pass


@contextlib.contextmanager
def _alarm() -> Iterator[None]:
    def ring(*_: Any) -> None:
        raise _Hang

    before = signal.signal(signal.SIGVTALRM, ring)
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        yield


def every_single_fault() -> list[Call]:
    """All calls with one wrong argument."""
    return [Call(d, ((key, kind),)) for d in doors() for key in optional(d.name) for kind in wrong()]


def drawn(count: int, seed: int) -> list[Call]:
    """So many random calls, of one or two wrong arguments; every callable is as likely."""
    rng, kinds = np.random.default_rng(seed), list(wrong())
    choice = [d for d in doors() if optional(d.name)]
    calls = []
    for _ in range(count):
        door = choice[rng.integers(len(choice))]
        keys = optional(door.name)
        chosen = rng.permutation(len(keys))[: 1 + int(rng.random() < 0.3)]
        calls.append(Call(door, tuple((keys[i], kinds[rng.integers(len(kinds))]) for i in chosen)))
    return calls


def main() -> None:
    """Make the calls that the command line asks for and list the raw ones by where they come from."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    asked = sys.argv[1:]
    calls = every_single_fault() if asked[:1] == ["all"] else drawn(int(asked[0]), int(asked[1]))
    only = asked[2] if len(asked) > 2 else ""
    calls = [c for c in calls if only in c.door.name]
    os.chdir(tempfile.mkdtemp(prefix="front-door-cwd-"))
    found: dict[str, list[str]] = {}
    ends: Counter[str] = Counter()
    for call in calls:
        raw = call.raw()
        ends["raw" if raw else "in order"] += 1
        if raw:
            lines = raw.splitlines()
            place = [line for line in lines if "File" in line][-1:] or [""]
            mine = [line for line in lines if "sampling_design/" in line][-1:] or place
            found.setdefault(f"{lines[0][:110]} | {mine[0].strip()}", []).append(str(call))
    for where, which in sorted(found.items(), key=lambda item: -len(item[1])):
        print(f"{len(which):4}  {where}\n        {'; '.join(which[:3])}")
    print(dict(ends), "of", len(calls))


if __name__ == "__main__":
    main()
