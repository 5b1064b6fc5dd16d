"""One estimate: the state at one time, how it came about, and what is proven of it.

And the tube of intervals over the time after a sample, true at all times: what is drawn between samples.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Literal, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from sampling_design.accuracy.interval import Interval
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.errors import ArgumentError
from sampling_design.numerics.filtering import inverse_root
from sampling_design.plants.functional import Wanted
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.declarations import above, below, plain
from sampling_design.records.record import Plain, PlainRecord, moment, short

KNOTS = 5  # times of a gap at which programs are solved; gains in between are mixed from theirs, which proves no less


def joined(tubes: Sequence[StateTube]) -> StateTube | None:
    """Return tubes one after the other; None where there is none."""
    if not tubes:
        return None
    parts = ([getattr(tube, key) for tube in tubes] for key in ("times", "lower", "upper"))
    return StateTube(*(np.concatenate(part) for part in parts))


@dataclass(frozen=True, eq=False)
class StateTube:
    """Ends (N, n) at some times; every state lies between the straight lines through them, at all times between."""

    times: Array  # (N,)
    lower: Array  # lower, upper, (N, n): NaN where the data contradict the bounds
    upper: Array

    @property
    def middle(self) -> Array:
        """Halfway between the ends (N, n); not finite where they are not."""
        with np.errstate(invalid="ignore"):
            return np.asarray((self.lower + self.upper) / 2)


def open_tube(program: RecordProgram, times: Array, x: Array) -> StateTube:
    """Return the tube over increasing times, as `_opened`; infinite where a flow overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        found = _opened(program, times, x)
    lost = np.isnan(found.upper) | np.isnan(found.lower)
    if lost.all():
        return found
    return StateTube(times, np.where(lost, -np.inf, found.lower), np.where(lost, np.inf, found.upper))


def _opened(program: RecordProgram, times: Array, x: Array) -> StateTube:
    """Return the tube over increasing times, the first of them the last of the readings; x (N, n) are any estimates.

    Notes
    -----
    *Method.* An end is convex in the row, and a mixture of gains proves the same mixture of ends. Between two times
    delta apart the row Phi(d)'c bends by at most delta^2/8 sup |A'^2 Phi(d)'c|, x by delta^2/8 sup |x''|, and
    what w adds grows by no more than it does until the later one; all of that is added.
    """
    plant, n, N = program.readings.plant, program.readings.plant.n_states, len(times)
    upper, added = _ends(program, times, np.vstack([np.eye(n), -np.eye(n)]))
    ends, added = np.stack([upper[:, :n], -upper[:, n:]]), added[:, :n]
    if np.any(ends[0] < ends[1]) or (program.seems_infeasible and program.contradicted):
        nothing = np.full((N, n), np.nan)
        return StateTube(times, nothing, nothing)
    upper, lower = ends
    reach = np.maximum(upper[0] - x[0], x[0] - lower[0])
    if N == 1 or not np.isfinite(reach).all():
        return StateTube(times, lower, upper)
    step, D = np.diff(times)[:, None], program.table.D[:n]
    grown = np.exp(np.linalg.norm(plant.A * D / D[:, None], 2) * step)
    flows = plant.transition(times - times[0])
    bent = np.linalg.norm((plant.A @ plant.A @ flows) * D, axis=2) * np.linalg.norm(reach / D)
    speed = np.diff(x, axis=0) / step
    turned = np.abs(np.diff(speed, axis=0, prepend=speed[:1], append=speed[-1:])) / step.mean()
    sag = step**2 / 8 * (grown * np.maximum(bent[1:], bent[:-1]) + np.maximum(turned[1:], turned[:-1]))
    sag += np.diff(added, axis=0)
    wide = np.zeros((N, n))
    wide[:-1], wide[1:] = sag, np.maximum(wide[1:], sag)
    wide[:-1] = np.maximum(wide[:-1], sag)
    return StateTube(times, lower - wide, upper + wide)


def _ends(program: RecordProgram, times: Array, rows: Array) -> tuple[Array, Array]:
    """Upper ends (N, r) of rows at the times, and what w adds after the first; times one by one: each makes a flow."""
    knots = np.unique(np.linspace(0, len(times) - 1, min(KNOTS, len(times))).astype(int))
    solved = {k: [program.end(float(times[k]), row) for row in rows] for k in knots.tolist()}
    gains = {k: np.array([end.gains for end in ends]) for k, ends in solved.items()}
    found, added = np.empty((2, len(times), len(rows)))
    for k, t in enumerate(times.tolist()):
        after, before = int(knots[knots >= k].min()), int(knots[knots <= k].max())
        share = 0.0 if after == before else (t - times[before]) / (times[after] - times[before])
        mixed = (1 - share) * gains[before] + share * gains[after]
        for i, row in enumerate(rows):
            found[k, i] = (solved[k][i] if k in solved else program.upper(t, row, mixed[i])).value
            added[k, i] = program.after(t, row)
    return found, added


Status = Literal["prior", "ok", "predicted", "infeasible", "solver failed", "bounds disproved"]
"""How an estimate came about.

prior: given, not estimated. ok: the window problem was solved. predicted: open loop since the last solve.
infeasible: no trajectory meets the constraints and the data; solver failed: no engine reached its
tolerance (in both cases the state is the open-loop prediction). bounds disproved: solved, and the cost is
larger than the assumed noise bounds allow.
"""

MOVED = "Moved into the middle of what the data prove."

FAILURES: tuple[Status, ...] = ("infeasible", "solver failed", "bounds disproved")


class Contradiction(NamedTuple):
    """The sample that the data would have to do without, for the bounds to hold.

    Attributes
    ----------
    number : int
        Of the sample since the prior, from 1.
    t : float
    output : str
        Of its outputs the one.
    factor : float
        By which its noise bound would have to grow (infinity where that bound is 0).
    alone : bool
        Whether the rest agrees once it is left out; if not, `factor` is that of all bounds together.
    """

    number: int
    t: float
    output: str
    factor: float
    alone: bool = True

    def sentence(self) -> str:
        """What every estimate from it on says of it."""
        return _sentence(self)

    def to_dict(self) -> dict[str, Plain]:
        """Plain data; an infinite factor becomes None."""
        return {**self._asdict(), "factor": plain(self.factor)}

    def __str__(self) -> str:
        return self.at(f"t = {self.t:.10g}")

    def at(self, when: str) -> str:
        """Say it of a sample whose time or date is called so."""
        sample, bounds = f"sample {self.number} at {when}, output {self.output}", "its v_bound"
        if not self.alone:
            sample, bounds = f"{sample}, and not it alone", "all bounds"
        if self.factor == np.inf:
            return f"{sample}: no factor of {bounds} suffices"
        return f"{sample}: {bounds} would have to be {below(self.factor, 3)} times as large"


@lru_cache(maxsize=8)
def _sentence(contradiction: Contradiction) -> str:
    again = "To leave it out: withdraw(t, output). To start again: start(prior, prior_time)."
    return f"The data contradict the bounds: {contradiction}. {again}"


class ProvesIntervals(Protocol):
    """What an interval is proven from."""

    @property
    def contradiction(self) -> Contradiction | None:
        """What the samples are known to contradict the bounds by, after the interval was asked for."""
        ...

    @property
    def newly(self) -> bool:
        """Whether the last of the samples is what made them do so."""
        ...

    def interval(self, t: float, of: Wanted, ellipsoid: tuple[Array, Array, float] | None) -> Interval:
        """Return the interval of wanted rows at t, no wider than an ellipsoid (centre, covariance, radius)."""
        ...

    def tube(self, times: Array, x: Array) -> StateTube:
        """Return the tube over increasing times from the last sample on, for estimates x (N, n) there."""
        ...


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(PlainRecord):
    """The state at one time, with the ellipsoid that holds it and the interval of each entry that the data prove.

        |x(t) - x|^2_Pi <= radius,    |x_i(t) - x_i| <= radii_i <= sqrt(radius (Pi^-1)_ii)

    Attributes
    ----------
    t : float
    x : (n,) array
    covariance : (n, n) array
        Pi^-1, the discounted Kalman covariance of the window; ahead of it, of the smaller one of two proven ellipsoids.
    radius : float
        Bound on |x(t) - x|^2_Pi; infinity where a bound on w, v or the initial error was not given, NaN where the
        data contradict the bounds or the constraints.
    status : str
        See `Status`.
    cost : float
        Optimal cost of the window problem (NaN where none was solved).
    certified : bool
        The ellipsoid is proven, provided that w, v and the initial error keep their bounds. What the interval proves to
        contradict the bounds is known once it is asked for (`interval`, `radii`, `centred`): from then on this estimate
        and all that are made after it are not certified and have no radius, until `start`.
    on_schedule : bool
        The certificate's a-priori claim covers this estimate: its own weights, cost and horizon, and no
        sample off its schedule so far.
    window_start : float
        Where the window began.
    engine : str
        What solved the window problem.
    note : str
        Why a flag is down or a solve failed, in words.
    contradiction : Contradiction or None
        Where the data contradict the bounds: the sample that does, and by what factor.
    proof : ProvesIntervals or None
        The samples and bounds behind it, from which `interval` and `radii` are computed when they are asked for; None
        where no bound on w or v was given.
    """

    t: float
    x: Array
    covariance: Array
    radius: float = np.inf
    status: Status = "ok"
    cost: float = np.nan
    certified: bool = False
    on_schedule: bool = False
    window_start: float = np.nan
    engine: str = ""
    note: str = ""
    contradiction: Contradiction | None = None
    proof: ProvesIntervals | None = field(default=None, repr=False)

    _plain = "t x radii radius status cost certified on_schedule note contradiction"
    _table = {
        "t": "{_moment}",
        "x": "{x}",
        "radii": "{radii}",
        "if centred": "{if_centred:or }",
        "status": "{status}",
        "certified": "{certified}",
        "on schedule": "{_schedule}",
        "cost": "{cost}",
        "note": "{note:or }",
    }

    def _schedule(self) -> bool | None:
        """None of an estimate that was moved: the claim is about the one that was not, wherever its samples lie."""
        return None if self.note == MOVED else self.on_schedule

    def interval(self, of: Wanted = None) -> Interval:
        """Return the values that the data and the bounds leave possible, for the states or for wanted rows.

        Parameters
        ----------
        of : str, sequence of str, or (r, n) array, optional
            Names of states or outputs, or rows; default all states.

        Returns
        -------
        Interval
            Never wider than the ellipsoid; with gains that prove it (`verify`).

        Raises
        ------
        ArgumentError
            If the estimator was given no bound on w or on v.
        """
        return self._of_states if of is None else self._proven(of)

    @cached_property
    def _of_states(self) -> Interval:
        """The interval of the states: `radii` and `centred` need it, too."""
        return self._proven(None)

    def _proven(self, of: Wanted) -> Interval:
        if self.proof is None:
            raise ArgumentError(
                "`w_bound` and `v_bound` must be given to the estimator: without them no interval can be proven."
            )
        found = self.proof.interval(self.t, of, (self.x, self.covariance, self.radius) if self.certified else None)
        _disprove(self.__dict__, self.proof)
        return found

    def centred(self) -> Estimate:
        """Return this estimate moved into the middle of its interval: no other has a smaller largest error.

            x_i = (lower_i + upper_i)/2,    |x_i(t) - x_i| <= radii_i = (upper_i - lower_i)/2

        Returns
        -------
        Estimate
            Its ellipsoid is one around the box of half-widths `radii`. Where the data leave a state unbounded it keeps
            its place and its radius is infinite; where they contradict the bounds the status says so. The
            certificate's a-priori claim is about the estimate that was not moved.

        Raises
        ------
        ArgumentError
            If the estimator was given no bound on w or on v.
        """
        found = self.interval()
        if np.isnan(self.radius):
            return changed(self, on_schedule=False)
        known = np.isfinite(found.lower) & np.isfinite(found.upper)
        if not known.all():
            x = freeze(np.where(known, found.centre, self.x))
            return changed(self, x=x, radius=np.inf, certified=False, on_schedule=False)
        box = freeze(np.diag(found.radii**2) * len(found.radii))
        return changed(self, x=found.centre, covariance=box, radius=1.0, certified=True, on_schedule=False, note=MOVED)

    @cached_property
    def Pi(self) -> Array:
        """Information matrix, the inverse of `covariance`; what rounding made singular counts as n eps of the rest."""
        return freeze(self._half.T @ self._half)

    @cached_property
    def _half(self) -> Array:
        """Z with Z'Z = `Pi`."""
        return inverse_root(self.covariance)

    @cached_property
    def radii(self) -> Array:
        """Distance from each entry to the far end of its interval; without a proof, half-widths of the ellipsoid.

        A linear or cone program for each end of each entry, when they are first asked for: as much as ten to a hundred
        updates. From there on `centred` costs nearly nothing, and has the least radii that there are.
        NaN where the data contradict the bounds, also where only the interval proves it.
        """
        if self.proof is not None and not np.isnan(self.radius):
            found = self.interval().radii_from(self.x)
            if not np.isnan(self.radius):
                return found
        return freeze(half_widths(np.asarray(self.radius), self.covariance.diagonal()))

    @cached_property
    def ellipsoid_radii(self) -> Array:
        """Half-widths of the ellipsoid, one per state: what every update says, some times as wide as `radii`."""
        return freeze(half_widths(np.asarray(self.radius), self.covariance.diagonal()))

    @property
    def failed(self) -> bool:
        """Whether the solve failed or the data contradict the bounds."""
        return self.status in FAILURES

    def holds(self, truth: npt.ArrayLike) -> bool:
        """Whether `truth` lies in the ellipsoid."""
        return self.ratio(truth) <= 1.0

    def ratio(self, truth: npt.ArrayLike) -> float:
        """Return |truth - x|^2_Pi / radius, at most 1 where the claim holds; NaN where data contradict the bounds."""
        off = checks.vector("truth", truth, self.x.size) - self.x
        if np.isnan(self.radius):
            return np.nan
        if self.radius == np.inf or not off.any():
            return 0.0
        if self.radius <= 0:
            return np.inf
        size = math.hypot(*self._half.dot(off).tolist()) / math.sqrt(self.radius)
        return size * size  # a power would refuse what no double holds

    def _moment(self) -> str:
        return moment(self.t)

    def explain(self) -> str:
        """Say what this estimate promises."""
        radii = self.radii  # before the status: what they disprove stands in it
        text = f"At {moment(self.t)} the state is {short(self.x)} ({self.status})."
        if np.isfinite(radii).any():
            text += f" It is within {above(radii)} of the truth, state by state, if the given bounds hold."
            least = self.if_centred()
            text += f" In the middle of its interval it would be within {least}: `centred()`." * bool(least)
        else:
            text += " No radius is proven."
        return text + (f" {self.note}" if self.note else "")

    def if_centred(self) -> str:
        """Within what it would be in the middle of its interval, in words; nothing where it lies there.

        Solves for its radii, unless that was done.
        """
        if self.proof is None or np.isnan(self.radius):
            return ""
        least = above(self._of_states.radii)
        return least if least != above(self.radii) else ""


def estimate_of(entries: dict[str, object], proof: ProvesIntervals | None = None) -> Estimate:
    """Return the estimate of entries that are right as they are and its own; those not given have their defaults.

    `proof` is what its interval is proven from.
    """
    if proof is not None:
        entries["proof"] = proof
        _disprove(entries, proof)
    found = object.__new__(Estimate)
    object.__setattr__(found, "__dict__", entries)  # what is missing is the class's own
    return found


def _disprove(entries: dict[str, object], proof: ProvesIntervals) -> None:
    """Take back what the entries of an estimate promise, if its samples are known to contradict the bounds."""
    if entries.get("contradiction") is not None or (contradiction := proof.contradiction) is None:
        return
    note = f"{contradiction.sentence()} {entries.get('note', '')}".strip()
    entries.update(radius=np.nan, certified=False, contradiction=contradiction, note=note)
    if proof.newly and entries["status"] == "ok":
        entries["status"] = "bounds disproved"
    entries.pop("ellipsoid_radii", None)


def changed(estimate: Estimate, **entries: object) -> Estimate:
    """Return an estimate with other entries, but made from the same samples: the states' interval is what it was."""
    found = replace(estimate, **entries)  # type: ignore[arg-type]  # each as its field says
    found.__dict__.update({key: value for key, value in vars(estimate).items() if key == "_of_states"})
    return found


def half_widths(radius: Array, variance: Array) -> Array:
    """Return sqrt(radius variance): 0 where the variance is 0 and there is a radius, NaN where there is none."""
    size, spread = np.sqrt(radius), np.sqrt(np.maximum(variance, 0.0))
    if np.isfinite(size).all():
        return np.asarray(size * spread)
    return np.multiply(size, spread, where=(spread > 0) | np.isnan(radius), out=np.zeros(spread.shape))
