"""One small recording, written in every format of files."""

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

from tests.recordings import logs
from tests.recordings.samples import swing

FORMATS = (
    "csv", "json", "jsonl", "npz", "deflated.npz", "npy", "mat", "deflated.mat", "7.3.mat",
    "parquet", "h5", "mcap", "bag", "db3",
)  # fmt: skip


def columns():
    return dict(zip(("t", "q", "tau"), swing(), strict=True))


@cache
def _bag(form):
    t, q, tau = swing()
    store = logs.ROS1 if form == "bag" else logs.ROS2
    signals = (x[:, None] for x in (q, np.zeros_like(q), tau))
    messages = logs.joint_states(t, *signals, store=store, joints=("knee",))
    with tempfile.TemporaryDirectory() as name:
        if form == "bag":
            return logs.write_ros1(Path(name) / "run.bag", messages).read_bytes()
        plugin = logs.StoragePlugin.SQLITE3 if form == "db3" else logs.StoragePlugin.MCAP
        logs.write_ros2(Path(name) / "run", messages, plugin)
        (path,) = (Path(name) / "run").glob(f"*.{form}")
        return path.read_bytes()


def content(form, data=None):
    """Bytes of the recording, or of other columns, in one of FORMATS."""
    data = columns() if data is None else data
    out = io.BytesIO()
    match form:
        case "csv" | "jsonl":
            rows = zip(*(values.tolist() for values in data.values()), strict=True)
            if form == "jsonl":
                lines = [json.dumps(dict(zip(data, row, strict=True))) for row in rows]
            else:
                lines = [",".join(data), *(",".join(map(repr, row)) for row in rows)]
            return "".join(f"{line}\n" for line in lines).encode()
        case "json":
            return json.dumps({name: values.tolist() for name, values in data.items()}).encode()
        case "npz":
            np.savez(out, **data)
        case "deflated.npz":
            np.savez_compressed(out, **data)
        case "npy":
            np.save(out, np.rec.fromarrays(list(data.values()), names=list(data)))
        case "mat":
            savemat(out, data)
        case "deflated.mat":
            savemat(out, data, do_compression=True)
        case "parquet":
            pq.write_table(pa.table(data), out)
        case "h5" | "7.3.mat":
            with h5py.File(out, "w", userblock_size=512 if form == "7.3.mat" else 0) as file:
                file.update(data)
            if form == "7.3.mat":
                return b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + out.getvalue()[128:]
        case _:
            return _bag(form)
    return out.getvalue()
