"""What a verb returns says what it is, its evidence, how good it is, how to check and how to draw it, in this order."""

import importlib
import inspect
import pickle
import pkgutil
import re

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import uncertain
from sampling_design.accuracy.accuracy_record import AccuracyBracket
from sampling_design.certificates.existence.periodic import ExistenceAnswer
from sampling_design.certificates.rigorous.decide import VerifiableRecord
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.observability.count.zero_count import SampleCount
from sampling_design.observability.sigma_bracket import SigmaBracket
from sampling_design.planning.comparison import PlanComparison
from sampling_design.records.declarations import BOUNDS as ROUNDED
from sampling_design.records.declarations import PLACE, STEP
from sampling_design.records.record import ANSWERS, Record
from tests import front_door

GIVEN = {  # what a user could have made, and what a plant consists of
    "EigenvalueCluster", "FunctionalPlant", "Measurements", "ModalSplit", "NonlinearPlant", "PeriodicSchedule", "Plant",
    "PlanRequirement", "Requirement", "SamplingFamily", "Schedule", "SimulatedRecord", "SparseSplit", "Sweep",
    "TimeVaryingPlant", "UnobservableModes",
}  # fmt: skip
READ_OR_MADE = ("read_", "named_", "simulate_")  # verbs that return what a user could have made
PLANT = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], time_unit="s", states=["position", "speed"])
SCHEDULE = sd.PeriodicSchedule([0.7, 1.6, 0.9], time_unit="s")
BOUNDS = {"w_bound": 0.1, "v_bound": 0.1}
BOX = sd.UncertainPlant(PLANT, [sd.UncertainParameter("stiffness", 0.0, 0.05, A=[[0.0, 0.0], [-1.0, 0.0]])])


def certificate():
    return front_door.things()["certificate"]


def thing(name):
    return lambda: front_door.things()[name]


def record():
    return [(0.7, [0.8]), (2.3, [-0.7])]


MADE = {
    "design_schedule": thing("design"),
    "certify": certificate,
    "certify_detectability": thing("detectability"),
    "window_sigma": thing("sigma"),
    "worst_case_sigma": thing("worst"),
    "worst_case_sigma of a box": lambda: sd.worst_case_sigma(BOX, sd.SpacedWindows(4.0, 3, 0.5), rtol=0.5),
    "zero_count_bound": thing("count"),
    "zero_count_bound of a box": lambda: sd.zero_count_bound(BOX, 4.0),
    "certificate_exists": lambda: sd.certificate_exists(PLANT, SCHEDULE, 0.4),
    "guaranteed_accuracy": lambda: sd.guaranteed_accuracy(PLANT, SCHEDULE, rtol=0.2, **BOUNDS),
    "guaranteed_accuracy of nothing": lambda: sd.guaranteed_accuracy(
        sd.Plant(np.diag([0.0, -1.0]), [[0.0, 1.0]]), SCHEDULE, of=[[1.0, 0.0]], **BOUNDS
    ),
    "state_interval": lambda: sd.state_interval(PLANT, record(), initial_error=2.0, prior_time=0.0, **BOUNDS),
    "state_interval that is empty": lambda: sd.state_interval(PLANT, [(0.1, [1.0]), (0.2, [9.0])], **BOUNDS),
    "run": lambda: sd.MovingHorizonEstimator(PLANT, certificate(), initial_error=2.0, **BOUNDS).run(record()),
    "run without bounds": lambda: sd.KalmanFilter(PLANT).run(record()),
    "random_arrivals": lambda: sd.certificates.random_arrivals(certificate(), 0.1),
    "compare_schedule": thing("log"),
    "accuracy_by_count": lambda: sd.accuracy.accuracy_by_count(PLANT, (1, 4), period=4.0, rtol=0.2, **BOUNDS),
    "accuracy_by_count of a budget": lambda: sd.accuracy.accuracy_by_count(
        PLANT, (4,), period=4.0, rtol=1e-9, budget=1e-9, **BOUNDS
    ),
    "accuracy_limit": lambda: sd.accuracy.accuracy_limit(PLANT, **BOUNDS),
    "standard_deviation": lambda: sd.accuracy.standard_deviation(PLANT, SCHEDULE, w_intensity=0.1, v_deviation=0.1),
    "four_horizons": thing("horizons"),
    "information_curve": thing("curve"),
    "tradeoff_curve": thing("tradeoff"),
    "constants_from_proof": thing("proof"),
    "loss_tolerance": lambda: sd.observability.loss_tolerance(PLANT, SCHEDULE),
    "loss_tolerance of growth": lambda: sd.observability.loss_tolerance(
        sd.Plant([[0.1, 1.0], [-1.0, 0.1]], [[1.0, 0.0]]), sd.PeriodicSchedule([np.pi / 2])
    ),
    "largest_box": lambda: uncertain.largest_box(BOX, SCHEDULE, window=4.0),
    "estimate_curve": lambda: sd.estimators.estimate_curve(
        sd.MovingHorizonEstimator(PLANT, certificate(), initial_error=2.0, **BOUNDS),
        sd.Measurements(PLANT, [0.7, 2.3], [[0.8], [-0.7]]),
    ),
    "validate": thing("report"),
}


def results():
    """Every class of record that a verb of the front door or of a room returns, and those of other plants."""
    for module in pkgutil.walk_packages(sd.__path__, "sampling_design."):  # all records are known then
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    rooms = (importlib.import_module(room.name) for room in pkgutil.iter_modules(sd.__path__, "sampling_design."))
    verbs = [
        thing
        for room in (sd, *rooms)
        for name, thing in ((name, getattr(room, name)) for name in getattr(room, "__all__", ()))
        if inspect.isfunction(thing) and not name.startswith(READ_OR_MADE)
    ]
    told = {kind for verb in verbs for kind in returned(verb)}
    kinds = {EstimateRecord, PlanComparison, sd.certificates.RandomArrivals} | told
    for base in (SigmaBracket, SampleCount, ExistenceAnswer, AccuracyBracket, VerifiableRecord):
        kinds |= {kind for kind in derived(base) if kind.__module__.startswith("sampling_design.")}
    return sorted((kind for kind in kinds if not kind.__subclasses__() or "_answers" in vars(kind)), key=repr)


def returned(verb):
    """The classes of records that a verb returns, but those that a user gives."""
    named = set(re.findall(r"\w+", str(inspect.unwrap(verb).__annotations__["return"])))
    return {kind for kind in derived(Record) if kind.__name__ in named - GIVEN}


def derived(base):
    for kind in base.__subclasses__():
        yield kind
        yield from derived(kind)


@pytest.mark.parametrize("kind", results(), ids=lambda kind: kind.__name__)
def test_no_result_is_forgotten(kind):
    assert issubclass(kind, Record)
    assert len(kind._answers) == 4
    known = {name for base in kind.__mro__ for name in (*vars(base), *getattr(base, "__annotations__", {}))}
    paths = [place[0] for text in kind._answers for place in PLACE.findall(text)]
    assert {STEP.findall(path)[0] for path in paths} <= known


TIMED = {"times", "period", "spacing", "window from", "until", "duration", "largest deviation", "worst times"}


def check_units(found):
    """Times have the unit of the plant, in tables and in sentences, and nothing is said to be at least zero."""
    rows = [(label, value) for label, value in found._answered() + found._rows() if label in TIMED]
    assert [row for row in rows if not re.search(r"[\d\])] s\b", row[1])] == []
    assert (
        re.findall(r"\b(?:horizon (?:is|of more than)|longer than|ends at) [\d.]+(?![\d.]| s\b)", found.explain()) == []
    )
    assert not re.search(r"at least 0(?!\.\d)", found.explain())


@pytest.mark.parametrize("name", MADE)
def test_five_things_stand_in_one_order(name):
    found = MADE[name]()
    check_units(found)
    assert [key for key, value in vars(found).items() if getattr(value, "flags", None) and value.flags.writeable] == []
    assert [label for label, _ in found._answered()] == list(ANSWERS)
    said = dict(found._answered())
    assert said["evidence"].split(":")[0].split()[0] in ("proven", "attained", "sampled", "nothing")
    assert not {"nan", "None"} & set(" ".join(said.values()).replace("[", " ").split())
    for shown, mark in ((str(found), "\n  {}  "), (found._repr_html_(), ">{}<")):
        places = [shown.find(mark.format(label)) if mark[0] == ">" else shown.find(f"\n  {label}") for label in ANSWERS]
        assert -1 not in places
        assert places == sorted(places)
    assert said["how good"] in repr(found)
    assert found.explain()
    assert str(pickle.loads(pickle.dumps(found))) == str(found)  # as a worker process hands it back
    texts = [str(found), repr(found), found.explain()]
    if said["how to draw"] == "`.plot()`":
        axes = np.ravel(found.plot())
        figure = axes[0].figure
        texts += [each.get_text() for each in figure.findobj(lambda each: hasattr(each, "get_text"))]
    assert inward(" ".join(texts), bounds_of(found)) == []


def bounds_of(record):
    """The bounds that a record holds, by their names: numbers, and which way each may be rounded."""
    for name in {*vars(record), *(name for kind in type(record).__mro__ for name in vars(kind))} & set(ROUNDED):
        value = np.asarray(getattr(record, name))
        for number in value.ravel().tolist() if value.dtype.kind == "f" else []:
            yield number, ROUNDED[name]


def inward(text, bounds):
    """The numbers of three digits and more that are bounds, rounded, and on the wrong side of each that they are."""
    bounds, wrong = [(value, up) for value, up in bounds if 0 < abs(value) < np.inf], []
    for printed in re.findall(r"(?<![\w.])-?\d+\.\d+(?:e[-+]\d+)?", text):
        mantissa, _, power = printed.partition("e")
        if len(mantissa.lstrip("-0.").replace(".", "")) < 3:
            continue  # too short to tell whether it is the bound
        unit = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
        near = [(value, up) for value, up in bounds if abs(float(printed) - value) <= 0.5001 * unit]
        if near and not any(float(printed) >= value if up else float(printed) <= value for value, up in near):
            wrong.append((printed, near))
    return wrong


def test_a_number_on_the_wrong_side_of_a_bound_is_found():
    bounds = [(0.12341, True), (2.0 / 3.0, False), (1.531e-7, True), (0.0, True), (np.inf, True)]
    assert inward("0.1235 of 0.6666, 1.54e-07, x0.6667, 0.67 and 3", bounds) == []
    assert [printed for printed, _ in inward("0.1234 of 0.6667, 1.53e-07", bounds)] == ["0.1234", "0.6667", "1.53e-07"]
