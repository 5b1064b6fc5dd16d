"""The application: the table of its commands, each of which is imported when it is called."""

from __future__ import annotations

import ast
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption

from sampling_design.cli.version import show_version

if TYPE_CHECKING:
    from collections.abc import Callable


PANELS: dict[str, dict[str, tuple[str, ...]]] = {
    "When to sample": {
        "new": ("new",),
        "design": ("info", "design", "pareto", "losses"),
        "plan": ("plan", "next_sample"),
        "explore": ("explore",),
    },
    "What does it prove": {
        "sigma": ("sigma", "worst_case"),
        "certify": ("certify", "verify", "robustness"),
        "accuracy": ("accuracy",),
    },
    "What is the state": {"estimate": ("estimate",)},
    "Did the promise hold": {"validate": ("validate", "compare"), "thyroid": ("thyroid",)},
}
"""Files and their functions, by the question that they answer."""

RENAMED = {"log": "compare", "survive": "robustness"}
"""Commands that were called otherwise; who types the earlier name is told the one of today."""

SHORT = {"next_sample": "next"}
"""Commands that are not called as their function."""

COMMANDS = {
    SHORT.get(function, function.replace("_", "-")): (file, function)
    for panel in PANELS.values()
    for file, functions in panel.items()
    for function in functions
}
"""File and function of each command."""


def function_of(command: str) -> Callable[..., None]:
    """Import the function of a command."""
    file, function = COMMANDS[command]
    found: Callable[..., None] = getattr(import_module(f"sampling_design.cli.{file}"), function)
    return found


@cache
def lines() -> dict[str, str]:
    """Return what one line of help says of each command: the first sentence of its docstring, read, not imported."""
    folder, said = Path(__file__).parent, dict[str, str]()
    for file in {file for file, _ in COMMANDS.values()}:
        for node in ast.parse((folder / f"{file}.py").read_text(encoding="utf-8")).body:
            match node:
                case ast.FunctionDef(name=name):
                    said[name] = " ".join((ast.get_docstring(node) or "").partition("\n\n")[0].split())
    return {command: said[function].split(". ")[0].rstrip(".") + "." for command, (_, function) in COMMANDS.items()}


@cache
def loaded(name: str) -> TyperCommand:
    """Import a command, with its arguments and flags."""
    from sampling_design.cli.settings import with_common_flags

    alone = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    alone.command(name)(with_common_flags(function_of(name), name))
    command = typer.main.get_command(alone)
    assert isinstance(command, TyperCommand)
    return command


def word_of(option: str) -> str:
    """What an option is called in Python."""
    return option.lstrip("-").replace("-", "_")


class CommandsWhenCalled(TyperGroup):
    """The commands of the table, known by name and line until one of them is called."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.commands = {name: TyperCommand(name, help=line) for name, line in lines().items()}

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, TyperCommand | None, list[str]]:
        """Return the command that is called, imported."""
        if args and args[0] in RENAMED:
            from sampling_design.errors import ArgumentError

            raise ArgumentError(f"`{args[0]}` is called `{RENAMED[args[0]]}` now, with the same arguments.")
        name, command, rest = super().resolve_command(ctx, args)
        return name, None if command is None else loaded(str(name)), rest

    def invoke(self, ctx: Any) -> object:
        """Call the command; an option that has another name here is named, one that takes several values explained."""
        refusals = import_module(typer.BadParameter.__module__)
        try:
            return super().invoke(ctx)
        except (refusals.BadOptionUsage, refusals.BadParameter) as error:
            named = vars(error).get("option_name") or (error.param and error.param.opts[0])
            for each in loaded(ctx.invoked_subcommand).params:
                match each:
                    case TyperOption(nargs=int(many)) if many > 1 and named in each.opts:
                        error.message = f"`{named}` takes {many} values, {each.metavar}: {each.help}"
            raise
        except refusals.NoSuchOption as error:
            from sampling_design.records.checks import ELSEWHERE

            known = {word_of(option): option for each in error.ctx.command.params for option in each.opts}
            ours = [known[name] for name in ELSEWHERE.get(word_of(error.option_name), ()) if name in known]
            error.possibilities = ours[:1] or error.possibilities
            raise

    def format_commands(self, ctx: object, formatter: Any) -> None:
        """Write the lines of the commands, under the question that they answer."""
        for title, panel in PANELS.items():
            with formatter.section(title):
                formatter.write_dl([(name, lines()[name]) for name, (file, _) in COMMANDS.items() if file in panel])


app = typer.Typer(
    name="sampling-design",
    cls=CommandsWhenCalled,
    no_args_is_help=True,
    help="When to measure a plant that is measured rarely, what that proves, and what the state is.",
    epilog="Exit codes: 0 done and the claim holds; 1 the mathematics says no; 2 bad input or usage; "
    "3 a solver failed or a budget ran out; 70 a defect of this program; 130 interrupted.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=show_version, is_eager=True)
    ] = False,
) -> None:
    """Design sampling schedules, certify them, and estimate the state from rare measurements."""
