"""The independent checker: imports, mutations against a dense Riccati oracle, and every way to be refused."""

import ast
import copy
import io
import json
import shutil
import signal
import subprocess
import sys
import time
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from sampling_design import (
    Certificate,
    GapRange,
    Jitter,
    LostSamples,
    PeriodicSchedule,
    Plant,
    Schedule,
    SpacedWindows,
    certify,
)
from sampling_design import checkers as checker
from sampling_design.accuracy.interval import state_interval
from sampling_design.certificates.detectability.best_rate import certify_detectability
from sampling_design.certificates.families.certify_family import certify_family
from sampling_design.checkers import claims, outcome, parts, sampled
from sampling_design.checkers.check import main
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests.cases import few
from tests.oracles import riccati as oracle

ROOM = Path(checker.__file__).parent
OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
FAMILIES = [
    GapRange(0.9, 1.1),
    SpacedWindows(3.0, 2, 1.0),
    LostSamples(PeriodicSchedule([1.0]), 1, 3),
    Jitter(PeriodicSchedule([1.0, 1.5]), 0.1),
]
TILTED = Plant([[-0.5, -1.1], [1.5, 0.6]], [[0.5, -0.4], [1.0, 0.2]], G=[[1.0], [0.4]])


@cache
def certificates():
    mask = [[1, 0], [1, 1]]
    return [
        certify(OSCILLATOR, PeriodicSchedule([0.8, 1.3]), eta=0.4, P2=np.diag([0.5, 0.2])),
        certify(TILTED, PeriodicSchedule([1.2, 0.7], 0.3, mask), eta=0.3, P2=[[0.3, -0.3], [-0.3, 2.1]]),
        certify(TILTED, Schedule([0.4, 1.5, 2.1]), eta=0.3, P2=np.eye(2)),
    ]


def redigested(data):
    data["digest"] = parts.digest(data)
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
        data["witness"] |= {key: factor * data["witness"][key] for key in ("t", "start")}
    else:
        data["witness"]["ratio"] *= factor
    return field


def verdict_by_scan(data):
    """True, False, or None where a claim is nearer to tight than the scan resolves."""
    P1, P2 = np.array(data["P1"]), np.array(data["P2"])
    resolved = (1 - 1e-3) * P2
    targets = [(1 + data["margin"]) * P1, resolved / data["lam"]]
    ratios = [ratio for ratio, *_ in oracle.worst_ratios(data, targets)]
    ratios.append(oracle.worst_ratio(data, resolved / data["lam_samples"], samples=True)[0])
    ratios.append(data["witness"]["ratio"] / oracle.witness_ratio(data))
    worst = max(ratios[:3])
    if ratios[3] > 1 + 1e-6 or worst > 1 + 1e-6:
        return False
    return None if worst > 1 - 2e-4 else True


@pytest.mark.long
@pytest.mark.parametrize("count", [200, 50])
def test_checker_agrees_with_the_riccati_oracle_on_mutations(count):
    rng = np.random.default_rng(20)
    originals = [json.loads(json.dumps(made.to_dict())) for made in certificates()]
    decided = {True: 0, False: 0}
    touched = set()
    while sum(decided.values()) < count:
        data = copy.deepcopy(originals[rng.integers(len(originals))])
        field = scaled(data, rng)
        expected = verdict_by_scan(data)
        if expected is None:
            continue
        found = checker.check(redigested(data))
        assert found["passed"] is expected, (field, found, expected)
        decided[expected] += 1
        touched.add(field)
    assert min(decided.values()) >= count / 5
    assert len(touched) == 14 or count < 200


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
        (lambda d: d.update(claim="detectability"), "form"),
        (lambda d: d["times"].update(kind="gap-range"), "form"),
        (lambda d: d.update(eta=0.0), "form"),
        (lambda d: d.update(lam=-1.0), "form"),
        (lambda d: d.update(R=[[-1.0]]), "R > 0"),
        (lambda d: d.update(P2=[[1.0, 0.0], [0.0, -1.0]]), "P2 > 0"),
        (lambda d: d.update(P1=[[1.0, 0.5], [0.0, 1.0]]), "form"),
        (lambda d: d.update(Qw=[[1.0, 0.0], [0.0, 0.0]]), "Qw > 0"),
        (lambda d: d["times"].update(gaps=[0.0, 1.0]), "form"),
        (lambda d: d["times"].update(first=9.0), "form"),
        (lambda d: d["times"].update(outputs=[[0], [1]]), "form"),
        (lambda d: d["witness"].update(start=-1.0), "form"),
        (lambda d: d["witness"].update(start=1e3), "form"),
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
        (lambda d: d.update(P2=[[1.0, 2.0], [2.0, 1.0]]), "is not positive definite: least eigenvalue -1"),
        (lambda d: d.update(P2=[[1.0, 1.0], [1.0, 1.0]]), "is not positive definite: least eigenvalue"),
        (lambda d: d.update(Qw=[[1.0, 0.0], [0.0, 0.0]]), "Qw is singular in a direction that drives the plant"),
        (lambda d: d.update(Qw=[[1.0, 2.0], [2.0, 1.0]]), "Qw is not positive semidefinite"),
        (lambda d: d["witness"].update(ratio=1e3), "the witness reaches"),
        (lambda d: d.update(P1=[[9.0, 0.0], [0.0, 9.0]]), "could not be decided|fails by"),
        (lambda d: d.update(P2=[[1e-290, 0.0], [0.0, 1.0]], Qw=[[1e290, 0.0], [0.0, 1.0]]), "too large or too small"),
        (lambda d: d.update(Qw=[[5e-324, 0.0], [0.0, 1.0]]), "is beyond the range of doubles"),
    ],
)
def test_each_proof_stops_at_the_first_thing_that_is_wrong(change, words):
    data = certificates()[0].to_dict()
    change(data)
    with pytest.raises(outcome.Refused, match=words):
        sampled.prove(claims.certificate(redigested(data)))


def test_digest_and_claim_come_first():
    data = certificates()[0].to_dict()
    assert "something was altered" in checker.check({**data, "lam": 2.0})["reason"]
    other = checker.check(redigested({**data, "claim": "guess"}))
    assert (other["verdict"], "`claim` must be" in other["reason"]) == ("bad file", True)


@cache
def tight_one():
    """x' = -x/4 at rate 1/2: the discounted information stands still between samples."""
    still = Plant([[-0.25]], [[1.0]], G=[[0.0]])
    return Certificate.from_matrices(
        still, PeriodicSchedule([1.0]), P1=[[1.0]], P2=[[1.0]], Qw=[[1.0]], R=[[2.0]], Qv=[[2.0]], eta=0.5, lam=1.0
    )


def test_what_can_not_be_decided_is_refused():
    """P1 = P2 with information that stands still: the inequality is tight along the whole gap, in balls too."""
    assert tight_one().verify().verdict == "undecided"
    found = checker.check(tight_one().to_dict())
    assert found["verdict"] == "undecided"
    assert "could not be decided: it is tight or nearly so" in found["reason"]


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
    fast = Plant([[0.0, 12.5], [-12.5, 0.0]], [[1.0, 0.0]])
    made = certify(fast, PeriodicSchedule([1.0]), eta=0.5, P2=np.diag([0.1, 1.0]))
    dense = oracle.worst_ratio(made.to_dict(), made.P2, fine=60, periods=4)[0]
    assert dense <= made.lam / (1 - 1e-3)
    assert oracle.witness_ratio(made.to_dict()) == pytest.approx(made.lam, rel=1e-6)
    assert made.lam > 1.01 * oracle.worst_ratio(made.to_dict(), made.P2, fine=4, periods=4)[0]


@pytest.mark.parametrize("rate", few([1e2, 1e5, 1e8], 1))
def test_stiff_plants_are_proven(rate):
    A = np.array([[-0.1, 0.3, 0.0], [-0.3, -0.1, 0.0], [0.5, 0.2, -rate]])
    plant = Plant(A, [[1.0, 0.0, 0.3]])
    made = certify(plant, PeriodicSchedule([1.0, 0.7]), eta=0.15, P2=np.eye(3))
    assert made.verify().passed
    assert 1 < made.lam < 50


def test_the_room_imports_the_standard_library_numpy_and_itself():
    modules = set()
    for path in ROOM.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                modules |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                modules.add((node.module or "").split(".")[0])
    assert modules - set(sys.stdlib_module_names) == {"numpy"}


@pytest.fixture
def copied(tmp_path):
    """The folder, alone in an empty directory."""
    shutil.copytree(ROOM, tmp_path / "alone" / "checkers", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "alone"


def bare(arguments, folder, text=""):
    """Run the bare interpreter: no path of the house, no module of it in reach."""
    return subprocess.run(
        [sys.executable, "-I", "-c", BARE, *map(str, arguments)], input=text, capture_output=True, text=True, cwd=folder
    )


BARE = """
import runpy, sys
class Nothing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] not in {"numpy", "checkers", "auditor", *sys.stdlib_module_names}:
            raise ModuleNotFoundError(name)
sys.meta_path.insert(0, Nothing())
_, how, what, *sys.argv[1:] = sys.argv
sys.path.insert(0, ".")
if how == "-m":
    runpy.run_module(what, run_name="__main__", alter_sys=True)
else:
    runpy.run_path(what, run_name="__main__")
"""


BOXED = UncertainPlant(Plant([[0.0]], [[1.0]]), [UncertainParameter("theta", -1.0, 1.0, A=[[1.0]])])
MEASURED = [(0.0, [1.0]), (0.7, [0.5]), (1.9, [-0.3])]
OF_EACH_CLAIM = {
    "detectability": lambda: [certify_detectability(OSCILLATOR)],
    "assumption-7": lambda: certificates()[:1],
    "family": lambda: [certify_family(OSCILLATOR, family, eta=0.2, P2=np.eye(2)) for family in FAMILIES[::3]],
    "interval": lambda: [state_interval(OSCILLATOR, MEASURED, w_bound=0.1, v_bound=0.2)],
    "inclusion": lambda: [certify_inclusion(BOXED, GapRange(0.1, 0.2), eta=0.5, pieces=4)],
}


@pytest.mark.parametrize("claim", few(list(claims.CLAIMS), 0, 2, 3, 4))
def test_the_copied_folder_takes_the_files_of_every_claim(claim, tmp_path, copied):
    """Alone and under another name, with numpy and the standard library and nothing else to import."""
    (copied / "checkers").rename(copied / "auditor")
    for k, certificate in enumerate(OF_EACH_CLAIM[claim]()):
        path = certificate.save(tmp_path / "certificate.json")
        as_file = (["file", "auditor/check.py"], copied, path.read_text())
        done = bare(*as_file) if k % 2 else bare(["-m", "auditor", path], copied)
        reason = checker.verdict(json.loads(path.read_text())).reason
        assert (done.returncode, done.stdout.strip(), done.stderr) == (0, reason, ""), claim


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1]", "must hold one JSON object, got list"),
        ("{}", "`format` must be 'sampling-design/certificate/1', got None"),
        ('{"format": "sampling-design/certificate/1", "claim": ["family"]}', "`claim` must be"),
        ('{"eta": 1e999}', "which is not a finite double"),
        ('{"eta": 1e-999}', "which is too small for a double"),
        ('{"eta": NaN}', "holds NaN, which is not allowed"),
        ('{"eta": ' + "9" * 5000 + "}", "a whole number beyond 2^53"),
        ("[" * 100000, "is nested more than 20 levels deep"),
        ('{"a":' * 30000, "is nested more than 20 levels deep"),
        ('{"a": 1, "a": 1}', "key 'a' occurs twice"),
        ('{"a": "\\ud800"}', "which is not Unicode"),
        ("", "is empty, expected one JSON object"),
        ('{"a": ', "Was the file cut off?"),
    ],
)
def test_a_bad_file_is_one_sentence_and_exit_code_2(text, words, monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    code, (told, complaint) = main([]), capsys.readouterr()
    assert (code, words in told, complaint) == (2, True, ""), told
    assert told.count("\n") == 1


def test_no_and_perhaps_have_exit_codes_of_their_own(tmp_path, copied):
    data = certificates()[0].to_dict()
    data["P1"] = (1.5 * np.array(data["P1"])).tolist()
    done = bare(["-m", "checkers"], copied, json.dumps(redigested(data)))
    assert (done.returncode, "fails by" in done.stdout) == (1, True)
    done = bare(["-m", "checkers"], copied, json.dumps({**data, "eta": 0.1}))
    assert (done.returncode, "something was altered" in done.stdout) == (2, True)
    tight = json.dumps(tight_one().to_dict())
    done = bare(["-m", "checkers"], copied, tight)
    assert (done.returncode, "could not be decided" in done.stdout) == (3, True)
    done = bare(["-m", "checkers", tmp_path / "none.json"], copied)
    assert (done.returncode, "cannot be read (No such file or directory)" in done.stdout) == (2, True)
    done = bare(["-m", "checkers", tmp_path], copied)
    assert (done.returncode, "cannot be read" in done.stdout) == (2, True)
    done = bare(["-m", "checkers", "--help"], copied)
    assert (done.returncode, "Exit code 0: proven" in done.stdout) == (0, True)


def test_an_interrupt_is_130(copied):
    with subprocess.Popen([sys.executable, "-m", "checkers"], cwd=copied, stdin=subprocess.PIPE) as process:
        process.stdin.write(bytes(2**20))  # more than a pipe holds: by now it is read, and soon there is no more of it
        process.stdin.flush()
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 130


def test_what_no_halving_decides_is_undecided(monkeypatch):
    monkeypatch.setattr(sampled, "ROUNDS", 0)
    with pytest.raises(outcome.Undecided, match="could not be decided: it is tight or nearly so"):
        sampled.prove(claims.certificate(certificates()[0].to_dict()))
