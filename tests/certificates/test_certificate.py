"""The record, its file, the choice of weights, existence and repair."""

import collections
import dataclasses
import json

import numpy as np
import pytest

from sampling_design import (
    Certificate,
    GapRange,
    PeriodicSchedule,
    Plant,
    Schedule,
    certificate_exists,
    certify,
    read_certificate,
)
from sampling_design.certificates.compare.tradeoff import tradeoff_curve
from sampling_design.certificates.exact import certificate as record
from sampling_design.certificates.exact import proof
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.exact.weight_choice import ETA_RANGE, SCAN, WeightSearch
from sampling_design.certificates.exact.window_gains import ACTIVE, WindowSet, WindowTimes, _log_largest_eigenvalues
from sampling_design.certificates.exact.window_problem import window_problem
from sampling_design.certificates.existence.periodic import smallest_repair
from sampling_design.certificates.form.verdict import verdict_of
from sampling_design.checkers import parts
from sampling_design.checkers.outcome import WorkLimit
from sampling_design.errors import ArgumentError, CertificateError, FileFormatError, UndecidedError
from sampling_design.plants.plant import Signals
from tests import kept_certificates
from tests.cases import few
from tests.oracles import riccati as oracle

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], name="oscillator")
DOUBLE = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
FOUR = Plant(
    [[-1.0, 0.0, 0.0, 0.0], [0.0, 0.1, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -1.0, 0.0]], [[1.0, 1.0, 1.0, 0.0]]
)
ONES = {**{key: [[1.0]] for key in ("P1", "P2", "Qw", "R", "Qv")}, **dict.fromkeys(("eta", "lam", "lam_samples"), 1.0)}
EVERY = PeriodicSchedule([1.0])


def given(plant=OSCILLATOR, schedule=EVERY, **changes):
    return certify(plant, schedule, **{"eta": 0.4, "P2": np.eye(plant.n_states), **changes})


def test_best_p1_is_p2_over_lambda_less_the_resolution():
    made = given()
    assert np.allclose(made.P1, (1 - 1e-3) * made.P2 / made.lam, rtol=1e-15)
    assert made.verify().passed
    assert made.lam_proven == pytest.approx(made.lam / (1 - 1e-3))
    assert made.Rtilde == pytest.approx(np.eye(1))


@pytest.mark.parametrize(
    ("plant", "improved", "paper"),
    few([(DOUBLE, 1.4, 6.2), (OSCILLATOR, 1.5, 6.5), (FOUR, 2.1, 7.7)], 1),
    ids=["2", "o", "4"],
)
def test_horizons_in_the_noise_free_limit(plant, improved, paper):
    """Reference values of the exact certificate at eta = .4 and period 1, best shape, P2 -> 0."""
    made = certify(plant, EVERY, eta=0.4, noise_gain=1e5)
    assert made.horizon("improved").minimum <= improved
    assert made.horizon("paper").minimum <= paper
    assert made.lam < given(plant, P2=1e-8 * np.eye(plant.n_states)).lam


def test_lambda_of_a_unit_prior():
    """The four-state reference plant with P2 = I and R = Qv = 1 at eta = .4."""
    assert given(FOUR, R=np.eye(1)).lam == pytest.approx(20.9, abs=0.05)


@pytest.mark.parametrize(("plant", "limit"), [(DOUBLE, 3.91), (OSCILLATOR, 2.23), (FOUR, 4.32)], ids=["2", "o", "4"])
def test_round_prior_tends_to_the_reference_limit(plant, limit):
    assert given(plant, P2=1e-9 * np.eye(plant.n_states)).lam == pytest.approx(limit, abs=0.01)


@pytest.mark.long
def test_chosen_weights_keep_the_noise_gain():
    for plant in (DOUBLE, FOUR):
        made = certify(plant, EVERY, eta=0.4, noise_gain=3.0)
        problem = window_problem(plant, EVERY, np.eye(plant.n_states), *weights_of(plant, None, None, None), 0.4)
        least = WindowSet.of(problem).least_floor(np.ones(plant.n_states))
        assert made.horizon().C_w <= 3.0 * least * 1.01
        assert made.verify().passed
        round_prior = given(plant, P2=1.0 / least * np.eye(plant.n_states))
        assert made.horizon().minimum < round_prior.horizon().minimum


@pytest.mark.long
def test_chosen_rate_is_no_worse_than_rates_around_it():
    made = certify(DOUBLE, EVERY, noise_gain=3.0)
    assert 0.05 <= made.eta <= 3.0
    for eta in (0.2, 0.6, 1.5):
        assert made.horizon().minimum <= certify(DOUBLE, EVERY, eta=eta, noise_gain=3.0).horizon().minimum * 1.001


def test_rate_alone_is_chosen_for_a_given_prior():
    made = certify(DOUBLE, EVERY, P2=0.01 * np.eye(2))
    for eta in (0.5 * made.eta, min(2 * made.eta, 3.0)):
        assert made.horizon().minimum <= given(DOUBLE, P2=0.01 * np.eye(2), eta=eta).horizon().minimum * 1.01


@pytest.mark.long
def test_scales_of_the_states_leave_the_horizon_alone():
    s = np.array([1e3, 1e-2])
    scaled = Plant(OSCILLATOR.A * s[:, None] / s, OSCILLATOR.C / s, G=np.diag(s), states=Signals(("a", "b"), scales=s))
    one, other = (certify(plant, EVERY, eta=0.4) for plant in (OSCILLATOR, scaled))
    assert other.lam == pytest.approx(one.lam, rel=1e-3)
    assert np.allclose(other.P2 * np.outer(s, s), one.P2, rtol=1e-2)


def windows_of(plant, gaps):
    n = plant.n_states
    problem = window_problem(plant, PeriodicSchedule(gaps), np.eye(n), np.eye(n), [[2.0]], [[2.0]], 0.4)
    return WindowSet.of(problem)


def test_gradients_are_those_of_differences():
    maps = windows_of(DOUBLE, [0.7, 1.1]).looked(np.diag([0.6, 0.3])).near(5.0)
    step, h = np.array([[0.3, 0.0], [-0.2, 0.4]]), 1e-6
    for T in np.array([[[0.8, 0.0], [0.3, 0.5]], [[2.0, 0.0], [-1.0, 0.7]], [[0.3, 0.0], [0.1, 1.5]]]):
        logs, slopes = maps.log_lambda(T)
        numerical = (maps.log_lambda(T + h * step)[0] - maps.log_lambda(T - h * step)[0]) / (2 * h)
        counts = logs > logs.max() - ACTIVE / 2
        slope = np.einsum("kij,ij->k", slopes, step @ T.T + T @ step.T)
        assert np.allclose(slope[counts], numerical[counts], rtol=1e-5)


@pytest.mark.parametrize("plant", [DOUBLE, OSCILLATOR, FOUR], ids=["2", "o", "4"])
def test_windows_as_a_function_of_the_weight_are_the_windows_followed_anew(plant):
    """About one P2, ln lambda of others: their own recursion says the same, near and far, and of multiples."""
    rng, n = np.random.default_rng(7), plant.n_states
    windows = windows_of(plant, [0.7, 1.1, 0.4])
    L = np.linalg.cholesky(np.cov(rng.standard_normal((n, 3 * n))) + np.eye(n))
    look = windows.looked(L @ L.T)
    time, window = (every.ravel() for every in np.indices(look.logs.shape))
    maps = windows.maps(L, WindowTimes(window, time, np.arange(len(windows.cycle))))
    for far in (0.01, 0.3, 2.0):
        T = np.tril(rng.standard_normal((n, n))) * far + (1 + far) * np.eye(n)
        assert maps.value(T) == pytest.approx(windows.looked(L @ T @ T.T @ L.T).value, rel=1e-9)
    for scale in (-look.reach, 0.3 * look.reach, look.reach):
        assert look.along(scale) == pytest.approx(windows.looked(np.exp(scale) * L @ L.T).value, rel=1e-9)


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_what_bounds_spare_is_no_largest_eigenvalue_that_counts(size):
    """The same to the last bit as all eigenvalues; nearly equal ones, which no bound tells apart, are all kept."""
    rng = np.random.default_rng(3)
    roots = rng.standard_normal((60, 5, 7, 7)) * np.exp(rng.uniform(-1, 0, (60, 5, 1, 1)))
    ratios = size * roots @ np.swapaxes(roots, -1, -2)
    ratios[:, 4] = size * np.eye(7) * np.exp(rng.uniform(-2 * ACTIVE, 0.0, (60, 1, 1)))
    valid = rng.uniform(size=(60, 5)) < 0.9
    logs = np.log(np.linalg.eigvalsh(ratios)[..., -1])
    counts = valid & (logs > np.where(valid, logs, -np.inf).max(axis=0) - ACTIVE)
    found = np.full(valid.shape, -np.inf)
    window = np.nonzero(valid)[1]
    found[valid] = _log_largest_eigenvalues(ratios[valid], window)
    assert np.array_equal(found[counts], logs[counts])
    spared = ~np.isfinite(found[:, :4]) & valid[:, :4]
    assert spared.sum() > 0.8 * valid[:, :4].sum()
    first = valid[:, 0]
    assert np.array_equal(_log_largest_eigenvalues(ratios[first, 0]), found[first, 0])


def test_tradeoff_curve_falls_in_horizon_and_rises_in_gain():
    curve = tradeoff_curve(DOUBLE, EVERY, 0.4, [1.5, 3.0, 30.0])
    assert np.all(np.diff(curve.horizons) < 0)
    assert np.all(np.diff(curve.C_w) > 0)
    assert all(made.verify() for made in curve.certificates)
    assert "and C_w rises from 15.5 to 309" in curve.explain()
    assert curve.to_frame()["horizons"].tolist() == curve.horizons.tolist()
    drawn = curve.plot().lines[0]
    assert (drawn.get_xdata().tolist(), drawn.get_ydata().tolist()) == (curve.C_v.tolist(), curve.horizons.tolist())
    with pytest.raises(ArgumentError, match="`noise_gains` must increase strictly"):
        tradeoff_curve(DOUBLE, EVERY, 0.4, [3.0, 2.0])


def test_file_round_trip_is_exact(tmp_path):
    made = given(schedule=PeriodicSchedule([0.7, 1.1], 0.2, [[1], [1]]))
    path = made.save(tmp_path / "c.json")
    again = read_certificate(path, plant=OSCILLATOR)
    assert again.to_dict() == made.to_dict()
    assert again.save(tmp_path / "d.json").read_text() == path.read_text()
    assert again.verify().passed
    with pytest.raises(CertificateError, match="certifies another plant"):
        read_certificate(path, plant=DOUBLE)


def test_altered_and_truncated_files_are_refused(tmp_path):
    path = given().save(tmp_path / "c.json")
    text = path.read_text()
    path.write_text(text.replace('"eta": 0.4', '"eta": 0.3'))
    with pytest.raises(FileFormatError, match="the digest does not fit the content"):
        read_certificate(path)
    path.write_text('{"format": "sampling-design/plant/1"}')
    with pytest.raises(FileFormatError, match="is no certificate: `format` must be"):
        read_certificate(path)
    path.write_text(text[: len(text) // 2])
    with pytest.raises(FileFormatError, match="Was the file cut off"):
        read_certificate(path)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d.update(format="x"), "Is this a certificate file"),
        (lambda d: d.update(claim="wishful"), "`claim` must be 'assumption-7'"),
        (lambda d: d.update(extra=1), "unknown key 'extra' in the certificate"),
        (lambda d: d.pop("P1"), "`P1` is missing in the certificate"),
        (lambda d: d["times"].update(kind="gap-range"), "`times.kind` of a schedule must be one of"),
        (lambda d: d.update(solver=3), "`solver` must be a table"),
    ],
)
def test_files_that_are_no_certificate_are_refused(tmp_path, change, words):
    data = json.loads(json.dumps(given().to_dict()))
    change(data)
    data["digest"] = parts.digest(data)
    path = tmp_path / "c.json"
    path.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match=words):
        read_certificate(path)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"P2": [[1.0, 2.0], [2.0, 1.0]]}, "`P2` must be positive definite"),
        ({"P2": [[1.0, 0.5], [0.0, 1.0]]}, "`P2` must be symmetric"),
        ({"eta": 0.0}, "`eta` must be positive"),
        ({"R": [[-1.0]]}, "`R` must be positive definite"),
        ({"Qv": [[0.0]]}, "`Qv` must be positive definite"),
        ({"Qw": np.diag([1.0, 0.0])}, "A direction without weight is a free disturbance"),
        ({"noise_gain": 1.0}, "`noise_gain` must be above 1"),
    ],
)
def test_bad_weights_are_refused(changes, words):
    with pytest.raises(ArgumentError, match=words):
        given(**changes)


def test_bad_plants_and_schedules_are_refused():
    with pytest.raises(ArgumentError, match="`times` must increase strictly"):
        given(schedule=Schedule([1.0, 1.0]))
    with pytest.raises(ArgumentError, match="`schedule` is None, as in a design with nothing to observe"):
        certify(OSCILLATOR, None)
    with pytest.raises(ArgumentError, match="`schedule` must hold a sample later than time 0"):
        given(schedule=Schedule([0.0]))
    with pytest.raises(ArgumentError, match="`plant` must be a Plant or a plant of another kind, got int"):
        certify(3, EVERY)
    with pytest.raises(ArgumentError, match="`plant` must be a Plant, got str"):
        Certificate("x", EVERY, **ONES)
    with pytest.raises(ArgumentError, match="`schedule` must hold at least one sample"):
        Certificate(Plant([[0.0]], [[1.0]]), Schedule([]), **ONES)


def test_aliased_schedule_is_refused_with_reason_and_a_repair_that_works():
    with pytest.raises(
        CertificateError, match=r"0\+1i is aliased with 0-1i: their difference is 2 pi over the period"
    ) as caught:
        given(schedule=PeriodicSchedule([np.pi]))
    details = caught.value.details
    assert details["eigenvalue"] == pytest.approx(1j)
    assert details["partners"] == pytest.approx((-1j,))
    assert details["period"] == pytest.approx(np.pi)
    repaired = given(schedule=PeriodicSchedule([details["repair"]["to"]]))
    assert repaired.verify().passed


@pytest.mark.parametrize("gaps", [[1.0], [0.3, 0.7]])
def test_eigenvalues_that_rounding_cannot_tell_apart_are_undecided(gaps):
    plant = Plant(np.diag([0.1, 0.1 + 1e-10]), [[1.0, 1.0]])
    with pytest.raises(UndecidedError, match="differ by only 1e-10 in a period of 1, which rounding hides"):
        certificate_exists(plant, PeriodicSchedule(gaps), 0.1)


@pytest.mark.parametrize("apart", [1e-7, 1e-5, 1e-3])
@pytest.mark.parametrize("gaps", [[1.0], [0.3, 0.7]])
def test_eigenvalues_that_are_nearly_one_are_said_to_be(apart, gaps):
    plant = Plant(np.diag([0.1, 0.1 + apart]), [[1.0, 1.0]])
    found = certificate_exists(plant, PeriodicSchedule(gaps), 0.1)
    assert found.exists
    assert f"lies within {apart:.6g} of 0.1" in found.reason
    assert "do not distinguish them" in found.reason
    assert "turn" not in found.reason
    assert "aliased" not in found.reason


def test_integer_gaps_alias_omega_pi_whatever_the_schedule():
    plant = Plant([[0.0, np.pi], [-np.pi, 0.0]], [[1.0, 0.0]])
    with pytest.raises(CertificateError, match="a multiple of 2 pi over every gap") as caught:
        given(plant, PeriodicSchedule([1.0, 2.0, 1.0]))
    repair = caught.value.details["repair"]
    gaps = np.array([1.0, 2.0, 1.0])
    gaps[repair["gap"]] = repair["to"]
    assert str(caught.value).endswith(f"which makes the period {gaps.sum():.6g}.")
    assert certificate_exists(plant, PeriodicSchedule(gaps), 0.4).exists
    assert given(plant, PeriodicSchedule([0.5])).verify().passed


def test_unseen_modes_are_refused_and_limit_eta():
    growing = Plant([[0.1, 0.0], [0.0, 0.0]], [[0.0, 1.0]])
    with pytest.raises(
        CertificateError, match=r"0\.1 is observable from no sample of the period\. No change of a single gap"
    ):
        given(growing)
    with pytest.raises(CertificateError, match="no certificate with rate"):
        certify(growing, EVERY)
    slow = Plant([[0.0, 0.0], [0.0, -0.3]], [[1.0, 0.0]])
    with pytest.raises(CertificateError, match=r"decays at 0\.6 only, so eta must stay below"):
        given(slow, eta=0.61)
    assert given(slow, eta=0.55).verify().passed


@pytest.mark.long
def test_a_chosen_rate_stays_below_that_at_which_unseen_modes_decay():
    assert certify(Plant([[0.0, 0.0], [0.0, -0.3]], [[1.0, 0.0]]), EVERY).eta < 0.6


def test_no_rate_beyond_the_largest_is_ever_tried(monkeypatch):
    """At the bound, which is best here, the difference quotient looks back: beyond it an unseen mode may not decay."""
    tried, plain = [], WeightSearch.setting
    monkeypatch.setattr(WeightSearch, "setting", lambda search, eta: (tried.append(eta), plain(search, eta))[1])
    made = certify(Plant([[0.1]], [[1.0]]), EVERY)
    assert made.eta == pytest.approx(ETA_RANGE[1])
    assert len(set(tried)) > SCAN
    assert max(tried) == pytest.approx(ETA_RANGE[1], rel=1e-12)


@pytest.mark.parametrize("schedule", [EVERY, PeriodicSchedule([0.4, 1.3]), Schedule([1.0, 2.0, 3.0])])
def test_existence_agrees_with_growth_of_the_recursion(schedule):
    assert certificate_exists(OSCILLATOR, schedule, 0.4).exists
    assert smallest_repair(OSCILLATOR, PeriodicSchedule([np.pi]), 0.4)["margin"] >= 1e-2
    bad = Plant(np.diag([0.2, 0.2]), [[1.0, 1.0]])
    found = certificate_exists(bad, PeriodicSchedule([0.4, 1.3]), 0.4)
    assert not found.exists
    assert "No certificate exists" in found.explain()


def test_near_the_alias_just_feasible_and_just_infeasible():
    lam = [given(schedule=PeriodicSchedule([np.pi - d])).lam for d in (0.3, 0.1, 0.03)]
    assert np.all(np.diff(lam) > 0)
    assert lam[2] > 50 * lam[0]
    assert not certificate_exists(OSCILLATOR, PeriodicSchedule([np.pi]), 0.4).exists


def test_finite_schedule_certifies_to_its_last_time_and_says_so():
    made = given(schedule=Schedule([0.5, 1.5, 2.0]))
    assert made.verify().passed
    assert "up to time 2" in made.claim.statement
    assert "up to time 2" in made.explain()
    assert made.witness.t <= 2.0
    aliased = given(schedule=Schedule(np.pi * np.arange(1, 4)))
    assert aliased.verify().passed


def test_a_period_that_is_given_several_times_over_is_proven_once():
    """The same weights and lambda, and the same work of the check; not where the first sample or an output differ."""
    once = PeriodicSchedule([0.5, 1.0], 0.25)
    many = PeriodicSchedule(np.tile(once.gaps, 30), 0.25)
    one, more = certify(OSCILLATOR, once, eta=0.4), certify(OSCILLATOR, many, eta=0.4)
    assert (more.lam, more.P2.tolist()) == (one.lam, one.P2.tolist())
    assert len(more.schedule) == 60
    works = [WorkLimit(1e6), WorkLimit(1e6)]
    assert all(verdict_of(made.to_dict(), work).passed for made, work in zip((one, more), works, strict=True))
    assert works[0].left == works[1].left
    late = given(schedule=PeriodicSchedule([1.0, 1.0], 1.5))
    assert late.content.schedule.gaps.size == 2
    both = Plant(OSCILLATOR.A, np.eye(2))
    mask = np.tile([[1, 1], [1, 0], [1, 1], [0, 1]], (2, 1))
    assert given(both, PeriodicSchedule(np.ones(8), outputs=mask)).content.schedule.gaps.size == 4


def test_nothing_to_observe_is_certified_at_once():
    made = certify(Plant(np.zeros((0, 0)), np.zeros((1, 0))), EVERY)
    assert made.lam == 1.0
    assert made.verify().passed
    stable = certify(Plant([[-5.0]], [[1.0]]), EVERY, eta=0.5, P2=[[1.0]])
    assert stable.lam == pytest.approx(1.0)
    assert stable.verify().passed
    noiseless = certify(Plant([[0.2]], [[1.0]], G=np.zeros((1, 0))), EVERY, eta=0.5, P2=[[1.0]])
    assert noiseless.verify().passed


def test_hand_made_certificate_claims_what_its_matrices_say():
    made = given()
    by_hand = Certificate.from_matrices(
        OSCILLATOR, EVERY, P1=made.P1, P2=made.P2, Qw=made.Qw, R=made.R, Qv=made.Qv, eta=made.eta
    )
    assert by_hand.lam == pytest.approx(made.lam / (1 - 1e-3))
    assert by_hand.verify().passed
    too_much = Certificate.from_matrices(
        OSCILLATOR, EVERY, P1=1.01 * made.P1, P2=made.P2, Qw=made.Qw, R=made.R, Qv=made.Qv, eta=made.eta
    )
    verdict = too_much.verify()
    assert not verdict.passed
    assert verdict.amount < 0
    assert verdict.time is not None
    assert "Refuted" in verdict.explain()
    assert "window from" in str(verdict)


def test_record_tells_its_numbers():
    made = given()
    assert "lambda" in str(made)
    assert "past errors are discounted at rate 0.4" in made.explain()
    assert made.constants.named("lam").value == made.lam
    for name in ("eta", "improved_C_w", "paper_C_v"):
        assert name in made.to_markdown()
    assert made.constants.to_latex() in made.to_latex()
    assert json.loads(json.dumps(made.to_dict()))["claim"] == "assumption-7"


def test_noise_free_error_stays_below_the_bound():
    made = given(DOUBLE)
    bound = made.error_bound([0.0, 3.0, 30.0], [1.0, -1.0])
    assert bound.shape == (3,)
    assert bound[2] < bound[1] < bound[0]
    with pytest.raises(ArgumentError, match=r"`t` must not be negative, got -1.0: the bound begins at 0"):
        made.error_bound([0.0, -1.0], [1.0, -1.0])
    noisy = made.error_bound(30.0, [1.0, -1.0], w_bound=0.1, v_bound=0.2)
    rate, h = made.horizon().eta_tilde, made.horizon()
    hits = np.sum(np.exp(-rate * (30.0 - np.arange(1, 31))))
    expected = h.C_x * 2 * np.exp(-30 * rate) + h.C_w * 0.01 * (1 - np.exp(-30 * rate)) / rate + h.C_v * 0.04 * hits
    assert noisy == pytest.approx(np.sqrt(expected))
    assert oracle.witness_ratio(made.to_dict()) == pytest.approx(made.lam)


def test_a_certificate_is_saved_as_json_and_as_nothing_else(tmp_path):
    for name in ("c.tex", "c", "c.toml"):
        with pytest.raises(ArgumentError, match=r"`path` of a certificate must end in \.json, got .*to_latex"):
            given().save(tmp_path / name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("when", few([0.1, 0.3, 0.7, 0.8], 0, 1))
def test_an_interrupt_ends_the_search_with_what_it_has_met(when):
    def stop(fraction, message):
        if fraction >= when and not rung:
            rung.append(message)
            raise KeyboardInterrupt

    rung = []
    made = certify(DOUBLE, EVERY, progress=stop)
    assert rung
    assert made.verify().passed
    assert made.horizon().C_w <= 3.0 * 1.01 * WindowSet.of(
        window_problem(DOUBLE, EVERY, np.eye(2), *weights_of(DOUBLE, None, None, None), made.eta)
    ).least_floor(np.ones(2))


def test_an_interrupt_before_anything_is_met_ends_the_call():
    def stop(fraction, message):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        certify(DOUBLE, EVERY, progress=stop)


def test_a_budget_of_seconds_ends_the_search_and_then_the_proof():
    assert certify(DOUBLE, EVERY, eta=0.4, budget=60.0).verify().passed
    with pytest.raises(UndecidedError, match=r"was proven within `budget` = 1e-06 s\. Give it more time"):
        certify(DOUBLE, EVERY, budget=1e-6)
    with pytest.raises(UndecidedError, match="no certificate was proven within the budget") as seen:
        certify(DOUBLE, GapRange(0.5, 1.5), budget=1e-6)
    assert seen.value.details["status"] == "budget"


def test_weights_that_lambda_takes_below_all_doubles_are_undecided():
    small = {key: [[1e-300]] for key in ("P2", "Qw", "R", "Qv")}
    with pytest.raises(UndecidedError, match="P1 = P2/lambda cannot be held in doubles"):
        certify(Plant([[30.0]], [[1.0]]), PeriodicSchedule([1.0]), eta=0.4, **small)


@pytest.mark.parametrize("tries", [1, 3])
def test_a_certificate_is_sealed_and_read_once_however_often_it_is_tried(tries, monkeypatch):
    """While it is sought its numbers are judged as they are, and no horizon is worked out."""
    monkeypatch.setattr(kept_certificates, "keep", lambda made: None)
    counts, judge = collections.Counter(), proof.verdict_on_schedule

    def counted(module, name):
        function = getattr(module, name)

        def call(*arguments, **named):
            counts[name] += 1
            return function(*arguments, **named)

        monkeypatch.setattr(module, name, call)

    def doubted(content, work):
        counts["tried"] += 1
        found = judge(content, work)
        if counts["tried"] == tries:
            return found
        return dataclasses.replace(found, passed=False, verdict="refuted", time=1.5, start=0.5)

    counted(record, "with_digest")
    counted(record, "Horizon")
    counted(proof, "certificate")
    monkeypatch.setattr(proof, "verdict_on_schedule", doubted)
    made = given()
    assert counts == {"with_digest": 1, "certificate": 1, "tried": tries}
    assert made.verify().passed


def test_a_file_that_says_something_else_than_what_was_proven_is_never_returned(monkeypatch):
    made = given()
    other = dataclasses.replace(made, lam=made.lam * 1.001)
    monkeypatch.setattr(proof, "certificate", lambda data: other.content)
    with pytest.raises(AssertionError, match="the file says something else"):
        proof.as_proven(made)
