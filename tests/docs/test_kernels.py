"""Kernels of pages are forks of one process: each with its own names, its pictures and its certificates."""

import json
import os
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
CERTIFIED = """import sampling_design as sd
sd.certify(sd.Plant([[0.0]], [[1.0]]), sd.PeriodicSchedule([1.0]), eta=0.1, P2=[[1.0]])
"""


@pytest.fixture
def execute(tmp_path, monkeypatch):
    """Return execute(*cells) -> their outputs, in a kernel of the documentation."""
    monkeypatch.syspath_prepend(str(DOCS))
    monkeypatch.setattr(os, "environ", os.environ.copy())
    monkeypatch.setenv("PYTHONPATH", str(DOCS.parent))
    monkeypatch.delenv("MPLBACKEND", raising=False)
    import kernels
    import nbformat
    import proven_pages
    from nbclient import NotebookClient

    proven_pages.collect(DOCS.parent, tmp_path)
    process, _ = kernels.start()

    def run(*cells):
        notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
        NotebookClient(notebook, kernel_name="python3", timeout=60).execute(cwd=str(tmp_path))
        return [cell.outputs for cell in notebook.cells]

    yield run
    process.stdin.close()
    assert process.wait(60) == 0


@pytest.mark.long
def test_a_fork_has_its_own_names_and_leaves_its_pictures_and_certificates(execute, tmp_path):
    from nbclient.exceptions import CellExecutionError, DeadKernelError

    about = "import os, sys; print(sys.executable, os.getcwd(), os.getppid())"
    (told,), (drawn,), _ = execute(about, "import matplotlib.pyplot as plt; plt.plot([1.0]);", CERTIFIED)
    assert told["text"].startswith(f"{sys.executable} {tmp_path} ")
    assert "image/png" in drawn["data"]
    kept = [json.loads(path.read_text())["claim"] for path in tmp_path.glob("*.json")]
    assert len(kept) == 1
    assert execute(about) == [[told]]  # forked from the same process
    with pytest.raises(CellExecutionError, match="name 'sd' is not defined"):
        execute("sd")
    with pytest.raises(DeadKernelError):
        execute("import os; os._exit(3)")
