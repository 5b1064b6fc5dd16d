"""Plant files: what is written, what is refused, and with which sentence."""

import io
import json
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from sampling_design import ArgumentError, Plant, read_plant
from sampling_design.errors import FileFormatError
from sampling_design.plants import files, library
from sampling_design.plants.files import plant_from_dict, write_plant
from sampling_design.plants.plant import Signals
from sampling_design.uncertain import UncertainParameter, UncertainPlant

SUFFIXES = ["toml", "json", "mat", "npz"]


@pytest.fixture
def plant():
    return Plant(
        [[-1.0, 0.1], [1 / 3, -2e-300]],
        [[1.0, 0.0]],
        B=[[1e22], [-0.0]],
        D=[[0.5]],
        G=[[np.nextafter(1.0, 2.0)], [5e-324]],
        time_unit="h",
        name='odd "name"',
        states=Signals(("longer", "x"), ("Ω", ""), [1e-3, 7.0]),
        outputs=Signals(("Temperatur °C",)),
        source="A\\B\nC",
    )


def same(a, b):
    return a.to_dict() == b.to_dict() and all(getattr(a, k).tobytes() == getattr(b, k).tobytes() for k in "ABCDG")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_round_trip_is_exact_to_the_bit(plant, suffix, tmp_path):
    assert same(read_plant(write_plant(plant, tmp_path / f"plant.{suffix}")), plant)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_plants_without_states_survive(suffix, tmp_path):
    empty = Plant(np.zeros((0, 0)), np.zeros((2, 0)), B=np.zeros((0, 1)), G=np.zeros((0, 3)))
    back = read_plant(write_plant(empty, tmp_path / f"plant.{suffix}"))
    assert same(back, empty)
    assert (back.n_inputs, back.n_disturbances, back.n_outputs) == (1, 3, 2)


def test_defaults_are_left_out():
    tree = Plant([[0.0]], [[1.0]]).to_dict()
    assert set(tree["matrices"]) == {"A", "C"}
    assert "inputs" not in tree
    assert "source" not in tree
    assert "scales" not in tree["states"]


def test_a_hand_written_file_needs_little(tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(
        'format = "sampling-design/plant/1"\ntime_unit = "s"\n[matrices]\nA = [[0, 1], [0, 0]]\nC = [[1, 0]]\n'
    )
    plant = read_plant(path)
    assert plant.states.names == ("x1", "x2")
    np.testing.assert_array_equal(plant.G, np.eye(2))


def test_toml_has_one_matrix_row_per_line(tmp_path):
    text = write_plant(library.oscillator(), tmp_path / "o.toml").read_text()
    assert "A = [\n    [0.0, 1.0],\n    [-1.0, 0.0],\n]\n" in text


def test_a_matlab_workspace_without_names_is_read(tmp_path):
    path = tmp_path / "workspace.mat"
    savemat(path, {"A": [[0.0, 1.0], [-1.0, 0.0]], "C": [[1.0, 0.0]]})
    assert read_plant(path, time_unit="s").n_states == 2
    with pytest.raises(FileFormatError, match=r"workspace\.mat: `time_unit` is missing\. Write it into the file or"):
        read_plant(path)


def test_matlab_character_arrays_are_names(tmp_path):
    path = tmp_path / "chars.mat"
    savemat(path, {"A": np.eye(2), "C": [[1.0, 1.0]], "time_unit": "min", "states_names": ["a", "bcd"]})
    assert read_plant(path).states.names == ("a", "bcd")


def edited(tmp_path, change):
    tree = library.oscillator().to_dict()
    change(tree)
    path = tmp_path / "edited.json"
    path.write_text(json.dumps(tree))
    return path


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.update(format="sampling-design/plant/2"), "`format` must be 'sampling-design/plant/1', got"),
        (lambda t: t.pop("format"), "`format` is missing: the file begins with the line format = "),
        (lambda t: t.update(t.pop("matrices")), r"`A` stands in a table: write the line \[matrices\] before it"),
        (lambda t: t.pop("time_unit"), "`time_unit` is missing"),
        (lambda t: t.update(time_unit="sec"), "`time_unit` must be one of ms, s, min, h, d, wk, got 'sec'"),
        (lambda t: t.update(time_unitt="s"), "unknown key 'time_unitt' in the file. Did you mean 'time_unit'"),
        (lambda t: t["matrices"].update(a=[[1.0]]), r"unknown key 'a' in \[matrices\]. Did you mean"),
        (lambda t: t["states"].update(scale=[1.0]), r"unknown key 'scale' in \[states\]. Did you mean 'scales'"),
        (lambda t: t["source"].update(cite="x"), r"unknown key 'cite' in \[source\]. Did you mean 'citation'"),
        (lambda t: t["source"].update(citation=1), "`source.citation` must be a string, got 1"),
        (lambda t: t.update(name=3), "`name` must be a string, got 3"),
        (lambda t: t.update(matrices=[1]), r"`matrices` must be a table of keys and values, got \[1\]"),
        (lambda t: t["matrices"].pop("C"), r"`C` is missing in \[matrices\]. Was the file cut off"),
        (lambda t: t["matrices"].update(A=[[0.0, 1.0]]), "`A` must be square, got shape"),
        (lambda t: t["matrices"].update(A="x"), "`matrices.A` must be a list, got a text"),
        (lambda t: t["states"].pop("names"), r"`names` is missing in \[states\]"),
        (
            lambda t: t["states"].update(names=5),
            r"in the table \[states\]: `names` must be a list of strings, got int 5",
        ),
        (lambda t: t["states"].update(units=5), r"in the table \[states\]: `units` must be 2 strings, one per name"),
        (lambda t: t["states"].update(names=["a"]), r"in the table \[states\]: `units` must be 1 strings"),
        (lambda t: t["states"].update(scales=[1.0, -1.0]), r"in the table \[states\]: `scales` must be positive"),
        (lambda t: t.update(states={"names": ["a"]}), "`states` must have 2 entries, got 1"),
    ],
)
def test_bad_content_is_named_with_the_path(change, message, tmp_path):
    path = edited(tmp_path, change)
    with pytest.raises(FileFormatError, match=message) as caught:
        read_plant(path)
    assert str(caught.value).startswith(str(path))
    assert caught.value.path == str(path)


def test_a_time_unit_that_disagrees_is_refused(tmp_path):
    path = write_plant(library.oscillator(), tmp_path / "o.toml")
    assert read_plant(path, time_unit="s").time_unit == "s"
    with pytest.raises(FileFormatError, match="`time_unit` must agree with the file, got 'h' where the file says 's'"):
        read_plant(path, time_unit="h")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_file_cut_off_is_refused(suffix, tmp_path):
    path = write_plant(library.satellite(), tmp_path / f"plant.{suffix}")
    content = path.read_bytes()
    for part in (0.0, 0.3, 0.6, 0.9):
        path.write_bytes(content[: int(part * len(content))])
        with pytest.raises(FileFormatError, match=r"cut off|format|empty"):
            read_plant(path)


@pytest.mark.parametrize("suffix", ["mat", "npz"])
def test_unknown_arrays_are_named(suffix, tmp_path):
    path = tmp_path / f"plant.{suffix}"
    data = {"A": np.eye(1), "C": np.eye(1), "time_unit": "s", "state_names": np.array(["a"])}
    savemat(path, data) if suffix == "mat" else np.savez(path, **data)
    with pytest.raises(FileFormatError, match=r"unknown key 'state_names' in the file\. Did you mean 'states_names'"):
        read_plant(path)


def test_pickles_are_not_loaded(tmp_path):
    path = tmp_path / "plant.npz"
    np.savez(path, A=np.eye(1), C=np.eye(1), time_unit="s", states_names=np.array([{"a": 1}], dtype=object))
    with pytest.raises(FileFormatError, match=r"is not a readable \.npz archive of plain arrays"):
        read_plant(path)


def test_a_plain_npy_array_is_no_archive(tmp_path):
    path = tmp_path / "plant.npz"
    with path.open("wb") as stream:
        np.save(stream, np.eye(2))
    with pytest.raises(FileFormatError, match="is not a readable"):
        read_plant(path)


def test_matlab_7_3_files_are_told_apart(tmp_path):
    path = tmp_path / "plant.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(64))
    with pytest.raises(FileFormatError, match=r"is a version 7\.3 \.mat file\. Save it with the option -v7"):
        read_plant(path)


def test_a_text_that_is_no_matlab_file_is_refused(tmp_path):
    path = tmp_path / "plant.mat"
    path.write_text("hello")
    with pytest.raises(FileFormatError, match=r"is not a readable \.mat file\. Was it cut off"):
        read_plant(path)


def test_an_array_beyond_the_memory_is_named(tmp_path, monkeypatch):
    """The head of an array asks for its memory before anything of it is read."""
    path, held = tmp_path / "plant.npz", io.BytesIO()
    np.save(held, np.eye(2))
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("A.npy", held.getvalue().replace(b"(2, 2), }" + b" " * 12, b"(2, 2000000000000), }"))
    with pytest.raises(FileFormatError, match="names an array that is larger than the memory that is left"):
        read_plant(path)

    def forged(*ignored):
        raise MemoryError

    monkeypatch.setattr("scipy.io.loadmat", forged)
    (tmp_path / "plant.mat").write_bytes(b"")
    with pytest.raises(FileFormatError, match="names an array that is larger than the memory that is left"):
        read_plant(tmp_path / "plant.mat")


def test_unknown_suffixes_are_refused(tmp_path):
    with pytest.raises(FileFormatError, match=r"the suffix must be one of \.toml, \.json, \.mat, \.npz, got '\.csv'"):
        write_plant(library.oscillator(), tmp_path / "plant.csv")
    with pytest.raises(FileFormatError, match=r"the suffix must be one of .*, got none"):
        write_plant(library.oscillator(), tmp_path / "plant")
    assert not list(tmp_path.iterdir())
    (tmp_path / "plant.csv").write_text("")
    with pytest.raises(FileFormatError, match=r"the suffix must be one of \.toml, \.json, \.mat, \.npz, got '\.csv'"):
        read_plant(tmp_path / "plant.csv")


def test_a_missing_file_is_named(tmp_path):
    for suffix in SUFFIXES:
        with pytest.raises(FileFormatError, match="no such file"):
            read_plant(tmp_path / f"none.{suffix}")


def test_writing_into_a_missing_folder_leaves_nothing(tmp_path):
    with pytest.raises(FileFormatError, match="cannot be written"):
        write_plant(library.oscillator(), tmp_path / "no" / "plant.toml")
    assert not list(tmp_path.iterdir())


def test_trees_keep_their_own_place_in_messages():
    with pytest.raises(FileFormatError, match=r"^certificate: `A` is missing"):
        plant_from_dict({"format": "sampling-design/plant/1", "time_unit": "s"}, "certificate")
    with pytest.raises(ArgumentError, match="`time_unit`"):
        Plant([[0.0]], [[1.0]], time_unit="x")


def test_paths_may_be_strings(tmp_path):
    target = str(tmp_path / "o.json")
    assert write_plant(library.oscillator(), target) == Path(target)
    assert read_plant(target).name == "oscillator"


@pytest.mark.parametrize("suffix", ["mat", "npz"])
@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("A", np.array([["1.0"]]), "`A` must be an array of real numbers, got one of <U3"),
        ("A", np.array([[1j]]), "`A` must be an array of real numbers, got one of complex128"),
        ("A", np.array([[np.inf]]), r"`matrices\.A\[0\]\[0\]` must be finite, got inf"),
        ("states_scales", np.array(["1"]), "`states_scales` must be an array of real numbers, got one of <U1"),
        ("states_names", np.array([1.0]), "`states_names` must be an array of texts, got one of float64"),
        ("time_unit", np.array([[115]]), "`time_unit` must be an array of texts, got one of"),
    ],
)
def test_arrays_of_another_type_are_named(suffix, key, value, message, tmp_path):
    path = tmp_path / f"plant.{suffix}"
    named = {"states_names": np.array(["a"], dtype=object if suffix == "mat" else None)}
    data = {"A": np.eye(1), "C": np.eye(1), "time_unit": "s", **named, key: value}
    savemat(path, data) if suffix == "mat" else np.savez(path, **data)
    with pytest.raises(FileFormatError, match=message):
        read_plant(path)


def test_truth_values_records_and_cells_are_no_numbers(tmp_path):
    path = tmp_path / "plant.npz"
    for wrong in (np.array([[True]]), np.array([(1.0, 2.0)], dtype=[("a", float), ("b", float)])):
        np.savez(path, A=wrong, C=np.eye(1), time_unit="s")
        with pytest.raises(FileFormatError, match="`A` must be an array of real numbers"):
            read_plant(path)
    path = tmp_path / "plant.mat"
    for wrong in ({"a": 1.0}, np.array([[1.0], ["x"]], dtype=object)):
        savemat(path, {"A": wrong, "C": np.eye(1), "time_unit": "s"})
        with pytest.raises(FileFormatError, match="`A` must be an array of real numbers"):
            read_plant(path)


def test_archives_that_name_an_array_twice_or_swell_are_refused(tmp_path, monkeypatch):
    path = tmp_path / "plant.npz"
    np.savez_compressed(path, A=np.zeros((1, 1)), C=np.zeros((1, 40_000)), time_unit="s")
    monkeypatch.setattr(files, "MOST_BYTES", 100_000)
    with pytest.raises(FileFormatError, match=r"is too large: \d+ bytes, expected at most 100000"):
        read_plant(path)
    np.savez(path, A=np.eye(1), C=np.eye(1), time_unit="s")
    with zipfile.ZipFile(path) as archive:
        content = archive.read("A.npy")
    with warnings.catch_warnings(), zipfile.ZipFile(path, "a") as archive:
        warnings.simplefilter("ignore")
        archive.writestr("A.npy", content)
    with pytest.raises(FileFormatError, match=r"\.npz: holds the array 'A' twice"):
        read_plant(path)


def test_a_file_of_an_uncertain_plant_is_refused_with_what_reads_it(tmp_path):
    path = UncertainPlant(Plant([[-1.0]], [[1.0]]), [UncertainParameter("k", -0.1, 0.1, A=[[1.0]])]).save(
        tmp_path / "plant.toml"
    )
    with pytest.raises(FileFormatError, match=r"of another kind of plant: `UncertainPlant\.read\(path\)` reads it"):
        read_plant(path)
    assert UncertainPlant.read(path).nominal.A[0, 0] == -1.0


@pytest.mark.parametrize("suffix", ["py", "toml", "json"])
def test_a_name_is_one_line_of_any_script_through_every_door(suffix, tmp_path):
    def given(name):
        if suffix == "py":
            return Plant([[0.0]], [[1.0]], states=[name], name=name)
        tree = {"format": "sampling-design/plant/1", "matrices": {"A": [[0.0]], "C": [[1.0]]}}
        quoted = json.dumps(name, ensure_ascii=False)
        path = tmp_path / f"plant.{suffix}"
        path.write_text(
            json.dumps({**tree, "name": name, "states": {"names": [name]}})
            if suffix == "json"
            else f'format = "{tree["format"]}"\nname = {quoted}\nstates.names = [{quoted}]\n'
            "matrices.A = [[0.0]]\nmatrices.C = [[1.0]]\n",
            encoding="utf-8",
        )
        return read_plant(path, "s")

    for name in ("Füllstand", "水位", "می\u200cخواهم", "\U0001f469\u200d\U0001f52c", "T\u00a0[°C]", 'a "b" #', "-"):
        plant = given(name)
        assert (plant.name, plant.states.names) == (name, (name,))
    for name in ("a\nb", "a\tb", "\x00", "\x1b[31m", "a\x85", "a\u2028b"):
        with pytest.raises((ArgumentError, FileFormatError), match="must be one line without control characters"):
            given(name)
    for name in ("", " ", "\u3000"):
        with pytest.raises((ArgumentError, FileFormatError), match="must not be blank"):
            given(name)
