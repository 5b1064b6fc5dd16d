"""Intervals as files: round trips, what the standalone checker proves, and every forgery it refuses."""

import copy
import json
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

import sampling_design as sd
from sampling_design.accuracy.interval import Interval, state_interval
from sampling_design.accuracy.readings import AboveRange, BelowDetection, CompositeReading
from sampling_design.checkers import check, claims, long_numbers, recovered
from sampling_design.checkers.long_numbers import BITS, doubles, largest_flow, long, long_flow
from sampling_design.checkers.outcome import Refused, Undecided
from sampling_design.checkers.parts import digest
from sampling_design.checkers.strict import from_json
from sampling_design.cli import files
from sampling_design.cli.app import app
from sampling_design.errors import ArgumentError, CertificateError, FileFormatError, UndecidedError
from sampling_design.observability import functional_plant
from tests.cases import few
from tests.laws.test_interval_of_the_data_always_holds_the_truth import adversarial_run
from tests.oracles.estimators import transition

SPRING = sd.Plant([[0.0, 1.0], [-1.0, -0.1]], [[1.0, 0.0]], B=[[0.0], [1.0]], name="spring")
GIVEN = {"w_bound": 0.05, "v_bound": 0.2}


def data_of(seed=0, **options):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.4, 1.2, 8))
    return [(float(t), [np.cos(t) + rng.uniform(-0.1, 0.1)], [float(rng.normal() * 0.1)]) for t in times]


@pytest.fixture(scope="module")
def whole():
    record = data_of()
    record[3] = (record[3][0], [BelowDetection(record[3][1][0] + 0.1)], None)
    record[6] = (record[6][0], [CompositeReading(record[6][1][0], since=record[5][0])], None)
    found = state_interval(SPRING, record, record[-1][0] + 0.3, initial_error=[3.0, 3.0], of=["x1", "x2"], **GIVEN)
    return found, json.loads(json.dumps(found._sealed()))


def with_digest(data):
    data["digest"] = digest(data)
    return data


def test_a_file_comes_back_and_is_proven(whole, tmp_path):
    found, _ = whole
    path = found.save(tmp_path / "interval.json")
    again = Interval.read(path)
    assert again.verify()
    assert again.verify(rigorous=True)
    assert np.all(again.lower <= found.lower)
    assert np.all(again.upper >= found.upper)
    assert np.allclose(again.radii, found.radii, rtol=1e-4)
    assert np.array_equal(again.gains, found.gains)
    assert again.rows.names == found.rows.names
    assert again.save(tmp_path / "again.json").exists()
    verdict = check(from_json(path.read_text()))
    assert verdict["verdict"] == "proven"
    assert 0 < verdict["amount"] < 1e-4


def test_the_command_and_the_folder_alone_prove_it(whole, tmp_path):
    path = whole[0].save(tmp_path / "interval.json")
    room = Path(recovered.__file__).parent
    alone = subprocess.run([sys.executable, room / "check.py", path], capture_output=True, text=True, check=False)
    assert alone.returncode == 0, alone.stdout
    assert "for every row and every trajectory within the bounds" in alone.stdout
    ran = CliRunner().invoke(app, ["verify", str(path)])
    assert ran.exit_code == 0, ran.output
    assert "Proven" in ran.output
    data = json.loads(path.read_text())
    forged_end(data)
    path.with_name("forged.json").write_text(json.dumps(with_digest(data)))
    assert CliRunner().invoke(app, ["verify", str(path.with_name("forged.json"))]).exit_code == 1
    sd.plants.write_plant(sd.Plant([[0.0]], [[1.0]]), tmp_path / "other.toml")
    with pytest.raises(CertificateError, match="is about another plant"):
        files.interval(path, sd.read_plant(tmp_path / "other.toml"))
    kind = sd.certificates.certify_detectability(SPRING).save(tmp_path / "detectability.json")
    data["t"] = "late"
    late = tmp_path / "late.json"
    late.write_text(json.dumps(data))
    with pytest.raises(FileFormatError, match="is no interval: `t` must be a number"):
        Interval.read(late)
    with pytest.raises(FileFormatError, match="Use read_certificate for a certificate"):
        Interval.read(kind)
    with pytest.raises(FileFormatError, match=r"holds an interval\. Use Interval\.read"):
        sd.read_certificate(path)
    with pytest.raises(ArgumentError, match=r"`path` of an interval must end in \.json"):
        whole[0].save(tmp_path / "interval.txt")


def forged_end(data):
    data["upper"][0] -= 1e-3 * (data["upper"][0] - data["lower"][0])


def forged_gain(data):
    data["gains"][0][0][2] *= 1.5


def forged_sign(data):
    k = next(k for k, row in enumerate(rows_of(data)) if row["below"])
    data["gains"][1][0][k] = -1.0


def rows_of(data):
    return [row for each in data["readings"] for row in each["rows"]]


def forged_bound(data):
    data["w"]["root"][0][0] *= 2


def forged_noise(data):
    for row in rows_of(data):
        row["size"] *= 1.1


def forged_plant(data):
    data["plant"]["matrices"]["A"][1][0] = -1.05


def forged_input(data):
    data["inputs"][-1]["u"][0] += 0.5


def forged_time(data):
    data["t"] += 0.2


@pytest.mark.parametrize(
    "forge",
    [
        forged_end,
        forged_gain,
        forged_sign,
        forged_bound,
        forged_noise,
        forged_plant,
        forged_input,
        forged_time,
    ],
)
def test_what_the_gains_do_not_prove_is_refused(whole, forge):
    data = copy.deepcopy(whole[1])
    forge(data)
    assert check(data)["inequality"] == "digest"
    assert check(with_digest(data))["verdict"] == "refuted"


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        (("gains",), [], "`gains` must have 2 entries"),
        (("scales",), [1.0, 1.0], "`scales` must have 3 entries"),
        (("start", "time"), 0.1, "`readings` must begin at the time of the start"),
        (("t",), 1.0, "`t` must not lie before the last reading"),
        (("readings", 2, "t"), 1e3, "`readings` must be in order of time"),
        (("readings", 2, "rows", 0, "row"), [1.0], "must have rows of 2 numbers"),
        (("start", "centre"), [0.0], "`start.centre` must have 2 entries"),
        (("start", "root"), [[1.0]], "`start.root` must have 2 rows"),
        (("w", "centre"), [0.0], "`w.centre` must have 2 entries"),
        (("w", "root"), [[0.0]], "`w.root` must have 2 rows"),
        (("inputs", 0, "u"), [1.0, 2.0], "`inputs` must each have 1 entries of u"),
        (("inputs", 0, "t"), 1e3, "`inputs` must be in order of time"),
        (("rows", "names"), ["x1"], "`rows.names` must have 2 entries"),
        (("rows", "matrix"), [[1.0], [2.0]], "`rows.matrix` must have rows of 2 numbers"),
        (("rows", "names"), ["x2", "x1"], "`rows` calls 'x2' what is not that state or output of the plant"),
        (("rows", "names"), ["x1", "x1"], "`rows` calls 'x1' what is not"),
        (("rows", "names"), ["x1", "y1"], "`rows` calls 'y1' what is not"),
        (("rows", "matrix"), [[1.0, 1e-9], [0.0, 1.0]], "`rows` calls 'x1' what is not"),
        (("rows", "units"), ["", "km"], "`rows` calls 'x2' what is not"),
        (("plant", "states"), {"names": ["x2", "x1"]}, "`rows` calls 'x1' what is not"),
    ],
)
def test_sizes_and_order_are_derived(whole, place, value, words):
    data = copy.deepcopy(whole[1])
    at = data
    for key in place[:-1]:
        at = at[key]
    at[place[-1]] = value
    verdict = check(with_digest(data))
    assert verdict["verdict"] == "bad file"
    assert words in verdict["reason"]


@pytest.mark.parametrize("other", [None, -1e300, "as it was"])
def test_an_end_is_proven_whatever_the_other_end_is(whole, other, tmp_path):
    """Both routes, with rounding or without, take no width of the file for room."""
    data = copy.deepcopy(whole[1])
    data["lower"][0] = data["lower"][0] if other == "as it was" else other
    for less, proven in ((0.0, True), (1e-3, False), (1e3, False)):
        forged = copy.deepcopy(data)
        forged["upper"][0] -= less
        path = tmp_path / "forged.json"
        path.write_text(json.dumps(with_digest(forged)))
        again = Interval.read(path)
        assert [check(forged)["passed"], again.verify(), again.verify(rigorous=True)] == [proven] * 3


@pytest.mark.parametrize("factor", [0.0, 0.5, 1.0])
def test_data_within_the_bounds_contradict_nothing(whole, factor, tmp_path):
    data = copy.deepcopy(whole[1])
    none, gains = [None, None], [0.0] * len(data["gains"][0][0])
    proof = {"factors": {"all": factor, "w": 0.0, "v": 0.0}, "gains": dict.fromkeys(("all", "w", "v"), gains)}
    path = tmp_path / "forged.json"
    path.write_text(json.dumps(with_digest(data | {"lower": none, "upper": none, "disproof": proof})))
    again = Interval.read(path)
    assert (check(from_json(path.read_text()))["passed"], again.verify(), again.verify(rigorous=True)) == (False,) * 3


def test_a_row_has_its_name_where_states_have_none(whole):
    """What has no name is called x1, x2 by whoever reads the file."""
    data = copy.deepcopy(whole[1])
    del data["plant"]["states"]
    assert check(with_digest(data))["verdict"] == "proven"
    data["rows"]["names"].reverse()
    assert "`rows` calls 'x2' what is not" in check(with_digest(data))["reason"]


def test_inputs_drive_a_part_as_they_drive_the_whole_plant():
    three = sd.Plant(np.diag([0.1, 0.2, -1.0]), [[1.0, 0.0, 0.5]], B=[[1.0], [1.0], [0.5]])
    record = [(1.0, [1.0], [0.3]), (2.0, [1.2], [0.0])]
    found = state_interval(functional_plant(three, "x1"), record, 2.5, initial_error=[3.0, 3.0], of="x1", **GIVEN)
    data = json.loads(json.dumps(found._sealed()))
    assert check(data)["verdict"] == "proven"
    data["plant"]["matrices"]["B"][0][0] *= 0.9
    data["lower"] = data["upper"] = [None]
    assert "`plant.part_of.map` does not carry G of the whole plant" in check(with_digest(data))["reason"]


def test_a_mean_begins_at_a_known_time(whole):
    data = copy.deepcopy(whole[1])
    next(row for row in rows_of(data) if row["since"] is not None)["since"] += 0.01
    assert "has a mean that does not begin at an earlier time" in check(with_digest(data))["reason"]


def test_a_contradiction_is_proven_too(tmp_path):
    walk = sd.Plant([[0.0]], [[1.0]])
    record = [(0.0, [1.0], None), (1.0, [AboveRange(2.0)], None)]
    found = state_interval(walk, record, w_bound=0.1, v_bound=0.05)
    path = found.save(tmp_path / "no.json")
    again = Interval.read(path)
    assert again.contradiction == pytest.approx(5.0, rel=1e-4)
    assert again.verify()
    assert again.verify(rigorous=True)
    data = json.loads(path.read_text())
    factor = data["disproof"]["factors"]["all"]
    data["disproof"]["factors"]["all"] = 1.02 * factor
    with pytest.raises(Refused, match="the gains do not prove that all must grow by the factor"):
        proven(data)
    data["disproof"]["factors"]["all"] = 1.01 * factor
    assert check(with_digest(data))["verdict"] in ("refuted", "undecided")
    data["disproof"]["factors"]["all"] = 0.5
    with pytest.raises(Refused, match="a factor of at most 1 is no contradiction"):
        proven(data)


def test_the_bound_is_what_quadrature_says(whole):
    """g by scipy's expm, the integral of |G'g| by a fine sum: no line is shared."""
    record = data_of(1)
    found = state_interval(SPRING, record, initial_error=2.0, prior_time=0.0, of="x2", **GIVEN)
    c = recovered_parts(found)
    A, gains, times = SPRING.A, found.gains[0, 0], found.readings.times
    g, total = np.array([0.0, 1.0]), 0.0
    for k in range(len(times) - 1, -1, -1):
        for row, gain in zip(found.readings.rows[k], gains_at(found, gains, k), strict=True):
            g = g - row.H * gain
            total += gain * row.y + abs(gain) * row.size
        if k:
            h = times[k] - times[k - 1]
            fine = np.linspace(0, h, 801)
            path = np.array([transition(A.T, s) @ g for s in fine])
            total += 0.05 * np.trapezoid(np.linalg.norm(path, axis=1), fine)
            held = [u for t, u in found.readings.inputs if t <= times[k - 1]]
            total += np.trapezoid(path @ SPRING.B, fine, axis=0) @ (held[-1] if held else np.zeros(1))
            g = transition(A.T, h) @ g
    total += 2.0 * np.linalg.norm(g)
    assert c == pytest.approx(total, rel=1e-5)


def gains_at(found, gains, k):
    return gains[found.readings.offsets[k] : found.readings.offsets[k + 1]]


def recovered_parts(found):
    c = claims.certificate(found._sealed())
    return recovered.BackwardRecursion(c, recovered.WorkLimit(np.inf)).run(c.rows, c.gains[:, 0]).ends()[0][0]


def test_coordinates_beyond_doubles_are_said(whole, tmp_path):
    data = copy.deepcopy(whole[1])
    data["scales"][:2] = [1e-308, 1e308]
    (tmp_path / "forged.json").write_text(json.dumps(with_digest(data)))
    found = Interval.read(tmp_path / "forged.json")
    with pytest.raises(UndecidedError, match="in coordinates of these `scales` the plant is beyond the range"):
        found.verify()


def proven(data, work=np.inf):
    with np.errstate(all="ignore"):  # as the checkers' door does
        return recovered.prove(claims.certificate(with_digest(data)), recovered.WorkLimit(work))


def unseen(data):
    data["start"]["root"] = None
    data["plant"]["matrices"]["C"] = [[0.0, 0.0]]
    for row in rows_of(data):
        row["row"] = [0.0, 0.0]
    data["scales"] = data["scales"][:3]


def beyond_doubles(data):
    data["plant"]["matrices"]["A"][0][1] = 1e300
    data["plant"]["matrices"]["A"][1][0] = 1e300
    data["scales"] = [1e-300, 1e300, 1e300]


def lost_in_units(data):
    """In these units the entry of A by which velocity moves position is below the least double."""
    data["scales"] = [1e170, 1e-170, 1.0]


def far(data):
    data["t"] = 1e9


@pytest.mark.parametrize(
    ("forge", "error", "words"),
    [
        (forged_sign, Refused, "a gain of a one-sided reading at"),
        (forged_end, Refused, "the gains prove the upper end of row 0 only up to"),
        (unseen, Undecided, "nothing is known of the start, and the readings do not show it well enough"),
        (beyond_doubles, Undecided, "some numbers are too large or too small for an honest check"),
        (lost_in_units, Undecided, "some numbers are too large or too small for an honest check"),
        (far, Undecided, "is too long for this check"),
    ],
)
def test_why_it_is_not_proven(whole, forge, error, words):
    data = copy.deepcopy(whole[1])
    forge(data)
    with pytest.raises(error, match=words):
        proven(data)


def test_what_rounding_hides_is_undecided(whole):
    """An end between what the gains prove and what they are at least."""
    data = copy.deepcopy(whole[1])
    c = claims.certificate(data)
    most, least = recovered.BackwardRecursion(c, recovered.WorkLimit(np.inf)).run(c.rows, c.gains[:, 0]).ends()
    data["upper"][0] = float((most[0] + least[0]) / 2)
    with pytest.raises(Undecided, match="rounding is as large as what is left"):
        proven(data)


def test_an_open_start_has_no_contradiction_that_the_rest_of_it_could_hide(tmp_path):
    walk = sd.Plant([[0.0]], [[1.0]])
    found = state_interval(walk, [(0.0, [1.0], None), (1.0, [2.0], None)], w_bound=0.1, v_bound=0.05)
    assert found.readings.start.unbounded
    assert found.verify(rigorous=True)


def test_a_check_may_do_so_much_and_no_more(whole):
    with pytest.raises(Undecided, match="it takes more work than one check may do"):
        proven(copy.deepcopy(whole[1]), 10.0)


@pytest.mark.parametrize("entry", [1e4, 1e16, 1e100, -1e16])
def test_a_flow_that_leaves_the_doubles_is_not_followed(whole, entry, monkeypatch):
    """Each squaring has twice as many digits as the one before: a file of some numbers took all memory."""
    digits, kept = [], long_numbers.product

    def counted(a, b):
        digits.append(max(abs(x) for x in a.ravel().tolist()).bit_length())
        assert digits[-1] < 2**13
        return kept(a, b)

    monkeypatch.setattr(long_numbers, "product", counted)
    data = copy.deepcopy(whole[1])
    data["plant"]["matrices"]["A"][0][0] = entry
    assert check(with_digest(data))["verdict"] == "undecided"
    assert digits
    with pytest.raises(OverflowError, match="the flow of a gap"):
        long_flow(np.array([[abs(entry)]]), Fraction(8))


@pytest.mark.parametrize("name", few(["double_integrator", "cart_pendulum", "satellite"], 0, 1))
def test_intervals_of_adversarial_runs_are_proven_with_every_rounding(name):
    for seed in (0, 1010, 1014):  # in the later ones costates in doubles lost up to a thousandth of the width
        found, _ = adversarial_run(name, seed)
        assert found.verify(rigorous=True), (name, seed)


@pytest.mark.parametrize("plant", [sd.plants.library.oscillator(), sd.plants.library.satellite()])
def test_the_first_sample_alone_proves_what_it_shows(plant):
    """With fewer readings than states gains must leave exactly nothing of a free start."""
    given = {"w_bound": plant.disturbances.scales.tolist(), "v_bound": plant.outputs.scales.tolist()}
    found = state_interval(plant, [(1.7e9, np.ones(plant.n_outputs), None)], **given)
    assert np.array_equal(np.isfinite(found.radii), np.abs(plant.C).sum(axis=0) > 0)
    data = found._sealed()
    assert check(data)["verdict"] == "proven"
    data["gains"][0][0][0] *= 1 + 1e-12
    data["upper"][0] *= 1.1
    with pytest.raises(Undecided, match="nothing is known of the start, and the readings do not show it well enough"):
        proven(data)


@pytest.mark.parametrize("size", [1e-12, 1.0, 1e12])
def test_a_part_that_no_reading_shows_leaves_the_others_proven(size):
    """What drives nothing that is read or wanted has no gains' rest; let it drive a reading, and nothing is proven."""
    A = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.5 * size, 0.0, -0.3]])
    plant, rng = sd.Plant(A, [[1.0, 0.0, 0.0]], G=np.diag([1.0, 1.0, size])), np.random.default_rng(0)
    record = [(1.7e9 + t, [np.sin(t) + rng.uniform(-0.1, 0.1)], None) for t in np.cumsum(rng.uniform(0.4, 1.2, 9))]
    found = state_interval(plant, record, w_bound=0.05, v_bound=0.2)
    assert np.isfinite(found.radii).tolist() == [True, True, False]
    data = found._sealed()
    assert check(data)["verdict"] == "proven"
    data["plant"]["matrices"]["A"][0][2] = 1e-9 / size
    with pytest.raises(Undecided, match="rounding is as large as what is left"):
        proven(data)
    data["plant"]["matrices"]["A"][0][2] = 0.0
    data["upper"][1] -= found.radii[1] / 2
    with pytest.raises(Refused, match="the gains prove the upper end of row 1 only up to"):
        proven(data)


def test_three_samples_of_four_states_prove_the_one_that_is_read():
    found, truth = adversarial_run("helicopter_he1", 2001)
    assert found.holds(truth)
    assert np.isfinite(found.radii).sum() == 1
    assert found.verify(rigorous=True)


def test_a_flow_in_integers_is_as_exact_as_it_says():
    import mpmath

    stiff = np.array([[-40.0, 7.0, 0.0], [0.0, -40.0, 1.0], [0.0, 0.0, 1e-9]])
    growing = np.array([[0.3, 1.1], [-7.0, 2.9]])
    for a, h in ((growing, Fraction(13, 10)), (stiff, Fraction(3)), (stiff * 0, Fraction(1))):
        found, off = long_flow(a, h)
        with mpmath.workprec(700):
            flow = mpmath.expm(mpmath.matrix(a.tolist()) * h.numerator / h.denominator)
            pairs = ((mpmath.mpf(x) / 2**BITS, flow[at]) for at, x in np.ndenumerate(found))
            worst = max(abs(x - y) for x, y in pairs)
        assert worst <= off < 1e-30
    assert np.isinf(doubles(np.array([2**2000], dtype=object))).all()


@pytest.mark.parametrize("a", [[[0.0, 5.0], [-5.0, -0.1]], [[-40.0, 7.0], [0.0, -0.1]], [[0.0, 3.0], [0.0, 0.0]]])
def test_no_flow_of_a_record_is_larger_than_what_carries_its_rounding(a):
    most, a = largest_flow(np.array(a), Fraction(200)), np.array(a)
    every = np.max([np.abs(transition(a, s)) for s in (*np.linspace(0, 2, 201), *np.linspace(2, 200, 200))], axis=0)
    assert np.all(every <= most)
    assert np.all(most <= 2**6 * every + 1e-60)  # a turn costs a root of two for each of few doublings


def main(runs: int) -> None:
    """Prove intervals of so many adversarial runs and say how many are decided."""
    from tests.laws.test_interval_of_the_data_always_holds_the_truth import CASES

    ended: dict[str, int] = {}
    for seed in range(runs):
        for name in CASES:
            if seed * len(CASES) >= runs:
                break
            verdict = check(adversarial_run(name, 1000 + seed)[0]._sealed())["verdict"]
            ended[verdict] = ended.get(verdict, 0) + 1
    print(ended)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)


def test_a_start_that_nothing_closes_decides_no_factor():
    said = SimpleNamespace(start=[np.inf], disturbance=[0.0], noise=[0.0], readings=[0.0])
    c = SimpleNamespace(factors={"all": (2.0, np.zeros(1))}, plant=SimpleNamespace(n=1))
    with pytest.raises(Undecided, match="the factor of all could not be decided: its start is not closed"):
        recovered.contradiction(c, SimpleNamespace(run=lambda *given: said))


@pytest.mark.parametrize("doubt", [0.0, 3.0])
def test_what_rounding_hides_refutes_no_factor(doubt):
    """A gain proves a factor of 2 up to its rounding: where that is large, not that 2.1 is wrong."""
    said = recovered.RowBound(*(np.array([x]) for x in (-2.0, -1.0 - doubt, 0.0, 1.0, 0.0)))
    c = SimpleNamespace(factors={"all": (2.1, np.zeros(1))}, plant=SimpleNamespace(n=1))
    with pytest.raises(
        Undecided if doubt else Refused, match="the gains do not prove that all must grow by the factor"
    ):
        recovered.contradiction(c, SimpleNamespace(run=lambda *given: said))


@pytest.mark.parametrize("start", few([None, 3.0], 0))
def test_a_long_record_is_proven_as_a_short_one(start):
    """An eighth of a turn a gap: products of |e^{A'h}| double every second time, and 2^320 was lost after 640."""
    turning, rng = sd.Plant([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]]), np.random.default_rng(0)
    record = [(k * np.pi / 4, [np.cos(k * np.pi / 4) + rng.uniform(-0.1, 0.1)], None) for k in range(700)]
    found = state_interval(turning, record, initial_error=start, of="x1", **GIVEN)
    data = json.loads(json.dumps(found._sealed()))
    assert check(data)["verdict"] == "proven"
    forged_end(data)
    assert check(with_digest(data))["verdict"] == "refuted"


def test_a_check_does_twice_as_much_for_twice_the_readings():
    """Where nothing was known of the start, each reading had a costate of its own: the square of their number."""
    spent = []
    for rows in (30, 60):
        record = [(0.7 * k, [np.cos(0.7 * k)], None) for k in range(rows)]
        work = recovered.WorkLimit(1e12)
        data = state_interval(SPRING, record, of="x1", **GIVEN)._sealed()
        assert recovered.prove(claims.certificate(data), work).passed
        spent.append(1e12 - work.left)
    assert spent[1] <= 2.1 * spent[0]


def test_a_start_is_closed_by_later_readings_where_the_first_do_not_show_it():
    """The second output comes after many of the first, which show nothing of its state."""
    two = sd.Plant(np.diag([-0.1, -0.2]), np.eye(2))
    record = [(float(k), [1.0, np.nan], None) for k in range(3 * recovered.FIRST)] + [(40.0, [np.nan, 0.1], None)]
    found = state_interval(two, record, w_bound=0.1, v_bound=0.3)
    assert np.isfinite(found.radii).all()
    assert found.verify(rigorous=True)


@pytest.mark.parametrize("count", few([100, 3000], 0))
def test_a_file_of_many_rows_over_a_long_gap_needs_little_memory_and_time(count, monkeypatch):
    """Costates of every panel and question were one array, and gains of zero were multiplied out as rationals."""
    made = state_interval(SPRING, [(0.0, [0.1], None), (1.0, [0.1], None)], w_bound=0.1, v_bound=0.3)._sealed()
    row = made["readings"][-1]["rows"][0]
    made |= {"readings": [{"t": t, "rows": count * [row]} for t in (0.0, 60.0)], "t": 60.0}
    made["start"]["time"] = 0.0
    made |= {"gains": 2 * [2 * [2 * count * [0.0]]], "lower": [None, None], "upper": [1e9, None]}
    held, products = [], []
    integrate, integers = recovered.BackwardRecursion.integrate, long
    monkeypatch.setattr(recovered, "long", lambda x: products.append(np.size(x)) or integers(x))
    monkeypatch.setattr(
        recovered.BackwardRecursion,
        "integrate",
        lambda self, columns, part, path, *rest: held.append(path.size) or integrate(self, columns, part, path, *rest),
    )
    found = check(from_json(json.dumps(with_digest(made))))
    assert found["verdict"] == "proven"
    assert max(held) <= recovered.MOST_HELD
    assert sum(products) < 10 * count


def test_products_of_rationals_are_counted(whole):
    content = claims.certificate(whole[1])
    with pytest.raises(Undecided, match="it takes more work than one check may do"):
        recovered.prove(content, recovered.WorkLimit(10.0))
