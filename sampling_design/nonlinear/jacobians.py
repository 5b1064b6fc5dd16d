"""What certificates ask of a nonlinear plant: functions as instructions, and Jacobians at points of the region."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from sampling_design.checkers.inclusion_file import Region
from sampling_design.checkers.inclusion_file import region as region_of
from sampling_design.checkers.parts import Plant as FilePlant
from sampling_design.checkers.regions import enclosed
from sampling_design.errors import ArgumentError
from sampling_design.nonlinear.equations import PlantEquations
from sampling_design.nonlinear.functions import casadi
from sampling_design.nonlinear.region import drawn
from sampling_design.plants.plant import Plant
from sampling_design.records.arrays import Array
from sampling_design.records.declarations import plain
from sampling_design.records.record import Plain, short
from sampling_design.uncertain.plants.uncertain_plant import InclusionMembers, MemberHull

if TYPE_CHECKING:
    from casadi import SX, Function


_ONE = {
    "OP_NEG": "neg",
    "OP_EXP": "exp",
    "OP_LOG": "log",
    "OP_SQRT": "sqrt",
    "OP_SQ": "square",
    "OP_TWICE": "twice",
    "OP_INV": "inverse",
    "OP_SIN": "sin",
    "OP_COS": "cos",
    "OP_TAN": "tan",
    "OP_ATAN": "atan",
    "OP_TANH": "tanh",
    "OP_SINH": "sinh",
    "OP_COSH": "cosh",
    "OP_FABS": "abs",
}
_TWO = {"OP_ADD": "add", "OP_SUB": "sub", "OP_MUL": "mul", "OP_DIV": "div"}


def instructions(function: Function, names: tuple[str, ...]) -> dict[str, Plain]:
    """Return `{"code": [[word, arguments...], ...], "outputs": [...]}` of a casadi SX Function.

    Raises ArgumentError if it holds an operation for which no interval is known, such as a comparison.

    Parameters
    ----------
    function : casadi Function
        Of SX, with one dense output.
    names : tuple of str
        Of its inputs, as the instructions call them.

    Examples
    --------
    >>> import casadi
    >>> x = casadi.SX.sym("x", 1)
    >>> instructions(casadi.Function("f", [x], [casadi.sin(x) * 2]), ("x",))["code"]
    [['x', 0], ['sin', 0], ['twice', 1]]
    """
    ca = casadi()
    known = {getattr(ca, key): word for key, word in (_ONE | _TWO).items()}
    code: list[list[str | int | float]] = []
    slots: dict[int, int] = {}
    outputs: dict[int, int] = {}

    def put(*entry: str | int | float) -> int:
        code.append(list(entry))
        return len(code) - 1

    for k in range(function.n_instructions()):
        op, into, out = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_CONST:
            slots[out[0]] = put("constant", float(function.instruction_constant(k)))
        elif op == ca.OP_INPUT:
            slots[out[0]] = put(names[into[0]], int(into[1]))
        elif op == ca.OP_OUTPUT:
            outputs[int(out[1])] = slots[into[0]]
        elif op == ca.OP_ASSIGN:
            slots[out[0]] = slots[into[0]]
        elif op in (ca.OP_POW, ca.OP_CONSTPOW):
            base, exponent = slots[into[0]], slots[into[1]]
            if code[exponent][0] == "constant":
                slots[out[0]] = put("power", base, code[exponent][1])
            else:
                slots[out[0]] = put("exp", put("mul", exponent, put("log", base)))
        elif op in known:
            word = known[op]
            slots[out[0]] = put(word, *(slots[i] for i in into[: 2 if word in _TWO.values() else 1]))
        else:
            raise ArgumentError(
                f"`{function.name()}` must be made of arithmetic, powers, exp, log, sqrt and trigonometric functions "
                f"for a certificate, got operation number {op} of casadi."
            )
    return {"code": code, "outputs": [outputs[k] for k in sorted(outputs)]}


POINTS = 600  # random points of the region whose Jacobians are members, and as many on its faces
SAME = 1e-9  # Jacobians this near, relative to the largest entries, are one
ROUNDING = 1e-9  # radii below this share of an entry are rounding
SUSPECTS = 12  # linearisations in which a refusal looks for what has no certificate


def symbols_of(plant: PlantEquations) -> tuple[SX, SX, SX, SX, SX]:
    """Return the plant's functions without noise: x, u, w, f(x, u, w) and h(x, u) as dense columns.

    Raises ArgumentError if the noise is not added to the outputs, one to each.
    """
    ca = casadi()
    x, u = ca.SX.sym("x", plant.n_states), ca.SX.sym("u", plant.n_inputs)
    w, v = ca.SX.sym("w", plant.n_disturbances), ca.SX.sym("v", plant.n_noises)
    outputs = plant.h_casadi(x, u, v)
    if not plant.adds_noise:
        raise ArgumentError("`measurement` must add one noise to each output, y = h(x, u) + v, for a certificate.")
    quiet = ca.substitute(outputs, v, ca.SX.zeros(plant.n_noises)) if plant.n_noises else outputs
    return x, u, w, ca.densify(plant.f_casadi(x, u, w)), ca.densify(quiet)


def model_of(plant: PlantEquations) -> dict[str, Plain]:
    """Return the plant as certificate files hold it."""
    ca, (x, u, w, rate, output) = casadi(), symbols_of(plant)
    f, h = ca.Function("dynamics", [x, u, w], [rate]), ca.Function("measurement", [x, u], [output])
    boxes: dict[str, Plain] = {
        key: {"low": plain(plant.bounds[name][0]), "high": plain(plant.bounds[name][1])}
        for key, name in (("u", "inputs"), ("w", "disturbances"))
    }
    programs: dict[str, Plain] = {"f": instructions(f, ("x", "u", "w")), "h": instructions(h, ("x", "u"))}
    return {"kind": "nonlinear", **programs, **plant.region.to_dict(), **boxes}


def points_of(plant: PlantEquations, rng: np.random.Generator, count: int = POINTS) -> tuple[Array, Array, Array]:
    """x, u and w at points of the region and the boxes."""
    region, n, m = plant.region, plant.n_states, plant.n_inputs
    names, boxes = ("states", "inputs", "disturbances"), boxes_of(plant)
    low, high = (np.concatenate([box[k] for box in boxes]) for k in (0, 1))
    scales = np.concatenate([plant.signals[name].scales for name in names])
    z = drawn(low, high, scales, count, rng)
    z = z[region.holds(z[:, :n])]
    return z[:, :n], z[:, n : n + m], z[:, n + m :]


def jacobians_at(plant: PlantEquations, x: Array, u: Array, w: Array) -> tuple[Array, Array]:
    """(A, G) side by side (K, n, n + q) and C (K, p, n) at K points; those that are not finite are left out."""
    ca, (*symbols, f, h) = casadi(), symbols_of(plant)
    at_x, _, at_w = symbols
    AG = ca.horzcat(ca.jacobian(f, at_x), ca.jacobian(f, at_w))
    both = ca.Function("both", symbols, [ca.densify(AG), ca.densify(ca.jacobian(h, at_x))])
    AG, C = (np.array(part) for part in both.map(len(x))(x.T, u.T, w.T))
    n, p, count = plant.n_states, plant.n_outputs, len(x)
    stack = AG.reshape(n, count, -1).transpose(1, 0, 2), C.reshape(p, count, n).transpose(1, 0, 2)
    fine = np.isfinite(stack[0]).all(axis=(1, 2)) & np.isfinite(stack[1]).all(axis=(1, 2))
    return stack[0][fine], stack[1][fine]


def members_of(plant: PlantEquations, rng: np.random.Generator) -> InclusionMembers:
    """Jacobians at points of the region, equal ones once.

    Raises ArgumentError if no point lies in the region or no Jacobian there is finite, or what has no bound makes them
    unbounded.
    """
    points = points_of(plant, rng)
    AG, C = jacobians_at(plant, *points) if len(points[0]) else (np.zeros((0, 0, 0)), np.zeros((0, 0, 0)))
    if not len(AG):
        raise ArgumentError("`region` must hold states at which the model has derivatives, got none among its points.")
    if names := without_bound(plant, np.concatenate([part[-1] for part in points])):
        raise ArgumentError(
            f"`plant` must have derivatives that are bounded over its region and boxes, and {', '.join(names)} without "
            "a bound makes them infinite. Give it one: `in_region` for states, `with_bounds` for the others."
        )
    AG, C = distinct(AG), distinct(C)
    return InclusionMembers(AG, C, tuple(f"point {k}" for k in range(len(AG))), len(AG) == 1 and len(C) == 1)


def without_bound(plant: PlantEquations, point: Array) -> list[str]:
    """What makes derivatives infinite by having no bound, all else at a point: no cell of a region then proves any."""
    low, high = (np.concatenate([np.ravel(bounds[k]) for bounds in boxes_of(plant)]) for k in (0, 1))
    names = [name for key in ("states", "inputs", "disturbances") for name in plant.signals[key].names]
    free = np.flatnonzero(~(np.isfinite(low) & np.isfinite(high)))
    if not free.size:
        return []
    apart = np.vstack([np.eye(low.size, dtype=bool)[free], np.isin(np.arange(low.size), free)])
    cells = np.where(apart, low, point), np.where(apart, high, point)
    with np.errstate(all="ignore"):
        found = [part for of_f in (True, False) for part in enclosed(region_model(plant), *cells, of_f)]
    fine = np.all([np.isfinite(part).all(axis=(*range(part.ndim - 3), -2, -1)) for part in found], axis=0)
    alone = [names[k] for k, ok in zip(free, fine[:-1], strict=True) if not ok]
    return alone or ([] if fine[-1] else [names[k] for k in free])


def region_model(plant: PlantEquations) -> Region:
    """The plant as the checkers read it."""
    centre = plant.centre
    return region_of(model_of(plant), FilePlant(centre.A, centre.C, centre.G, centre.time_unit))


def hull_of(plant: PlantEquations, halvings: int, size: Callable[[Array], Array]) -> MemberHull | None:
    """Return what interval arithmetic says over cells of the region, halved where it helps; None if not finite."""
    low, high = (np.concatenate([np.ravel(bounds[k]) for bounds in boxes_of(plant)])[None] for k in (0, 1))
    model = region_model(plant)

    def cells(low: Array, high: Array) -> tuple[Array, Array]:
        M, E, moves = enclosed(model, low, high, True)
        return M, with_entries(M, moves, E)

    with np.errstate(all="ignore"):
        C, EC, shifts = enclosed(model, low, high, False)
        for _ in range(halvings):
            tried = []
            for j in np.flatnonzero(np.isfinite(low[0]) & np.isfinite(high[0]) & (low[0] < high[0])):
                middle, left, right = low[:, j] / 2 + high[:, j] / 2, high.copy(), low.copy()
                left[:, j] = right[:, j] = middle
                tried.append((np.concatenate([low, right]), np.concatenate([left, high])))
            if not tried:
                break
            every = cells(*(np.concatenate([pair[k] for pair in tried]) for k in (0, 1)))[1]
            costs = np.nan_to_num(size(every), nan=np.inf).reshape(len(tried), -1).sum(axis=1)
            low, high = tried[int(np.argmin(costs))]
        M, moves = cells(low, high)
    if not all(np.isfinite(X).all() for X in (M, moves, C, EC, shifts)):
        return None
    return MemberHull(M, moves, C[0], with_entries(C, shifts, EC)[:, 0])


def with_entries(middle: Array, moves: Array, radii: Array) -> Array:
    """Moves, and one for each entry of which some radius is more than rounding."""
    beyond = (radii > ROUNDING * (np.abs(moves).sum(axis=0) + np.abs(middle))).any(axis=0)
    own = [np.where((np.indices(beyond.shape) == at[:, None, None]).all(axis=0), radii, 0.0)
           for at in np.argwhere(beyond)]  # fmt: skip
    return np.concatenate([moves, np.array(own).reshape(len(own), *radii.shape)])


def boxes_of(plant: PlantEquations) -> list[tuple[Array, Array]]:
    """Least and largest x, u and w."""
    return [(plant.region.lower, plant.region.upper), plant.bounds["inputs"], plant.bounds["disturbances"]]


def distinct(stack: Array) -> Array:
    """Matrices that differ."""
    size = np.abs(stack).max(axis=0)
    grain = SAME * np.where(size > 0, size, 1.0)
    _, first = np.unique(np.round(stack / grain).reshape(len(stack), -1), axis=0, return_index=True)
    return stack[np.sort(first)]


def linearisations_of(plant: PlantEquations, rng: np.random.Generator) -> list[tuple[str, Plant]]:
    """Linear plants at points of the region."""
    x, u, _ = points_of(plant, rng, SUSPECTS)
    found = []
    for a, b in zip(x[:SUSPECTS], u[:SUSPECTS], strict=True):
        try:
            found.append((f"x = {short(a)}", plant.linearise(a, b)))
        except ArgumentError:
            continue  # not finite there
    return found
