"""Good inputs to damage: one small recording in every format, and configurations for it."""

import io
import json
import tempfile
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from scipy.io import savemat

from tests.commands.bench import CONFIG, swing
from tests.recordings import logs

N = 250
FORMATS = (
    "csv", "tsv", "json", "rows.json", "npz", "deflated.npz", "mat", "deflated.mat", "parquet",
    "lists.parquet", "jsonl", "h5", "7.3.mat", "mcap", "packed.mcap", "bag", "db3", "npy",
)  # fmt: skip
# how the columns of the configurations are called where that is not t, q and tau
NAMES = {
    form: {"t": "header.stamp", "q": "position[knee]", "tau": "effort[knee]"}
    for form in ("mcap", "bag", "db3")
}

# every table and most keys, so that damage meets each reader of the configuration
LONG_CONFIG = """\
[mechanism]
preset = "rabbit-knee"
offset = true
gain = false
elements.motor.viscous = true
elements.gearbox = { load_loss = "two", ratio = 50.0 }
load = { gravity_angle = false, gravity = 9.81 }

[[recordings]]
file = ["run.csv"]
format = "csv"
delimiter = ","
decimal = "."
skip_rows = 0
time = { column = "t", unit = "s" }
position = { column = "q", unit = "turn/8192", side = "motor", sign = -1 }
velocity = { column = 2, unit = "rpm", side = "joint" }
current = { column = "tau", unit = "A", torque_constant = "0.32 N m/A" }
start = "0.1 s"
stop = 30.0
exclude = [[0.5, 0.6], ["700 ms", "0.8 s"]]
added_mass = "2 kg"
radius = "35 cm"
name = "knee"

[processing]
lowpass = "8 Hz"
order = 4
decimate = 3
band = 10.0
dead_zone = "0.5 deg/s"
trim = "50 ms"

[likelihood]
method = "output-error"

[noise]
scale = "per-recording"

[estimation]
starts = 4
seed = 3

[sampling]
walkers = 64
ensembles = 4
seed = 1

[advice]
torque_limit = 1.0
masses = [{ mass = "2 kg", radius = 0.35 }]

[priors]
"motor.inertia" = { distribution = "norm", loc = 3.32e-4, scale = 1e-5 }
load = { first_moment = 0.41 }
motor.viscous = [0.0, 1.0]

[references]
"motor.inertia" = { value = 3.32e-4, source = "data sheet" }
"""


def columns(n=N):
    return dict(zip(("t", "q", "tau"), swing(n), strict=True))


@cache
def _bag(form, n):
    """Write a bag of two joints, the second without a motion, and a topic of talk."""
    t, q, tau = swing(n)
    zero = np.zeros_like(t)
    store = logs.ROS1 if form == "bag" else logs.ROS2
    signals = (np.stack([one, zero], axis=1) for one in (q, zero, tau))
    messages = logs.joint_states(t, *signals, store=store, joints=("knee", "hip"))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        if form == "bag":
            return logs.write_ros1(folder / "run.bag", messages).read_bytes()
        suffix = form.rpartition(".")[2]
        plugin = logs.StoragePlugin.SQLITE3 if suffix == "db3" else logs.StoragePlugin.MCAP
        logs.write_ros2(folder / "run", messages, plugin, packed=form == "packed.mcap")
        (path,) = (folder / "run").glob(f"*.{suffix}")
        return path.read_bytes()


def content(form, n=N, data=None):
    """Bytes of the good recording, or of other columns, in one of FORMATS."""
    given, data = data is not None, columns(n) if data is None else data
    rows = [] if given else np.stack(list(data.values()), axis=1).tolist()
    out = io.BytesIO()
    match form:
        case "csv" | "tsv":
            mark = "," if form == "csv" else "\t"
            text = [mark.join(data), *(mark.join(map(repr, row)) for row in rows)]
            return ("\n".join(text) + "\n").encode()
        case "json":
            return json.dumps({name: values.tolist() for name, values in data.items()}).encode()
        case "rows.json":
            return json.dumps([dict(zip(data, row, strict=True)) for row in rows]).encode()
        case "npz":
            np.savez(out, **data)
        case "npy":
            np.save(out, np.rec.fromarrays(list(data.values()), names=list(data)))
        case "deflated.npz":
            np.savez_compressed(out, **data)
        case "mat":
            savemat(out, {**data, "log": {**data, "note": "x"}})
        case "deflated.mat":
            savemat(out, data, do_compression=True)
        case "parquet":
            pq.write_table(pa.table(data), out)
        case "lists.parquet":
            both = pa.array(np.stack([data["q"], data["tau"]], axis=1).tolist())
            pq.write_table(pa.table({**data, "state": both}), out)
        case "jsonl":
            lines = (json.dumps(dict(zip(data, row, strict=True))) for row in rows)
            return "".join(f"{line}\n" for line in lines).encode()
        case "h5" | "hdf5" | "7.3.mat":
            with h5py.File(out, "w", userblock_size=512 if form == "7.3.mat" else 0) as file:
                for name, values in data.items():
                    file[name] = values
                file.create_dataset("more", data=np.array(rows), chunks=(50, 3), compression="gzip")
            if form != "7.3.mat":
                return out.getvalue()
            return b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + out.getvalue()[128:]
        case _:
            return _bag(form, n)
    return out.getvalue()


def config(file, extra=""):
    """The good configuration for a file, with more keys for its recording."""
    text = CONFIG.replace('file = "run.csv"', f'file = "{file}"{extra}')
    for name, other in NAMES.get(file.rpartition(".")[2], {}).items():
        text = text.replace(f'column = "{name}"', f'column = "{other}"')
    return text
