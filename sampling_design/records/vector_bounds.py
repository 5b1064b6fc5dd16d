"""Bounds on vectors as a user types them: a number on the norm, one for each entry, or by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias, TypeGuard

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.strict import is_number, is_table
from sampling_design.errors import ArgumentError
from sampling_design.records import checks
from sampling_design.records.arrays import Array, freeze

Entry: TypeAlias = float | tuple[float, float]
VectorBound: TypeAlias = npt.ArrayLike | Mapping[str, Entry] | None
"""A number, entries, or a mapping from names to numbers or pairs (lower, upper); None: no bound."""

MOST_POWER = 1e150
"""Sizes beyond it, or below its inverse, have squares that are no doubles: no bound is so large or small but 0."""


def of_any_names(argument: str, value: object) -> object:
    """Return a bound as it was said, before it is known of what; what is neither numbers nor a table is refused."""
    if not is_table(value):
        checks.floats(argument, value)
    return value


def vector_bound(argument: str, value: VectorBound, names: tuple[str, ...]) -> Array:
    """Return a bound about 0: a number (0-d array), on the Euclidean norm, or one for each entry, given by name or not.

    Of one entry the norm is its size, and a number is a bound on that entry.

    Raises ArgumentError if it is negative, not finite, of another length, names what is not there, leaves a name out,
    is a pair that is not about 0, or so large or small that its square is no number.
    """
    if is_table(value):
        given = {str(key): entry for key, entry in value.items()}
        half, centre = named_bounds(argument, given, names)
        if centre.any():
            name = names[int(np.argmax(centre != 0))]
            raise ArgumentError(f"`{argument}[{name!r}]` must be a number or a pair about 0 here, got {given[name]!r}.")
        if np.isinf(half).any():
            lost = [name for name, size in zip(names, half, strict=True) if np.isinf(size)]
            raise ArgumentError(f"`{argument}` is missing for {', '.join(lost)}: give a number, 0 for none.")
        return freeze(half)
    if checks.dimensions(value) == 0:
        number = squarable(argument, checks.nonnegative(argument, value))
        return freeze(number.reshape(1)) if len(names) == 1 else number
    entries = checks.vector(argument, value, len(names))
    if np.any(entries < 0):
        raise ArgumentError(f"`{argument}` must not be negative, got {float(entries.min())!r}.")
    return freeze(squarable(argument, entries))


def named_bounds(argument: str, value: Mapping[str, object], names: tuple[str, ...]) -> tuple[Array, Array]:
    """Return half-widths (infinite of a name that is left out) and centres of a mapping from names to numbers or pairs.

    Raises ArgumentError if a name is unknown, a number negative or a pair in the wrong order.
    """
    checks.known_keys(f"`{argument}`", [str(key) for key in value], names)
    half, centre = np.full(len(names), np.inf), np.zeros(len(names))
    for name, entry in value.items():
        at = names.index(str(name))
        half[at], centre[at] = half_and_centre(f"{argument}[{name!r}]", entry)
    return half, centre


def half_and_centre(argument: str, entry: object) -> tuple[float, float]:
    """Return half-width and centre of a number (about 0) or a pair (lower, upper); what is one-sided is unbounded.

    Raises ArgumentError if the number is negative, the pair in the wrong order, or a square no number.
    """
    if isinstance(entry, tuple):
        if len(entry) != 2:
            raise ArgumentError(f"`{argument}` must be a number or a pair (lower, upper), got {entry!r:.60}.")
        low, high = (float(x) if _is_infinite(x) else checks.number(argument, x) for x in entry)
        if low > high:
            raise ArgumentError(f"`{argument}` must be a pair (lower, upper), got {entry!r:.60}: lower exceeds upper.")
        if np.isinf(low) or np.isinf(high):
            return np.inf, 0.0
        squarable(argument, [(high - low) / 2, (high + low) / 2])
        return (high - low) / 2, (high + low) / 2
    if _is_infinite(entry) and entry == np.inf:
        return np.inf, 0.0
    return float(squarable(argument, checks.nonnegative(argument, entry))), 0.0


def squarable(argument: str, sizes: npt.ArrayLike) -> Array:
    """Return sizes that are 0, infinite, or have squares that are doubles. Raises ArgumentError if one is another."""
    entries = np.asarray(sizes, dtype=np.float64)
    size = np.abs(entries[np.isfinite(entries) & (entries != 0)])
    if size.size and not 1 / MOST_POWER <= size.min() <= size.max() <= MOST_POWER:
        raise ArgumentError(
            f"`{argument}` must be 0 or lie between {1 / MOST_POWER:g} and {MOST_POWER:g}, or its square is no number "
            f"in double precision, got {size.min() if size.min() < 1 else size.max():g}."
        )
    return entries


def refuse_apart(C: Array, G: Array, **bounds: Array | None) -> None:
    """Raise ArgumentError where two bounds of a plant are so far apart that the square of their ratio is no double.

    A disturbance moves states by G w and they outputs by C x: over the other bound that is the same in any units.
    """
    with np.errstate(divide="ignore"):
        c, g = np.log10(np.abs(C)), np.log10(np.abs(G))
        sizes = {name: np.log10(size) for name, size in bounds.items() if size is not None}
    through = np.max(c[:, :, None] + g, axis=1, initial=-np.inf)
    pairs = (("w_bound", "v_bound", through), ("initial_error", "v_bound", c), ("w_bound", "initial_error", g))
    for one, other, effect in pairs:
        if one in sizes and other in sizes:
            over = np.broadcast_to(sizes[other], (*sizes[other].shape[:-1], len(effect)))[..., None]
            with np.errstate(invalid="ignore"):
                powers = effect + np.broadcast_to(sizes[one], effect.shape[1:]) - over
            powers = np.append(powers[np.isfinite(powers)], 0.0)
            worst = float(powers[np.argmax(np.abs(powers))])
            if abs(worst) > np.log10(MOST_POWER):
                raise ArgumentError(
                    f"`{one}` and `{other}` must be nearer to each other: what the one moves is 1e{worst:+.0f} times "
                    "the other, whose square is no number in double precision."
                )


def _is_infinite(value: object) -> TypeGuard[float]:
    return is_number(value) and bool(np.isinf(value))
