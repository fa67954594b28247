"""Commands that run a Monte Carlo study, and show what its store holds.

Everything heavy is imported inside the functions, as in the other commands.
"""

import contextlib
import sys
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import click

from .json_text import json_text
from .option_values import quiet_option, refuse
from .output_files import check_targets, force_option, telling_of_files
from .preparation import BAD_INPUT, STOPPED_EARLY, Positive, start_jax

_INTERRUPTED = 130  # as a shell says of Ctrl-C


@click.command("monte-carlo")
@click.argument("study")
@click.option("--size", type=click.IntRange(min=1), help="Members; the file's else.")
@click.option("--seed", type=click.IntRange(min=0), help="Of the random numbers.")
@click.option(
    "--sampling",
    type=click.Choice(["plain", "latin", "sobol"]),
    help="Independent members, Latin hypercubes, or scrambled Sobol sequences.",
)
@click.option("--store", type=click.Path(), help="Folder of a Zarr store to write.")
@click.option("--resume", is_flag=True, help="Go on with a store that is there.")
@click.option("--block", type=click.IntRange(min=1), help="Members of a chunk.")
@click.option("--workers", type=click.IntRange(min=1), help="Blocks at a time.")
@click.option("--processes", is_flag=True, help="Compute in processes, not threads.")
@click.option("--cluster", metavar="ADDRESS", help="Of a Dask scheduler.")
@click.option("--shard", metavar="I/N", help="Only every N-th block, from the I-th.")
@click.option(
    "--precision",
    multiple=True,
    metavar="NAME=HALF_WIDTH",
    help="Stop where the interval of NAME is as short, or at --size.",
)
@click.option("--json", "as_json", is_flag=True, help="Print statistics as JSON.")
@click.option("--plot", type=click.Path(), help="Picture: histograms, probabilities.")
@force_option
@quiet_option
@click.pass_context
def monte_carlo(
    ctx: click.Context,
    study: str,
    store: str | None,
    resume: bool,
    as_json: bool,
    plot: str | None,
    force: bool,
    quiet: bool,
    **options: Any,
) -> None:
    """Run STUDY, a TOML file of what varies and what is looked at.

    \b
    rollkane monte-carlo study.toml --size 100000 --store study.zarr

    What a killed process has done stays in the store, and --resume goes on to the same
    bytes. Exit code 0: done; 2: bad input, nothing changed; 3: every motion failed;
    130: Ctrl-C.
    """
    targets = {} if plot is None else {"plot": Path(plot)}
    check_targets(targets, study, force=force)
    if resume and store is None:
        refuse("--resume", "needs the --store that is gone on with")
    if store is not None and not Path(store).resolve().parent.is_dir():
        folder = Path(store).resolve().parent
        refuse("--store", f"the folder {folder} does not exist; make it first")
    shard = _shard(options.pop("shard"))
    wanted = _precisions(options.pop("precision"))
    start_jax()
    file = _loaded(ctx, study)
    size = options.pop("size") or file.size
    if size is None:
        refuse("--size", "is needed: neither it nor size in the file says how many")
    found = _run(ctx, file, size, store, resume, shard, wanted, quiet, options)
    _show(found, file.title, as_json, quiet)
    with telling_of_files():
        for target in targets.values():
            found.plot(target, file.title)
            _tell(f"  wrote {target}", quiet or as_json)
    if found.size and found.failed == found.size:
        click.echo("error: every motion failed", err=True)
        ctx.exit(STOPPED_EARLY)


@click.command()
@click.argument("store")
@click.option("--json", "as_json", is_flag=True, help="Print statistics as JSON.")
@click.option("--plot", type=click.Path(), help="Picture: histograms, probabilities.")
@force_option
@click.pass_context
def show(
    ctx: click.Context, store: str, as_json: bool, plot: str | None, force: bool
) -> None:
    """Print what STORE holds, the folder that `monte-carlo --store` wrote.

    Every block is checked against its checksum. Exit code 0: all blocks are there; 2:
    no store; 3: some are not, or are damaged, and are left out.
    """
    targets = {} if plot is None else {"plot": Path(plot)}
    check_targets(targets, store, force=force)

    from ..uncertainty.result import read_study
    from ..uncertainty.store import StoreError
    from ..validation.checks import FieldError

    try:
        found = read_study(store)
    except (StoreError, FieldError, ImportError) as refused:
        click.echo(f"error: {refused}", err=True)
        ctx.exit(BAD_INPUT)
    _show(found, str(store), as_json, quiet=False)
    with telling_of_files():
        for target in targets.values():
            found.plot(target, str(store))
            _tell(f"  wrote {target}", as_json)
    if not found.complete:
        click.echo("error: blocks are missing; go on with --resume", err=True)
        ctx.exit(STOPPED_EARLY)


def _tell(line: str, quiet: bool) -> None:
    if not quiet:
        click.echo(line)


def _shard(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    first, slash, last = text.partition("/")
    if not slash or not first.isdigit() or not last.isdigit():
        refuse("--shard", f"{text!r} is not I/N, such as 1/8")
    return int(first), int(last)


def _precisions(given: tuple[str, ...]) -> dict[str, float]:
    found: dict[str, float] = {}
    for one in given:
        name, equals, text = one.rpartition("=")
        if not equals or not name.strip():
            refuse("--precision", f"{one!r} is not NAME=HALF_WIDTH")
        if name.strip() in found:
            refuse("--precision", f"names {name.strip()} twice")
        try:
            found[name.strip()] = Positive().convert(text, None, None)
        except click.BadParameter as refused:
            refuse("--precision", f"{one!r}: {refused.message}")
    return found


def _loaded(ctx: click.Context, study: str) -> Any:
    from ..files.scene_files import SceneFileError
    from ..uncertainty.study_file import load_study

    try:
        return load_study(study)
    except SceneFileError as error:
        count = len(error.problems)
        click.echo(str(error), err=True)
        click.echo(f"{count} error{'s' if count > 1 else ''} in {study}", err=True)
        ctx.exit(BAD_INPUT)


def _run(
    ctx: click.Context,
    file: Any,
    size: int,
    store: str | None,
    resume: bool,
    shard: tuple[int, int] | None,
    wanted: dict[str, float],
    quiet: bool,
    options: dict[str, Any],
) -> Any:
    """The study's result, or a sentence and the end of the command."""
    from ..uncertainty.monte_carlo import monte_carlo as run
    from ..uncertainty.precision import Precision
    from ..uncertainty.store import StoreError
    from ..validation.checks import FieldError

    processes, cluster = options.pop("processes"), options.pop("cluster")
    if processes and cluster:
        refuse("--cluster", "cannot be given with --processes")
    given = {"seed": file.seed, "sampling": file.sampling, "block": file.block}
    options = {name: value for name, value in options.items() if value is not None}
    target = f" {store}" if store else ""
    try:
        with _progress(quiet) as progress, telling_of_files(target):
            return run(
                file.study,
                size,
                store=store,
                resume=resume,
                executor="processes" if processes else cluster,
                shard=shard,
                stop=[Precision(*one) for one in wanted.items()] or None,
                progress=progress,
                **(given | options),
            )
    except (FieldError, StoreError, ImportError) as refused:
        click.echo(f"error: {refused}", err=True)
        ctx.exit(BAD_INPUT)
    except KeyboardInterrupt:
        kept = "go on with --resume" if store else "nothing was kept without --store"
        click.echo(f"stopped: {kept}", err=True)
        ctx.exit(_INTERRUPTED)


@contextlib.contextmanager
def _progress(quiet: bool) -> Generator[Callable[[Any], None] | None, None, None]:
    """A bar with rate, time left and failures, where someone sees it."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    try:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
    except ImportError:  # of an extra: a study runs without it
        yield None
        return
    shown = TextColumn("{task.fields[rate]}"), TextColumn("{task.fields[failed]}")
    columns = BarColumn(), TextColumn("{task.percentage:>3.0f} %"), *shown
    console = Console(stderr=True)
    with Progress(*columns, TimeRemainingColumn(), console=console) as bar:
        task = bar.add_task("", rate="compiling", failed="")

        def told(done: Any) -> None:
            failed = f"{done.failed:,} failed" if done.failed else ""
            rate = f"{done.rate:,.0f} motions/s"
            how = {"total": done.size, "completed": done.members}
            bar.update(task, **how, rate=rate, failed=failed)

        yield told


def _show(found: Any, title: str, as_json: bool, quiet: bool) -> None:
    if as_json:
        click.echo(json_text(found.to_dict()))
    elif not quiet:
        click.echo(title)
        click.echo(str(found))
