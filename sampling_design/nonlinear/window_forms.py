"""The functions of a window at one point, interval by interval and node by node, with first and second derivatives.

And what a solved window leaves unknown, to first order: covariances at its nodes, and what errors on the way do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from scipy.linalg import lapack

from sampling_design.estimators.gap_flows.flows import discounted_length
from sampling_design.nonlinear.functions import casadi
from sampling_design.nonlinear.weights import NonlinearWeights
from sampling_design.numerics.filtering import propagate
from sampling_design.records.arrays import Array

if TYPE_CHECKING:
    from casadi import Function

PARTS = 4  # lengths for which a window's functions are mapped: while it fills, less is evaluated; each takes memory


class WindowData(NamedTuple):
    """One window of K intervals in scaled coordinates; row j of nodes lies at `edges[j]`.

    edges (K+1,) absolute times; inputs (K+1, m) physical, from each node on; later (K, m) what they have become at the
    end of each interval; y (K+1, p) with 0 where `mask` (K+1, p) is 0; prior (n,), and the upper triangular root (n, n)
    of what its error weighs, not discounted.
    """

    edges: Array
    inputs: Array
    later: Array
    y: Array
    mask: Array
    prior: Array
    root: Array


class ProgramPoint(NamedTuple):
    """Values of the unknowns, or of their multipliers: z0 (n,), v (K+1, r), w (K, q), z (K, degree, n)."""

    z0: Array
    v: Array
    w: Array
    z: Array


class WindowSolution(NamedTuple):
    """What came out: the unknowns and the multipliers (of bounds, dynamics, outputs), and how."""

    edges: Array
    point: ProgramPoint
    bound_multipliers: ProgramPoint
    row_multipliers: Array
    output_multipliers: Array
    cost: float
    status: Literal["ok", "infeasible", "solver failed"]
    message: str
    iterations: int
    seconds: float
    engine: Literal["ipopt", "newton"] = "ipopt"

    @property
    def last(self) -> Array:
        """Scaled state at the window's end."""
        return self.point.z[-1, -1] if len(self.point.z) else self.point.z0

    @property
    def nodes(self) -> Array:
        """Scaled states at the edges, (K+1, n)."""
        return np.vstack([self.point.z0[None], self.point.z[:, -1]])


class WindowSlopes(NamedTuple):
    """A window linearised at its solution, scaled.

    F (K, n, n) and G (K, n, q) carry a state and w over each interval; H (K+1, p, n) is the slope of the outputs at the
    nodes, outputs (K+1, p) what they are; roots (K+1, p, p) of their weights, zero where nothing was measured.
    """

    F: Array
    G: Array
    H: Array
    outputs: Array
    roots: Array


class LocalForms(NamedTuple):
    """A window at one point, scaled: K intervals with d Radau points, K + 1 nodes, s = (x, w) and e = (x, v).

    rows (K, d, n): what the collocation equations leave; inside (K, d n, d n), before (K, d n, n), by_w (K, d n, q):
    their slopes by the states inside, the state before and w; curve (K, d, n + q, n + q): second derivatives by s of
    the rows at each point times their multipliers; cost, and by node its gradient (K+1, n + r) and second derivatives
    (K+1, n + r, n + r) by e; outputs (K+1, p) and its slope H (K+1, p, n) by x.
    """

    rows: Array
    inside: Array
    before: Array
    by_w: Array
    curve: Array
    cost: float
    gradient: Array
    bend: Array
    outputs: Array
    H: Array

    def carried(self) -> Array:
        """Return dZ of (dx, 1, dw) such that the linearised rows hold, (K, d n, n + 1 + q)."""
        K, size = self.inside.shape[:2]
        known = np.concatenate([self.before, self.rows.reshape(K, size, 1), self.by_w], axis=2)
        return np.asarray(-np.linalg.solve(self.inside, known))


class WindowFunctions:
    """Evaluates `LocalForms`: one call for all Radau points and one for all nodes.

    `rate` is the scaled x' of (x, w, u, t); `node` the cost at a node and the scaled output, of (x, v, u, t, y, root,
    fit, v_weight).
    """

    def __init__(self, rate: Function, node: Function, points: Array, capacity: int) -> None:
        ca = casadi()
        self.points, self.capacity = points, capacity
        self._along = np.array(ca.collocation_coeff(list(points))[0])
        n, q = rate.size1_in(0), rate.size1_in(1)
        self._before = np.kron(self._along[0][:, None], np.eye(n))
        x, w, u, t = (ca.SX.sym(name, rate.size1_in(k)) for k, name in enumerate("xwut"))
        weigh, both = ca.SX.sym("weigh", n), ca.vertcat(x, w)
        value = rate(x, w, u, t)
        parts = [value, ca.jacobian(value, both), ca.hessian(ca.dot(weigh, value), both)[0]]
        self._inside = ca.Function("inside", [x, w, u, t, weigh], [ca.densify(part) for part in parts])
        arguments = [ca.SX.sym(f"a{k}", node.size1_in(k)) for k in range(node.n_in())]
        cost, outputs = node(*arguments)
        bend, gradient = ca.hessian(cost, ca.vertcat(*arguments[:2]))
        parts = [cost, gradient, bend, outputs, ca.jacobian(outputs, arguments[0])]
        self._at_node = ca.Function("at_node", arguments, [ca.densify(part) for part in parts])
        self.sizes = n, q, node.size1_in(1), node.size1_out(1)
        self._mapped: dict[int, tuple[_PaddedMap, _PaddedMap, _PaddedMap]] = {}

    def _maps(self, K: int) -> tuple[_PaddedMap, _PaddedMap, _PaddedMap]:
        """What maps Radau points, nodes and the recursion of `eliminated`: for K intervals rounded up to a quarter."""
        quarters = max(-(-PARTS * K // self.capacity), 1)
        found = self._mapped.get(quarters)
        if found is None:
            most, (n, q, _, _) = -(-quarters * self.capacity // PARTS), self.sizes
            within, nodes = most * self.points.size, most + 1
            found = self._mapped[quarters] = (
                _PaddedMap(self._inside.map(within), within),
                _PaddedMap(self._at_node.map(nodes), nodes),
                _PaddedMap(_riccati(n + 1, q, nodes), nodes),
            )
        return found

    def eliminated(self, over: Array, interval: Array, at: Array) -> tuple[Array, Array]:
        """Minimise over w from the last node to the first: what lies ahead costs at least, and the gains of w.

            P <- L'PL + M = [[a, b'], [b, c]],    g = c^-1 b,    P <- a - b'g + N

        over (K, one, one + q) holds L, interval (K, one + q, one + q) M, at (K + 1, one, one) N. Not finite from the
        first node on where some c is not positive definite.
        """
        K, one, both = over.shape
        ahead, own = np.zeros((K + 1, one, both)), np.zeros((K + 1, both, both))
        ahead[1:], own[1:], own[0] = over[::-1], interval[::-1], np.eye(both)
        own[0, :one, :one] = 0.0  # nothing lies ahead of the last node
        values, gains = self._maps(K)[2](ahead, own, at[::-1])
        gains = gains.reshape(K + 1, one, both - one).transpose(0, 2, 1)
        return values.reshape(K + 1, one, one)[::-1], gains[:0:-1]

    def at(self, data: WindowData, point: ProgramPoint, multipliers: Array, columns: dict[str, Array]) -> LocalForms:
        """Return the forms at a point; `multipliers` (K, d, n) of its rows, `columns` what the program is given."""
        n, q, r, p = self.sizes
        K, N, d = data.edges.size - 1, self.capacity, self.points.size
        h = np.diff(data.edges)
        rise = data.later - data.inputs[:-1]
        u = data.inputs[:-1, None] + self.points[:, None] * rise[:, None]
        t = data.edges[:-1, None] + h[:, None] * self.points
        w = np.broadcast_to(point.w[:, None], (K, d, q))
        weigh = -h[:, None, None] * multipliers
        map_inside, map_nodes, _ = self._maps(K)
        rate, slope, curve = map_inside(point.z, w, u, t, weigh)
        nodes = np.concatenate([point.z0[None], point.z[:, -1]])
        along = np.einsum("kjn,ji->kin", np.concatenate([nodes[:-1, None], point.z], axis=1), self._along)
        slope = slope.reshape(K, d, n + q, n).transpose(0, 1, 3, 2)
        inside = np.zeros((K, d, n, d, n))
        each = np.arange(n)
        inside[:, :, each, :, each] = self._along[1:].T
        each = np.arange(d)
        inside[:, each, :, each] -= (h[:, None, None, None] * slope[..., :n]).transpose(1, 0, 2, 3)
        by_w = -h[:, None, None] * slope[..., n:].reshape(K, d * n, q)
        root, fit, v = (columns[key].reshape(N + 1, -1)[N - K :] for key in ("root", "fit", "v"))
        cost, gradient, bend, outputs, H = map_nodes(nodes, point.v, data.inputs, data.edges, data.y, root, fit, v)
        return LocalForms(
            rows=along - h[:, None, None] * rate.reshape(K, d, n),
            inside=inside.reshape(K, d * n, d * n),
            before=np.broadcast_to(self._before, (K, d * n, n)),
            by_w=by_w,
            curve=curve.reshape(K, d, n + q, n + q),
            cost=float(cost.sum()),
            gradient=gradient,
            bend=bend.reshape(K + 1, n + r, n + r),
            outputs=outputs,
            H=H.reshape(K + 1, n, p).transpose(0, 2, 1),
        )


def _riccati(one: int, q: int, steps: int) -> Function:
    """Return the recursion of `WindowFunctions.eliminated` over so many steps, of its transposed L, M and N."""
    ca = casadi()
    c, b = ca.SX.sym("c", q, q), ca.SX.sym("b", q, one)
    upper = ca.chol(c)  # no number where c is not positive definite
    gains = ca.Function("gains", [c, b], [ca.densify(ca.solve(upper, ca.solve(upper.T, b)))])
    P, L = ca.MX.sym("P", one, one), ca.MX.sym("L", one + q, one)
    M, N = ca.MX.sym("M", one + q, one + q), ca.MX.sym("N", one, one)
    ahead = ca.mtimes([L, P, L.T]) + M
    g = gains(ahead[one:, one:], ahead[one:, :one]) if q else ca.MX(0, one)
    least = ahead[:one, :one] - ca.mtimes(ahead[:one, one:], g) + N
    over = ca.Function("step", [P, L, M, N], [least, g]).mapaccum(steps)
    given = [ca.MX.sym("given", *over.size_in(k)) for k in range(1, 4)]
    found: Function = ca.Function("riccati", given, over(ca.DM.zeros(one, one), *given))
    return found


class _PaddedMap:
    """A mapped function of arrays with a row for each of its steps; missing rows repeat the first, in front."""

    def __init__(self, function: Function, columns: int) -> None:
        self._owner, self.columns = function, columns  # casadi's buffer does not keep the function alive
        self._buffer, self._call = function.buffer()
        self.given = [np.zeros((columns, function.nnz_in(k) // columns)) for k in range(function.n_in())]
        self.found = [np.zeros((columns, function.nnz_out(k) // columns)) for k in range(function.n_out())]
        for k, array in enumerate(self.given):
            if array.size:
                self._buffer.set_arg(k, array.data)  # type: ignore[call-arg]
        for k, array in enumerate(self.found):
            if array.size:
                self._buffer.set_res(k, array.data)  # type: ignore[call-arg]

    def __call__(self, *arrays: Array) -> list[Array]:
        used = 0
        for array, value in zip(self.given, arrays, strict=True):
            if array.size:
                rows = value.reshape(-1, array.shape[1])
                used = len(rows)
                array[self.columns - used :] = rows
                array[: self.columns - used] = rows[0] if used else 0.0
        self._call()
        return [array[self.columns - used :].copy() for array in self.found]


class WindowCovariances(NamedTuple):
    """Filtered covariances of a window as roots, scaled, discounted to each node's own time.

    filtered (K+1, n, n) with S S' = Y after the samples of each node, grown (K+1, n, n) before them; noise (K, n, n):
    root of what an interval adds; bias (n,): what the given jumps of the state make of the last estimate.
    """

    filtered: Array
    grown: Array
    noise: Array
    bias: Array

    @property
    def last(self) -> Array:
        """Covariance at the window's end, (n, n)."""
        return np.asarray(self.filtered[-1] @ self.filtered[-1].T)


def window_covariances(
    edges: Array, slopes: WindowSlopes, root: Array, weights: NonlinearWeights, jumps: Array | None = None
) -> WindowCovariances:
    """Return the covariances of a window, without its boxes.

        Y <- e^{eta h} F Y F' + G (Qw int e^{-eta s} ds)^-1 G',    Y^-1 <- Y^-1 + H'WH at a sample

    Parameters
    ----------
    edges : (K+1,) array
    root : (n, n) array
        Upper triangular; its square weighs the error at the window's start.
    jumps : (K, n) array, optional
        Added to the state at the end of each interval; `bias` is what the estimator makes of them.
    """
    n, lengths = root.shape[0], np.diff(edges)
    upper = np.triu(np.ones((n, n)))
    S = lapack.dtrtri(root)[0]
    noise_flow, growth = np.zeros((len(lengths), n, n)), np.exp(weights.eta * lengths / 2)[:, None, None] * slopes.F
    if len(lengths) and slopes.G.shape[2]:
        lower = np.linalg.cholesky(weights.twice * weights.Qw)
        worth = np.sqrt(discounted_length(weights.eta, lengths))[:, None, None]
        noise_roots = np.linalg.solve(lower, slopes.G.transpose(0, 2, 1)) / worth
        triangle: Array = np.asarray(np.linalg.qr(noise_roots, mode="r"), dtype=np.float64)
        noise_flow[:, :, : triangle.shape[1]] = triangle.transpose(0, 2, 1)
    filtered, grown = np.empty((len(edges), n, n)), np.empty((len(edges), n, n))
    bias, whitened_rows = np.zeros(n), slopes.roots @ slopes.H
    measured: list[bool] = [bool(root.any()) for root in slopes.roots]
    for k in range(len(edges)):
        if k:
            wide = np.concatenate([growth[k - 1].dot(S).T, noise_flow[k - 1].T])
            factor = lapack.dgeqrf(wide)[0]
            S = (factor[:n] * upper).T
            if jumps is not None:
                bias = slopes.F[k - 1].dot(bias) + jumps[k - 1]
        grown[k] = S
        if measured[k]:
            A = whitened_rows[k].dot(S)
            information = A.T.dot(A)
            information.flat[:: n + 1] += 1.0
            half = lapack.dtrtri(lapack.dpotrf(information, clean=1)[0])[0]
            S = S.dot(half)
            if jumps is not None:
                bias = bias - S.dot(A.dot(half).T.dot(whitened_rows[k].dot(bias)))
        filtered[k] = S
    return WindowCovariances(filtered, grown, noise_flow, bias)


def smoothed_covariances(covariances: WindowCovariances, slopes: WindowSlopes, edges: Array, eta: float) -> Array:
    """Return the covariances (K+1, n, n) at all nodes, given all samples, discounted to the window's end.

    Y_j = (I - J F) Y (I - J F)' + J (Y_{j+1} + N) J',    J = Y F' (F Y F' + N)^-1
    """
    found = np.empty_like(covariances.filtered)
    found[-1] = covariances.last
    n = found.shape[1]
    for k in range(len(edges) - 2, -1, -1):
        growth = np.exp(eta * (edges[-1] - edges[k]))
        root, F = np.sqrt(growth) * covariances.filtered[k], slopes.F[k]
        noise = np.sqrt(np.exp(eta * (edges[-1] - edges[k + 1]))) * covariances.noise[k]
        ahead = F @ root
        # J' solves (F Y F' + N) J' = F Y, here as a least-squares problem of the roots
        both = np.hstack([ahead, noise])
        gain = root @ np.linalg.lstsq(both, np.eye(n), rcond=None)[0][: root.shape[1]]
        rest = root - gain @ ahead
        found[k] = propagate(found[k + 1] + noise @ noise.T, gain, rest @ rest.T)
    return found
