"""Hormone concentrations from rare blood samples: the paper's Section VI, and a week of samples in office hours.

    python examples/thyroid.py [--runs 2] [--weeks 4] [--pairs 100] [--output DIR]

Part 1 repeats the experiment (few runs here; `sampling-design thyroid --runs 50 -o DIR` is the whole one).
Part 2 designs on top of it. Of the six modes at the patient's equilibrium only one is slower than the squared-error
rate .35 a day, and two are slower than 1.5 a day; the blood samples have to see these two. They may be taken on
weekdays from 8 to 17 h. The schedule is certified for the linearisation and then used on the nonlinear patient.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import sampling_design as sd
from sampling_design.design.schedule_design import ScheduleDesign
from sampling_design.nonlinear import thyroid
from sampling_design.nonlinear.detectability import DetectabilityEvidence
from sampling_design.nonlinear.experiment import HORIZON, paper_weights
from sampling_design.nonlinear.report import rmse
from sampling_design.nonlinear.simulation import simulate

HOUR = 1 / 24
OFFICE = [(day + 8 * HOUR, day + 17 * HOUR) for day in range(5)]  # Monday is day 0
EDGES = [0.0, *(t for hours in OFFICE for t in hours), 7.0]
FORBIDDEN = list(zip(EDGES[::2], EDGES[1::2], strict=True))
RATES = (0.35, 1.5)
SETTLED = 7.0  # errors count from here on: the prior is forgotten, only the schedule matters


def design_week(patient: sd.NonlinearPlant, samples: int = 3) -> ScheduleDesign:
    """Return the best week of `samples` blood samples in office hours for the modes slower than 1.5 a day."""
    linear = patient.linearise(patient.equilibrium(thyroid.TRUE_START))
    requirement = sd.Requirement(
        window=7.0, period=7.0, samples=samples, spacing=1.0, decay_rate=1.5, forbidden=FORBIDDEN
    )
    return sd.design_schedule(linear, requirement)


def certify_week(patient: sd.NonlinearPlant, schedule: sd.PeriodicSchedule, rate: float = 0.35) -> sd.Certificate:
    """Return the certificate of the retained modes of the linearisation, in scaled states, at the paper's rate."""
    linear = patient.linearise(patient.equilibrium(thyroid.TRUE_START)).scaled()
    return sd.certify(sd.plants.split_modes(linear, 1.5).retained, schedule, eta=rate)


def error_on(patient: sd.NonlinearPlant, schedule: sd.PeriodicSchedule, weeks: int, runs: int) -> tuple[float, int]:
    """Return the RMSE in scaled states on a 2 h grid after `SETTLED`, and how many window problems failed."""
    scheme = sd.NonlinearMovingHorizonEstimator(
        patient,
        horizon=HORIZON,
        prior=thyroid.PRIOR_START,
        collocation=sd.nonlinear.Collocation(w_step=6 * HOUR, degree=3),
        cost=paper_weights(),
    )
    end = 7.0 * weeks
    grid = np.arange(0.0, end + HOUR, 2 * HOUR)
    samples = schedule.between(0.0, end).times
    times = np.union1d(grid, samples)
    cell = np.searchsorted(grid, times, side="right") - 1
    errors, failed = [], 0
    for run in range(runs):
        rng = np.random.default_rng([1, run])
        w = rng.uniform(-1, 1, (grid.size, 2)) * thyroid.PROCESS_BOUND
        v = rng.uniform(-1, 1, (times.size, 3)) * thyroid.NOISE_BOUND
        truth = simulate(patient, thyroid.TRUE_START, times, w=w[cell])
        y = truth[:, [1, 2, 4]] + v
        scheme.start(thyroid.PRIOR_START)
        for k, t in enumerate(times):
            estimate = scheme.update(t, y[k]) if t in samples else scheme.predict(t)
            if t >= SETTLED:
                errors.append((truth[k] - estimate.x) * thyroid.SCALING)
        failed += sum(solve.status != "ok" for solve in scheme.solves)
    return rmse(errors), failed


def assumption_7(patient: sd.NonlinearPlant, pairs: int) -> DetectabilityEvidence:
    """Return inequality (16) for the paper's weights and one sample a day, along random pairs of patients."""
    box = (thyroid.TRUE_START / 2, 2 * thyroid.TRUE_START)
    daily = sd.PeriodicSchedule([1.0], time_unit="d")
    return sd.nonlinear.check_detectability(
        patient, daily, box, duration=10.0, dt=0.25, pairs=pairs, cost=paper_weights()
    )


def compare(weeks: int, runs: int, output: Path | None = None, pairs: int = 100) -> str:
    """Return a page: design, certificate and errors of three ways to take blood samples; write it and the calendar."""
    patient = thyroid.thyroid()
    linear = patient.linearise(patient.equilibrium(thyroid.TRUE_START))
    retained = [
        f"slower than {rate} a day: {sd.plants.split_modes(linear, rate).retained.n_states} of 6 modes"
        for rate in RATES
    ]
    design = design_week(patient)
    certificate = certify_week(patient, design.schedule)
    schedules = {
        "designed": design.schedule,
        "Mon, Tue, Wed at 8 h": sd.PeriodicSchedule.from_times([8 * HOUR + d for d in range(3)], 7.0, time_unit="d"),
        "every day at 8 h": sd.PeriodicSchedule([1.0], first=8 * HOUR, time_unit="d"),
    }
    rows = ["| schedule | samples a week | RMSE after day 7 | failed |", "| --- | --- | --- | --- |"]
    for name, schedule in schedules.items():
        error, failed = error_on(patient, schedule, weeks, runs)
        rows.append(f"| {name} | {schedule.count(0.0, 7.0)} | {error:.4f} | {failed} |")
    evidence = assumption_7(patient, pairs)
    page = "\n\n".join(
        [
            "# A week of blood samples in office hours",
            f"Written by `python examples/thyroid.py --runs {runs} --weeks {weeks} --pairs {pairs} --output DIR`.",
            "At the patient's equilibrium: " + "; ".join(retained) + ". The samples have to see the latter.",
            *(f"```\n{record}\n```" for record in (design, certificate, certificate.horizon())),
            f"The nonlinear estimator over {weeks} weeks, {runs} noise realisations, RMSE in scaled states:",
            "\n".join(rows),
            "Assumption 7 with the paper's weights and one sample a day, along random pairs of patients:",
            f"```\n{evidence}\n```",
            evidence.explain(),
        ]
    )
    if output is not None:
        output.mkdir(parents=True, exist_ok=True)
        sd.schedules.write_ics(
            design.schedule, output / "blood_samples.ics", "2026-01-05T00:00", summary="blood sample"
        )
        certificate.save(output / "certificate.json")
        (output / "thyroid_week.md").write_text(page + "\n")
    return page


def main() -> None:
    """Run both parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=2, help="noise realisations")
    parser.add_argument("--weeks", type=int, default=4, help="length of a run of part 2")
    parser.add_argument("--days", type=float, default=20.0, help="length of a run of part 1")
    parser.add_argument("--pairs", type=int, default=100, help="pairs of patients for Assumption 7")
    parser.add_argument("--output", type=Path, help="folder for the page, the calendar and the certificate")
    options = parser.parse_args()
    print(sd.nonlinear.thyroid_experiment(options.runs, days=options.days), end="\n\n")
    print(compare(options.weeks, options.runs, options.output, options.pairs))


if __name__ == "__main__":
    main()
