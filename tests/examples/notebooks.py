"""Notebooks as the repository wants them: `python tests/examples/notebooks.py strip|run [NOTEBOOK...]`.

`strip` removes outputs, counts and private metadata, and writes every notebook in one form. `run` executes a notebook
in a kernel of its own (plainly, cell after cell, where no kernel is installed) and prints how many pictures it made.
`plain` always runs it without a kernel and with ipywidgets out of reach.
"""

from __future__ import annotations

import ast
import io
import json
import os
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[2] / "examples" / "notebooks"
KERNEL = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
PATIENCE = 120
"""Seconds that a cell may take."""
WATCH = f"""
import sys; sys.path.insert(0, {str(Path(__file__).parents[2])!r})
from tests.kept_certificates import watch; watch(); del watch
"""
"""What a notebook runs before its own cells: its certificates are kept, where the environment asks for it."""


def stripped(notebook: dict[str, Any]) -> str:
    """Return the text of a notebook without what a run leaves behind."""
    cells = []
    for number, cell in enumerate(notebook["cells"]):
        source = "".join(cell["source"]).strip("\n").splitlines(keepends=True)
        kept = {"cell_type": cell["cell_type"], "id": f"c{number:02d}", "metadata": {}, "source": source}
        cells.append(kept | ({"execution_count": None, "outputs": []} if cell["cell_type"] == "code" else {}))
    whole = {"cells": cells, "metadata": KERNEL | {"language_info": {"name": "python"}}}
    return json.dumps(whole | {"nbformat": 4, "nbformat_minor": 5}, indent=1, ensure_ascii=False, sort_keys=True) + "\n"


def run_in_kernel(path: Path) -> int:
    """Execute a notebook in a kernel and return the number of pictures."""
    import nbformat
    from nbclient import NotebookClient

    os.environ.pop("MPLBACKEND", None)  # the kernel chooses its own
    notebook = nbformat.read(path, as_version=4)
    notebook.cells.insert(0, nbformat.v4.new_code_cell(WATCH))
    client = NotebookClient(notebook, timeout=PATIENCE, kernel_name="python3")
    client.execute(cwd=str(path.parent))
    outputs = [out for cell in notebook.cells if cell.cell_type == "code" for out in cell.outputs]
    return sum("image/png" in out.get("data", {}) for out in outputs)


def run_plainly(path: Path) -> int:
    """Execute the code cells one after the other, without kernel and widgets; return the number of pictures."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    sys.modules["ipywidgets"] = None  # type: ignore[assignment]
    shown: list[Any] = []
    plt.show = lambda *_, **__: shown.append(plt.gcf().savefig(io.BytesIO(), format="png"))
    names: dict[str, Any] = {"__name__": "__notebook__"}
    exec(WATCH, {})
    for number, cell in enumerate(json.loads(path.read_text())["cells"]):
        if cell["cell_type"] == "code":
            value = run_cell("".join(cell["source"]), f"{path.name}, cell {number}", names)
            if hasattr(value, "_repr_png_"):
                shown.append(value._repr_png_())
    return len(shown)


def run_cell(source: str, where: str, names: dict[str, Any]) -> Any:
    """Run a cell and return the value of its last line, if that is an expression."""
    body = ast.parse(source).body
    last = body.pop() if body and isinstance(body[-1], ast.Expr) else None
    exec(compile(ast.Module(body, []), where, "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), where, "eval"), names)


def main(verb: str, *names: str) -> None:
    """Strip or run the given notebooks, or all."""
    kernel = find_spec("nbclient") is not None and find_spec("ipykernel") is not None
    for path in [Path(name) for name in names] or sorted(FOLDER.glob("*.ipynb")):
        if verb == "strip":
            path.write_text(stripped(json.loads(path.read_text())))
        elif verb in ("run", "plain"):
            how = run_in_kernel if kernel and verb == "run" else run_plainly
            print(path.name, "pictures:", how(path), "by", how.__name__)
        else:
            raise SystemExit(f"strip, run or plain, not {verb!r}")


if __name__ == "__main__":
    main(*sys.argv[1:])
