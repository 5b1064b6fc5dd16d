"""Kernels that are forked from one process with all modules loaded: to load them takes longer than most pages.

`start` puts a kernel `python3` before others (`JUPYTER_PATH`): this file, run as a program. It asks the process that
has loaded the modules for a fork, which becomes the kernel, and lives as long. Names of a page are its own.
"""

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SOCKET = "DOCS_KERNELS"
"""Environment variable: where forks are asked for."""
INLINE = "module://matplotlib_inline.backend_inline"
"""What a kernel chooses for matplotlib before it is loaded, and here it is loaded earlier."""


def start():
    """Let kernels be forks from here on, and return the process that is forked and the folder of its socket."""
    folder = Path(tempfile.mkdtemp(prefix="kernels-"))
    spec = folder / "kernels" / "python3"
    spec.mkdir(parents=True)
    argv = [sys.executable, "-I", "-S", __file__, "-f", "{connection_file}"]
    (spec / "kernel.json").write_text(json.dumps({"argv": argv, "display_name": "Python 3", "language": "python"}))
    os.environ[SOCKET] = str(folder / "socket")
    os.environ["JUPYTER_PATH"] = os.pathsep.join(filter(None, [str(folder), os.environ.get("JUPYTER_PATH")]))
    loaded = {**os.environ, "MPLBACKEND": INLINE}
    code = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import kernels; kernels.serve()"
    process = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, env=loaded)  # it ends with us
    while not (folder / "socket").exists() and process.poll() is None:
        time.sleep(0.05)
    return process, folder


def serve():
    """Load what pages use, and fork for each request until whoever has started this is gone."""
    import matplotlib.backends.backend_agg
    import matplotlib.pyplot  # noqa: F401
    from ipykernel.kernelapp import IPKernelApp

    sys.path.insert(0, str(Path(__file__).parents[1]))
    import sampling_design
    from tests.kept_certificates import watch

    watch()
    for name in sampling_design.__all__:
        getattr(sampling_design, name)
    sys.path.remove(str(Path(__file__).parents[1]))
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them
    server = socket.socket(socket.AF_UNIX)
    server.bind(os.environ[SOCKET] + ".new")
    server.listen()
    os.rename(os.environ[SOCKET] + ".new", os.environ[SOCKET])
    while server in select.select([server, sys.stdin], [], [])[0]:
        asked, _ = server.accept()
        arguments, folder, environment = json.loads(asked.makefile().readline())
        if os.fork():
            asked.close()
            continue
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        server.close()
        asked.sendall(f"{os.getpid()}\n".encode())  # open until the kernel ends
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        sys.path[:1] = ["", *filter(None, environment.get("PYTHONPATH", "").split(os.pathsep))]
        sys.argv[1:] = arguments
        IPKernelApp.launch_instance(parent_handle=os.getppid())  # it ends with that process
        return


def ask():
    """Stand for one kernel: ask for it, pass signals on to it, and end with it."""
    with socket.socket(socket.AF_UNIX) as kernel:
        kernel.connect(os.environ[SOCKET])
        kernel.sendall(json.dumps([sys.argv[1:], os.getcwd(), dict(os.environ)]).encode() + b"\n")
        told = kernel.makefile()
        number = int(told.readline())

        def pass_on(which, _):
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, which)

        for which in (signal.SIGINT, signal.SIGTERM):
            signal.signal(which, pass_on)
        told.read()


if __name__ == "__main__":
    ask()
