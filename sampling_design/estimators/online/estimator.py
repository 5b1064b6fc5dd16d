"""What every estimator hands out, and what may be asked of any of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_flag
from sampling_design.errors import ArgumentError, SamplingDesignError
from sampling_design.estimators.online.estimate import FAILURES, MOVED, Contradiction, Estimate, Status, half_widths
from sampling_design.estimators.records.measurement_table import MeasuredPlant, dates_of, time_or_date
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array, Mask, freeze
from sampling_design.records.declarations import Column, above
from sampling_design.records.record import CurveRecord, ListRecord, PlainRecord, Variable, counted


@dataclass
class EstimateCounts:
    """Counts of estimates in order of time; no a-priori claim is about those that were `moved` into their intervals."""

    time_unit: str
    moved: bool = False
    origin: str = ""
    count: int = 0
    first: float = 0.0
    last: float = 0.0
    status: Counter[Status] = field(default_factory=Counter)
    certified: int = 0
    on_schedule: int = 0
    contradictions: dict[Contradiction, None] = field(default_factory=dict)

    def add(self, t: float, estimate: Estimate) -> None:
        """Count one estimate more, at t."""
        self.take(t, estimate.status, estimate.certified, estimate.on_schedule, estimate.contradiction)

    def take(
        self, t: float, status: Status, certified: bool, on_schedule: bool, contradiction: Contradiction | None
    ) -> None:
        """Count what is said of one estimate more."""
        if not self.count:
            self.first = t
        self.count += 1
        self.last = t
        self.status[status] += 1
        self.certified += bool(certified)
        self.on_schedule += bool(on_schedule)
        if contradiction is not None:
            self.contradictions.setdefault(contradiction)

    @property
    def what(self) -> str:
        """How many estimates there are, of which times, and where they lie."""
        first, last = (time_or_date(self.origin, t, self.time_unit) for t in (self.first, self.last))
        span = f" from {first.removesuffix(f' {self.time_unit}')} to {last}" if self.count else ""
        where = ", in the middle of what data and bounds allow" if self.moved else ""
        return f"{counted(self.count, 'estimate')} of the state{span}{where}"

    @property
    def evidence(self) -> str:
        """Of how many a radius is proven."""
        many = f"the radii of {self.certified} of {self.count}, where the bounds hold"
        return f"proven: {many}" if self.certified else "nothing is proven"

    def _contradicted(self) -> list[str]:
        """What contradicts the bounds, by its date where the record has dates."""
        if not self.origin:
            return [str(each) for each in self.contradictions]
        return [each.at(time_or_date(self.origin, each.t, self.time_unit)) for each in self.contradictions]

    def rows(self) -> list[tuple[str, str]]:
        """Rows of a table."""
        return [
            ("what", self.what),
            ("evidence", self.evidence),
            ("status", ", ".join(f"{k}: {v}" for k, v in self.status.items()) or "-"),
            *([] if self.moved else [("on schedule", f"{self.on_schedule} of {self.count}")]),
            *(("contradiction", said) for said in self._contradicted()),
        ]

    def explain(self) -> str:
        """Say how many estimates there are and what they promise."""
        failed = sum(count for status, count in self.status.items() if status in FAILURES)
        trouble = f" {failed} failed; {'its note says' if failed == 1 else 'their notes say'} why." if failed else ""
        for said in self._contradicted():
            trouble += f" The data contradict the bounds: {said}."
        where = ", each in the middle of what data and bounds allow" * self.moved
        return f"{counted(self.count, 'estimate')}{where}, {self.certified} of them with a proven radius.{trouble}"


class GuaranteeWarning(UserWarning):
    """A choice that gives up the certificate's claim: the estimator works on, and its estimates say so."""


class Sample(NamedTuple):
    """A time stamp with what came at it: y (NaN where not measured; None for no measurement) and u from then on.

    A pair t = (first, last) says that y was measured at some time in between, nobody knows when.
    """

    t: float | tuple[float, float]
    y: object = None
    u: object = None


@dataclass(frozen=True, eq=False, repr=False)
class EstimateRecord(ListRecord[Estimate], CurveRecord, PlainRecord):
    """Estimates in order of time, as arrays.

    Attributes
    ----------
    times : (N,), x : (N, n), radii : (N, n), radius : (N,), cost : (N,) arrays
    covariance : (N, n, n) array
    status : tuple of str
    certified, on_schedule : (N,) arrays of bool
    notes : tuple of str
    contradictions : tuple of Contradiction or None
    estimates : tuple of Estimate
        Those that it was made of.
    origin : str
        Date (ISO 8601) of time 0, if known: then rows of `to_frame()` have their dates.
    """

    plant: Plant
    times: Array
    x: Array
    covariance: Array
    radius: Array
    cost: Array
    status: tuple[Status, ...]
    certified: Mask
    on_schedule: Mask
    notes: tuple[str, ...] = field(default=())
    contradictions: tuple[Contradiction | None, ...] = field(default=())
    estimates: tuple[Estimate, ...] = field(default=(), repr=False)
    origin: str = ""

    _plain = (
        "states:plant.states.names time_unit:plant.time_unit times x radii radius cost status certified on_schedule "
        "notes contradictions:first_contradictions"
    )

    @classmethod
    def collect(cls, plant: Plant | MeasuredPlant, estimates: Iterable[Estimate], origin: str = "") -> EstimateRecord:
        """Return the record of some estimates of one plant, linear or not."""
        found: Sequence[Estimate] = list(estimates)
        if not checks.holds(found, Estimate):
            raise ArgumentError(f"`estimates` must be a list of estimates, got {checks.described(found)}.")
        n = plant.n_states
        if any(e.x.shape != (n,) for e in found):
            raise ArgumentError(f"`estimates` must be of the plant's {n} states.")
        return cls(
            plant=plant,  # type: ignore[arg-type]  # a nonlinear one has what is asked of it
            times=freeze([e.t for e in found]),
            x=freeze(np.array([e.x for e in found]).reshape(-1, n)),
            covariance=freeze(np.array([e.covariance for e in found]).reshape(-1, n, n)),
            radius=freeze([e.radius for e in found]),
            cost=freeze([e.cost for e in found]),
            status=tuple(e.status for e in found),
            certified=np.array([e.certified for e in found], dtype=bool),
            on_schedule=np.array([e.on_schedule for e in found], dtype=bool),
            notes=tuple(e.note for e in found),
            contradictions=tuple(e.contradiction for e in found),
            estimates=tuple(found),
            origin=origin,
        )

    def _entries(self) -> tuple[Estimate, ...]:
        return self.estimates

    def centred(self) -> EstimateRecord:
        """Return the estimates moved into the middle of their intervals, as `Estimate.centred`."""
        return self.collect(self.plant, [estimate.centred() for estimate in self.estimates], self.origin)

    @cached_property
    def radii(self) -> Array:
        """What each entry is off at most, (N, n): see `Estimate.radii`; computed when first asked for."""
        found = freeze(np.array([e.radii for e in self.estimates]).reshape(self.x.shape))
        self._judge()
        return found

    def _judge(self) -> None:
        """Take over what the intervals disproved when they were asked for: one verdict for both proofs."""
        judged = self.collect(self.plant, self.estimates)
        keys = ("radius", "status", "certified", "notes", "contradictions")
        self._hold(**{key: getattr(judged, key) for key in keys})

    @cached_property
    def ellipsoid_radii(self) -> Array:
        """Half-widths of the ellipsoids, (N, n)."""
        return freeze(half_widths(self.radius[:, None], np.einsum("kii->ki", self.covariance)))

    def _variables(self) -> dict[str, Variable]:
        states, time = self.plant.states.names, self.plant.time_unit
        n = range(len(states))
        variance = self.covariance if len(self.times) else np.zeros((0, len(n), len(n)))
        return {
            "time": Variable(("time",), self.times, time),
            "state": Variable(("state",), np.array(states, dtype=str)),
            "other_state": Variable(("other_state",), np.array(states, dtype=str)),
            "unit": Variable(("state",), np.array(self.plant.states.units, dtype=str)),
            "x": Variable(("time", "state"), self.x),
            "radii": Variable(("time", "state"), self.radii),
            "covariance": Variable(("time", "state", "other_state"), variance),
            "radius": Variable(("time",), self.radius),
            "cost": Variable(("time",), self.cost),
            "status": Variable(("time",), np.array(self.status, dtype=str)),
            "certified": Variable(("time",), self.certified),
            "on_schedule": Variable(("time",), self.on_schedule),
        }

    def _columns(self) -> dict[str, Column]:
        names = self.plant.states.names
        dates = dates_of(self.origin, self.times, self.plant.time_unit)
        return {
            **({} if dates is None else {"date": dates}),
            "time": self.times,
            **{name: self.x[:, i] for i, name in enumerate(names)},
            **{f"{name} radius": self.radii[:, i] for i, name in enumerate(names)},
            "status": self.status,
            "certified": self.certified,
            **({} if MOVED in self.notes else {"on_schedule": self.on_schedule}),  # see `Estimate.centred`
        }

    @property
    def first_contradictions(self) -> tuple[Contradiction, ...]:
        """The different samples that contradict the bounds, in order."""
        return tuple(dict.fromkeys(each for each in self.contradictions if each is not None))

    @property
    def _counted(self) -> EstimateCounts:
        found = EstimateCounts(self.plant.time_unit, moved=MOVED in self.notes, origin=self.origin)
        contradictions = self.contradictions or (None,) * len(self)
        flags = (self.status, self.certified.tolist(), self.on_schedule.tolist(), contradictions)
        for each in zip(self.times.tolist(), *flags, strict=True):
            found.take(*each)
        return found

    _answers = ("{_counted.what}", "{_counted.evidence}", "{_last}", "`.estimates[-1].interval().verify()`")

    def _last(self) -> str:
        """How well the state is known at the end."""
        radii = self.estimates[-1].radii if self.estimates else np.array([])
        if not np.isfinite(radii).any():
            return "no radius at the end"
        least = self.estimates[-1].if_centred()
        return f"at the end within {above(radii)}" + f" ({least} if `centred()`)" * bool(least)

    def _rows(self) -> list[tuple[str, str]]:
        return self._counted.rows()[2:]

    def explain(self) -> str:
        """Say how many estimates there are and what they promise."""
        return self._counted.explain()


@runtime_checkable
class Estimator(Protocol):
    """Anything that turns samples into states as they come: three methods, of any class.

    What `update` and `predict` return is an `Estimate`, or the state alone, (n,), where nothing is said of its error.
    """

    def start(self, prior: npt.ArrayLike, prior_time: float = 0.0) -> object:
        """Forget all samples and start again from the state `prior` at `prior_time`."""
        ...

    def update(self, t: float, y: npt.ArrayLike | None, u: npt.ArrayLike | None = None) -> Estimate | npt.ArrayLike:
        """Take in a sample and return the state just after it.

        y is (p,) with NaN for "not measured", or None where only the input changes; of a record with limits or means
        they stand in it as they are. u (m,) holds from t on, None for unchanged.
        """
        ...

    def predict(self, t: float) -> Estimate | npt.ArrayLike:
        """Return the state at a time after the last sample, open loop; no sample is taken in."""
        ...


SYMMETRIC = 1e-12  # of the largest entry of a covariance, what mirrored entries may differ by


@contextmanager
def answering(estimator: Estimator) -> Iterator[None]:
    """Say of an error whose it is: raises ArgumentError from one of an estimator that the package has not worded."""
    try:
        yield
    except (SamplingDesignError, MemoryError):
        raise
    except Exception as error:
        said = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        who = type(estimator).__name__
        raise ArgumentError(f"`estimator` must answer without an error, got of {who} {said}.") from error


def estimate_from(found: Estimate | npt.ArrayLike, t: float, n: int) -> Estimate:
    """Return what an estimator returned as an estimate: of a state alone nothing is proven, and its radius is infinite.

    Raises ArgumentError if it is no state of `n` entries, or an estimate of another time or size or with a covariance
    that is not symmetric.
    """
    if not isinstance(found, Estimate):
        x = checks.vector("estimate", found, n)
        return Estimate(t, x, freeze(np.eye(n)), note="The estimator says nothing of its error.")
    if found.t != t:
        raise ArgumentError(f"`estimate` must be of the time that was asked for, {t!r}, got t = {found.t!r}.")
    if not is_flag(found.certified):
        raise ArgumentError(f"`estimate.certified` must be true or false, got {checks.described(found.certified)}.")
    for key, shape in (("x", (n,)), ("covariance", (n, n))):
        value = getattr(found, key)
        if getattr(value, "shape", None) != shape:
            got = getattr(value, "shape", None) or checks.described(value)
            raise ArgumentError(f"`estimate.{key}` must be an array of shape {shape}, got {got}.")
    Y = found.covariance
    if found.certified and np.abs(Y - Y.T).max() > SYMMETRIC * np.abs(Y).max():
        raise ArgumentError("`estimate.covariance` must be symmetric.")
    return found
