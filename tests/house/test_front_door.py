"""The front door: every name opens, is documented, and costs nothing before it is used."""

import importlib
import inspect
import subprocess
import sys

import pytest

import sampling_design

PROMISED = [
    "Plant",
    "read_plant",
    "split_modes",
    "zero_count_bound",
    "observability_matrix",
    "sigma_min",
    "Schedule",
    "PeriodicSchedule",
    "SpacedWindows",
    "GapRange",
    "window_sigma",
    "worst_case_sigma",
    "Requirement",
    "design_schedule",
    "certify",
    "certify_from_proof",
    "load_certificate",
    "MovingHorizonEstimator",
    "validate",
]


@pytest.mark.parametrize("name", sampling_design.__all__)
def test_every_public_name_opens_and_is_documented(name):
    thing = getattr(sampling_design, name)
    if name == "__version__":
        assert thing.count(".") == 2
        return
    assert (inspect.getdoc(thing) or "").strip(), f"{name} has no docstring"


def test_the_names_that_others_rely_on_are_there():
    assert [name for name in PROMISED if name not in sampling_design.__all__] == []


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match="has no attribute 'desing_schedule'"):
        sampling_design.desing_schedule  # noqa: B018


def test_dir_lists_the_front_door():
    assert set(sampling_design.__all__) <= set(dir(sampling_design))


FUNCTIONS = [n for n in sampling_design.__all__ if inspect.isfunction(getattr(sampling_design, n))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_public_functions_state_parameters_and_returns(name):
    thing = getattr(sampling_design, name)
    doc = inspect.getdoc(thing)
    assert "Returns\n---" in doc, f"{name} does not say what it returns"
    assert "Parameters\n---" in doc or not inspect.signature(thing).parameters, f"{name} does not list its parameters"


def test_import_loads_numpy_at_most():
    heavy = ["scipy", "cvxpy", "control", "matplotlib", "clarabel", "typer", "rich", "joblib", "casadi", "flint"]
    code = f"import sys, sampling_design; print([m for m in {heavy} if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert found.strip() == "[]"


ROOMS = ["plants", "schedules", "observability", "design", "certificates", "estimators", "validation", "nonlinear"]


@pytest.mark.parametrize("room", [*ROOMS, "plotting", "cli"])
def test_every_room_imports_and_says_what_it_is(room):
    assert importlib.import_module(f"sampling_design.{room}").__doc__
