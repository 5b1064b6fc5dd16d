"""e^{At} against 50-digit arithmetic, on the modal and on the dense route."""

import mpmath
import numpy as np
import pytest

from sampling_design.numerics.linalg import expm_batch, forced_flow
from sampling_design.numerics.modal_flow import ModalFlow, exponential
from sampling_design.plants import library
from tests.cases import few
from tests.oracles.observability import exponential_50_digits

J = np.array([[0.0, 1.0], [-1.0, 0.0]])
PLANTS = (
    library.oscillator,
    library.double_integrator,
    library.triple_integrator,
    library.satellite,
    library.tidal_gauge,
    library.cart_pendulum,
    library.three_compartment,
    library.helicopter_he1,
)


def rotation(n):
    return np.linalg.qr(np.random.default_rng(n).standard_normal((n, n)))[0]


def rotated(A):
    """The same plant in another basis: its defective blocks are then defective to rounding only."""
    Q = rotation(len(A))
    return Q @ A @ Q.T


def blocks(*parts):
    n = sum(len(p) for p in parts)
    A, low = np.zeros((n, n)), 0
    for part in parts:
        A[low : low + len(part), low : low + len(part)] = part
        low += len(part)
    return A


DOUBLE_OSCILLATOR = np.block([[J, np.eye(2)], [np.zeros((2, 2)), J]])
DEFECTIVE = {
    "triple zero": np.diag([1.0, 1.0], 1),
    "triple zero, rotated": rotated(np.diag([1.0, 1.0], 1)),
    "double oscillator": DOUBLE_OSCILLATOR,
    "double oscillator and drift, rotated": rotated(blocks(DOUBLE_OSCILLATOR, np.diag([1.0], 1))),
    "equal oscillators side by side": rotated(blocks(J, J)),
    "coupled oscillators": np.kron([[0, 1], [0, 0]], np.eye(2)) + np.kron([[0, 0], [1, 0]], [[-2.0, 1.0], [1.0, -2.0]]),
    "companion of (s + 1)^4": np.array([[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-1, -4, -6, -4.0]]),
    "nearly triple": np.array([[0, 1, 0], [0, 1e-4, 1], [0, 0, 2e-4]]),
    "triangular, wide": np.triu(-np.ones((6, 6))) + np.diag(-0.2 * np.arange(6)),
}


def error(A, flow, t):
    exact = exponential_50_digits(A, t)
    return np.linalg.norm(flow - exact, 2) / np.linalg.norm(exact, 2)


def balanced_times(A, factors):
    """Times with t |A| equal to each factor, |A| after balancing."""
    return np.array(factors) / np.linalg.norm(ModalFlow(A)._balanced, 2)


def test_oracle_agrees_with_mpmath():
    A = rotated(DOUBLE_OSCILLATOR)
    with mpmath.workdps(60):
        theirs = mpmath.expm(mpmath.matrix(A.tolist()) * 3, method="taylor")
        theirs = np.array(theirs.tolist(), dtype=float)
    np.testing.assert_allclose(exponential_50_digits(A, 3.0), theirs, rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize("named", few(PLANTS, 0, 1, 2, 5, 7), ids=lambda f: f.__name__)
def test_library_plants(named):
    A = named().A
    times = balanced_times(A, [1e-3, 7.0, 200.0, -20.0])
    for t, flow in zip(times, exponential(A)(times), strict=True):
        assert error(A, flow, t) < 1e-12


@pytest.mark.parametrize("name", DEFECTIVE)
def test_defective_blocks(name):
    A = DEFECTIVE[name]
    times = balanced_times(A, [1e-3, 3.0, 60.0, 200.0, -60.0])
    for t, flow in zip(times, exponential(A)(times), strict=True):
        assert error(A, flow, t) < 1e-12


def test_one_orbit_of_the_satellite_in_si_units():
    A = library.satellite().A
    times = np.array([1e-3, 1.0, 60.0, 1388.5, 5554.0])
    for t, flow in zip(times, exponential(A)(times), strict=True):
        assert error(A, flow, t) < 1e-12


def test_stiff_plant_keeps_its_slow_mode():
    flow = exponential(np.diag([-1e8, -0.1]))([1.0])[0]
    assert abs(flow[1, 1] / np.exp(-0.1) - 1) < 1e-12
    assert abs(flow[0]).max() == 0.0
    # scaling and squaring alone has lost eight digits by then: the trap that the modal route avoids
    assert abs(expm_batch(np.diag([-1e8, -0.1]), [1.0])[0, 1, 1] / np.exp(-0.1) - 1) > 1e-10


def test_stiff_plant_with_coupling():
    A = np.array([[-1e6, 2.0], [0.0, -0.1]])
    assert error(A, exponential(A)([3.0])[0], 3.0) < 1e-12


@pytest.mark.parametrize("shared", [False, True], ids=["squared one by one", "shared squarings"])
def test_dense_route(shared):
    A = np.random.default_rng(5).standard_normal((6, 6))
    scale = np.linalg.norm(A, 2)
    times = np.linspace(-30, 60, 721) / scale if shared else np.array([-30.0, -0.2, 1e-6, 0.7, 60.0]) / scale
    flows = expm_batch(A, times)
    for i in range(0, times.size, 180 if shared else 1):
        assert error(A, flows[i], times[i]) < 1e-12


def test_dense_route_of_a_complex_matrix():
    A = rotated(DOUBLE_OSCILLATOR)
    turned = expm_batch(A + 0.5j * np.eye(4), [2.0])[0]
    np.testing.assert_allclose(turned, exponential_50_digits(A, 2.0) * np.exp(1j), rtol=0, atol=1e-13)


def test_rows_are_those_of_the_full_exponential():
    rng = np.random.default_rng(6)
    for A in (rng.standard_normal((5, 5)), library.satellite().A, *DEFECTIVE.values()):
        C = rng.standard_normal((2, len(A)))
        times = balanced_times(A, np.linspace(-30, 100, 40))
        whole = exponential(A)(times)
        difference = np.linalg.norm(exponential(A).rows(C, times) - C @ whole, axis=(1, 2))
        assert np.all(difference <= 1e-12 * np.linalg.norm(C) * np.linalg.norm(whole, axis=(1, 2)))


def test_route_is_named():
    assert exponential(library.satellite().A).route == "modal"
    wide = np.triu(-np.ones((8, 8))) + np.diag(-0.2 * np.arange(8))
    assert ModalFlow(wide).route == "mixed"
    large = ModalFlow(np.diag(-np.arange(260.0)))
    assert (large.route, large.reason) == ("dense", "more than 256 states")
    assert ModalFlow(rotation(6)).reason == ""


def test_wide_block_beyond_its_reach():
    wide = np.triu(-np.ones((8, 8))) + np.diag(-0.2 * np.arange(8))
    flow = ModalFlow(wide)
    reach = min(block.reach for block in flow._blocks)
    for t in (0.9 * reach, 1.1 * reach, 10 * reach):
        assert error(wide, flow([t])[0], t) < 1e-12


def test_empty_inputs():
    assert exponential(np.zeros((0, 0)))([1.0, 2.0]).shape == (2, 0, 0)
    assert exponential(J)([]).shape == (0, 2, 2)
    assert exponential(np.zeros((3, 3)))([1e9])[0].tolist() == np.eye(3).tolist()


def test_built_once_per_matrix():
    assert exponential(J.copy()) is exponential(J)
    assert exponential(2 * J) is not exponential(J)


@pytest.mark.parametrize("turn", [0.0, 1.7j])
@pytest.mark.parametrize("power", [30, 60, -60])
def test_units_of_what_drives_change_nothing_of_a_flow(power, turn):
    rng = np.random.default_rng(6)
    A, B, units = rng.standard_normal((3, 3)), rng.standard_normal((3, 2)), np.array([2.0**power, 1.0])
    A = A - turn * np.eye(3) if turn else A
    flow, scaled = forced_flow(A, B, [0.3, 2.0]), forced_flow(A, B * units, [0.3, 2.0])
    scaled[:, :, 3:] /= units
    np.testing.assert_allclose(scaled, flow, rtol=1e-13, atol=1e-13)
