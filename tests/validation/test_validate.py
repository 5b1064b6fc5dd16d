"""The report: what it holds, what it refuses, and that a false promise is found out."""

import json

import numpy as np
import pytest

from sampling_design import ArgumentError, GapRange, PeriodicSchedule, Plant, Schedule, certify, validate
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.estimators.gap_flows.cost_weights import CostFunction
from sampling_design.records.file_io import to_json
from sampling_design.validation import monte_carlo
from sampling_design.validation.report import ClaimCheck, ValidationReport
from sampling_design.validation.scenario import ErrorSources
from sampling_design.validation.study import CHOSEN_HERE, SCENARIOS
from tests.cases import few
from tests.validation.plants import FINITE, PLANTS, SCHEDULES, certificate

SHORT = {"runs": 4, "duration": 12.0}


def judged(name, **options):
    return validate(PLANTS[name], SCHEDULES[name], certificate(name), **{**SHORT, **options})


@pytest.mark.parametrize("name", few(PLANTS, 0))
def test_a_report_is_complete_and_says_the_same_in_every_form(name):
    report = judged(name)
    assert report.passed
    assert bool(report)
    assert {f.scenario for f in report.checks} >= {"worst pair", "random noise", "worst energy"}
    data = json.loads(to_json(report.to_dict()))
    assert data["passed"] is True
    assert [f["claim"] for f in data["checks"]] == [f.claim for f in report.checks]
    assert data["settings"]["seed"] == "0"
    assert set(data["settings"]["versions"]) == {"sampling-design", "numpy", "python"}
    text = report.to_markdown()
    assert text.count("| held |") == len(report.checks)
    assert all(f"- {key}:" in text for key in report.settings)
    assert "promises held" in report.explain()
    assert "least margin" in str(report)
    assert np.all(report.error_curves[0].largest <= report.bound * (1 + 1e-9))


def test_seeds_repeat_a_report_and_change_it():
    again = [judged("oscillator", scenarios=["random"], rng=np.random.default_rng(s)).to_dict() for s in (3, 3, 4)]
    assert again[0] == again[1]
    assert again[0]["checks"] != again[2]["checks"]
    assert again[2]["settings"]["seed"] == "4"


@pytest.mark.long
def test_without_steering_an_unstable_truth_would_drown_the_errors():
    report = judged("unstable", duration=150.0, scenarios=["estimator"])  # e^45 by the end
    found = {f.claim: f for f in report.checks}
    assert found["difference to the linear error map"].observed < 1e-9
    assert found["share of proven estimates"].observed == 1.0
    assert np.max(np.abs(report.example.errors)) < 20.0


def test_constraints_are_active_in_one_scenario_and_not_in_the_other():
    report = judged("oscillator", scenarios=["constraints"], duration=20.0)
    assert report.passed, report.explain()
    notes = [f.note for f in report.checks if f.claim == "a-priori bound"]
    share = float(notes[0].split(" in ")[1].split(" %")[0])
    assert share > 5.0


def test_a_finite_schedule_is_judged_to_its_last_time():
    report = validate(PLANTS["oscillator"], FINITE, certificate("oscillator", finite=True), runs=2, duration=99.0)
    assert report.passed, report.explain()
    assert report.settings["duration"] == FINITE.times[-1]
    assert ["ends within three horizons" in text for text in report.skipped] == [True]
    assert "## Not checked" in report.to_markdown()


def test_a_filtered_arrival_cost_keeps_the_full_rate():
    report = judged("two outputs", cost=CostFunction(arrival="filtered"), horizon=1.0, scenarios=["random", "worst"])
    assert report.passed, report.explain()
    sources = {f.source for f in report.checks if f.claim == "a-priori bound"}
    assert sources == {"filtered arrival cost, full rate"}


@pytest.mark.parametrize("form", ["certificate", "paper"])
def test_windows_that_begin_at_samples_keep_what_their_certificate_promises(form):
    report = judged("oscillator", cost=CostFunction(form=form, begins="sample"), scenarios=["random", "worst"])
    assert report.passed, report.explain()
    assert [f for f in report.checks if f.claim == "a-priori bound" and f.checked]


def test_the_papers_own_cost_can_be_studied():
    report = judged("oscillator", cost=CostFunction(form="paper"), scenarios=["random", "paper"])
    assert {f.source for f in report.checks if f.claim == "a-priori bound"} == {"Theorem 9"}


def test_off_the_certificates_schedule_only_ellipsoids_are_judged():
    other = PeriodicSchedule([0.8, 1.35])
    report = validate(PLANTS["oscillator"], other, certificate("oscillator"), **SHORT)
    assert {f.claim for f in report.checks if not f.passed} == {"a-priori bounds and inequality (16)"}
    assert "off the certificate's schedule" in next(f.note for f in report.checks if not f.checked)
    assert not [f for f in report.checks if f.claim in ("a-priori bound", "inequality (16)")]
    assert report.bound is None


@pytest.mark.parametrize("G", few([np.eye(2), np.zeros((2, 0)), np.zeros((2, 1))], 1), ids=["noisy", "none", "zero"])
def test_any_member_of_a_certified_family_keeps_its_promises(G):
    plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], G=G)
    made = certify(plant, GapRange(0.5, 1.5), eta=0.3, P2=np.eye(2))
    report = validate(plant, PeriodicSchedule([0.6, 1.4, 0.9]), made, **SHORT)
    assert report.passed, report.explain()
    assert report.bound is not None
    stranger = validate(plant, PeriodicSchedule([0.6, 1.7, 0.9]), made, scenarios=["random"], **SHORT)
    assert stranger.bound is None


def test_a_certificate_that_claims_too_much_is_found_out():
    made = certificate("oscillator")
    parts = {key: getattr(made, key) for key in ("P2", "Qw", "R", "Qv")}
    false = Certificate.from_matrices(made.plant, made.schedule, P1=1.5 * made.P1, **parts, eta=made.eta)
    report = validate(made.plant, made.schedule, false, scenarios=["pairs"], **SHORT)
    assert not report.passed
    assert not report
    broken = {f.scenario for f in report.checks if not f.passed}
    assert "worst pair" in broken
    assert "BROKEN" in report.to_markdown()
    assert "was broken under worst pair" in report.explain()


def test_noise_beyond_what_the_estimator_is_told_is_found_out(monkeypatch):
    """The ellipsoid is judged in earnest: with noise three times the bound some truth leaves it."""
    honest = monte_carlo.draw_inputs
    monkeypatch.setattr(monte_carlo, "draw_inputs", lambda *given: ErrorSources(*(3 * part for part in honest(*given))))
    report = judged("oscillator", scenarios=["random"], runs=60)
    broken = [f.claim for f in report.checks if not f.passed]
    assert "online ellipsoid" in broken
    assert "a-priori bound" not in broken  # that promise is about the noise that really occurred


def test_checks_know_their_margin():
    most = ClaimCheck("a", "b", 2.0, 1.5)
    assert (most.margin, most.passed) == (0.25, True)
    least = ClaimCheck("a", "b", 1.0, 0.9, "at least")
    assert (round(least.margin, 12), least.passed) == (-0.1, False)
    assert ClaimCheck("a", "b", 0.0, 0.0).passed
    with pytest.raises(ArgumentError, match="`observed` must be one number, got shape"):
        ClaimCheck("a", "b", 1.0, [np.inf, 0.0])
    assert ClaimCheck("a", "b", 1.0, 1.0 + 1e-9).passed
    assert not ClaimCheck("a", "b", 1.0, 1.0 + 1e-7).passed
    assert "was broken" in least.explain()
    assert "at least 1" in str(least)
    empty = ValidationReport(PLANTS["oscillator"], (), np.zeros(1), None, "none")
    assert "least margin  -" in str(empty)


def test_progress_goes_from_nothing_to_one():
    heard = []
    judged("oscillator", scenarios=["pairs", "random"], progress=lambda f, m: heard.append((f, m)))
    fractions = [f for f, _ in heard]
    assert fractions == sorted(fractions)
    assert heard[0] == (0.0, "pairs: begun")
    assert heard[-1] == (1.0, "done")


def test_bad_input_is_refused():
    with pytest.raises(ArgumentError, match="`scenarios` must be among pairs, random"):
        judged("oscillator", scenarios=["chaos"])
    with pytest.raises(ArgumentError, match="`runs` must be a whole number of at least 1"):
        judged("oscillator", runs=0)
    with pytest.raises(ArgumentError, match="`horizon` must be given where there is no certificate"):
        validate(PLANTS["oscillator"], SCHEDULES["oscillator"])
    with pytest.raises(ArgumentError, match="`schedule` holds no sample in"):
        judged("oscillator", duration=0.1)
    with pytest.raises(ArgumentError, match="belongs to another plant"):
        validate(PLANTS["unstable"], SCHEDULES["unstable"], certificate("oscillator"))
    for name in CHOSEN_HERE:
        with pytest.raises(ArgumentError, match="is chosen by the scenarios, it cannot be given"):
            judged("oscillator", **{name: 0.0})
    with pytest.raises(ArgumentError, match="`schedule` must be a Schedule"):
        validate(PLANTS["oscillator"], [1.0, 2.0], certificate("oscillator"), duration=3.0)
    assert isinstance(FINITE, Schedule)
    assert len(SCENARIOS) == 8


def test_a_promise_that_could_not_be_checked_did_not_hold():
    made = certificate("oscillator")
    report = validate(made.plant, PeriodicSchedule([0.6, 1.7, 0.9]), made, scenarios=["random"], **SHORT)
    assert not report.passed
    (missing,) = [f for f in report.checks if not f.checked]
    assert missing.to_dict() | {"note": ""} == {
        "claim": "a-priori bounds and inequality (16)",
        "scenario": "not checked",
        "predicted": 1.0,
        "observed": None,
        "sense": "at most",
        "source": "",
        "strength": "sampled",
        "note": "",
        "checked": False,
        "margin": None,
        "passed": False,
    }
    assert "off the certificate's schedule" in missing.explain()
    assert "NOT CHECKED" in report.to_markdown()
    assert "1 of 2 promises held. The promise 'a-priori bounds" in report.explain()
    assert "least margin" in str(report)


@pytest.mark.parametrize(
    ("workers", "words"),
    [
        (0, "`workers` must be a number of processes of at least 1"),
        (-2, "`workers` must be a number of processes of at least 1"),
        ("nosuch", "`workers` must name a joblib backend, one of .*, got 'nosuch'"),
        (2.5, r"`workers` must be a concurrent\.futures\.Executor or a Dask client or a whole number or a text"),
    ],
)
def test_workers_who_are_nobody_are_refused_before_any_work(workers, words):
    with pytest.raises(ArgumentError, match=words):
        judged("oscillator", workers=workers)


def test_an_option_that_no_estimator_has_is_named():
    with pytest.raises(ArgumentError, match="`validate` and its MovingHorizonEstimator have no argument `options`"):
        judged("oscillator", options=3)
    with pytest.raises(ArgumentError, match="have no argument `horizn`"):
        judged("oscillator", horizn=3)


def test_a_generator_is_a_generator():
    with pytest.raises(ArgumentError, match="`rng` must be a whole number of at least 0, got -1"):
        judged("oscillator", rng=-1)
