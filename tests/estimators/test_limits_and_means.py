"""Limits of detection and composite samples: in files, in intervals, in estimators; against the plainest reading."""

from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy.interval import state_interval
from sampling_design.accuracy.readings import AboveRange, BelowDetection, CensoredReading, CompositeReading
from sampling_design.errors import ArgumentError, FileFormatError
from tests.cases import few
from tests.oracles.windows import by_the_reference

TANK = sd.Plant(
    [[-0.05]], [[1.0], [1.0]], B=[[1.0]], states=["level"], outputs=["blood", "urine"], inputs=["dose"], time_unit="h"
)
TEXT = "time,blood,urine,urine_since,dose\n0,2,,,0\n24,<0.5,3.1,0,0\n48,>8,<0.2,24,1\n60,,,,0\n"


def test_a_file_with_limits_and_means_comes_back_exactly(tmp_path):
    path = tmp_path / "readings.csv"
    path.write_text(TEXT)
    record = sd.read_measurements(path, TANK)
    assert [len(row) for row in record.censored] == [0, 2, 2, 0]
    rows = list(record)
    assert rows[1][1] == [BelowDetection(0.5), CompositeReading(3.1, 0.0)]
    assert rows[2][1] == [AboveRange(8.0), CompositeReading(BelowDetection(0.2), 24.0)]
    again = sd.read_measurements(sd.estimators.write_measurements(record, tmp_path / "again.csv"), TANK)
    assert again.censored == record.censored
    assert np.array_equal(again.y, record.y, equal_nan=True)
    assert record.measured.sum() == 5
    assert "blood: 3" in record.explain()


def test_semicolons_and_dates(tmp_path):
    path = tmp_path / "readings.csv"
    path.write_text(
        "date;blood;urine;urine_since;dose\n2026-01-05T08:00;<0,5;;;0\n2026-01-06T08:00;;3,1;2026-01-05T08:00;\n"
    )
    record = sd.read_measurements(path, TANK)
    assert record.censored[0][0].upper == 0.5
    assert record.censored[1][0] == CensoredReading(1, 3.1, 3.1, 0.0)


@pytest.mark.parametrize("first", ["1", '"1"'])  # at once, and cell by cell
@pytest.mark.parametrize("cell", ["<=0.5", "≤ 0.5", ">=8", "≥8"])
def test_a_limit_with_its_end_is_the_limit(tmp_path, cell, first):
    ends = (-np.inf, 0.5) if cell[0] in "<≤" else (8.0, np.inf)
    path = tmp_path / "readings.csv"
    path.write_text(f"time,blood,urine,dose\n1,{first},,0\n2,{cell},,0\n")
    assert sd.read_measurements(path, TANK).censored[1] == (CensoredReading(0, *ends, None),)


@pytest.mark.parametrize(
    ("cells", "match"),
    [
        ("24,<,,,0", "blood in line 2 is not a number: ''"),
        ("24,<<1,,,0", "blood in line 2 is not a number: '<1'"),
        ("24,≤=1,,,0", "blood in line 2 is not a number: '=1'"),
        ("24,<nan,,,0", "blood in line 2 is not a number: 'nan'"),
        ("24,1,,3,0", "urine_since in line 2 has no urine beside it. Leave both cells empty."),
        ("24,1,2,24,0", "line 2 begins a composite sample at '24', which is not before its end"),
        ("24,1,2,x,0", "time in line 2 is not a number: 'x'"),
    ],
)
def test_bad_cells_are_refused(tmp_path, cells, match):
    path = tmp_path / "readings.csv"
    path.write_text(f"time,blood,urine,urine_since,dose\n{cells}\n")
    with pytest.raises(FileFormatError, match=match):
        sd.read_measurements(path, TANK)


def test_told_belongs_to_rows():
    with pytest.raises(ArgumentError, match="`censored` must have an entry for each row"):
        sd.Measurements(TANK, [0.0], [[1.0, np.nan]], censored=((), ()))
    beyond = CensoredReading(2, 0.0, 1.0, None)
    for told in (np.nan, "<0.5", ((3,),), (3,), ((beyond,),)):
        with pytest.raises(ArgumentError, match="`censored` must be a tuple of what each row says, got "):
            sd.Measurements(TANK, [0.0], [[1.0, np.nan]], censored=told)


WALK = sd.Plant([[0.0]], [[1.0]], states=["level"])
GIVEN = {"w_bound": 0.1, "v_bound": 0.05}


def test_limits_are_half_lines():
    found = state_interval(WALK, [(0.0, [1.0], None), (1.0, [BelowDetection(0.97)], None)], **GIVEN)
    assert found.lower == pytest.approx([0.85], abs=1e-6)
    assert found.upper == pytest.approx([0.97 + 0.05], abs=1e-6)
    both = state_interval(WALK, [(0.0, [1.0], None), (1.0, [AboveRange(1.1)], None)], **GIVEN)
    assert both.lower == pytest.approx([1.05], abs=1e-6)
    assert both.upper == pytest.approx([1.15], abs=1e-6)
    assert both.verify()
    wrong = state_interval(WALK, [(0.0, [1.0], None), (1.0, [BelowDetection(0.5)], None)], **GIVEN)
    assert wrong.contradiction > 1


def test_a_mean_is_the_integral_over_its_time():
    """x(t) = x(2) + what w did; the mean over [0, 2] of a walk differs from x(2) by at most w_bound 2/2."""
    found = state_interval(WALK, [(2.0, [CompositeReading(1.0, since=0.0)], None)], prior_time=0.0, **GIVEN)
    assert found.radii == pytest.approx([0.05 + 0.1 * 1.0], abs=1e-5)
    assert found.centre == pytest.approx([1.0], abs=1e-5)
    assert found.verify()


def test_a_mean_counts_what_the_input_adds_to_the_output():
    plant = sd.Plant([[0.0]], [[1.0]], B=[[0.0]], D=[[2.0]], states=["level"])
    record = [(0.0, None, [0.0]), (1.0, None, [1.0]), (2.0, [CompositeReading(3.0, since=0.0)], None)]
    found = state_interval(plant, record, prior_time=0.0, w_bound=0.0, v_bound=0.05)
    assert found.centre == pytest.approx([3.0 - 2.0 * 0.5], abs=1e-6)


@pytest.mark.parametrize("maker", [sd.KalmanFilter, sd.SetMembershipEstimator])
def test_estimators_use_them_in_intervals(maker):
    estimator = maker(WALK, initial_error=5.0, **GIVEN)
    estimator.update(0.5, [1.0])
    estimate = estimator.update(1.5, [BelowDetection(0.97)])
    found = estimate.interval()
    assert found.upper == pytest.approx([1.02], abs=1e-5)
    assert found.lower == pytest.approx([0.85], abs=1e-5)
    later = estimator.update(4.0, [CompositeReading(0.9, since=2.0)])
    assert later.interval().verify()
    assert later.interval().radii[0] < 0.16
    again = estimator.update(4.5, [1.0])
    assert again.interval().radii[0] < later.interval().radii[0]


@pytest.mark.parametrize(("side", "fed"), [("left", 0.0), ("right", 10.0)])
def test_a_limit_where_the_input_jumps_takes_the_input_of_the_same_side_as_a_number(side, fed):
    """y = level + u, and u jumps at the sample: a limit and a number at that time agree about the level."""
    plant = sd.Plant([[0.0]], [[1.0]], B=[[0.0]], D=[[1.0]], states=["level"])
    for maker, more in ((sd.KalmanFilter, {}), (sd.MovingHorizonEstimator, {"horizon": 4.0})):
        estimator = maker(plant, initial_error=5.0, input_side=side, **GIVEN, **more)
        estimator.update(0.0, [1.0], [0.0])
        found = estimator.update(1.0, [BelowDetection(fed + 0.97)], [10.0]).interval()
        assert found.upper == pytest.approx([1.02], abs=1e-5)
        assert estimator.update(1.0 + 1e-9, [10.9]).interval().verify()


def test_the_moving_horizon_estimator_and_a_whole_record(tmp_path):
    path = tmp_path / "readings.csv"
    path.write_text("time,y1,y1_since\n0.5,1,\n1.5,<0.97,\n4,0.9,2\n")
    record = sd.read_measurements(path, WALK)
    found = sd.MovingHorizonEstimator(WALK, horizon=9.0, initial_error=5.0, **GIVEN).run(record)
    alone = state_interval(WALK, record, prior_time=0.0, initial_error=5.0, **GIVEN)
    assert found.estimates[-1].interval().upper == pytest.approx(alone.upper, abs=1e-5)


def test_what_cannot_be_used_is_refused():
    plain = sd.KalmanFilter(WALK)
    with pytest.raises(ArgumentError, match="`w_bound` and `v_bound` must be given for the limit, mean or"):
        plain.update(1.0, [BelowDetection(0.5)])
    assert plain.state.last.t == 0.0
    bounded = sd.KalmanFilter(WALK, **GIVEN)
    bounded.update(3.0, [CompositeReading(1.0, since=1.0)])
    with pytest.raises(ArgumentError, match=r"`since` = 2\.0 of the mean at t = 4\.0 must lie before it"):
        bounded.update(4.0, [CompositeReading(1.0, since=2.0)])
    with pytest.raises(ArgumentError, match="`limit` must be"):
        bounded.update(5.0, [BelowDetection(np.inf)])


def test_estimators_of_nonlinear_plants_take_plain_numbers():
    plant = sd.nonlinear.from_linear(WALK)
    estimator = sd.NonlinearMovingHorizonEstimator(plant, horizon=5.0, cost=sd.CostFunction(eta=0.1))
    with pytest.raises(ArgumentError, match="this estimator takes plain numbers only"):
        estimator.update(1.0, [BelowDetection(0.5)])
    with pytest.raises(ArgumentError, match="is uncertain: this estimator takes exact times only"):
        estimator.update((0.5, 1.0), [0.5])


SPRING = sd.Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0]])
BOUNDED = {"w_bound": 0.1, "v_bound": 0.2, "initial_error": 2.0}


def limited_run(seed, changed=lambda mhe: mhe, samples=12):
    """A run in which half of the readings are limits of detection: truth and estimates."""
    rng = np.random.default_rng(seed)
    mhe = changed(sd.MovingHorizonEstimator(SPRING, horizon=6.0, cost=sd.CostFunction(eta=0.2), **BOUNDED))
    x, now, truth, found = rng.uniform(-1, 1, 2), 0.0, [], []
    for t in np.cumsum(rng.uniform(0.4, 1.5, 12))[:samples]:
        w = rng.uniform(-0.07, 0.07, 2)
        x = SPRING.transition(t - now) @ x + sum(
            SPRING.transition(s) @ w * (t - now) / 40 for s in (np.arange(40) + 0.5) * (t - now) / 40
        )
        y, now = float(SPRING.C[0] @ x) + rng.uniform(-0.2, 0.2), float(t)
        limit = rng.normal() * 0.3
        told = y if rng.random() < 0.5 else BelowDetection(limit) if y < limit else AboveRange(limit)
        found.append(mhe.update(now, [told]))
        truth.append(x)
    return np.array(truth), found


@pytest.mark.parametrize("seed", few(range(4), 0, 2))
def test_limits_constrain_the_moving_horizon_estimate_which_still_holds_the_truth(seed):
    truth, found = limited_run(seed)
    for x, estimate in zip(truth, found, strict=True):
        assert estimate.status == "ok"
        assert estimate.certified
        assert estimate.holds(x)
    if seed:
        return  # the reference is slow: once, and until windows have slid
    bounded = limited_run(seed, by_the_reference, 8)[1]
    for one, other in zip(found[:8], bounded, strict=True):
        assert np.allclose(one.x, other.x, atol=2e-5)


def test_a_limit_moves_the_estimate_under_it():
    plain = sd.MovingHorizonEstimator(SPRING, horizon=6.0, prior=[3.0, 0.0], **BOUNDED)
    estimate = plain.update(0.1, [BelowDetection(1.0)])
    assert estimate.x[0] <= 1.0 + 0.2 + 1e-6
    assert estimate.x[0] > 1.1
    later = plain.update(0.2, [AboveRange(0.5)])
    assert later.x[0] >= 0.3 - 1e-6
    both = sd.Plant([[0.0]], [[1.0]])
    torn = sd.MovingHorizonEstimator(both, horizon=6.0, **BOUNDED)
    torn.update(1.0, [BelowDetection(0.0)])
    assert torn.update(1.001, [AboveRange(5.0)]).interval().contradiction > 1


def test_limits_stay_where_they_are_when_a_late_sample_is_replayed():
    rows = [(0.5, [0.4]), (1.0, [BelowDetection(0.1)]), (1.6, [0.0]), (2.2, [AboveRange(-0.3)])]
    ordered = sd.MovingHorizonEstimator(SPRING, horizon=6.0, **BOUNDED)
    late = sd.MovingHorizonEstimator(SPRING, horizon=6.0, **BOUNDED)
    last = [ordered.update(*row) for row in rows][-1]
    for k in (0, 2, 3, 1):
        again = late.update(*rows[k])
    assert np.allclose(again.x, last.x, atol=1e-10)


READ_AT_ONE = [
    0.3,
    0.4,
    BelowDetection(0.5),
    AboveRange(0.1),
    CompositeReading(0.3, 0.5),
    CompositeReading(0.4, 0.5),
    CompositeReading(BelowDetection(0.5), 0.5),
]


@pytest.mark.parametrize(("first", "late"), few(product(READ_AT_ONE, [False, True]), 1, 5, 9, 13), ids=str)
def test_an_output_has_one_reading_at_a_time_whatever_kind_it_is_of(first, late):
    two = sd.Plant([[0.0]], [[1.0], [1.0]])
    for second in READ_AT_ONE:
        mhe = sd.MovingHorizonEstimator(two, horizon=3.0, w_bound=1.0, v_bound=0.2, initial_error=5.0)
        for row in [(0.0, [0.3, np.nan]), *([(1.5, [0.3, np.nan])] if late else []), (1.0, [first, np.nan])]:
            before = mhe.update(*row)
        state = mhe.state
        if first == second:
            again = mhe.update(1.0, [second, np.nan])
            assert mhe.state is state
            np.testing.assert_array_equal(again.x, before.x)
        else:
            with pytest.raises(ArgumentError, match=r"already given as .* and an output has one reading"):
                mhe.update(1.0, [second, np.nan])
            assert mhe.state is state
        mhe.update(1.0, [np.nan, second])  # what the other output says stands beside it
        joined = sd.MovingHorizonEstimator(two, horizon=3.0, w_bound=1.0, v_bound=0.2, initial_error=5.0)
        for row in [(0.0, [0.3, np.nan]), (1.0, [first, second]), *([(1.5, [0.3, np.nan])] if late else [])]:
            whole = joined.update(*row)
        np.testing.assert_allclose(mhe.predict(2.0).x, joined.predict(2.0).x, rtol=0, atol=1e-12)
        assert whole.certified
        twice = [(0.0, [0.3, 0.3]), (1.0, [first, np.nan]), (1.0, [second, np.nan])]
        if first == second:
            once, again = (state_interval(two, rows, **GIVEN) for rows in (twice[:2], twice))
            np.testing.assert_array_equal([once.lower, once.upper], [again.lower, again.upper])
        else:
            with pytest.raises(ArgumentError, match=r"already given as .* and an output has one reading"):
                state_interval(two, twice, **GIVEN)


@pytest.mark.parametrize("nothing", [(0.1, np.inf), (-np.inf, np.inf), {"y1": np.inf}], ids=str)
def test_readings_without_a_bound_say_nothing_of_an_interval(nothing):
    rows = [(0.0, [0.5]), (2.0, [0.5])]
    found = state_interval(WALK, rows, w_bound=0.1, v_bound=nothing, initial_error=1.0)
    assert (found.lower[0], found.upper[0]) == pytest.approx((-1.2, 1.2), rel=1e-6)


@pytest.mark.parametrize(
    "rows",
    [
        ["0,0.5,<0.1", "1,,> 3", "2,<0.2,", "3,,", "4, <1e-3 ,>-2", "5,0.25,0.5"],
        ["0,<0.1,<0.2"],
        ["0;0,5;<0,1", "1;;>3", "2;<0,2;"],
    ],
)
def test_rows_with_limits_are_read_at_once_as_they_are_one_by_one(tmp_path, rows):
    plant = sd.Plant(-np.eye(2), np.eye(2), outputs=["a", "b"], time_unit="h")
    mark = ";" if ";" in rows[0] else ","
    read = []
    for name, begin in (("at_once", ""), ("one_by_one", '"')):  # a quote: no row of that block is plain
        path = tmp_path / f"{name}.csv"
        last = mark.join(["9", f"{begin}1{begin}", "1"])
        path.write_text("\n".join([mark.join(["time", "a", "b"]), *rows, last]) + "\n")
        read.append(sd.read_measurements(path, plant))
    at_once, one_by_one = read
    np.testing.assert_array_equal(at_once.times, one_by_one.times)
    np.testing.assert_array_equal(at_once.y, one_by_one.y)
    assert at_once.censored == one_by_one.censored
    assert any(at_once.censored)


def test_a_limit_without_its_number_is_refused_with_its_line(tmp_path):
    plant = sd.Plant(-np.eye(2), np.eye(2), outputs=["a", "b"], time_unit="h")
    path = tmp_path / "half.csv"
    path.write_text("time,a,b\n0,<0.1,1\n1,<,1\n")
    with pytest.raises(FileFormatError, match="line 3"):
        sd.read_measurements(path, plant)
