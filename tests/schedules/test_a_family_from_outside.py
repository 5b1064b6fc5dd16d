"""Adding a family is adding a file: this one, which the package does not know, goes through every verb of families."""

import json
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import sampling_design as sd
from sampling_design import PeriodicSchedule, Plant, Schedule
from sampling_design.certificates.compare.robustness import RobustnessSearch
from sampling_design.certificates.families.graphs import graph_of
from sampling_design.checkers import check, cover, family_file, parts, strict
from sampling_design.cli.app import app
from sampling_design.errors import ArgumentError
from sampling_design.estimators.online.schedule_watch import ScheduleWatch
from sampling_design.records.budget import Budget
from sampling_design.records.checks import generator
from sampling_design.schedules.family import OUTWARD, START, FamilyStep, Leeway, SamplingFamily
from sampling_design.schedules.files import family_from_dict


@dataclass(frozen=True, eq=False, repr=False)
class DayAndNight(SamplingFamily, kind="day-and-night"):
    """Gaps that are in turn by day (short) and by night (long), each at most `slack` longer than planned."""

    day: float
    night: float
    slack: float
    time_unit: str | None = None

    @property
    def min_gap(self) -> float:
        return min(self.day, self.night)

    @property
    def d_max(self) -> float:
        return max(self.day, self.night) + self.slack

    @property
    def nominal(self) -> PeriodicSchedule:
        return PeriodicSchedule([self.day, self.night])

    def contains(self, schedule: Any) -> bool:
        gaps, slack = schedule.gaps, 1e-9 * self.d_max
        if isinstance(schedule, PeriodicSchedule) and len(gaps) % 2:
            return False
        least = np.tile([self.day, self.night], len(gaps) // 2 + 1)
        orders = (least[: len(gaps)], least[1 : len(gaps) + 1])
        return any(bool(np.all((low - slack <= gaps) & (gaps <= low + self.slack + slack))) for low in orders)

    def draw(self, rng: Any = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
        late = generator(rng).uniform(0.0, self.slack, 2 * (samples or 10))
        return Schedule.from_gaps(np.tile([self.day, self.night], late.size // 2) + late)

    def steps(self, memory: int, outputs: int) -> Any:
        planned = (self.day, self.night)

        def steps(word: Any) -> list[FamilyStep]:
            nexts = (0, 1) if word == START else (1 - word[0],)
            return [
                FamilyStep(
                    (j,),
                    0.0 if word == START else planned[j],
                    (planned[j] + self.slack) * (1 + OUTWARD),
                    (True,) * outputs,
                )
                for j in nexts
            ]

        return steps

    def to_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "day": self.day, "night": self.night, "slack": self.slack}

    def explain(self) -> str:
        return f"By day every {self.day}, by night every {self.night}, at most {self.slack} late."


@dataclass(frozen=True, eq=False, repr=False)
class Shifted(SamplingFamily, kind="shifted"):
    """A plan that a person keeps a little late, with one of any three samples missing: a leeway of its own."""

    schedule: PeriodicSchedule
    late: float

    @property
    def time_unit(self) -> str | None:
        return self.schedule.time_unit

    @property
    def min_gap(self) -> float:
        return float(self.schedule.gaps.min()) - self.late

    @property
    def d_max(self) -> float:
        return 2 * float(self.schedule.gaps.max()) + self.late

    @property
    def nominal(self) -> PeriodicSchedule:
        return self.schedule

    @property
    def leeway(self) -> Leeway:
        return Leeway(self.schedule, self.late, most=1, of=3)

    def contains(self, schedule: Any) -> bool:
        raise AssertionError("a leeway says all")

    def draw(self, rng: Any = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
        raise AssertionError("not asked for here")

    def steps(self, memory: int, outputs: int) -> Any:
        raise AssertionError("not asked for here")

    def to_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "schedule": self.schedule.to_dict(), "late": self.late}

    def explain(self) -> str:
        return f"At most {self.late} late, one of three missing."


@dataclass(frozen=True)
class Planned(family_file.Family):
    """What an auditor reads of it."""

    gaps: tuple[float, float]
    slack: float


def covers_day_and_night(family: Planned, graph: family_file.Graph) -> None:
    """Words are what came last: 0 after a day's gap, 1 after a night's."""
    for u, word in enumerate(graph.words):
        cover.need(not u or word in ((0,), (1,)), u, "the word is neither day nor night")
        for j in (0, 1) if not u else (1 - int(word[0]),):
            gap, late = Fraction(family.gaps[j]), Fraction(family.slack)
            parts = [(Fraction(e.low), Fraction(e.high)) for e in graph.leaving(u) if graph.words[e.target] == (j,)]
            cover.need(all(all(e.outputs) for e in graph.leaving(u)), u, "an edge measures too little")
            cover.need(cover.covers(parts, gap if u else Fraction(0), gap + late), u, f"gap {j}")


READ = strict.table({"kind": strict.text, **dict.fromkeys(("day", "night", "slack"), strict.positive)})
family_file.FAMILIES["day-and-night"] = READ, lambda d, plant: Planned((d["day"], d["night"]), d["slack"])
cover.COVERED[Planned] = covers_day_and_night


OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def test_it_comes_back_from_its_file():
    family = DayAndNight(1.0, 2.0, 0.1)
    again = family_from_dict(family.to_dict())
    assert isinstance(again, DayAndNight)
    assert again.to_dict() == family.to_dict()
    assert repr(again) == "DayAndNight(members=By day every 1.0, by night every 2.0, at most 0.1 late.)"
    with pytest.raises(ArgumentError, match="a family of kind 'day-and-night' needs `night`"):
        family_from_dict({"kind": "day-and-night", "day": 1.0})


def test_its_graph_is_walked():
    graph = graph_of(DayAndNight(1.0, 2.0, 0.1), 0, 1)
    assert graph.words == ((), (0,), (1,))
    assert [(e.source, e.target) for e in graph.edges] == [(0, 1), (0, 2), (1, 2), (2, 1)]
    assert [e.low for e in graph.edges] == [0.0, 0.0, 2.0, 1.0]
    assert [e.high for e in graph.edges] == pytest.approx([1.1, 2.1, 2.1, 1.1], rel=1e-14)


def test_a_member_without_a_certificate_is_found():
    # a day and a night of half a turn each: the oscillator shows one combination of its states for ever
    found, _ = sd.certificates.find_counterexample(OSCILLATOR, DayAndNight(np.pi, np.pi, 0.2), 0.1)
    assert found is not None
    found, (margin, *_) = sd.certificates.find_counterexample(OSCILLATOR, DayAndNight(0.7, 1.6, 0.1), 0.1)
    assert found is None
    assert margin > 0


@pytest.fixture(scope="module")
def certificate():
    return sd.certify(OSCILLATOR, DayAndNight(0.7, 1.6, 0.1), eta=0.2, P2=np.eye(2))


@pytest.mark.parametrize(("table", "key"), [(family_file.FAMILIES, "day-and-night"), (cover.COVERED, Planned)])
def test_without_an_auditor_nothing_is_certified(monkeypatch, table, key):
    monkeypatch.delitem(table, key)
    with pytest.raises(ArgumentError, match="must be of a kind that an auditor reads, got 'day-and-night'"):
        sd.certify(OSCILLATOR, DayAndNight(0.7, 1.6, 0.1), eta=0.2)


def test_it_is_certified_and_its_graph_is_not_trusted(certificate):
    assert certificate.verify().passed
    assert certificate.verify(rigorous=True).passed
    data = json.loads(json.dumps(certificate.to_dict()))
    graph = data["graph"]
    graph["edges"] = [e for e in graph["edges"] if not e[0] or graph["words"][e[1]] != [1]]  # no night after a day
    data["digest"] = parts.digest(data)
    assert check(data)["verdict"] == "refuted"
    assert "gap 1" in check(data)["reason"]


def test_its_certificate_is_a_file_that_the_command_checks(certificate, tmp_path):
    path = certificate.save(tmp_path / "day_and_night.json")
    again = sd.read_certificate(path)
    assert again.family.to_dict() == certificate.family.to_dict()
    assert again.to_dict() == certificate.to_dict()
    told = CliRunner().invoke(app, ["verify", str(path)])
    assert told.exit_code == 0, told.output


def test_estimators_know_whether_samples_are_on_its_schedules(certificate):
    mhe = sd.MovingHorizonEstimator(OSCILLATOR, certificate)
    times = certificate.family.draw(samples=4).times
    assert all(mhe.update(t, [0.0]).on_schedule for t in times)
    assert not mhe.update(times[-1] + 1.2, [0.0]).on_schedule  # neither a day nor a night


def test_a_leeway_from_outside_is_what_samples_are_held_against():
    watch, one = ScheduleWatch(Shifted(PeriodicSchedule([1.0]), 0.1), "s"), np.ones(1)
    assert watch.sample_fits(np.array([3.0, 4.09, 6.05]), one, first=False)
    assert not watch.sample_fits(np.array([3.0, 4.2]), one, first=False)
    assert not watch.sample_fits(np.array([3.0, 5.0, 7.0]), one, first=False)


def test_it_has_pictures(certificate):
    for record in (certificate, certificate.family):
        axes = record.plot()
        assert axes.get_title(loc="left").endswith(certificate.family.explain())
        assert axes.lines or axes.collections


@pytest.mark.long
def test_a_planned_certificate_is_asked_whether_it_survives_on_it():
    plant = Plant([[0.1]], [[1.0]])
    planned = sd.certify(plant, PeriodicSchedule([0.7, 1.6]), eta=0.2, P2=np.eye(1))
    near, far = DayAndNight(0.7, 1.6, 0.05), DayAndNight(30.0, 30.0, 0.1)
    found = sd.robustness(plant, planned, longest=2, families=[near, far])
    assert [trial.survives for trial in found.others] == [True, False]
    assert found.others[0].certificate.verify().passed
    assert found.others[0].certificate.lam_proven < found.limit
    assert [entry["survives"] for entry in found.to_dict()["families"]] == [True, False]
    assert "day-and-night family" in found.explain()
    with pytest.raises(ArgumentError, match="`families` must hold families of schedules, got float 0"):
        sd.robustness(plant, planned, families=[0.1])


def test_no_planned_certificate_survives_where_the_nominal_member_is_blind():
    # half turns: the oscillator's schedule shows one combination of its states for ever
    planned = sd.certify(OSCILLATOR, PeriodicSchedule([0.7, 1.6]), eta=0.2, P2=np.eye(2))
    search = RobustnessSearch(planned, 1e9, Budget(), print)
    assert not search.tried(DayAndNight(np.pi, np.pi, 0.2)).survives


def test_a_kind_is_taken_once():
    with pytest.raises(ArgumentError, match="`kind` 'gap-range' is taken by GapRange"):

        class Again(SamplingFamily, kind="gap-range"):
            pass
