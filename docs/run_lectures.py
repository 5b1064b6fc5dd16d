"""Lectures to change and run: `jupyter server --config run_lectures.py` serves this folder, on this machine alone.

It opens the list of lectures in a browser. Who may ask for a kernel is judged by the server's token, as always.
"""

import os
from pathlib import Path

os.environ.pop("MPLBACKEND", None)  # one that somebody exports would take the place of the kernels' own

c = get_config()  # noqa: F821
c.ServerApp.ip = "localhost"
c.ServerApp.open_browser = True
c.ServerApp.default_url = "/static/made/notebooks/index.html"
c.ServerApp.extra_static_paths = [str(Path(__file__).resolve().parent)]
c.ServerApp.terminals_enabled = False
c.MappingKernelManager.cull_idle_timeout = 600  # s: of a kernel whose page is gone without a word
c.MappingKernelManager.cull_interval = 60
