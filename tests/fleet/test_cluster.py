"""Whole fleets on processes: the command, killed workers, a given cluster."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pyarrow.parquet as pq
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput

from .simulated_fleet import write_fleet

# s; bounds what deadlocks, not what a busy machine slows down
FOREVER = 3600.0
COMMAND = [sys.executable, "-m", "bayesfric", "fleet", "fleet.toml", "-o", "out"]


def run_command(folder, *arguments, code=0):
    ended = subprocess.run(
        [*COMMAND, *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=FOREVER,
        check=False,
    )
    assert ended.returncode == code, ended.stderr
    return ended


def start_command(folder, *arguments):
    with (folder / "errors.txt").open("w") as errors:
        return subprocess.Popen(
            [*COMMAND, "--workers", "2", *arguments],
            cwd=folder,
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
        )


def table(folder):
    return (folder / "results.parquet").read_bytes()


def finish_times(folder):
    """Units with a stored result, by the time it was stored."""
    paths = folder.glob("units/*/unit.toml")
    return {path.parent.name: path.stat().st_mtime_ns for path in paths}


def workers_of(pid):
    """Processes of a local cluster's workers, of those that work."""
    command = ["ps", "--ppid", str(pid), "-ww", "-o", "pid=,args="]
    listed = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    return [int(line.split()[0]) for line in listed.splitlines() if "spawn_main" in line]


@pytest.mark.slow
def test_the_command_fits_all_and_resumes(tmp_path):
    write_fleet(tmp_path)
    record = json.loads(run_command(tmp_path, "--workers", "2", "--json").stdout)
    assert record["outcomes"] == {"good": 3, "failed": 2}
    assert set(record["failed"]) == {"broken", "missing"}
    assert record["left"] == {}
    results = pq.read_table(tmp_path / "out/results.parquet").to_pandas()
    assert list(results.unit.unique()) == ["a0", "a1", "a2", "broken", "missing"]
    rows = results[results.unit == "a1"].set_index("quantity")
    # axes simulated with these: a wide bound, as one of three may be far off
    for name, truth in {"motor.viscous": 0.05, "motor.coulomb": 0.2}.items():
        assert abs(rows.value[name] - truth) < 5 * rows.sd[name]
        assert rows.low[name] < rows.value[name] < rows.high[name]
    # refused without --resume; with it nothing is fitted again, and no byte changes
    before, times = table(tmp_path / "out"), finish_times(tmp_path / "out")
    assert "--resume" in run_command(tmp_path, code=2).stderr
    again = json.loads(run_command(tmp_path, "--resume", "--json", "--workers", "1").stdout)
    assert again["again"] == 3  # what failed is tried again
    assert finish_times(tmp_path / "out") == times
    assert table(tmp_path / "out") == before


@pytest.mark.slow
def test_killed_workers_and_a_killed_client_change_no_byte(tmp_path):
    write_fleet(tmp_path, good=9)
    run_command(tmp_path, "--workers", "2")
    undisturbed = table(tmp_path / "out")
    shutil.rmtree(tmp_path / "out")
    client, killed, resumed = start_command(tmp_path), set(), False
    finished, end = {}, time.monotonic() + FOREVER
    while client.poll() is None:
        assert time.monotonic() < end
        finished = finish_times(tmp_path / "out") | finished
        workers = [pid for pid in workers_of(client.pid) if pid not in killed]
        if len(killed) < 5 and len(finished) > len(killed) and workers:
            os.kill(workers[0], signal.SIGKILL)
            killed.add(workers[0])
        if len(killed) >= 3 and not resumed:
            resumed = True
            os.killpg(client.pid, signal.SIGKILL)
            client.wait()
            finished = finish_times(tmp_path / "out") | finished
            client = start_command(tmp_path, "--resume")
        time.sleep(0.1)
    assert client.returncode == 0, (tmp_path / "errors.txt").read_text()
    assert resumed
    assert len(killed) == 5
    assert table(tmp_path / "out") == undisturbed
    # what was stored once is never stored again
    last = finish_times(tmp_path / "out")
    assert {name: last[name] for name in finished} == finished


@pytest.mark.slow
def test_an_interrupted_fleet_can_be_resumed(tmp_path):
    write_fleet(tmp_path, good=6)
    client, end = start_command(tmp_path), time.monotonic() + FOREVER
    while not finish_times(tmp_path / "out"):
        assert time.monotonic() < end
        assert client.poll() is None
        time.sleep(0.1)
    workers = workers_of(client.pid)
    client.send_signal(signal.SIGINT)
    assert client.wait(timeout=FOREVER) == 130
    errors = (tmp_path / "errors.txt").read_text()
    (line,) = [x for x in errors.splitlines() if x.startswith("bayesfric: interrupted")]
    assert line.endswith("--resume")
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers)
    before = finish_times(tmp_path / "out")
    record = json.loads(run_command(tmp_path, "--resume", "--json").stdout)
    assert record["again"] >= len(before)
    assert sum(record["outcomes"].values()) == 8
    assert record["outcomes"]["failed"] == 2
    after = finish_times(tmp_path / "out")
    assert {name: after[name] for name in before} == before


@pytest.mark.slow
def test_a_given_cluster_gives_the_table_of_local_workers(tmp_path):
    from distributed import LocalCluster

    write_fleet(tmp_path)
    fleet = bf.Fleet(tmp_path / "unit.toml", tmp_path / "units.csv")
    options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**options, security=True) as cluster:
        # without its credentials one is refused
        with pytest.raises(BadInput, match="no scheduler answers"):
            fleet.run(tmp_path / "refused", scheduler=cluster.scheduler_address)
        result = fleet.run(tmp_path / "out", scheduler=cluster)
    assert result.left == {}
    assert result.outcomes == {"good": 3, "failed": 2}
    local = fleet.run(tmp_path / "local", workers=1)
    assert local.outcomes == result.outcomes
    assert table(tmp_path / "local") == table(tmp_path / "out")


def test_a_scheduler_that_does_not_answer(tmp_path):
    import socket

    write_fleet(tmp_path, good=1)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    fleet = bf.Fleet(tmp_path / "unit.toml", tmp_path / "units.csv")
    with pytest.raises(BadInput, match=f"{address}: no scheduler answers"):
        fleet.run(tmp_path / "out", scheduler=address)
    assert (tmp_path / "out" / "fleet.toml").exists()
