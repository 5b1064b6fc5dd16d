"""The information curve: exact at its points, least where the certificate's witness says."""

import numpy as np
import pytest

from sampling_design import Certificate, PeriodicSchedule, Plant, Schedule, certify
from sampling_design.certificates.exact.information import information_curve
from sampling_design.errors import ArgumentError

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
GAPS = PeriodicSchedule([0.7, 1.6, 0.9])


def test_the_curve_touches_the_promise_at_the_witness():
    certificate = certify(OSCILLATOR, GAPS, eta=0.2, P2=np.eye(2))
    curve = information_curve(certificate)
    assert curve.start == certificate.witness.start
    assert 1.0 < curve.least.min() < 1.01
    assert curve.t[np.argmin(curve.least)] == pytest.approx(certificate.witness.t, abs=0.1)
    assert curve.samples.size == 6
    assert "times the information" in curve.explain()


def test_a_scalar_plant_by_hand():
    # Pi' = -eta Pi - Pi^2 between samples, Pi+ = Pi + 1 at one
    plant = Plant([[0.0]], [[1.0]])
    made = Certificate.from_matrices(
        plant, PeriodicSchedule([1.0]), P1=[[0.2]], P2=[[1.0]], Qw=[[1.0]], R=[[2.0]], Qv=[[2.0]], eta=0.1
    )
    curve = information_curve(made, start=0.0, samples=2, points=3)

    def flown(pi, h):
        return 1 / (np.exp(0.1 * h) / pi + (np.exp(0.1 * h) - 1) / 0.1)

    first = [flown(1.0, h) for h in (0.0, 0.5, 1.0)]
    second = [flown(first[-1] + 1, h) for h in (0.0, 0.5, 1.0)]
    assert curve.least == pytest.approx(np.array(first + second) / 0.2)
    assert curve.t == pytest.approx([0, 0.5, 1, 1, 1.5, 2])


def test_a_finite_schedule_ends_at_its_last_sample():
    certificate = certify(OSCILLATOR, Schedule([0.5, 1.5, 2.2, 4.0]), eta=0.2, P2=np.eye(2))
    curve = information_curve(certificate, start=0.0)
    assert curve.t[-1] == pytest.approx(4.0)
    assert curve.least.min() >= 1.0
    with pytest.raises(ArgumentError, match="`start` must lie before the last sample"):
        information_curve(certificate, start=4.0)
