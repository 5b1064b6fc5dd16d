"""Counting samples is not enough: how many determine a state, when they fail, and how well they see it.

Run: `python examples/01_counting_is_not_enough.py`
"""

from itertools import pairwise

import numpy as np

import sampling_design as sd

WINDOW = 4.0


def two_tones(low: float = 1.0, high: float = 3.0) -> sd.Plant:
    """Return two undamped oscillators whose sum is measured."""
    A = np.array([[0, 1, 0, 0], [-(low**2), 0, 0, 0], [0, 0, 0, 1], [0, 0, -(high**2), 0]], dtype=float)
    return sd.Plant(A, [[1.0, 0.0, 1.0, 0.0]], time_unit="s")


def sigma_against_spacing(plant: sd.Plant, spacings: list[float], count: int) -> list[float]:
    """Return the proven worst sigma of any `count` samples in the window for each least spacing."""
    families = [sd.SpacedWindows(WINDOW, count, spacing) for spacing in spacings]
    return [sd.worst_case_sigma(plant, family).lower for family in families]


def main() -> None:
    """Show that three samples always do on an oscillator, and how badly."""
    oscillator = sd.named_plant("oscillator")
    count = sd.zero_count_bound(oscillator, WINDOW)
    print(f"k* = {count.value:.3f}: any {count.samples_needed} samples in {WINDOW:g} s determine the state.")

    # two samples half a turn apart are one sample seen twice
    half_turn = sd.observability.sigma_min(oscillator, [0.0, np.pi])
    near = sd.observability.sigma_min(oscillator, [0.0, np.pi - 0.3])
    print(f"Two samples: sigma {half_turn:.1e} at gap pi, {near:.3f} at gap pi - 0.3.")
    many = sd.observability.sigma_min(oscillator, np.pi * np.arange(50))
    print(f"Fifty samples at multiples of pi: sigma {many:.1e}.")

    spacings = [1.0, 0.5, 0.25, 0.1, 0.05]
    sigmas = sigma_against_spacing(oscillator, spacings, count.samples_needed)
    for spacing, sigma in zip(spacings, sigmas, strict=True):
        print(f"Three samples at least {spacing:4.2f} s apart: sigma is never below {sigma:.4f}.")

    tones = sd.zero_count_bound(two_tones(), 3.0)
    print(f"1 and 3 rad/s: {tones.samples_needed} by k*, {tones.samples_critical} by the critical length.")

    assert count.samples_needed == 3
    assert half_turn < 1e-12
    assert many < 1e-12
    assert all(a > b > 0 for a, b in pairwise(sigmas))
    assert sigmas[0] > 10 * sigmas[-1], "the count is the same, what it is worth is not"
    assert (tones.samples_needed, tones.samples_critical) == (6, 4)


if __name__ == "__main__":
    main()
