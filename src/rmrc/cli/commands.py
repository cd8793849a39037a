"""The command line: one function a command, each calling one library function."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape as escape_markup
from rich.table import Table

from rmrc.errors import INTERRUPTED, RmrcError, printable, printable_lines

NOT_CONVERGED, WRONG_INPUT, OUR_FAULT = 1, 2, 3
"""Exit codes; 0 is success."""

app = typer.Typer(
    help="Resolved motion rate control: differential inverse kinematics on MuJoCo models.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="A YAML configuration.")]
RunPath = Annotated[Path, typer.Argument(metavar="RUN", help="A run folder.")]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="PATH=VALUE", help="Set a value, as in solver.backend=osqp."),
]


def main() -> None:
    """Run the command line; every way out is an exit code and at most one clear message."""
    try:
        app()
    except RmrcError as mistake:
        _complain(str(mistake), WRONG_INPUT)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(NOT_CONVERGED)
    except KeyboardInterrupt:
        _complain("interrupted", INTERRUPTED)
    except SystemExit as end:
        if end.code == INTERRUPTED:  # typer's, which says nothing
            _complain("interrupted", INTERRUPTED)
        raise
    except OSError as failure:
        _complain(str(failure), WRONG_INPUT)
    except Exception as fault:  # the last resort: a traceback is for us, not for users
        if os.environ.get("RMRC_TRACEBACK"):
            raise
        where = f"{type(fault).__name__}: {fault}"
        _complain(f"a fault of rmrc itself: {where} (RMRC_TRACEBACK=1 shows where)", OUR_FAULT)


def _complain(message: str, code: int) -> None:
    message = printable_lines(message)
    print(f"rmrc: {message}" if "\n" not in message else message, file=sys.stderr)
    sys.exit(code)


def _say(text: object) -> None:
    """Print a text, which may hold names of the model or of files, on a line of its own."""
    print(printable(str(text)))


def _escape(text: str) -> str:
    """Return text as rich shows it, neither as markup nor as what a terminal would obey."""
    return escape_markup(printable(text))


def _overrides(settings: list[str] | None) -> dict[str, Any]:
    from rmrc.config.load import parse_override

    return dict(parse_override(text) for text in settings or [])


def _names(text: str | None) -> list[str]:
    return [name.strip() for name in (text or "").split(",") if name.strip()]


@app.command()
def solve(
    config: ConfigPath,
    settings: Settings = None,
    out: Annotated[
        Path | None, typer.Option(help="The run folder; by default runs/NAME-0001, counting up.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the summary as JSON.")] = False,
) -> None:
    """Run a configuration: a progress bar, a summary, a run folder with a report."""
    import rmrc
    from rmrc.record.folder import json_text
    from rmrc.record.run import RUN_FOLDER

    RUN_FOLDER.ensure_free(out or Path("runs/new"))
    loaded = rmrc.load(config, overrides=_overrides(settings))
    with _progress(loaded.name) as progress:
        run = rmrc.solve(loaded, progress)
    folder = run.save(out) if out is not None else run.save_numbered("runs")
    if as_json:
        print(json_text({"run": str(folder), **run.summary}))
    else:
        _print_summary(run.manifest, folder)
    kept = all(limit["max_violation"] == 0 for limit in run.summary["limits"].values())
    raise typer.Exit(0 if run.summary["converged"] and kept else NOT_CONVERGED)


@contextmanager
def _progress(name: str) -> Iterator[Callable[[int, int], None] | None]:
    """Show a progress bar on a terminal, and none in a pipe."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield None
        return
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(_escape(name))
        yield lambda done, count: bar.update(task, completed=done, total=count)


def _print_summary(manifest: dict[str, Any], folder: Path) -> None:
    console, summary = Console(highlight=False), manifest["summary"]
    table = Table(title=_escape(manifest["name"]), title_justify="left", show_edge=False)
    for header in ("", "rms", "max", "final", "unit"):
        table.add_column(header, justify="left" if header in ("", "unit") else "right")
    for name, numbers in summary["tasks"].items():
        _add_task(table, name, numbers)
        if "orientation" in numbers:
            _add_task(table, "  orientation", numbers["orientation"])
    console.print(table)
    for name, limit in summary["limits"].items():
        if started := limit.get("started_outside"):
            console.print(f"[yellow]started outside by {_passed(started)}[/]")
        if limit["max_violation"]:
            console.print(f"[red]{name} limit passed by {_passed(limit)}[/]")
    counts = ", ".join(f"{name} {count}" for name, count in summary["status"].items())
    time = summary["step_time_us"]
    verdict = "[green]converged[/]" if summary["converged"] else "[red]not converged[/]"
    console.print(
        f"{verdict} · {summary['steps']} steps: {counts} · "
        f"{time['median']:.0f} µs a step (p99 {time['p99']:.0f}) · "
        f"{summary['engine']} engine, {summary['backend']}"
    )
    if manifest.get("interrupted"):
        console.print("[yellow]interrupted: this is what was done so far[/]")
    for notice in manifest.get("notices", []):
        console.print(f"[dim]note: {_escape(notice)}[/]")
    console.print(
        f"run folder: {_escape(str(folder))} · look at {_escape(str(folder / 'report.html'))}",
        soft_wrap=True,
    )


def _passed(limit: dict[str, Any]) -> str:
    """Return how far a limit is passed, and by which joint."""
    joint = f" ({_escape(limit['joint'])})" if limit.get("joint") else ""
    return f"{limit['max_violation']:.3g} {limit['unit']}{joint}"


def _add_task(table: Table, name: str, numbers: dict[str, Any]) -> None:
    values = (f"{numbers[key]:.3g}" for key in ("rms", "max", "final"))
    table.add_row(_escape(name), *values, numbers["unit"])


@app.command()
def compare(
    config: ConfigPath,
    methods: Annotated[
        str | None, typer.Option(metavar="A,B,…", help="The methods; by default all.")
    ] = None,
    backends: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,…", help="The solvers of method qp; by default native,daqp,proxqp,osqp."
        ),
    ] = None,
    follow: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,…", help="The ways of following; by default the configuration's."
        ),
    ] = None,
    sweep: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH=A,B,…", help="Values, as in damping.curvature=on,off."),
    ] = None,
    settings: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option(help="The folder; by default comparisons/NAME-0001, counting up."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON.")] = False,
) -> None:
    """Run a configuration by several methods: a table, and a page with all their curves."""
    import rmrc
    from rmrc.config.load import parse_sweep, swept
    from rmrc.record.folder import json_text
    from rmrc.runs.compare import COMPARISON_FOLDER

    if out is not None:
        COMPARISON_FOLDER.ensure_free(out)
    overrides = _overrides(settings)
    configs = {
        name: rmrc.load(config, overrides=overrides | values)
        for name, values in swept(map(parse_sweep, sweep or [])).items()
    }
    with _progress(config.stem) as progress:
        comparison = rmrc.compare(
            configs, _names(methods), _names(backends), _names(follow), progress
        )
    folder = comparison.save(out) if out else comparison.save_numbered("comparisons")
    if as_json:
        numbers = {"comparison": str(folder), **comparison.summary}
        print(json_text(numbers))
    else:
        _print_comparison(comparison.config.name, comparison.summary, folder)
    raise typer.Exit(0 if comparison.finished else NOT_CONVERGED)


def _print_comparison(name: str, summary: dict[str, Any], folder: Path) -> None:
    from rmrc.record.overlay import table
    from rmrc.runs.compare import PAGE

    console = Console(highlight=False)
    head, rows = table(summary, whole=False)
    shown = Table(title=_escape(name), title_justify="left", box=None, padding=(0, 1, 0, 0))
    for title, *cells in zip(head, *rows, strict=True):
        texts = (printable(text) for text in (title, *(cell.text for cell in cells)))
        words = [word for text in texts for word in text.split()]
        # The last column, of the statuses, takes what is left of the width.
        width = max(map(len, words)) if title != head[-1] else None
        shown.add_column(_escape(title), overflow="fold", width=width)
    for row in rows:
        shown.add_row(*(f"[red]{_escape(c.text)}[/]" if c.bad else _escape(c.text) for c in row))
    console.print(shown)
    for left_out in summary["left_out"]:
        console.print(
            f"[dim]{_escape(left_out['name'])} is left out: {_escape(left_out['reason'])}[/]"
        )
    if summary["interrupted"]:
        console.print("[yellow]interrupted: this is what was done so far[/]")
    console.print(f"comparison: {_escape(str(folder))} · look at {_escape(str(folder / PAGE))}")


@app.command()
def check(
    configs: Annotated[list[Path], typer.Argument(metavar="CONFIG…", help="YAML configurations.")],
    settings: Settings = None,
) -> None:
    """Validate configurations against their models, and say what will bind."""
    import rmrc
    from rmrc.runs.check import check as check_config

    overrides, mistaken = _overrides(settings), False
    for path in configs:
        try:
            lines = check_config(rmrc.load(path, overrides=overrides))
        except RmrcError as mistake:
            mistaken = True
            print(mistake, file=sys.stderr)
        else:
            _say(f"{path}: ok")
            for line in lines:
                _say(f"  {line}")
    raise typer.Exit(WRONG_INPUT if mistaken else 0)


@app.command()
def inspect(
    model: Annotated[
        str, typer.Argument(metavar="SCENE|CONFIG", help="A model, or a YAML configuration.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print it all as JSON.")] = False,
) -> None:
    """List what a model has: frames, joints with ranges and speeds, couplings, keyframes."""
    from rmrc.runs.describe import described
    from rmrc.runs.inspect import inspect as look

    found = look(model)
    if as_json:
        print(json.dumps(found, ensure_ascii=False))
        return
    for line in described(found):
        print(line)


@app.command()
def init(
    folder: Annotated[
        Path | None, typer.Argument(metavar="DIR", help="The folder, made if it is not there.")
    ] = None,
    scene: Annotated[
        str | None, typer.Option(help="The robot: a model file, menagerie:NAME, …")
    ] = None,
    frame: Annotated[
        str | None, typer.Option(help="The site or body that moves; by default it is found.")
    ] = None,
    example: Annotated[
        str | None, typer.Option(metavar="NAME", help="A configuration that comes with rmrc.")
    ] = None,
    listed: Annotated[
        bool, typer.Option("--list", help="List the configurations that come with rmrc.")
    ] = False,
) -> None:
    """Begin: a configuration and a stack of one's own for a robot, that run at once."""
    from rmrc.errors import RmrcError
    from rmrc.runs.init import examples, init_example, init_scene

    if listed:
        for name, says in examples().items():
            print(f"{name:<24} {says}")
        return
    if folder is None:
        raise RmrcError("name the folder: rmrc init DIR (or rmrc init --list)")
    if example is not None and (scene or frame):
        raise RmrcError("--example brings its own scene: leave --scene and --frame out")
    said = init_scene(folder, scene, frame) if example is None else init_example(folder, example)
    for line in said:
        print(line)


@app.command()
def show(config: ConfigPath, settings: Settings = None) -> None:
    """Print the resolved configuration, each value with its origin."""
    from rmrc.config.load import show as show_config

    print(show_config(config, overrides=_overrides(settings)), end="")


@app.command()
def schema() -> None:
    """Print the JSON Schema of configurations and stacks."""
    from rmrc.config.schema import schema as json_schema

    print(json.dumps(json_schema(), indent=2, ensure_ascii=False))


@app.command()
def report(
    run: RunPath,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="The file; by default report.html in RUN.")
    ] = None,
) -> None:
    """Write the report of a run again."""
    from rmrc.record.report import write_report
    from rmrc.record.run import REPORT, Run

    path = out or run / REPORT
    write_report(Run.load(run), path)
    _say(path)


@app.command()
def why(
    run: RunPath,
    step: Annotated[
        int | None,
        typer.Option(help="The step; by default the first of the most severe status."),
    ] = None,
) -> None:
    """Say why a step of a run is what it is: what binds, and what would help."""
    from rmrc.record.run import Run
    from rmrc.runs.why import why as explain_step

    loaded = Run.load(run)
    number, explanation = explain_step(loaded, step)
    print(f"step {number} at {loaded.time[number]:.4g} s")
    print(explanation)


@app.command()
def bench(
    config: Annotated[
        Path | None,
        typer.Argument(metavar="CONFIG", help="A YAML configuration; by default, a small arm."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON.")] = False,
) -> None:
    """Measure this machine: how long a step takes, with each engine that is here."""
    import rmrc
    from rmrc.record.folder import json_text
    from rmrc.runs.bench import bench as measure

    found = measure(rmrc.load(config) if config else None)
    if as_json:
        print(json_text(found))
        return
    name = config or "an arm"
    _say(f"{name}: {found['dofs']} dofs, {found['tasks']} tasks, {found['steps']} steps")
    for engine, times in found["engines"].items():
        print(f"{engine:>12} {times['median_us']:8.1f} µs a step (p99 {times['p99_us']:.1f})")
    if found["native"]:
        print("native engine: installed")
    for notice in found["notices"]:
        _say(f"note: {notice}")


@app.command()
def render(
    run: RunPath,
    out: Annotated[Path, typer.Option("--out", "-o", help="A .png or .gif file.")],
) -> None:
    """Draw the robot: its last pose as PNG, or its motion as GIF."""
    from rmrc.record.render import render as render_run
    from rmrc.record.run import Run

    render_run(Run.load(run), out)
    _say(out)
