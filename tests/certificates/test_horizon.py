"""Horizons by both theorems, RGES on simulated estimators, and the true contraction."""

from dataclasses import replace

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, Schedule, certify
from sampling_design.certificates.compare import contraction
from sampling_design.certificates.compare.contraction import (
    MOST_PERIODS,
    error_map,
    least_contracting,
    spectral_radius,
)
from sampling_design.certificates.compare.four_horizons import four_horizons
from sampling_design.errors import ArgumentError, CertificateError, UndecidedError
from sampling_design.records.record import above
from tests.cases import few

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
FOUR = Plant(
    [[-1.0, 0.0, 0.0, 0.0], [0.0, 0.1, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -1.0, 0.0]], [[1.0, 1.0, 1.0, 0.0]]
)
EVERY = PeriodicSchedule([1.0])


def made_for(plant=OSCILLATOR, schedule=EVERY, **options):
    return certify(plant, schedule, **{"eta": 0.4, "P2": np.eye(plant.n_states), **options})


def test_both_theorems_give_their_formulas():
    made = made_for(DOUBLE)
    lam, samples, eta = made.lam / (1 - 1e-3), made.lam_samples / (1 - 1e-3), made.eta
    sharp, paper = made.horizon(), made.horizon("paper")
    assert sharp.minimum == pytest.approx(np.log(lam) / eta)
    assert sharp.length == pytest.approx(max(1.0, np.log(4 * lam) / eta))
    assert paper.minimum == pytest.approx(2 * np.log(2 * samples) / eta)
    assert paper.length == pytest.approx(2 * np.log(4 * samples) / eta)
    assert sharp.eta_tilde == pytest.approx(eta - np.log(lam) / sharp.length)
    assert paper.eta_tilde == pytest.approx(eta - np.log(4 * samples**2) / paper.length)
    low = np.linalg.eigvalsh(made.P1)[0]
    assert (sharp.C_x, sharp.C_w, sharp.C_v) == pytest.approx((1 / low, 1 / low, 1 / low))
    low = 1.0 / samples
    assert (paper.C_x, paper.C_w, paper.C_v) == pytest.approx(
        (4 * samples / low, 4 * samples / low, 8 * samples * 2 / low)
    )
    assert float(sharp) == sharp.length


def test_rate_of_the_estimator_is_below_that_of_the_certificate():
    """Printed the other way round ("using eta <= eta~"): lambda >= 1, so that eta~ = eta - ln(4 lambda^2)/M < eta."""
    lam, eta, M = 2.0, 1.0, 4.0
    assert eta - np.log(4 * lam**2) / M == pytest.approx(0.307, abs=1e-3)
    made = made_for(DOUBLE)
    for theorem in ("improved", "paper"):
        for factor in (1.01, 2.0, 50.0):
            found = made.horizon(theorem, max(factor * made.horizon(theorem).minimum, made.d_max))
            assert 0 < found.eta_tilde < made.eta


def test_too_short_windows_are_refused():
    made = made_for()
    least = made.horizon().minimum
    assert made.horizon(length=1.0001 * least).eta_tilde > 0
    with pytest.raises(CertificateError, match="this theorem needs M >"):
        made.horizon(length=0.9999 * least)
    with pytest.raises(CertificateError, match="is too short: this theorem needs"):
        made.horizon("paper", length=made.horizon("paper").minimum)
    slow = replace(made, eta=1e-308)
    with pytest.raises(CertificateError, match="is so slow that the horizon is no number"):
        slow.horizon()
    with pytest.raises(ArgumentError, match='`theorem` must be "improved" or "paper"'):
        made.horizon("best")
    assert "decays at rate" in made.horizon().explain()
    assert made.horizon("paper").claim.theorem == "Theorem 9"
    assert made.horizon().claim.theorem == "improved horizon theorem"


@pytest.mark.parametrize(
    ("plant", "radii"),
    [(DOUBLE, (0.556, 0.266, 0.052)), (OSCILLATOR, (0.633, 0.399, 0.125)), (FOUR, (0.818, 0.605, 0.260))],
    ids=["double integrator", "oscillator", "four states"],
)
def test_spectral_radius_of_the_papers_estimator(plant, radii):
    made = made_for(plant, R=np.eye(1))
    assert [spectral_radius(made, M, "paper") for M in (1.0, 2.0, 4.0)] == pytest.approx(radii, abs=6e-4)
    assert least_contracting(made, "paper") <= 1.0


def test_error_map_is_that_of_a_least_squares_estimator():
    """One window solved as one weighted least-squares problem over x(start), w and the samples."""
    made = made_for(DOUBLE, PeriodicSchedule([0.6, 0.9]))
    start, length, eta = 0.3, 2.7, made.eta
    seen = made.schedule.between(start, start + length, closed="right").times - start
    pieces = 300
    edges = np.linspace(0, length, pieces + 1)
    h = length / pieces
    step, drive = made.plant.transition(h), np.array([[h, h * h / 2], [0.0, h]])
    x = np.hstack([np.eye(2), np.zeros((2, 2 * pieces))])
    rows, weights = [np.eye(2, 2 + 2 * pieces)], [np.exp(-eta * length) * np.ones(2)]
    rows.append(np.eye(2 * pieces, 2 + 2 * pieces, 2))
    weights.append(np.repeat((np.exp(-eta * (length - edges[1:])) - np.exp(-eta * (length - edges[:-1]))) / eta, 2))
    target = [np.eye(2), np.zeros((2 * pieces, 2))]
    nearest = np.round(seen / h).astype(int)
    for k in range(pieces):
        x = step @ x
        x[:, 2 + 2 * k : 4 + 2 * k] += drive
        if k + 1 in nearest:
            rows.append(x[:1])
            weights.append(np.array([np.exp(-eta * (length - edges[k + 1]))]))
            target.append(np.zeros((1, 2)))  # the truth is zero, the prior is e
    root = np.sqrt(np.concatenate(weights))[:, None]
    z = np.linalg.lstsq(root * np.vstack(rows), root * np.vstack(target), rcond=None)[0]
    assert np.allclose(x @ z, error_map(made, start, length), atol=2e-4)


def test_contraction_needs_a_periodic_schedule_and_a_known_cost():
    finite = made_for(schedule=Schedule([1.0, 2.0]))
    with pytest.raises(ArgumentError, match="a finite one has no long run"):
        spectral_radius(finite, 1.0)
    for length in (0.0, -1.0):
        with pytest.raises(ArgumentError, match="`horizon` must be positive"):
            spectral_radius(made_for(), length)
        with pytest.raises(ArgumentError, match="`horizon` must be positive"):
            error_map(made_for(), 0.0, length)
    with pytest.raises(ArgumentError, match="`certificate` must be on a periodic schedule"):
        least_contracting(finite)
    with pytest.raises(ArgumentError, match='`cost` must be "certificate" or "paper"'):
        error_map(made_for(), 0.0, 1.0, "improved")


def test_windows_side_by_side_are_what_one_after_the_other_is(monkeypatch):
    made = made_for(schedule=PeriodicSchedule([0.5, np.sqrt(2) / 3, 0.9]))
    for cost, length in (("certificate", 1.3), ("paper", 0.8)):
        worst = 0.0
        for offset in made.schedule.times:
            product = np.eye(2)
            for k in range(MOST_PERIODS):
                product = error_map(made, float(offset) + k * length, length, cost) @ product
            worst = max(worst, np.abs(np.linalg.eigvals(product)).max() ** (1 / MOST_PERIODS))
        assert spectral_radius(made, length, cost) == pytest.approx(worst, rel=1e-12)
        monkeypatch.setattr(contraction, "MOST_AT_ONCE", 64)
        assert spectral_radius(made, length, cost) == pytest.approx(worst, rel=1e-12)


@pytest.mark.parametrize("cost", few(["certificate", "paper"], 0))
def test_a_sample_at_the_end_of_a_window_lies_in_it_whatever_the_unit_of_time(cost):
    """Rounding of times decided: ten windows of 1.7 gaps lost a sample, and their radius was .540 for .512."""
    found = []
    for gaps, length in (([1.0], 1.7), ([0.3, 0.5, 0.2], 1.3), ([0.5, 0.7], 1.7), ([0.5, 0.7] * 2, 1.7)):
        for c in (1.0, 0.1, 1 / 3, 7.7e4):
            plant = Plant(OSCILLATOR.A / c, OSCILLATOR.C, G=OSCILLATOR.G)
            made = made_for(plant, PeriodicSchedule(np.array(gaps) * c), eta=0.4 / c, Qw=np.eye(2) * c, R=np.eye(1))
            found.append((spectral_radius(made, length * c, cost), least_contracting(made, cost) / c))
    same = np.array(found).reshape(4, 4, 2)
    assert same == pytest.approx(np.broadcast_to(same[:, :1], same.shape), rel=1e-7)
    assert same[3, 0, 0] == pytest.approx(same[2, 0, 0], rel=1e-7)  # a period written twice


def test_a_comparison_that_no_time_is_left_for_says_so():
    with pytest.raises(UndecidedError, match="not every length was tried within `budget` = 1e-09 s"):
        least_contracting(made_for(), budget=1e-9)
    row = four_horizons(OSCILLATOR, EVERY, made_for(), budget=1e-9).rows[-1]
    assert row.minimum is None
    assert "not every length was tried" in row.note


def test_a_certificate_that_is_not_given_is_sought_within_the_budget(monkeypatch):
    """The search took all the time it wanted, fourteen seconds of .3 for forty states."""
    asked = []
    monkeypatch.setattr(
        "sampling_design.certificates.compare.four_horizons.certify",
        lambda *given, budget: asked.append(budget) or made_for(),
    )
    assert four_horizons(OSCILLATOR, EVERY, budget=6.0).rows[-1].minimum is not None
    assert four_horizons(OSCILLATOR, EVERY).rows[-1].minimum is not None
    assert 3.0 < asked[0] <= 4.0
    assert asked[1] is None


def test_contraction_over_windows_that_do_not_divide_the_period():
    made = made_for(schedule=PeriodicSchedule([0.5, 0.7]))
    assert 0 < spectral_radius(made, 1.0) < 1
    assert spectral_radius(made, 3.6) < spectral_radius(made, 1.2)


@pytest.mark.parametrize(
    ("plant", "chain"), few([(DOUBLE, 44.3), (OSCILLATOR, 44.4), (FOUR, 182.0)], 0, 1), ids=["2", "o", "4"]
)
def test_four_horizons_stand_in_order(plant, chain):
    table = four_horizons(plant, EVERY, certify(plant, EVERY, eta=0.4))
    minima = [row.minimum for row in table.rows]
    assert minima[0] == pytest.approx(chain, rel=0.01)
    assert minima[0] > minima[1] > minima[2] > minima[3]
    assert table.radius < 1
    assert table.to_markdown().count("\n") == 6
    assert "exact, improved" in table.to_latex()
    said = [f"{above(value, 4)} s" for value in minima]
    assert f"paper's constants: {said[0]}; exact, Theorem 9: {said[1]}; " in table.explain()
    assert f" improved: {said[2]}. In doubles the error map contracts from {said[3]}" in table.explain()
    assert f"more than {said[2]} is proven" in repr(table)  # the yardstick bounds nothing
    assert "M >" in str(table)


def test_four_horizons_of_a_finite_schedule_say_what_is_missing():
    table = four_horizons(OSCILLATOR, Schedule([0.2, 0.5]), made_for(schedule=Schedule([0.2, 0.5])))
    assert table.rows[3].minimum is None
    assert "finite" in str(table)
    assert table.radius is None
