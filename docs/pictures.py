"""The picture that opens the documentation: what is measured, what is proven, what is estimated."""

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from sampling_design import MovingHorizonEstimator, PeriodicSchedule, certify, window_sigma
from sampling_design.plants import library
from sampling_design.plotting.style import ATTAINED, ESTIMATE, FAILED, MEASURED, PROVEN, TRUTH

PERIOD = 2 * np.pi
WINDOW = 4.2


def one_picture() -> Figure:
    """Return samples, sigma over the window's position, and an estimate with its radius, one below the other."""
    plant = library.oscillator()
    schedule = PeriodicSchedule.from_times([0.6, 1.4, 3.4, 5.0], PERIOD)
    figure, axes = plt.subplots(3, 1, figsize=(9, 4.3), sharex=True, layout="constrained", height_ratios=(1, 1.1, 1.7))
    _samples(axes[0], schedule)
    _sigma(axes[1], plant, schedule)
    _estimate(axes[2], plant, schedule)
    axes[2].set_xlabel("time [s]")
    axes[2].set_xlim(0, 3 * PERIOD)
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    plt.close(figure)
    return figure


def _samples(ax, schedule) -> None:
    times = schedule.between(0, 3 * PERIOD).times
    ax.vlines(times, 0, 1, color=MEASURED, lw=2)
    ax.plot(times, np.ones(times.size), "o", color=MEASURED, ms=5)
    ax.set(yticks=[], ylim=(0, 1.3), ylabel="samples")
    ax.set_title("1  when to measure", loc="left", fontsize=9.5, fontweight="bold")


def _sigma(ax, plant, schedule) -> None:
    found = window_sigma(plant, schedule, WINDOW)
    pathological = PeriodicSchedule.from_times([0.6, 0.6 + np.pi], PERIOD)
    t = np.linspace(WINDOW, 3 * PERIOD, 900)
    for plan, colour, label in ((schedule, ATTAINED, "this schedule"), (pathological, FAILED, "half a period apart")):
        values = [_at(plant, plan, end) for end in t]
        ax.plot(t, values, color=colour, lw=1.4, label=label)
    ax.hlines(found.lower, WINDOW, 3 * PERIOD, color=PROVEN, ls="--", lw=1.4, label="proven, for every window")
    ax.set(ylim=(-0.1, 2.2), ylabel=r"$\sigma$ of the window")
    ax.set_title("2  what that proves", loc="left", fontsize=9.5, fontweight="bold")
    ax.legend(ncols=3, fontsize=7.5, frameon=False, loc="upper left")


def _at(plant, schedule, end) -> float:
    times = schedule.window(end, WINDOW).times - (end - WINDOW)
    if times.size < 2:
        return 0.0
    rows = np.vstack([plant.C @ plant.transition(s) for s in times])
    return float(np.linalg.svd(rows, compute_uv=False)[1])


def _estimate(ax, plant, schedule) -> None:
    rng = np.random.default_rng(1)
    grid = np.arange(0, 3 * PERIOD, 0.02)
    times = schedule.between(0, 3 * PERIOD).times
    x, states, step = np.array([1.0, 0.3]), [], plant.transition(0.02)
    for t in grid:
        states.append(x)
        x = step @ x + 0.02 * 0.05 * np.array([0.0, np.sin(2.3 * t)])
    truth = np.array(states)
    drawn, velocity = grid[::2], [[0.0, 1.0]]  # two pixels apart
    certificate = certify(plant, schedule)
    mhe = MovingHorizonEstimator(plant, certificate, w_bound=0.05, v_bound=0.1, initial_error=1.5)
    centre, radius, k = np.zeros(drawn.size), np.zeros(drawn.size), 0
    heard = []
    for i, t in enumerate(drawn):
        while k < times.size and times[k] <= t:
            y = np.interp(times[k], grid, truth[:, 0]) + rng.uniform(-0.1, 0.1)
            mhe.update(times[k], [y])
            heard.append(y)
            k += 1
        now = mhe.predict(t)
        centre[i], radius[i] = now.x[1], now.interval(velocity).radii_from(now.x[1:])[0]
    ax.fill_between(drawn, centre - radius, centre + radius, color=PROVEN, alpha=0.18, lw=0, label="guaranteed")
    ax.plot(grid, truth[:, 1], color=TRUTH, lw=1.2, label="velocity, never measured")
    ax.plot(drawn, centre, color=ESTIMATE, lw=1.4, label="estimate")
    ax.plot(times[: len(heard)], heard, "o", color=MEASURED, ms=4, label="position, measured")
    ax.set(ylim=(-2.6, 2.9), ylabel="state")
    ax.set_title("3  what the state is, with a radius that holds", loc="left", fontsize=9.5, fontweight="bold")
    ax.legend(ncols=4, fontsize=7.5, frameon=False, loc="upper right")
