"""What `guaranteed_accuracy` returns: brackets of the least guaranteed error, verified without a solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from sampling_design.accuracy.between_samples import RowSearch
from sampling_design.accuracy.bounded_directions import GapProof
from sampling_design.accuracy.bounds import SignalBounds
from sampling_design.accuracy.deviation import StandardDeviation
from sampling_design.accuracy.projection import Projection, project_rows
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.accuracy.results_out import SAME
from sampling_design.accuracy.sampled_system import SampledSystem
from sampling_design.accuracy.search import GainSearch
from sampling_design.accuracy.timing import KEPT_ROOM, added, is_enough, keeps_times
from sampling_design.accuracy.undetectable import DetectablePart, modes_with
from sampling_design.accuracy.witness import KEPT, AccuracyWitness, attains
from sampling_design.errors import ArgumentError
from sampling_design.plants.functional import RequestedRows
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.record import (
    CurveRecord,
    Plain,
    PlainRecord,
    TableRecord,
    Variable,
    above,
    below,
    moment,
    short,
)
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule


@dataclass(frozen=True, eq=False)
class AccuracyProfile:
    """Both bounds over time: `upper` holds all along [edges[k], edges[k+1]], `lower` is attained at edges[k].

    Attributes
    ----------
    edges : (N+1,) array
        From the first sample of a period on, or from the start of a finite schedule [the plant's time unit].
    lower : (r, N) array
    upper : (r, N) array
        Infinite where the samples taken by then do not determine the row.
    samples : (m,) array
        Sample times.
    """

    edges: Array
    lower: Array
    upper: Array
    samples: Array

    def repeated(self, times: Array) -> AccuracyProfile:
        """The profile of one period over as many of them as `times` (sample times from the same first one on) fill."""
        count = times.size // self.samples.size
        starts = times[:: self.samples.size] - times[0]
        edges = np.append((self.edges[:-1] + starts[:, None]).ravel(), self.edges[-1] + starts[-1])
        return AccuracyProfile(
            freeze(edges), freeze(np.tile(self.lower, count)), freeze(np.tile(self.upper, count)), times
        )


def reopen(search: GainSearch, proof: Sequence[GapProof]) -> None:
    """Bound the directions of a search by what gains prove, as whoever verifies a record does: all evaluated at once.

    What a fit takes from directions for others may jump with the last digit of theirs, which hangs on what stands
    beside them: a record says what this evaluation proves, so that the next one proves the same.
    """
    for part in proof:
        found = search.evaluate(part.sample, part.directions, part.gains)
        search.directions[part.sample].hold(part.directions, found)  # all: one that adds nothing here may serve others


class ProvenRow(NamedTuple):
    """What gains prove of one row (N,) at nodes, (M,) on panels, and from when on it is known."""

    at_samples: Array
    panels: Array
    known_from: float


def panel_edges(question: AccuracyQuestion, system: SampledSystem | None, found: RowSearch | None) -> Array:
    """Where the panels of a profile begin and end: those of any row, or the gaps where no row is bounded."""
    if system is None or found is None:
        return np.append(question.nodes, question.end)
    grids = [question.time_of(system, j) + opened.d for j, opened in found.opened.items()]
    last = question.end if question.initial is not None else float(grids[0][0] + question.end - question.nodes[0])
    return np.concatenate([*(d[:-1] for d in grids), [last]])


def proven_row(question: AccuracyQuestion, system: SampledSystem, found: RowSearch) -> ProvenRow:
    """What gains prove of a row: at each node once all results of its sample are in, and along the panels."""
    edges = panel_edges(question, system, found)
    begins = np.array([question.time_of(system, j) + opened.d[0] for j, opened in found.opened.items()])
    comes = question.comes_after
    complete = question.nodes + np.where(np.isfinite(comes), comes, 0.0).max(axis=1, initial=0.0)
    period, first = question.end - question.nodes[0], begins[0]
    tiny = SAME * period
    if question.initial is None:
        complete = first + np.mod(complete - first + tiny, period) - tiny
    nodes = [each[0] for each in found.nodes.values()]
    at = np.searchsorted(begins, complete - tiny)
    at_samples = np.array([nodes[k] if k < len(nodes) else np.inf for k in at.tolist()])
    panels = np.concatenate(list(found.panels.values()))
    late = int(np.max(np.flatnonzero(np.isinf(panels)), initial=-1)) + 1
    if question.initial is None:
        known_from = -np.inf if np.isfinite(at_samples).any() or np.isfinite(panels).any() else np.inf
    else:
        known_from = float(edges[late]) if late < panels.size else np.inf
    return ProvenRow(at_samples, panels, known_from)


class AccuracyBracket(TableRecord, PlainRecord):
    """The least guaranteed error of each wanted row, bracketed: `lower` attained, `upper` guaranteed."""

    rows: RequestedRows
    lower: Array
    upper: Array
    closed: Mask

    _frame = "row:rows.names unit:rows.units lower upper closed"


@dataclass(frozen=True, eq=False, repr=False)
class Accuracy(AccuracyBracket, CurveRecord):
    """The least guaranteed error of each wanted row, bracketed, at the worst time of a schedule.

        lower <= sup over t of rho(c; t) <= upper

    Attributes
    ----------
    plant : Plant
    schedule : PeriodicSchedule or Schedule
    rows : RequestedRows
        Matrix, names and units of what is wanted.
    lower : (r,) array
        No estimator whatsoever guarantees less: attained by `witnesses`.
    upper : (r,) array
        Proven for all real times by gains: of an endless schedule whatever the error was in the distant past, of a
        finite one for all times at which the row is known at all.
    worst : (r,) array
        A time at which `lower` is attained; of an endless schedule not beyond its period.
    offset : (r,) array
        What the best estimate adds to its weighted data at that time since the bounds are not centred at 0; its
        error is then within `upper` on both sides.
    known_from : (r,) array
        From when on the row is known; minus infinity on an endless schedule, infinite if never.
    closed : (r,) bool array
        Whether the bracket met the tolerance asked for.
    at_samples : (r, N) array
        What gains prove at each sample, the sample included.
    profile : AccuracyProfile
    deviation : StandardDeviation or None
        The same rows for white noise, if its size was given.
    witnesses : tuple of AccuracyWitness
        In the coordinates of the known part where something is unknown; None for an infinite row.
    noise : (N, p) array or None
        Where samples may be early or late: noise of samples on time that stands for that in `upper`, beside `v_bound`.
    unknown : tuple of str
        Eigenvalues of the modes that no sample shows and that do not decay, or that the samples of a finite schedule do
        not determine: rows that they touch are infinite.
    """

    question: AccuracyQuestion
    rows: RequestedRows
    lower: Array
    upper: Array
    worst: Array
    offset: Array
    known_from: Array
    closed: Mask
    at_samples: Array
    profile: AccuracyProfile
    witnesses: tuple[AccuracyWitness | None, ...]
    unknown: tuple[str, ...]
    proof: tuple[GapProof, ...] = field(repr=False)
    """Over the shortest period that the question has (`AccuracyQuestion.primitive`)."""
    deviation: StandardDeviation | None = None
    noise: Array | None = None

    _plain = (
        "rows{names units matrix} time_unit:plant.time_unit schedule lower upper unknown worst offset known_from "
        "closed at_samples profile{edges lower upper} witnesses deviation? timing_tolerance? result_delay?"
    )

    @property
    def plant(self) -> Plant:
        """The plant."""
        return self.question.plant

    @property
    def schedule(self) -> Schedule | PeriodicSchedule:
        """The schedule."""
        return self.question.schedule

    @property
    def timing_tolerance(self) -> Plain:
        """How early or late each sample may be; None where samples come on time."""
        late = self.question.timing_tolerance
        return late.plain if late else None

    @property
    def result_delay(self) -> dict[str, float] | None:
        """How long after its sample a result comes at most, by output; None where all come at once."""
        delays = self.question.result_delay
        return None if delays is None else dict(zip(self.plant.outputs.names, delays.tolist(), strict=True))

    @property
    def bounds(self) -> SignalBounds:
        """Bounds on w and v; one row of v for each sample, and an empty one for a start that is no sample."""
        return self.question.bounds

    def projection(self, first: str, second: str, t: float | None = None, directions: int = 24) -> Projection:
        """Return the exact set of what data may leave possible of two rows at one time (`accuracy.projection`).

        Default time: the worst one of the first row.
        """
        question, place = self.question, self.rows.names.index(first) if first in self.rows.names else 0
        if t is None:
            t = float(self.worst[place])
            t += (question.end - question.nodes[0]) * (t < question.nodes[0] and question.initial is None)
        back = max([len(g) for part in self.proof for g in part.gains], default=8)
        deep = max([back, *(w.samples.size for w in self.witnesses if w is not None)])
        return project_rows(question, first, second, t, directions, back, deep)

    def verify(self, rigorous: bool = False) -> bool:
        """Whether both sides hold, at samples and over time too, recomputed from gains and witnesses without a solver.

        rigorous : bool
            In ball arithmetic (extra `rigorous`): True is then a theorem about the doubles of this record; False
            says that it was not decided, as for exact sensors or where nothing drives what attains it. For endless
            schedules that show every mode.

        Raises
        ------
        ArgumentError
            If a rigorous proof is asked of a finite schedule, or where a mode is unknown.
        """
        asked = self.question.primitive()
        known = asked.lasting()
        if rigorous:
            if self.question.is_late:
                raise ArgumentError("`rigorous` is for samples on time that are known at once: leave it out.")
            if self.question.initial is not None or self.unknown:
                raise ArgumentError(
                    "`rigorous` is for endless schedules that show every mode; what else is known is decided "
                    "numerically. Leave it out."
                )
            return known.is_whole and self._proven(asked)
        bounded = {k for k, row in enumerate(self.rows.matrix) if known.plant.n_states and not known.touches(row)}
        search = self._reopened(asked, known) if bounded else None
        if not self.question.fits_schedule() or (bounded and search is None):
            return False
        opened = {k: search.opened(self.rows.matrix[k] @ known.lift) for k in bounded if search is not None}
        mine = self._keeps_edges(asked, search, next(iter(opened.values()), None))
        return mine and all(self._holds(k, known, search, opened.get(k)) for k in range(len(self.rows)))

    def _proven(self, asked: AccuracyQuestion) -> bool:
        """Both sides in ball arithmetic."""
        from sampling_design.accuracy.rigorous import proven_above, proven_below

        system, _ = asked.filter_bounds(self.plant)
        below = all(
            bool(lower == 0) if witness is None else proven_below(witness, self.bounds, float(lower))
            for witness, lower in zip(self.witnesses, self.lower, strict=True)
        )
        return below and proven_above(system, self.rows.matrix, self.upper, self.proof)

    def _reopened(self, asked: AccuracyQuestion, known: DetectablePart) -> GainSearch | None:
        """The gains of the proof evaluated anew; None where they do not stand for all times that samples may have."""
        noise = None if self.noise is None else self.noise[: len(asked.nodes)]
        search = GainSearch(*asked.noisier(noise).filter_bounds(known.plant, known.moving))
        reopen(search, self.proof)
        enough = noise is not None and is_enough(noise, added(search, asked, known), KEPT_ROOM)
        return search if enough or not asked.timing_tolerance else None

    def _keeps_edges(self, asked: AccuracyQuestion, search: GainSearch | None, opened: RowSearch | None) -> bool:
        """Whether the profile, and what repeats itself beside it, stands where gains prove it."""
        edges = panel_edges(asked, None if search is None else search.system, opened)
        profile = AccuracyProfile(edges, self.lower, self.upper, asked.nodes[asked.samples])
        if asked is not self.question:
            profile = profile.repeated(self.question.nodes)
        pairs = ((profile.edges, self.profile.edges), (profile.samples, self.profile.samples))
        tiny = 4 * np.spacing(np.abs(edges).max())
        return all(a.shape == b.shape and bool(np.all(np.abs(a - b) <= tiny)) for a, b in pairs)

    def _worst_holds(self, k: int) -> bool:
        """Whether the worst time of a row is when its witness ends, which begins as its last sample may come."""
        asked, witness = self.question.primitive(), self.witnesses[k]
        if witness is None:
            return bool(self.worst[k] == asked.nodes[0])
        ends = asked.nodes[witness.last] + float(witness.edges[-1] - witness.samples[-1])
        late, length = asked.timing_tolerance, float(asked.end - asked.nodes[0])
        tiny = KEPT * length + 4 * np.spacing(np.abs(asked.nodes).max())
        after = float(self.worst[k]) - ends + float(late.back.min()) + tiny
        if asked.initial is None:
            after = np.mod(after, length)
        return bool(0 <= after <= late.back.min() + late.forward.min() + 2 * tiny)

    def _holds(self, k: int, known: DetectablePart, search: GainSearch | None, opened: RowSearch | None) -> bool:
        """Whether both sides of a row hold, over time too; of one that is not opened only what is known at rest is."""
        asked, profile = self.question.primitive(), self.profile
        rest = top = least = known.at_rest(self.rows.matrix[k])
        proven = ProvenRow(np.full(asked.nodes.size, rest), np.array([rest]), np.inf if rest else -np.inf)
        if search is not None and opened is not None:
            proven = proven_row(asked, search.system, opened)
            if any(np.isfinite(nodes).any() for nodes in opened.nodes.values()):
                top = search.top(opened)[0]
            if np.isfinite(proven.at_samples).any() or np.isfinite(proven.panels).any():
                least = 0.0
        count = len(self.schedule) // len(asked.schedule)
        panels = np.tile(proven.panels, count) if opened is not None else np.full(profile.edges.size - 1, rest)
        sides = (
            (np.array(top), self.upper[k]),
            (np.tile(proven.at_samples[asked.samples], count), self.at_samples[k]),
            (panels, profile.upper[k]),
            (profile.lower[k], profile.upper[k]),
        )
        upper = all(low.shape == high.shape and bool(np.all(low <= high * (1 + KEPT))) for low, high in sides)
        upper = upper and bool(proven.known_from <= self.known_from[k])
        return upper and self._worst_holds(k) and self._attained(k, known, least)

    def _attained(self, k: int, known: DetectablePart, rest: float) -> bool:
        """Whether the lower side of a row is what its witness, of this question, attains, or at rest."""
        witness, asked = self.witnesses[k], self.question.primitive()
        if witness is None:
            return bool(self.lower[k] <= rest)
        mine = np.array_equal(witness.row, self.rows.matrix[k] @ known.lift)
        if not (mine and known.plant.same_dynamics(witness.plant) and keeps_times(witness, self.question)):
            return False
        value, excess = attains(witness, asked.bounds, asked.initial, asked.gaps)
        return excess <= 1 + KEPT and value >= max(self.lower[k], witness.value * (1 - KEPT)) * (1 - KEPT)

    _answers = (
        "the least error that an estimator can guarantee along a schedule, at the worst time",
        "proven: `upper` by gains, `lower` by trajectories that no sample shows",
        "{_within}",
        "`.verify()`, `.verify(rigorous=True)`",
    )

    def _within(self) -> str:
        """How far apart both sides are."""
        known = np.isfinite(self.upper)
        if not known.any():
            return "no bound holds at all times" if known.size else "no row was asked for"
        low, up = self.lower[known], self.upper[known]
        width = float(np.max(np.divide(up, low, out=np.where(up > 0, np.inf, 1.0), where=low > 0))) - 1
        return f"brackets within {above(100 * width, 2)} %" if np.isfinite(width) else "0: nothing was attained"

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.plant.time_unit
        if self.schedule.endless:
            lines = [("samples per period", f"{len(self.schedule)} in {short(self.schedule.period)} {unit}")]
        else:
            span = f"from {moment(self.question.nodes[0])} to {moment(self.question.end)} {unit}"
            lines = [("samples", f"{len(self.schedule)}, {span}")]
        if late := self.question.timing_tolerance:
            lines.append(("samples come", late.describe(unit)))
        if self.result_delay:
            lines.append(("results come after", self._delays()))
        for k, label in enumerate(self.rows.labels()):
            text = f"{below(self.lower[k])} to {above(self.upper[k])}, worst at {moment(self.worst[k])} {unit}"
            if not np.isfinite(self.upper[k]):
                text = f"without bound: {self._why()}"
            elif np.isinf(self.known_from[k]) and self.question.initial is not None:
                text += ", at single times only"
            elif self.known_from[k] > self.question.nodes[0]:
                text += f", unknown before {moment(self.known_from[k])} {unit}"
            lines.append((label, text + ("" if self.closed[k] else " (not closed)")))
            if self.offset[k]:
                lines.append((f"offset of {label}", short(self.offset[k])))
        if self.notice:
            lines.append(("notice", self.notice))
        return lines + ([] if self.deviation is None else self.deviation._rows())

    def _delays(self) -> str:
        """How long after their samples results come, in words."""
        delays = self.result_delay or {}
        if len(set(delays.values())) == 1:
            return f"{short(next(iter(delays.values())))} {self.plant.time_unit}"
        return ", ".join(f"{short(delay)} {self.plant.time_unit} ({name})" for name, delay in delays.items())

    def _why(self) -> str:
        modes = modes_with(self.unknown)
        return (
            f"the samples do not determine {modes}" if self.question.initial is not None else f"no sample shows {modes}"
        )

    @property
    def notice(self) -> str:
        """Say where the program is degenerate: exact sensors leave what is possible without interior."""
        exact = np.any(self.bounds.v == 0, axis=0)
        names = [name for name, zero in zip(self.plant.outputs.names, exact, strict=True) if zero]
        if not names:
            return ""
        return (
            f"Samples of {', '.join(names)} count as exact (noise bound 0): what is possible has no interior there, so "
            "that the program is degenerate. Both bounds hold; that they meet is not guaranteed."
        )

    def explain(self) -> str:
        """Say what can be guaranteed."""
        known = np.isfinite(self.upper)
        ends = zip(self.rows.labels(), self.upper, self.lower, strict=True)
        parts = [f"{n} within {above(u, 4)} (none less than {below(low, 4)})" for n, u, low in ends if np.isfinite(u)]
        lost = [name for name, sure in zip(self.rows.names, known, strict=True) if not sure]
        text = f"No error bound of {', '.join(lost)} holds at all times: {self._why()}. " if lost else ""
        if not parts:
            return text.strip() or "No row was asked for."
        late = [k for k in np.flatnonzero(known) if self.known_from[k] > self.question.nodes[0]]
        when = "At all times"
        if any(np.isinf(self.known_from[k]) for k in late):
            when = "Where the samples determine them"
        elif late:
            when = f"From {moment(max(self.known_from[k] for k in late))} {self.plant.time_unit} on"
        if self.question.timing_tolerance:
            when += f", for samples {self.question.timing_tolerance.describe(self.plant.time_unit)}"
        if self.result_delay:
            when += f", with results {self._delays()} after their samples"
        return (
            f"{text}{when}, some estimator guarantees {', '.join(parts)}: {self._within()}."
            + (f" {self.notice}" if self.notice else "")
            + ("" if self.deviation is None else f" {self.deviation.explain()}")
        )

    def _variables(self) -> dict[str, Variable]:
        profile, time = self.profile, self.plant.time_unit
        return {
            "row": Variable(("row",), np.array(self.rows.names, dtype=str)),
            "unit": Variable(("row",), np.array(self.rows.units, dtype=str)),
            "start": Variable(("cell",), profile.edges[:-1], time),
            "end": Variable(("cell",), profile.edges[1:], time),
            "lower": Variable(("row", "cell"), profile.lower),
            "upper": Variable(("row", "cell"), profile.upper),
            "sample": Variable(("sample",), profile.samples, time),
            "worst": Variable(("row",), self.worst, time),
        }
