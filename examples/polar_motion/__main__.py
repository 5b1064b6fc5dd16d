"""`python -m examples.polar_motion [DAYS]`: the table of the withheld days; without DAYS the whole, and its page."""

import sys
from pathlib import Path

import numpy as np

import sampling_design as sd
from examples.polar_motion import pole as p

PAGE = Path(__file__).parents[2] / "docs" / "polar_motion.md"
HEAD = "| readings | sigma of the kept | withheld days | inside | half-width, mean (widest) | error, rms (worst) |"


def row(found: p.Coverage) -> str:
    """One line of the table, in mas."""
    times = found.schedule.gap * np.arange(found.schedule.kept)
    sigma = sd.observability.sigma_min(p.plant(), times)
    nothing = found.radius > 1000
    shown = "nothing" if nothing else f"{found.radius:.0f} ({found.widest:.0f})"
    error = "" if nothing else f"{found.rms:.1f} ({found.worst:.0f})"
    return f"| {found.schedule.name} | {sigma:.1e} | {found.days} | {100 * found.inside:.0f} % | {shown} | {error} |"


def too_tight(pole: p.Pole, every: int) -> list[str]:
    """Bounds below those that are used, and how often readings disprove them."""
    lines = ["| faster than a season | scale | stretches of 60 monthly readings that disprove it |", "|---|---|---|"]
    for faster, scale in p.TIGHTER:
        refuted, asked = p.disproved(pole, p.SCHEDULES[0], scale, faster, every)
        assert refuted > 0 or scale == 0.14, "bounds this tight are disproved somewhere"
        lines.append(f"| {faster:g} mas | {scale:.2f} mas/d | {refuted} of {asked} |")
    return lines


def main(count: int = 0) -> None:
    """Print the table, and write the page if all days are asked for."""
    pole = p.read_pole()
    assert pole.xy.shape == (len(pole.days), 2)
    least = p.least_scale(pole, step=0.5 if not count else 2.0)
    scale = p.RESERVE * least
    rms, worst = p.sinusoids_error(pole)
    told = [
        f"Record to day {pole.days[-1]} (MJD). Least scale that 1962 to 1999 do not disprove: {least:.3f},",
        f"used: {scale:.3f}.",
        "",
        HEAD,
        "|---|---|---|---|---|---|",
    ]
    found = {s.name: p.coverage(pole, s, scale, count or 330) for s in p.SCHEDULES}
    told += [row(one) for one in found.values()]
    told += [
        "",
        "Half-widths and errors in mas, over both coordinates; 1 mas is 31 mm on the ground. *Nothing*: more than",
        f"1000 mas, while the pole never was further than {np.abs(pole.xy).max():.0f} mas from its zero. Sinusoids",
        "of the same periods with a drift, fitted to 1962 to 1999 and continued,",
        f"err by {rms:.0f} mas rms, {worst:.0f} at worst.",
        "",
        "Tighter bounds, and how many stretches of readings after 2000 disprove them, with a proof each:",
        "",
        *too_tight(pole, 60 if count else 4),
        "",
    ]
    wide = p.ellipsoids(pole, p.SCHEDULES[0], scale, eta=1e-3)
    told += [
        f"The ellipsoids of the moving horizon estimator (eta 0.001 1/d) say {wide:.0f} mas between monthly readings,",
        f"where the intervals of the same readings say {found['every 30 d'].radius:.0f}.",
        "",
    ]
    print("\n".join(told))
    assert all(one.inside == 1.0 for one in found.values())
    assert found["every 30 d"].widest < 60
    assert found["every 300 d"].widest < 350
    assert min(found[n].radius for n in ("every 198 d", "two fixed dates a year", "one fixed date a year")) > 1000
    if not count:
        head = [
            "# The Earth's pole, withheld days",
            "",
            "Made by `python -m examples.polar_motion`; [the lecture](pole.md).",
            "",
        ]
        PAGE.write_text("\n".join([*head, *told]))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
