"""The interval of every state over the time after a sample, true at all times: what is drawn between samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.records.arrays import Array

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
