"""What a bounded disturbance can do over one gap: bounds on omega that provably contain the truth.

A bound on w(t) is no bound on a constant w. Of all w that lead to the true displacement, the one of least cost
obeys |omega|^2 <= sup|w|^2_Qw (1 - e^{-eta h})/eta, since the true w costs no more than that; and every entry of
omega = L^+ int e^{As} G w ds lies between the support functions of the box of w, integrated over the gap.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sampling_design._linalg import expm_batch
from sampling_design.estimators.flows import Flow
from sampling_design.plants.plant import Plant

Array = npt.NDArray[np.float64]

CELL = 0.05
"""Cells of the gap have |A|_2 times length at most this; the remainder terms below are then a few per cent at worst."""

CELL_RANGE = (16, 2048)
"""Least and largest number of cells per gap."""


def support_box(plant: Plant, flow: Flow, integral: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return lower and upper bounds on omega over all w with `lower` <= w(t) <= `upper`.

    `integral` is int_0^h e^{As} G ds.

    Notes
    -----
    *Method.* With phi(s) = L^+ e^{As} G and w = middle + deviation, the middle is exact and the deviation adds at
    most int |phi| half. Per cell of length d, int |phi| <= d|phi(m)| + d^3/24 sup|phi''|, and d^2/4 |phi'(m)| more
    where phi may change sign; sup|phi''_ki| <= |(L^+ A^2)_k| e^{|A|d/2} |e^{Am} g_i|.
    """
    middle, half = (lower + upper) / 2, (upper - lower) / 2
    size = float(np.linalg.norm(plant.A, 2))
    count = int(np.clip(np.ceil(size * flow.gap / CELL), *CELL_RANGE))
    d = flow.gap / count
    moved = expm_batch(plant.A, (np.arange(count) + 0.5) * d) @ plant.G
    phi = np.abs(flow.whiten @ moved)
    slope = np.abs(flow.whiten @ plant.A @ moved)
    bend = np.linalg.norm(flow.whiten @ plant.A @ plant.A, axis=1) * np.exp(size * d / 2)
    second = bend[None, :, None] * np.linalg.norm(moved, axis=1)[:, None, :]
    turning = phi < slope * d / 2 + second * d * d / 8
    area = np.sum(d * phi + d**3 / 24 * second + np.where(turning, d * d / 4 * slope, 0.0), axis=0)
    centre, reach = flow.whiten @ integral @ middle, area @ half
    return centre - reach, centre + reach
