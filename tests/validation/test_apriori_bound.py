"""The worst case is attained when it is run forward, agrees with brute force, and no trial exceeds it."""

import numpy as np
import pytest

from sampling_design import MovingHorizonEstimator
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.validation.apriori_bound import apriori_bound_of, sensitivity, worst_disturbance, worst_energy
from sampling_design.validation.error_map import ErrorMap
from sampling_design.validation.scenario import ErrorSources, ScenarioBounds, draw_inputs
from sampling_design.validation.timeline import build_timeline
from tests.oracles.validation import promised
from tests.validation.plants import PLANTS, SCHEDULES, certificate

CASES = [("oscillator", "certificate"), ("unstable", "certificate"), ("two outputs", "certificate")]
CASES += [("oscillator", "paper"), ("unstable", "carried")]


def built(name, kind, duration=6.0):
    plant, bounds = PLANTS[name], ScenarioBounds.of(PLANTS[name], 0.4, 0.3, 1.5)
    options = {"cost": CostFunction(arrival="filtered") if kind == "carried" else CostFunction(form=kind)}
    noise = {"w_bound": bounds.w, "v_bound": bounds.v, "initial_error": bounds.e0}
    mhe = MovingHorizonEstimator(plant, certificate(name), **noise, **options)
    line = build_timeline(plant, SCHEDULES[name], duration, mhe.horizon)
    cost = "paper" if kind == "paper" else "certificate"
    return (
        bounds,
        line,
        ErrorMap(line, mhe, bounds),
        apriori_bound_of(certificate(name), mhe.horizon, cost, kind == "carried"),
    )


def unit_inputs(line):
    """One run for each single input."""
    n, q, p = line.plant.n_states, line.plant.n_disturbances, line.plant.n_outputs
    sizes = n, line.cells * q, line.samples.size * p
    whole = np.eye(sum(sizes))
    e0, w, v = np.split(whole, np.cumsum(sizes)[:2], axis=1)
    return ErrorSources(e0, w.reshape(-1, line.cells, q), v.reshape(-1, line.samples.size, p))


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_sensitivity_is_the_response_to_each_single_input(name, kind):
    _, line, found, _ = built(name, kind)
    response = found.apply(unit_inputs(line)).e
    first, last = line.rows.samples[[0, -1]]
    for row in (0, first, last, last - 1, line.rows.at.size - 1):
        parts = sensitivity(found, int(row))
        mine = np.concatenate([parts.e0, *parts.w, *parts.v], axis=1)
        assert mine == pytest.approx(response[:, row].T, abs=1e-11)


@pytest.mark.parametrize(("name", "kind"), CASES)
def test_worst_energy_is_the_largest_eigenvalue_and_is_attained(name, kind):
    _, line, found, apriori = built(name, kind)
    ratio, row, inputs = worst_energy(found, apriori)
    errors = found.apply(inputs)
    ratios = apriori.size(errors.e) / apriori.along(line, inputs)
    assert ratio == pytest.approx(ratios[0, row], rel=1e-9)
    assert ratios.max() <= ratio * (1 + 1e-9)
    assert ratio <= 1.0
    units = unit_inputs(line)
    response = found.apply(units).e[:, row] @ apriori.root.T
    weights = apriori.along(line, units)[:, row]
    free = weights > 0
    # with several outputs or disturbances the weights here are diagonal, so that single inputs do not interact
    full = (response[free] / weights[free, None]).T @ response[free]
    assert ratio == pytest.approx(np.linalg.eigvalsh(full)[-1], rel=1e-9)


def test_the_promise_agrees_with_plain_quadrature():
    bounds, line, found, apriori = built("two outputs", "certificate")
    inputs = draw_inputs(line, bounds, np.random.SeedSequence(4).spawn(2))
    mine = apriori.along(line, inputs)
    samples = line.times[line.samples]
    for row in (0, 7, found.timeline.rows.samples[1], found.timeline.rows.samples[-1]):
        t = found.timeline.rows.times[row]
        heard = samples if found.timeline.rows.after[row] else samples[samples < t]
        shape = apriori.prior, apriori.w, apriori.v, apriori.rate, apriori.gain
        noise = inputs.e0[1], inputs.w[1], inputs.v[1][: heard.size]
        assert mine[1, row] == pytest.approx(promised(line.times, heard, *shape, *noise, t), rel=1e-6)
    largest = apriori.at_most(
        line,
        (
            bounds.e0**2 * np.linalg.eigvalsh(apriori.prior)[-1],
            bounds.w**2 * np.linalg.eigvalsh(apriori.w)[-1],
            np.full(samples.size, bounds.v**2 * np.linalg.eigvalsh(apriori.v)[-1]),
        ),
    )
    assert np.all(mine <= largest * (1 + 1e-12))


def test_worst_push_reaches_the_support_of_the_bounds():
    bounds, _, found, apriori = built("unstable", "certificate")
    inputs = worst_disturbance(found, bounds, apriori.root)
    errors = found.apply(inputs).e
    row = int(found.timeline.rows.samples[-1])
    parts, axis = sensitivity(found, row), apriori.root[0]
    reach = sum(
        float(b.max()) * np.sum(np.linalg.norm(np.swapaxes(E, -1, -2) @ axis, axis=-1))
        for b, E in zip((bounds.e0, bounds.w, bounds.v), parts, strict=True)  # of one entry its size
    )
    assert errors[0, row] @ axis == pytest.approx(reach, rel=1e-12)
