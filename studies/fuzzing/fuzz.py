"""Coverage-guided fuzzing of one reader, of the configuration, of what a run or a fleet reads back.

``python studies/fuzzing/fuzz.py READER --seconds N`` lets atheris (libFuzzer for Python) change
the bytes of good files, keeping what reaches new lines of this package and of the Python
libraries below it. Whatever is not read must be refused with BadInput within 20 s and
2 GiB. Other exceptions are findings: each is shown once, its input is saved beside the corpus.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
READERS = (
    "csv", "json", "npz", "mat", "parquet", "jsonl", "h5", "mcap", "bag", "db3", "config",
    "posterior", "summary", "fleet",
)  # fmt: skip
# Packages, whole, but what numba compiles.
_INSTRUMENTED = ["bayesfric", "json", "tomllib", "zipfile", "numpy", "scipy", "rosbags"]
_COMPILED = [
    ".".join(path.relative_to(REPOSITORY).with_suffix("").parts)
    for path in (REPOSITORY / "bayesfric").rglob("*.py")
    if "njit" in path.read_text(encoding="utf-8")
]
# The smallest database of SQLite takes more.
_MOST_BYTES = {"db3": 64_000, "posterior": 400_000, "summary": 64_000}
_MOST_BYTES_ELSE = 16_000
# Twice what the tests allow: on a busy machine a stall is no finding.
_SECONDS_A_RUN = 20
_MEGABYTES = 2048


def main() -> int:
    """Run one reader's fuzzer in a process of its own, and add a line to results.json."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("reader", choices=READERS)
    parser.add_argument("--seconds", type=int, default=600)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--work", type=Path, default=Path("/tmp/bayesfric-fuzzing"))
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    sys.path.insert(0, str(REPOSITORY))
    folder: Path = options.work / options.reader
    if options.child:
        _child(options.reader, folder, options.seconds, options.seed)
        return 0
    corpus, findings = folder / "corpus", folder / "findings"
    shutil.rmtree(folder / "input", ignore_errors=True)  # as the last input left it
    for path in (corpus, findings, folder / "input"):
        path.mkdir(parents=True, exist_ok=True)
    for old in findings.iterdir():
        old.unlink()
    _seed(options.reader, corpus)
    command = [sys.executable, __file__, *sys.argv[1:], "--child"]
    done = subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False)
    print(done.stderr[-3000:], file=sys.stderr)
    runs = re.search(r"number_of_executed_units: +(\d+)", done.stderr)
    covered = re.findall(r"cov: (\d+) ft: (\d+)", done.stderr)
    record = {
        "reader": options.reader,
        "seconds": options.seconds,
        "seed": options.seed,
        "executions": int(runs[1]) if runs else None,
        "edges": int(covered[-1][0]) if covered else None,
        "corpus": len(list(corpus.iterdir())),
        "findings": sorted(path.name for path in findings.iterdir()),
        "ended": done.returncode,
    }
    results = Path(__file__).with_name("results.json")
    lines = json.loads(results.read_text()) if results.exists() else []
    lines = [line for line in lines if line["reader"] != options.reader]
    lines = sorted([*lines, record], key=lambda line: READERS.index(line["reader"]))
    results.write_text(json.dumps(lines, indent=1) + "\n")
    print(json.dumps(record))
    return 1 if record["findings"] or done.returncode else 0


def _seed(reader: str, corpus: Path) -> None:
    from tests.hostile import good

    if reader in ("posterior", "summary"):
        texts = [(_run(corpus.parent) / _IN_A_RUN[reader]).read_bytes()]
    elif reader == "fleet":
        texts = [_FLEET.encode()]
    elif reader == "config":
        texts = [good.config("run.csv").encode(), good.LONG_CONFIG.encode()]
    else:
        # short ones: most changes of a long file hit its numbers
        texts = [
            b"\0" + good.content(form, 60)
            for form in good.FORMATS
            if form.rpartition(".")[2].replace("tsv", "csv") == reader
        ]
    for number, text in enumerate(texts):
        (corpus / f"seed{number}").write_bytes(text)


_IN_A_RUN = {"posterior": "posterior.nc", "summary": "summary.json"}
_FLEET = """
[template.mechanism]
preset = "motor-axis"
[[template.recordings]]
file = "{file}"
name = "{unit}-{serial}"
time = { column = "t", unit = "s" }
[units]
table = "units.csv"
name = "{unit}"
joint = "serial"
over = "day"
[runs]
draws = 300
[cluster]
workers = 2
memory_limit = "1 GiB"
"""


def _run(folder: Path) -> Path:
    """Fit a small simulated recording, once, with few draws: a short ``posterior.nc``."""
    from tests.commands.bench import SAMPLED, simulated

    run = folder / "input" / "run"
    if not run.exists():
        simulated(run.parent / "small.toml", SAMPLED)
        command = [sys.executable, "-m", "bayesfric", "fit", "small.toml", "-o", "run"]
        subprocess.run(command, cwd=run.parent, env={**os.environ, "PYTHONPATH": str(REPOSITORY)})
    return run


def _child(reader: str, folder: Path, seconds: int, seed: int) -> None:
    import atheris

    with atheris.instrument_imports(include=_INSTRUMENTED, exclude=_COMPILED):
        special = {"config": _config_target, "fleet": _fleet_target}
        special |= dict.fromkeys(_IN_A_RUN, partial(_run_target, reader))
        target = special.get(reader, partial(_table_target, reader))(folder)
    from bayesfric.base.errors import BadInput

    seen: set[str] = set()

    def one(data: bytes) -> None:
        try:
            target(data)
        except BadInput as error:
            if not str(error).isprintable():
                raise
        except Exception as error:
            own = [
                f for f in traceback.extract_tb(error.__traceback__) if "bayesfric" in f.filename
            ]
            name = f"{type(error).__name__}-{Path(own[-1].filename).stem}-{own[-1].lineno}"
            if name not in seen:
                seen.add(name)
                digest = hashlib.sha256(data).hexdigest()[:8]
                (folder / "findings" / f"{name}-{digest}").write_bytes(data)
                traceback.print_exc()

    flags = [
        f"-max_total_time={seconds}",
        f"-seed={seed}",
        f"-max_len={_MOST_BYTES.get(reader, _MOST_BYTES_ELSE)}",
        f"-timeout={_SECONDS_A_RUN}",
        "-report_slow_units=1000",
        f"-rss_limit_mb={_MEGABYTES}",
        f"-artifact_prefix={folder}/findings/",
        "-print_final_stats=1",
        "-verbosity=1",
        str(folder / "corpus"),
    ]
    atheris.Setup([sys.argv[0], *flags], one)
    atheris.Fuzz()


def _table_target(reader: str, folder: Path) -> Callable[[bytes], None]:
    """Read a recording; the first byte chooses what the configuration says about it."""
    import numpy as np

    from bayesfric.recordings import Processing, Recording, Source, observe, read_recordings
    from tests.hostile import good

    path = folder / "input" / f"run.{reader}"
    names = good.NAMES.get(reader, {"t": "t", "q": "q", "tau": "tau"})
    by_name = dict(zip(("time", "position", "torque"), names.values(), strict=True))
    by_number = {"time": 1, "position": 2, "torque": 3}
    more: list[dict[str, object]] = [{}]
    if reader == "csv":
        more += [{"delimiter": ";", "decimal": ","}]
        more += [{"skip_rows": 2}, {"delimiter": "whitespace"}, {"delimiter": "tab"}]
    elif reader in ("json", "jsonl", "mat", "h5"):
        more += [{"table": "log"}, {"table": "a.b"}]
    units = {"time": "s", "position": "rad", "torque": "N m"}
    sources = [
        Source.model_validate(
            {
                "file": path.name,
                **{k: {"column": column, "unit": units[k]} for k, column in columns.items()},
                **keys,
            }
        )
        for keys in more
        for columns in (by_name, by_number)
    ]
    processing = Processing(lowpass="off", dead_zone=0.0, trim=0.0)

    def target(data: bytes) -> None:
        path.write_bytes(data[1:])
        source = sources[data[0] % len(sources)] if data else sources[0]
        with np.errstate(all="ignore"):
            for recording in read_recordings(
                Recording(source, path.parent), ratio=1.0, motion="rotary", processing=processing
            ):
                observe(recording, processing)

    return target


def _run_target(reader: str, folder: Path) -> Callable[[bytes], None]:
    """Read a run back, as ``export`` and ``compare`` do, with one file changed; recordings once."""
    from bayesfric.base.opened import read_json
    from bayesfric.fit import finished_run
    from bayesfric.report.summary.record import Summary

    run = _run(folder)
    path = run / _IN_A_RUN[reader]
    problem = finished_run.Problem.from_config(run / "config.toml")
    finished_run.Problem.from_config = lambda _: problem

    def target(data: bytes) -> None:
        path.write_bytes(data)
        if reader == "summary":
            Summary.read(read_json(path), str(path))
        else:
            finished_run.finished(run)

    return target


def _fleet_target(folder: Path) -> Callable[[bytes], None]:
    """Read a fleet's plan and its units."""
    from bayesfric.fleet.plan import read_plan

    place = folder / "input"
    (place / "units.csv").write_text("unit,file,serial,day\na,a.csv,7,1\nb,b.csv,7,2\n")
    path = place / "fleet.toml"

    def target(data: bytes) -> None:
        path.write_bytes(data)
        read_plan(path)

    return target


def _config_target(folder: Path) -> Callable[[bytes], None]:
    """Check a configuration, and everything in it that is read later."""
    from bayesfric.problem.config import read_config

    path = folder / "input" / "c.toml"

    def target(data: bytes) -> None:
        path.write_bytes(data)
        config = read_config(path)
        with config.named():
            config.tables.mechanism.joint()
        assert isinstance(config.priors, dict)
        assert isinstance(config.references, dict)

    return target


if __name__ == "__main__":
    sys.exit(main())
