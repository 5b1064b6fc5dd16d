"""Late and out-of-order samples give the estimates of the samples in order, and rewrite nothing that was handed out."""

import numpy as np
import pytest

from sampling_design import Constraints, KalmanFilter, Measurements, Plant, read_measurements, state_interval
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.estimators.mhe import MovingHorizonEstimator
from tests.cases import few

PLANT = Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0], [0.0, 1.0]], B=[[0.0], [1.0]], D=[[0.1], [0.0]])


def record(seed, count=24):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.2, 0.9, count))
    ys = rng.normal(size=(count, 2))
    ys[rng.random((count, 2)) < 0.3] = np.nan
    ys[np.isnan(ys).all(axis=1), 0] = 0.5
    us = rng.normal(size=(count, 1))
    return [(float(t), y, u if k % 3 == 0 else None) for k, (t, y, u) in enumerate(zip(times, ys, us, strict=True))]


NAMES = ["mhe", "constrained", "paper carried", "from samples", "filter"]


def estimators():
    bounds = {"w_bound": 0.5, "v_bound": 2.0, "initial_error": 1.0}
    yield lambda: MovingHorizonEstimator(PLANT, horizon=4.0, cost=CostFunction(eta=0.3), **bounds)
    yield lambda: MovingHorizonEstimator(
        PLANT, horizon=4.0, cost=CostFunction(eta=0.3), constraints=Constraints(x=([-0.5, -0.5], [0.5, 0.5])), **bounds
    )
    yield lambda: MovingHorizonEstimator(
        PLANT, horizon=4.0, cost=CostFunction(eta=0.3, form="paper", arrival="filtered")
    )
    yield lambda: MovingHorizonEstimator(PLANT, horizon=4.0, cost=CostFunction(eta=0.3, begins="sample"), **bounds)
    yield lambda: KalmanFilter(PLANT, cost=CostFunction(eta=0.3), maximum_delay=4.0, **bounds)


def check_same(a, b):
    assert a.t == b.t
    for left, right in ((a.x, b.x), (a.covariance, b.covariance), (a.cost, b.cost)):
        np.testing.assert_allclose(left, right, rtol=1e-12, atol=1e-12)
    # its dual bound is about reference trajectories, which samples in another order choose anew
    np.testing.assert_allclose(a.radius, b.radius, rtol=1e-11, atol=1e-12)
    assert (a.status, a.certified, a.on_schedule) == (b.status, b.certified, b.on_schedule)


@pytest.mark.parametrize(
    "make", list(estimators()), ids=["mhe", "constrained", "paper carried", "from samples", "filter"]
)
@pytest.mark.parametrize("seed", few(range(3), 1))
def test_any_order_within_the_window(make, seed):
    rows = record(seed)
    straight, shuffled = make(), make()
    in_order = [straight.update(*row) for row in rows]
    order = sorted(range(len(rows)), key=lambda k: rows[k][0] + np.random.default_rng(seed + 100 * k).uniform(0, 3.0))
    assert order != sorted(order)
    handed_out = []
    for k in order:
        estimate = shuffled.update(*rows[k])
        handed_out.append((estimate, estimate.x.copy(), estimate.radius))
    check_same(shuffled.predict(rows[-1][0]), in_order[-1])
    check_same(shuffled.predict(rows[-1][0] + 1.0), straight.predict(rows[-1][0] + 1.0))
    for estimate, x, radius in handed_out:
        assert np.array_equal(estimate.x, x)
        assert np.array_equal(estimate.radius, radius, equal_nan=True)
        assert not estimate.x.flags.writeable
    # past online estimates that are still kept agree too
    check_same(shuffled.predict(rows[-4][0]), straight.predict(rows[-4][0]))


@pytest.mark.parametrize(
    "make", list(estimators()), ids=["mhe", "constrained", "paper carried", "from samples", "filter"]
)
def test_outputs_of_one_time_may_come_apart_and_an_input_may_come_late(make):
    rows = record(5)
    straight, apart = make(), make()
    for t, y, u in rows:
        straight.update(t, y, u)
    for k, (t, y, _) in enumerate(rows):
        for i in np.flatnonzero(np.isfinite(y))[::-1]:
            apart.update(t, [y[j] if j == i else np.nan for j in range(2)])
        if k >= 2 and rows[k - 2][2] is not None:
            apart.update(rows[k - 2][0], None, rows[k - 2][2])
    for t, _, u in rows[-2:]:
        if u is not None:
            apart.update(t, None, u)
    check_same(apart.predict(rows[-1][0]), straight.predict(rows[-1][0]))


def test_step_is_pure():
    mhe = MovingHorizonEstimator(PLANT, horizon=4.0, cost=CostFunction(eta=0.3))
    rows = record(7)
    state = mhe.initial_state()
    states, estimates = [state], []
    for row in rows:
        state, estimate = mhe.step(state, row)
        states.append(state)
        estimates.append(estimate)
    for k in (3, 9, 15):
        again, estimate = mhe.step(states[k], rows[k])
        check_same(estimate, estimates[k])
        assert len(again.nodes) == len(states[k + 1].nodes)
    assert mhe.state.last.t == 0.0


@pytest.mark.parametrize(
    ("make", "origin"), [(make, 1.7e9 * (k == 1)) for k, make in enumerate(estimators())], ids=NAMES
)
def test_what_is_corrected_or_withdrawn_is_as_if_it_had_come_so_at_first(make, origin):
    """Against the record from the start: a value, an input, one output, a whole sample, and the last one."""
    rows = [(origin + t, y, u) for t, y, u in record(3, 14)]
    wrong, right = make(), make()
    for estimator in (wrong, right):
        estimator.start([0.0, 0.0], origin)
    moved = next(k for k in range(len(rows) - 5, len(rows)) if rows[k][2] is not None)
    one = next(k for k in range(len(rows) - 5, len(rows)) if np.isfinite(rows[k][1]).all())
    gone = next(k for k in range(len(rows) - 5, len(rows)) if k not in (one, moved))
    for k, (t, y, u) in enumerate(rows):
        wrong.update(t, [*(y + 0.3 * (k == one))], u if u is None or k != moved else u + 1.0)
    before = [(e.x.copy(), e.radius) for e in [wrong.predict(rows[-1][0])]]
    wrong.correct(rows[moved][0], u=rows[moved][2])
    wrong.correct(rows[one][0], [rows[one][1][0], np.nan])
    wrong.withdraw(rows[one][0], "y2")
    last = wrong.withdraw(rows[gone][0])
    assert not np.array_equal(last.x, before[0][0])
    for k, (t, y, u) in enumerate(rows):
        said = None if k == gone else [y[0], np.nan] if k == one else y
        if said is not None or u is not None:
            found = right.update(t, said, u)
    check_same(wrong.predict(rows[-1][0]), right.predict(rows[-1][0]))
    check_same(wrong.withdraw(rows[-1][0]), right.withdraw(rows[-1][0]))
    assert found.t == rows[-1][0]


def test_a_maximum_delay_of_ones_own_takes_older_results_and_refuses_what_is_older_still():
    """More than a window back the estimate is that of the samples in order, too; the default is a window."""
    rows, bounds = [(t, y, None) for t, y, _ in record(11)], {"w_bound": 0.5, "v_bound": 2.0, "initial_error": 1.0}
    make = [
        lambda **more: MovingHorizonEstimator(PLANT, horizon=2.0, cost=CostFunction(eta=0.3), **bounds, **more),
        lambda **more: KalmanFilter(PLANT, cost=CostFunction(eta=0.3), **bounds, **more),
    ]
    late, after = rows[4], [row for row in rows[:18] if row is not rows[4]]
    age = after[-1][0] - late[0]
    for new in make:
        patient, straight, hasty = new(maximum_delay=age), new(), new(maximum_delay=0.9 * age)
        for row in after:
            patient.update(*row)
            hasty.update(*row)
        found = patient.update(*late)
        wanted = [straight.update(*row) for row in rows[:18]][-1]
        check_same(found, wanted)
        for refused, given in ((hasty.update, late), (hasty.correct, late), (hasty.withdraw, late[:1])):
            with pytest.raises(ArgumentError, match="goes back beyond the window that is kept for late samples"):
                refused(*given)
    with pytest.raises(ArgumentError, match="`maximum_delay` must not be negative"):
        make[0](maximum_delay=-1.0)


@pytest.mark.parametrize("make", list(estimators()), ids=NAMES)
def test_whatever_is_withdrawn_from_the_end_the_rest_is_as_if_it_had_never_come(make):
    """One after the other, until what came before is no longer kept; then samples come again and are corrected."""
    rows, back, straight = [(t, y, None) for t, y, _ in record(2, 48)], make(), make()
    for row in rows:
        back.update(*row)
    kept = len(rows)
    for t, *_ in rows[::-1]:
        state = back.state
        try:
            back.withdraw(t)
        except ArgumentError:
            assert back.state is state
            break
        kept -= 1
    assert 3 <= kept <= len(rows) - 5
    for row in rows[:kept]:
        straight.update(*row)
    check_same(back.predict(rows[kept - 1][0]), straight.predict(rows[kept - 1][0]))
    for t, y, _ in rows[kept:]:
        check_same(back.update(t, 0.5 * y), straight.update(t, 0.5 * y))
        check_same(back.correct(t, y), straight.correct(t, y))


def test_what_cannot_be_corrected_is_refused_and_changes_nothing():
    mhe = MovingHorizonEstimator(PLANT, horizon=4.0, cost=CostFunction(eta=0.3))
    for t, y in ((1.0, [1.0, np.nan]), (2.0, [0.5, 0.2])):
        mhe.update(t, y)
    state = mhe.state
    for refused, words in (
        (lambda: mhe.correct(1.5, [1.0, 1.0]), "must be the time of a sample that is kept, got 1.5. A new one is for"),
        (lambda: mhe.withdraw(0.0), "must be the time of a sample that is kept, got 0.0"),
        (lambda: mhe.correct(1.0, [1.0, 1.0]), ", where it was not read. A new reading is for update"),
        (lambda: mhe.correct(1.0, u=[1.0]), "`u` corrects an input at t = 1.0, where none was given"),
        (lambda: mhe.withdraw(1.0, "y2"), "`output` = 'y2' was not read at t = 1.0"),
        (lambda: mhe.withdraw(1.0, "z"), "`output` must be"),
        (lambda: mhe.correct(1.0), "`y` and `u` are both missing"),
    ):
        with pytest.raises(ArgumentError, match=words):
            refused()
        assert mhe.state is state


@pytest.mark.parametrize("zero", [0.0, 1.7e9])
@pytest.mark.parametrize("seed", few(range(12), 0, 5))
def test_a_record_says_the_same_in_any_order_and_in_parts(seed, zero, tmp_path):
    """Rows of one time that complete each other are one, to whoever reads them: a file, `merged`, intervals, `run`."""
    rng = np.random.default_rng(seed)
    whole = [(zero + t, y, np.zeros(1) if u is None else u) for t, y, u in record(seed, 8)]
    parts = [(t, np.where(np.arange(2) == i, y, np.nan), u) for t, y, u in whole for i in range(2) if np.isfinite(y[i])]
    shuffled = [parts[k] for k in rng.permutation([*range(len(parts)), *rng.integers(len(parts), size=2)])]
    cells = [[repr(float(v)) if np.isfinite(v) else "" for v in (t, *y, *u)] for t, y, u in shuffled]
    path = tmp_path / "parts.csv"
    path.write_text("\n".join(map(",".join, [["time", *PLANT.outputs.names, *PLANT.inputs.names], *cells])))
    t, y, u = map(np.array, zip(*whole, strict=True))
    half = rng.random(len(parts)) < 0.5
    one, two = (
        Measurements(
            PLANT,
            *map(np.array, zip(*[row for row, mine in zip(parts, half, strict=True) if mine == side], strict=True)),
        )
        for side in (True, False)
    )
    for found in (read_measurements(path, PLANT).in_order(), one.merged(two)):
        assert np.array_equal(found.times, t)
        assert np.array_equal(found.y, y, equal_nan=True)
        assert np.array_equal(found.u, u)
    bounds = {"w_bound": 0.5, "v_bound": 2.0, "initial_error": 9.0, "prior_time": zero}
    ends = [state_interval(PLANT, rows, **bounds) for rows in (whole, shuffled)]
    assert np.array_equal([ends[0].lower, ends[0].upper], [ends[1].lower, ends[1].upper])
    assert np.isfinite(ends[0].upper).all()
    weights = CostFunction(eta=0.3)
    runs = [MovingHorizonEstimator(PLANT, horizon=4.0, cost=weights, **bounds).run(r) for r in (whole, shuffled)]
    np.testing.assert_allclose(runs[0][-1].x, runs[1][-1].x, rtol=1e-9, atol=1e-9)


def test_a_row_at_a_time_and_one_that_may_have_been_taken_then_stay_two():
    """A joined row would say of the sure reading, too, that nobody knows its time."""
    sure = Measurements(PLANT, [1.0], [[1.0, np.nan]])
    some = Measurements(PLANT, [(0.5, 1.5)], [[np.nan, 2.0]])
    both = sure.merged(some)
    assert [both.span_of(k) for k in range(len(both))] == [None, (0.5, 1.5)]
    with pytest.raises(ArgumentError, match="contradicts these measurements at 1"):
        sure.merged(Measurements(PLANT, [1.0], [[1.5, 0.0]]))
