"""The command line: it parses, calls a command and prints."""

from __future__ import annotations

import ctypes
import gc
import io
import json
import math
import os
import shlex
import signal
import sys
import warnings
from collections.abc import Iterable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Argument, Option

from bayesfric.base import LINEAR_ALGEBRA_THREADS, __version__
from bayesfric.base.errors import BadInput, Interrupted
from bayesfric.base.progress import Timer, progress_shown, time_text
from bayesfric.estimates import METHODS

if TYPE_CHECKING:
    from bayesfric.fit.model import Model

# Commands import what they need when they run, so that --help answers at once.
app = typer.Typer(
    help="What a measured motor torque says about a joint: inertia, friction and gearbox "
    "losses, as posteriors.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
    rich_markup_mode=None,
)

ConfigFile = Annotated[Path, Argument(metavar="CONFIG", help="configuration (TOML)")]
RunFolder = Annotated[Path, Argument(metavar="RUN", help="run directory")]
AsJson = Annotated[bool, Option("--json", help="print the machine-readable form")]
Seed = Annotated[int | None, Option(min=0, max=2**63 - 1, help="replaces the configuration's")]
Force = Annotated[bool, Option("--force", help="replace an old run")]
OutputError = Annotated[bool, Option("--output-error", help="with that estimate; it simulates")]
Paper = Annotated[bool, Option("--paper", help="with figures as PDF and PNG, and LaTeX")]
Verbose = Annotated[bool, Option("--verbose", help="print how numbers were made, all findings")]
OUTPUT = ("-o", "--output")
RunOption = Annotated[Path | None, Option(*OUTPUT, help="run directory to make")]


FORMATS = "mujoco, urdf, sdf, drake, pinocchio, isaac, bam, ros2-control, csv, c or python"
DEMO = "The demo recording is simulated, from Table 3 of the paper."
BAD_INPUT, NOT_CONVERGED, INTERRUPTED = 2, 3, 130


@app.callback(invoke_without_command=True)
def _version(version: bool = Option(False, "--version", help="print the version")) -> None:
    if version:
        print(__version__)
        raise typer.Exit


def _progress() -> Any:
    """Show a bar where someone sees it."""
    return progress_shown(sys.stderr.isatty())


@app.command()
def init(
    preset: str | None = Argument(None, help="rabbit-knee, motor-axis, servo-pendulum, fleet, arm"),
    output: Path | None = Option(None, *OUTPUT, help="file to write"),
    log: Path | None = Option(None, "--from", metavar="LOG", help="recording, columns by name"),
    table: str | None = Option(None, help="with --from: table, group or topic in it"),
    joint: str | None = Option(None, help="with --from: which joint of several"),
    file_format: str | None = Option(None, "--format", help="with --from: csv, hdf5, ros, ..."),
    skip_rows: int | None = Option(None, help="with --from: lines above the table of a text"),
    decimal: str | None = Option(None, help="with --from: decimal mark of a text"),
    urdf: Path | None = Option(None, metavar="ROBOT.urdf", help="of an arm"),
    all_keys: bool = Option(False, "--all-keys", help="every key, its type and meaning"),
    schema: bool = Option(False, "--schema", help="the JSON schema, for editors"),
    force: bool = Option(False, "--force", help="replace the file to write"),
    as_json: AsJson = False,
) -> None:
    """Write a commented configuration."""
    from bayesfric.base.atomic_write import write_files
    from bayesfric.commands.init import columns_text, draft_configuration, open_text

    reference = "--schema" if schema else "--all-keys" if all_keys else None
    if reference and (log or (schema and all_keys)):
        raise BadInput(reference, "was given with --from or --all-keys", "give one of them")
    keys = {"format": file_format, "skip_rows": skip_rows, "decimal": decimal, "table": table}
    layout = {key: value for key, value in keys.items() if value is not None}
    if log is None and (layout or joint):
        option = next(iter(layout), "joint").replace("_", "-")
        raise BadInput(f"--{option}", "is for a log", "add --from LOG")
    output = None if output == Path("-") else output
    draft = draft_configuration(
        preset, log, output, reference=reference, layout=layout, joint=joint, urdf=urdf
    )
    columns = columns_text(draft)
    lines = [*(f"# {line}".rstrip() for line in columns), draft["text"]]
    if output is not None:
        write_files({output: draft["text"]}, replace=force)
        lines = [*columns, f"Written to {output}", *open_text(draft)]
    if schema and output:
        lines += [f"Editors with Taplo use it in files that begin with: #:schema ./{output.name}"]
    _print({**draft, "written": str(output) if output else None}, as_json, lines)


@app.command()
def simulate(
    config: ConfigFile,
    output: Path = Option(..., *OUTPUT, help="CSV file to write"),
    seed: Seed = None,
    as_json: AsJson = False,
) -> None:
    """Simulate a recording from known parameters; save these next to it."""
    from bayesfric.commands.simulate import simulate as run
    from bayesfric.problem.config import read_config

    truth = run(read_config(config), output, seed=seed)
    lines = [f"Simulated recording written to {output}, truth next to it as .truth.json"]
    _print(truth, as_json, lines)


@app.command()
def check(config: ConfigFile, verbose: Verbose = False, as_json: AsJson = False) -> None:
    """Read everything; print what is measured, its quality and its problems."""
    from bayesfric.fit.check_report import check as run

    checked = run(config)
    _print(checked.as_json(), as_json, checked.text(verbose=verbose).splitlines())


@app.command()
def estimate(
    config: ConfigFile,
    method: str = Option("all", help=f"{', '.join(METHODS)}, or all of the paper's"),
    as_json: AsJson = False,
) -> None:
    """Point estimates by the paper's methods, with standard deviations."""
    from bayesfric.commands.analyse import estimate as run

    with _progress() as progress:
        record, lines = run(_model(config), method, progress=progress)
    _print(record, as_json, lines)


@app.command()
def identify(
    config: ConfigFile,
    advise: str | None = Option(None, metavar="NAME", help="rank what to record next to know this"),
    output: Path | None = Option(None, *OUTPUT, help="CSV to write, the torque to play"),
    force: bool = Option(False, "--force", help="replace that CSV"),
    as_json: AsJson = False,
) -> None:
    """Find what these recordings can and cannot determine, and what would help."""
    from bayesfric.commands import analyse

    if advise is None and (output or force):
        key = "--output" if output else "--force"
        raise BadInput(key, "is for the excitation of --advise", "add --advise NAME")
    model = _model(config)
    with _progress() as show:
        if advise is None:
            record, text = analyse.identify(model, progress=show)
        else:
            record, text = analyse.advise(model, advise, output, force=force, progress=show)
    _print(record, as_json, text)


@app.command()
def explain(
    config: ConfigFile,
    output: Path | None = Option(None, *OUTPUT, help="configuration to write with these terms"),
    as_json: AsJson = False,
) -> None:
    """Find what else explains the torque, tested against simulated replicates."""
    from bayesfric.commands.analyse import explain as run

    with _progress() as progress:
        record, text = run(_model(config), output, progress=progress)
    _print(record, as_json, text)


@app.command()
def pool(config: ConfigFile, seed: Seed = None, as_json: AsJson = False) -> None:
    """Fit recordings together of which some parameters differ, and predict the next one."""
    from bayesfric.fit.pooled_fit import pool as run
    from bayesfric.report.words import filled, line_of

    model = _model(config)
    with _progress() as progress:
        pooled = run(model, seed=seed, progress=progress)
    lines = [
        f"{finding.recording}: {line_of(finding.kind, finding.as_dict())}"
        for finding in pooled.findings
    ]
    text = filled("pool.txt.j2", found=pooled, findings=lines)
    _print(pooled.as_json(), as_json, text.splitlines(), converged=pooled.status == "reliable")


@app.command()
def fit(
    config: ConfigFile,
    output: RunOption = None,
    seed: Seed = None,
    force: Force = False,
    output_error: OutputError = False,
    paper: Paper = False,
    verbose: Verbose = False,
    as_json: AsJson = False,
) -> None:
    """Sample the posterior and write the run directory."""
    options = {"seed": seed, "force": force, "paper": paper, "output_error": output_error}
    _fit(config, output or Path(f"{config.stem}-run"), as_json, verbose=verbose, **options)


@app.command()
def demo(
    output: RunOption = None,
    seed: Seed = None,
    force: Force = False,
    paper: Paper = False,
    verbose: Verbose = False,
    as_json: AsJson = False,
) -> None:
    """Fit the packaged knee: a recording SIMULATED from Table 3 of the paper."""
    options = {"seed": seed, "force": force, "paper": paper}
    _fit(None, output or Path("demo-run"), as_json, verbose=verbose, **options)


@app.command()
def report(run: RunFolder, paper: Paper = False, as_json: AsJson = False) -> None:
    """Make the page and the tables of a finished run again."""
    from bayesfric.commands.runs import report as make

    with _progress() as progress:
        record = make(run, paper=paper, progress=progress)
    _print(record, as_json, [f"Written to {run}: {', '.join(record['written'])}"])


@app.command()
def rollout(
    run: RunFolder,
    config: Path | None = Argument(None, metavar="CONFIG", help="with other recordings"),
    draws: int = Option(100, min=2, max=10_000, help="of the posterior"),
    every: bool = Option(False, "--all", help="also what was fitted, not held out"),
    seed: Seed = None,
    as_json: AsJson = False,
) -> None:
    """Play recordings to the joint: how far its simulated motion is from the measured one."""
    from bayesfric.base.atomic_write import jsonable
    from bayesfric.commands.runs import rollout as play
    from bayesfric.commands.runs import rollout_text

    with _progress() as progress:
        result = play(run, config, draws=draws, seed=seed, every=every, progress=progress)
    written = f"Added to {run}: report.html, figures/rollout.pdf, summary.json"
    _print(jsonable(result), as_json, [*rollout_text(result), written])


@app.command()
def export(
    run: RunFolder,
    to: str = Option(..., metavar="FORMAT", help=FORMATS),
    output: Path | None = Option(None, *OUTPUT, help="folder to make; RUN-FORMAT if left out"),
    joint: str = Option("joint", help="what the simulator calls the joint"),
    into: Path | None = Option(None, metavar="MODEL", help="mujoco: model whose joint is changed"),
    draws: int | None = Option(None, help="how many draws, of intervals and of the CSV"),
    program: str | None = Option(
        None, "--for", metavar="PROGRAM", help="only what it takes, such as drake or pinocchio"
    ),
    force: bool = Option(False, "--force", help="keep an old export aside"),
    as_json: AsJson = False,
) -> None:
    """Export a finished run to a simulator's files, and list what these cannot represent."""
    from bayesfric.export.exported import export as run_to

    place = output or Path(f"{run.resolve().name}-{to}")
    exported = run_to(
        run, to, output=place, force=force, joint=joint, into=into, draws=draws, program=program
    )
    written = [str(place / name) for name in (*exported.files, "export.json")]
    lines = [*exported.text().splitlines(), "", f"Written: {', '.join(written)}"]
    _print(exported.as_json(), as_json, lines)


@app.command()
def compare(
    runs: list[Path] = Argument(..., metavar="RUN", help="run directories"),
    output: Path | None = Option(None, *OUTPUT, help="folder to make: page, tables, figures"),
    estimates: bool = Option(False, "--estimates", help="of several runs, too"),
    as_json: AsJson = False,
) -> None:
    """Compare runs, or the methods and the posterior of one run."""
    from bayesfric.commands.runs import compare as run
    from bayesfric.report.comparison.comparison import comparison_dict, comparison_text

    table = run(runs, output, estimates=estimates or None)
    written = [f"Written to {output}"] if output else []
    _print(comparison_dict(table), as_json, [*comparison_text(table), *written])


@app.command()
def arm(
    urdf: Path = Argument(..., metavar="ROBOT.urdf", help="of the arm, with inertials"),
    log: list[Path] = Argument(..., metavar="LOG", help="positions and efforts of its joints"),
    output: Path | None = Option(None, *OUTPUT, help="folder to make; LOG-arm if left out"),
    config: Path | None = Option(None, "--config", metavar="arm.toml", help="what else is known"),
    predict: Path | None = Option(None, metavar="LOG", help="another motion, to be predicted"),
    effort_unit: str | None = Option(None, metavar="UNIT", help="of efforts; N m if left out"),
    full: bool = Option(False, "--full", help="figures, tables and page of each joint"),
    to_files: bool = Option(False, "--export", help="as URDF, MJCF, ros2_control and Python"),
    roll_out: float | None = Option(
        None, "--rollout", metavar="SECONDS", help="simulate the efforts in such parts, as CSV"
    ),
    advise: bool = Option(False, "--advise", help="most informative next motion, CSV and YAML"),
    wanted: list[str] | None = Option(
        None, metavar="JOINT.NUMBER", help="with --advise: what it is to determine"
    ),
    seconds: float = Option(20.0, help="with --advise: how long it may be"),
    seed: Seed = None,
    as_json: AsJson = False,
) -> None:
    """Fit every joint of an arm, in addition to the rigid-body torque of its URDF."""
    from bayesfric.arm.arm import Arm
    from bayesfric.arm.arm_rollout import rollout as play
    from bayesfric.arm.excitation import next_motion
    from bayesfric.arm.exports import files_of
    from bayesfric.base.atomic_write import check_output_folder, write_files

    folder = output or Path(f"{log[0].stem}-arm")
    check_output_folder(folder, force=None)
    with _progress() as progress:
        fitter = Arm(urdf, {} if config is None else config)
        result = fitter.fit(
            log, predict=predict, effort_unit=effort_unit, seed=seed, progress=progress
        )
        # further requests may be refused; the fit is kept
        page, lines, numbers = result.write(folder, full=full), result.text(), result.as_json()
        if to_files:
            write_files({folder / name: text for name, text in files_of(result).items()})
        if roll_out is not None or (predict is not None and result.timing is not None):
            parts = math.inf if roll_out is None else roll_out
            played = play(result, seconds=parts, seed=seed, progress=progress)
            write_files({folder / "rollout.csv": played.as_csv()})
            lines.append(played.text())
            numbers["rollout"] = played.as_json()
        if advise:
            motion = next_motion(result, wanted, seconds=seconds, seed=seed, progress=progress)
            csv, yaml = folder / "exciting.csv", folder / "exciting.yaml"
            write_files({csv: motion.as_csv(), yaml: motion.as_joint_trajectory()})
            lines.append(motion.text(wanted))
            numbers["next_motion"] = motion.as_json()
    _print(numbers, as_json, [*lines, "", f"Written: {page}"], converged=result.reliable)


@app.command()
def fleet(
    plan: Path = Argument(..., metavar="FLEET", help="template and units (TOML)"),
    output: Path | None = Option(None, *OUTPUT, help="folder to make; FLEET-fleet if left out"),
    workers: int | None = Option(None, min=1, help="processes; one a core if left out"),
    scheduler: str | None = Option(None, help="address of a running Dask scheduler"),
    resume: bool = Option(False, "--resume", help="do what is missing, failed or has changed"),
    as_json: AsJson = False,
) -> None:
    """Fit many units by one template, and estimate their population."""
    from bayesfric.fleet.fleet import PLAN, Fleet
    from bayesfric.report.words import filled

    fleet, folder = Fleet.from_config(plan), output or Path(f"{plan.stem}-fleet")
    options: dict[str, Any] = {"workers": workers, "scheduler": scheduler, "resume": resume}
    try:
        with _progress() as progress:
            result = fleet.run(folder, progress=progress, **options)
    except KeyboardInterrupt:
        if not (folder / PLAN).exists():
            raise
        done = sum(1 for _ in folder.glob("units/*/unit.toml"))
        raise Interrupted(f"{done} of {len(fleet.plan.units)} units are kept") from None
    lines = filled("fleet.txt.j2", found=result).splitlines()
    _print(result.as_json(), as_json, lines, converged=not result.left)


def _fit(
    config: Path | None, folder: Path, as_json: bool, *, verbose: bool, **options: Any
) -> None:
    """Fit a configuration, or the demo's."""
    timer = Timer()  # before the slow imports
    with ExitStack() as bars:
        from bayesfric.commands.fit import demo_config, fit_text
        from bayesfric.commands.fit import fit as run
        from bayesfric.problem.config import read_config

        show = bars.enter_context(_progress())

        def print_summary(summary: Any) -> None:
            nonlocal show
            bars.close()  # before the numbers are printed
            if config is None:
                print(DEMO, file=sys.stderr)
            if not as_json:
                _print(summary, as_json, fit_text(summary, verbose=verbose))
            show = bars.enter_context(_progress())

        read = demo_config() if config is None else read_config(config)
        summary = run(read, folder, progress=lambda x: show(x), on_summary=print_summary, **options)
    lines = ["", f"{folder / 'report.html'}   in all {time_text(timer)}"]
    _print(summary, as_json, lines, converged=summary["sampler"]["status"] == "reliable")


def _model(config: Path) -> Model:
    from bayesfric.fit.model import Model

    return Model.from_config(config)


def _print(record: Any, as_json: bool, lines: Iterable[str], *, converged: bool = True) -> None:
    """Print a command's record as JSON, or its lines; exit if it has not converged."""
    if as_json:
        ascii_only = not str(sys.stdout.encoding or "utf").lower().startswith("utf")
        lines = [json.dumps(record, indent=1, ensure_ascii=ascii_only, allow_nan=False)]
    try:
        for line in lines:
            print(line)
        sys.stdout.flush()
    except BrokenPipeError:
        # the reader, such as head, has ended; files are still written
        _discard_output()
    if not converged:
        raise typer.Exit(NOT_CONVERGED)


def _machine(error: OSError | MemoryError) -> BadInput:
    """Convert an error of the machine to bad input."""
    if isinstance(error, MemoryError):
        hint = "shorten the recordings, or use a larger machine"
        return BadInput("memory", "is not sufficient", hint)
    if error.filename is None:  # the output itself; do not fail again
        _discard_output()
    where, reason = error.filename or "output", error.strerror or str(error)
    return BadInput(
        str(where), f"cannot be read or written ({reason})", "check disk space and permissions"
    )


def _discard_output() -> None:
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def main() -> None:
    """Run the command line; bad input ends with one line and exit code 2."""
    if not sys.warnoptions:
        # warnings for developers; python -W shows them
        warnings.simplefilter("ignore")
    for name in LINEAR_ALGEBRA_THREADS:
        os.environ.setdefault(name, "1")  # before NumPy is imported
    # M_MMAP_THRESHOLD: freed arrays of a megabyte return to the system, which glibc else keeps
    with suppress(OSError, TypeError, AttributeError):  # another C library
        ctypes.CDLL(None).mallopt(-3, 2**20)
    # waiting threads of compiled kernels yield the core
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:  # like Ctrl-C
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # never fail on a character
            stream.reconfigure(errors="backslashreplace")
    try:
        try:
            app(prog_name="bayesfric")
        except (OSError, MemoryError) as error:
            raise _machine(error) from None
    except BadInput as error:
        print(f"bayesfric: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
    except Interrupted as interruption:
        command = shlex.join([word for word in sys.argv[1:] if word != "--resume"])
        message = f"interrupted, {interruption}; go on with: bayesfric {command} --resume"
        print(f"bayesfric: {message}", file=sys.stderr)
        sys.exit(INTERRUPTED)
    except (KeyboardInterrupt, SystemExit) as end:
        # typer turns the first into the second
        if isinstance(end, SystemExit) and end.code != INTERRUPTED:
            raise
        print("bayesfric: interrupted, nothing was written", file=sys.stderr)
        sys.exit(INTERRUPTED)
    finally:
        gc.freeze()  # skips the garbage collection at exit: 0.2 s of a check


if __name__ == "__main__":
    main()
