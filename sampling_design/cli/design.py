"""Commands that choose schedules: info, design, pareto, losses."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import typer
from rich.table import Table as RichTable

import sampling_design as sd
from sampling_design.checkers.strict import is_table
from sampling_design.cli import files, options
from sampling_design.cli.settings import Settings, record_table, table
from sampling_design.cli.sigma import window_length
from sampling_design.errors import ArgumentError
from sampling_design.plants.clusters import format_eigenvalue
from sampling_design.plants.modes import ModalSplit
from sampling_design.records.checks import positive
from sampling_design.records.dates import parse_date, zoned_text
from sampling_design.records.record import short

if TYPE_CHECKING:
    from sampling_design.design.schedule_design import ScheduleDesign

SECONDS_BOUGHT = 1.0
"""What `design` may take to say what samples buy, where none are needed."""


def info(
    settings: Settings,
    plant_file: options.PlantFile,
    window: Annotated[
        float | None,
        typer.Option(help="Window of the counts [time unit]; default: the longest oscillation, else 4/|A|."),
    ] = None,
) -> None:
    """Show a plant: its modes, which of them must be observable, and how many samples that takes.

    With -o DIR: info.json.

    Example: sampling-design info examples/plants/oscillator.toml
    """
    plant = settings.part(files.plant(plant_file))
    split = sd.plants.split_modes(plant, settings.decay_rate or 0.0)
    tables: list[RichTable | str] = [record_table(plant), _modes(split, plant.time_unit), split.explain()]
    data: dict[str, object] = {"plant": plant.to_dict(), "split": split.to_dict(), "counts": None}
    if split.retained.n_states:
        sd.observability.require_observable(plant, "a zero count", split.decay_rate)
        count = sd.zero_count_bound(split.retained, window_length(settings, split, window))
        tables += [record_table(count), count.explain()]
        left = plant.n_states - split.retained.n_states
        if left:
            kept = split.retained.n_states
            means = "its one retained direction" if kept == 1 else f"its {kept} retained directions"
            others, counts = f"The other {left} decay by themselves and need", "some of them are counted too"
            if left == 1:
                others, counts = "The other one decays by itself and needs", "it may be counted too"
            tables.append(f"Here the state means {means}. {others} no samples; with a larger --decay-rate {counts}.")
        data["counts"] = count.to_dict()
    settings.write_json(data, "info")
    settings.show(data, *tables)


def _modes(split: ModalSplit, unit: str) -> RichTable:
    rows = []
    for cluster in split.clusters:
        value = complex(cluster.value)
        if value.imag < 0:
            continue  # its conjugate has a row already
        real = format_eigenvalue(value.real, grain=split.offset)
        written = f"{real} ± {short(value.imag)}i" if value.imag else real
        period = short(2 * np.pi / value.imag) if value.imag else "-"
        part = "retained" if cluster in split.retained_clusters else "left to decay"
        rows.append([written, str(cluster.multiplicity), str(cluster.index), period, part])
    return table("Modes", [f"eigenvalue [1/{unit}]", "multiplicity", "index", f"period [{unit}]", "part"], rows)


DesignWindow = Annotated[
    float | None,
    typer.Option(help="Window that must show the state [time unit]; default: the longest oscillation, else 4/|A|."),
]
Period = Annotated[
    float | None, typer.Option(help="The schedule repeats after this time [time unit]; default: the window.")
]
Spacing = Annotated[
    float | None, typer.Option(help="Least time between two samples [time unit]; default: window/(4 samples).")
]
Samples = Annotated[
    int | None, typer.Option(help="Exactly so many samples per period; default: what the zero count asks for.")
]
CostLimit = Annotated[
    float | None, typer.Option(help="Most that the measurements of a period may cost; default: no limit.")
]
Branches = Annotated[
    int | None, typer.Option(help="Boxes of schedules cut in two to narrow the upper bound; default: while that helps.")
]
TargetSigma = Annotated[
    float | None, typer.Option(help="The fewest samples that reach this sigma; default: none is asked.")
]


def design(
    settings: Settings,
    plant_file: options.PlantFile,
    requirement_file: options.RequirementFile = None,
    window: DesignWindow = None,
    period: Period = None,
    spacing: Spacing = None,
    samples: Samples = None,
    target_sigma: TargetSigma = None,
    cost_limit: CostLimit = None,
    timing_tolerance: options.TimingOption = None,
    branches: Branches = None,
    start: Annotated[
        str | None,
        typer.Option(metavar="DATE", help="Date of time 0 (ISO 8601): writes calendar.csv and schedule.ics too."),
    ] = None,
    zone: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Time zone of --start and of the calendars, as Europe/Berlin; default UTC."),
    ] = None,
) -> None:
    """Design an endless periodic schedule, with its proven sigma and a bound that none can beat.

    The work ends by itself once the bound is at most 3 % above sigma, or where more cuts help little; Ctrl-C ends it at
    any time (exit code 130). Files hold what is proven by then.

    Example: sampling-design design examples/plants/oscillator.toml examples/requirements/oscillator.toml -o out
    """
    plant = files.plant(plant_file)
    if settings.folder() is None and start is not None:  # said before the design is computed, not after
        raise ArgumentError("`--start` writes a calendar, so it needs a folder. Give --output DIR.")
    if zone is not None and start is None:
        raise ArgumentError(f"`--zone` {zone} says where --start is local time: give --start DATE with it.")
    zero = None if start is None else zoned_text(parse_date("--start", start, zone))
    requirement = _required(
        settings, requirement_file, window=window, period=period, spacing=spacing, samples=samples,
        target_sigma=target_sigma, cost_limit=cost_limit,
        timing_tolerance=None if timing_tolerance is None else options.timing(timing_tolerance),
    )  # fmt: skip
    with settings.progress("design") as progress:
        rng = np.random.default_rng(settings.seed)
        given = {} if branches is None else {"branches": branches}
        result = sd.design_schedule(plant, requirement, rng=rng, budget=settings.budget, progress=progress, **given)
    for name, value in result.defaults_used.items():
        said = [f"{each.replace('_', ' ')} {of}" for each, of in value.items()] if is_table(value) else [value]
        settings.notice(str(value) if name == "notice" else f"--{name.replace('_', '-')} not given: {said[0]} is used.")
    settings.write_json(result.to_dict(), "design")
    folder, next_steps = settings.folder(), list[str]()
    if folder is not None and result.schedule is not None and result.sigma > 0:
        paths, notes = sd.design.write_design(result, folder, origin=zero, zone=zone)
        settings.wrote(*paths, notes=notes)
        settings.draw(result, "design", origin=zero)
        made = f"{options.shell_word(folder / 'schedule.csv')} -o {options.shell_word(folder)}"
        next_steps = [f"Next: sampling-design certify {options.shell_word(plant_file)} {made}"]
    if result.decay is not None:
        next_steps = _bought(result, plant_file)
    settings.show(result.to_dict(), record_table(result), *_samples(result), result.explain(), *next_steps)
    _end_unobservable(result)


def _bought(result: ScheduleDesign, plant_file: Path) -> list[str]:
    """Where no samples are needed: the accuracy without any and with some, and the line for other bounds."""
    decay, plant, sensors = result.decay, result.split.plant, result.requirement.sensors
    assert decay is not None
    noise = dict(zip(plant.outputs.names, plant.outputs.scales.tolist(), strict=True))
    noise |= {name: term.noise_bound for name, term in sensors.items() if term.noise_bound is not None}
    found = sd.accuracy.accuracy_by_count(
        plant, decay.counts, period=decay.to_a_tenth, w_bound=plant.disturbances.scales, v_bound=list(noise.values()),
        of=result.requirement.of, budget=SECONDS_BOUGHT,
    )  # fmt: skip
    which = "the plant's scales, and the noise bounds of its sensors" if sensors else "the plant's scales"
    line = (
        f"sampling-design accuracy {options.shell_word(plant_file)} --samples {','.join(map(str, decay.counts))} "
        f"--period {decay.to_a_tenth:g} --w-bound W --v-bound V"
    )
    return [f"{found.explain()} The bounds are typical sizes: {which}. With your own:", f"Next: {line}"]


def _samples(result: ScheduleDesign) -> list[RichTable | str]:
    if result.schedule is None:
        return []
    schedule, unit = result.schedule, result.schedule.time_unit or ""
    times = zip(schedule.times, schedule.gaps, strict=True)
    rows = [[str(i + 1), short(t, 9), short(g)] for i, (t, g) in enumerate(times)]
    return [table("Samples of one period", ["sample", f"time [{unit}]", f"gap before [{unit}]"], rows)]


def pareto(
    settings: Settings,
    plant_file: options.PlantFile,
    requirement_file: options.RequirementFile = None,
    counts: Annotated[str, typer.Option(help="Samples per period, at least one number: 8,10,12 or 8-16.")] = "",
    workers: options.WorkerCount = 1,
    scheduler: options.Scheduler = None,
    budget: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="Of all counts together; bounds then depend on the machine. Default: none."
        ),
    ] = None,
) -> None:
    """Design for several counts: what more samples buy. With -o DIR it can be interrupted and resumed.

    Without a budget the result is the same for any number of workers.

    Example: sampling-design pareto examples/plants/oscillator.toml --counts 2-8 -o out
    """
    from sampling_design.design.pareto import NO_NEED

    plant = files.plant(plant_file)
    requirement, folder = _required(settings, requirement_file), settings.folder()
    resume = None if folder is None else folder / "pareto.json"
    with settings.progress("pareto") as progress, options.workforce(workers, scheduler) as pool:
        front = sd.pareto_front(
            plant, requirement, _counts(counts), rng=np.random.default_rng(settings.seed), workers=pool, resume=resume,
            progress=progress, budget=None if budget is None else positive("budget", budget),
        )  # fmt: skip
    if resume is not None:
        settings.wrote(resume)
    settings.draw(front, "pareto")
    settings.show(front.to_dict(), record_table(front), front.explain())
    if not front.efficient and not any(point.obstacle == NO_NEED for point in front.points):
        undecided = any(point.upper_bound > 0 for point in front.points)
        raise typer.Exit(3 if undecided else 1)


def _counts(text: str) -> Iterator[int]:
    """8,10,12 or 8-16, or both mixed."""
    found: list[range] = []
    for part in filter(None, text.split(",")):
        first, dash, last = part.partition("-")
        if not first.strip().isdecimal() or (dash and not last.strip().isdecimal()):
            raise ArgumentError(f"`--counts` must look like 8,10,12 or 8-16, got {text!r}.")
        if last and int(last) < int(first):
            raise ArgumentError(f"`--counts` must rise from the smaller number to the larger, got {part!r}.")
        found.append(range(int(first), int(last or first) + 1))
    if not found:
        raise ArgumentError("`--counts` must name at least one number of samples, for example 8-16.")
    return chain.from_iterable(found)


def losses(
    settings: Settings,
    plant_file: options.PlantFile,
    requirement_file: options.RequirementFile = None,
    every_period: Annotated[
        bool, typer.Option("--every-period", help="Leave the sample out of every period, not once.")
    ] = False,
) -> None:
    """Design, then say what the loss of each single sample costs: sigma without it, and what none can exceed.

    Example: sampling-design losses examples/plants/oscillator.toml examples/requirements/oscillator.toml
    """
    plant = files.plant(plant_file)
    requirement = _required(settings, requirement_file)
    with settings.progress("losses") as progress:
        design, result = sd.design.design_and_losses(
            plant, requirement, every_period=every_period, rng=settings.seed, budget=settings.budget, progress=progress
        )
    if result is None:
        settings.finish_early({"without": []}, "losses", design.explain())
        _end_unobservable(design)
        return
    settings.draw(result, "losses")
    settings.finish(result, result.to_dict(), "losses")


def _required(settings: Settings, path: Path | None, **flags: object) -> sd.Requirement:
    """The requirement of a file, with what the flags say instead."""
    flags |= {"decay_rate": settings.decay_rate, "of": settings.rows}
    return files.requirement(path).replace(**{key: value for key, value in flags.items() if value is not None})


def _end_unobservable(design: ScheduleDesign) -> None:
    """Leave with 1 where no schedule sees every state, and with 3 where only none was found."""
    if not design.sigma > 0:
        raise typer.Exit(1 if design.upper_bound == 0 else 3)
