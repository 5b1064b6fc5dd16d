import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sampling_design import ArgumentError, Plant, zero_count_bound
from sampling_design.errors import NotObservableError
from tests.oracles import zero_count as oracle

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def companion_plant(eigenvalues):
    A, C = oracle.companion(eigenvalues)
    return Plant(A, C)


@pytest.mark.parametrize(
    ("eigenvalues", "duration", "value", "needed"),
    [
        ([1j, -1j], np.pi, 2.0, 3),
        ([1j, -1j], 3.0, 1 + 3 / np.pi, 2),
        ([0, 1j, -1j], 5.0, 2 + 5 / np.pi, 4),
        ([1j, -1j, 3j, -3j], 3.0, 3 + 9 / np.pi, 6),
        ([0, 1j, -1j, 3j, -3j], 3.0, 4 + 9 / np.pi, 7),
        ([0, 0, 0], 1e6, 2.0, 3),
        ([-1, -2], 10.0, 1.0, 2),
    ],
)
def test_count_by_hand(eigenvalues, duration, value, needed):
    bound = zero_count_bound(companion_plant(eigenvalues), duration)
    assert bound.value == pytest.approx(value, abs=1e-9)
    assert bound.samples_needed == needed
    assert bound.order == len(eigenvalues)
    assert bound.frequency_spread == pytest.approx(2 * np.max(np.imag(eigenvalues)), abs=1e-12)


def test_critical_length_asks_for_fewer_where_it_holds():
    """Theory section 9: {0, +-i} needs 3 instead of 4, {+-i, +-3i} 4 instead of 6, with three zeros 5 instead of 7."""
    for eigenvalues, duration, by_count, by_length in [
        ([0, 1j, -1j], 5.0, 4, 3),
        ([1j, -1j, 3j, -3j], 3.0, 6, 4),
        ([0, 1j, -1j, 3j, -3j], 3.0, 7, 5),
    ]:
        bound = zero_count_bound(companion_plant(eigenvalues), duration)
        assert (bound.samples_needed, bound.samples_critical) == (by_count, by_length)
        assert bound.binding == "critical length"
        assert bound.samples == by_length


def test_critical_length_holds_strictly_below_it_only():
    assert zero_count_bound(OSCILLATOR, np.pi * (1 - 1e-6)).samples_critical == 2
    at = zero_count_bound(OSCILLATOR, np.pi)
    assert at.samples_critical is None
    assert at.binding == "zero count"
    assert at.samples == 3


def test_count_is_strict_and_guards_rounding():
    """E22: ceil(k*) gives 2 on the oscillator with T = pi, and so does floor(k*) + 1 of a k* just below 2."""
    T = np.pi
    printed = int(np.ceil(1 + T / np.pi))
    assert printed == 2
    assert oracle.rank(OSCILLATOR.A, OSCILLATOR.C, ["0", str(oracle.mp.mpf(np.pi))], 1e-14) == 1
    ours = zero_count_bound(OSCILLATOR, T).samples_needed
    assert ours == 3
    assert oracle.rank(OSCILLATOR.A, OSCILLATOR.C, [0.0, 1.0, np.pi], 1e-14) == 2
    # in another basis k* comes out as 2 - 4e-16 now and then: without a guard the count drops to 2
    rng = np.random.default_rng(0)
    fell_short = []
    for _ in range(60):
        basis = rng.standard_normal((2, 2)) + 2 * np.eye(2)
        plant = Plant(basis @ OSCILLATOR.A @ np.linalg.inv(basis), OSCILLATOR.C @ np.linalg.inv(basis))
        bound = zero_count_bound(plant, T)
        fell_short.append(int(np.floor(bound.value)) + 1 == 2)
        assert bound.samples_needed == 3
    assert any(fell_short)


def test_unobservable_pair_is_refused_with_its_eigenvalue():
    """E23: the printed count 3 > k* = 2.95 promises rank 3; fifty samples show rank 2 of 3."""
    A = np.diag([0.0, 0.0, -1.0]) + np.diag([0.4, 0.0], 1) - np.diag([0.4, 0.0], -1)
    C = [[1.0, 0.0, 0.0]]
    duration = 7.4
    printed = 3 - 1 + duration * 0.8 / (2 * np.pi)
    assert printed == pytest.approx(2.94, abs=0.01)
    assert oracle.rank(A, C, np.linspace(0.0, duration, 50)) == 2
    with pytest.raises(NotObservableError, match="unobservable: -1 along velocity") as caught:
        zero_count_bound(Plant(A, C, states=["x", "y", "velocity"]), duration)
    np.testing.assert_allclose(caught.value.eigenvalues, [-1.0], atol=1e-12)
    np.testing.assert_allclose(np.abs(caught.value.directions[:, 0]), [0, 0, 1], atol=1e-12)


def test_several_outputs_are_counted_by_indices():
    """E24: with C = I and A = 0 one sample does where r = n asks for two; two oscillators: 5 by count, 2 can do."""
    still = zero_count_bound(Plant(np.zeros((2, 2)), np.eye(2)), 3.0)
    assert (still.order, still.samples_needed, still.samples_least) == (1, 1, 1)
    assert oracle.rank(np.zeros((2, 2)), np.eye(2), [1.5]) == 2
    block = np.array([[0.0, 1.0], [-1.0, 0.0]])
    A = np.block([[block, np.zeros((2, 2))], [np.zeros((2, 2)), 2 * block]])
    C = np.eye(4)[[0, 2]]
    pair = zero_count_bound(Plant(A, C), 0.5 * np.pi)
    assert (pair.order, pair.samples_needed, pair.samples_least) == (4, 5, 2)
    assert pair.critical_length is None
    assert oracle.rank(A, C, [0.0, 0.5]) == 4  # conservative: two samples of two outputs can do
    # equal blocks: the index counts once, not the multiplicity
    twice = np.kron(np.eye(2), block)
    assert zero_count_bound(Plant(twice, C), 0.5).order == 2


def test_lower_bound_looks_at_every_set_of_outputs():
    """Theory section 11: ceil(n/p) = 2 is not enough here, three samples are needed."""
    A, C = np.diag([-0.1, -0.5, -1.0, 0.2]), [[1, 1, 1, 0], [0, 0, 0, 1]]
    assert zero_count_bound(Plant(A, C), 2.0).samples_least == 3
    assert oracle.rank(A, C, [0.0, 1.0]) == 3
    assert oracle.rank(A, C, [0.0, 1.0, 1.7]) == 4


def test_lower_bound_of_many_outputs_tries_the_sets_at_both_ends():
    n = 14
    assert zero_count_bound(Plant(np.zeros((n, n)), np.eye(n)), 1.0).samples_least == 1
    A = np.diag(-np.arange(1.0, n + 2))
    C = np.eye(n + 1)[:n]
    C[0, n] = 1.0  # the first output alone must tell two states apart
    assert zero_count_bound(Plant(A, C), 1.0).samples_least == 2


def test_defective_eigenvalues_are_one_eigenvalue():
    """E25: eigenvalues one by one give a triple zero a spread of 7e-6 and r = 3 distinct ones; a cluster gives 0."""
    rng = np.random.default_rng(3)
    T, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    A = T @ np.diag([1.0, 1.0], 1) @ T.T
    C = np.array([[1.0, 0.0, 0.0]]) @ T.T
    loose = np.linalg.eigvals(A)
    printed_spread = np.max(loose.imag) - np.min(loose.imag)
    assert printed_spread > 1e-7
    duration = 1e7
    assert int(np.floor(3 - 1 + duration * printed_spread / (2 * np.pi))) + 1 > 3
    bound = zero_count_bound(Plant(A, C), duration)
    assert bound.frequency_spread == 0.0
    assert (bound.order, bound.samples_needed) == (3, 3)


def test_nothing_to_observe():
    """E25: the largest imaginary part of no eigenvalue does not exist; r = 0, k* = -1, no samples."""
    with pytest.raises(ValueError, match="zero-size array"):
        np.max(np.zeros(0))
    bound = zero_count_bound(Plant(np.zeros((0, 0)), np.zeros((1, 0))), 5.0)
    assert (bound.value, bound.samples_needed, bound.order, bound.frequency_spread) == (-1.0, 0, 0, 0.0)
    assert (bound.samples, bound.samples_least, bound.critical_length) == (0, 0, None)
    assert bound.explain() == "Nothing has to be observed: no samples needed."


def test_an_order_beyond_the_search_leaves_the_critical_length_out():
    eigenvalues = [s * k * 1j for k in range(1, 8) for s in (1, -1)]
    A = np.zeros((14, 14))
    for i, k in enumerate(range(1, 8)):
        A[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[0, k], [-k, 0]]
    bound = zero_count_bound(Plant(A, np.tile([1.0, 0.0], 7)[None]), 1.0)
    assert bound.critical_length is None
    assert bound.order == len(eigenvalues)
    stiff = zero_count_bound(
        Plant(np.diag([-1e6, 0, 0]) + np.eye(3, k=1) - np.diag([0, 1.0], -1), [[1.0, 1.0, 0]]), 1.0
    )
    assert (stiff.critical_length, stiff.binding) == (None, "zero count")


def test_doubt_about_clusters_takes_the_larger_order():
    """Two eigenvalues that rounding nearly merges: however they are grouped, r is n for one output."""
    for gap in 10.0 ** np.arange(-9, -5):
        A, C = oracle.companion([-1.0, -1.0 - gap, -2.0])
        assert zero_count_bound(Plant(A, C), 1.0).order == 3


@pytest.mark.long
@given(st.floats(1e-6, 1e6), st.floats(0.0, 20.0))
def test_count_does_not_depend_on_the_unit_of_time(factor, duration):
    eigenvalues = np.array([0.0, 0.1 + 1j, 0.1 - 1j, -2.0])
    A, C = oracle.companion(eigenvalues)
    one, other = zero_count_bound(Plant(A, C), duration), zero_count_bound(Plant(A / factor, C), duration * factor)
    assert other.value == pytest.approx(one.value, rel=1e-9)
    assert other.critical_length == pytest.approx(one.critical_length * factor, rel=1e-5)


def test_record_speaks_and_is_plain_data():
    bound = zero_count_bound(companion_plant([-1, -2]), 1.0)
    data = bound.to_dict()
    assert data["critical_length"] == "infinite"
    assert data["samples"] == 2
    assert data["claim"]["strength"] == "proven"
    assert "any 2 distinct times" in data["claim"]["statement"]
    assert bound.explain().startswith("Any 2 distinct times in a closed window of 1 s determine the state")
    assert "samples by critical length  2" in str(bound)
    assert zero_count_bound(OSCILLATOR, 1.0).to_dict()["critical_length"] == pytest.approx(np.pi)


def test_bad_input():
    with pytest.raises(ArgumentError, match="`duration` must not be negative"):
        zero_count_bound(OSCILLATOR, -1.0)
    with pytest.raises(ArgumentError, match="`duration` must be a number, got str"):
        zero_count_bound(OSCILLATOR, "pi")
