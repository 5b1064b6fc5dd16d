"""Standard deviations for white noise: against a plain filter, in the limit, unstable, unknown, finite."""

import contextlib
from itertools import product

import mpmath
import numpy as np
import pytest
from scipy.linalg import expm

import sampling_design as sd
from sampling_design.accuracy import deviation, riccati, sampled_system
from sampling_design.accuracy.gap_table import GapTable
from sampling_design.accuracy.riccati import RootedPeriod
from sampling_design.errors import ArgumentError, SolverError, UndecidedError
from tests.cases import few
from tests.oracles.families import flow

PLANT = sd.Plant([[0.0, 1.0], [-1.0, -0.2]], [[1.0, 0.0]], states=["position", "velocity"])
SCHEDULE = sd.PeriodicSchedule([0.7, 1.6, 0.9])
W, V = np.array([[0.02, 0.01], [0.01, 0.05]]), 0.3


def stepped(A, W, P, h, steps=400):
    """P flown over h by the trapezoidal rule on a fine grid."""
    F, d = expm(A * h / steps), h / steps
    for _ in range(steps):
        P = F @ (P + W * d / 2) @ F.T + W * d / 2
    return P


def after_periods(A, C, W, v, gaps, count, P):
    """Covariances after each sample of the last of so many periods; a plain filter."""
    for _ in range(count):
        after = []
        for h in gaps:
            K = P @ C.T @ np.linalg.inv(C @ P @ C.T + v**2 * np.eye(len(C)))
            P = P - K @ C @ P
            after.append(P)
            P = stepped(A, W, P, h)
    return after


def test_the_periodic_limit_is_that_of_a_plain_filter():
    found = sd.accuracy.standard_deviation(PLANT, SCHEDULE, w_intensity=W, v_deviation=V)
    gaps = [1.6, 0.9, 0.7]  # the first sample stands behind the first gap
    after = after_periods(PLANT.A, PLANT.C, W, V, gaps, 12, 10 * np.eye(2))
    for j in range(3):
        at = int(np.flatnonzero(np.isclose(found.times, SCHEDULE.times[j]))[-1])
        assert found.profile[:, at] ** 2 == pytest.approx(np.diag(after[j]), rel=1e-4)
        before = stepped(PLANT.A, W, after[j], gaps[j] * 0.5)
        half = j * 65 + 32
        assert found.profile[:, half] ** 2 == pytest.approx(np.diag(before), rel=1e-4)
    assert np.all(found.worst >= found.profile.max(axis=1) * (1 - 1e-12))
    assert np.all(found.worst <= found.profile.max(axis=1) * (1 + 1e-3))
    assert np.all((found.mean < found.worst) & (found.mean > found.profile.min(axis=1)))


def test_an_unstable_mode_that_no_noise_reaches_is_still_followed():
    """From P = 0 the filter would sleep for ever; the strong solution of P = a^2 P v^2/(P + v^2) is (a^2 - 1) v^2."""
    plant = sd.Plant([[0.5]], [[1.0]], G=[[0.0]])
    found = sd.accuracy.standard_deviation(plant, sd.PeriodicSchedule([1.0]), w_intensity=1.0, v_deviation=2.0)
    assert found.worst[0] ** 2 == pytest.approx((np.exp(1.0) - 1) * 4.0, rel=1e-5)


MIXED = np.array([[0.8, -2.0, 0.3], [1.5, 0.3, -0.4], [0.2, 0.5, 1.1]])


@pytest.mark.parametrize(("T", "periods"), few(product([np.eye(3), MIXED], [1, 3]), 0, 3))
def test_growth_over_a_period_hides_no_mode_that_an_output_sees(T, periods):
    """Neither beside what decays, nor in other coordinates, nor where samples are counted as longer periods."""
    A = np.array([[0.2, -0.8, 0.0], [-0.3, 1.3, 0.0], [0.0, 0.0, -0.3]])
    C, gaps, P, reached = np.array([[-0.6, -0.5, 0.7]]), [0.9, 1.4, 1.4, 1.6, 1.2, 1.1], np.eye(3), []
    for h in [*gaps[1:], gaps[0]] * 9:
        P = np.linalg.inv(np.linalg.inv(P) + C.T @ C / 0.1**2)
        F, noise = flow(A, np.eye(3), np.eye(3) / 0.1, 0.0, h)
        P = F @ P @ F.T + noise
        reached.append(np.sqrt(P[0, 0]))
    plant, schedule = sd.Plant(T @ A @ np.linalg.inv(T), C @ np.linalg.inv(T), G=T), sd.PeriodicSchedule(gaps * periods)
    asked = {"of": np.linalg.inv(T)[:1]}
    white = sd.accuracy.standard_deviation(plant, schedule, w_intensity=0.1, v_deviation=0.1, **asked)
    assert white.worst[0] == pytest.approx(max(reached[-6:]), rel=1e-6)
    found = sd.guaranteed_accuracy(plant, schedule, w_bound=0.1, v_bound=0.1, rtol=0.05, **asked)
    assert not found.unknown
    assert 0 < found.upper[0] <= 1.05 * found.lower[0]


GROWING, TURNING = np.diag([0.5, 0.4]), np.array([[0.0, 1.0], [-1.0, 0.0]])
DECAYING = np.array([[0.3, 1.0, 0.0], [0.0, 0.45, 0.0], [0.0, 0.0, -0.6]])


@pytest.mark.parametrize(
    ("A", "C", "G", "known", "endless"),
    [
        (GROWING, np.eye(2), [[0.0], [1.0]], [True, False], True),
        pytest.param(GROWING, np.eye(2), [[0.0], [1.0]], [True, False], False, marks=pytest.mark.long),
        (GROWING, np.eye(2), [[1.0], [1.0]], [False, False], True),
        pytest.param(TURNING, [[1.0, 0.0], [0.0, 0.0]], [[0.0], [0.0]], [True, True], False, marks=pytest.mark.long),
        (DECAYING, [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], [[1.0], [0.0], [0.0]], [False, False, True], True),
    ],
    ids=["beside noise", "beside noise, finite", "of noise", "turning, finite", "decaying"],
)
def test_an_exact_sensor_has_no_noise_of_its_own(A, C, G, known, endless):
    """Against a plain filter that takes its inverse as it is; what no noise reaches is then known exactly."""
    gaps, C, G, v = [1.0, 0.6] * 20, np.array(C), np.array(G), np.diag([0.0, 0.3])
    schedule = sd.PeriodicSchedule([1.0, 0.6]) if endless else sd.Schedule(np.cumsum(gaps))
    n = len(A)
    P, reached = 1e2 * np.eye(n), []
    for h in gaps[1:]:
        P = P - P @ C.T @ np.linalg.pinv(C @ P @ C.T + v**2, 1e-11, hermitian=True) @ C @ P
        F, noise = flow(A, G, np.eye(1) / 0.2, 0.0, h)
        P = F @ P @ F.T + noise
        reached.append(np.sqrt(np.abs(np.diag(P))))
    largest = np.max(reached[-4:], axis=0)
    for unit, T in ((1.0, np.eye(n)), (1e5, np.eye(n)), (1.0, MIXED[:n, :n])):
        plant, back = sd.Plant(T @ A @ np.linalg.inv(T), C @ np.linalg.inv(T) * unit, G=T @ G), np.linalg.inv(T)
        sizes = {"w_intensity": 0.2, "v_deviation": np.diag(v) * unit}
        found = sd.accuracy.standard_deviation(plant, schedule, of=back, **sizes)
        end = found.profile[:, -65 * 4 :].max(axis=1)
        assert end == pytest.approx(np.where(known, 0.0, largest), rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("beside", [-0.3, -2.0])
def test_beside_it_what_decays_and_no_noise_reaches_is_known(beside):
    """It leaves nothing in the end, and its variance has no size that it could settle at."""
    S = np.array([[1.0, 0.4], [0.3, 1.0]])
    plant = sd.Plant(S @ np.diag([0.5, beside]) @ np.linalg.inv(S), np.array([[1.0, 1.0]]) @ np.linalg.inv(S))
    schedule, sizes = sd.PeriodicSchedule([1.0]), {"w_intensity": 0.0, "v_deviation": 2.0}
    found = sd.accuracy.standard_deviation(plant, schedule, of=np.vstack([np.linalg.inv(S), np.eye(2)]), **sizes)
    growing = np.sqrt((np.exp(1.0) - 1) * 4.0)
    assert found.worst == pytest.approx([growing, 0.0, S[0, 0] * growing, S[1, 0] * growing], rel=1e-5, abs=1e-9)
    still = sd.accuracy.standard_deviation(sd.Plant([[beside]], [[1.0]]), schedule, **sizes)
    assert still.worst == still.mean == 0.0


@pytest.mark.parametrize("beside", [-0.4, -2.5])
def test_an_exact_sensor_is_followed_beside_what_decays_and_no_noise_reaches(beside):
    """Where roots settle in place of doubling, what goes to zero by a share each period has no size to settle at."""
    A, C = np.array([[0.24, 0.24], [-0.31, -0.44]]), np.array([[-0.27, -1.5], [-0.98, 0.45], [1.19, -0.31]])
    G, schedule = np.array([[2.0], [1.4]]), sd.PeriodicSchedule([0.3, 1.5])
    sizes, row = {"w_intensity": 0.1, "v_deviation": [0.0, 0.27, 0.24]}, np.array([[-0.74, -0.92, 0.0]])
    alone = sd.accuracy.standard_deviation(sd.Plant(A, C, G=G), schedule, of=row[:, :2], **sizes)
    wider = np.zeros((3, 3))
    wider[:2, :2], wider[2, 2] = A, beside
    plant = sd.Plant(wider, np.hstack([C, np.zeros((3, 1))]), G=np.vstack([G, [[0.0]]]))
    assert sd.accuracy.standard_deviation(plant, schedule, of=row, **sizes).worst == pytest.approx(alone.worst, 1e-9)


def test_a_finite_schedule_starts_from_nothing():
    plant = sd.Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
    found = sd.accuracy.standard_deviation(plant, sd.Schedule([0.0, 2.0]), w_intensity=0.0, v_deviation=0.3, end=3.0)
    early = found.times < 2.0
    assert np.all(np.isinf(found.profile[1, early]))
    assert np.all(np.isinf(found.profile[0, early & (found.times > 0)]))
    last = found.profile[:, -1]  # a straight line through two points: (3 y2 - y1)/2 and (y2 - y1)/2
    assert last == pytest.approx([0.3 * np.sqrt(10) / 2, 0.3 * np.sqrt(2) / 2], rel=1e-4)


def test_unknown_rows_are_infinite_and_the_others_are_not():
    plant = sd.Plant(np.zeros((2, 2)), [[1.0, 0.0]], states=["seen", "unseen"])
    found = sd.accuracy.standard_deviation(plant, sd.PeriodicSchedule([1.0]), w_intensity=[1.0, 1.0], v_deviation=[1.0])
    assert found.worst[0] ** 2 == pytest.approx((1 + np.sqrt(5)) / 2)
    assert np.isinf(found.worst[1])
    assert "infinite" in str(found)
    assert found.to_dict()["worst"][1] is None


@pytest.mark.long
def test_it_stands_beside_the_guaranteed_error():
    found = sd.guaranteed_accuracy(
        PLANT, SCHEDULE, w_bound=0.02, v_bound=0.4, of="position", w_intensity=W, v_deviation=V, rtol=0.1
    )
    alone = sd.accuracy.standard_deviation(PLANT, SCHEDULE, of="position", w_intensity=W, v_deviation=V)
    assert found.deviation.worst == pytest.approx(alone.worst)
    assert "deviation of position" in str(found)
    assert "the best filter's standard deviation is at worst" in found.explain()
    assert found.to_dict()["deviation"]["rows"] == ["position"]


def test_more_samples_average_the_noise():
    seldom, often = (
        sd.accuracy.standard_deviation(PLANT, sd.PeriodicSchedule([h]), w_intensity=W, v_deviation=V).worst
        for h in (1.0, 0.25)
    )
    assert np.all(often < 0.85 * seldom)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"w_intensity": None}, "`w_intensity` is missing"),
        ({"v_deviation": None}, "`v_deviation` is missing: give the standard deviation of the noise of y1"),
        ({"w_intensity": [-1.0, 0.0]}, "`w_intensity` must not be negative"),
        ({"w_intensity": [[1.0, 2.0], [2.0, 1.0]]}, "`w_intensity` must be positive semidefinite"),
        ({"v_deviation": [-1.0]}, "`v_deviation` must not be negative"),
        ({"v_deviation": np.full((len(SCHEDULE.times), 1), -1.0)}, "`v_deviation` must not be negative"),
        ({"start": 0.0}, "`start` is for finite schedules"),
    ],
)
def test_bad_input_is_refused(change, match):
    with pytest.raises(ArgumentError, match=match):
        sd.accuracy.standard_deviation(PLANT, SCHEDULE, **({"w_intensity": W, "v_deviation": V} | change))


def test_a_mode_that_only_the_samples_hide_leaves_other_rows_as_they_are():
    """An oscillation at twice the samples' period beside a level with a sensor of its own."""
    A = np.zeros((3, 3))
    A[0, 1], A[1, 0] = np.pi, -np.pi
    both = sd.Plant(A, [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    found = sd.accuracy.standard_deviation(both, sd.PeriodicSchedule([1.0, 1.0]), w_intensity=1.0, v_deviation=1.0)
    assert np.isinf(found.worst).tolist() == [True, True, False]
    assert abs(found.worst[2] ** 2 - (1 + 5**0.5) / 2) < 1e-9


def in_many_digits(growth, periods=5):
    """Deviations before a sample of a growing oscillator, by a plain filter in 200 digits from a start that it
    forgets."""
    with mpmath.workdps(200):
        g, W = mpmath.mpf(growth), mpmath.mpf("0.1")
        F = mpmath.exp(g) * mpmath.matrix([[mpmath.cos(1), mpmath.sin(1)], [-mpmath.sin(1), mpmath.cos(1)]])
        spread, P = W * (mpmath.exp(2 * g) - 1) / (2 * g) * mpmath.eye(2), mpmath.mpf(10) ** 6 * mpmath.eye(2)
        for _ in range(periods):
            P = P - P[:, 0] * P[0, :] / (P[0, 0] + mpmath.mpf("0.1") ** 2)
            P = F * P * F.T + spread
        return [float(mpmath.sqrt(P[i, i])) for i in range(2)]


@pytest.mark.parametrize("growth", [3.0, 10.0, 14.0, 15.0, 18.0, 20.0, 25.0, 30.0])
def test_growth_between_samples_costs_no_digits(growth):
    """Covariances lose them from e^12 on: 4e5 was said where 1.2e12 is true, and "infinite" beyond."""
    plant = sd.Plant([[growth, 1.0], [-1.0, growth]], [[1.0, 0.0]])
    found = sd.accuracy.standard_deviation(plant, sd.PeriodicSchedule([1.0]), w_intensity=0.1, v_deviation=0.1)
    assert found.worst == pytest.approx(in_many_digits(growth), rel=1e-9)
    if growth == 3.0:
        ends = sd.accuracy.standard_deviation(
            plant, sd.Schedule([0.0, 1.0, 2.0]), w_intensity=0.1, v_deviation=0.1, end=3.0
        )
        assert ends.profile[:, -1] == pytest.approx(in_many_digits(growth, 3), rel=1e-9)


@pytest.mark.parametrize("growth", [3.0, 15.0, 20.0])
def test_where_doubling_meets_a_singular_matrix_roots_go_on(growth, monkeypatch):
    """Whether a condition beyond doubles is met as a singular matrix is rounding's, and the machine's."""

    def singular(period):
        raise np.linalg.LinAlgError("Singular matrix")

    monkeypatch.setattr(riccati, "limit", singular)
    plant = sd.Plant([[growth, 1.0], [-1.0, growth]], [[1.0, 0.0]])
    found = sd.accuracy.standard_deviation(plant, sd.PeriodicSchedule([1.0]), w_intensity=0.1, v_deviation=0.1)
    assert found.worst == pytest.approx(in_many_digits(growth), rel=1e-9)


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.5, 1.0, 1.5])
def test_turned_states_hide_no_growing_mode_that_nothing_drives(angle):
    """Doubled, its rounding outgrows what it is added to: the answer is that of the modes themselves."""
    T = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    plant = sd.Plant(T @ np.diag([0.45, -0.01]) @ T.T, np.array([[1.0, 0.5]]) @ T.T, G=T @ [[0.0], [1.0]])
    sizes = {"w_intensity": 0.1, "v_deviation": 0.3, "of": np.array([[1.0, 1.0]]) @ T.T}
    found = deviation.standard_deviation(plant, sd.PeriodicSchedule([0.7, 0.4]), **sizes)
    assert found.worst[0] == pytest.approx(0.4215882593547856, rel=1e-8)


def test_gaps_whose_quadrature_overflows_are_undecided():
    with pytest.raises(UndecidedError, match="grows so far between the samples"):
        sampled_system.make_gap(
            GapTable(np.array([[0.0, 1e7], [0.0, 0.0]]), np.eye(2), np.ones(2)), 1.0, *[np.eye(2)] * 3
        )


@pytest.mark.parametrize("growth", [28.0, 36.0, 100.0, 400.0])
@pytest.mark.parametrize("schedule", [sd.PeriodicSchedule([1.0]), sd.Schedule([0.0, 1.0, 2.0])])
def test_growth_that_no_double_follows_is_undecided_and_never_a_number(growth, schedule):
    plant = sd.Plant([[growth, 1.0], [-1.0, growth]], [[1.0, 0.0]])
    noise, bounds = {"w_intensity": 0.1, "v_deviation": 0.1}, {"w_bound": 0.1, "v_bound": 0.1}
    if isinstance(schedule, sd.Schedule):
        bounds["initial_error"] = 1.0
    least = 0.5 * np.array(in_many_digits(growth, 4)) if growth < 40 else np.inf
    with contextlib.suppress(UndecidedError, SolverError):
        assert np.all(sd.accuracy.standard_deviation(plant, schedule, **noise).worst >= least)
    with contextlib.suppress(UndecidedError, SolverError):
        assert np.all(sd.guaranteed_accuracy(plant, schedule, **bounds).upper >= least)


def from_nothing(A, C, W, v, times, end):
    """Deviations at the end of a finite schedule, its start 10^30 wide, in 300 digits; infinite if they follow it."""
    n = len(A)
    with mpmath.workdps(300):
        A, C, M = mpmath.matrix(A), mpmath.matrix(C), mpmath.zeros(2 * n)
        M[:n, :n], M[:n, n:], M[n:, n:] = -A, mpmath.matrix(W), A.T
        P, noise = mpmath.eye(n) * mpmath.mpf(10) ** 60, mpmath.diag([mpmath.mpf(each) ** 2 for each in v])
        flows = {}
        for gap in np.round(np.diff([*times, end]), 9).tolist():
            K = P * C.T * (C * P * C.T + noise) ** -1
            if gap not in flows:
                flows[gap] = mpmath.expm(M * mpmath.mpf(gap), method="taylor")
            F, E = flows[gap][n:, n:].T, flows[gap][:n, n:]
            P = F * (P - K * C * P) * F.T + F * E
        found = [float(mpmath.sqrt(abs(P[i, i]))) for i in range(n)]
    return [x if x < 1e20 else np.inf for x in found]


@pytest.mark.parametrize("growth", few([5.0, 8.0, 11.0, 14.0, 17.0, 20.0, 25.0, 28.0], 5))
def test_no_plant_that_grows_loses_more_digits_than_its_growth_takes(growth):
    """Covariances of the noise over a gap lost a thousandth of what samples leave at e^15, and all of it at e^18."""
    rng = np.random.default_rng(int(growth))
    for n, p in ((2, 1), (3, 2), (3, 3)):
        A, C, G = rng.normal(size=(n, n)), rng.normal(size=(p, n)), rng.normal(size=(n, 2))
        A *= growth / max(np.linalg.eigvals(A).real, key=abs)  # some modes decay
        w, v = 10.0 ** rng.uniform(-2, 2, 2), 10.0 ** rng.uniform(-3, 2, p)
        times = np.array([1.0, 0.6] * 20).cumsum()
        truth = from_nothing(A.tolist(), C.tolist(), (G * w @ G.T).tolist(), v, times.tolist(), times[-1] + 1.0)
        plant, sizes = sd.Plant(A, C, G=G), {"w_intensity": w, "v_deviation": v}
        with contextlib.suppress(UndecidedError):
            found = sd.accuracy.standard_deviation(plant, sd.PeriodicSchedule([1.0, 0.6]), **sizes)
            assert found.profile[:, 129] == pytest.approx(truth, rel=max(1e-9, np.finfo(float).eps * np.exp(growth)))


@pytest.mark.parametrize(
    ("pair", "growth"),
    few(
        product(
            [
                ([[1.0, 0.0], [0.0, 0.0]], [[1.0, 1.0]]),  # beside an integrator
                ([[1.0, 0.1], [0.0, -0.01]], [[1.0, 0.0]]),  # driven by what only its growth shows
                ([[1.0, 0.0], [0.0, 0.5]], [[1.0, 1.0]]),
                ([[1.0, 0.0], [0.0, 0.01]], [[1.0, 0.0]]),  # beside what nothing shows
            ],
            [1.0, 10.0, 20.0],
        ),
        *(0, 4, 5, 8, 10),
    ),
)
def test_a_start_of_which_nothing_is_known_leaves_no_trace(pair, growth):
    """ "Infinite" was said from e^5 a gap on, and 3 to 20 % too little of a state that is seen weakly."""
    A, C, times = growth * np.array(pair[0]), pair[1], [0.0, 1.0, 2.0, 3.0]
    truth = from_nothing(A.tolist(), C, np.eye(2).tolist(), [0.3], times, 4.0)
    weak = growth == 20.0 and A[0, 1] != 0
    said = (
        pytest.raises(UndecidedError, match=r"the samples show some state so weakly|becomes so small beside the rest")
        if weak
        else contextlib.nullcontext()
    )
    with said:
        found = sd.accuracy.standard_deviation(
            sd.Plant(A, C), sd.Schedule(times), w_intensity=1.0, v_deviation=0.3, end=4.0
        )
        assert found.profile[:, -1] == pytest.approx(truth, rel=1e-4)


@pytest.mark.parametrize("seed", few(range(40), 3, 9, 17))
def test_what_an_exact_sensor_has_shown_is_not_shown_again(seed):
    """In any states and units: rounding that a known state leaves, read as if it were one, took others' deviations."""
    rng = np.random.default_rng(seed)
    A = np.diag(rng.choice([-0.5, 0.0, 0.25], 3)) + np.triu(rng.choice([0.0, 0.0, 0.5], (3, 3)), 1)
    C, G = np.triu(rng.choice([-2.0, -1.0, 1.0], (3, 3))), np.diag([1.0, *rng.integers(0, 2, 2)])
    times, exact = np.cumsum(rng.choice([0.25, 0.5, 2.0], 5)), [0.3, rng.choice([0.0, 0.3]), 0.0]
    digits = [each or 1e-25 for each in exact]
    truth = from_nothing(A.tolist(), C.tolist(), (G @ G.T).tolist(), digits, times.tolist(), times[-1] + 1)
    for steps, unit in product((0, 3), (1.0, 2.0**20)):
        T, back = of_integers(rng, 3, steps)
        plant = sd.Plant(T @ A @ back, unit * C @ back, G=T @ G)
        sizes = {"w_intensity": 1.0, "v_deviation": unit * np.array(exact), "end": times[-1] + 1}
        found = sd.accuracy.standard_deviation(plant, sd.Schedule(times), of=back, **sizes).profile[:, -1]
        assert found == pytest.approx(truth, rel=1e-6, abs=1e-8 * np.linalg.cond(T))


@pytest.mark.parametrize("turn", [0, 1])
def test_what_is_shown_exactly_at_the_end_of_a_period_is_known_at_its_beginning(turn):
    """The sample before that one kept what a filter with noise had left."""
    plant, outputs = sd.Plant([[0.125]], [[1.0], [1.0]], G=[[0.0]]), np.roll(np.eye(2, dtype=bool), turn, axis=0)
    schedule = sd.PeriodicSchedule.from_times([0.3, 0.6], 1.0, outputs)
    assert not sd.accuracy.standard_deviation(plant, schedule, w_intensity=1.0, v_deviation=[4.0, 0.0]).worst.any()


def test_a_noise_in_large_units_hides_no_other():
    """Beside one of 1e24 the size of another was rounding: 0.0076 was said where 0.27 is true."""
    found = []
    for unit in (1.0, 2.0**40):
        plant = sd.Plant([[-1.0, -0.9], [0.0, 0.125]], [[0.25, 0.0]], G=[[0.0, 0.0], [0.75, 0.0]])
        sizes = {"w_intensity": [0.1, unit**2], "v_deviation": 0.004}
        found.append(sd.accuracy.standard_deviation(plant, sd.PeriodicSchedule([1.0]), **sizes).worst)
    assert found[1] == pytest.approx(found[0], rel=1e-12)
    assert found[0][1] > 0.1


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_a_noise_reaches_a_state_in_any_unit_of_it(noise):
    """Levels that one noise moves together: beside one in units of 1e7 another, in units of 1e-5, was not moved."""
    A, C, G = (
        np.diag([0.75, 0.0, 0.0]),
        np.array([[1.0, 1.0, 1.0], [0.0, 1.0, 2.0], [1.0, 0.0, -1.0]]),
        [0.7, -0.4, -1.2],
    )
    found = []
    for x in (np.ones(3), 2.0 ** np.array([24, 8, -14])):
        plant, sizes = sd.Plant(A, C / x, G=(x * G)[:, None]), {"w_intensity": 1.0, "v_deviation": noise}
        found.append(sd.accuracy.standard_deviation(plant, sd.PeriodicSchedule([0.5]), **sizes).worst / x)
    assert found[1] == pytest.approx(found[0], rel=1e-5)
    assert noise or found[0][1:] == pytest.approx(np.sqrt(0.5) * np.array([0.4, 1.2]), rel=1e-6)


@pytest.mark.parametrize("noise", [(0.0, 0.0, 2.448), (1e-3, 0.5, 2.4)])
def test_sizes_of_states_that_have_nothing_to_do_with_each_other_hide_no_noise(noise):
    """Modes that outputs alone join, each in a unit of its own: beside some in large units others were not reached."""
    A, G = np.diag([0.0, -1.0, 0.25]), np.array([1.25, -0.5, 0.875])
    C = np.array([[-0.0049, 0.0, 0.0068], [-128.0, 0.0, 96.0], [4.0, 32.0, -32.0]])
    schedule, sizes = sd.PeriodicSchedule.from_times([2.0, 4.0], 4.1), {"w_intensity": 0.5, "v_deviation": noise}
    found = []
    for x in (np.ones(3), *10.0 ** np.random.default_rng(0).uniform(-9, 9, (8, 3))):
        found.append(
            sd.accuracy.standard_deviation(sd.Plant(A, C / x, G=(x * G)[:, None]), schedule, **sizes).worst / x
        )
    assert found[0][1] > 0.2
    assert np.allclose(found, found[0], rtol=1e-5, atol=0.0)


def test_growth_says_so():
    plant = sd.Plant([[400.0, 1.0], [-1.0, 400.0]], [[1.0, 0.0]])
    with pytest.raises(UndecidedError, match="grows so far between the samples of this schedule that no filter's"):
        sd.guaranteed_accuracy(plant, sd.Schedule([0.0, 1.0, 2.0]), w_bound=0.1, v_bound=0.1, initial_error=1.0)
    with pytest.raises(UndecidedError, match="the covariance of the filter on this schedule does not settle in double"):
        RootedPeriod([2 * np.eye(1)], [np.zeros((1, 1))], [np.eye(1)]).settled(np.eye(1))


def test_a_start_that_is_never_wide_enough_is_undecided(monkeypatch):
    monkeypatch.setattr(deviation, "WIDER", ())
    with pytest.raises(UndecidedError, match="the samples show some state so weakly"):
        deviation.standard_deviation(PLANT, sd.Schedule([1.0, 2.0, 3.0]), w_intensity=W, v_deviation=V)


UNREACHED = {  # A, G, C, and the states that keep a deviation: a double integrator that nothing drives, and beside it
    "drift": ([[0.0, 1.0], [0.0, 0.0]], [0.0, 0.0], [[1.0, 0.0]], []),
    "level": (np.diag([0.25, 0.0, -0.5]), [0.0, 0.0, 1.0], [[1.0, 1.0, 1.0]], [0, 2]),
    "oscillator": (
        [[0.0, 1.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.125]],
        [0.0, 0.0, 1.0, 0.0],
        [[1.0, 0.0, 1.0, 1.0]],
        [2, 3],
    ),
    "two drifts": (
        [[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]],
        [0.0, 0.0, 0.0, 1.0],
        [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]],
        [2, 3],
    ),
    "slope": ([[0.0, 1.0], [0.0, 0.0]], [1.0, 0.0], [[1.0, 0.0]], [0]),
}


def in_fifty_digits(A, G, C, gaps):
    """The largest deviation of each state before a sample after 300 periods from P = 1, noise of size one."""
    n, most = len(A), []
    with mpmath.workdps(50):
        A, C, steps = mpmath.matrix(A.tolist()), mpmath.matrix(C.tolist()), []
        for h in gaps:  # Van Loan
            both = mpmath.zeros(2 * n)
            both[:n, :n], both[n:, n:], both[:n, n:] = -A * h, A.T * h, mpmath.matrix(np.outer(G, G).tolist()) * h
            both = mpmath.expm(both)
            steps.append((both[n:, n:].T, both[n:, n:].T * both[:n, n:]))
        P = mpmath.eye(n)
        for _ in range(300):
            most = [mpmath.mpf(0)] * n
            for F, W in steps:
                gain = P * C.T * (C * P * C.T + mpmath.eye(C.rows)) ** -1
                P = F * (P - gain * C * P) * F.T + W
                P = (P + P.T) / 2
                most = [max(most[i], P[i, i]) for i in range(n)]
        return np.array([float(mpmath.sqrt(each)) for each in most])


def of_integers(rng, n, steps):
    """A matrix of integers whose inverse has integers, too: nothing is rounded."""
    T, back = np.eye(n), np.eye(n)
    for _ in range(steps):
        (i, j), step = rng.choice(n, 2, replace=False), np.zeros((n, n))
        step[i, j] = rng.choice([-2, -1, 1, 2])
        T, back = (np.eye(n) + step) @ T, back @ (np.eye(n) - step)
    return T, back


@pytest.mark.parametrize("name", few(UNREACHED, 0, 2))
def test_of_what_no_noise_reaches_only_what_grows_keeps_a_deviation(name):
    """In any states of condition up to 1e6 and any units; what is known in the end is 0."""
    A, G, C, kept = (np.array(each) for each in UNREACHED[name])
    kept, n, gaps, wanted = kept.astype(int), len(A), [0.75, 0.5], np.zeros(len(A))
    if kept.size:
        wanted[kept] = in_fifty_digits(A[np.ix_(kept, kept)], G[kept], C[:, kept], gaps)
    rng = np.random.default_rng(3)
    for steps, unit in product((0, 6, 12, 16), (1e-9, 1.0, 1e9)):
        T, back = of_integers(rng, n, steps)
        u = 2.0 ** np.round(np.log2(unit) * (-1.0) ** np.arange(n))
        plant = sd.Plant(u[:, None] * (T @ A @ back) / u, C @ back / u, G=u[:, None] * (T @ G)[:, None])
        found = sd.accuracy.standard_deviation(
            plant, sd.PeriodicSchedule(gaps), w_intensity=1.0, v_deviation=1.0, of=back / u
        ).worst
        condition = np.linalg.cond(T)
        assert np.all(np.abs(found - wanted) <= 1e-12 * (20 + condition) * max(wanted.max(), 1.0))
        assert name != "drift" or not found.any()
