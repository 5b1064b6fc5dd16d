"""What a certificate guarantees of an estimator a priori, and the worst that can be done to it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.estimators.gap_flows.cost_weights import marginal
from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.numerics.linalg import quadratic
from sampling_design.records.arrays import Array
from sampling_design.validation.error_map import ErrorMap, SolveWindow
from sampling_design.validation.scenario import ErrorSources, ScenarioBounds, most_along
from sampling_design.validation.timeline import Timeline


@dataclass(frozen=True, eq=False)
class AprioriBound:
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

    def along(self, line: Timeline, inputs: ErrorSources) -> Array:
        """Return the right side at every row, for every run: (r, R)."""
        total = quadratic(inputs.e0, self.prior)
        energy = np.einsum("rci,ij,rcj->rc", inputs.w, self.w, inputs.w) * discounted_length(self.rate, line.lengths)
        noise = np.einsum("rji,jik,rjk->rj", inputs.v, self.sample_weights(line.masks), inputs.v)
        decay = np.exp(-self.rate * line.lengths)
        radii = np.empty((line.rows.at.size, total.size))
        last = 0
        for row, (b, after) in enumerate(zip(line.rows.at, line.rows.after, strict=True)):
            for c in range(last, b):
                total = total * decay[c] + energy[:, c]
            last = b
            if after and int(b) in line.sample_at:
                total = total + noise[:, line.sample_at[int(b)]]
            radii[row] = total
        return self.gain * radii.T

    def sample_weights(self, masks: Array) -> Array:
        """Return the weight of v at each of N samples, (N, p, p): what is not measured is free."""
        return np.array([marginal(self.v, mask > 0) for mask in masks])

    def at_most(self, line: Timeline, energies: tuple[float, float, Array]) -> Array:
        """Return the right side at every row for the largest |e0|^2, |w|^2 and (per sample) |v|^2 in these weights."""
        e0, w, v = energies
        t, when = line.rows.times, line.times[line.samples]
        counted = (when[None] < t[:, None]) | ((when[None] == t[:, None]) & line.rows.after[:, None])
        decay = np.exp(-self.rate * np.maximum(t[:, None] - when[None], 0.0))
        total = np.exp(-self.rate * t) * e0 + w * discounted_length(self.rate, t) + np.where(counted, decay, 0.0) @ v
        return np.asarray(self.gain * total)

    def size(self, e: Array) -> Array:
        """Return |root e|^2."""
        return np.asarray(np.sum((e @ self.root.T) ** 2, axis=-1))


def apriori_bound_of(
    certificate: SampledCertificate, horizon: float, cost: str = "certificate", filtered: bool = False
) -> AprioriBound:
    """Return what a certificate promises of an estimator with its weights.

    The improved theorem for the certificate's own cost, Thm 9 for the paper's; with the arrival cost filtered the
    full rate, whatever the horizon.
    """
    if filtered:
        inside = certificate.P2, certificate.Qw, certificate.Rtilde
        root = np.asarray(np.linalg.cholesky(certificate.P1).T)
        return AprioriBound("filtered arrival cost, full rate", root, *inside, rate=certificate.eta, gain=1.0)
    promised = certificate.horizon("improved" if cost == "certificate" else "paper", horizon)
    root = np.asarray(np.linalg.cholesky(certificate.P2 / promised.lam).T)
    if cost == "certificate":
        inside = certificate.P2, certificate.Qw, certificate.Rtilde
        return AprioriBound("improved horizon theorem", root, *inside, rate=promised.eta_tilde, gain=1.0)
    inside = certificate.P2, certificate.Qw, 2 * certificate.Qv
    return AprioriBound("Theorem 9", root, *inside, rate=promised.eta_tilde, gain=4 * promised.lam)


MOST_TARGETS = 60  # rows at which the worst energy is computed; they are spread evenly where there are more


def sensitivity(error_map: ErrorMap, row: int) -> ErrorSources:
    """Return what the error at a row is made of, by going back from it through the windows in charge.

    e(row) = e0 E0' + sum_c E_w,c w_c + sum_j E_v,j v_j.
    """
    line = error_map.timeline
    n, q, p = line.plant.n_states, line.plant.n_disturbances, line.plant.n_outputs
    result = ErrorSources(np.zeros((n, n)), np.zeros((line.cells, n, q)), np.zeros((line.samples.size, n, p)))
    b, after, functional = int(line.rows.at[row]), bool(line.rows.after[row]), np.eye(n)
    while True:
        if after and b in line.sample_at:
            window = error_map.windows[error_map.place[b]]
            functional = _through_window(error_map, window, functional, result)
            if window.given:
                break
            b = int(line.events[window.start])
            continue
        if b == 0:
            break
        functional = _through_cell(error_map, b - 1, functional, result)
        b, after = b - 1, True
    result.e0[:] = functional
    return result


def _through_cell(error_map: ErrorMap, c: int, functional: Array, result: ErrorSources) -> Array:
    result.w[c] -= functional @ error_map.timeline.gamma[c]
    return np.asarray(functional @ error_map.timeline.F[c])


def _through_window(error_map: ErrorMap, window: SolveWindow, functional: Array, result: ErrorSources) -> Array:
    events = error_map.timeline.events
    for k in range(window.end, window.start - 1, -1):
        if k in window.absorbs:
            j, gain, _ = window.absorbs[k]
            result.v[j] += functional @ gain @ error_map.weigh[j]
            functional = functional - functional @ gain @ error_map.H[j]
        if k > window.start:
            for c in range(events[k] - 1, events[k - 1] - 1, -1):
                functional = _through_cell(error_map, c, functional, result)
    return functional


def worst_energy(error_map: ErrorMap, apriori: AprioriBound) -> tuple[float, int, ErrorSources]:
    """Return the worst ratio of |e|^2 to what is promised, over all e0, v and w constant on cells; its row and inputs.

        max e'P e / (|e0|^2 + int |w|^2 + sum |v|^2, each discounted)  =  lambda_max(P^1/2 (sum E D^-1 E') P^1/2)

    At most MOST_TARGETS rows are looked at, always the last ones before and after a sample among them.
    """
    ends = np.sort(np.concatenate([error_map.timeline.rows.samples, error_map.timeline.rows.samples - 1]))
    chosen = ends[np.unique(np.linspace(0, ends.size - 1, min(MOST_TARGETS, ends.size)).astype(int))]
    best: tuple[float, int, Array, ErrorSources] | None = None
    for row in chosen:
        parts = sensitivity(error_map, int(row))
        terms = _bound_terms(error_map, apriori, int(row), parts)
        total = sum(np.einsum("kab,kbc,kdc->ad", E, D, E) for E, D in terms)
        values, vectors = np.linalg.eigh(apriori.root @ total @ apriori.root.T)
        if best is None or values[-1] > best[0]:
            best = float(values[-1]), int(row), apriori.root.T @ vectors[:, -1], parts
    assert best is not None
    ratio, row, direction, parts = best
    e0, w, v = (
        D @ (np.swapaxes(E, -1, -2) @ direction)[..., None] for E, D in _bound_terms(error_map, apriori, row, parts)
    )
    return ratio, row, ErrorSources(e0[..., 0], *(part[None, ..., 0] for part in (w, v)))


def _bound_terms(
    error_map: ErrorMap, apriori: AprioriBound, row: int, parts: ErrorSources
) -> list[tuple[Array, Array]]:
    """Each part, a stack of matrices, with the inverses of its weights in the promise at that row."""
    line, t = error_map.timeline, error_map.timeline.rows.times[row]
    inside, rate = line.times[1:] <= t * (1 + 1e-15), apriori.rate
    faded = np.exp(-rate * np.maximum(t - line.times[1:], 0)) * discounted_length(rate, line.lengths)
    cost = np.where(inside, faded, np.inf)
    decay = np.exp(rate * np.maximum(t - line.times[line.samples], 0))
    unit = np.linalg.inv(apriori.w)
    weights = apriori.sample_weights(line.masks)
    blank = np.einsum("ja,ab->jab", 1 - line.masks, np.eye(line.masks.shape[1]))
    return [
        (parts.e0[None], np.linalg.inv(apriori.prior)[None] * np.exp(rate * t) / apriori.gain),
        (parts.w, unit / cost[:, None, None] / apriori.gain),
        (parts.v, np.linalg.inv(weights + blank) * decay[:, None, None] / apriori.gain),
    ]


def worst_disturbance(error_map: ErrorMap, bounds: ScenarioBounds, root: Array) -> ErrorSources:
    """Return the inputs within the bounds that make the last error largest, along each axis of |root e|, both ends.

    A linear functional over boxes and balls is largest at a corner or on the sphere, cell by cell: bang-bang.
    """
    rows = [int(error_map.timeline.rows.samples[-1]), int(error_map.timeline.rows.at.size - 1)]
    runs = []
    for row in rows:
        parts = sensitivity(error_map, row)
        for axis in root:
            aims = [np.swapaxes(E, -1, -2) @ axis for E in parts]
            runs.append([most_along(b, aim) for b, aim in zip((bounds.e0, bounds.w, bounds.v), aims, strict=True)])
    e0, w, v = (np.array(part) for part in zip(*runs, strict=True))
    return ErrorSources(e0, w, v * error_map.timeline.masks)
