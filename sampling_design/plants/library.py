"""Named plants, each with its source: textbook plants, a satellite, a tide gauge, a drug, a helicopter."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import sparse
from scipy.linalg import block_diag

from sampling_design.checkers.strict import likely
from sampling_design.errors import ArgumentError
from sampling_design.plants.plant import Plant, Signals
from sampling_design.plants.sparse import SparsePlant
from sampling_design.records import checks
from sampling_design.records.file_io import check_columns
from sampling_design.records.signatures import checked

# speeds of the tidal constituents [degree/h] and round typical amplitudes [m], of no particular gauge
TIDES = {
    "M2": (28.9841042, 1.0),
    "S2": (30.0, 0.3),
    "N2": (28.4397295, 0.2),
    "K1": (15.0410686, 0.1),
    "O1": (13.9430356, 0.1),
}


def double_integrator() -> Plant:
    """Return x'' = u + w with its position measured: eigenvalue 0 with index 2.

    Examples
    --------
    >>> double_integrator().A
    array([[0., 1.],
           [0., 0.]])
    """
    return _integrators(2, ("position", "velocity"), ("m", "m/s"))


def triple_integrator() -> Plant:
    """Return x''' = u + w with its position measured: eigenvalue 0 with index 3.

    Examples
    --------
    >>> triple_integrator().n_states
    3
    """
    return _integrators(3, ("position", "velocity", "acceleration"), ("m", "m/s", "m/s^2"))


def _integrators(n: int, names: tuple[str, ...], units: tuple[str, ...]) -> Plant:
    last = np.eye(n)[:, -1:]
    unit = ("m/s^2", "m/s^3")[n - 2]
    return Plant(
        np.eye(n, k=1),
        np.eye(n)[:1],
        B=last,
        name=("double_integrator", "triple_integrator")[n - 2],
        states=Signals(names, units),
        outputs=Signals(("position",), ("m",)),
        inputs=Signals(("command",), (unit,)),
        disturbances=Signals(tuple(f"w_{name}" for name in names), tuple(f"{u}/s" for u in units)),
        source="Textbook chain of integrators.",
    )


def oscillator(omega: float = 1.0) -> Plant:
    """Return the undamped oscillator x'' = -omega^2 x + u, position measured: eigenvalues +-i omega.

    Raises ArgumentError if `omega` is not positive.

    Parameters
    ----------
    omega : float [rad/s], positive

    Examples
    --------
    >>> oscillator(2.0).A
    array([[ 0.,  1.],
           [-4.,  0.]])
    """
    omega = checks.positive("omega", omega)
    return Plant(
        [[0.0, 1.0], [-(omega**2), 0.0]],
        [[1.0, 0.0]],
        B=[[0.0], [1.0]],
        name="oscillator",
        states=Signals(("position", "velocity"), ("m", "m/s")),
        outputs=Signals(("position",), ("m",)),
        inputs=Signals(("force_per_mass",), ("m/s^2",)),
        disturbances=Signals(("w_position", "w_velocity"), ("m/s", "m/s^2")),
        source="Textbook harmonic oscillator.",
    )


def satellite(period: float = 5554.0) -> Plant:
    """Return the motion of a satellite relative to a point on a circular orbit (Clohessy-Wiltshire).

        x'' = 3 n^2 x + 2 n y',   y'' = -2 n x',   z'' = -n^2 z,   n = 2 pi / period

    with x radial (away from the Earth), y along-track, z cross-track. Raises ArgumentError if `period` is not positive.

    Parameters
    ----------
    period : float [s], positive
        Orbit period; 5554 s is a low Earth orbit of about 415 km altitude.

    Notes
    -----
    Eigenvalues: 0 with index 2 (the along-track drift), +-i n twice and semisimple (in-plane ellipse and
    cross-track oscillation). Outputs are the three relative positions, as a tracking station resolves
    them from range and two angles while the satellite is in view; a pass lasts about ten minutes of an
    orbit, which is why samples come rarely and in bunches. Along-track position alone would leave the
    cross-track motion unobserved.

    References
    ----------
    W. H. Clohessy and R. S. Wiltshire, Terminal Guidance System for Satellite Rendezvous, Journal of the
    Aerospace Sciences 27(9), 1960.

    Examples
    --------
    >>> plant = satellite()
    >>> bool(np.allclose(plant.transition(5554.0)[4, [0, 1, 2, 3, 5]], 0.0, atol=1e-9))
    True
    """
    n = 2 * np.pi / checks.positive("period", period)
    axes = ("radial", "along_track", "cross_track")
    stiffness = np.diag([3 * n**2, 0.0, -(n**2)])
    coriolis = np.array([[0.0, 2 * n, 0.0], [-2 * n, 0.0, 0.0], [0.0, 0.0, 0.0]])
    push = np.vstack([np.zeros((3, 3)), np.eye(3)])
    return Plant(
        np.block([[np.zeros((3, 3)), np.eye(3)], [stiffness, coriolis]]),
        np.eye(3, 6),
        B=push,
        G=push,
        name="satellite",
        states=Signals((*axes, *(f"v_{a}" for a in axes)), ("m",) * 3 + ("m/s",) * 3, [100.0] * 3 + [0.1] * 3),
        outputs=Signals(axes, ("m",) * 3, [100.0] * 3),
        inputs=Signals(tuple(f"thrust_{a}" for a in axes), ("m/s^2",) * 3, [1e-3] * 3),
        disturbances=Signals(tuple(f"w_{a}" for a in axes), ("m/s^2",) * 3, [1e-5] * 3),
        source="Clohessy and Wiltshire, Terminal Guidance System for Satellite Rendezvous, "
        "Journal of the Aerospace Sciences 27(9), 1960.",
    )


def tidal_gauge() -> Plant:
    """Return the water level at a gauge as a mean and five tidal constituents: n = 11, one output, hours.

        level = mean + sum over M2, S2, N2, K1, O1 of the in-phase part of an oscillator

    Notes
    -----
    All eigenvalues lie on the imaginary axis, in two close groups: S2 and M2 separate in 354 h, M2 and
    N2 in 661 h, so a window must reach over four weeks. S2 has exactly twelve hours: readings at one
    clock time each day see it as a constant. Scales are round typical amplitudes.

    References
    ----------
    P. Schureman, Manual of Harmonic Analysis and Prediction of Tides, US Coast and Geodetic Survey
    Special Publication 98, 1940 (speeds of the constituents).

    Examples
    --------
    >>> plant = tidal_gauge()
    >>> plant.n_states, plant.time_unit
    (11, 'h')
    """
    A = np.zeros((11, 11))
    names, scales = ["mean"], [0.5]
    for k, (constituent, (speed, amplitude)) in enumerate(TIDES.items()):
        omega = np.deg2rad(speed)
        A[1 + 2 * k, 2 + 2 * k], A[2 + 2 * k, 1 + 2 * k] = omega, -omega
        names += [f"{constituent}_in_phase", f"{constituent}_quadrature"]
        scales += [amplitude, amplitude]
    C = np.zeros((1, 11))
    C[0, 0] = C[0, 1::2] = 1.0
    return Plant(
        A,
        C,
        time_unit="h",
        name="tidal_gauge",
        states=Signals(tuple(names), ("m",) * 11, scales),
        outputs=Signals(("level",), ("m",)),
        disturbances=Signals(tuple(f"w_{n}" for n in names), ("m/h",) * 11, np.array(scales) / 100),
        source="Constituent speeds: Schureman, Manual of Harmonic Analysis and Prediction of Tides, "
        "US Coast and Geodetic Survey Special Publication 98, 1940. Amplitudes: round typical values.",
    )


def cart_pendulum() -> Plant:
    """Return an inverted pendulum on a cart, linearised upright; cart position and angle are measured.

        (M + m) p'' + b p' - m l a'' = u + w_1,    (I + m l^2) a'' - m g l a - m l p'' = w_2

    Notes
    -----
    M = 0.5 kg cart, m = 0.2 kg pendulum with l = 0.3 m to its centre of mass and I = 0.006 kg m^2,
    b = 0.1 N s/m friction, g = 9.81 m/s^2. One eigenvalue is zero (where the cart stands), one
    unstable near 5.6 1/s, two stable. Disturbances: a force on the cart and a torque on the pendulum.

    References
    ----------
    University of Michigan, Control Tutorials for MATLAB and Simulink: Inverted Pendulum (parameters).

    Examples
    --------
    >>> plant = cart_pendulum()
    >>> int(np.sum(np.linalg.eigvals(plant.A).real > 1))
    1
    """
    M, m, b, l, I, g = 0.5, 0.2, 0.1, 0.3, 0.006, 9.81
    total, inertia, coupling = M + m, I + m * l**2, m * l
    det = total * inertia - coupling**2
    # accelerations = [[inertia, coupling], [coupling, total]] / det times (force, torque)
    G = np.array([[0.0, 0.0], [inertia, coupling], [0.0, 0.0], [coupling, total]]) / det
    A = np.outer(G[:, 0], [0.0, -b, 0.0, 0.0]) + np.outer(G[:, 1], [0.0, 0.0, m * g * l, 0.0])
    A[0, 1] = A[2, 3] = 1.0
    return Plant(
        A,
        np.eye(4)[::2],
        B=G[:, :1],
        G=G,
        name="cart_pendulum",
        states=Signals(
            ("position", "velocity", "angle", "angular_rate"), ("m", "m/s", "rad", "rad/s"), [0.1, 0.1, 0.05, 0.1]
        ),
        outputs=Signals(("position", "angle"), ("m", "rad"), [0.1, 0.05]),
        inputs=Signals(("force",), ("N",)),
        disturbances=Signals(("w_force", "w_torque"), ("N", "N m"), [0.1, 0.01]),
        source="Parameters: University of Michigan, Control Tutorials for MATLAB and Simulink, Inverted Pendulum "
        "(with g = 9.81 m/s^2).",
    )


def three_compartment(weight: float = 70.0) -> Plant:
    """Return a three-compartment model of propofol: amounts in mg, plasma concentration measured, minutes.

        a1' = -(k10 + k12 + k13) a1 + k21 a2 + k31 a3 + u,   a2' = k12 a1 - k21 a2,   a3' = k13 a1 - k31 a3
        concentration = a1 / V1

    Raises ArgumentError if `weight` is not positive.

    Parameters
    ----------
    weight : float [kg], positive
        Body weight; V1 = 0.228 L/kg.

    Notes
    -----
    k10 = 0.119, k12 = 0.112, k13 = 0.042, k21 = 0.055, k31 = 0.0033 1/min. All eigenvalues are real and
    negative, so that nothing need be measured unless a `decay_rate` is asked for.

    References
    ----------
    B. Marsh, M. White, N. Morton, G. N. C. Kenny, Pharmacokinetic model driven infusion of propofol in
    children, British Journal of Anaesthesia 67, 1991 (its adult parameters).

    Examples
    --------
    >>> np.sort(np.linalg.eigvals(three_compartment().A)).round(4)
    array([-0.2987, -0.0302, -0.0024])
    """
    V1 = 0.228 * checks.positive("weight", weight)
    k10, k12, k13, k21, k31 = 0.119, 0.112, 0.042, 0.055, 0.0033
    compartments = ("central", "fast", "slow")
    return Plant(
        [[-(k10 + k12 + k13), k21, k31], [k12, -k21, 0.0], [k13, 0.0, -k31]],
        [[1 / V1, 0.0, 0.0]],
        B=[[1.0], [0.0], [0.0]],
        time_unit="min",
        name="three_compartment",
        states=Signals(compartments, ("mg",) * 3, [50.0, 100.0, 500.0]),
        outputs=Signals(("concentration",), ("mg/L",), [3.0]),
        inputs=Signals(("infusion",), ("mg/min",), [10.0]),
        disturbances=Signals(tuple(f"w_{c}" for c in compartments), ("mg/min",) * 3, [1.0, 1.0, 1.0]),
        source="Marsh, White, Morton, Kenny, Pharmacokinetic model driven infusion of propofol in children, "
        "British Journal of Anaesthesia 67, 1991 (rate constants and V1 as quoted for the Marsh model).",
    )


def helicopter_he1() -> Plant:
    """Return the longitudinal motion of a VTOL helicopter, problem HE1 of COMPleib; vertical speed measured.

    Notes
    -----
    One unstable pair near 0.276 +- 0.258i 1/s and two stable real eigenvalues. Speeds are in knots, the
    pitch rate in degree/s, the pitch angle in degrees; G is the disturbance input of the collection.

    References
    ----------
    F. Leibfritz, COMPleib: COnstrained Matrix-optimization Problem library, problem HE1, after S. N. Singh
    and A. A. R. Coelho, Journal of Dynamic Systems, Measurement and Control 106, 1984.

    Examples
    --------
    >>> int(np.sum(np.linalg.eigvals(helicopter_he1().A).real > 0))
    2
    """
    return Plant(
        [
            [-0.0366, 0.0271, 0.0188, -0.4555],
            [0.0482, -1.01, 0.0024, -4.0208],
            [0.1002, 0.3681, -0.707, 1.42],
            [0.0, 0.0, 1.0, 0.0],
        ],
        [[0.0, 1.0, 0.0, 0.0]],
        B=[[0.4422, 0.1761], [3.5446, -7.5922], [-5.52, 4.49], [0.0, 0.0]],
        G=[[4.678e-2, 0.0], [4.572e-2, 9.88e-3], [4.369e-2, 1.11e-3], [-2.179e-2, 0.0]],
        name="helicopter_he1",
        states=Signals(
            ("horizontal_speed", "vertical_speed", "pitch_rate", "pitch_angle"), ("kn", "kn", "deg/s", "deg")
        ),
        outputs=Signals(("vertical_speed",), ("kn",)),
        inputs=Signals(("collective", "longitudinal_cyclic")),
        disturbances=Signals(("gust_1", "gust_2")),
        source="Leibfritz, COMPleib, problem HE1, after Singh and Coelho, Nonlinear control of mismatched uncertain "
        "linear systems and application to control of aircraft, Journal of Dynamic Systems, Measurement and Control "
        "106, 1984.",
    )


@checked
def plant_of_modes(
    oscillations: Sequence[float] = (),
    decays: Sequence[float] = (),
    *,
    level: bool = True,
    sensors: Sequence[str] = ("sensor",),
    units: Sequence[str] = (),
    names: Sequence[str] = (),
    time_unit: str = "h",
    name: str = "",
) -> Plant:
    """Return the plant of a constant level, undamped oscillations and decaying modes; every sensor shows their sum.

    Parameters
    ----------
    oscillations, decays : sequence of float [time]
        Periods of undamped oscillations, and times in which a decaying mode falls to a third.
    level : bool
    sensors, units, names : sequence of str
        The outputs; units of each, or one for all, which the states then have too; names of the level, the oscillations
        and the decaying modes, in this order, instead of level, oscillation_1, ...
    time_unit, name : str

    Returns
    -------
    Plant

    Raises
    ------
    ArgumentError
        If nothing moves or is measured, a time is not positive, a name comes twice or cannot be a column of a file, or
        there is another number of names or units.

    Examples
    --------
    >>> plant_of_modes([24.0], [6.0]).states.names
    ('level', 'oscillation_1', 'oscillation_1_quadrature', 'decaying_1')
    """
    if not len(oscillations) and not len(decays):
        raise ArgumentError("`oscillations` or `decays` must name a time, or nothing moves.")
    rates = [2 * np.pi / checks.positive(f"oscillations[{k}]", length) for k, length in enumerate(oscillations)]
    losses = [np.log(3.0) / checks.positive(f"decays[{k}]", time) for k, time in enumerate(decays)]
    turning = [[[0.0, rate], [-rate, 0.0]] for rate in rates]
    A = block_diag(*[[[0.0]]] * level, *turning, *[[[-rate]] for rate in losses])
    row = np.concatenate([[1.0] * level, [1.0, 0.0] * len(rates), [1.0] * len(losses)])
    usual = [f"{kind}_{k + 1}" for kind, of in (("oscillation", rates), ("decaying", losses)) for k in range(len(of))]
    called = checks.names("names", list(names) or ["level"] * level + usual, level + len(usual), "")
    turns = [f"{mode}{part}" for mode in called[level : level + len(rates)] for part in ("", "_quadrature")]
    states = [*called[:level], *turns, *called[level + len(rates) :]]
    if not len(sensors):
        raise ArgumentError("`sensors` must name at least one: a plant without outputs cannot be measured.")
    sensors = checks.names("sensors", sensors, len(sensors), "")
    check_columns("sensors", sensors)
    C, shared = np.tile(row, (len(sensors), 1)), units[0] if len(set(units)) == 1 else ""
    outputs = Signals(sensors, [shared] * len(sensors) if len(units) == 1 else units)
    return Plant(A, C, time_unit=time_unit, states=Signals(states, [shared] * len(states)), outputs=outputs, name=name)


PLANTS: dict[str, Callable[[], Plant]] = {
    make.__name__: make
    for make in (
        double_integrator,
        triple_integrator,
        oscillator,
        satellite,
        tidal_gauge,
        cart_pendulum,
        three_compartment,
        helicopter_he1,
    )
}


@checked
def named_plant(name: str) -> Plant:
    """Return a plant of the library by its name.

    Parameters
    ----------
    name : str
        A key of `PLANTS`, such as "satellite".

    Returns
    -------
    Plant

    Raises
    ------
    ArgumentError
        If there is no such plant; the nearest name is offered, or all where none is near.

    Examples
    --------
    >>> named_plant("oscillator").n_states
    2
    """
    if name not in PLANTS:
        raise ArgumentError(f"`name` must be a plant of the library, got {name!r}. {likely(str(name), PLANTS)}")
    return PLANTS[name]()


def heat_plate(side: int = 100, *, sensors: int = 4) -> SparsePlant:
    """Return an insulated square plate of `side` x `side` cells, its temperature measured at a few of them.

    Edge 1 m, diffusivity 1e-4 m^2/s, time in minutes: x' = k Laplacian x, Neumann boundary. Its eigenvalues are sums
    of two of -4 k side^2 sin^2(pi j/(2 side)), j = 0 .. side - 1, and most appear twice.

    Examples
    --------
    >>> heat_plate(10).n_states
    100
    """
    side = checks.whole("side", side, 2)
    sensors = checks.whole("sensors", sensors, 1)
    ring = np.ones(side)
    ring[[0, -1]] = 0.5
    line = sparse.diags_array([np.ones(side - 1), -2 * ring, np.ones(side - 1)], offsets=[-1, 0, 1])
    eye = sparse.eye_array(side)
    cells = (side * ((np.arange(sensors) * 7 + 3) % side) + (np.arange(sensors) * 4 + 1) % side) % side**2
    C = sparse.csr_array((np.ones(sensors), (np.arange(sensors), cells)), shape=(sensors, side**2))
    return SparsePlant(
        60 * 1e-4 * side**2 * (sparse.kron(line, eye) + sparse.kron(eye, line)),
        C,
        time_unit="min",
        name="heat_plate",
        outputs=Signals(tuple(f"T{i + 1}" for i in range(sensors)), ("K",) * sensors),
    )


def droop_network(nodes: int = 2000, *, meters: int = 6, seed: int = 1) -> SparsePlant:
    """Return a grid-like network of droop-controlled sources: d_i theta_i' = -sum b_ij (theta_i - theta_j) + w.

    Nodes at random in the plane, joined to near neighbours as lines of a transmission grid are (Delaunay edges, the
    longest left out); phase angles measured at a few nodes. d_i in 0.5 to 2 s, b_ij in 0.5 to 2. One mode stays, the
    angle that all share, and the slow ones sway between regions.

    References
    ----------
    Simpson-Porco, Doerfler, Bullo, Automatica 49(9), 2013 (droop-controlled networks).

    Examples
    --------
    >>> droop_network(50).n_states
    50
    """
    from scipy.spatial import Delaunay

    nodes = checks.whole("nodes", nodes, 10)
    meters = checks.whole("meters", meters, 1)
    rng = np.random.default_rng(checks.whole("seed", seed))
    places = rng.uniform(size=(nodes, 2))
    corners = Delaunay(places).simplices
    pairs = np.unique(
        np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [0, 2]]]), axis=1), axis=0
    )
    length = np.linalg.norm(places[pairs[:, 0]] - places[pairs[:, 1]], axis=1)
    tree = sparse.csgraph.minimum_spanning_tree(sparse.csr_array((length, pairs.T), shape=(nodes, nodes))).tocoo()
    near = pairs[length <= np.quantile(length, 0.7)]
    edges = np.unique(np.concatenate([near, np.sort(np.stack([tree.row, tree.col], axis=1), axis=1)]), axis=0)
    b = rng.uniform(0.5, 2.0, len(edges))
    W = sparse.csr_array((b, edges.T), shape=(nodes, nodes))
    W = W + W.T
    chosen = np.sort(rng.choice(nodes, meters, replace=False))
    return SparsePlant(
        W - sparse.diags_array(np.asarray(W.sum(axis=1)).ravel()),
        sparse.csr_array((np.ones(meters), (np.arange(meters), chosen)), shape=(meters, nodes)),
        mass=rng.uniform(0.5, 2.0, nodes),
        time_unit="s",
        name="droop_network",
        outputs=Signals(tuple(f"angle_{i}" for i in chosen), ("rad",) * meters),
    )
