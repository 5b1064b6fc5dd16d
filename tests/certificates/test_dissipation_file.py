"""The file of a detectability certificate: written, read, refused, and judged by its independent checker."""

import copy
import dataclasses
import json
from functools import cache
from itertools import product

import numpy as np
import pytest

from sampling_design import ArgumentError, PeriodicSchedule, Plant, certify, named_plant, read_certificate, robustness
from sampling_design.certificates.detectability.best_rate import certify_detectability, detectability_from_proof
from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate
from sampling_design.checkers import check, claims, detectability, parts
from sampling_design.checkers.detectability import INEQUALITY
from sampling_design.checkers.outcome import Refused
from sampling_design.errors import CertificateError, FileFormatError
from tests.cases import few
from tests.oracles import dissipation as oracle

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]], time_unit="h", name="Doppelintegrator µ")
TILTED = Plant([[-0.5, -1.1], [1.5, 0.6]], [[0.5, -0.4], [1.0, 0.2]], G=[[1.0], [0.4]])
QUIET = Plant([[-0.1, 1.0], [-1.0, -0.1]], [[1.0, 0.0]], G=np.zeros((2, 0)))
SCALAR = Plant([[1.0]], [[1.0]])


@cache
def certificates():
    return (
        certify_detectability(OSCILLATOR),
        certify_detectability(TILTED, eta=0.7),
        detectability_from_proof(DOUBLE),
        DetectabilityCertificate(SCALAR, [[1.0]], eta=1.0, c_w=1.0, c_y=4.01, margin=1e-3),
        certify_detectability(QUIET),
        certify_detectability(named_plant("satellite")),
    )


EACH = pytest.mark.parametrize("k", range(6))


def redigested(data):
    data["digest"] = parts.digest(data)
    return data


def stated(k):
    return json.loads(json.dumps(certificates()[k].to_dict()))


@EACH
def test_the_file_returns_the_record_bit_for_bit(k, tmp_path):
    made = certificates()[k]
    path = made.save(tmp_path / "certificate.json")
    back = read_certificate(path, plant=made.plant)
    assert type(back) is DetectabilityCertificate
    assert back.to_dict() == made.to_dict()
    np.testing.assert_array_equal(back.P, made.P)
    assert (back.eta, back.c_w, back.c_y, back.margin, back.method) == (
        made.eta,
        made.c_w,
        made.c_y,
        made.margin,
        made.method,
    )
    assert back.solver == made.solver
    assert back.save(tmp_path / "again.json").read_bytes() == path.read_bytes()
    assert back.verify().passed
    assert back.verify().to_dict() == made.verify().to_dict()


def test_the_file_is_laid_out_as_the_formats_say():
    data = stated(0)
    keys = ["format", "plant", "claim", "P", "eta", "c_w", "c_y", "margin", "method", "tool", "solver", "digest"]
    assert list(data) == keys
    assert (data["format"], data["claim"]) == ("sampling-design/certificate/1", "detectability")
    assert data["plant"]["time_unit"] == "s"


@pytest.mark.parametrize("old", ['"eta": ', '"s"', '"riccati"', '"version": ', '"c_y": '])
def test_any_altered_byte_is_refused(old, tmp_path):
    path = certificates()[0].save(tmp_path / "certificate.json")
    text = path.read_text()
    new = {'"s"': '"h"', '"riccati"': '"proof"', '"version": ': '"version": "1", "name": '}.get(old, old + "1")
    assert text.count(old) >= 1
    path.write_text(text.replace(old, new, 1))
    with pytest.raises((CertificateError, FileFormatError), match=r"the digest does not fit the content|occurs twice"):
        read_certificate(path)
    if old != '"version": ':
        assert check(json.loads(path.read_text()))["inequality"] == "digest"


@pytest.mark.parametrize("part", [0.02, 0.3, 0.7, 0.99])
def test_a_file_that_was_cut_off_is_refused(part, tmp_path):
    path = certificates()[0].save(tmp_path / "certificate.json")
    text = path.read_text()
    path.write_text(text[: int(part * len(text))])
    with pytest.raises(FileFormatError, match="Was the file cut off"):
        read_certificate(path)


@EACH
def test_a_file_about_another_plant_is_refused(k, tmp_path):
    path = certificates()[k].save(tmp_path / "certificate.json")
    other = certificates()[(k + 1) % 6].plant
    with pytest.raises(CertificateError, match="certifies another plant"):
        read_certificate(path, plant=other)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda d: d.update(claim="observability"),
            "`claim` must be 'assumption-7', 'family', 'detectability', 'inclusion', 'interval' here",
        ),
        (
            lambda d: d.update(claim=["detectability"]),
            "`claim` must be 'assumption-7', 'family', 'detectability', 'inclusion', 'interval' here",
        ),
        (lambda d: d.update(claim="family"), "unknown key 'P' in the certificate"),
        (lambda d: d.update(format="sampling-design/plant/1"), "Is this a certificate file"),
        (lambda d: d.pop("c_w"), "`c_w` is missing in the certificate"),
        (lambda d: d.update(P1=[[1.0]]), "unknown key 'P1' in the certificate"),
        (lambda d: d.update(times={"kind": "periodic"}), "unknown key 'times' in the certificate"),
        (lambda d: d.update(method="guess"), "`method` must be one of riccati, proof, given, got 'guess'"),
        (lambda d: d.update(eta=0.0), "`eta` must be positive"),
        (lambda d: d.update(c_w=-1.0), "`c_w` must be positive"),
        (lambda d: d.update(c_y="1.0"), "`c_y` must be a number"),
        (lambda d: d.update(margin=-1e-9), "`margin` must not be negative"),
        (lambda d: d.update(P=[[1.0, 0.5], [0.0, 1.0]]), "`P` must be symmetric"),
        (lambda d: d.update(P=[[1.0]]), "`P` must have shape"),
        (lambda d: d.update(P=[]), "`P` must have shape"),
        (lambda d: d.update(solver=3), "`solver` must be a table"),
    ],
)
def test_content_that_is_no_certificate_is_refused(change, words, tmp_path):
    data = stated(0)
    change(data)
    path = tmp_path / "certificate.json"
    path.write_text(json.dumps(redigested(data)))
    with pytest.raises(FileFormatError, match=words):
        read_certificate(path)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"eta": ', '"eta": NaN, "was": ', "holds NaN, which is not allowed"),
        ('"c_w": ', '"c_w": Infinity, "was": ', "holds Infinity, which is not allowed"),
        ('"c_w": ', '"c_w": 1.0, "c_w": ', "key 'c_w' occurs twice"),
    ],
)
def test_what_json_should_not_hold_is_refused(old, new, words, tmp_path):
    path = certificates()[0].save(tmp_path / "certificate.json")
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FileFormatError, match=words):
        read_certificate(path)


def mutated(data, rng):
    """One number altered; returns which."""
    field = str(rng.choice(["P", "p", "eta", "c_w", "c_y", "margin", "A", "C", "G"]))
    factor = float(rng.choice([0.3, 0.9, 0.99, 0.9999, 1.00001, 1.0001, 1.01, 1.3, 3.0, -1.0]))
    matrices = data["plant"]["matrices"]
    if field == "P":
        data["P"] = (factor * np.array(data["P"])).tolist()
    elif field == "p":
        i, j = rng.integers(len(data["P"]), size=2)
        data["P"][i][j] *= factor
        data["P"][j][i] = data["P"][i][j]
    elif field in ("A", "C", "G"):
        X = np.array(matrices.get(field, np.eye(len(matrices["A"]))))
        if X.size:
            X.flat[rng.integers(X.size)] *= factor
        matrices[field] = X.tolist()
    else:
        data[field] = abs(factor) * data[field] * (30 if field == "margin" and factor > 1 else 1)
    return field


@pytest.mark.parametrize("count", few([80, 200], 0))
def test_checker_agrees_with_eigenvalues_at_50_digits_on_mutations(count):
    rng = np.random.default_rng(4)
    counts, touched = {True: 0, False: 0}, set()
    while sum(counts.values()) < count:
        data = stated(rng.integers(6))
        field = mutated(data, rng)
        expected = oracle.holds(data)
        if expected is None:
            continue
        found = check(redigested(data))
        assert found["passed"] is expected, (field, found)
        assert (found["amount"] > 0) is expected, (field, found)
        counts[expected] += 1
        touched.add(field)
    assert min(counts.values()) >= count // 4
    assert len(touched) == 9


@EACH
def test_numbers_that_are_right_keep_every_trajectory_below_the_bound(k):
    data, rng = stated(k), np.random.default_rng(k)
    A, _, G, P, *_ = oracle.parts(data)
    for _ in range(6):
        x0 = np.linalg.solve(np.linalg.cholesky(P).T, rng.standard_normal(len(A)))
        gain = rng.standard_normal((G.shape[1], len(A))) * rng.choice([0.0, 0.1, 1.0])
        for w in (gain, gain @ x0):
            assert oracle.excess(data, x0, w, rng.uniform(0.01, 1.0) / np.linalg.norm(A, 2)) <= 1e-12


@EACH
def test_one_percent_too_much_is_refused_along_a_direction_in_which_a_trajectory_breaks_the_bound(k):
    data = stated(k)
    data["eta"] *= 1.01 if k not in (2, 4) else 3.0  # constants of a proof, or without w, have room
    found = check(redigested(data))
    assert (found["passed"], found["inequality"]) == (False, INEQUALITY)
    assert found["reason"].startswith(f"{INEQUALITY} fails by")
    A, C, G, P, eta, c_w, c_y, margin = oracle.parts(data)
    v = np.array(found["direction"])
    x, w = v[: len(A)], v[len(A) :]
    assert np.linalg.norm(v) == pytest.approx(1.0)
    growth = 2 * x @ P @ (A @ x + G @ w) + (1 + margin) * eta * x @ P @ x - c_w * w @ w - c_y * np.sum((C @ x) ** 2)
    sizes = 2 * np.abs(A.T) @ np.abs(P) + (1 + margin) * eta * np.abs(P)
    size = x**2 @ (np.diag(sizes) + c_y * np.sum(C**2, axis=0)) + c_w * w @ w
    assert found["amount"] == pytest.approx(-growth / size, rel=1e-6)
    gain = np.outer(w, P @ x) / (x @ P @ x)
    assert oracle.excess(data, x, gain, 1e-3 / np.linalg.norm(A, 2)) > 0


@pytest.mark.parametrize(("key", "k"), few(product(["eta", "c_w", "c_y"], [0, 1, 3, 5]), 0, 5, 10))
def test_just_feasible_passes_and_just_infeasible_does_not(k, key):
    """The threshold of one number, by bisection at 50 digits: 1e-11 to either side decides."""
    data, worse = stated(k), 1 if key == "eta" else -1
    good, bad = 0.0, 0.7
    while bad - good > 1e-13:
        middle = (good + bad) / 2
        tried = {**data, key: data[key] * (1 + worse * middle)}
        good, bad = (middle, bad) if min(oracle.least_eigenvalues(tried, 30)) > 0 else (good, middle)
    for off, expected in ((-1e-9, True), (1e-9, False)):
        tried = redigested({**data, key: data[key] * (1 + worse * (good + off))})
        assert oracle.holds(tried) is expected
        assert check(tried)["passed"] is expected
        assert rigorously(tried).verdict == ("proven" if expected else "refuted")


def rigorously(data):
    from sampling_design.certificates.rigorous.decide import verify_rigorously

    return verify_rigorously(data)


@pytest.mark.parametrize(
    ("c_y", "passed"), [(np.nextafter(4.0, 5.0), True), (4.0, False), (np.nextafter(4.0, 3.0), False)]
)
def test_the_last_bit_decides(c_y, passed):
    """x' = x + w, y = x, V = x^2: with eta = c_w = 1 the inequality holds for c_y > 4, tight along x = w at 4."""
    made = DetectabilityCertificate(SCALAR, [[1.0]], eta=1.0, c_w=1.0, c_y=c_y)
    verdict = made.verify()
    assert verdict.passed is passed
    assert "rational numbers" in verdict.reason
    assert verdict.direction is None if passed else np.abs(verdict.direction) == pytest.approx([np.sqrt(0.5)] * 2)
    rigorous = {4.0: "undecided"}.get(c_y, "proven" if passed else "refuted")
    assert made.verify(rigorous=True).verdict == rigorous


@pytest.mark.parametrize("digits", [3, 10, 30, 50])
@pytest.mark.parametrize(("c_w", "passed"), [(1.01, True), (0.99, False)])
def test_rational_numbers_decide_what_floats_can_not(digits, c_w, passed):
    """One direction is seen 4^digits times as well as another is bound, for which c_w must exceed 1."""
    huge = 2.0**digits
    plant = Plant(-np.eye(2), [[huge, huge]], G=[[1.0], [-1.0]])
    made = DetectabilityCertificate(plant, np.eye(2) / 2, eta=1.0, c_w=c_w, c_y=1.0)
    assert oracle.holds(made.to_dict(), 90) is passed
    verdict = made.verify()
    assert verdict.passed is passed
    assert ("rational numbers" in verdict.reason) is (digits >= 30)
    rigorous = made.verify(rigorous=True)
    assert rigorous.verdict == ("proven" if passed else "refuted")
    if not passed:
        for found in (verdict, rigorous):
            assert np.abs(found.direction[:2]) == pytest.approx([np.abs(found.direction[0])] * 2, rel=1e-3)


def test_sizes_beyond_floats_are_decided_in_rational_numbers():
    for scale in (1e-200, 1e200):
        made = DetectabilityCertificate(SCALAR, [[scale]], eta=1.0, c_w=scale, c_y=4.01 * scale)
        verdict = made.verify()
        assert verdict.passed
        assert "proven in rational numbers" in verdict.reason
        worse = dataclasses.replace(made, c_y=3.9 * scale).verify()
        assert not worse.passed
        assert worse.amount == pytest.approx(-0.1 / 3.9 / 4 * 1.5, rel=0.9)
        assert len(worse.direction) == 2


def test_an_indefinite_P_is_refused_with_its_direction():
    data = stated(0)
    data["P"] = [[1.0, 2.0], [2.0, 1.0]]
    found = check(redigested(data))
    assert found["inequality"] == "P > 0"
    assert found["amount"] == pytest.approx(-1.0)
    assert np.abs(found["direction"]) == pytest.approx([np.sqrt(0.5)] * 2)
    data["P"] = [[1.0, 0.0], [0.0, 0.0]]
    found = check(redigested(data))
    assert (found["inequality"], found["amount"], found["direction"]) == ("P > 0", 0.0, [0.0, 1.0])


@pytest.mark.parametrize(
    ("change", "inequality"),
    [
        (lambda d: d.update(claim="assumption-7"), "form"),
        (lambda d: d.update(eta=0.0), "form"),
        (lambda d: d.update(c_w=-1.0), "form"),
        (lambda d: d.update(c_y=0), "form"),
        (lambda d: d.update(margin=-1e-9), "form"),
        (lambda d: d.update(P=[[1.0, 0.5], [0.0, 1.0]]), "form"),
        (lambda d: d.update(P=[[1.0]]), "form"),
        (lambda d: d.update(eta="much"), "form"),
        (lambda d: d.pop("margin"), "form"),
        (lambda d: d["plant"].pop("matrices"), "form"),
        (lambda d: d["plant"]["matrices"].update(G=[[1.0]]), "form"),
        (lambda d: d.update(c_w=10**400), "form"),
    ],
)
def test_malformed_data_are_refused_with_the_right_word(change, inequality):
    data = stated(0)
    change(data)
    found = check(redigested(data))
    assert (found["passed"], found["inequality"]) == (False, inequality)
    assert found["reason"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(P=[[1.0, 2.0], [2.0, 1.0]]), r"P > 0 fails by 1, an eigenvalue .* \(rounding below"),
        (lambda d: d.update(c_y=1e-80), r"fails by .* \(in rational numbers\), along \["),
    ],
)
def test_each_proof_stops_at_the_first_thing_that_is_wrong(change, words):
    data = stated(0)
    change(data)
    with pytest.raises(Refused, match=words):
        detectability.prove(claims.certificate(redigested(data)))


def test_digest_and_claim_come_first():
    data = stated(0)
    assert "something was altered" in check({**data, "eta": 0.1})["reason"]
    assert "`claim` must be" in check(redigested({**data, "claim": "guess"}))["reason"]
    assert check({**data, "eta": np.nan})["inequality"] == "form"
    assert check([])["inequality"] == "form"


def test_no_states_leave_nothing_to_prove(tmp_path):
    plant = Plant(np.zeros((0, 0)), np.zeros((1, 0)))
    made = DetectabilityCertificate(plant, np.zeros((0, 0)), eta=1.0, c_w=1.0, c_y=1.0)
    back = read_certificate(made.save(tmp_path / "certificate.json"))
    assert back.verify().passed
    assert back.verify(rigorous=True).verdict == "proven"


def test_the_verdict_shows_what_was_found():
    wrong = dataclasses.replace(certificates()[0], eta=2 * certificates()[0].eta).verify()
    assert [label for label, _ in wrong._rows()] == ["passed", "inequality", "direction", "slack", "reason"]
    assert wrong.explain().startswith("Refuted: [[A'P + PA")
    assert json.loads(json.dumps(wrong.to_dict()))["direction"] == wrong.direction


def test_what_is_stated_is_the_margin_that_was_solved_for():
    made = certify_detectability(OSCILLATOR, margin=4e-3)
    assert made.margin == 1e-3
    assert dataclasses.replace(made, margin=5e-3).verify().passed is False
    assert ("margin", "0.001") in made._rows()


def test_who_needs_samples_is_told_that_there_are_none():
    made = certificates()[0]
    with pytest.raises(AttributeError, match="promises nothing about samples and has no `lam`"):
        made.lam  # noqa: B018
    with pytest.raises(AttributeError, match="promises nothing about samples and has no `schedule`"):
        made.schedule  # noqa: B018
    with pytest.raises(ArgumentError, match="or a ScheduleDesign, got DetectabilityCertificate"):
        robustness(OSCILLATOR, made)
    assert copy.deepcopy(made).to_dict() == made.to_dict()


def test_wrong_arguments_are_refused():
    with pytest.raises(ArgumentError, match="`plant` must be a Plant, got str"):
        DetectabilityCertificate("oscillator", [[1.0]], 1.0, 1.0, 1.0)
    with pytest.raises(ArgumentError, match="`method` must be one of riccati, proof, given, got 'sdp'"):
        DetectabilityCertificate(SCALAR, [[1.0]], 1.0, 1.0, 1.0, method="sdp")
    with pytest.raises(ArgumentError, match="`margin` must not be negative"):
        DetectabilityCertificate(SCALAR, [[1.0]], 1.0, 1.0, 1.0, margin=-0.1)


def test_a_certificate_about_samples_is_not_taken_for_one(tmp_path):
    path = certify(OSCILLATOR, PeriodicSchedule([1.0]), eta=0.4).save(tmp_path / "certificate.json")
    assert not isinstance(read_certificate(path), DetectabilityCertificate)
    assert check(json.loads(path.read_text()))["passed"]
