"""100 random schedules of each certified family: the lambda of each, by plain recursion, is at most the family's."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design import Certificate, GapRange, Jitter, LostSamples, PeriodicSchedule, Plant, SpacedWindows
from tests.oracles.families import information, largest_lambda

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
INTEGRATOR = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
CASES = [
    (OSCILLATOR, GapRange(0.5, 1.5)),
    (OSCILLATOR, GapRange(0.3, 3.0)),
    (INTEGRATOR, GapRange(0.1, 4.0)),
    (OSCILLATOR, SpacedWindows(4.0, 2, 0.5)),
    (INTEGRATOR, LostSamples(PeriodicSchedule([1.0, 0.5]), 1, 3)),
    (OSCILLATOR, Jitter(PeriodicSchedule([1.0, 2.0]), 0.3)),
]


@pytest.mark.long
@pytest.mark.parametrize(("plant", "family"), CASES, ids=lambda x: type(x).__name__)
def test_every_drawn_schedule_keeps_the_family_certificate(plant, family):
    certificate = sd.certify(plant, family, eta=0.3, P2=[[0.3, 0.05], [0.05, 0.2]])
    weights = (certificate.Qw, certificate.R, certificate.Qv)
    rng = np.random.default_rng(7)
    top = 0.0
    for _ in range(30):
        drawn = family.draw(rng, duration=5 * family.d_max)
        assert family.contains(drawn)
        top = max(top, largest_lambda(plant, weights, 0.3, certificate.P2, drawn.times[:6], starts=2, parts=2))
    assert top <= certificate.lam_proven
    assert top >= certificate.lam / 3  # and the family's lambda is not far above what its schedules reach


@pytest.mark.long
@pytest.mark.parametrize(("plant", "family"), CASES, ids=lambda x: type(x).__name__)
def test_the_family_certificate_is_a_certificate_of_every_drawn_schedule(plant, family):
    whole = sd.certify(plant, family, eta=0.3, P2=[[0.3, 0.05], [0.05, 0.2]])
    weights = {key: getattr(whole, key) for key in ("P2", "Qw", "R", "Qv", "eta", "lam", "lam_samples")}
    rng = np.random.default_rng(9)
    drawn = [family.draw(rng, duration=5 * family.d_max) for _ in range(30)]
    for k, schedule in enumerate(drawn):
        single = Certificate.from_matrices(plant, schedule, P1=whole.P1, **weights)
        verdict = single.verify(rigorous=k % 10 == 0)
        assert verdict.passed, f"{schedule.times}: {verdict.reason}"
    wrong = (Certificate.from_matrices(plant, schedule, P1=3.5 * whole.P1, **weights) for schedule in drawn)
    assert not all(single.verify().passed for single in wrong)


def test_the_kept_information_is_at_least_P1_at_any_time():
    certificate = sd.certify(OSCILLATOR, GapRange(0.5, 1.5), eta=0.3)
    weights = (certificate.Qw, certificate.R, certificate.Qv)
    rng = np.random.default_rng(8)
    for _ in range(40):
        times = GapRange(0.5, 1.5).draw(rng, samples=6).times
        start = rng.uniform(0.0, times[-2])
        t = rng.uniform(start, times[-1])
        Pi = information(OSCILLATOR, weights, 0.3, certificate.P2, times, start, t)
        assert np.linalg.eigvalsh(Pi - certificate.P1)[0] > 0
