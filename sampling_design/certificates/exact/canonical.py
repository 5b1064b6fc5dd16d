"""A plant, its schedule and its weights in internal units, in which the search works: powers of two, so that nothing is
lost on the way there and back.

Time is counted in mean gaps, outputs and disturbances in the size that their weights give them, states in that of the
prior weight, or in one that balances A, C and G. So the units of the caller change no step of a search.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sampling_design.certificates.exact.given_weights import NoiseWeights
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.numerics.linalg import cut, positive_or_one
from sampling_design.plants.plant import Plant, Signals
from sampling_design.records.arrays import Array
from sampling_design.schedules.family import AnySchedule
from sampling_design.schedules.schedule import PeriodicSchedule, Schedule

MOST_GROWTH = 300.0  # exponent of the largest growth between two samples that is followed: its square is still a double
RANGE = 2.0**400
"""Numbers beyond this (or below its inverse) in internal units are refused: products of three leave the doubles."""
SINGULAR = 1e-6  # least eigenvalue of a weight's correlations from which on the digits cut leave it definite
LATE = 10
"""Gaps before the first sample from which on dates are suspected that do not count from the schedule's beginning."""


@dataclass(frozen=True, eq=False)
class ScaledProblem:
    """The internal problem, and the units x, w, y and time of it in those of the caller, all powers of two.

    `sizes` are the balancing sizes of the states in the internal units, between 1/sqrt(2) and sqrt(2) where the states
    were balanced: with them every quantity of the search is a fixed multiple of one that knows no units.
    """

    plant: Plant
    schedule: AnySchedule
    weights: NoiseWeights
    x: Array
    w: Array
    y: Array
    time: float
    sizes: Array

    def inside(self, P: Array) -> Array:
        """A weight of the states in internal units."""
        return P * self.x * self.x[:, None]

    def outside(self, P: Array) -> Array:
        """The inverse of `inside`."""
        return P / self.x / self.x[:, None]


def canonical(
    plant: Plant,
    schedule: AnySchedule,
    weights: NoiseWeights,
    P2: Array | None = None,
    log_sizes: Array | None = None,
    driven: bool = True,
) -> ScaledProblem:
    """Return the problem in internal units: states in those of P2, else of the base-two `log_sizes`, else balanced.

    Unless `driven`, G does not enter the balance. Raises ArgumentError if numbers are so far apart that they leave the
    range of doubles.
    """
    Qw, R, Qv = weights
    gaps = schedule.gaps if schedule.gaps.size else np.asarray(schedule.times)
    mean = np.log2(float(np.mean(gaps)))
    time = float(_power(mean))
    with np.errstate(over="ignore", divide="ignore", invalid="ignore", under="ignore"):
        log_w = -(np.log2(np.diagonal(Qw)) + mean) / 2
        log_y = -np.maximum(np.log2(np.diagonal(R)), np.log2(np.diagonal(Qv))) / 2
        w, y = _power(log_w), _power(log_y)
        A, C, G = time * plant.A, plant.C / y[:, None], time * plant.G * w
        if P2 is not None:
            logs = -np.log2(np.diagonal(P2)) / 2
        elif log_sizes is not None:
            logs = log_sizes
        else:  # in units that are no powers of two, which would leave something of the caller's in the sizes
            even = plant.A * np.exp2(mean), plant.C / np.exp2(log_y)[:, None], plant.G * np.exp2(mean + log_w) * driven
            logs = _balanced(*even, np.log2(plant.states.scales))
        x = _power(logs)
        A, C, G = A * x / x[:, None], C * x, G / x[:, None]
        inner = NoiseWeights(time * Qw * w * w[:, None], R * y * y[:, None], Qv * y * y[:, None])
        scales = [plant.states.scales / x, plant.outputs.scales / y, plant.disturbances.scales / w]
    for name, value in {"A": A, "C": C, "G": G, "Qw": inner[0], "R": inner[1], "Qv": inner[2]}.items():
        if not np.all(np.abs(value) < RANGE):
            raise ArgumentError(
                f"`{name}` holds numbers too far apart for doubles: {np.abs(value).max():.3g} in units of gaps, "
                "weights and prior. Is one of them meant in another unit?"
            )
    details = zip((plant.states, plant.outputs, plant.disturbances), scales, strict=True)
    states, outputs, disturbances = (Signals(s.names, (), np.clip(v, 1 / RANGE, RANGE)) for s, v in details)
    scaled = Plant(A, C, G=G, states=states, outputs=outputs, disturbances=disturbances)
    sizes = np.exp2(logs) / x
    return ScaledProblem(scaled, _timed(schedule, time), inner, x, w, y, time, sizes)


def evened(canon: ScaledProblem) -> ScaledProblem:
    """The same problem in units that are no powers of two, digits `cut`: a search there is the same in all units.

    What is found there is proven on the problem itself.
    """
    gaps = canon.schedule.gaps if canon.schedule.gaps.size else canon.schedule.times
    time, (Qw, R, Qv) = float(np.mean(gaps)), canon.weights
    sizes = np.diagonal(Qw) * time, np.maximum(np.diagonal(R), np.diagonal(Qv))
    w, y = (1 / np.sqrt(positive_or_one(each)) for each in sizes)
    x, plant, old = canon.sizes, canon.plant, canon.schedule
    details = ((plant.states, x), (plant.outputs, y), (plant.disturbances, w))
    states, outputs, disturbances = (Signals(s.names, (), cut(s.scales / own)) for s, own in details)
    A, C, G = time * plant.A * x / x[:, None], plant.C * x / y[:, None], time * plant.G * w / x[:, None]
    scaled = Plant(cut(A), cut(C), G=cut(G), states=states, outputs=outputs, disturbances=disturbances)
    schedule: AnySchedule
    if old.endless:
        even = cut(old.gaps / time)
        schedule = PeriodicSchedule(even, min(float(cut(old.first / time)), float(np.sum(even))), outputs=old.outputs)
    else:
        each = cut(np.diff(old.times, prepend=0.0) / time)  # cut themselves, far times would lose their gaps
        schedule = Schedule(np.cumsum(each), old.outputs)
    weights = tuple(W * u * u[:, None] for W, u in ((Qw * time, w), (R, y), (Qv, y)))
    kept = NoiseWeights(*map(cut_weight, weights))
    return ScaledProblem(
        scaled, schedule, kept, canon.x * x, canon.w * w, canon.y * y, canon.time * time, np.ones_like(x)
    )


def cut_weight(W: Array) -> Array:
    """A weight with digits `cut`, but for one so nearly singular that it might not be definite then."""
    sizes = np.diagonal(W)
    d = np.sqrt(positive_or_one(sizes))
    if np.count_nonzero(W - np.diag(sizes)) and not np.linalg.eigvalsh(W / d / d[:, None])[0] > SINGULAR:
        return W
    return cut(W)


def followed(canon: ScaledProblem, eta: float) -> None:
    """Say that it is undecided where the squared error grows beyond doubles before the next sample.

    Raises UndecidedError if e^{(2 max Re mu + eta) d}, d the longest gap, is beyond e^MOST_GROWTH.
    """
    rate = 2 * float(np.max(np.linalg.eigvals(canon.plant.A).real, initial=0.0)) + eta
    gaps, first = canon.schedule.gaps, float(canon.schedule.times[0])
    longest = max(float(np.max(gaps, initial=0.0)), first)
    if rate * longest > MOST_GROWTH:
        raise UndecidedError(
            f"undecided: the squared error may grow by e^{rate * longest:.4g} before the next sample, beyond what "
            f"doubles can follow (e^{MOST_GROWTH:g}).{origin_question(canon)}"
        )


def origin_question(canon: ScaledProblem) -> str:
    """A question about the origin of the times, where the first sample comes long after time 0; else nothing."""
    times = canon.schedule.times
    late = times.size > 1 and float(times[0]) > LATE * float(np.median(np.diff(times)))
    return " Times count from 0: should the schedule begin there?" if late else ""


def _power(logs: npt.ArrayLike) -> Array:
    """The power of two that is nearest on a logarithmic scale."""
    return np.exp2(np.rint(np.nan_to_num(np.asarray(logs, dtype=np.float64), neginf=-400.0, posinf=400.0)))


def _timed(schedule: AnySchedule, time: float) -> AnySchedule:
    if schedule.endless:
        shortest = schedule.primitive()  # whatever is equal is followed once
        return PeriodicSchedule(shortest.gaps / time, shortest.first / time, outputs=shortest.outputs)
    return Schedule(schedule.times / time, schedule.outputs)


def _balanced(A: Array, C: Array, G: Array, start: Array) -> Array:
    """Base-two sizes of the states that bring the entries of A, C and G near one, in least squares of logarithms.

    Another unit of a state shifts its logarithm and nothing else. What no entry ties down stays at `start`.
    """
    n = len(start)
    rows, right = [np.zeros((0, n))], [np.zeros(0)]
    eye = np.eye(n)
    for M, of_row, of_column in ((A, -eye, eye), (C, None, eye), (G, -eye, None)):
        i, j = np.nonzero(M)
        if of_row is not None and of_column is not None:
            i, j = i[i != j], j[i != j]
        change = np.zeros((i.size, n))
        if of_row is not None:
            change += of_row[i]
        if of_column is not None:
            change += of_column[j]
        rows.append(change)
        right.append(-np.log2(np.abs(M[i, j])) - change @ start)
    return np.asarray(start + np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=1e-9)[0])
