"""Nonlinear plants with a region: certificates that hold for all their Jacobians, proven from f itself."""

import casadi as ca
import numpy as np
import pytest

from sampling_design import GapRange, NonlinearPlant, certify, read_certificate
from sampling_design.certificates.exact.given_weights import weights_of
from sampling_design.certificates.rigorous.decide import judged
from sampling_design.checkers import programs
from sampling_design.checkers.intervals import Interval
from sampling_design.errors import ArgumentError, CertificateError, UndecidedError
from sampling_design.nonlinear import examples
from sampling_design.nonlinear.jacobians import instructions, points_of, without_bound
from sampling_design.nonlinear.region import StateRegion
from sampling_design.nonlinear.simulation import simulate
from sampling_design.nonlinear.thyroid import thyroid
from sampling_design.uncertain.inclusion.certify_inclusion import certify_inclusion, longest_gap
from sampling_design.uncertain.inclusion.members import graph_for
from sampling_design.uncertain.inclusion.search import InclusionSearch

SIZES = {"states": 2, "disturbances": 1, "outputs": 1}


@pytest.fixture(scope="module")
def swinging():
    return certify(examples.pendulum(), GapRange(0.1, 1.0), eta=0.4)


def test_the_pendulum_is_certified_at_all_angles(swinging, tmp_path):
    assert swinging.verify().verdict == "proven"
    assert swinging.lam < 60.0  # the prototype of the theory: 60, M > 13.7
    assert swinging.horizon().minimum < 13.7
    assert swinging.horizon("arrival").minimum == pytest.approx(np.log(4) / 0.4)
    again = read_certificate(swinging.save(tmp_path / "pendulum.json"))
    assert again.to_dict() == swinging.to_dict()
    assert again.verify().passed
    assert "stay in the region" in str(swinging.claim)


def test_no_pair_of_pendulums_violates_it(swinging):
    """Assumption 7 along pairs that are simulated: starts near and far, disturbances that push them apart."""
    plant, rng, c = examples.pendulum(), np.random.default_rng(0), swinging
    least = np.inf
    for _ in range(6):
        gaps = np.where(rng.random(8) < 0.5, rng.choice([0.1, 1.0], 8), rng.uniform(0.1, 1.0, 8))
        times = np.concatenate([[0.0], np.cumsum(gaps)])
        start = rng.uniform([-3.0, -1.0], [3.0, 1.0])
        other = start + rng.normal(size=2) * rng.choice([1e-3, 1.0])
        w = [rng.normal(size=(times.size, 1)) * rng.choice([0.0, 0.5]) for _ in range(2)]
        one, two = (simulate(plant, s, times, w=v) for s, v in zip((start, other), w, strict=True))
        d, push = one - two, (w[0] - w[1])[:-1, 0]
        right = float(d[0] @ c.P2 @ d[0])
        for k, gap in enumerate(gaps.tolist()):
            share = np.exp(-c.eta * gap)
            right = right * share + push[k] ** 2 * c.Qw[0, 0] * (1 - share) / c.eta
            least = min(least, right / float(d[k + 1] @ c.P1 @ d[k + 1]))
            right += d[k + 1, 0] ** 2 * c.Rtilde[0, 0]
    assert least >= 1.0


@pytest.mark.long
def test_angles_that_are_bounded_bear_longer_gaps():
    found = {
        most: longest_gap(examples.pendulum(largest_angle=most), eta=0.05, most=3.2, pieces=8).family.longest
        for most in (np.pi / 3, None)
    }
    assert found[None] > 1.1
    assert found[np.pi / 3] > 1.9


@pytest.mark.long
def test_a_growth_rate_known_to_a_third_bears_gaps_of_an_hour():
    """Cells judged by the norm of what their Jacobian is off, against the diagonal alone, leave this one open."""
    plant = examples.bioreactor().in_region([9.0, 0.4, 0.2], [10.0, 0.7, 0.4])
    weights = weights_of(plant.centre, None, None, None)
    gaps = GapRange(0.1, 1.0)
    search = InclusionSearch(plant, gaps, graph_for(gaps, 0, plant.centre.n_outputs), weights, 3.0)
    found = search.solve(0.02, 2)
    data = search.certificate(found, 0.02, 2, 9, 0.0).to_dict()
    assert judged(data, False, 0.0).passed
    data["eta"] = 0.3
    del data["digest"]
    assert not judged(data, False, 0.0).passed


def test_coordinates_decide():
    certificate = certify_inclusion(examples.van_der_pol(), GapRange(0.1, 1.0), eta=0.05, pieces=8)
    assert certificate.verify().passed
    with pytest.raises(UndecidedError, match="no P"):
        certify_inclusion(examples.van_der_pol("velocity"), GapRange(0.1, 1.0), eta=0.05, pieces=2)


def test_a_pathological_gap_of_a_linearisation_is_told_apart_from_a_refutation():
    with pytest.raises(UndecidedError, match="The nonlinear plant is not refuted by that") as caught:
        certify_inclusion(examples.pendulum(), GapRange(3.0, 3.3), eta=0.1, pieces=4)
    assert isinstance(caught.value, CertificateError)


def test_instructions_say_what_the_function_is():
    x, w = ca.SX.sym("x", 2), ca.SX.sym("w", 1)
    rate = ca.vertcat(ca.tanh(x[0]) * ca.exp(-x[1]) / (1 + x[0] ** 2) + x[1] ** 1.5, ca.fmax(0, 1) * ca.sqrt(x[1]) - w)
    function = ca.Function("f", [x, w], [ca.densify(rate)])
    program = programs.read(instructions(function, ("x", "w")), "f", {"x": 2, "u": 0, "w": 1})
    for point in np.random.default_rng(0).uniform(0.1, 2.0, (10, 3)):
        inside = [Interval(np.array([v]), np.array([v])) for v in point]
        done = programs.every(program, {"x": inside[:2], "w": inside[2:]}, ())
        found = [done[k][0] for k in program.outputs]
        truth = np.array(function(point[:2], point[2:])).ravel()
        for value, interval in zip(truth, found, strict=True):
            assert interval.low[0] - 1e-12 <= value <= interval.high[0] + 1e-12
            assert interval.high[0] - interval.low[0] < 1e-9


def test_the_patient_has_instructions_too():
    model = thyroid().model_to_dict()
    assert len(model["f"]["outputs"]) == 6
    assert model["x"]["low"] == [0.0] * 6
    assert model["x"]["high"] == [None] * 6


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: StateRegion([1.0], [0.0]), "`lower` and `upper` of a region must be vectors"),
        (lambda: StateRegion([0.0], [1.0], about=[2.0]), "`about` must lie between `lower` and `upper` of the region"),
        (lambda: examples.pendulum().in_region([0.0], [1.0]), "`region` must be a StateRegion of 2 states"),
        (lambda: examples.van_der_pol("polar"), '`coordinates` must be "lienard" or "velocity"'),
        (
            lambda: NonlinearPlant(
                lambda x, u, w: [x[1], -x[0] + w[0]], lambda x, u, v: [x[0] * (1 + v[0])], SIZES
            ).model_to_dict(),
            "`measurement` must add one noise to each output",
        ),
        (
            lambda: NonlinearPlant(
                lambda x, u, w: [ca.if_else(x[0] > 0, x[1], -x[1]), w[0]], lambda x, u, v: [x[0] + v[0]], SIZES
            ).model_to_dict(),
            "must be made of arithmetic, powers, exp",
        ),
        (
            lambda: certify(
                examples.pendulum().in_region([0.0, 0.0], [1.0, 1.0], [[1.0, 1.0], [-1.0, -1.0]], [0.3, -0.3]),
                GapRange(0.1, 1.0),
            ),
            "`region` must hold states at which the model has derivatives",
        ),
    ],
)
def test_wrong_arguments_are_refused(make, match):
    with pytest.raises(ArgumentError, match=match):
        make()


def test_a_region_shows_and_explains_itself():
    region = StateRegion([-1.0, -np.inf], [1.0, np.inf], [[1.0, 1.0]], [1.0])
    assert "half-spaces" in str(region)
    assert "1 half-spaces" in region.explain()
    assert region.holds([[0.0, 0.0], [0.0, 2.0], [2.0, 0.0]]).tolist() == [True, False, False]
    assert region.middle.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("plant", [examples.batch_reactor(), examples.quadruple_tank(), examples.stirred_reactor()])
def test_plants_of_others_have_a_model(plant):
    members = plant.members(np.random.default_rng(0))
    assert members.dynamics.shape[1:] == (plant.n_states, plant.n_states + plant.n_disturbances)
    assert plant.model_to_dict()["kind"] == "nonlinear"


def test_a_region_with_a_pole_in_its_middle_is_refused_in_its_own_words():
    shown = [lambda x, u, v: [x[0] + v[0]], lambda x, u, v: [1 / x[0] + v[0]]]
    moves = [lambda x, u, w: [x[1], -1 / x[0] + w[0]], lambda x, u, w: [x[1], -x[0] + w[0]]]
    for f, h in zip(moves, shown, strict=True):
        plant = NonlinearPlant(f, h, SIZES).in_region([-1.0, -1.0], [1.0, 1.0])
        with pytest.raises(
            ArgumentError, match=r"must have a finite linearisation at \[0, 0\], the state that its region"
        ):
            certify_inclusion(plant, GapRange(0.1, 0.5), eta=0.05, pieces=4)
    beside = NonlinearPlant(moves[0], shown[0], SIZES).in_region([0.0, -1.0], [1.0, 1.0])
    with pytest.raises(UndecidedError, match="no P"):  # the Jacobian is unbounded at the region's edge
        certify_inclusion(beside, GapRange(0.1, 0.5), eta=0.05, pieces=4)


@pytest.mark.parametrize(
    ("rate", "name"),
    [
        (lambda x, u, w: [w[0] * x[0] - x[0]], "w1"),
        (lambda x, u, w: [u[0] * x[0] - x[0] + w[0]], "u1"),
        (lambda x, u, w: [w[0] ** 2 - x[0]], "w1"),
        (lambda x, u, w: [u[0] * w[0] * x[0] - x[0]], "u1, w1"),
    ],
)
def test_what_multiplies_a_state_and_has_no_bound_is_refused_before_any_search(rate, name, monkeypatch):
    sizes = {"states": 1, "inputs": 1, "disturbances": 1, "outputs": 1}
    plant = NonlinearPlant(rate, lambda x, u, v: [x[0] + v[0]], sizes).in_region([-1.0], [1.0])
    monkeypatch.setattr(InclusionSearch, "solve", None)
    with pytest.raises(ArgumentError, match=f"and {name} without a bound makes them infinite"):
        certify(plant, GapRange(0.1, 0.5), eta=0.1)


@pytest.mark.parametrize(
    "name", ["pendulum", "van_der_pol", "batch_reactor", "quadruple_tank", "bioreactor", "unicycle"]
)
def test_what_is_linear_or_saturates_needs_no_bound(name):
    plant = getattr(examples, name)()
    point = np.concatenate([part[-1] for part in points_of(plant, np.random.default_rng(0))])
    assert without_bound(plant, point) == []
