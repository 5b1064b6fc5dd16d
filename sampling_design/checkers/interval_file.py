"""What a file of claim "interval" holds: what was read, the bounds, and gains that prove the ends of rows."""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .parts import AROUND, Plant, misnamed
from .strict import (
    Array,
    Tree,
    flag,
    label,
    line,
    list_of,
    matrix,
    nonnegative,
    number,
    or_nothing,
    positive,
    refuse,
    table,
)

_numbers = list_of(number)
_row = table({"row": _numbers, "y": number, "size": nonnegative, "below": flag, "since": or_nothing(number)})
_timed = table({"t": number, "rows": list_of(_row)})
_factors = {"all": or_nothing(nonnegative), "w": or_nothing(nonnegative), "v": or_nothing(nonnegative)}
INTERVAL = table(
    {
        **AROUND,
        "t": number,
        "rows": table({"names": list_of(label), "units": list_of(line), "matrix": matrix()}),
        "lower": list_of(or_nothing(number)),
        "upper": list_of(or_nothing(number)),
        "gains": list_of(matrix()),
        "scales": list_of(positive),
        "start": table({"time": number, "centre": _numbers, "root": or_nothing(matrix()), "ball": flag}),
        "w": table({"centre": _numbers, "root": matrix(), "ball": flag}),
        "noise_together": flag,
        "inputs": list_of(table({"t": number, "u": _numbers})),
        "readings": list_of(lambda value, place: timed(value, place)),
        "disproof": or_nothing(table({"factors": table(_factors), "gains": table(dict.fromkeys(_factors, _numbers))})),
    },
    whole="the certificate",
)


@dataclass(frozen=True)
class Reading:
    """|row x - y| <= size at a time, or row x <= y + size (`below`); a mean of row x from `since` on."""

    row: Array
    y: float
    size: float
    below: bool
    since: float | None


TimedReadings = tuple[float, list[Reading], str]
"""A time, what was read then, and where that stands in the file."""


@dataclass(frozen=True)
class OfInterval:
    """Rows of x(t) with their ends (None: not bounded) and gains (r, 2, R), or a contradiction's factors (infinite: no
    factor suffices) and gains.

    x(times[0]) = centre + root a (anything without a root) and w = w_centre + w_root a, where |a| <= 1 in the
    Euclidean norm (`ball`) or entry by entry; u from `inputs`, each from its time on.
    """

    plant: Plant
    t: float
    rows: Array
    names: tuple[str, ...]
    units: tuple[str, ...]
    ends: list[tuple[float | None, float | None]]
    gains: Array
    scales: Array
    centre: Array
    root: Array | None
    start_ball: bool
    w_centre: Array
    w_root: Array
    w_ball: bool
    together: bool
    inputs: list[tuple[float, Array]]
    times: list[float]
    readings: list[list[Reading]]
    factors: dict[str, tuple[float, Array]] | None


def of_interval(read: Tree, plant: Plant) -> OfInterval:
    """The claim in a file's table, every size derived from the plant and compared."""
    n, q = plant.n, plant.G.shape[1]
    rows, R = read["rows"]["matrix"], sum(len(rows) for _, rows, _ in read["readings"])
    r = len(rows)
    need(n > 0 and r > 0 and rows.shape == (r, n), "rows.matrix", f"must have rows of {n} numbers")
    for key in ("names", "units"):
        need(len(read["rows"][key]) == r, f"rows.{key}", f"must have {r} entries")
    called = list(zip(read["rows"]["names"], read["rows"]["units"], strict=True))
    name = misnamed(rows, called, plant.C, plant.states, plant.outputs)
    need(name is None, "rows", f"calls {name!r} what is not that state or output of the plant")
    for key in ("lower", "upper", "gains"):
        need(len(read[key]) == r, key, f"must have {r} entries")
    for k, pair in enumerate(read["gains"]):
        need(pair.shape == (2, R), f"gains[{k}]", f"must have 2 rows of {R} numbers")
    start, w = read["start"], read["w"]
    need(len(start["centre"]) == n, "start.centre", f"must have {n} entries")
    need(start["root"] is None or start["root"].shape[0] == n, "start.root", f"must have {n} rows")
    need(len(w["centre"]) == q, "w.centre", f"must have {q} entries")
    need(len(w["root"]) == q, "w.root", f"must have {q} rows")
    times, readings = in_order(read["readings"], start["time"], n)
    need(read["t"] >= times[-1], "t", "must not lie before the last reading")
    means = {one.row.tobytes() for some in readings for one in some if one.since is not None}
    need(len(read["scales"]) == n + len(means), "scales", f"must have {n + len(means)} entries")
    given = [(one["t"], np.array(one["u"], dtype=np.float64)) for one in read["inputs"]]
    m = plant.B.shape[1]
    need(all(len(u) == m for _, u in given), "inputs", f"must each have {m} entries of u")
    need(all(a < b for (a, _), (b, _) in pairwise(given)), "inputs", "must be in order of time")
    factors = None
    if read["disproof"] is not None:
        found = read["disproof"]
        need(all(len(g) == R for g in found["gains"].values()), "disproof.gains", f"must have {R} numbers each")
        nothing = all(end is None for end in (*read["lower"], *read["upper"]))
        need(nothing, "lower", "must be null where the data contradict the bounds")
        stated = {key: math.inf if value is None else float(value) for key, value in found["factors"].items()}
        factors = {key: (value, np.array(found["gains"][key])) for key, value in stated.items()}
    return OfInterval(
        plant=plant,
        t=read["t"],
        rows=rows,
        names=tuple(read["rows"]["names"]),
        units=tuple(read["rows"]["units"]),
        ends=list(zip(read["lower"], read["upper"], strict=True)),
        gains=np.array(read["gains"]).reshape(r, 2, R),
        scales=np.array(read["scales"]),
        centre=np.array(start["centre"]),
        root=start["root"],
        start_ball=start["ball"],
        w_centre=np.array(w["centre"], dtype=np.float64),
        w_root=w["root"],
        w_ball=w["ball"],
        together=read["noise_together"],
        inputs=given,
        times=times,
        readings=readings,
        factors=factors,
    )


def timed(value: object, place: str) -> "TimedReadings":
    """What was read at one time."""
    read = _timed(value, place)
    rows = [Reading(**{**one, "row": np.array(one["row"], dtype=np.float64)}) for one in read["rows"]]
    return read["t"], rows, place


def in_order(given: list["TimedReadings"], start: float, n: int) -> tuple[list[float], list[list[Reading]]]:
    """Times and what was read at each: the first is the start; means begin at one of them and do not overlap."""
    times = [t for t, _, _ in given]
    need(bool(times) and times[0] == start, "readings", "must begin at the time of the start")
    need(all(a < b for a, b in pairwise(times)), "readings", "must be in order of time")
    ended: dict[bytes, float] = {}
    for t, rows, place in given:
        for one in rows:
            need(one.row.shape == (n,), f"{place}.rows", f"must have rows of {n} numbers")
            if one.since is not None:
                known = one.since in times and one.since < t
                free = ended.get(one.row.tobytes(), times[0]) <= one.since
                words = "has a mean that does not begin at an earlier time, after the one before"
                need(known and free, f"{place}.rows", words)
                ended[one.row.tobytes()] = t
    return times, [rows for _, rows, _ in given]


def need(holds: bool, place: str, what: str) -> None:
    """Refuse what does not hold."""
    if not holds:
        raise refuse(place, what)
