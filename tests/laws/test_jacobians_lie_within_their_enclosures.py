"""Every Jacobian of a region is the middle of its enclosure plus multiples in [-1, 1] of its directions."""

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import linprog

from sampling_design import NonlinearPlant
from sampling_design.checkers.inclusion_file import region
from sampling_design.checkers.parts import Plant
from sampling_design.checkers.regions import enclosed
from sampling_design.nonlinear import examples
from sampling_design.nonlinear.jacobians import boxes_of, jacobians_at
from sampling_design.nonlinear.thyroid_logs import patient_in_tube


def opposed():
    """Two functions in one row whose slopes grow together and are subtracted: their ranges must not cancel."""
    plant = NonlinearPlant(
        lambda x, u, w: [ca.exp(x[0]) - ca.sinh(x[0]) + w[0]],
        lambda x, u, v: [x[0] + v[0]],
        {"states": 1, "disturbances": 1, "outputs": 1},
    )
    return plant.in_region([0.0], [2.0])


def mixed():
    """Sums, powers and quotients in every place where derivatives may be taken relative to values."""
    plant = NonlinearPlant(
        lambda x, u, w: [
            ca.exp(x[0] - x[1]) / (2 + x[1]) - 3 * x[0] ** 2 * x[1],
            ca.sqrt(x[0] * x[1] + 1) * ca.exp(-x[0]) + (x[0] - x[1] - 4) ** 3 / (1 + x[0]) + w[0],
        ],
        lambda x, u, v: [x[0] * x[1] + v[0]],
        {"states": 2, "disturbances": 1, "outputs": 1},
    )
    return plant.in_region([0.5, 0.2], [1.5, 1.0])


PLANTS = {
    "opposed": opposed,
    "mixed": mixed,
    "reactor": examples.stirred_reactor,
    "bioreactor": examples.bioreactor,
    "patient": patient_in_tube,
}


@pytest.mark.parametrize("name", PLANTS)
def test_jacobians_lie_within_their_enclosures(name):
    plant = PLANTS[name]()
    low, high = (np.concatenate([np.ravel(box[k]) for box in boxes_of(plant)]) for k in (0, 1))
    rng, finite = np.random.default_rng(0), np.isfinite(high - low)
    width = np.where(finite, high, 0.0) - np.where(finite, low, 0.0)
    centre, n, m = plant.centre, plant.n_states, plant.n_inputs
    model = region(plant.model_to_dict(), Plant(centre.A, centre.C, centre.G, centre.time_unit))
    for share in (1.0, 0.1):
        a = np.where(finite, low, 0.0) + width * (1 - share) * rng.random(low.size)
        x = a + share * width * rng.choice([0.0, 1.0, 0.3], (6, low.size))
        a, b = np.where(finite, a, low), np.where(finite, a + share * width, high)
        truths = jacobians_at(plant, x[:, :n], x[:, n : n + m], x[:, n + m :])
        for of_f, truth in zip((True, False), truths, strict=True):
            M, E, moves = (X[..., 0, :, :] for X in enclosed(model, a[None], b[None], of_f))
            scale = np.maximum(np.abs(M) + np.abs(moves).sum(axis=0), 1e-300)
            for J in truth:
                room = (E + 1e-9 * scale) / scale
                off = (J - M) / scale
                D = (moves / scale).reshape(len(moves), J.size).T
                sides = np.concatenate([(room + off).ravel(), (room - off).ravel()])
                if not len(moves):
                    assert np.all(sides >= 0)
                    continue
                assert linprog(np.zeros(len(moves)), np.vstack([D, -D]), sides, bounds=(-1, 1)).status == 0
