"""`certified` means a finite state and finite radii, above 0 unless all is known; a failed estimate shows no radius.

Over plants that grow, decay and swing, gaps from 1e-3 to 1e5 time constants, data up to 1e300 and outliers of any size.
"""

import json
from itertools import product

import numpy as np
import pytest

from sampling_design import Constraints, KalmanFilter, MovingHorizonEstimator, Plant
from sampling_design.errors import ArgumentError
from sampling_design.estimators.estimate_file import write_estimates
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.online.estimator import EstimateRecord
from sampling_design.records.file_io import to_json
from tests.cases import few, scale_weights

PLANTS = {
    "integrator": Plant([[0.0]], [[1.0]]),
    "oscillator": Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]]),
    "saddle": Plant([[1.0, 0.0], [0.0, -1e4]], [[1.0, 1.0]]),
    "fast": Plant([[-50.0, 3.0], [0.0, -0.1]], [[1.0, 1.0]]),
}
MAKERS = {
    "mhe": lambda plant, weights, **o: MovingHorizonEstimator(plant, horizon=5.0, cost=CostFunction(**weights), **o),
    "carried": lambda plant, weights, **o: MovingHorizonEstimator(
        plant, horizon=5.0, cost=CostFunction(arrival="filtered", **weights), **o
    ),
    "boxes": lambda plant, weights, **o: MovingHorizonEstimator(
        plant, horizon=5.0, cost=CostFunction(**weights), constraints=Constraints(x=(-1e3, 1e3), v=(-9, 9)), **o
    ),
    "filter": lambda plant, weights, **o: KalmanFilter(plant, cost=CostFunction(**weights), **o),
}


def sane(estimate, exact=True):
    """What must hold of any estimate; `exact`: of its interval, too."""
    if estimate.certified:
        assert np.isfinite(estimate.x).all()
        assert np.isfinite(estimate.ellipsoid_radii).all()
        assert np.isfinite(estimate.radius)
        assert (estimate.ellipsoid_radii > 0).all()
        if not exact:
            return
        if np.isnan(estimate.radii).any():  # the exact set is empty although the ellipsoid is not
            found = estimate.interval()
            assert found.contradiction > 1
            assert found.verify()
        else:
            assert (estimate.radii > 0).all()
            assert (estimate.radii <= estimate.ellipsoid_radii * (1 + 1e-12)).all()
    elif estimate.status in ("infeasible", "bounds disproved") or estimate.contradiction:
        assert np.isnan(estimate.radius)
        assert np.isnan(estimate.radii).all()
        assert estimate.to_dict()["radii"] == [None] * estimate.x.size
    else:
        assert estimate.note
        assert not np.isnan(estimate.radius)
        assert not (estimate.radii == 0).any()
    if estimate.status == "bounds disproved":
        assert estimate.contradiction is not None
        assert estimate.contradiction.factor > 1
        assert "start(" in estimate.note


def answers(estimator, t, y, ahead, exact):
    """Ask for two estimates; return the words of a refusal."""
    try:
        if np.isfinite(y).any():
            sane(estimator.update(t, y), exact)
        sane(estimator.predict(ahead), exact)
    except ArgumentError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(("name", "maker"), few(list(product(PLANTS, MAKERS)), 0, 5, 15))
def test_whatever_the_data_and_however_far_ahead(name, maker):
    plant, refused = PLANTS[name], 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        bounds = {} if seed % 5 == 0 else {"w_bound": 0.1, "v_bound": 0.5, "initial_error": 2.0}
        estimator = MAKERS[maker](plant, {"eta": rng.choice([0.0, 0.3, 3.0])}, **bounds)
        t = 0.0
        for _ in range(6):
            t += float(10.0 ** rng.uniform(-3, 0.5 if rng.random() < 0.8 else 5))
            y = rng.normal(size=plant.n_outputs) * (1e-1 if rng.random() < 0.8 else 10.0 ** rng.uniform(0, 300))
            y[rng.random(y.size) < 0.2] = np.nan
            words = answers(estimator, t, y, t + 10.0 ** rng.uniform(-3, 5), seed in (1, 9))
            if words:
                assert "grows beyond double precision. Start again near it: start(" in words
                refused += 1
                estimator.start(prior_time=t)
                sane(estimator.predict(t))
    assert refused < 50


LONG = 1500.0
BEYOND = {
    "one": Plant([[1.0]], [[1.0]]),
    "two": Plant([[1.0, 0.0], [0.0, -0.5]], [[1.0, 1.0]]),
    "chain": Plant([[1.0, 1.0], [0.0, 1.0]], [[1.0, 0.0]]),
    "unseen": Plant([[1.0, 0.0], [0.0, -0.5]], [[0.0, 1.0]]),
    "decays": Plant([[-1.0, 0.0], [1.0, -2.0]], [[0.0, 1.0]]),
}
OVER_LONG_WINDOWS = {
    "mhe": lambda plant, **o: MovingHorizonEstimator(plant, horizon=LONG, cost=CostFunction(eta=0.3), **o),
    "undiscounted": lambda plant, **o: MovingHorizonEstimator(plant, horizon=LONG, **o),
    "forgets": lambda plant, **o: MovingHorizonEstimator(plant, horizon=LONG, cost=CostFunction(eta=3.0), **o),
    "paper": lambda plant, **o: MovingHorizonEstimator(plant, horizon=LONG, cost=CostFunction(form="paper"), **o),
    "carried": lambda plant, **o: MovingHorizonEstimator(
        plant, horizon=LONG, cost=CostFunction(arrival="filtered"), **o
    ),
    "boxes": lambda plant, **o: MovingHorizonEstimator(
        plant, horizon=LONG, cost=CostFunction(eta=0.3), constraints=Constraints(v=(-9, 9)), **o
    ),
    "held": lambda plant, **o: MovingHorizonEstimator(
        plant, horizon=LONG, constraints=Constraints(w=(-1, 1), w_model="constant"), **o
    ),
    "filter": lambda plant, **o: KalmanFilter(plant, cost=CostFunction(eta=0.3), **o),
}


@pytest.mark.parametrize("maker", few(OVER_LONG_WINDOWS, 0, 3, 5, 6, 7))
def test_growth_beyond_all_numbers_between_samples_is_refused_in_words(maker):
    """e^300 to e^800 within the window: an estimate with what holds of it, or the sentence; never "ok" with NaN."""
    refused, plants = 0, list(BEYOND.values())
    for plant, growth in product(plants[:1] if maker == "held" else plants, (300.0, 400.0, 800.0)):
        estimator = OVER_LONG_WINDOWS[maker](plant, w_bound=0.1, v_bound=0.1, initial_error=1.0)
        t = 0.0
        for gap in (1.0, growth, 0.5):
            t += gap
            words = answers(estimator, t, np.zeros(plant.n_outputs), t + growth, False)
            if words:
                assert "grows beyond double precision. Start again near it: start(" in words
                refused += 1
                estimator.start(prior_time=t)
                sane(estimator.predict(t), False)
    assert refused > 0


def test_a_sample_without_a_bound_is_unbounded_however_old():
    """The discount of the first sample is 0 in doubles, its noise is not bounded: 0 times infinity is no radius."""
    estimator = OVER_LONG_WINDOWS["forgets"](BEYOND["chain"])
    for t, y in ((1.0, 0.0), (111.0, 1e100), (112.0, 2.0), (222.0, 1e100), (277.0, 0.0)):
        assert estimator.update(t, [y]).radius == np.inf


def test_what_rounding_hides_is_not_called_infeasible():
    """v is free, so that any data can be met; the state has grown by e^165, and no solver follows it."""
    plant = Plant(BEYOND["two"].A, np.eye(2))
    held = Constraints(w=(-1, 1), w_model="constant")
    estimator = MovingHorizonEstimator(plant, horizon=LONG, cost=CostFunction(eta=0.3), constraints=held)
    samples = ((1.0, 0.0), (111.0, 0.0), (112.0, 2.0), (222.0, 0.0), (277.0, 0.0))
    found = [estimator.update(t, [y, y]).status for t, y in samples]
    assert found == ["ok", "ok", "ok", "ok", "solver failed"]


def test_the_three_reported_cases():
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0}
    far = MovingHorizonEstimator(PLANTS["integrator"], horizon=3.0, cost=CostFunction(eta=3.0), **bounds)
    far.update(1.0, [0.1])
    estimate = far.predict(241.0)
    assert estimate.certified
    assert estimate.radii[0] == pytest.approx(0.1 * 240, rel=0.02)
    huge = MovingHorizonEstimator(PLANTS["integrator"], horizon=3.0, cost=CostFunction(eta=3.0), **bounds)
    found = huge.update(1.0, [1e155])
    assert (found.status, found.certified) == ("bounds disproved", False)
    assert found.contradiction.t == 1.0
    saddle = MovingHorizonEstimator(PLANTS["saddle"], horizon=3.0, **bounds)
    saddle.update(1.0, [0.0])
    with pytest.raises(ArgumentError, match=r"`t` = 1000\.0 lies 999 s after the last sample"):
        saddle.predict(1000.0)
    assert saddle.predict(20.0).certified


def outlier(estimator, plant, rng, at=7, output=1, size=9.0):
    """Twelve samples of rest with noise below the bound .1; one output of sample `at` (from 1) is off by `size`."""
    found = []
    for k in range(1, 13):
        y = rng.uniform(-0.05, 0.05, plant.n_outputs)
        y[output] += size if k == at else 0.0
        found.append(estimator.update(0.5 * k, y))
    return found


@pytest.mark.parametrize("maker", MAKERS)
def test_an_outlier_is_named_and_a_reset_forgets_it(maker, tmp_path):
    plant, rng = PLANTS["oscillator"], np.random.default_rng(3)
    bounds = {"w_bound": 0.1, "v_bound": [0.1, 0.1], "initial_error": 0.5}
    weights = {"P2": 4 * np.eye(2), "Qw": 100 * np.eye(2), "R": 200 * np.eye(2), "Qv": 200 * np.eye(2)}
    estimator = MAKERS[maker](plant, {"eta": 0.3, **weights}, **bounds)
    found = outlier(estimator, plant, rng)
    assert [e.certified for e in found] == [True] * 6 + [False] * 6
    contradiction = found[6].contradiction
    assert (contradiction.number, contradiction.t, contradiction.output) == (7, 3.5, "y2")
    assert 20 < contradiction.factor < 200
    assert all(e.contradiction == contradiction for e in found[6:])
    assert "sample 7 at t = 3.5, output y2: its v_bound would have to be" in found[-1].note
    record = EstimateRecord.collect(plant, found)
    assert np.isnan(record.radii[6:]).all()
    assert "sample 7" in record.explain()
    assert "sample 7" in str(record)
    data = json.loads(to_json(record.to_dict()))
    assert data["radii"][6:] == [[None, None]] * 6
    assert data["contradictions"][0]["number"] == 7
    rows = write_estimates(record, tmp_path / "e.csv").read_text().splitlines()
    assert all(row.split(",")[-1] == "" for row in rows[7:])
    assert all(row.split(",")[-1] != "" for row in rows[1:7])
    shade = record.plot()[0].collections[0].get_paths()
    assert max(path.vertices[:, 0].max() for path in shade) == 3.0
    last = estimator.predict(6.0)
    estimator.start(prior=last.x, prior_time=6.0)
    after = estimator.update(6.5, [0.0, 0.0])
    assert (after.certified, after.contradiction) == (True, None)


def gauge_read_once(factors, seed):
    """An estimator whose third output is read at the seventh sample only, off by 4; bounds times `factors`."""
    plant = Plant(PLANTS["oscillator"].A, [[1.0, 0.0], [0.0, 1.0], [0.0, 1.0]])
    weights = {"P2": 4 * np.eye(2), "R": 2 * np.eye(3), "Qv": 2 * np.eye(3)}
    e0, v = 0.3 * factors[0], np.array([0.1, 0.1, 0.2]) * factors
    mhe = MovingHorizonEstimator(
        plant, horizon=50.0, w_bound=0.0, initial_error=e0, v_bound=v, cost=CostFunction(**weights)
    )
    rng, found = np.random.default_rng(seed), []
    for k in range(1, 9):
        y = np.append(rng.uniform(-0.05, 0.05, 2), 4.0 if k == 7 else np.nan)
        found.append(mhe.update(0.5 * k, y))
    return found


@pytest.mark.parametrize("seed", range(4))
def test_the_factor_is_the_least_that_ends_the_contradiction(seed):
    found = gauge_read_once(np.ones(3), seed)
    contradiction = found[6].contradiction
    assert (contradiction.number, contradiction.output, contradiction.alone) == (7, "y3", True)
    assert [e.status for e in found[:6]] == ["ok"] * 6
    for grown, status in ((1.0001, "ok"), (0.9999, "bounds disproved")):
        again = gauge_read_once(np.array([1.0, 1.0, grown * contradiction.factor]), seed)
        assert again[6].status == status


def test_a_record_of_contradictions_by_several_outputs_names_them_together():
    plant = PLANTS["oscillator"]

    def after(factor):
        bounds = {"w_bound": 0.0, "v_bound": 0.01 * factor, "initial_error": 0.01 * factor}
        return MovingHorizonEstimator(plant, horizon=9.0, cost=scale_weights(plant), **bounds).update(1.0, [5.0, 5.0])

    found = after(1.0)
    assert "and not it alone: all bounds would have to be" in found.note
    factor = found.contradiction.factor
    assert [after(c * factor).status for c in (0.999, 1.001)] == ["bounds disproved", "ok"]


def test_what_is_known_exactly_has_radius_zero_and_says_so():
    mhe = MovingHorizonEstimator(Plant([[0.0]], [[1.0]]), horizon=2.0, w_bound=0, v_bound=0, initial_error=0)
    estimate = mhe.update(1.0, [0.0])
    assert estimate.certified
    assert estimate.radii.tolist() == [0.0]
