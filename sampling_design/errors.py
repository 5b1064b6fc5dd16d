"""Exceptions that carry data.

Every class names the exit code with which the command line ends (docs: "exit codes"):
1 the mathematics says no, 2 bad input or usage, 3 a solver failed or a budget ran out.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np


class SamplingDesignError(Exception):
    """Base of every error that this package raises on purpose: one line of text, and data that survive pickling."""

    exit_code = 2

    def __init__(self, message: str = "") -> None:
        super().__init__(" ".join(str(message).split()))

    def __str__(self) -> str:
        return str(self.args[0]) if self.args else ""

    def __reduce__(self) -> tuple[object, ...]:
        return _restored, (type(self), self.args, self.__dict__)


def _restored(
    kind: type[SamplingDesignError], args: tuple[object, ...], data: dict[str, object]
) -> SamplingDesignError:
    """Make an error as it was, whatever its class takes: a worker process hands it to the one that asked."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(data)
    return error


class ArgumentError(SamplingDesignError, ValueError):
    """An argument is not what the function asks for; the message names it as typed."""


class CallError(ArgumentError, TypeError):
    """A call does not fit the function: an unknown keyword, an argument missing, given twice, or one too many."""


class FileFormatError(SamplingDesignError, ValueError):
    """A file cannot be read as what it claims to be; carries the path."""

    def __init__(self, message: str, path: str = "") -> None:
        super().__init__(message)
        self.path = path


class MissingExtraError(SamplingDesignError, ImportError):
    """An optional dependency is not installed; carries the name of the extra that brings it."""

    def __init__(self, package: str, extra: str) -> None:
        super().__init__(
            f"This needs {package}, which is not installed. Install the extra: pip install 'sampling-design[{extra}]'."
        )
        self.extra = extra


class MathematicsError(SamplingDesignError):
    """The input is in order and the answer is no; carries the reason as data."""

    exit_code = 1


class NotObservableError(MathematicsError):
    """Some mode is seen by no output, however often it is sampled.

    Attributes
    ----------
    eigenvalues : (m,) complex array
        The unseen eigenvalues.
    directions : (n, m) complex array
        One unseen eigenvector per eigenvalue.
    """

    def __init__(self, message: str, eigenvalues: object = (), directions: object = ()) -> None:
        super().__init__(message)
        self.eigenvalues = np.asarray(eigenvalues, dtype=complex)
        self.directions = np.asarray(directions, dtype=complex)


class NotDetectableError(NotObservableError):
    """An unseen eigenvalue does not decay at the rate that was asked for."""


class InfeasibleRequirementError(MathematicsError):
    """No schedule meets the requirement.

    Attributes
    ----------
    obstacle : str
        The constraint that cannot be met.
    nearest : dict
        The change of the requirement that would make it feasible, as keyword arguments. Of a plan's `accuracy` the
        tolerances, by goal, that can be kept.
    """

    def __init__(self, message: str, obstacle: str = "", nearest: Mapping[str, object] | None = None) -> None:
        super().__init__(message)
        self.obstacle = obstacle
        self.nearest = dict(nearest or {})


class CertificateError(MathematicsError):
    """No certificate exists, or one is refused; `details` says which inequality, when and by how much."""

    def __init__(self, message: str, **details: object) -> None:
        super().__init__(message)
        self.details = details


class UndecidedError(CertificateError):
    """Neither a certificate nor a counterexample was found; `details` says how far both searches came."""

    exit_code = 3


class SolverError(SamplingDesignError):
    """A numerical solver failed or a budget ran out; carries the solver's status."""

    exit_code = 3

    def __init__(self, message: str, status: str = "") -> None:
        super().__init__(message)
        self.status = status
