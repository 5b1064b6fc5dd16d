"""Units of states, outputs, disturbances and time change nothing in the nonlinear scheme, nor in what is seen of it.

The estimate is compared relative to its own size, up to the accuracy of the solver: IPOPT ends at `tolerance` in scaled
variables, so that no more than some hundreds of it may come back.
"""

from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.nonlinear.collocation import Collocation, WindowSolver
from sampling_design.nonlinear.detectability import check_detectability
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.model import from_linear
from tests.cases import few
from tests.rescale import Units

PLANTS = {
    "oscillator": sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]),
    "two outputs": sd.Plant(
        [[0.1, 1.0, 0.0], [-1.0, 0.0, 0.3], [0.0, 0.0, -0.2]],
        [[1.0, 0.0, 0.0], [0.0, 0.4, 1.0]],
        B=[[0.0], [1.0], [0.0]],
        G=[[0.0, 0.0], [1.0, 0.0], [0.0, 0.5]],
    ),
}
TIMES = np.array([0.0, 0.8, 1.6, 3.2, 4.0, 5.6, 6.4])
TOLERANCE = 1e-11
SAME = 1e-6


def changes(seed, plant):
    """States, outputs, inputs and disturbances by 1e-6 to 1e6, time by 1e-3 to 1e3."""
    rng = np.random.default_rng(seed)
    units = Units.drawn(rng, plant, decades=6, time_decades=3)
    return units, units.plant(plant)


def weights(plant, units=None):
    one = Units(*map(np.ones, (plant.n_states, plant.n_outputs, plant.n_inputs, plant.n_disturbances)))
    own, p = units or one, plant.n_outputs
    correlated = np.eye(p) + 0.6 * (np.ones((p, p)) - np.eye(p))
    return {
        "P2": own.state_weight(np.eye(plant.n_states) + 0.2),
        "Qw": own.disturbance_weight(np.eye(plant.n_disturbances) + 0.1),
        "R": own.output_weight(5 * correlated),
        "Qv": own.output_weight(3 * np.eye(p)),
    }


def samples(plant, seed):
    rng = np.random.default_rng(seed)
    start = 0.3 * np.arange(1.0, plant.n_states + 1)
    for k, t in enumerate(TIMES):
        y = plant.C @ plant.transition(t) @ start + 0.05 * rng.standard_normal(plant.n_outputs)
        if plant.n_outputs > 1 and k % 3 == 1:
            y[k % plant.n_outputs] = np.nan
        yield t, y, np.full(plant.n_inputs, 0.2 * (-1) ** k)


def estimates(plant, record, horizon, factor, eta, **given):
    scheme = NonlinearMovingHorizonEstimator(
        from_linear(plant),
        horizon=horizon,
        collocation=Collocation(w_step=horizon / 4, degree=3),
        cost=CostFunction(eta=eta, **given),
        solver=WindowSolver(TOLERANCE),
    )
    found = scheme.run(record)
    assert set(found.status) == {"ok"}
    return np.vstack([found.x, scheme.predict(factor * 7.0).x]), found.cost


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("seed", few(range(3), 1))
def test_units_change_no_estimate(seed, name, given):
    plant = PLANTS[name]
    units, other = changes(seed, plant)
    here = weights(plant) if given else {"Qw": weights(plant)["Qw"]}
    there = weights(plant, units) if given else {"Qw": weights(plant, units)["Qw"]}
    record = list(samples(plant, seed))
    moved = [(units.time * t, units.outputs * y, units.inputs * u) for t, y, u in record]
    x, cost = estimates(plant, record, 3.2, 1.0, 0.3, **here)
    z, again = estimates(other, moved, 3.2 * units.time, units.time, 0.3 / units.time, **there)
    np.testing.assert_allclose(z / units.states, x, rtol=SAME, atol=SAME * np.abs(x).max())
    np.testing.assert_allclose(again, cost, rtol=SAME)


@pytest.mark.long
@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("seed", range(3))
def test_units_change_nothing_that_is_seen_of_detectability(seed, name):
    plant = PLANTS[name]
    units, other = changes(seed, plant)
    schedule = sd.PeriodicSchedule([0.5, 1.1])
    found = []
    for one, factors, weighed in ((plant, None, weights(plant)), (other, units, weights(plant, units))):
        c, s = (1.0, np.ones(plant.n_states)) if factors is None else (factors.time, factors.states)
        for share in (0.02, 50.0):
            found.append(
                check_detectability(
                    from_linear(one),
                    schedule if factors is None else factors.schedule(schedule),
                    (-s, s),
                    P1=share * weighed["P2"],
                    cost=CostFunction(eta=0.1 / c, **weighed),
                    duration=4.0 * c,
                    pairs=5,
                )
            )
    for here, there in zip(found[:2], found[2:], strict=True):
        assert there.holds == here.holds
        assert there.ratios == pytest.approx(here.ratios, rel=SAME)
        assert there.least_lambda == pytest.approx(here.least_lambda, rel=SAME)
        assert there.witness.difference / units.states == pytest.approx(here.witness.difference, rel=SAME, abs=SAME)
    assert found[0].holds
    assert not found[1].holds


def test_the_scales_of_the_noise_alone_change_nothing():
    plant = from_linear(PLANTS["two outputs"])
    given, record = weights(PLANTS["two outputs"]), list(samples(PLANTS["two outputs"], 1))
    runs = []
    for scale in (1.0, 1e3, [1e-3, 1e2]):
        signals = {**plant.signals, "noises": sd.plants.Signals(plant.signals["noises"].names, (), np.ones(2) * scale)}
        own = replace(plant, signals=signals)
        runs.append(
            NonlinearMovingHorizonEstimator(
                own, horizon=3.2, collocation=Collocation(w_step=0.8), cost=CostFunction(eta=0.3, **given)
            )
            .run(record)
            .x
        )
    for run in runs[1:]:
        np.testing.assert_allclose(run, runs[0], rtol=SAME, atol=SAME)
