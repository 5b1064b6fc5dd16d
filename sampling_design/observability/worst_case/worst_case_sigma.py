"""Worst case of sigma over all schedules with k spaced samples in a window (Theorem 17), bracketed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.observability import sigma_bracket
from sampling_design.observability.count.functional import part_for
from sampling_design.observability.sigma_bracket import SigmaBracket, SigmaDeviations
from sampling_design.observability.windows.bracket import require_moderate
from sampling_design.observability.windows.sampled import observability_matrix
from sampling_design.observability.windows.timing import least_observed
from sampling_design.observability.windows.window_record import MOST_WIDER
from sampling_design.observability.worst_case import spaced_search
from sampling_design.observability.worst_case.spaced_rows import SpacedRows, within_periods
from sampling_design.observability.worst_case.spaced_search import AttainedSchedule
from sampling_design.observability.worst_case.spaced_sphere import MOST_STATES, SphereBounds, prove_worst
from sampling_design.observability.worst_case.spaced_times import has_few_times, prove_by_times
from sampling_design.plants.clusters import balanced_schur
from sampling_design.plants.functional import Wanted, rows_counted, wider_beside
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.budget import Budget, Progress
from sampling_design.records.dispatch import OpenPlant
from sampling_design.records.record import Claim, Plain, above, below, counted, moment, short
from sampling_design.records.signatures import open_verb
from sampling_design.schedules.jitter import ON_TIME, Timing, TimingTolerance
from sampling_design.schedules.spaced_windows import SpacedWindows

MOST_MEMORY = 2.0  # GiB that a search over the times of all samples may take
_PROOF = 0.25  # of the budget: what the proof has in any case, however long a busy machine took for the search
LEAST_SEARCH = 0.1  # seconds for the attained bound even where the budget is spent: without it nothing is said
APART = 2.0**10  # units of states that doubles take as they are
RTOL = 0.01  # default width of the bracket, relative
_PICTURE = 401  # points of the profile
_REASONS = {
    "budget": "the budget ran out before the bracket closed; more time narrows it",
    "interrupted": "the search was interrupted before the bracket closed",
    "rounding": "rounding keeps the bracket open; scale the plant",
    "units": "units of states that are far apart keep the bracket open; give the plant scales",
    "too many states": f"a proof by directions is not tried beyond {MOST_STATES} states; retain fewer of them",
}


@dataclass(frozen=True)
class WorstCaseProfile:
    """What the worst schedule sees of the worst state, for pictures.

    `times` and `output_norm` hold f(s) = |C e^{As} x| over the window, `samples` and `at_samples` the witness on
    that curve; sigma^2 is the sum of at_samples^2.
    """

    times: Array
    output_norm: Array
    samples: Array
    at_samples: Array


@dataclass(frozen=True, eq=False, repr=False)
class WorstCaseSigma(SigmaBracket):
    """Bounds on the least sigma over all schedules with k samples, epsilon apart, in a window of length T.

    Attributes
    ----------
    lower : float
        Proven for every admissible schedule at real times.
    upper : float
        Attained at `witness`, or at `readings`.
    witness : (k,) array
        Sample times within [0, T], relative to the window's start. Of samples that may be early or late planned ones,
        and the window is as much longer.
    readings : (k, p) array or None
        When each output of these samples is read; None where that is when they are planned.
    timing_tolerance : float, pair of floats, dict of these, or None
        How early or late each sample may be: `family` is the rule of what is planned, and `lower` is for all times at
        which it may be read. None where samples are on time.
    direction : (n,) array
        Unit state at the window's start that `witness` sees least.
    status : str
        Why the search ended: "closed", "too few samples", "below rounding", "budget", "interrupted", "rounding",
        "units", "too many states" or "no states".
    method : str
        What `lower` rests on, in words.
    cells : int
        How many cells of directions or times were bounded.
    family : SpacedWindows
    profile : WorstCaseProfile
    coordinates : str
        Which both bounds and `direction` refer to: "functional" for rows, "modal" for a part,
        "scaled" where the plant has scales, else "physical".
    time_unit : str
    rigorous : bool
        Whether `lower` is proven in ball arithmetic, a theorem about the stated doubles.
    """

    witness: Array
    direction: Array
    method: str
    cells: int
    family: SpacedWindows
    profile: WorstCaseProfile
    time_unit: str = field(default="s", kw_only=True)
    late: TimingTolerance = field(default=ON_TIME, kw_only=True)
    readings: Array | None = field(default=None, kw_only=True)

    _plain = (
        "lower upper witness readings? direction closed status method cells rtol rigorous family{window count spacing} "
        "timing_tolerance? time_unit deviations coordinates claim"
    )
    _answers = (
        "the least sigma over all schedules with {_counted} in {family.window} {time_unit}, {family.spacing} "
        "{time_unit} apart{_read}",
        "{_grounds}",
        SigmaBracket._good,
        SigmaBracket._balls.format(at="{_attained}"),
    )
    _table = {
        "samples come": "{_late}",
        "worst times": "{witness} {time_unit}",
        "worst state": "{direction}",
        "status": "{status}",
        "method": "{_method}",
    }

    def _counted(self) -> str:
        return counted(self.family.count, "sample")

    @property
    def timing_tolerance(self) -> Plain:
        """How early or late each sample may be read, as it is written; None where it is on time."""
        return self.late.plain if self.late else None

    def _late(self) -> str | None:
        return self.late.describe(self.time_unit) if self.late else None

    def _attained(self) -> str:
        return "reading at `.readings`" if self.late else "the schedule `.witness`"

    def _read(self) -> str:
        return said_of_readings(self.family, self.late, self.time_unit)

    def _method(self) -> str:
        return f"{self.method}, {self.cells} cells" if self.cells else self.method

    @property
    def claim(self) -> Claim:
        """What `lower` claims, and on what grounds."""
        f = self.family
        return Claim(
            f"sigma_n(O_s) >= {below(self.lower)} for all schedules with at least {f.count} samples, at least "
            f"{short(f.spacing)} apart, in every window of {short(f.window)}{self._read()}",
            theorem="Theorem 17" + (", in ball arithmetic" if self.rigorous else ""),
            assumptions=(
                "the plant's matrices are exact",
                "every sample measures all outputs",
                f"{self.coordinates} coordinates",
            ),
        )

    def explain(self) -> str:
        """Say what was proven for the family, which schedule is worst, and why a bracket did not close."""
        f, unit = self.family, self.time_unit
        if self.status == "no states":
            return sigma_bracket.NO_STATES
        many = (
            f"{self._counted()}, {short(f.spacing)} {unit} apart, in a window of {short(f.window)} {unit}{self._read()}"
        )
        if self.status == "too few samples":
            return f"Sigma is 0: fewer measurements than the {counted(self.direction.size, 'state')} ({many})."
        where = f"The worst times are {moment(self.witness)} {unit}"
        if self.status == "below rounding":
            measured = f"of the state {short(self.direction)} they measure {above(self.upper)}"
            return f"{where}; {measured}, which rounding does not tell from zero."
        proven = f"With {many}, sigma is at least {below(self.lower)} ({self._grounds})"
        return self._concluded(proven, where, _REASONS)


def said_of_readings(family: SpacedWindows, late: TimingTolerance, unit: str) -> str:
    """What is said of samples that may come early or late; nothing where they are on time."""
    wider, one = f"{short(family.window + late.span)} {unit}", "output" if late.apart else "sample"
    return f", as planned; each {one} {late.describe(unit)}, over windows of {wider}" if late else ""


@open_verb(SigmaBracket)
def worst_case_sigma(
    plant: Plant,
    family: SpacedWindows,
    rtol: float | None = None,
    *,
    of: Wanted = None,
    timing_tolerance: Timing = 0.0,
    rng: checks.Seed = None,
    rigorous: bool = False,
    budget: float | None = 60.0,
    progress: Progress | None = None,
) -> WorstCaseSigma:
    """Bracket the least sigma over all schedules with k samples, epsilon apart, in a window.

        sigma_bar = min of sigma_n(rows C e^{A tau_i}) over 0 <= tau_1, tau_i + epsilon <= tau_{i+1}, tau_k <= T

    Parameters
    ----------
    plant : Plant or UncertainPlant
        With constant parameters in a box: the least over every plant of the box too.
    family : SpacedWindows
        T = window, k = count, epsilon = spacing. More than k samples in a window only raise sigma, so
        exactly k are looked at.
    rtol : float
        The search ends when lower >= (1 - rtol) upper; in (0, 1). Default 0.01, over a box 0.1.
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows (`functional_plant`). Sigma is then the
        least |O x| over |H x|, in coordinates that the rows share with states that count next to nothing.
        Default: all states.
    timing_tolerance : float, pair (early, late), or dict of these by output [plant.time_unit]
        How early or late each planned sample may be: at any time in [t - early, t + late] of a planned t; by output,
        each at a time of its own. `family` is the rule of planned times, windows are early and late together longer,
        and `upper` is attained at times that are allowed, `readings`.
    rng : numpy.random.Generator or its seed, optional
        Draws the starts of the search for the attained bound; the proof draws nothing. Default: seed 0.
    rigorous : bool
        Prove `lower` anew in ball arithmetic (extra `rigorous`), at most 1e-6 of it given away; the budget then
        holds for that proof once more.
    budget : float, optional [seconds]
        When it runs out, the bounds so far are returned with closed = False; so they are after an interrupt (Ctrl-C) of
        the proof. None: no limit.
    progress : callable, optional
        Called with the share of directions or times that is settled, and a message.

    Returns
    -------
    WorstCaseSigma, or WorstCaseOverBox
        lower = upper = 0 where k samples give fewer measurements than states; infinity for a plant
        without states.

    Raises
    ------
    ArgumentError
        If plant and family have different units of time, rtol is not in (0, 1), or e^{At} overflows
        within the window.
    MissingExtraError
        If `rigorous` is asked for and python-flint is not installed.

    Notes
    -----
    *Assumptions.* Every sample measures all outputs; the matrices are exact. That the samples fit,
    (k - 1) epsilon <= T, is a matter of the family, which refuses otherwise and says what would fit.
    *Claim.* `lower` holds for all real sample times, with sigma of the state at the window's *start*, of a plant with
    scales in scaled coordinates. `upper` is sigma of `witness`.
    *Method.* Upper: worst direction and worst times in turn, the latter by dynamic programming on a
    grid, from many starts; then Newton off the grid. Lower: branch and bound over the sphere of states.
    In slacks u_i = tau_i - (i - 1) epsilon the constraint is order alone, so that no gap is ever rounded.
    A worst state z is an eigenvector, so that y'Gz = lambda y'Nz for every y: linear in z. A cell of directions
    is closed by its corners, where the least y'Gz over all schedules is a least path and each sample's term lies
    above its chords minus (h^2/8) max of its second derivative. Cell, grid and the windows in which each
    sample can still matter shrink together. The state is taken at the first sample, which alone leaves it a thin slab.
    From five states on, where at most twelve samples are on time, cells of times take the place of those of directions:
    one matrix lies below the Gramians of all schedules of a cell.
    *Deviations.* `deviations` of the record says what is left where samples come a hundredth of the spacing early or
    late (or as was asked), and where one is lost, within what is left of a `budget`: a rule with one sample fewer.
    *Numerical aspects.* The coordinates are those in which a survey of the window and the worst schedule
    found see all directions alike. Remainders are suprema over the grid cells (fourth derivatives,
    bounded by norms), not samples: a dip narrower than the first grid is not missed. `lower` is reduced by
    `bracket.ALLOWANCE` for the exponentials and by a multiple of eps for the sums; it is no interval
    arithmetic unless `rigorous` asks for it. Sigma counts as zero below n eps |O|. Cost grows exponentially
    with the number of states, about linearly with k, over directions, and over times exponentially with k.

    References
    ----------
    The paper, Theorem 17.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    >>> sigma = worst_case_sigma(plant, SpacedWindows(window=4.0, count=2, spacing=0.5))
    >>> sigma.witness, round(sigma.upper, 5), sigma.closed
    (array([3.5, 4. ]), 0.09092, True)
    >>> bool(0.99 * sigma.upper <= sigma.lower <= sigma.upper)
    True
    """
    late = TimingTolerance.of(timing_tolerance, plant.outputs.names, plant.time_unit)
    late.require_order(family.spacing)
    plant = part_for(plant, of, family.window + late.span)
    tolerance, seconds = asked(plant, family, RTOL if rtol is None else rtol, budget)
    generator = checks.generator(rng)
    require_moderate(plant)
    _require_memory(plant, family, late)
    limit = Budget(seconds)
    bracketed = partial(_bracketed, late=late, rtol=tolerance, rng=generator, progress=progress)
    result, own = _of_rows(plant, family, seconds, bracketed)
    left = limit.left
    if rigorous:
        from sampling_design.observability.worst_case.balls import prove_worst_sigma

        proof = prove_worst_sigma(own, result.family, result.lower, result.witness, seconds, late=late)
        result = sigma_bracket.in_balls(result, proof)
    coordinates = sigma_bracket.coordinates_of(plant)
    least = partial(_least, plant, tolerance)
    beside = partial(deviations_of_family, least, family, late, result.lower, left, plant.time_unit)
    return replace(result, family=family, coordinates=coordinates, beside=beside)


def _least(plant: Plant, rtol: float, family: SpacedWindows, late: TimingTolerance, seconds: float) -> float:
    """Proven sigma of a rule."""
    bracketed = partial(_bracketed, late=late, rtol=rtol, rng=checks.generator(0), progress=None)
    return sigma_bracket.uninterrupted(_of_rows(plant, family, seconds, bracketed)[0]).lower


def deviations_of_family(
    least: Callable[[SpacedWindows, TimingTolerance, float], float],
    family: SpacedWindows,
    asked: TimingTolerance,
    sigma: float,
    seconds: float,
    time_unit: str,
) -> SigmaDeviations | None:
    """Prove what is left of a family's `sigma` if samples come early or late, or one is lost; None without `seconds`.

    `least(family, late, seconds)` proves sigma of a rule. As early or late as was `asked`, of which `sigma` is proven,
    else by a share of the spacing. Windows that are early and late together longer hold all that was planned in the
    shorter ones. In windows of the family's own length real times hold what was planned in one that is as much shorter,
    less than the spacing: all samples but one. A rule with one sample fewer and less spacing holds where one is lost,
    too.
    """
    limit = Budget(seconds)
    late = asked or TimingTolerance.of(sigma_bracket.SHARE * family.spacing)
    wider = sigma if asked else least(family, late, limit.left)
    nearer = family.spacing if asked else family.spacing - late.span
    fewer = family.count - 1
    if limit.over:
        return None
    rule = replace(family, count=fewer, spacing=nearer) if fewer else family
    lost = min(sigma, least(rule, asked or ON_TIME, limit.left)) if fewer else 0.0
    return SigmaDeviations(late, sigma if asked else lost, min(sigma, wider), lost, None, time_unit, bool(asked))


def asked(plant: OpenPlant, family: SpacedWindows, rtol: float, budget: float | None) -> tuple[float, float]:
    """Return the tolerance and the seconds, checked as the family's unit is.

    Raises ArgumentError if plant and family have different units of time, or a number is out of range.
    """
    if family.time_unit is not None and family.time_unit != plant.time_unit:
        raise ArgumentError(
            f"`family` is in {family.time_unit} and the plant in {plant.time_unit}. Give both in one unit of time."
        )
    return sigma_bracket.rtol_and_seconds(rtol, budget)


def _require_memory(plant: Plant, family: SpacedWindows, late: TimingTolerance) -> None:
    """Refuse a number of samples whose Hessian and tables do not fit into memory, before anything is tried."""
    k, read = float(family.count), plant.n_outputs * (spaced_search.MOVES + 1 if late else 1)
    need = 8 * (3 * k * k + k * spaced_search.LEAST_CELLS * (read * plant.n_states + plant.n_states + 4)) / 2**30
    if need > MOST_MEMORY:
        raise ArgumentError(
            f"`family` asks for {family.count} samples in a window, which would take {need:.3g} GiB; at most "
            f"{MOST_MEMORY:g} GiB are taken. Look at a shorter window with fewer samples."
        )


def _of_rows(
    plant: Plant, family: SpacedWindows, seconds: float,
    bracketed: Callable[[Plant, SpacedWindows, float, int], tuple[WorstCaseSigma, Array]],
) -> tuple[WorstCaseSigma, Plant]:  # fmt: skip
    """The record, and the plant in its own coordinates; states beside rows count as little as its witness asks."""
    limit, inner, found = Budget(seconds), within_periods(plant, family), list[tuple[WorstCaseSigma, Plant]]()
    for _ in range(MOST_WIDER):
        own = plant.scaled() if plant.has_scales else plant
        record, shares = bracketed(own, inner, limit.left, rows_counted(plant))
        found.append((record, own))
        wider = wider_beside(plant, shares)
        if record.status not in ("rounding", "units") or wider is None or limit.over:
            break
        plant = wider
    return max(found, key=lambda pair: pair[0].lower)


def _bracketed(
    plant: Plant, family: SpacedWindows, seconds: float, counted: int, *, late: TimingTolerance, rtol: float,
    rng: np.random.Generator, progress: Progress | None,
) -> tuple[WorstCaseSigma, Array]:  # fmt: skip
    """The record for one plant in its own coordinates, and what its witness leaves of each state (`least_observed`).

    Where rounding keeps it open, it is proven for states z, x = D z, that are balanced as far as their units are more
    than `APART` apart: |O x| >= sigma_z |z| and |z| >= |x|/max D.
    """
    rows, budget = SpacedRows(plant, family.window, family.count, family.spacing, late), Budget(seconds)
    if plant.n_states == 0:
        found = AttainedSchedule(np.inf, np.zeros(rows.count), np.zeros(0))
        return _record(rows, family, late, rtol, SphereBounds(np.inf, found, "no states", 0), "no states", counted)
    record, shares = _record(rows, family, late, rtol, *_proof(rows, rtol, seconds, rng, progress), counted)
    D = balanced_schur(plant.A, plant.C).d if record.status in ("rounding", "below rounding") else np.ones(1)
    if np.ptp(D) == 0:
        return record, shares
    D = np.minimum(D.max(), D * APART)
    balanced = Plant(plant.A * D / D[:, None], plant.C * D, time_unit=plant.time_unit)
    rows = SpacedRows(balanced, family.window, family.count, family.spacing, late)
    proof, method = _proof(rows, rtol, budget.left, rng, progress)
    lower = min(proof.lower / float(D.max()), record.upper)
    if lower <= record.lower:
        return record, shares
    status = "closed" if lower >= (1 - rtol) * record.upper else "units"
    method = f"{method}, of balanced states"
    return replace(record, lower=lower, status=status, method=method, cells=proof.cells), shares


def _proof(
    rows: SpacedRows, rtol: float, seconds: float, rng: np.random.Generator, progress: Progress | None
) -> tuple[SphereBounds, str]:
    """Both bounds, by the shortest way that the problem allows, and its name."""
    if rows.count * rows.p < rows.n:
        found = spaced_search.worst_of(rows, np.linspace(0.0, rows.slack, rows.count)[None])
        return SphereBounds(0.0, found, "too few samples", 0), "fewer measurements than states"
    if rows.slack == 0.0:
        found = spaced_search.worst_of(rows, np.zeros((1, rows.count)))
        lower = max(0.0, found.sigma - rows.rounding(found.slacks))
        proof = SphereBounds(lower, found, "closed" if lower >= (1 - rtol) * found.sigma else "rounding", 0)
        method = "only one schedule is admissible"
    else:
        budget = Budget(seconds)
        found = spaced_search.search_worst(rows, rng, max(seconds / 2, LEAST_SEARCH))
        if rows.counts_as_zero(found.sigma, found.slacks, found.moves):
            proof, method = SphereBounds(0.0, found, "", 0), "a schedule that leaves a direction unobservable"
        else:
            proof, method = _searched(rows, found, rtol, max(budget.left, _PROOF * seconds), progress)
    if rows.counts_as_zero(proof.attained.sigma, proof.attained.slacks, proof.attained.moves):
        proof = proof._replace(lower=0.0, status="below rounding")
    return proof, method


def _searched(
    rows: SpacedRows, found: AttainedSchedule, rtol: float, seconds: float, progress: Progress | None
) -> tuple[SphereBounds, str]:
    """Both bounds by cells of times where these are few, else by cells of directions, and which of the two."""
    budget = Budget(seconds)
    by_times = prove_by_times(rows, found, rtol, seconds, progress) if has_few_times(rows) else None
    if by_times is not None and by_times.status != "rounding":
        return by_times, "branch and bound over times"
    if rows.n > MOST_STATES:
        return SphereBounds(0.0, found, "too many states", 0), "none"
    return prove_worst(rows, found, rtol, budget.left, progress), "branch and bound over directions"


def _record(
    rows: SpacedRows, family: SpacedWindows, late: TimingTolerance, rtol: float, proof: SphereBounds, method: str,
    counted: int,
) -> tuple[WorstCaseSigma, Array]:  # fmt: skip
    """The public record, its witness evaluated afresh by the room's own sigma of what is counted, and its shares."""
    plant, planned, status = rows.plant, rows.times(proof.attained.slacks), proof.status
    readings, when, mask = None, planned, None
    if late:
        readings = np.empty((rows.count, plant.n_outputs))
        for each, group in zip(rows.readings(planned, proof.attained.moves).T, rows.groups, strict=True):
            readings[:, group.outputs] = each[:, None]
        when, mask = readings.ravel(), np.tile(np.eye(plant.n_outputs, dtype=bool), (rows.count, 1))
    counted = plant.n_states if status in ("too few samples", "below rounding") else counted  # of what is hidden, all
    x, upper, shares = proof.attained.direction, np.inf, np.zeros(0)
    if plant.n_states:
        x, upper, shares = least_observed(observability_matrix(plant, when, mask), counted)
    lower = min(proof.lower, upper)
    status = "rounding" if status == "closed" and lower < (1 - rtol) * upper else status  # of rows: others hide them
    s = np.linspace(0.0, family.window + late.span, _PICTURE)
    seen, at = (plant.C @ plant.transition(t) @ x for t in (s, when))
    at_samples = np.linalg.norm(at if mask is None else at * mask, axis=1)
    frozen = [freeze(a) for a in (s, np.linalg.norm(seen, axis=1), when, at_samples)]
    record = WorstCaseSigma(
        lower=lower, upper=upper, witness=freeze(planned + max(late.early)),
        direction=freeze(x), status=status, method=method, cells=proof.cells, family=family, rtol=rtol,
        profile=WorstCaseProfile(*frozen), time_unit=plant.time_unit, late=late,
        readings=None if readings is None else freeze(readings),
    )  # fmt: skip
    return record, shares
