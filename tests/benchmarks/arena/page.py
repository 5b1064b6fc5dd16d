"""The page: versions and settings, a table per task, figures."""

from __future__ import annotations

import io
import os
import platform
from datetime import date
from pathlib import Path

import sampling_design as sd
from sampling_design.records.file_io import write_bytes, write_text

from .table import PINS, Table, named

COMMAND = "pip install -e . -r tests/benchmarks/arena/peers.txt && python -m tests.benchmarks.arena"
SETTINGS = {
    "scipy": "`expm` in a loop; `differential_evolution` with its defaults, new seeds until the time is over; "
    "`shgo` with its defaults, then with Sobol points, doubled until the time is over",
    "control": "`OptimalEstimationProblem`, continuous time, `gaussian_likelihood_cost`, sample times as `timepts`",
    "do-mpc": "`MHE` on a continuous model with process and measurement noise; collocation and IPOPT by default",
    "casadi": "only under do-mpc",
    "cvxpy": "window in the states at the samples; rebuilt at each estimate, or kept with parameters (DPP)",
    "clarabel": "cvxpy's solver, default tolerances",
    "filterpy": "`KalmanFilter`, F and Q overwritten before each `predict`",
}


def written(tables: list[Table], folder: Path, spent: float, quick: bool) -> Path:
    """Write the page and its figures into `folder` and return the page's path."""
    lines = ["# Arena: the same plants and data, this toolbox and its peers", ""]
    lines += [
        f"Made by `{COMMAND}{' --quick' if quick else ''}` on {date.today()} in {spent:.0f} s of processor time; ",
        "",
    ]
    lines[-2] += f"Python {platform.python_version()}, {os.cpu_count()} cores ({platform.machine()}), one BLAS thread, "
    lines[-2] += (
        f"sampling_design {sd.__version__}. Times are processor time, medians of several calls, first calls apart; "
    )
    lines[-2] += "on a shared machine the ratios hold better than the figures."
    lines += ["| peer | setting |", "|---|---|", *(f"| {named(peer)} | {SETTINGS[peer]} |" for peer in PINS), ""]
    for table in tables:
        lines += section(table)
        for name, figure in table.figures.items():
            buffer = io.BytesIO()
            figure.savefig(buffer, format="png", dpi=110, bbox_inches="tight", metadata={"Software": None})
            write_bytes(folder / "figures" / f"{name}.png", buffer.getvalue())
            lines += [f"![{table.title}](figures/{name}.png)", ""]
        lines += told(table)
    return write_text(folder / "arena.md", "\n".join(lines).rstrip() + "\n")


def markdown(table: Table) -> list[str]:
    """Return the lines of a table; what does not apply stays empty."""
    rows = [table.columns, ("---",) * len(table.columns), *table.rows]
    return ["| " + " | ".join("" if cell is None else str(cell) for cell in row) + " |" for row in rows]


def section(table: Table) -> list[str]:
    """Return a table under its title and question."""
    return [f"## {table.title}", "", table.question, "", *markdown(table), ""]


def told(table: Table) -> list[str]:
    """Return its notes."""
    return [line for note in table.notes for line in (note, "")]


def renewed(table: Table, page: Path) -> Path:
    """Put a table without figures in the place of the one of the same title on a page."""
    before, title, rest = page.read_text().partition(f"## {table.title}\n")
    if not title:
        raise ValueError(f"no table {table.title!r} in {page.name}")
    after = rest.partition("\n## ")
    return write_text(page, before + "\n".join([*section(table), *told(table)]) + after[1] + after[2])
