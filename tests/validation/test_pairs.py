"""Inequality (16): the worst pair comes near to equality, and a certificate that claims more is caught."""

import numpy as np
import pytest

from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.validation.scenario import ErrorSources
from sampling_design.validation.study import sides, worst_pair
from sampling_design.validation.timeline import build_timeline
from tests.cases import few
from tests.oracles.validation import step
from tests.validation.plants import FINITE, PLANTS, SCHEDULES, certificate

MATRICES = ("P1", "P2", "Qw", "R", "Qv")


def boasting(made, factor):
    parts = {key: getattr(made, key) for key in MATRICES}
    parts["P1"] = factor * parts["P1"]
    return Certificate.from_matrices(made.plant, made.schedule, **parts, eta=made.eta)


def random_pairs(line, made, span, rng, count):
    """Ratios of random pairs from a few starts, noise that hides what is read among them."""
    plant, found = line.plant, []
    hiding = -np.linalg.solve(made.R + made.Qv, made.R @ plant.C)
    units = [np.linalg.cholesky(np.linalg.inv(M)) for M in (made.P2, made.Qw)]
    samples = line.sample_at
    for start in rng.integers(0, np.searchsorted(line.times, line.times[-1] - span), size=8).tolist():
        stop = int(np.searchsorted(line.times, line.times[start] + span)) - 1
        chi = rng.normal(size=(count, plant.n_states)) @ units[0].T
        size = rng.choice([0.0, 0.1, 1.0], size=(count, 1, 1)) / np.sqrt(span)
        w = size * (rng.normal(size=(count, line.cells, plant.n_disturbances)) @ units[1].T)
        x, v = chi, np.zeros((count, line.samples.size, plant.n_outputs))
        for c in range(start, stop):
            x = x @ line.F[c].T + w[:, c] @ line.gamma[c].T
            if c + 1 in samples:
                v[:, samples[c + 1]] = x @ hiding.T
        v *= rng.uniform(0.0, 1.5, size=(count, 1, 1))
        found.append(sides(line, made, start, stop, ErrorSources(chi, w, v))[0])
    return found


@pytest.mark.parametrize("name", few(PLANTS, 0))
def test_the_worst_pair_nearly_reaches_equality_and_never_exceeds_it(name):
    line = build_timeline(PLANTS[name], SCHEDULES[name], 12.0, 3.7)
    ratio, _, _ = worst_pair(line, certificate(name), 6.0)
    assert 0.9 < ratio <= 1.0
    drawn = random_pairs(line, certificate(name), 6.0, np.random.default_rng(0), 100)
    assert 0.0 < max(drawn) < ratio
    assert worst_pair(line, boasting(certificate(name), 1.15), 6.0)[0] > 1.0


def test_a_finite_schedule_is_looked_at_up_to_its_end():
    line = build_timeline(PLANTS["oscillator"], FINITE, FINITE.times[-1], 3.0)
    ratio, _, time = worst_pair(line, certificate("oscillator", finite=True), 20.0)
    assert 0.8 < ratio <= 1.0
    assert time <= FINITE.times[-1]


def test_both_sides_agree_with_plain_sums():
    name, start, stop = "two outputs", 3, 40
    plant, made = PLANTS[name], certificate(name)
    line = build_timeline(plant, SCHEDULES[name], 12.0, 3.7)
    rng = np.random.default_rng(5)
    chi, w = rng.normal(size=3), rng.normal(size=(line.cells, 3))
    v = rng.normal(size=(line.samples.size, 2))
    found = sides(line, made, start, stop, ErrorSources(chi[None], w[None], v[None]))
    x, best = chi, 0.0
    terms = [(line.times[start], chi @ made.P2 @ chi)]
    for c in range(start, stop):
        h = line.lengths[c]
        F, moved = step(plant.A, plant.G, w[c], h)
        x = F @ x + moved
        terms.append((line.times[c + 1], (1 - np.exp(-made.eta * h)) / made.eta * (w[c] @ made.Qw @ w[c])))
        looks = [False, True] if c + 1 in line.samples else [False]
        for sampled in looks:
            if sampled:
                j = int(np.flatnonzero(line.samples == c + 1)[0])
                noise = v[j] * line.masks[j]
                y = plant.C @ x * line.masks[j] + noise
                terms.append((line.times[c + 1], y @ made.R @ y + noise @ made.Qv @ noise))
            right = sum(np.exp(-made.eta * (line.times[c + 1] - t)) * value for t, value in terms)
            best = max(best, x @ made.P1 @ x / right)
    assert found[0] == pytest.approx(best, rel=1e-10)
