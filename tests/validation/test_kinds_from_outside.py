"""A plant kind, a schedule family and an estimator that the package does not know go through its verbs from outside.

Each is what `docs/contributing.md` shows: one class, and a line for each verb that it takes part in.
"""

import re
import sys
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design import Plant
from sampling_design.checkers import cover, family_file, strict
from sampling_design.errors import ArgumentError
from sampling_design.estimators.estimator_choice import estimate
from sampling_design.records import dispatch
from sampling_design.schedules.family import OUTWARD, FamilyStep, SamplingFamily
from tests.house.sources import PACKAGE

DOCS = Path(__file__).parents[2] / "docs"

# --- a kind of plant: what it is, and a verb at a time what is done about it ------------------------------------------


@dataclass(frozen=True)
class Pendulum:
    """Small swings of a pendulum whose angle is measured."""

    length: float
    time_unit: str = "s"

    @property
    def linear(self) -> Plant:
        return Plant([[0.0, 1.0], [-9.81 / self.length, -0.1]], [[1.0, 0.0]], G=[[0.0], [1.0]])


@pytest.fixture
def pendulum(monkeypatch):
    dispatch._ask_rings()  # what they register stays
    monkeypatch.setattr(dispatch, "_OFFERED", dict(dispatch._OFFERED))
    for verb in (sd.window_sigma, sd.certify, sd.validate, estimate):

        def of_pendulum(plant: Pendulum, *arguments: Any, _verb: Any = verb, **options: Any) -> Any:
            return _verb(plant.linear, *arguments, **options)

        dispatch.register(verb.__name__, Pendulum, of_pendulum)
    return Pendulum(1.0)


# --- a family of schedules: what belongs to it, what may come next; and what an auditor makes of its file -------------


@dataclass(frozen=True, eq=False, repr=False)
class EitherGap(SamplingFamily, kind="either-gap"):
    """Every gap is `low` or `high`, in any order."""

    low: float
    high: float
    time_unit: str | None = None
    min_gap = property(lambda self: self.low)
    d_max = property(lambda self: self.high)
    nominal = property(lambda self: sd.PeriodicSchedule([self.low, self.high]))

    def contains(self, schedule: Any) -> bool:
        return all(np.isclose(gap, [self.low, self.high], rtol=1e-9).any() for gap in schedule.gaps)

    def draw(self, rng: Any = None, *, duration: float | None = None, samples: int | None = None) -> sd.Schedule:
        return sd.Schedule.from_gaps(np.random.default_rng(rng).choice([self.low, self.high], samples or 10))

    def steps(self, memory: int, outputs: int) -> Any:
        def steps(word: Any) -> list[FamilyStep]:
            ends = [(0.0, self.high)] if word == ("start",) else [(gap, gap) for gap in (self.low, self.high)]
            return [FamilyStep((), low * (1 - OUTWARD), high * (1 + OUTWARD), (True,) * outputs) for low, high in ends]

        return steps

    def to_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "low": self.low, "high": self.high}

    def explain(self) -> str:
        return f"Gaps of {self.low} or {self.high}."


@dataclass(frozen=True)
class ReadEitherGap(family_file.Family):
    """What an auditor reads of it."""

    gaps: tuple[float, float]


def covers(family: ReadEitherGap, graph: family_file.Graph) -> None:
    """Every node allows both gaps; the first one any part of the longer."""
    for u, word in enumerate(graph.words):
        parts = [(Fraction(e.low), Fraction(e.high)) for e in graph.leaving(u)]
        ends = [(0.0, family.gaps[1])] if not u else [(gap, gap) for gap in family.gaps]
        for low, high in ends:
            cover.need(cover.covers(parts, Fraction(low), Fraction(high)), u, f"gap {high} after {word}")


READ = strict.table({"kind": strict.text, "low": strict.positive, "high": strict.positive})
family_file.FAMILIES["either-gap"] = (READ, lambda d, plant: ReadEitherGap((d["low"], d["high"])))
cover.COVERED[ReadEitherGap] = covers


# --- an estimator: three methods --------------------------------------------------------------------------------------


class Luenberger:
    """x' = Ax + Bu between samples, x += L (y - Cx) at one."""

    def __init__(self, plant: Plant, gain: Any) -> None:
        self.plant, self.gain = plant, np.asarray(gain)

    def start(self, prior: Any, prior_time: float = 0.0) -> None:
        self.t, self.x, self.u = prior_time, np.asarray(prior, dtype=float), np.zeros(self.plant.n_inputs)

    def update(self, t: float, y: Any, u: Any = None) -> Any:
        x = self.predict(t)
        if y is not None:  # None: only the input changes
            x = x + self.gain @ np.nan_to_num(y - self.plant.C @ x)  # NaN: this output is not measured
        self.t, self.x, self.u = t, x, self.u if u is None else np.asarray(u)
        return x

    def predict(self, t: float) -> Any:
        rate = np.column_stack([self.plant.A, self.plant.B @ self.u])
        rate = np.vstack([rate, np.zeros(len(self.x) + 1)])
        return (expm(rate * (t - self.t)) @ [*self.x, 1.0])[:-1]


GAIN = [[0.8], [0.5]]


# --- all three through the verbs --------------------------------------------------------------------------------------


def test_what_is_registered_is_asked_of_kinds_and_nothing_else():
    """Every function that is opened, and every verb that a reader or a picture asks with, is known before it loads."""
    sources = "\n".join(path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py"))
    opened = re.findall(r"@open_verb\(\w+\)\ndef (\w+)", sources)
    asked = re.findall(r"(?:offered|registered)\(\"(\w+)\", [a-z]", sources)
    assert sorted(dispatch.VERBS) == sorted({*opened, *asked})
    with pytest.raises(ArgumentError, match="one that is asked of kinds, got 'window_sgima'"):
        dispatch.register("window_sgima", Pendulum, "my_package.sigma:of_pendulum")


def test_every_verb_takes_all_three(pendulum):
    family, plant = EitherGap(0.3, 0.4), pendulum.linear
    schedule = sd.PeriodicSchedule([0.3, 0.4])
    assert sd.window_sigma(pendulum, schedule, 1.5).lower == sd.window_sigma(plant, schedule, 1.5).lower > 0
    certificate = sd.certify(pendulum, family, eta=0.1, P2=np.diag([10.0, 1.0]))
    assert certificate.verify(rigorous=True).passed
    assert certificate.family is family
    record = [(t, [np.cos(t)]) for t in family.draw(0, samples=40).times.tolist()]
    found = estimate(pendulum, record, Luenberger(plant, GAIN), prior=[1.0, 0.0])
    assert found.x.shape == (40, 2)
    assert np.isinf(found.radius).all()
    assert not found.certified.any()
    report = sd.validate(pendulum, schedule, estimator=Luenberger(plant, GAIN), runs=2, duration=24.0)
    assert report.passed
    assert [curve.name for curve in report.error_curves] == ["random", "resonant", "initial"]


def test_an_estimator_is_given_what_the_protocol_says_of_inputs_and_of_outputs_that_were_not_measured():
    plant = Plant([[0.0, 1.0], [-1.0, -0.4]], np.eye(2), B=[[0.0], [1.0]])
    schedule = sd.PeriodicSchedule([0.5, 0.4], outputs=[[True, False], [False, True]])
    inputs = [(0.0, [1.0]), (7.3, [-2.0])]
    made = sd.simulate_record(plant, schedule, 30.0, x0=[1.0, 2.0], inputs=inputs, w_bound=0.0, v_bound=0.0)
    came = list[Any]()

    class Listening(Luenberger):
        def update(self, t: float, y: Any, u: Any = None) -> Any:
            came.append((y, u))
            return super().update(t, y, u)

    found = estimate(plant, made.measurements, Listening(plant, 0.5 * np.eye(2)))
    assert len(came) == len(made.measurements)
    assert any(y is None for y, _ in came)
    assert all(y is None or (y.shape == (2,) and np.isnan(y).sum() == 1) for y, _ in came)
    assert all(u is None or u.shape == (1,) for _, u in came)
    assert found.x[-1] == pytest.approx(made.states[np.searchsorted(made.times, found.times[-1])], abs=1e-5)


def test_pages_show_this_very_observer():
    own = Path(__file__).read_text().partition("class Luenberger:")[2].partition("\nGAIN")[0]
    code = [line.strip().replace(": Any", "").replace("-> Any", "") for line in own.splitlines() if "(self" not in line]
    text = (DOCS / "own_estimator.md").read_text()
    assert [line for line in code if line and not line.startswith('"""') and line not in text] == []


def test_what_contributors_are_shown_runs_as_it_stands(monkeypatch, capsys):
    for home, name in ((dispatch, "_OFFERED"), (SamplingFamily, "KINDS")):
        monkeypatch.setattr(home, name, dict(getattr(home, name)))
    monkeypatch.setitem(sys.modules, "contributor", shown := ModuleType("contributor"))
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / "contributing.md").read_text(), re.DOTALL)
    assert len(blocks) == 3
    said = []
    for block in blocks:
        assert block.count("\n") < 60
        exec(compile(block, "contributing.md", "exec"), vars(shown))
        said.append(capsys.readouterr().out)
    assert "ValidationReport" in said[0]
    assert "WindowSigma" in said[1]
    assert re.search("passed +yes", said[2])


def test_an_estimator_that_lets_errors_grow_is_found_out(pendulum):
    fed_backwards = Luenberger(pendulum.linear, [[-0.5], [0.0]])
    report = sd.validate(pendulum, sd.PeriodicSchedule([0.3]), estimator=fed_backwards, runs=1, duration=20.0)
    assert {finding.scenario for finding in report.broken} == {"resonant", "initial"}


def test_a_radius_that_does_not_hold_is_found_out(pendulum):
    class Boasting(Luenberger):
        def update(self, t: float, y: Any, u: Any = None) -> Any:
            return sd.estimators.Estimate(t, super().update(t, y, u), np.eye(2), 1e-6, certified=True)

    boasting = Boasting(pendulum.linear, GAIN)
    report = sd.validate(pendulum, sd.PeriodicSchedule([0.3]), estimator=boasting, runs=1, scenarios=["random"])
    assert [finding.claim for finding in report.broken] == ["online ellipsoid"]


class Changing(Luenberger):
    """One that keeps its state where it was handed to it, and hands that out."""

    def start(self, prior: Any, prior_time: float = 0.0) -> None:
        super().start(prior, prior_time)
        self.kept = self.x = np.asarray(prior)

    def update(self, t: float, y: Any, u: Any = None) -> Any:
        self.kept[:] = super().update(t, y, u)
        self.x = self.kept
        return self.kept


def test_an_estimator_that_changes_its_state_in_place_is_the_same_estimator(pendulum):
    plant, schedule = pendulum.linear, sd.PeriodicSchedule([0.3, 0.4])
    record = [(t, [np.cos(t)]) for t in schedule.between(0.0, 5.0).times.tolist()]
    own, other = Luenberger(plant, GAIN), Changing(plant, GAIN)
    assert np.array_equal(*(estimate(pendulum, record, each, prior=[1.0, 0.0]).x for each in (own, other)))
    reports = [sd.validate(pendulum, schedule, estimator=each, runs=2, duration=3.0) for each in (own, other)]
    for one, same in zip(*(report.error_curves for report in reports), strict=True):
        assert np.array_equal(one.largest, same.largest)
    assert not reports[0].passed  # runs too short to judge anything
    assert reports[0].explain().startswith("No promise was judged. pairs: it needs a certificate's estimator.")


def answers(**entries: Any) -> Any:
    """An `update` that returns an estimate with these entries of its own."""

    def update(self: Any, t: float, y: Any, u: Any = None) -> Any:
        x = Luenberger.update(self, t, y, u)
        whole = {"t": t, "x": x, "covariance": np.eye(2), "radius": 100.0, "certified": True}
        return sd.estimators.Estimate(**(whole | entries))

    return update


@pytest.mark.parametrize(
    ("update", "words"),
    [
        (lambda self, t, y, u=None: {}["gain"], "must answer without an error, got of Broken KeyError: 'gain'"),
        (lambda self, t, y, u=None: 1 / 0, "must answer without an error, got of Broken ZeroDivisionError"),
        (lambda self, t, y, u=None: np.full(2, np.nan), r"`estimate` must be finite, got estimate\[0\] = nan"),
        (answers(x=np.zeros(3)), r"`estimate\.x` must be an array of shape \(2,\), got \(3,\)"),
        (answers(x=[0.0, 0.0]), r"`estimate\.x` must be an array of shape \(2,\), got list"),
        (answers(covariance=np.eye(1)), r"`estimate\.covariance` must be an array of shape \(2, 2\), got \(1, 1\)"),
        (answers(covariance=np.array([[1.0, 50.0], [0.0, 1.0]])), r"`estimate\.covariance` must be symmetric"),
        (answers(t=0.1), "must be of the time that was asked for, .*, got t = 0.1"),
        (answers(certified="yes"), r"`estimate\.certified` must be true or false, got str 'yes'"),
    ],
)
def test_an_estimator_that_answers_nonsense_is_refused_in_a_sentence(pendulum, update, words):
    broken = type("Broken", (Luenberger,), {"update": update})(pendulum.linear, GAIN)
    with pytest.raises(ArgumentError, match=words):
        sd.validate(pendulum, sd.PeriodicSchedule([0.3]), estimator=broken, runs=1, duration=1.0, scenarios=["random"])
    with pytest.raises(ArgumentError, match=words):
        estimate(pendulum, [(0.3, [1.0])], broken)


@pytest.mark.parametrize(
    ("entries", "verdicts"),
    [
        ({"radius": np.inf}, []),
        ({"radius": np.nan}, ["NOT CHECKED"]),
        ({"radius": -1.0}, ["BROKEN"]),
        ({"radius": 0.0}, ["BROKEN"]),
        ({"x": np.array([np.nan, 0.0])}, ["NOT CHECKED"]),
        ({"x": np.array([np.inf, 0.0])}, ["BROKEN"]),
        ({"covariance": np.zeros((2, 2))}, ["BROKEN"]),
        ({"covariance": -np.eye(2)}, ["BROKEN"]),
        ({"covariance": np.full((2, 2), np.nan)}, ["NOT CHECKED"]),
        ({}, ["held"]),
    ],
)
def test_an_ellipsoid_that_says_nothing_is_never_counted_as_one_that_held(pendulum, entries, verdicts):
    said = type("Said", (Luenberger,), {"update": answers(**entries)})(pendulum.linear, GAIN)
    options = {"runs": 1, "duration": 1.0, "scenarios": ["random"]}
    report = sd.validate(pendulum, sd.PeriodicSchedule([0.3]), estimator=said, **options)
    assert [finding.verdict for finding in report.checks] == verdicts


def test_the_estimators_of_the_package_are_validated_by_their_methods_alone(pendulum):
    bounds = {"w_bound": 0.1, "v_bound": 0.05, "initial_error": 0.5}
    kalman = sd.KalmanFilter(pendulum.linear, **bounds)
    options = {"runs": 3, "duration": 15.0, "scenarios": ["random", "initial", "paper"]}
    report = sd.validate(pendulum, sd.PeriodicSchedule([0.3, 0.4]), estimator=kalman, **options, **bounds)
    assert report.passed
    assert {finding.claim for finding in report.checks} == {"online ellipsoid", "error does not grow"}
    assert report.skipped == ("paper: it needs a certificate's estimator.",)


def test_what_does_not_go_together_is_refused(pendulum):
    schedule, observer = sd.PeriodicSchedule([0.3]), Luenberger(pendulum.linear, GAIN)
    with pytest.raises(ArgumentError, match="`horizon` must be left out where an `estimator` is given"):
        sd.validate(pendulum, schedule, estimator=observer, horizon=3.0)
    with pytest.raises(ArgumentError, match="`estimator` must be an Estimator, got float"):
        sd.validate(pendulum, schedule, estimator=3.0)
    with pytest.raises(ArgumentError, match=r"must be an Estimator, got Half\. It has no `start` and no `predict`\."):
        sd.validate(pendulum, schedule, estimator=type("Half", (), {"update": Luenberger.update})())
    with pytest.raises(ArgumentError, match=r"an Estimator, got Short\. Its `update` does not take \(t, y, u\)\."):
        estimate(pendulum, [], type("Short", (Luenberger,), {"update": lambda self, t, y: y})(pendulum.linear, GAIN))
    with pytest.raises(ArgumentError, match="`estimate` must have 2 entries"):
        estimate(
            pendulum, [(0.0, [1.0])], type("Short", (Luenberger,), {"update": lambda *_: [1.0]})(pendulum.linear, GAIN)
        )
    with pytest.raises(ArgumentError, match="`plant` must be a Plant, got Pendulum"):
        sd.zero_count_bound(pendulum, 2.0)
