"""Families: certificate, independent proof, refusal, robustness."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import CertificateError

OSCILLATOR = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])


def test_certify_gap_range_at_a_rate(benchmark):
    family = sd.GapRange(0.5, 1.5)
    sd.certify(OSCILLATOR, family, eta=0.1)  # the first call loads the solver
    assert benchmark(sd.certify, OSCILLATOR, family, eta=0.1).lam < 2


def test_certify_gap_range_with_rate_chosen(benchmark):
    found = benchmark.pedantic(sd.certify, (OSCILLATOR, sd.GapRange(0.5, 1.5)), rounds=1)
    assert found.horizon().minimum < 3.2


def test_certify_four_states(benchmark):
    found = benchmark(sd.certify, sd.plants.library.helicopter_he1(), sd.GapRange(0.2, 0.5), eta=0.3)
    assert found.lam < 3


def test_certify_spaced_windows_with_memory(benchmark):
    family = sd.SpacedWindows(4.0, 2, 0.5)
    assert benchmark.pedantic(sd.certify, (OSCILLATOR, family), {"eta": 0.1}, rounds=1).lam < 3


def test_verify_gap_range(benchmark):
    certificate = sd.certify(OSCILLATOR, sd.GapRange(0.5, 1.5), eta=0.1)
    assert benchmark(certificate.verify).passed


def test_refuse_a_range_that_holds_pi(benchmark):
    def refused():
        with pytest.raises(CertificateError, match=r"3\.14159"):
            sd.certify(OSCILLATOR, sd.GapRange(3.0, 3.3), eta=0.1)

    benchmark(refused)


def test_robustness_of_a_period(benchmark):
    planned = sd.certify(OSCILLATOR, sd.PeriodicSchedule([1.0]), eta=0.8, P2=0.5 * np.eye(2))
    assert benchmark.pedantic(sd.robustness, (OSCILLATOR, planned), {"longest": 5}, rounds=1).radius > 0
