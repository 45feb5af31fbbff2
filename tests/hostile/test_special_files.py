"""What is no ordinary file, or far larger than it looks: refused at once, never run or awaited."""

import os
import pickle
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.recordings import Processing, Recording, Source
from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.tables import read_table
from tests.commands.bench import CONFIG, has
from tests.hostile import good
from tests.hostile.rule import SECONDS, at_most, check, refuses

FORMATS = ("csv", "json", "jsonl", "npz", "mat", "parquet", "hdf5", "mcap", "bag")
_READERS = {"mcap": "ros", "bag": "ros"}
SOURCE = {
    "time": {"column": "t", "unit": "s"},
    "position": {"column": "q", "unit": "rad"},
    "torque": {"column": "tau", "unit": "N m"},
}


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "data").mkdir()
    return tmp_path / "data"


def refused(folder, file, *, extra="", parts=(), seconds=SECONDS):
    path = folder / "c.toml"
    path.write_text(good.config(file, extra))
    refuses(path, *parts, seconds=seconds)


# -- pipes, devices, folders, links: one gate before all readers


def linked(to):
    return lambda path: path.symlink_to(to)


SPECIAL = {
    "pipe": (os.mkfifo, "no ordinary file"),
    "folder": (Path.mkdir, "is a folder"),
    "link to itself": (lambda path: path.symlink_to(path.name), "symbolic links"),
    "link to nothing": (linked("gone.csv"), "does not exist"),
} | {
    device: (linked(f"/dev/{device}"), "no ordinary file")
    for device in ("zero", "full", "null", "urandom")
}


@pytest.mark.parametrize("form", ["csv", "mcap"])
@pytest.mark.parametrize(("make", "says"), SPECIAL.values(), ids=SPECIAL)
def test_what_is_no_ordinary_file(folder, form, make, says):
    make(folder / f"run.{form}")
    refused(folder, f"run.{form}", parts=[f"run.{form}", says])


@pytest.mark.parametrize("form", FORMATS)
def test_device_is_not_read_whatever_is_said_of_its_format(folder, form):
    extra = f'\nformat = "{_READERS.get(form, form)}"'
    refused(folder, "/dev/zero", extra=extra, parts=["/dev/zero", "no ordinary file"])


def test_pattern_over_a_pipe_takes_the_files_only(folder):
    os.mkfifo(folder / "a.csv")
    (folder / "b.csv").write_bytes(good.content("csv"))
    assert check(_config(folder, "*.csv")).code == 0


def test_configuration_that_is_a_pipe(folder):
    os.mkfifo(folder / "c.toml")
    outcome = check(folder / "c.toml")
    assert outcome.code == 2
    has(outcome.err, "c.toml", "no ordinary file")


def test_pattern_does_not_go_round_in_linked_folders(folder):
    # each further level would double the number of paths, forty levels deep
    for name in ("a", "b"):
        (folder / name).symlink_to(".", target_is_directory=True)
    (folder / "deep").mkdir()
    (folder / "deep" / "run.csv").write_bytes(good.content("csv"))
    (folder / "c.toml").write_text(good.config("**/*.csv"))
    outcome = check(folder / "c.toml")
    assert outcome.code == 0, outcome
    assert outcome.out.count('"sha256"') == 1


def test_permission_denied_told_by_the_system(folder, monkeypatch):
    path = folder / "run.csv"
    path.write_bytes(good.content("csv"))
    opened = Path.open

    def denied(self, *arguments, **more):
        if self.name == path.name:
            raise PermissionError(13, "Permission denied")
        return opened(self, *arguments, **more)

    monkeypatch.setattr(Path, "open", denied)
    refused(folder, path.name, parts=[path.name, "permission"])


def test_files_outside_the_folder_are_allowed(tmp_path, folder):
    """A user's data may be anywhere: absolute paths and .. name what they name."""
    (tmp_path / "run.csv").write_bytes(good.content("csv"))
    for file in ("../run.csv", str(tmp_path / "run.csv"), "../r*.csv", str(tmp_path / "r*.csv")):
        (folder / "c.toml").write_text(good.config(file))
        assert check(folder / "c.toml").code == 0, file


def test_file_names_that_are_not_text(folder):
    with open(os.path.join(os.fsencode(folder), b"run\xff.csv"), "wb") as file:  # noqa: PTH123, PTH118
        file.write(good.content("csv"))
    refused(folder, "*.csv", parts=["run\\udcff.csv", "not UTF-8"])
    name = os.path.join(os.fsencode(folder), b"c\xff.toml")  # noqa: PTH118
    with open(name, "wb") as file:  # noqa: PTH123
        file.write(CONFIG.encode())
    outcome = check(os.fsdecode(name))
    assert outcome.code == 2
    has(outcome.err, "c\\udcff.toml", "not UTF-8")


@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.99])
@pytest.mark.parametrize("form", [f for f in good.FORMATS if f not in ("csv", "tsv", "jsonl")])
def test_file_that_is_cut_off(folder, form, share):
    path, data = folder / f"run.{form}", good.content(form)
    path.write_bytes(data[: int(share * len(data))])
    refused(folder, path.name, parts=[path.name])


# -- larger than they look


@pytest.mark.parametrize("form", [form for form in FORMATS if form != "bag"])
def test_sparse_file_of_a_tebibyte(folder, form):
    with (folder / f"run.{form}").open("wb") as file:
        file.truncate(2**40)
    refused(folder, f"run.{form}", parts=[f"run.{form}"])


def test_archive_that_hides_its_size(folder):
    """The directory claims a small member; only so much of it is unpacked."""
    path = folder / "run.npz"
    np.savez_compressed(path, **dict.fromkeys(("t", "q", "tau"), np.zeros(2**21)))
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        real = archive.getinfo("q.npy").file_size.to_bytes(4, "little")
    at = data.find(b"PK\x01\x02")
    assert real in data[at:]
    path.write_bytes(data[:at] + data[at:].replace(real, (1000).to_bytes(4, "little")))
    refused(folder, "run.npz", parts=["run.npz"])


# -- code inside data


class Payload:
    """Makes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def test_pickles_are_never_run(folder):
    trap = folder / "trap"
    payload, values = pickle.dumps(Payload(trap)), np.array([Payload(trap)] * 3, dtype=object)
    np.savez(folder / "objects.npz", t=values, q=values, tau=values)
    np.save(folder / "array.npy", values)
    (folder / "array.npy").rename(folder / "array.npz")
    (folder / "plain.npz").write_bytes(payload)
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (3,), }"
    npy = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + payload
    with zipfile.ZipFile(folder / "disguised.npz", "w") as archive:
        for name in ("t", "q", "tau"):
            archive.writestr(f"{name}.npy", npy)
    pickle.loads(payload)
    assert trap.exists()  # it would work
    trap.unlink()
    for name in ("objects.npz", "array.npz", "plain.npz", "disguised.npz"):
        for extra in ("", *(f'\nformat = "{_READERS.get(form, form)}"' for form in FORMATS)):
            refused(folder, name, extra=extra, parts=[name])
            assert not trap.exists()


# -- HDF5 holds links, and claims sizes that it does not hold; MATLAB 7.3 is HDF5, too


def _hdf5(path, make):
    with h5py.File(path, "w", userblock_size=512) as file:
        make(file)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize(
    "make",
    [
        lambda f: f.create_dataset("q", data=np.arange(9.0)),
        lambda f: f.update({"q": h5py.ExternalLink("/etc/passwd", "/x")}),
        lambda f: f.update({"q": h5py.ExternalLink("run.mat", "/q")}),
        lambda f: f.update({"q": h5py.SoftLink("/tau"), "tau": h5py.SoftLink("/q")}),
        lambda f: f.create_group("g").update({"up": f["/"]}),
        lambda f: f.create_dataset("q", shape=(2**50,), dtype="f8", chunks=(2**20,)),
        lambda f: f.create_dataset("q", data=np.array([f.ref] * 3, dtype=h5py.ref_dtype)),
    ],
    ids=["plain", "external", "itself", "soft-loop", "hard-loop", "huge", "references"],
)
@pytest.mark.parametrize("share", [1.0, 0.5])
@pytest.mark.parametrize("form", ["mat", "h5"])
def test_hdf5(folder, make, share, form):
    path = folder / f"run.{form}"
    _hdf5(path, make)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    refused(folder, path.name, parts=[path.name])


@pytest.mark.parametrize("form", ["mat", "h5"])
@pytest.mark.parametrize("name", ["q", "tau"])
def test_hdf5_takes_nothing_from_another_file(folder, form, name):
    """What the link leads to would do."""
    t, q, tau = good.columns().values()
    _hdf5(folder / "other.h5", lambda f: f.update({"t": t, "q": q, "tau": tau}))
    _hdf5(folder / f"run.{form}", lambda f: f.update({"t": t, "q": q, "tau": tau}))
    assert check(_config(folder, f"run.{form}")).code == 0
    with h5py.File(folder / f"run.{form}", "r+") as file:
        del file[name]
        file[name] = h5py.ExternalLink("other.h5", f"/{name}")
    refused(folder, f"run.{form}", parts=[f"'{name}'", "does not exist"])
    with h5py.File(folder / f"run.{form}", "r+") as file:
        del file[name]
        layout = h5py.VirtualLayout(shape=(good.N,), dtype="f8")
        layout[:] = h5py.VirtualSource("other.h5", name, shape=(good.N,))
        file.create_virtual_dataset(name, layout)
    refused(folder, f"run.{form}", parts=[f"'{name}'", "another file"])
    (folder / "raw").write_bytes(q.tobytes())
    with h5py.File(folder / f"run.{form}", "r+") as file:
        del file[name]
        file.create_dataset(name, (good.N,), "f8", external=[(folder / "raw", 0, 8 * good.N)])
    refused(folder, f"run.{form}", parts=[f"'{name}'", "another file"])


def _config(folder, file):
    (folder / "c.toml").write_text(good.config(file))
    return folder / "c.toml"


# -- very wide


@pytest.mark.parametrize("columns", [20, 9_999])
def test_wide_but_possible(folder, columns):
    head = ",".join(["t", "q", "tau", *(f"c{i}" for i in range(columns - 3))])
    rest = ",1" * (columns - 3)
    rows = good.content("csv", 110).decode().splitlines()[1:]
    (folder / "run.csv").write_text("\n".join([head, *(row + rest for row in rows)]))
    with at_most(SECONDS):
        source = Source.model_validate({"file": "run.csv", **SOURCE})
        (read,) = read_recordings(
            Recording(source, folder), ratio=1.0, motion="rotary", processing=Processing()
        )
    assert len(read.time) == 110


def test_too_wide_is_told(folder):
    (folder / "run.csv").write_text("\n".join([",".join(["1"] * 10_001)] * 60))
    refused(folder, "run.csv", parts=["run.csv", "10001 columns"])


# -- memory


def test_no_memory_left_is_told(folder, monkeypatch):
    (folder / "run.npz").write_bytes(good.content("npz"))

    def full(*_, **__):
        raise MemoryError

    monkeypatch.setattr(np, "squeeze", full)
    refused(folder, "run.npz", parts=["run.npz", "MemoryError"])
    monkeypatch.undo()
    monkeypatch.setattr("bayesfric.recordings.read.make_grid", full)
    refused(folder, "run.npz", parts=["run.npz", "memory"])


def test_table_is_not_read_before_it_is_asked_for(folder):
    """A column that is damaged does not spoil the others."""
    np.savez(folder / "run.npz", t=np.arange(3.0))
    with zipfile.ZipFile(folder / "run.npz", "a") as archive:
        archive.writestr("q.npy", b"\x93NUMPY\x01\x00no array")
    table = read_table(folder / "run.npz", Source.model_validate({"file": "run.npz", **SOURCE}))
    assert table.column("t").tolist() == [0.0, 1.0, 2.0]
    with pytest.raises(BadInput, match="readable npz"):
        table.column("q")
