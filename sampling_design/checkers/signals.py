"""Do the signals of a plant name what its matrices hold?"""

from .strict import Tree, refuse


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
