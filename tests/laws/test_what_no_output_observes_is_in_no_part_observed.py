"""A mode that does not decay and that no output observes is so in the retained part, in whatever coordinates."""

from itertools import product

import numpy as np
import pytest
from scipy.linalg import block_diag

import sampling_design as sd
from sampling_design.certificates import constants_from_proof
from sampling_design.errors import NotDetectableError, NotObservableError
from sampling_design.observability import loss_tolerance, unobservable_modes
from sampling_design.plants import split_modes
from tests.cases import few

TURNING = np.array([[0.0, 1.0], [-1.0, 0.0]])
DECAYING = {"twice": [[-0.3, 1.0], [0.0, -0.3]], "once": [[-1.0]], "turning": TURNING - 0.2 * np.eye(2)}
HIDDEN = {"growth": [[0.2]], "level": [[0.0]], "oscillation": TURNING}
SCHEDULE = sd.PeriodicSchedule([0.5, 0.8])


def plant(decaying, hidden, seed, shown=0.0):
    """The parts side by side, in coordinates of condition up to 1e4, of odd seeds in units of their own.

    `shown` is what the output shows of the second part.
    """
    rng = np.random.default_rng([61, seed])
    parts = [np.array(DECAYING[decaying]), np.array(HIDDEN[hidden])]
    A = block_diag(*parts)
    C = np.concatenate([np.ones(len(parts[0])), np.full(len(parts[1]), shown)])[None]
    left, right = (np.linalg.qr(rng.standard_normal(A.shape))[0] for _ in range(2))
    T = (
        10.0 ** (seed % 2 * rng.integers(-6, 7, (len(A), 1)))
        * (left * 10.0 ** np.linspace(0, seed % 3 * 2, len(A)))
        @ right
    )
    return sd.Plant(T @ A @ np.linalg.inv(T), C @ np.linalg.inv(T)), len(parts[1])


CASES = list(product(DECAYING, HIDDEN, range(12)))


@pytest.mark.parametrize(("decaying", "hidden", "seed"), few(CASES, 0, 21, 40, 61))
def test_the_retained_part_observes_no_more_than_the_plant(decaying, hidden, seed):
    whole, size = plant(decaying, hidden, seed)
    kept = split_modes(whole).retained
    assert kept.n_states == size
    assert len(unobservable_modes(whole)) == size
    if seed % 6 in (0, 4):  # units do not commute with rounding, and condition enlarges it
        assert len(unobservable_modes(kept)) == size
    with pytest.raises(NotObservableError):
        loss_tolerance(whole, SCHEDULE)
    with pytest.raises(NotDetectableError):
        constants_from_proof(whole, SCHEDULE)
    with pytest.raises(NotObservableError):
        sd.design_schedule(whole, sd.Requirement(window=4.0, samples=4), starts=1, branches=0)


@pytest.mark.parametrize(("decaying", "hidden", "seed"), few(CASES, 0, 20, 40))
def test_what_is_shown_weakly_is_not_taken_for_rounding(decaying, hidden, seed):
    whole, _ = plant(decaying, hidden, seed, shown=1e-3)
    kept = split_modes(whole).retained
    assert len(unobservable_modes(whole)) == len(unobservable_modes(kept)) == 0
