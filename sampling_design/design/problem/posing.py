"""A requirement met with a plant: defaults filled in, units converted, numbers posed and checked."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sampling_design.design.problem.feasible import check_feasible
from sampling_design.design.problem.numbers import SLACK, DesignProblem
from sampling_design.design.problem.requirement import Requirement
from sampling_design.errors import ArgumentError, InfeasibleRequirementError
from sampling_design.observability.count.default_window import default_window
from sampling_design.observability.count.functional import part_for
from sampling_design.observability.count.zero_count import ZeroCountBound, zero_count_bound
from sampling_design.plants.functional import split_needed, weighed_over
from sampling_design.plants.modes import ModalSplit
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import short
from sampling_design.records.signatures import checked
from sampling_design.records.units import time_factor
from sampling_design.schedules.jitter import TimingTolerance

MOST_DEFAULT_SAMPLES = 24
"""Samples of a period that are taken unasked, at most: more take minutes."""
TIMES = ("window", "period", "spacing")
"""What a requirement says in its unit of time, beside what is within the period."""


class ResolvedRequirement(NamedTuple):
    """A requirement without gaps, the defaults that were used, with reasons, and the zero count if they took it."""

    requirement: Requirement
    used: dict[str, Any]
    zero_count: ZeroCountBound | None


def split_for(plant: Plant, requirement: Requirement) -> ModalSplit:
    """Split what is designed for: the plant, or what the rows asked for need, weighed over the window."""
    rate = requirement.decay_rate / time_factor(requirement.time_unit or plant.time_unit, plant.time_unit)
    split = split_needed(part_for(plant, requirement.of, decay_rate=rate), rate)
    if requirement.of is None or not split.retained.n_states:
        return split
    return weighed_over(split, float(resolve(split, requirement).requirement.window or 0))


@checked
def resolve(split: ModalSplit, requirement: Requirement) -> ResolvedRequirement:
    """Fill in the defaults, in the plant's time unit; return them with what they rest on."""
    r = in_unit(requirement, split.plant.time_unit)
    used: dict[str, Any] = {}
    retained, count = split.retained, None
    if r.window is None:
        r = r.replace(window=default_window(split) or r.period or 1.0)
        used["window"] = r.window
    if r.period is None:
        r = r.replace(period=r.window)
        used["period"] = r.period
    if not r.samples:
        held = _held(r)
        count = zero_count_bound(retained, held)
        needed = count.samples
        per_period = max(1, int(np.ceil(needed * _known(r.period) / held - SLACK)))
        kind = "exactly" if r.target_sigma is None else "at_most"
        most = min(per_period, MOST_DEFAULT_SAMPLES) if r.target_sigma is None else MOST_DEFAULT_SAMPLES
        r = r.replace(samples={kind: max(most, r.fixed.size)})
        used["samples"] = dict(r.samples)
        if r.target_sigma is None and per_period > MOST_DEFAULT_SAMPLES:
            used["notice"] = (
                f"The zero count asks for {per_period} samples per period; {MOST_DEFAULT_SAMPLES} are designed. "
                "Give `samples` to change this."
            )
    if r.spacing is None:
        r = r.replace(spacing=_known(r.window) / (4 * max(r.samples.values())))
        used["spacing"] = r.spacing
    r._check_within(_known(r.period))
    late = TimingTolerance.of(r.timing_tolerance, split.plant.outputs.names)
    if late and late.span >= _known(r.spacing):
        raise ArgumentError(
            f"`timing_tolerance`, early and late together, must be less than the least time between two samples, "
            f"{short(r.spacing)}, got {short(late.span)}: they could change places. Ask for a wider `spacing`."
        )
    return ResolvedRequirement(r, used, count)


def _held(requirement: Requirement) -> float:
    """The part of a window whose planned samples lie in it whatever their real times are."""
    window, late = _known(requirement.window), TimingTolerance.of(requirement.timing_tolerance)
    if not window > 2 * late.radius:
        raise ArgumentError(
            f"`window` must be longer than early and late together, {short(2 * late.radius)}, got {short(window)}: no "
            "sample is certain to lie in it."
        )
    return window - 2 * late.radius


def repeated(requirement: Requirement, periods: int) -> Requirement:
    """Return the same constraints on times, over `periods` periods as one; `requirement` is resolved."""
    period = _known(requirement.period)

    def tiled(spans: Array) -> Array:
        return np.asarray((spans[None] + period * np.arange(periods)[:, None, None]).reshape(-1, 2))

    outputs = {
        name: {"available": None if a.available is None else tiled(a.available), "cost": a.cost}
        for name, a in requirement.outputs.items()
    }
    fixed = (requirement.fixed + period * np.arange(periods)[:, None]).ravel()
    changes: dict[str, Any] = {
        "period": periods * period,
        "forbidden": tiled(requirement.forbidden),
        "fixed": fixed,
        "outputs": outputs,
    }
    if requirement.cost_limit is not None:
        changes["cost_limit"] = periods * requirement.cost_limit
    return requirement.replace(**changes)


def _known(value: float | None) -> float:
    """A number that was filled in before."""
    assert value is not None
    return value


def in_unit(requirement: Requirement, unit: str) -> Requirement:
    """Return the requirement with every time and rate in another unit."""
    if requirement.time_unit in (None, unit):
        return requirement.replace(time_unit=unit)
    c = time_factor(str(requirement.time_unit), unit)
    times = {k: v * c for k in TIMES if (v := getattr(requirement, k)) is not None}
    times["timing_tolerance"] = TimingTolerance.of(requirement.timing_tolerance).scaled(c).plain
    outputs = {
        name: {"available": None if a.available is None else a.available * c, "cost": a.cost}
        for name, a in requirement.outputs.items()
    }
    return requirement.replace(
        **times,
        forbidden=requirement.forbidden * c,
        fixed=requirement.fixed * c,
        decay_rate=requirement.decay_rate / c,
        outputs=outputs,
        time_unit=unit,
    )


def pose(plant: Plant, requirement: Requirement, samples: int, check: bool = True) -> DesignProblem:
    """Return the numbers of the design with `samples` per period; `requirement` is resolved.

    With samples that come up to a early or b late, no schedule has a larger sigma over windows of T than exact ones
    have over windows of T - a - b, of the state a before these begin, read (b - a)/2 after they are planned: of the
    plant (A, C e^{A(a + b)/2}). Those planned within a of a window's beginning or b of its end may be out of it, and
    all others in the middle. Of outputs with tolerances of their own each has its row, and the least a and b hold.
    Raises InfeasibleRequirementError if no schedule meets it; names the obstacle and the nearest one that works.
    """
    names = plant.outputs.names
    checks.known_keys("`outputs` of the requirement", requirement.outputs, names)
    access = [requirement.outputs.get(name) for name in names]
    prices = np.array([0.0 if a is None else a.cost for a in access])
    late = TimingTolerance.of(requirement.timing_tolerance, names)
    lost = min(late.early) + min(late.late)
    problem = DesignProblem(
        plant=_read_in_the_middle(plant, late) if late else plant,
        window=_held(requirement) + 2 * late.radius - lost,
        late=lost / 2,
        period=_known(requirement.period),
        spacing=_known(requirement.spacing),
        samples=samples,
        forbidden=requirement.forbidden,
        fixed=requirement.fixed,
        available=tuple(None if a is None else a.available for a in access),
        costs=prices,
        cost_limit=np.inf if requirement.cost_limit is None else requirement.cost_limit,
    )
    if check:
        try:
            check_feasible(problem)
        except InfeasibleRequirementError as error:
            raise InfeasibleRequirementError(
                str(error), error.obstacle, _as_asked(error.nearest, requirement, names)
            ) from None
    return problem


def _read_in_the_middle(plant: Plant, late: TimingTolerance) -> Plant:
    """The plant whose outputs show, when a sample is planned, what each shows in the middle of its own times.

    Of the state at a window's beginning, the least `early` before the first sample that it is sure of is planned.
    """
    after = np.broadcast_to((np.array(late.late) - late.early) / 2 + min(late.early), plant.n_outputs)
    return Plant(plant.A, np.einsum("pi,pij->pj", plant.C, plant.transition(after)))


def _as_asked(change: dict[str, Any], requirement: Requirement, names: tuple[str, ...]) -> dict[str, Any]:
    """A change of the problem as keyword arguments of the requirement."""
    result = {key: value.tolist() if isinstance(value, np.ndarray) else value for key, value in change.items()}
    spans = result.pop("available", None)
    if spans is not None:
        prices = {name: access.cost for name, access in requirement.outputs.items()}
        result["outputs"] = {
            name: {"available": None if span is None else span.tolist(), "cost": prices.get(name, 0.0)}
            for name, span in zip(names, spans, strict=True)
        }
    return result
