"""A nonlinear estimate's proven radius holds the truth, whatever the noise does within its bounds.

`python -m tests.laws.test_the_radius_of_a_nonlinear_estimate_holds_the_truth 200` tries so many signals.
"""

import sys
from functools import cache
from itertools import pairwise

import casadi
import numpy as np
import pytest

from sampling_design import GapRange, Plant
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.online.estimator import GuaranteeWarning
from sampling_design.nonlinear.collocation import Collocation, WindowSolver
from sampling_design.nonlinear.examples import pendulum
from sampling_design.nonlinear.inclusion_bound import InclusionBound
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.model import NonlinearPlant, from_linear
from sampling_design.nonlinear.simulation import simulate
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests.cases import few

W, V, FIRST = 0.05, 0.02, 0.4
PLANT = pendulum().with_bounds(disturbances=(-W, W), noises=(-V, V))
STEPS = 4


@cache
def certificate():
    return certify_inclusion(PLANT, GapRange(0.4, 0.8), eta=0.4, pieces=8)


@cache
def scheme():
    return NonlinearMovingHorizonEstimator(
        PLANT, certificate(), initial_error=FIRST, prior=[0.6, 0.0], collocation=Collocation(0.5, 3, capacity=28)
    )


def one(seed, estimator):
    """Worst ratio of an error to its radius, over samples and in between, and the radii."""
    rng = np.random.default_rng(seed)
    gaps = rng.uniform(0.4, 0.8, 9)
    samples = np.concatenate([[0.0], np.cumsum(gaps)]) + (0.0 if seed % 2 else 0.3)
    grid = np.unique(np.concatenate([[0.0], *(np.linspace(a, b, STEPS) for a, b in pairwise(samples))]))
    push = (
        W * np.sign(np.sin(grid * rng.uniform(0.5, 2.0)) + 0.3) if seed % 3 else W * rng.choice([-1.0, 1.0], grid.size)
    )
    start = np.array([0.6, 0.0]) + FIRST * np.array([np.cos(seed), np.sin(seed)])
    truth = dict(zip(grid.tolist(), simulate(PLANT, start, grid, w=push[:, None]), strict=True))
    estimator.start([0.6, 0.0])
    ratios, radii, flags = [], [], []
    for t in grid.tolist():
        if np.any(np.abs(samples - t) < 1e-12):
            found = estimator.update(t, truth[t][:1] + V * rng.choice([-1.0, 1.0]))
        else:
            found = estimator.predict(t)
        assert found.certified, found.note
        ratios.append(found.ratio(truth[t]))
        radii.append(found.radii)
        flags.append(found.on_schedule)
    assert all(flags)
    return max(ratios), radii[-1]


@pytest.mark.parametrize("seed", few(range(3), 0))
def test_the_truth_lies_within(seed):
    ratio, radii = one(seed, scheme())
    assert ratio <= 1.0
    assert ratio > 1e-4  # it says something
    assert radii.max() < 1.5 * np.sqrt(np.linalg.eigvalsh(np.linalg.inv(certificate().P[0])).max()) * 1.0


def test_a_bad_solution_has_a_larger_radius_and_not_a_wrong_one():
    # one Radau point on long pieces and no second look: the trajectory jumps where it is integrated anew
    poor = NonlinearMovingHorizonEstimator(
        PLANT, certificate(), initial_error=FIRST, prior=[0.6, 0.0], horizon=4.0,
        collocation=Collocation(1.0, 1, accuracy=None), solver=WindowSolver(1e-3),
    )  # fmt: skip
    ratio, radii = one(1, poor)
    assert ratio <= 1.0
    assert radii.max() > one(1, scheme())[1].max()


def test_a_gap_beyond_the_certified_ones_ends_the_radius_until_the_window_has_passed():
    estimator = scheme()
    estimator.start([0.6, 0.0])
    times = [0.5, 1.2, 3.9, 4.6]
    found = [estimator.update(t, [0.1]) for t in times]
    assert [e.certified for e in found] == [True, True, False, False]
    assert "a gap, an input or an output that the certificate does not cover" in found[2].note
    assert estimator.predict(5.5).certified is False
    estimator.start([0.6, 0.0])
    assert estimator.update(0.5, [0.1]).certified
    assert estimator.predict(1.2).certified
    assert not estimator.predict(1.4).certified


@pytest.mark.parametrize("zero", [-1.7e9, 1.7e9])
def test_the_shortest_and_the_longest_gap_are_certified_wherever_the_clock_begins(zero):
    """Stamps are rounded, to 2e-7 s where clocks count from 1970; what is longer than that is longer."""
    found = []
    for begin in (0.0, zero):
        estimator = scheme()
        estimator.start([0.6, 0.0], begin)
        times = begin + np.cumsum([0.4, 0.4, 0.8, 0.4, 0.8])
        found.append([estimator.update(t, [0.5]) for t in times.tolist()])
    for near, far in zip(*found, strict=True):
        assert far.certified
        assert far.on_schedule
        assert far.radii == pytest.approx(near.radii, rel=1e-4)
    assert not estimator.predict(times[-1] + 0.80001).certified


def test_an_open_loop_that_left_the_region_is_not_certified_where_it_has_come_back():
    plant = pendulum(1.0, 1.0).with_bounds(disturbances=(-W, W), noises=(-V, V))
    found = certify_inclusion(plant, GapRange(0.4, 1.6), eta=0.2, pieces=8)
    estimator = NonlinearMovingHorizonEstimator(plant, found, initial_error=0.1, prior=[0.9, 0.6])
    ahead = [estimator.predict(t) for t in np.linspace(0.0, 1.6, 9)]  # out at 0.2, back at 1.3
    assert np.abs(ahead[-1].x).max() < 1.0
    assert [e.certified for e in ahead] == [True] + 8 * [False]


def driven():
    """A pendulum whose stiffness is its input, within a fifth."""
    return NonlinearPlant(
        lambda x, u, w: [x[1], -casadi.sin(x[0]) * (1 + u[0]) + w[0]],
        lambda x, u, v: [x[0] + v[0]],
        {"states": 2, "inputs": 1, "disturbances": 1, "outputs": 1},
        bounds={"inputs": (-0.2, 0.2), "disturbances": (-W, W), "noises": (-V, V)},
    )


def test_an_input_beyond_its_box_ends_the_radius_and_the_claim():
    found = certify_inclusion(driven(), GapRange(0.4, 0.6), eta=0.1, pieces=4)
    estimator = NonlinearMovingHorizonEstimator(
        driven(), found, initial_error=0.1, collocation=Collocation(2.0, 1, capacity=8, accuracy=None)
    )
    ends = []
    for second in (-0.2, 5.0):
        estimator.start([0.9, 0.6])
        estimator.update(0.5, [1.0], [0.2])
        ends.append((estimator.update(1.0, [1.0], [second]), estimator.predict(1.4)))
    (here, later), (there, after) = ends
    assert here.certified
    assert here.on_schedule
    assert later.certified
    assert not there.certified
    assert "a gap, an input or an output that the certificate does not cover" in there.note
    assert not after.certified


def test_disturbances_that_leave_out_none_leave_no_radius():
    plant = pendulum().with_bounds(disturbances=(0.01, W), noises=(-V, V))
    found = certify_inclusion(plant, GapRange(0.4, 0.8), eta=0.4, pieces=8)
    estimator = NonlinearMovingHorizonEstimator(plant, found, initial_error=FIRST)
    assert not estimator.predict(0.3).certified
    assert "leaves out 0, the open loop's" in estimator.update(0.5, [0.0]).note


@pytest.mark.parametrize("x", [(0.2, -0.3), (3.0, 0.0), (-2.0, 5.0)])
def test_what_a_region_leaves_the_truth_is_counted_from_the_estimate_wherever_it_is(x):
    plant = pendulum().with_bounds(disturbances=(-W, W), noises=(-V, V)).in_region([-1.0, -1.0], [1.0, 1.0])
    bound = InclusionBound(certify_inclusion(plant, GapRange(0.4, 0.8), eta=0.4, pieces=8), plant, None)
    truths = np.array([(a, b) for a in (-1.0, 1.0) for b in (-1.0, 1.0)]) - x
    worst = np.max(np.einsum("ki,ij,kj->k", truths, bound.weight(0.5, 0.0), truths))
    most = bound.largest(0.5, 0.0, np.array(x), prior=False)
    assert worst <= most * (1 + 1e-12)
    assert most < 3 * worst


@pytest.mark.parametrize("begins", few(["sample", "horizon"], 1))
@pytest.mark.parametrize("first", [0.0, 0.3])
def test_before_any_sample_counts_a_prior_is_weighed_as_what_is_made_of_it(first, begins):
    """A sample of one output alone does not count, and may come sooner after the prior than any gap is."""
    A = np.diag([-3.0, -0.5])
    plant = from_linear(Plant(A, np.eye(2), G=np.zeros((2, 1)))).with_bounds(disturbances=(0, 0), noises=(0, 0))
    made = certify_inclusion(plant, GapRange(1.0, 1.5), eta=0.1, pieces=3)
    with pytest.warns(GuaranteeWarning, match="the horizon 0.5 must exceed"):
        estimator = NonlinearMovingHorizonEstimator(
            plant, made, initial_error=1.0, horizon=0.5, cost=CostFunction(begins=begins),
            collocation=Collocation(0.5, 2, capacity=8),
        )  # fmt: skip
    ratios = []
    for angle in (0.02, 0.8, 1.55):
        x = np.array([np.cos(angle), np.sin(angle)])
        estimator.start()
        for step, t in enumerate([first, 0.8, 1.3, 1.9]):
            y = np.exp(np.diag(A) * t) * x
            found = estimator.update(t, np.where(np.arange(2) == step % 2, y, np.nan) if step < 3 else y)
            assert found.certified == (t < 1.5), found.note
            ratios.append(found.ratio(np.exp(np.diag(A) * t) * x) if found.certified else 0.0)
    assert max(ratios) <= 1.0
    assert max(ratios) > 0.5


def test_a_sample_of_one_output_alone_does_not_count_at_the_time_of_the_prior_either():
    """Where the least certified gap may be thought to lie before it: the error along the other output has its bound."""
    A = np.array([[0.0, 1.0], [-1.0, 0.0]])
    plant = from_linear(Plant(A, np.eye(2), G=np.zeros((2, 1)))).with_bounds(disturbances=(0, 0), noises=(0, 0))
    made = certify_inclusion(plant, GapRange(1.0, 1.5), eta=0.1, pieces=3)
    with pytest.warns(GuaranteeWarning, match="the horizon 0.5 must exceed"):
        estimator = NonlinearMovingHorizonEstimator(
            plant, made, initial_error=1.0, horizon=0.5, collocation=Collocation(0.5, 2, capacity=8)
        )
    estimator.start()
    at = estimator.update(0.0, [0.0, np.nan])
    ahead = estimator.predict(0.7)
    ratios = [at.ratio([0.0, 1.0]), ahead.ratio(np.array([np.sin(0.7), np.cos(0.7)]))]
    assert at.certified
    assert ahead.certified
    assert max(ratios) <= 1.0
    assert min(ratios) > 0.99


def test_samples_that_come_too_early_do_no_harm():
    estimator = scheme()
    estimator.start([0.6, 0.0])
    found = [estimator.update(t, [0.6 * np.cos(t)]) for t in (0.5, 0.6, 0.7, 1.2)]
    assert all(e.certified for e in found)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ArgumentError, match="`certificate` belongs to another plant: its dynamics differs"):
        NonlinearMovingHorizonEstimator(pendulum(2.0), certificate())
    with pytest.raises(ArgumentError, match="its box of disturbances differs"):
        NonlinearMovingHorizonEstimator(pendulum(), certificate())
    linear = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    uncertain = UncertainPlant(linear, [UncertainParameter("stiffness", 0.9, 1.1, A=[[0.0, 0.0], [-1.0, 0.0]])])
    other = certify_inclusion(uncertain, GapRange(0.4, 0.8), eta=0.1, pieces=4)
    with pytest.raises(ArgumentError, match="`certificate` must be the InclusionCertificate of a nonlinear plant"):
        NonlinearMovingHorizonEstimator(PLANT, other)
    with pytest.raises(ArgumentError, match='`cost` must have the form "certificate" and the arrival "fixed"'):
        NonlinearMovingHorizonEstimator(PLANT, certificate(), cost=CostFunction(form="paper"))
    with pytest.warns(GuaranteeWarning, match="the horizon 1 must exceed 3.46"):
        short = NonlinearMovingHorizonEstimator(PLANT, certificate(), horizon=1.0, initial_error=FIRST)
    assert not short.update(0.5, [0.0]).on_schedule
    open_start = NonlinearMovingHorizonEstimator(PLANT, certificate())
    assert "neither `initial_error` nor a bounded region" in open_start.update(0.5, [0.0]).note
    loud = NonlinearMovingHorizonEstimator(PLANT.with_bounds(noises=None), certificate(), initial_error=1.0)
    assert "the plant's box of noises is not bounded" in loud.update(0.5, [0.0]).note


if __name__ == "__main__":
    ratios = [one(seed, scheme())[0] for seed in range(int(sys.argv[1]))]
    print(f"{len(ratios)} signals, largest ratio of a squared error to its radius {max(ratios):.4f}")
