"""The command line: it parses, calls a command and prints."""

from __future__ import annotations

import gc
import json
import os
import shlex
import sys
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import bayesfric
from bayesfric.errors import BadInput, Interrupted
from bayesfric.estimates.methods import ESTIMATORS
from bayesfric.progress import Spent, progress_shown
from bayesfric.threads import QUIET

if TYPE_CHECKING:
    from bayesfric.config import Config
    from bayesfric.model import Model

# Commands import what they need when they run, so that --help answers at once.
app = typer.Typer(
    help="What a measured motor torque says about a joint: inertia, friction and gearbox "
    "losses, as posteriors.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)

ConfigFile = Annotated[Path, typer.Argument(metavar="CONFIG", help="configuration (TOML)")]
AsJson = Annotated[bool, typer.Option("--json", help="print the machine-readable form")]
Seed = Annotated[
    int | None, typer.Option(min=0, max=2**63 - 1, help="replaces the configuration's seed")
]
Force = Annotated[bool, typer.Option("--force", help="keep an old run under another name")]
OutputError = Annotated[
    bool, typer.Option("--output-error", help="with the output-error estimate, which simulates")
]
Resume = Annotated[bool, typer.Option("--resume", help="go on with an interrupted run")]
Paper = Annotated[
    bool,
    typer.Option("--paper", help="with figures as PDF and PNG, and LaTeX; report adds them later"),
]
Verbose = Annotated[
    bool, typer.Option("--verbose", help="print how each number was made, and every finding")
]
RunOption = Annotated[Path | None, typer.Option("-o", "--output", help="run directory to make")]

BAD_INPUT, NOT_CONVERGED, INTERRUPTED = 2, 3, 130


@app.callback(invoke_without_command=True)
def _version(
    version: Annotated[bool, typer.Option("--version", help="print the version")] = False,
) -> None:
    if version:
        print(bayesfric.__version__)
        raise typer.Exit


@app.command()
def init(
    preset: Annotated[
        str | None, typer.Argument(help="rabbit-knee, motor-axis, servo-pendulum; or fleet")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="file to write; printed if left out")
    ] = None,
    log: Annotated[
        Path | None,
        typer.Option("--from", metavar="LOG", help="take this recording's columns by their names"),
    ] = None,
    table: Annotated[
        str | None, typer.Option(help="with --from: table, group or topic inside the file")
    ] = None,
    joint: Annotated[str | None, typer.Option(help="with --from: which joint of several")] = None,
    all_keys: Annotated[
        bool, typer.Option("--all-keys", help="every key, its type, default, unit and meaning")
    ] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="the JSON schema by which editors complete keys")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="replace the file to write")] = False,
    as_json: AsJson = False,
) -> None:
    """Write a commented configuration."""
    from bayesfric.commands.init import configuration
    from bayesfric.commands.init_fleet import FLEET, fleet_plan
    from bayesfric.commands.init_from import configuration_from, open_text
    from bayesfric.commands.keys import reference_text, schema_hint
    from bayesfric.report.files import write_beside

    found = None
    asked = "--schema" if schema else "--all-keys" if all_keys else ""
    if schema and all_keys:
        raise BadInput("--all-keys", "is beside --schema", "ask for one")
    if force and output is None:
        raise BadInput("--force", "replaces a file", "name it with -o")
    if log is not None and (asked or preset == FLEET):
        raise BadInput(asked or FLEET, "takes no log", "leave --from out")
    if log is not None:
        found = configuration_from(log, preset, output, table=table, joint=joint)
    elif table is not None or joint is not None:
        key = "--table" if table is not None else "--joint"
        raise BadInput(key, "is for a log", "add --from LOG")
    elif preset is None and not asked:
        raise BadInput("PRESET", "is missing", "name one, or a log with --from LOG")
    if asked:
        text = reference_text(preset, schema=schema, option=asked)
    elif preset == FLEET:
        text = fleet_plan()
    else:
        text = configuration(preset or "") if found is None else found["text"]
    if output is not None:
        write_beside({output: text}, replace=force)
    written = [f"Written to {output}"] if output else [text]
    _print(
        {**(found or {}), "written": str(output) if output else None, "text": text},
        as_json,
        [
            *written,
            *(open_text(found) if found and output else ()),
            *(schema_hint(output) if schema and output else ()),
        ],
    )


@app.command()
def simulate(
    config: ConfigFile,
    output: Annotated[Path, typer.Option("-o", "--output", help="CSV file to write")],
    seed: Seed = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a recording from known parameters; the truth is saved beside it."""
    from bayesfric.commands.simulate import simulate as run
    from bayesfric.config import read_config

    truth = run(read_config(config), output, seed=seed)
    lines = [f"Simulated recording written to {output}, truth beside it as .truth.json"]
    _print(truth, as_json, lines)


@app.command()
def check(config: ConfigFile, verbose: Verbose = False, as_json: AsJson = False) -> None:
    """Read everything; print what is measured, its quality and its problems."""
    from bayesfric.checked import check as run

    found = run(config)
    _print(found.as_json(), as_json, found.text(verbose=verbose).splitlines())


if TYPE_CHECKING:
    MethodChoice = str
    _ALL = "all"
else:
    MethodChoice = StrEnum("MethodChoice", {name: name for name in (*ESTIMATORS, "all")})
    _ALL = MethodChoice("all")


@app.command()
def estimate(
    config: ConfigFile,
    method: Annotated[MethodChoice, typer.Option(help="which of the paper's methods")] = _ALL,
    as_json: AsJson = False,
) -> None:
    """Point estimates by the paper's methods, with standard deviations."""
    from bayesfric.commands.estimate import estimate_record, estimate_text

    model = _model(config)
    wanted = [name for name in ESTIMATORS if method in ("all", name)]
    with progress_shown(sys.stderr.isatty()) as progress:
        found = model.estimates(wanted, progress=progress)
    _print(estimate_record(found, model), as_json, estimate_text(found, model))


@app.command()
def identify(
    config: ConfigFile,
    advise: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="rank what to record next to know this parameter or quantity"
        ),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", help="CSV for the best excitation; advice-NAME.csv if left out"
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="replace that CSV")] = False,
    as_json: AsJson = False,
) -> None:
    """Tell what these recordings can and cannot determine, and what would help."""
    from bayesfric.commands.identify import identify_record, identify_text

    if advise is not None:
        _advise(config, advise, output, force, as_json)
        return
    if output is not None or force:
        raise BadInput(
            "--output" if output is not None else "--force",
            "is for the excitation that --advise finds",
            "add --advise NAME",
        )
    model = _model(config)
    with progress_shown(sys.stderr.isatty()) as progress:
        found = model.identification(progress=progress)
    _print(identify_record(found, model), as_json, identify_text(found, model))


@app.command()
def explain(
    config: ConfigFile,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="BETTER.toml: the configuration with what explains the torque put in",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Tell what else explains the torque, judged by recordings simulated from the model."""
    from bayesfric.commands import explain as command

    model = _model(config)
    if output is None:
        with progress_shown(sys.stderr.isatty()) as progress:
            found = model.explain(progress=progress)
        record, text = command.explain_record(found, model), command.explain_text(found, model)
    else:
        from bayesfric.report.files import write_beside

        command.refuse_other_place(output, model)
        with progress_shown(sys.stderr.isatty()) as progress:
            better, taken, left = model.completed(progress=progress)
        write_beside({output: better.config.text})
        record = command.completed_record(better, taken, left, output)
        text = command.explain_text(left, better, taken, output)
    _print(record, as_json, text)


@app.command()
def pool(config: ConfigFile, seed: Seed = None, as_json: AsJson = False) -> None:
    """Say what recordings of which some parameters differ tell together, and of the next one."""
    from bayesfric.report.text_templates import filled

    model = _model(config)
    with progress_shown(sys.stderr.isatty()) as progress:
        found = model.pool(seed=seed, progress=progress)
    _print(found.as_json(), as_json, filled("pool.txt.j2", found=found).splitlines())
    if found.status != "reliable":
        raise typer.Exit(NOT_CONVERGED)


def _advise(config: Path, name: str, output: Path | None, force: bool, as_json: bool) -> None:
    from bayesfric.commands.identify import advice_file, advice_record, advice_text, write_advice

    model = _model(config)
    path = advice_file(name, output, force=force)
    with progress_shown(sys.stderr.isatty()) as progress:
        found = model.advise(name, progress=progress)
    written = write_advice(found, path, model, force=force)
    record = advice_record(found, model, path if written else None)
    _print(record, as_json, advice_text(found, model, path, written=written))


@app.command()
def fit(
    config: ConfigFile,
    output: RunOption = None,
    seed: Seed = None,
    resume: Resume = False,
    force: Force = False,
    output_error: OutputError = False,
    paper: Paper = False,
    verbose: Verbose = False,
    as_json: AsJson = False,
) -> None:
    """Sample the posterior and write the run directory."""

    def read() -> Config:
        from bayesfric.config import read_config

        return read_config(config)

    _fit(
        read,
        output or Path(f"{config.stem}-run"),
        as_json,
        verbose=verbose,
        seed=seed,
        resume=resume,
        force=force,
        output_error=output_error,
        paper=paper,
    )


@app.command()
def demo(
    output: RunOption = None,
    seed: Seed = None,
    resume: Resume = False,
    force: Force = False,
    paper: Paper = False,
    verbose: Verbose = False,
    as_json: AsJson = False,
) -> None:
    """Fit the packaged knee: a recording SIMULATED from Table 3 of the paper."""

    def read() -> Config:
        from bayesfric.commands.fit import demo_config

        return demo_config()

    output = output or Path("demo-run")
    remark = "The demo recording is simulated, from Table 3 of the paper."
    options: dict[str, Any] = {"seed": seed, "resume": resume, "force": force, "paper": paper}
    _fit(read, output, as_json, remark, verbose=verbose, **options)


@app.command()
def report(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="run directory")],
    paper: Annotated[
        bool, typer.Option("--paper", help="with figures as PDF and PNG, drawn anew, and LaTeX")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Make the page and the tables of a finished run again."""
    from bayesfric.commands.report import report as make

    with progress_shown(sys.stderr.isatty()) as progress:
        found = make(run, paper=paper, progress=progress)
    _print(found, as_json, [f"Written to {run}: {', '.join(found['written'])}"])


@app.command()
def rollout(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="run directory")],
    config: Annotated[
        Path | None,
        typer.Argument(metavar="CONFIG", help="other recordings (TOML); the run's if left out"),
    ] = None,
    draws: Annotated[int, typer.Option(min=2, max=10_000, help="of the posterior")] = 100,
    every: Annotated[
        bool, typer.Option("--all", help="what was fitted, too, where some was held out")
    ] = False,
    seed: Seed = None,
    as_json: AsJson = False,
) -> None:
    """Play recordings to the joint: how far its simulated motion is from the measured one."""
    from bayesfric.commands.rollout import rollout as play
    from bayesfric.commands.rollout import rollout_text

    with progress_shown(sys.stderr.isatty()) as progress:
        found = play(run, config, draws=draws, seed=seed, every=every, progress=progress)
    written = f"Added to {run}: report.html, figures/rollout.pdf, summary.json"
    _print(found.as_dict(), as_json, [*rollout_text(found), written])


@app.command()
def export(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="run directory")],
    to: Annotated[
        str,
        typer.Option(
            metavar="FORMAT",
            help="mujoco, urdf, sdf, drake, pinocchio, isaac, bam, csv, parquet, npz, c or python",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="folder to make, or main file; RUN-FORMAT if left out"),
    ] = None,
    joint: Annotated[
        str | None, typer.Option(metavar="NAME", help="what the simulator calls the joint")
    ] = None,
    at_load: Annotated[
        float | None,
        typer.Option(
            metavar="TORQUE",
            help="N m at the joint, at which a constant loss stands for a load loss; the mean of "
            "the recordings if left out",
        ),
    ] = None,
    into: Annotated[
        Path | None, typer.Option(metavar="MODEL", help="mujoco: model whose joint is changed")
    ] = None,
    damping_terms: Annotated[
        int | None, typer.Option(help="mujoco: 3 numbers of damping (from 3.7 on), or 1")
    ] = None,
    isaac_sim: Annotated[
        str | None, typer.Option(metavar="VERSION", help="isaac: 5.0 or 4.5")
    ] = None,
    actuator: Annotated[
        str | None, typer.Option(metavar="NAME", help="bam: its name of the actuator")
    ] = None,
    draws: Annotated[
        int | None, typer.Option(help="csv, parquet, npz: how many draws, a row each")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="csv, parquet, npz: of which draws")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="keep an old export aside")] = False,
    as_json: AsJson = False,
) -> None:
    """Put a finished run into a simulator's files, and say what these cannot carry."""
    from bayesfric.commands.export import export_run

    found, written = export_run(
        run,
        to,
        output,
        force=force,
        joint=joint,
        at_load=at_load,
        into=into,
        damping_terms=damping_terms,
        isaac_sim=isaac_sim,
        actuator=actuator,
        draws=draws,
        seed=seed,
    )
    lines = [*found.text().splitlines(), "", f"Written: {', '.join(written)}"]
    _print(found.as_json(), as_json, lines)


@app.command()
def compare(
    runs: Annotated[list[Path], typer.Argument(metavar="RUN", help="run directories")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", help="folder to make: page, tables, forest figure"),
    ] = None,
    estimates: Annotated[
        bool, typer.Option("--estimates", help="with several runs: their point estimates too")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Put runs side by side, or the methods and the posterior of one run."""
    from bayesfric.commands.compare import compare as run
    from bayesfric.report.comparison.table import comparison_dict, comparison_text

    found = run(runs, output, estimates=estimates or None)
    written = [f"Written to {output}"] if output else []
    _print(comparison_dict(found), as_json, [*comparison_text(found), *written])


@app.command()
def fleet(
    plan: Annotated[Path, typer.Argument(metavar="FLEET", help="template and units (TOML)")],
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="folder to make; FLEET-fleet if left out")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="processes; as many as cores if left out")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="of a running Dask scheduler")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="do what is missing, or has changed since")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Fit many units by one template, and say what population they are."""
    from bayesfric.commands.fleet import fleet as run
    from bayesfric.commands.fleet import fleet_text

    try:
        with progress_shown(sys.stderr.isatty()) as progress:
            found = run(
                plan,
                output or Path(f"{plan.stem}-fleet"),
                workers=workers,
                scheduler=scheduler,
                resume=resume,
                progress=progress,
            )
    except Interrupted as stopped:
        raise _Stopped(stopped) from None
    _print(found.as_json(), as_json, fleet_text(found))
    if found.left:
        raise typer.Exit(NOT_CONVERGED)


def _fit(
    config: Callable[[], Config],
    folder: Path,
    as_json: bool,
    remark: str = "",
    *,
    verbose: bool = False,
    **options: Any,
) -> None:
    spent = Spent()  # before what it imports, which takes time, too
    from bayesfric.report.second_process import second_process

    with second_process(), ExitStack() as bars:
        from bayesfric.commands.fit import fit as run
        from bayesfric.commands.fit import fit_text

        show = bars.enter_context(progress_shown(sys.stderr.isatty()))

        def tell(found: Any) -> None:
            nonlocal show
            bars.close()  # it would stand amid the numbers
            if remark:
                print(remark, file=sys.stderr)
            if not as_json:
                _print(found, as_json, fit_text(found, verbose=verbose))
            show = bars.enter_context(progress_shown(sys.stderr.isatty()))

        try:
            summary = run(config(), folder, progress=lambda x: show(x), found=tell, **options)
        except Interrupted as stopped:
            raise _Stopped(stopped) from None
    _print(summary, as_json, ["", f"{folder / 'report.html'}   in all {spent}"])
    if summary["sampler"]["status"] != "reliable":
        raise typer.Exit(NOT_CONVERGED)


class _Stopped(Exception):
    """An interruption with something to tell; typer would end on its own on a KeyboardInterrupt."""

    def __init__(self, stopped: Interrupted) -> None:
        self.code = 128 + stopped.signal
        text = "interrupted, nothing was written"
        if stopped.kept:
            again = [word for word in sys.argv[1:] if word not in ("--resume", "--force")]
            command = shlex.join(["bayesfric", *again, "--resume"])
            text = f"interrupted, {stopped.kept} kept; go on with: {command}"
        super().__init__(text)


def _model(config: Path) -> Model:
    from bayesfric.model import Model

    return Model.from_config(config)


def _print(found: Any, as_json: bool, lines: Any) -> None:
    if as_json:
        lines = [json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False)]
    try:
        for line in lines:
            print(line)
        sys.stdout.flush()
    except BrokenPipeError:
        # who reads has read enough, as head does; what is to be made is made all the same
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main() -> None:
    """Run the command line; bad input ends with one line and exit code 2."""
    if not sys.warnoptions:
        # libraries' remarks to programmers; python -W brings them back
        warnings.simplefilter("ignore")
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)  # before NumPy is there to read it
    try:
        app(prog_name="bayesfric")
    except BadInput as error:
        print(f"bayesfric: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except _Stopped as stopped:
        print(f"bayesfric: {stopped}", file=sys.stderr)
        sys.exit(stopped.code)
    except (KeyboardInterrupt, SystemExit) as end:
        # typer turns the first into the second
        if isinstance(end, SystemExit) and end.code != INTERRUPTED:
            raise
        print("bayesfric: interrupted, nothing was written", file=sys.stderr)
        sys.exit(INTERRUPTED)
    finally:
        gc.freeze()  # or Python looks for garbage once more before it ends: 0.4 s
        # A KeyboardInterrupt that went through an exec of text, as in an import of a dataclass,
        # makes ``python -m`` end by SIGINT whatever its exit code (CPython's run_eval_code_obj);
        # the next exec of text takes that back.
        exec("")


if __name__ == "__main__":
    main()
