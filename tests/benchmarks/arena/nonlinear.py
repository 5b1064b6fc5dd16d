"""Nonlinear plants beside do-mpc and Kalman filters: `python -m tests.benchmarks.arena.nonlinear [RUNS [PLANT ...]]`.

Each plant of `nonlinear.examples` in its region, and an inertial chain whose bias decays at another rate than all
methods believe; gaps drawn between half the longest and the longest, w constant on quarters of the longest gap, w and v
Gaussian, the first estimate off by a draw of its standard deviation. All methods know the same model, standard
deviations and steps. Errors are in scales of the states, a norm over all of them.
"""

from __future__ import annotations

import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

from sampling_design import CostFunction, Plant
from sampling_design.nonlinear import examples
from sampling_design.nonlinear.collocation import Collocation
from sampling_design.nonlinear.mhe import NonlinearMovingHorizonEstimator
from sampling_design.nonlinear.model import NonlinearPlant, from_linear
from sampling_design.uncertain.nominal_filter import NominalFilter
from sampling_design.uncertain.plants.plant_files import UncertainParameter
from sampling_design.uncertain.plants.uncertain_plant import UncertainPlant
from tests.nonlinear.likely import likely_cost

from .nonlinear_rival import stepped
from .page import markdown, renewed
from .table import Table, duration, named

SAMPLES, STEPS, SUBSTEPS, WINDOW = 16, 4, 3, 5
"""Samples of a run, steps of w in the longest gap, Runge-Kutta steps in each of them, longest gaps in a window."""
SKIPPED = 3
"""Samples at the start that are not counted."""

QUESTION = (
    "irregular samples each, gaps between half the longest and the longest that section 14 of the theory certifies for "
    "each plant or a common one; w (constant on quarters of the longest gap) and v Gaussian, and all methods know "
    f"their standard deviations. Errors at the samples after the first {SKIPPED}, in scales of the states; `lost`: "
    "runs in which a covariance ceased to be one or a state to be finite. `python -m "
    "tests.benchmarks.arena.nonlinear 3` makes this section anew. Both Kalman filters are plain ones of our own (the "
    "unscented one with 2 (n + q) points "
    f"of equal weight); the window is {WINDOW} gaps, arrival weight filtered. do-mpc's estimator takes one measurement "
    "at each of its regular steps: its step is a quarter of the longest gap, a time-varying weight is 0 where there is "
    "no sample, and arrival weight and its centre are its own (constant; the window before). The chain's bias decays "
    "at 3 per second where all methods believe .5; their common box is [1/12, 3]."
)
NOTES = (
    "Where the first estimate is good and noise small, the window and both filters are equal within the draws, and the "
    "filters are much faster (times on a shared machine); do-mpc takes 2 to 4 times as long as the window, and its "
    "constant arrival weight costs it accuracy where data are few (batch reactor, bioreactor, tank). With a first "
    "estimate far off (0.1, 4.5 where the truth is 3, 1; states known not to be negative) the extended filter settles "
    "at negative concentrations and the unscented one is lost; the windows keep to the states that are possible. "
    "Filters give covariances, which are no bounds; radii of the moving horizon estimator are proven with a "
    "certificate, and those of the filter of the nominal plant hold for the whole box.",
)


@dataclass(frozen=True)
class Case:
    """A plant, its longest gap, where it starts, and standard deviations of the first error, w and v."""

    plant: NonlinearPlant
    longest: float
    start: tuple[float, ...]
    error: tuple[float, ...]
    push: tuple[float, ...]
    noise: tuple[float, ...]
    u: tuple[float, ...] = ()
    prior: tuple[float, ...] = ()
    """The first estimate, if it is not drawn."""
    box: UncertainPlant | None = None
    truth: NonlinearPlant | None = None
    """Where the plant is not exactly known: all that it may be, and what it is."""


def inertial_chain(nominal: float = 0.5) -> UncertainPlant:
    """Position, speed, acceleration and its bias, which decays at a rate between 1/12 and 3 per second."""
    A, decay = np.diag(np.ones(3), 1), np.diag([0.0, 0.0, 0.0, -1.0])
    known = Plant(A + nominal * decay, [[1.0, 0.0, 0.0, 0.0]], G=[[0.0], [0.0], [0.0], [1.0]], name="inertial chain")
    return UncertainPlant(known, [UncertainParameter("rate", 1 / 12, 3.0, A=decay, nominal=nominal)])


def chain_case() -> Case:
    """The chain whose bias decays six times as fast as its nominal plant says, as fast as it may."""
    box = inertial_chain()
    known, true = (from_linear(plant) for plant in (box.nominal, box.at([3.0])))
    return Case(known, 0.25, (0.0, 1.0, 0.0, 0.5), (0.5,) * 4, (0.2,), (0.01,), box=box, truth=true)


CASES = {
    "pendulum, all angles": Case(examples.pendulum(), 1.25, (2.5, 0.0), (0.5, 0.5), (0.05,), (0.05,)),
    "van der Pol": Case(examples.van_der_pol(), 1.4, (1.5, 0.0), (0.3, 0.3), (0.05,), (0.05,)),
    "stirred reactor": Case(examples.stirred_reactor(20.0), 0.25, (0.5, 350.0), (0.03, 3.0), (0.02, 0.5), (0.3,)),
    "batch reactor": Case(examples.batch_reactor(), 1.0, (3.0, 1.0), (0.4, 0.4), (0.002, 0.002), (0.05,)),
    "batch reactor, poor first estimate": Case(
        examples.batch_reactor().with_bounds(states=(0.0, np.inf)),
        0.4,
        (3.0, 1.0),
        (6.0, 6.0),
        (0.002, 0.002),
        (0.05,),
        prior=(0.1, 4.5),
    ),
    "bioreactor": Case(
        examples.bioreactor(), 0.5, (9.5, 0.55, 0.3), (0.2, 0.05, 0.02), (0.02, 0.01, 0.0005), (0.1, 0.02)
    ),
    "quadruple tank": Case(
        examples.quadruple_tank(), 20.0, (12.0, 12.0, 5.0, 5.0), (1.0,) * 4, (0.005,) * 4, (0.1, 0.1), (60.0, 60.0)
    ),
    "unicycle": Case(
        examples.unicycle(), 0.5, (-0.8, 0.0, 0.1), (0.2, 0.2, 0.2), (0.02, 0.02, 0.02), (0.05,) * 3, (1.0, 0.3)
    ),
    "inertial chain, bias rate 3 (believed .5)": chain_case(),
}


def stepper(plant: NonlinearPlant, dt: float) -> tuple[ca.Function, ca.Function]:
    """One step of constant w, with its derivatives, and the output with its derivative."""
    n, m, q = plant.n_states, plant.n_inputs, plant.n_disturbances
    x, u, w = ca.SX.sym("x", n), ca.SX.sym("u", m), ca.SX.sym("w", q)
    z, h = x, dt / SUBSTEPS
    for _ in range(SUBSTEPS):
        k1 = plant.f_casadi(z, u, w)
        k2 = plant.f_casadi(z + h / 2 * k1, u, w)
        k3 = plant.f_casadi(z + h / 2 * k2, u, w)
        z = z + h / 6 * (k1 + 2 * k2 + 2 * k3 + plant.f_casadi(z + h * k3, u, w))
    y = plant.h_casadi(x, u, ca.SX.zeros(plant.n_noises))
    return (
        ca.Function("step", [x, u, w], [z, ca.densify(ca.jacobian(z, x)), ca.densify(ca.jacobian(z, w))]),
        ca.Function("output", [x, u], [y, ca.densify(ca.jacobian(y, x))]),
    )


class Extended:
    """The extended Kalman filter: first derivatives along the estimate."""

    def __init__(self, case: Case, prior: np.ndarray) -> None:
        self.case, self.x = case, prior
        self.P, self.Q, self.R = (np.diag(np.square(s)) for s in (case.error, case.push, case.noise))

    def predict(self, step: ca.Function) -> None:
        x, F, G = (np.array(part) for part in step(self.x, self.case.u, np.zeros(len(self.Q))))
        self.x, self.P = x.ravel(), F @ self.P @ F.T + G @ self.Q @ G.T

    def update(self, output: ca.Function, y: np.ndarray) -> None:
        shown, H = (np.array(part) for part in output(self.x, self.case.u))
        self.corrected(y - shown.ravel(), self.P @ H.T, H @ self.P @ H.T + self.R)

    def corrected(self, off: np.ndarray, cross: np.ndarray, S: np.ndarray) -> None:
        """The linear update."""
        K = np.linalg.solve(S, cross.T).T
        self.x, P = self.x + K @ off, self.P - K @ S @ K.T
        self.P = (P + P.T) / 2


class Unscented(Extended):
    """The unscented Kalman filter with 2 (n + q) points of equal weight (the cubature rule)."""

    def predict(self, step: ca.Function) -> None:
        n, q = len(self.P), len(self.Q)
        root = np.zeros((n + q, n + q))
        root[:n, :n], root[n:, n:] = np.linalg.cholesky(self.P), np.sqrt(self.Q)
        points = np.concatenate([self.x, np.zeros(q)]) + np.sqrt(n + q) * np.vstack([root.T, -root.T])
        moved = np.array([np.array(step(p[:n], self.case.u, p[n:])[0]).ravel() for p in points])
        self.x = moved.mean(axis=0)
        self.P = (moved - self.x).T @ (moved - self.x) / len(moved)

    def update(self, output: ca.Function, y: np.ndarray) -> None:
        n = len(self.P)
        root = np.sqrt(n) * np.linalg.cholesky(self.P)
        points = self.x + np.vstack([root.T, -root.T])
        shown = np.array([np.array(output(p, self.case.u)[0]).ravel() for p in points])
        off = shown - shown.mean(axis=0)
        self.corrected(y - shown.mean(axis=0), (points - self.x).T @ off / (2 * n), off.T @ off / (2 * n) + self.R)


def drawn(case: Case, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Steps before each sample, states and measurements there, and the first estimate."""
    rng, dt = np.random.default_rng(seed), case.longest / STEPS
    step, output = stepper(case.truth or case.plant, dt)
    counts = rng.integers(STEPS // 2, STEPS + 1, SAMPLES)
    x, states, shown = np.array(case.start), [], []
    for count in counts:
        for _ in range(count):
            x = np.array(step(x, case.u, rng.normal(size=len(case.push)) * case.push)[0]).ravel()
        states.append(x)
        shown.append(np.array(output(x, case.u)[0]).ravel() + rng.normal(size=len(case.noise)) * case.noise)
    first = np.array(case.start) + rng.normal(size=x.size) * case.error
    return counts, np.array(states), np.array(shown), np.array(case.prior) if case.prior else first


def filtered(kind: type[Extended], case: Case, data: tuple[np.ndarray, ...]) -> tuple[np.ndarray, float]:
    """Estimates at the samples, and the processor time of one."""
    step, output = stepper(case.plant, case.longest / STEPS)
    counts, _, shown, prior = data
    filter_, found, before = kind(case, prior), [], time.process_time()
    for count, y in zip(counts, shown, strict=True):
        for _ in range(count):
            filter_.predict(step)
        filter_.update(output, y)
        found.append(filter_.x)
    return np.array(found), (time.process_time() - before) / len(shown)


def windowed(case: Case, data: tuple[np.ndarray, ...]) -> tuple[np.ndarray, float]:
    """The same of the moving horizon estimator of this toolbox."""
    counts, _, shown, prior = data
    dt = case.longest / STEPS
    cost = likely_cost(prior=case.error, v=case.noise, w=case.push, w_time=dt, arrival="filtered")
    estimator = NonlinearMovingHorizonEstimator(
        case.plant, horizon=WINDOW * case.longest, cost=cost, prior=prior, collocation=Collocation(dt, 3)
    )
    times, found = np.cumsum(counts) * dt, []
    u = {"u": case.u} if case.u else {}
    if case.u:  # an input counts from when it is given; nothing is measured then
        estimator.update(0.0, None, **u)
    before = time.process_time()
    for t, y in zip(times.tolist(), shown, strict=True):
        found.append(estimator.update(t, y, **u).x)
    return np.array(found), (time.process_time() - before) / len(shown)


def nominal(case: Case, data: tuple[np.ndarray, ...]) -> tuple[np.ndarray, float]:
    """The same of the filter of the nominal plant, which weighs the mismatch as a disturbance."""
    counts, _, shown, prior = data
    dt = case.longest / STEPS
    P2, Qw, R = (np.diag(1 / np.square(s)) for s in (case.error, np.array(case.push) * np.sqrt(dt), case.noise))
    assert case.box is not None
    filter_ = NominalFilter(case.box, cost=CostFunction(P2=P2, Qw=Qw, R=2 * R, Qv=2 * R, eta=1e-6), prior=prior)
    times, found, before = np.cumsum(counts) * dt, [], time.process_time()
    for t, y in zip(times.tolist(), shown, strict=True):
        found.append(filter_.update(t, y).x)
    return np.array(found), (time.process_time() - before) / len(shown)


NOMINAL, RIVAL = "sampling_design, filter of the nominal plant", f"{named('do-mpc')} MHE"
METHODS = {
    "sampling_design, moving horizon": windowed,
    NOMINAL: nominal,
    RIVAL: lambda case, data: stepped(case, data, case.longest / STEPS, WINDOW * STEPS),
    "extended Kalman filter": lambda case, data: filtered(Extended, case, data),
    "unscented Kalman filter": lambda case, data: filtered(Unscented, case, data),
}


def run(quick: bool, runs: int | None = None, names: list[str] | None = None) -> list[Table]:
    """One table: a row for each plant and method."""
    count, cases = runs or (1 if quick else 3), list(CASES.items())[1:2] if quick else list(CASES.items())
    if names:
        cases = [(name, CASES[name]) for name in names]
    table = Table(
        "Nonlinear plants of others",
        f"{count} runs of {SAMPLES} {QUESTION}",
        ("plant", "method", "mean error", "worst error", "time per sample", "lost"),
    )
    for name, case in cases:
        scales = case.plant.signals["states"].scales
        data = [drawn(case, seed) for seed in range(count)]
        for method, estimate in METHODS.items():
            if (method == NOMINAL and case.box is None) or (
                method == RIVAL and table.missing(name, "do-mpc", "do_mpc")
            ):
                continue
            errors, seconds, lost = [], [], 0
            for each in data:
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        found, spent = estimate(case, each)
                    off = np.linalg.norm((found - each[1]) / scales, axis=1)[SKIPPED:]
                    if not np.isfinite(off).all():
                        lost += 1
                        continue
                    errors.append(off)
                    seconds.append(spent)
                except (np.linalg.LinAlgError, RuntimeError):
                    lost += 1
            if errors:
                every = np.concatenate(errors)
                shown = (f"{every.mean():.4f}", f"{every.max():.3f}", duration(float(np.median(seconds))))
            else:
                shown = (None, None, None)
            table.add(name, method, *shown, lost)
    table.notes += NOTES
    return [table]


if __name__ == "__main__":
    made = run(False, int(sys.argv[1]) if len(sys.argv) > 1 else None, sys.argv[2:])[0]
    print("\n".join(markdown(made)))
    if not sys.argv[2:]:
        renewed(made, Path(__file__).parents[3] / "docs" / "arena.md")
