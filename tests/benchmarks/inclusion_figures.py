"""Certificates for a set of plants: longest gaps, lambda and windows, and pairs of trajectories against them.

python -m tests.benchmarks.inclusion_figures [ROW ...] writes docs/not_exactly_known.md, or those rows in it
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
from sampling_design.nonlinear.collocation import Collocation
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.model import NonlinearPlant
from sampling_design.nonlinear.thyroid import PRIOR_START
from sampling_design.nonlinear.thyroid_logs import DOSE, logarithms, patient_in_tube, patient_under_therapy
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion, longest_gap
from sampling_design.uncertain.inclusion.inclusion_certificate import InclusionCertificate
from tests.benchmarks.pages import MeasuredPage, Table
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


Row = tuple[str, Made, Callable[[InclusionCertificate], str]]
"""Plant and question, how the certificate is made, and what is said of it."""
FREE = 1e4
"""A noise gain that does not bind."""
PATIENT = "thyroid patient, six states, gaps .5 to 1.5 d"
FAST = (9.0, 0.4, 0.2), (10.0, 0.7, 0.4)
"""A bioreactor of which less is known: its growth rate lies between .2 and .4 per h."""


def linear() -> list[Row]:
    """Linear plants in a box."""
    found: list[Row] = []
    for pieces in (8, 16, 32):
        make = partial(longest_gap, oscillator(0.1), eta=0.02, most=2.86, pieces=pieces)
        found.append((f"oscillator, frequency within 10 %, eta .02, {pieces} pieces", make, gap))
    for share in (1e-9, 0.1, 0.2):
        for more, most in (("", 3.0), (", noise gains as they come", FREE)):
            make = partial(certify_inclusion, oscillator(share), GapRange(0.5, 1.5), eta=0.1, noise_gain=most)
            name = f"oscillator, frequency varying by {100 * share:.0f} %, gaps .5 to 1.5, eta .1"
            found.append((name + more, make, lam))
    name = "inertial chain, bias rate 1/12 to 3 per s, gaps 5 to 250 ms, eta .3"
    for more, most in (("", 3.0), (", noise gains as they come", FREE)):
        make = partial(certify_inclusion, inertial_chain(), GapRange(0.005, 0.25), eta=0.3, noise_gain=most)
        found.append((name + more, make, lam))
    return found


def swings() -> list[Row]:
    """The pendulum and van der Pol's oscillator."""
    found: list[Row] = []
    for angle, name in ((np.pi / 3, "to 60 degrees"), (np.pi / 2, "to 90 degrees"), (None, "all angles")):
        for pieces in (16, 32, 64):
            make = partial(longest_gap, examples.pendulum(1.0, angle), eta=0.05, most=3.1, pieces=pieces)
            found.append((f"pendulum, {name}, eta .05, {pieces} pieces", make, gap))
    make = partial(certify_inclusion, examples.pendulum(), GapRange(0.1, 1.0), eta=0.4)
    found.append(("pendulum, all angles, gaps to 1, eta .4", make, lam))
    for pieces in (16, 32):
        make = partial(longest_gap, examples.van_der_pol(), eta=0.05, most=2.2, pieces=pieces)
        found.append((f"van der Pol, Lienard, abs(x1) <= 2.1, eta .05, {pieces} pieces", make, gap))
    make = partial(longest_gap, examples.van_der_pol("velocity"), eta=0.05, most=1.0, pieces=16)
    found.append(("van der Pol in (x, x'), abs(x') <= 3, eta .05", make, gap))
    return found


def processes() -> list[Row]:
    """Reactors, tanks, a vehicle and a patient."""
    found: list[Row] = []
    for spread in (2.0, 5.0, 10.0, 20.0):
        make = partial(longest_gap, examples.stirred_reactor(spread), eta=0.1, most=1.3, pieces=16)
        found.append((f"stirred reactor, within {spread:g} K, eta .1", make, gap))
    make = partial(longest_gap, examples.batch_reactor(), eta=0.02, most=40.0)
    found.append(("batch reactor, gaps to 40 min at most, eta .02", make, gap))
    make = partial(longest_gap, examples.quadruple_tank(), eta=0.02, most=60.0)
    found.append(("quadruple tank, gaps to 60 s at most, eta .02", make, gap))
    make = partial(certify_inclusion, examples.bioreactor(), GapRange(0.2, 2.0), eta=0.02)
    found.append(("bioreactor, growth rate .25 to .35 per h, gaps to 2 h, eta .02", make, lam))
    make = partial(certify_inclusion, examples.bioreactor().in_region(*FAST), GapRange(0.1, 1.0), eta=0.02)
    found.append(("bioreactor, growth rate .2 to .4 per h, gaps to 1 h, eta .02", make, lam))
    make = partial(certify_inclusion, examples.unicycle(), GapRange(0.05, 0.5), eta=0.1)
    found.append(("unicycle, heading within .5 rad, gaps to .5 s, eta .1", make, lam))
    found.append((f"{PATIENT}, untreated, eta .66", stored("thyroid_patient"), lam))
    found.append((f"{PATIENT}, under therapy, eta .49", stored("thyroid_therapy"), lam))
    return found


ROWS = {name: row for name, *row in (*linear(), *swings(), *processes())}
LIMITS = {"oscillator, frequency within 10 %": np.pi / 1.1, "pendulum": np.pi}
"""Gaps that alias the fastest oscillator, and the small swings of the pendulum."""


def proven(name: str) -> list[str]:
    """What a row says; seconds of processor time for all of it and for its proof alone."""
    make, said = ROWS[name]
    began = time.process_time()
    found = make()
    between = time.process_time()
    assert found.verify().verdict == "proven"
    limit = next((f"{value:.3g}" for kind, value in LIMITS.items() if name.startswith(kind) and said is gap), "")
    whole = "from its file" if name.startswith(PATIENT) else f"{between - began:.2g}"
    return [said(found), limit, whole, f"{time.process_time() - between:.2g}"]


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
ESTIMATED = {"untreated": 0.0, "under therapy": DOSE}
DRAWN, WITHHELD, WINDOW = 25, 20261126, 2.9
"""Patients of each kind, a seed that nothing was chosen with, and the horizon [d]."""


def estimated(name: str) -> list[str]:
    """Patients with gaps of 12 to 36 h, estimated with the one certificate that covers both kinds."""
    plant = patient_under_therapy()
    pieces = Collocation(patients.STEP, 3, int(np.ceil(WINDOW / patients.STEP)), accuracy=None)
    prior = logarithms(PRIOR_START)
    scheme = NonlinearMovingHorizonEstimator(
        plant, stored("thyroid_therapy")(), horizon=WINDOW, prior=prior, collocation=pieces
    )
    shares, errors = [], []
    for run in range(DRAWN):
        scheme.start(prior)
        rng = np.random.default_rng([WITHHELD, run])
        share, error = patients.estimated(scheme, plant, rng, dose=ESTIMATED[name])
        shares.append(share)
        errors.append([float(np.sqrt(np.mean(part**2))) for part in (error, error[13:])])
    every, (whole, later) = np.array(shares), np.mean(errors, axis=0)
    return [f"{int(np.sum(every <= 1))} of {every.size}", f"{every.max():.3f}", f"{whole:.4f}", f"{later:.4f}"]


SWITCHED = {
    "oscillator, frequency varying by 20 %": (partial(oscillator, 0.2), GapRange(0.5, 1.5), 0.1),
    "inertial chain": (inertial_chain, GapRange(0.005, 0.25), 0.3),
}
"""Certificate or plant, and with what it is flown."""


def cells(name: str) -> list[str]:
    """What the pairs of a plant say."""
    if name in PATIENTS:
        return flown_patients(*PATIENTS[name])
    return switched(*SWITCHED[name]) if name in SWITCHED else flown(name)


ADVERSARIES = f"""Pairs of trajectories, at least {PAIRS} of each plant that stay in its region where there are so many:
starts near and far, disturbances along the worst direction of P(tau), gaps at both ends. The largest
squared distance over what Assumption 7 allows, of those that left until they did. Of linear plants the ratio is that
of all pairs and all disturbances at once, along {PAIRS} schedules on which the parameters switch between corners."""
ESTIMATES = f"""The thyroid patient's estimates with windows of {WINDOW} d, below 3 d, and gaps of 12 to 36 h at random:
start, prior and noise as in the paper, seed {WITHHELD}, which nothing was chosen with. One certificate, that under
therapy, covers both kinds; the prior of a window weighs P(tau). The distance of truth and estimate in P(tau) beside
the radius, every 2 h."""
PAGE = MeasuredPage(
    "not_exactly_known.md",
    "Plants that are not exactly known: what is proven",
    "What certificates prove of plants that are not exactly known, and pairs of trajectories against them.",
    "python -m tests.benchmarks.inclusion_figures",
    "Theory: [section 14](theory/inclusion.md). Gaps from a tenth of the longest on unless a range is named, in the "
    "units of the plant. Seconds are processor time on a shared machine, of the search and of the proof alone. "
    "Rows that a run does not name stay as an earlier run left them.",
    [
        Table(("plant and rate", "proven", "known limit", "search, s", "proof, s"), list(ROWS), proven,
              clocked=frozenset({"search, s", "proof, s"})),
        Table(("plant", "stayed, of pairs simulated", "largest ratio"), [*pairs.PLANTS, *PATIENTS, *SWITCHED], cells,
              ADVERSARIES),
        Table((f"{DRAWN} patients, 20 d", "estimates within their radius", "largest share of it", "RMSE, scaled states",
               "after day 1"), list(ESTIMATED), estimated, ESTIMATES),
    ],
)  # fmt: skip

if __name__ == "__main__":
    PAGE.run(sys.argv[1:])
