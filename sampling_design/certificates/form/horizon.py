"""Constants of a certificate with where they come from, and the horizons that follow from them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sampling_design.errors import ArgumentError
from sampling_design.records.arrays import Array
from sampling_design.records.checks import unit_diagonal
from sampling_design.records.declarations import BOUNDS, above, below, in_latex, latex_number, latex_table
from sampling_design.records.record import Claim, Record, short
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
        return f"{self.name} = {short(self.value, up=self.up)}  [{self.source}]"

    @property
    def up(self) -> bool | None:
        """Which way it is rounded where it is printed."""
        return _ROUNDED.get(self.name)


_ROUNDED = {**BOUNDS, "horizon": True, "lam_u": True, "sigma_bar": False, "eta_s": False, "eta_composed": False}


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
        return [(c.name, f"{short(c.value, up=c.up)}  ({c.source})") for c in self]

    def to_markdown(self) -> str:
        """Return a table: constant, value, formula, source."""
        rows = [f"| {c.name} | {short(c.value, up=c.up)} | $ {c.formula} $ | {c.source} |" for c in self]
        return "\n".join(["| constant | value | formula | source |", "|---|---|---|---|", *rows]) + "\n"

    def to_latex(self) -> str:
        """Return a `tabular`: constant, value, formula, source."""
        symbols = [c.symbol or rf"\mathrm{{{in_latex(c.name)}}}" for c in self]
        rows = [
            [
                f"${symbol}$",
                f"${latex_number(c.value, up=c.up)}$",
                f"${c.formula}$".replace("#", r"\#"),
                in_latex(c.source),
            ]
            for symbol, c in zip(symbols, self, strict=True)
        ]
        return latex_table(("constant", "value", "formula", "source"), rows, "llll")


CONTRACTION = 4.0  # by default a window shrinks the squared error at least by this factor (formats.md, Defaults)
_LOW, _PAPER_LOW = r"\lambda_{\min}(P_1)", r"\lambda_{\min}(P_2/\lambda_K)"
_FORMULAS = {
    "improved": {
        "minimum": r"M > \ln(\lambda)/\eta",
        "length": r"\max(d_{\max}, \ln(4\lambda)/\eta)",
        "eta_tilde": r"\eta - \ln(\lambda)/M",
        "C_x": rf"\lambda_{{\max}}(P_2)/{_LOW}",
        "C_w": rf"\lambda_{{\max}}(Q_w)/{_LOW}",
        "C_v": rf"\lambda_{{\max}}(\tilde R)/{_LOW}",
    },
    "paper": {
        "minimum": r"M > 2\ln(2\lambda_K)/\eta",
        "length": r"\max(d_{\max}, 2\ln(4\lambda_K)/\eta)",
        "eta_tilde": r"\eta - \ln(4\lambda_K^2)/M",
        "C_x": rf"4\lambda_K\lambda_{{\max}}(P_2)/{_PAPER_LOW}",
        "C_w": rf"4\lambda_K\lambda_{{\max}}(Q_w)/{_PAPER_LOW}",
        "C_v": rf"8\lambda_K\lambda_{{\max}}(Q_v)/{_PAPER_LOW}",
    },
}
_SYMBOLS = {"minimum": "M", "length": "M", "eta_tilde": r"\tilde\eta", "C_x": "C_x", "C_w": "C_w", "C_v": "C_v"}


@dataclass(frozen=True, eq=False, repr=False)
class Horizon(Record):
    """A window length of the moving horizon estimator, and the error bound that it buys.

        |e(t)|^2 <= C_x |e(0)|^2 e^{-eta_tilde t} + int C_w |w|^2 e^{-eta_tilde (t-s)} ds
                    + sum over samples C_v |v|^2 e^{-eta_tilde (t-tau)}

    Attributes
    ----------
    theorem : str
        "improved" (estimator cost "certificate", half-open windows) or "paper" (Thm 9, cost (15)).
    minimum : float [time]
        The length M must exceed this.
    length : float [time]
        The length M for which the constants hold; by default the recommended one.
    eta_tilde : float [1/time]
        Rate of the squared error.
    C_x, C_w, C_v : float
        Gains on the initial error, the disturbance and the measurement noise, all in squared norms.
    lam : float
        The proven lambda_max(P2, P1) that entered.
    time_unit : str
    """

    theorem: str
    minimum: float
    length: float
    eta_tilde: float
    C_x: float
    C_w: float
    C_v: float
    lam: float
    time_unit: str = "s"

    _table = {
        "theorem": "{theorem}",
        "M >": "{minimum} {time_unit}",
        "M": "{length} {time_unit}",
        "eta_tilde": "{eta_tilde} 1/{time_unit}",
        "C_x": "{C_x}",
        "C_w": "{C_w}",
        "C_v": "{C_v}",
        "lambda": "{lam}",
    }

    def __float__(self) -> float:
        """The length M, so that `float(certificate.horizon())` is a horizon to use."""
        return self.length

    @property
    def claim(self) -> Claim:
        """The theorem behind the bound and what it assumes."""
        given = ("Assumption 7 with the certificate's weights", "linear plant", f"M > {above(self.minimum)}")
        if self.theorem == "paper":
            return Claim("RGES of the estimator with the cost (15)", "Theorem 9", given)
        convex = ("convex constraints that hold the truth", "half-open windows (t-M, t]", "every real window start")
        return Claim("RGES of the estimator with the certificate's cost", "improved horizon theorem", (*given, *convex))

    def constants(self) -> list[Constant]:
        """Length, rate and gains with their formulas and sources, of the theorems "improved" and "paper"."""
        source, constants = "Theorem 9" if self.theorem == "paper" else "improved horizon theorem", []
        for key, formula in _FORMULAS[self.theorem].items():
            name, said = f"{self.theorem}_{key}", "default" if key == "length" else source
            constants.append(Constant(name, getattr(self, key), formula, said, _SYMBOLS[key]))
        return constants

    def explain(self) -> str:
        """Say what the horizon promises."""
        return (
            f"With a window of {short(self.length)} {self.time_unit} (anything above {above(self.minimum)}) the "
            f"squared error decays at rate {below(self.eta_tilde)} per {self.time_unit}; disturbances enter with "
            f"C_w = {above(self.C_w)}, measurement noise with C_v = {above(self.C_v)}."
        )


def output_information(R: Array, Qv: Array) -> Array:
    """Return R~ = (R^-1 + Qv^-1)^-1, written R (R + Qv)^-1 Qv so that neither is inverted."""
    both = R @ np.linalg.solve(R + Qv, Qv)
    return (both + both.T) / 2


def least_eigenvalue(matrix: Array) -> float:
    """Least eigenvalue of a positive definite matrix, to its own digits whatever the units; infinity if it is empty.

    With `matrix` = d M d, M = L L' of diagonal about one, it is 1/|L^-1 d^-1|^2; an eigenvalue beside others that are
    1e16 times larger would have no digits.
    """
    if not matrix.size:
        return float("inf")
    d, M = unit_diagonal(matrix)
    least = float(np.linalg.eigvalsh(M)[0])
    if least <= 0:
        return float(np.linalg.eigvalsh(matrix)[0])
    return float(1 / np.linalg.norm(np.linalg.solve(np.linalg.cholesky(M), np.diag(1 / d)), 2)) ** 2


def largest_eigenvalue(matrix: Array) -> float:
    """Largest eigenvalue of a symmetric matrix; 0 if it is empty."""
    return float(np.linalg.eigvalsh(matrix)[-1]) if matrix.size else 0.0
