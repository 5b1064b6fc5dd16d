"""The scripts: each runs and asserts its own headline number."""

import ast
import importlib.util
from pathlib import Path

import pytest

from tests import kept_certificates

FOLDER = Path(__file__).parents[2] / "examples"
SCRIPTS = sorted(FOLDER.glob("0*.py"))


@pytest.mark.long
@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.stem)
def test_script_runs_what_it_claims_holds_and_its_certificates_are_proven(path, capsys, monkeypatch, tmp_path):
    monkeypatch.setenv(kept_certificates.FOLDER, str(tmp_path))
    spec = importlib.util.spec_from_file_location(f"example_{path.stem}", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    assert not capsys.readouterr().out, "nothing happens on import"
    module.main()
    assert capsys.readouterr().out
    kept_certificates.check_proven(tmp_path, 1 if "sd.certify" in path.read_text() else 0)


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda p: p.stem)
def test_main_asserts_its_headline(path):
    functions = {node.name: node for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}
    assert sum(isinstance(node, ast.Assert) for node in ast.walk(functions["main"])) >= 3
