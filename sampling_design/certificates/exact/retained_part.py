"""The weights of a large plant from its slow modes; the fast ones have a Lyapunov matrix of their own.

    x = V (z_s, z_f),   A V = V diag(A_s, A_f),   P2 = V^-T diag(P_s, X_f^-1) V^-1

P_s is sought for the slow modes alone, as if the outputs showed nothing else; A_f decays at the rate by itself
(`own_decay`). What the fast modes add to the slow ones' errors is not neglected: lambda is that of the whole plant, and
is proven as all others are.

Weights for a plant that decays on its own at the rate in question: lambda is one, whatever is sampled.

    A~ X + X A~' + G Qw^-1 G' <= 0,   A~ = A + eta/2 I,   P2 = X^-1

Then Y, which starts at X, falls all along, and samples only lower it. This is one Lyapunov equation and one eigenvalue
problem for any number of states, where the search and the proof of windows are many.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag, schur, solve_continuous_lyapunov, solve_sylvester

from sampling_design.certificates.exact.canonical import ScaledProblem, canonical, evened
from sampling_design.certificates.exact.given_weights import NoiseWeights
from sampling_design.certificates.exact.weight_choice import SEARCH_WORK, ChosenWeights, WeightSearch, choose_weights
from sampling_design.certificates.exact.window_gains import WindowSet
from sampling_design.certificates.exact.window_problem import noise_input, window_problem
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.errors import SolverError, UndecidedError
from sampling_design.numerics.linalg import symmetrise
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.budget import Budget, Progress
from sampling_design.schedules.family import AnySchedule

RATES = 7  # rates that are tried where none is given, evenly on a logarithmic scale
NEAREST = 0.99  # fraction of the plant's own rate up to which one is tried
FASTER = 0.3, 1e-2  # X is that of a rate so much nearer to the plant's own, so that Y falls in every direction
ROUNDNESS = 1e-2, 1e-6
"""Shares of every state's variance that are driven beside the disturbances, which may not reach all states."""


def own_decay(
    canon: ScaledProblem, bounds: tuple[float, float], budgets: list[float], work: WorkLimit
) -> list[ChosenWeights | None]:
    """The weights at the fastest rate within `bounds` that keep each budget; None where the decay alone does not."""
    choices: list[ChosenWeights | None] = [None] * len(budgets)
    own = -2 * float(np.max(np.linalg.eigvals(canon.plant.A).real))
    fastest = min(bounds[1], NEAREST * own)
    if fastest < bounds[0]:
        return choices
    search = WeightSearch(canon, work=work)
    rates = np.geomspace(fastest, bounds[0], RATES) if fastest > bounds[0] else [fastest]
    for rate in map(float, rates):
        if search.work.over or all(choices):
            break
        try:
            rooms = [(shape, search.setting(rate).least(shape)) for shape in lyapunov_shapes(canon, rate, own)]
        except (SolverError, np.linalg.LinAlgError, ValueError):
            continue
        for k, budget in enumerate(budgets):
            allowed = (shape for shape, room in rooms if room >= -np.log(budget))
            if choices[k] is None and (shape := next(allowed, None)) is not None:
                choices[k] = ChosenWeights(shape, rate, 0.0, status="the plant decays on its own")
    return choices


def lyapunov_shapes(canon: ScaledProblem, rate: float, own: float) -> Iterator[Array]:
    """X^-1 for this rate, the roundest and the surest first."""
    n, H = canon.plant.n_states, noise_input(canon.plant.G, canon.weights[0])
    for faster in FASTER:
        A = canon.plant.A + (rate + faster * (own - rate)) / 2 * np.eye(n)
        X = solve_continuous_lyapunov(A, -H @ H.T)
        size = np.maximum(np.diagonal(X), np.finfo(float).eps * np.max(np.diagonal(X)))
        round_one = solve_continuous_lyapunov(A, -np.diag(own * size))
        for share in ROUNDNESS:
            yield symmetrise(np.linalg.inv(X + share * round_one))


LARGE = 16  # states from which on a plant is split; with fewer the search for all of them takes no longer
APART = 4.0  # so many times faster than the slow modes the fast ones decay, at least
BELOW = 0.7
"""Part of their rate up to which one is sought: nearer to it their Lyapunov matrix grows beyond any noise gain."""
SHARE, LEAST_GAIN = 0.7, 1.2
"""Part of the noise gain that the slow modes alone may have, the rest is for what the fast ones add; and the least."""


def settled_sizes(canon: ScaledProblem, eta: float) -> Array | None:
    """Base-two sizes of the states, in the caller's units, at which the long-run covariance has a unit diagonal.

    The balanced ones of states that it does not reach; None where it cannot be followed.
    """
    known = np.log2(canon.x) + np.log2(canon.sizes)
    n = canon.plant.n_states
    with np.errstate(all="ignore"):
        try:
            windows = WindowSet.of(window_problem(canon.plant, canon.schedule, np.eye(n), *canon.weights, eta))
            spread = np.mean(windows.long_run(np.diag(canon.sizes**2)), axis=0)
        except (np.linalg.LinAlgError, SolverError):
            return None
        settled = np.log2(canon.x) + np.log2(np.diagonal(spread)) / 2
    return np.where(np.isfinite(settled), settled, known) if np.isfinite(settled).any() else None


def search_units(
    plant: Plant, schedule: AnySchedule, weights: NoiseWeights, bounds: tuple[float, float]
) -> tuple[ScaledProblem, tuple[float, float]]:
    """The problem in units in which weights are sought, and the bounds of the rate (those of `canonical`) in them."""
    canon = canonical(plant, schedule, weights)
    sizes = settled_sizes(canon, bounds[0])
    if sizes is None:  # the disturbance is so weak or strong that no balance with it can be followed
        canon = canonical(plant, schedule, weights, driven=False)
        sizes = settled_sizes(canon, bounds[0])
    canon = canon if sizes is None else canonical(plant, schedule, weights, log_sizes=sizes)
    longer, canon = canon.time, evened(canon)
    return canon, (bounds[0] * canon.time / longer, bounds[1] * canon.time / longer)


def retained_part_weights(
    canon: ScaledProblem, bounds: tuple[float, float], budgets: list[float], progress: Progress | None, limit: Budget
) -> list[ChosenWeights | None]:
    """For each budget the weights from the slow modes; None where the plant is small, or has no fast modes apart."""
    nothing: list[ChosenWeights | None] = [None] * len(budgets)
    parts = _slow_and_fast_modes(canon, bounds) if canon.plant.n_states >= LARGE else None
    if parts is None:
        return nothing
    V, slow, fast, own = parts
    back, top = np.linalg.inv(V), min(bounds[1], BELOW * own)
    try:
        unit = canonical(slow, canon.schedule, canon.weights).time
        inner, between = search_units(slow, canon.schedule, canon.weights, (bounds[0] * unit, top * unit))
        found = choose_weights(inner, between, [max(SHARE * budget, LEAST_GAIN) for budget in budgets], progress, limit)
    except UndecidedError:
        return nothing
    search, made = WeightSearch(canon, work=WorkLimit(SEARCH_WORK, stop=lambda: limit.over)), nothing
    for k, (budget, choices) in enumerate(zip(budgets, found, strict=True)):
        for choice in choices[:1]:
            rate = choice.eta / inner.time
            lam = np.exp(choice.value * choice.eta)  # so much Y may rise in fast directions too
            shape = lam * next(lyapunov_shapes(replace(canon, plant=fast), rate, own))
            whole = symmetrise(back.T @ block_diag(inner.outside(choice.P2), shape) @ back)
            made[k] = search.judged(whole, rate, budget, choice)
    return made


def _slow_and_fast_modes(canon: ScaledProblem, bounds: tuple[float, float]) -> tuple[Array, Plant, Plant, float] | None:
    """V, the plants of the slow and of the fast modes, and the rate of the latter; None where none stand apart."""
    plant, size = canon.plant, 1 / canon.plant.states.scales
    A = plant.A * size[:, None] / size  # of states counted in their scales, where the noise gain is
    rates = np.sort(np.maximum(-2 * np.linalg.eigvals(A).real, bounds[0]))
    most = len(rates) // 2
    k = 1 + int(np.argmax(rates[1 : most + 1] / rates[:most]))
    if not rates[k] > APART * rates[k - 1]:
        return None
    middle = -float(np.sqrt(rates[k] * rates[k - 1])) / 2
    T, Z, count = schur(A, output="real", sort=lambda real, imaginary=0.0: real > middle)
    if count != k:
        return None
    across = solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:])
    V = Z @ np.block([[np.eye(k), across], [np.zeros((len(T) - k, k)), np.eye(len(T) - k)]]) / size[:, None]
    G, C = np.linalg.solve(V, plant.G), plant.C @ V
    slow, fast = Plant(T[:k, :k], C[:, :k], G=G[:k]), Plant(T[k:, k:], C[:, k:], G=G[k:])
    return V, slow, fast, float(rates[k])
