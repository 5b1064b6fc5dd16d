"""Two trajectories of a certified nonlinear plant never come apart further than Assumption 7 allows.

Starts near and far, disturbances that push apart along the worst direction of P(tau), gaps at both ends of the range.
A pair that leaves the region has counted until then; others are drawn, from less and less of the region, until as many
as were asked for have stayed. `python -m tests.benchmarks.inclusion_figures` flies 1000 pairs of each plant.
"""

import numpy as np
import pytest

from sampling_design import GapRange
from sampling_design.nonlinear import examples
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion
from tests.cases import few

PLANTS = {
    "pendulum": (examples.pendulum, 0.4, 1.0, 16, 5),
    "van der Pol": (examples.van_der_pol, 0.05, 1.0, 8, 5),
    "stirred reactor": (lambda: examples.stirred_reactor(2.0), 0.1, 0.2, 4, 5),
    "batch reactor": (examples.batch_reactor, 0.01, 3.0, 4, 5),
    "quadruple tank": (examples.quadruple_tank, 0.005, 5.0, 4, 5),
    "bioreactor": (examples.bioreactor, 0.02, 0.5, 4, 1),
    "unicycle": (examples.unicycle, 0.1, 0.5, 4, 3),
}
"""Plant, rate, longest gap, pieces, and gaps of a flight: a unicycle drives on, a bioreactor eats up."""
STEPS = 12
"""Of a Runge-Kutta method in each gap."""
REACHES, MOST_FLOWN = (1.0, 0.5, 0.2, 0.05), 40
"""Parts of the region that pairs begin in, in turns; pairs that are flown at most, for each that was asked for."""


def far(plant, low, high):
    """Ends of a box, a few scales where it has none."""
    return np.where(np.isfinite(low), low, -3.0), np.where(np.isfinite(high), high, 3.0)


def fly(name, pairs, seed=0):
    """The largest V(t) over what Assumption 7 allows, over all pairs and instants, pairs that stayed, pairs flown."""
    make, eta, longest, pieces, gaps = PLANTS[name]
    plant = make()
    c = certify_inclusion(plant, GapRange(longest / 10, longest), eta=eta, pieces=pieces)
    rng, worst, stayed, flown = np.random.default_rng(seed), 0.0, 0, 0
    while stayed < pairs and flown < MOST_FLOWN * pairs:
        found, inside = flight(plant, c, rng, pairs, REACHES[flown // pairs % len(REACHES)], gaps)
        worst, stayed, flown = max(worst, found), stayed + inside, flown + pairs
    return worst, stayed, flown


def flight(plant, c, rng, pairs, reach, gaps):
    """The same for pairs that begin within a part of the region, and whose inputs are drawn from such a part."""
    eta, longest, n, q = c.eta, c.family.longest, plant.n_states, plant.n_disturbances
    f = plant.f_casadi.map(pairs)
    h = plant.h_casadi.map(pairs)
    low, high = far(plant, plant.region.lower, plant.region.upper)
    ulow, uhigh = far(plant, *plant.bounds["inputs"])
    middle, half = (low + high) / 2, (high - low) / 2
    # around a point of its own: where the plant drifts, trajectories that stay begin near an end
    around = middle + rng.choice([0.0, 0.9], (pairs, 1)) * (1 - reach) * half * rng.uniform(-1, 1, (pairs, n))
    one = around + 0.7 * reach * half * rng.uniform(-1, 1, (pairs, n))
    two = one + reach * half * rng.uniform(-0.3, 0.3, (pairs, n)) * rng.choice([1e-4, 1.0], (pairs, 1))
    size = reach * plant.disturbances.scales * rng.choice([0.0, 0.02], (pairs, 1))
    inside = plant.region.holds(one) & plant.region.holds(two)
    d = np.where(inside[:, None], one - two, 0.0)
    allowed = np.einsum("ki,ij,kj->k", d, c.P2, d)
    worst = 0.0

    def slope(x, u, w):
        return np.array(f(x.T, u.T, w.T)).T

    # the first window may begin at any time since the last sample; here it begins at a sample, before it counts
    for _ in range(gaps):
        gap = longest * (1.0 if rng.random() < 0.5 else rng.uniform(0.1, 1.0))
        drawn = rng.uniform(-reach, reach, (pairs, len(ulow)))
        u = (ulow + uhigh) / 2 + drawn * (uhigh - ulow) / 2
        dt = gap / STEPS
        for k in range(STEPS):
            P = c.at(k * dt)
            push = np.sign((one - two) @ P @ c.plant.G) * (rng.random((pairs, q)) < 0.8)
            w1, w2 = size * push, -size * push
            moved = []
            for x, w in ((one, w1), (two, w2)):
                k1 = slope(x, u, w)
                k2 = slope(x + dt / 2 * k1, u, w)
                k3 = slope(x + dt / 2 * k2, u, w)
                moved.append(x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + dt * k3, u, w)))
            one, two = moved
            with np.errstate(invalid="ignore"):
                inside &= plant.region.holds(one) & plant.region.holds(two)
            dw = w1 - w2
            lost = np.einsum("ki,ij,kj->k", dw, c.Qw, dw) * (1 - np.exp(-eta * dt)) / eta
            allowed = allowed * np.exp(-eta * dt) + lost
            d = np.where(inside[:, None], one - two, 0.0)
            V = np.einsum("ki,ij,kj->k", d, c.at((k + 1) * dt), d)
            worst = max(worst, float(np.max(np.where(inside & (allowed > 0), V / np.maximum(allowed, 1e-300), 0.0))))
        x1, x2 = (np.where(inside[:, None], x, middle) for x in (one, two))
        quiet = np.zeros((pairs, plant.n_noises))
        dy = np.array(h(x1.T, u.T, quiet.T)).T - np.array(h(x2.T, u.T, quiet.T)).T
        allowed = allowed + np.einsum("ki,ij,kj->k", dy, c.Rtilde, dy)
        one, two = x1, x2
    return worst, int(inside.sum())


@pytest.mark.parametrize("name", few(["stirred reactor", "batch reactor"], 0))
def test_no_pair_of_trajectories_violates_a_nonlinear_certificate(name):
    worst, stayed, _ = fly(name, 20)
    assert stayed >= 20
    assert worst <= 1 + 1e-6
