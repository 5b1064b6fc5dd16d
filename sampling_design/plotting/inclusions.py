"""What a certificate for a plant that is not exactly known proves: P(tau) over the gap."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from sampling_design.plotting import style
from sampling_design.records.record import short
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate


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
        certificate.lam, color=style.PROVEN, linestyle="--", linewidth=1.2, label=f"lambda: {short(certificate.lam, 4)}"
    )
    style.log_axis(ax)
    ax.axvspan(
        certificate.min_gap, certificate.d_max, color=style.ALLOWED, alpha=0.12, linewidth=0, label="a sample may come"
    )
    style.time_axis(ax, certificate.plant.time_unit, "time since the last sample")
    ax.set_ylabel("information relative to P1")
    plant, longest = certificate.plant, short(certificate.d_max, 4)
    ax.set_title(f"{plant.name or 'plant'}: proven for gaps up to {longest} {plant.time_unit}", loc="left")
    style.legend(ax, 2)
    return ax
