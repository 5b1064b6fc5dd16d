"""The truth never leaves the nominal filter's ellipsoid, whichever plant of the box it is and whatever the signals do.

`python -m tests.laws.test_radii_of_the_nominal_filter_hold_for_every_plant_of_the_box 1000` draws 1000 plants.
"""

import sys

import numpy as np
import pytest
from scipy.linalg import expm

from sampling_design import Plant
from sampling_design.errors import ArgumentError
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.uncertain import nominal_filter
from sampling_design.uncertain.nominal_filter import MismatchLoop, NominalFilter
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests.cases import few
from tests.oracles.boxes import drawn_values, matrices

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0]], B=[[0.0], [1.0]], G=[[0.0], [1.0]])
STIFFNESS = UncertainParameter("omega^2", 0.9, 1.1, A=[[0.0, 0.0], [-1.0, 0.0]], nominal=1.0)
GAIN = UncertainParameter("gain", 0.97, 1.03, C=[[1.0, 0.0]], nominal=1.0)
PUSH = UncertainParameter("push", 0.8, 1.2, G=[[0.0], [1.0]], nominal=1.0)


def drawn_box(rng):
    """One of four boxes: an oscillator, also with an unknown gain, an unstable plant, and far units of the first."""
    kind = int(rng.integers(4))
    if kind == 0:
        return UncertainPlant(OSCILLATOR, [STIFFNESS, PUSH], varying=True), np.ones(2)
    if kind == 1:
        return UncertainPlant(OSCILLATOR, [STIFFNESS, GAIN]), np.ones(2)
    if kind == 2:
        plant = Plant([[0.2, 1.0], [0.0, -1.0]], [[1.0, 0.0]], B=[[0.0], [1.0]], G=[[0.0], [1.0]])
        growth = UncertainParameter("growth", 0.15, 0.22, A=[[1.0, 0.0], [0.0, 0.0]], nominal=0.2)
        return UncertainPlant(plant, [growth]), np.ones(2)
    D = np.array([1e9, 1e-6])
    far = OSCILLATOR.A * D[:, None] / D
    from sampling_design.plants.plant import Signals

    plant = Plant(far, OSCILLATOR.C / D, B=OSCILLATOR.B * D[:, None], G=OSCILLATOR.G * D[:, None],
                  states=Signals(["x", "v"], (), D))  # fmt: skip
    moved = np.array(STIFFNESS.A) * D[:, None] / D
    return UncertainPlant(plant, [UncertainParameter("omega^2", 0.9, 1.1, A=moved, nominal=1.0)]), D


def fly(seed: int) -> float:
    """The largest |x - xhat|^2 in the inverse covariance over the radius, at and between samples, signals at bounds."""
    rng = np.random.default_rng(seed)
    box, D = drawn_box(rng)
    w_bound, v_bound, first = 0.1, 0.05, 0.3
    cost = CostFunction(P2=np.diag(1 / (first * D) ** 2) / 2, Qw=[[1 / w_bound**2]], R=[[2 / v_bound**2]],
                        Qv=[[2 / v_bound**2]], eta=0.4)  # fmt: skip
    x = D * rng.normal(size=2)
    away = rng.normal(size=2)
    off = first * D * away / max(np.abs(away))
    filter_ = NominalFilter(box, cost=cost, prior=x + off, w_bound=w_bound, v_bound=v_bound,
                            initial_error=first * D, typical=0.5)  # fmt: skip
    theta, t, u, worst = drawn_values(box, rng), 0.0, np.zeros(1), 0.0
    estimate = filter_.predict(0.0)
    for _ in range(8):
        gap = float(rng.uniform(0.2, 1.2))
        for _ in range(6):
            step = gap / 6
            e = x - estimate.x
            if box.varying:
                ends = np.array([[p.low, p.high] for p in box.parameters])
                theta = ends[np.arange(len(ends)), rng.integers(2, size=len(ends))]
            A, _ = matrices(box, theta)
            G = box.at(theta).G
            Pi = np.linalg.inv(estimate.covariance)
            w = w_bound * np.sign(float(e @ Pi @ G[:, 0])) if rng.random() < 0.8 else rng.uniform(-w_bound, w_bound)
            block = np.zeros((3, 3))
            block[:2, :2], block[:2, 2] = A, G[:, 0] * w + box.nominal.B[:, 0] * u[0]
            x = (expm(block * step) @ np.append(x, 1.0))[:2]
            t += step
            estimate = filter_.predict(t)
            assert estimate.certified, seed
            worst = max(worst, estimate.ratio(x))
        v = v_bound * rng.choice([-1.0, 1.0])
        u = rng.normal(size=1)
        estimate = filter_.update(t, matrices(box, theta)[1] @ x + v, u)
        assert estimate.certified, seed
        worst = max(worst, estimate.ratio(x))
    return worst


@pytest.mark.parametrize("seed", few(range(4), 0, 1))
def test_radii_of_the_nominal_filter_hold_for_every_plant_of_the_box(seed):
    assert fly(seed) <= 1.0


def test_the_radius_grows_with_the_box_and_without_one_is_that_of_the_filter():
    from sampling_design import KalmanFilter

    radii = []
    for half in (1e-12, 0.02, 0.2):
        box = UncertainPlant(OSCILLATOR, [UncertainParameter("k", 1 - half, 1 + half, A=STIFFNESS.A, nominal=1.0)])
        made = NominalFilter(box, cost=CostFunction(eta=0.4), w_bound=0.1, v_bound=0.05, initial_error=0.3)
        radii.append(float(made.update(0.5, [0.2]).radii[0]))
    plain = KalmanFilter(OSCILLATOR, cost=CostFunction(eta=0.4), w_bound=0.1, v_bound=0.05, initial_error=0.3)
    assert radii[0] == pytest.approx(float(plain.update(0.5, [0.2]).ellipsoid_radii[0]), rel=0.2)
    assert radii[0] < radii[1] < radii[2]


def test_a_box_that_no_bound_holds_says_that_there_is_no_radius():
    box = UncertainPlant(OSCILLATOR, [UncertainParameter("k", -1e7, 1e7, A=STIFFNESS.A, nominal=1.0)])
    made = NominalFilter(box, cost=CostFunction(eta=0.4), w_bound=0.1, v_bound=0.05, initial_error=0.3)
    for found in (made.predict(30.0), made.update(30.0, [0.2]), made.update(31.0, [0.2])):
        assert not found.certified
        assert found.radius == np.inf
        assert "No radius: it overflows." in found.note


@pytest.mark.parametrize(("typical", "certified", "most"), [(0.1, True, 150), (0.01, False, 250)])
def test_a_mismatch_that_weighs_much_at_first_takes_short_steps_at_first_alone(typical, certified, most, monkeypatch):
    """The first error is large against what lasts: steps are short where it is, and nothing is walked for minutes."""
    walked, stepped = [], MismatchLoop._stepped

    def counted(self, *given):
        walked.append(given[-1])
        return stepped(self, *given)

    monkeypatch.setattr(MismatchLoop, "_stepped", counted)
    monkeypatch.setattr(nominal_filter, "MOST_STEEP", 200)
    leak = UncertainParameter("leak", 4.9, 5.1, A=[[-1.0]], nominal=5.0)
    made = NominalFilter(UncertainPlant(Plant([[-5.0]], [[1.0]]), [leak]), cost=CostFunction(eta=0.5), w_bound=0.1,
                         v_bound=0.1, initial_error=1.0, typical=typical)  # fmt: skip
    assert made.update(4.0, [0.1]).certified == certified
    assert len(walked) < most


def test_what_is_no_box_is_refused():
    with pytest.raises(ArgumentError, match="must be an UncertainPlant"):
        NominalFilter(OSCILLATOR)
    with pytest.raises(ArgumentError, match="must have parameters in a box"):
        NominalFilter(UncertainPlant(OSCILLATOR, vertices=[OSCILLATOR]))


if __name__ == "__main__":
    ratios = [fly(seed) for seed in range(int(sys.argv[1]))]
    print(f"{len(ratios)} plants, largest ratio {max(ratios):.3g}, violations {sum(r > 1 for r in ratios)}")
