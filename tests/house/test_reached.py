"""What nobody can reach is not there: every definition is reached from a door, a table of a room or a command."""

import ast
import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path

import pytest

from tests.house.sources import PACKAGE, ROOT, parsed

pytestmark = pytest.mark.long  # a lint, which the style step of .ci/run runs

Name = tuple[str, str]
"""A module and what is defined in it; "" for the module itself."""


class House:
    """The definitions of a package, and which of them name which: by import, or by their place in a table."""

    def __init__(self, package: Path):
        self.package = package
        files = sorted(package.rglob("*.py"))
        self.trees = {self.module(path): parsed(path) for path in files}
        self.doors = {self.module(path) for path in files if path.name in ("__init__.py", "__main__.py")}
        self.definitions: dict[Name, list[ast.stmt]] = {}
        self.imports = {module: dict(self.imported(module)) for module in self.trees}
        for module, tree in self.trees.items():
            for statement in tree.body:
                for name in defined(statement):
                    self.definitions.setdefault((module, name), []).append(statement)

    def module(self, path: Path) -> str:
        """The dotted name of a file."""
        parts = path.relative_to(self.package.parent).with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    def imported(self, module: str) -> Iterator[tuple[str, Name]]:
        """Each name that a module imports anywhere, and what it stands for."""
        own = module.split(".") if module in self.doors else module.split(".")[:-1]
        for node in ast.walk(self.trees[module]):
            if isinstance(node, ast.ImportFrom):
                base = own[: len(own) - node.level + 1] if node.level else []
                place = ".".join([*base, *([node.module] if node.module else [])])
                yield from ((each.asname or each.name, (place, each.name)) for each in node.names)
            elif isinstance(node, ast.Import):
                yield from ((each.asname or each.name.split(".")[0], (each.name, "")) for each in node.names)

    def found(self, place: str) -> set[Name]:
        """The definition or module at a dotted place, through the tables of rooms too."""
        module, _, name = place.replace(":", ".").rpartition(".")
        for each in ((module, name), self.tables.get((module, name), ("", ""))):
            if each in self.definitions:
                return {each}
        if module in self.imports and name in self.imports[module]:
            return self.found(".".join(self.imports[module][name]).rstrip("."))
        return {(place, "")} if place in self.trees else set()

    @cached_property
    def tables(self) -> dict[Name, Name]:
        """What a package offers under a shorter name than that of the file in which it stands."""
        rows = ((door, *row) for door in self.doors for row in pairs(self.trees[door]))
        return {(door, name): (f"{door}.{file}", name) for door, file, name in rows}

    def named(self, module: str, part: ast.AST) -> Iterator[Name]:
        """What a piece of a module names: by import, by attribute, or as text in a table."""
        room = module if module in self.doors else module.rpartition(".")[0]
        for node in ast.walk(part):
            if isinstance(node, ast.Name):
                yield from {(module, node.id)} & self.definitions.keys()
                if node.id in self.imports[module]:
                    yield from self.found(".".join(self.imports[module][node.id]).rstrip("."))
            elif isinstance(node, ast.Attribute):
                whole: ast.expr = node
                names: list[str] = []
                while isinstance(whole, ast.Attribute):
                    names.insert(0, whole.attr)
                    whole = whole.value
                if isinstance(whole, ast.Call) and getattr(whole.func, "id", "") == "import_module":
                    yield from (each for each in self.definitions if each[1] == names[0] and each[0].startswith(room))
                elif isinstance(whole, ast.Name) and whole.id in self.imports[module]:
                    yield from self.found(".".join([".".join(self.imports[module][whole.id]).rstrip("."), *names]))
            elif isinstance(node, ast.Constant) and re.fullmatch(r"[\w.:]+", str(node.value)):
                places = (str(node.value), f"{room}.{node.value}", f"{module}.{node.value}")
                yield from (each for place in places for each in self.found(place))
        for file, name in pairs(part):
            yield from self.found(f"{room}.{file}.{name}")

    def unreached(self) -> list[str]:
        """The definitions that are reached from none of the doors."""
        waiting = [(door, "") for door in self.doors]
        waiting += [
            each for each in self.definitions if each[0] in self.doors | self.open_files or each[1] == "__all__"
        ]
        reached: set[Name] = set()
        while waiting:
            if (here := waiting.pop()) in reached:
                continue
            reached.add(here)
            module, name = here
            waiting.append((module, ""))
            statements = self.definitions[here] if name else [s for s in self.trees[module].body if runs(s)]
            waiting += [(module, each) for statement in statements if not name for each in defined(statement)]
            waiting += [each for statement in statements for each in self.named(module, statement)]
        return sorted(".".join(each) for each in self.definitions.keys() - reached)

    @cached_property
    def open_files(self) -> set[str]:
        """Files that a room lists beside its names, as a whole."""
        calls = ((door, node) for door in self.doors for node in ast.walk(self.trees[door]))
        listed = {
            f"{door}.{each.value}"
            for door, node in calls
            if isinstance(node, ast.keyword) and node.arg == "modules" and isinstance(node.value, ast.Tuple)
            for each in node.value.elts
            if isinstance(each, ast.Constant)
        }
        return listed - self.doors


def defined(statement: ast.stmt) -> list[str]:
    """The names that a statement at the top of a file defines."""
    if isinstance(statement, (ast.FunctionDef, ast.ClassDef)):
        return [statement.name]
    targets = statement.targets if isinstance(statement, ast.Assign) else [getattr(statement, "target", None)]
    names = [each for target in targets for each in getattr(target, "elts", [target])]
    return [each.id for each in names if isinstance(each, ast.Name)]


def runs(statement: ast.stmt) -> bool:
    """Whether a statement does something when its file is imported, beside giving a name to what stands in it."""
    if isinstance(statement, ast.FunctionDef):  # a decorator of an object registers it there
        calls = [each for each in statement.decorator_list if isinstance(each, ast.Call)]
        return any(isinstance(each.func, ast.Attribute) for each in calls)
    return not isinstance(statement, (ast.Import, ast.ImportFrom)) and not defined(statement)


def pairs(part: ast.AST) -> list[tuple[str, str]]:
    """Rows of tables that give a file and names in it: {"file": ("name", ...)}, or ("file", "name")."""
    found = []
    for node in ast.walk(part):
        if isinstance(node, ast.Dict):
            rows = zip(node.keys, node.values, strict=True)
            found += [(k, each) for k, v in rows if isinstance(v, ast.Tuple) for each in v.elts]
        elif isinstance(node, ast.Tuple) and len(node.elts) == 2:
            found.append(tuple(node.elts))
    texts = [[each.value for each in row if isinstance(each, ast.Constant)] for row in found]
    return [(row[0], row[1]) for row in texts if len(row) == 2 and all(isinstance(each, str) for each in row)]


def declared(node: ast.Assign) -> list[str]:
    """The names in what a record declares of itself: its table, its plain data and its answers."""
    if ast.unparse(node.targets[0]) not in ("_table", "_plain", "_answers"):
        return []
    texts = [each.value for each in ast.walk(node.value) if isinstance(each, ast.Constant)]
    return [word for text in texts for word in re.findall(r"\w+", str(text))]


def unmentioned(package: Path, besides: str) -> list[str]:
    """Methods whose names stand nowhere but in their definitions: private ones in the package, others in no text."""
    trees = [ast.parse(path.read_text()) for path in sorted(package.rglob("*.py"))]
    nodes = [node for tree in trees for node in ast.walk(tree)]
    known = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    known |= {node.id for node in nodes if isinstance(node, ast.Name)}
    known |= {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    known |= {word for node in nodes if isinstance(node, ast.Assign) for word in declared(node)}
    methods = [
        f"{node.name}.{each.name}"
        for node in nodes
        if isinstance(node, ast.ClassDef)
        for each in node.body
        if isinstance(each, ast.FunctionDef) and not each.name.startswith("__")
    ]
    words = set(besides.replace("(", " ").replace(".", " ").replace("`", " ").split())
    return [
        each
        for each in methods
        if (name := each.split(".")[1]) not in known
        and (name.removeprefix("_") not in known if name.startswith("_") else name not in words)
    ]


def unpassed(package: Path) -> list[str]:
    """Options of inner functions that no call in the package gives, neither by name nor by place."""
    house = House(package)
    offered = set(re.findall(r"\w+", " ".join(path.read_text() for path in package.rglob("__init__.py"))))
    calls, names = defaultdict(list), Counter()
    for node in (node for tree in house.trees.values() for node in ast.walk(tree)):
        names.update([getattr(node, "attr", getattr(node, "id", None))])
        if isinstance(node, ast.Call):
            calls[getattr(node.func, "id", getattr(node.func, "attr", ""))].append(node)
    found = []
    inner = [
        (module, each) for module, tree in house.trees.items() for each in tree.body if module not in house.open_files
    ]
    for module, function in inner:
        if not isinstance(function, ast.FunctionDef) or function.name in offered or function.decorator_list:
            continue
        given = calls[function.name]
        every = [key.arg for call in given for key in call.keywords]
        starred = any(isinstance(each, ast.Starred) for call in given for each in call.args)
        if names[function.name] > len(given) or None in every or starred:  # handed on as a whole, or with what comes
            continue
        a, most = function.args, max((len(call.args) for call in given), default=0)
        places = [each.arg for each in (*a.posonlyargs, *a.args)]
        options = [name for k, name in enumerate(places) if k >= max(most, len(places) - len(a.defaults))]
        options += [each.arg for each, value in zip(a.kwonlyargs, a.kw_defaults, strict=True) if value is not None]
        found += [f"{module}.{function.name}({name})" for name in options if name not in every]
    return found


GIVEN_ELSEWHERE = {
    "sampling_design.certificates.form.verdict.verdict_of(work)",  # tests of what work a check may do
    *(
        f"sampling_design.nonlinear.simulation.simulate({each})" for each in ("u", "tolerance", "input_between")
    ),  # users
}


def test_every_option_of_an_inner_function_is_given():
    """By some call in the package, or the function is handed on; commands are called by typer."""
    found = {each for each in unpassed(PACKAGE) if not each.startswith("sampling_design.cli.")}
    assert found <= GIVEN_ELSEWHERE


def test_every_definition_is_reached_from_a_door():
    assert House(PACKAGE).unreached() == []


CALLED_BY_LIBRARIES = {
    "CommandsWhenCalled.format_commands": "click, for its help",
    "Axes._repr_png_": "notebooks",
    "Handler.do_GET": "http.server",
    "Handler.do_POST": "http.server",
    "Handler.log_message": "http.server",
    "Panels._repr_png_": "notebooks",
    "Server.shutdown_request": "socketserver",
    "Displayable._repr_html_": "notebooks",
}


def test_every_method_is_mentioned_somewhere():
    texts = [
        p
        for folder in ("tests", "docs", "examples")
        for p in (ROOT / folder).rglob("*.*")
        if p.suffix in (".py", ".md")
    ]
    besides = " ".join(path.read_text() for path in texts if path != Path(__file__))
    assert set(unmentioned(PACKAGE, besides)) <= CALLED_BY_LIBRARIES.keys()


def test_what_nobody_reaches_is_found(tmp_path):
    package = tmp_path / "house"
    package.mkdir()
    (package / "__init__.py").write_text('_NAMES = {"room": ("open_verb",)}\nlazy(modules=("whole",))\n')
    (package / "room.py").write_text(
        "from house.below import used as other\n"
        "TABLE = {'kind': 'below:by_name'}\nFORGOTTEN = 1\n"
        "def open_verb():\n    return other, TABLE\n"
        "def closed_verb():\n    return closed_verb\n"
    )
    (package / "below.py").write_text("def used(): ...\ndef by_name(): ...\ndef unused(): ...\n")
    (package / "whole.py").write_text("def offered(): ...\n")
    assert House(package).unreached() == ["house.below.unused", "house.room.FORGOTTEN", "house.room.closed_verb"]
    (package / "room.py").write_text(
        "class One:\n    _table = {'a': '{_shown} s'}\n    def _shown(self): ...\n    def _left(self): ...\n"
        "    def asked(self): ...\n"
    )
    assert unmentioned(package, "one.asked()") == ["One._left"]
    (package / "inner.py").write_text(
        "def asked(a, b=1, c=2, *, d=3): return a\ndef user(e=4): return asked(0, 1, d=2), handed\n"
        "def handed(f=5): return user()\n"
    )
    assert unpassed(package) == ["house.inner.asked(c)", "house.inner.user(e)"]
