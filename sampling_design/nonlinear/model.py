"""The nonlinear plant: its equations, where linear ones come from, and what certificates ask of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sampling_design.nonlinear.equations import PlantEquations
from sampling_design.nonlinear.functions import linear_model
from sampling_design.nonlinear.jacobians import hull_of, linearisations_of, members_of, model_of
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.record import Plain
from sampling_design.records.signatures import checked
from sampling_design.uncertain.plants.uncertain_plant import InclusionMembers, LinearInclusion, MemberHull


@dataclass(frozen=True, eq=False, repr=False)
class NonlinearPlant(PlantEquations, LinearInclusion):
    """A nonlinear continuous-time plant.

        x'(t) = f(x(t), u(t), w(t)),    y(t) = h(x(t), u(t), v(t)),    g(x(t), u(t)) <= 0

    Parameters
    ----------
    f : callable (x, u, w) or (x, u, w, t) -> n entries [state unit / time_unit]
        Written with arithmetic and casadi functions, so that it can be evaluated on casadi symbols. With a fourth
        argument the plant varies in time.
    h : callable (x, u, v) or (x, u, v, t) -> p entries
    sizes : mapping
        Numbers of "states", "inputs", "disturbances", "outputs", "noises"; inputs, disturbances and
        noises default to 0, 0 and the number of outputs.
    time_unit : str
    name, source : str
    signals : mapping, optional
        Names, units and scales (`Signals`, or a list of names) for any of the five vectors.
    bounds : mapping, optional
        Boxes (lower, upper) that hold the truth for any of the five vectors: the sets X, W, Y, V of
        the paper. Infinite entries mean no bound.
    region : StateRegion, optional
        Convex set of states in which certificates are to hold; default the box of states. See `in_region`.
    limits : callable (x, u) -> any number of entries, optional
        g: the set X of the truth is where none of them is positive, beside the box of states.

    Raises
    ------
    ArgumentError
        If a size is wrong, f or h return another number of entries, g cannot be evaluated, or a box is empty.
    MissingExtraError
        If casadi is not installed.

    Notes
    -----
    *Numerical aspects.* f and h are physical; the scales in `signals` are used by whoever solves with
    them, never silently here. A pickled plant holds its functions as casadi does, not as they were written.

    References
    ----------
    The paper, equation (1).

    Examples
    --------
    >>> pendulum = NonlinearPlant(
    ...     lambda x, u, w: [x[1], -(x[0] - x[0] ** 3 / 6) + w[0]],
    ...     lambda x, u, v: [x[0] + v[0]],
    ...     {"states": 2, "disturbances": 1, "outputs": 1},
    ... )
    >>> float(pendulum.f([0.1, 0.0])[0])
    0.0
    >>> pendulum.linearise([0.0, 0.0]).A.tolist()
    [[0.0, 1.0], [-1.0, 0.0]]
    """

    @classmethod
    def _foreign(cls, system: object) -> Callable[[object, str], NonlinearPlant] | None:
        """How the door makes one of a linear plant or of a system of another library; None: it is neither."""
        made = Plant._foreign(system)
        if made is None and not isinstance(system, Plant):
            return None

        def linear(value: object, unit: str) -> NonlinearPlant:
            return from_linear(value if made is None else made(value, unit))  # type: ignore[arg-type]

        return linear

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What a certificate about it takes for granted."""
        return ("nonlinear plant whose trajectories stay in the region", "two trajectories share the input")

    @property
    def members_are_plants(self) -> bool:
        """False: a linearisation is no plant of its own."""
        return False

    def model_to_dict(self) -> dict[str, Plain]:
        """f and h as lists of instructions, and the region, as certificate files hold them.

        Raises
        ------
        ArgumentError
            If the noise is not added to the outputs one by one, or f or h hold an operation without intervals.
        """
        return model_of(self)

    def members(self, rng: np.random.Generator) -> InclusionMembers:
        """Jacobians at points of the region."""
        return members_of(self, rng)

    def hull(self, halvings: int, size: Callable[[Array], Array]) -> MemberHull | None:
        """What interval arithmetic says of the Jacobians over cells of the region."""
        return hull_of(self, halvings, size)

    def constant_members(self, rng: np.random.Generator) -> list[tuple[str, Plant]]:
        """Linearisations at points of the region, corners first."""
        return linearisations_of(self, rng)


@checked
def from_linear(plant: Plant, *, noises: bool = True) -> NonlinearPlant:
    """Return a linear plant as a nonlinear one.

        f = A x + B u + G w,    h = C x + D u + v

    Parameters
    ----------
    plant : Plant
    noises : bool
        False leaves v out.

    Returns
    -------
    NonlinearPlant

    Examples
    --------
    >>> plant = from_linear(Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]))
    >>> plant.f([1.0, 2.0]).tolist()
    [2.0, -1.0]
    """
    f, h, sizes, signals = linear_model(plant, noises)
    return NonlinearPlant(f, h, sizes, time_unit=plant.time_unit, name=plant.name, source=plant.source, signals=signals)
