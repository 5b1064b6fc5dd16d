"""The trajectory of a solved window, in units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.weights import NonlinearWeights
from sampling_design.nonlinear.window_forms import WindowData, smoothed_covariances
from sampling_design.nonlinear.window_search import WindowAnswer
from sampling_design.records.arrays import Array, freeze
from sampling_design.records.declarations import Column
from sampling_design.records.record import CurveRecord, TableRecord, Variable, moment, short


@dataclass(frozen=True, eq=False, repr=False)
class SmoothedWindow(TableRecord, CurveRecord):
    """The states of a window given all of its samples, physical.

    Attributes
    ----------
    plant : NonlinearPlant
    times : (K+1,) array
        Edges of the pieces, samples among them.
    x : (K+1, n) array
    w : (K, q) array
        On each piece.
    outputs : (K+1, p) array
        h(x, u), with the fitted noise where it is kept.
    residuals : (K+1, p) array
        y minus that; NaN where nothing was measured.
    covariance : (K+1, n, n) array
        Of the linearised window without its boxes, weights read as inverse covariances and discounted to its end.
    """

    plant: NonlinearPlant
    times: Array
    x: Array
    w: Array
    outputs: Array
    residuals: Array
    covariance: Array

    _table = {
        "window": "{times[0]} to {times[-1]} {plant.time_unit}",
        "samples": "{_samples}",
        "pieces": "{w.__len__}",
        "x at its end": "{x[-1]}",
        "standard deviation there": "{deviation[-1]}",
    }

    def _samples(self) -> int:
        return int(np.isfinite(self.residuals).any(axis=1).sum())

    def __len__(self) -> int:
        return self.times.size

    @property
    def deviation(self) -> Array:
        """Standard deviations of the states, (K+1, n)."""
        return np.asarray(np.sqrt(np.einsum("kii->ki", self.covariance)))

    def _columns(self) -> dict[str, Column]:
        names, outputs = self.plant.states.names, self.plant.outputs.names
        deviation = self.deviation
        return {
            "time": self.times,
            **{name: self.x[:, i] for i, name in enumerate(names)},
            **{f"{name} deviation": deviation[:, i] for i, name in enumerate(names)},
            **{f"{name} residual": self.residuals[:, i] for i, name in enumerate(outputs)},
        }

    def _variables(self) -> dict[str, Variable]:
        names = self.plant.states.names
        return {
            "time": Variable(("time",), self.times, self.plant.time_unit),
            "state": Variable(("state",), np.array(names, dtype=str)),
            "other_state": Variable(("other_state",), np.array(names, dtype=str)),
            "output": Variable(("output",), np.array(self.plant.outputs.names, dtype=str)),
            "x": Variable(("time", "state"), self.x),
            "outputs": Variable(("time", "output"), self.outputs),
            "residuals": Variable(("time", "output"), self.residuals),
            "covariance": Variable(("time", "state", "other_state"), self.covariance),
        }

    def explain(self) -> str:
        """Say what the window found."""
        return (
            f"From {moment(self.times[0])} to {moment(self.times[-1])} {self.plant.time_unit}: the states that fit all "
            f"samples of the window best, on {len(self.w)} pieces; at its end {short(self.x[-1])}."
        )


def smoothed_window(
    plant: NonlinearPlant, weights: NonlinearWeights, data: WindowData, answer: WindowAnswer
) -> SmoothedWindow:
    """Return the physical trajectory of a window that was solved."""
    assert answer.slopes is not None
    assert answer.covariances is not None
    scale = plant.scales
    covariance = smoothed_covariances(answer.covariances, answer.slopes, data.edges, weights.eta)
    missed = np.where(data.mask > 0, data.y - answer.slopes.outputs, np.nan)
    return SmoothedWindow(
        plant=plant,
        times=freeze(data.edges),
        x=freeze(answer.solution.nodes * scale["states"]),
        w=freeze(answer.solution.point.w * scale["disturbances"]),
        outputs=freeze(answer.slopes.outputs * scale["outputs"]),
        residuals=freeze(missed * scale["outputs"]),
        covariance=freeze(covariance * scale["states"] * scale["states"][:, None]),
    )
