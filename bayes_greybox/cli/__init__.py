"""The command bayes-greybox; JAX and all that needs it are imported inside the commands."""

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayes_greybox.running.errors import InputError

from . import options as o
from .ending import DONE, exit_code, log_to_stderr, run_app, show
from .options import ending

if TYPE_CHECKING:
    from bayes_greybox.config import Config

app = typer.Typer(
    name="bayes-greybox",
    epilog="Exit codes: 0 done, 2 bad input, 3 done but the sampler did not converge, 130 stopped.",
    # Typer completes words in bash, zsh, fish and PowerShell by itself; no other library is needed.
    add_completion=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code."""
    return run_app(app, "bayes-greybox", arguments)


def command() -> int:
    """Run the command of a process that ends with it, and return the exit code; `main` is for those that go on."""
    try:
        return main()
    finally:
        # Python's last search for garbage takes most of a second, and the system takes all memory back anyway.
        gc.freeze()


def _version(asked: bool | None) -> None:
    if asked:
        # Imported here because it is slow and seldom needed.
        from importlib.metadata import version

        typer.echo(f"bayes-greybox {version('bayes-greybox')}")
        raise typer.Exit()


@app.callback()
def _whole(
    version: Annotated[
        bool | None, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = None,
) -> None:
    """Find, name and add the physics a simulation is missing, with honest uncertainty."""


@app.command(epilog=ending("fit configs/first.toml", "report runs/first"))
def fit(
    config: o.ConfigFile, output: o.Output = None,
    seed: o.Seed = None, draws: o.Draws = None, tune: o.Tune = None, chains: o.Chains = None,
    resume: o.Resume = False, no_progress: o.NoProgress = False, quiet: o.Quiet = False, verbose: o.Verbose = 0,
) -> int:  # fmt: skip
    """Fit the model of a configuration file and write the results to a folder.

    The folder gets run.nc (the whole fit), summary.json (verdict, coefficients, discrepancy), the figures
    and a copy of the configuration, which can be run again where it lies. bayes-greybox report FOLDER writes its page.
    A run that was stopped goes on with --resume: its draws are those of a run that was not.
    """
    log_to_stderr(verbose)
    settings = _configured(config, seed=seed, draws=draws, tune=tune, chains=chains)
    progress = not (no_progress or quiet)
    with _starting(progress):
        from .fitting import fit_configured
    return fit_configured(settings, o.Run(output, progress, quiet, resume))


@app.command(epilog=ending("discover configs/discover_spring.toml", "next runs/discover_spring/study.nc"))
def discover(
    config: Annotated[Path | None, typer.Argument(help="Configuration file (TOML).")] = None,
    fleet: Annotated[
        Path | None,
        typer.Option(
            help="A folder of assets, to be studied one by one and put together: data files, all under CONFIG, or, "
            "without CONFIG, configuration files."
        ),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="With --fleet: processes of this machine; as many as cores by default.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="With --fleet: address of a Dask scheduler, such as tcp://host:8786.")
    ] = None,
    output: o.Output = None,
    seed: o.Seed = None, draws: o.Draws = None, tune: o.Tune = None, chains: o.Chains = None,
    resume: o.Resume = False, no_progress: o.NoProgress = False, quiet: o.Quiet = False, verbose: o.Verbose = 0,
) -> int:  # fmt: skip
    """Find which effect a simulation is missing, and where.

    The gap is measured before and after the effect is added, on held-out data where the file names some. The
    folder gets gap.html (the report), summary.json, study.nc (the study, and the extended model's posterior), the
    figures and a copy of the configuration.

    With --fleet every asset of a folder is studied, and fleet.html ranks them by their gap, groups them by what they
    lack, and says whether that is one cause. Assets that were studied before are not studied again.
    """
    log_to_stderr(verbose)
    progress, sampling = not (no_progress or quiet), {"seed": seed, "draws": draws, "tune": tune, "chains": chains}
    if fleet is not None:
        if resume:
            raise InputError("A fleet goes on with the assets that are left by itself: leave --resume out.")
        with _starting(progress):
            from .studying import study_folder
        tasks = {"workers": workers, "scheduler": scheduler}
        return study_folder(config, fleet, sampling, tasks, o.Run(output, progress, quiet))
    if config is None:
        raise InputError("Missing argument 'CONFIG': give a configuration file, or --fleet FOLDER for many assets.")
    if workers is not None or scheduler is not None:
        raise InputError("--workers and --scheduler are for a fleet: give --fleet FOLDER.")
    settings = _configured(config, **sampling)
    with _starting(progress):
        from .studying import study_configured
    return study_configured(settings, o.Run(output, progress, quiet, resume))


@app.command(epilog=ending("compare configs/compare_priors.toml", "report runs/compare_priors"))
def compare(
    files: Annotated[
        list[Path], typer.Argument(help="A configuration file with [models.NAME], or two or more saved fits (.nc).")
    ],
    output: o.Output = None,
    scheme: o.SchemeOption = None, block: o.BlockOption = None, max_refits: o.MaxRefits = None,
    seed: o.Seed = None, draws: o.Draws = None, tune: o.Tune = None, chains: o.Chains = None,
    resume: o.Resume = False, no_progress: o.NoProgress = False, quiet: o.Quiet = False, verbose: o.Verbose = 0,
) -> int:  # fmt: skip
    """Compare models by how well they predict data that are left out.

    The models of a configuration file are fitted first, and its folder gets NAME.nc for each of them,
    comparison.html (the report), summary.json, a figure and a copy of the configuration. Saved fits are compared
    as they are; the report and its like are written if --output is given.
    """
    log_to_stderr(verbose)
    sampling = {"seed": seed, "draws": draws, "tune": tune, "chains": chains}
    folds = _folds(scheme, block, max_refits)
    saved = all(file.suffix == ".nc" for file in files)
    if saved != (len(files) > 1):
        raise InputError("compare takes one configuration file, or two or more saved fits (*.nc).")
    progress = not (no_progress or quiet)
    with _starting(progress):
        from .comparing import compare_configured, compare_saved
    run = o.Run(output, progress, quiet, resume)
    if saved:
        given = [f"--{name}" for name, value in sampling.items() if value is not None] + ["--resume"] * resume
        if given:
            raise InputError(f"{given[0]} does not apply to saved fits, which are not sampled again; leave it out.")
        return compare_saved(files, folds, run)
    settings = _configured(files[0], **sampling).with_settings("compare", **folds)
    return compare_configured(settings, run)


@app.command(epilog=ending("report runs/discover_spring", "export runs/discover_spring/study.nc amended.c"))
def report(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="A saved fit or study (.nc), several fits to compare, or a folder that fit, discover or compare wrote."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o",
            help="The page to write, instead of FILE.html beside the file; in a folder run.html of a fit, gap.html of "
            "a study, comparison.html of a comparison, which is written here for several fits.",
        ),
    ] = None,
    scheme: o.SchemeOption = None, block: o.BlockOption = None, max_refits: o.MaxRefits = None,
    no_progress: o.NoProgress = False, quiet: o.Quiet = False, verbose: o.Verbose = 0,
) -> int:  # fmt: skip
    """Write the report of a saved fit, of a study or of a comparison, one HTML page.

    Several fits are compared first; a folder that fit, discover or compare wrote is shown as it is. The page holds
    all its figures and needs no network.
    """
    log_to_stderr(verbose)
    given = _folds(scheme, block, max_refits)
    if any(file.is_dir() for file in files) and len(files) > 1:
        raise InputError("report takes one saved fit or study (*.nc), several fits, or one folder of results.")
    if given and len(files) == 1:
        option = next(iter(given)).replace("_", "-")
        raise InputError(f"--{option} applies where several saved fits are compared; leave it out.")
    progress = not (no_progress or quiet)
    with _starting(progress, "Writing the report"):
        from bayes_greybox.report.folders.saved import saved_html

        fits, page = saved_html(files, output, given, progress=progress)
    show(page if quiet else f"The report is {page}.")
    return exit_code(fits)


@app.command(name="next", epilog=ending("next runs/discover_spring/study.nc --signal sine", "init new_run.csv"))
def next_(
    file: Annotated[Path, typer.Argument(help="Configuration file (TOML), or a saved study (.nc).")],
    signal: Annotated[list[str] | None, typer.Option(help="Family of signals; all by default.")] = None,
    amplitude: Annotated[
        list[float] | None, typer.Option(help="Over half the range in the data; half and all of it by default.")
    ] = None,
    batch: Annotated[int | None, typer.Option(min=1, help="Experiments to do together; 1 by default.")] = None,
    threshold: Annotated[
        float | None, typer.Option(min=0.0, help="Bits below which none is worth it; 0.05 by default.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the simulation.")] = 0,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Folder for the table and for figures of what is expected.")
    ] = None,
    no_progress: o.NoProgress = False, quiet: o.Quiet = False, verbose: o.Verbose = 0,
) -> int:  # fmt: skip
    """Say what to measure next, to tell the likely explanations of a study apart.

    A configuration is studied first, without sampling.
    """
    log_to_stderr(verbose)
    from .studying import next_configured

    options = {"signals": signal, "amplitudes": amplitude, "batch": batch, "threshold": threshold}
    return next_configured(file, options, seed, o.Run(output, not (no_progress or quiet), quiet))


@app.command(epilog=ending("export runs/discover_spring/study.nc amended.c", "report runs/discover_spring"))
def export(
    file: Annotated[Path, typer.Argument(metavar="RESULT", help="A saved fit or study (.nc).")],
    output: Annotated[
        Path, typer.Argument(metavar="OUTPUT", help="The file to write: .py (NumPy), .c (C99), .mo (Modelica) or .fmu.")
    ],
    quiet: o.Quiet = False, verbose: o.Verbose = 0,
) -> int:  # fmt: skip
    """Write the equations of a saved fit or study as a program, in the language that the file's ending names.

    It computes rates of change from states and inputs. Comments say what is known of its coefficients, and what is not
    in it.
    """
    log_to_stderr(verbose)
    from bayes_greybox.missing_effects import Study, load
    from bayes_greybox.report.exports.door import require_ending

    # A large result takes long to read.
    require_ending(output)
    result = load(file)
    result.export(output)
    show(output if quiet else f"The program is {output}.")
    fit = result.fit if isinstance(result, Study) else result
    return exit_code({} if fit is None else {file.stem: fit})


@app.command(context_settings={"ignore_unknown_options": True}, hidden=True)
def benchmark(words: Annotated[list[str] | None, typer.Argument(help="Arguments of a benchmark.")] = None) -> int:
    """Say where the benchmarks are."""
    asked = " ".join(words or ["--help"])
    raise InputError(f"The benchmarks are run from a checkout of the repository: python -m benchmarks {asked}")


@app.command(epilog=ending("init run.csv", "discover run.toml"))
def init(
    data: Annotated[Path, typer.Argument(help="A table: text, Excel, Parquet, netCDF, MATLAB or LabVIEW.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The file to write, instead of NAME.toml here.")
    ] = None,
    sep: Annotated[str | None, typer.Option(help="What separates the values, if it is not found.")] = None,
    decimal: Annotated[str, typer.Option(help="Decimal mark.")] = ".",
    thousands: Annotated[str | None, typer.Option(help="Mark between groups of digits, if it is not found.")] = None,
    skiprows: Annotated[int, typer.Option(min=0, help="Lines before the names of columns, if not found.")] = 0,
    encoding: Annotated[str, typer.Option(help="Encoding of text, such as latin-1.")] = "utf-8",
    sheet: Annotated[str | None, typer.Option(help="Sheet of an Excel file, the first by default.")] = None,
    dayfirst: Annotated[
        bool | None, typer.Option("--dayfirst/--monthfirst", help="Whether 03.04.2024 is in April, if it is not found.")
    ] = None,
) -> int:
    """Write a first configuration for a table, with comments.

    Title lines, a row of units, decimal commas and the encoding are found where they leave no doubt. What columns are
    is guessed from their names and behaviour, and said. What your simulation says and the units are to be filled in.
    """
    from bayes_greybox.config.starting.starter import starter
    from bayes_greybox.data.reading.door import layout_of
    from bayes_greybox.running.whole_files import write_text

    config = output or Path(f"{data.stem}.toml")
    if config.exists():
        raise InputError(f'"{config}" is there already; choose another name with --output.')
    layout = layout_of(
        sep=sep, decimal=decimal, thousands=thousands, skiprows=skiprows, encoding=encoding, sheet=sheet,
        dayfirst=dayfirst,
    )  # fmt: skip
    start = starter(data, config, layout)
    try:
        write_text(config, start.text)
    except OSError as error:
        raise InputError(f'"{config}" cannot be written ({error.strerror}); choose another with --output.') from None
    typer.echo("\n".join(start.summary))
    return DONE


@app.command(epilog=ending("schema > bayes-greybox.schema.json", "init run.csv"))
def schema() -> int:
    """Print the JSON schema of configuration files, for editors that complete and check keys."""
    import json

    from bayes_greybox.config.schema import json_schema

    typer.echo(json.dumps(json_schema(), indent=2))
    return DONE


@app.command(epilog=ending("datasets", "init run.csv"))
def datasets() -> int:
    """List the measured benchmark data sets and where they were found."""
    from bayes_greybox.data.datasets import dataset_table
    from bayes_greybox.report.terminal.tables import datasets_table

    show(datasets_table(dataset_table()))
    return DONE


@contextmanager
def _starting(progress: bool, text: str = "Starting") -> Iterator[None]:
    """Show what a command does, by default that it starts, while its modules are imported."""
    from bayes_greybox.running.stages import stage, stages

    with stages(progress), stage(text, said=False):
        yield


def _folds(scheme: o.Scheme | None, block: int | None, max_refits: int | None) -> dict[str, Any]:
    folds = {"scheme": scheme and scheme.value, "block": block, "max_refits": max_refits}
    return {name: value for name, value in folds.items() if value is not None}


def _configured(file: Path, **sampling: int | None) -> "Config":
    from bayes_greybox.config import load_config

    return load_config(file).with_settings("sampling", **sampling)
