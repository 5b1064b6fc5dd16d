"""Adding a claim is adding a file: this one, which the package does not know, is written, read, checked and decided.

Claim "decay": the state of x' = Ax shrinks at rate eta in the norm of P, A'P + PA + eta P < 0.
"""

import json
import sys
from dataclasses import dataclass, replace
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.certificates import files
from sampling_design.certificates.form.horizon import Constant, ConstantList
from sampling_design.certificates.rigorous import decide
from sampling_design.checkers import check, claims, outcome, parts, strict
from sampling_design.checkers.detectability import downhill
from sampling_design.checkers.outcome import Refused, Verdict, holds
from sampling_design.numerics.balls import ball, definite, matrix, symmetric
from sampling_design.records.record import Claim, with_digest

INEQUALITY = "P > 0 and A'P + PA + eta P < 0"

# 1. what a file of the claim holds, and its judged content: the auditor's record


@dataclass(frozen=True)
class Decay:
    """A file of claim "decay"."""

    plant: parts.Plant
    P: np.ndarray
    eta: float


TABLE = strict.table(
    {**parts.AROUND, "P": strict.matrix(), "eta": strict.positive, "solver": strict.or_nothing(parts.SOLVER)}
)


def record(read: Any, plant: parts.Plant) -> Decay:
    return Decay(plant, parts.shaped(read["P"], "P", plant.n, plant.n), read["eta"])


# 2. the proof of its inequality, in rational numbers: nothing is rounded


def exact(M: Any) -> Any:
    return np.array([Fraction(x) for x in np.ravel(M).tolist()], dtype=object).reshape(np.shape(M))


def prove(c: Decay, work: Any) -> Verdict:
    A, P = exact(c.plant.A), exact(c.P)
    P = (P + P.T) / 2
    for form in (P, -(A.T @ P + P @ A + Fraction(c.eta) * P)):
        if downhill(form)[0] is not None:
            raise Refused(INEQUALITY, f"{INEQUALITY} fails")
    return Verdict(outcome.PROVEN, INEQUALITY, f"{INEQUALITY}, in rational numbers", 0.0)


CLAIM = parts.Claim(TABLE, record, prove)

# 3. the record that everybody else has, and its reader


@dataclass(frozen=True)
class DecayCertificate(decide.VerifiableRecord):
    """The state shrinks at this rate."""

    plant: sd.Plant
    P: np.ndarray
    eta: float

    @property
    def claim(self) -> Claim:
        return Claim("the state decays in the norm of P", INEQUALITY, ("linear plant",))

    def _numbers(self) -> ConstantList:
        return ConstantList([Constant("eta", self.eta, r"\eta", INEQUALITY)])

    def to_dict(self) -> dict[str, Any]:
        return with_digest(
            self.plant, {"claim": "decay", "P": np.asarray(self.P).tolist(), "eta": self.eta}, solver=None
        )


def read(data: Any, plant: sd.Plant, found: Decay) -> DecayCertificate:
    return DecayCertificate(plant, found.P, found.eta)


# 4. its decision in ball arithmetic


def in_balls(c: Decay, clock: Any) -> Verdict:
    A, P, eta = matrix(c.plant.A), symmetric(c.P), ball(c.eta)
    drift = A.transpose() * P
    if not definite(P) or not definite(-(drift + drift.transpose() + P * eta)):
        raise Refused(INEQUALITY, f"{INEQUALITY} fails")
    return holds(INEQUALITY, 0.0, "every state")


# 5. where each of them is looked up


@pytest.fixture(autouse=True)
def known(monkeypatch):
    monkeypatch.setitem(sys.modules, f"{claims.__package__}.decay", SimpleNamespace(CLAIM=CLAIM))  # checkers/decay.py
    monkeypatch.setitem(claims.CLAIMS, "decay", "decay")
    monkeypatch.setitem(files.READERS, Decay, read)
    monkeypatch.setitem(decide.CLAIMS, "decay", in_balls)


@pytest.fixture
def certificate():
    plant = sd.Plant([[-1.0, 2.0], [0.0, -1.0]], [[1.0, 0.0]])
    return DecayCertificate(plant, np.array([[1.0, 0.8], [0.8, 4.0]]), 0.5)


def test_it_is_proven_by_the_checkers_and_in_balls(certificate):
    assert certificate.verify().verdict == "proven"
    assert certificate.verify(rigorous=True).verdict == "proven"


def test_its_file_comes_back_and_the_command_checks_it(certificate, tmp_path, shell):
    path = certificate.save(tmp_path / "decay.json")
    again = sd.read_certificate(path)
    assert again.to_dict() == certificate.to_dict()
    told = shell("verify", path)
    assert told.code == 0, told.err


def test_a_rate_that_is_too_fast_is_refuted_everywhere(certificate, tmp_path, shell):
    fast = replace(certificate, eta=3.0)
    assert fast.verify().verdict == "refuted"
    assert fast.verify(rigorous=True).verdict == "refuted"
    assert shell("verify", fast.save(tmp_path / "fast.json")).code == 1


def test_an_altered_file_and_a_forged_key_are_no_certificate(certificate):
    data = json.loads(json.dumps(certificate.to_dict()))
    assert "digest" in check(data | {"eta": 0.1})["reason"]
    forged = data | {"P1": [[1.0]]}
    forged["digest"] = parts.digest(forged)
    assert check(forged)["verdict"] == "bad file"
    assert "unknown key 'P1'" in check(forged)["reason"]
