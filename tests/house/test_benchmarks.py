"""Every benchmark runs: one that names what is no longer there would be noticed only when figures are wanted."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DEAR = "tidal_gauge or one_hundred_thousand or test_design[satellite or triple_integrator"
"""Minutes each; what they call is called by others as well."""


@pytest.mark.long
def test_every_benchmark_runs():
    files = sorted((ROOT / "tests" / "benchmarks").glob("bench_*.py"))
    command = [sys.executable, "-m", "pytest", "-q", "--benchmark-disable", "-p", "no:cacheprovider", "-p", "no:xdist"]
    ended = subprocess.run(
        [*command, "-k", f"not ({DEAR})", *files], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stdout[-2000:]
    assert int(re.search(r"(\d+) passed", ended.stdout)[1]) > 5 * len(files)
