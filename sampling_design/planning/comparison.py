"""Two plans side by side: what each costs, keeps and bears."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from sampling_design.errors import ArgumentError
from sampling_design.planning.figures import LOST, PlanFigures
from sampling_design.planning.problem import RowGoal
from sampling_design.records.declarations import Column, above, below, selected
from sampling_design.records.record import ListRecord, Plain, short
from sampling_design.records.units import spoken, time_factor


@dataclass(frozen=True, eq=False, repr=False)
class PlanComparison(ListRecord[tuple[str, tuple[str, str]]]):
    """Two plans for the same plant, side by side.

    Attributes
    ----------
    first, second : Plan
    names : (str, str)
    """

    first: PlanFigures
    second: PlanFigures
    names: tuple[str, str] = ("first", "second")

    def _entries(self) -> list[tuple[str, tuple[str, str]]]:
        return self.lines()

    def _columns(self) -> dict[str, Column]:
        labels, said = zip(*self.lines(), strict=True)
        return {"": labels, **dict(zip(self.names, zip(*said, strict=True), strict=True))}

    def __post_init__(self) -> None:
        if not self.shared() or self.first.plant.states.names != self.second.plant.states.names:
            raise ArgumentError(
                "`other` must be a plan for the same states with at least one goal in common, got goals "
                f"{', '.join(g.name for g in self.first.goals)} and {', '.join(g.name for g in self.second.goals)}."
            )

    @property
    def plans(self) -> tuple[PlanFigures, PlanFigures]:
        """Both."""
        return self.first, self.second

    def shared(self) -> list[RowGoal]:
        """Goals of the first plan that the second has by the same name."""
        names = {goal.name for goal in self.second.goals}
        return [goal for goal in self.first.goals if goal.name in names]

    def reached(self, name: str) -> tuple[float, float]:
        """What each plan reaches for a goal of both, in its unit."""
        return _reached(self.first)[name], _reached(self.second)[name]

    def a_day(self, plan: PlanFigures, value: float) -> float:
        """An amount per period as one per day, so that periods may differ."""
        return value / (plan.schedule.period * time_factor(plan.plant.time_unit, "d"))

    def lines(self) -> list[tuple[str, tuple[str, str]]]:
        """Label and what each plan says of it."""

        def both(label: str, say: Callable[[PlanFigures], str]) -> tuple[str, tuple[str, str]]:
            return label, (say(self.first), say(self.second))

        unit = self.first.plant.time_unit
        rows = [
            both("samples", lambda p: f"{p.samples} in {spoken(p.schedule.period, p.plant.time_unit)}"),
            both("cost of a period", lambda p: short(p.cost)),
        ]
        if self.first.schedule.period != self.second.schedule.period:
            rows.append(both("cost of a day", lambda p: short(self.a_day(p, p.cost))))
        rows.append(both("no plan for less than", lambda p: "-" if p.bound.cost is None else below(p.bound.cost.value)))
        for goal in self.shared():
            mark = f" {goal.unit}" if goal.unit else ""
            first, second = (f"{above(value, 4)}{mark}" for value in self.reached(goal.name))
            rows.append((goal.name, (first, second)))
        rows.append(both("of the tolerances", lambda p: above(p.ratio, 4)))
        rows.append(both("could gain at most", lambda p: f"{above(100 * p.gap, 2)} %"))
        if any(p.robustness is not None or "robustness" in p.left_out for p in self.plans):
            rows += [
                both("one sample late by", lambda p: _bears(p, "late", unit)),
                both("samples that may be lost", lambda p: _bears(p, "lost", unit)),
            ]
        rows.append(both("rate of the certificate", _rate))
        return rows

    _answers = (
        "two plans for one plant: {names}",
        "proven: what each plan keeps, and what none beats",
        "{first.ratio:4up} and {second.ratio:4up} of the tolerances",
        "`.first.verify()`, `.second.verify()`",
    )

    def _rows(self) -> list[tuple[str, str]]:
        return [("", " | ".join(self.names)), *((label, " | ".join(said)) for label, said in self.lines())]

    def explain(self) -> str:
        """Say which plan costs less and which knows more."""
        costs = [self.a_day(p, p.cost) for p in self.plans]
        share = min(costs) / max(costs) if max(costs) > 0 else 1.0
        alike = share > 1 - 1e-9
        less = self.names[0] if costs[0] < costs[1] else self.names[1]
        text = "Both cost the same" if alike else f"{less} costs {short(100 * (1 - share), 3)} % less"
        parts = []
        for goal in self.shared():
            first, second = self.reached(goal.name)
            better = self.names[0] if first < second else self.names[1]
            closer = 1 - min(first, second) / max(first, second)
            parts.append(f"{goal.name} by {better} ({short(100 * closer, 2)} % closer)")
        return f"{text}; known better: {', '.join(parts)}."

    def to_dict(self) -> dict[str, Plain]:
        """Plain data."""
        said = "samples period:schedule.period cost reached ratio gap robustness"
        both = zip(self.names, self.plans, strict=True)
        return {name: selected(p, said) | {"reached": _reached(p)} for name, p in both}


def _reached(plan: PlanFigures) -> dict[str, float]:
    """What a plan reaches for each goal, in its unit."""
    return {goal.name: float(reached) for goal, reached in zip(plan.goals, plan.reached, strict=True)}


def _bears(plan: PlanFigures, what: str, unit: str) -> str:
    if plan.robustness is None:
        return "left out" if "robustness" in plan.left_out else "-"
    if what == "lost":
        return LOST[plan.robustness.lost]
    return spoken(plan.robustness.least_late, unit)


def _rate(plan: PlanFigures) -> str:
    if plan.certificate is None:
        return "left out" if "certificate" in plan.left_out else "-"
    return f"{below(plan.certificate.eta)} 1/{plan.plant.time_unit}"
