"""The build of the documentation fails where a page makes a certificate that is not proven."""

import importlib.util
import os
import runpy
from pathlib import Path

import numpy as np
import pytest

from sampling_design import Certificate, PeriodicSchedule, Plant
from tests import kept_certificates

ROOT = Path(__file__).parents[2]


@pytest.fixture
def room(monkeypatch):
    for name in (kept_certificates.FOLDER, "IPYTHONDIR"):
        monkeypatch.setenv(name, os.environ.get(name, ""))  # given back afterwards
    spec = importlib.util.spec_from_file_location("proven_pages", ROOT / "docs" / "proven_pages.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def certificate(factor):
    """True for a factor up to some 1.5, and wrong above it."""
    oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    weights = {"P2": np.eye(2), "Qw": np.eye(2), "R": [[2.0]], "Qv": [[2.0]], "eta": 0.4}
    return Certificate.from_matrices(oscillator, PeriodicSchedule([1.0]), P1=0.05 * factor * np.eye(2), **weights)


def test_what_a_kernel_makes_is_judged(room, tmp_path, monkeypatch):
    room.collect(ROOT, tmp_path / "made")
    (startup,) = Path(os.environ["IPYTHONDIR"]).glob("profile_default/startup/*.py")
    runpy.run_path(str(startup))  # as a kernel does: what makes certificates is watched from then on
    (few,) = room.open_certificates(tmp_path / "made")
    assert few == f"0 certificates were made, {room.LEAST} at least were expected"
    monkeypatch.setattr(room, "LEAST", 1)
    kept_certificates.keep(certificate(1.0))
    assert room.open_certificates(tmp_path / "made") == ()
    kept_certificates.keep(certificate(20.0))
    (told,) = room.open_certificates(tmp_path / "made")
    assert "refuted" in told


def test_without_the_program_that_decides_nothing_is_proven(room, tmp_path, monkeypatch):
    room.collect(ROOT, tmp_path / "made")
    monkeypatch.setattr(room, "find_spec", lambda name: None)
    (told,) = room.open_certificates(tmp_path / "made")
    assert "pip install 'sampling-design[rigorous]'" in told
