"""Slow, plain counterparts of what validation computes: it imports nothing of the room that it judges."""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from tests.oracles.estimators import discounted_kalman


def step(A, G, w, h):
    """(e^{Ah}, int_0^h e^{As} G w ds) from one augmented exponential."""
    n = A.shape[0]
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A, G @ w
    whole = expm(block * h)
    return whole[:n, :n], whole[:n, n]


def integrate(A, G, x0, times, w):
    """States at `times` for w constant on each cell, by an adaptive integrator."""
    x, found = np.array(x0, float), [np.array(x0, float)]
    for a, b, force in zip(times[:-1], times[1:], w, strict=True):
        x = solve_ivp(lambda _, z, f=force: A @ z + G @ f, (a, b), x, rtol=1e-11, atol=1e-13).y[:, -1]
        found.append(x)
    return np.array(found)


def moving_horizon(A, C, G, P2, Qw, Rt, eta, horizon, samples, y):
    """Estimates at the samples of the estimator with the certificate's cost, prior 0 at time 0, half-open windows."""
    online, found = [], []
    for i, t in enumerate(samples):
        s = t - horizon
        if s <= 0:
            start, prior, first = 0.0, np.zeros(A.shape[0]), 0
        else:
            before = [k for k in range(i) if samples[k] <= s]
            at, x = (samples[before[-1]], online[before[-1]]) if before else (0.0, np.zeros(A.shape[0]))
            start, prior, first = s, expm(A * (s - at)) @ x, len(before)
        x, _, _ = discounted_kalman(A, C, G, P2, Qw, Rt, eta, prior, start, samples[first : i + 1], y[first : i + 1])
        online.append(x)
        found.append(x)
    return np.array(found)


def promised(times, samples, prior, Qw, weight, rate, gain, e0, w, v, t):
    """gain (e^{-rate t}|e0|^2 + int e^{-rate(t-s)}|w|^2 ds + sum over samples in [0, t]), w constant on cells."""
    total = np.exp(-rate * t) * (e0 @ prior @ e0)
    for a, b, force in zip(times[:-1], times[1:], w, strict=True):
        if b <= t + 1e-12:
            s = np.linspace(a, b, 2001)
            middle = (s[1:] + s[:-1]) / 2
            total += np.sum(np.exp(-rate * (t - middle))) * (s[1] - s[0]) * (force @ Qw @ force)
    for tau, noise in zip(samples, v, strict=True):
        if tau <= t:
            total += np.exp(-rate * (t - tau)) * (noise @ weight @ noise)
    return gain * total
