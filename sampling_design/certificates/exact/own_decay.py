"""Weights for a plant that decays on its own at the rate in question: lambda is one, whatever is sampled.

    A~ X + X A~' + G Qw^-1 G' <= 0,   A~ = A + eta/2 I,   P2 = X^-1

Then Y, which starts at X, falls all along, and samples only lower it. This is one Lyapunov equation and one eigenvalue
problem for any number of states, where the search and the proof of windows are many.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.linalg import solve_continuous_lyapunov

from sampling_design.certificates.exact.canonical import ScaledProblem
from sampling_design.certificates.exact.weight_choice import ChosenWeights, WeightSearch
from sampling_design.certificates.exact.window_problem import noise_input
from sampling_design.checkers.work import WorkLimit
from sampling_design.errors import SolverError
from sampling_design.numerics.linalg import symmetrise
from sampling_design.records.arrays import Array

RATES = 7  # rates that are tried where none is given, evenly on a logarithmic scale
NEAREST = 0.99  # fraction of the plant's own rate up to which one is tried
FASTER = 0.3, 1e-2  # X is that of a rate so much nearer to the plant's own, so that Y falls in every direction
ROUNDNESS = 1e-2, 1e-6
"""Shares of every state's variance that are driven beside the disturbances, which may not reach all states."""


def own_decay(
    canon: ScaledProblem, bounds: tuple[float, float], budgets: list[float], work: WorkLimit
) -> list[ChosenWeights | None]:
    """The weights at the fastest rate within `bounds` that keep each budget; None where the decay alone does not."""
    found: list[ChosenWeights | None] = [None] * len(budgets)
    own = -2 * float(np.max(np.linalg.eigvals(canon.plant.A).real))
    fastest = min(bounds[1], NEAREST * own)
    if fastest < bounds[0]:
        return found
    search = WeightSearch(canon, work=work)
    rates = np.geomspace(fastest, bounds[0], RATES) if fastest > bounds[0] else [fastest]
    for rate in map(float, rates):
        if search.work.over or all(found):
            break
        try:
            rooms = [(shape, search.setting(rate).least(shape)) for shape in lyapunov_shapes(canon, rate, own)]
        except (SolverError, np.linalg.LinAlgError, ValueError):
            continue
        for k, budget in enumerate(budgets):
            kept = (shape for shape, room in rooms if room >= -np.log(budget))
            if found[k] is None and (shape := next(kept, None)) is not None:
                found[k] = ChosenWeights(shape, rate, 0.0, status="the plant decays on its own")
    return found


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
