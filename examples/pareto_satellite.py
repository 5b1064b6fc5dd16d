"""Samples per orbit against sigma for the satellite: docs/figures/pareto_satellite.png and docs/pareto_satellite.md.

python examples/pareto_satellite.py
"""

from collections.abc import Sequence
from pathlib import Path

import sampling_design as sd
from sampling_design import plotting
from sampling_design.design.pareto import ParetoFront
from sampling_design.records.record import above, below

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"
COUNTS = range(6, 17)


def front_of(counts: Sequence[int]) -> ParetoFront:
    """A design for every count."""
    plant = sd.read_plant(HERE / "plants" / "satellite.toml")
    requirement = sd.read_requirement(HERE / "requirements" / "satellite.toml")
    return sd.pareto_front(plant, requirement, counts, progress=lambda fraction, message: print(message))


def rows(front: ParetoFront) -> list[str]:
    """Lines of the table."""
    return [
        f"| {p.samples} | {below(p.sigma, 5)} | {above(p.upper_bound, 5)} | {above(gap, 2)} % | {lost} |"
        for p in front.points
        for gap in [100 * (1 - p.sigma / p.upper_bound)]
        for lost in ["-" if p.deviations is None else below(p.deviations.lost, 4)]
    ]


def main() -> None:
    """Design for every count, write the table and the picture."""
    front = front_of(COUNTS)
    (DOCS / "figures").mkdir(exist_ok=True)
    plotting.save(front, DOCS / "figures" / "pareto_satellite.png", dpi=110)
    lines = [
        "# Samples per orbit against sigma: the satellite",
        "",
        "Made by `python examples/pareto_satellite.py`.",
        "",
    ]
    head = "| samples | sigma proven | no schedule exceeds | gap | if one is lost |"
    lines += [head, "|---|---|---|---|---|", *rows(front)]
    lines += ["", front.explain(), "", "![sigma over samples per orbit](figures/pareto_satellite.png)", ""]
    (DOCS / "pareto_satellite.md").write_text("\n".join(lines))


if __name__ == "__main__":
    main()
