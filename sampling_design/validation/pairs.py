"""Assumption 7 itself, inequality (16), along the worst pair of trajectories."""

from __future__ import annotations

import numpy as np

from sampling_design.certificates.exact.certificate import SampledCertificate
from sampling_design.estimators.gap_flows.cost_weights import marginal
from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.numerics.filtering import inverse_root, measurement_update, propagate, whitened
from sampling_design.numerics.linalg import symmetrise
from sampling_design.records.arrays import Array
from sampling_design.validation.scenario import ErrorSources
from sampling_design.validation.timeline import Timeline

MOST_STARTS = 80  # window starts that are tried; they are spread evenly over the break points where there are more


def _pair_end(line: Timeline, start: int, span: float) -> int:
    """Break point at which pairs from `start` end."""
    return int(np.searchsorted(line.times, line.times[start] + span, side="right")) - 1


def sides(
    line: Timeline, certificate: SampledCertificate, start: int, stop: int, pairs: ErrorSources
) -> tuple[float, float]:
    """Simulate pairs from break point `start` to `stop`; return the largest |Dx|^2_P1 over the right side of (16).

    Returns that ratio and its time. `pairs` are differences e0, w and v of r pairs from one start, along the whole
    timeline. The right side counts samples in (start, t]; before and after each sample is looked at.
    """
    root, eta = np.linalg.cholesky(certificate.P1).T, certificate.eta
    x = pairs.e0
    total = np.einsum("ri,ij,rj->r", x, certificate.P2, x)
    best = (0.0, start)
    for c in range(start, stop):
        h, w = line.lengths[c], pairs.w[:, c]
        energy = np.einsum("ri,ij,rj->r", w, certificate.Qw, w)
        total = total * np.exp(-eta * h) + energy * discounted_length(eta, h)
        x = x @ line.F[c].T + w @ line.gamma[c].T
        left = np.sum((x @ root.T) ** 2, axis=1)
        best = max(best, (float(np.max(left / total)), c + 1))
        j = line.sample_at.get(c + 1)
        if j is not None:
            measured, v = line.masks[j] > 0, pairs.v[:, j]
            y = x @ line.plant.C.T + v
            total = total + np.einsum("ri,ij,rj->r", y, marginal(certificate.R, measured), y)
            total = total + np.einsum("ri,ij,rj->r", v, marginal(certificate.Qv, measured), v)
            best = max(best, (float(np.max(left / total)), c + 1))
    return best[0], float(line.times[best[1]])


def worst_pair(line: Timeline, certificate: SampledCertificate, span: float) -> tuple[float, float, float]:
    """Return how near the worst pair comes to equality in (16), over starts, times and w constant on cells.

    Returns the ratio of both sides, the start and the time.

    Least right side that leads to Dx(t) = xi is xi'Y^-1 xi; the pair that reaches it is found by going back from the
    worst xi, and then simulated like any other.
    """
    last = max(1, _pair_end(line, 0, max(line.times[-1] - span, 0.0)))
    starts = np.unique(np.linspace(0, last - 1, min(MOST_STARTS, last)).astype(int))
    root, best = np.linalg.cholesky(certificate.P1).T, (-np.inf, 0, 0)
    for start in starts:
        before, _ = _forward(line, certificate, int(start), _pair_end(line, int(start), span))
        tops = np.linalg.eigvalsh(symmetrise(root @ np.array(before) @ root.T))[:, -1]
        at = int(np.argmax(tops))
        best = max(best, (float(tops[at]), int(start), int(start) + at))
    _, start, stop = best
    stop = max(stop, start + 1)
    ratio, time = sides(line, certificate, start, stop, _backward(line, certificate, start, stop))
    return ratio, float(line.times[start]), time


def _cell_noise(line: Timeline, certificate: SampledCertificate, c: int) -> tuple[Array, Array]:
    """Gamma and (Qw delta)^-1 of a cell."""
    unit = np.linalg.inv(certificate.Qw) / discounted_length(certificate.eta, line.lengths[c])
    return line.gamma[c], unit


def _forward(line: Timeline, certificate: SampledCertificate, start: int, stop: int) -> tuple[list[Array], list[Array]]:
    """Covariances of one start, before and after each break point."""
    Y = np.asarray(np.linalg.inv(certificate.P2))
    before, later = [Y], [Y]
    for c in range(start, stop):
        gamma, unit = _cell_noise(line, certificate, c)
        Y = propagate(np.exp(certificate.eta * line.lengths[c]) * Y, line.F[c], gamma @ unit @ gamma.T)
        before.append(Y)
        j = line.sample_at.get(c + 1)
        if j is not None:
            measured = line.masks[j] > 0
            noise = np.linalg.inv(certificate.R) + np.linalg.inv(certificate.Qv)
            Y = measurement_update(Y, whitened(line.plant.C[measured], noise[np.ix_(measured, measured)]))
        later.append(Y)
    return before, later


def _backward(line: Timeline, certificate: SampledCertificate, start: int, stop: int) -> ErrorSources:
    """The pair of least right side that ends, just before `stop`'s sample, in the worst direction."""
    (before, later), plant = _forward(line, certificate, start, stop), line.plant
    root = np.linalg.cholesky(certificate.P1).T
    values, vectors = np.linalg.eigh(symmetrise(root @ before[-1] @ root.T))
    x = np.linalg.solve(root, vectors[:, -1] * np.sqrt(values[-1]))
    w = np.zeros((1, line.cells, plant.n_disturbances))
    v = np.zeros((1, line.samples.size, plant.n_outputs))
    for c in range(stop - 1, start - 1, -1):
        if c + 1 < stop and c + 1 in line.sample_at:
            j = line.sample_at[c + 1]
            measured = line.masks[j] > 0
            R, Qv = (marginal(M, measured)[np.ix_(measured, measured)] for M in (certificate.R, certificate.Qv))
            v[0, j, measured] = -np.linalg.solve(R + Qv, R @ plant.C[measured] @ x)
        gamma, unit = _cell_noise(line, certificate, c)
        half = inverse_root(before[c + 1 - start])
        dual = half.T @ (half @ x)
        w[0, c] = unit @ gamma.T @ dual
        x = np.exp(certificate.eta * line.lengths[c]) * later[c - start] @ line.F[c].T @ dual
    return ErrorSources(x[None], w, v)
