"""The nonlinear plant x' = f(x, u, w), y = h(x, u, v), its simulation and its linearisation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sampling_design import _checks
from sampling_design._record import Plain, Record, counted
from sampling_design._units import check_time_unit
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear._casadi import casadi
from sampling_design.nonlinear.functions import PlainFunction, PlantFunctions, TimedFunction, takes_time
from sampling_design.nonlinear.region import StateRegion
from sampling_design.plants.inclusion import Hull, LinearInclusion, Members
from sampling_design.plants.plant import Plant, Signals

if TYPE_CHECKING:
    from casadi import SX, Function

Array = npt.NDArray[np.float64]
Box = tuple[Array, Array]
_VECTORS = ("states", "inputs", "disturbances", "outputs", "noises")
_PREFIX = {"states": "x", "inputs": "u", "disturbances": "w", "outputs": "y", "noises": "v"}


@dataclass(frozen=True, eq=False, repr=False)
class NonlinearPlant(LinearInclusion, Record):
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

    dynamics: Callable[..., SX | Sequence[SX]]
    measurement: Callable[..., SX | Sequence[SX]]
    sizes: Mapping[str, int]
    time_unit: str = field(default="s", kw_only=True)
    name: str = field(default="", kw_only=True)
    source: str = field(default="", kw_only=True)
    signals: Mapping[str, Any] = field(default_factory=dict, kw_only=True)
    bounds: Mapping[str, Any] = field(default_factory=dict, kw_only=True)
    region: StateRegion = field(default=None, kw_only=True)  # type: ignore[assignment]
    limits: Callable[..., SX | Sequence[SX]] | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        check_time_unit(self.time_unit)
        for key in ("sizes", "signals", "bounds"):
            if not isinstance(getattr(self, key), Mapping):
                raise ArgumentError(
                    f"`{key}` must be a table of names and values, got {_checks.described(getattr(self, key))}."
                )
        _checks.known_keys("`sizes`", self.sizes, _VECTORS)
        _checks.known_keys("`signals`", self.signals, _VECTORS)
        _checks.known_keys("`bounds`", self.bounds, _VECTORS)
        for key in ("states", "outputs"):
            if key not in self.sizes:
                raise ArgumentError(f"`sizes` must give the number of {key}.")
        sizes = {"inputs": 0, "disturbances": 0, "noises": self.sizes["outputs"], **self.sizes}
        sizes = {
            key: _checks.whole(f"sizes[{key!r}]", sizes[key], int(key in ("states", "outputs"))) for key in _VECTORS
        }
        signals = {key: _own_signals(key, self.signals.get(key), sizes[key]) for key in _VECTORS}
        bounds = {key: own_box(key, self.bounds.get(key), sizes[key]) for key in _VECTORS}
        for key, value in {"sizes": sizes, "signals": signals, "bounds": bounds}.items():
            object.__setattr__(self, key, value)
        region = StateRegion(*bounds["states"]) if self.region is None else self.region
        if not isinstance(region, StateRegion) or region.lower.size != sizes["states"]:
            shown = _checks.described(region)
            raise ArgumentError(f"`region` must be a StateRegion of {sizes['states']} states, got {shown}.")
        object.__setattr__(self, "region", region)
        self._functions  # noqa: B018  built now, so that a wrong model is refused at the door

    @cached_property
    def _functions(self) -> PlantFunctions:
        ca = casadi()
        t = ca.SX.sym("t")
        x, u, w, v = (
            ca.SX.sym(k, self.sizes[s])
            for k, s in zip("xuwv", ("states", "inputs", "disturbances", "noises"), strict=True)
        )
        built = []
        for label, function, arguments, size in (
            ("dynamics", self.dynamics, (x, u, w), self.sizes["states"]),
            ("measurement", self.measurement, (x, u, v), self.sizes["outputs"]),
            ("limits", self.limits or _no_limits, (x, u), None),
        ):
            if not callable(function):
                raise ArgumentError(f"`{label}` must be a function, got {_checks.described(function)}.")
            timed = size is not None and takes_time(function)
            try:
                value = function(*arguments, t) if timed else function(*arguments)
                column = ca.vertcat(*value) if isinstance(value, list | tuple) else ca.SX(value)
            except Exception as error:  # whatever the function of a user raises
                raise ArgumentError(
                    f"`{label}` fails for symbols: {type(error).__name__} ({' '.join(str(error).split()):.120})."
                ) from error
            count = column.shape[0] * column.shape[1]
            if size is not None and column.shape != (size, 1):
                raise ArgumentError(f"`{label}` must return {size} entries, got {count}.")
            if size is None:
                built.append(ca.Function(label, [x, u], [ca.reshape(column, count, 1)]))
            else:
                built.append(ca.Function(label, [*arguments, t], [column]))
        varies = takes_time(self.dynamics) or takes_time(self.measurement)
        return PlantFunctions(built[0], built[1], built[2], varies)

    @classmethod
    def _foreign(cls, system: object) -> Callable[[object, str], NonlinearPlant] | None:
        """How the door makes one of a linear plant or of a system of another library; None: it is neither."""
        made = Plant._foreign(system)
        if made is None and not isinstance(system, Plant):
            return None

        def linear(value: object, unit: str) -> NonlinearPlant:
            from sampling_design.nonlinear.conversion import from_linear

            return from_linear(value if isinstance(value, Plant) else Plant(value, time_unit=unit))  # type: ignore[arg-type]

        return linear

    @property
    def varies(self) -> bool:
        """Whether f or h depend on time."""
        return self._functions.varies

    @property
    def rate_casadi(self) -> Function:
        """f as a casadi Function of (x, u, w, t)."""
        return self._functions.rate

    @property
    def shown_casadi(self) -> Function:
        """h as a casadi Function of (x, u, v, t)."""
        return self._functions.shown

    @property
    def limits_casadi(self) -> Function:
        """g as a casadi Function of (x, u); no entries where there is none."""
        return self._functions.limits

    @cached_property
    def f_casadi(self) -> Function:
        """f as a casadi Function of (x, u, w).

        Raises
        ------
        ArgumentError
            If the plant varies in time.
        """
        return self._without_time(self.rate_casadi, "disturbances")

    @cached_property
    def h_casadi(self) -> Function:
        """h as a casadi Function of (x, u, v).

        Raises
        ------
        ArgumentError
            If the plant varies in time.
        """
        return self._without_time(self.shown_casadi, "noises")

    def _without_time(self, function: Function, last: str) -> Function:
        if self.varies:
            raise ArgumentError(f"`plant` must not vary in time here: `{function.name()}` depends on t.")
        ca = casadi()
        arguments = [ca.SX.sym(k, self.sizes[s]) for k, s in zip("xuz", ("states", "inputs", last), strict=True)]
        found: Function = ca.Function(function.name(), arguments, [function(*arguments, 0)])
        return found

    def __getstate__(self) -> dict[str, object]:
        """The plant as data: functions as casadi's own, which can be pickled."""
        kept = {key: value for key, value in self.__dict__.items() if key in self.__dataclass_fields__}
        made = self._functions
        kept["dynamics"] = TimedFunction(made.rate) if made.varies else PlainFunction(made.rate)
        kept["measurement"] = TimedFunction(made.shown) if made.varies else PlainFunction(made.shown)
        kept["limits"] = None if self.limits is None else made.limits
        return kept

    def __setstate__(self, state: dict[str, object]) -> None:
        for key, value in state.items():
            object.__setattr__(self, key, value)

    @property
    def n_states(self) -> int:
        """Number of states."""
        return self.sizes["states"]

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return self.sizes["inputs"]

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return self.sizes["outputs"]

    @property
    def n_disturbances(self) -> int:
        """Number of disturbances."""
        return self.sizes["disturbances"]

    @property
    def n_noises(self) -> int:
        """Number of noises."""
        return self.sizes["noises"]

    @property
    def states(self) -> Signals:
        """Names, units and scales of the states."""
        found: Signals = self.signals["states"]
        return found

    @property
    def outputs(self) -> Signals:
        """Names, units and scales of the outputs."""
        found: Signals = self.signals["outputs"]
        return found

    @property
    def inputs(self) -> Signals:
        """Names, units and scales of the inputs."""
        found: Signals = self.signals["inputs"]
        return found

    @property
    def disturbances(self) -> Signals:
        """Names, units and scales of the disturbances."""
        found: Signals = self.signals["disturbances"]
        return found

    def f(self, x: npt.ArrayLike, u: npt.ArrayLike = (), w: npt.ArrayLike | None = None, t: float = 0.0) -> Array:
        """Return x' = f(x, u, w, t), shape (n,); w defaults to zero."""
        return self._evaluate(self.rate_casadi, "disturbances", x, u, w, t)

    def h(self, x: npt.ArrayLike, u: npt.ArrayLike = (), v: npt.ArrayLike | None = None, t: float = 0.0) -> Array:
        """Return y = h(x, u, v, t), shape (p,); v defaults to zero."""
        return self._evaluate(self.shown_casadi, "noises", x, u, v, t)

    def _evaluate(self, function: Function, last: str, x: object, u: object, z: object, t: float) -> Array:
        x = _checks.vector("x", x, self.sizes["states"])
        u = _checks.vector("u", _given(u, self.sizes["inputs"]), self.sizes["inputs"])
        z = _checks.vector(
            "w" if last == "disturbances" else "v", np.zeros(self.sizes[last]) if z is None else z, self.sizes[last]
        )
        value = np.array(function(x, u, z, _checks.number("t", t))).ravel()
        if not np.all(np.isfinite(value)):
            raise ArgumentError(
                f"`{function.name()}` returns {value.tolist()} at x = {x.tolist()}: the model is not finite there."
            )
        return value

    def linearise(self, x: npt.ArrayLike, u: npt.ArrayLike = (), t: float = 0.0) -> Plant:
        """Return the linear plant of small deviations from (x, u) at t, with w = 0 and v = 0.

            A = df/dx, B = df/du, G = df/dw, C = dh/dx, D = dh/du

        Raises
        ------
        ArgumentError
            If x or u has the wrong length, or the derivatives are not finite there.
        """
        ca = casadi()
        n, m = self.sizes["states"], self.sizes["inputs"]
        point = _checks.vector("x", x, n)
        control = _checks.vector("u", _given(u, m), m)
        xs, us, ws, vs = (
            ca.SX.sym(k, self.sizes[s])
            for k, s in zip("xuwv", ("states", "inputs", "disturbances", "noises"), strict=True)
        )
        when = _checks.number("t", t)
        fx, hx = self.rate_casadi(xs, us, ws, when), self.shown_casadi(xs, us, vs, when)
        wanted = [
            ca.jacobian(fx, xs),
            ca.jacobian(fx, us),
            ca.jacobian(fx, ws),
            ca.jacobian(hx, xs),
            ca.jacobian(hx, us),
        ]
        values = ca.Function("derivatives", [xs, us, ws, vs], wanted)(point, control, 0, 0)
        A, B, G, C, D = (np.array(value) for value in values)
        kept = {key: self.signals[key] for key in ("states", "inputs", "disturbances", "outputs")}
        return Plant(
            A, C, B.reshape(n, m), D.reshape(C.shape[0], m), G.reshape(n, self.sizes["disturbances"]),
            time_unit=self.time_unit, name=f"{self.name} (linearised)".strip(), source=self.source, **kept,
        )  # fmt: skip

    def equilibrium(self, guess: npt.ArrayLike, u: npt.ArrayLike = ()) -> Array:
        """Return x with f(x, u, 0) = 0 near `guess`, by Newton's method in scaled states.

        Raises
        ------
        SolverError
            If the iteration does not converge.
        """
        scale = self.signals["states"].scales
        z = _checks.vector("guess", guess, self.sizes["states"]) / scale
        for _ in range(_NEWTON_STEPS):
            residual = self.f(z * scale, u) / scale
            step = np.linalg.solve(self.linearise(z * scale, u).A * scale / scale[:, None], residual)
            z = z - step
            if np.max(np.abs(step)) <= _NEWTON_TOLERANCE * max(1.0, float(np.max(np.abs(z)))):
                return np.asarray(z * scale)
        raise SolverError("no equilibrium found near `guess`: Newton's method does not converge.", status="diverged")

    def in_region(
        self,
        lower: npt.ArrayLike,
        upper: npt.ArrayLike,
        rows: npt.ArrayLike | None = None,
        offsets: npt.ArrayLike | None = None,
        about: npt.ArrayLike | None = None,
    ) -> NonlinearPlant:
        """Return the same plant with the states lower <= x <= upper, rows x <= offsets as the region of certificates.

        `about` is the state at which certificates linearise, by default the middle of the box.

        Raises
        ------
        ArgumentError
            If sizes differ or the box is empty.
        """
        return replace(self, region=StateRegion(lower, upper, rows, offsets, about))

    # --- what certificates need ---------------------------------------------------------------------------------------

    @cached_property
    def centre(self) -> Plant:
        """The linearisation about a state of the region."""
        found = self.linearise(self.region.about, StateRegion(*self.bounds["inputs"]).middle)
        return replace(found, name=self.name)

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
        from sampling_design.nonlinear.jacobians import model_of

        return model_of(self)

    def members(self, rng: np.random.Generator) -> Members:
        """Jacobians at points of the region."""
        from sampling_design.nonlinear.jacobians import members_of

        return members_of(self, rng)

    def hull(self, halvings: int, size: Callable[[Array], Array]) -> Hull | None:
        """What interval arithmetic says of the Jacobians over cells of the region."""
        from sampling_design.nonlinear.jacobians import hull_of

        return hull_of(self, halvings, size)

    def constant_members(self, rng: np.random.Generator) -> list[tuple[str, Plant]]:
        """Linearisations at points of the region, corners first."""
        from sampling_design.nonlinear.jacobians import linearisations_of

        return linearisations_of(self, rng)

    def with_bounds(self, **boxes: object) -> NonlinearPlant:
        """Return the same plant with other boxes, for example `with_bounds(states=(0.0, np.inf), noises=None)`.

        Raises
        ------
        ArgumentError
            If a name is none of the five vectors, or a box is empty.
        """
        _checks.known_keys("`with_bounds`", boxes, _VECTORS)
        return replace(self, bounds={**self.bounds, **boxes})

    def _rows(self) -> list[tuple[str, str]]:
        groups = [(key, ", ".join(self.signals[key].names) or "-") for key in _VECTORS]
        return [("name", self.name or "-"), *groups, ("time unit", self.time_unit)]

    def explain(self) -> str:
        """Say what the plant is, in words."""
        n, p, q = (counted(self.sizes[f"{what}s"], what) for what in ("state", "output", "disturbance"))
        return f"{self.name or 'A nonlinear plant'} with {n}, {p} and {q}; time in {self.time_unit}."


def _no_limits(*arguments: SX) -> list[SX]:
    """No g at all."""
    return []


_NEWTON_STEPS = 100
_NEWTON_TOLERANCE = 1e-13


def _given(u: object, size: int) -> object:
    """The input as it was given; nothing at all stands for zero."""
    return np.zeros(size) if u is None or (isinstance(u, Sized) and not len(u)) else u


def _side(key: str, value: object, size: int) -> Array:
    side = _checks.floats(f"bounds[{key!r}]", value)
    if side.shape not in ((), (size,)):
        raise ArgumentError(f"`bounds[{key!r}]` must be a pair (lower, upper) of numbers or of {size} entries each.")
    return np.broadcast_to(side, (size,)).copy()


def own_box(key: str, box: object, size: int) -> Box:
    """Return (lower, upper) as frozen vectors; infinite where there is no bound.

    Raises
    ------
    ArgumentError
        If lengths differ, a bound is NaN, or lower exceeds upper.
    """
    if box is None:
        box = (np.full(size, -np.inf), np.full(size, np.inf))
    lower, upper = (_side(key, side, size) for side in _pair(key, box))
    if np.any(np.isnan(lower)) or np.any(np.isnan(upper)) or np.any(lower > upper):
        raise ArgumentError(f"`bounds[{key!r}]` must be (lower, upper) with lower <= upper.")
    lower.flags.writeable = upper.flags.writeable = False
    return lower, upper


def _pair(key: str, box: object) -> Sequence[object]:
    if not isinstance(box, (Sequence, np.ndarray)) or isinstance(box, str) or len(box) != 2:
        raise ArgumentError(f"`bounds[{key!r}]` must be a pair (lower, upper), got {_checks.described(box)}.")
    return box  # type: ignore[return-value]


def _own_signals(key: str, value: Signals | Sequence[str] | None, size: int) -> Signals:
    if isinstance(value, Signals):
        if len(value) != size:
            raise ArgumentError(f"`signals[{key!r}]` must have {size} entries, got {len(value)}.")
        return value
    return Signals(_checks.names(f"signals[{key!r}]", value, size, _PREFIX[key]))
