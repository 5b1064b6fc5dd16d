"""Frames of pandas and polars, series, datasets, as the lines of the file that they would be: one grammar reads all."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from typing import Protocol, TypeGuard, runtime_checkable

import numpy as np

from sampling_design.errors import ArgumentError, FileFormatError
from sampling_design.estimators.records.measurement_table import MeasuredPlant
from sampling_design.records import checks, file_io
from sampling_design.records.file_io import STAMPS
from sampling_design.records.units import SECONDS


@runtime_checkable
class DataFrame(Protocol):
    """What is asked of a frame of pandas or polars, so that reading one needs neither here."""

    columns: Iterable[object]

    def __getitem__(self, name: object) -> object: ...


@runtime_checkable
class _PandasFrame(DataFrame, Protocol):
    index: object

    def assign(self, **columns: object) -> _PandasFrame: ...
    def rename_axis(self, mapper: str) -> _PandasFrame: ...
    def reset_index(self) -> _PandasFrame: ...
    def to_csv(self, *, index: bool, date_format: str, lineterminator: str) -> str: ...


@runtime_checkable
class _PolarsFrame(DataFrame, Protocol):
    def fill_nan(self, value: None) -> _PolarsFrame: ...

    def with_columns(self, **columns: object) -> _PolarsFrame: ...
    def write_csv(self) -> str: ...


@runtime_checkable
class Series(Protocol):
    """What is asked of a pandas Series: the readings of one output, with their stamps as its index."""

    index: object
    name: object

    def to_frame(self, name: object = ...) -> DataFrame: ...


@runtime_checkable
class Dataset(Protocol):
    """What is asked of a Dataset or a named DataArray of xarray, with its stamps as its only axis."""

    def to_dataframe(self) -> DataFrame: ...


@runtime_checkable
class LazyFrame(Protocol):
    """What is asked of a frame of polars that is not computed yet: never its columns, which would compute them."""

    def collect_schema(self) -> object: ...
    def collect(self) -> DataFrame: ...


def is_frame(record: object) -> TypeGuard[LazyFrame | DataFrame | Series | Dataset]:
    """Whether this is a frame, a series or a dataset that can be read, and not the class of one."""
    kinds = LazyFrame | _PandasFrame | _PolarsFrame | Series | Dataset
    return isinstance(record, kinds) and not isinstance(record, type)


def lines_of(
    source: str | os.PathLike[str] | LazyFrame | DataFrame | Series | Dataset, plant: MeasuredPlant
) -> tuple[str, Iterator[str]]:
    """Name and lines of a file; of a frame those that its file would have, so that both are read by one grammar."""
    if isinstance(source, str | os.PathLike):
        return os.fspath(source), file_io.text_lines(source)
    frame: object = source
    match source:
        case Series():
            names = plant.outputs.names
            frame = source.to_frame(names[0] if source.name is None and len(names) == 1 else source.name)
        case Dataset():
            frame = source.to_dataframe()
        case LazyFrame():
            frame = source.collect()
    if not isinstance(frame, _PandasFrame | _PolarsFrame):
        raise ArgumentError(f"`path` must be a file, or a frame of pandas or polars, got {checks.described(source)}.")
    header = [str(name) for name in frame.columns]
    dates = [k for k, name in enumerate(frame.columns) if _kind(frame[name]) == "M"]
    stamps = [k for k, name in enumerate(header) if name.lower() in STAMPS]
    if isinstance(frame, _PandasFrame):
        frame, header, stamps = _stamped(frame, header, stamps, dates)
    frame = _in_unit(frame, plant.time_unit)
    for k in dates if stamps or len(dates) == 1 else ():
        header[k] = "date" if k in stamps or not stamps else header[k]
    first = io.StringIO()
    csv.writer(first, lineterminator="", quoting=csv.QUOTE_ALL).writerow(header)
    return file_io.FRAME, chain([first.getvalue()], islice(_lines(_text(frame)), 1, None))


def _stamped(
    frame: _PandasFrame, header: list[str], stamps: list[int], dates: list[int]
) -> tuple[_PandasFrame, list[str], list[int]]:
    """The frame with its times in a column."""
    if not stamps and (stamp := _stamp_of(frame.index, alone=not dates)):
        frame, header, stamps = frame.rename_axis(stamp).reset_index(), [stamp, *header], [-1]
    elif not stamps and not dates:
        kind = getattr(frame.index, "dtype", "unknown")
        raise FileFormatError(
            f"the frame: has no column `time` or `date`, and its index of {kind} says no times.", file_io.FRAME
        )
    return frame, header, stamps


def _in_unit(frame: _PandasFrame | _PolarsFrame, unit: str) -> _PandasFrame | _PolarsFrame:
    """The frame with spans of time as numbers of `unit`."""
    for name in [name for name in frame.columns if str(name).lower() in STAMPS and _kind(frame[name]) == "m"]:
        spans = {str(name): np.asarray(frame[name]) / np.timedelta64(1, "s") / SECONDS[unit]}
        match frame:
            case _PandasFrame():
                frame = frame.assign(**spans)
            case _PolarsFrame():
                frame = frame.with_columns(**spans)
    return frame


def _text(frame: _PandasFrame | _PolarsFrame) -> str:
    """The file that a frame would be."""
    try:
        return _written(frame)
    except Exception:  # whatever a column of foreign objects does when it is asked for text
        for name in frame.columns:
            try:
                _written(frame[[name]])
            except Exception:
                kind = getattr(frame[name], "dtype", "unknown")
                raise FileFormatError(
                    f"the frame: column {str(name)!r} must hold numbers, texts or dates of the years 1 to 9999, "
                    f"got the kind {kind}.",
                    file_io.FRAME,
                ) from None
        raise


def _written(frame: object) -> str:
    match frame:
        case _PandasFrame():
            hours = "%Y-%m-%dT%H:%M:%S.%f%z"  # of days alone, too: a column of pandas has times
            return frame.to_csv(index=False, date_format=hours, lineterminator="\n")
        case _PolarsFrame():
            return frame.fill_nan(None).write_csv()
    return ""


def _lines(text: str) -> Iterator[str]:
    """The rows of a file; an end of a line within quotes ends none, and none is a comment."""
    pending = ""
    for line in text.split("\n"):
        pending += line
        if pending.count('"') % 2:
            pending += "\n"
        else:
            cell, comma, rest = pending.partition(",")
            yield f'"{cell}"{comma}{rest}' if cell.lstrip().startswith("#") else pending
            pending = ""


def _stamp_of(index: object, alone: bool) -> str:
    """What a file calls the index of a frame, "" where it says no times; `alone`: nor does another column."""
    kind, named = _kind(index), getattr(index, "name", None)
    name = str(named).lower()
    if kind in "Mm" or name in (*STAMPS, "t"):
        return "date" if kind == "M" or name == "date" else "time"
    if named is not None or getattr(index, "nlevels", 1) > 1 or kind not in "iuf" or not alone:
        return ""
    if np.array_equal(np.asarray(index), np.arange(np.asarray(index).size)):
        raise FileFormatError(
            "the frame: has no column `time` or `date`, and its index counts the rows. Add the column, or take "
            "the times for the index.",
            file_io.FRAME,
        )
    return "time"


def _kind(column: object) -> str:
    """The kind of what a column or an index of a frame holds: "M" for dates, "m" for spans of time."""
    kind = getattr(column, "dtype", None)
    temporal = getattr(kind, "is_temporal", None)  # of polars
    if not callable(temporal):
        return str(getattr(kind, "kind", "O"))
    return ("m" if str(kind).startswith("Duration") else "M") if temporal() else ""
