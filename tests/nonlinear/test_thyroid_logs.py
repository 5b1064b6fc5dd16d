"""The patient in logarithms is the patient, and the region holds the course for which the certificate is a theorem."""

import json
from pathlib import Path

import numpy as np
import pytest

from sampling_design import read_certificate
from sampling_design.certificates.rigorous.decide import judged
from sampling_design.checkers.parts import digest
from sampling_design.errors import ArgumentError
from sampling_design.nonlinear.collocation import Collocation
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.simulation import simulate
from sampling_design.nonlinear.thyroid import PRIOR_START, PROCESS_BOUND, TRUE_START, thyroid
from sampling_design.nonlinear.thyroid_logs import (
    DOSE,
    logarithmic_thyroid,
    logarithms,
    patient_in_tube,
    patient_under_therapy,
)
from tests.cases import few
from tests.oracles import patients

FILE = Path(__file__).parents[2] / "examples" / "data" / "thyroid_patient.json"
THERAPY = FILE.with_name("thyroid_therapy.json")
DAYS = np.concatenate([[0.0], np.geomspace(1e-7, 0.5, 20), np.arange(1.0, 21.0)])


@pytest.mark.parametrize("basis", [None, np.eye(6)])
def test_both_forms_are_one_plant(basis):
    more = {} if basis is None else {"basis": basis}
    u = np.tile([1e-12, 1e-14], (7, 1))
    times = np.linspace(0.0, 3.0, 7)
    plain = simulate(thyroid(), PRIOR_START, times, u=u)
    logs = simulate(logarithmic_thyroid(**more), logarithms(PRIOR_START, *more.values()), times, u=u)
    assert logs == pytest.approx(logarithms(plain, *more.values()), abs=1e-7)
    outputs = [form.h(state) for form, state in ((thyroid(), plain[-1]), (logarithmic_thyroid(**more), logs[-1]))]
    assert outputs[0] == pytest.approx(outputs[1], rel=1e-7)


def test_a_singular_basis_is_refused():
    with pytest.raises(ArgumentError, match="`basis` must be invertible"):
        logarithmic_thyroid(basis=np.ones((6, 6)))


@pytest.mark.parametrize("start", [TRUE_START, PRIOR_START])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_the_region_holds_start_prior_and_course(start, sign):
    w = sign * np.tile(PROCESS_BOUND, (DAYS.size, 1)) * np.where(np.arange(DAYS.size) % 2, 1.0, -1.0)[:, None]
    states = simulate(thyroid(), start, DAYS, w=w)
    assert patient_in_tube().region.holds(logarithms(states)).all()


@pytest.mark.parametrize("start", few([TRUE_START, PRIOR_START], 0))
def test_the_region_under_therapy_holds_its_course(start):
    """The full dose, and one that comes and goes, with the printed disturbances."""
    w = np.tile(PROCESS_BOUND, (DAYS.size, 1)) * np.where(np.arange(DAYS.size) % 2, 1.0, -1.0)[:, None]
    for on in (np.ones(DAYS.size), np.arange(DAYS.size) % 2):
        states = simulate(thyroid(), start, DAYS, u=on[:, None] * [DOSE, 0.0], w=w)
        assert patient_under_therapy().region.holds(logarithms(states)).all()
    assert states[-1, 1] > 2.5e-8
    long = np.arange(0.0, 201.0, 20.0)
    kept = simulate(thyroid(), start, long, u=np.tile([DOSE, 0.0], (long.size, 1)), w=w[: long.size])
    assert patient_under_therapy().region.holds(logarithms(kept)).all()
    overdosed = simulate(thyroid(), start, DAYS, u=np.tile([3 * DOSE, 0.0], (DAYS.size, 1)))
    assert not patient_under_therapy().region.holds(logarithms(overdosed)).all()


@pytest.mark.long
def test_the_patient_under_therapy_is_certified_with_windows_below_3_days():
    found = read_certificate(THERAPY)
    assert found.verify().verdict == "proven"
    assert (found.family.shortest, found.family.longest) == (0.5, 1.5)
    assert found.horizon("arrival").minimum < 3.0 < found.horizon().minimum < 5.0  # with P(tau), and with P2 alone
    assert found.model_data == patient_under_therapy().model_to_dict()


def test_the_region_under_therapy_holds_the_untreated_one_so_that_one_figure_serves_both():
    one, other = patient_in_tube(), patient_under_therapy()
    for key in ("inputs", "disturbances"):
        (low, high), (lower, upper) = one.bounds[key], other.bounds[key]
        assert np.all(lower <= low)
        assert np.all(high <= upper)
    assert np.all(other.region.lower <= one.region.lower)
    assert np.all(one.region.upper <= other.region.upper)
    assert {key: value for key, value in one.model_to_dict().items() if key in "fh"} == {
        key: value for key, value in other.model_to_dict().items() if key in "fh"
    }


@pytest.mark.long
def test_estimates_with_windows_below_3_days_stay_within_their_radius():
    plant, prior = patient_under_therapy(), logarithms(PRIOR_START)
    pieces = Collocation(patients.STEP, 3, 35, accuracy=None)
    scheme = NonlinearMovingHorizonEstimator(
        plant, read_certificate(THERAPY), horizon=2.9, prior=prior, collocation=pieces
    )
    shares, errors = patients.estimated(scheme, plant, np.random.default_rng([20261126, 0]), days=6.0)
    assert shares.max() < 1
    assert errors[-1] < errors[0] / 10


@pytest.fixture(scope="module")
def certificate():
    return read_certificate(FILE)


@pytest.mark.long
def test_the_patient_is_certified_for_gaps_of_12_to_36_hours(certificate):
    assert certificate.verify().verdict == "proven"
    assert (certificate.family.shortest, certificate.family.longest) == (0.5, 1.5)
    assert certificate.horizon("arrival").minimum < certificate.horizon().minimum < 5.0  # days: the paper's own horizon
    assert certificate.model_data == patient_in_tube().model_to_dict()


@pytest.mark.parametrize("wrong", few(["rate", "region", "lambda"], 0))
def test_what_the_file_does_not_prove_is_not_proven(certificate, wrong):
    data = json.loads(FILE.read_text())
    if wrong == "rate":
        data["eta"] = 2.0
    elif wrong == "region":
        data["model"]["x"]["high"][4] = 3.0
    else:
        data["lam"] = data["lam_samples"] = 1.5
    data.pop("digest")
    verdict = judged({**data, "digest": digest(data)}, False, 0.0)
    assert verdict.verdict in ("refuted", "undecided")  # of the claim, not of a broken file


@pytest.mark.parametrize("file", few([FILE, THERAPY], 0))
def test_no_pair_of_patients_violates_it(file):
    """V along pairs of trajectories, far apart and near, with disturbances of their own and one therapy."""
    plant, dose = (patient_in_tube(), 0.0) if file == FILE else (patient_under_therapy(), DOSE)
    rng = np.random.default_rng(0)
    starts = np.vstack([logarithms([TRUE_START, PRIOR_START]), patients.scattered(plant, 6, rng)])
    gaps = np.array([0.5, 1.5, 1.5, 0.7])
    worst, pairs = patients.largest_ratio(read_certificate(file), plant, starts, gaps, rng, dose)
    assert pairs >= 15
    assert 0.5 < worst <= 1 + 1e-6
