"""Adding a family is adding a file: this one, which the package does not know, is read, drawn, graphed and searched."""

import json
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import PeriodicSchedule, Plant, Schedule
from sampling_design.certificates.families.graphs import graph_of
from sampling_design.checkers import check, cover, grammar, strict
from sampling_design.errors import ArgumentError
from sampling_design.schedules.family import OUTWARD, START, SamplingFamily, Step, generator
from sampling_design.schedules.family_files import family_from_dict


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
        gaps = schedule.gaps
        if len(gaps) % 2:
            return False
        least = np.tile([self.day, self.night], len(gaps) // 2)
        orders = (least, least[::-1])
        return any(bool(np.all((low <= gaps) & (gaps <= low + self.slack))) for low in orders)

    def draw(self, rng: Any = None, *, duration: float | None = None, samples: int | None = None) -> Schedule:
        late = generator(rng).uniform(0.0, self.slack, 2 * (samples or 10))
        return Schedule.from_gaps(np.tile([self.day, self.night], late.size // 2) + late)

    def steps(self, memory: int, outputs: int) -> Any:
        planned = (self.day, self.night)

        def steps(word: Any) -> list[Step]:
            nexts = (0, 1) if word == START else (1 - word[0],)
            return [
                Step(
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


@dataclass(frozen=True)
class Planned(grammar.Family):
    """What an auditor reads of it."""

    gaps: tuple[float, float]
    slack: float


def covers_day_and_night(family: Planned, graph: grammar.Graph) -> None:
    """Words are what came last: 0 after a day's gap, 1 after a night's."""
    for u, word in enumerate(graph.words):
        cover.need(not u or word in ((0,), (1,)), u, "the word is neither day nor night")
        for j in (0, 1) if not u else (1 - int(word[0]),):
            gap, late = Fraction(family.gaps[j]), Fraction(family.slack)
            parts = [(Fraction(e.low), Fraction(e.high)) for e in graph.leaving(u) if graph.words[e.target] == (j,)]
            cover.need(all(all(e.outputs) for e in graph.leaving(u)), u, "an edge measures too little")
            cover.need(cover.covers(parts, gap if u else Fraction(0), gap + late), u, f"gap {j}")


READ = strict.table({"kind": strict.text, **dict.fromkeys(("day", "night", "slack"), strict.positive)})
grammar.FAMILIES["day-and-night"] = grammar.Kind(READ, lambda d, plant: Planned((d["day"], d["night"]), d["slack"]))
cover.COVERED[Planned] = covers_day_and_night


OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def test_it_comes_back_from_its_file():
    family = DayAndNight(1.0, 2.0, 0.1)
    again = family_from_dict(family.to_dict())
    assert isinstance(again, DayAndNight)
    assert again.to_dict() == family.to_dict()
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
    found, _ = sd.find_counterexample(OSCILLATOR, DayAndNight(np.pi, np.pi, 0.2), 0.1)
    assert found is not None
    found, (margin, *_) = sd.find_counterexample(OSCILLATOR, DayAndNight(0.7, 1.6, 0.1), 0.1)
    assert found is None
    assert margin > 0


def test_it_is_certified_and_its_graph_is_not_trusted():
    certificate = sd.certify(OSCILLATOR, DayAndNight(0.7, 1.6, 0.1), eta=0.2, P2=np.eye(2))
    assert certificate.verify().passed
    data = json.loads(json.dumps(certificate.to_dict()))
    graph = data["graph"]
    graph["edges"] = [e for e in graph["edges"] if not e[0] or graph["words"][e[1]] != [1]]  # no night after a day
    data["digest"] = grammar.digest(data)
    assert check(data)["verdict"] == "refuted"
    assert "gap 1" in check(data)["reason"]


def test_a_kind_is_taken_once():
    with pytest.raises(ArgumentError, match="`kind` 'gap-range' is taken by GapRange"):

        class Again(SamplingFamily, kind="gap-range"):
            pass
