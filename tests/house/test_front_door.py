"""The front door: every name opens, is documented and typed, and costs nothing before it is used."""

import ast
import doctest
import importlib
import inspect
import pickle
import pkgutil
import re
import shutil
import subprocess
import sys
import textwrap
import tomllib
import typing

import pytest

import sampling_design
from sampling_design.records.record import Displayable, Record
from sampling_design.records.signatures import hints_of
from tests.front_door import public
from tests.house.front_door import lazy_rooms, stubs
from tests.house.sources import PACKAGE, ROOT, SOURCES, nodes

PROMISED = [
    "Plant",
    "read_plant",
    "split_modes",
    "zero_count_bound",
    "observability_matrix",
    "sigma_min",
    "Schedule",
    "PeriodicSchedule",
    "SpacedWindows",
    "GapRange",
    "window_sigma",
    "worst_case_sigma",
    "Requirement",
    "design_schedule",
    "certify",
    "certify_from_proof",
    "read_certificate",
    "MovingHorizonEstimator",
    "validate",
]
MOST_NAMES = 45


def test_every_public_name_opens_and_is_documented():
    assert sampling_design.__version__.count(".") == 2
    for name in public():
        assert (inspect.getdoc(public()[name]) or "").strip(), f"{name} has no docstring"


def test_the_names_that_others_rely_on_are_there():
    assert [name for name in PROMISED if name not in public()] == []


def test_the_door_stays_small():
    assert len(sampling_design.__all__) <= MOST_NAMES


def test_an_unknown_name_is_refused():
    with pytest.raises(AttributeError, match=r"has no attribute 'xyzzy'$"):
        sampling_design.xyzzy  # noqa: B018
    assert not hasattr(sampling_design, "_nonsense")


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("desing_schedule", "design_schedule"),
        ("plant", "Plant"),
        ("MovingHorizonEstimater", "MovingHorizonEstimator"),
        ("plan", "plan_samples"),
        ("simulate", "simulate_record"),
        ("four_horizons", "certificates.four_horizons"),
        ("standard_deviation", "accuracy.standard_deviation"),
    ],
)
def test_a_mistyped_name_suggests_the_right_one(typed, meant):
    with pytest.raises(AttributeError, match=f"has no attribute '{typed}'; did you mean '{meant}'") as raised:
        getattr(sampling_design, typed)
    assert raised.value.obj is None  # else Python prints a nearest name of its own behind it
    with pytest.raises(ImportError, match=f"did you mean '{meant}'"):
        exec(f"from sampling_design import {typed}")


def test_no_name_has_two_places():
    names = [name for names in sampling_design._FRONT_DOOR.values() for name in names]
    assert sorted(names) == sorted(set(names))
    assert set(names).isdisjoint(sampling_design._ROOMS)


def test_every_room_opens_at_the_door():
    inside = {p.stem for p in PACKAGE.iterdir() if p.is_dir() or p.suffix == ".py"}
    assert set(sampling_design._ROOMS) == {name for name in inside if not name.startswith("_")}
    code = "import sampling_design as sd; print([getattr(sd, r).__name__ for r in sd._ROOMS])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert ast.literal_eval(found) == [f"sampling_design.{room}" for room in sampling_design._ROOMS]


@pytest.mark.long
def test_what_lives_in_a_room_is_reached_and_completed_through_it():
    """After `import sampling_design as sd` alone: names, sub-rooms and files; an unknown name says the nearest."""
    listed = {room: [*module.__all__] for room, module in lazy_rooms().items()}
    code = "import ast, sys, sampling_design as sd\nlisted = ast.literal_eval(sys.argv[1])\n"
    code += "print([f'{r}.{n}' for r in listed for n in listed[r] if n not in dir(getattr(sd, r))])\n"
    code += "print([f'{r}.{n}' for r in listed for n in listed[r] if getattr(getattr(sd, r), n) is None])"
    told = subprocess.run([sys.executable, "-c", code, repr(listed)], capture_output=True, text=True, check=True).stdout
    assert told == "[]\n[]\n"
    front = {name: place for place, names in sampling_design._FRONT_DOOR.items() for name in names}
    for room, module in lazy_rooms().items():
        names = {name: f"{room}.{place}" for place, found in module._NAMES.items() for name in found}
        assert {name: place for name, place in names.items() if front.get(name, place) != place} == {}
    assert {"four_horizons", "compare", "exact"} <= set(listed["certificates"])
    with pytest.raises(AttributeError, match="has no attribute 'four_horizon'; did you mean 'four_horizons'"):
        sampling_design.certificates.four_horizon  # noqa: B018
    with pytest.raises(ImportError, match="did you mean 'four_horizons'"):
        exec("from sampling_design.certificates import four_horizon")


def test_dir_lists_the_front_door():
    assert {*sampling_design.__all__, *sampling_design._ROOMS} == {*dir(sampling_design), "__version__"}


def test_records_of_the_door_travel_between_processes():
    assert pickle.loads(pickle.dumps(sampling_design.Plant)) is sampling_design.Plant


def test_the_stubs_are_the_tables():
    told = {path: path.read_text() if path.is_file() else "" for path in PACKAGE.rglob("__init__.pyi")}
    assert told == stubs(), "write them anew: python -m tests.house.front_door"


def test_the_package_ships_its_types():
    assert (PACKAGE / "py.typed").is_file()


README_LINES = re.search(r"## Eight lines\n\n```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL).group(1)
WRONG = {
    'sd.Plant("nonsense", 3, colour="red")': r'Unexpected keyword argument "colour" for "Plant"',
    "sd.desing_schedule": r'Module has no attribute "desing_schedule"; maybe "design_schedule"',
    "sd.Requirement(window=[4.0])": r'Argument "window" to "Requirement" has incompatible type "list\[float\]"',
    "sd.Schedule(None)": r'Argument 1 to "Schedule" has incompatible type "None"',
    "sd.Plant([[1.0]], [[1.0]]).states.names.append('x')": r'"tuple\[str, ...\]" has no attribute "append"',
    "sd.certify(sd.plants.library.oscillator(), 3.0)": r'No overload variant of "certify" matches argument types',
    "sd.read_plant('a.toml').eigenvalue": r'"Plant" has no attribute "eigenvalue"',
}


def _others():
    """As a user's mypy has it: our bodies are not read again, nor the types of the libraries below us.

    An example of a docstring may name whatever its file names.
    """
    skipped = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]["overrides"]
    names = ",".join(name for each in skipped for name in each["module"])
    below = f"[mypy-{names}]\nignore_missing_imports = true\nfollow_imports = skip\n"
    return f"{below}[mypy-sampling_design.*]\nfollow_imports = silent\nimplicit_reexport = true\n"


_CODES = "arg-type|call-arg|call-overload|dict-item|list-item"
UNFIT = re.compile(rf'examples\.py:\d+: error: (?!.*"\*\*dict).*\[({_CODES})\]')
"""Something is passed that the types do not take; what `**` of a table hands on, mypy cannot know."""


def docstring_examples():
    """Every example of every docstring as a function of its own, with what it names of its file."""
    names = [m.name for m in pkgutil.walk_packages(sampling_design.__path__, "sampling_design.")]
    finder, found = doctest.DocTestFinder(), {}
    for module in [importlib.import_module(name) for name in names if not name.endswith("__main__")]:
        for test in finder.find(module, module.__name__):
            code = "".join(example.source for example in test.examples)
            read = {node.id for node in ast.walk(ast.parse(code)) if isinstance(node, ast.Name)}
            named = sorted(read & vars(module).keys())
            found[test.name] = "".join(f"from {module.__name__} import {name}\n" for name in named) + code
    texts = [textwrap.indent(code, "    ") for code in found.values() if code]
    return "".join(f"def example_{k}() -> None:\n{text}\n" for k, text in enumerate(texts))


@pytest.mark.long  # a lint: mypy, in the style step of .ci/run
def test_an_editor_knows_our_types(tmp_path):
    """One run of mypy, away from the checkout: the README's eight lines pass as `strict`, each wrong line fails.

    What the examples pass, the types take.
    """
    (tmp_path / "right.py").write_text(README_LINES)
    (tmp_path / "wrong.py").write_text("\n".join(["import sampling_design as sd", *WRONG, ""]))
    examples = docstring_examples()
    (tmp_path / "examples.py").write_text(examples)
    (tmp_path / "mypy.ini").write_text(f"[mypy]\nstrict = true\nmypy_path = {ROOT}\n{_others()}")
    cache = ROOT / ".mypy_cache" / "front_door"
    known = cache.parent / "{}.{}".format(*sys.version_info)
    if known.is_dir() and not cache.exists():
        shutil.copytree(known, cache / known.name)  # what the step before has read of the libraries
    command = [sys.executable, "-m", "mypy", "--cache-dir", cache, "right.py", "wrong.py", "examples.py"]
    told = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, check=False).stdout
    assert "right.py" not in told, told
    unfit = [line for line in told.splitlines() if UNFIT.match(line)]
    assert not unfit, unfit
    assert examples.count("def example") > 80
    for line, (code, message) in enumerate(WRONG.items(), start=2):
        assert re.search(rf"wrong\.py:{line}: error: {message}", told), f"{code}:\n{told}"


@pytest.mark.long
def test_no_class_repeats_its_fields_for_the_type_checker():
    """It reads them off the fields, `Converted` where more is taken than is held."""
    for path in SOURCES:
        for kind in nodes(path):
            for part in kind.body if isinstance(kind, ast.ClassDef) else ():
                if isinstance(part, ast.If) and ast.unparse(part.test) == "TYPE_CHECKING":
                    assert "__init__" not in {each.name for each in part.body}, f"{path}: {kind.name}"


def functions():
    return [name for name, thing in public().items() if inspect.isfunction(thing)]


def test_public_functions_state_parameters_and_returns():
    for name in functions():
        thing = public()[name]
        doc = inspect.getdoc(thing)
        assert "Returns\n---" in doc, f"{name} does not say what it returns"
        listed = "Parameters\n---" in doc or not inspect.signature(thing).parameters
        assert listed, f"{name} does not list its parameters"


WORDS = {
    **dict.fromkeys(("T", "length"), "window or horizon"),
    **dict.fromkeys(("rate", "decay"), "eta of the squared error, decay_rate of modes"),
    **dict.fromkeys(("step", "sampling_time", "period_time"), "dt"),
    **dict.fromkeys(("tol", "tolerance", "eps", "reltol"), "rtol"),
    **dict.fromkeys(("random_state", "generator", "random"), "rng"),
    **dict.fromkeys(("timeout", "seconds", "time_limit", "max_seconds"), "budget"),
    **dict.fromkeys(("n_jobs", "jobs", "processes", "pool"), "workers"),
    **dict.fromkeys(("callback", "verbose", "report"), "progress"),
    **dict.fromkeys(("file", "filename"), "path"),
    **dict.fromkeys(("disturbance_bound", "noise_bound", "prior_error"), "w_bound, v_bound or initial_error"),
    **dict.fromkeys(("rows", "states_of", "wanted"), "of"),
}
"""What arguments of public functions are not called, and what the field and the other functions call them."""
TOGETHER = (
    ("w_bound", "v_bound", "initial_error"),
    ("P2", "Qw", "R", "Qv"),
    ("A", "B", "C", "D"),
    ("prior", "prior_time"),
)
"""Arguments that stand in this order wherever several of them do."""


def out_of_order(name, asked):
    """What stands elsewhere than in other verbs: the plant first, but after the path of what is read; then the rest."""
    subjects = ["path", "plant"] if name.startswith("read_") else ["plant", "path"]
    if name.startswith("write_"):
        subjects = ["path"]
    groups = [given for group in (*TOGETHER, subjects) if (given := [each for each in group if each in asked])]
    wrong = [given for given in groups if [each for each in asked if each in given] != given]
    return wrong + [["plant"]] * ("plant" in asked and not name.startswith("read_") and asked[0] != "plant")


def test_arguments_out_of_order_are_seen():
    assert out_of_order("certify", ["schedule", "plant"])
    assert out_of_order("certify", ["plant", "v_bound", "w_bound"])
    assert not out_of_order("read_certificate", ["path", "plant"])


@pytest.mark.parametrize("name", functions())
def test_arguments_are_called_and_ordered_as_in_every_other_verb(name):
    asked = list(inspect.signature(public()[name]).parameters)
    assert {each: WORDS[each] for each in asked if each in WORDS} == {}
    assert out_of_order(name, asked) == []
    assert not name.startswith(("load_", "get_", "compute_")), "files are read by `read_`"
    assert "seed" not in asked or "rng" not in asked


def results():
    """The records that verbs of the front door return."""
    found = {}
    for name in sampling_design.__all__:
        thing = getattr(sampling_design, name)
        if inspect.isfunction(thing):
            hint = hints_of(thing).get("return")
            kinds = [each for each in (hint, *typing.get_args(hint)) if inspect.isclass(each)]
            found |= {each.__name__: each for each in kinds if issubclass(each, Record)}
    return found


@pytest.mark.parametrize("name", results())
def test_every_result_says_shows_and_holds_itself_in_the_same_ways(name):
    """In words, as a table, as a picture, and as data; the same methods of whatever a verb returns."""
    kind = results()[name]
    for method in ("explain", "plot", "_repr_html_"):
        assert callable(getattr(kind, method)), method
    assert hasattr(kind, "to_dict") or hasattr(kind, "to_frame")
    assert kind._rows is not Displayable._rows or kind._table, "no table"
    if hasattr(kind, "save"):  # what has a file of its own is a claim that can be checked, or what one was made of
        assert hasattr(kind, "verify")


def test_import_loads_nothing():
    code = "import sys, importlib; old = set(sys.modules); import sampling_design; print(sorted({*sys.modules} - old))"
    command = [sys.executable, "-S", "-c", code]
    found = subprocess.run(command, capture_output=True, text=True, check=True, cwd=ROOT).stdout
    below = ["sampling_design", "sampling_design.records", "sampling_design.records.lazy"]
    assert ast.literal_eval(found) == ["__future__", *below]


def test_every_room_imports_and_says_what_it_is():
    rooms = [room for room in sampling_design._ROOMS if room not in ("errors", "evidence")]
    assert [room for room in rooms if not importlib.import_module(f"sampling_design.{room}").__doc__] == []


def test_every_public_function_has_a_door():
    assert [name for name in functions() if "checked" not in vars(public()[name])] == []


def test_the_annotations_behind_every_door_can_be_read():
    """A name that only type checkers import would leave an argument without its check."""
    for name in public():
        thing = public()[name]
        members = [thing] if inspect.isfunction(thing) else list(vars(thing).values()) if inspect.isclass(thing) else []
        for member in members:
            inner = getattr(member, "__func__", member)
            if inspect.isfunction(inner) and "checked" in vars(inner):
                unread = set(inspect.get_annotations(inner)) - {"return", *hints_of(inner.__wrapped__)}
                assert not unread, f"{name}: {inner.__name__} cannot read {unread}"
