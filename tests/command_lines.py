"""Command lines with valid and broken files and flags, for the law that nothing raw comes out of the command line.

`python -m tests.command_lines 300 7` runs 300 of them from seed 7 and prints what is raw, `... 300 7 wrong` as many
that have something wrong with them, drawn from the grammar of the commands' own arguments.
"""

from __future__ import annotations

import contextlib
import functools
import io
import os
import resource
import signal
import sys
import tempfile
import warnings
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import sampling_design as sd
from sampling_design.cli.app import loaded
from sampling_design.cli.settings import flags_of
from sampling_design.planning.requirement_file import write_plan_requirement
from tests.front_door import EXAMPLES, MEMORY

SECONDS = 60
CODES = {0, 1, 2, 3}


@functools.cache
def files() -> dict[str, Path]:
    """Valid files of an oscillator, and everything that can be wrong with a file."""
    place = Path(tempfile.mkdtemp(prefix="command-lines-"))
    plant, schedule = sd.read_plant(EXAMPLES / "plants" / "oscillator.toml"), sd.PeriodicSchedule([0.7, 1.6, 0.9])
    schedule = sd.PeriodicSchedule([0.7, 1.6, 0.9], time_unit="s")
    certificate = sd.certify(plant, schedule, eta=0.4, P2=np.eye(2))
    made = {name: place / name for name in ("plant.toml", "plant.json", "plant.npz", "schedule.csv", "schedule.json")}
    made |= {name: place / name for name in ("requirement.toml", "certificate.json", "measurements.csv")}
    for name in ("plant.toml", "plant.json", "plant.npz"):
        sd.plants.write_plant(plant, made[name])
    for name in ("schedule.csv", "schedule.json"):
        sd.schedules.write_schedule(schedule, made[name])
    sd.design.write_requirement(sd.Requirement(window=4.0, spacing=0.5, samples=3), made["requirement.toml"])
    certificate.save(made["certificate.json"])
    sd.estimators.write_measurements(sd.simulate_record(plant, schedule, 6.0).measurements, made["measurements.csv"])
    terms = {"position": {"noise_bound": 0.2}}
    wanted = sd.PlanRequirement({"position": 0.6}, period=6.4, grid=0.8, w_bound=0.02, sensors=terms)
    made["wanted.toml"] = write_plan_requirement(wanted, place / "wanted.toml")
    plan = sd.plan_samples(plant, wanted, search_seconds=1.0, certificate=False, robustness=False, from_start=False)
    made["planned.json"] = plan.save(place / "planned.json")
    for name, path in list(made.items()):
        made |= _broken(place, name, path.read_bytes())
    made |= {"missing": place / "nosuch.toml", "folder": place, "device": Path("/dev/null"), "": Path("")}
    return made


def _broken(place: Path, name: str, content: bytes) -> dict[str, Path]:
    """Copies of one file with one thing wrong each."""
    stem, _, suffix = name.rpartition(".")
    text = content.decode("utf-8", "ignore")
    lines = text.splitlines()
    kinds = {
        "empty": b"", "half": content[: len(content) // 2], "cut": content[:-3], "binary": bytes(range(256)) * 20,
        "utf16": text.encode("utf-16"), "bom": b"\xef\xbb\xbf" + content, "crlf": content.replace(b"\n", b"\r\n"),
        "semicolons": text.replace(",", ";").encode(), "decimals": text.replace(",", ";").replace(".", ",").encode(),
        "nan": text.replace("1.0", "nan", 1).replace("1.6", "nan", 1).encode(),
        "infinite": text.replace("1.0", "1e999", 1).replace("0.7", "1e308", 1).encode(),
        "twice": content + content, "doubled": "\n".join([*lines, *lines[-1:], ""]).encode(),
        "backwards": "\n".join([*lines[:2], *lines[:1:-1], ""]).encode(), "spaces": b" \n" * 50,
        "deep": (b"[" * 100_000) if suffix == "json" else b"a = " + b"[" * 20_000, "nul": content.replace(b"\n", b"\0"),
        "long": content + b"9" * 200_000 + b"\n", "text": text.replace("1", "one").encode(),
        "negative": text.replace("0.", "-0.").encode(), "list": b"[1, 2, 3]\n", "units": text.replace('"s"', '"ly"')
        .replace("=s", "=ly").encode(),
    }  # fmt: skip
    made = {}
    for kind, data in kinds.items():
        path = place / f"{stem}-{kind}.{suffix}"
        path.write_bytes(data)
        made[path.name] = path
    return made


COMMANDS = {
    "new": ((), {"--oscillation": "24", "--decay": "2,3", "--open": "7-19", "--samples": "3", "--period": "48",
                  "--within": "0.5", "--noise": "0.1", "--disturbance": "0.01", "--start": "2026-03-02",
                  "--zone": "UTC"}),
    "info": (("plant",), {"--window": "4"}),
    "design": (("plant", "requirement"), {"--samples": "3", "--branches": "1", "--start": "2026-01-01"}),
    "sigma": (("plant", "schedule"), {"--window": "4", "--rigorous": None}),
    "worst-case": (("plant",), {"--window": "4", "--count": "3", "--spacing": "0.5", "--rtol": "0.1"}),
    "pareto": (("plant", "requirement"), {"--counts": "2,3", "--workers": "1"}),
    "losses": (("plant", "requirement"), {"--every-period": None}),
    "certify": (
        ("plant", "schedule"),
        {
            "--eta": "0.4", "--noise-gain": "3", "--timing-tolerance": "0.01", "--gap-range": "0.9 1.1",
            "--detectability": None,
        },
    ),
    "plan": (("plant", "wanted"), {}),
    "next": (("planned",), {"--now": "1.5"}),
    "accuracy": (("plant", "schedule"), {"--w": "0.1", "--v": "0.2", "--of": "position", "--rtol": "0.1"}),
    "explore": (
        ("plant", "requirement"),
        {"--w": "0.1", "--v": "0.2", "--tolerance": "0.1,0.2", "--schedule": "SCHEDULE", "--port": "0"},
    ),
    "robustness": (("plant", "certificate"), {"--longest": "2", "--horizon": "8"}),
    "verify": (("certificate",), {"--plant": "PLANT", "--rigorous": None}),
    "estimate": (
        ("plant", "measurements"),
        {"--eta": "0.4", "--prior": "0,0", "--w-bound": "0.1", "--v-bound": "0.1,", "--schedule": "SCHEDULE",
         "--certificate": "CERTIFICATE", "--horizon": "8"},
    ),
    "validate": (("plant", "schedule"), {"--runs": "2", "--duration": "4", "--workers": "1", "--eta": "0.4"}),
    "compare": (("plant", "schedule", "measurements"), {"--window": "4"}),
    "thyroid": ((), {"--days": "0.1", "--runs": "1", "--workers": "1", "--reading": "per_day"}),
}  # fmt: skip
"""Each command, the kinds of its files, and flags with right values."""
USUAL = {
    "plant": "plant.toml", "schedule": "schedule.csv", "requirement": "requirement.toml",
    "certificate": "certificate.json", "measurements": "measurements.csv", "wanted": "wanted.toml",
    "planned": "planned.json",
}  # fmt: skip
VALUES = ["nan", "inf", "-1", "0", "1e308", "abc", "", "1,2", "1e18", "2.5", "9" * 400, "é", "²", "--json", "0x10"]
ALWAYS = {"thyroid": ["--days", "0.1", "--runs", "1", "--workers", "1"], "validate": ["--runs", "2"],
          "worst-case": ["--window", "4", "--count", "3", "--spacing", "0.5"], "pareto": ["--counts", "2,3"],
          "robustness": ["--longest", "2"], "design": ["--branches", "1"],
          "explore": ["--idle", "0.2", "--no-browser"],
          "new": [tempfile.mkdtemp(), "--force", "--oscillation", "24"]}  # fmt: skip


def drawn(count: int, seed: int) -> list[list[str]]:
    """So many random command lines; each has up to two things that may be wrong."""
    rng = np.random.default_rng(seed)
    lines = []
    for _ in range(count):
        name = str(rng.choice(list(COMMANDS)))
        kinds, flags = COMMANDS[name]
        arguments = [str(files()[USUAL[kind]]) for kind in kinds]
        if arguments and rng.random() < 0.7:
            at = int(rng.integers(len(arguments)))
            own = [key for key in files() if key.startswith(USUAL[kinds[at]].split(".")[0])]
            pool = own if rng.random() < 0.75 else list(files())
            arguments[at] = str(files()[pool[rng.integers(len(pool))]])
        if kinds[-1:] == ("requirement",) and rng.random() < 0.3:
            arguments.pop()
        line = [name, *arguments, *ALWAYS.get(name, []), "--quiet"]
        line += ["--budget", "3"] if "budget" in flags_of(name) else []
        for flag in rng.permutation(list(flags))[: int(rng.integers(0, 3))]:
            value = flags[str(flag)]
            line.append(str(flag))
            if value is not None:
                wrong = rng.random() < 0.5 and not value.isupper()
                named = files()[USUAL[value.lower()]] if value.lower() in USUAL else value
                line += [str(rng.choice(VALUES))] if wrong else str(named).split(" ")
        chance = rng.random()
        if chance < 0.25:
            line += ["--json"]
        if 0.2 < chance < 0.35:
            line += ["-o", str(rng.choice(["/dev/full", "/proc/nowhere", str(files()["plant.toml"]), "\0", ""]))]
        if chance > 0.85:
            line += [str(rng.choice(["--seed", "--decay-rate", "--budget"])), str(rng.choice(VALUES))]
        lines.append(line)
    return lines


@functools.cache
def options(name: str) -> list[Any]:
    """The options that a command declares, those of every command among them."""
    declared = loaded(name).params
    return [one for one in declared if one.param_type_name == "option" and not {"--version", "--help"} & {*one.opts}]


def wrong(count: int, seed: int) -> list[list[str]]:
    """So many random command lines with something wrong in each: one thing, in every third two."""
    rng = np.random.default_rng(seed)
    names, lines = list(COMMANDS), []
    for k in range(count):
        name = names[k % len(names)] if k < len(names) else str(rng.choice(names))
        arguments = [str(files()[USUAL[kind]]) for kind in COMMANDS[name][0]]
        line = [name, *arguments, *ALWAYS.get(name, []), "--quiet"]
        line += ["--budget", "3"] if "budget" in flags_of(name) else []
        for _ in range(1 + (rng.random() < 1 / 3)):
            line = _spoilt(line, len(arguments), rng)
        lines.append(line)
    return lines


def _spoilt(line: list[str], arguments: int, rng: np.random.Generator) -> list[str]:
    """The line with one thing wrong: an option's value, number or name; an argument's file or number."""
    chosen = options(line[0])[int(rng.integers(len(options(line[0]))))]
    flag = str(rng.choice(chosen.opts))
    values = [str(rng.choice(VALUES)) for _ in range(0 if chosen.is_flag else chosen.nargs)]
    kind = int(rng.integers(10))
    if kind < 5:  # a value that is none, or one for what takes none
        return [*line, flag, *(values or [str(rng.choice(VALUES))])]
    if kind == 5:  # a value too few, or one for what takes none
        return [*line, *([flag, *values[:-1]] if values else [f"{flag}={rng.choice(VALUES)}"])]
    if kind == 6:  # misspelt
        return [*line, flag[:-1] + "x", *values]
    if kind == 7 and len(line) > 1:  # something left out
        at = int(rng.integers(1, len(line)))
        return line[:at] + line[at + 1 :]
    if kind == 8 or not arguments:
        return [*line, str(rng.choice([str(path) for path in files().values()]))]
    at = int(rng.integers(1, 1 + arguments))
    return [*line[:at], str(rng.choice([str(path) for path in files().values()])), *line[at + 1 :]]


@dataclass
class Ended:
    """What a command line came to."""

    code: object
    out: str
    err: str

    def raw(self) -> str:
        """What must not be: a traceback, a code that means nothing, or an end without a word ("": in order)."""
        if self.code not in CODES:
            return f"code {self.code}: {self.err[-600:]}"
        if "Traceback" in self.err + self.out:
            return f"traceback: {self.err[-600:]}"
        if self.code and not (self.err.strip() or self.out.strip()):
            return f"code {self.code} without a word"
        return ""


class _Hang(BaseException):
    pass


def run(line: list[str]) -> Ended:
    """Run one command line in this process, as a shell would."""
    from sampling_design.cli import main

    def ring(*_: object) -> None:
        raise _Hang

    out, err, argv = io.StringIO(), io.StringIO(), sys.argv
    before = signal.signal(signal.SIGVTALRM, ring)
    signal.setitimer(signal.ITIMER_VIRTUAL, SECONDS)
    sys.argv = ["sampling-design", *line]
    code: object = "none"
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            main()
    except SystemExit as stop:
        code = stop.code or 0
    except _Hang:
        code = f"hangs, over {SECONDS} s"
    except Exception as error:
        code = f"{type(error).__name__}: {error}"
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
        signal.signal(signal.SIGVTALRM, before)
        sys.argv = argv
    return Ended(code, out.getvalue(), err.getvalue())


def main() -> None:
    """Run as many command lines as asked, and list the raw ones."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    count, seed = int(sys.argv[1]), int(sys.argv[2])
    lines = wrong(count, seed) if sys.argv[3:] else drawn(count, seed)
    os.chdir(tempfile.mkdtemp(prefix="command-lines-cwd-"))
    ends: Counter[object] = Counter()
    raw = 0
    for line in lines:
        ended = run(line)
        ends[ended.code] += 1
        if found := ended.raw():
            raw += 1
            print("sampling-design", " ".join(line), "\n   ", found[-700:], flush=True)
    print(f"{raw} raw of {count}; exit codes {dict(ends)}")


if __name__ == "__main__":
    main()
