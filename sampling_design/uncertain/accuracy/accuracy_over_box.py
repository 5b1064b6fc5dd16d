"""The least error that an estimator can guarantee, for every plant of a box of constant parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from sampling_design.accuracy.accuracy import bracket_of_rows
from sampling_design.accuracy.accuracy_record import AccuracyBracket
from sampling_design.accuracy.bounds import Bound
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.numerics.branch_and_bound import LeastOverCells
from sampling_design.numerics.linalg import extrapolated
from sampling_design.observability.alignment import align
from sampling_design.plants.functional import RequestedRows, Wanted, requested_rows
from sampling_design.plants.plant import Plant, Signals, remade
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Index, Mask
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.record import Claim, above, below
from sampling_design.records.vector_bounds import vector_bound
from sampling_design.schedules.family import period_of
from sampling_design.schedules.jitter import TimingTolerance
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule
from sampling_design.uncertain.box.branching import BALL_ROOM, bisected
from sampling_design.uncertain.box.model import BoxCells, at_parameters, require_constant_box
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

Both = tuple[Array, Array]
OnePlant = Callable[[Plant, Array, Array, Array, int], Both]
"""Lower bounds of the first rows of one plant and upper ones of all: bounds on w and v, rows, and how many of them."""

SECONDS = 120.0
RTOL = 0.1
"""Default width of the brackets, relative."""
FINER = 0.4  # share of the tolerance that the bracket of each single plant may take
PART, SHORTEST = 0.4, 0.05
"""Share of the seconds left that one plant may take; and of all seconds, what it may take once they are spent."""
FIRST, ROOM, TURNS = 1.02, 1.02, 4
"""How much larger what the mismatch moves is taken than at the centre, then than where it may bound itself, and how
often: three times at least, whatever is left."""
MOST_CORNERS = 2  # parameters up to which the corners of the box are looked at first
RANK = 1e-13  # singular values below this share of the largest are rounding of a parameter's matrix
SMALLEST = 1e-6  # cells below this share of the box, along every parameter, are not halved further


@dataclass(frozen=True, eq=False, repr=False)
class AccuracyOverBox(AccuracyBracket):
    """The least guaranteed error of each wanted row at the worst time of a schedule, for the worst plant of a box.

    Attributes
    ----------
    lower : (r,) array
        Attained by the plant `worst[k]`: no estimator guarantees less for it, even one that knows its parameters.
    upper : (r,) array
        Proven: for every plant of the box an estimator that knows its parameters guarantees it, at all real times.
        Infinite where the budget ended before anything finite was proven of all plants.
    worst : tuple of mappings
        Values of the parameters, one for each row.
    closed : (r,) bool array
    cells : int
    """

    rows: RequestedRows
    lower: Array
    upper: Array
    worst: tuple[Mapping[str, float], ...]
    closed: Mask
    cells: int
    plant: UncertainPlant
    schedule: PeriodicSchedule

    _plain = "rows{names matrix} lower upper worst closed cells claim"

    @property
    def claim(self) -> Claim:
        """What `upper` claims."""
        return Claim(
            f"for every plant of the box some estimator guarantees {above(self.upper)}",
            "Theorem D for each plant of the box, the mismatch within a cell as a disturbance that bounds itself",
            ("constant parameters in their ranges, known to the estimator", "bounded disturbance and noise"),
        )

    _answers = (
        "the least error that an estimator can guarantee for every plant of a box, which it knows",
        "{claim.evidence}",
        "at most {upper}; for the worst plants no less than {lower}",
        "`guaranteed_accuracy` of the plants `.worst`",
    )

    def _rows(self) -> list[tuple[str, str]]:
        found = [
            (name, f"{below(low)} to {above(up)}, worst at {at_parameters(where)}")
            for name, low, up, where in zip(self.rows.labels(), self.lower, self.upper, self.worst, strict=True)
        ]
        return [*found, ("cells", str(self.cells))]

    def explain(self) -> str:
        """Say what can be guaranteed for every plant of the box."""
        ends = [*zip(self.rows.labels(), self.upper, strict=True)]
        parts = [f"{name} within {above(most, 4)}" for name, most in ends if np.isfinite(most)]
        open_still = [name for name, most in ends if np.isinf(most)]
        text = f"Whichever plant of the box it is, some estimator that knows it guarantees {', '.join(parts)}. "
        more = f"Of {', '.join(open_still)} nothing finite was proven in time for every plant of the box. "
        return (
            f"{text if parts else ''}{more if open_still else ''}"
            f"For the worst plants none guarantees less than {below(self.lower, 4)}."
        )


def accuracy_over_box(
    plant: UncertainPlant,
    schedule: Schedule | PeriodicSchedule,
    *,
    w_bound: Bound = None,
    v_bound: Bound = None,
    of: Wanted = None,
    rtol: float | None = None,
    budget: float | None = None,
    progress: Progress | None = None,
    **others: object,
) -> AccuracyOverBox:
    """Bracket the worst accuracy over a box: see `guaranteed_accuracy`.

    Within a cell about theta_0 the plant theta is that of theta_0 with the disturbance sum_k (theta_k - theta_0k) A_k x
    and the noise of C_k x beside. If |r'x| <= beta for the rows r of A_k and C_k implies |r'x| < beta for them under
    those disturbances and zero outputs, then the same implication bounds every wanted row (a small-gain argument: what
    gains prove is affine in beta with a nonnegative matrix, whose spectral radius is then below 1). Raises
    ArgumentError if the schedule is finite, or a bound is not one number for each entry; UndecidedError if some plant
    of the box could not be bounded, and none attains anything.
    """
    refuse_others("over a box of parameters", **others)
    aligned, rtol = align(plant.nominal, schedule), checks.positive("rtol", RTOL if rtol is None else rtol)
    require_constant_box(plant, "accuracy")
    schedule = period_of(aligned, "`schedule` must be periodic for accuracy over a box of parameters.")
    w = _entries("w_bound", w_bound, plant.nominal.disturbances.names)
    v = _entries("v_bound", v_bound, plant.nominal.outputs.names)
    rows = requested_rows(plant.nominal, of)
    given = Budget(SECONDS if budget is None else checks.positive("budget", budget))
    middle, whole = plant.low / 2 + plant.high / 2, plant.high / 2 - plant.low / 2
    worst = [middle] * len(rows)
    start = BoxCells(middle[None], whole[None], np.zeros(1), np.zeros(1), np.zeros(1, dtype=int))

    def one(member: Plant, w: Array, v: Array, rows: Array, opposed: int) -> Both:
        asked = AccuracyQuestion.of(member, schedule, w, v)
        left = Budget(given.seconds_left(SHORTEST * given.seconds, PART))
        return bracket_of_rows(asked, rows, FINER * rtol, left, opposed)

    def enough(bound: Array, best: Array) -> Mask:
        return np.asarray(-bound * (1 - rtol) <= -best)

    def attained(theta: Array, low: Array) -> None:
        for k in search.attain(-low).tolist():
            worst[k] = theta

    def judged(cell: BoxCells) -> tuple[Array, Array]:
        low, up = _cell(plant, cell.u[0], cell.half[0], (w, v), rows, one, given)
        attained(cell.u[0], low)
        for corner in _corners(plant) if not search.judged else ():
            if given.left < (1 - PART) * given.seconds:
                break  # the rest is for what is proven of all plants
            attained(corner, one(plant.at(corner), w, v, rows.matrix, len(rows))[0])
        return -up[None], cell.half * _weights(plant)

    def cut(cell: BoxCells, effect: Array) -> tuple[BoxCells, Index] | None:
        return None if np.all(cell.half <= SMALLEST * whole) else bisected(cell, np.append(effect, [[0.0]], axis=1))

    def look() -> bool:
        if progress is not None and search.judged:
            progress(min(1.0, given.spent / given.seconds), f"{search.judged} cells")
        return False

    search = LeastOverCells(start, np.full((1, len(rows)), -np.inf), enough, given)
    search.attain(np.zeros(len(rows)))
    status = search.run(judged, cut, look)
    lower, top, cells = -search.best, -search.lower, search.judged
    named = [each.name for each in plant.parameters]
    where = tuple(dict(zip(named, np.clip(each, plant.low, plant.high).tolist(), strict=True)) for each in worst)
    if np.any(np.isinf(top) & (lower == 0)):
        raise KeyboardInterrupt if status == "interrupted" else _unbounded(where[0])
    closed = top * (1 - BALL_ROOM * rtol) <= lower
    return AccuracyOverBox(rows, lower, top, where, closed, cells, plant, schedule)


def _unbounded(where: Mapping[str, float]) -> UndecidedError:
    return UndecidedError(
        f"undecided: some plant of the box near {at_parameters(where)} could not be bounded in time. Try a smaller box."
    )


def _corners(plant: UncertainPlant) -> list[Array]:
    """The corners of a small box: the worst plant is often one of them."""
    ends = [sorted({each.low, each.high}) for each in plant.parameters]
    if sum(len(each) > 1 for each in ends) > MOST_CORNERS:
        return []
    return [np.array(corner) for corner in product(*ends)]


def _cell(
    plant: UncertainPlant, theta: Array, half: Array, bounds: Both, rows: RequestedRows, one: OnePlant, given: Budget
) -> Both:
    """What the centre attains, and what holds for every plant of a cell; infinite where nothing is proven in time."""
    w, v = bounds
    centre = plant.at(np.clip(theta, plant.low, plant.high))
    into, driving = mismatch(plant, half)
    moved_outputs, driven = (moved(plant, half, key) for key in ("C", "G"))
    matrix = np.vstack([rows.matrix, *driving, *moved_outputs])
    low, up = one(centre, w, v, matrix, len(rows))
    count, moves = len(rows), sum(len(r) for r in driving)
    if not np.all(np.isfinite(up)):
        return low, np.full(count, np.inf)
    extra = np.hstack([centre.G, *into, *driven])
    wide = remade(centre, G=extra, disturbances=Signals([f"d{k}" for k in range(extra.shape[1])]))
    before, beta = np.zeros(len(up) - count), FIRST * up[count:]
    for turn in range(TURNS):
        noise = v + sum(
            (beta[moves + k * len(v) : moves + (k + 1) * len(v)] for k in range(len(moved_outputs))), np.zeros(len(v))
        )
        _, found = one(wide, np.concatenate([w, beta[:moves], *[w for _ in driven]]), noise, matrix, 0)
        if np.all(found[count:] < beta) or not len(beta):
            return low, found[:count]
        if not np.all(found[count:] < 2 * beta) or (turn > 1 and given.over):
            break  # what moves by twice as much as was taken grows faster than it
        before, beta = beta, ROOM * extrapolated(before, beta, found[count:])
    return low, np.full(count, np.inf)


def mismatch(plant: UncertainPlant, half: Array) -> tuple[list[Array], list[Array]]:
    """What half-widths of A add as columns (n, rank) times rows (rank, n)."""
    into, driving = [], []
    for A, size in zip(plant.moves("A"), half.tolist(), strict=True):
        if not A.any() or not size:
            continue
        x = plant.nominal.states.scales
        U, s, V = np.linalg.svd(size * A * x / x[:, None])
        rank = int(np.sum(s > RANK * s[0]))
        into.append(x[:, None] * U[:, :rank])
        driving.append(s[:rank, None] * V[:rank] / x)
    return into, driving


def moved(plant: UncertainPlant, half: Array, key: str) -> list[Array]:
    """What half-widths add to C or to G."""
    return [size * M for M, size in zip(plant.moves(key), half.tolist(), strict=True) if M.any() and size]


def _weights(plant: UncertainPlant) -> Array:
    """How much a parameter's unit moves, relative to the nominal matrices, or to what moves more where these are 0."""
    found = np.zeros(len(plant.parameters))
    for key in ("A", "C", "G"):
        sizes = np.array([np.linalg.norm(each) for each in plant.moves(key)])
        size = float(np.linalg.norm(getattr(plant.nominal, key))) or sizes.max(initial=0.0)
        found += sizes / size if size > 0 else 0.0
    return found


def _entries(name: str, value: Bound, names: tuple[str, ...]) -> Array:
    """A bound for each entry; one number only where there is one entry."""
    if value is None and not names:
        return np.zeros(0)
    if value is not None and not callable(value):
        found = vector_bound(name, value, names)
        if found.ndim:
            return found
    raise ArgumentError(
        f"`{name}` must be {len(names)} numbers that are not negative, one bound for each entry, for accuracy over a "
        f"box of parameters, got {checks.described(value)}."
    )


def refuse_others(where: str, **others: object) -> None:
    """Raise if something is given that has no meaning there.

    Raises
    ------
    ArgumentError
        The first of them that is not None, or that is a `timing_tolerance` other than 0.
    """
    for name, value in others.items():
        on_time = name == "timing_tolerance" and not TimingTolerance.of(value, unit="s")
        if value is not None and not on_time:
            raise ArgumentError(f"`{name}` must be left out for accuracy {where}.")
