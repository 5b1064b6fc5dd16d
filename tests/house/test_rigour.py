"""No certificate of a test run escapes the proof in ball arithmetic, and one that is not proven fails its test."""

import ast
import dataclasses
import os
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from sampling_design import Certificate, PeriodicSchedule, Plant
from tests import kept_certificates, rigour
from tests.house.sources import PACKAGE, ROOT, SOURCES, nodes

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
KINDS = {"Certificate", "FamilyCertificate", "DetectabilityCertificate", "InclusionCertificate", "from_matrices"}
NO_MAKERS = {
    "certificates.exact.proof": {"_made"},
    "uncertain.inclusion.search": {"certificate"},
    "certificates.files": {"_sampled", "_of_family", "_detectable"},
    "uncertain.inclusion.inclusion_certificate": {"read_inclusion"},
}
"""Functions whose certificates are still to be proven by the maker that asked for them, or are read from a file."""


def given(factor=1.0):
    """A certificate by hand; true for a factor up to some 1.5, and wrong above it."""
    return Certificate.from_matrices(
        OSCILLATOR,
        PeriodicSchedule([1.0]),
        P1=0.05 * factor * np.eye(2),
        P2=np.eye(2),
        Qw=np.eye(2),
        R=[[2.0]],
        Qv=[[2.0]],
        eta=0.4,
    )


@pytest.fixture
def judge(tmp_path, monkeypatch):
    monkeypatch.setenv(kept_certificates.FOLDER, str(tmp_path / "main"))
    return rigour.Rigour(tmp_path, "main")


def constructors(path):
    """(function, kind) of every place in a file that makes a certificate."""
    for node in nodes(path):
        if isinstance(node, ast.FunctionDef):
            for call in ast.walk(node):
                if isinstance(call, ast.Call):
                    kind = getattr(call.func, "attr", getattr(call.func, "id", ""))
                    if kind in KINDS:
                        yield node.name, kind


@pytest.mark.long
def test_certificates_are_made_by_the_watched_functions_only():
    seen = 0
    for path in SOURCES:
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        makers = {name.split(".")[-1] for name in kept_certificates.MAKERS.get(module, ())}
        for function, kind in constructors(path):
            seen += 1
            proven_here = kind == "DetectabilityCertificate" and "proven" in makers
            allowed = function in makers | NO_MAKERS.get(module, set()) or proven_here
            assert allowed, f"{module}.{function} makes a {kind} that no test run collects"
    assert seen >= 6


def test_every_watched_function_is_wrapped_where_its_module_looks_it_up():
    from sampling_design.certificates.certification import certify
    from sampling_design.certificates.detectability import best_rate as detectability
    from sampling_design.certificates.families import certify_family as family
    from sampling_design.certificates.paper import proof_constants

    assert certify.__globals__["certify_given"].watched
    assert family.certify_family.__globals__["certified"].watched
    assert family.without_states.watched
    assert proof_constants.ProofConstants.certificate.watched
    assert detectability.proven.watched


def test_what_is_wrong_fails_and_what_is_right_is_counted_once(judge):
    assert judge.judge("none") == ""
    for _ in range(2):
        kept_certificates.keep(given())
        assert judge.judge("right") == ""
        assert [v["verdict"] for v in judge.verdicts()] == ["proven"]
        assert not list(judge.folder.iterdir())  # or each test to come would look at it
    kept_certificates.keep(given(20.0))
    assert "is refuted: (1 + margin) P1 <= Pi(t) fails by" in judge.judge("wrong")
    assert judge.judge("the one after it") == ""
    kept_certificates.keep(given(20.0))
    assert "is refuted" in judge.judge("wrong again")
    assert sorted(v["verdict"] for v in judge.verdicts()) == ["proven", "refuted"]


def test_two_runs_of_a_maker_are_one_certificate(judge, tmp_path):
    one = given()
    other = dataclasses.replace(one, solver=dataclasses.replace(one.solver, version="another"))
    assert kept_certificates.content(one.to_dict()) == kept_certificates.content(other.to_dict())
    assert one.to_dict()["digest"] != other.to_dict()["digest"]
    assert kept_certificates.content(one.to_dict()) != kept_certificates.content(given(1.0 + 1e-15).to_dict())


@pytest.mark.parametrize(
    ("factor", "mark", "complaint"),
    [
        (20.0, ("refuted", "made wrong"), ""),
        (20.0, ("undecided", "made wrong"), "is refuted, not undecided"),
        (1.0, ("refuted", "made wrong"), "no certificate of this test is refuted: take the mark away"),
        (20.0, ("refuted", ""), "mark it as unproven"),
        (20.0, ("whatever", "why"), "mark it as unproven"),
    ],
)
def test_a_test_that_states_the_verdict_must_be_right(factor, mark, complaint, judge):
    kept_certificates.keep(given(factor))
    found = judge.judge("marked", *mark)
    assert complaint in found
    assert bool(complaint) == bool(found)


@pytest.mark.parametrize(
    ("count", "testpaths", "deselected", "before", "fails"),
    [
        (rigour.LEAST - 1, True, False, 0, True),
        (rigour.LEAST, True, False, 0, False),
        (0, False, False, 0, False),
        (0, True, True, 0, False),
        (0, True, False, 2, False),
    ],
)
def test_a_whole_run_with_too_few_fails(count, testpaths, deselected, before, fails, judge, monkeypatch):
    source = pytest.Config.ArgsSource
    config = SimpleNamespace(args_source=source.TESTPATHS if testpaths else source.ARGS, ArgsSource=source)
    session = SimpleNamespace(config=config, exitstatus=before)
    if deselected:
        judge.pytest_deselected()
    monkeypatch.setattr(judge, "verdicts", lambda: [{}] * count)
    judge.pytest_sessionfinish(session)
    assert session.exitstatus == (1 if fails else before)
    assert judge.lost == fails


def test_files_stay_only_where_something_is_not_proven(tmp_path, monkeypatch):
    for name, factor in (("right", 1.0), ("wrong", 20.0)):
        monkeypatch.setenv(kept_certificates.FOLDER, str(tmp_path / name / "main"))
        plugin = rigour.Rigour(tmp_path / name, "main")
        kept_certificates.keep(given(factor))
        plugin.judge(name)
        plugin.pytest_unconfigure()
    assert not (tmp_path / "right").exists()
    assert len(list((tmp_path / "wrong").glob("not-*.json"))) == 1


def test_a_folder_with_too_few_or_wrong_ones_is_refused(judge, tmp_path):
    with pytest.raises(AssertionError, match="0 certificates were made, 1 at least were expected"):
        kept_certificates.check_proven(judge.folder, 1)
    kept_certificates.keep(given())
    assert len(kept_certificates.check_proven(judge.folder, 1)) == 1
    kept_certificates.keep(given(20.0))
    with pytest.raises(AssertionError, match="refuted"):
        kept_certificates.check_proven(judge.folder, 1)


LIE = """
import dataclasses
import sampling_design as sd
from sampling_design.certificates.certification import certify
from sampling_design.certificates.exact import proof
from sampling_design.certificates.form.verdict import Verification

def test_honest():
    assert certify(sd.Plant([[0.1]], [[1.0]]), sd.PeriodicSchedule([1.0]), eta=0.4, P2=[[1.0]])

def test_lying(monkeypatch):
    made, believed = proof._made, Verification(True, "", None, None, 1.0, "", verdict="proven")
    monkeypatch.setattr(proof, "_made", lambda *a: dataclasses.replace(made(*a), P1=[[1.0]]))
    monkeypatch.setattr(proof, "verdict_on_schedule", lambda content, work: believed)
    assert certify(sd.Plant([[0.2]], [[1.0]]), sd.PeriodicSchedule([1.0]), eta=0.4, P2=[[1.0]])
"""


@pytest.mark.parametrize(
    "workers", [pytest.param(each, marks=pytest.mark.long) for each in ((), ("-n", "1"))], ids=["alone", "on a worker"]
)
def test_a_run_whose_maker_lies_fails(workers, tmp_path):
    (tmp_path / "test_lie.py").write_text(LIE)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "tests.conftest",
        "--rootdir",
        str(tmp_path),
        "-c",
        "/dev/null",
    ]
    command += [*workers, str(tmp_path / "test_lie.py")]
    here = os.environ | {"TMPDIR": str(tmp_path)}
    done = subprocess.run(command, cwd=ROOT, env=here, capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "2 passed, 1 error" in done.stdout
    assert "ERROR" in done.stdout
    assert "test_lying" in done.stdout.split("short test summary info")[1]
    assert "2 distinct" in done.stdout
    assert "(1 + margin) P1 <= Pi(t) fails by" in done.stdout
