"""The pituitary-thyroid loop against its reference values."""

import numpy as np
import pytest

from sampling_design.errors import ArgumentError
from sampling_design.nonlinear.simulation import simulate
from sampling_design.nonlinear.thyroid import PARAMETERS, PRIOR_START, TRUE_START, thyroid

HEALTHY = [3.867e-12, 1.14e-07, 3.162e-09, 1.094e-08, 1.885, 2.013]
PATIENT = [7.33e-13, 2.161e-08, 9.583e-10, 2.102e-09, 4.698, 5.017]
FROM_TRUTH = {
    1.0: [7.366e-13, 2.106e-08, 9.54e-10, 2.049e-09, 4.764, 5.087],
    5.0: [7.352e-13, 2.126e-08, 9.517e-10, 2.069e-09, 4.74, 5.061],
    20.0: [7.334e-13, 2.154e-08, 9.57e-10, 2.096e-09, 4.705, 5.025],
}
FROM_PRIOR = {
    1.0: [7.846e-13, 1.485e-08, 6.314e-10, 1.445e-09, 5.78, 6.164],
    5.0: [7.635e-13, 1.735e-08, 8.61e-10, 1.688e-09, 5.302, 5.658],
}


@pytest.mark.parametrize(("patient", "reference"), [(False, HEALTHY), (True, PATIENT)])
def test_equilibria(patient, reference):
    plant = thyroid(patient)
    rest = plant.equilibrium(reference)
    assert rest == pytest.approx(reference, rel=5e-4)
    assert np.abs(plant.f(rest) / plant.signals["states"].scales).max() < 1e-7


@pytest.mark.parametrize(("start", "reference"), [(TRUE_START, FROM_TRUTH), (PRIOR_START, FROM_PRIOR)])
def test_trajectories(start, reference):
    states = simulate(thyroid(), start, [0.0, *reference])
    assert states[1:] == pytest.approx(np.array(list(reference.values())), rel=5e-4)


def test_eigenvalues_of_the_scaled_jacobian():
    plant = thyroid()
    linear = plant.linearise(plant.equilibrium(TRUE_START)).scaled()
    found = np.sort(np.linalg.eigvals(linear.A).real)
    assert found == pytest.approx([-2.2003e7, -7.8419e6, -71.719, -19.847, -0.6912, -0.1134], rel=1e-4)


def test_treatment_restores_the_hormone():
    states = simulate(thyroid(), TRUE_START, [0.0, 200.0], u=[1.192e-12, 0.0])
    assert states[-1, 1] == pytest.approx(1.223e-7, rel=1e-3)


def test_the_two_readings_of_the_disturbance_differ_by_a_day_in_seconds():
    second, day = (thyroid(w_reading=reading) for reading in ("per_second", "per_day"))
    effect = [plant.f(TRUE_START, w=[1e-13, 0.6]) - plant.f(TRUE_START) for plant in (second, day)]
    assert effect[0] == pytest.approx(86400 * effect[1], rel=1e-3)
    with pytest.raises(ArgumentError, match="`w_reading` must be"):
        thyroid(w_reading="per_hour")


def test_a_changed_parameter_is_named_and_a_wrong_name_refused():
    assert thyroid(alpha_th=3e-5).f(TRUE_START)[0] != thyroid().f(TRUE_START)[0]
    with pytest.raises(ArgumentError, match="unknown key 'alpha_t'"):
        thyroid(alpha_t=1.0)


def test_every_parameter_says_whether_it_was_found():
    assert {p.status for p in PARAMETERS.values()} == {"found", "reconstructed"}
    assert all(p.unit and p.value > 0 for p in PARAMETERS.values())
