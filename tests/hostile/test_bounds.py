"""What a few bytes ask for has a bound: sizes, patterns, priors, fleets."""

import zipfile
import zlib

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bayesfric.export.formats.mujoco import patched
from tests.commands.bench import PRIOR, SAMPLED, cases
from tests.fleet.made import FLEET, TEMPLATE
from tests.hostile import good
from tests.hostile.bounded import Bounded
from tests.hostile.rule import SECONDS, at_most


@pytest.fixture(scope="module")
def process():
    made = Bounded()
    yield made
    made.close()


def rows(cell, every=False):
    text = good.content("csv").decode().splitlines()
    return "\n".join(
        f"{row.rpartition(',')[0]},{cell}" if k and (every or k == 5) else row
        for k, row in enumerate(text)
    ).encode()


# -- sizes


@pytest.mark.parametrize(
    "text",
    cases(
        ("cell", rows("9" * 20_000 + "x")),
        ("column", rows("9" * 20_000 + "x", every=True)),
        ("above", b"9" * 1_000_000 + b"x\n" + good.content("csv")),
        ("header", ("t,q,tau\n" + f"{'9' * 20_000}x,{'1' * 20_000}y,3\n" * 300).encode()),
        ("dots", rows("1." * 10_000)),
        ("infinite", rows("9" * 20_000)),
    ),
)
def test_cells_of_many_digits(process, tmp_path, text):
    (tmp_path / "run.csv").write_bytes(text)
    (tmp_path / "c.toml").write_text(good.config("run.csv"))
    outcome = process.run(tmp_path, "check", "c.toml")
    assert outcome.code in (0, 2)  # what stands above a table is skipped
    assert outcome.code == 0 or "run.csv" in outcome.err


def hdf5(path, shape, chunks, pieces=1):
    """Write a position of zeros, each chunk next to nothing on the disk."""
    deflate = zlib.compressobj(1)
    size = 8 * int(np.prod(chunks))
    packed = b"".join(deflate.compress(bytes(2**24)) for _ in range(size >> 24)) + deflate.flush()
    with h5py.File(path, "w") as file:
        file.update({name: values for name, values in good.columns().items() if name != "q"})
        made = file.create_dataset("q", shape, "f8", maxshape=(None,) * len(shape), chunks=chunks,
                                   compression="gzip")  # fmt: skip
        for k in range(pieces):
            made.id.write_direct_chunk((k * chunks[0], *(0 for _ in chunks[1:])), packed)


def npz(path, size):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("t", "q", "tau"):
            with archive.open(f"{name}.npy", "w") as member:
                shape = (size // 8,)
                np.lib.format.write_array_header_1_0(
                    member, {"descr": "<f8", "fortran_order": False, "shape": shape}
                )
                for _ in range(size >> 24):
                    member.write(bytes(2**24))


def parquet(path, table, times):
    with pq.ParquetWriter(path, table.schema, compression="zstd") as writer:
        for _ in range(times):
            writer.write_table(table)


def repeated(path):
    ones = pa.array(np.ones(2**20))
    parquet(path, pa.table({"t": ones, "q": ones, "tau": ones}), 60)


def lists(path):
    one = pa.array([np.ones(2**10)] * 2**10)
    parquet(path, pa.table({"t": one, "q": one, "tau": one}), 60)


@pytest.mark.parametrize(
    ("name", "make"),
    cases(
        ("chunk", "run.h5", lambda path: hdf5(path, (250,), (4 * 10**8,))),
        ("chunks", "run.h5", lambda path: hdf5(path, (6 * 2**24,), (2**24,), 6)),
        ("unwritten", "run.h5", lambda path: hdf5(path, (4 * 10**8,), (10**6,), 0)),
        ("matlab", "run.mat", lambda path: hdf5(path, (250, 10**7), (250, 10**6))),
        ("npz", "run.npz", lambda path: npz(path, 2**29)),
        ("rows", "run.parquet", repeated),
        ("lists", "run.parquet", lists),
    ),
)
def test_an_array_takes_256_mebibytes_at_most(process, tmp_path, name, make):
    make(tmp_path / name)
    (tmp_path / "c.toml").write_text(good.config(name))
    process.refused(tmp_path, "check", "c.toml", parts=[name, "MiB, more than 256"])


def test_a_constant_that_is_packed_a_thousandfold_is_read(process, tmp_path):
    n = 40_000
    t = np.arange(n) * 1e-3
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file.update({"t": t, "q": np.sin(3 * t)})
        file.create_dataset("tau", data=np.zeros(n), chunks=(n,), compression="gzip")
        packed = file["tau"].id.get_storage_size()
    assert 8 * n > 500 * packed
    (tmp_path / "c.toml").write_text(good.config("run.h5"))
    assert "tau" in process.run(tmp_path, "check", "c.toml").err  # which never changes


@pytest.mark.parametrize("count", [0, 1001, 90_000])
def test_frequencies_are_a_thousand_at_most(process, tmp_path, count):
    asked = f"frequencies = [{', '.join(f'{1 + k * 1e-4:.4f}' for k in range(count))}]"
    kind = 'excitation = "multisine"'
    (tmp_path / "c.toml").write_text(SAMPLED.replace(kind, f"{kind}\n{asked}"))
    process.refused(tmp_path, "simulate", "c.toml", "-o", "s.csv", parts=["simulation.frequencies"])


MODEL = "<mujoco>{}<body>{}<joint name='knee'{}/></body></mujoco>"


@pytest.mark.parametrize(
    "text",
    cases(
        ("comments", MODEL.format("<!-- a -->" * 40_000, "<!-- b -->\n" * 40_000, "")),
        ("spaces", MODEL.format("", "", " " * 400_000 + "pos='0 0 0'" + "\n" * 400_000)),
        ("depth", MODEL.format("<a>" * 50_000 + "</a>" * 50_000, "", " " * 400_000)),
        ("joints", MODEL.format("", "<body><joint/></body>" * 60_000, "")),
    ),
)
def test_a_model_is_changed_in_linear_time(text):
    with at_most(SECONDS):
        changed = patched(text, "knee", {"armature": "1.5", "damping": "2.5"}, "m.xml")
    assert changed.count(' armature="1.5" damping="2.5"') == 1
    assert changed.replace(' armature="1.5" damping="2.5"', "") == text


@pytest.mark.parametrize(
    "prior",
    cases(
        ("rice", '{ distribution = "rice", b = 1e9 }'),
        ("irwinhall", '{ distribution = "irwinhall", n = 1e5 }'),
        ("range", '{ distribution = "studentized_range", k = 3.0, df = 10.0 }'),
        ("nan", '{ distribution = "norminvgauss", a = 1.0, b = 0.9999 }'),
    ),
)
def test_a_prior_that_takes_long_is_refused_by_name(process, tmp_path, prior):
    (tmp_path / "run.csv").write_bytes(good.content("csv"))
    text = good.config("run.csv").replace(PRIOR, f'"motor.coulomb" = {prior}')
    (tmp_path / "c.toml").write_text(text)
    process.refused(tmp_path, "check", "c.toml", parts=["priors.motor.coulomb", "in a second"])


# -- fleets

UNITS = "unit,file,seed,joint,km\na0,u0.csv,1,j0,1\n"
FOUND = '[units]\nglob = "{}"\n'


def fleet(folder, *, plan=FLEET, template=TEMPLATE, units=UNITS):
    (folder / "fleet.toml").write_text(plan)
    (folder / "unit.toml").write_text(template)
    (folder / "units.csv").write_text(units)


def test_a_fleet_is_refused_that_has_no_recordings(process, tmp_path):
    """What the others would end with, were they not refused before."""
    fleet(tmp_path, units=UNITS.replace("seed", "sead"))
    process.refused(tmp_path, "fleet", "fleet.toml", parts=["asks for {seed}"])


@pytest.mark.parametrize(
    "text",
    cases(
        ("arrays", "[priors]\nx = " + "[" * 900 + "]" * 900),
        ("deep-arrays", "[priors]\nx = " + "[" * 50_000 + "]" * 50_000),
        ("tables", "[priors]\nx = " + "{a=" * 400 + "1" + "}" * 400),
        ("dots", "[priors]\n" + "a." * 600 + "b = 1"),
        ("quoted-dots", "[priors]\n" + '"a".' * 600 + "b = 1"),
        ("header", "[" + "a." * 600 + "b]"),
        ("keys", "[priors]\n" + "\n".join(f"{'a.' * 60}b{k} = 1" for k in range(2200))),
    ),
)
def test_templates_are_not_deep(process, tmp_path, text):
    fleet(tmp_path, template=f"{TEMPLATE}\n{text}\n")
    process.refused(tmp_path, "fleet", "fleet.toml", parts=["unit.toml"])


@pytest.mark.parametrize(
    ("pattern", "parts"),
    cases(
        ("deep", "*/" * 3000 + "{unit}.csvx", ["looks at more than 100000"]),
        ("stars", "**/" * 25 + "{unit}.csvx", ["no file"]),
        ("stars-and-folders", "**/*/" * 12 + "{unit}.csvx", []),
        ("everything", "/**/{unit}.csvx", ["looks at more than 100000"]),
        ("letters", "{a}a{b}a{c}a{d}a{e}a{f}a{g}a{h}a{i}a{j}a{k}a{a}", ["no file"]),
    ),
)
def test_patterns_look_at_so_many_files(process, tmp_path, pattern, parts):
    # each further level would double the number of paths
    for name in ("x", "y"):
        (tmp_path / name).symlink_to(".", target_is_directory=True)
    (tmp_path / ("a" * 150 + "b")).touch()
    (tmp_path / "/".join("abcdefghijkl")).mkdir(parents=True)
    fleet(tmp_path, plan=f'template = "unit.toml"\n{FOUND.format(pattern)}')
    process.refused(tmp_path, "fleet", "fleet.toml", parts=["units.glob", *parts])
    if "**" in pattern:
        text = good.config(pattern.replace("{unit}", "*"))
        (tmp_path / "c.toml").write_text(text)
        process.refused(tmp_path, "check", "c.toml", parts=["recordings.1"])


WIDE = ",".join(f"c{k}" for k in range(60_000))


@pytest.mark.parametrize(
    ("changed", "parts"),
    cases(
        ("columns", {"units": UNITS.replace("km", f"km,{WIDE}")}, ["60005 columns"]),
        ("rows", {"units": UNITS + "a0,u0.csv,1,j0,1\n" * 200_000}, ["rows, more than 100000"]),
        ("bytes", {"units": UNITS + "x" * 2**25}, ["larger than 16 MiB"]),
        ("name", {"units": UNITS.replace("a0", "9" * 140_000)}, ["cannot be the name"]),
        ("cell", {"units": UNITS.replace("j0", "j" * 1_200_000),
                  "template": TEMPLATE.replace("{file}", "{joint}")}, ["1200000 characters"]),
        ("cells", {"units": UNITS.replace("j0", "j" * 100_000),
                   "template": TEMPLATE.replace("{file}", "{joint}" * 30_000)},
         ["unit.toml", "characters"]),
        ("texts", {"units": UNITS.replace("j0", "j" * 900_000),
                   "template": TEMPLATE + '[references]\nx = { source = "{joint}" }\n'
                   + 'y = { source = "{joint}" }\n'}, ["more than 1000000 characters"]),
        ("named", {"units": UNITS.replace("j0", "j" * 100_000),
                   "plan": FLEET + f'name = "{"{joint}" * 30_000}"\n'}, ["units.name"]),
    ),
)  # fmt: skip
def test_tables_of_units_have_bounds(process, tmp_path, changed, parts):
    fleet(tmp_path, **changed)
    process.refused(tmp_path, "fleet", "fleet.toml", parts=parts)


@pytest.mark.parametrize("size", ["1e400 GiB", "1e308 GiB", "nan", "inf GiB", "-1 GiB", "1 B", ""])
def test_a_limit_of_memory_is_one(process, tmp_path, size):
    fleet(tmp_path, plan=f'{FLEET}\n[cluster]\nmemory_limit = "{size}"\n')
    process.refused(tmp_path, "fleet", "fleet.toml", parts=["cluster.memory_limit"])
