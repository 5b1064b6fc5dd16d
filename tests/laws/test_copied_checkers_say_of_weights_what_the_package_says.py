"""Whoever reads a file whose weights are none, the package or the checkers alone, ends with the same exit code."""

import json

import numpy as np
import pytest

from sampling_design import PeriodicSchedule, Plant, certify, read_certificate
from sampling_design.certificates.detectability.best_rate import certify_detectability
from sampling_design.checkers import verdict
from sampling_design.checkers.parts import digest
from sampling_design.errors import CertificateError, SamplingDesignError
from sampling_design.schedules import Jitter
from sampling_design.uncertain import UncertainParameter, UncertainPlant

PLANT, EVEN = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), PeriodicSchedule([0.7])
BOX = UncertainPlant(PLANT, [UncertainParameter("stiffness", 0.95, 1.05, A=[[0, 0], [-1, 0]], nominal=1.0)])
CLAIMS = {
    "schedule": lambda: certify(PLANT, EVEN),
    "family": lambda: certify(PLANT, Jitter(EVEN, 0.05), eta=0.3),
    "detectability": lambda: certify_detectability(PLANT),
    "inclusion": lambda: certify(BOX, EVEN, eta=0.3),
}


def ending(path):
    try:
        return {"proven": 0, "refuted": 1, "undecided": 3}[read_certificate(path).verify().verdict]
    except SamplingDesignError as error:
        return error.exit_code


@pytest.fixture(scope="module", params=CLAIMS)
def made(request):
    return CLAIMS[request.param]()


@pytest.mark.parametrize("change", ["negative", "zero", "indefinite"])
def test_both_end_alike(made, change, tmp_path):
    path = made.save(tmp_path / "certificate.json")
    assert ending(path) == 0
    tree = json.loads(path.read_text())
    for name in ("P1", "P2", "Qw", "R", "Qv") if "P1" in tree else ("P",):
        M = np.array(tree[name])
        least = np.linalg.eigvalsh(M)[0]
        worse = {"negative": -M, "zero": 0 * M, "indefinite": M - 2 * least * np.eye(len(M))}[change]
        edited = tree | {name: worse.tolist()}
        path.write_text(json.dumps(edited | {"digest": digest(edited)}))
        found = verdict(edited | {"digest": digest(edited)})
        assert found.exit_code in (1, 3)
        assert ending(path) == found.exit_code


def test_the_sentence_is_the_checkers(tmp_path):
    path = certify(PLANT, EVEN).save(tmp_path / "certificate.json")
    tree = json.loads(path.read_text()) | {"R": [[-1.0]]}
    path.write_text(json.dumps(tree | {"digest": digest(tree)}))
    with pytest.raises(CertificateError, match="is not proven: R is not positive definite") as caught:
        read_certificate(path)
    assert caught.value.details["inequality"] == "R > 0"
