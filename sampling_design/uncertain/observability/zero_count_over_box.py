"""How many samples in a window determine the state of every plant of a box, whatever the times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sampling_design.errors import NotObservableError, UndecidedError
from sampling_design.observability.count.zero_count import SampleCount, samples_above, zero_count_bound
from sampling_design.observability.windows.pieces import WindowPieces
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import Claim, short
from sampling_design.uncertain.box.branching import BoxBounds, branch
from sampling_design.uncertain.box.model import UP, BoxCells, BoxModel, at_parameters, bases, signs
from sampling_design.uncertain.observability.window_sigma_over_box import WindowsOverBox
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant

SLOWEST = 1e-3  # frequencies below this share of |A| count as none: the count is taken with this much more
CLOSE = 1e-3  # relative width of a bracket of frequencies
UNOBSERVABLE = 1e-12  # what is below this share of the outputs counts so: short windows see slow modes little
SECONDS = 60.0  # of each bracket, which the count needs only to the next whole number


@dataclass(frozen=True, eq=False, repr=False)
class ZeroCountOverBox(SampleCount):
    """Number of samples in a closed window of length `duration` that suffices for every plant of a box.

    Attributes
    ----------
    value : float
        At least k* of every plant, by n - 1 + T delta/(2 pi).
    samples_needed : int
        Any so many distinct times determine the state, whichever plant of the box it is.
    frequency_spread : float
        At least delta = 2 max |Im lambda| of every plant, proven [rad/time].
    worst : mapping
        Values of the parameters at which `attained` is reached.
    attained : float
        delta of that plant.
    """

    attained: float
    worst: Mapping[str, float]
    cells: int
    plant: UncertainPlant

    _answers = (
        "how many samples in a window of {_long} determine the state of every plant of a box",
        "{claim.evidence}",
        "{samples_needed} do, wherever they lie",
        "`zero_count_bound` of the plant `.worst`",
    )
    _table = {
        "k*, at most": "{value}",
        "frequency spread": "{attained:down} to {frequency_spread} rad/{plant.nominal.time_unit}",
        "fastest plant": "{worst:or the nominal plant}",
    }
    _plain = "value samples_needed frequency_spread attained duration cells worst claim"

    @property
    def _long(self) -> str:
        return f"{short(self.duration)} {self.plant.nominal.time_unit}"

    @property
    def claim(self) -> Claim:
        """What the count claims."""
        return Claim(
            f"any {self.samples_needed} distinct times in a closed window of {self._long} determine the "
            "state of every plant of the box",
            "the paper, equation (29), for each plant of the box",
            ("constant parameters in their ranges",),
            citation="paper, equation (29)",
        )

    def explain(self) -> str:
        """Say how many samples suffice, and for which plant they are needed."""
        return (
            f"Any {self.samples_needed} distinct times in a closed window of {self._long} determine the "
            f"state of every plant of the box; the fastest has {at_parameters(self.worst)}."
        )


def zero_count_over_box(plant: UncertainPlant, duration: float) -> ZeroCountOverBox:
    """Bound the zero count over a box; see `zero_count_bound`.

    Raises NotObservableError if some plant of the box has a mode that no output sees; names it; UndecidedError if this
    could not be decided.
    """
    duration = checks.nonnegative("duration", duration)
    model = BoxModel.of(plant, "zero_count_bound", duration)
    if not model.n:
        return ZeroCountOverBox(-1.0, 0, 0.0, duration, 0.0, {}, 0, plant)
    if not model.m:  # of one plant its eigenvalues say it
        own = zero_count_bound(plant.nominal, duration)
        spread, values = own.frequency_spread, model.values(model.start)
        return ZeroCountOverBox(own.value, own.samples, spread, duration, spread, values, 0, plant)
    require_every_plant_observable(model)
    found, floor = _frequencies(model)
    top = max(1 / found.lower - floor, 0.0) if found.lower > 0 else np.inf
    value = model.n - 1 + duration * top / np.pi
    needed = samples_above(value, duration)
    reached = 2 * max(1 / found.upper - floor, 0.0)
    return ZeroCountOverBox(
        float(value), needed, 2 * float(top), duration, reached, model.values(found.u), found.cells, plant
    )


def _frequencies(model: BoxModel) -> tuple[BoxBounds, float]:
    """1/(floor + max |Im lambda|) bracketed from below over the box, and that floor.

    In any coordinates |Im lambda| is at most the largest eigenvalue of (B - B*)/2i, which is convex in the parameters:
    corners decide.
    """
    floor = SLOWEST * max(float(np.linalg.norm(model.A, 2)), 1e-300)

    def judge(cells: BoxCells) -> tuple[Array, Array, Array]:
        A, C = model.at(cells.u)
        parts = cells.half[:, :, None, None] * model.parts_A
        corners = A[:, None] + np.einsum("cm,kmij->kcij", signs(model.m), parts)
        top, effect = np.full(len(A), np.inf), np.zeros((len(A), model.m + 1))
        for T in bases(A, C, np.zeros(len(A))):
            inverse = np.linalg.inv(T)
            B = inverse[:, None] @ corners @ T[:, None]
            turning = np.linalg.eigvalsh((B - np.conj(np.swapaxes(B, 2, 3))) / 2j)
            top = np.minimum(top, np.abs(turning).max(axis=(1, 2)) * UP)
            effect[:, :-1] = np.linalg.norm(inverse[:, None] @ parts @ T[:, None], axis=(2, 3))
        own = np.abs(np.linalg.eigvals(A).imag).max(axis=1)
        return 1 / (floor + np.maximum(top, own)), 1 / (floor + own), effect

    def value(u: Array, s: float, piece: int) -> float:
        A, _ = model.at(u[None])
        return float(1 / (floor + np.abs(np.linalg.eigvals(A[0]).imag).max()))

    ends = (np.zeros(1), np.zeros(1))
    return branch(BoxCells.whole(model.m), judge, value, lambda *_: False, CLOSE, SECONDS, ends, None), floor


def require_every_plant_observable(model: BoxModel) -> None:
    """Raise unless a window of evenly spaced times sees every plant of the box.

    Raises NotObservableError if a plant was found that is not seen, however long the outputs are watched;
    UndecidedError if neither was shown.
    """
    n, start = model.n, np.zeros(1)
    fastest = float(np.max(np.abs(np.linalg.eigvals(model.A)), initial=0.0)) or 1.0
    times = np.linspace(0.0, 1.0, 2 * n + 1) * n / fastest
    place = np.zeros(1, dtype=int)
    window = WindowPieces(
        start,
        start,
        place,
        place + times.size,
        times=times,
        mask=None,
        window=float(times[-1]),
        tolerance=0.0,
        start=0.0,
    )
    asked = WindowsOverBox(model, window, unobservable_share=UNOBSERVABLE)
    found = branch(asked.cells(), asked.judge, asked.value, asked.unobservable, 0.9, SECONDS, (start, start), None)
    if found.lower > 0:
        return
    values = model.values(found.u)
    if found.status == "unobservable":
        raise NotObservableError(
            f"`plant` must be observable for a zero count, for every plant of the box: at {at_parameters(values)} some "
            "mode is observable from no output."
        )
    raise UndecidedError(
        f"undecided: whether every plant of the box is observable; the nearest to not being so is at "
        f"{at_parameters(values)}. Try a smaller box.",
        parameters=values,
    )
