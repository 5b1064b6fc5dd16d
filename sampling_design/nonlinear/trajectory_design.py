"""When to sample plants that vary in time: expected accuracy of an ensemble, sigma, a design beside even spacing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._checks import freeze
from sampling_design._door import door
from sampling_design._record import Record, short
from sampling_design.errors import ArgumentError
from sampling_design.plants.time_varying import TimeVaryingPlant, TransitionTable

Array = npt.NDArray[np.float64]
Criterion = Literal["mean", "worst"]

SWEEPS = 20
"""Rounds of exchanges at most."""

BETTER = 1e-9
"""An exchange must gain this share."""


@dataclass(frozen=True, eq=False, repr=False)
class TrajectoryDesign(Record):
    """Sample times for an ensemble of plants that vary in time, beside even spacing.

    Attributes
    ----------
    times : (N,) array [time]
    accuracy : float
        Root of the trace of the covariance of the scaled state at the horizon's end, mean or worst of the ensemble.
    even_times, even_accuracy
        The better one of two even spacings: over the whole candidate range, and in the middle of equal parts.
    accuracies, even_accuracies : (M,) arrays
        Of each member.
    sigma, even_sigma : (M,) arrays
        Least singular value of the scaled rows C(t) Phi(t, 0).
    criterion : str
    closed : bool
        Whether no single exchange improves it any more.
    error : float
        How far off the transitions are, by a closer integration: an estimate.
    time_unit : str
    """

    times: Array
    accuracy: float
    even_times: Array
    even_accuracy: float
    accuracies: Array
    even_accuracies: Array
    sigma: Array
    even_sigma: Array
    criterion: Criterion
    closed: bool
    error: float
    time_unit: str

    @property
    def gain(self) -> float:
        """By which share the design undercuts even spacing; 0 where even spacing is as good."""
        return 1 - self.accuracy / self.even_accuracy

    def _rows(self) -> list[tuple[str, str]]:
        return [
            ("times", f"{short(self.times)} {self.time_unit}"),
            (f"accuracy ({self.criterion} of {self.accuracies.size})", short(self.accuracy)),
            ("even spacing", f"{short(self.even_accuracy)} (the design is {short(100 * self.gain, 3)} % below)"),
            ("least sigma", f"{short(self.sigma.min())}, even {short(self.even_sigma.min())}"),
            ("transitions off by", short(self.error)),
        ]

    def explain(self) -> str:
        """Say what the design gains over even spacing."""
        if self.gain < 1e-3:
            return f"Even spacing is as good: {short(self.even_accuracy)} with {self.times.size} samples."
        worse = int((self.accuracies > self.even_accuracies).sum())
        text = f"{self.times.size} samples at {short(self.times)} {self.time_unit} reach {short(self.accuracy)}, even "
        text += f"spacing {short(self.even_accuracy)}: {100 * self.gain:.0f} % less, "
        return text + f"and more for {worse} of {self.accuracies.size} trajectories. Expected, not guaranteed."


@door
def design_along(
    plants: TimeVaryingPlant | Sequence[TimeVaryingPlant],
    count: int,
    *,
    prior: npt.ArrayLike,
    v: npt.ArrayLike,
    w: npt.ArrayLike | None = None,
    candidates: npt.ArrayLike | int = 60,
    criterion: Criterion = "mean",
) -> TrajectoryDesign:
    """Choose sample times for plants that vary in time, for the accuracy expected at the end of the horizon.

        accuracy = sqrt(trace Y(T)),    Y' = A Y + Y A' + G S G',    Y^-1 <- Y^-1 + C' R^-1 C at a sample

    Parameters
    ----------
    plants : TimeVaryingPlant, or a list of them with one horizon
        An ensemble of trajectories: one alone is the wrong criterion where the start is not known.
    count : int
        Samples.
    prior : (n,) array
        Standard deviations of the first state, physical.
    v : (p,) array
        Of the noise of a sample.
    w : (q,) array, optional
        Square roots of the intensities of white noise on the disturbance; default none.
    candidates : (K,) array or int
        Times that may be chosen, or their number, evenly over the horizon from 0.
    criterion : "mean" or "worst"
        Over the ensemble.

    Returns
    -------
    TrajectoryDesign

    Raises
    ------
    ArgumentError
        If a size or the criterion is out of range, or horizons differ.

    Notes
    -----
    *Claim.* Never worse than even spacing in its criterion; no single exchange of a sample improves it where `closed`.
    No optimum is proven, and the accuracy is expected, not guaranteed.
    *Method.* Exchanges of one sample at a time, all candidates at once, from both even spacings and a greedy choice.

    Examples
    --------
    >>> swing = TimeVaryingPlant(lambda t: [[0.0, 1.0], [-1 - 0.5 * np.cos(t), 0.0]], lambda t: [[1.0, 0.0]], horizon=6)
    >>> found = design_along(swing, 3, prior=[1.0, 1.0], v=[0.1], candidates=13)
    >>> bool(found.accuracy <= found.even_accuracy)
    True
    """
    members = [plants] if isinstance(plants, TimeVaryingPlant) else list(plants)
    if not members or len({plant.horizon for plant in members}) > 1:
        raise ArgumentError("`plants` must be one or more plants with one horizon.")
    first, number = members[0], _checks.whole("count", count, 1)
    if isinstance(candidates, int):
        grid = np.linspace(0.0, first.horizon, _checks.whole("candidates", candidates, 2))
    else:
        grid = _checks.increasing("candidates", candidates)
    if number > grid.size:
        raise ArgumentError(f"`count` must be at most the {grid.size} candidates, got {number}.")
    table = _Candidates(members, grid, prior, v, w)
    even = min((_even(grid, number, shift) for shift in (False, True)), key=lambda chosen: table.one(chosen, criterion))
    starts = [_even(grid, number, False), _even(grid, number, True), _greedy(table, number, criterion)]
    ends = [_exchanged(table, start, criterion) for start in starts]
    best, closed = min(ends, key=lambda end: table.one(end[0], criterion))
    values, others = (table.accuracies(table.masks([chosen]))[0] for chosen in (best, even))
    return TrajectoryDesign(
        times=freeze(grid[best]),
        accuracy=table.one(best, criterion),
        even_times=freeze(grid[even]),
        even_accuracy=table.one(even, criterion),
        accuracies=freeze(values),
        even_accuracies=freeze(others),
        sigma=freeze(table.sigmas(best)),
        even_sigma=freeze(table.sigmas(even)),
        criterion=criterion,
        closed=closed,
        error=max(motion.error for motion in table.motions),
        time_unit=first.time_unit,
    )


class _Candidates:
    """Everything that one choice of times needs, computed once for the candidates."""

    def __init__(
        self, members: list[TimeVaryingPlant], grid: Array, prior: object, v: object, w: npt.ArrayLike | None
    ) -> None:
        self.grid = grid
        instants = np.unique(np.concatenate([[0.0], grid, [members[0].horizon]]))
        self.at = np.searchsorted(instants, grid)
        self.motions: list[TransitionTable] = [plant.motion(instants, w) for plant in members]
        first = members[0]
        start = _checks.vector("prior", prior, first.n_states) / first.states.scales
        noise = _checks.vector("v", v, len(first.outputs)) / first.outputs.scales
        if np.any(start <= 0) or np.any(noise <= 0):
            raise ArgumentError("`prior` and `v` must hold positive standard deviations.")
        self.start, self.noise = np.diag(start**2), np.diag(noise**2)
        self.F, self.W, self.C = (np.array([getattr(m, key) for m in self.motions]) for key in ("F", "W", "C"))

    def masks(self, choices: Sequence[npt.NDArray[np.intp]]) -> npt.NDArray[np.bool_]:
        """Which instants each choice of candidates samples, (S, K)."""
        found = np.zeros((len(choices), self.C.shape[1]), dtype=bool)
        for row, chosen in zip(found, choices, strict=True):
            row[self.at[chosen]] = True
        return found

    def accuracies(self, masks: npt.NDArray[np.bool_]) -> Array:
        """Root of the trace at the end, (S, M)."""
        S, M, n = len(masks), len(self.motions), self.start.shape[0]
        Y = np.broadcast_to(self.start, (S, M, n, n)).copy()
        for k in range(masks.shape[1]):
            if k:
                Y = self.F[:, k - 1] @ Y @ np.swapaxes(self.F[:, k - 1], 1, 2) + self.W[:, k - 1]
            taken = masks[:, k]
            if taken.any():
                C = self.C[:, k]
                CY = C @ Y[taken]
                gain = np.swapaxes(np.linalg.solve(CY @ np.swapaxes(C, 1, 2) + self.noise, CY), -1, -2)
                rest = np.eye(n) - gain @ C
                Y[taken] = rest @ Y[taken] @ np.swapaxes(rest, -1, -2) + gain @ self.noise @ np.swapaxes(gain, -1, -2)
        return np.asarray(np.sqrt(np.trace(Y, axis1=2, axis2=3)))

    def values(self, choices: Sequence[npt.NDArray[np.intp]], criterion: Criterion) -> Array:
        """The criterion of each choice."""
        found = self.accuracies(self.masks(choices))
        return np.asarray(found.mean(axis=1) if criterion == "mean" else found.max(axis=1))

    def one(self, chosen: npt.NDArray[np.intp], criterion: Criterion) -> float:
        """The criterion of one choice."""
        return float(self.values([chosen], criterion)[0])

    def sigmas(self, chosen: npt.NDArray[np.intp]) -> Array:
        """Least singular value of the rows C(t) Phi(t, 0) of a choice, for each member."""
        found = []
        for F, C in zip(self.F, self.C, strict=True):
            flow, rows, wanted = np.eye(F.shape[1]), [], set(self.at[chosen].tolist())
            for k in range(len(C)):
                flow = F[k - 1] @ flow if k else flow
                rows += [C[k] @ flow] if k in wanted else []
            stacked = np.vstack(rows)
            few = len(stacked) < flow.shape[0]
            found.append(0.0 if few else float(np.linalg.svd(stacked, compute_uv=False)[-1]))
        return np.array(found)


def _even(grid: Array, count: int, middles: bool) -> npt.NDArray[np.intp]:
    """Candidates nearest to even spacing: over the whole range, or in the middle of equal parts."""
    low, high = grid[0], grid[-1]
    shares = (np.arange(count) + 0.5) / count if middles else np.linspace(0.0, 1.0, count) if count > 1 else np.ones(1)
    wanted = low + shares * (high - low)
    chosen = np.unique(np.abs(grid[:, None] - wanted).argmin(axis=0))
    free = np.setdiff1d(np.arange(grid.size), chosen)
    return np.sort(np.concatenate([chosen, free[: count - chosen.size]])).astype(np.intp)


def _greedy(table: _Candidates, count: int, criterion: Criterion) -> npt.NDArray[np.intp]:
    """One sample after the other, each where it helps most."""
    chosen = np.zeros(0, dtype=np.intp)
    for _ in range(count):
        free = np.setdiff1d(np.arange(table.grid.size), chosen)
        choices = [np.append(chosen, k) for k in free.tolist()]
        chosen = choices[int(np.argmin(table.values(choices, criterion)))]
    return np.sort(chosen)


def _exchanged(
    table: _Candidates, chosen: npt.NDArray[np.intp], criterion: Criterion
) -> tuple[npt.NDArray[np.intp], bool]:
    """Exchange one sample at a time as long as that helps; whether it ended by itself."""
    value = table.one(chosen, criterion)
    for _ in range(SWEEPS):
        before = value
        for place in range(chosen.size):
            rest = np.delete(chosen, place)
            free = np.setdiff1d(np.arange(table.grid.size), rest)
            choices = [np.append(rest, k) for k in free.tolist()]
            values = table.values(choices, criterion)
            k = int(np.argmin(values))
            if values[k] < value * (1 - BETTER):
                chosen, value = choices[k], float(values[k])
        if value == before:
            return np.sort(chosen), True
    return np.sort(chosen), False
