"""One table of four horizons: by the paper's constants, exact with its theorem, exact and improved, and true."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

from sampling_design.certificates.certification import certify
from sampling_design.certificates.compare.contraction import contracting_within, radius_within
from sampling_design.certificates.exact.certificate import Certificate
from sampling_design.certificates.form.horizon import Horizon
from sampling_design.certificates.paper.proof_constants import ProofConstants, constants_from_proof
from sampling_design.errors import ArgumentError, SamplingDesignError, UndecidedError
from sampling_design.plants.plant import Plant, first_difference
from sampling_design.records import checks
from sampling_design.records.budget import Budget, BudgetSpentError
from sampling_design.records.declarations import above, in_latex, latex_table
from sampling_design.records.record import ListRecord, markdown_table
from sampling_design.records.signatures import checked
from sampling_design.schedules.family import AnySchedule

FOR_SEARCH = 2 / 3  # of the seconds, for a certificate that is not given: what is left is the true contraction's


@dataclass(frozen=True)
class HorizonRow:
    """One line of the table; gains are those of RGES at the recommended length, None where there is none.

    Attributes
    ----------
    name, source : str
    minimum : float or None [time]
        M must exceed this (the yardstick: the least M at which the true error map contracts).
    horizon : Horizon or None
    note : str
    """

    name: str
    source: str
    minimum: float | None
    horizon: Horizon | None = None
    note: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class FourHorizons(ListRecord[HorizonRow]):
    """Four horizons of one plant on one schedule.

    Attributes
    ----------
    rows : tuple of HorizonRow
        The paper's constants with Thm 9, exact certificate with Thm 9, with the improved theorem, true contraction.
    certificate : Certificate
        The exact one.
    proof : ProofConstants or None
        None where the paper's hypotheses fail or the schedule is finite.
    radius : float or None
        Spectral radius of the true error map over one window of the recommended improved length; None where the budget
        ended before.
    """

    rows: tuple[HorizonRow, ...]
    certificate: Certificate
    proof: ProofConstants | None
    radius: float | None

    _answers = (
        "horizons that four ways of proof ask for",
        "proven: each by the theorem that it names, but the true contraction, a yardstick in doubles",
        "{_good}",
        "`.certificate.verify()`",
    )
    _frame = "rows{name source minimum note C_x:horizon.C_x C_w:horizon.C_w C_v:horizon.C_v}"

    def _entries(self) -> tuple[HorizonRow, ...]:
        return self.rows

    def _good(self) -> str:
        known = [row.minimum for row in self.rows if row.minimum is not None and row.horizon is not None]
        unit = self.certificate.plant.time_unit
        return f"more than {above(min(known), 4)} {unit} is proven to be enough" if known else "none is proven"

    def _rows(self) -> list[tuple[str, str]]:
        unit = self.certificate.plant.time_unit
        lines = []
        for row in self.rows:
            bound = row.note if row.minimum is None else f"M > {above(row.minimum, 4)} {unit}"
            gains = row.horizon
            if gains is not None:
                bound += f", C_x {above(gains.C_x, 3)}, C_w {above(gains.C_w, 3)}, C_v {above(gains.C_v, 3)}"
            lines.append((row.name, bound))
        return lines

    def explain(self) -> str:
        """Compare the four."""
        unit = self.certificate.plant.time_unit
        *proven, true = self.rows
        known = [f"{row.name}: {above(row.minimum, 4)} {unit}" for row in proven if row.minimum is not None]
        text = f"A horizon is proven to be long enough if it is longer than one of these: {'; '.join(known)}."
        if true.minimum is not None:
            at = f"{above(true.minimum, 4)} {unit}"
            text += f" In doubles the error map contracts from {at} on, a yardstick and no bound."
        return text

    def cells(self) -> list[list[str]]:
        """The table's rows as text: name, source, M >, C_x, C_w, C_v."""
        cells = []
        for row in self.rows:
            gains = (None,) * 3 if row.horizon is None else (row.horizon.C_x, row.horizon.C_w, row.horizon.C_v)
            texts = ["-" if value is None else above(value, 3) for value in gains]
            cells.append([row.name, row.source, "-" if row.minimum is None else above(row.minimum, 4), *texts])
        return cells

    def to_markdown(self) -> str:
        """Return the table as markdown."""
        return markdown_table(("horizon", "source", "M >", "C_x", "C_w", "C_v"), self.cells()) + "\n"

    def to_latex(self) -> str:
        """Return the table as a LaTeX `tabular` in small type."""
        rows = [[in_latex(cell) for cell in cells] for cells in self.cells()]
        table = latex_table(("horizon", "source", "$M >$", "$C_x$", "$C_w$", "$C_v$"), rows, "lp{30mm}rrrr")
        return "{\\footnotesize\\noindent\n" + table + "\\par}\n"


@checked
def four_horizons(
    plant: Plant,
    schedule: AnySchedule,
    certificate: Certificate | None = None,
    proof_constants: ProofConstants | None = None,
    *,
    budget: float | None = None,
) -> FourHorizons:
    """Return four horizons side by side: the paper's constants, exact with Thm 9, exact and improved, true contraction.

    Parameters
    ----------
    plant : Plant
    schedule : PeriodicSchedule or Schedule
    certificate : Certificate, optional
        Default `certify(plant, schedule)`.
    proof_constants : ProofConstants, optional
        Default `constants_from_proof(plant, schedule)`; where the paper's hypotheses fail the row says why.
    budget : float, optional [seconds]
        Two thirds are the search's for a certificate that is not given; true contraction and `radius` come last, and
        where it ends before, the row says so.

    Returns
    -------
    FourHorizons

    Raises
    ------
    ArgumentError
        If what is given belongs to another plant.
    CertificateError
        If no certificate exists.
    UndecidedError
        If none is given and none is proven within the budget.

    Notes
    -----
    *Claim.* The first three are proven bounds. The last is the least window among sums of gaps from which on the
    spectral radius of the estimator's error map (no constraints, no noise) stays below one; it bounds nothing, it is
    the yardstick.

    Examples
    --------
    >>> from sampling_design.schedules.schedule import PeriodicSchedule
    >>> oscillator = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
    >>> table = four_horizons(oscillator, PeriodicSchedule([1.0]))
    >>> chain, paper, improved, true = (row.minimum for row in table.rows)
    >>> chain > paper > improved > true
    True
    """
    for name, given in (("certificate", certificate), ("proof_constants", proof_constants)):
        if given is not None and (other := first_difference(plant, given.plant)):
            raise ArgumentError(f"`{name}` belongs to another plant: {other}.")
    clock = Budget(None if budget is None else checks.positive("budget", budget))
    exact = (
        certify(plant, schedule, budget=clock.seconds_left(share=FOR_SEARCH)) if certificate is None else certificate
    )
    note = ""
    proof = proof_constants
    if proof is None:
        try:
            proof = constants_from_proof(plant, schedule)
        except SamplingDesignError as error:
            note = f"the paper's hypotheses fail: {error}"
    periodic = exact.schedule.endless and bool(plant.n_states)
    improved, paper = exact.horizon("improved"), exact.horizon("paper")
    by_paper = None if proof is None else proof.certificate().horizon("paper")
    true, missing = None, "" if periodic else "a finite schedule has none"
    if periodic:
        try:
            true = contracting_within(clock, exact)
        except UndecidedError as error:
            missing = str(error)
    rows = (
        HorizonRow(
            "paper's constants", "Theorems 5, 14, 16 and 9", None if proof is None else proof.horizon, by_paper, note
        ),
        HorizonRow("exact, Theorem 9", "Riccati and Theorem 9", paper.minimum, paper),
        HorizonRow("exact, improved", "Riccati and the improved theorem", improved.minimum, improved),
        HorizonRow("true contraction", "spectral radius", true, None, missing),
    )
    radius = None
    with suppress(BudgetSpentError):
        radius = None if true is None else radius_within(clock, exact, improved.length)
    return FourHorizons(rows, exact, proof, radius)
