"""Samples per orbit against sigma for the satellite: docs/figures/pareto_satellite.png and docs/pareto_satellite.md.

python examples/pareto_satellite.py
"""

from pathlib import Path

import sampling_design as sd

HERE = Path(__file__).parent
DOCS = HERE.parent / "docs"
COUNTS = range(6, 17)


def main() -> None:
    """Design for every count, write the table and the picture."""
    plant = sd.read_plant(HERE / "plants" / "satellite.toml")
    requirement = sd.read_requirement(HERE / "requirements" / "satellite.toml")
    front = sd.pareto_front(plant, requirement, COUNTS, progress=lambda fraction, message: print(message))
    (DOCS / "figures").mkdir(exist_ok=True)
    front.plot().figure.savefig(DOCS / "figures" / "pareto_satellite.png", dpi=110)
    lines = [
        "# Samples per orbit against sigma: the satellite",
        "",
        "Made by `python examples/pareto_satellite.py`.",
        "",
    ]
    lines += ["| samples | sigma proven | no schedule exceeds | gap |", "|---|---|---|---|"]
    for p in front.points:
        lines.append(
            f"| {p.samples} | {p.sigma:.5f} | {p.upper_bound:.5f} | {100 * (1 - p.sigma / p.upper_bound):.1f} % |"
        )
    lines += ["", front.explain(), "", "![sigma over samples per orbit](figures/pareto_satellite.png)", ""]
    (DOCS / "pareto_satellite.md").write_text("\n".join(lines))


if __name__ == "__main__":
    main()
