"""The linear plant x' = Ax + Bu + Gw, y = Cx + Du + v, with names, units and scales."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, fields, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_text, likely
from sampling_design.errors import ArgumentError, MissingExtraError
from sampling_design.numerics.modal_flow import exponential
from sampling_design.plants.systems import CARRIED, StateSpace, check_system, driven, is_system, parts_of
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import Converted, frozen
from sampling_design.records.record import ListRecord, Plain, Record, counted, short
from sampling_design.records.units import check_time_unit

if TYPE_CHECKING:
    import control

FORMAT = "sampling-design/plant/1"  # of the tree that `Plant.to_dict` returns and a plant file holds

DISCRETE = "A plant is continuous in time; one in discrete time is given as Plant(control.ss(A, B, C, D, dt))."
ORDER = "Others write (A, B, C, D); here only A and C have places, as in Plant(A, C, B=B, D=D)."
"""What is said where a matrix too many was given by place: with square sizes B would pass for C."""
MATRICES = ("A", "B", "C", "D", "G")
GROUPS = ("states", "outputs", "inputs", "disturbances")
_PREFIX = {"states": "x", "outputs": "y", "inputs": "u", "disturbances": "w"}


@frozen
class Signals(ListRecord[str]):
    """Names, units and typical magnitudes of the entries of one vector.

    Parameters
    ----------
    names : sequence of str
    units : sequence of str, optional
        Default: empty strings.
    scales : (m,) array, optional
        Typical magnitudes in those units, positive. Default ones.

    Raises
    ------
    ArgumentError
        If lengths differ, a name repeats or a scale is not positive.
    """

    names: Converted[Sequence[str], tuple[str, ...]]
    units: Converted[Sequence[str], tuple[str, ...]] = ()  # type: ignore[assignment]
    scales: Converted[npt.ArrayLike | None, Array] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        listed = checks.texts(self.names)
        if listed is None:
            raise ArgumentError(f"`names` must be a list of strings, got {checks.described(self.names)}.")
        names = checks.names("names", listed, count := len(listed), "")
        units = checks.texts(self.units)
        units = ("",) * count if units == () else units
        if units is None or len(units) != count:
            raise ArgumentError(f"`units` must be {count} strings, one per name, got {checks.described(self.units)}.")
        units = tuple(checks.line("units", unit) for unit in units)
        scales = checks.vector("scales", np.ones(count) if self.scales is None else self.scales, count)
        if np.any(scales <= 0):
            raise ArgumentError(f"`scales` must be positive, got {short(scales)}.")
        self._hold(names=names, units=units, scales=scales)

    _frame = "name:names unit:units scale:scales"

    def _entries(self) -> Sequence[str]:
        return self.names

    def _where(self, name: str) -> str:
        if name not in self.names:
            return f" {likely(name, self.names)}"
        return f" It is entry {self.names.index(name)}: names.index({name!r})."

    def with_more(self, names: Sequence[str], units: Sequence[str], scales: Sequence[float]) -> Signals:
        """Return these entries with others after them."""
        return Signals([*self.names, *names], [*self.units, *units], [*self.scales, *scales])

    def labels(self) -> tuple[str, ...]:
        """Names with their units in brackets, for tables and axes."""
        return tuple(f"{n} [{u}]" if u else n for n, u in zip(self.names, self.units, strict=True))

    @property
    def called(self) -> list[tuple[str, str]]:
        """Names with their units, as checkers compare them."""
        return list(zip(self.names, self.units, strict=True))

    def to_dict(self) -> dict[str, Plain]:
        """Return a table of the plant file format; units and scales that say nothing are left out."""
        table: dict[str, Plain] = {"names": list(self.names)}
        if any(self.units):
            table["units"] = list(self.units)
        if np.any(self.scales != 1):
            table["scales"] = self.scales.tolist()
        return table

    def _rows(self) -> list[tuple[str, str]]:
        return [(label, f"scale {short(s)}") for label, s in zip(self.labels(), self.scales, strict=True)]

    def explain(self) -> str:
        """Say which entries there are."""
        return "Entries: " + ", ".join(self.labels()) + "."


@frozen
class Plant(Record):
    """A linear continuous-time plant.

        x'(t) = A x(t) + B u(t) + G w(t),    y(t) = C x(t) + D u(t) + v(t)

    Parameters
    ----------
    A : (n, n) array [1/time_unit], or a system
        A system of `control` or `scipy.signal`, given alone, brings A, B, C and D, and the names that it knows; a
        transfer function its observer form; a discrete-time one the plant that has its samples, with inputs held in
        between, where a real logarithm says which (`source` names it).
    C : (p, n) array
    B : (n, m) array, optional
        By name, as all that follows. Default: no inputs.
    D : (p, m) array, optional
        Default zero.
    G : (n, q) array, optional
        Disturbance input. Default identity, so that w enters every state.
    time_unit : str
        One of ms, s, min, h, d, wk; all rates and times are in this unit. Default s.
    name : str
    states, outputs, inputs, disturbances : Signals or sequence of str, optional
        Names, units and scales. Default names x1.., y1.., u1.., w1...
    source : str
        Where the numbers come from.

    Raises
    ------
    ArgumentError
        If a matrix has the wrong shape, is complex, or holds NaN or infinity; if C is missing or has no row; if a
        system comes with matrices beside it, has a delay, or is a discrete-time one that no plant has as its samples.
    CallError
        If more than A and C are given by place.

    Notes
    -----
    *Assumptions.* Continuous time. *Numerical aspects.* Arrays are copied, float64
    and read-only. Matrices are physical; scales say how large each entry typically is (x~ = x/s_x) and are never
    applied silently.

    References
    ----------
    The paper, equation (18).

    Examples
    --------
    >>> import numpy as np
    >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], states=["position", "velocity"])
    >>> plant
    Plant(name=-, states=position, velocity, inputs=-, outputs=y1)
    >>> bool(np.allclose(plant.transition(np.pi), -np.eye(2)))
    True
    """

    is_part: ClassVar[bool] = False
    """Whether it is that of chosen rows of another one's state."""
    _reader: ClassVar[str] = "read_plant"
    _order: ClassVar[str] = ORDER
    _absent: ClassVar[dict[str, str]] = dict.fromkeys(("dt", "Ts", "h", "sampling_time", "sample_time"), DISCRETE)
    A: Converted[npt.ArrayLike | StateSpace, Array]
    C: Converted[npt.ArrayLike | None, Array] = None  # type: ignore[assignment]
    B: Converted[npt.ArrayLike | None, Array] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    D: Converted[npt.ArrayLike | None, Array] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    G: Converted[npt.ArrayLike | None, Array] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    time_unit: str = field(default=None, kw_only=True)  # type: ignore[assignment]
    name: str = field(default="", kw_only=True)
    states: Converted[Signals | Sequence[str] | None, Signals] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    outputs: Converted[Signals | Sequence[str] | None, Signals] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    inputs: Converted[Signals | Sequence[str] | None, Signals] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    disturbances: Converted[Signals | Sequence[str] | None, Signals] = field(default=None, kw_only=True)  # type: ignore[arg-type]
    source: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        self._take_system()
        A = checks.matrix("A", self.A)
        n = A.shape[0]
        if A.shape[1] != n:
            slip = " Decimals have a point, not a comma: 0.5." if A.shape[1] == 2 * n else ""
            raise ArgumentError(f"`A` must be square, got shape {A.shape}.{slip}")
        empty = n > 0 and checks.floats("C", self.C).size == 0
        C = np.zeros((0, n)) if empty else checks.matrix("C", self.C, None, n)
        p = C.shape[0]
        if p == 0:
            raise ArgumentError("`C` must have at least one row: a plant without outputs cannot be measured.")
        B = checks.matrix("B", np.zeros((n, 0)) if self.B is None else self.B, n)
        D = checks.matrix("D", np.zeros((p, B.shape[1])) if self.D is None else self.D, p, B.shape[1])
        G = checks.matrix("G", np.eye(n) if self.G is None else self.G, n)
        owned: dict[str, object] = {"A": A, "B": B, "C": C, "D": D, "G": G}
        owned["time_unit"] = check_time_unit("s" if self.time_unit is None else self.time_unit)
        checks.line("name", self.name)
        checks.of_kind("source", self.source, str, "a string")
        sizes = {"states": n, "outputs": p, "inputs": B.shape[1], "disturbances": G.shape[1]}
        for key, size in sizes.items():
            owned[key] = signals_of(key, getattr(self, key), size, _PREFIX[key])
        self._hold(**owned)

    def _take_system(self) -> None:
        """Put the parts of a system in the place of A, where one came."""
        system: object = self.A
        if not is_system(system) and not all(hasattr(system, key) for key in "ABCD"):
            if self.C is None:
                raise ArgumentError("`C` is missing: which states, or sums of states, are measured?")
            return
        for key in ("C", "B", "D"):
            if getattr(self, key) is not None:
                raise ArgumentError(f"`{key}` must come with the system, got one beside it.")
        for key, value in parts_of(system).items():
            given = getattr(self, key)
            if key == "A" or given is None or (is_text(given) and not given):
                self._hold(**{key: value})

    @property
    def n_states(self) -> int:
        """Dimension n of x."""
        return len(self.A)

    @property
    def n_outputs(self) -> int:
        """Dimension p of y."""
        return len(self.C)

    @property
    def n_inputs(self) -> int:
        """Dimension m of u."""
        return len(self.B.T)

    @property
    def n_disturbances(self) -> int:
        """Dimension q of w."""
        return len(self.G.T)

    def transition(self, t: npt.ArrayLike) -> Array:
        """Return e^{A t}: (n, n) for a number t, (N, n, n) for an array of N times."""
        times = checks.floats("t", t)
        if times.ndim > 1:
            raise ArgumentError(f"`t` must be a number or a vector of times, got shape {times.shape}.")
        if not np.isfinite(times).all():
            raise ArgumentError(f"`t` must be finite, got {checks.described(t)}.")
        result = exponential(self.A)(times)
        return result[0] if times.ndim == 0 else result

    def same_dynamics(self, other: Plant) -> bool:
        """Whether A, C, G agree to the last bit and the time unit is the same.

        That is what a certificate, an estimator's guarantee or a report is about; B, D, names, scales and source do
        not enter. The same dynamics written in another time unit holds other numbers, so it is not the same here.

        Examples
        --------
        >>> plant = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
        >>> plant.same_dynamics(Plant(plant.A, plant.C, B=[[0.0], [1.0]], name="driven"))
        True
        >>> plant.same_dynamics(Plant(plant.A, plant.C, time_unit="h"))
        False
        """
        return not first_difference(self, other)

    def scaled(self) -> Plant:
        """Return the plant in scaled coordinates x~ = x/s_x, y~ = y/s_y, u~ = u/s_u, w~ = w/s_w, scales one."""
        x, y, u, w = (s.scales for s in (self.states, self.outputs, self.inputs, self.disturbances))
        return Plant(
            self.A * x / x[:, None], self.C * x / y[:, None], B=self.B * u / x[:, None], D=self.D * u / y[:, None],
            G=self.G * w / x[:, None], time_unit=self.time_unit, name=self.name, source=self.source,
            states=Signals(self.states.names), outputs=Signals(self.outputs.names), inputs=Signals(self.inputs.names),
            disturbances=Signals(self.disturbances.names),
        )  # fmt: skip

    def augmented(
        self,
        *,
        bias: Sequence[str] | Mapping[str, float] = (),
        disturbance: Sequence[str] | Mapping[str, float] = (),
        parameter: Mapping[str, npt.ArrayLike] | None = None,
        drift: Mapping[str, float] | None = None,
    ) -> Plant:
        """Return the plant with constants that nobody knows as states of their own, after its states.

            x' = A x + E theta + ...,    theta' = 0, or w_theta,    y = C x + F theta + ...

        Parameters
        ----------
        bias : names of outputs
            A sensor's unknown zero, state "y1_bias" in the output's unit: its column of F is that of the identity.
        disturbance : names of disturbances
            The mean of a disturbance, state "w1_mean": its column of E is that of G.
        parameter : mapping from name to (n,) array
            What else enters linearly: the name of the state, and what one unit of it adds to x' (its column of E).
        drift : mapping from the name of such a state to a number
            How fast it may change at most [its unit/time_unit]: it is driven by a disturbance "y1_bias_drift" of this
            scale. Default: it is constant.

        Returns
        -------
        Plant
            A mapping in place of names gives the typical size of each constant, its scale; default 1. Ask verbs `of`
            the states that matter: what cannot be told from a bias is then named.

        Raises
        ------
        ArgumentError
            If a name is unknown or taken, or there is nothing to add.

        Examples
        --------
        >>> gauge = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], outputs=["level"]).augmented(bias={"level": 0.1})
        >>> gauge.states.names, gauge.C
        (('x1', 'x2', 'level_bias'), array([[1., 0., 1.]]))
        """
        n, p = self.n_states, self.n_outputs
        added: list[tuple[str, str, float, Array, Array]] = []
        groups = (("bias", "bias", bias, self.outputs), ("disturbance", "mean", disturbance, self.disturbances))
        for key, word, given, group in groups:
            checks.known_keys(f"`{key}`", given, group.names)
            for name in given:
                at, size = group.names.index(name), given[name] if isinstance(given, Mapping) else 1.0
                E, F = (np.zeros(n), np.eye(p)[at]) if key == "bias" else (self.G[:, at], np.zeros(p))
                added.append((f"{name}_{word}", group.units[at], size, E, F))
        for name, column in dict(parameter or {}).items():
            added.append((name, "", 1.0, checks.vector(f"parameter.{name}", column, n), np.zeros(p)))
        if not added:
            raise ArgumentError("`augmented` needs a constant to add: bias, disturbance or parameter.")
        names, units, scales, E_columns, F_columns = zip(*added, strict=True)
        moving, k = dict(drift or {}), len(added)
        checks.known_keys("`drift`", moving, names)
        own = np.array([[float(name == other) for other in moving] for name in names]).reshape(k, len(moving))
        words = [f"{name}_drift" for name in moving]
        return remade(
            self, A=np.block([[self.A, np.column_stack(E_columns)], [np.zeros((k, n + k))]]),
            C=np.hstack([self.C, np.column_stack(F_columns)]), B=np.vstack([self.B, np.zeros((k, self.n_inputs))]),
            G=np.block([[self.G, np.zeros((n, len(moving)))], [np.zeros((k, self.n_disturbances)), own]]),
            states=self.states.with_more(names, units, scales),
            disturbances=self.disturbances.with_more(words, [""] * len(words), list(moving.values())),
        )  # fmt: skip

    def unscaled(self) -> Plant:
        """Return the plant with the same matrices and no scales: its sigma is that in physical units."""
        bare = [Signals(s.names, s.units) for s in (self.states, self.outputs, self.inputs, self.disturbances)]
        states, outputs, inputs, disturbances = bare
        return replace(self, states=states, outputs=outputs, inputs=inputs, disturbances=disturbances)

    @property
    def has_scales(self) -> bool:
        """Whether a state or output scale differs from one."""
        return bool(np.any(self.states.scales != 1) or np.any(self.outputs.scales != 1))

    @classmethod
    def from_control(cls, system: object, **details: Any) -> Plant:
        """Return the plant of a system of `control`; `details` as for `Plant` (time_unit, ...).

        What `to_control` made comes back whole, with G, units and scales. A transfer function becomes its observer
        form: the first state of each output is that output without D u.

        Raises
        ------
        ArgumentError
            If it has a delay, is neither linear nor a transfer function, is improper, or is a discrete-time system that
            no plant has as its samples.
        """
        check_system(system)
        return cls(system, **details)  # type: ignore[arg-type]

    @classmethod
    def _foreign(cls, system: object) -> Callable[[object, str], Plant] | None:
        """How the door makes a plant of a system of `control` or `scipy.signal`; None: it is neither."""
        if not is_system(system):
            return None
        return lambda value, unit: cls(value, **({} if "time_unit" in parts_of(value) else {"time_unit": unit}))  # type: ignore[arg-type]

    @classmethod
    def from_scipy(cls, system: object, **details: Any) -> Plant:
        """Return the plant of a system of `scipy.signal`, as `from_control`.

        Raises
        ------
        ArgumentError
            As for `from_control`.
        """
        check_system(system)
        return cls(system, **details)  # type: ignore[arg-type]

    def to_control(self, disturbances: bool | None = None) -> control.StateSpace:
        """Return this plant as a `control.StateSpace`; `Plant.from_control` of it is this plant again.

        Its inputs are u and, with `disturbances`, w after them. Default: w only where there is no u, since `control`
        has no system without inputs.

        Raises
        ------
        ArgumentError
            If nothing at all drives it.
        MissingExtraError
            If `control` is not installed (extra `control`).
        """
        try:
            import control
        except ImportError:
            raise MissingExtraError("python-control", "control") from None

        both = not self.n_inputs if disturbances is None else disturbances
        B, D = driven(self.B, self.D, self.G, both)
        if not B.shape[1]:
            raise ArgumentError("`control` has no system without inputs: this plant has neither B nor G to drive it.")
        names = list(self.inputs.names)
        names += [f"{w} (disturbance)" if w in names else w for w in self.disturbances.names if both]
        system = control.ss(
            self.A, B, self.C, D, name=self.name or None, states=list(self.states.names), inputs=names,
            outputs=list(self.outputs.names),
        )  # fmt: skip
        setattr(system, CARRIED, self)
        return system

    def to_dict(self) -> dict[str, Plain]:
        """Return the tree of the plant file format; defaults (no inputs, D = 0, G = identity) are left out."""
        given = {"A": self.A, "C": self.C}
        if self.n_inputs:
            given["B"] = self.B
        if self.n_inputs and not _same_bits(self.D, np.zeros_like(self.D)):
            given["D"] = self.D
        if self.G.shape != self.A.shape or not _same_bits(self.G, np.eye(self.n_states)):
            given["G"] = self.G
        tree: dict[str, Plain] = {"format": FORMAT, "name": self.name, "time_unit": self.time_unit}
        tree["matrices"] = {key: given[key].tolist() for key in MATRICES if key in given}
        tree |= {group: signals.to_dict() for group in GROUPS if len(signals := getattr(self, group))}
        return tree | ({"source": {"citation": self.source}} if self.source else {})

    def _rows(self) -> list[tuple[str, str]]:
        groups = {k: ", ".join(getattr(self, k).names) or "-" for k in ("states", "inputs", "outputs", "disturbances")}
        return [("name", self.name or "-"), *groups.items(), ("time unit", self.time_unit)]

    def explain(self) -> str:
        """Say what the plant is, in words."""
        sizes = f"{counted(self.n_states, 'state')}, {counted(self.n_inputs, 'input')}"
        sizes += f", {counted(self.n_outputs, 'output')} and {counted(self.n_disturbances, 'disturbance')}"
        return f"{self.name or 'A plant'} with {sizes}; time in {self.time_unit}."


def first_difference(mine: Plant, theirs: Plant) -> str:
    """Return in what the dynamics of `theirs` differ first from those of `mine`, as a clause; "" if they are the same.

    See `Plant.same_dynamics`.
    """
    if (whole := getattr(theirs, "whole", None)) is not None and not isinstance(mine, type(theirs)):
        if not (other := first_difference(mine, whole)):
            names = ", ".join(theirs.states.names[: getattr(theirs, "rows", 0)])
            return f"it is about chosen rows of this one ({names}): name them with `of` (--of on the command line)"
        return other
    if mine.time_unit != theirs.time_unit:
        return f"its time unit is {theirs.time_unit!r}, not {mine.time_unit!r}"
    for key in ("A", "C", "G"):
        a, b = getattr(mine, key), getattr(theirs, key)
        if a.shape != b.shape:
            return f"its {key} has shape {b.shape}, not {a.shape}"
        if not np.array_equal(a, b):
            i, j = (int(k) for k in np.argwhere(a != b)[0])
            return f"its {key}[{i}, {j}] is {float(b[i, j])!r}, not {float(a[i, j])!r}"
    return ""


def _same_bits(a: Array, b: Array) -> bool:
    return np.ascontiguousarray(a).tobytes() == np.ascontiguousarray(b).tobytes()


def signals_of(key: str, value: Signals | Sequence[str] | None, size: int, prefix: str) -> Signals:
    """Return the signals of a vector, given as such or by names; ArgumentError if their number is not `size`."""
    if isinstance(value, Signals):
        if len(value) != size:
            raise ArgumentError(f"`{key}` must have {size} entries, got {len(value)}.")
        return value
    return Signals(checks.names(key, value, size, prefix))


def remade(plant: Plant, **others: Array | Signals | None) -> Plant:
    """Return a plant of its own with other matrices or signals, part of none even where that one is a part."""
    return Plant(**{**{each.name: getattr(plant, each.name) for each in fields(Plant)}, **others})


def replace_matrices(plant: Plant, A: Array, C: Array, onto: Array, states: Signals) -> Plant:
    """Return the plant of q = onto x, with the matrices that it has there."""
    return remade(plant, A=A, C=C, B=onto @ plant.B, G=onto @ plant.G, states=states)
