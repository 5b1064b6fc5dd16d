"""What files say, plainly: facts of trees, of tables and of the records that were read; no import of the package."""

import re

import numpy as np

NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")


def same(a, b, room=1e-9):
    """Whether facts are equal, numbers to a fraction."""
    if isinstance(a, dict) or isinstance(b, dict):
        return (
            isinstance(a, dict)
            and isinstance(b, dict)
            and a.keys() == b.keys()
            and all(same(a[k], b[k], room) for k in a)
        )
    if isinstance(a, (list, tuple, np.ndarray)) or isinstance(b, (list, tuple, np.ndarray)):
        both = all(isinstance(x, (list, tuple, np.ndarray)) for x in (a, b))
        return both and len(a) == len(b) and all(same(x, y, room) for x, y in zip(a, b, strict=True))
    plain = [isinstance(x, (int, float)) and not isinstance(x, (bool, np.bool_)) for x in (a, b)]
    if all(plain):
        return bool(abs(a - b) <= room * max(abs(a), abs(b)))
    return bool(a == b) and type(a) is type(b)


def matrix(rows, columns):
    """A table of numbers; one without rows has the columns asked for."""
    return np.array(rows, dtype=float).reshape(len(rows), len(rows[0]) if len(rows) and len(rows[0]) else columns)


def facts_of_plant(source):
    """Matrices and signals, defaults filled in."""
    if not isinstance(source, dict):
        groups = {g: getattr(source, g) for g in ("states", "outputs", "inputs", "disturbances")}
        signals = {g: (list(s.names), list(s.units), list(s.scales)) for g, s in groups.items()}
        matrices = {key: getattr(source, key) for key in "ABCDG"}
        return {**matrices, **signals, "unit": source.time_unit, "name": source.name, "source": source.source}
    m = source["matrices"]
    n, p = len(m["A"]), len(m["C"])
    facts = {"A": matrix(m["A"], n), "C": matrix(m["C"], n)}
    given = {g: source.get(g) or {} for g in ("states", "outputs", "inputs", "disturbances")}
    inputs = len(given["inputs"].get("names", ()))
    wide = m["B"] if m.get("B") else m.get("D")
    inputs = len(wide[0]) if wide else inputs
    facts["B"] = matrix(m["B"], inputs) if "B" in m else np.zeros((n, inputs))
    facts["D"] = matrix(m["D"], inputs) if "D" in m else np.zeros((p, inputs))
    facts["G"] = matrix(m["G"], len(given["disturbances"].get("names", ()))) if "G" in m else np.eye(n)
    counts = {"states": n, "outputs": p, "inputs": inputs, "disturbances": facts["G"].shape[1]}
    for g, prefix in (("states", "x"), ("outputs", "y"), ("inputs", "u"), ("disturbances", "w")):
        names = list(given[g].get("names") or (f"{prefix}{k + 1}" for k in range(counts[g])))
        ones, blank = [1.0] * counts[g], [""] * counts[g]
        facts[g] = (names, list(given[g].get("units") or blank), list(given[g].get("scales") or ones))
    facts |= {"unit": source.get("time_unit"), "name": source.get("name", "")}
    return {**facts, "source": source.get("source", {}).get("citation", "")}


def facts_of_schedule(source):
    """Times of the first period, its length, what is measured, and what it is called."""
    if isinstance(source, dict):
        periodic = source["kind"] == "periodic"
        names, mask = source.get("output_names"), source.get("outputs")
        times, period = source.get("times"), source.get("period")
        if periodic and "gaps" in source:
            gaps = np.array(source["gaps"], dtype=float)
            first = gaps[0] if source.get("first") is None else source["first"]
            by_gaps = first + np.concatenate([[0.0], np.cumsum(gaps[1:])])
            assert times is None or same(list(times), list(by_gaps))
            times, period = by_gaps, gaps.sum()
        unit, origin = source.get("time_unit"), source.get("origin")
    else:
        periodic = hasattr(source, "period")
        times, mask, names = source.times, source.outputs, source.output_names
        period, unit, origin = getattr(source, "period", None), source.time_unit, source.origin
    return {
        "times": [float(t) for t in times],
        "period": float(period) if periodic else None,
        "outputs": None if mask is None else [[float(bit) for bit in row] for row in mask],
        "names": None if names is None else list(names),
        "unit": unit,
        "origin": origin,
    }


def facts_of_table(text):
    """The same of a schedule's CSV."""
    first, header, *rows = text.rstrip("\n").split("\n")
    keys = dict(part.split("=") for part in first.split("; ")[1:])
    cells = [row.replace('"', "").split(",") for row in rows]
    assert all(NUMBER.fullmatch(row[0]) and set(row[1:]) <= {"0", "1"} for row in cells)
    names = header.replace('"', "").split(",")[1:]
    assert len(set(names)) == len(names)
    assert len({len(row) for row in cells} | {len(names) + 1}) == 1
    mask = [[float(bit) for bit in row[1:]] for row in cells]
    return {
        "times": [float(row[0]) for row in cells],
        "period": float(keys["period"]) if "period" in keys else None,
        "outputs": None if all(all(row) for row in mask) else mask,
        "names": names or None,
        "unit": keys["time_unit"],
        "origin": keys.get("origin"),
    }


def joined(spans):
    """Intervals in order, those that touch as one."""
    found = []
    for a, b in sorted(spans):
        if found and a <= found[-1][1]:
            found[-1][1] = max(found[-1][1], b)
        else:
            found.append([a, b])
    return found


def facts_of_requirement(source):
    """Every entry, defaults filled in."""
    data = source if isinstance(source, dict) else source.to_dict()
    plain = ("window", "period", "spacing", "cost_limit", "time_unit")
    facts = {key: data.get(key) for key in plain}
    samples = data.get("samples")
    counts = dict(samples) if isinstance(samples, dict) else {} if samples is None else {"exactly": samples}
    facts["target_sigma"] = counts.pop("target_sigma", data.get("target_sigma"))
    outputs = {
        name: (None if access.get("available") is None else joined(access["available"]), access.get("price", 0.0))
        for name, access in data.get("sensors", {}).items()
    }
    more = {"samples": counts, "decay_rate": data.get("decay_rate", 0.0), "sensors": outputs}
    return {**facts, **more, "forbidden": joined(data.get("forbidden", [])), "fixed": list(data.get("fixed", []))}
