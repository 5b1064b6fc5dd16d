"""Every certificate that an executed page makes is decided in ball arithmetic, and the build fails where one is open.

Kernels are told by a start-up file of their own IPython folder to keep what they make (`tests/kept_certificates.py`),
beside the cache of executed cells: a page from the cache has its certificates from the run that filled it.
"""

import os
import tempfile
from importlib.util import find_spec
from pathlib import Path

LEAST = 100
"""All pages together make hardly more."""


def collect(root, folder):
    """Tell kernels that are started from here on where to keep certificates."""
    from tests.kept_certificates import FOLDER

    (folder / "proven").mkdir(parents=True, exist_ok=True)
    profile = Path(tempfile.mkdtemp(prefix="ipython-"))
    startup = profile / "profile_default" / "startup"
    startup.mkdir(parents=True)
    where = f"import sys; sys.path.insert(0, {str(root)!r})\n"
    first = f"{where}from tests.kept_certificates import watch; watch(); del watch\n"
    (startup / "00_keep_certificates.py").write_text(first)
    os.environ[FOLDER] = str(folder)
    os.environ["IPYTHONDIR"] = str(profile)


def open_certificates(folder):
    """Say of every new certificate of the folder that is not proven what is wrong with it; () where all are."""
    from tests.kept_certificates import open_ones

    if find_spec("flint") is None:
        return ("python-flint decides them, and it is not installed: pip install 'sampling-design[rigorous]'",)
    told = tuple(open_ones(folder))
    number = len(list((folder / "proven").glob("*.json")))
    if not told and number < LEAST:
        return (f"{number} certificates were made, {LEAST} at least were expected",)
    return told
