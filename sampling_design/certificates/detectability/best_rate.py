"""Detectability (Thm 10): the best rate and gains from the dissipation inequality, and the constants of the proof."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cho_factor, cho_solve, solve_continuous_lyapunov

from sampling_design.certificates.detectability.dissipation import DetectabilityCertificate, proven
from sampling_design.certificates.form.horizon import Constant, ConstantList
from sampling_design.errors import ArgumentError, CertificateError, NotDetectableError, SolverError
from sampling_design.numerics.filtering import stationary_covariance
from sampling_design.numerics.linalg import symmetrise
from sampling_design.observability.count.functional import part_for
from sampling_design.observability.count.pbh import unobservable_modes
from sampling_design.plants.functional import Wanted
from sampling_design.plants.plant import Plant
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.record import below, short
from sampling_design.records.signatures import checked

MARGIN = 1e-4
"""The inequality is solved at the rate (1 + margin) eta and claimed at eta: strict by far more than rounding."""
STATED = 0.25
"""Part of that margin which the certificate states: (1 + STATED margin) eta is the rate that `verify` proves."""
FLOOR = 1e-3  # part of |G|^2 added as noise in every direction: one that no noise reaches would get infinite weight
NOISE_GAIN = 10.0  # c_w and c_y at most this many times the least that any positive rate asks for
RATE_TOLERANCE = 1e-5  # relative width at which the bisection on the rate ends; the lower end is certified
ROUNDING = 1e-9
"""Constants of the proof are moved to the safe side by this part of themselves: the Young inequality may be tight."""

_NO_SOLUTION = (
    "The Riccati equation at rate {rate} has no stabilising solution in floating point. "
    "An unobservable mode is too close to the limit: ask for a smaller rate or a smaller `margin`."
)
_TOO_LARGE = (
    "The gains at rates close to zero, times the noise gain {noise_gain}, are not finite with the floor {floor}: "
    "ask for a smaller `noise_gain` or `floor`."
)


@checked
def certify_detectability(
    plant: Plant,
    eta: float | None = None,
    *,
    c_w: float | None = None,
    c_y: float | None = None,
    noise_gain: float = NOISE_GAIN,
    margin: float = MARGIN,
    floor: float = FLOOR,
    of: Wanted = None,
) -> DetectabilityCertificate:
    """Certify exponential i-iIOSS with explicit constants.

        [[A'P + PA + eta P - c_y C'C, PG], [G'P, -c_w I]] < 0,   P >= I

    Parameters
    ----------
    plant : Plant
    eta : float [1/time_unit], optional
        The rate asked for; the least gains at it are returned. Default: the largest rate whose gains stay within
        the bounds (for an observable pair the rate alone has no maximum).
    c_w, c_y : float, optional
        Bounds on the gains, both or neither. Default: `noise_gain` times their least at rates close to zero.
    noise_gain : float
        See there; only used without `eta` and bounds.
    margin : float
        The inequality is solved at the rate (1 + margin) eta, and stated, with strict proof, at (1 + margin/4) eta.
    floor : float
        Noise in every direction, relative to |G|^2, that keeps P well conditioned; 0 for the exact optimum.
    of : str, sequence of str, or (k, n) array, optional
        Only these rows of the state: names of states or outputs, or the rows themselves (`functional_plant`).
        Default: all states.

    Returns
    -------
    DetectabilityCertificate
        It has passed its own `verify`.

    Raises
    ------
    NotDetectableError
        If a mode that no output sees does not decay at the rate asked for; carries eigenvalues and directions.
    CertificateError
        If the bounds are too small for the rate; says what they would have to be.
    SolverError
        If the Riccati equation cannot be solved.

    Notes
    -----
    *Method.* With P = c_y X the inequality reads A'X + XA + eta X - C'C + r X G G' X <= 0, r = c_y/c_w, and
    X = Y^{-1} is the information of the Kalman-Bucy filter of the shifted plant (A + eta/2 I, C) with noise
    r GG': the stabilising Y is the least of all solutions, so that P >= I is possible iff c_y >= lambda_max(Y).
    Hence the least gains at a rate are one Riccati equation, and the best rate under bounds is a bisection on a
    monotone function. *Claim.* Decided by eigenvalues of the dissipation matrix, never by the word of a solver.
    Without bounds the ratio c_y/c_w is |A|^2/(|C| |G|)^2, which follows the units of output and disturbance.
    *Assumptions.* Gains are in the plant's own coordinates; for scaled ones pass `plant.scaled()`.

    References
    ----------
    The paper, Definition 1 and Theorem 10; theory 1.2, E1.

    Examples
    --------
    An unobservable mode e^{-0.3 t} limits the rate to 0.6:

    >>> plant = Plant([[0.5, 0.0], [0.0, -0.3]], [[1.0, 0.0]])
    >>> certify_detectability(plant, eta=0.59).verify().passed
    True
    >>> certify_detectability(plant, eta=0.61)
    Traceback (most recent call last):
        ...
    sampling_design.errors.NotDetectableError: ... -0.3 ...
    """
    plant = part_for(plant, of, decay_rate=eta)
    _refuse_no_states(plant)
    if (c_w is None) != (c_y is None):
        raise ArgumentError("`c_w` and `c_y` must be bounded together or not at all: one can be traded for the other.")
    noise_gain, margin = checks.positive("noise_gain", noise_gain), checks.positive("margin", margin)
    floor = checks.nonnegative("floor", floor)
    eta = None if eta is None else checks.positive("eta", eta)
    refuse_undetectable(plant, 0.0 if eta is None else eta)
    unit_w, unit_y = _units(plant)
    bounds = None if c_w is None or c_y is None else (checks.positive("c_w", c_w), checks.positive("c_y", c_y))
    ratio = unit_y / unit_w if bounds is None else checks.positive("c_y / c_w", bounds[1] / bounds[0])

    def least(at: float) -> float:
        """Least c_y for P >= I at this rate with c_w = c_y/ratio; infinite where none exists."""
        Y = _filter(plant, at * (1 + margin), ratio, floor)
        return float("inf") if Y is None else float(np.linalg.eigvalsh(Y)[-1])

    if eta is None:
        allowed = noise_gain * least(0.0) if bounds is None else bounds[1]
        if not np.isfinite(allowed):
            raise SolverError(_TOO_LARGE.format(noise_gain=short(noise_gain), floor=short(floor)))
        eta = _largest_rate(least, allowed, float(np.linalg.norm(plant.A, 2)) or 1.0)
        gain_y = allowed
    else:
        gain_y = least(eta) if bounds is None else bounds[1]
        if not np.isfinite(gain_y):
            raise SolverError(_NO_SOLUTION.format(rate=short(eta * (1 + margin))))
        _within(least, eta, gain_y, ratio)
    P, gain = _largest_P(plant, eta * (1 + margin), ratio, floor, gain_y)
    stated = STATED * margin
    return proven(
        DetectabilityCertificate(plant, P, eta, gain_y / ratio, gain_y, margin=stated, method="riccati", gain=gain)
    )


def _refuse_no_states(plant: Plant) -> None:
    if plant.n_states == 0:
        raise ArgumentError("`plant` must have at least one state: without states there is nothing to detect.")


def refuse_undetectable(plant: Plant, rate: float) -> None:
    """Refuse modes that no output sees and that do not decay at `rate` (of the squared error)."""
    unobservable = unobservable_modes(plant, rate)
    if len(unobservable):
        asked = f"at the rate {short(rate)} of the squared error (Re < {short(-rate / 2)})" if rate else "(Re < 0)"
        raise NotDetectableError(
            f"Not detectable: no output observes {unobservable.describe()}, which does not decay {asked}.",
            unobservable.eigenvalues,
            unobservable.directions,
        )


def _units(plant: Plant) -> tuple[float, float]:
    """Natural sizes of c_w and c_y: |Gw| = nu |x| or |Cx| = |C| |x| then cost nu |x|^2, nu = |A|."""
    nu = float(np.linalg.norm(plant.A, 2)) or 1.0
    size_G = float(np.linalg.norm(plant.G, 2)) if plant.n_disturbances else 0.0
    size_C = float(np.linalg.norm(plant.C, 2))
    return (size_G or 1.0) ** 2 / nu, nu / (size_C or 1.0) ** 2


def _filter(plant: Plant, eta: float, ratio: float, floor: float) -> Array | None:
    """Stabilising Y of A_e Y + Y A_e' + ratio (GG' + floor) - Y C'C Y = 0, A_e = A + eta/2 I; None without one."""
    n, size_G = plant.n_states, float(np.linalg.norm(plant.G, 2)) if plant.n_disturbances else 0.0
    shifted = plant.A + eta / 2 * np.eye(n)
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows has no solution
        noise = ratio * (plant.G @ plant.G.T + np.diag(np.full(n, floor * (size_G or 1.0) ** 2)))
        try:
            Y = stationary_covariance(shifted, plant.C, noise)
        except (LinAlgError, ValueError):
            return None
    stable = np.max(np.linalg.eigvals(shifted - Y @ plant.C.T @ plant.C).real) < 0
    return Y if stable and np.linalg.eigvalsh(Y)[0] > 0 else None


def _largest_P(plant: Plant, eta: float, ratio: float, floor: float, c_y: float) -> tuple[Array, Array]:
    """P = c_y Y^{-1} and the filter's gain."""
    Y = _filter(plant, eta, ratio, floor)
    if Y is None:
        raise SolverError(_NO_SOLUTION.format(rate=below(eta)))
    return symmetrise(c_y * cho_solve(cho_factor(Y), np.eye(len(Y)))), Y @ plant.C.T


def _largest_rate(least: Callable[[float], float], allowed: float, unit: float) -> float:
    """Largest rate with least(rate) <= allowed, by doubling and bisection; `least` increases with the rate."""
    if least(0.0) > allowed:
        raise CertificateError(
            f"No rate is possible within these bounds: even rates close to 0 need c_y = {short(least(0.0))} "
            "at this ratio of c_w to c_y.",
            least_c_y=least(0.0),
        )
    low, high = 0.0, unit
    while least(high) <= allowed:
        low, high = high, 2 * high
    while high - low > RATE_TOLERANCE * high:
        middle = (low + high) / 2
        low, high = (middle, high) if least(middle) <= allowed else (low, middle)
    return low


def _within(least: Callable[[float], float], eta: float, allowed: float, ratio: float) -> None:
    """Refuse a rate whose least gains exceed the bounds."""
    needed = least(eta)
    if needed > allowed:
        raise CertificateError(
            f"The rate {below(eta)} needs c_w = {short(needed / ratio)} and c_y = {short(needed)} at this ratio, "
            f"more than the bounds c_w = {short(allowed / ratio)}, c_y = {short(allowed)}.",
            least_c_w=needed / ratio,
            least_c_y=needed,
        )


@checked
def detectability_from_proof(
    plant: Plant, gain: npt.ArrayLike | None = None, Q: npt.ArrayLike | None = None
) -> DetectabilityCertificate:
    """Return the constants that the proof of Theorem 10 gives: observer gain, Lyapunov equation, Young's inequality.

        A_L = A - LC,   A_L'P + P A_L = -Q,   q = lambda_min(Q):
        c_x = q/2,   c_w = 4|PG|^2/q,   c_y = 4|PL|^2/q,   eta = c_x/lambda_max(P)

    Parameters
    ----------
    plant : Plant
    gain : (n, p) array, optional
        L with A - LC Hurwitz. Default: gain of the Kalman-Bucy filter with noise GG' + 1e-3 |G|^2 I.
    Q : (n, n) array, optional
        Symmetric positive definite. Default identity.

    Returns
    -------
    DetectabilityCertificate
        With every intermediate number in `.constants`, in the order of the proof.

    Raises
    ------
    NotDetectableError
        If no gain makes A - LC Hurwitz; carries the unobservable eigenvalues and directions.
    ArgumentError
        If the given gain does not, or Q is not positive definite.

    Notes
    -----
    *Claim.* V' <= -(q/2)|x|^2 + c_w|w|^2 + c_y|y|^2 and -(q/2)|x|^2 <= -eta V: the discount that the paper drops
    between this line and its (19). With the disturbance input G = I, c_w = 4|P|^2/q as in the paper.

    References
    ----------
    The paper, Theorem 10; theory 1.6, 3.1, E1.

    Examples
    --------
    >>> plant = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])
    >>> certificate = detectability_from_proof(plant, gain=[[2.0], [1.0]])
    >>> [constant.name for constant in certificate.constants]
    ['q', 'lambda_max_P', 'c_x', 'eta', 'c_w', 'c_y']
    >>> certificate.verify().passed
    True
    """
    n = plant.n_states
    _refuse_no_states(plant)
    Q = np.eye(n) if Q is None else checks.definite("Q", Q, n)
    if gain is None:
        refuse_undetectable(plant, 0.0)
        Y = _filter(plant, 0.0, 1.0, FLOOR)
        if Y is None:
            raise SolverError(_NO_SOLUTION.format(rate=0))
        gain = Y @ plant.C.T
    L = checks.matrix("gain", gain, n, plant.n_outputs)
    A_L = plant.A - L @ plant.C
    slowest = float(np.max(np.linalg.eigvals(A_L).real))
    if slowest >= 0:
        raise ArgumentError(f"`gain` must make A - LC Hurwitz, got an eigenvalue with real part {short(slowest)}.")
    P = symmetrise(np.asarray(solve_continuous_lyapunov(A_L.T, -Q), dtype=np.float64))
    constants = _proof_numbers(plant, P, L, Q)
    eta, c_w, c_y = (constants.named(name).value for name in ("eta", "c_w", "c_y"))
    return proven(DetectabilityCertificate(plant, P, eta, c_w, c_y, method="proof", gain=L, constants=constants))


def _proof_numbers(plant: Plant, P: Array, L: Array, Q: Array) -> ConstantList:
    """The proof's numbers in order, each rounded to the safe side by its last digits."""
    q, top = float(np.linalg.eigvalsh(Q)[0]), float(np.linalg.eigvalsh(P)[-1])
    safe = 1 + ROUNDING
    eta = q / 2 / top / safe
    c_w = 4 * float(np.linalg.norm(P @ plant.G, 2)) ** 2 / q * safe if plant.n_disturbances else q
    c_y = 4 * float(np.linalg.norm(P @ L, 2)) ** 2 / q * safe
    source = "Theorem 10"
    return ConstantList(
        (
            Constant("q", q, r"\lambda_{\min}(Q)", source, "q"),
            Constant("lambda_max_P", top, r"\lambda_{\max}(P),\ A_L^\top P+PA_L=-Q", source, r"\lambda_{\max}(P)"),
            Constant("c_x", q / 2, r"q/2", source, "c_x"),
            Constant("eta", eta, r"c_x/\lambda_{\max}(P)", source + ", with the discount of (2)", r"\eta"),
            Constant("c_w", c_w, r"4|PG|^2/q", source, "c_w"),
            Constant("c_y", c_y or q, r"4|PL|^2/q", source, "c_y"),
        )
    )
