"""`python -m examples.theophylline`: the withheld samples of six people, and which samples tell most about tomorrow."""

import numpy as np

from examples.theophylline import blood as b


def main() -> None:
    """Print both tables; assert the coverage."""
    blood = b.read_blood()
    least = b.least_bound(blood)
    bound = b.RESERVE * least
    found = b.predictions(blood, bound)
    print(f"Least bound on v that persons 1 to 6 do not disprove: {least:.3f}; used: {bound:.3f}.\n")
    print("| samples before | withheld | inside | known within | error of the middle, worst | of a fitted line |")
    print("|---|---|---|---|---|---|")
    for after in sorted({one.after for one in found}):
        these = [one for one in found if one.after == after]
        radius = np.mean([one.radius for one in these])
        worst, line = (max(abs(getattr(one, key)) for one in these) for key in ("error", "line_error"))
        hours = f"{after}, the next at {np.mean([one.t for one in these]):.0f} h"
        share = f"{sum(one.inside for one in these)} of {len(these)}"
        factors = f"factor {np.exp(radius):.2f} | {np.exp(worst):.2f} | {np.exp(line):.2f}"
        print(f"| {hours} | {len(these)} | {share} | {factors} |")
    print("\n| blood at [h] | the concentration at 24 h is known within a factor |\n|---|---|")
    for times in ([3.5, 5.0], [3.5, 5.0, 7.0], [3.5, 12.0], [3.5, 5.0, 7.0, 9.0, 12.0]):
        print(f"| {', '.join(f'{t:g}' for t in times)} | {b.known_next_day(times, bound):.2f} |")
    assert all(one.inside for one in found)
    assert not any(one.disproved for one in found)
    early, late = (b.known_next_day(times, bound) for times in ([3.5, 5.0, 7.0], [3.5, 12.0]))
    assert np.log(late) < 0.5 * np.log(early)


if __name__ == "__main__":
    main()
