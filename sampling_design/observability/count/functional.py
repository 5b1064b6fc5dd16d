"""Chosen rows of the state: which part of a plant they need, and whether any record can tell them."""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr, schur

from sampling_design.errors import ArgumentError, NotDetectableError
from sampling_design.numerics.linalg import (
    balance,
    balanced,
    balanced_rows,
    expm_batch,
    positive_or_one,
    right_directions,
)
from sampling_design.observability.count.pbh import RANK_TOLERANCE, unobservable_modes
from sampling_design.plants.functional import FunctionalPlant, RequestedRows, Wanted, requested_rows, without
from sampling_design.plants.plant import Plant, Signals, replace_matrices
from sampling_design.records import checks
from sampling_design.records.arrays import Array
from sampling_design.records.signatures import checked
from sampling_design.schedules.schedule import PeriodicSchedule

MISSED = 1e-9
"""Singular values of what a period shows below this, relative, count as zero: as where existence is decided."""
ENTERS = 1e-6
"""Share of a row from which on what is hidden enters it: the hidden directions are known to about `MISSED`."""


@checked
def functional_plant(plant: Plant, of: Wanted, *, decay_rate: float = 0.0) -> FunctionalPlant:
    """Return the part of a plant that chosen rows z = H x of its state need: a plant that every verb takes.

    Parameters
    ----------
    plant : Plant
    of : str, sequence of str, or (k, n) array
        Names of states or outputs (the row of an output is C), or the rows H themselves; independent of each other.
    decay_rate : float [1/time_unit]
        Modes that no output shows may enter z if their squared error decays at this rate; 0: if it decays at all.

    Returns
    -------
    FunctionalPlant
        Its first k states are z, under the names and in the units asked for.

    Raises
    ------
    ArgumentError
        If a name is unknown, or the rows depend on each other on what the outputs and they themselves show.
    NotDetectableError
        If a mode that no output shows enters z and does not decay: no record of outputs can tell z then.

    Notes
    -----
    *Theorem.* Let M be the largest A-invariant subspace on which C and H vanish. x mod M is a plant of its own, with
    the same outputs, that carries z. It is detectable at the rate eta if and only if H vanishes on the part N+ of the
    unobservable subspace of (C, A) whose modes have Re lambda >= -eta/2, that is if and only if z follows from
    all outputs. *Method.* M is the unobservable subspace of (A, [C; H]), taken out eigenvector by eigenvector until
    none is left, which takes out Jordan chains too. The rank test of [s I - A; C; H] and [s I - A; C] asks for
    eigenvectors only and misses a Jordan chain whose second vector H shows; so it is not used. *Numerical aspects.* A
    mode counts as hidden where entries wrong by 1e-10 of themselves could hide it (`unobservable_modes`).

    References
    ----------
    Darouach, Fernando, Functional detectability and asymptotic functional observer design (2023); theory, section 16.

    Examples
    --------
    >>> import numpy as np
    >>> plant = Plant(np.diag([0.1, 0.2, -1.0]), [[1.0, 0.0, 0.5]])
    >>> part = functional_plant(plant, "x1")
    >>> part.states.names, part.A.diagonal()
    (('x1', 'x3'), array([ 0.1, -1. ]))
    """
    checks.nonnegative("decay_rate", decay_rate)
    rows = requested_rows(plant, of)
    part, onto, H = plant, np.eye(plant.n_states), rows.matrix
    while len(hidden := unobservable_modes(_with_rows(part, H))):
        weights = balance(part.A, np.vstack([part.C, H])).d
        scaled = hidden.directions / weights[:, None]  # a real basis: complex ones have their mirrors
        left, _, _ = np.linalg.svd(np.hstack([scaled.real, scaled.imag]), full_matrices=False)
        basis = weights[:, None] * left[:, : len(hidden)]
        part, step, kept = without(part, basis, weights, RANK_TOLERANCE)
        onto, H = step @ onto, H[:, kept]
    part, onto = _rows_first(plant, part, onto, H, rows)
    _require_detectable(plant, part, rows, decay_rate)
    return FunctionalPlant.of_part(part, plant, onto, len(rows))


def part_for(plant: Plant, of: Wanted, window: float | None = None, *, decay_rate: float | None = None) -> Plant:
    """Return what a verb is asked about: the plant, or what rows of it need, weighed for sigma over a window."""
    if of is None:
        return plant
    part = functional_plant(plant, of, decay_rate=max(decay_rate or 0.0, 0.0))
    return part if window is None else part.beside(window)


def rows_between_samples(plant: FunctionalPlant, schedule: PeriodicSchedule, decay_rate: float) -> str:
    """Say which rows asked for the modes enter that a period does not show and that do not decay.

    Notes
    -----
    *Method.* What no period shows is the kernel of C_i e^{A tau_i} e^{A P k}, k < n, in balanced coordinates; its part
    N+ that does not decay is invariant under e^{A P}, not under A. A row is free of it at all times if and only if
    H A^k N+ = 0 for k < n, and at the sample times if H e^{A tau_i} N+ = 0.
    """
    n, d = plant.n_states, balance(plant.A, plant.C).d
    A, C = balanced(plant.A, d), balanced_rows(plant.C, d)
    C, growth = C / positive_or_one(np.linalg.norm(C, axis=1))[:, None], float(np.max(np.linalg.eigvals(A).real))
    flows = expm_batch(A - growth * np.eye(n), np.append(schedule.times - schedule.times[0], schedule.period))
    taken = np.ones((len(schedule), len(C)), bool) if schedule.outputs is None else schedule.outputs
    stacked = [np.vstack([C[mask] @ F for mask, F in zip(taken, flows, strict=False)])]
    for _ in range(n - 1):
        stacked.append(stacked[-1] @ flows[-1])
    sizes, V = right_directions(np.vstack(stacked))
    N = V[np.count_nonzero(sizes > MISSED * sizes[0]) :].T
    kept = np.exp((-decay_rate / 2 - growth) * schedule.period) * (1 - RANK_TOLERANCE)
    _, Z, count = schur(N.T @ flows[-1] @ N, output="complex", sort=lambda mu: abs(mu) >= kept)
    N = N @ Z[:, :count]
    unit, powers = A / max(float(np.linalg.norm(A)), np.finfo(float).tiny), [N]
    for _ in range(n - 1):
        powers.append(unit @ powers[-1])
    names = plant.wanted.names
    always, sampled = (
        np.max(np.abs(np.hstack(parts)[: len(names)]), axis=1, initial=0.0) <= ENTERS
        for parts in (powers, flows[:-1] @ N)
    )
    said = {
        "; what is hidden enters {}": ~sampled,
        "; {} is free of it at the sample times, and not between": sampled & ~always,
        "; {} is free of it at all times, which no certificate says and `guaranteed_accuracy` does": always,
    }
    listed = [
        (text, ", ".join(name for name, one in zip(names, which, strict=True) if one)) for text, which in said.items()
    ]
    return "".join(text.format(them) for text, them in listed if them and count)


def _with_rows(plant: Plant, H: Array) -> Plant:
    """The plant that measures the rows, too."""
    return Plant(plant.A, np.vstack([plant.C, H]), time_unit=plant.time_unit, states=plant.states)


def _rows_first(plant: Plant, part: Plant, onto: Array, H: Array, rows: RequestedRows) -> tuple[Plant, Array]:
    """The quotient in coordinates whose first entries are the rows, in the sizes that the user gave."""
    count, weights = len(rows), balance(part.A, np.vstack([part.C, H])).d
    sizes = positive_or_one(np.linalg.norm(H * weights, axis=1))[:, None]
    R, order = qr(H * weights / sizes, pivoting=True, mode="r")
    if count > part.n_states or np.min(np.abs(np.diag(R)[:count])) <= RANK_TOLERANCE:
        raise ArgumentError(
            f"`of` must have rows that are independent of each other, and none of zeros, got {', '.join(rows.names)}."
        )
    gone, others = np.sort(order[:count]), np.sort(order[count:])
    T = np.vstack([H, np.eye(part.n_states)[others]])

    def exchanged(M: Array) -> Array:
        """M T^-1: states `gone` are what the rows leave of the others, each entry in the sizes that belong to it."""
        of_rows = np.linalg.solve((H[:, gone] * weights[gone] / sizes).T, (M[:, gone] * weights[gone]).T).T / sizes.T
        return np.hstack([of_rows, M[:, others] - of_rows @ H[:, others]])

    A, C = exchanged(T @ part.A), exchanged(part.C)
    states = part.states
    given = np.abs(rows.matrix) @ plant.states.scales if plant.has_scales else np.ones(count)
    signals = Signals(
        [*rows.names, *(states.names[j] for j in others)],
        [*rows.units, *(states.units[j] for j in others)],
        np.concatenate([given, states.scales[others]]),
    )
    whole = T @ onto
    whole[:count] = rows.matrix
    return replace_matrices(plant, A, C, whole, signals), whole


def _require_detectable(plant: Plant, part: Plant, rows: RequestedRows, decay_rate: float) -> None:
    """Refuse rows into which a mode enters that no output shows and that does not decay fast enough."""
    hidden = unobservable_modes(part, decay_rate)
    if not len(hidden):
        return
    spoiled = [
        name for name, d in zip(rows.names, hidden.directions, strict=False) if np.max(np.abs(d)) > RANK_TOLERANCE
    ]
    everywhere = unobservable_modes(plant, decay_rate).directions
    free = [
        name for name, d in zip(plant.states.names, everywhere, strict=True) if not np.any(np.abs(d) > RANK_TOLERANCE)
    ]
    slow = f"does not decay at the rate {decay_rate!r}" if decay_rate else "does not decay"
    other = f", or ask for states that it leaves alone: {', '.join(free[:6])}" if free else ""
    raise NotDetectableError(
        f"`of` asks for {', '.join(spoiled or rows.names)}, into which a mode enters that no output shows and that "
        f"{slow}: {hidden.describe()}. Add an output that shows it{other}.",
        hidden.eigenvalues,
        hidden.directions,
    )
