"""A plant that decays on its own at the rate is certified by that alone, whatever its size, units and samples.

One Lyapunov equation, one eigenvalue problem: nothing is searched, no window followed, and the noise budget holds.
"""

import dataclasses

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule, certify
from sampling_design.certificates import certification as room
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.exact.window_gains import WindowSet
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.certificates.form.verdict import verdict_of
from sampling_design.checkers import sampled
from tests.cases import few
from tests.rescale import Units

GAIN = 3.0


def chain(n):
    """Masses on springs between two walls, damped, the first one's place measured."""
    m = n // 2
    stiffness = 2 * np.eye(m) - np.eye(m, k=1) - np.eye(m, k=-1)
    return Plant(np.block([[np.zeros((m, m)), np.eye(m)], [-stiffness, -0.4 * np.eye(m)]]), np.eye(1, n))


def dense(n):
    """Random entries, the slowest mode at -0.2."""
    rng = np.random.default_rng(n)
    A = rng.standard_normal((n, n)) / np.sqrt(n)
    return Plant(A - (np.linalg.eigvals(A).real.max() + 0.2) * np.eye(n), rng.standard_normal((1, n)))


def driven_in_one(n):
    """A cascade of lags that a disturbance reaches through the first one alone."""
    return Plant(-np.eye(n) + 0.9 * np.eye(n, k=-1), np.eye(1, n, n - 1), G=np.eye(n, 1))


SCHEDULES = {
    "periodic": PeriodicSchedule([1.0, 1.5]),
    "late": PeriodicSchedule([0.5, 0.5, 1.0], 1.7),
    "finite": Schedule(np.arange(1.0, 31.0)),
}
SMALL = [
    (make, n, schedule)
    for make, n in ((chain, 4), (dense, 12), (driven_in_one, 6))
    for schedule in ("periodic", "late", "finite")
]
SIZED = [(make, n, "periodic") for make in (chain, dense, driven_in_one) for n in (40, 60)]


@pytest.mark.parametrize(("make", "n", "schedule"), few([*SMALL, *SIZED], 0, 2, 4, 6, 7))
def test_lambda_is_one_within_the_noise_budget(make, n, schedule, monkeypatch):
    monkeypatch.setattr(room, "choose_weights", None)  # nothing is searched
    monkeypatch.setattr(sampled.Windows, "windows", None)  # and no window followed
    plant, times = make(n), SCHEDULES[schedule]
    made = certify(plant, times, noise_gain=GAIN)
    assert made.lam == 1
    assert made.eta < -2 * np.linalg.eigvals(plant.A).real.max()
    problem = window_problem(plant, times, np.eye(n), *weights_of(plant, None, None, None), made.eta)
    assert 1 / np.linalg.eigvalsh(made.P1)[0] <= GAIN * (1 + 2e-3) * WindowSet.of(problem).least_floor(np.ones(n))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long), pytest.param(2, marks=pytest.mark.long)])
def test_units_change_nothing(seed):
    """States, outputs and time in units up to 1e12 apart."""
    plain, times = dense(6), SCHEDULES["periodic"]
    units = Units.drawn(np.random.default_rng(seed), plain)
    made, other = certify(plain, times), certify(units.plant(plain), units.schedule(times))
    assert other.lam == made.lam == 1
    assert other.verify().passed


def test_what_the_decay_does_not_bear_is_not_proven():
    """A larger P1, a rate beyond the plant's own and a stronger disturbance are no longer held by the flow alone."""
    made = certify(chain(4), SCHEDULES["periodic"])
    rate = -2 * float(np.linalg.eigvals(made.plant.A).real.max())
    for change in ({"P1": 1.01 * made.P1}, {"eta": 1.2 * rate, "lam": 1.0}, {"Qw": made.Qw / 100}):
        assert verdict_of(dataclasses.replace(made, **change).to_dict()).verdict == "refuted"


def test_where_the_decay_alone_is_too_noisy_weights_are_searched():
    """A slow mode seen well: its own spread is fifty times what samples leave."""
    made = certify(Plant([[-0.01]], [[1.0]]), PeriodicSchedule([1.0]))
    assert made.lam > 1
    assert made.verify().passed
