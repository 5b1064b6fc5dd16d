"""Family certificates: reference values, all families, files, refusals at the door."""

import dataclasses
import json

import numpy as np
import pytest
from scipy import sparse

import sampling_design as sd
from sampling_design import GapRange, Jitter, LostSamples, PeriodicSchedule, Plant, SpacedWindows
from sampling_design.certificates.exact.certificate import latest_samples
from sampling_design.certificates.families import certify_family as family
from sampling_design.certificates.families import program
from sampling_design.certificates.families.graphs import MOST_NODES, graph_of, in_plant_terms, unrolled
from sampling_design.certificates.families.step_proof import node_conditions, prove
from sampling_design.certificates.form.claims import RESOLUTION, STATED_MARGIN
from sampling_design.checkers.outcome import Verdict
from sampling_design.errors import ArgumentError, FileFormatError, SolverError, UndecidedError
from tests.cases import few

OSCILLATOR = Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]])
INTEGRATOR = Plant([[0.0, 1.0], [0.0, 0.0]], [[1.0, 0.0]])


@pytest.mark.parametrize(
    ("plant", "gaps", "together", "separate"),
    few(
        [
            (OSCILLATOR, (0.9, 1.1), 1.25, 1.19),
            (OSCILLATOR, (0.5, 1.5), 1.36, 1.33),
            (OSCILLATOR, (0.5, 2.5), 1.90, 1.43),
            (OSCILLATOR, (0.3, 3.0), 9.3, 1.68),
            (INTEGRATOR, (0.5, 1.5), 1.37, 1.26),
            (INTEGRATOR, (0.1, 4.0), 2.27, 1.79),
        ],
        0,
        4,
    ),
)
def test_reference_values_of_gap_ranges(plant, gaps, together, separate):
    # P2 apart from the matrix after a sample; R~ = 1/2, Qw = I; the reference lets P2 be as small as it likes
    found = sd.certify(plant, GapRange(*gaps), eta=0.1, R=[[1.0]], noise_gain=1e4)
    assert 1.0 < found.lam <= separate + 0.01 < together
    assert found.verify().passed
    assert np.allclose(found.Rtilde, 0.5)


def test_a_wider_range_has_a_larger_lambda():
    lams = [sd.certify(OSCILLATOR, GapRange(1 - r, 1 + r), eta=0.4, P2=np.eye(2)).lam for r in (0.0, 0.2, 0.5)]
    assert lams[0] < lams[1] < lams[2]


def test_a_gap_that_no_lambda_bears_is_said_before_anything_is_tried(monkeypatch):
    """Lambda is at least e^{(2 alpha + eta) h}: hours of programs would end where they began."""
    monkeypatch.setattr(family, "FamilySearch", None)
    growing = Plant([[0.1, 1.0], [0.0, -0.2]], [[1.0, 0.3]], time_unit="h")
    with pytest.raises(UndecidedError, match=r"may grow by e\^180\.1 within the longest gap of 900") as told:
        sd.certify(growing, GapRange(0.5, 900.0, time_unit="h"))
    assert told.value.details["longest"] == pytest.approx(184, abs=1)


def test_a_gap_that_some_lambda_bears_keeps_to_its_lower_bound():
    growing = Plant([[0.1]], [[1.0]])
    found = sd.certify(growing, GapRange(0.5, 40.0), eta=0.01)
    assert found.lam >= np.exp(0.21 * 40.0) * (1 - 1e-3)


def test_a_range_of_one_gap_is_nearly_the_exact_certificate():
    exact = sd.certify(OSCILLATOR, PeriodicSchedule([1.0]), eta=0.4, P2=[[2.0, 0.3], [0.3, 1.0]])
    found = sd.certify(OSCILLATOR, GapRange(1.0, 1.0), eta=0.4, P2=exact.P2)
    assert exact.lam <= found.lam * (1 + 1e-3)
    assert found.lam <= exact.lam * 1.01


@pytest.mark.long
def test_rate_and_weights_are_chosen_within_the_noise_gain():
    found = sd.certify(INTEGRATOR, GapRange(0.8, 1.2))
    assert found.verify().passed
    assert found.horizon().minimum < 2.0
    small = sd.certify(INTEGRATOR, GapRange(0.5, 1.5), eta=0.4, noise_gain=2.0)
    large = sd.certify(INTEGRATOR, GapRange(0.5, 1.5), eta=0.4, noise_gain=30.0)
    assert large.lam < small.lam
    assert small.horizon().C_w < large.horizon().C_w


FAMILIES = [
    SpacedWindows(3.0, 2, 0.5),
    SpacedWindows(4.0, 3, 0.5),
    LostSamples(PeriodicSchedule([1.0]), 1, 3),
    LostSamples(PeriodicSchedule([0.7, 0.4], first=0.2), 2, 4),
    Jitter(PeriodicSchedule([1.0, 2.0]), 0.2),
    Jitter(PeriodicSchedule([1.0]), 0.0),
]


@pytest.mark.parametrize("which", few(FAMILIES, 2, 5), ids=lambda f: type(f).__name__)
def test_every_kind_of_family_is_certified_saved_and_read(which, tmp_path):
    found = sd.certify(OSCILLATOR, which, eta=0.2)
    assert found.verify().passed
    back = sd.read_certificate(found.save(tmp_path / "family.json"))
    assert back.to_dict() == found.to_dict()
    assert json.loads((tmp_path / "family.json").read_text())["claim"] == "family"
    assert back.family.to_dict() == found.family.to_dict()
    assert back.verify().passed
    assert back.horizon().minimum == pytest.approx(np.log(found.lam_proven) / 0.2)
    assert found.d_max == which.d_max


def test_outputs_of_the_nominal_schedule_are_followed():
    plant = Plant(OSCILLATOR.A, np.eye(2), outputs=sd.plants.Signals(["x", "v"]))
    mask = np.array([[1, 0], [0, 1]], bool)
    nominal = PeriodicSchedule([1.0, 1.0], outputs=mask, output_names=("x", "v"))
    both = sd.certify(plant, Jitter(PeriodicSchedule([1.0, 1.0]), 0.1), eta=0.4, P2=np.eye(2))
    turns = sd.certify(plant, Jitter(nominal, 0.1), eta=0.4, P2=np.eye(2))
    swapped = PeriodicSchedule([1.0, 1.0], outputs=mask[:, ::-1], output_names=("v", "x"))
    other = sd.certify(plant, Jitter(swapped, 0.1), eta=0.4, P2=np.eye(2))
    assert both.lam < turns.lam == other.lam
    assert turns.verify().passed
    thinned = sd.certify(plant, LostSamples(nominal, 1, 3), eta=0.4, P2=np.eye(2))
    assert thinned.lam > sd.certify(plant, Jitter(nominal, 0.0), eta=0.4, P2=np.eye(2)).lam
    assert thinned.verify().passed


@pytest.mark.long
def test_memory_is_grown_on_demand():
    # gaps up to 3.5 hold pi, but a long gap is followed by a short one
    which = SpacedWindows(4.0, 2, 0.5)
    found = sd.certify(OSCILLATOR, which, eta=0.1, P2=np.eye(2))
    assert which.d_max > np.pi
    assert len(set(found.graph.words)) > 2
    with pytest.raises(UndecidedError, match=r"undecided at rate 0\.1"):
        sd.certify(OSCILLATOR, which, eta=0.1, memory=0, P2=np.eye(2))


@pytest.mark.long
def test_a_range_within_a_thousandth_of_half_a_turn_is_certified():
    # the slack of the usual margin is too small for the steps of the proof: the margin grows
    found = sd.certify(OSCILLATOR, GapRange(0.5, np.pi - 1e-3), eta=0.1)
    assert found.lam < 2.0
    assert found.verify().passed
    assert np.linalg.cond(found.P[-1]) > 1e5


@pytest.mark.parametrize("seed", few([3, 24], 1))
def test_lambda_of_matrices_leaves_what_the_certificate_states(seed):
    """Between the instants that are looked at information may dip by the resolution; a margin is stated beyond it."""
    search = family.FamilySearch(
        OSCILLATOR, in_plant_terms(OSCILLATOR, GapRange(0.5, 3.0)), (np.eye(2), 2 * np.eye(1), 2 * np.eye(1)), None, 3.0
    )
    posed, rng = search.program(0.1, search.graph(0, layers=1)), np.random.default_rng(seed)
    roots = rng.normal(size=(posed.graph.count, 2, 2))
    P = roots @ roots.swapaxes(1, 2) + 0.01 * np.eye(2)
    lam, proof = search._lam_of(posed, P)
    stated = (1 + STATED_MARGIN) * (1 - RESOLUTION) * P[0] / lam
    assert proof.proven
    assert prove(posed.dynamics, node_conditions(posed.graph, P, stated)).proven
    assert not prove(posed.dynamics, node_conditions(posed.graph, P, stated * 1.01)).proven


@pytest.mark.parametrize("start", few([1.01, 2.0, 1e4], 2))
@pytest.mark.parametrize(("longest", "rtol"), [(1.5, family.LAM_RTOL), (1.5, family.COARSE_RTOL), (0.03, 0.003)])
def test_the_least_lambda_is_bracketed_by_few_programs(start, longest, rtol):
    """A program is solved just below what is returned, and has no point; halvings between 1 and 2 would take nine.

    Of short gaps the least lambda is hardly above 1, which takes no more of them.
    """
    family_ = in_plant_terms(OSCILLATOR, GapRange(longest / 3, longest))
    search = family.FamilySearch(OSCILLATOR, family_, (np.eye(2), np.eye(1), np.eye(1)), None, 3.0)
    posed, tried = search.program(0.1, search.graph(0)), {}
    solved = posed.feasible
    posed.feasible = lambda lam, floor: tried.setdefault(lam, solved(lam, floor))
    lam, P, _, _ = search.least_lam(posed, rtol, start)
    reached = {each: found[1] is not None for each, found in tried.items()}
    assert P is tried[lam][1]
    assert lam == min(each for each, holds in reached.items() if holds)
    assert lam / (1 + rtol) <= max(each for each, holds in reached.items() if not holds) < lam
    assert len(tried) <= (7 if rtol < 0.01 else 5) + 3 * (start > 100)
    assert search.least_lam(posed, rtol, lam * 1.2, enough=lam * 1.2)[0] == lam * 1.2


def test_the_margin_stops_growing():
    family_ = in_plant_terms(OSCILLATOR, GapRange(0.5, 1.5))
    search = family.FamilySearch(OSCILLATOR, family_, (np.eye(2), np.eye(1), np.eye(1)), None, 3.0)
    program = search.program(0.1, search.graph(0))
    widened = [program.widen() for _ in range(4)]
    assert widened == [True, True, True, False]
    assert program.margin == 0.05


def test_the_undecided_say_how_far_both_sides_came():
    with pytest.raises(UndecidedError, match="Certified is, as the largest part by halvings: Every sch") as caught:
        # gaps of pi - 1e-7: seen by every sample, but too little for the numbers of a certificate
        sd.certify(OSCILLATOR, GapRange(2.0, np.pi - 1e-7), eta=0.1, memory=0, P2=np.eye(2))
    details = caught.value.details
    assert caught.value.exit_code == 3
    assert details["status"] == "undecided"
    part = details["certified"]
    assert 2.0 < part.shortest < part.longest < np.pi
    assert 0 < details["margin"] < 1e-3
    assert GapRange(2.0, np.pi - 1e-7).contains(details["word"])


@pytest.mark.long
def test_a_badly_scaled_plant_keeps_its_lambda():
    scale = np.array([1e6, 1e-3])
    plant = Plant(np.diag(scale) @ OSCILLATOR.A @ np.diag(1 / scale), OSCILLATOR.C / scale, G=np.diag(scale),
                  states=sd.plants.Signals(["x", "v"], scales=scale))  # fmt: skip
    plain = sd.certify(OSCILLATOR, GapRange(0.5, 1.5), eta=0.4)
    scaled = sd.certify(plant, GapRange(0.5, 1.5), eta=0.4)
    assert scaled.lam == pytest.approx(plain.lam, rel=5e-3)


def test_a_plant_without_states_needs_nothing():
    plant = Plant(np.zeros((0, 0)), np.zeros((1, 0)))
    found = sd.certify(plant, GapRange(0.5, 1.5))
    assert (found.lam, found.verify().passed) == (1.0, True)


def test_unstable_and_several_states():
    helicopter = sd.plants.library.helicopter_he1()
    found = sd.certify(helicopter, GapRange(0.2, 0.5), eta=0.3)
    assert found.verify().passed
    assert found.lam < 3.0


def test_records_say_what_they_prove():
    found = sd.certify(OSCILLATOR, GapRange(0.5, 1.5), eta=0.4)
    assert "Every schedule whose gaps lie between 0.5 and 1.5" in found.explain()
    assert "every schedule of the family" in str(found.claim)
    assert "edges" in str(found)
    counted = found.error_bound([0.0, 3.0], [1.0, 0.0], 0.1, 0.1)
    silent = found.error_bound([0.0, 3.0], [1.0, 0.0], 0.1)
    assert np.all(counted > silent)
    # no schedule of the family has more samples in [0, 3] than seven
    assert found._samples_until(3.0).size == 7


@pytest.mark.parametrize("count", [3, 6, 7])
def test_a_sample_at_the_end_is_counted_whatever_rounding_says(count):
    """0.3/0.1 is less than 3 in doubles, and 0, 0.1, 0.2, 0.3 are four samples."""
    end = round(0.1 * count, 1)
    assert latest_samples(end, 0.1).size == count + 1
    assert latest_samples(0.99 * end, 0.1).size == count


def test_what_does_not_fit_is_refused_at_the_door():
    with pytest.raises(ArgumentError, match="`family` must be a SamplingFamily, got list"):
        family.certify_family(OSCILLATOR, [1.0, 2.0])
    with pytest.raises(ArgumentError, match="`plant` must be a Plant"):
        family.certify_family(np.eye(2), GapRange(0.5, 1.5))
    with pytest.raises(ArgumentError, match="`family` is in h and the plant in s"):
        sd.certify(OSCILLATOR, GapRange(0.5, 1.5, time_unit="h"))
    with pytest.raises(ArgumentError, match="must be a PeriodicSchedule: a finite one has no long run"):
        sd.certify(OSCILLATOR, Jitter(sd.Schedule([1.0, 2.0]), 0.1))
    with pytest.raises(ArgumentError, match=r"`noise_gain` must be above 1, got 1\.0"):
        sd.certify(OSCILLATOR, GapRange(0.5, 1.5), noise_gain=1.0)
    with pytest.raises(ArgumentError, match="`memory` must be a whole number from 0 to 4 for this family, got 9"):
        sd.certify(OSCILLATOR, GapRange(0.5, 1.5), eta=0.1, memory=9)
    with pytest.raises(sd.errors.InfeasibleRequirementError, match="an endless schedule needs"):
        sd.certify(OSCILLATOR, SpacedWindows(2.0, 3, 0.9), eta=0.1)
    large = LostSamples(PeriodicSchedule(np.ones(60)), 2, 8)
    with pytest.raises(ArgumentError, match=f"the graph of this family has more than {MOST_NODES} nodes"):
        graph_of(large, large.levels_of_memory - 1, 1)


def test_a_proof_that_does_not_close_is_no_certificate(monkeypatch):
    from sampling_design.certificates.form import verdict

    found = Verdict("refuted", "x", "too tight")
    monkeypatch.setattr(verdict, "verdict_on", lambda content, prove, work=None: found)
    with pytest.raises(UndecidedError, match="undecided: the proof of the certificate did not close: too tight"):
        sd.certify(OSCILLATOR, GapRange(0.9, 1.1), eta=0.1, P2=np.eye(2))


def test_matrices_and_graph_must_fit():
    found = sd.certify(OSCILLATOR, GapRange(0.9, 1.1), eta=0.1, P2=np.eye(2))
    parts = {key: getattr(found, key) for key in ("P1", "P2", "Qw", "R", "Qv", "eta", "lam", "lam_samples", "graph")}
    with pytest.raises(ArgumentError, match="`P` must hold one matrix per node of the graph, P2 first"):
        family.FamilyCertificate(OSCILLATOR, found.family, **parts, P=found.P[1:])


def test_damaged_graphs_are_refused_by_name(tmp_path):
    found = sd.certify(OSCILLATOR, GapRange(0.9, 1.1), eta=0.1, P2=np.eye(2))
    whole = found.to_dict()
    del whole["graph"]
    path = tmp_path / "cut.json"
    path.write_text(json.dumps(whole))
    with pytest.raises(FileFormatError, match="`graph` is missing in the certificate"):
        sd.read_certificate(path)


def test_graphs_hold_what_their_words_say():
    which = LostSamples(PeriodicSchedule([1.0]), 1, 3)
    graph = graph_of(in_plant_terms(OSCILLATOR, which), 1, 1)
    assert graph.words == ((), (0,), (0, 1), (0, 0, 1))
    lost = [(e.source, e.target) for e in graph.edges if not any(e.outputs)]
    assert lost == [(0, 2), (1, 2)]
    twice = unrolled(graph, 2)
    assert twice.count == 7
    assert list(twice.tops) == [1.0] * 7
    assert {(e.source, e.target) for e in twice.edges if e.source == 2} == {(2, 6)}


def test_a_record_by_hand_needs_a_family():
    made = family.certify_family(OSCILLATOR, GapRange(0.9, 1.1), eta=0.2, memory=0)
    with pytest.raises(ArgumentError, match="`schedule` must be a Schedule, a PeriodicSchedule or a family"):
        dataclasses.replace(made, family="often")


def test_a_timing_tolerance_is_the_family_of_all_such_times():
    schedule = PeriodicSchedule([1.0])
    wanted = sd.certify(OSCILLATOR, Jitter(schedule, 0.05), eta=0.2)
    found = sd.certify(OSCILLATOR, schedule, timing_tolerance=0.05, eta=0.2)
    assert isinstance(found.family, Jitter)
    assert found.to_dict() == wanted.to_dict()
    with pytest.raises(ArgumentError, match="`timing_tolerance` is for one schedule, got"):
        sd.certify(OSCILLATOR, Jitter(schedule, 0.05), timing_tolerance=0.05)
    with pytest.raises(ArgumentError, match="`timing_tolerance` must be less than half of the least gap 1"):
        sd.certify(OSCILLATOR, schedule, timing_tolerance=0.6)


def test_rows_of_a_long_schedule_are_kept_without_their_zeros(monkeypatch):
    """Each edge of 30 gaps has rows over the matrices of 30 nodes, and numbers in those of two."""
    held = []

    def stopped(cost, blocks, budget):
        held.append([(A.nnz if sparse.issparse(A) else A.size, A.shape[0] * A.shape[1]) for _, A, _ in blocks])
        raise UndecidedError("undecided: that is enough")

    monkeypatch.setattr(program, "_solved", stopped)
    plant = Plant(np.kron(np.diag([1.0, 2.0, 3.0]), [[0.0, 1.0], [-1.0, 0.0]]), [[1.0, 0.0, 1.0, 0.0, 1.0, 0.0]])
    late = sd.Jitter(PeriodicSchedule(np.linspace(0.1, 0.2, 30)), 0.001)
    with pytest.raises(UndecidedError, match="that is enough"):
        sd.certify(plant, late, eta=0.1, P2=np.eye(6))
    stored, whole = np.sum(held[0], axis=0)
    assert stored < 0.1 * whole


def test_a_family_is_certified_in_whatever_unit_its_outputs_are():
    family = LostSamples(PeriodicSchedule([0.7]), 1, 3)
    fine = sd.certify(Plant(OSCILLATOR.A, 1e6 * OSCILLATOR.C), family, eta=0.8)
    assert "noise as large as what disturbances of 1 do to an output" in fine.explain()
    R = fine.R * 1e12  # of the same noise, in the unit of the oscillator's output
    assert fine.lam == pytest.approx(sd.certify(OSCILLATOR, family, eta=0.8, R=R, Qv=R).lam, rel=0.02)
    assert 0.5 < R[0, 0] / 2 < 2


def test_one_loss_among_any_number_of_samples_is_certified():
    """What is tried does not grow with the number of samples: neither levels of memory nor suspects."""
    rare = sd.certify(OSCILLATOR, LostSamples(PeriodicSchedule([0.7]), 1, 10**9), eta=0.4, P2=np.eye(2))
    assert rare.graph.count < 20


def test_the_undecided_without_bounds_say_that_units_were_weighed():
    units = np.diag([1e9, 1e-9])
    far = Plant(units @ OSCILLATOR.A @ np.diag([1e-9, 1e9]), OSCILLATOR.C @ np.diag([1e-9, 1e9]))
    one = Jitter(PeriodicSchedule([1.0]), 0.0)
    with pytest.raises(
        UndecidedError, match="w and v of 1 count alike: give w_bound, v_bound and initial_error"
    ) as caught:
        sd.certify(far, one, eta=0.8)
    assert caught.value.details["status"] == "undecided"
    assert sd.certify(far, one, w_bound=[1e9, 1e-9], v_bound=1.0, initial_error=[1e9, 1e-9]).verify()


def test_tolerances_of_outputs_are_told_by_their_names_and_unit():
    plant = Plant(OSCILLATOR.A, np.eye(2), time_unit="s", outputs=["strip", "laboratory"])
    schedule = PeriodicSchedule([1.0, 1.5], outputs=[[1, 0], [1, 1]], time_unit="s")
    made = sd.certify(plant, schedule, timing_tolerance={"strip": 0.02, "laboratory": 0.05}, eta=0.5, P2=np.eye(2))
    for said in (str(made), made.explain(), made.to_latex(), made.plot().get_title(loc="left")):
        assert "up to 0.02 s early or late (strip), up to 0.05 s early or late (laboratory)" in said


@pytest.mark.parametrize("unit", [1.0, 1e6])
@pytest.mark.parametrize("A", [[[-0.5]], [[-0.5, 1.0], [0.0, -0.5]], [[0.1, 0.3], [0.0, -0.5]]], ids=str)
def test_what_nothing_drives_is_certified_along_families(A, unit):
    """What decays and nothing drives leaves no covariance for coordinates, and there is no most of its information."""
    plant = Plant(np.divide(A, unit), np.ones((1, len(A))), G=np.zeros((len(A), 1)))
    made = sd.certify(plant, GapRange(0.8 * unit, unit), eta=0.4 / unit)
    assert made.verify().passed
    assert made.lam < (1.1 if A[0][0] < 0 else 10.0)


@pytest.mark.parametrize(
    ("rate", "turned", "family"),
    few(
        [
            (rate, turned, spec)
            for rate in (20.0, 700.0, 1e4)
            for turned in (False, True)
            for spec in (GapRange(0.5, 1.5), LostSamples(PeriodicSchedule([1.0]), 1, 3))
        ],
        2,
        4,
    ),
)
def test_what_is_gone_within_a_gap_and_nothing_drives_changes_no_lambda(rate, turned, family):
    """Of modes that decay by e^-20 to e^-15000 in a gap rounding leaves nothing, in whatever basis they stand."""
    Q = np.linalg.qr(np.random.default_rng(1).standard_normal((2, 2)))[0] if turned else np.eye(2)
    whole = Plant(Q @ np.diag([-rate, 0.1]) @ Q.T, [[1.0, 1.0]] @ Q.T, G=np.zeros((2, 1)))
    alone = sd.certify(Plant([[0.1]], [[1.0]], G=[[0.0]]), family, eta=0.1)
    made = sd.certify(whole, family, eta=0.1)
    assert made.verify().passed
    assert made.lam == pytest.approx(alone.lam, rel=1e-3)


def test_a_nominal_schedule_that_does_not_settle_is_no_obstacle(monkeypatch):
    """It gives coordinates alone; those of the scales serve, too."""

    def unsettled(problem):
        raise SolverError("the information did not settle")

    monkeypatch.setattr(family, "periodic_riccati_solution", unsettled)
    assert sd.certify(OSCILLATOR, GapRange(0.9, 1.1), eta=0.4).verify().passed


@pytest.mark.parametrize("bounded", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_plant_that_decays_on_its_own_is_certified_along_families_too(bounded):
    """Beside an output that is nearly exact no solver sees what is left between samples; the decay alone is enough."""
    given = {"w_bound": 0.1, "v_bound": 0.1, "initial_error": 1.0} if bounded else {"eta": 1e9, "Qw": [[1e-9]]}
    made = sd.certify(Plant([[-2.5e9]], [[2.8e7], [0.015]], G=[[1e9]]), GapRange(5e-10, 7e-10), **given)
    assert made.verify().passed
    assert made.lam < 1.01
    assert ("noise gain is beyond 3" in made.explain()) is not bounded
