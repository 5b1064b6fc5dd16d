"""What certificate files of several claims share: plant, weights, and what stands around them, as frozen records.

Sizes come from the plant: n states, p outputs, q disturbances.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from .outcome import Verdict
from .strict import (
    Array,
    Reader,
    Tree,
    anything,
    count,
    label,
    line,
    list_of,
    matrix,
    nonnegative,
    positive,
    refuse,
    table,
    text,
    word,
)


def signals_of(read: Tree, n: int, p: int, q: int) -> None:
    """Refuse signals that do not name what the matrices hold: nothing is proven of them, but they are read."""
    m, given = read["matrices"], {key: len(read[key]["names"]) for key in ("inputs", "disturbances") if key in read}
    inputs = (m["B"].shape[1] if "B" in m else 0) if n else given.get("inputs", 0)  # no rows say no columns
    for key, shape in (("B", (n, inputs)), ("D", (p, inputs))):
        if key in m and m[key].shape != shape and n:
            raise refuse(f"plant.matrices.{key}", f"must have shape {shape}, got {m[key].shape}")
    sizes = {"states": n, "outputs": p, "inputs": inputs, "disturbances": q if n else given.get("disturbances", 0)}
    for key, size in sizes.items():
        table = read.get(key, {"names": [""] * size})
        if key in read and len(set(table["names"])) < len(table["names"]):
            raise refuse(f"plant.{key}.names", "must be distinct")
        for column, entries in table.items():
            if len(entries) != size and (entries or column != "units"):
                raise refuse(f"plant.{key}.{column}", f"must have a length of {size}, got {len(entries)}")


FORMAT = "sampling-design/certificate/1"
PLANT_FORMAT = "sampling-design/plant/1"
TIME_UNITS = ("ms", "s", "min", "h", "d", "wk")
time_unit = word(*TIME_UNITS)
SKEW = 1e-12  # entries that differ from their mirror by more, relative to the diagonal, make a matrix not symmetric

SIGNALS = table({"names": list_of(label)}, {"units": list_of(line), "scales": list_of(positive)})
PLANT_TREE: dict[str, Reader] = {
    "format": word(PLANT_FORMAT),
    "matrices": table({"A": matrix(), "C": matrix()}, dict.fromkeys("BDG", matrix())),
    "name": line,
    "time_unit": time_unit,
    **dict.fromkeys(("states", "outputs", "inputs", "disturbances"), SIGNALS),
    "source": table({}, {"citation": text}),
}
_needed = ("format", "matrices")
_plain = {key: item for key, item in PLANT_TREE.items() if key not in _needed}
WHOLE = table({key: PLANT_TREE[key] for key in _needed}, _plain)
PART = table({"plant": WHOLE, "map": matrix(), "rows": count})
"""What a plant is the quotient of, for rows of its state: the first so many of the quotient's."""
PLANT = table({key: PLANT_TREE[key] for key in _needed}, {**_plain, "part_of": PART})
CARRIED = 1e-10
"""What map A = A_q map, C = C_q map and map G = G_q may miss, each entry relative to the terms that make it up."""

AROUND: dict[str, Reader] = {
    "format": word(FORMAT),
    "claim": text,
    "plant": PLANT,
    "tool": table({"name": text, "version": text}),
    "digest": text,
}
SOLVER = table(
    {"name": text, "version": text, "status": text, "iterations": count, "details": anything}, {"seconds": nonnegative}
)
RATES: dict[str, Reader] = {"eta": positive, "margin": nonnegative}
NUMBERS: dict[str, Reader] = {**RATES, "lam": positive, "lam_samples": positive}
MATRICES = dict.fromkeys(("P1", "P2", "Qw", "R", "Qv"), matrix())
Labels = list[tuple[str, str]]
"""Names with their units, in order."""


@dataclass(frozen=True)
class Plant:
    """x' = Ax + Bu + Gw, y = Cx; `part`: rows of another plant's state, which `check_part` has judged."""

    A: Array
    C: Array
    G: Array
    time_unit: str
    part: bool = False
    B: Array = field(default_factory=lambda: np.zeros((0, 0)))
    states: Labels = field(default_factory=list)
    outputs: Labels = field(default_factory=list)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)


@dataclass(frozen=True)
class Weights:
    """Weights and numbers of Assumption 7."""

    P1: Array
    P2: Array
    Qw: Array
    R: Array
    Qv: Array
    eta: float
    lam: float
    lam_samples: float
    margin: float


@dataclass(frozen=True)
class Claim:
    """What a file of a claim holds, no more and no less; its judged content; and what proves it.

    `table` reads the file, `record(read, plant)` makes the record of what was read, and `prove(record, work)` says how
    it is proven, or raises `Refused` or `Undecided` where there is no proof.
    """

    table: Reader
    record: Callable[..., object]
    prove: Callable[..., Verdict]


def of_whole_plant(content: object, proven: Verdict) -> Verdict:
    """The verdict on content that is proven; of a part it says how nearly that is one of the whole plant."""
    if not getattr(getattr(content, "plant", None), "part", False):
        return proven
    return replace(
        proven, reason=f"{proven.reason}; of the whole plant to {CARRIED:g} of the terms that make up each entry"
    )


def digest(data: Mapping[str, object]) -> str:
    """Return the SHA-256 of the canonical JSON (sorted keys, no spaces, UTF-8) without the key `digest`."""
    rest = {key: value for key, value in data.items() if key != "digest"}
    canonical = json.dumps(rest, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(canonical.encode("utf-8")).hexdigest()


def plant_of(read: Tree) -> Plant:
    """The plant, its matrices of sizes that fit."""
    m = read["matrices"]
    if "time_unit" not in read:
        raise refuse("plant.time_unit", "is missing")
    n, p = len(m["A"]), len(m["C"])
    A, C, G = shaped(m["A"], "plant.matrices.A", n, n), m["C"], m.get("G", np.eye(n))
    if (n and C.shape != (p, n)) or (n and len(G) != n) or not p:
        raise refuse("plant.matrices", f"must have n columns in C and n rows in G, n = {n} rows of A, and a row in C")
    signals_of(read, n, p, G.shape[1])
    states, outputs = labels(read.get("states"), "x", n), labels(read.get("outputs"), "y", p)
    B, G, C = m.get("B", np.zeros((n, 0))) if n else A, G.reshape(n, G.shape[1] if n else 0), C.reshape(p, n)
    found = Plant(A, C, G, read["time_unit"], "part_of" in read, B, states, outputs)
    if "part_of" in read:
        part = read["part_of"]
        whole = plant_of({"time_unit": found.time_unit, **part["plant"]})
        check_part(found, whole, part["map"], part["rows"])
        if (name := misnamed(part["map"], states, whole.C, whole.states, whole.outputs)) is not None:
            raise refuse("plant.states", f"calls {name!r} what is not that of the whole plant")
    return found


def labels(signals: Mapping[str, list[str]] | None, letter: str, count: int) -> Labels:
    """Names of states or outputs with their units: what has no name is called x1, x2, ..., or y1, y2, ..."""
    known = signals or {"names": [f"{letter}{i + 1}" for i in range(count)]}
    return list(zip(known["names"], known.get("units") or [""] * count, strict=True))


def check_part(part: Plant, whole: Plant, onto: Array, rows: int) -> None:
    """Refuse a plant that is not the quotient which its file says it is."""
    if whole.time_unit != part.time_unit:
        raise refuse("plant.part_of.plant.time_unit", f"must be {part.time_unit!r}")
    if onto.shape != (part.n, whole.n) or not 1 <= rows <= part.n:
        raise refuse("plant.part_of", f"must have a map of shape {(part.n, whole.n)}, and 1 to {part.n} rows")
    own, other = ((each.A, each.C, np.hstack([each.B, each.G])) for each in (part, whole))
    apart = not_carried(onto, own, other)
    if apart is not None:
        raise refuse("plant.part_of.map", f"does not carry {apart} of the whole plant, each entry to {CARRIED:g}")


def not_carried(onto: Array, part: tuple[Array, Array, Array], whole: tuple[Array, Array, Array]) -> str | None:
    """Which of A, C and G the map of a quotient does not carry: None where all are, to rounding."""
    (A, C, G), (A_whole, C_whole, G_whole) = part, whole
    if G.shape[1] != G_whole.shape[1] or C.shape[0] != C_whole.shape[0]:
        return "the sizes"
    size = np.abs(onto)
    terms = {
        "A": (onto @ A_whole - A @ onto, size @ np.abs(A_whole) + np.abs(A) @ size),
        "C": (C @ onto - C_whole, np.abs(C) @ size + np.abs(C_whole)),
        "G": (onto @ G_whole - G, size @ np.abs(G_whole) + np.abs(G)),
    }
    return next((name for name, (off, of) in terms.items() if not np.all(np.abs(off) <= CARRIED * of)), None)


def misnamed(rows: Array, called: Labels, C: Array, states: Labels, outputs: Labels) -> str | None:
    """The first row of a plant's state called like a state or output of it that is another row or has another unit:
    None where there is none."""
    known = {name: (row, unit) for (name, unit), row in zip(outputs, C, strict=True)}
    known |= {name: (row, unit) for (name, unit), row in zip(states, np.eye(rows.shape[1]), strict=True)}
    for (name, unit), own in zip(called, rows, strict=True):
        row, theirs = known.get(name, (own, unit))
        if unit != theirs or np.any(np.abs(own - row) > CARRIED * np.max(np.abs(row), initial=0.0)):
            return name
    return None


def shaped(M: Array, place: str, *shape: int) -> Array:
    """The matrix, if it has that shape; one without entries says no more."""
    if M.shape != shape and (M.size or np.prod(shape)):
        raise refuse(place, f"must have shape {shape}, got {M.shape}")
    return M.reshape(shape)


def symmetric(M: Array, place: str, size: int) -> Array:
    """The matrix, if it is of that size and symmetric but for rounding."""
    M = shaped(M, place, size, size)
    d = np.sqrt(np.abs(np.diag(M)))
    if np.any(np.abs(M / 2 - M.T / 2) > SKEW / 2 * d * d[:, None]):
        raise refuse(place, "must be symmetric")
    return M


def weights_of(read: Tree, plant: Plant) -> Weights:
    """Symmetric weights of the sizes of the plant."""
    n, p, q = plant.n, len(plant.C), plant.G.shape[1]
    sizes = {"P1": n, "P2": n, "Qw": q, "R": p, "Qv": p}
    found = {key: read[key] for key in (*sizes, *NUMBERS)}
    found |= {key: symmetric(found[key], key, size) for key, size in sizes.items()}
    return Weights(**found)
