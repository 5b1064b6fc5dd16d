"""Pages of measured tables: a run writes the rows that it measures, and those that it does not name stay."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


@dataclass(frozen=True)
class Table:
    """Columns, the names of the rows in their order, what measures a row by its name, and what stands above.

    `clocked` are columns that another hour makes others: `tests/docs/test_measured_pages.py` holds the rest.
    """

    columns: Sequence[str]
    names: Sequence[str]
    measured: Callable[[str], Iterable[str]]
    above: str = ""
    clocked: frozenset[str] = frozenset({"CPU s", "processor time", "loop"})

    @property
    def head(self) -> str:
        return "| " + " | ".join(self.columns) + " |"


@dataclass(frozen=True)
class MeasuredPage:
    """A page of `docs` whose rows are known by their table and their first column."""

    name: str
    title: str
    what: str
    command: str
    note: str
    tables: Sequence[Table]

    def rows(self) -> dict[tuple[str, str], list[str]]:
        """What the page says: cells by the head of their table and the name of the row."""
        found: dict[tuple[str, str], list[str]] = {}
        path, head = DOCS / self.name, ""
        for line in path.read_text().splitlines() if path.exists() else []:
            if line in {table.head for table in self.tables}:
                head = line
            elif line.startswith("| ") and head:
                cells = [cell.strip() for cell in line.strip("| ").split(" |")]
                found[head, cells[0]] = cells
        return found

    def write(self, rows: dict[tuple[str, str], list[str]]) -> None:
        """Write the page, the rows in their order."""
        made = f"Made by `{self.command}`, last on {date.today()}; {os.cpu_count()} cores, one BLAS thread."
        text = [f"# {self.title}", "", self.what, "", made, self.note]
        for table in self.tables:
            text += ["", *([table.above, ""] if table.above else []), table.head, "|---" * len(table.columns) + "|"]
            text += ["| " + " | ".join(rows[table.head, n]) + " |" for n in table.names if (table.head, n) in rows]
        (DOCS / self.name).write_text("\n".join(text) + "\n")

    def run(self, asked: Sequence[str]) -> None:
        """Measure all rows, or those whose name or table's first column holds what is asked, and write the page."""
        rows = self.rows()
        for table in self.tables:
            for name in table.names:
                if not asked or any(each in (name, table.columns[0]) for each in asked):
                    rows[table.head, name] = [name, *table.measured(name)]
                    print("| " + " | ".join(rows[table.head, name]) + " |", flush=True)
                    self.write(rows)
