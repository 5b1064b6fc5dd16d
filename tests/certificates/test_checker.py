"""The independent checker: imports, mutations against a dense Riccati oracle, and every way to be refused."""

import ast
import copy
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from sampling_design import (
    Certificate,
    GapRange,
    PeriodicSchedule,
    Plant,
    Schedule,
    certify,
    certify_detectability,
    certify_family,
)
from sampling_design.certificates import checker
from sampling_design.certificates.form import seal
from tests.oracles import riccati as oracle

PATH = Path(checker.__file__)
OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
TILTED = Plant([[-0.5, -1.1], [1.5, 0.6]], [[0.5, -0.4], [1.0, 0.2]], G=[[1.0], [0.4]])


def certificates():
    mask = [[1, 0], [1, 1]]
    return [
        certify(OSCILLATOR, PeriodicSchedule([0.8, 1.3]), eta=0.4, P2=np.diag([0.5, 0.2])),
        certify(TILTED, PeriodicSchedule([1.2, 0.7], 0.3, mask), eta=0.3, P2=[[0.3, -0.3], [-0.3, 2.1]]),
        certify(TILTED, Schedule([0.4, 1.5, 2.1]), eta=0.3, P2=np.eye(2)),
    ]


def redigested(data):
    data["digest"] = seal.digest(data)
    return data


def scaled(data, rng):
    """One field altered by a random factor; returns what was altered."""
    field = rng.choice(
        ["P1", "P2", "Qw", "R", "Qv", "eta", "lam", "lam_samples", "margin", "A", "C", "G", "gaps", "ratio"]
    )
    factor = float(rng.choice([0.3, 0.8, 0.97, 0.99, 1.01, 1.03, 1.25, 3.0]))
    matrices = data["plant"]["matrices"]
    if field in ("P1", "P2", "Qw", "R", "Qv"):
        data[field] = (factor * np.array(data[field])).tolist()
    elif field in ("eta", "lam", "lam_samples", "margin"):
        data[field] = data[field] * factor * (100 if field == "margin" and factor > 1 else 1)
    elif field in ("A", "C", "G"):
        matrix = np.array(matrices.get(field, np.eye(2)))
        matrix.flat[rng.integers(matrix.size)] *= factor
        matrices[field] = matrix.tolist()
    elif field == "gaps" and data["times"]["kind"] == "periodic":
        data["times"]["gaps"][0] *= factor
    elif field == "gaps":
        data["times"]["times"] = [factor * t for t in data["times"]["times"]]
    else:
        data["witness"]["ratio"] *= factor
    return field


def verdict_by_scan(data):
    """True, False, or None where a claim is nearer to tight than the scan resolves."""
    P1, P2 = np.array(data["P1"]), np.array(data["P2"])
    resolved = (1 - 1e-3) * P2
    ratios = [
        oracle.worst_ratio(data, (1 + data["margin"]) * P1)[0],
        oracle.worst_ratio(data, resolved / data["lam"])[0],
    ]
    ratios.append(oracle.worst_ratio(data, resolved / data["lam_samples"], samples=True)[0])
    ratios.append(data["witness"]["ratio"] / oracle.witness_ratio(data))
    worst = max(ratios[:3])
    if ratios[3] > 1 + 1e-6 or worst > 1 + 1e-6:
        return False
    return None if worst > 1 - 2e-4 else True


def test_checker_agrees_with_the_riccati_oracle_on_200_mutations():
    rng = np.random.default_rng(20)
    originals = [json.loads(json.dumps(made.to_dict())) for made in certificates()]
    decided = {True: 0, False: 0}
    touched = set()
    while sum(decided.values()) < 200:
        data = copy.deepcopy(originals[rng.integers(len(originals))])
        field = scaled(data, rng)
        expected = verdict_by_scan(data)
        if expected is None:
            continue
        found = checker.check(redigested(data))
        assert found["passed"] is expected, (field, found, expected)
        decided[expected] += 1
        touched.add(field)
    assert min(decided.values()) >= 40
    assert len(touched) == 14


@pytest.mark.parametrize("k", range(3))
def test_one_percent_too_much_is_refused_with_inequality_time_and_amount(k):
    made = certificates()[k]
    data = made.to_dict()
    data["P1"] = (1.01 * np.array(data["P1"])).tolist()
    found = checker.check(redigested(data))
    assert not found["passed"]
    assert found["inequality"] == "(1 + margin) P1 <= Pi(t)"
    # the window and the time that it names violate the inequality by just the amount that it names
    assert -0.0105 < found["amount"] < -0.001
    Pi = oracle.information_at(data, found["start"], found["time"])
    stated = (1 + data["margin"]) * np.array(data["P1"])
    assert found["amount"] == pytest.approx(1 / oracle.worst_trajectory_ratio(stated, Pi) - 1, abs=1e-6)


def test_shorter_gaps_may_stay_valid():
    data = certify(OSCILLATOR, PeriodicSchedule([1.0]), eta=0.4, P2=np.eye(2)).to_dict()
    data["times"] = {"kind": "periodic", "gaps": [0.99], "first": 0.99, "outputs": None}
    data["witness"] = None
    assert oracle.worst_ratio(data, data["P1"], fine=32)[0] < 1 - 1e-3
    assert checker.check(redigested(data))["passed"]


def test_any_altered_byte_is_refused(tmp_path):
    path = certificates()[0].save(tmp_path / "certificate.json")
    text = path.read_text()
    assert checker.check(json.loads(text))["passed"]
    for old, new in (('"eta": 0.4', '"eta": 0.41'), ('"margin": 0.0001', '"margin": 0.0002'), ('"s"', '"h"')):
        assert old in text
        assert checker.check(json.loads(text.replace(old, new)))["inequality"] == "digest"


@pytest.mark.parametrize(
    ("change", "inequality"),
    [
        (lambda d: d.update(claim="detectability"), "claim"),
        (lambda d: d["times"].update(kind="gap-range"), "claim"),
        (lambda d: d.update(eta=0.0), "eta > 0"),
        (lambda d: d.update(lam=-1.0), "lam > 0"),
        (lambda d: d.update(R=[[-1.0]]), "R > 0"),
        (lambda d: d.update(P2=[[1.0, 0.0], [0.0, -1.0]]), "P2 > 0"),
        (lambda d: d.update(P1=[[1.0, 0.5], [0.0, 1.0]]), "P1 symmetric"),
        (lambda d: d.update(Qw=[[1.0, 0.0], [0.0, 0.0]]), "Qw > 0"),
        (lambda d: d["times"].update(gaps=[0.0, 1.0]), "times"),
        (lambda d: d["times"].update(first=9.0), "times"),
        (lambda d: d["times"].update(outputs=[[0], [1]]), "times"),
        (lambda d: d["witness"].update(start=-1.0), "witness"),
        (lambda d: d["witness"].update(ratio=1e3), "witness"),
        (lambda d: d.update(P1=[[1.0]]), "form"),
        (lambda d: d.pop("witness"), "form"),
        (lambda d: d["plant"].pop("matrices"), "form"),
        (lambda d: d.update(eta="much"), "form"),
    ],
)
def test_malformed_data_are_refused_with_the_right_word(change, inequality):
    data = certificates()[0].to_dict()
    change(data)
    found = checker.check(redigested(data))
    assert not found["passed"]
    assert found["inequality"] == inequality
    assert found["reason"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(R=[[np.nan]]), "is not symmetric and finite"),
        (lambda d: d.update(P2=[[1.0, 0.0], [0.0, -1.0]]), "is not positive definite: least eigenvalue -1"),
        (lambda d: d.update(eta=-1.0), "must be positive, got -1.0"),
        (lambda d: d["times"].update(gaps=[-1.0, 1.0]), "times must increase strictly, the first within the period"),
        (lambda d: d.update(Qw=[[1.0, 0.0], [0.0, 0.0]]), "Qw is singular in a direction that drives the plant"),
        (lambda d: d["witness"].update(t=-1.0), "the witness must have 0 <= start <= t within the schedule"),
        (lambda d: d["witness"].update(ratio=1e3), "the witness reaches"),
        (lambda d: d.update(P1=[[9.0, 0.0], [0.0, 9.0]]), "could not be decided|fails by"),
    ],
)
def test_each_proof_stops_at_the_first_thing_that_is_wrong(change, words):
    data = certificates()[0].to_dict()
    change(data)
    with pytest.raises(checker.Refused, match=words):
        checker.assumption_7(data)


def test_digest_and_claim_come_first():
    data = certificates()[0].to_dict()
    assert "something was altered" in checker.check({**data, "lam": 2.0})["reason"]
    other = checker.check(redigested({**data, "claim": "guess"}))
    assert other["reason"].startswith("no proof is known for the claim")


def test_what_can_not_be_decided_is_refused():
    """P1 = P2 with a plant that stands still: the inequality is tight along the whole gap."""
    still = Plant([[0.0]], [[1.0]], G=[[0.0]])
    made = Certificate.from_matrices(
        still, PeriodicSchedule([1.0]), P1=[[1.0]], P2=[[1.0]], Qw=[[1.0]], R=[[2.0]], Qv=[[2.0]], eta=1e-12, lam=1.0
    )
    verdict = made.verify()
    assert not verdict.passed
    assert "could not be decided: it is tight or nearly so" in verdict.reason or "fails by" in verdict.reason


def test_an_aliased_schedule_is_never_proven():
    made = Certificate.from_matrices(
        OSCILLATOR,
        PeriodicSchedule([np.pi]),
        P1=1e-6 * np.eye(2),
        P2=np.eye(2),
        Qw=np.eye(2),
        R=[[2.0]],
        Qv=[[2.0]],
        eta=0.4,
    )
    verdict = made.verify()
    assert not verdict
    assert verdict.time > 10
    assert "fails by" in verdict.reason


def test_a_dip_narrower_than_the_first_cells_is_found():
    """Two fast sharp modes: lambda over the starts has peaks far narrower than a quarter of a gap."""
    fast = Plant([[0.0, 25.0], [-25.0, 0.0]], [[1.0, 0.0]])
    made = certify(fast, PeriodicSchedule([1.0]), eta=0.5, P2=np.diag([0.1, 1.0]))
    dense = oracle.worst_ratio(made.to_dict(), made.P2, fine=160, laps=6)[0]
    assert dense <= made.lam / (1 - 1e-3)
    assert oracle.witness_ratio(made.to_dict()) == pytest.approx(made.lam, rel=1e-6)
    assert made.lam > 1.01 * oracle.worst_ratio(made.to_dict(), made.P2, fine=4, laps=6)[0]


@pytest.mark.parametrize("rate", [1e2, 1e5, 1e8])
def test_stiff_plants_are_proven(rate):
    A = np.array([[-0.1, 0.3, 0.0], [-0.3, -0.1, 0.0], [0.5, 0.2, -rate]])
    plant = Plant(A, [[1.0, 0.0, 0.3]])
    made = certify(plant, PeriodicSchedule([1.0, 0.7]), eta=0.15, P2=np.eye(3))
    assert made.verify().passed
    assert 1 < made.lam < 50


def test_checker_imports_the_standard_library_and_numpy_only():
    modules = set()
    for node in ast.walk(ast.parse(PATH.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            modules.add((node.module or "").split(".")[0])
    assert modules == {"hashlib", "json", "numpy", "runpy", "sys", "types", "typing"}
    assert PATH.read_text().count("\n") < 300


def test_checker_runs_alone(tmp_path):
    path = certificates()[0].save(tmp_path / "certificate.json")
    code = f"import runpy, sys; sys.argv = ['checker']; runpy.run_path({str(PATH)!r}, run_name='__main__')"
    for text, status in ((path.read_text(), 0), (path.read_text().replace('"eta": 0.4', '"eta": 0.5'), 1)):
        done = subprocess.run([sys.executable, "-c", code], input=text, capture_output=True, text=True)
        assert done.returncode == status
        assert done.stdout.strip()


def test_one_command_takes_the_files_of_every_claim(tmp_path):
    made = {
        "family": certify_family(OSCILLATOR, GapRange(0.9, 1.1), eta=0.2),
        "detectability": certify_detectability(OSCILLATOR),
        "assumption-7": certificates()[0],
    }
    for claim, certificate in made.items():
        text = certificate.save(tmp_path / "certificate.json").read_text()
        done = subprocess.run([sys.executable, PATH], input=text, capture_output=True, text=True)
        assert (done.returncode, done.stdout.strip()) == (0, certificate.verify().reason), claim
    for text in ("[1]", "{}", '{"claim": ["family"]}'):
        done = subprocess.run([sys.executable, PATH], input=text, capture_output=True, text=True)
        assert (done.returncode, "no certificate" in done.stdout) == (1, True)
