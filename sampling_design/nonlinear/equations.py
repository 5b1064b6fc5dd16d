"""The equations x' = f(x, u, w), y = h(x, u, v) of a nonlinear plant, their values and their linearisation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Sized
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_list, is_table
from sampling_design.errors import ArgumentError, SolverError
from sampling_design.nonlinear.functions import casadi, takes_time
from sampling_design.nonlinear.region import StateRegion, own_box
from sampling_design.plants.plant import Plant, Signals, signals_of
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import Record, counted, short
from sampling_design.records.units import check_time_unit

if TYPE_CHECKING:
    from casadi import SX, Function

_VECTORS = ("states", "inputs", "disturbances", "outputs", "noises")
_PREFIX = {"states": "x", "inputs": "u", "disturbances": "w", "outputs": "y", "noises": "v"}


@dataclass(frozen=True, eq=False, repr=False)
class PlantEquations(Record):
    """The entries of a `NonlinearPlant`, which says what they mean; their values and derivatives."""

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
        checks.line("name", self.name)
        checks.of_kind("source", self.source, str, "a string")
        for key in ("sizes", "signals", "bounds"):
            if not is_table(getattr(self, key)):
                raise ArgumentError(
                    f"`{key}` must be a table of names and values, got {checks.described(getattr(self, key))}."
                )
        checks.known_keys("`sizes`", self.sizes, _VECTORS)
        checks.known_keys("`signals`", self.signals, _VECTORS)
        checks.known_keys("`bounds`", self.bounds, _VECTORS)
        for key in ("states", "outputs"):
            if key not in self.sizes:
                raise ArgumentError(f"`sizes` must give the number of {key}.")
        sizes = {"inputs": 0, "disturbances": 0, "noises": self.sizes["outputs"], **self.sizes}
        sizes = {
            key: checks.whole(f"sizes[{key!r}]", sizes[key], int(key in ("states", "outputs"))) for key in _VECTORS
        }
        signals = {
            key: signals_of(f"signals[{key!r}]", self.signals.get(key), sizes[key], _PREFIX[key]) for key in _VECTORS
        }
        bounds = {key: own_box(key, self.bounds.get(key), sizes[key]) for key in _VECTORS}
        self._hold(sizes=sizes, signals=signals, bounds=bounds)
        region = StateRegion(*bounds["states"]) if self.region is None else self.region
        if not isinstance(region, StateRegion) or region.lower.size != sizes["states"]:
            shown = checks.described(region)
            raise ArgumentError(f"`region` must be a StateRegion of {sizes['states']} states, got {shown}.")
        self._hold(region=region)
        self._functions  # noqa: B018  built now, so that a wrong model is refused at the door

    @cached_property
    def _functions(self) -> tuple[Function, ...]:
        """f, h and g as casadi Functions."""
        ca = casadi()
        t = ca.SX.sym("t")
        x, u, w, v = self._symbols()
        built = []
        for label, function, arguments, size in (
            ("dynamics", self.dynamics, (x, u, w), self.sizes["states"]),
            ("measurement", self.measurement, (x, u, v), self.sizes["outputs"]),
            ("limits", (lambda *_: []) if self.limits is None else self.limits, (x, u), None),
        ):
            if not callable(function):
                raise ArgumentError(f"`{label}` must be a function, got {checks.described(function)}.")
            timed = size is not None and takes_time(function)
            try:
                value = function(*arguments, t) if timed else function(*arguments)
                column = ca.vertcat(*value) if is_list(value) else ca.SX(value)
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
        return tuple(built)

    @cached_property
    def varies(self) -> bool:
        """Whether f or h depend on time."""
        return takes_time(self.dynamics) or takes_time(self.measurement)

    @property
    def rate_casadi(self) -> Function:
        """f as a casadi Function of (x, u, w, t)."""
        return self._functions[0]

    @property
    def output_casadi(self) -> Function:
        """h as a casadi Function of (x, u, v, t)."""
        return self._functions[1]

    @property
    def limits_casadi(self) -> Function:
        """g as a casadi Function of (x, u); no entries where there is none."""
        return self._functions[2]

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
        return self._without_time(self.output_casadi, "noises")

    @cached_property
    def slopes_casadi(self) -> Function:
        """df/dx, df/du, df/dw, dh/dx, dh/du and dh/dv as a casadi Function of (x, u, w, v, t)."""
        ca, (x, u, w, v) = casadi(), self._symbols()
        t = ca.SX.sym("t")
        f, h = self.rate_casadi(x, u, w, t), self.output_casadi(x, u, v, t)
        slopes = [ca.densify(ca.jacobian(y, z)) for y, own in ((f, (x, u, w)), (h, (x, u, v))) for z in own]
        found: Function = ca.Function("slopes", [x, u, w, v, t], slopes)
        return found

    @cached_property
    def adds_noise(self) -> bool:
        """Whether v is added to y, one to each output, or there is none."""
        ca, count = casadi(), self.n_noises
        slope = self.slopes_casadi(*self._symbols(), ca.SX.sym("t"))[5]
        constant = slope.shape == (count, count) and slope.is_constant()
        return not count or bool(constant and np.array_equal(np.array(ca.DM(slope)), np.eye(count)))

    @property
    def shows_noise(self) -> bool:
        """Whether v enters y at all."""
        return not self.slopes_casadi(*self._symbols(), casadi().SX.sym("t"))[5].is_zero()

    def _symbols(self) -> list[SX]:
        """Symbols of x, u, w and v."""
        named = zip("xuwv", ("states", "inputs", "disturbances", "noises"), strict=True)
        return [casadi().SX.sym(letter, self.sizes[key]) for letter, key in named]

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
        kept["dynamics"] = self.rate_casadi if self.varies else self.f_casadi
        kept["measurement"] = self.output_casadi if self.varies else self.h_casadi
        kept["limits"] = None if self.limits is None else self.limits_casadi
        return kept

    def __setstate__(self, state: dict[str, object]) -> None:
        self._hold(**state)

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

    @cached_property
    def scales(self) -> dict[str, Array]:
        """Scales of the five vectors."""
        return {key: each.scales for key, each in self.signals.items()}

    def f(self, x: npt.ArrayLike, u: npt.ArrayLike = (), w: npt.ArrayLike | None = None, t: float = 0.0) -> Array:
        """Return x' = f(x, u, w, t), shape (n,); w defaults to zero."""
        return self._evaluate(self.rate_casadi, "disturbances", x, u, w, t)

    def h(self, x: npt.ArrayLike, u: npt.ArrayLike = (), v: npt.ArrayLike | None = None, t: float = 0.0) -> Array:
        """Return y = h(x, u, v, t), shape (p,); v defaults to zero."""
        return self._evaluate(self.output_casadi, "noises", x, u, v, t)

    def _evaluate(self, function: Function, last: str, x: object, u: object, z: object, t: float) -> Array:
        x = checks.vector("x", x, self.sizes["states"])
        u = checks.vector("u", _input_or_zero(u, self.sizes["inputs"]), self.sizes["inputs"])
        z = checks.vector(
            "w" if last == "disturbances" else "v", np.zeros(self.sizes[last]) if z is None else z, self.sizes[last]
        )
        value = np.array(function(x, u, z, checks.number("t", t))).ravel()
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
        n, m = self.sizes["states"], self.sizes["inputs"]
        point = checks.vector("x", x, n)
        control = checks.vector("u", _input_or_zero(u, m), m)
        values = self.slopes_casadi(point, control, 0, 0, checks.number("t", t))
        A, B, G, C, D, _ = (np.array(value) for value in values)
        kept = {key: self.signals[key] for key in ("states", "inputs", "disturbances", "outputs")}
        return Plant(
            A, C, B=B.reshape(n, m), D=D.reshape(C.shape[0], m), G=G.reshape(n, self.sizes["disturbances"]),
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
        z = checks.vector("guess", guess, self.sizes["states"]) / scale
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
    ) -> Self:
        """Return the same plant with the states lower <= x <= upper, rows x <= offsets as the region of certificates.

        `about` is the state at which certificates linearise, by default the middle of the box.

        Raises
        ------
        ArgumentError
            If sizes differ or no state is in the box and the half-spaces.
        """
        return replace(self, region=StateRegion(lower, upper, rows, offsets, about))

    @cached_property
    def centre(self) -> Plant:
        """The linearisation about a state of the region.

        Raises
        ------
        ArgumentError
            If it is not finite there.
        """
        try:
            found = self.linearise(self.region.about, StateRegion(*self.bounds["inputs"]).middle)
        except ArgumentError as error:
            raise ArgumentError(
                f"`plant` must have a finite linearisation at {short(self.region.about)}, the state that its region is "
                f"judged about ({str(error).rstrip('.')}). Choose a region without the pole, or another `about`."
            ) from None
        return replace(found, name=self.name)

    def with_bounds(self, **boxes: object) -> Self:
        """Return the same plant with other boxes, for example `with_bounds(states=(0.0, np.inf), noises=None)`.

        Raises
        ------
        ArgumentError
            If a name is none of the five vectors, or a box is empty.
        """
        checks.known_keys("`with_bounds`", boxes, _VECTORS)
        return replace(self, bounds={**self.bounds, **boxes})

    def _rows(self) -> list[tuple[str, str]]:
        groups = [(key, ", ".join(self.signals[key].names) or "-") for key in _VECTORS]
        return [("name", self.name or "-"), *groups, ("time unit", self.time_unit)]

    def explain(self) -> str:
        """Say what the plant is, in words."""
        n, p, q = (counted(self.sizes[f"{what}s"], what) for what in ("state", "output", "disturbance"))
        return f"{self.name or 'A nonlinear plant'} with {n}, {p} and {q}; time in {self.time_unit}."


_NEWTON_STEPS = 100  # a steady state that takes more has none near
_NEWTON_TOLERANCE = 1e-13  # relative, in scaled states


def _input_or_zero(u: object, size: int) -> object:
    """The input as it was given; nothing at all stands for zero."""
    return np.zeros(size) if u is None or (isinstance(u, Sized) and checks.dimensions(u) and not len(u)) else u
