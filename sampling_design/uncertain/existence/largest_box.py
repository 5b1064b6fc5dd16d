"""The largest box of parameters that a schedule survives: every plant of it is seen, or has a certificate."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.numerics.branch_and_bound import LeastOverCells, within
from sampling_design.observability.alignment import align
from sampling_design.observability.windows.pieces import window_pieces
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import Budget
from sampling_design.records.record import Claim, PlainRecord, above, below, short
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import period_of
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule
from sampling_design.uncertain.box.branching import TOGETHER, bisected, judged_in_time
from sampling_design.uncertain.box.branching import descended as descended_sigma
from sampling_design.uncertain.box.model import BoxCells, BoxModel, at_parameters
from sampling_design.uncertain.existence.existence_over_box import FilteredErrors, descended, looked_at, margin_on
from sampling_design.uncertain.observability.window_sigma_over_box import WindowsOverBox
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

Judged = tuple[Mask, Mask, Array]
Search = tuple[Callable[[BoxCells], Judged], Callable[[BoxCells], Array | None]]
"""Which cells are proven, which fail at their centre, what each direction matters; a plant near a cell that fails."""
GAINED_TOGETHER = 32  # cells judged together by gains, those nearest to the nominal values
SAME = 1e-9
"""BoxCells below this share of the ranges are not halved further."""
LOOKS = 6  # rounds between two searches for a plant that fails


@dataclass(frozen=True, eq=False, repr=False)
class LargestBox(PlainRecord):
    """How much of its ranges about the nominal values a plant may take before a schedule fails some plant.

    Attributes
    ----------
    share : float
        Proven: with parameters within this share of their ranges, counted from the nominal values, every plant passes.
    refuted : float
        A plant at this share fails; infinity where none does.
    low, high : mapping
        Ends of the parameters of the proven box.
    worst : mapping or None
        The plant that fails.
    closed : bool
        Whether share >= (1 - rtol) refuted, or the whole box is proven.
    """

    share: float
    refuted: float
    low: Mapping[str, float]
    high: Mapping[str, float]
    worst: Mapping[str, float] | None
    closed: bool
    question: str
    cells: int
    plant: UncertainPlant

    _plain = "share refuted low high worst closed claim"
    _answers = (
        "the largest share of the ranges of parameters within which every plant passes",
        "{claim.evidence}",
        "share {share}{_refuted}",
        "the same question of the plant `.box`",
    )

    def _refuted(self) -> str:
        return f"; a plant at {short(self.refuted)} fails" if self.worst is not None else ", none in the ranges fails"

    @property
    def box(self) -> UncertainPlant:
        """The plant with the ranges that are proven, the same nominal values."""
        parts = [replace(each, low=self.low[each.name], high=self.high[each.name]) for each in self.plant.parameters]
        return UncertainPlant(self.plant.nominal, parts)

    @property
    def claim(self) -> Claim:
        """What is proven."""
        ranges = "; ".join(f"{k} in [{above(v)}, {below(self.high[k])}]" for k, v in self.low.items())
        return Claim(f"{self.question} for every plant with {ranges}", assumptions=("constant parameters",))

    def _rows(self) -> list[tuple[str, str]]:
        rows = [(name, f"{above(low)} to {below(self.high[name])}") for name, low in self.low.items()]
        failing = "none in the ranges" if self.worst is None else f"{at_parameters(self.worst)} ({short(self.refuted)})"
        return [*rows, ("a plant that fails", failing), ("cells", str(self.cells))]

    def explain(self) -> str:
        """Say how far the parameters may go."""
        ranges = ", ".join(f"{k} from {above(v)} to {below(self.high[k])}" for k, v in self.low.items())
        end = "." if self.worst is None else f"; it fails at {at_parameters(self.worst)}."
        return f"{self.question[0].upper()}{self.question[1:]} for every plant with {ranges}{end}"


@checked
def largest_box(
    plant: UncertainPlant,
    schedule: PeriodicSchedule | Schedule,
    *,
    window: float | None = None,
    at_least: float = 0.0,
    eta: float | None = None,
    rtol: float = 0.01,
    budget: float = 60.0,
) -> LargestBox:
    """Return the largest box of parameters, about the nominal values, of which a schedule sees every plant.

        max s : every plant with |theta_k - nominal_k| <= s (its range on that side) passes

    Parameters
    ----------
    plant : UncertainPlant
        Constant parameters in a box: as far as is looked.
    schedule : PeriodicSchedule or Schedule
    window : float, optional [time]
        Passing means sigma above `at_least` in every window of this length, as in `window_sigma`.
    at_least : float
    eta : float, optional [1/time]
        Passing means that a certificate with this rate exists, as in `certificate_exists`. Either this or `window`.
    rtol : float
        The search ends when share >= (1 - rtol) refuted.
    budget : float [seconds]

    Returns
    -------
    LargestBox

    Raises
    ------
    ArgumentError
        If neither or both of `window` and `eta` are given, or the plant has no box of constant parameters.

    Notes
    -----
    *Claim.* `share` is proven; at `refuted` a plant fails. *Method.* BoxCells of the box, those nearest to the nominal
    values first; no cell beyond a plant that fails is looked at. *Numerical aspects.* Cells are proven in doubles, with
    room for rounding (1e-8 of every norm), not in balls; for sigma, `window_sigma(found.box, ..., rigorous=True)` is.

    Examples
    --------
    >>> from sampling_design import PeriodicSchedule, Plant
    >>> from sampling_design.uncertain.plants.uncertain_plant import UncertainParameter
    >>> oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> stiffness = UncertainParameter("omega^2", 0.5, 2.0, A=[[0.0, 0.0], [-1.0, 0.0]], nominal=1.0)
    >>> found = largest_box(UncertainPlant(oscillator, [stiffness]), PeriodicSchedule([2.8]), eta=0.1)
    >>> round(found.high["omega^2"], 2), round((np.pi / 2.8) ** 2, 2)
    (1.26, 1.26)
    """
    if (window is None) == (eta is None):
        raise ArgumentError("`window` or `eta` must be given, one of them and not both.")
    aligned = align(plant.nominal, schedule)
    tolerance, clock = checks.positive("rtol", rtol), Budget(checks.positive("budget", budget))
    if window is not None:
        least, window = checks.nonnegative("at_least", at_least), checks.positive("window", window)
        model = BoxModel.of(plant, "largest_box", window)
        over_box = WindowsOverBox(model, window_pieces(aligned, window))
        question = f"sigma is above {short(least)} in every window of {short(window)} {plant.time_unit}"
        cells = over_box.cells()
        search, together = _by_sigma(over_box, least, clock), TOGETHER
        if over_box.too_few() is not None:
            return _found(model, 0.0, 0.0, model.start, False, question, 0)
    else:
        repeated = period_of(
            aligned, "`schedule` must be periodic with `eta`: on a finite one every plant has a certificate."
        )
        rate, model = checks.nonnegative("eta", eta), BoxModel.of(plant, "largest_box", repeated.period)
        question = f"a certificate with rate {short(rate)} exists"
        cells = BoxCells.whole(model.m)
        search, together = _by_gains(model, repeated, rate, clock), GAINED_TOGETHER
    return _searched(model, cells, search, together, tolerance, clock, question)


def _by_sigma(over_box: WindowsOverBox, floor: float, clock: Budget) -> Search:
    """Sigma of every window above a number."""

    def judge(cells: BoxCells) -> Judged:
        lower, centre, effect = judged_in_time(cells, over_box.judge, clock)
        lost, k = np.asarray(centre <= floor), int(np.argmin(centre))
        lost[k] |= over_box.unobservable(cells.u[k], float(cells.s[k]), int(cells.piece[k]))
        return lower > floor, lost, effect

    def failing(cell: BoxCells) -> Array | None:
        start = (np.inf, cell.u[0], float(cell.s[0]), int(cell.piece[0]))
        ends = (over_box.pieces.left, over_box.pieces.right)
        value, u, s, piece = descended_sigma(start, over_box.value, ends, clock)
        return u if value <= floor or over_box.unobservable(u, s, piece) else None

    return judge, failing


def _by_gains(model: BoxModel, schedule: PeriodicSchedule, eta: float, clock: Budget) -> Search:
    """Certificates that exist."""
    gaps, margin = FilteredErrors(model, schedule, eta, clock), margin_on(schedule, eta)

    def judge(cells: BoxCells) -> Judged:
        every = cells.each()
        proven = np.array([gaps.contract(cell) for cell in every])
        lost = [
            not (good or clock.over or margin(model.plant.at(model.values(cell.u[0])))[0])
            for good, cell in zip(proven.tolist(), every, strict=True)
        ]
        return proven, np.array(lost), np.concatenate([gaps.effect(cell) for cell in every])

    def failing(cell: BoxCells) -> Array | None:
        found = descended(model, margin, looked_at(model, margin, cell.u[0], None), clock)
        return None if found[1] else found[2]

    return judge, failing


def _level(model: BoxModel, u: Array) -> Array:
    """The share of the ranges, counted from the nominal values, at which each u lies."""
    start, off = model.start, u - model.start
    up, down = np.where(start < 1, 1 - start, 1.0), np.where(start > -1, 1 + start, 1.0)
    return np.asarray(np.max(np.where(off > 0, off / up, -off / down), axis=1, initial=0.0) + 0.0)


def _searched(
    model: BoxModel, cells: BoxCells, search_of: Search, together: int, rtol: float, clock: Budget, question: str
) -> LargestBox:
    """BoxCells from the nominal values outwards."""
    worst, rounds, (judge, failing) = model.start, 0, search_of

    def begin(cells: BoxCells) -> Array:
        return _level(model, np.clip(model.start, cells.u - cells.half, cells.u + cells.half))[:, None]

    def fails(u: Array) -> None:
        nonlocal worst
        if search.attain(_level(model, u[None])).size:
            worst = u

    def judged(near: BoxCells) -> tuple[Array, Array]:
        nonlocal rounds
        proven, lost, effect = judge(near)
        if rounds % LOOKS == LOOKS - 1 and not proven[0]:
            found = failing(near.take(np.array([0])))
            if found is not None:
                fails(found)
        rounds += 1
        for k in np.flatnonzero(lost):
            fails(near.u[k])
        return np.where(proven, np.inf, -np.inf)[:, None], effect

    def cut(cells: BoxCells, effect: Array) -> tuple[BoxCells, Index] | None:
        parts, parents = bisected(cells, effect)
        return None if model.m and parts.half.max(axis=1).min() < SAME else (parts, parents)

    search = LeastOverCells(cells, begin(cells), within(rtol), clock, together=together, begin=begin)
    closed = search.run(judged, cut) == "closed"
    share, failed = min(1.0, float(search.lower[0])), float(search.best[0])
    return _found(model, share, failed, worst, closed, question, search.judged)


def _found(
    model: BoxModel, share: float, failed: float, worst: Array, closed: bool, question: str, cells: int
) -> LargestBox:
    listed = model.plant.parameters
    moved = {model.plant.parameters[k].name for k in model.place.tolist()}
    share *= 1 - 1e-12  # ends of the box that are rounded outwards stay inside of what is proven
    part = {each.name: share if each.name in moved else 1.0 for each in listed}
    low = {p.name: p.nominal - part[p.name] * (p.nominal - p.low) for p in listed}
    high = {p.name: p.nominal + part[p.name] * (p.high - p.nominal) for p in listed}
    lost = model.values(worst) if np.isfinite(failed) else None
    return LargestBox(
        share=share, refuted=failed, low=low, high=high, worst=lost, closed=closed, question=question, cells=cells,
        plant=model.plant,
    )  # fmt: skip
