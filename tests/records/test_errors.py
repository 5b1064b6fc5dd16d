"""Errors carry data, inherit the builtin they stand for, and know their exit code."""

import copy
import inspect
import pickle
import sys

import numpy as np
import pytest

from sampling_design import Plant, errors
from sampling_design.estimators.constraints import qp


@pytest.mark.parametrize(
    ("module", "extra", "ask"),
    [("control", "control", Plant([[0.0]], [[1.0]]).to_control), ("cvxpy", "modelling", qp.cvxpy)],
)
def test_a_library_that_is_not_installed_names_its_extra(module, extra, ask, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(errors.MissingExtraError, match=rf"sampling-design\[{extra}\]"):
        ask()


@pytest.mark.parametrize(
    ("error", "builtin", "code"),
    [
        (errors.ArgumentError("x"), ValueError, 2),
        (errors.FileFormatError("x", "p"), ValueError, 2),
        (errors.MissingExtraError("casadi", "nonlinear"), ImportError, 2),
        (errors.MathematicsError("x"), Exception, 1),
        (errors.NotObservableError("x"), Exception, 1),
        (errors.NotDetectableError("x"), errors.NotObservableError, 1),
        (errors.InfeasibleRequirementError("x"), errors.MathematicsError, 1),
        (errors.CertificateError("x"), errors.MathematicsError, 1),
        (errors.SolverError("x"), Exception, 3),
    ],
)
def test_family_and_exit_code(error, builtin, code):
    assert isinstance(error, errors.SamplingDesignError)
    assert isinstance(error, builtin)
    assert error.exit_code == code


def test_they_carry_their_data():
    assert errors.FileFormatError("x", "a.toml").path == "a.toml"
    unseen = errors.NotObservableError("x", [1j], [[1.0], [0.0]])
    np.testing.assert_array_equal(unseen.eigenvalues, [1j])
    assert unseen.directions.shape == (2, 1)
    infeasible = errors.InfeasibleRequirementError("x", "spacing", {"spacing": 0.1})
    assert (infeasible.obstacle, infeasible.nearest) == ("spacing", {"spacing": 0.1})
    assert errors.CertificateError("x", margin=-0.1).details == {"margin": -0.1}
    assert errors.SolverError("x", "MaxTime").status == "MaxTime"
    assert "pip install 'sampling-design[nonlinear]'" in str(errors.MissingExtraError("casadi", "nonlinear"))
    assert errors.MissingExtraError("casadi", "nonlinear").extra == "nonlinear"


KINDS = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, Exception)]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_every_error_survives_pickling_with_all_that_it_carries(kind):
    """A worker process hands its error to the process that asked, as a pickle."""
    names = {"message": "a\n  b", "package": "casadi", "extra": "nonlinear"}
    required = [
        p.name
        for p in inspect.signature(kind).parameters.values()
        if p.default is p.empty and p.kind is not p.VAR_KEYWORD
    ]
    made = kind(*(names[key] for key in required))
    made.note = [1.5, "x"]
    back = pickle.loads(pickle.dumps(made))
    assert type(back) is kind
    assert str(back) == str(made)
    assert back.args == made.args
    assert {k: repr(v) for k, v in vars(back).items()} == {k: repr(v) for k, v in vars(made).items()}
    assert copy.deepcopy(made).note == made.note


def test_errors_with_data_survive_pickling():
    import sampling_design as sd

    with pytest.raises(errors.CertificateError) as caught:
        sd.certify(sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), sd.PeriodicSchedule([np.pi]), eta=0.1)
    back = pickle.loads(pickle.dumps(caught.value))
    assert str(back) == str(caught.value)
    assert set(back.details) == set(caught.value.details) != set()


def test_a_message_is_one_line():
    assert str(errors.SamplingDesignError("two\n   lines")) == "two lines"
    assert str(errors.SamplingDesignError()) == ""
