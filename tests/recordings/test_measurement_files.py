"""Files written by the formats' own libraries: what ``init`` makes of them reads the same joint."""

import csv
import json
import re
import struct
import tomllib
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import bayesfric as bf
from bayesfric.base.errors import BadInput
from bayesfric.commands.init import draft_configuration
from bayesfric.recordings.readers import TableOptions, read_table
from bayesfric.recordings.source import Recording, Source
from tests.recordings.samples import has, measured

pytestmark = pytest.mark.usefixtures("nothing_explained")

UNITS = {"position": "rad", "velocity": "rad/s", "torque": "N m"}


@pytest.fixture(scope="module")
def simulated():
    frame = bf.simulate(bf.Joint.preset("motor-axis"), duration=4, seed=1)
    time, q, torque = (frame[name].to_numpy() for name in ("time", "position", "torque"))
    # stamps that every format holds exactly
    time = np.round(time, 6)
    return SimpleNamespace(time=time, position=q, velocity=np.gradient(q, time), torque=torque)


def signals(s):
    return {name: getattr(s, name) for name in UNITS}


def mdf(path, s):
    asammdf = pytest.importorskip("asammdf", reason="writes MDF4")
    with asammdf.MDF(version="4.10") as file:
        for group, names in {"encoder": ("position", "velocity"), "drive": ("torque",)}.items():
            channels = [
                asammdf.Signal(getattr(s, name), s.time, name=name, unit=UNITS[name])
                for name in names
            ]
            file.append(channels, acq_name=group)
        file.save(path)


def tdms(path, s):
    nptdms = pytest.importorskip("nptdms", reason="writes TDMS")
    wave = {"wf_start_time": np.datetime64("2026-01-01T00:00:00"), "wf_start_offset": 0.0}
    wave["wf_increment"] = float(s.time[1])
    with nptdms.TdmsWriter(path) as file:
        file.write_segment(
            [
                nptdms.ChannelObject("knee", name, x, wave | {"unit_string": UNITS[name]})
                for name, x in signals(s).items()
            ]
        )


def ulog(path, s):
    """By the specification, of version 1: pyulog only reads."""
    pytest.importorskip("pyulog", reason="reads ULog")

    def message(kind, content):
        return struct.pack("<Hc", len(content), kind) + content

    fields = b"".join(b"double %s;" % name.encode() for name in UNITS)
    rows = zip(np.rint(s.time * 1e6).astype(int) + 10**6, *signals(s).values(), strict=True)
    data = [
        b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0),
        message(b"F", b"joint:uint64_t timestamp;" + fields),
        message(b"A", struct.pack("<BH", 0, 0) + b"joint"),
        *(message(b"D", struct.pack("<HQddd", 0, *row)) for row in rows),
    ]
    path.write_bytes(b"".join(data))


def wpilog(path, s):
    """As WPILib's own writer, records of all entries in turn; the last one is cut off."""
    log = pytest.importorskip("wpiutil.log", reason="writes WPILib's data logs")
    writer = import_module("wpiutil").DataLogWriter(str(path))
    entries = [(log.DoubleLogEntry(writer, f"/knee/{n}"), x) for n, x in signals(s).items()]
    mode = log.StringLogEntry(writer, "/mode")
    for k in np.random.default_rng(1).permutation(s.time.size):
        for entry, values in entries:
            entry.append(float(values[k]), round(s.time[k] * 1e6) + 5)
        mode.append("teleop", 9)
    writer.flush()
    del entries, entry, mode, writer
    path.write_bytes(path.read_bytes() + b"\x70\x01\x08")


def xlsx(path, s):
    pytest.importorskip("openpyxl", reason="reads and writes Excel's workbooks")
    frame = pd.DataFrame(
        {"time [s]": s.time} | {f"{n} [{UNITS[n]}]": x for n, x in signals(s).items()}
    )
    frame.to_excel(path, index=False, startrow=2)


def lerobot(path, s):
    (path / "meta").mkdir(parents=True)
    names = [f"{joint}.{name}" for joint in ("hip", "knee") for name in UNITS]
    about = {"observation.state": {"dtype": "float64", "shape": [6], "names": names}}
    about["action"] = about["observation.state"]
    (path / "meta" / "info.json").write_text(json.dumps({"features": about}))
    state = np.stack([*(0 * x for x in signals(s).values()), *signals(s).values()], axis=1)
    half = s.time.size // 2
    for number, rows in enumerate((slice(0, half), slice(half, None))):
        file = path / "data" / "chunk-000" / f"file-{number:03d}.parquet"
        file.parent.mkdir(parents=True, exist_ok=True)
        lists = pa.array(state[rows].tolist(), pa.list_(pa.float64(), 6))
        columns = {"action": lists, "observation.state": lists, "timestamp": s.time[rows]}
        pq.write_table(pa.table(columns | {"episode_index": [0] * len(lists)}), file)


def plc(path, s):
    lines = ["[key]; [value]", "Version; 1", "BufferEntries; 600"]
    for number, (name, values) in enumerate(signals(s).items()):
        lines += [f"{number}.Variable; Knee.{name}", f"{number}.Data; "]
        rows = zip((1e3 * s.time).tolist(), values.tolist(), strict=True)
        lines += [f"; {t!r}; {x!r}" for t, x in rows]
    path.write_text("\n".join(lines))


def serial(path, s):
    """A capture that begins within a row, with decimal commas and a suffix of no format."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, delimiter=";")
        writer.writerow(["t_s", *UNITS])
        writer.writerow(["5", "1"])
        for row in zip(s.time.tolist(), *(x.tolist() for x in signals(s).values()), strict=True):
            writer.writerow([repr(x).replace(".", ",") for x in row])


WRITERS = {
    "run.mf4": (mdf, 0),
    "run.tdms": (tdms, 0),
    "run.ulg": (ulog, 3),
    "run.wpilog": (wpilog, 3),
    "run.xlsx": (xlsx, 0),
    "lerobot": (lerobot, 3),
    "plc.csv": (plc, 4),
    "serial.log": (serial, 3),
}


@pytest.mark.parametrize("file", WRITERS)
def test_what_init_writes_reads_the_same_joint(tmp_path, simulated, file):
    write, edits = WRITERS[file]
    write(tmp_path / file, simulated)
    draft = draft_configuration(None, tmp_path / file, tmp_path / "knee.toml")
    text = draft["text"]
    assert len(re.findall(r'"\?"', text)) == edits
    units = UNITS | {"time": "ms" if write is plc else "s"}
    for channel, unit in units.items():
        text = re.sub(rf'^({channel} = .*)"\?"', rf'\1"{unit}"', text, flags=re.M)
    (keys,) = tomllib.loads(text)["recordings"]
    recording = measured(Recording(Source.model_validate(keys), tmp_path))
    np.testing.assert_allclose(recording.time, simulated.time, atol=1e-9)
    for name, values in signals(simulated).items():
        np.testing.assert_allclose(getattr(recording, name), values, rtol=1e-9, atol=1e-12)


def test_groups_of_an_mdf_file_keep_their_own_stamps(tmp_path, simulated):
    """Two rasters: the torque is interpolated at the position's stamps, not paired by rows."""
    asammdf = pytest.importorskip("asammdf", reason="writes MDF4")
    s, late = simulated, 0.5 * simulated.time[1]
    ramp = 3.0 * s.time
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(s.position, s.time, name="q", unit="rad")], acq_name="encoder")
        torque = asammdf.Signal(ramp + 3.0 * late, s.time + late, name="tau", unit="N m")
        file.append([torque], acq_name="drive")
        file.save(tmp_path / "run.mf4")
    text = draft_configuration(None, tmp_path / "run.mf4", tmp_path / "knee.toml")["text"]
    (keys,) = tomllib.loads(text)["recordings"]
    recording = measured(Recording(Source.model_validate(keys), tmp_path))
    np.testing.assert_allclose(recording.torque, 3.0 * recording.time, rtol=1e-9)


@pytest.mark.parametrize("suffix", [".mf4", ".tdms", ".ulg", ".xlsx", ".bag"])
def test_a_library_that_is_absent_is_named(tmp_path, monkeypatch, suffix):
    def absent(name):
        raise ImportError(name)

    monkeypatch.setattr("bayesfric.recordings.readers.import_module", absent)
    (tmp_path / f"run{suffix}").write_bytes(b"x")
    with pytest.raises(BadInput) as caught:
        read_table(tmp_path / f"run{suffix}", TableOptions())
    has(str(caught.value), "pip install 'bayesfric[")
