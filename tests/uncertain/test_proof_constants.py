"""Theorem 5's constants of plants that are not exactly known, against pairs of trajectories, one by one."""

import re
from functools import cache

import numpy as np
import pytest

from sampling_design import GapRange, PeriodicSchedule, Plant, UncertainParameter, UncertainPlant
from sampling_design.certificates.paper.proof_constants import constants_from_proof
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.nonlinear import examples
from tests.cases import few
from tests.oracles.inclusions import theorem_5
from tests.oracles.nonlinear import flow
from tests.rescale import Units

GAPS = GapRange(0.1, 0.5)
SWING = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
SWING_PUSHED = Plant(SWING.A, SWING.C, G=[[0.0], [1.0]])
GROWING = UncertainPlant(Plant([[0.0]], [[2.0]]), [UncertainParameter("a", -0.3, 0.2, A=[[1.0]], nominal=0.0)])


@cache
def pendulum():
    return constants_from_proof(examples.pendulum(1.0, np.pi / 3), GAPS)


@cache
def swing():
    moved = UncertainParameter("w2", -0.1, 0.1, A=[[0.0, 0.0], [-1.0, 0.0]])
    return constants_from_proof(UncertainPlant(SWING_PUSHED, [moved]), GAPS)


def values(found):
    return {each.name: each.value for each in found.constants}


def flown(starts, pushes, steps, step):
    """Two pendulums, integrated one by one, with a push for each half second."""
    paths = []
    for start, push in zip(starts, pushes, strict=True):
        x = [np.array(start)]
        for k in range(steps):
            w = push[int(k * step / 0.5)]
            x.append(flow(lambda z, u, w: [z[1], -np.sin(z[0]) + w], x[-1], None, w, step, 1e-8, 1e-9))
        paths.append(np.array(x))
    assert np.abs(np.array(paths)[..., 0]).max() < np.pi / 3
    return paths


@pytest.mark.parametrize("seed", few([0, 1], 0))
def test_no_pair_of_pendulums_violates_a_step_of_the_proof(seed):
    found, rng = pendulum(), np.random.default_rng(seed)
    step, steps = 0.1, 90
    pushes = 0.1 * rng.choice([-1.0, 1.0], (2, 18)) * (seed == 0)
    one, two = flown([[0.7, 0.1], [-0.4, 0.3]] if seed == 0 else [[0.3, 0.0], [0.3 + 1e-3, 0.0]], pushes, steps, step)
    dw = np.repeat(pushes[0] - pushes[1], 5)[: steps + 1]
    dx, dw = one - two, np.append(dw, 0.0)[: steps + 1, None]
    sampled = np.cumsum(rng.integers(1, 6, steps))
    certificate = found.inclusion
    ratios = theorem_5(
        step * np.arange(steps + 1), dx, dw, dx[:, :1], sampled, values(found), found.metric, certificate.Qw,
        certificate.Rtilde,
    )  # fmt: skip
    assert all(0 < ratio <= 1 + 1e-9 for ratio in ratios.values()), ratios


def test_lipschitz_constant_of_the_pendulum_is_nearly_attained_and_no_smaller_one_is_true():
    found, rng = pendulum(), np.random.default_rng(0)
    S = np.linalg.cholesky(found.metric).T
    x1 = rng.uniform(-np.pi / 3, np.pi / 3, 2000) * rng.choice([1.0, 1e-2], 2000)
    one = np.column_stack([x1, rng.uniform(-1, 1, 2000)])
    two = one + 1e-4 * rng.standard_normal((2000, 2))
    rates = [np.column_stack([z[:, 1], -np.sin(z[:, 0])]) for z in (one, two)]
    ratio = np.linalg.norm((rates[0] - rates[1]) @ S.T, axis=1) / np.linalg.norm((one - two) @ S.T, axis=1)
    inside = np.abs(two[:, 0]) <= np.pi / 3
    assert 0.95 * found["Lf"].value <= ratio[inside].max() <= found["Lf"].value


def test_constants_of_a_growth_rate_in_a_range_are_what_they_must_be():
    """x' = a x + w with a in [-.3, .2], y = 2x: L_f and mu are attained, and the horizon is the formula's."""
    found = constants_from_proof(GROWING, GAPS)
    c = values(found)
    assert (c["Lf"], c["mu"], c["gamma_2"]) == pytest.approx((0.3, 0.3, 2.0), rel=1e-8)
    assert found.lam == pytest.approx(4 * c["beta"] * c["gamma"] * np.exp((2 * c["Lf"] + c["eta"]) * c["t_star"]))
    assert found.horizon == pytest.approx(2 * np.log(2 * found.lam) / c["eta"])
    assert pytest.approx(2 * c["R0"] * found.inclusion.Rtilde) == found.R
    assert found.inclusion.horizon("arrival").minimum < found.horizon
    assert "of the proof (inclusion)" in found.explain()
    assert "Theorem 5" in found.claim.theorem


@pytest.mark.long
def test_a_longer_window_asks_for_a_longer_horizon():
    least = constants_from_proof(GROWING, GAPS)
    assert constants_from_proof(GROWING, GAPS, window=2 * least["T"].value).horizon > least.horizon
    with pytest.raises(UndecidedError, match=r"over windows of 1e\+06 s: constants leave doubles\. Leave `window` out"):
        constants_from_proof(GROWING, GAPS, window=1e6)


def test_too_short_a_window_proves_nothing():
    with pytest.raises(UndecidedError, match=r"over windows of 0\.001 s: it needs `window` longer than") as told:
        constants_from_proof(GROWING, GAPS, window=1e-3)
    needed = float(re.search(r"longer than ([\d.e+-]+) s", str(told.value))[1])
    assert constants_from_proof(GROWING, GAPS, window=1.001 * needed)["T"].value == pytest.approx(1.001 * needed)


@pytest.mark.parametrize("size", few([1e-12, 1e6], 1))
def test_units_change_nothing(size):
    units = Units(np.array([size, 1 / size]), np.array([size**2]), disturbances=np.array([1 / size]))
    moved = np.array([[0.0, 0.0], [-1.0 / size**2, 0.0]])
    other = UncertainPlant(units.plant(SWING_PUSHED), [UncertainParameter("w2", -0.1, 0.1, A=moved)])
    assert constants_from_proof(other, GAPS).horizon == pytest.approx(swing().horizon, rel=1e-3)


@pytest.mark.parametrize("size", few([1e3, 1e12], 1))
def test_states_in_other_units_without_scales_change_nothing(size):
    """The noises keep their units, and so do the weights: the same claim in other coordinates."""
    S = np.diag([size, 1 / size])
    back = np.diag(1 / np.diag(S))
    plant = Plant(S @ SWING.A @ back, SWING.C @ back, G=S @ SWING_PUSHED.G)
    moved = UncertainParameter("w2", -0.1, 0.1, A=S @ np.array([[0.0, 0.0], [-1.0, 0.0]]) @ back)
    found = constants_from_proof(UncertainPlant(plant, [moved]), GAPS)
    assert found.horizon == pytest.approx(swing().horizon, rel=1e-3)
    assert found.inclusion.verify().passed


def test_a_state_that_decays_fast_and_is_not_seen_keeps_condition_4_from_being_proven():
    """Backwards in time it grows as fast: Theorem 5 alone says nothing of it, `certify` does."""
    plant = Plant([[-200.0, 0.0], [0.0, 0.0]], [[0.0, 1.0]])
    model = UncertainPlant(plant, [UncertainParameter("rate", -20.0, 20.0, A=[[1.0, 0.0], [0.0, 0.0]])])
    with pytest.raises(UndecidedError, match="Try shorter gaps, a smaller region, or `certify`") as told:
        constants_from_proof(model, GAPS)
    assert told.value.details["backward"] == pytest.approx(220.0)


def test_what_does_not_fit_is_refused_in_a_sentence():
    many = [UncertainParameter(f"p{k}", -0.1, 0.1, A=np.eye(2) * 0.01) for k in range(11)]
    for plant, schedule, more, match in (
        (SWING, GAPS, {}, "`schedule` must be a Schedule or a PeriodicSchedule for a plant that is exactly known"),
        (GROWING, PeriodicSchedule([0.5]), {}, "`schedule` must be a GapRange for the constants"),
        (GROWING, GAPS, {"gain": [[1.0]]}, "`gain` must be left out"),
        (GROWING, GAPS, {"variant": "tightened"}, "`variant` must be"),
        (UncertainPlant(SWING, many), GAPS, {}, "`plant` must have few parameters"),
    ):
        with pytest.raises(ArgumentError, match=match):
            constants_from_proof(plant, schedule, **more)
