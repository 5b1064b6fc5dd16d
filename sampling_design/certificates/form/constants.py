"""A constant with its name, formula and source, and an ordered list of them that prints as markdown or LaTeX."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from sampling_design.errors import ArgumentError
from sampling_design.records.declarations import in_latex, latex_number, latex_table
from sampling_design.records.record import short
from sampling_design.records.signatures import checked_methods


@dataclass(frozen=True)
class Constant:
    """One number of a proof.

    Parameters
    ----------
    name : str
        As in the code: `mu_bar`.
    value : float
    formula : str
        LaTeX, without dollars.
    source : str
        Theorem or equation it comes from.
    symbol : str
        LaTeX of the constant itself.
    """

    name: str
    value: float
    formula: str
    source: str
    symbol: str = ""

    def __str__(self) -> str:
        return f"{self.name} = {short(self.value)}  [{self.source}]"


@checked_methods
class ConstantList(tuple[Constant, ...]):
    """Constants in the order of the proof; also by name, `constants["mu_bar"].value`."""

    __slots__ = ()

    def named(self, name: str) -> Constant:
        """Return the constant of that name.

        Raises
        ------
        ArgumentError
            If there is none; it lists the names that exist.
        """
        for constant in self:
            if constant.name == name:
                return constant
        raise ArgumentError(f"`name` must be one of {', '.join(self.names())}, got {name!r}.")

    def names(self) -> Iterator[str]:
        """Names in order."""
        return (c.name for c in self)

    def lines(self) -> list[tuple[str, str]]:
        """Return the rows of a table: constant, value and source."""
        return [(c.name, f"{short(c.value)}  ({c.source})") for c in self]

    def to_markdown(self) -> str:
        """Return a table: constant, value, formula, source."""
        rows = [f"| {c.name} | {short(c.value)} | $ {c.formula} $ | {c.source} |" for c in self]
        return "\n".join(["| constant | value | formula | source |", "|---|---|---|---|", *rows]) + "\n"

    def to_latex(self) -> str:
        """Return a `tabular`: constant, value, formula, source."""
        symbols = [c.symbol or rf"\mathrm{{{in_latex(c.name)}}}" for c in self]
        rows = [
            [f"${symbol}$", f"${latex_number(c.value)}$", f"${c.formula}$".replace("#", r"\#"), in_latex(c.source)]
            for symbol, c in zip(symbols, self, strict=True)
        ]
        return latex_table(("constant", "value", "formula", "source"), rows, "llll")
