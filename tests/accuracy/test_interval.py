"""What the data prove: against programs on a fine grid, its proofs, contradictions, and what is refused."""

from dataclasses import replace
from itertools import pairwise, permutations

import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.accuracy import record_program
from sampling_design.accuracy.interval import prove, state_interval
from sampling_design.accuracy.readings import BelowDetection, CompositeReading
from sampling_design.accuracy.record_program import RecordProgram
from sampling_design.accuracy.record_readings import read_record
from sampling_design.accuracy.record_rows import arrived
from sampling_design.accuracy.unknown_start import NEAR, FreeStart
from sampling_design.errors import ArgumentError
from sampling_design.plants.functional import requested_rows
from tests.cases import few
from tests.counted_clock import Counted

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], B=[[0.0], [1.0]], states=["position", "velocity"])
TIMES = [0.7, 2.3, 3.2, 5.2, 5.9]
RECORD = [(t, [np.sin(t)], None) for t in TIMES]
GIVEN = {"w_bound": 0.02, "v_bound": 0.4}


def fine_grid(record, c, w, v, cells=12):
    """Largest c'x at the last sample over all starts and all w on cells, in cvxpy."""
    import cvxpy as cp

    from tests.oracles.accuracy import _cells
    from tests.oracles.estimators import transition

    A, C, G = OSCILLATOR.A, OSCILLATOR.C, OSCILLATOR.G
    x = cp.Variable(2)
    rules = [cp.abs(C @ x - record[0][1]) <= v]
    for (a, *_), (b, y, _) in pairwise(record):
        u = cp.Variable((cells, 2))
        parts = _cells(A, G, b - a, cells)
        x = transition(A, b - a) @ x + sum(parts[k] @ u[k] for k in range(cells))
        rules += [cp.norm(u, axis=1) <= w, cp.abs(C @ x - y) <= v]
    problem = cp.Problem(cp.Maximize(c @ x), rules)
    problem.solve(solver=cp.CLARABEL)
    return problem.value


def test_ends_are_those_of_a_fine_grid():
    found = state_interval(OSCILLATOR, RECORD, **GIVEN)
    for k, c in enumerate(np.eye(2)):
        assert found.upper[k] == pytest.approx(fine_grid(RECORD, c, 0.02, 0.4), abs=1e-3)
        assert found.lower[k] == pytest.approx(-fine_grid(RECORD, -c, 0.02, 0.4), abs=1e-3)
    assert found.verify()
    assert "The data prove position from" in found.explain()


def test_one_state_by_hand():
    plant = sd.Plant([[0.0]], [[1.0]])
    found = state_interval(plant, [(0.0, [1.0], None), (1.0, [1.5], None)], 2.0, w_bound=0.1, v_bound=0.3)
    assert found.lower == pytest.approx([1.1], abs=1e-6)
    assert found.upper == pytest.approx([1.5], abs=1e-6)


@pytest.mark.parametrize("growth", few([5.0, 10.0, 20.0, 30.0], 0, 1))
def test_growth_between_samples_hides_nothing_that_doubles_hold(growth):
    """By hand: what grows was as good as nothing a gap ago, so the other state was read within .1, then and now."""
    plant = sd.Plant(np.diag([growth, -1.0]), [[1.0, 1.0]])
    found = state_interval(
        plant, [(t, [0.0], None) for t in np.arange(1.0, 6.0)], w_bound=0.1, v_bound=0.1, initial_error=1, prior_time=0
    )
    rounding = 1e-14 * np.exp(growth)
    assert np.all(found.radii - rounding <= [0.21, 0.101])
    assert np.all(found.radii >= [0.19, 0.095])
    assert found.verify()
    for e in (growth, 60.0, 400.0):  # a reading of the state itself
        alone = state_interval(
            sd.Plant([[e]], [[1.0]]), [(0.0, [0.0], None), (1.0, [0.5], None)], w_bound=1, v_bound=0.1
        )
        assert alone.upper == pytest.approx([0.6], rel=1e-6)


def test_inputs_and_a_prior_move_it():
    free = state_interval(OSCILLATOR, RECORD, **GIVEN)
    driven, x = [], np.zeros(2)
    pushed = sd.Plant(np.block([[OSCILLATOR.A, OSCILLATOR.B], [np.zeros((1, 3))]]), [[1.0, 0.0, 0.0]])
    for a, b in zip([0.0, *TIMES[:-1]], TIMES, strict=True):
        x = (pushed.transition(b - a) @ [*x, 0.3])[:2]
        driven.append((b, [np.sin(b) + x[0]], None))
    moved = state_interval(OSCILLATOR, [(0.0, None, [0.3]), *driven], prior_time=0.0, **GIVEN)
    assert moved.lower - x == pytest.approx(free.lower, abs=1e-5)
    known = state_interval(OSCILLATOR, RECORD, initial_error=[0.1, 0.1], prior=[0.0, 1.0], prior_time=0.0, **GIVEN)
    assert np.all(known.radii < free.radii)
    exact = state_interval(
        OSCILLATOR, RECORD, initial_error=0.0, prior=[0.0, 1.0], prior_time=0.0, w_bound=0.0, v_bound=0.4
    )
    assert exact.centre == pytest.approx([np.sin(TIMES[-1]), np.cos(TIMES[-1])], abs=1e-6)
    assert np.all(exact.radii < 1e-6)


def test_corrupt_gains_prove_nothing():
    found = state_interval(OSCILLATOR, RECORD, **GIVEN)
    wrong = found.gains.copy()
    wrong[0, 0] *= 1.2
    assert not replace(found, gains=wrong).verify()
    assert not replace(found, upper=found.upper - 0.1).verify()
    assert not replace(found, lower=found.lower + 0.1).verify()


def test_a_contradiction_is_proven_with_its_samples_and_factor():
    wrong = [(t, [y[0] + (5.0 if k == 2 else 0.0)], None) for k, (t, y, _) in enumerate(RECORD)]
    found = state_interval(OSCILLATOR, wrong, **GIVEN)
    assert found.contradiction > 1
    assert 2 in found.samples
    assert found.verify()
    assert not replace(found, disproof=replace(found.disproof, factors={"all": 1.01 * found.contradiction})).verify()
    assert "The data contradict the bounds" in found.explain()
    assert np.isnan(found.upper).all()
    factor = found.contradiction
    enough = state_interval(OSCILLATOR, wrong, w_bound=0.02 * factor * 1.001, v_bound=0.4 * factor * 1.001)
    assert not enough.contradiction
    short = state_interval(OSCILLATOR, wrong, w_bound=0.02 * factor * 0.98, v_bound=0.4 * factor * 0.98)
    assert short.contradiction == pytest.approx(1 / 0.98, rel=1e-3)


def test_what_no_sample_shows_is_unbounded():
    found = state_interval(OSCILLATOR, RECORD[:1], **GIVEN)
    assert np.isfinite(found.upper[0])
    assert np.isinf(found.upper[1])
    assert found.to_dict()["upper"][1] is None


def counted_columns(monkeypatch):
    """Unknowns of the programs that are posed, by their level."""
    columns, posed = {}, RecordProgram.posed

    def counted(self, level=0):
        columns[level] = posed(self, level).columns
        return posed(self, level)

    monkeypatch.setattr(RecordProgram, "posed", counted)
    return columns


def test_cells_of_half_the_size_where_they_suffice_prove_what_smaller_ones_do(monkeypatch):
    """Coarse cells lose 1.2 and 1.6 % of the half-width here: .3 and .4 % with half the size, .1 % with a quarter."""
    record = [(2.0 * k, [np.sin(2.0 * k)], None) for k in range(8)]
    solved, columns = {}, counted_columns(monkeypatch)
    for multiple, levels in ((record_program.HALVED, {0, 1}), (1.0, {0, 2})):
        monkeypatch.setattr(record_program, "HALVED", multiple)
        columns.clear()
        program = RecordProgram(read_record(OSCILLATOR, arrived(record, OSCILLATOR), 2.0, 0.1, None, None, None))
        solved[multiple] = program.solve(14.3, np.eye(2))
        assert set(columns) == levels
    for halved, finer in zip(*solved.values(), strict=True):
        half = (halved[0].value + halved[1].value) / 2
        for one, other in zip(halved, finer, strict=True):
            assert 0 <= one.short <= record_program.CLOSED * half
            assert one.value == pytest.approx(other.value, abs=1e-3 * half)


def test_only_the_latest_gaps_of_a_long_record_get_finer_cells(monkeypatch):
    """All of them took a solver's memory many times over, for gaps of which the gains take almost nothing."""
    record = [(2.0 * k, [np.sin(2.0 * k)], None) for k in range(100)]
    columns = counted_columns(monkeypatch)
    program = RecordProgram(read_record(OSCILLATOR, arrived(record, OSCILLATOR), 2.0, 0.1, None, None, None))
    ends = program.solve(198.0, np.eye(2))
    assert len(columns) > 1
    assert max(columns.values()) < 1.2 * columns[0]
    for up, down in ends:
        assert max(up.short, down.short) <= record_program.CLOSED * (up.value + down.value) / 2


def test_one_row_is_two_programs_and_little_beside():
    A = np.zeros((4, 4))
    A[:2, :2], A[2:, 2:] = [[0, 1], [-1, 0]], [[0, 1], [-2.3, 0]]
    plant = sd.Plant(A, [[1.0, 0.0, 1.0, 0.0]])
    record = [(t, [np.sin(t)], None) for t in np.cumsum(np.random.default_rng(0).uniform(0.3, 1, 20))]
    program, taken = RecordProgram(read_record(plant, arrived(record, plant), 0.05, 0.5, None, None, None)), []
    for _ in range(10):
        for row in np.eye(4):
            with Counted().running() as clock:
                program.solve(record[-1][0], row[None])
            taken.append(clock.steps)
    assert np.median(taken) < 3000


@pytest.mark.parametrize(
    ("record", "change", "match"),
    [
        ([], {}, "`record` must hold at least one measurement"),
        (RECORD, {"prior_time": 9e9}, "`prior_time` = 9000000000.0 must not lie after the first row"),
        ([1.0], {}, "`record` must hold rows"),
        (RECORD, {"t": 0.5}, "`t` must not lie before the start"),
        (RECORD, {"initial_error": [-1.0, 1.0]}, "`initial_error` must not be negative"),
        (RECORD, {"v_bound": None}, "`v_bound` is missing"),
    ],
)
def test_bad_input_is_refused(record, change, match):
    with pytest.raises(ArgumentError, match=match):
        state_interval(OSCILLATOR, record, **(GIVEN | change))


FED = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0], [0.0, 1.0]], B=[[0.0], [1.0]], D=[[0.5], [0.0]])
FED_BOUNDS = {"w_bound": 0.1, "v_bound": 0.3, "initial_error": 2.0, "prior_time": 0.0}


@pytest.mark.parametrize("last", [1.0, BelowDetection(0.5)], ids=["number", "limit"])
def test_rows_of_one_time_are_one_sample_in_whatever_order_and_however_often_they_come(last):
    nothing = np.nan
    whole = [(0.0, [0.2, nothing], [1.0]), (1.0, [1.1, last], [2.0])]
    parts = [(1.0, [nothing, last], None), (1.0, None, [2.0]), (1.0, [1.1, nothing], None)]
    expected = state_interval(FED, whole, **FED_BOUNDS)
    for order in list(permutations([*parts, parts[0]]))[::5]:
        record = [whole[0], *order]
        mhe = sd.MovingHorizonEstimator(FED, horizon=5.0, **FED_BOUNDS)
        for found in (state_interval(FED, record, **FED_BOUNDS), mhe.run(record)[-1].interval()):
            np.testing.assert_allclose([found.lower, found.upper], [expected.lower, expected.upper], atol=1e-6)


@pytest.mark.parametrize(
    "row",
    [
        (1.0, None, None), (1.0, [np.nan, np.nan], None), (1.0, [np.nan, np.nan], [1.0]), (1.0, [np.inf, 0.0], None),
        (1.0, [0.1], None), (1.0, [[0.1, 0.2]], None), (1.0, ["<0.5", 0.1], None), (1.0, [0.1, 0.1], [np.nan]),
        (1.0, [0.1, 0.1], [1.0, 2.0]), (np.nan, [0.1, 0.1], None), ((1.0, 2.0), [np.nan, np.nan], None),
        ((1.0, 2.0), [0.1, 0.1], [1.0]), (0.5, [0.3, np.nan], None), (0.5, None, [3.0]),
    ],
    ids=str,
)  # fmt: skip
def test_what_is_no_row_is_refused_in_the_same_words_by_all_who_read_a_record(row):
    record = [(0.5, [0.2, 0.1], [1.0]), row, (3.0, [0.1, 0.1], None)]
    mhe, of_rows = sd.MovingHorizonEstimator(FED, horizon=5.0, **FED_BOUNDS), []
    for takes in (lambda: state_interval(FED, record, **FED_BOUNDS), lambda: mhe.run(record)):
        with pytest.raises(ArgumentError) as refused:
            takes()
        of_rows.append(str(refused.value))
    assert of_rows[0] == of_rows[1]


def test_what_nothing_shows_is_unbounded_and_named():
    plant = sd.Plant(np.diag([0.1, -0.1]), [[0.0, 1.0]], states=["hidden", "seen"])
    found = state_interval(plant, [(0.0, [1.0], None)], w_bound=0.1, v_bound=0.1)
    assert np.isinf(found.radii[0])
    assert "They prove no bound of hidden: no reading shows the mode with eigenvalue 0.1." in found.explain()
    assert "seen from 0.8999 to 1.101" in found.explain()
    assert found.unobservable_modes == ("0.1",)
    only = state_interval(plant, [(0.0, [1.0], None)], w_bound=0.1, v_bound=0.1, of="hidden")
    assert only.explain().startswith("They prove no bound of hidden")
    early = state_interval(
        sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]]), [(0.0, [1.0], None)], w_bound=0.1, v_bound=0.1
    )
    assert early.explain().endswith("They prove no bound of x2: 1 reading (limits do not count) for 2 states.")


@pytest.mark.parametrize("contradicted", [False, True])
def test_rows_that_no_reading_shows_take_one_program_together(monkeypatch, contradicted):
    """Whatever is asked of them; what contradicts the bounds is found all the same."""
    w = np.arange(1.0, 5.0)
    plant = sd.Plant(np.kron(np.diag(w), [[0.0, 1.0], [-1.0, 0.0]]), np.tile([[1.0, 0.0]], 4))
    record = [(t, [np.sin(t)], None) for t in (0.2, 0.9, 1.3)]
    if contradicted:  # a second output that shows the same
        plant = sd.Plant(plant.A, np.vstack([plant.C, plant.C]))
        record = [(t, [y, y + 1.0], None) for t, (y,), _ in record]
    program = RecordProgram(read_record(plant, arrived(record, plant), 0.05, 0.1, None, None, None))
    solver, asked = program.posed().solver, []
    own = solver.solve
    monkeypatch.setattr(solver, "solve", lambda *given: asked.append(1) or own(*given))
    found = prove(program, 1.3, requested_rows(plant, None))
    if contradicted:
        assert found.contradiction > 1
        assert found.verify()
    else:
        assert np.all(np.isinf(found.upper) & np.isinf(found.lower))
        assert len(asked) == 1


@pytest.mark.parametrize("seed", few(range(24), 17, 18))
def test_less_noise_never_leaves_more_down_to_none(seed):
    """Where w changes within a gap no coarse cells explain nearly exact readings: 1e5 times too much was left.

    Where noise and disturbances are further apart than a solver's digits, a third too much.
    """
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    p, q = rng.integers(1, n + 1, 2).tolist()
    A, C, G = rng.normal(size=(n, n)), rng.normal(size=(p, n)), rng.normal(size=(n, q))
    gaps = rng.uniform(0.2, 1.2, int(rng.integers(3, 8)))
    x, states = rng.normal(size=n), []
    for quarter in [0.0, *np.repeat(gaps / 4, 4)]:
        moved = np.vstack([np.column_stack([A, G @ rng.uniform(-0.08, 0.08, q)]), np.zeros(n + 1)])
        x = (expm(moved * quarter) @ [*x, 1.0])[:n]
        states.append(x)
    times, readings = np.append(0.0, gaps.cumsum()), np.array(states)[::4] @ C.T
    driven, before = 0.1 * np.linalg.norm(C @ G, axis=1) * gaps.mean(), np.full(n, np.inf)
    for share in (1e-2, 1e-5, 1e-7, 1e-9, 1e-12, 0.0):
        found = state_interval(
            sd.Plant(A, C, G=G), [(t, y, None) for t, y in zip(times, readings, strict=True)],
            w_bound=np.full(q, 0.1), v_bound=share * driven, initial_error=np.full(n, 3.0),
        )  # fmt: skip
        width, rounding = found.upper - found.lower, 1e-9 * np.abs(x).max()
        assert np.all(width <= 1.02 * before + rounding)
        assert np.all(np.abs(x - (found.upper + found.lower) / 2) <= width / 2)
        if p == n:  # the last sample alone leaves so much
            assert np.all(width <= 2.04 * np.abs(np.linalg.inv(C)) @ (share * driven) + rounding)
        before = width


@pytest.mark.parametrize("seed", few(range(24), 3, 8))
def test_less_noise_never_contradicts_less_down_to_none(seed):
    """Of bounds on w 1.6 times too small half the contradictions were missed with noise below 1e-9 of the signal."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 4))
    A, C, G = rng.normal(size=(n, n)), rng.normal(size=(int(rng.integers(1, n + 1)), n)), rng.normal(size=(n, 1))
    A = A - max(np.linalg.eigvals(A).real.max(), 0.0) * np.eye(n)
    gaps = rng.uniform(0.2, 1.2, n + int(rng.integers(8, 14)))
    signs = rng.choice([-1.0, 1.0], 4 * len(gaps)) * rng.uniform(0.5, 1.0)
    x, states = rng.normal(size=n), []
    for quarter, w in zip([0.0, *np.repeat(gaps / 4, 4)], [0.0, *signs], strict=True):
        x = (expm(np.vstack([np.column_stack([A, G * w]), np.zeros(n + 1)]) * quarter) @ [*x, 1.0])[:n]
        states.append(x)
    readings = np.array(states)[::4] @ C.T
    record = [(t, y, None) for t, y in zip(np.append(0.0, gaps.cumsum()), readings, strict=True)]
    largest, driven = np.abs(signs).max(), np.linalg.norm(C @ G, axis=1) * gaps.mean()
    before = 0.0
    for share in (1e-3, 1e-6, 1e-8, 1e-10, 1e-12, 0.0):
        found = state_interval(
            sd.Plant(A, C, G=G),
            record,
            w_bound=0.2 * largest,
            v_bound=share * driven,
            initial_error=5 + np.abs(states[0]),
        )
        assert found.contradiction >= 0.8 * before  # cells leave up to a fifth of what is exact
        assert found.contradiction <= 5
        if found.contradiction:
            assert min(found.disproof.factors.values()) == found.contradiction
            assert found.verify()
        before = found.contradiction


def test_exact_readings_say_that_the_program_is_degenerate():
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], outputs=["position"])
    record = [(0.0, [1.0], None), (1.0, [1.0], None)]
    found = state_interval(plant, record, w_bound=0.0, v_bound=0.0)
    assert "Readings of position count as exact (noise bound 0)" in found.notice
    assert found.explain().endswith(found.notice)
    assert np.allclose(found.radii, 0.0, atol=1e-9)
    assert state_interval(plant, record, w_bound=0.1, v_bound=0.1).notice == ""


def test_one_zero_state_plant_of_no_dynamics_has_its_mode_named():
    found = state_interval(sd.Plant([[0.0]], [[0.0]]), [(0.0, [0.05], None)], w_bound=0.1, v_bound=0.1)
    assert "no reading shows the mode with eigenvalue 0" in found.explain()


@pytest.mark.parametrize("turned", [False, True], ids=["apart", "in other coordinates"])
@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_a_mode_that_nothing_shows_is_unbounded_in_all_units(size, turned):
    """A solver's last digits are no proof: gains of 1e18 would leave of it a share that looks like rounding."""
    A, C = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.5, 0.0, -0.3]]), np.array([[1.0, 0.0, 0.0]])
    T = np.array([[1.0, 2.0, 0.3], [0.0, 1.0, 0.5], [0.2, 0.1, 1.0]]) if turned else np.eye(3)
    T = np.diag([1.0, 1.0, size]) @ T
    back = np.linalg.inv(T)
    plant, rng = sd.Plant(T @ A @ back, C @ back, G=T), np.random.default_rng(0)
    record = [(1.7e9 + t, [np.sin(t) + rng.uniform(-0.1, 0.1)], None) for t in np.cumsum(rng.uniform(0.4, 1.2, 9))]
    found = state_interval(plant, record, w_bound=0.05, v_bound=0.2, of=back)
    assert np.isinf(found.lower[2])
    assert np.isinf(found.upper[2])
    assert np.all(found.radii[:2] < 1.0)
    assert found.verify()


def test_zeros_say_before_there_are_data_what_data_will_be_worth():
    """Theorem D: the largest error is that of readings all zero; a mean of x' = w leaves T/2 of w and its v."""
    walk = sd.Plant([[0.0]], [[1.0]])
    plan = [(2.0, [CompositeReading(0.0, since=0.5)], None)]
    found = state_interval(walk, plan, w_bound=0.2, v_bound=0.3, prior_time=0.0)
    assert found.upper == pytest.approx([0.3 + 0.2 * 1.5 / 2], rel=1e-6)
    assert found.lower == pytest.approx(-found.upper, rel=1e-6)
    plant, times = sd.plants.library.oscillator(), [0.4, 1.1, 2.6, 3.0]
    given = {"w_bound": 0.02, "v_bound": 0.1}
    promised = sd.guaranteed_accuracy(plant, sd.Schedule(times), initial_error=1.0, start=0.0, **given)
    zeros = state_interval(plant, [(t, [0.0], None) for t in times], initial_error=1.0, prior_time=0.0, **given)
    assert np.all(zeros.upper <= promised.at_samples[:, -1] * (1 + 1e-6))
    assert np.all(zeros.upper >= promised.at_samples[:, -1] * (1 - 0.01))


@pytest.mark.parametrize("known", [None, 0.5])
def test_both_sides_meet_where_states_have_grown_far_beyond_what_is_known_of_them(known):
    """The state reaches 1e5 times its interval; a program in absolute states lost half of the width there."""
    plant, rng = sd.Plant([[0.0, 1.0], [4.0, 0.0]], [[1.0, 0.0]]), np.random.default_rng(3)
    x, now, record = np.array([0.3, 0.4]), 0.0, []
    for t in np.cumsum(rng.uniform(0.3, 0.9, 12)):
        x, now = plant.transition(t - now) @ x, float(t)
        record.append((now, x[:1] + rng.choice([-0.05, 0.05]), None))
    readings = read_record(plant, arrived(record, plant), 0.02, 0.05, known, None, 0.0)
    program = RecordProgram(readings)
    for row in np.eye(2):
        ((up, down),) = program.solve(now, row[None])
        half = (up.value + down.value) / 2
        assert -down.value <= row @ x <= up.value
        assert np.abs(row @ x) > 1e5 * half
        assert max(up.short, down.short) <= 0.01 * half


@pytest.mark.parametrize("rate", [5.0, 12.0, 20.0, 25.0, 40.0, 80.0])
def test_what_decays_fast_is_as_unknown_as_anything_else_at_a_start_of_which_nothing_is_known(rate):
    """The slow state is read at 0 within 10, the sum of both at 1 within .01: the fast one is known within 9 there.

    What rounding hides of a start may make an end infinite, never a finite one too narrow.
    """
    plant = sd.Plant(np.diag([-rate, -0.1]), [[0.0, 1.0], [1.0, 1.0]])
    record = [(0.0, [1.0, np.nan], None), (1.0, [np.nan, 1.0], None)]
    given = {"w_bound": 0.0, "v_bound": [10.0, 0.01], "of": [[1.0, 0.0]]}
    found, late = state_interval(plant, record, **given), 10 * np.exp(-0.1)
    if rate <= 20:
        assert found.radii == pytest.approx([late + 0.01], rel=1e-5)
        assert found.centre == pytest.approx([1 - np.exp(-0.1)], rel=1e-4)
    assert found.radii[0] >= (late + 0.01) * (1 - 1e-6)
    assert found.verify(rigorous=True)
    ignored = RecordProgram(read_record(plant, arrived(record, plant), 0.0, [10.0, 0.01], None, None, None))
    slow = np.array([0.0, 1.0])  # the second reading taken for one of the slow state, as if the fast one were gone
    assert ignored.upper(1.0, slow, np.array([0.0, 1.0])).value == np.inf


def test_time_before_the_first_reading_adds_nothing_to_a_start_of_which_nothing_is_known():
    plant = sd.Plant(np.diag([-25.0, -0.1]), [[1.0, 1.0]])
    for before in (0.0, -1.0, -1e3):
        found = state_interval(
            plant, [(0.0, [1.0], None)], w_bound=0.01, v_bound=0.1, prior_time=before, of=[[0.0, 1.0]]
        )
        assert found.radii == [np.inf]


def test_limits_of_detection_bound_a_side_that_nothing_else_does():
    """x1 within .1 of 0 at 0, at most 1.1 at 1: the velocity is at most 1.2, and nothing bounds it below."""
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], G=[[0.0], [1.0]])
    record = [(0.0, [0.0], None), (1.0, [BelowDetection(1.0)], None)]
    found = state_interval(plant, record, w_bound=0.0, v_bound=0.1, of="x2")
    assert found.lower == -np.inf
    assert found.upper == pytest.approx([1.2], rel=1e-6)
    assert found.verify(rigorous=True)


def test_no_start_is_sought_where_noise_alone_would_make_it_large():
    """Two readings show nearly the same: a unit of noise, fitted, is a start of a million, and costs six digits."""
    told = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-6]])
    free, noise = FreeStart(told, np.zeros(2, dtype=bool), np.ones(2)), np.array([1.0, -1.0])
    assert np.linalg.norm(np.linalg.solve(told, noise)) > 1e6
    assert np.linalg.norm(free.start(noise)) < 10
    for far in ([3e9, -2e9], [3e9, -3e9]):
        shown = told @ far + noise
        assert np.linalg.norm(told @ free.start(shown) - shown) <= NEAR * np.sqrt(2)
