"""Whole fleets on processes: the command, killed workers, a cluster of its own with TLS."""

import datetime
import ipaddress
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
from bayesfric.errors import BadInput

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
    return {one.parent.name: one.stat().st_mtime_ns for one in folder.glob("units/*/unit.json")}


@pytest.mark.slow
def test_the_command_fits_all_and_goes_on_with_what_changed(tmp_path):
    write_fleet(tmp_path)
    done = run_command(tmp_path, "--workers", "2", "--json")
    found = json.loads(done.stdout)
    assert found["units"] == 5
    assert found["status"] == {"reliable": 3, "failed": 2}
    assert set(found["failed"]) == {"broken", "missing"}
    assert found["left"] == {}
    table = pq.read_table(tmp_path / "out/results.parquet").to_pandas()
    failed = table[table.status == "failed"].set_index("unit")
    assert "fewer than min_samples" in failed.error["broken"]
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
    assert again["again"] == 5
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
    assert again["status"] == {"reliable": 6, "failed": 2}
    later = finished(tmp_path / "out")
    assert {name: later[name] for name in done} == done


SBATCH = """#!{python}
# Stands in for SLURM's: the job script runs as a process of its own on this machine.
import os, subprocess, sys
print(open(sys.argv[1]).read(), file=open("jobs", "a"))
job = subprocess.Popen(["bash", sys.argv[1]], start_new_session=True,
                       stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
print(f"Submitted batch job {{job.pid}}")
"""
SCANCEL = """#!{python}
import os, signal, sys
for job in sys.argv[1:]:
    os.killpg(int(job), signal.SIGTERM)
"""


# dask-jobqueue leaves it to the collector to close and remove its certificates
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.slow
def test_slurm_jobs_give_the_table_that_local_workers_give(tmp_path, monkeypatch):
    """The queue is a stand-in; jobs, their scripts, TLS and the fits are real."""
    pytest.importorskip("dask_jobqueue")
    import dask

    write_fleet(tmp_path)
    (tmp_path / "bin").mkdir()
    for name, text in {"sbatch": SBATCH, "scancel": SCANCEL}.items():
        (tmp_path / "bin" / name).write_text(text.format(python=sys.executable))
        (tmp_path / "bin" / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path / 'bin'}:{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    with dask.config.set({"jobqueue.slurm.walltime": "00:20:00"}):  # what a cluster's users have
        found = made(tmp_path, {"slurm": 2, "patience": 30.0}).run(tmp_path / "out")
    assert found.left == {}
    assert found.status == {"reliable": 3, "failed": 2}
    jobs = (tmp_path / "jobs").read_text()
    assert jobs.count("#SBATCH -t 00:20:00") == 2
    assert "tls://" in jobs
    assert not [one for one in (tmp_path / "out").rglob("*") if "PRIVATE KEY" in text_of(one)]
    made(tmp_path, {"workers": 1}).run(tmp_path / "local")
    tables = [(tmp_path / name / "results.parquet").read_bytes() for name in ("out", "local")]
    assert tables[0] == tables[1]


def text_of(path):
    return path.read_text(errors="replace") if path.is_file() else ""


def workers_of(pid):
    """Processes of a local cluster's workers, of those that work."""
    listed = subprocess.run(
        ["ps", "--ppid", str(pid), "-o", "pid=,args="], capture_output=True, text=True, check=False
    ).stdout
    return [int(line.split()[0]) for line in listed.splitlines() if "spawn_main" in line]


def write_certificates(folder):
    """Write an authority, and a certificate for localhost that it has signed."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    now = datetime.datetime.now(datetime.UTC)

    def named(words):
        return x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, words)])

    def made(words, key, by, signed_with, authority):
        names = [x509.DNSName("localhost"), x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]
        return (
            x509.CertificateBuilder()
            .subject_name(named(words))
            .issuer_name(named(by))
            .public_key(key.public_key())
            .serial_number(x509.random_serial_number())
            .not_valid_before(now - datetime.timedelta(days=1))
            .not_valid_after(now + datetime.timedelta(days=1))
            .add_extension(x509.BasicConstraints(ca=authority, path_length=None), critical=True)
            .add_extension(x509.SubjectAlternativeName(names), critical=False)
            .sign(signed_with, hashes.SHA256())
        )

    keys = [ec.generate_private_key(ec.SECP256R1()) for _ in range(2)]
    pem = serialization.Encoding.PEM
    private = (pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    files = {
        "ca.pem": made("authority", keys[0], "authority", keys[0], True).public_bytes(pem),
        "cert.pem": made("fleet", keys[1], "authority", keys[0], False).public_bytes(pem),
        "key.pem": keys[1].private_bytes(*private),
    }
    for name, text in files.items():
        (folder / name).write_bytes(text)


@pytest.mark.slow
def test_a_cluster_of_its_own_speaks_tls_only_and_may_be_restarted(tmp_path):
    write_fleet(tmp_path, good=4)
    write_certificates(tmp_path)
    tls = ["--tls-ca-file", "ca.pem", "--tls-cert", "cert.pem", "--tls-key", "key.pem"]
    dask = [sys.executable, "-m", "dask"]

    def begin(*words):
        return subprocess.Popen(
            [*dask, *words, *tls],
            cwd=tmp_path,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    def scheduler():
        place = ["--protocol", "tls", "--host", "127.0.0.1", "--port", str(port)]
        return begin("scheduler", *place, "--no-dashboard")

    def worker():
        words = ["--nthreads", "1", "--no-dashboard", "--memory-limit", "2GiB"]
        return begin("worker", address, *words)

    port = free_port()
    address = f"tls://127.0.0.1:{port}"
    given = {"scheduler": address, "ca": "ca.pem", "certificate": "cert.pem", "key": "key.pem"}
    files = {k: str(tmp_path / v) for k, v in given.items() if k != "scheduler"}
    started = [scheduler(), worker()]
    try:
        fleet = made(tmp_path, {**files, "scheduler": address})
        # without a certificate, and with one of another authority
        with pytest.raises(BadInput, match="no scheduler answers"):
            made(tmp_path, {"scheduler": address}).run(tmp_path / "refused")
        (tmp_path / "other").mkdir()
        write_certificates(tmp_path / "other")
        others = {k: str(tmp_path / "other" / given[k]) for k in files}
        with pytest.raises(BadInput, match="no scheduler answers"):
            made(tmp_path, {**others, "scheduler": address}).run(tmp_path / "refused-too")
        assert not (tmp_path / "refused").exists()

        units = []

        def restart(progress):
            """Kill the scheduler when the first units are there, and start another."""
            units.append(progress.phase)
            if len(units) == 2:
                for one in started:
                    os.killpg(one.pid, signal.SIGKILL)
                    one.wait()
                started[:] = [scheduler(), worker()]

        found = fleet.run(tmp_path / "out", progress=restart)
        assert found.left == {}
        assert set(found.failed) == {"broken", "missing"}, found.failed
        assert found.status == {"reliable": 4, "failed": 2}
    finally:
        for one in started:
            os.killpg(one.pid, signal.SIGKILL)
            one.wait()
    # a local cluster gives the same table
    local = made(tmp_path, {"workers": 1}).run(tmp_path / "local")
    assert local.status == found.status
    tables = [(tmp_path / name / "results.parquet").read_bytes() for name in ("out", "local")]
    assert tables[0] == tables[1]


def made(folder, cluster):
    return bf.Fleet(
        folder / "unit.toml", folder / "units.csv", joint="joint", over="km", cluster=cluster
    )


def free_port():
    import socket

    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]
