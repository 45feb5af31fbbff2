"""Whole fleets on processes: the command, killed workers, a cluster of its own."""

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

from .made import write_fleet

COMMAND = [sys.executable, "-m", "bayesfric", "fleet", "fleet.toml", "-o", "out"]


def run_command(folder, *more, code=0):
    done = subprocess.run(
        [*COMMAND, *more], cwd=folder, capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == code, done.stderr
    return done


def finished(folder):
    """Units with a stored result, by the time it was stored."""
    return {one.parent.name: one.stat().st_mtime_ns for one in folder.glob("units/*/unit.toml")}


@pytest.mark.slow
def test_the_command_fits_all_and_goes_on_with_what_changed(tmp_path):
    write_fleet(tmp_path)
    done = run_command(tmp_path, "--workers", "2", "--json")
    found = json.loads(done.stdout)
    assert found["units"] == 5
    assert found["outcomes"] == {"good": 3, "failed": 2}
    assert set(found["failed"]) == {"broken", "missing"}
    assert found["left"] == {}
    table = pq.read_table(tmp_path / "out/results.parquet").to_pandas()
    failed = table[table.outcome == "failed"].set_index("unit")
    assert "fewer than 50" in failed.error["broken"]
    assert "does not exist" in failed.error["missing"]
    assert list(table.unit.unique()) == ["a0", "a1", "a2", "broken", "missing"]
    rows = table[table.unit == "a1"].set_index("quantity")
    assert set(rows.km) == {1.5}
    # axes simulated with these: a wide bound, as one of three may be far off
    for name, truth in {"motor.viscous": 0.05, "motor.coulomb": 0.2}.items():
        assert abs(rows.value[name] - truth) < 5 * rows.sd[name]
        assert rows.low[name] < rows.value[name] < rows.high[name]
    # as it is, it is refused; with --resume nothing is done again, and no byte changes
    before, times = (tmp_path / "out/results.parquet").read_bytes(), finished(tmp_path / "out")
    assert "add --resume" in run_command(tmp_path, code=2).stderr
    again = json.loads(run_command(tmp_path, "--resume", "--json", "--workers", "1").stdout)
    assert again["again"] == 3  # what failed is tried again
    assert again["cpu_seconds"] < found["cpu_seconds"]
    assert finished(tmp_path / "out") == times
    assert (tmp_path / "out/results.parquet").read_bytes() == before


@pytest.mark.slow
def test_killed_workers_and_a_killed_client_change_no_byte(tmp_path):
    write_fleet(tmp_path, good=9)
    run_command(tmp_path, "--workers", "2")
    whole = (tmp_path / "out/results.parquet").read_bytes()
    shutil.move(tmp_path / "out", tmp_path / "undisturbed")

    def begin(*more):
        with (tmp_path / "said").open("w") as said:
            return subprocess.Popen(
                [*COMMAND, "--workers", "2", *more],
                cwd=tmp_path,
                stdout=subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,
            )

    client, killed = begin(), set()
    seen, end = {}, time.monotonic() + 300
    while client.poll() is None:
        assert time.monotonic() < end
        if (tmp_path / "out/results.parquet").exists():
            pq.read_table(tmp_path / "out/results.parquet")  # whole at every moment
        seen = finished(tmp_path / "out") | seen
        fresh = [pid for pid in workers_of(client.pid) if pid not in killed]
        if len(killed) < 5 and len(seen) > len(killed) and fresh:
            os.kill(fresh[0], signal.SIGKILL)
            killed.add(fresh[0])
        if len(killed) >= 3 and "resumed" not in seen:
            seen["resumed"] = 0
            os.killpg(client.pid, signal.SIGKILL)
            client.wait()
            seen = finished(tmp_path / "out") | seen
            client = begin("--resume")
        time.sleep(0.1)
    assert client.returncode == 0, (tmp_path / "said").read_text()
    assert len(killed) == 5
    assert "resumed" in seen
    assert (tmp_path / "out/results.parquet").read_bytes() == whole
    # what was stored once was never stored again
    last = finished(tmp_path / "out")
    assert {name: last[name] for name in seen if name != "resumed"} == {
        name: when for name, when in seen.items() if name != "resumed"
    }


@pytest.mark.slow
def test_ctrl_c_leaves_a_fleet_to_go_on_with(tmp_path):
    write_fleet(tmp_path, good=6)
    client = subprocess.Popen(
        [*COMMAND, "--workers", "2"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    end = time.monotonic() + 300
    while not finished(tmp_path / "out"):
        assert time.monotonic() < end
        assert client.poll() is None
        time.sleep(0.1)
    workers = workers_of(client.pid)
    client.send_signal(signal.SIGINT)
    _, said = client.communicate(timeout=60)
    assert client.returncode == 130
    (line,) = [one for one in said.splitlines() if one.startswith("bayesfric: interrupted")]
    assert "of 8 units are kept; go on with: bayesfric fleet" in line
    assert line.endswith("--resume")
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers)
    done = finished(tmp_path / "out")
    again = json.loads(run_command(tmp_path, "--resume", "--json").stdout)
    assert again["again"] >= len(done)
    assert sum(again["outcomes"].values()) == 8
    assert again["outcomes"]["failed"] == 2
    later = finished(tmp_path / "out")
    assert {name: later[name] for name in done} == done


def workers_of(pid):
    """Processes of a local cluster's workers, of those that work."""
    listed = subprocess.run(
        ["ps", "--ppid", str(pid), "-ww", "-o", "pid=,args="],
        capture_output=True,
        text=True,
        check=False,
    ).stdout
    return [int(line.split()[0]) for line in listed.splitlines() if "spawn_main" in line]


@pytest.mark.slow
def test_a_cluster_of_its_own_gives_the_table_that_local_workers_give(tmp_path):
    from distributed import LocalCluster

    write_fleet(tmp_path)
    given = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
    with LocalCluster(**given, security=True) as cluster:
        # whoever cannot show its credentials is refused
        with pytest.raises(BadInput, match="no scheduler answers"):
            made(tmp_path).run(tmp_path / "refused", scheduler=cluster.scheduler_address)
        found = made(tmp_path).run(tmp_path / "out", scheduler=cluster)
    assert found.left == {}
    assert found.outcomes == {"good": 3, "failed": 2}
    local = made(tmp_path).run(tmp_path / "local", workers=1)
    assert local.outcomes == found.outcomes
    tables = [(tmp_path / name / "results.parquet").read_bytes() for name in ("out", "local")]
    assert tables[0] == tables[1]


def made(folder):
    return bf.Fleet(folder / "unit.toml", folder / "units.csv")


def test_a_scheduler_that_does_not_answer_is_said_and_the_fleet_can_go_on(tmp_path):
    write_fleet(tmp_path, good=1)
    address = f"tcp://127.0.0.1:{free_port()}"
    with pytest.raises(BadInput, match=f"{address}: no scheduler answers"):
        made(tmp_path).run(tmp_path / "out", scheduler=address)
    assert (tmp_path / "out" / "fleet.toml").exists()


def free_port():
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]
