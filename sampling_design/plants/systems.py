"""Linear systems of other libraries, taken as the matrices and names of a plant."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping
from typing import Protocol, cast

import numpy as np
import numpy.typing as npt

from sampling_design.errors import ArgumentError
from sampling_design.numerics.linalg import forced_flow
from sampling_design.records import checks
from sampling_design.records.arrays import Array

LIBRARIES = {"control": "from_control", "scipy": "from_scipy"}
CARRIED = "sampling_design_plant"
"""Attribute of a system that `Plant.to_control` made: the plant, for what such a system has no place for."""
AUTOMATIC = re.compile(r"(sys|[uxy])\[\d+\]")  # names that `control` makes where nobody gave one
PARTS = ("A", "C", "B", "D", "G", "time_unit", "name", "states", "outputs", "inputs", "disturbances", "source")
SAME_POLE = 1e-6
"""Poles of one output are one, and a zero cancels a pole, within this part of their size: a double root of a polynomial
is known to about the root of the rounding, 1.5e-8."""
DEAD = 1e-8  # a pole of a discrete system this small beside the largest is zero: double zeros are known to about 1.5e-8
SAME_FLOW = 1e-8  # a discrete system is given back by its logarithm to this share of its norm, in balanced coordinates
DELAYS = ("delay", "delays", "iodelay", "ioDelay", "input_delay", "output_delay", "InputDelay", "OutputDelay")


class StateSpace(Protocol):
    """A state-space system of another library."""

    A: npt.ArrayLike
    B: npt.ArrayLike
    C: npt.ArrayLike
    D: npt.ArrayLike


def is_system(value: object) -> bool:
    """Whether it is a linear system of `control` or `scipy.signal`, in any form."""
    return type(value).__module__.partition(".")[0] in LIBRARIES and hasattr(value, "dt")


def parts_of(system: object) -> dict[str, object]:
    """The matrices of a system, and what else it knows of a plant: names, and all that `to_control` left with it.

    Raises ArgumentError if it has a delay or is no linear system; if a transfer function is improper; if it is a
    discrete-time system without a sampling interval, or no continuous one has its samples.
    """
    check_system(system)
    if all(hasattr(system, key) for key in "ABCD"):
        plant = getattr(system, CARRIED, None)
        if plant is not None and _same(cast("StateSpace", system), plant, plant.G):
            return {key: getattr(plant, key) for key in PARTS}
        parts: dict[str, object] = {key: getattr(system, key) for key in "ACBD"}
    else:
        (A, B, C, D), outputs = realised(*_polynomials(system))
        parts = {"A": A, "C": C, "B": B, "D": D}
        names = _given(system, "output_labels") or [f"y{i + 1}" for i in range(len(C))]
        place = [outputs[:k].count(i) for k, i in enumerate(outputs)]
        states = [f"{names[i]}_{k + 1}" for i, k in zip(outputs, place, strict=True)]
        parts |= {"states": states, "outputs": names, "source": "transfer function, in observer form"}
    if getattr(system, "dt", None) not in (None, 0, 0.0):
        parts |= continuous(parts, float(system.dt))  # type: ignore[attr-defined]
    for mine, theirs in (("states", "state_labels"), ("outputs", "output_labels"), ("inputs", "input_labels")):
        labels = _given(system, theirs)
        if labels:
            parts[mine] = labels
    name = str(getattr(system, "name", "") or "")
    return parts | {"name": "" if AUTOMATIC.match(name) else name}


def _given(system: object, kind: str) -> list[str]:
    """The labels that somebody gave; none where `control` counted them from zero, as x[0], x[1]."""
    labels = list(getattr(system, kind, None) or ())
    return [] if all(AUTOMATIC.match(label) for label in labels) else labels


def driven(B: Array, D: Array, G: Array, disturbances: bool) -> tuple[Array, Array]:
    """B and D of a plant as another library has it, with its disturbances after its inputs where they are asked for."""
    return (np.hstack([B, G]), np.hstack([D, np.zeros((len(D), G.shape[1]))])) if disturbances else (B, D)


def _same(system: StateSpace, plant: StateSpace, G: Array) -> bool:
    """Whether a system is still the one that was made of a plant, in whichever of its two forms."""
    if not np.array_equal(system.A, plant.A) or not np.array_equal(system.C, plant.C):
        return False
    forms = [driven(np.asarray(plant.B), np.asarray(plant.D), G, form) for form in (False, True)]
    return any(np.array_equal(system.B, B) and np.array_equal(system.D, D) for B, D in forms)


def check_system(system: object) -> None:
    """Refuse what is no continuous-time linear system without delay. Raises ArgumentError if it is none."""
    delayed = next((key for key in DELAYS if np.any(np.asarray(getattr(system, key, 0), dtype=object))), "")
    if delayed:
        raise ArgumentError(
            f"`system` must have no delay, got one with `{delayed}`: add states for it (control.pade), or, where only "
            "the outputs come late, leave it out and give each measurement the time that it speaks of."
        )
    if not is_system(system) and not all(hasattr(system, key) for key in "ABCD"):
        raise ArgumentError(
            f"`system` must be a linear system of control or scipy.signal, got {checks.described(system)}."
        )
    known = all(hasattr(system, key) for key in "ABCD") or hasattr(system, "num") or hasattr(system, "gain")
    if not known:
        raise ArgumentError(
            f"`system` must be a state-space system or a transfer function, got {type(system).__name__}: linearise it "
            "first (system.linearize), or fit a model to its frequency response."
        )
    if getattr(system, "dt", None) is True:
        raise ArgumentError(
            "`system` must say how long its sampling interval is, got a discrete one with dt = True: with it, as in "
            "control.ss(A, B, C, D, 0.1), the plant between the samples is found."
        )


def continuous(parts: Mapping[str, object], dt: float) -> dict[str, object]:
    """A, B and the source of the plant whose samples, dt apart with inputs held in between, a discrete system gives.

        A = log(A_d)/dt,    int_0^dt e^{A s} ds B = B_d

    Raises ArgumentError if the real logarithm does not exist, is not unique, or is lost in rounding.

    Notes
    -----
    The principal logarithm: of all plants with these samples the one whose oscillations are the slowest, below half a
    cycle per dt.
    """
    from scipy.linalg import logm, matrix_balance

    stepped, B_d = (checks.matrix(key, parts[key]) for key in "AB")
    n, m = len(stepped), len(B_d.T)
    balanced, T = matrix_balance(stepped, permute=False)
    poles = np.linalg.eigvals(balanced)
    size = float(np.max(np.abs(poles), initial=0.0))
    lost = [p for p in poles if abs(p) <= DEAD * size or (p.real < 0 and abs(p.imag) <= SAME_POLE * abs(p))]
    if lost:
        value = float(lost[0].real)
        why = "what is forgotten within one sample, or delayed by whole samples, follows no differential equation"
        if abs(lost[0]) > DEAD * size:
            why = "a sign that changes with each sample is an oscillation of half a cycle per sample or faster, which "
            why += "these samples do not determine"
        raise ArgumentError(
            f"`system` must have a real logarithm, got a discrete one with the pole {value:.6g}: {why}. Give the plant "
            "before it was discretised."
        )
    with warnings.catch_warnings(), np.errstate(all="ignore"):  # a poor logarithm is judged by its flow
        warnings.simplefilter("ignore", RuntimeWarning)
        scale = np.diag(T)
        try:
            rate = np.real(logm(balanced))
        except ValueError:  # its own estimate of its error overflows
            rate = np.zeros((n, n))
        finite = np.nan_to_num(rate, nan=0.0, posinf=0.0, neginf=0.0)
        (flow,) = forced_flow(finite, np.eye(n), 1.0)
    if not np.allclose(flow[:, :n], balanced, rtol=0, atol=SAME_FLOW * float(np.linalg.norm(balanced, 2))):
        raise ArgumentError(
            "`system` must have a logarithm that doubles hold, got a discrete one that its own does not give back to "
            f"{SAME_FLOW:g}. Give the plant before it was discretised."
        )
    A = scale[:, None] * rate / scale / dt
    B = scale[:, None] * np.linalg.solve(flow[:, n:], B_d / scale[:, None]) / dt if m else B_d
    source = f"discrete-time system with dt = {dt:g}, inputs held in between; the plant that oscillates slowest"
    return {"A": A, "B": B, "source": source}


def _polynomials(system: object) -> tuple[list[list[Array]], list[list[Array]]]:
    """Numerators and denominators of a transfer function, a row for each output."""
    made = system if hasattr(system, "num") else system.to_tf()  # type: ignore[attr-defined]
    above, below = (getattr(made, key) for key in ("num", "den"))
    if isinstance(above, np.ndarray) and above.dtype != object:  # of scipy: one input, one denominator
        rows = np.atleast_2d(above)
        return [[np.asarray(row)] for row in rows], [[np.asarray(below)]] * len(rows)
    num, den = ([[np.asarray(entry) for entry in row] for row in given] for given in (above, below))
    return num, den


def realised(num: list[list[Array]], den: list[list[Array]]) -> tuple[tuple[Array, Array, Array, Array], list[int]]:
    """Return A, B, C, D of the observer form of a transfer matrix, and the output that each state belongs to.

        y_i = x_1 + D u,    x_k' = -a_k x_1 + x_{k+1} + b_k u,    s^n + a_1 s^{n-1} + ... + a_n the poles of row i

    What cancels within an entry is left out, and the entries of a row share their poles; rows do not. Raises
    ArgumentError if an entry has more zeros than poles.
    """
    blocks = [_row(*row) for row in zip(num, den, strict=True)]
    sizes = [len(each[0]) for each in blocks]
    n, m = sum(sizes), len(num[0])
    A, B, C, D = np.zeros((n, n)), np.zeros((n, m)), np.zeros((len(blocks), n)), np.zeros((len(blocks), m))
    start = 0
    for i, (a, b, d) in enumerate(blocks):
        own = slice(start, start + len(a))
        A[own, own] = np.eye(len(a), k=1)
        B[own], D[i] = b, d
        if len(a):
            A[own, start] -= a
            C[i, start] = 1.0
        start += len(a)
    return (A, B, C, D), [i for i, size in enumerate(sizes) for _ in range(size)]


def _row(num: list[Array], den: list[Array]) -> tuple[Array, Array, Array]:
    """Coefficients a, b and D of one output: its entries over the poles that any of them has."""
    entries = [_cancelled(*entry) for entry in zip(num, den, strict=True)]
    shared: list[complex] = []
    for _, below in entries:
        shared += _left(list(np.roots(below)), shared)
    over = [np.real(np.poly(_left(shared, list(np.roots(below))))) for _, below in entries]
    longest = max(range(len(entries)), key=lambda j: len(entries[j][1]))
    a = np.asarray(np.polymul(entries[longest][1], over[longest]), dtype=np.float64)
    D, b = np.zeros(len(entries)), np.zeros((len(a) - 1, len(entries)))
    for j, (above, _) in enumerate(entries):
        top = np.polymul(above, over[j])
        top = np.concatenate([np.zeros(len(a) - len(top)), top])
        D[j] = top[0]
        b[:, j] = top[1:] - D[j] * a[1:]
    return a[1:], b, D


def _cancelled(num: Array, den: Array) -> tuple[Array, Array]:
    """Numerator and monic denominator of one entry without what cancels; as they are where nothing does."""
    num, den = np.trim_zeros(np.ravel(num), "f"), np.trim_zeros(np.ravel(den), "f")
    if len(num) > len(den):
        raise ArgumentError(
            f"`system` must have no more zeros than poles, got degree {len(num) - 1} over {len(den) - 1}: what "
            "differentiates its input has no states."
        )
    if not len(num):
        return np.zeros(1), np.ones(1)
    zeros, poles = list(np.roots(num)), list(np.roots(den))
    left = _left(zeros, poles)
    if len(left) == len(zeros):
        return num / den[0], den / den[0]
    return num[0] / den[0] * np.real(np.poly(left)), np.real(np.poly(_left(poles, zeros)))


def _left(these: list[complex], others: list[complex]) -> list[complex]:
    """What is left of roots once each is taken away that has one of its own among the others."""
    open_, left = list(others), []
    size = max((abs(z) for z in (*these, *others)), default=0.0)
    for root in these:
        near = min(open_, key=lambda z: abs(z - root), default=None)
        if near is not None and abs(near - root) <= SAME_POLE * max(abs(root), SAME_POLE * size):
            open_.remove(near)
        else:
            left.append(root)
    return left
