"""Modes: which must be observed and which decay by themselves; and a trajectory that no sample of a schedule shows."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.certificates.existence.counterexample import Counterexample
from sampling_design.numerics.linalg import expm_batch
from sampling_design.plants.modes import ModalSplit
from sampling_design.plotting import style

POINTS = 600  # points of a curve over the periods that are drawn
PERIODS, LEAST_SAMPLES = 2, 4  # periods that are drawn, more where they hold fewer samples than these


def draw_split(split: ModalSplit, ax: Axes | None = None) -> Axes:
    """Draw the eigenvalues: right of the line they must be observed, left of it they decay by themselves."""
    ax = style.new_axes(ax, width=6.0, height=3.4)
    kept = [c for c in split.clusters if c in split.retained_clusters]
    rest = [c for c in split.clusters if c not in split.retained_clusters]
    for clusters, colour, mark, label in (
        (kept, style.MEASURED, "o", "to be observed"),
        (rest, style.ALLOWED, "x", "decays by itself"),
    ):
        if clusters:
            values = np.array([c.value for c in clusters])
            ax.plot(values.real, values.imag, mark, color=colour, label=label)
            for c in clusters:
                if c.multiplicity > 1:
                    ax.annotate(f"{c.multiplicity}", (c.value.real, c.value.imag), (4, 4), textcoords="offset points")
    ax.axvline(0.0 - split.decay_rate / 2, color=style.ALLOWED, linewidth=0.8, linestyle=":")
    ax.axhline(0.0, color=style.ALLOWED, linewidth=0.4)
    ax.margins(0.12)
    unit = split.plant.time_unit
    ax.set_xlabel(f"growth [1/{unit}]")
    title = f"{split.retained.n_states} of {split.plant.n_states} modes must be observed"
    return style.finished(ax, f"frequency [rad/{unit}]", title)


def draw_counterexample(found: Counterexample, ax: Axes | None = None) -> Axes:
    """Draw the outputs while the state moves along the direction that no sample sees: zero wherever one is taken."""
    ax = style.new_axes(ax)
    schedule, C = found.schedule, found.plant.C
    rounds = max(PERIODS, -(-LEAST_SAMPLES // len(schedule)))
    end = rounds * schedule.period
    t = np.linspace(0.0, end, POINTS)
    curves = np.einsum("pn,tnm,m->tp", C, expm_batch(found.plant.A, t), np.array(found.direction))
    with np.errstate(over="ignore"):
        phase = np.exp(-0.5j * np.angle(np.sum(curves**2)))  # the phase in which the outputs are largest
    scaled = np.real(phase * curves) / found.plant.outputs.scales
    size = float(np.abs(scaled).max()) or 1.0
    names = found.plant.outputs.names
    colours = (style.TRUTH, style.ESTIMATE, style.ALLOWED)  # none says how sure anything is
    for i, name in enumerate(names):
        colour = colours[i % len(colours)]
        ax.plot(t, scaled[:, i] / size, color=colour, linewidth=1.0, label=f"{name} along the unobservable state")
    taken = np.concatenate([np.cumsum(schedule.gaps) + k * schedule.period for k in range(rounds)])
    ax.plot(taken, np.zeros_like(taken), "o", color=style.MEASURED, markersize=5, label="samples", zorder=3)
    style.time_axis(ax, found.plant.time_unit)
    ax.margins(x=0.02)
    title = "every sample is zero: these samples do not determine the state"
    return style.finished(ax, "outputs, largest 1", title, 3)
