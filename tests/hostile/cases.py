"""Case number i of a seed: a folder's contents, the same on every machine."""

from dataclasses import dataclass

import numpy as np

from tests.hostile import good, random_configs, random_files

# one more key of the recording, as users of each format write it
_KEYS = {
    "csv": (
        "",
        "",
        "",
        "\nheader = true",
        "\nheader = false",
        '\ndelimiter = ";"',
        '\ndecimal = ","\ndelimiter = ";"',
        "\nskip_rows = 3",
        '\ndelimiter = "whitespace"',
        "\nstart = 0.3",
        '\nvalid = "q"',
    ),
    "jsonl": ("", "", '\ntable = "a.b"', "\nwhere = { q = 0.0 }"),
    "h5": ("", "", '\ntable = "log"', '\nwhere = { "more[0]" = 0.0 }'),
    "mcap": ("", "", '\ntable = "/joint_states"', '\ntable = "/x"'),
    "bag": ("", "", '\ntable = "/joint_states"'),
    "parquet": ("", "", "\nwhere = { t = 0.01 }", '\nwhere = { "state[1]" = 0.3 }'),
    "json": ("", "", '\ntable = "a.b"', '\ntable = ""'),
    "mat": ("", "", '\ntable = "log"', '\ntable = "s.a"'),
}


@dataclass
class Case:
    kind: str
    config: bytes
    name: str
    recording: bytes

    @property
    def named(self):
        """What a complaint must name: the file, or any key of a configuration."""
        return () if "config" in self.kind else ("run.", "'run'", ": run:")

    def write(self, folder):
        """Make the folder hold this case only; where its configuration is."""
        for path in folder.iterdir():
            path.unlink()
        (folder / self.name).write_bytes(self.recording)
        path = folder / "c.toml"
        path.write_bytes(self.config)
        return path


def case(seed, index):
    """Case ``index`` of ``seed``; one in four is a configuration, the rest are recordings."""
    rng = np.random.default_rng([seed, index])
    if index % 4 == 0:
        make = random_configs.edited if rng.random() < 0.7 else random_configs.damaged
        return Case(f"{make.__name__} config", make(rng), "run.csv", good.content("csv"))
    if index % 4 == 1:
        form = list(random_files.ODD)[index // 4 % len(random_files.ODD)]
        recording, kind = random_files.ODD[form](rng), f"odd {form}"
    else:
        form = good.FORMATS[index // 4 % len(good.FORMATS)]
        recording, kind = random_files.damaged(form, rng), f"damaged {form}"
    suffix = form.rpartition(".")[2]
    keys = _KEYS.get("csv" if suffix == "tsv" else suffix, ("",))
    name = f"run.{suffix}"
    text = good.config(name, keys[int(rng.integers(len(keys)))])
    return Case(kind, text.encode(), name, recording)
