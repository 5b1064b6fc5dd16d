"""The cases of the page on late results, each against the answer that has everything in order."""

import re

import numpy as np
import pytest

from tests.estimators.pages import DOCS, check_same, defined_on
from tests.oracles.estimators import discounted_kalman

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def said():
    return defined_on("late_results.md")


def test_late_and_out_of_order_results_give_the_estimate_in_order(said):
    rows = {t: np.full(2, np.nan) for t in sorted({t for t, _ in said["came"]})}
    for t, y in said["came"]:  # what came of one time in parts is one sample
        rows[t] = np.where(np.isnan(y), rows[t], y)
    check_same(said["told"][4], said["estimator"]().run(list(rows.items()), centred=False)[-1])
    check_same(said["mixed"][-1], said["batch"][-1])
    assert not np.allclose(said["told"][3].x, said["told"][4].x, rtol=1e-6)


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


def test_each_part_takes_ten_lines_with_its_picture():
    parts = re.split(r"^##+ ", (DOCS / "late_results.md").read_text(), flags=re.MULTILINE)[1:]
    cells = {
        part.split("\n")[0]: "".join(re.findall(r"```\{code-cell\} python\n(.*?)```", part, re.DOTALL))
        for part in parts
    }
    lines = {heading: len(re.findall(r"\S.*\n", code)) for heading, code in cells.items()}
    assert {heading: count for heading, count in lines.items() if count > 10} == {}
    pictures = {heading for heading, code in cells.items() if ".plot(" in code or "plt.subplots(" in code}
    assert {*cells} - pictures == {"In the mail"}  # what is due next is a sentence
