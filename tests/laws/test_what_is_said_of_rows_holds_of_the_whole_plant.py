"""Law: asked for rows of the state, every verb answers with `of`, and what it says is true of the whole plant.

The whole plant is moved by itself, hidden modes included, however large they are and however fast they grow.
"""

from functools import cache

import numpy as np
import pytest
from scipy.linalg import cholesky

from sampling_design import (
    KalmanFilter,
    MovingHorizonEstimator,
    PeriodicSchedule,
    Plant,
    Requirement,
    Schedule,
    SetMembershipEstimator,
    SpacedWindows,
    UncertainParameter,
    UncertainPlant,
    certificate_exists,
    certify,
    design_schedule,
    pareto_front,
    read_certificate,
    robustness,
    simulate_record,
    validate,
    window_sigma,
    worst_case_sigma,
    zero_count_bound,
)
from sampling_design.accuracy import accuracy_by_count
from sampling_design.certificates import certify_detectability
from sampling_design.design import design_and_losses
from sampling_design.errors import (
    ArgumentError,
    CallError,
    CertificateError,
    MathematicsError,
    NotDetectableError,
    UndecidedError,
)
from sampling_design.estimators import estimate, estimator_for
from sampling_design.observability import functional_plant
from tests.cases import few
from tests.oracles.hidden import random_hidden
from tests.oracles.rows import worst_energy

THREE = Plant(np.diag([0.1, 0.2, -1.0]), [[1.0, 0.0, 0.5]], name="three")
EVERY_SECOND = PeriodicSchedule([1.0])
BOUNDS = {"w_bound": 0.02, "v_bound": 0.1, "initial_error": 1.0}
RECORD = simulate_record(THREE, EVERY_SECOND, 6.0, x0=[0.2, 1e6, 0.5], rng=3, w_bound=0.02, v_bound=0.1)
PLAIN = Requirement(window=4.0, samples=3)


@cache
def certificate():
    return certify(THREE, EVERY_SECOND, of="x1", eta=0.7, P2=np.eye(2))


VERBS = {
    "certify": lambda **of: certify(THREE, EVERY_SECOND, eta=0.7, P2=np.eye(2 + (of != {"of": "x1"})), **of),
    "certify a tolerance": lambda **of: certify(THREE, EVERY_SECOND, eta=0.7, timing_tolerance=0.01, **of),
    "certify_detectability": lambda **of: certify_detectability(THREE, eta=0.1, **of),
    "certificate_exists": lambda **of: certificate_exists(THREE, EVERY_SECOND, 0.1, **of),
    "design_schedule": lambda **of: design_schedule(THREE, PLAIN, **of),
    "window_sigma": lambda **of: window_sigma(THREE, EVERY_SECOND, 4.0, **of),
    "worst_case_sigma": lambda **of: worst_case_sigma(THREE, SpacedWindows(4.0, 3, 0.5), rtol=0.1, **of),
    "zero_count_bound": lambda **of: zero_count_bound(THREE, 4.0, **of),
    "losses": lambda **of: design_and_losses(THREE, PLAIN, **of)[1],
    "pareto": lambda **of: pareto_front(THREE, PLAIN, [3], **of),
    "robustness": lambda **of: robustness(THREE, certificate(), longest=2, budget=0.2, **of),
    "MovingHorizonEstimator": lambda **of: MovingHorizonEstimator(THREE, certificate(), **BOUNDS, **of),
    "KalmanFilter": lambda **of: KalmanFilter(THREE, certificate(), **BOUNDS, **of),
    "estimate": lambda **of: estimate(THREE, RECORD.measurements, KalmanFilter(THREE, certificate(), **of), **of),
    "validate": lambda **of: validate(THREE, EVERY_SECOND, certificate(), runs=2, scenarios=["random"], **of, **BOUNDS),
}


NOTHING = {
    "certificate_exists": lambda found: not found.exists,
    "window_sigma": lambda found: found.upper == 0,
    "worst_case_sigma": lambda found: found.upper == 0,
    "pareto": lambda found: not found.efficient,
}


@pytest.mark.parametrize("verb", few(VERBS, *(k for k in range(len(VERBS)) if k not in (8, 9))))
def test_a_verb_answers_for_rows_and_for_all_states_as_before(verb):
    ask = VERBS[verb]
    found = ask(of="x1")
    if verb == "validate":
        assert found.passed
    with pytest.raises(NotDetectableError, match=r"asks for x2, .*0\.2 along x2\. Add an output that shows it, or ask"):
        ask(of=["x1", "x2"])
    try:  # of all states nothing is known: x2 is hidden, and grows
        answer = ask()
    except (MathematicsError, ArgumentError):
        return
    assert NOTHING[verb](answer)


@pytest.mark.parametrize("verb", ["window_sigma", "estimate", "validate", "MovingHorizonEstimator"])
def test_a_misspelt_row_is_named(verb):
    with pytest.raises(ArgumentError, match="`of` must name states or outputs, got 'x4'"):
        VERBS[verb](of="x4")


@pytest.mark.parametrize("verb", ["window_sigma", "MovingHorizonEstimator"])
def test_a_misspelt_keyword_is_named(verb):
    with pytest.raises(CallError, match=r"has no argument `off`\. Did you mean 'of'"):
        VERBS[verb](off="x1")


def check_held(found, truth, onto):
    """All that estimates of a part say of a motion of the whole plant: ellipsoids, and the radius of every state."""
    for each, x in zip(found, truth, strict=True):
        off = onto @ x - each.x
        # what rounding of onto x leaves of hidden states that are large
        slack = 1e-12 * np.abs(onto) @ np.abs(x)
        assert each.certified
        assert np.all(np.abs(off) <= each.radii + slack)


@pytest.mark.parametrize(("rows", "zero"), few([("x1", 1.7e9), ("y1", 0.0), ([[2.0, 0.0, -1.0]], 1.7e9)], 0))
def test_every_estimator_of_rows_holds_the_truth_of_the_whole_plant(rows, zero):
    made = certify(THREE, EVERY_SECOND, of=rows, eta=0.7, P2=np.eye(2))
    record = simulate_record(THREE, EVERY_SECOND, 12.0, x0=[0.2, 1e8, 0.5], rng=5, w_bound=0.02, v_bound=0.1)
    known = BOUNDS | {"initial_error": 2.0, "prior_time": zero}
    estimators = [
        MovingHorizonEstimator(THREE, made, of=rows, schedule_zero=zero, **known),
        KalmanFilter(THREE, made, of=rows, **known),
        SetMembershipEstimator(THREE, of=rows, **known),
        estimator_for(THREE, record.measurements, made, of=rows, **BOUNDS | {"initial_error": 2.0}).estimator,
    ]
    for each in estimators[: 4 if not zero else 3]:
        samples = [(zero + t, y, u) for t, y, u in record.measurements]
        assert each.plant.wanted.names == made.plant.wanted.names
        check_held(each.run(samples).estimates, record.truth, each.plant.map)


@pytest.mark.parametrize("growth", few([0.2, 20.0], 1))
def test_a_hidden_mode_may_grow_beyond_anything(growth):
    """e^{20 t} overflows by t = 36: the part does not know of it."""
    plant = Plant(np.diag([0.1, growth, -1.0]), THREE.C)
    made = certify(plant, EVERY_SECOND, of="x1", eta=0.7, P2=np.eye(2))
    late = Schedule(np.arange(1.0, 41.0))
    record = simulate_record(made.plant, late, 40.0, x0=[0.2, 0.5], rng=1, w_bound=0.02, v_bound=0.1)
    filter = KalmanFilter(plant, made, of="x1", **BOUNDS)
    check_held(filter.run(record.measurements).estimates, record.truth, np.eye(2))


@pytest.mark.parametrize("seed", few(range(60), 0))
def test_a_certificate_of_rows_states_the_exact_supremum_of_the_whole_plant(seed):
    """lambda is attained to its resolution, and |z|^2 never exceeds what P1 says, both by a dense least-squares problem
    in the coordinates of the whole plant."""
    rng = np.random.default_rng(seed)
    plant, H, _ = random_hidden(rng, mixed=False)
    schedule = PeriodicSchedule(rng.uniform(0.3, 1.2, int(rng.integers(1, 4))))
    try:
        made = certify(plant, schedule, of=H, eta=1.0, P2=np.eye(functional_plant(plant, H).n_states))
    except (CertificateError, UndecidedError):  # aliased, or beyond the noise gain
        return
    onto, root = made.plant.map, cholesky(made.P2)

    def exact(start, t, rows):
        samples = schedule.between(start, t).times
        weights = root @ onto, made.Qw, made.Rtilde, made.eta
        return worst_energy(plant.A, plant.C, plant.G, samples, start, t, rows, *weights)

    if made.witness is not None and 0 < made.witness.t - made.witness.start < 6.0:
        assert exact(made.witness.start, made.witness.t, root @ onto) == pytest.approx(made.lam, rel=2e-3)
    stated = np.linalg.norm(np.linalg.inv(cholesky(made.P1))[: len(H)], 2) ** 2
    for start in rng.uniform(0.0, schedule.period, 2):
        for t in start + rng.uniform(0.1, 5.0, 2):
            assert exact(start, t, root @ onto) <= made.lam_proven * (1 + 1e-6)
            assert exact(start, t, H) <= stated * (1 + 1e-6)


def test_other_kinds_of_plants_refuse_rows_in_a_sentence():
    from sampling_design.nonlinear import NonlinearMovingHorizonEstimator
    from sampling_design.nonlinear.examples import van_der_pol

    unsure = UncertainPlant(
        Plant([[0.0, 1], [-1, 0]], [[1.0, 0]]), (UncertainParameter("k", -0.1, 0.1, A=[[0, 0], [1, 0]]),)
    )
    with pytest.raises(ArgumentError, match="`of` is for exactly known plants: validate all states of this one"):
        validate(unsure, EVERY_SECOND, of="x1")
    with pytest.raises(CallError, match="has no argument `of`"):
        NonlinearMovingHorizonEstimator(van_der_pol(), of="x1")


def test_what_a_part_of_a_part_says_is_said_of_the_whole(tmp_path):
    part = functional_plant(THREE, "x1")
    inner = functional_plant(part, [[1.0, 2.0]])
    assert inner.whole is THREE
    np.testing.assert_allclose(inner.map[:1], [[1.0, 2.0]] @ part.map, rtol=1e-12)
    made = certify(part, EVERY_SECOND, of="x1", eta=0.7, P2=np.eye(2))
    again = read_certificate(made.save(tmp_path / "c.json"))
    assert again.verify()
    assert KalmanFilter(THREE, again, of="x1", **BOUNDS).run(RECORD.measurements).certified.all()


def test_a_part_is_asked_like_any_plant():
    """What puts other matrices in the place of a part's asks about another plant, which is part of none."""
    part = functional_plant(THREE, "x1")
    counts = {"period": 4.0, "w_bound": 0.1, "v_bound": 0.2, "of": "x1", "rtol": 0.01}
    steady = functional_plant(Plant(np.diag([-0.1, -0.2, -1.0]), [[1.0, 0.0, 0.5]]), "x1")
    found = accuracy_by_count(steady, (0, 2), **counts)
    np.testing.assert_allclose(found.upper, accuracy_by_count(steady.whole, (0, 2), **counts).upper, rtol=0.02)
    bounds = {"w_bound": 0.1, "v_bound": 0.2, "rng": 0}
    made = certify(steady, EVERY_SECOND, eta=0.05)
    assert validate(steady, EVERY_SECOND, made, runs=2, duration=4.0, scenarios=("estimator",), **bounds).passed
    assert part.augmented(bias=part.outputs.names).n_states == part.n_states + part.n_outputs
    corner = UncertainPlant(part, [UncertainParameter("k", 0.0, 0.1, A=np.eye(2), nominal=0.0)]).at([0.1])
    np.testing.assert_array_equal(corner.A, part.A + 0.1 * np.eye(2))


def nearly_aliased(off):
    """A constant, which one sensor shows, beside an oscillation that samples a unit apart nearly hide."""
    turn = np.pi - off
    return Plant([[0.0, 0, 0], [0, 0, turn], [0, -turn, 0]], [[1.0, 0, 0], [0, 1.0, 0]])


@pytest.mark.parametrize(("off", "late"), [(1e-3, 0.0), (1e-6, 0.0), (1e-2, 0.01)])
def test_sigma_of_rows_is_theirs_however_little_the_samples_show_of_other_states(off, late):
    """Every window holds four samples of the constant, whenever these are taken."""
    plant = nearly_aliased(off)
    found = window_sigma(plant, EVERY_SECOND, 4.0 + 2 * late, of="x1", timing_tolerance=late)
    assert found.status == ("timing" if late else "closed")
    assert (0.0 if late else 1.998) <= found.lower <= 2.0 * (1 + 1e-12)
    assert found.upper == pytest.approx(2.0, rel=1e-9)
    assert window_sigma(plant, EVERY_SECOND, 4.0).upper < 3 * off


@pytest.mark.parametrize("seed", few(range(40), 0, 6, 23))
def test_sigma_of_rows_is_attained_by_its_witness(seed):
    rng = np.random.default_rng([11, seed])
    n = int(rng.integers(2, 5))
    plant = Plant(rng.standard_normal((n, n)), rng.standard_normal((1, n)))
    H = rng.standard_normal((int(rng.integers(1, n)), n))
    gaps = rng.uniform(0.3, 1.0, 2)
    found = window_sigma(plant, PeriodicSchedule(gaps), 1.2 * n * gaps.mean() + 1.0, of=H)
    seen, begins = found.witness, found.witness.t - found.window
    O = (plant.C @ plant.transition(np.maximum(seen.samples - begins, 0.0))).reshape(-1, n)
    left = np.linalg.lstsq(O, np.eye(len(O)), rcond=None)[0]  # the least of all left inverses
    assert found.upper == pytest.approx(1 / np.linalg.norm(H @ left, 2), rel=1e-6)
    assert found.lower <= found.upper


@pytest.mark.parametrize("off", few([1e-3, 1e-4], 0))
def test_worst_sigma_of_rows_is_theirs_however_little_the_samples_show_of_other_states(off):
    """Every schedule holds four samples of the constant, and none has room to show as little as equal gaps do."""
    rule = SpacedWindows(window=3.0 + off / 10, count=4, spacing=1.0)
    found = worst_case_sigma(nearly_aliased(off), rule, of="x1")
    assert found.status == "closed"
    assert found.lower >= 1.98 * (1 - 1e-4)
    assert found.upper == pytest.approx(2.0, rel=1e-9)
    assert worst_case_sigma(nearly_aliased(off), rule).upper < 3 * off


@pytest.mark.parametrize("seed", few(range(20), 0, 7))
def test_worst_sigma_of_rows_is_attained_by_its_witness_and_no_schedule_drawn_has_less(seed):
    rng = np.random.default_rng([12, seed])
    n = int(rng.integers(2, 4))
    plant, H = Plant(rng.standard_normal((n, n)), rng.standard_normal((1, n))), rng.standard_normal((n - 1, n))
    count, spacing = n + int(rng.integers(0, 3)), rng.uniform(0.2, 0.6)
    slack = (count - 1) * spacing * rng.uniform(0.05, 0.6)
    found = worst_case_sigma(plant, SpacedWindows((count - 1) * spacing + slack, count, spacing), of=H)

    def of_rows(times):
        O = (plant.C @ plant.transition(times)).reshape(-1, n)
        return 1 / np.linalg.norm(H @ np.linalg.lstsq(O, np.eye(len(O)), rcond=None)[0], 2)

    drawn = np.sort(rng.uniform(size=(100, count)), axis=1) * slack + spacing * np.arange(count)
    assert found.upper == pytest.approx(of_rows(found.witness), rel=1e-6)
    assert found.lower <= min(map(of_rows, drawn)) * (1 + 1e-9)


def test_a_window_that_hides_a_state_beside_rows_names_that_state():
    """Sigma of the rows counts as 0 there, and the state that is hidden is none of theirs."""
    found = window_sigma(nearly_aliased(0.0), EVERY_SECOND, 4.0, of="x1")
    worst = worst_case_sigma(nearly_aliased(0.0), SpacedWindows(3.0, 4, 1.0), of="x1")
    for sigma, state in ((found, found.witness.direction), (worst, worst.direction)):
        assert sigma.status == "below rounding"
        assert sigma.lower == 0.0 <= sigma.upper < 1e-12
        assert abs(state[0]) < 1e-12
