"""Section VI in short runs: what is compared, what is saved, what a page says."""

import json

import numpy as np
import pytest

from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.nonlinear import experiment
from sampling_design.nonlinear.experiment import CASES, paper_weights, patient_run, thyroid_experiment
from sampling_design.nonlinear.mhe import SolverRun
from sampling_design.nonlinear.report import PatientRun, rmse
from sampling_design.nonlinear.thyroid import NOISE_BOUND, PRIOR_START, SCALING, TRUE_START, thyroid


@pytest.fixture(scope="module")
def five_days():
    return patient_run("per_day", 1, days=3.5)


@pytest.fixture(scope="module")
def twenty_days():
    return patient_run("per_day", 1)


def test_the_rmse_is_that_of_the_definition():
    errors = np.array([[3.0, 4.0], [0.0, 0.0], [0.0, 12.0]])
    assert rmse(errors) == pytest.approx(np.sqrt((25 + 0 + 144) / 3))


def test_the_set_up_is_the_papers(five_days):
    assert five_days.truth[0] == pytest.approx(TRUE_START)
    assert five_days.times[:3] == pytest.approx([0.0, 1 / 12, 1 / 6])
    assert np.all(np.abs(five_days.outputs - five_days.truth[:, [1, 2, 4]]) <= NOISE_BOUND * (1 + 1e-12))
    gaps = np.diff(five_days.times[five_days.sampled])
    assert five_days.sampled[0]
    assert 0.5 - 1e-9 <= gaps.min() <= gaps.max() <= 1.5 + 1e-9
    assert len(five_days.solves_standard) == five_days.times.size
    assert len(five_days.solves_sample_based) == five_days.sampled.sum()
    assert {s.status for s in (*five_days.solves_standard, *five_days.solves_sample_based)} == {"ok"}
    weights = paper_weights()
    assert np.diag(weights.P2) / SCALING**2 == pytest.approx([1, 5, 1, 1, 1, 1])
    assert weights.Qw[1, 1] == pytest.approx(1.39e-4)


def test_both_schemes_agree_at_the_first_sample_and_find_the_truth(five_days):
    assert five_days.standard[0] == pytest.approx(five_days.sample_based[0], rel=1e-9)
    # TSH_c is not measured and keeps the prior's error at t = 0
    assert five_days.sample_based[0, 5] == pytest.approx(PRIOR_START[5], rel=1e-4)
    assert five_days.rmse("standard", "after_day_1") < 0.01
    assert five_days.rmse("sample_based", "after_day_1") < 0.04


@pytest.mark.long
def test_with_the_first_instant_the_figures_are_near_the_papers(twenty_days):
    assert twenty_days.rmse("standard", "after_day_1") < 0.01
    assert twenty_days.rmse("sample_based", "after_day_1") < 0.04
    assert twenty_days.rmse("standard", "without_start") < 0.015
    assert twenty_days.rmse("sample_based", "without_start") < 0.06
    standard, sparse = twenty_days.rmse("standard"), twenty_days.rmse("sample_based")
    assert standard == pytest.approx(0.22, abs=0.01)
    assert 1.0 < sparse / standard < 1.05


def test_between_samples_the_estimate_is_the_open_loop(five_days):
    from sampling_design.nonlinear.simulation import simulate

    first, second = np.flatnonzero(five_days.sampled)[1:3]
    path = simulate(thyroid(), five_days.sample_based[first], five_days.times[first:second])
    assert five_days.sample_based[first:second] * SCALING == pytest.approx(path * SCALING, abs=1e-7)


@pytest.mark.long
def test_readings_share_the_noise_and_differ_in_what_it_does():
    runs = [patient_run(case, 0, days=1.0) for case in CASES]
    noise = [run.outputs - run.truth[:, [1, 2, 4]] for run in runs]
    assert noise[0] == pytest.approx(noise[1], rel=1e-6, abs=1e-14)
    moved = [np.abs(run.truth - runs[1].truth)[-1, 0] * SCALING[0] for run in runs]
    assert moved[0] < 2e-3  # per second, fast store
    assert moved[2] > 0.01  # per day, slow store


def test_a_slow_store_keeps_the_equilibrium():
    fast, slow = (thyroid(**CASES[case]) for case in ("per_day", "per_day_slow"))
    assert slow.equilibrium(TRUE_START) == pytest.approx(fast.equilibrium(TRUE_START), rel=1e-9)


def test_a_result_file_is_gone_on_with(tmp_path, monkeypatch):
    path, asked = tmp_path / "runs.jsonl", []
    original = experiment.patient_run
    monkeypatch.setattr(
        experiment, "patient_run", lambda case, run, **k: asked.append((case, run)) or original(case, run, **k)
    )
    options = {"cases": ["per_day"], "days": 0.25, "workers": 1, "path": path}
    thyroid_experiment(1, **options)
    seen = []
    report = thyroid_experiment(3, **options, progress=lambda fraction, note: seen.append((fraction, note)))
    assert asked == [("per_day", 0), ("per_day", 1), ("per_day", 2)]
    assert seen[-1] == (1.0, "3 of 3 runs")
    assert len(path.read_text().splitlines()) == 4
    again = thyroid_experiment(3, **options)
    assert len(asked) == 3
    assert again.to_dict() == report.to_dict()
    with pytest.raises(ArgumentError, match=r"holds runs with days = 0\.25, asked for 0.5"):
        thyroid_experiment(3, **{**options, "days": 0.5})
    with pytest.raises(ArgumentError, match=r"holds runs with degree = 3, asked for 4"):
        thyroid_experiment(3, **options, degree=4)


@pytest.mark.long
def test_two_processes_give_what_one_gives(tmp_path):
    one, two = (thyroid_experiment(2, cases=["per_day"], days=0.25, workers=k) for k in (1, 2))
    assert one.rmse("per_day", "standard") == pytest.approx(two.rmse("per_day", "standard"), rel=1e-7)


def test_a_foreign_file_is_refused_and_left_alone(tmp_path):
    path = tmp_path / "other.jsonl"
    path.write_text('{"format": "something else"}\n')
    with pytest.raises(FileFormatError, match="is no result file of this experiment"):
        thyroid_experiment(1, days=0.25, path=path)
    path.write_text('{"format": "sampling-design/thyroid-runs/1", "days"')
    with pytest.raises(FileFormatError, match="is not valid JSON"):
        thyroid_experiment(1, days=0.25, path=path)
    assert path.read_text().endswith('"days"')


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"runs": 0}, "`runs` must be a whole number of at least 1"),
        ({"cases": ["per_week"]}, "`cases` must be one of per_second, per_day, per_day_slow, got 'per_week'"),
        ({"days": 0.01}, "`days` must be at least one step of 2 hours"),
        ({"days": -1.0}, "`days` must be positive"),
        ({"seed": -1}, "`seed` must be a whole number"),
        ({"degree": 0}, "`degree` must be a whole number of at least 1"),
        ({"workers": 0}, "`workers` must be a number of processes of at least 1"),
    ],
)
def test_bad_arguments_are_refused(arguments, words):
    with pytest.raises(ArgumentError, match=words):
        thyroid_experiment(**{"runs": 1, "days": 0.25, **arguments})


def test_failed_problems_are_counted_and_printed():
    solves = (SolverRun(0.0, "ok", 3, 0.01, 0, 1), SolverRun(1 / 12, "solver failed", 9, 0.04, 1, 2))
    flat = np.ones((2, 6))
    run = PatientRun("per_day", 0, np.array([0.0, 1 / 12]), flat, flat[:, :3], np.array([True, False]),
                     2 * flat, 3 * flat, solves, solves[:1])  # fmt: skip
    from sampling_design.nonlinear.report import ThyroidReport

    report = ThyroidReport(("per_day",), 1, 1 / 12, 0, (run.summary(),))
    assert report.failures == 1
    assert report.to_dict()["cases"]["per_day"]["standard"]["failed"] == 1
    assert "| per_day | standard | 2 | 0.025 | 0.040 | 0.1 | 1 |" in report.to_markdown()
    assert "| per_day | after day 1 | - | - | - |" in report.to_markdown()


def test_the_page_says_what_cannot_be_known(five_days):
    from sampling_design.nonlinear.report import ThyroidReport

    report = ThyroidReport(("per_day",), 1, 20.0, 0, (five_days.summary(),))
    page = report.to_markdown()
    assert "| the paper | t = 0 counted | 0.2244 | 0.2275 | 1.014 |" in page
    assert f"{report.ratio('per_day'):.3f}" in page
    assert all(choice in page for _, choice in report.open_points)
    assert json.dumps(report.to_dict(), allow_nan=False)
    assert "cannot be known" in page
    assert "`sampling-design thyroid --runs 1 --days 20 --seed 0 --reading per_day -o DIR`" in page
    assert "t = 0 counted" in str(report)
    finer = ThyroidReport(("per_day",), 1, 20.0, 0, (five_days.summary(),), degree=6).to_markdown()
    assert "--seed 0 --degree 6 --reading per_day -o DIR`" in finer
    assert "Radau collocation of degree 6" in finer
    assert "samples instead of" in five_days.explain()
    assert five_days.figure(2).explain().startswith("The measured states")
