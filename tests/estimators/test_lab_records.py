"""The cases of the page on what laboratories do, each against the record that is right from the start."""

import numpy as np
import pytest

from tests.estimators.pages import check_same, defined_on

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def page():
    return defined_on("lab_records.md")


def test_corrected_withdrawn_and_old_results_give_the_estimate_of_the_right_record(page):
    check_same(page["after"], page["batch"][-1])
    for said, gone in ((page["rest"], {(2.0, 1)}), (page["mended"], {(3.0, 0)})):
        straight = page["estimator"]()
        for t, y in page["rows"]:
            wanted = straight.update(t, [np.nan if (t, i) in gone else y[i] for i in range(2)])
        check_same(said, wanted)
    straight = page["estimator"]()
    for t in range(1, 20):
        wanted = straight.update(float(t), page["truth"](t))
    check_same(page["last"], wanted)


def test_a_wild_reading_is_named_and_the_rest_stands(page):
    assert (page["named"].t, page["named"].output) == (3.0, "gauge")
    assert not page["found"].certified
    assert page["mended"].certified


def test_a_date_without_an_hour_holds_the_truth_and_a_believed_one_does_not(page):
    some, believed = page["some_time"], page["believed"]
    assert some.certified
    assert some.interval().holds(page["truth"](some.t))
    assert not (believed.certified and believed.interval().holds(page["truth"](believed.t)))


def test_past_states_are_held(page):
    smoothed = page["smoothed"]
    for t, x, radii in zip(smoothed.times, smoothed.x, smoothed.radii, strict=True):
        assert np.all(np.abs(x - page["truth"](t)) <= radii)
    sd, given = page["sd"], page["bounds"] | {"prior_time": 0.0}
    for estimate in smoothed.estimates:
        found, whole = estimate.interval(), sd.state_interval(page["plant"], page["rows"], estimate.t, **given)
        assert np.all(np.abs(found.radii - whole.radii) <= 0.01 * whole.radii)
        assert np.all(found.radii < 0.5 * estimate.ellipsoid_radii)


def test_with_one_wild_reading_the_truth_is_held_without_naming_it(page):
    assert page["among"].holds(page["truth"](4.0))
    assert page["among"].verify()


def test_what_is_proven_for_the_times_that_were_is_less_than_the_plan_promised_and_help_is_named(page):
    """The times that really were: late and missed samples are told, the error that was possible is, and what to do."""
    assert page["log"].missed.size == 1
    assert page["log"].largest_deviation == pytest.approx(0.4)
    assert page["log"].kept < 1
    assert page["was"].upper[0] > page["plan"].reached[0]
    assert page["was"].verify()
    assert page["advice"].now == page["stamps"][-1]
    assert page["advice"].kept_from > page["advice"].now
