"""What is proven of plants that are not exactly known: `python -m tests.benchmarks.inclusion_figures [ROW ...]`.

Writes docs/not_exactly_known.md: each figure of the prototype of the theory's section 14 beside what is proven here,
and 1000 adversarial pairs of trajectories for each nonlinear plant. Rows that begin with a word given are made anew,
the others stay.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from sampling_design import GapRange, Plant, UncertainParameter, UncertainPlant, read_certificate
from sampling_design.nonlinear import examples
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.thyroid_logs import DOSE, patient_in_tube, patient_under_therapy
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion, longest_gap
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate
from tests.laws import test_no_pair_of_trajectories_violates_a_nonlinear_certificate as pairs
from tests.oracles import patients
from tests.oracles.inclusions import adversary

from .arena.nonlinear import inertial_chain

ROOT = Path(__file__).parents[2]
PAIRS = 1000
Made = Callable[[], InclusionCertificate]


def oscillator(share: float) -> UncertainPlant:
    """Frequency 1 within a share."""
    known = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], name="oscillator")
    low, high = (1 - share) ** 2, (1 + share) ** 2
    return UncertainPlant(known, [UncertainParameter("omega^2", low, high, A=[[0.0, 0.0], [-1.0, 0.0]], nominal=1.0)])


def stored(name: str) -> Made:
    """A certificate of the repository, whose search takes minutes."""
    return lambda: read_certificate(ROOT / "examples" / "data" / f"{name}.json")  # type: ignore[return-value]


def gap(found: InclusionCertificate) -> str:
    """The longest gap."""
    return f"gaps to {found.family.longest:.4g}"


def lam(found: InclusionCertificate) -> str:
    """Lambda, and what a window must be longer than, with P2 and with P(tau)."""
    arrival = found.horizon("arrival").minimum
    return f"lambda {found.lam_proven:.3g}, M > {found.horizon().minimum:.3g}, with P(tau) M > {arrival:.3g}"


Row = tuple[str, str, Made, Callable[[InclusionCertificate], str]]
"""Question, the prototype's figure, how the certificate is made, and what is said of it."""
FREE = 1e4
"""A noise gain that does not bind."""
PATIENT = "thyroid patient, six states, gaps .5 to 1.5 d"


def linear() -> list[Row]:
    """Linear plants in a box."""
    found: list[Row] = []
    for pieces, theirs in ((8, "2.13"), (16, "2.35"), (32, "2.50")):
        make = partial(longest_gap, oscillator(0.1), eta=0.02, most=2.86, pieces=pieces)
        found.append((f"oscillator, frequency within 10 %, eta .02, {pieces} pieces", f"gaps to {theirs}", make, gap))
    for share, theirs in ((1e-9, "1.38"), (0.1, "2.9"), (0.2, "6.6")):
        make = partial(certify_inclusion, oscillator(share), GapRange(0.5, 1.5), eta=0.1, noise_gain=FREE, pieces=32)
        name = f"oscillator, frequency varying by {100 * share:.0f} %, gaps .5 to 1.5, eta .1"
        found.append((name, f"lambda {theirs}", make, lam))
    name = "inertial chain, bias rate 1/12 to 3 per s, gaps 5 to 250 ms, eta .3"
    for more, theirs, budget in (("", "lambda 2.6", 3.0), (", noise gains as they come", "", FREE)):
        make = partial(certify_inclusion, inertial_chain(), GapRange(0.005, 0.25), eta=0.3, noise_gain=budget)
        found.append((name + more, theirs, make, lam))
    return found


def nonlinear() -> list[Row]:
    """Nonlinear plants in a region."""
    found: list[Row] = []
    angles = ((np.pi / 3, "to 60 degrees", "2.66"), (np.pi / 2, "to 90 degrees", "2.03"), (None, "all angles", "1.35"))
    for angle, name, theirs in angles:
        for pieces in (16, 32, 64):
            make = partial(longest_gap, examples.pendulum(1.0, angle), eta=0.05, most=3.1, pieces=pieces)
            found.append((f"pendulum, {name}, eta .05, {pieces} pieces", f"gaps to {theirs}", make, gap))
    make = partial(certify_inclusion, examples.pendulum(), GapRange(0.1, 1.0), eta=0.4)
    found.append(("pendulum, all angles, gaps to 1, eta .4", "lambda 60, M > 13.7, 3.5", make, lam))
    for pieces in (16, 32):
        make = partial(longest_gap, examples.van_der_pol(), eta=0.05, most=2.2, pieces=pieces)
        found.append((f"van der Pol, Lienard, abs(x1) <= 2.1, eta .05, {pieces} pieces", "gaps to 1.40", make, gap))
    make = partial(longest_gap, examples.van_der_pol("velocity"), eta=0.05, most=1.0, pieces=16)
    found.append(("van der Pol in (x, x'), abs(x') <= 3, eta .05", "gaps to .29", make, gap))
    for spread, theirs in ((2.0, ".53"), (5.0, ".35"), (10.0, ".21"), (20.0, ".07")):
        make = partial(longest_gap, examples.stirred_reactor(spread), eta=0.1, most=1.3, pieces=16)
        found.append((f"stirred reactor, within {spread:g} K, eta .1", f"gaps to {theirs}", make, gap))
    theirs = "six states, sampled: with P(tau) M > 2.8"
    found.append((f"{PATIENT}, untreated, eta .58", theirs, stored("thyroid_patient"), lam))
    theirs = "four states, sampled: lambda 3.95, M > 3.94, with P(tau) 3.96"
    found.append((f"{PATIENT}, under therapy, eta .45", theirs, stored("thyroid_therapy"), lam))
    return found


def measured(make: Made) -> tuple[InclusionCertificate, float, float]:
    """The certificate, and seconds of processor time for all of it and for its proof alone."""
    began = time.process_time()
    found = make()
    between = time.process_time()
    assert found.verify().verdict == "proven"
    return found, between - began, time.process_time() - between


INTRODUCTION = """# Plants that are not exactly known: what is proven

Made by `python -m tests.benchmarks.inclusion_figures`; theory: [section 14](#inclusion). What the prototype found was
in part sampled or not decided; what stands beside it is proven, for gaps from a tenth of the longest on unless a range
is named, in the units of the plant. Seconds are processor time on a shared machine, of search and proof, and of the
proof alone.

| plant | prototype | proven here | search and proof | proof |
|---|---|---|---|---|"""
ADVERSARIES = f"""
Adversarial pairs of trajectories, at least {PAIRS} of each plant that stay in its region where so many were found:
starts near and far, disturbances that push apart along the worst direction of P(tau), gaps at both ends. The largest
squared distance over what Assumption 7 allows, of those that left until they did. Of linear plants the ratio is that
of all pairs and all disturbances at once, along {PAIRS} schedules on which the parameters switch between corners:

| plant | stayed, of pairs flown | largest ratio |
|---|---|---|"""


def main(chosen: tuple[str, ...]) -> None:
    """Write the page; where rows are chosen the others stay as they were."""
    page = ROOT / "docs" / "not_exactly_known.md"
    before = page.read_text().splitlines() if page.exists() else []
    kept = {(line.split("|")[1].strip(), line.count("|")): line for line in before if line.startswith("| ")}

    made: list[tuple[str, int, Callable[[], list[str]]]] = [
        (name, 5, partial(proven, name, theirs, make, said)) for name, theirs, make, said in [*linear(), *nonlinear()]
    ]
    made += [(name, 3, partial(flown, name)) for name in pairs.PLANTS]
    made += [(name, 3, partial(flown_patients, *each)) for name, each in PATIENTS.items()]
    made += [(name, 3, partial(switched, *each)) for name, each in SWITCHED.items()]
    for name, width, cells in made:
        if name.startswith(chosen or ""):
            kept[name, width + 1] = f"| {' | '.join([name, *cells()])} |"
            print(kept[name, width + 1], flush=True)
            tables = [[kept[key] for key in ((each, w + 1) for each, w, _ in made if w == size) if key in kept]
                      for size in (5, 3)]  # fmt: skip
            page.write_text("\n".join([INTRODUCTION, *tables[0], ADVERSARIES, *tables[1], ""]))


def proven(name: str, theirs: str, make: Made, said: Callable[[InclusionCertificate], str]) -> list[str]:
    """What stands beside the prototype's figure."""
    found, whole, proof = measured(make)
    took = "from its file" if name.startswith(PATIENT) else f"{whole:.2g} s"
    return [theirs, said(found), took, f"{proof:.2g} s"]


def flown(name: str) -> list[str]:
    """Pairs that stayed, and the largest ratio of all."""
    worst, stayed, every = pairs.fly(name, PAIRS)
    return [f"{stayed} of {every}", f"{worst:.4f}"]


def flown_patients(name: str, make: Callable[[], NonlinearPlant], dose: float) -> list[str]:
    """The same of all pairs of so many trajectories."""
    plant, rng = make(), np.random.default_rng(0)
    starts = patients.scattered(plant, TRAJECTORIES, rng)
    worst, stayed = patients.largest_ratio(stored(name)(), plant, starts, PATIENTS_GAPS, rng, dose)
    return [f"{stayed} of {TRAJECTORIES * (TRAJECTORIES - 1) // 2}", f"{worst:.4f}"]


def switched(make: Callable[[], UncertainPlant], family: GapRange, eta: float) -> list[str]:
    """The largest ratio of all pairs of an uncertain linear plant, whose parameters switch at any time."""
    plant, rng = make(), np.random.default_rng(0)
    found = certify_inclusion(plant, family, eta=eta)
    members = [(each.A, each.C, each.G) for _, each in plant.constant_members(rng)]
    worst = max(adversary(found, members, rng) for _ in range(PAIRS))
    return [f"all, on {PAIRS} schedules", f"{worst:.4f}"]


TRAJECTORIES, PATIENTS_GAPS = 50, np.array([0.5, 1.5, 1.5, 0.7, 1.5])
PATIENTS = {
    "thyroid patient, untreated": ("thyroid_patient", patient_in_tube, 0.0),
    "thyroid patient, under therapy": ("thyroid_therapy", patient_under_therapy, DOSE),
}
SWITCHED = {
    "oscillator, frequency varying by 20 %": (partial(oscillator, 0.2), GapRange(0.5, 1.5), 0.1),
    "inertial chain": (inertial_chain, GapRange(0.005, 0.25), 0.3),
}
"""Certificate or plant, and with what it is flown."""


if __name__ == "__main__":
    main(tuple(sys.argv[1:]))
