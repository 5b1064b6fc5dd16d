"""Plants of chosen rows: against the quotient by hand, against what the rows show, in files and verbs."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from sampling_design import (
    CostFunction,
    KalmanFilter,
    PeriodicSchedule,
    PlanRequirement,
    Plant,
    Requirement,
    UncertainParameter,
    UncertainPlant,
    certificate_exists,
    certify,
    design_schedule,
    guaranteed_accuracy,
    plan_samples,
    read_certificate,
    read_plan,
    simulate_record,
    window_sigma,
)
from sampling_design.certificates.files import certificate_from_dict
from sampling_design.certificates.rigorous.decide import verify_rigorously
from sampling_design.checkers.check import verdict
from sampling_design.errors import (
    ArgumentError,
    CertificateError,
    FileFormatError,
    NotDetectableError,
    NotObservableError,
)
from sampling_design.observability import functional_plant, unobservable_modes
from sampling_design.plants import FunctionalPlant, read_plant, write_plant
from tests.cases import few
from tests.checkers.test_sampled import redigested
from tests.oracles.hidden import random_hidden, random_rows

THREE = Plant(np.diag([0.1, 0.2, -1.0]), [[1.0, 0.0, 0.5]], name="three")
EVERY_SECOND = PeriodicSchedule([1.0])


def least_gain_of_rows(observed, H):
    """min |O x| over |H x| = 1, where O has full rank: one over the largest value of H O^+, without any coordinates."""
    return 1 / np.linalg.norm(H @ np.linalg.pinv(observed), 2)


def test_a_state_that_nothing_else_holds_is_deleted_without_rounding():
    part = functional_plant(THREE, "x1")
    np.testing.assert_array_equal(part.A, np.diag([0.1, -1.0]))
    np.testing.assert_array_equal(part.C, [[1.0, 0.5]])
    np.testing.assert_array_equal(part.map, [[1, 0, 0], [0, 0, 1]])
    assert (part.states.names, part.rows, part.wanted.names) == (("x1", "x3"), 1, ("x1",))
    assert part.explain() == (
        "What x1 of three needs: 2 states, 1 direction of the state that no output shows and no row holds left out."
    )


@pytest.mark.parametrize("seed", range(12))
def test_the_quotient_has_the_size_and_the_rows_of_the_one_by_hand(seed):
    plant, H, kept = random_hidden(np.random.default_rng(seed))
    part = functional_plant(plant, H)
    assert part.n_states == kept
    times = [0.0, 0.7, 1.9]
    for t in times:  # z of every motion, and y, are those of the whole plant
        whole, own = expm(plant.A * t), expm(part.A * t) @ part.map
        for rows, mine in ((H, np.eye(part.n_states)[: len(H)]), (plant.C, part.C)):
            np.testing.assert_allclose(mine @ own, rows @ whole, atol=1e-8 * np.abs(rows @ whole).max())


@pytest.mark.parametrize("seed", few(range(300), *range(8)))
def test_rows_are_refused_where_what_is_hidden_does_not_die_out(seed):
    plant, H, dies = random_rows(np.random.default_rng(seed))
    if dies:
        assert functional_plant(plant, H).rows == 1
    else:
        with pytest.raises(NotDetectableError, match="into which a mode enters that no output shows"):
            functional_plant(plant, H)


@pytest.mark.parametrize("seed", range(6))
def test_sigma_of_rows_is_their_least_gain(seed):
    rng = np.random.default_rng(seed)
    plant, H, _ = random_hidden(rng)
    part = functional_plant(plant, H)
    shown = np.vstack([part.C @ expm(part.A * t) for t in np.sort(rng.uniform(0, 4, 2 * part.n_states + 2))])
    true = least_gain_of_rows(shown, np.eye(part.n_states)[: len(H)])
    scales = part.beside(4.0).states.scales
    assert (scales[: len(H)] == 1).all()
    weighed = np.linalg.svd(shown * scales, compute_uv=False)[-1]
    assert weighed <= true * (1 + 1e-9)
    assert weighed >= 0.98 * true


def test_window_sigma_of_rows_is_theirs_in_the_worst_window():
    found = window_sigma(THREE, EVERY_SECOND, 3.0, of="x1")
    part = functional_plant(THREE, "x1")
    ends = np.linspace(3.0, 4.0, 101)[:-1]
    least = min(
        least_gain_of_rows(
            np.vstack([part.C @ expm(part.A * (k - t + 3)) for k in range(9) if t - 3 <= k <= t]), np.array([[1.0, 0]])
        )
        for t in ends
    )
    assert found.lower == pytest.approx(least, rel=5e-3)
    assert found.lower <= least


def test_a_chain_that_the_rank_test_misses_is_refused():
    chain = Plant([[0.0, 1.0], [0.0, 0.0]], [[0.0, 0.0]], states=["position", "velocity"])
    for s in (0.0, 0.3):  # [sI - A; C; H] and [sI - A; C] have one rank, for H = velocity, and yet nobody knows it
        pencil = np.vstack([s * np.eye(2) - chain.A, chain.C])
        assert np.linalg.matrix_rank(pencil) == np.linalg.matrix_rank(np.vstack([pencil, [0.0, 1.0]]))
    with pytest.raises(
        NotDetectableError, match="velocity, into which a mode enters that no output shows and that does not decay"
    ):
        functional_plant(chain, "velocity")


def test_a_hidden_mode_may_enter_where_it_decays():
    plant = Plant(np.diag([0.1, -0.5]), [[1.0, 0.0]])
    assert functional_plant(plant, ["x1", "x2"]).n_states == 2
    with pytest.raises(NotDetectableError, match=r"does not decay at the rate 2\.0: -0\.5 along x2") as caught:
        functional_plant(plant, ["x1", "x2"], decay_rate=2.0)
    assert "or ask for states that it leaves alone: x1." in str(caught.value)


def test_refusals_name_the_row_the_mode_and_what_would_help():
    with pytest.raises(
        NotDetectableError, match=r"asks for x2, .* does not decay: 0.2 along x2\. Add an output"
    ) as caught:
        functional_plant(THREE, ["x1", "x2"])
    assert str(caught.value).endswith("or ask for states that it leaves alone: x1, x3.")
    for rows in ([[1.0, 0, 0], [2.0, 0, 0]], [[0.0, 0, 0]]):
        with pytest.raises(
            ArgumentError, match="must have rows that are independent of each other, and none of zeros, got "
        ):
            functional_plant(THREE, rows)
    with pytest.raises(ArgumentError, match="`of` must name states or outputs, got 'x4'"):
        functional_plant(THREE, "x4")
    with pytest.raises(ArgumentError, match="`of` must name at least one row, got none"):
        Requirement(of=np.zeros((0, 3)))


def test_the_rows_of_a_requirement_are_designed_for():
    with pytest.raises(NotObservableError, match=r"unobservable: 0\.2"):
        design_schedule(THREE, Requirement(window=4.0, samples=3))
    found = design_schedule(THREE, Requirement(window=4.0, samples=3, of="x1"))
    sigma = window_sigma(found.split.retained, found.schedule, 4.0).lower
    assert found.sigma == pytest.approx(sigma, rel=1e-9)
    assert "make x1 observable in every window" in found.explain()
    assert found.verify()


UNSEEN = Plant(np.diag([0.1, 0.05, -0.5]), [[1.0, 1.0, 0.0]])
"""Two modes that are seen together, and one that nobody sees and that decays."""


@pytest.mark.parametrize(
    ("rows", "unit"),
    few(
        [
            ([[1.0, 0, 0]], 1.0),
            ([[1.0, 0, 1]], 1e-9),
            ([[1.0, 0, 0], [1.0, 0, 1e3]], 1e9),
            ([[0.3, 1, -1], [0, 0, 1]], 1e-9),
        ],
        1,
    ),
)
def test_sigma_of_a_design_is_that_of_the_rows_on_what_does_not_decay(rows, unit):
    """What decays unseen enters the rows, and counts nothing."""
    units = np.array([1.0, 1.0, unit])
    plant = Plant(UNSEEN.A, UNSEEN.C, G=np.diag(units))
    found = design_schedule(plant, Requirement(window=4.0, samples=3), of=np.array(rows) / units, branches=0, starts=1)
    times = found.schedule.between(0.0, 30.0).times
    starts = np.concatenate([times[times < 20] + 1e-9, times[(times > 4) & (times < 20)] - 4 - 1e-9])
    exact = min(
        least_gain_of_rows(
            np.vstack([UNSEEN.C[:, :2] * np.exp(UNSEEN.A.diagonal()[:2] * (k - s)) for k in times if s <= k <= s + 4]),
            np.array(rows)[:, :2],
        )
        for s in starts
    )
    assert found.sigma == pytest.approx(exact, rel=2e-3)
    assert found.verify()
    assert "(functional coordinates, state at the window's start)" in str(found)
    assert found.window.coordinates == "functional"


def test_rows_into_which_only_decaying_modes_enter_need_no_samples():
    found = design_schedule(UNSEEN, Requirement(window=4.0, samples=3, of="x3"))
    assert found.schedule is None
    assert found.explain().startswith("No samples needed: every mode that enters x3 decays by itself")
    hidden = "no output shows -0.5 along {}, so that none helps against it"
    assert hidden.format("z1") in str(found)
    assert hidden.format("x2") in str(design_schedule(Plant(np.diag([-1.0, -0.5]), [[1.0, 0.0]]), Requirement()))


def test_a_rate_is_asked_of_the_rows_in_its_own_name():
    for ask in (certify, certificate_exists):
        with pytest.raises(
            NotDetectableError, match=r"asks for x3, .* does not decay at the rate 2\.0: -0\.5 along x3"
        ):
            ask(UNSEEN, EVERY_SECOND, eta=2.0, of=["x1", "x3"])
    with pytest.raises(ArgumentError, match="`eta` must be positive"):
        certify(UNSEEN, EVERY_SECOND, eta=-2.0, of=["x1", "x3"])


def test_a_certificate_of_rows_keeps_the_whole_plant_and_refuses_another(tmp_path):
    found = certify(THREE, EVERY_SECOND, of="x1", eta=0.7, P2=np.eye(2))
    again = read_certificate(found.save(tmp_path / "certificate.json"))
    assert isinstance(again.plant, FunctionalPlant)
    assert again.plant.whole.same_dynamics(THREE)
    assert again.verify(rigorous=True)
    with pytest.raises(CertificateError, match="it is about chosen rows of this one"):
        read_certificate(tmp_path / "certificate.json", THREE)
    with pytest.raises(CertificateError, match=r"its A\[0, 0\] is 0.1, not 0.3"):
        read_certificate(tmp_path / "certificate.json", Plant(np.diag([0.3, 0.2, -1.0]), THREE.C))
    assert certificate_exists(THREE, EVERY_SECOND, 0.1, of="x1")


@cache
def of_one_row():
    """The text of a certificate of one row of a plant of three states."""
    return json.dumps(certify(THREE, EVERY_SECOND, of="x1", eta=0.7, P2=np.eye(2)).to_dict())


@pytest.mark.parametrize(
    ("where", "change"),
    [
        (("map", 0, 0), 1.01),
        (("map", 1, 1), 1e-6),
        (("plant", "matrices", "A", 0, 0), 0.1001),
        (("plant", "matrices", "A", 0, 1), 1e-3),
        (("plant", "matrices", "C", 0, 1), 1e-3),
        (("plant", "matrices", "C", 0, 2), 0.6),
        (("plant", "time_unit"), "h"),
        (("rows",), 0),
        (("rows",), 3),
        (("map",), [[1.0, 0.0, 0.0]]),
    ],
)
def test_no_file_says_of_another_plant_what_holds_of_its_part(where, change):
    data = json.loads(of_one_row())
    place = data["plant"]["part_of"]
    for key in where[:-1]:
        place = place[key]
    place[where[-1]] = change
    data = redigested(data)  # the forger seals it
    found = verdict(data)
    assert (found.verdict, "part_of" in found.reason) == ("bad file", True)
    with pytest.raises((ArgumentError, FileFormatError), match="part_of"):
        certificate_from_dict(data)


def leaves(tree, path=()):
    """Every entry of a file: numbers, texts and truths, with its path."""
    if not isinstance(tree, (dict, list)):
        yield path, tree
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ():
        yield from leaves(value, (*path, key))


def altered(value):
    """Something else of the same kind."""
    if isinstance(value, str):
        return "x2" if value == "x1" else value + "x"
    return not value if isinstance(value, bool) else 1.0 if value is None else value * 1.5 + 0.1


def accepted(data):
    """Whether the checker alone takes a file, and whether the house does."""
    try:
        return verdict(data).verdict == "proven", bool(certificate_from_dict(data).verify())
    except (ArgumentError, FileFormatError):
        return verdict(data).verdict == "proven", False


NO_EVIDENCE = ("tool", "solver", "witness", "digest")
WEAKER = {"P2", "R", "Qv", "lam", "lam_samples"}
"""Fields of which a larger one claims less."""


@pytest.mark.parametrize("part", few(range(8), 5))
def test_no_entry_of_a_certificate_of_rows_can_be_altered_unseen(part):
    """As it is, by nobody; sealed again by a forger, only where what is then claimed holds. Both checkers agree."""
    data = json.loads(json.dumps(certify(THREE, EVERY_SECOND, of="x1", eta=0.7, P2=np.eye(2)).to_dict()))
    assert verdict(data).verdict == "proven"
    entries = list(leaves(data))
    assert len(entries) > 80
    for path, value in entries[part::8]:
        forged = json.loads(json.dumps(data))
        place = forged
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = altered(value)
        assert accepted(forged) == (False, False)
        alone, house = accepted(redigested(forged))
        assert alone == house, path
        # names that are nobody else's, and the dynamics of x2, which z does not hold, are no claim
        harmless = path[0] in NO_EVIDENCE or path[-1] == "name" or "names" in path or path[-3:-1] == ("A", 1)
        if alone and not harmless:
            made = {key: np.array(forged[key]) for key in ("P1", "P2", "Qw", "R", "Qv")}
            again = certify(THREE, EVERY_SECOND, of="x1", eta=0.7, **{k: made[k] for k in ("P2", "Qw", "R", "Qv")})
            assert path[0] in WEAKER | {"P1", "Qw"}
            assert again.lam <= forged["lam"] * (1 + 1e-3) / (1 - 1e-3)


def test_a_row_is_not_called_by_the_name_of_another():
    data = json.loads(json.dumps(certify(THREE, EVERY_SECOND, of="x1", eta=0.7, P2=np.eye(2)).to_dict()))
    for group, key, value in (("names", 0, "x2"), ("names", 1, "y1"), ("units", 0, "km")):
        forged = json.loads(json.dumps(data))
        held = forged["plant"]["states"]
        held.setdefault("units", ["", ""])[key if group == "units" else 0] = value if group == "units" else ""
        if group == "names":
            held["names"][key] = value
        assert "calls" in verdict(redigested(forged)).reason
        with pytest.raises((ArgumentError, FileFormatError), match="what is not that"):
            certificate_from_dict(forged)
    part = functional_plant(THREE, "x1")
    given = {key: getattr(part, key) for key in ("A", "C", "G", "whole", "map", "rows")}
    with pytest.raises(ArgumentError, match="`states` call 'x2' what is not that state or output of the whole plant"):
        FunctionalPlant(**given, states=["x2", "x3"])


def test_rows_of_a_part_have_names_of_their_own():
    retained = Plant(np.diag([0.1, 0.2]), [[1.0, 1.0]], states=["z1", "z2"])
    assert functional_plant(retained, [[1.0, 1.0]]).states.names[0] == "zz1"


def test_a_map_of_another_shape_is_no_part():
    data = certify(THREE, EVERY_SECOND, of="x1", eta=0.7, P2=np.eye(2)).to_dict()
    part = {**data["plant"]["part_of"], "map": [[1.0, 0.0, 0.0]]}
    with pytest.raises(ArgumentError, match=r"must have a map of shape \(2, 3\), and 1 to 2 rows"):
        certificate_from_dict(redigested(data | {"plant": data["plant"] | {"part_of": part}}))


def test_a_verdict_says_how_nearly_a_part_is_one_of_the_whole_plant():
    """Large terms that cancel may hide a coupling of size one: z = x1 + x2, z' = z / 10 + x3 where x3 says 1e10."""
    A = [[0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
    data = certify(Plant(A, [[1.0, 1.0, 0.0]]), EVERY_SECOND, of=[[1.0, 1.0, 0.0]], eta=0.7, P2=[[1.0]]).to_dict()
    hidden = json.loads(json.dumps(data))
    matrix = hidden["plant"]["part_of"]["plant"]["matrices"]["A"]
    matrix[0][2], matrix[1][2] = 1e10, 1.0 - 1e10
    for content in (data, redigested(hidden)):
        for found in (verdict(content), verify_rigorously(content)):
            assert found.verdict == "proven"
            assert found.reason.endswith("; of the whole plant to 1e-10 of the terms that make up each entry")
    plain = certify(Plant([[0.1]], [[1.0]]), EVERY_SECOND, eta=0.7, P2=[[1.0]]).to_dict()
    assert "whole plant" not in verdict(plain).reason + verify_rigorously(plain).reason
    matrix[1][2] = 2.0 - 1e10
    assert verdict(redigested(hidden)).verdict == "bad file"


def test_plant_files_hold_the_whole_plant_beside_the_part(tmp_path):
    part = functional_plant(THREE, "x1")
    for name in ("part.toml", "part.json"):
        again = read_plant(write_plant(part, tmp_path / name))
        assert (type(again), again.to_dict()) == (FunctionalPlant, part.to_dict())
    with pytest.raises(ArgumentError, match="a plant of chosen rows holds the whole one beside it"):
        write_plant(part, tmp_path / "part.mat")


def test_a_part_that_is_none_is_refused():
    part = functional_plant(THREE, "x1")
    given = {key: getattr(part, key) for key in ("A", "C", "G", "whole", "map", "rows")}
    with pytest.raises(ArgumentError, match="`map` does not carry `A` of the whole plant"):
        FunctionalPlant(**{**given, "A": np.diag([0.11, -1.0])})
    with pytest.raises(ArgumentError, match="`rows` must be at most 2"):
        FunctionalPlant(**{**given, "rows": 3})
    with pytest.raises(ArgumentError, match="`time_unit` must be that of the whole plant"):
        FunctionalPlant(**given, time_unit="h")
    with pytest.raises(ArgumentError, match="`map` does not carry `the sizes`"):
        FunctionalPlant(**{**given, "G": np.eye(2)})


def test_plants_of_other_kinds_are_told_that_rows_are_not_for_them():
    unsure = UncertainPlant(
        Plant([[0.0, 1], [-1, 0]], [[1.0, 0]]), (UncertainParameter("k", -0.1, 0.1, A=[[0, 0], [1, 0]]),)
    )
    with pytest.raises(ArgumentError, match="`of` is for exactly known plants, got str 'x1' with a plant"):
        window_sigma(unsure, EVERY_SECOND, 3.0, of="x1")
    with pytest.raises(ArgumentError, match="`of` is for exactly known plants: certify all states"):
        certify(unsure, EVERY_SECOND, of="x1")


@pytest.mark.parametrize("unit", [1e-12, 1.0, 1e12])
def test_units_change_no_part(unit):
    rng = np.random.default_rng(3)
    plant, H, kept = random_hidden(rng)
    d = unit ** rng.uniform(-1, 1, plant.n_states)
    part = functional_plant(Plant(plant.A * d / d[:, None], plant.C * d), H * d)
    assert part.n_states == kept
    assert not len(unobservable_modes(Plant(part.A, np.vstack([part.C, np.eye(part.n_states)[: len(H)]]))))


def test_a_sum_of_states_is_called_by_its_terms():
    turn = 2 * np.pi / 12.42
    tide = Plant([[0, 0, 0], [0, 0, turn], [0, -turn, 0]], [[1.0, 1.0, 0.0]], states=["mean", "tide", "other"])
    gauge = tide.augmented(bias=["y1"])
    assert functional_plant(gauge, "tide").states.names == ("tide", "other", "mean + y1_bias")
    with pytest.raises(NotDetectableError, match="0 along 1 mean, -1 y1_bias"):
        functional_plant(gauge, "mean")


@pytest.mark.long
def test_a_plan_for_rows_is_certified_for_them(tmp_path):
    wanted = PlanRequirement(
        {"x1": 0.5}, period=8.0, grid=1.0, w_bound=0.05, sensors={"y1": {"price": 1, "noise_bound": 0.1}}
    )
    found = plan_samples(THREE, wanted, robustness=False)
    assert found.certificate.plant.wanted.names == ("x1",)
    assert "the samples show x1; rate" in str(found)
    again = read_plan(found.save(tmp_path / "plan.json"))
    assert again.verify()
    assert again.certificate.plant.whole.same_dynamics(THREE)
    other = functional_plant(Plant(np.diag([0.1, 0.3, -1.0]), THREE.C), "x1")
    assert not replace(found, certificate=certify(other, found.schedule)).verify()


TURN = 2 * np.pi
ALIASED = Plant(
    block_diag([[0.0, 1.0], [-1.0, 0.0]], [[0.0, 1 + TURN], [-1 - TURN, 0.0]], 0.1),
    [[1.0, 0.0, 1.0, 0.0, 1.0]],
    G=np.eye(5)[:, [0, 2, 4]],
    states=["slow", "slow_quadrature", "fast", "fast_quadrature", "growing"],
)
"""Equal gaps of 1 do not tell the two oscillations apart: a = (1, 0, -1, 0, 0) is seen at no sample."""


@pytest.mark.parametrize(
    ("rows", "said", "at_samples", "between", "unit"),
    few(
        [
            ("growing", "growing is free of it at all times", True, True, 1e-9),
            ([[1.0, 0, 1, 0, 0]], "z1 is free of it at the sample times, and not between", True, False, 1.0),
            ("slow", "what is hidden enters slow", False, False, 1.0),
        ],
        1,
    ),
)
def test_what_equal_gaps_hide_of_rows_is_said_and_true(rows, said, at_samples, between, unit):
    units = np.array([1.0, unit, 1.0, 1 / unit, 1.0])
    plant = Plant(
        ALIASED.A * units / units[:, None], ALIASED.C * units, G=ALIASED.G / units[:, None], states=ALIASED.states
    )
    H, hidden = functional_plant(plant, rows).map[:1], np.array([1.0, 0, -1, 0, 0]) / units
    z = [float((H @ expm(plant.A * t) @ hidden)[0]) for t in (1.0, 2.0, 3.0, 1.3, 2.6)]
    assert np.allclose([(plant.C @ expm(plant.A * k) @ hidden)[0] for k in range(4)], 0, atol=1e-9)
    assert (np.allclose(z[:3], 0, atol=1e-9), np.allclose(z, 0, atol=1e-9)) == (at_samples, between)
    found = certificate_exists(plant, EVERY_SECOND, 0.1, of=rows)
    assert not found
    assert said in found.reason
    with pytest.raises(CertificateError, match=r"is aliased with .*gaps\[0\] = 1 to ") as caught:
        certify(plant, EVERY_SECOND, eta=0.1, of=rows)
    assert said in str(caught.value)
    limit = guaranteed_accuracy(plant, EVERY_SECOND, w_bound=0.02, v_bound=0.1, of=rows, rtol=0.1)
    assert np.isfinite(limit.upper[0]) == between
    assert "[" not in limit.explain()
    filter = KalmanFilter(plant, cost=CostFunction(eta=0.1), w_bound=0.02, v_bound=0.1, initial_error=1.0, of=rows)
    record = simulate_record(plant, EVERY_SECOND, 9.0, x0=0.3 * hidden, rng=1, w_bound=0.02, v_bound=0.1)
    for each, x in zip(filter.run(record.measurements).estimates, record.truth, strict=True):
        assert each.certified
        assert abs((H @ x)[0] - each.x[0]) <= each.radii[0]
