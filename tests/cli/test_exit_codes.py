"""How the command line ends: interrupts, outputs that cannot be written, defects."""

import importlib
import io
import json
import os
import signal
import subprocess
import sys
import time
from itertools import product
from pathlib import Path

import pytest

from sampling_design.cli import exit_codes
from tests.cases import few

EXAMPLES = Path(__file__).parents[2] / "examples"
OSCILLATOR, SATELLITE = (EXAMPLES / "plants" / f"{name}.toml" for name in ("oscillator", "satellite"))
INTERRUPTED = """
import os, signal, sys, threading, time
from sampling_design.cli import main

def interrupt():
    while signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # Python's own start is not ours to catch
        time.sleep(1e-4)
    while loaded not in sys.modules:
        time.sleep(1e-3)
    time.sleep(after)
    os.kill(os.getpid(), number)

loaded, after, number = sys.argv.pop(1), float(sys.argv.pop(1)), int(sys.argv.pop(1))
threading.Thread(target=interrupt, daemon=True).start()
main()
"""


MOMENTS = [
    *product(["sys"], (0.002, 0.05, 0.1, 0.2, 0.3, 0.5), exit_codes.SIGNALS),
    *product(["sampling_design.design.search.local_search"], (0.1, 1.0), exit_codes.SIGNALS),
]
"""Seconds after the start, and after what searches is there."""


@pytest.mark.parametrize(("loaded", "after", "number"), few(MOMENTS, 0, 4, 13))
def test_an_interrupt_at_any_moment_is_130_without_a_traceback(loaded, after, number):
    """From the first line on: while numpy, scipy and the drawing load, and while the search runs."""
    command = ["design", str(SATELLITE), str(EXAMPLES / "requirements" / "satellite.toml"), "--branches", "100000"]
    found = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, loaded, str(after), str(int(number)), *command],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (found.returncode, "Traceback" in found.stderr) == (130, False), found.stderr
    assert "sampling-design: interrupted." in found.stderr


WHO_LISTENS = """
import pathlib, signal, sys
if any("popen_loky" in word for word in sys.orig_argv):
    deaf = signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])
    with open(pathlib.Path(__file__).with_name("deaf.txt"), "a") as told:
        told.write(f"{deaf} ")
"""


@pytest.mark.long
def test_processes_that_share_the_work_begin_deaf_to_interrupts(tmp_path):
    """Python's own traceback would be on the screen otherwise, once for each process that is still loading."""
    (tmp_path / "sitecustomize.py").write_text(WHO_LISTENS)
    code = (
        "import math; from sampling_design.records.workers import numbered; "
        "print(sorted(numbered(math.sqrt, [4.0, 9.0], 2)))"
    )
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    told = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=True,
    )
    assert told.stdout == "[(0, 2.0), (1, 3.0)]\n"
    assert (tmp_path / "deaf.txt").read_text() == "True True "


def of_all(pid):
    """As a terminal does."""
    os.killpg(pid, signal.SIGINT)


def of_the_first_alone(pid):
    """As `kill` and batch systems do: the others held what it wrote to open, minutes after its end."""
    os.kill(pid, signal.SIGTERM)


@pytest.mark.long
@pytest.mark.parametrize("interrupt", [of_all, of_the_first_alone])
def test_an_interrupt_ends_the_processes_that_share_the_work(interrupt):
    code = "from sampling_design.cli import main; main()"
    command = [sys.executable, "-c", code, "pareto", str(SATELLITE), "--counts", "8-40", "--workers", "2"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        with pytest.raises(subprocess.TimeoutExpired):
            process.wait(6)
        interrupt(process.pid)
        told = process.communicate(timeout=30)[1]
    assert process.returncode == 130
    assert "Traceback" not in told


def test_an_error_of_a_library_that_an_interrupt_caused_is_the_interrupt(shell, monkeypatch):
    from sampling_design.cli import app

    def swallowed(*_, **__):
        try:
            os.kill(os.getpid(), signal.SIGINT)
        except KeyboardInterrupt:
            raise ImportError("cannot load") from None

    monkeypatch.setattr(app, "app", swallowed)
    before = signal.getsignal(signal.SIGINT)
    result = shell("info")
    signal.signal(signal.SIGINT, before)
    assert result.code == 130
    assert result.err == "sampling-design: interrupted.\n"


def test_an_interrupt_of_code_that_is_made_while_a_module_runs_is_130(tmp_path):
    """Of a named tuple, as they are made while the package loads."""
    made = "exec('import os; os.kill(os.getpid(), 2); [0 for _ in range(10**6)]')"
    command = f"from sampling_design.cli import exit_codes\nexit_codes._run = lambda: {made}\nexit_codes.main()"
    (tmp_path / "made.py").write_text(command)
    command = [sys.executable, "-m", "made"]
    found = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stderr) == (130, "sampling-design: interrupted.\n")


def test_an_interrupt_after_the_work_is_done_changes_nothing_of_it():
    """Whatever Python still does on its way out."""
    late = "import atexit, os, signal; atexit.register(lambda: os.kill(os.getpid(), signal.SIGINT))"
    command = f"{late}\nimport sys; from sampling_design.cli import main; sys.argv[1:] = ['--version']; main()"
    found = subprocess.run([sys.executable, "-c", command], capture_output=True, text=True, check=False)
    assert (found.returncode, found.stderr) == (0, "")


def test_a_file_that_is_half_written_when_the_program_is_ended_is_not_there(tmp_path):
    """Its beginning stayed beside it under another name."""
    code = (
        "import os, signal; from sampling_design.cli import exit_codes; from sampling_design.records import file_io\n"
        "def half():\n"
        "    with file_io.atomic_file('plan.json') as write:\n"
        "        write(b'{'); os.kill(os.getpid(), signal.SIGTERM)\n"
        "exit_codes._run = half; exit_codes.main()"
    )
    found = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (found.returncode, found.stderr, [*tmp_path.iterdir()]) == (130, "sampling-design: interrupted.\n", [])


def test_after_a_command_interrupts_are_as_they_were(shell):
    before = ([signal.getsignal(each) for each in exit_codes.SIGNALS], sys.unraisablehook)
    shell("--version")
    assert ([signal.getsignal(each) for each in exit_codes.SIGNALS], sys.unraisablehook) == before


@pytest.mark.parametrize("more", few([["--json"], [], ["--help"]], 0))
def test_a_full_device_is_one_sentence_and_exit_code_2(more):
    code = "from sampling_design.cli import main; main()"
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-c", code, "info", str(OSCILLATOR), "--quiet", *more]
        found = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert found.returncode == 2
    assert found.stderr == "sampling-design: the output cannot be written (No space left on device).\n"


def test_a_reader_that_goes_away_is_no_error():
    code = "from sampling_design.cli import main; main()"
    command = [sys.executable, "-c", code, "info", str(OSCILLATOR), "--quiet", "--json"]
    files, writing = os.pipe()
    os.close(files)
    found = subprocess.run(command, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (found.returncode, found.stderr) == (0, "")


def test_a_folder_that_is_full_is_one_sentence(shell):
    result = shell("info", OSCILLATOR, "-o", "/dev/full")
    assert result.code in (0, 2)
    result = shell("sigma", OSCILLATOR, OSCILLATOR, "-o", "/dev/full")
    assert result.code == 2


def test_a_defect_is_told_apart_from_a_no(shell, monkeypatch):
    from sampling_design.cli import files

    def broken(*_, **__):
        raise AttributeError("no such thing\nat all")

    monkeypatch.setattr(files, "plant", broken)
    result = shell("info", OSCILLATOR)
    assert result.code == 70
    assert result.err.splitlines()[-1].startswith("sampling-design: a defect of this program, please report it")
    assert "Traceback" in result.err


def test_memory_and_numbers_of_processes(shell, monkeypatch):
    from sampling_design.cli import files

    def greedy(*_, **__):
        raise MemoryError("Unable to allocate 60 GiB")

    monkeypatch.setattr(files, "plant", greedy)
    result = shell("info", OSCILLATOR)
    assert (result.code, "needs more memory than there is (Unable to allocate 60 GiB)" in result.err) == (3, True)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("design", OSCILLATOR, "--seed", -1), "`--seed` must be a whole number of at least 0, got -1"),
        (("design", OSCILLATOR, "--budget", 0), "`--budget` must be positive"),
        (("design", OSCILLATOR, "--budget", "nan"), "`--budget` must be finite"),
        (("pareto", OSCILLATOR, "--counts", "2,3", "--workers", 0), "`--workers` must be a number of processes"),
        (("thyroid", "--workers", 0), "`--workers` must be a number of processes"),
    ],
)
def test_flags_out_of_range_are_one_sentence(shell, arguments, words):
    result = shell(*arguments, "--quiet")
    assert result.code == 2
    assert words in result.err
    assert result.err.count("\n") == 1


@pytest.mark.parametrize(("given", "kept"), [(None, "1"), ("2", "2")])
def test_the_blas_has_one_thread_unless_somebody_says_otherwise(shell, monkeypatch, given, kept):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", given or "")
    if given is None:
        monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    assert shell("--version").code == 0
    assert os.environ["OPENBLAS_NUM_THREADS"] == kept


def test_help_shows_brackets_and_one_unbroken_example(shell):
    told = shell("info", "--help").out
    assert "[time unit]" in told
    told = shell("certify", "--help").out
    example = "  Example: sampling-design certify examples/plants/oscillator.toml out/schedule.csv --eta 0.3 -o out"
    assert any(line.startswith(example) for line in told.splitlines())


def test_the_package_runs_as_a_module():
    command = [sys.executable, "-m", "sampling_design", "--version"]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (told.returncode, told.stdout.split()[0], told.stderr) == (0, "sampling-design", "")
    importlib.import_module("sampling_design.__main__")  # as worker processes do: nothing runs


@pytest.mark.long
def test_a_validation_that_was_killed_goes_on(tmp_path):
    """The process dies with no warning; the second one certifies anew, and the certificate is the same."""
    schedule = tmp_path / "schedule.csv"
    schedule.write_text("# sampling-design schedule; time_unit=s; period=1.0\ntime\n1.0\n")
    short = ["--eta", "0.4", "--runs", "150", "--duration", "9", "--quiet"]
    arguments = ["validate", str(OSCILLATOR), str(schedule), *short, "-o"]
    command = [sys.executable, "-m", "sampling_design", *arguments]
    assert subprocess.run([*command, str(tmp_path / "whole")], check=False, capture_output=True).returncode == 0
    killed, journal = tmp_path / "killed", tmp_path / "killed" / "validation.journal"
    with subprocess.Popen([*command, str(killed)], stdout=subprocess.DEVNULL) as process:
        while not journal.exists() or journal.read_bytes().count(b"\n") < 3:
            assert process.poll() is None
            time.sleep(0.002)
        process.kill()
    kept = journal.read_bytes().count(b"\n")
    again = subprocess.run([*command, str(killed)], check=False, capture_output=True, text=True)
    assert (again.returncode, again.stderr) == (0, "")
    assert kept >= 3
    assert (killed / "report.json").read_bytes() == (tmp_path / "whole" / "report.json").read_bytes()


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "latin-1", "utf-8"])
def test_letters_that_the_output_cannot_hold_are_written_as_json_escapes_them(encoding, monkeypatch):
    names, written = ["öszi", "日 σ", "±\U0001f321"], io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding=encoding))
    monkeypatch.setattr(exit_codes, "_run", lambda: print(json.dumps(names, ensure_ascii=False), flush=True) or 0)
    with pytest.raises(SystemExit) as end:
        exit_codes.main()
    assert end.value.code == 0
    assert json.loads(written.getvalue().decode(encoding)) == names
