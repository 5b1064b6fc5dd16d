"""A large plant with few slow modes is certified by weights that were sought for these alone, in whatever units.

The fast modes have a Lyapunov matrix; the noise gain is kept by the whole plant, whose lambda is proven as all others.
"""

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule, certify
from sampling_design.certificates import certification as room
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.exact.window_gains import WindowSet
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.checkers.outcome import WorkLimit
from tests.rescale import Units

GAIN = 3.0
PERIODIC = PeriodicSchedule([1.0, 0.7, 0.9])
SLOW = {
    "oscillator": np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -0.01]]),
    "growing": np.array([[0.05, 1.0], [0.0, 0.05]]),
}


def plant_of(slow, n, slowest=2.0):
    """Slow modes and decays up to a thousand times faster, in random coordinates, through two outputs."""
    rng, k = np.random.default_rng(n), len(slow)
    A = np.zeros((n, n))
    A[:k, :k], A[k:, k:] = slow, -np.diag(slowest * np.geomspace(1.0, 100.0, n - k))
    S = np.linalg.qr(rng.standard_normal((n, n)))[0] * np.exp(rng.uniform(-0.5, 0.5, n))
    return Plant(S @ A @ np.linalg.inv(S), rng.standard_normal((2, n)) @ np.linalg.inv(S))


@pytest.mark.parametrize(
    ("slow", "n", "schedule"),
    [
        pytest.param("oscillator", 16, PERIODIC, marks=pytest.mark.long),
        ("growing", 16, Schedule(np.arange(1.0, 4.0))),
        pytest.param("growing", 20, Schedule(np.arange(1.0, 13.0)), marks=pytest.mark.long),
        pytest.param("growing", 16, PERIODIC, marks=pytest.mark.long),
        pytest.param("oscillator", 40, PERIODIC, marks=pytest.mark.long),
        pytest.param("oscillator", 60, PERIODIC, marks=pytest.mark.long),
    ],
)
def test_it_is_proven_within_the_noise_gain(slow, n, schedule, monkeypatch):
    monkeypatch.setattr(room, "choose_weights", None)  # nothing is sought for all states together
    plant = plant_of(SLOW[slow], n)
    made = certify(plant, schedule, noise_gain=GAIN)
    assert made.verify().passed
    problem = window_problem(plant, schedule, np.eye(n), *weights_of(plant, None, None, None), made.eta)
    assert 1 / np.linalg.eigvalsh(made.P1)[0] <= GAIN * (1 + 5e-3) * WindowSet.of(problem).least_floor(np.ones(n))


@pytest.mark.long
def test_units_change_nothing_of_that(monkeypatch):
    monkeypatch.setattr(room, "choose_weights", None)
    plain = plant_of(SLOW["growing"], 16)
    units = Units.drawn(np.random.default_rng(0), plain, decades=6, time_decades=0)
    assert certify(units.plant(plain), units.schedule(PERIODIC)).verify().passed


def test_modes_that_stand_close_together_are_sought_together():
    """Where no mode is four times faster than the next, and with few states, no part is taken out."""
    n = 16
    close = Plant(np.diag(-0.02 * 1.3 ** np.arange(n)), np.ones((1, n)))
    for plant in (close, plant_of(SLOW["growing"], 15)):
        canon, bounds = room.search_units(plant, PERIODIC, weights_of(plant, None, None, None), (0.05, 1.0))
        assert room.retained_part_weights(canon, bounds, [GAIN], None, room.ENDLESS) == [None]


def test_the_price_of_windows_grows_with_the_cube_of_the_states():
    spent = []
    for n in (40, 80):
        plant, work = plant_of(SLOW["oscillator"], n), WorkLimit(1e12)
        problem = window_problem(
            plant, Schedule(np.arange(1.0, 9.0)), np.eye(n), *weights_of(plant, None, None, None), 0.5
        )
        windows = WindowSet.of(problem, work)
        before = work.left
        windows.looked(np.eye(n))
        spent.append(before - work.left)
    assert spent[1] > 4 * spent[0]


def test_what_breaks_the_noise_gain_is_certified_without_it_and_says_so(monkeypatch):
    """A slow mode whose own spread is fifty times what samples leave, where no search finds anything else."""

    def fails(*arguments):
        raise room.UndecidedError("undecided: the search is made to fail")

    monkeypatch.setattr(room, "choose_weights", fails)
    monkeypatch.setattr(room, "precisely_chosen", fails)
    made = certify(Plant([[-0.01]], [[1.0]]), PeriodicSchedule([1.0]), noise_gain=GAIN)
    assert made.lam == 1
    assert made.verify().passed
    assert "for none was proven with 3" in made.solver.details["weights"]
    assert "for none was proven with 3" in made.explain()
    with pytest.raises(room.UndecidedError, match="the search is made to fail"):
        certify(Plant([[0.01]], [[1.0]]), PeriodicSchedule([1.0]))
