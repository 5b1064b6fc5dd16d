import numpy as np
import pytest

from sampling_design import ArgumentError, Plant, named_plant
from sampling_design.errors import NotObservableError
from sampling_design.observability.count import pbh
from sampling_design.observability.count.pbh import observable_rank, require_observable, unobservable_modes


def planted(seed, hidden):
    """A plant of 5 states in a random basis, the modes at positions `hidden` kept from every output."""
    rng = np.random.default_rng(seed)
    D = np.zeros((5, 5))
    D[:2, :2] = [[-0.2, 1.5], [-1.5, -0.2]]
    D[2, 2], D[3, 3], D[4, 4] = 0.3, -1.0, -4.0
    C = rng.uniform(0.5, 2.0, (2, 5))
    C[:, hidden] = 0.0
    T = rng.standard_normal((5, 5)) + 3 * np.eye(5)
    return Plant(T @ D @ np.linalg.inv(T), C @ np.linalg.inv(T)), T


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize(
    ("hidden", "expected"), [([], []), ([2], [0.3]), ([0, 1], [-0.2 + 1.5j, -0.2 - 1.5j]), ([3, 4], [-1.0, -4.0])]
)
def test_planted_modes_are_found_with_their_directions(seed, hidden, expected):
    plant, _ = planted(seed, hidden)
    unseen = unobservable_modes(plant)
    np.testing.assert_allclose(np.sort_complex(unseen.eigenvalues), np.sort_complex(expected), atol=1e-9)
    for value, d in zip(unseen.eigenvalues, unseen.directions.T, strict=True):
        assert np.linalg.norm(d) == pytest.approx(1.0)
        np.testing.assert_allclose(plant.A @ d, value * d, atol=1e-8)
        np.testing.assert_allclose(plant.C @ d, 0.0, atol=1e-8)
    assert unseen.margin > 1e3 * unseen.tolerance
    assert observable_rank(plant, [0, 1]) == 5 - len(hidden)


def test_a_rate_asks_only_for_modes_that_are_too_slow():
    plant, _ = planted(0, [3, 4])
    assert len(unobservable_modes(plant, decay_rate=0.0)) == 0
    np.testing.assert_allclose(
        unobservable_modes(plant, decay_rate=2.0).eigenvalues, [-1.0], atol=1e-9
    )  # -1 = -rate/2 counts
    assert len(unobservable_modes(plant, decay_rate=8.5)) == 2


def test_defective_eigenvalues():
    integrators = np.diag([1.0, 1.0], 1)
    assert len(unobservable_modes(Plant(integrators, [[1.0, 0.0, 0.0]]))) == 0
    unseen = unobservable_modes(Plant(integrators, [[0.0, 1.0, 0.0]], states=["position", "velocity", "force"]))
    assert unseen.explain() == "No output observes the eigenvalue 0 along position."
    rng = np.random.default_rng(5)
    T, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    assert len(unobservable_modes(Plant(T @ integrators @ T.T, np.array([[1.0, 0.0, 0.0]]) @ T.T))) == 0
    assert len(unobservable_modes(Plant(T @ integrators @ T.T, np.array([[0.0, 1.0, 0.0]]) @ T.T))) == 1


def test_one_output_cannot_see_two_equal_modes():
    unseen = unobservable_modes(Plant(np.eye(3), [[1.0, 1.0, 0.0]]))
    assert len(unseen) == 2
    np.testing.assert_allclose(unseen.directions.T @ np.array([1.0, 1.0, 0.0]), 0.0, atol=1e-12)


def test_units_do_not_change_the_verdict():
    """An orbit in SI units: rates of 1e-3, entries of A from 1 to 1e-6, measured in km or um."""
    w = 1.1e-3
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * w * w, 2 * w, -2 * w, -w * w
    for unit in (1e-3, 1.0, 1e6):
        assert len(unobservable_modes(Plant(A, unit * np.eye(6)[:3]))) == 0
        hidden = unobservable_modes(Plant(A, unit * np.eye(6)[[0, 2]]))
        np.testing.assert_allclose(hidden.eigenvalues, [0.0], atol=1e-12)
        np.testing.assert_allclose(np.abs(hidden.directions[:, 0]), np.eye(6)[1], atol=1e-9)
    assert observable_rank(Plant(A, np.eye(6)), [0]) == 3
    assert observable_rank(Plant(A, np.eye(6)), [1]) == 4
    assert observable_rank(Plant(A, np.eye(6)), [2]) == 2


def test_refusal_carries_the_modes_as_data():
    plant, T = planted(1, [0, 1])
    with pytest.raises(
        NotObservableError, match=r"a window needs .* unobservable: -0.2\+1.5i along .* split it off"
    ) as caught:
        require_observable(plant, "a window")
    assert caught.value.eigenvalues.size == 2
    assert caught.value.directions.shape == (5, 2)
    plane = np.linalg.lstsq(T[:, :2].astype(complex), caught.value.directions, rcond=None)[0]
    np.testing.assert_allclose(T[:, :2] @ plane, caught.value.directions, atol=1e-9)
    require_observable(planted(1, [])[0], "a window")


def test_plants_without_states_or_with_blind_outputs():
    assert len(unobservable_modes(Plant(np.zeros((0, 0)), np.zeros((1, 0))))) == 0
    blind = unobservable_modes(Plant(np.diag([1.0, 2.0]), np.zeros((1, 2))))
    assert len(blind) == 2
    assert blind.margin == np.inf
    assert "tolerance" in str(blind)
    assert unobservable_modes(Plant([[1.0]], [[1.0]])).explain().startswith("Every mode is observable from some output")


def test_bad_input():
    plant, _ = planted(0, [])
    with pytest.raises(ArgumentError, match="`decay_rate` must not be negative"):
        unobservable_modes(plant, decay_rate=-1.0)
    with pytest.raises(ArgumentError, match="`rtol` must be positive"):
        unobservable_modes(plant, rtol=0.0)


@pytest.mark.parametrize("unit", [1e-9, 1.0, 3600.0])
def test_a_zero_that_rounding_moves_hides_no_mode(unit):
    """A satellite's offset along its track cannot be told from that of the clock that it is read against."""
    orbit = named_plant("satellite")
    A = np.zeros((8, 8))
    A[:6, :6], A[6, 7] = orbit.A, 1.0
    clocked = Plant(
        A * unit, np.hstack([orbit.C, [[0, 0], [1, 0], [0, 0]]]), states=[*orbit.states.names, "clock", "rate"]
    )
    found = unobservable_modes(clocked)
    assert found.eigenvalues.tolist() == [0]
    np.testing.assert_allclose(np.abs(found.directions[:, 0]), np.sqrt(0.5) * np.isin(np.arange(8), [1, 6]), atol=1e-12)


def test_a_plant_is_grouped_once_whatever_outputs_are_asked_about(monkeypatch):
    group, asked = pbh.clusters_of, []
    monkeypatch.setattr(pbh, "clusters_of", lambda *parts: asked.append(parts) or group(*parts))
    A, C = np.random.default_rng(831).normal(size=(2, 4, 4))
    plant = Plant(A, C)
    assert observable_rank(plant, [0]) == observable_rank(plant, [1, 2]) == 4
    assert not unobservable_modes(plant).eigenvalues.size
    assert len(asked) == 1
