"""What is known of the error at every sample of an endless chain, whatever it once was."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy import forgetting, gap_table
from sampling_design.accuracy import sampled_system as chains
from sampling_design.accuracy.bounds import SignalBounds
from sampling_design.accuracy.gains import filtered, filtered_along
from sampling_design.accuracy.question import AccuracyQuestion
from sampling_design.errors import UndecidedError
from sampling_design.numerics.linalg import expm_batch
from sampling_design.observability.alignment import align
from tests.cases import few

PLANTS = {
    "oscillator": ([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]),
    "double integrator": ([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]]),
    "growing": ([[0.5]], [[1.0]]),
    "stiff": ([[-30.0, 1.0], [0.0, -0.1]], [[1.0, 1.0]]),
}


def made(name, gaps):
    plant = sd.Plant(*PLANTS[name])
    count = len(gaps)
    bounds = SignalBounds.of(plant, count, np.ones((count, 1), dtype=bool), 0.02, np.full((count, 1), 0.4))
    return chains.periodic_system(plant, np.array(gaps), bounds)


def by_whole_periods(system, j):
    """R = cost + |rest|'R for one sample alone, over as many periods as it takes."""
    count, n = len(system), system.D.size
    mu, cost, at, steps = np.eye(n), np.zeros(n), j, 0
    while True:
        sample = system.samples[at]
        gains = sample.K.T @ mu
        mu = mu - sample.H.T @ gains
        cost += np.abs(gains).sum(axis=0)
        if steps and at == j and np.abs(mu).sum(axis=0).max() < forgetting.CONTRACTED:
            return np.linalg.solve(np.eye(n) - np.abs(mu).T, cost)
        at, steps = (at - 1) % count, steps + 1
        cost += system.gaps[at].integral(mu, system.bounds.w_ball)
        mu = system.gaps[at].F.T @ mu


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("gaps", [[1.3], [0.7, 1.6, 0.9, 2.0]])
def test_the_reach_is_that_of_each_sample_alone(name, gaps):
    system = made(name, gaps)
    for j in range(len(system)):
        np.testing.assert_allclose(system.reach[j], by_whole_periods(system, j), rtol=3 * forgetting.CONTRACTED)


@pytest.mark.parametrize("name", PLANTS)
def test_the_reach_satisfies_its_inequality_and_hardly_more(name):
    system = made(name, [0.7, 1.6, 0.9, 2.0])
    for j, (back, cost, rest) in enumerate(system._filtered):
        right = cost + np.abs(rest).T @ system.reach[(j - back) % len(system)]
        np.testing.assert_allclose(system.reach[j], right, rtol=1e-12)
        np.testing.assert_allclose(system.rests_on(j, system.reach[(j - back) % len(system)]), right, rtol=1e-12)
        assert np.abs(rest).sum(axis=0).max() < forgetting.CONTRACTED


def test_many_samples_take_as_many_steps_as_the_error_lasts(monkeypatch):
    system, rows = made("growing", [4.0] * 60), []
    cost = forgetting.noise_cost
    monkeypatch.setattr(forgetting, "noise_cost", lambda gains, *more: rows.append(len(gains)) or cost(gains, *more))
    assert system.reach.shape == (60, 1)
    assert sum(rows) == system.forgetting.sum() + 60 < 7 * 60
    assert len(rows) == 1 + system.forgetting[0] + 1 + system.forgetting.max()  # the first, all others


def walked(system, j):
    """The past of one sample: its rows followed back one sample and one gap at a time."""
    mu, cost, steps, count = np.eye(system.D.size), 0.0, 0, len(system)
    while True:
        sample, gap = system.samples[(j - steps) % count], system.gaps[(j - steps - 1) % count]
        gains = sample.K.T @ mu
        mu, noisy = mu - sample.H.T @ gains, gains * sample.noise[:, None]
        cost = cost + (np.linalg.norm(noisy, axis=0) if system.bounds.v_ball else np.abs(noisy).sum(axis=0))
        if steps and np.abs(mu).sum(axis=0).max() < forgetting.CONTRACTED:
            return steps, cost, mu
        cost, mu, steps = cost + gap.size(mu, system.bounds.w_ball), gap.F.T @ mu, steps + 1


@pytest.mark.parametrize(("w_bound", "v_bound"), [(0.02, 0.4), ([0.02, 0.01], [0.4, 0.2])])
@pytest.mark.parametrize("few", [False, True])
def test_samples_that_are_followed_together_have_the_past_of_each_alone(w_bound, v_bound, few, monkeypatch):
    """Of gaps with few and with many panels, which come once and many times, and samples of one output or both."""
    rng = np.random.default_rng(3)
    plant = sd.Plant([[0.0, 1.0], [-2.0, -0.1]], np.eye(2))
    gaps = np.append(rng.uniform(0.02, 0.4, 6), 60.0)
    measured = np.array([[1, 0], [1, 1], [0, 1], [1, 1], [1, 0], [1, 0], [0, 1]], dtype=bool)
    bounds = SignalBounds.of(plant, 7, measured, w_bound, v_bound)
    system = chains.periodic_system(plant, gaps, bounds)
    assert len({gap.flow.third.size for gap in system.gaps}) > 1
    if few:  # two samples at a time, and integrals in parts
        monkeypatch.setattr(forgetting, "KEPT", 2 * system.forgetting[0] * 4)
        monkeypatch.setattr(gap_table, "AT_ONCE", 200)
        system = replace(system)
    for j, (steps, cost, rest) in enumerate(system._filtered):
        alone = walked(system, j)
        assert steps == alone[0]
        np.testing.assert_allclose(cost, alone[1], rtol=1e-12)
        np.testing.assert_allclose(rest, alone[2], rtol=1e-9, atol=1e-14)


def test_an_error_that_is_not_forgotten_is_not_bounded(monkeypatch):
    monkeypatch.setattr(chains, "PERIODS", 1)
    monkeypatch.setattr(forgetting, "PATIENT", 1)
    with pytest.raises(UndecidedError, match="its filter forgets no past within 1 periods"):
        _ = made("oscillator", [1.3]).reach


@pytest.mark.parametrize("gap", [20.0, 0.5])  # in the first samples, and in doubled periods
def test_a_filter_that_does_not_hold_what_grows_is_told_in_time(gap):
    found = made("growing", [gap])
    deaf = replace(found, samples=tuple(replace(each, K=0 * each.K) for each in found.samples))
    with pytest.raises(UndecidedError, match="grows so far between the samples of this schedule that no filter's"):
        deaf._filtered  # noqa: B018


def test_a_state_that_decays_beyond_numbers_between_samples_leaves_the_others_what_they_are():
    """Nothing drives it, so that its covariance underflows: any coordinates serve it."""
    slow, known = sd.Plant([[-1.0]], [[1.0]]), {"w_bound": [0.3], "rtol": 0.05}
    both = sd.Plant(np.diag([-1000.0, -1.0]), np.eye(2), G=[[0.0], [1.0]])
    alone = sd.guaranteed_accuracy(slow, sd.PeriodicSchedule([1.0]), v_bound=[0.3], **known)
    found = sd.guaranteed_accuracy(both, sd.PeriodicSchedule([1.0]), v_bound=[0.3, 0.3], **known)
    assert found.verify()
    assert found.lower[1] <= alone.upper[0] * (1 + 1e-9)
    assert alone.lower[0] <= found.upper[1] * (1 + 1e-9)
    assert found.upper[1] <= 1.06 * alone.upper[0]
    assert found.lower[0] == 0


@pytest.mark.parametrize("ball", [False, True])
def test_integrals_of_columns_are_the_same_however_many_are_made_at_once(ball, monkeypatch):
    """A fast mode asks for thousands of panels: then a few columns at a time, of the same values."""
    A, G = np.diag([-300.0, -0.1]) + np.eye(2, k=1), np.array([[0.3, 0.0], [1.0, 0.5]])
    gap = gap_table.GapTable(A, G, np.ones(2)).cut(1.0, gap_table.PANEL)
    g = np.random.default_rng(0).normal(size=(2, 7))
    whole = gap.integral(g, ball)
    monkeypatch.setattr(gap_table, "AT_ONCE", 2 * gap.propagated.size)
    np.testing.assert_allclose(gap.integral(g, ball), whole, rtol=1e-12)
    monkeypatch.setattr(gap_table, "AT_ONCE", 0)
    np.testing.assert_allclose(gap.integral(g, ball), whole, rtol=1e-12)


@pytest.mark.parametrize("ball", few([False, True], 1))
def test_gaps_of_a_record_are_integrated_as_closely_as_others_with_a_tenth_of_their_memory(ball):
    """All panels of each gap at once took gigabytes of five thousand rows of eight states."""
    rng, n, gaps = np.random.default_rng(0), 8, 64
    A, G, lengths = rng.normal(size=(n, n)) - 4 * np.eye(n), rng.normal(size=(n, n)), rng.uniform(0.9, 1.1, gaps)
    table, g = gap_table.GapTable(A, G, np.ones(n)), rng.normal(size=(gaps, n))
    tracemalloc.start()
    known = table.get(lengths.tolist())
    found = gap_table.DisturbanceQuadrature(table, known).integral(g, ball)
    most = tracemalloc.get_traced_memory()[1] / 8
    tracemalloc.stop()
    assert (
        most < sum(gap.third.size for gap in known) * n**2
    )  # less than one flow a panel; propagated, bend and pieces are three
    np.testing.assert_allclose([gap.F for gap in known], expm_batch(A, lengths), rtol=1e-12, atol=1e-14)
    of_period = sum(
        table.cut(h, gap_table.PANEL).integral(own[:, None], ball)[0] for h, own in zip(lengths, g, strict=True)
    )
    s = (np.arange(4000) + 0.5) / 4000
    flows = [h / s.size * own @ expm_batch(A, h * s) @ G for h, own in zip(lengths, g, strict=True)]
    truth = sum(float((np.linalg.norm(p, axis=1) if ball else np.abs(p)).sum()) for p in flows)
    assert truth * (1 - 1e-6) <= found <= of_period * (1 + 1e-4)
    assert found <= truth * (1 + 1e-4)


def test_a_variance_that_rounding_makes_negative_is_none():
    """In states that nearly depend on each other what w does to one is a difference: 1e-20 less than nothing."""
    assert gap_table.state_scales(np.eye(1)[None], np.array([[[-1e-20]]]), [2 * np.eye(1)]) == pytest.approx(0.5)


@pytest.mark.parametrize("ball", [False, True])
@pytest.mark.parametrize("q", [0, 1, 2])
def test_integrals_over_many_gaps_are_those_of_each(ball, q):
    """Also where nothing drives the plant, and over no columns."""
    A, G = np.array([[0.0, 1.0], [-2.0, -0.1]]), np.array([[0.3, 0.0], [1.0, 0.5]])[:, :q]
    table = gap_table.GapTable(A, G, np.ones(2))
    gaps = [table.cut(h, gap_table.PANEL) for h in (0.3, 40.0, 0.5, 0.3)]
    g, at = np.random.default_rng(1).normal(size=(5, 2, 3)), np.array([3, 0, 1, 2, 1])
    found = gap_table.GapIntegrals(gaps).over(at, g, ball)
    each = [gaps[i].integral(columns, ball) for i, columns in zip(at, g, strict=True)]
    np.testing.assert_allclose(found, each, rtol=1e-13)
    assert gap_table.GapIntegrals(gaps).over(at, g[:, :, :0], ball).shape == (5, 0)


@pytest.mark.parametrize(("ball", "count"), [(False, 12), (True, 40)])
def test_the_filters_gains_of_many_samples_are_those_of_each(ball, count):
    """One way back through all samples, which rows join at theirs: what follows a spent budget takes no more."""
    plant = sd.Plant([[-0.1, 1.0], [-1.0, -0.1]], [[1.0, 0.0], [0.3, 1.0]])
    schedule = align(plant, sd.PeriodicSchedule([0.7, 1.1, 0.4, 0.9, 1.3]))
    noise = 0.1 if ball else np.full(2, 0.1)
    question = AccuracyQuestion.of(plant, schedule, 0.1, noise)
    system, _ = question.filter_bounds(plant)
    wanted = {j: np.random.default_rng(j).normal(size=(2, 2)) for j in (0, 3, 4)}
    along = dict(filtered_along(system, count, system.reach.__getitem__, wanted))
    for j, rows in wanted.items():
        nodes = system.nodes(j, count)
        alone = filtered(system, nodes, lambda k, nodes=nodes: system.reach[nodes[k]], rows.T)
        assert [each.value for each in along[j]] == pytest.approx([each.value for each in alone], rel=1e-9)
        assert [len(each.gains) for each in along[j]] == [len(each.gains) for each in alone]
