"""The commands: one function each, calling one library function."""

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from rmrc.cli.console import print_comparison, print_summary, progress_bar, say
from rmrc.errors import RmrcError

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
    with progress_bar(loaded.name) as progress:
        run = rmrc.solve(loaded, progress)
    folder = run.save(out) if out is not None else run.save_numbered("runs")
    if as_json:
        print(json_text({"run": str(folder), **run.summary}))
    else:
        print_summary(run.manifest, folder)
    kept = all(limit["max_violation"] == 0 for limit in run.summary["limits"].values())
    raise typer.Exit(0 if run.summary["converged"] and kept else NOT_CONVERGED)


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
    with progress_bar(config.stem) as progress:
        comparison = rmrc.compare(
            configs, _names(methods), _names(backends), _names(follow), progress
        )
    folder = comparison.save(out) if out else comparison.save_numbered("comparisons")
    if as_json:
        numbers = {"comparison": str(folder), **comparison.summary}
        print(json_text(numbers))
    else:
        print_comparison(comparison.config.name, comparison.summary, folder)
    raise typer.Exit(0 if comparison.finished else NOT_CONVERGED)


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
            say(f"{path}: ok")
            for line in lines:
                say(f"  {line}")
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
    say(path)


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
    say(f"{name}: {found['dofs']} dofs, {found['tasks']} tasks, {found['steps']} steps")
    for engine, times in found["engines"].items():
        print(f"{engine:>12} {times['median_us']:8.1f} µs a step (p99 {times['p99_us']:.1f})")
    if found["native"]:
        print("native engine: installed")
    for notice in found["notices"]:
        say(f"note: {notice}")


@app.command()
def render(
    run: RunPath,
    out: Annotated[Path, typer.Option("--out", "-o", help="A .png or .gif file.")],
) -> None:
    """Draw the robot: its last pose as PNG, or its motion as GIF."""
    from rmrc.record.render import render as render_run
    from rmrc.record.run import Run

    render_run(Run.load(run), out)
    say(out)
