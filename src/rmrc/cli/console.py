"""What a terminal shows: summaries, tables, a progress bar."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape as escape_markup
from rich.table import Table

from rmrc.errors import printable


def say(text: object) -> None:
    """Print a text, which may hold names of the model or of files, on a line of its own."""
    print(printable(str(text)))


def escape(text: str) -> str:
    """Return text as rich shows it, neither as markup nor as what a terminal would obey."""
    return escape_markup(printable(text))


@contextmanager
def progress_bar(name: str) -> Iterator[Callable[[int, int], None] | None]:
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
        task = bar.add_task(escape(name))
        yield lambda done, count: bar.update(task, completed=done, total=count)


def print_summary(manifest: dict[str, Any], folder: Path) -> None:
    """Print what a run came to: a row a task, limits that were passed, the verdict."""
    console, summary = Console(highlight=False), manifest["summary"]
    table = Table(title=escape(manifest["name"]), title_justify="left", show_edge=False)
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
        console.print(f"[dim]note: {escape(notice)}[/]")
    console.print(
        f"run folder: {escape(str(folder))} · look at {escape(str(folder / 'report.html'))}",
        soft_wrap=True,
    )


def _passed(limit: dict[str, Any]) -> str:
    """Return how far a limit is passed, and by which joint."""
    joint = f" ({escape(limit['joint'])})" if limit.get("joint") else ""
    return f"{limit['max_violation']:.3g} {limit['unit']}{joint}"


def _add_task(table: Table, name: str, numbers: dict[str, Any]) -> None:
    values = (f"{numbers[key]:.3g}" for key in ("rms", "max", "final"))
    table.add_row(escape(name), *values, numbers["unit"])


def print_comparison(name: str, summary: dict[str, Any], folder: Path) -> None:
    """Print the table of a comparison, and what was left out of it."""
    from rmrc.record.overlay import table
    from rmrc.runs.compare import PAGE

    console = Console(highlight=False)
    head, rows = table(summary, whole=False)
    shown = Table(title=escape(name), title_justify="left", box=None, padding=(0, 1, 0, 0))
    for title, *cells in zip(head, *rows, strict=True):
        texts = (printable(text) for text in (title, *(cell.text for cell in cells)))
        words = [word for text in texts for word in text.split()]
        # The last column, of the statuses, takes what is left of the width.
        width = max(map(len, words)) if title != head[-1] else None
        shown.add_column(escape(title), overflow="fold", width=width)
    for row in rows:
        shown.add_row(*(f"[red]{escape(c.text)}[/]" if c.bad else escape(c.text) for c in row))
    console.print(shown)
    for left_out in summary["left_out"]:
        console.print(
            f"[dim]{escape(left_out['name'])} is left out: {escape(left_out['reason'])}[/]"
        )
    if summary["interrupted"]:
        console.print("[yellow]interrupted: this is what was done so far[/]")
    console.print(f"comparison: {escape(str(folder))} · look at {escape(str(folder / PAGE))}")
