"""Blocks of trials: each run depends on its own seed alone, whoever computes it."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from sampling_design import ArgumentError, MovingHorizonEstimator
from sampling_design.validation.apriori_bound import apriori_bound_of
from sampling_design.validation.error_map import ErrorMap
from sampling_design.validation.monte_carlo import BLOCK, monte_carlo, ratio
from sampling_design.validation.scenario import ScenarioBounds
from sampling_design.validation.timeline import build_timeline
from tests.validation.plants import PLANTS, SCHEDULES, certificate

PLANT, BOUNDS = PLANTS["oscillator"], ScenarioBounds.of(PLANTS["oscillator"])


def setting():
    noise = {"w_bound": BOUNDS.w, "v_bound": BOUNDS.v, "initial_error": BOUNDS.e0}
    mhe = MovingHorizonEstimator(PLANT, certificate("oscillator"), **noise)
    line = build_timeline(PLANT, SCHEDULES["oscillator"], 12.0, mhe.horizon)
    apriori = apriori_bound_of(certificate("oscillator"), mhe.horizon)
    return ErrorMap(line, mhe, BOUNDS), BOUNDS, apriori, apriori.root


def test_a_run_depends_on_its_own_seed_alone():
    seeds = np.random.SeedSequence(7).spawn(2 * BLOCK + 5)
    whole = monte_carlo(*setting(), seeds)
    assert whole.size.shape[0] == len(seeds)
    part = monte_carlo(*setting(), seeds[BLOCK : BLOCK + 3])
    assert part.size == pytest.approx(whole.size[BLOCK : BLOCK + 3], rel=1e-12)
    assert np.all(whole.promised <= 1.0)
    assert np.all(whole.ellipsoid <= 1.0 + 1e-9)
    assert whole.plain.shape == (3, whole.size.shape[1])
    assert not np.array_equal(whole.size[0], whole.size[1])


def test_progress_counts_the_runs():
    heard = []
    monte_carlo(*setting(), np.random.SeedSequence(7).spawn(BLOCK + 1), progress=lambda f, m: heard.append((f, m)))
    assert heard == [(0.5, f"{BLOCK} of {BLOCK + 1} runs"), (1.0, f"{BLOCK + 1} of {BLOCK + 1} runs")]


def test_without_a_promise_only_ellipsoids_are_judged():
    found, bounds, _, measure = setting()
    trials = monte_carlo(found, bounds, None, measure, np.random.SeedSequence(7).spawn(4), ThreadPoolExecutor(2))
    assert np.isnan(trials.promised).all()
    assert trials.ellipsoid.max() <= 1.0 + 1e-9


def test_other_workers_are_refused():
    for bad in (1.5, True, [2]):
        with pytest.raises(ArgumentError, match="`workers` must name a joblib backend, one of"):
            monte_carlo(*setting(), np.random.SeedSequence(7).spawn(2), bad)


def test_nothing_over_nothing_is_nothing():
    assert ratio(np.array([0.0, 1.0]), np.array([0.0, 2.0])) == pytest.approx([0.0, 0.5])
