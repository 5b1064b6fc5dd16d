"""Pages and pictures that are made from the package itself, so that they cannot drift from it.

`made/items.md`: the table item -> theory -> function -> test, from `paper_items.toml`.
`made/api/ROOM.md`: a room's README, every name of the front door that lives there, and the records that they return.
`made/command-line.md`: every command with its flags. `made/reports.md`, `made/notebooks/`: what is there to include.
`made/constants.md`: every constant that tunes a computation, by room, with what it trades.
`made/floors.svg`: which room imports which. `made/rooms.svg`: the same inside the large rooms.
"""

import ast
import functools
import importlib
import inspect
import json
import re
import textwrap
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOMS = {
    "plants": "What is measured",
    "schedules": "When it is measured",
    "observability": "What samples show",
    "accuracy": "How well anybody can know",
    "design": "When to sample",
    "planning": "Which readings keep a promise",
    "certificates": "What a schedule proves",
    "estimators": "What the state is",
    "uncertain": "Plants that are not exactly known",
    "nonlinear": "Nonlinear plants",
    "validation": "Whether the promise held",
    "explorer": "What happens when a sample moves",
    "plotting": "Pictures",
    "cli": "Command line",
}
FLOORS = (
    ("plants", "schedules"),
    ("observability",),
    ("accuracy", "certificates", "design"),
    ("estimators", "planning"),
    ("validation", "uncertain", "explorer"),
    ("nonlinear",),
    ("plotting",),
    ("cli",),
)
WRITTEN = {
    "index",
    "many_cores",
    "tour",
    "choosing",
    "conventions",
    "formats",
    "numerics",
    "references",
    "architecture",
}
WRITTEN |= {
    "contributing",
    "changelog",
    "installation",
    "first_hour",
    "journeys",
    "gallery",
    "exercises",
    "glossary",
    "opening_hours",
    "pole",
    "blood",
    "own_estimator",
    "paper",
    "lectures",
}  # every other page beside these was written by a command
GROUPS = {
    "definition": "Definitions",
    "assumption": "Assumptions",
    "theorem": "Theorems and lemma",
    "remark": "Remarks",
    "equation": "Equations",
    "section": "Appendix and Section VI",
    "erratum": "Corrections",
}


def write_all(docs: Path) -> None:
    """Write everything below docs/made, touching only what has changed."""
    package, made = docs.parent / "sampling_design", docs / "made"
    write(made / "items.md", items_page(read_items(docs)))
    for room in ROOMS:
        if (package / room / "README.md").is_file():
            write(made / "api" / f"{room}.md", room_page(room))
    write(made / "api" / "index.md", api_index([r for r in ROOMS if (made / "api" / f"{r}.md").is_file()]))
    write(made / "command-line.md", command_page())
    write(made / "constants.md", constants_page(package))
    write(made / "reports.md", reports_page(sorted({p.stem for p in docs.glob("*.md")} - WRITTEN)))
    write(made / "floors.svg", floors_picture(package))
    write(made / "rooms.svg", rooms_picture(package))
    copy_notebooks(docs.parent / "examples" / "notebooks", made / "notebooks")


def write(path: Path, text: str) -> None:
    """Write `path` if it does not say that already (an untouched page is not built again)."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if not path.is_file() or path.read_text() != text:
        path.write_text(text)


def read_items(docs: Path) -> list[dict]:
    """Return the items of the paper, in order."""
    return tomllib.loads((docs / "paper_items.toml").read_text())["item"]


def items_page(items: list[dict]) -> str:
    """Return the table item -> theory -> function -> test."""
    errata = [i for i in items if i["kind"] == "erratum"]
    shown = sum(bool(i.get("printed")) for i in errata)
    lines = [
        "# From the paper to functions and tests",
        "",
        f"All {len(items)} entries: every numbered item of the paper and every correction of it. A test reads the same",
        "list (`docs/paper_items.toml`) and fails where a page, a function or a test is missing.",
        f"{shown} of the {len(errata)} corrections have a test that puts the printed formula in and shows it fail;",
        "for the others the table says why there is nothing to evaluate.",
        "[Ten lines for each item](../paper.md) work it out on an example.",
        "",
    ]
    for kind, heading in GROUPS.items():
        lines += [f"## {heading}", "", "| item | says | functions | tests |", "|---|---|---|---|"]
        lines += [item_row(i) for i in items if i["kind"] == kind]
        lines.append("")
    return "\n".join(lines)


def item_row(item: dict) -> str:
    """Return one row; a pipe inside a cell would end it."""
    functions = ", ".join(function_link(f) for f in item.get("functions", ())) or f"*{item['no_function']}*"
    tests = item.get("printed", []) + [t for t in item.get("tests", ()) if t not in item.get("printed", ())]
    shown = "".join(test_label(t, t in item.get("printed", ())) for t in tests)
    if "no_test" in item:
        shown += f"*{item['no_test']}*"
    cells = (f"[{item['label']}](#{item['theory']})", item["title"], functions, shown)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def function_link(name: str) -> str:
    """Return a link where the name has a place on the pages of the rooms, its dotted name elsewhere."""
    import sampling_design

    last = name.split(".")[-1]
    if last in sampling_design.__all__:
        return f"{{py:obj}}`~sampling_design.{last}`"
    room = name.split(".")[0]
    return f"{{py:obj}}`~sampling_design.{name}`" if room in ROOMS and name in records_of(room) else f"`{name}`"


def test_label(name: str, printed: bool) -> str:
    """Return the sentence that the test's name is, with its file."""
    path, function = name.split("::")
    sentence = function.removeprefix("test_").replace("_", " ")
    mark = " **(printed formula)**" if printed else ""
    return f"{sentence}{mark} <small>`{path.removeprefix('tests/')}`</small>"


BESIDE = {
    "estimators": ("estimators.online.curve.estimate_curve",),
    "plotting": ("plotting.draw", "plotting.save"),
    "explorer": ("explorer.scene", "explorer.serve", "explorer.ScheduleExplorer", "explorer.explore"),
}
"""What a room offers beside the front door."""


def room_page(room: str) -> str:
    """Return the page of one room: a table of its functions, its README, then its names."""
    import sampling_design

    modules = {m: names for m, names in sampling_design._FRONT_DOOR.items() if m.split(".")[0] == room and "." in m}
    readme = (Path(sampling_design.__file__).parent / room / "README.md").read_text()
    heading, _, rest = readme.partition("\n")
    lines = [heading, "", *functions_table(room), rest.strip("\n"), ""]
    if modules or room in BESIDE:
        lines += ["## Interface", ""]
    for place in BESIDE.get(room, ()):
        lines += interface_of(place, named(place))
    for module, names in modules.items():
        lines += [f"### `{module.replace('.', '/')}.py`", ""]
        for name in names:
            lines += interface_of(name, getattr(sampling_design, name))
    records = records_of(room)
    if records:
        lines += ["## Records and their parts", "", "Imported from the files that they stand in.", ""]
    for place, thing in records.items():
        lines += interface_of(place, thing)
    if room == "plants":
        lines += ["### `plants/library.py`", "", "```{eval-rst}", ".. automodule:: sampling_design.plants.library"]
        beside = [place.rpartition(".")[2] for place in records if place.startswith("plants.library.")]
        lines += ["   :members:", *([f"   :exclude-members: {', '.join(beside)}"] if beside else []), "", "```", ""]
    return "\n".join(lines)


def functions_table(room: str) -> list[str]:
    """Return the table that opens a room's page: what it offers, and what that does."""
    if room == "cli":
        return commands_table()
    lines = ["| name | does |", "|---|---|"]
    for place in (*names_of(room), *BESIDE.get(room, ())):
        thing, name = named(place), place.rpartition(".")[2]
        mark = "" if isinstance(thing, type) else "()"
        lines.append(f"| {{py:obj}}`{name}{mark} <sampling_design.{place}>` | {first_sentence(thing)} |")
    return [*lines, ""]


def named(place: str) -> object:
    """Return what stands at a place below the package."""
    module, _, name = place.rpartition(".")
    return getattr(importlib.import_module(f"sampling_design.{module}".rstrip(".")), name)


def first_sentence(thing: object) -> str:
    """Return what a docstring begins with, as Markdown."""
    first = (inspect.getdoc(thing) or "").split("\n\n")[0].replace("\n", " ").split("::")[0]
    return re.sub(r"(?<!`)([|<>*_\\$])", r"\\\1", first.replace("``", "`"))


def commands_table() -> list[str]:
    """Return the table of the commands, each with a link to its flags."""
    from sampling_design.cli.app import lines as lines_of_commands

    lines = ["| command | does |", "|---|---|"]
    for name, line in lines_of_commands().items():
        lines.append(f"| [`{name}`](../command-line.md#sampling-design-{name}) | {line} |")
    return [*lines, ""]


def records_of(room: str) -> dict[str, object]:
    """Return the records and helpers of a room that are public and not at the front door, by file and name."""
    import sampling_design
    from sampling_design.records.record import Record

    found: dict[str, object] = {}
    package = Path(sampling_design.__file__).parent
    for path in sorted((package / room).rglob("[a-z]*.py")):
        file = ".".join(path.relative_to(package).with_suffix("").parts)
        module = importlib.import_module(f"sampling_design.{file}")
        for name, thing in vars(module).items():
            public = (
                issubclass(thing, Record) if isinstance(thing, type) else "checked" in getattr(thing, "__dict__", {})
            )
            own = public and thing.__module__ == module.__name__
            listed = name in sampling_design.__all__ or f"{file}.{name}" in BESIDE.get(room, ())
            if own and not name.startswith("_") and not listed:
                found[f"{file}.{name}"] = thing
    return found


def interface_of(name: str, thing: object) -> list[str]:
    """Return the directive that documents one name, given by its place below the package."""
    kind = "autoclass" if isinstance(thing, type) else "autofunction" if callable(thing) else "autodata"
    if kind == "autodata":
        return []
    options = ["   :members:"] if kind == "autoclass" else []
    return ["```{eval-rst}", f".. {kind}:: sampling_design.{name}", *options, "```", ""]


def api_index(rooms: list[str]) -> str:
    """Return the page that lists the rooms."""
    lines = [
        "# Interface, room by room",
        "",
        "What a user types opens at the front door: `from sampling_design import ...`; records and their parts open in "
        "their rooms.",
    ]
    lines += ["Each page begins with the README that stands in the room itself.", ""]
    lines += ["| room | question | names |", "|---|---|---|"]
    for room in rooms:
        names = ", ".join(f"{{py:obj}}`~sampling_design.{n}`" for n in names_of(room))
        lines.append(f"| [{room}]({room}.md) | {ROOMS[room].lower()} | {names} |")
    return "\n".join([*lines, "", "```{toctree}", ":hidden:", *(f"{r} <{r}>" for r in rooms), "```", ""])


def names_of(room: str) -> list[str]:
    """Return the names of the front door that live in a room."""
    import sampling_design

    door = sampling_design._FRONT_DOOR
    names = [n for module, found in door.items() if module.split(".")[0] == room and "." in module for n in found]
    return [n for n in names if callable(getattr(sampling_design, n))]


def command_page() -> str:
    """Return every command with its help, arguments and flags, from the application itself."""
    from typer.main import get_command

    from sampling_design.cli.app import COMMANDS, app, loaded

    root = get_command(app)
    lines = ["# Command line", "", root.help or "", ""]
    lines += ["Results go to stdout, progress and messages to stderr. `--install-completion` teaches the shell.", ""]
    lines += ["Exit codes: [conventions](../conventions.md).", ""]
    for name, command in ((name, loaded(name)) for name in COMMANDS):
        lines += [f"## `sampling-design {name}`", "", *command_help(command.help or "")]
        lines += ["| argument or flag | meaning |", "|---|---|"]
        for parameter in command.params:
            is_option, called = parameter.param_type_name == "option", parameter.metavar
            flags = [*(parameter.opts if is_option else ()), *([called] if called else [])]
            told = (getattr(parameter, "help", None) or "").replace("|", "\\|")
            plain = isinstance(parameter.default, int | float | str) and not isinstance(parameter.default, bool)
            shown = f" Default {parameter.default}." if plain and parameter.default != "" else ""
            lines.append(f"| `{' '.join(flags)}` | {told}{shown} |")
        lines.append("")
    return "\n".join(lines)


def command_help(text: str) -> list[str]:
    """Return the help of a command, its example as something to copy."""
    lines = []
    for paragraph in text.strip().split("\n\n"):
        said = " ".join(paragraph.replace("\b", "").split())
        if said.startswith("Example: "):
            lines += ["```sh", said.removeprefix("Example: "), "```", ""]
        else:
            lines += [said, ""]
    return lines


def reports_page(reports: list[str]) -> str:
    """Return the page that gathers what commands have measured and written."""
    lines = ["# Measured", "", "Figures that commands of this project have written; each page names its command.", ""]
    return "\n".join([*lines, "```{toctree}", *(f"../{name}" for name in reports), "```", ""])


def copy_notebooks(source: Path, target: Path) -> None:
    """Copy the lectures beside the pages, where they are executed; each page offers its file and its solutions."""
    names = sorted(p.name for p in source.glob("*.ipynb")) if source.is_dir() else []
    for name in names:
        notebook = json.loads((source / name).read_text())
        solved = name.replace(".ipynb", "_solved.ipynb")
        write(target / "solved" / solved, (source.parent / "teachers" / name).read_text())
        offered = (
            ":::{container} until-live\n"
            "**To change and run the cells of this page**, without a network: "
            "`jupyter server --config run_lectures.py` in the folder of these pages opens them in a browser, with a "
            "button at each cell ([once before](../../lectures.md): `pip install '.[nonlinear,notebooks]'`).\n:::\n\n"
            f"To keep: {{download}}`the notebook <../../../examples/notebooks/{name}>`, "
            f"{{download}}`its exercises, solved <solved/{solved}>`."
        )
        notebook["cells"].insert(1, {"cell_type": "markdown", "id": "offered", "metadata": {}, "source": offered})
        write(target / name, json.dumps(notebook, indent=1, ensure_ascii=False))
    lines = [
        "# Notebooks",
        "",
        "The [lectures](../../lectures.md) of `examples/notebooks/`, executed for these pages.",
        "",
    ]
    lines += ["```{toctree}", ":maxdepth: 1", *(n.removesuffix(".ipynb") for n in names), "```", ""]
    write(target / "index.md", "\n".join(lines))


@functools.cache
def imports_of(path: Path) -> list[ast.Import | ast.ImportFrom]:
    """Return the imports of a file, those inside functions and branches among them: no expression is looked into."""
    found, waiting = [], list(ast.parse(path.read_text()).body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import | ast.ImportFrom):
            found.append(node)
        for block in ("body", "orelse", "handlers", "finalbody", "cases"):
            waiting += getattr(node, block, ())
    return found


def imports_between(package: Path) -> dict[tuple[str, str], int]:
    """Count the modules of one room that import another."""
    found: dict[tuple[str, str], int] = {}
    rooms = {room for floor in FLOORS for room in floor}
    for path in package.rglob("*.py"):
        here = path.relative_to(package).parts[0]
        if here not in rooms:
            continue
        named = set()
        for node in imports_of(path):
            modules = [a.name for a in node.names]
            if isinstance(node, ast.ImportFrom):
                modules = [node.module, *(f"{node.module}.{name}" for name in modules)] if node.module else []
            named |= {m.split(".")[1] for m in modules if m.startswith("sampling_design.")}
        for other in named & rooms - {here}:
            found[here, other] = found.get((here, other), 0) + 1
    return found


def constants_page(package: Path) -> str:
    """Every constant that tunes a computation, by room and file, with the line that says what it trades."""
    head = """Each stands at the head of the file that uses it, one that several files use in the lowest of them. They
are collected here, room by room, with what each trades."""
    lines = ["# Constants that tune", "", head, ""]
    for room in sorted(path for path in package.iterdir() if path.is_dir()):
        found = [(path, told) for path in sorted(room.rglob("*.py")) if (told := list(tuning_constants(path)))]
        lines += [f"## {room.name}", ""] if found else []
        for path, told in found:
            lines += [f"`{path.relative_to(package)}`", "", "```text"]
            for name, value, why in told:
                lines += textwrap.wrap(f"{name} = {value}: {why}", 140, subsequent_indent="    ")
            lines += ["```", ""]
    return "\n".join(lines)


def tuning_constants(path: Path) -> Iterator[tuple[str, str, str]]:
    """Name and value of the numeric constants of a file, and the line beside or below that says what they trade."""
    lines, body = ["", *path.read_text().splitlines()], ast.parse(path.read_text()).body
    for i, node in enumerate(body):
        if not isinstance(node, ast.Assign) or not _is_numeric(node.value):
            continue
        names = [each.id for each in ast.walk(node.targets[0]) if isinstance(each, ast.Name)]
        if not all(re.fullmatch(r"_?[A-Z][A-Z0-9_]*", name) for name in names):
            continue
        why = _beside(lines, node.end_lineno) or _beside(lines, node.lineno)
        below = next((each for each in body[i + 1 :] if not isinstance(each, ast.Assign)), None)
        if not why and isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            why = " ".join(str(below.value.value).split())
        yield ", ".join(names), ast.unparse(node.value).strip("()"), why


def _beside(lines: list[str], place: int) -> str:
    """The comment at the end of a line of numbers, else that on the line above it alone."""
    above = lines[place - 1].strip()
    return (lines[place].partition("#")[2] or above * above.startswith("#")).lstrip("# ")


def _is_numeric(node: ast.AST) -> bool:
    """Whether an expression is a number, or several, that somebody chose."""
    parts = list(ast.walk(node))
    kinds = ast.Constant | ast.Tuple | ast.UnaryOp | ast.BinOp | ast.operator | ast.unaryop | ast.expr_context
    values = [part.value for part in parts if isinstance(part, ast.Constant)]
    return bool(values) and all(isinstance(p, kinds) for p in parts) and all(type(v) in (int, float) for v in values)


def floors_picture(package: Path) -> str:
    """Return an SVG: rooms on their floors, a line wherever one imports another."""
    width, height, box = 860, 92, (196, 46)
    top = len(FLOORS)
    places = {}
    for level, rooms in enumerate(FLOORS):
        for k, room in enumerate(rooms):
            x = width / 2 + (k - (len(rooms) - 1) / 2) * min(330, (width - 190) / max(len(rooms) - 1, 1))
            places[room] = (x, (top - 1 - level) * height + 40)
    lines = []
    for (here, other), count in sorted(imports_between(package).items()):
        (x, y), (u, v) = places[here], places[other]
        bend = 0 if abs(v - y) <= height else (120 if x <= width / 2 else -120) * (1 if u >= x else -1)
        middle = f"{(x + u) / 2 + bend:.0f} {(y + v) / 2:.0f}"
        lines.append(
            f'<path d="M {x:.0f} {y + box[1] / 2:.0f} Q {middle} {u:.0f} {v - box[1] / 2 - 4:.0f}" fill="none" '
            f'stroke="#1f5fa8" stroke-opacity="0.45" stroke-width="{1 + min(count, 12) / 4:.2f}" '
            f'marker-end="url(#tip)"><title>{here} imports {other} ({count} modules)</title></path>'
        )
    boxes = []
    for room, (x, y) in places.items():
        boxes.append(
            f'<g><rect x="{x - box[0] / 2:.0f}" y="{y - box[1] / 2:.0f}" width="{box[0]}" height="{box[1]}" rx="8" '
            f'fill="#eef4fb" stroke="#1f5fa8"/><text x="{x:.0f}" y="{y - 2:.0f}" text-anchor="middle" '
            f'font-weight="600">{room}</text><text x="{x:.0f}" y="{y + 14:.0f}" text-anchor="middle" '
            f'font-size="11" fill="#555">{ROOMS[room].lower()}</text></g>'
        )
    ground = top * height + 26
    boxes.append(
        f'<rect x="60" y="{ground - 22}" width="{width - 120}" height="44" rx="8" fill="#f4f4f4" stroke="#888"/>'
        f'<text x="{width / 2:.0f}" y="{ground + 5}" text-anchor="middle" font-size="13">ground: errors, evidence, '
        f"checks, records, files, units, linear algebra, balls, the one door to the conic solver</text>"
    )
    style = 'font-family="Helvetica, Arial, sans-serif" font-size="15"'
    tip = (
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto" '
        'markerUnits="userSpaceOnUse"><path d="M 0 0 L 8 4 L 0 8 z" fill="#1f5fa8" fill-opacity="0.6"/></marker></defs>'
    )
    inside = "\n".join([tip, *lines, *boxes])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {ground + 34}" {style}>\n'
        f'<rect width="100%" height="100%" fill="white"/>\n{inside}\n</svg>\n'
    )


def arrows_inside(package: Path, room: str) -> dict[str, set[str]]:
    """Return what each room inside a room, and each file that stands in it directly, imports of the others."""
    folder = package / room
    inside = {p.name for p in folder.iterdir() if (p / "__init__.py").is_file()}
    below: dict[str, set[str]] = {name: set() for name in sorted(inside)}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(folder).parts
        here = parts[0] if len(parts) > 1 else path.stem
        if here == "__init__":
            continue
        below.setdefault(here, set())
        for node in imports_of(path):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(f"sampling_design.{room}."):
                other = node.module.split(".")[2]
                if other != here:
                    below[here].add(other)
    return below


def levels(below: dict[str, set[str]]) -> dict[str, int]:
    """Return the floor of each: one above the highest that it imports."""
    found: dict[str, int] = {}
    while len(found) < len(below):
        ready = [n for n, others in below.items() if n not in found and others & set(below) <= set(found)]
        assert ready, f"a circle among {sorted(set(below) - set(found))}"
        for name in ready:
            found[name] = 1 + max((found[other] for other in below[name] & set(below)), default=-1)
    return found


def direct(below: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the arrows that no longer way implies."""

    def reached(name: str) -> set[str]:
        others = below.get(name, set())
        return others.union(*(reached(other) for other in others))

    return {n: {o for o in others if not any(o in reached(x) for x in others - {o})} for n, others in below.items()}


def rooms_picture(package: Path) -> str:
    """Return an SVG: inside each large room, its rooms and files on their floors, and who imports whom."""
    large = [r for floor in FLOORS for r in floor if any((package / r).glob("*/__init__.py"))]
    width, box, step = 430, (130, 30), 62
    drawn, panels = [], []
    for k, room in enumerate(large):
        below = arrows_inside(package, room)
        floor = levels(below)
        top = max(floor.values())
        row = k // 2
        left, base = 20 + (k % 2) * (width + 20), 60 + sum(panels[:row])
        places = {}
        for level in range(top + 1):
            names = sorted(n for n in below if floor[n] == level)
            for i, name in enumerate(names):
                x = left + width / 2 + (i - (len(names) - 1) / 2) * min(138, (width - 10) / len(names))
                places[name] = (x, base + (top - level) * step + 24)
        if k % 2:
            panels[row] = max(panels[row], (top + 1) * step + 56)
        else:
            panels.append((top + 1) * step + 56)
        drawn.append(f'<text x="{left + 8}" y="{base - 18}" font-weight="600">{room}</text>')
        for here, others in sorted(direct(below).items()):
            for other in sorted(others & set(places)):
                (x, y), (u, v) = places[here], places[other]
                drawn.append(
                    f'<path d="M {x:.0f} {y + box[1] / 2:.0f} L {u:.0f} {v - box[1] / 2 - 3:.0f}" fill="none" '
                    'stroke="#1f5fa8" stroke-opacity="0.4" marker-end="url(#tip)">'
                    f"<title>{here} imports {other}</title></path>"
                )
        for name, (x, y) in places.items():
            wide = min(box[0], (width - 10) / sum(f == floor[name] for f in floor.values()) - 6)
            file = not (package / room / name).is_dir()
            fill, shown = ("#ffffff", f"{name}.py") if file else ("#eef4fb", name)
            drawn.append(
                f'<rect x="{x - wide / 2:.0f}" y="{y - box[1] / 2:.0f}" width="{wide:.0f}" height="{box[1]}" rx="6" '
                f'fill="{fill}" stroke="#1f5fa8"/><text x="{x:.0f}" y="{y + 4:.0f}" text-anchor="middle" '
                f'font-size="12">{shown}</text>'
            )
    tip = (
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="6" markerHeight="6" orient="auto" '
        'markerUnits="userSpaceOnUse"><path d="M 0 0 L 8 4 L 0 8 z" fill="#1f5fa8" fill-opacity="0.6"/></marker></defs>'
    )
    inside = "\n".join([tip, *drawn])
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {2 * width + 60} {sum(panels) + 40}" '
        f'font-family="Helvetica, Arial, sans-serif" font-size="15">\n'
        f'<rect width="100%" height="100%" fill="white"/>\n{inside}\n</svg>\n'
    )
