"""The application: the table of its commands, each of which is imported when it is called."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from sampling_design.cli.version import show_version

if TYPE_CHECKING:
    from collections.abc import Callable


class Command(NamedTuple):
    """Where a command stands and what one line of help says of it: the first sentence of its docstring."""

    place: str
    line: str


PANELS = {
    "When to sample": {
        "new": Command(
            "new.new",
            "Write a first plant and requirement, with comments, from flags; at a terminal, what is missing is asked.",
        ),
        "info": Command(
            "plan.info", "Show a plant: its modes, which of them must be observable, and how many samples that takes."
        ),
        "design": Command(
            "plan.design", "Design an endless periodic schedule, with its proven sigma and a bound that none can beat."
        ),
        "pareto": Command("what_if.pareto", "Design for several counts: what more samples buy."),
        "losses": Command(
            "what_if.losses",
            "Design, then say what the loss of each single sample costs: sigma without it, and what none can exceed.",
        ),
        "plan": Command(
            "planning.plan",
            "Make a calendar that keeps wanted accuracies at the least cost, with a bound that no other plan can beat.",
        ),
        "next": Command(
            "planning.next_sample",
            "Say by when the next sample must be taken so that every tolerance is kept, now and afterwards.",
        ),
        "explore": Command(
            "explore.explore",
            "Drag samples on a time line in the browser and see what they prove; Save writes schedule.csv to -o DIR.",
        ),
    },
    "What does it prove": {
        "sigma": Command(
            "plan.sigma",
            "Prove how observable a plant is along a schedule: the least sigma over every real window position.",
        ),
        "worst-case": Command(
            "what_if.worst_case",
            "Bracket the least sigma over every schedule with COUNT samples, SPACING apart, in each WINDOW.",
        ),
        "certify": Command(
            "prove.certify", "Prove sample-based exponential i-iIOSS on a schedule, or on every schedule of a family."
        ),
        "verify": Command("prove.verify", "Check a certificate or an interval from its data alone."),
        "robustness": Command(
            "what_if.robustness",
            "Say how late samples may come, and how many may be lost, before a certificate no longer holds.",
        ),
        "accuracy": Command(
            "accuracy.accuracy",
            "Bracket the least error that any estimator can guarantee, at the worst time of a schedule.",
        ),
    },
    "What is the state": {
        "estimate": Command(
            "track.estimate",
            "Estimate the state from measurements, with a radius that holds the truth if noise keeps its bounds.",
        )
    },
    "Did the promise hold": {
        "validate": Command(
            "track.validate",
            "Certify a schedule, then try to break the promise: random and worst noise, constraints, inequality (16).",
        ),
        "compare": Command(
            "track.compare",
            "Compare planned with actual sample times: what came late, what was missed, and what that costs.",
        ),
        "thyroid": Command(
            "thyroid.thyroid",
            "Repeat the paper's Section VI: hormone concentrations from rare blood samples, against sampling every "
            "2 hours.",
        ),
    },
}
"""The commands, by the question that they answer."""

RENAMED = {"log": "compare", "survive": "robustness"}
"""Commands that were called otherwise; who types the earlier name is told the one of today."""

COMMANDS = {name: command for panel in PANELS.values() for name, command in panel.items()}


def function_of(name: str) -> Callable[..., None]:
    """Import the function of a command."""
    module, _, function = COMMANDS[name].place.partition(".")
    found: Callable[..., None] = getattr(import_module(f"sampling_design.cli.{module}"), function)
    return found


@cache
def loaded(name: str) -> TyperCommand:
    """Import a command, with its arguments and flags."""
    from sampling_design.cli.settings import with_common_flags

    alone = typer.Typer(add_completion=False, rich_markup_mode=None, pretty_exceptions_enable=False)
    alone.command(name)(with_common_flags(function_of(name), name))
    command = typer.main.get_command(alone)
    assert isinstance(command, TyperCommand)
    return command


class CommandsWhenCalled(TyperGroup):
    """The commands of the table, known by name and line until one of them is called."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.commands = {name: TyperCommand(name, help=command.line) for name, command in COMMANDS.items()}

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, TyperCommand | None, list[str]]:
        """Return the command that is called, imported."""
        if args and args[0] in RENAMED:
            from sampling_design.errors import ArgumentError

            raise ArgumentError(f"`{args[0]}` is called `{RENAMED[args[0]]}` now, with the same arguments.")
        name, command, rest = super().resolve_command(ctx, args)
        return name, None if command is None else loaded(str(name)), rest

    def format_commands(self, ctx: object, formatter: Any) -> None:
        """Write the lines of the commands, under the question that they answer."""
        for title, commands in PANELS.items():
            with formatter.section(title):
                formatter.write_dl([(name, command.line) for name, command in commands.items()])


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
