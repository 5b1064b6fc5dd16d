"""What an a-priori theorem promises along a run, with the noise that really occurred."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.estimators.gap_flows.cost_weights import marginal
from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.numerics.linalg import quadratic
from sampling_design.records.arrays import Array
from sampling_design.validation.error_map import ErrorRows
from sampling_design.validation.scenario import ErrorSources
from sampling_design.validation.timeline import Timeline


@dataclass(frozen=True, eq=False)
class Promise:
    """|root e(t)|^2 <= gain (e^{-rate t}|e0|^2_prior + int e^{-rate(t-s)}|w|^2_w ds + sum e^{-rate(t-tau)}|v|^2_v).

    `theorem` names its source.
    """

    theorem: str
    root: Array
    prior: Array
    w: Array
    v: Array
    rate: float
    gain: float

    def along(self, line: Timeline, rows: ErrorRows, inputs: ErrorSources) -> Array:
        """Return the right side at every row, for every run: (r, R)."""
        samples = {int(b): j for j, b in enumerate(line.samples)}
        total = quadratic(inputs.e0, self.prior)
        energy = np.einsum("rci,ij,rcj->rc", inputs.w, self.w, inputs.w) * discounted_length(self.rate, line.lengths)
        noise = np.einsum("rji,jik,rjk->rj", inputs.v, self.sample_weights(line.masks), inputs.v)
        decay = np.exp(-self.rate * line.lengths)
        found = np.empty((rows.at.size, total.size))
        last = 0
        for row, (b, after) in enumerate(zip(rows.at, rows.after, strict=True)):
            for c in range(last, b):
                total = total * decay[c] + energy[:, c]
            last = b
            if after and int(b) in samples:
                total = total + noise[:, samples[int(b)]]
            found[row] = total
        return self.gain * found.T

    def sample_weights(self, masks: Array) -> Array:
        """Return the weight of v at each of N samples, (N, p, p): what is not measured is free."""
        return np.array([marginal(self.v, mask > 0) for mask in masks])

    def at_most(self, line: Timeline, rows: ErrorRows, energies: tuple[float, float, Array]) -> Array:
        """Return the right side at every row for the largest |e0|^2, |w|^2 and (per sample) |v|^2 in these weights."""
        e0, w, v = energies
        t, when = rows.times, line.times[line.samples]
        counted = (when[None] < t[:, None]) | ((when[None] == t[:, None]) & rows.after[:, None])
        decay = np.exp(-self.rate * np.maximum(t[:, None] - when[None], 0.0))
        total = np.exp(-self.rate * t) * e0 + w * discounted_length(self.rate, t) + np.where(counted, decay, 0.0) @ v
        return np.asarray(self.gain * total)

    def size(self, e: Array) -> Array:
        """Return |root e|^2."""
        return np.asarray(np.sum((e @ self.root.T) ** 2, axis=-1))


def promise_of(
    certificate: SampledCertificate, horizon: float, cost: str = "certificate", filtered: bool = False
) -> Promise:
    """Return what a certificate promises of an estimator with its weights.

    The improved theorem for the certificate's own cost, Thm 9 for the paper's; with the arrival cost filtered the
    full rate, whatever the horizon.
    """
    if filtered:
        inside = certificate.P2, certificate.Qw, certificate.Rtilde
        root = np.asarray(np.linalg.cholesky(certificate.P1).T)
        return Promise("filtered arrival cost, full rate", root, *inside, rate=certificate.eta, gain=1.0)
    found = certificate.horizon("improved" if cost == "certificate" else "paper", horizon)
    root = np.asarray(np.linalg.cholesky(certificate.P2 / found.lam).T)
    if cost == "certificate":
        inside = certificate.P2, certificate.Qw, certificate.Rtilde
        return Promise("improved horizon theorem", root, *inside, rate=found.eta_tilde, gain=1.0)
    inside = certificate.P2, certificate.Qw, 2 * certificate.Qv
    return Promise("Theorem 9", root, *inside, rate=found.eta_tilde, gain=4 * found.lam)
