"""The door before the public functions: kinds by annotation, foreign systems, numbers too large."""

from __future__ import annotations

import inspect
import os
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import control
import numpy as np
import pytest
import scipy.signal

import sampling_design as sd
from sampling_design.certificates import find_counterexample, four_horizons
from sampling_design.errors import ArgumentError, CallError, SolverError
from sampling_design.estimators import ConvexSet, EstimateRecord
from sampling_design.nonlinear import from_linear
from sampling_design.nonlinear.report import ThyroidReport
from sampling_design.observability.count.zero_count import critical_length
from sampling_design.plotting import draw
from sampling_design.records import dispatch
from sampling_design.records.signatures import _ForeignSystem, _kinds, checked, checked_methods, hints_of, open_verb
from tests import front_door
from tests.cases import few
from tests.front_door import DOORS

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
MEASURED = [*inspect.signature(sd.Measurements).parameters][:3]
GAPS = sd.PeriodicSchedule([0.7, 1.6, 0.9])


@checked
def verb(
    x: float,
    n: int = 1,
    *,
    flag: bool = False,
    kind: Literal["a", "b"] = "a",
    path: str | Path | None = None,
    tell: Callable[[float], None] | None = None,
    some: Sequence[int] = (),
    more: Iterable[Any] = (),
    anything: Any = None,
) -> tuple[Any, ...]:
    """What came through."""
    return x, n, flag, kind, path, tell, some, more, anything


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"x": "3"}, "`x` must be a number, got str '3'"),
        ({"x": True}, "`x` must be a number, got bool True"),
        ({"x": 1j}, "`x` must be a number, got complex 1j"),
        ({"x": None}, "`x` must be a number, got None"),
        ({"x": float("nan")}, "`x` must be finite, got nan"),
        ({"x": 10**400}, "`x` must be a number of double precision, got one above 1e308"),
        ({"x": 1.0, "n": 1.5}, "`n` must be a whole number, got float 1.5"),
        ({"x": 1.0, "n": float("inf")}, "`n` must be a whole number, got float inf"),
        ({"x": 1.0, "flag": 1}, "`flag` must be True or False, got int 1"),
        ({"x": 1.0, "kind": "c"}, "`kind` must be one of 'a', 'b', got str 'c'"),
        ({"x": 1.0, "path": 3}, "`path` must be a text or a Path, got int 3"),
        ({"x": 1.0, "tell": 3}, "`tell` must be a function of 1 argument, got int 3"),
        ({"x": 1.0, "tell": lambda: None}, "`tell` must be a function of 1 argument, got function"),
        ({"x": 1.0, "some": "ab"}, "`some` must be a list, got str 'ab'"),
        ({"x": 1.0, "more": 5}, "`more` must be a list, got int 5"),
        ({"x": np.ones((2, 2))}, r"`x` must be a number, got ndarray array\(\[\[1., 1.\], \[1., 1.\]\]\)"),
    ],
)
def test_an_argument_of_another_kind_is_one_sentence(given, words):
    with pytest.raises(ArgumentError, match=words) as caught:
        verb(**given)
    assert "\n" not in str(caught.value)


def test_what_means_a_number_is_one():
    assert verb(np.float64(2.0), np.int32(3))[:2] == (2.0, 3)
    assert verb(Fraction(3, 2), 4.0)[:2] == (1.5, 4)
    assert type(verb(1.0, np.int64(3))[1]) is int
    assert verb(np.array(2.5), flag=np.bool_(True))[::2][:2] == (2.5, True)
    assert verb(float("inf"))[0] == np.inf
    assert verb(1.0, some=np.array([1, 2]))[6] == [1, 2]


def test_a_door_leaves_name_signature_and_module():
    assert verb.__name__ == "verb"
    assert next(iter(inspect.signature(verb).parameters)) == "x"
    assert verb.__globals__ is globals()  # or doctest would not look inside


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: verb(1.0, y=2), r"`verb` has no argument `y`\. Known: 'x', 'n', 'flag'"),
        (lambda: verb(1.0, knd="a"), r"`verb` has no argument `knd`\. Did you mean 'kind'\?"),
        (lambda: verb(), r"`verb` needs `x`\."),
        (lambda: verb(1.0, x=2.0), r"`verb` got `x` twice, by place and by name\."),
        (lambda: verb(1.0, 2, True), r"`verb` takes 2 arguments by place \(x, n\), got 3: the others have names\."),
        (
            lambda: sd.certify(OSCILLATOR, GAPS, budgett=2.0),
            "`certify` has no argument `budgett`. Did you mean 'budget'",
        ),
        (
            lambda: sd.validate(OSCILLATOR, sd.PeriodicSchedule([1.0]), seed=1),
            "have no argument `seed`. Did you mean 'rng'",
        ),
        (lambda: sd.Plant(OSCILLATOR.A, OSCILLATOR.C, xyzzy=3), "`Plant` has no argument `xyzzy`. Known: 'A', 'C'"),
        (lambda: sd.Plant(OSCILLATOR.A, C=OSCILLATOR.C, state=["p", "v"]), "`state`. Did you mean 'states'"),
        (lambda: sd.Plant(), "`Plant` needs `A`"),
        (lambda: sd.plants.Signals(), "`Signals` needs `names`"),
        (
            lambda: sd.KalmanFilter(OSCILLATOR, w_bounds=0.1),
            "`KalmanFilter` has no argument `w_bounds`. Did you mean 'w_",
        ),
        (
            lambda: sd.design_schedule(OSCILLATOR, window=3.0),
            r"It belongs to `requirement`: Requirement\(window=\.\.\.\)",
        ),
        (lambda: sd.worst_case_sigma(OSCILLATOR, count=3), r"It belongs to `family`: SpacedWindows\(count=\.\.\.\)"),
        (lambda: sd.KalmanFilter(OSCILLATOR, Q=1.0), r"It belongs to `cost`: CostFunction\(Qw=\.\.\.\)"),
        (lambda: sd.KalmanFilter(OSCILLATOR).predict(), "`KalmanFilter.predict` needs `t`"),
        (lambda: GAPS.plot(axes=3), "`plot` of a PeriodicSchedule has no argument `axes`. Did you mean 'ax'"),
        (lambda: OSCILLATOR.transition(), "`Plant.transition` needs `t`"),
        (
            lambda: sd.KalmanFilter(OSCILLATOR).run([1.0], [[0.1]]),
            rf"takes 1 argument by place \(record\), got 2.* record: Measurements\({', '.join(MEASURED)}\)\.",
        ),
        (lambda: sd.Plant.from_control(), "`Plant.from_control` needs `system`"),
    ],
)
def test_a_call_that_does_not_fit_is_one_sentence(call, words):
    with pytest.raises(TypeError, match=words) as told:  # what Python calls it, too
        call()
    assert isinstance(told.value, CallError)


@pytest.mark.parametrize("path", ["a\0b", "\ud800"])
def test_a_path_that_no_file_has_is_one_sentence(path):
    with pytest.raises(ArgumentError, match="`path` must be a path that a file can have, got str"):
        sd.read_plan(path)


def test_a_file_may_have_a_name_that_is_no_text(tmp_path):
    path = tmp_path / os.fsdecode(b"caf\xe9.toml")
    sd.plants.write_plant(sd.named_plant("oscillator"), path)
    assert sd.read_plant(path).name == sd.read_plant(str(path)).name


def test_a_class_is_no_instance():
    with pytest.raises(ArgumentError, match=r"got the class KalmanFilter: make one, KalmanFilter\(\.\.\.\)"):
        sd.validate(OSCILLATOR, sd.PeriodicSchedule([1.0]), estimator=sd.KalmanFilter)


def test_a_type_error_of_what_the_caller_gave_stays_what_it_is():
    def broken(x):
        return x + "text"

    @checked
    def calls(function: Callable[[float], float]) -> float:
        """Call what is given."""
        return function(1.0)

    with pytest.raises(TypeError, match="unsupported operand") as told:
        calls(broken)
    assert not isinstance(told.value, CallError)


def test_inside_the_house_a_call_that_does_not_fit_is_a_defect():
    @checked
    def calls() -> sd.Plant:
        """Make a plant of what no plant takes."""
        return sd.Plant(colour=3)

    @checked
    def calls_a_door() -> object:
        """Call a door as none can be called."""
        return verb(y=2)

    for defect in (calls, calls_a_door):
        with pytest.raises(TypeError, match="unexpected keyword argument") as told:
            defect()
        assert not isinstance(told.value, CallError)


def test_numbers_that_leave_double_precision_are_one_sentence():
    @checked
    def overflows(x: float) -> float:
        return float(x) ** 400

    @checked
    def singular(x: float) -> Any:
        return np.linalg.inv(np.zeros((2, 2)) * x)

    @checked
    def huge(x: float) -> Any:
        return np.zeros((2**40, int(x)))

    with pytest.raises(SolverError, match="`overflows` leaves what double precision can hold"):
        overflows(1e5)
    with pytest.raises(SolverError, match="`singular` leaves what double precision can hold"):
        singular(1.0)
    with pytest.raises(SolverError, match="`huge` needs more memory than there is"):
        huge(2.0**10)
    with pytest.raises(SolverError, match="`huge` needs more memory than there is"):
        huge(2.0**60)  # beyond what numpy even asks for


def test_inner_doors_let_errors_pass_to_those_who_expect_them():
    @checked
    def inner(x: float) -> float:
        raise np.linalg.LinAlgError("singular")

    @checked
    def outer(x: float) -> float:
        try:
            return inner(x)
        except np.linalg.LinAlgError:
            return 7.0

    assert outer(1.0) == 7.0


def test_methods_of_a_class():
    @checked_methods
    class Thing:
        def __init__(self, size: float) -> None:
            self.size = size

        def grown(self, factor: float) -> float:
            return self.size * factor

        @classmethod
        def of(cls, size: float) -> Any:
            return cls(size)

        @staticmethod
        def twice(size: float) -> float:
            return 2 * size

    assert (Thing(2.0).grown(3), Thing.of(2.0).size, Thing.twice(4)) == (6.0, 2.0, 8)
    for call in (lambda: Thing("a"), lambda: Thing(1.0).grown("a"), lambda: Thing.of("a"), lambda: Thing.twice("a")):
        with pytest.raises(ArgumentError, match="must be a number, got str 'a'"):
            call()


@pytest.mark.parametrize(
    "system",
    [
        control.ss([[0, 1], [-1, 0]], [[0], [0]], [[1, 0]], [[0]]),
        scipy.signal.StateSpace([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [0.0]], [[1.0, 0.0]], [[0.0]]),
        scipy.signal.lti([[0.0, 1.0], [-1.0, 0.0]], [[0.0], [0.0]], [[1.0, 0.0]], [[0.0]]),
    ],
    ids=["control", "scipy", "lti"],
)
def test_a_state_space_system_is_taken_wherever_a_plant_is(system):
    ours = sd.certify(OSCILLATOR, GAPS, eta=0.4, P2=np.eye(2))
    theirs = sd.certify(system, GAPS, eta=0.4, P2=np.eye(2))
    assert theirs.lam == ours.lam
    assert theirs.plant.time_unit == "s"
    assert sd.certificate_exists(system, GAPS, 0.1).exists
    assert sd.window_sigma(system, GAPS, 4.0).lower == sd.window_sigma(OSCILLATOR, GAPS, 4.0).lower
    assert sd.plants.split_modes(plant=system).retained.n_states == 2


def test_no_verb_that_takes_a_plant_was_forgotten():
    """What each door makes of a state-space system where its annotation names a plant, linear or not."""
    system = control.ss([[0, 1], [-1, 0]], [[0], [0]], [[1, 0]], [[0]])
    asked = {
        "largest_box": "how far uncertain parameters may go: a system has none",
        "NominalFilter.__init__": "for a box of plants: a system is one, and KalmanFilter takes it",
        "split_sparse": "for matrices that are never dense: a system's are, and split_modes takes it",
    }
    beside = {"critical_length": (system,), "EstimateRecord.collect": None}  # what else they take hides it from a check
    for name, verb in DOORS.items():
        for argument, hint in hints_of(verb.__wrapped__).items():
            if argument == "return" or not re.search(
                r"\b(Plant|NonlinearPlant|UncertainPlant|SparsePlant)\b", str(hint)
            ):
                continue
            if name in beside:
                assert beside[name] is None or verb(*beside[name]) == pytest.approx(np.pi)
                continue
            taken = [take(argument, system) for _, take in _kinds(hint)]
            assert any(isinstance(found, _ForeignSystem) for found in taken) or name in asked, f"{name}({argument}=)"


def test_a_nonlinear_verb_takes_a_linear_plant():
    mine = sd.NonlinearMovingHorizonEstimator(OSCILLATOR, horizon=3.0)
    system = control.ss(OSCILLATOR.A, [[0], [0]], OSCILLATOR.C, [[0]])
    for given in (OSCILLATOR, system):
        made = sd.NonlinearMovingHorizonEstimator(given, horizon=3.0)
        assert made.plant.n_states == mine.plant.n_states == 2
        assert made.plant.f([1.0, 2.0]).tolist() == [2.0, -1.0]


def test_its_unit_of_time_is_the_schedule_s():
    system = control.ss([[0, 1], [-1, 0]], [[0], [0]], [[1, 0]], [[0]])
    hours = sd.PeriodicSchedule([0.7, 1.6, 0.9], time_unit="h")
    assert sd.certify(system, hours, eta=0.4, P2=np.eye(2)).plant.time_unit == "h"


def test_a_discrete_system_says_what_to_give_and_a_transfer_function_is_taken():
    discrete = scipy.signal.StateSpace([[-0.5]], [[1.0]], [[1.0]], [[0.0]], dt=0.1)
    with pytest.raises(
        ArgumentError, match=r"`system` must have a real logarithm, got a discrete one with the pole -0"
    ):
        sd.certify(discrete, GAPS)
    for transfer in (control.tf([1], [1, 1]), scipy.signal.lti([1.0], [1.0, 1.0])):
        assert sd.certify(transfer, GAPS, eta=0.4, P2=np.eye(1)).plant.A.tolist() == [[-1.0]]


class Awkward:
    """An object that breaks whoever asks it for an array."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("no")


def family() -> sd.certificates.FamilyCertificate:
    return sd.certify(OSCILLATOR, sd.GapRange(0.9, 1.1), eta=0.2, P2=np.eye(2))


def estimator() -> sd.KalmanFilter:
    return sd.KalmanFilter(OSCILLATOR, cost=sd.CostFunction(eta=0.1), w_bound=0.1, v_bound=0.1, initial_error=1.0)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: sd.Plant(Awkward(), [[1.0]]), "`A` must hold real numbers, got Awkward"),
        (lambda: sd.zero_count_bound(OSCILLATOR, 10**5000), "`duration` must be a number of double precision"),
        (lambda: sd.Plant([[1.0]], [[1.0]], time_unit=[]), r"`time_unit` must be one of ms, .* got list \[\]"),
        (lambda: sd.Plant([[1.0]], [[1.0]], source=[1]), r"`source` must be a string, got list \[1\]"),
        (lambda: OSCILLATOR.transition(np.ones((2, 2))), "`t` must be a number or a vector of times, got shape"),
        (lambda: OSCILLATOR.transition(np.inf), "`t` must be finite, got"),
        (lambda: ConvexSet.box([0.0], [1.0]).excess([[1.0, 2.0]]), "`values` must have 1 columns, got shape"),
        (lambda: ConvexSet([0.0], [1.0], None, None, [3]), r"`balls` must be a tuple of balls, got list \[3\]"),
        (lambda: estimator().run(3), r"`record` must be Measurements, a DataFrame or a list of \(t, y, u\), got int 3"),
        (lambda: estimator().run([3]), r"`sample` must be \(t, y\) or \(t, y, u\), got int 3"),
        (lambda: estimator().smooth("abc"), r"`record` must be Measurements, a DataFrame or a list of \(t, y, u\)"),
        (lambda: sd.Measurements(3, [1.0], [[1.0]]), "`plant` must be a Plant or a NonlinearPlant, got int 3"),
        (lambda: critical_length(["a"]), "`plant` must be a Plant or a list of eigenvalues, got list"),
        (lambda: find_counterexample(OSCILLATOR, 3, 0.1), "`family` must be a SamplingFamily, got int 3"),
        (lambda: GAPS.between(0.0, 1e12), r"`schedule` has .* samples from 0 to 1e\+12, which take .* GiB"),
        (lambda: sd.Schedule([1.0], output_names=3), "`output_names` must be a list of strings, got int 3"),
        (lambda: sd.robustness(OSCILLATOR, 3), "`certificate` must be a Certificate or FamilyCertificate or a Sche"),
        (lambda: sd.robustness(OSCILLATOR, SimpleNamespace(schedule=3)), "`certificate` must be one about samples"),
        (lambda: four_horizons(OSCILLATOR, GAPS, None, 3), "`proof_constants` must be a ProofConstants, got int 3"),
        (lambda: EstimateRecord.collect(OSCILLATOR, [3]), "`estimates` must be a list of estimates, got list"),
        (lambda: EstimateRecord.collect(3, []), "`plant` must be a Plant or a NonlinearPlant, got int 3"),
        (lambda: sd.NonlinearPlant(3, 4, {"states": 1, "outputs": 1}), "`dynamics` must be a function, got int 3"),
        (lambda: sd.NonlinearPlant(len, len, {"states": 1, "outputs": 1}), "`dynamics` fails for symbols: TypeError"),
        (lambda: sd.NonlinearPlant(len, len, 3), "`sizes` must be a table of names and values, got int 3"),
        (lambda: ThyroidReport(("a",), 0, 1.0, 0, ()).ratio("b"), "`case` must be one of a, got 'b'"),
        (lambda: from_linear(OSCILLATOR).with_bounds(states=([[1.0]], 2.0)), "of 2 entries each"),
        (lambda: from_linear(OSCILLATOR).with_bounds(states=3), "must hold a pair .lower, upper., got int 3"),
        (lambda: replace(family(), graph=3), "`graph` must be a PathCompleteGraph, got int 3"),
        (
            lambda: EstimateRecord.collect(sd.Plant([[1.0]], [[1.0]]), [estimator().update(0.5, [0.3])]),
            "`estimates` must be of the plant's 1 states",
        ),
        (lambda: draw(GAPS, 3), "`ax` must be axes of matplotlib, or None for a new figure, got int 3"),
    ],
)  # fmt: skip
def test_a_wrong_kind_deeper_inside_is_one_sentence(call, words):
    with pytest.raises(ArgumentError, match=words):
        call()


def test_a_gap_beyond_all_count_is_one_sentence():
    certificate = sd.certify(OSCILLATOR, GAPS, eta=0.4, P2=np.eye(2))
    made = sd.MovingHorizonEstimator(OSCILLATOR, certificate, w_bound=0.1, v_bound=0.1, initial_error=2.0)
    with pytest.raises(SolverError, match="a gap is too long to be counted in the plant's fastest units"):
        made.update(1e308, [0.3])


class Own:
    """A plant as far as an opened verb knows it."""

    time_unit = "h"


class Other:
    time_unit = "h"


@open_verb(float)
def opened(plant: Own, x: float, *, scale: float = 1.0) -> float:
    """Return x in some unit."""
    return x * scale


def test_an_opened_verb_hands_another_kind_of_plant_to_what_is_registered(monkeypatch):
    dispatch._ask_rings()  # what they register stays
    monkeypatch.setattr(dispatch, "_OFFERED", dict(dispatch._OFFERED))
    monkeypatch.setattr(dispatch, "VERBS", dispatch.VERBS | {"opened"})
    assert opened(Own(), 2.0, scale=3.0) == opened(plant=Own(), x=2.0, scale=3.0) == 6.0
    with pytest.raises(ArgumentError, match="`plant` must be a Plant, got Other"):
        opened(Other(), 2.0)
    dispatch.register("opened", Other, lambda plant, *placed, **named: (plant.time_unit, placed, named))
    assert opened(Other(), 2, scale=3.0) == ("h", (2,), {"scale": 3.0})
    assert opened(plant=Other(), x=2.0) == ("h", (), {"x": 2.0})


def test_an_opened_verb_checks_the_arguments_of_every_kind(monkeypatch):
    dispatch._ask_rings()  # what they register stays
    monkeypatch.setattr(dispatch, "_OFFERED", dict(dispatch._OFFERED))
    monkeypatch.setattr(dispatch, "VERBS", dispatch.VERBS | {"opened"})
    dispatch.register("opened", Other, lambda plant, *placed, **named: None)
    for plant in (Own(), Other()):
        with pytest.raises(ArgumentError, match=r"`x` must be a number, got str 'text'"):
            opened(plant, "text")
    with pytest.raises(ArgumentError, match=r"`plant` must be (an|a) Own or a plant of another kind, got int 3"):
        opened(3, 1.0)
    for call in (lambda: opened(), lambda: opened(x=1.0)):
        with pytest.raises(CallError, match="`opened` needs `plant`"):
            call()
    with pytest.raises(CallError, match=r"`opened` has no argument `scal`"):
        opened(Own(), 1.0, scal=2.0)
    assert opened.__doc__ == "Return x in some unit."
    assert next(iter(inspect.signature(opened).parameters)) == "plant"


def with_a_plant():
    """Public functions and classes that take a plant and then something about it, by place; at most three needed."""
    for name, thing in front_door.public().items():
        door = thing.__init__ if inspect.isclass(thing) else thing
        if inspect.isfunction(door):
            given = [p for p in inspect.signature(door).parameters.values() if p.name != "self"]
            placed = [p.name for p in given if p.kind is p.POSITIONAL_OR_KEYWORD]
            if placed[:1] == ["plant"] and sum(p.default is p.empty for p in given) <= 3:
                yield from ((name, thing, placed[1:k]) for k in (2, 3) if placed[k - 1 : k] and placed[k - 1] in ABOUT)


ABOUT = {"schedule", "certificate", "family", "requirement", "record"}


@pytest.mark.parametrize("share", few(range(4), 0))
def test_arguments_in_each_others_place_are_named(share):
    """In every verb, whichever of the two the door stops at, and where a schedule stands for its certificate."""
    things, named, special = front_door.things(), front_door.named(), front_door.special()
    verbs = list(with_a_plant())
    assert {"certify", "robustness", "window_sigma", "estimate", "KalmanFilter"} <= {name for name, *_ in verbs}
    for name, thing, between in verbs[share::4]:
        valid = {**named, **special.get(name, {})}
        about, plant = between[-1], things["uncertain"] if name == "certify_inclusion" else valid["plant"]
        kinds = [valid[about] or things[about]] + [things["schedule"]] * (len(between) == 1 and about == "certificate")
        for kind in kinds:
            with pytest.raises(ArgumentError, match=rf"`plant` and `{about}` are exchanged: it is {name}\(plant, "):
                thing(kind, *(valid[other] for other in between[:-1]), plant)
        with pytest.raises((ArgumentError, CallError)) as other:
            thing(plant, *(valid[each] for each in between[:-1]), plant)
        assert "exchanged" not in str(other.value)


def test_no_argument_of_a_method_is_exchanged_with_its_object():
    with pytest.raises(ArgumentError, match=r"`other` must be a Measurements, got list \[1\.0\]\.$"):
        sd.Measurements(OSCILLATOR, [0.0], [[0.5]]).merged([1.0])


@pytest.mark.parametrize(
    ("verb", "came", "said"),
    [
        (
            sd.compare_schedule,
            ("plant", "certificate"),
            "got Certificate. Its `.schedule` is one",
        ),
        (sd.window_sigma, ("certificate", "schedule"), "`plant` must be .*, got Certificate. Its `.plant` is one"),
        (sd.MovingHorizonEstimator, ("plant", "robustness"), "got Robustness. Its `.certificate` is one"),
        (sd.MovingHorizonEstimator, ("plant", "design"), r"got ScheduleDesign. certify\(plant, schedule\) makes one"),
        (sd.design_schedule, ("plant", "design"), "got ScheduleDesign. Its `.requirement` is one"),
        (sd.next_sample, ("plant",), r"got Plant. plan_samples\(plant, requirement\) makes one"),
        (sd.Jitter, ("certificate",), "got Certificate. Its `.schedule` is one"),
        (sd.state_interval, ("plant", "record"), "got SimulatedRecord. Give its `.measurements`"),
    ],
)
def test_a_record_in_the_place_of_another_says_which_part_is_meant(verb, came, said):
    things = front_door.things()
    rest = {"window": 4.0, "timing_tolerance": 0.1, "w_bound": 0.1, "v_bound": 0.1, "times": [1.0]}
    taken = inspect.signature(verb).parameters
    with pytest.raises(ArgumentError, match=said):
        verb(*map(things.get, came), **{key: value for key, value in rest.items() if key in taken})
