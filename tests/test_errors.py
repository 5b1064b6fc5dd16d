"""Errors carry data, inherit the builtin they stand for, and know their exit code."""

import numpy as np
import pytest

from sampling_design import errors


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
