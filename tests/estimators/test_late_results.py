"""The cases of the page on late results, each against the answer that has everything in order."""

import numpy as np
import pytest

from tests.estimators.pages import check_same, defined_on
from tests.oracles.estimators import discounted_kalman

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def said():
    return defined_on("late_results.md")


def test_late_and_out_of_order_results_give_the_estimate_in_order(said):
    rows = {t: np.full(2, np.nan) for t in sorted({t for t, _ in said["came"]})}
    for t, y in said["came"]:  # what came of one time in parts is one sample
        rows[t] = np.where(np.isnan(y), rows[t], y)
    check_same(said["after"], said["estimator"]().run(list(rows.items()), centred=False)[-1])
    check_same(said["last"], said["batch"][-1])
    assert not np.allclose(said["without"].x, said["after"].x, rtol=1e-6)


def test_a_missing_sample_is_one_that_was_never_planned(said):
    plant, weights = said["plant"], said["missing"].weights
    times, ys = zip(*(row for row in said["rows"] if row[0] != 3.0), strict=True)
    w, start = (weights.prior, weights.w, weights.y), (np.zeros(2), 0.0)
    x, Y, cost = discounted_kalman(plant.A, plant.C, plant.G, *w, weights.eta, *start, times, ys)
    fewer = said["fewer"]
    np.testing.assert_allclose(fewer.x, x, rtol=1e-9)
    np.testing.assert_allclose(fewer.covariance, Y, rtol=1e-9)
    assert fewer.cost == pytest.approx(cost, rel=1e-9)


def test_sensors_of_several_rates_may_come_one_after_the_other(said):
    check_same(said["separate"], said["together"])


def test_the_plan_of_several_prices_is_the_cheapest(said):
    assert said["plan"].verify()
    assert said["plan"].cost == pytest.approx(said["plan"].bound.cost.value)
