"""The window problem (14)-(15) as one nonlinear program: built once, its interval lengths are parameters.

The window has a fixed number of intervals with w constant on each; those that are not used have length 0, lie at the
front and carry the state over unchanged. Inside an interval the state is a polynomial that meets the differential
equation at the Radau points, so that stiff plants cost no small steps. Everything is in scaled coordinates.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sampling_design.checkers.strict import Tree
from sampling_design.estimators.gap_flows.cost_weights import marginal_root
from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.nonlinear.functions import casadi
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.newton import CondensedNewton
from sampling_design.nonlinear.region import StateRegion
from sampling_design.nonlinear.weights import NonlinearWeights
from sampling_design.nonlinear.window_forms import (
    LocalForms,
    ProgramPoint,
    WindowData,
    WindowFunctions,
    WindowSlopes,
    WindowSolution,
)
from sampling_design.records.arrays import Array
from sampling_design.records.budget import processor_seconds

if TYPE_CHECKING:
    from casadi import SX, Function


WARM_DISTANCE = 1e-9  # how far a warm start is moved off its bounds: next to nothing, since it came from the interior

APPROXIMATE_MINIMUM_DEGREE = 0
"""How IPOPT's linear solver orders a window: its own choice takes a sixth longer over a solve."""

WARM_BARRIER = 1e-6  # barrier parameter of a warm start: well below the cost of a sample, well above the tolerance


class WindowProgram:
    """The nonlinear program for windows of at most `capacity` intervals."""

    def __init__(
        self,
        plant: NonlinearPlant,
        weights: NonlinearWeights,
        capacity: int,
        degree: int,
        tolerance: float,
        max_iterations: int,
        region: StateRegion,
        huber: float | None = None,
    ) -> None:
        ca = casadi()
        self.plant, self.weights, self.capacity, self.degree = plant, weights, capacity, degree
        self.region, self.huber = region, huber
        self.tolerance, self.max_iterations = tolerance, max_iterations
        self.points = np.array(ca.collocation_points(degree, "radau"))
        self.keeps_v = not (plant.adds_noise and _unbounded(plant, "noises") and _unbounded(plant, "outputs"))
        self.n_noises = plant.n_noises if self.keeps_v else 0
        self.bounds_y = not _unbounded(plant, "outputs")
        self._upper = np.triu_indices(plant.n_states)
        self._fit = self._fit_weight()
        self._fit_at = np.nonzero(np.triu(np.linalg.matrix_power(self._fit != 0, max(1, plant.n_outputs))))
        self._fit_roots: dict[bytes, Array] = {}
        self._solvers: dict[bool, Function] = {}
        self._problem = self._assemble()
        self.boxes = self._bounds()

    def solve(self, data: WindowData, guess: WindowSolution, warm: bool) -> WindowSolution:
        """Solve one window from `guess` (with its multipliers if `warm`); never raises, the status says how it went."""
        lower, upper = self.boxes
        rows = self._row_bounds(data)
        given = np.concatenate(list(self._columns(data).values()))
        arguments = {"x0": self._pack(guess.point), "p": given, "lbx": lower, "ubx": upper}
        arguments |= {"lbg": rows[0], "ubg": rows[1]}
        if warm:
            arguments["lam_x0"] = self._pack(guess.bound_multipliers, idle=0.0)
            arguments["lam_g0"] = self._pack_rows(guess)
        solver = self._solver(warm)
        started = processor_seconds()
        try:
            found = solver(**arguments)
            stats = solver.stats()
        except RuntimeError as error:
            message = str(error).strip().splitlines()[-1][:120]
            return guess._replace(status="solver failed", message=message, seconds=processor_seconds() - started)
        return self._unpack(data.edges, found, stats, processor_seconds() - started)

    def _solver(self, warm: bool) -> Function:
        """The solver of one kind, built when first asked for."""
        if warm not in self._solvers:
            options: dict[str, Any] = {
                "print_level": 0,
                "sb": "yes",
                "tol": self.tolerance,
                "max_iter": self.max_iterations,
                "mu_strategy": "adaptive",
                "honor_original_bounds": "yes",
                "mumps_pivot_order": APPROXIMATE_MINIMUM_DEGREE,
            }
            if warm:
                warm_options = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")
                options |= {f"warm_start_{key}": WARM_DISTANCE for key in warm_options}
                options |= {"warm_start_init_point": "yes", "mu_init": WARM_BARRIER}
            quiet = {"print_time": False, "show_eval_warnings": False, "calc_lam_p": False, "ipopt": options}
            self._solvers[warm] = casadi().nlpsol("window", "ipopt", self._problem, quiet)
        return self._solvers[warm]

    def _rate(self) -> Function:
        """Return the scaled x' of (x, w, u, t)."""
        ca, plant, scale = casadi(), self.plant, self.plant.scales
        x, w = ca.SX.sym("x", plant.n_states), ca.SX.sym("w", plant.n_disturbances)
        u, t = ca.SX.sym("u", plant.n_inputs), ca.SX.sym("t")
        rate = plant.rate_casadi(x * scale["states"], u, w * scale["disturbances"], t) / scale["states"]
        found: Function = ca.Function("rate", [x, w, u, t], [rate])
        return found

    def _node(self) -> Function:
        """Return the cost at a node and the scaled output, of (x, v, u, t, y, root, fit, v_weight)."""
        ca, plant, p, scale = casadi(), self.plant, self.plant.n_outputs, self.plant.scales
        x, v = ca.SX.sym("x", plant.n_states), ca.SX.sym("v", self.n_noises)
        u, t, y = ca.SX.sym("u", plant.n_inputs), ca.SX.sym("t"), ca.SX.sym("y", p)
        entries, fit, v_weight = ca.SX.sym("root", self._fit_at[0].size), ca.SX.sym("fit"), ca.SX.sym("v_weight")
        physical_v = v * scale["noises"] if self.keeps_v else ca.SX.zeros(plant.n_noises)
        predicted = plant.output_casadi(x * scale["states"], u, physical_v, t) / scale["outputs"]
        root = ca.SX(p, p)
        for k, (row, column) in enumerate(zip(*self._fit_at, strict=True)):
            root[int(row), int(column)] = entries[k]
        cost = fit * self._loss(ca.mtimes(root, predicted - y))
        if self.n_noises:
            cost += v_weight * ca.bilin(self.weights.twice * self.weights.Qv, v, v)
        found: Function = ca.Function("node", [x, v, u, t, y, entries, fit, v_weight], [cost, predicted])
        return found

    @cached_property
    def functions(self) -> WindowFunctions:
        """The window's functions with their derivatives, built when first asked for."""
        return WindowFunctions(self._rate(), self._node(), self.points, self.capacity)

    @cached_property
    def newton(self) -> CondensedNewton:
        """Newton's method on the windows; limits on states and outputs it only looks at."""
        lower, upper = (self._split(box, self.capacity) for box in self.boxes)
        weight = 2 * self.weights.twice * self.weights.Qw
        return CondensedNewton(self.functions, (lower, upper), weight, self.tolerance, self.max_iterations)

    def near(self, data: WindowData, guess: WindowSolution) -> tuple[WindowSolution, WindowSlopes] | None:
        """Return the solution next to `guess` by Newton's method, and its slopes.

        None where none is near, a bound of states or outputs acts, or the plant has limits beside them.
        """
        if self._counts[1] or data.edges.size == 1:
            return None
        found = self.newton.solve(data, guess, self._columns(data))
        if found is None:
            return None
        solution, forms, carried = found
        scale = self.plant.signals["outputs"].scales
        low, high = (side / scale for side in self.plant.bounds["outputs"])
        if np.any((data.mask > 0) & ((forms.outputs < low) | (forms.outputs > high))):
            return None
        return solution, self._slopes(data, forms, carried)

    def linearised(self, data: WindowData, solution: WindowSolution) -> WindowSlopes:
        """Return the slopes of the intervals and the outputs at a solution, scaled."""
        still = np.zeros(solution.point.z.shape)
        forms = self.functions.at(data, solution.point, still, self._columns(data))
        return self._slopes(data, forms, forms.carried())

    def _slopes(self, data: WindowData, forms: LocalForms, carried: Array) -> WindowSlopes:
        n, p = self.plant.n_states, self.plant.n_outputs
        both = carried[:, -n:]
        roots = np.zeros((len(both) + 1, p, p))
        is_measured = data.mask.any(axis=1, keepdims=True)
        roots[:, self._fit_at[0], self._fit_at[1]] = np.where(is_measured, self._fit_rows(data.mask), 0.0)
        return WindowSlopes(both[:, :, :n], both[:, :, n + 1 :], forms.H, forms.outputs, roots)

    def _limited(self) -> Function:
        """Return the rows of (z, u) that must not be positive: g, and the half-spaces of the region."""
        ca, plant = casadi(), self.plant
        z, u = ca.SX.sym("z", plant.n_states), ca.SX.sym("u", plant.n_inputs)
        x = z * plant.signals["states"].scales
        g = plant.limits_casadi(x, u)
        rows = self.region.rows * plant.signals["states"].scales
        size = np.maximum(np.abs(rows).sum(axis=1), np.abs(self.region.offsets))
        size = np.where(size > 0, size, 1.0)
        flat = ca.mtimes(ca.DM(rows / size[:, None]), z) - self.region.offsets / size
        found: Function = ca.Function("limited", [z, u], [ca.vertcat(g, flat)])
        return found

    def _assemble(self) -> dict[str, SX]:
        ca, plant, N = casadi(), self.plant, self.capacity
        n, m, q, r, p = plant.n_states, plant.n_inputs, plant.n_disturbances, self.n_noises, plant.n_outputs
        rate, node, slopes = self._rate(), self._node(), ca.collocation_coeff(list(self.points))[0]
        Qw = self.weights.twice * self.weights.Qw
        sizes = {"h": (N, 1), "u": (m, N + 1), "rise": (m, N), "t": (N + 1, 1), "y": (p, N + 1)}
        sizes |= {"root": (self._fit_at[0].size, N + 1), "prior": (n, 1), "P2": (self._upper[0].size, 1)}
        sizes |= {"w": (N, 1), "v": (N + 1, 1), "fit": (N + 1, 1)}
        par = {key: ca.SX.sym(key, *shape) for key, shape in sizes.items()}
        limited = self._limited()
        z = ca.SX.sym("z0", n)
        unknowns, constraints, outputs, limits = [z], [], [], [limited(z, par["u"][:, 0])]
        arrival = ca.SX(n, n)
        for k, (row, column) in enumerate(zip(*self._upper, strict=True)):
            arrival[int(row), int(column)] = par["P2"][k]
        cost = ca.sumsqr(ca.mtimes(arrival, z - par["prior"]))
        for j in range(N + 1):
            if j:
                w, Z = ca.SX.sym(f"w{j}", q), ca.SX.sym(f"z{j}", n, self.degree)
                unknowns += [w, ca.vec(Z)]
                u, rise, h = par["u"][:, j - 1], par["rise"][:, j - 1], par["h"][j - 1]
                along = ca.horzcat(z, Z)
                for k, share in enumerate(self.points):
                    slope = rate(Z[:, k], w, u + share * rise, par["t"][j - 1] + share * h)
                    constraints.append(ca.mtimes(along, slopes[:, k]) - h * slope)
                limits += [limited(Z[:, k], u + float(self.points[k]) * rise) for k in range(self.degree)]
                cost += par["w"][j - 1] * ca.bilin(Qw, w, w)
                z = Z[:, self.degree - 1]
            v = ca.SX.sym(f"v{j}", r)
            unknowns.append(v)
            y, root = par["y"][:, j], par["root"][:, j]
            own, output = node(z, v, par["u"][:, j], par["t"][j], y, root, par["fit"][j], par["v"][j])
            cost += own
            if self.bounds_y:
                outputs.append(output)
        parameters = ca.vertcat(*(ca.vec(par[key]) for key in sizes))
        rows_of_all = ca.vertcat(*constraints, *limits, *outputs)
        self._counts = (sum(c.numel() for c in constraints), sum(c.numel() for c in limits))
        return {"x": ca.vertcat(*unknowns), "p": parameters, "f": cost, "g": rows_of_all}

    def _loss(self, e: SX) -> SX:
        """The square of a whitened residual; beyond `huber` each entry counts about linearly."""
        ca, c = casadi(), self.huber
        found: SX = ca.sumsqr(e) if c is None else ca.sum1(2 * c * c * (ca.sqrt(1 + (e / c) ** 2) - 1))
        return found

    def _fit_weight(self) -> Array:
        """Return the weight of y - h in scaled outputs; with v eliminated where v has no box."""
        own, scale = self.weights, self.plant.scales
        if self.keeps_v or not self.plant.n_noises:
            return own.R
        # min over v of c|v|^2_Qv + |e - v|^2_R = |e|^2 with weight (R^-1 + (c Qv)^-1)^-1, v like e in scaled outputs
        ratio = scale["outputs"] / scale["noises"]
        Qv = own.twice * own.Qv * ratio * ratio[:, None]
        fit: Array = np.asarray(own.R @ np.linalg.solve(own.R + Qv, Qv), dtype=np.float64)
        return (fit + fit.T) / 2

    def _fit_rows(self, mask: Array) -> Array:
        """Return the roots of the fit's weight where only some outputs are measured: least over the others."""
        keys = [row.tobytes() for row in mask > 0]
        for key in set(keys).difference(self._fit_roots):
            self._fit_roots[key] = marginal_root(self._fit, np.frombuffer(key, dtype=bool))[self._fit_at]
        return np.array([self._fit_roots[key] for key in keys])

    def _columns(self, data: WindowData) -> dict[str, Array]:
        """Return the parameters, in the order of `_assemble`."""
        N, K = self.capacity, data.edges.size - 1
        idle = N - K
        lengths = np.diff(data.edges)
        discount = np.exp(-self.weights.eta * (data.edges[-1] - data.edges))
        weight_w = np.ones(N)  # an idle w does nothing and is held at 0
        weight_w[idle:] = discount[1:] * discounted_length(self.weights.eta, lengths)
        sampled = data.mask.any(axis=1)
        zero, roots = np.zeros(self.plant.n_outputs), self._fit_rows(data.mask)
        return {
            "h": np.concatenate([np.zeros(idle), lengths]),
            "u": _padded_in_front(idle, data.inputs[0], data.inputs).ravel(),
            "rise": _padded_in_front(idle, 0 * data.inputs[0], data.later - data.inputs[:-1]).ravel(),
            "t": np.concatenate([np.full(idle, data.edges[0]), data.edges]),
            "y": _padded_in_front(idle, zero, data.y).ravel(),
            "root": _padded_in_front(idle, 0 * roots[0], roots).ravel(),
            "prior": data.prior,
            "P2": np.sqrt(discount[0]) * data.root[self._upper],
            "w": weight_w,
            "v": np.concatenate([np.ones(idle), np.where(sampled, discount, 1.0)]),
            "fit": np.concatenate([np.zeros(idle), np.where(sampled, discount, 0.0)]),
        }

    def _bounds(self) -> tuple[Array, Array]:
        """Return the boxes of X, W and V on all unknowns."""
        N, plant = self.capacity, self.plant
        sides = []
        for k in (0, 1):
            x, w, v = (plant.bounds[key][k] / plant.scales[key] for key in ("states", "disturbances", "noises"))
            own = (self.region.lower, self.region.upper)[k] / plant.signals["states"].scales
            x = np.minimum(x, own) if k else np.maximum(x, own)
            v = v if self.keeps_v else v[:0]
            z = np.broadcast_to(x, (N, self.degree, x.size))
            sides.append(self._pack(ProgramPoint(x, np.tile(v, (N + 1, 1)), np.tile(w, (N, 1)), z)))
        return sides[0], sides[1]

    def _row_bounds(self, data: WindowData) -> tuple[Array, Array]:
        """Return the bounds of the rows: dynamics 0, g at most 0, outputs in Y where they were measured."""
        equal, limited = self._counts
        lowest = np.concatenate([np.zeros(equal), np.full(limited, -np.inf)])
        highest = np.zeros(equal + limited)
        if not self.bounds_y:
            return lowest, highest
        rows = np.zeros((self.capacity + 1, self.plant.n_outputs), dtype=bool)
        rows[self.capacity + 1 - len(data.mask) :] = data.mask > 0
        scale = self.plant.signals["outputs"].scales
        lower, upper = (side / scale for side in self.plant.bounds["outputs"])
        return (
            np.concatenate([lowest, np.where(rows, lower, -np.inf).ravel()]),
            np.concatenate([highest, np.where(rows, upper, np.inf).ravel()]),
        )

    def _pack(self, point: ProgramPoint, idle: float | None = None) -> Array:
        """Return a point as one vector; idle intervals repeat the first state (or hold the value `idle`)."""
        K, N = len(point.w), self.capacity
        still = np.broadcast_to(point.z0, (N - K, self.degree, point.z0.size))
        z = np.concatenate([still if idle is None else np.full(still.shape, idle), point.z])
        w = np.concatenate([np.zeros((N - K, point.w.shape[1])), point.w])
        v = np.concatenate([np.zeros((N - K, point.v.shape[1])), point.v])
        body = np.hstack([w, z.reshape(N, self.degree * point.z0.size), v[1:]])
        return np.concatenate([point.z0, v[0], body.ravel()])

    def _pack_rows(self, guess: WindowSolution) -> Array:
        rows = np.zeros((self.capacity, self.degree * self.plant.n_states))
        rows[self.capacity - len(guess.row_multipliers) :] = guess.row_multipliers
        limits = np.zeros(self._counts[1])  # where g was active is found anew
        if not self.bounds_y:
            return np.concatenate([rows.ravel(), limits])
        outputs = np.zeros((self.capacity + 1, self.plant.n_outputs))
        outputs[self.capacity + 1 - len(guess.output_multipliers) :] = guess.output_multipliers
        return np.concatenate([rows.ravel(), limits, outputs.ravel()])

    def _split(self, vector: object, used: int) -> ProgramPoint:
        """Return the used part of a vector of unknowns."""
        n, q, r, N = self.plant.n_states, self.plant.n_disturbances, self.n_noises, self.capacity
        flat = np.array(vector).ravel()
        body = flat[n + r :].reshape(N, q + n * self.degree + r)
        states = body[:, q : q + n * self.degree].reshape(N, self.degree, n)
        v = np.vstack([flat[None, n : n + r], body[:, q + n * self.degree :]])
        first = states[N - used - 1, -1] if used < N else flat[:n]
        return ProgramPoint(first, v[N - used :], body[N - used :, :q], states[N - used :])

    def _unpack(self, edges: Array, found: dict[str, SX], stats: Tree, seconds: float) -> WindowSolution:
        K, N = edges.size - 1, self.capacity
        word = str(stats["return_status"])
        status: Literal["ok", "infeasible", "solver failed"] = "solver failed"
        if word in ("Solve_Succeeded", "Solved_To_Acceptable_Level"):
            status = "ok"
        elif word == "Infeasible_Problem_Detected":
            status = "infeasible"
        lam = np.array(found["lam_g"]).ravel()
        dynamic, limited = self._counts
        rows = lam[:dynamic].reshape(N, -1)[N - K :]
        outputs = np.zeros((K + 1, self.plant.n_outputs))
        if self.bounds_y:
            outputs = lam[dynamic + limited :].reshape(N + 1, -1)[N - K :]
        return WindowSolution(
            edges=edges,
            point=self._split(found["x"], K),
            bound_multipliers=self._split(found["lam_x"], K),
            row_multipliers=rows,
            output_multipliers=outputs,
            cost=float(found["f"]),
            status=status,
            message=word.replace("_", " ").lower(),
            iterations=int(stats["iter_count"]),
            seconds=seconds,
        )


def _padded_in_front(idle: int, fill: Array, rows: Array) -> Array:
    """Return `rows` behind `idle` rows of `fill`."""
    return np.vstack([np.broadcast_to(fill, (idle, fill.size)), rows])


def _unbounded(plant: NonlinearPlant, key: str) -> bool:
    lower, upper = plant.bounds[key]
    return bool(np.all(np.isinf(lower)) and np.all(np.isinf(upper)))
