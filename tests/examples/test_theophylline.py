"""Theophylline: withheld samples of six people lie in what their earlier ones prove, under bounds of six others."""

import numpy as np
import pytest

from examples.theophylline import blood as b


@pytest.fixture(scope="module")
def record():
    return b.read_blood()


def test_the_record_is_the_one_of_twelve_people(record):
    assert sorted(record) == list(range(1, 13))
    assert all(len(rows) == 6 and rows[0, 0] > b.ABSORBED and 23 < rows[-1, 0] < 25 for rows in record.values())
    assert record[1][0].tolist() == [3.82, 8.58]


def test_withheld_samples_are_inside_and_no_bound_is_disproved(record):
    least = b.least_bound(record, step=4e-3)
    assert 0.08 < least < 0.09
    found = b.predictions(record, b.RESERVE * least)
    assert len(found) == 18
    assert all(one.inside for one in found)
    assert not any(one.disproved for one in found)
    assert max(abs(one.error) for one in found) < 0.3


def test_a_bound_that_is_too_small_is_disproved_and_misses(record):
    found = b.predictions(record, 0.02, persons=(8, 9))
    assert any(one.disproved or not one.inside for one in found)


def test_two_samples_far_apart_tell_as_much_of_tomorrow_as_five():
    two, three, five = (b.known_next_day(t, 0.1) for t in ([3.5, 12.0], [3.5, 5.0, 7.0], [3.5, 5.0, 7.0, 9.0, 12.0]))
    assert two == pytest.approx(five, rel=0.02)
    # by hand: the ends of the line decide, v (1 + 2 (24 - 12)/(12 - 3.5))
    assert np.log(two) == pytest.approx(0.1 * (1 + 2 * 12.0 / 8.5), rel=1e-3)
    assert np.log(three) == pytest.approx(0.1 * (1 + 2 * 17.0 / 3.5), rel=1e-3)
