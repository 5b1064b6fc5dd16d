"""What certificates prove: their horizons, the information of a window, and what they survive."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import shorten

import numpy as np
from matplotlib import ticker
from matplotlib.axes import Axes

from sampling_design.certificates.compare.four_horizons import FourHorizons
from sampling_design.certificates.compare.robustness import Robustness
from sampling_design.certificates.compare.tradeoff import TradeoffCurve
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.exact.information import InformationCurve, information_curve
from sampling_design.certificates.exact.window_problem import noise_input
from sampling_design.certificates.families.family_certificate import FamilyCertificate
from sampling_design.certificates.families.graphs import family_in_words
from sampling_design.numerics.linalg import discounted_flow
from sampling_design.plotting import style
from sampling_design.records.record import above, below, short
from sampling_design.records.units import readable_unit
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate


def draw_robustness(result: Robustness, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw lambda over the timing error (on `ax` alone if given), and below it over the losses."""
    if ax is not None:
        return _radii(result, ax)
    lost = ", ".join(f"{d} of any {w}" for d, w in result.tolerated)
    losses = f"losses of {lost}" if lost else "no loss"
    unit = result.certificate.plant.time_unit or ""
    words = f"survives timing errors up to {below(result.radius, 4)} {unit} and {losses}"
    # a panel of losses only where some were tried with a lambda to show
    found = any(np.isfinite(loss.lam) for loss in result.losses)
    figure, panels = style.new_figure(2 if found else 1, row_height=2.8)
    _radii(result, panels[0])
    if found:
        _losses(result, panels[1])
    figure.suptitle(words, wrap=True)
    return panels


def _radii(result: Robustness, ax: Axes) -> Axes:
    kinds = ((True, "o-", style.PROVEN, "survives, proven"), (False, "x", style.FAILED, "not proven"))
    for survives, mark, colour, words in kinds:
        some = [t for t in result.trials if t.survives == survives]
        if some:
            radii, heights = [t.family.timing_tolerance for t in some], _heights(result, [t.lam for t in some])
            ax.plot(radii, heights, mark, color=colour, label=words)
    _limit(result, ax)
    ax.axvline(result.radius, color=style.PROVEN, linewidth=1.0)
    ax.set_xlabel(style.time_label(result.certificate.plant.time_unit, "timing error of every sample"))
    style.legend(ax)
    return ax


def _losses(result: Robustness, ax: Axes) -> Axes:
    for d in sorted({loss.family.most for loss in result.losses}):
        mine = [loss for loss in result.losses if loss.family.most == d]
        heights = _heights(result, [loss.lam for loss in mine])
        for loss, height in zip(mine, heights, strict=True):
            colour = style.PROVEN if loss.survives else style.FAILED
            ax.plot([loss.family.of], [height], "o" if loss.survives else "x", color=colour)
            style.note(ax, f"{d} lost", (loss.family.of, height), (5, 3))
    _limit(result, ax)
    ax.set_xlim(1, max((loss.family.of for loss in result.losses), default=2) + 1)
    ax.xaxis.set_major_locator(ticker.MaxNLocator(integer=True))
    ax.set_xlabel("consecutive samples among which they are counted")
    return ax


def _heights(result: Robustness, lams: Sequence[float]) -> list[float]:
    """Lambdas to draw; where none was found, a mark above the limit, or above all others where that is no number."""
    top = result.limit if np.isfinite(result.limit) else max(filter(np.isfinite, lams), default=1.0)
    return [lam if np.isfinite(lam) else 1.5 * top for lam in lams]


def _limit(result: Robustness, ax: Axes) -> None:
    unit = result.certificate.plant.time_unit or ""
    label = f"limit of the horizon {short(result.length, 4)} {unit}".rstrip()
    if np.isfinite(result.limit):
        ax.axhline(result.limit, color=style.TRUTH, linestyle="--", linewidth=1.0, label=label)
    style.log_axis(ax)
    low, high = ax.get_ylim()
    ax.set_ylim(low / 1.2, high * 1.2)
    ax.set_ylabel("lambda")


def draw_inclusion(certificate: InclusionCertificate, ax: Axes | None = None) -> Axes:
    """Draw eigenvalues of P(tau) relative to P1 over the time since the last sample; samples may come in the band."""
    ax = style.new_axes(ax)
    L = np.linalg.cholesky(certificate.P1)
    half = np.linalg.solve(L, certificate.P)
    values = np.linalg.eigvalsh(np.linalg.solve(L, np.swapaxes(half, 1, 2)))
    times = np.insert(certificate.nodes, breaks := np.flatnonzero(certificate.nodes == 0)[1:], np.nan)
    for k, column in enumerate(values.T):  # a word after another, the pen lifted
        label = "eigenvalues of P(tau) relative to P1" if not k else None
        ax.plot(times, np.insert(column, breaks, np.nan), color=style.MEASURED, linewidth=1.3, marker=".", label=label)
    ax.axhline(1.0, color=style.PROVEN, linewidth=1.2, label="P1: never below")
    ax.axhline(
        certificate.lam, color=style.PROVEN, linestyle="--", linewidth=1.2, label=f"lambda: {above(certificate.lam, 4)}"
    )
    style.log_axis(ax)
    ax.axvspan(
        certificate.min_gap, certificate.d_max, color=style.ALLOWED, alpha=0.12, linewidth=0, label="a sample may come"
    )
    style.time_axis(ax, certificate.plant.time_unit, "time since the last sample")
    plant, longest = certificate.plant, short(certificate.d_max, 4)
    title = f"{plant.name or 'plant'}: proven for gaps up to {longest} {plant.time_unit}"
    return style.finished(ax, "information relative to P1", title, 2)


_COLOURS = (style.PROVEN, style.PROVEN, style.PROVEN, style.ATTAINED)  # the last is reached, the others are bounds


def draw_certificate(certificate: Certificate, ax: Axes | None = None) -> Axes:
    """Draw the information along the certificate's worst window, relative to P1."""
    return draw_information(information_curve(certificate), ax)


def draw_information(curve: InformationCurve, ax: Axes | None = None) -> Axes:
    """Draw lambda_min(Pi(t), P1) along a window; the certificate promises that it never falls below one."""
    ax = style.new_axes(ax)
    ax.plot(curve.t, curve.least, color=style.MEASURED, linewidth=1.3)
    ax.axhline(1.0, color=style.PROVEN, linewidth=1.2, label="proven for every window and time")
    at = int(np.argmin(curve.least))
    (least,) = ax.plot([curve.t[at]], [curve.least[at]], "o", color=style.ATTAINED, markerfacecolor="none")
    low, high = 0.9, 1.3 * float(curve.least.max())
    ax.set_ylim(low, high)
    style.log_axis(ax)
    ticks = style.distinct_times(curve.samples)
    foot = ax.get_xaxis_transform()
    ax.plot(ticks, np.full(ticks.size, 0.025), "|", transform=foot, color=style.TRUTH, markersize=8, label="samples")
    least.set_label(f"least: {short(curve.least[at], 5)} at {style.moment(ax, curve.t[at], curve.time_unit)}")
    style.time_axis(ax, curve.time_unit, f"time, window from {style.moment(ax, curve.start, curve.time_unit)}")
    title = "the information of a window never falls below P1"
    return style.finished(ax, "least information relative to P1", title)


def draw_tradeoff(curve: TradeoffCurve, ax: Axes | None = None) -> Axes:
    """Draw the horizon over the noise gain, one dot per certificate."""
    ax = style.new_axes(ax)
    ax.semilogx(curve.C_v, curve.horizons, "o-", color=style.PROVEN, linewidth=1.2, markersize=5, label="proven")
    for stated, gain, horizon in zip(curve.noise_gains, curve.C_v, curve.horizons, strict=True):
        label = f"at most {short(stated, 4)} times the least"
        side = gain > np.sqrt(min(curve.C_v) * max(curve.C_v))  # what is written stays within the picture
        place, ends = ((-5, -12), "right") if side else ((5, 4), "left")
        style.note(ax, label, (gain, horizon), place, ha=ends)
    ax.margins(x=0.15, y=0.15)  # room for what is written beside the dots
    style.plain_numbers(ax.xaxis)
    ax.set_xlabel("noise gain C_v")
    ylabel = f"least horizon [{curve.certificates[0].plant.time_unit}]"
    return style.finished(ax, ylabel, "a shorter horizon has a larger noise gain")


def draw_family_certificate(certificate: FamilyCertificate, ax: Axes | None = None) -> Axes:
    """Draw lambda_max(P2, Phi_s(P_u)) over the time s since a sample, one curve per node of the family's graph."""
    ax = style.new_axes(ax)
    plant, eta = certificate.plant, certificate.eta
    root, drive = np.linalg.cholesky(certificate.P2), noise_input(plant.G, certificate.Qw)
    for node, (P, top) in enumerate(zip(certificate.P, certificate.graph.tops, strict=True)):
        s = np.linspace(0.0, top, 80)
        F, W = discounted_flow(plant.A, drive @ drive.T, s, eta)
        Y = np.exp(eta * s)[:, None, None] * (F @ np.linalg.solve(P, np.swapaxes(F, 1, 2))) + W
        lam = np.linalg.eigvalsh(root.T @ Y @ root)[:, -1]
        colour, width = (style.TRUTH, 1.6) if node == 0 else (style.MEASURED, 0.9)
        label = {0: "after the window's start", 1: "after samples, one for each node"}.get(node)
        ax.plot(s, lam, color=colour, linewidth=width, alpha=0.8, label=label)
    ax.axhline(
        certificate.lam, color=style.PROVEN, linestyle="--", linewidth=1.2, label=f"lambda: {above(certificate.lam, 5)}"
    )
    ax.set_ylim(bottom=0.0)
    style.time_axis(ax, plant.time_unit, "time since the last sample")
    ax.set_ylabel("prior weight over information kept")
    family = certificate.family
    unit = "" if family.time_unit else f", times in {plant.time_unit}"
    said = f"lambda {above(certificate.lam, 4)} proven{unit}. {family_in_words(plant, family)}"
    ax.set_title(said, loc="left", fontsize="medium", wrap=True)
    style.legend(ax)
    return ax


def draw_four_horizons(horizons: FourHorizons, ax: Axes | None = None) -> Axes | style.Panels:
    """Draw the four horizons as dots on a log axis; below them, in a figure of its own, the information curve."""
    if ax is not None:
        return _dots(horizons, ax)
    if not horizons.certificate.plant.n_states:
        return _dots(horizons, style.new_axes())
    _, (top, bottom) = style.new_figure(2, ratios=(1.0, 1.3))
    return style.Panels([_dots(horizons, top), draw_certificate(horizons.certificate, bottom)])


def _dots(horizons: FourHorizons, ax: Axes) -> Axes:
    """One row each: a dot where a horizon is known, else why there is none."""
    known = [row.minimum for row in horizons.rows if row.minimum is not None]
    unit, factor = readable_unit(max(known, default=0.0), horizons.certificate.plant.time_unit)
    known = [factor * length for length in known]
    lengths = [max(length, 1e-12) for length in known] or [1.0]
    low, high = 10 ** np.floor(np.log10(0.8 * min(lengths))), 10 ** np.ceil(np.log10(1.25 * max(lengths)))
    for k, (row, colour) in enumerate(zip(horizons.rows, _COLOURS, strict=True)):
        if row.minimum is None:
            why = f"not available: {row.note}" if row.note else "not available"
            ax.text(
                1.2 * low, k, shorten(why, 90, placeholder=" ..."), va="center", fontsize="small", color=style.ALLOWED
            )
            continue
        at = max(factor * row.minimum, 1e-12)
        ax.hlines(k, low, at, color=style.ALLOWED, linewidth=0.8, linestyle=":")
        ax.plot([at], [k], "o", color=colour, markersize=9)
        style.note(ax, above(factor * row.minimum, 4), (at, k), (9, 0), va="center")
    ax.set_yticks(range(len(horizons.rows)), [row.name for row in horizons.rows])
    ax.set_ylim(len(horizons.rows) - 0.4, -0.6)
    ax.set_xscale("log")
    ax.set_xlim(low, high * (1.6 if known and max(known) > 0.5 * high else 1.0))
    enough = horizons.rows[2].minimum
    ax.set_xlabel(style.time_label(unit, "horizon M must exceed"))
    if enough is not None:
        ax.set_title(f"a horizon above {above(factor * enough, 4)} {unit} is proven to be enough", loc="left")
    return ax
