"""Plants as files: TOML and JSON (one tree), MATLAB .mat and numpy .npz (flat names)."""

from __future__ import annotations

import io
import os
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sized
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt

from sampling_design.checkers.parts import PLANT
from sampling_design.checkers.strict import MOST_BYTES, Tree, is_list, is_table, is_text
from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.plants.functional import FunctionalPlant
from sampling_design.plants.plant import FORMAT, GROUPS, MATRICES, Plant, Signals
from sampling_design.records import checks, file_io
from sampling_design.records.arrays import Array
from sampling_design.records.dispatch import offered
from sampling_design.records.signatures import checked
from sampling_design.records.units import check_time_unit

_COLUMNS = {"A": "states", "B": "inputs", "C": "states", "D": "inputs", "G": "disturbances"}
_KEYS = ("names", "units", "scales")
_TREE = ("format", "name", "time_unit", "matrices", *GROUPS, "source", "part_of")
_FLAT = ("format", "name", "time_unit", *MATRICES, *(f"{g}_{k}" for g in GROUPS for k in _KEYS), "citation")


@checked
def read_plant(path: str | os.PathLike[str], time_unit: str | None = None) -> Plant:
    """Read a plant from a .toml, .json, .mat or .npz file.

    Parameters
    ----------
    path : path
        The suffix decides the format.
    time_unit : str, optional
        Needed if the file does not name one; must agree with the file if it does.

    Returns
    -------
    Plant

    Raises
    ------
    FileFormatError
        If the file is missing, cut off, of another format, has an unknown key, lacks a time unit, or
        does not describe a plant. The message begins with the path.

    Notes
    -----
    *Numerical aspects.* Numbers are read exactly as written: write, read, write gives the same bits.
    Nothing in a file is executed (no pickle).

    Examples
    --------
    >>> import tempfile, pathlib
    >>> from sampling_design.plants import library
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = write_plant(library.oscillator(), pathlib.Path(folder) / "oscillator.toml")
    ...     read_plant(path).A
    array([[ 0.,  1.],
           [-1.,  0.]])
    """
    where = os.fspath(path)
    if not Path(where).exists():
        from sampling_design.plants.library import PLANTS

        if where in PLANTS:
            raise FileFormatError(f"{where}: no such file. Did you mean named_plant({where!r})?", where)
        file_io.read_bytes(where)  # says so, and what may have been meant
    text = {"toml": file_io.from_toml, "json": file_io.from_json}
    reads = {key: lambda where, parse=parse: parse(file_io.read_text(where), where) for key, parse in text.items()}
    read = _by_suffix(where, {**reads, "mat": _read_mat, "npz": _read_npz})
    return plant_from_dict(read(where), where, time_unit)


@checked
def write_plant(plant: Plant, path: str | os.PathLike[str]) -> Path:
    """Write a plant to a .toml, .json, .mat or .npz file, whole or not at all; return the path.

    Parameters
    ----------
    plant : Plant
    path : path
        Its suffix says which kind of file.

    Returns
    -------
    Path

    Raises
    ------
    FileFormatError
        If the suffix is unknown or the file cannot be written.
    """
    where = os.fspath(path)
    encoders = {"toml": _as_toml, "json": lambda tree: file_io.to_json(tree).encode(), "mat": _as_mat, "npz": _as_npz}
    encode = _by_suffix(where, encoders)
    return file_io.write_bytes(where, encode(plant.to_dict()))


def plant_from_dict(data: Mapping[str, Any], where: str = "plant", time_unit: str | None = None) -> Plant:
    """Return the plant in a tree of the file format; `where` begins every message.

    Raises FileFormatError if a key is unknown or missing, or the data do not describe a plant.
    """
    try:
        return _plant_from_tree(data, time_unit)
    except FileFormatError:
        raise
    except ArgumentError as error:
        raise _located(where, error) from None


def _plant_from_tree(data: Mapping[str, Any], time_unit: str | None) -> Plant:
    if not data:
        raise ArgumentError("the file is empty, expected a plant.")
    if stray := [key for key in MATRICES if key in data and "matrices" not in data]:
        raise ArgumentError(f"`{stray[0]}` stands in a table: write the line [matrices] before it.")
    kind = data.get("format")
    other = offered("read_plant", kind, object) if is_text(kind) and kind != FORMAT else None
    if other is not None:
        raise ArgumentError(
            f"`format` is {kind!r}, of another kind of plant: `{other.__qualname__}.read(path)` reads it."
        )
    checks.known_keys("the file", data, _TREE)
    if "format" not in data:
        raise ArgumentError(f'`format` is missing: the file begins with the line format = "{FORMAT}".')
    if data.get("format") != FORMAT:
        raise ArgumentError(f"`format` must be {FORMAT!r}, got {data.get('format')!r}. Is this a plant file?")
    matrices = _table(data, "matrices")
    checks.known_keys("[matrices]", matrices, MATRICES)
    missing = [key for key in ("A", "C") if key not in matrices]
    if missing:
        raise ArgumentError(f"`{missing[0]}` is missing in [matrices]. Was the file cut off?")
    source = _table(data, "source")
    checks.known_keys("[source]", source, ("citation",))
    groups = {group: _signals_from_dict(group, _table(data, group)) for group in GROUPS}
    _exactly(data)
    found: Tree = {key: _rows(value, groups[_COLUMNS[key]]) for key, value in matrices.items()}
    unit = _agreed_unit(data.get("time_unit"), time_unit)
    found |= {**groups, "time_unit": unit, "name": data.get("name", ""), "source": source.get("citation", "")}
    if "part_of" not in data:
        return Plant(**found)
    part = data["part_of"]
    return FunctionalPlant.of_part(Plant(**found), _plant_from_tree(part["plant"], unit), part["map"], part["rows"])


def _exactly(data: Mapping[str, Any]) -> None:
    """Refuse numbers that are booleans or texts, and whatever else the plant's grammar does not allow."""
    file_io.exactly(PLANT, {key: value for key, value in data.items() if key != "time_unit"})


def _located(where: str, error: ArgumentError) -> FileFormatError:
    """The same sentence, with the file in front."""
    return FileFormatError(f"{where}: {error}", where)


def _agreed_unit(in_file: object, given: str | None) -> str:
    if in_file is None and given is None:
        raise ArgumentError("`time_unit` is missing. Write it into the file or give it as an argument.")
    unit = check_time_unit(given if in_file is None else in_file)
    if given is not None and check_time_unit(given) != unit:
        raise ArgumentError(f"`time_unit` must agree with the file, got {given!r} where the file says {unit!r}.")
    return unit


def _table(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    value = data.get(key, {})
    if not is_table(value):
        raise ArgumentError(f"`{key}` must be a table of keys and values, got {value!r:.60}.")
    return value


def _rows(value: npt.ArrayLike, columns: Sized | None) -> npt.ArrayLike:
    """An empty list of rows does not say how many columns it has; the names of the signals do."""
    return np.zeros((0, len(columns or ()))) if is_list(value) and not value else value


def _signals_from_dict(group: str, table: Mapping[str, Any]) -> Signals | None:
    checks.known_keys(f"[{group}]", table, _KEYS)
    if not table:
        return None
    if "names" not in table:
        raise ArgumentError(f"`names` is missing in [{group}].")
    try:
        return Signals(table["names"], table.get("units", ()), table.get("scales"))
    except ArgumentError as error:
        raise ArgumentError(f"in the table [{group}]: {error}") from None


def _by_suffix(where: str, table: Mapping[str, Callable[..., Any]]) -> Callable[..., Any]:
    suffix = Path(where).suffix.lower().lstrip(".")
    if suffix not in table:
        known = ", ".join(f".{key}" for key in table)
        got = f"got {f'.{suffix}'!r}" if suffix else "got none"
        raise FileFormatError(f"{where}: the suffix must be one of {known}, {got}.", where)
    return table[suffix]


def _as_toml(tree: Tree) -> bytes:
    import tomli_w

    head = {key: value for key, value in tree.items() if not is_table(value)}
    tables = {key: value for key, value in tree.items() if is_table(value) and key != "matrices"}
    # one row per line: the TOML library would spend a line on each number
    lines = {key: "".join(f"    {row!r},\n" for row in rows) for key, rows in tree["matrices"].items()}
    matrices = "".join(f"{key} = [\n{rows}]\n" for key, rows in lines.items())
    return f"{tomli_w.dumps(head)}\n[matrices]\n{matrices}\n{tomli_w.dumps(tables)}".encode()


def _read_npz(where: str) -> dict[str, object]:
    content = file_io.read_bytes(where)
    try:
        _check_archive(content, where)
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:  # object arrays are refused: they are pickles
            flat = {key: archive[key] for key in archive.files}
    except FileFormatError:
        raise
    except MemoryError:
        raise _beyond_memory(where) from None
    except Exception:  # the reader raises whatever it stumbles on
        raise FileFormatError(
            f"{where}: is not a readable .npz archive of plain arrays. Was it cut off?", where
        ) from None
    return _tree(flat, where)


def _beyond_memory(where: str) -> FileFormatError:
    return FileFormatError(
        f"{where}: names an array that is larger than the memory that is left. Is a size in it wrong?", where
    )


def _check_archive(content: bytes, where: str) -> None:
    """Refuse an archive that names an array twice or grows beyond all measure when it is unpacked."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        names = archive.namelist()
        size = sum(entry.file_size for entry in archive.infolist())
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise FileFormatError(f"{where}: holds the array {twice.removesuffix('.npy')!r} twice.", where)
    if size > MOST_BYTES:
        raise FileFormatError(f"{where}: is too large: {size} bytes, expected at most {MOST_BYTES}.", where)


def _read_mat(where: str) -> dict[str, object]:
    from scipy.io import loadmat
    from scipy.io.matlab import MatReadWarning

    content = file_io.read_bytes(where)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", MatReadWarning)  # a variable that is there twice
            flat = loadmat(cast(Any, io.BytesIO(content)))
    except MemoryError:
        raise _beyond_memory(where) from None
    except NotImplementedError:
        raise FileFormatError(f"{where}: is a version 7.3 .mat file. Save it with the option -v7.", where) from None
    except Exception:  # the reader raises whatever it stumbles on
        raise FileFormatError(f"{where}: is not a readable .mat file. Was it cut off?", where) from None
    return _tree({key: value for key, value in flat.items() if not key.startswith("__")}, where)


def _tree(flat: Mapping[str, Any], where: str) -> dict[str, object]:
    """Return flat array names as the tree of the file format."""
    try:
        return _tree_of(flat)
    except ArgumentError as error:
        raise _located(where, error) from None


def _tree_of(flat: Mapping[str, Any]) -> dict[str, object]:
    checks.known_keys("the file", flat, _FLAT)
    tree: dict[str, object] = {"format": FORMAT}
    tree["matrices"] = {key: _plain(key, flat[key]) for key in MATRICES if key in flat}
    for key in ("format", "name", "time_unit"):
        if key in flat:
            tree[key] = "".join(_words(key, flat[key]))
    for group in GROUPS:
        named = {k: f"{group}_{k}" for k in _KEYS[:2] if f"{group}_{k}" in flat}
        table: dict[str, object] = {k: _words(name, flat[name]) for k, name in named.items()}
        if f"{group}_scales" in flat:
            table["scales"] = np.ravel(_plain(f"{group}_scales", flat[f"{group}_scales"]))
        if table:
            tree[group] = table
    if "citation" in flat:
        tree["source"] = {"citation": "".join(_words("citation", flat["citation"]))}
    return tree


def _plain(key: str, value: object) -> Array:
    """An array of numbers as it is: no records, no cells, no texts, no truth values."""
    if not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf":
        kind = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
        raise ArgumentError(f"`{key}` must be an array of real numbers, got one of {kind}.")
    return value


def _words(key: str, value: object) -> list[str]:
    """Strings of a string array, or of a MATLAB cell or character array (rows padded with blanks)."""
    array = np.asarray(value)
    cells = [np.asarray(cell) for cell in array.ravel()] if array.dtype == object else [array]
    if any(cell.dtype.kind != "U" and cell.size for cell in cells):
        raise ArgumentError(f"`{key}` must be an array of texts, got one of {array.dtype}.")
    if array.dtype == object:
        return ["".join(cell.ravel().tolist()) for cell in cells]
    return [str(v).rstrip() for v in array.ravel()]


def _flat(tree: Tree) -> Tree:
    if "part_of" in tree:
        raise ArgumentError("`path` must end in .toml or .json: a plant of chosen rows holds the whole one beside it.")
    flat: Tree = {key: np.array(tree[key]) for key in ("format", "name", "time_unit")}
    for key, rows in tree["matrices"].items():
        flat[key] = np.array(_rows(rows, tree.get(_COLUMNS[key], {}).get("names")), dtype=np.float64)
    for group in GROUPS:
        for key, entries in tree.get(group, {}).items():
            flat[f"{group}_{key}"] = np.array(entries)
    if "source" in tree:
        flat["citation"] = np.array(tree["source"]["citation"])
    return flat


def _as_npz(tree: Tree) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **_flat(tree))
    return stream.getvalue()


def _as_mat(tree: Tree) -> bytes:
    from scipy.io import savemat

    stream = io.BytesIO()
    # cells, because character arrays pad their rows to equal length
    cells = {k: v.astype(object) if v.dtype.kind == "U" and v.ndim else v for k, v in _flat(tree).items()}
    savemat(cast(Any, stream), cells, oned_as="row")
    return stream.getvalue()
