"""What a user says of the constraints of an estimator, all of it in one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy.typing as npt

from sampling_design.checkers.strict import is_list
from sampling_design.estimators.constraints.convex_set import ConvexSet
from sampling_design.records import checks
from sampling_design.records.record import Record, short

SetLike: TypeAlias = "ConvexSet | tuple[npt.ArrayLike, npt.ArrayLike] | None"
WModel = Literal["outer", "constant"]
Engine = Literal["auto", "active set", "conic"]


@dataclass(frozen=True, eq=False, repr=False)
class Constraints(Record):
    """What is known of the signals, for a `MovingHorizonEstimator`: each a ConvexSet or a pair (lower, upper).

        x(t) in X,    C x + D u + v in Y,    v in V,    w(t) in W

    Parameters
    ----------
    x, y, v, w : ConvexSet or (lower, upper), optional
        Of the state x, the modelled output C x + D u + v, the noise v and the disturbance w; in physical units.
        Numbers stand for all entries, infinite ones for no bound.
    check_spacing : float, optional [time]
        Impose those on x also between samples, at points at most this far apart.
    w_model : "outer" or "constant"
        How bounds on w act: as an outer bound on what they can do over a gap, which provably contains the truth, or
        on a disturbance that is constant between nodes, which is not certified.
    engine : "auto", "active set" or "conic"
        What solves a window with active constraints.

    Raises
    ------
    ArgumentError
        If `check_spacing` is not positive, or `w_model` or `engine` is unknown. The sets meet the plant's dimensions
        in the estimator.

    Examples
    --------
    >>> from sampling_design import CostFunction, MovingHorizonEstimator, Plant
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> inside = Constraints(x=(-1.0, 1.0), v=(-0.1, 0.1))
    >>> mhe = MovingHorizonEstimator(plant, horizon=5.0, cost=CostFunction(eta=0.2), constraints=inside)
    >>> bool(abs(mhe.update(0.4, [1.3]).x).max() <= 1.0 + 1e-9)
    True
    """

    x: SetLike = None
    y: SetLike = None
    v: SetLike = None
    w: SetLike = None
    check_spacing: float | None = None
    w_model: WModel = "outer"
    engine: Engine = "auto"

    def __post_init__(self) -> None:
        self._check(check_spacing=checks.positive)
        for key, value, known in (("w_model", self.w_model, WModel), ("engine", self.engine, Engine)):
            checks.word(key, value, get_args(known))

    def _rows(self) -> list[tuple[str, str]]:
        rows = [(key, _bounds_text(getattr(self, key))) for key in "xyvw" if getattr(self, key) is not None]
        if self.check_spacing is not None:
            rows.append(("checked every", short(self.check_spacing)))
        return [*rows, *([("w between nodes", self.w_model)] if self.w is not None else [])]

    def explain(self) -> str:
        """Say what is constrained."""
        named = [key for key in "xyvw" if getattr(self, key) is not None]
        return f"Constraints on {', '.join(named)}." if named else "No constraints."


def _bounds_text(chosen: object) -> str:
    if is_list(chosen) and len(chosen) == 2:
        return f"{short(chosen[0], 4)} to {short(chosen[1], 4)}"
    return repr(chosen)
