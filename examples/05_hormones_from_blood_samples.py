"""Six hormone concentrations from one blood sample a day: the nonlinear pituitary-thyroid loop.

The nonlinear rooms need the extra `nonlinear` (CasADi).

Run: `python examples/05_hormones_from_blood_samples.py`
"""

import numpy as np

import sampling_design as sd
from sampling_design.nonlinear.experiment import patient_run

DAYS = 4.0


def main() -> None:
    """Estimate one patient over four days from a handful of samples and from a sample every two hours."""
    plant = sd.nonlinear.thyroid.thyroid()
    print(plant.explain())
    run = patient_run("per_second", run=0, days=DAYS, seed=0)
    print(run.explain())

    dense, sparse = run.rmse("standard", "after_day_1"), run.rmse("sample_based", "after_day_1")
    share = run.sampled.sum() / run.times.size
    print(f"{run.sampled.sum()} of {run.times.size} samples; after the first day {sparse:.4f} against {dense:.4f}.")

    # what counts in the paper's figures is dominated by the first instant, where both start from the same prior
    print(f"Over all instants: {run.rmse('sample_based'):.4f} against {run.rmse('standard'):.4f}.")

    failed = [solve for solve in run.solves_sample_based if solve.status != "ok"]
    assert not failed
    assert share < 0.12
    assert np.isclose(run.rmse("sample_based"), run.rmse("standard"), rtol=0.05)
    assert dense < sparse < 0.2


if __name__ == "__main__":
    main()
