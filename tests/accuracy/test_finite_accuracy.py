"""Finite schedules: what is known at the start, bounds per sample and per sensor, intervals, and what stays unknown."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.accuracy import finite
from sampling_design.accuracy.bounded_directions import BoundedDirections
from sampling_design.accuracy.bounds import SignalBounds
from sampling_design.accuracy.gains import Gains, RepeatedIntegrals
from sampling_design.accuracy.lasting import LastingResponses
from sampling_design.errors import ArgumentError, UndecidedError
from sampling_design.numerics.cone_table import ConeTable
from sampling_design.numerics.conic_programs import ConeSolver
from tests.cases import few
from tests.oracles import accuracy as oracle

PLANT = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
TIMES = np.array([1.0, 2.0, 2.6, 4.0, 5.0])
SCHEDULE = sd.Schedule(TIMES)


@pytest.mark.parametrize("size", [1e-200, 1e-25, 1.0, 1e25, 1e200])
def test_the_strongest_lasting_response_is_the_same_in_any_units(size):
    """Of x1 + x2 where noise allows |x1 + 2 x2| <= 1 and |x1| <= 1, in units of the size, once w drives neither."""
    plant = sd.Plant(np.zeros((2, 2)), size * np.array([[1.0, 2.0], [1.0, 0.0]]), G=np.zeros((2, 1)))
    bounds = SignalBounds.of(plant, 1, None, 0.0, [1.0, 1.0])
    lasting = LastingResponses.of(plant, bounds)
    assert lasting.undriven
    table = ConeTable(2 + lasting.columns)
    lasting.begin(table, 2, size * np.eye(2))
    table.end("zero")
    lasting.pose(table, 2, ball=False)
    table.end("nonnegative")
    lasting.pose(table, 2, ball=True)
    solver = ConeSolver(table.matrix(), table.cones, tolerance=1e-11)
    found, *_ = solver.solve(np.append([-1.0, -1.0], np.zeros(lasting.columns)), table.b())
    past = lasting.trajectory(found[2:])
    assert size * past.state == pytest.approx([1.0, 0.0], rel=1e-9, abs=1e-9)
    assert past.excess(plant, bounds) == pytest.approx(1.0, rel=1e-9)


@pytest.fixture(scope="module")
def free():
    return sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=0.02, v_bound=0.1)


def test_the_oracle_agrees_at_every_sample(free):
    for k in range(1, 5):
        for row in np.eye(2):
            low, *_ = oracle.adversary(PLANT.A, PLANT.C, PLANT.G, TIMES[: k + 1], row, 0.02, 0.1, cells=8)
            high, _ = oracle.gains(PLANT.A, PLANT.C, PLANT.G, TIMES[: k + 1], row, 0.02, 0.1, cells=8)
            value = free.at_samples[int(row[1]), k]
            assert value == pytest.approx((low + high) / 2, rel=2e-3)
    assert free.verify()


def test_a_row_is_unknown_until_samples_determine_it(free):
    assert np.isinf(free.at_samples[1, 0])
    assert free.at_samples[0, 0] == pytest.approx(0.1)
    assert free.known_from.tolist() == [2.0, 2.0]
    before = free.profile.edges[:-1] < 2.0
    assert np.all(np.isinf(free.profile.upper[:, before]))
    assert np.all(np.isfinite(free.profile.upper[:, ~before]))
    assert np.all(free.profile.lower <= free.profile.upper)
    assert "From 2 s on, some estimator guarantees" in free.explain()
    assert "unknown before 2 s" in str(free)


@pytest.mark.parametrize(
    ("initial", "size", "norm"),
    few(
        [
            (0.3, np.full(2, 0.3), "ball"),
            ([0.05, 0.4], np.array([0.05, 0.4]), "box"),
            (np.diag([4.0, 25.0]), np.array([0.5, 0.2]), "ball"),
            ({"velocity": 0.2}, np.array([np.inf, 0.2]), "box"),
            ({"velocity": (0.1, 0.5), "position": 0.0}, np.array([0.0, 0.2]), "box"),
        ],
        0,
        2,
    ),
)
def test_every_kind_of_initial_set_agrees_with_the_oracle(initial, size, norm):
    found = sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=0.02, v_bound=0.1, initial_error=initial, start=0.5)
    assert np.all(found.closed)
    assert found.verify()
    start = (size, norm)
    for row in np.eye(2):
        low, *_ = oracle.adversary(
            PLANT.A, PLANT.C, PLANT.G, [0.5, *TIMES[:3]], row, 0.02, 0.1, cells=10, start=start, unmeasured=(0,)
        )
        assert found.at_samples[int(row[1]), 2] == pytest.approx(low, rel=4e-3)


def test_before_the_first_sample_the_start_flows():
    found = sd.guaranteed_accuracy(
        PLANT, SCHEDULE, w_bound=0.0, v_bound=0.1, initial_error=[0.3, 0.2], start=0.0, end=7.0
    )
    at = int(np.searchsorted(found.profile.edges, 0.5))
    expected = 0.3 + 0.2 * found.profile.edges[at]
    assert found.profile.lower[0, at] == pytest.approx(expected)
    assert found.profile.edges[-1] == 7.0
    assert found.worst[1] == 0.0


@pytest.mark.long
def test_a_better_instrument_today_helps():
    plain = sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=0.02, v_bound=0.1)
    rows = np.full((5, 1), 0.1)
    rows[3] = 0.01
    better = sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=0.02, v_bound=rows)
    assert better.at_samples[0, 3] == pytest.approx(0.01)
    assert np.all(better.at_samples[1, 3:] < plain.at_samples[1, 3:])

    def instrument(t):
        return 0.01 if t == 4.0 else 0.1

    for same in (instrument, {"y1": instrument}, {"y1": rows[:, 0].tolist()}):
        again = sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=0.02, v_bound=same)
        assert again.upper == pytest.approx(better.upper)


def test_an_infinite_bound_is_a_sample_that_was_not_taken():
    rows = np.full((5, 1), 0.1)
    fewer = sd.guaranteed_accuracy(PLANT, sd.Schedule(TIMES[[0, 2, 3, 4]]), w_bound=0.02, v_bound=0.1)
    skipped = sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=0.02, v_bound={"y1": [0.1, (-np.inf, 0.1), *rows[2:, 0]]})
    assert skipped.upper == pytest.approx(fewer.upper, rel=2e-3)
    assert skipped.known_from[0] == 2.6


@pytest.mark.long
def test_intervals_keep_the_width_and_shift_the_centre():
    """A sensor that reads .1 too high on average shifts the position by -.1; a push looks like so much velocity."""
    centred = sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=[0.01, 0.02], v_bound={"y1": 0.1})
    high = sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=[0.01, 0.02], v_bound={"y1": (0.0, 0.2)})
    pushed = sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound={"w1": (0.0, 0.02), "w2": 0.02}, v_bound={"y1": 0.1})
    for found, offset in ((centred, [0.0, 0.0]), (high, [-0.1, 0.0]), (pushed, [0.0, -0.01])):
        assert found.upper == pytest.approx(centred.upper)
        assert found.offset == pytest.approx(offset, abs=1e-9)
        assert found.verify()
    assert "offset of velocity" in str(pushed)
    endless = sd.guaranteed_accuracy(
        PLANT, sd.PeriodicSchedule([1.0, 0.6]), w_bound={"w1": (0.0, 0.02), "w2": 0.02}, v_bound={"y1": (0.0, 0.2)}
    )
    assert endless.offset == pytest.approx([-0.1, -0.01], rel=1e-6)


def test_names_choose_and_order_the_sensors():
    plant = sd.Plant(np.zeros((2, 2)), np.eye(2), outputs=["left", "right"])
    found = sd.guaranteed_accuracy(plant, SCHEDULE, w_bound=0.0, v_bound={"right": 0.2, "left": 0.1})
    assert found.upper == pytest.approx([0.1, 0.2], rel=1e-4)


def test_a_bound_of_what_is_known_nowhere_does_not_verify():
    plant = sd.Plant(np.diag([0.1, 0.2]), np.eye(2))
    found = sd.guaranteed_accuracy(
        plant, sd.Schedule([0.0, 1.0], [[1, 0], [1, 0]]), w_bound=0.1, v_bound=0.1, of=["x2"]
    )
    assert np.isinf(found.upper[0])
    assert found.verify()
    assert not replace(found, upper=np.array([0.1])).verify()


def test_a_forged_start_does_not_verify():
    found = sd.guaranteed_accuracy(PLANT, SCHEDULE, w_bound=0.02, v_bound=0.1, initial_error=[0.3, 0.2])
    assert found.verify()
    narrower = sd.accuracy.bounds.InitialSet.of(PLANT, [0.03, 0.02])
    forged = replace(found, question=replace(found.question, initial=narrower))
    assert not forged.verify()


def test_more_samples_never_widen_it(free):
    more = sd.guaranteed_accuracy(PLANT, sd.Schedule([1.0, 1.7, 2.0, 2.6, 3.2, 4.0, 5.0]), w_bound=0.02, v_bound=0.1)
    shared = [0, 2, 3, 5, 6]
    finite = np.isfinite(free.at_samples)
    assert np.all(more.at_samples[:, shared][finite] <= free.at_samples[finite] * 1.002)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"start": 1.5}, "`start` must not lie after the first sample 1.0, got 1.5"),
        ({"end": 4.5}, "`end` must not lie before the last sample 5.0, got 4.5"),
        ({"schedule": sd.PeriodicSchedule([1.0]), "start": 0.0}, "`start` is for finite schedules"),
        ({"initial_error": -1.0}, "`initial_error`"),
        ({"initial_error": [1.0]}, "`initial_error` must be a number, 2 half-widths"),
        ({"initial_error": -np.eye(2)}, "`initial_error` as a matrix P means e'P e <= 1"),
        ({"initial_error": {"velocity": (1.0, 0.0)}}, "lower exceeds upper"),
        ({"initial_error": {"velocity": (1.0, 0.0, 2.0)}}, "must be a number or a pair"),
        ({"initial_error": {"velocty": 1.0}}, "velocty"),
        ({"v_bound": {}}, "`v_bound` is missing for y1, which the schedule measures"),
        ({"w_bound": {"w1": 0.1}}, "`w_bound` is missing for w2: give both ends, or 0"),
        ({"w_bound": lambda t: t}, "`w_bound` must be numbers, got a function"),
        ({"v_bound": {"y1": [0.1, 0.2]}}, "must have one entry for each of 5 samples, got 2"),
        ({"v_bound": -np.ones((5, 1))}, "`v_bound` must not be negative"),
        ({"v_bound": (np.array([0.1]), np.array([0.2]))}, "`v_bound` must "),
        ({"v_bound": {"y1": (np.array([0.1, 0.2]), 0.3)}}, r"`v_bound\['y1'\]` must be a number, got ndarray"),
        ({"w_bound": (np.array([0.1, 0.2]), np.array([0.2, 0.3]))}, "`w_bound` must "),
        ({"initial_error": {"velocity": (0.1, "x")}}, r"`initial_error\['velocity'\]` must be a number"),
        ({"v_bound": lambda t: 0.1 if t > 2 else [0.1]}, "numbers for all samples or entries for all samples"),
        ({"schedule": sd.Schedule([])}, "at least one sample"),
    ],
)
def test_bad_input_is_refused(change, match):
    given = {"schedule": SCHEDULE, "w_bound": 0.02, "v_bound": 0.1} | change
    with pytest.raises(ArgumentError, match=match):
        sd.guaranteed_accuracy(PLANT, given.pop("schedule"), **given)


def test_functions_need_sample_times():
    from sampling_design.accuracy.bounds import SignalBounds

    with pytest.raises(ArgumentError, match="there are no sample times to give it"):
        SignalBounds.of(PLANT, 2, None, 0.1, lambda t: t)


def test_intervals_off_centre_need_an_owner():
    from sampling_design.accuracy.bounds import SignalBounds

    with pytest.raises(ArgumentError, match="`v_bound` must be centred at 0 here"):
        SignalBounds.of(PLANT, 2, None, 0.1, {"y1": (0.0, 1.0)})


def test_a_row_that_stays_unknown_has_its_mode_named():
    hidden = sd.Plant([[0.1, 0.0], [0.0, 0.0]], [[0.0, 1.0]], states=["hidden", "seen"])
    found = sd.guaranteed_accuracy(hidden, sd.Schedule([0.0, 1.0]), w_bound=0.1, v_bound=0.1)
    assert found.unknown == ("0.1",)
    assert "No error bound of hidden holds at all times: the samples do not determine the mode with eigenvalue 0.1" in (
        found.explain()
    )
    early = sd.guaranteed_accuracy(
        sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]]), sd.Schedule([0.0]), w_bound=0.1, v_bound=0.1
    )
    assert early.unknown == ("0",)
    assert sd.guaranteed_accuracy(hidden, sd.Schedule([0.0, 1.0]), w_bound=0.1, v_bound=0.1, of="seen").unknown == ()


def test_a_row_that_is_known_at_its_sample_alone_says_so():
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
    found = sd.guaranteed_accuracy(plant, sd.Schedule([0.0]), w_bound=0.1, v_bound=0.1, end=2.0)
    assert "at single times only" in str(found)
    assert "Where the samples determine them, some estimator guarantees position within 0.1" in found.explain()


STIFF = sd.Schedule([0.0, 1.0], np.array([[True, False], [False, True]]))


def stiff(rate, turn=0.0):
    """A fast state that only the second sample shows, beside a slow one that both do; and a row of both."""
    Q = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    C = np.array([[0.0, 1.0], [1.0, 1.0]]) @ Q.T
    return sd.Plant(Q @ np.diag([-rate, -0.1]) @ Q.T, C, G=Q), np.array([[1000.0, 1.0]]) @ Q.T


@pytest.mark.parametrize("turn", [0.0, 0.7])
@pytest.mark.parametrize("rate", [5.0, 12.0])
def test_a_fast_state_of_which_nothing_is_known_is_known_from_where_it_is_seen(rate, turn):
    plant, row = stiff(rate, turn)
    found = sd.guaranteed_accuracy(plant, STIFF, w_bound=[1e-6, 1e-6], v_bound=[0.1, 0.1], of=row)
    # the slow one is known to .1 e^-.1 by then, the fast one to .1 more, and the two errors have opposite signs
    assert found.at_samples[0, 1] == pytest.approx(100 + 999 * 0.1 * np.exp(-0.1), rel=1e-4)
    # an entry of w that the witness hardly uses closes its flight as well: up to 1e4 times too little was said
    assert found.lower[0] > 0.999 * found.upper[0]


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_what_has_faded_before_it_is_seen_is_not_taken_for_unseen(turn):
    """The row was promised to within .094 where the truth is about 190."""
    plant, row = stiff(40.0, turn)
    with pytest.raises(UndecidedError, match="becomes so small beside the rest"):
        sd.guaranteed_accuracy(plant, STIFF, w_bound=[1e-6, 1e-6], v_bound=[0.1, 0.1], of=row)
    bounded = sd.guaranteed_accuracy(
        plant, STIFF, w_bound=[1e-6, 1e-6], v_bound=[0.1, 0.1], of=row, initial_error=[1.0, 1.0]
    )
    assert bounded.upper[0] < 1001 * np.sqrt(2)  # where it begins, in turned coordinates


def test_what_no_sample_shows_stays_unknown_however_fast_it_fades():
    known = {"w_bound": [1e-3, 1e-3], "v_bound": 0.1}
    found = sd.guaranteed_accuracy(
        sd.Plant(np.diag([-40.0, -0.1]), [[0.0, 1.0]], G=np.eye(2)), sd.Schedule([0.0, 1.0]), **known
    )
    assert found.upper == pytest.approx([np.inf, 0.1], rel=1e-3)
    with pytest.raises(UndecidedError, match="becomes so small beside the rest"):
        sd.guaranteed_accuracy(
            sd.Plant(np.diag([-400.0, -0.1]), [[0.0, 1.0]], G=np.eye(2)), sd.Schedule([0.0, 1.0]), **known
        )


@pytest.mark.parametrize("root", [np.zeros((1, 1)), np.diag([1.0, 0.0]), [[1.0, 0.0], [1.0, 1e-30]]])
def test_coordinates_are_regular_whatever_has_decayed(root):
    made = finite.coordinate_root(np.array(root))
    assert made @ made.T == pytest.approx(np.array(root) @ np.transpose(root), abs=1e-12)
    assert np.linalg.cond(made / np.linalg.norm(made, axis=1, keepdims=True)) < 1e7


def test_what_is_known_exactly_and_moved_by_others_costs_no_digits():
    """In a small unit beside an exact sensor: 1e88 was said of what 1.3 holds."""
    plant = sd.Plant([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [3e5, 2.0, 0.0]], [[0.1, 0.3, 4e-6], [0.1, -3.0, 7e-6]])
    known = {"start": 0.0, "initial_error": [1.0, 1.0, 0.0]}
    found = sd.guaranteed_accuracy(plant, sd.Schedule([0.3, 1.0]), w_bound=0.0, v_bound=[0.0, 3e-4], of="x2", **known)
    assert found.upper == pytest.approx([1.3], rel=1e-3)
    assert found.verify()


@pytest.mark.parametrize("free", [[[1.0, 1.0], [0.0, 0.0]], [[1.0, 0.0], [0.0, 0.0]]])
def test_what_is_free_and_points_one_way_is_undecided(free):
    with pytest.raises(UndecidedError, match="undecided"):
        finite._determined(np.array(free), [np.zeros((1, 2))])


@pytest.mark.parametrize(
    ("initial", "noise"),
    few(
        product([None, [np.inf, 1.0], {"x1": 1.0}, [[1.0, 0.2], [0.2, 0.04]], 1.0], [[0.0, 0.0, 0.0], [0.0, 0.0, 0.1]]),
        *(0, 4, 7),
    ),
)
def test_what_exact_sensors_show_twice_is_known_whatever_the_start(initial, noise):
    """Two exact outputs of two states that nothing drives: from the first sample on nothing is left but rounding."""
    A, C = [[0.7, -0.4], [0.9, 0.5]], [[1.0, 0.3], [-0.4, 0.8], [0.5, 1.1]]
    plant, times = sd.Plant(A, C, G=[[1.0], [0.0]]), np.array([0.7, 1.2, 1.6, 2.5])
    known = {"initial_error": initial, "start": 0.5, "rtol": 0.05}
    found = sd.guaranteed_accuracy(plant, sd.Schedule(times), w_bound=0.0, v_bound=noise, **known)
    late = found.profile.edges[:-1] >= times[1] - 1e-9
    assert np.all(found.profile.upper[:, late] <= 1e-5)
    assert np.all(found.upper[np.isfinite(found.upper)] <= 10.0)


KNOWN = [(1.0, 0.1, np.inf), (1e9, 0.0, np.inf), (1e-9, 0.0, 1.0), (1e6, 0.1, 1.0)]


@pytest.mark.parametrize(("unit", "noise", "start"), few(KNOWN, 0, 1))
def test_an_entry_that_is_known_for_ever_is_as_good_as_left_out(unit, noise, start):
    """x3' = -.5 x3 is 0 from the start on: both sides are those of the plant without it, in whatever units."""
    A = np.array([[-0.3, 0.4, -0.6], [0.6, -0.9, 0.5], [0.0, 0.0, -0.5]])
    C, G, times = np.array([[1.0, 0.3, 2.0], [0.1, 1.0, 0.5]]), np.array([[0.5], [0.3], [0.0]]), sd.Schedule([1.0, 1.6])
    bounds, D = {"w_bound": 0.1, "v_bound": [noise, 0.1], "of": ["x1"]}, np.array([unit, 1.0, 1 / unit])
    plant = sd.Plant(A * D[:, None] / D, C / D, G=G * D[:, None])
    found = sd.guaranteed_accuracy(plant, times, **bounds, initial_error=np.array([np.inf, start, 0.0]) * D)
    alone = sd.guaranteed_accuracy(
        sd.Plant(A[:2, :2], C[:, :2], G=G[:2]), times, **bounds, initial_error=[np.inf, start]
    )
    assert found.upper / unit == pytest.approx(alone.upper, rel=1e-3)
    assert found.lower / unit == pytest.approx(alone.lower, rel=1e-3)
    assert found.known_from == pytest.approx(alone.known_from)
    assert found.verify()


def test_a_directions_bound_that_is_infinite_hides_no_time():
    """What rounding leaves unbounded at a sample is unknown there: a number that is none would be left out."""
    directions = BoundedDirections(np.eye(2), np.array([2.0, np.inf]))
    directions.add(np.array([1.0, 0.0]), Gains(1.0, ()))
    with np.errstate(all="raise"):
        bounds = directions.bound(np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]))
    assert bounds.tolist() == [1.0, np.inf, np.inf]


def test_a_search_ends_where_only_what_nobody_sought_is_left():
    """Nothing drives x2 and x3, which are known: what is left of their bounds is the width of panels."""
    A = [[-0.985, -1.366, -1.072], [0.0, 0.565, -0.376], [0.0, -1.341, -0.859]]
    plant = sd.Plant(A, [[-1.223, 0.183, -1.213]], G=np.zeros((3, 1)))
    schedule = sd.Schedule([0.83, 1.7, 2.27, 3.25, 3.58, 4.26])
    bounds = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": [np.inf, 0.0, 0.0]}
    found = sd.guaranteed_accuracy(plant, schedule, of=["x2", "x3"], budget=60.0, **bounds)
    assert np.all(found.closed)
    assert np.all(found.upper <= 1e-7)


@pytest.mark.parametrize("seed", few(range(12), 6, 8))
def test_what_is_proven_once_the_budget_is_spent_verifies(seed):
    """Gains of a filter count as what they prove when they are evaluated again, not as what a sketch says of them."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    plant = sd.Plant(rng.normal(size=(n, n)) * 0.5 - 0.3 * np.eye(n), rng.normal(size=(2, n)))
    schedule = sd.Schedule(np.cumsum(rng.uniform(0.2, 0.8, 8)))
    bounds = {"w_bound": 0.1, "v_bound": [0.1, 0.1], "initial_error": 1.0}
    assert sd.guaranteed_accuracy(plant, schedule, budget=1e-9, **bounds).verify()


@pytest.mark.parametrize("initial", few([None, 1.0], 1))
def test_what_bounds_a_sample_is_worked_out_when_it_is_asked_for(monkeypatch, initial):
    """In whatever order, the same to the last digit; with those alone on which it rests."""
    rng = np.random.default_rng(5)
    schedule = sd.Schedule(np.cumsum(rng.uniform(0.3, 0.8, 60)))
    given = {"w_bound": 0.02, "v_bound": 0.1, "initial_error": initial}
    system = sd.guaranteed_accuracy(PLANT, schedule, **given, budget=1e-9).question.filter_bounds(PLANT)[0]
    whole, counted, bounds = [*finite.FiniteDirections(system)], list[int](), finite.path_bounds

    def path(system, nodes, *given):
        counted.append(nodes[-1])
        return bounds(system, nodes, *given)

    monkeypatch.setattr(finite, "path_bounds", path)
    last = finite.FiniteDirections(system)
    assert not counted
    assert np.array_equal(last[59].reach, whole[59].reach)
    assert len(set(counted)) <= 12
    for k in range(60)[::-1]:
        assert np.array_equal(last[k].reach, whole[k].reach)
        assert np.array_equal(last[k].basis, whole[k].basis)
    assert len(set(counted)) == 60
    assert len(counted) <= 120


def test_integrals_that_come_again_are_worked_out_once(monkeypatch):
    """What paths prove with them is what they prove without, to rounding."""
    accuracy = sd.guaranteed_accuracy(PLANT, sd.Schedule(np.arange(1.0, 9.0)), w_bound=0.02, v_bound=0.1, budget=1e-9)
    system, counted = accuracy.question.filter_bounds(PLANT)[0], list[int]()
    gap, integral = system.gaps[3], type(system.gaps[3]).integral
    blocks = np.random.default_rng(6).standard_normal((2, 6))

    def columns_of(gap, mu, ball):
        counted.append(mu.shape[1])
        return integral(gap, mu, ball)

    for ball in (False, True):
        known = RepeatedIntegrals(system.gaps[3:4])
        with monkeypatch.context() as patched:
            patched.setattr(type(gap), "integral", columns_of)
            for places, fresh in (([0, 1, 2, 3, 4, 5], 6), ([2, 3, 0, 1], 0), ([0, 1, 1, 0], 2)):
                counted.clear()
                found = known(gap, blocks[:, places], ball)
                assert found == pytest.approx(integral(gap, blocks[:, places], ball), rel=1e-13)
                assert sum(counted) == fresh
    assert np.array_equal(known(system.gaps[4], blocks, True), system.gaps[4].integral(blocks, True))
