"""The scripts: each runs and asserts its own headline number."""

import ast
import importlib.util
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(FOLDER.glob("0*.py"))


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.stem)
def test_script_runs_and_what_it_claims_holds(path, capsys):
    spec = importlib.util.spec_from_file_location(f"example_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert not capsys.readouterr().out, "nothing happens on import"
    module.main()
    assert capsys.readouterr().out


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.stem)
def test_main_asserts_its_headline(path):
    functions = {node.name: node for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}
    assert sum(isinstance(node, ast.Assert) for node in ast.walk(functions["main"])) >= 3
