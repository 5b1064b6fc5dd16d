"""A bound by names is the vector of its entries, whatever verb takes it; a name that is not there is named."""

import numpy as np
import pytest

import sampling_design as sd
from sampling_design.errors import ArgumentError
from tests.cases import few

NAMES = sd.plants.Signals
PLANT = sd.Plant(
    [[0.0, 1.0], [-1.0, 0.0]],
    np.eye(2),
    time_unit="h",
    states=NAMES(["level", "flow"]),
    outputs=["gauge", "meter"],
    disturbances=["rain", "leak"],
)
SCHEDULE = sd.PeriodicSchedule([0.7, 0.6], time_unit="h")
LISTS = {"w_bound": [0.1, 0.2], "v_bound": [0.3, 0.1], "initial_error": [2.0, 1.0]}
DICTS = {
    "w_bound": {"leak": 0.2, "rain": 0.1},
    "v_bound": {"meter": (-0.1, 0.1), "gauge": 0.3},
    "initial_error": {"flow": 1.0, "level": 2.0},
}
"""The same, by name: numbers or pairs about 0."""
RECORD = sd.Measurements(PLANT, [0.5, 1.1, 1.9], [[1.0, 0.1], [0.7, np.nan], [0.2, -0.3]])
BOX = sd.UncertainPlant(PLANT, [sd.UncertainParameter("stiffness", 0.99, 1.01, A=[[0.0, 0.0], [-1.0, 0.0]])])
TERMS = {"gauge": {"noise_bound": 0.1}, "meter": {"noise_bound": 0.1}}
GRID = {"period": 4.8, "grid": 1.2, "sensors": TERMS}


VERBS = {
    "guaranteed_accuracy": lambda w_bound, v_bound, **_: sd.guaranteed_accuracy(
        PLANT, SCHEDULE, w_bound=w_bound, v_bound=v_bound, rtol=0.2
    ).upper,
    "certify": lambda **bounds: sd.certify(PLANT, SCHEDULE, **bounds).P2,
    "weights_from_bounds": lambda **bounds: sd.certificates.weights_from_bounds(PLANT, 1.0, **bounds)["P2"],
    "MovingHorizonEstimator": lambda **bounds: (
        sd.MovingHorizonEstimator(PLANT, horizon=3.0, cost=sd.CostFunction(eta=0.1), **bounds).run(RECORD).radii
    ),
    "KalmanFilter": lambda **bounds: sd.KalmanFilter(PLANT, **bounds).run(RECORD).radii,
    "SetMembershipEstimator": lambda **bounds: sd.SetMembershipEstimator(PLANT, **bounds).run(RECORD).radii,
    "estimator_for": lambda **bounds: sd.estimators.estimator_for(PLANT, RECORD, **bounds).estimator.run(RECORD).radii,
    "state_interval": lambda **bounds: sd.state_interval(PLANT, RECORD, **bounds).upper,
    "simulate_record": lambda w_bound, v_bound, **_: sd.simulate_record(
        PLANT, SCHEDULE, 3.0, w_bound=w_bound, v_bound=v_bound, rng=1
    ).measurements.y,
    "accuracy_limit": lambda w_bound, v_bound, **_: sd.accuracy.accuracy_limit(
        PLANT, w_bound=w_bound, v_bound=v_bound
    ).lower,
    "over a box": lambda w_bound, v_bound, **_: sd.guaranteed_accuracy(
        BOX, SCHEDULE, w_bound=w_bound, v_bound=v_bound, rtol=0.5
    ).upper,
    "NominalFilter": lambda **bounds: sd.uncertain.NominalFilter(BOX, **bounds).run(RECORD).radii,
    "standard_deviation": lambda w_bound, v_bound, **_: sd.accuracy.standard_deviation(
        PLANT, SCHEDULE, w_intensity=w_bound, v_deviation=v_bound
    ).worst,
    "validate": lambda **bounds: sd.validate(
        PLANT, SCHEDULE, estimator=sd.KalmanFilter(PLANT), runs=1, duration=1.0, **bounds
    ).settings["initial_error"],
    "plan": lambda w_bound, **_: sd.plan_samples(
        PLANT, sd.PlanRequirement({"level": 1.5}, w_bound=w_bound, **GRID),
        search_seconds=0.1, certificate=False, robustness=False, from_start=False,
    ).reached,
}  # fmt: skip


@pytest.mark.parametrize("verb", VERBS)
def test_a_bound_by_names_is_that_of_its_entries(verb):
    np.testing.assert_array_equal(VERBS[verb](**DICTS), VERBS[verb](**LISTS))


@pytest.mark.parametrize("verb", VERBS)
def test_a_name_that_is_not_there_is_refused_with_the_nearest(verb):
    wrong = DICTS | {"w_bound": {"rain": 0.1, "leek": 0.2}}
    with pytest.raises(ArgumentError, match=r"unknown key 'leek' in `w_\w+`\. Did you mean 'leak'"):
        VERBS[verb](**wrong)


def test_a_name_that_is_left_out_and_an_interval_that_is_not_about_0_are_refused():
    with pytest.raises(ArgumentError, match="`w_bound` is missing for leak: give a number, 0 for none"):
        sd.KalmanFilter(PLANT, **DICTS | {"w_bound": {"rain": 0.1}})
    with pytest.raises(
        ArgumentError, match=r"`v_bound\['meter'\]` must be a number or a pair about 0 here, got \(0, 1\)"
    ):
        sd.KalmanFilter(PLANT, **DICTS | {"v_bound": {"gauge": 0.3, "meter": (0, 1)}})


def test_a_name_that_is_a_number_may_be_typed_as_one():
    plant = sd.Plant([[-0.5]], [[1.0]], G=[[1.0]], disturbances=["1"])
    bounds = {"v_bound": 0.1, "initial_error": 1.0}
    made = sd.KalmanFilter(plant, w_bound={1: 0.2}, **bounds)
    np.testing.assert_array_equal(made.loop.bounds.w, [0.2])
    with pytest.raises(ArgumentError, match=r"`w_bound\['1'\]` must be a number or a pair about 0 here, got \(0, 1\)"):
        sd.KalmanFilter(plant, w_bound={1: (0, 1)}, **bounds)


@pytest.mark.parametrize("seed", few(range(6), 2))
def test_a_number_bounds_the_one_entry_there_is(seed):
    """Its norm is its size: as a number (so the command line reads it) or in a list, the report is the same."""
    rng = np.random.default_rng(seed)
    plant = sd.Plant([[rng.uniform(-0.5, 0.1)]], [[1.0]], states=["a"], outputs=["b"], disturbances=["c"])
    schedule = sd.PeriodicSchedule(rng.uniform(0.4, 1.0, 2))
    numbers = dict(zip(LISTS, rng.uniform(0.1, 0.4, 3).tolist(), strict=True))
    proof, lists = sd.certify(plant, schedule, eta=0.3), {key: [bound] for key, bound in numbers.items()}
    one, other = (sd.validate(plant, schedule, proof, runs=4, duration=8.0, rng=seed, **b) for b in (numbers, lists))
    assert one.to_dict() == other.to_dict()
