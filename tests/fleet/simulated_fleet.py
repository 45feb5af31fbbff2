"""A fleet of small simulated axes, among them a broken file and one that is not there."""

import shutil

from tests.commands.bench import SMALL, simulated, simulation

SIMULATED = simulation(encoder_counts=2**20)
TEMPLATE = f"""{SMALL.replace("small.csv", "{file}")}
[sampling]
min_ess = 300
seed = "{{seed}}"

[self_check]
recordings = 0
"""
FLEET = """\
template = "unit.toml"

[units]
table = "units.csv"
"""


def write_fleet(folder, good=3):
    """Write template, table and recordings; the last two units are broken and missing."""
    (folder / "unit.toml").write_text(TEMPLATE)
    (folder / "fleet.toml").write_text(FLEET)
    rows = ["unit,file,seed,joint,km"]
    for k in range(good):
        text = SMALL + "\n[sampling]\nseed = 1\n" + SIMULATED
        if k < 3:
            simulated(folder / "small.toml", text, f"u{k}", seed=k)
        else:  # the same motion and noise, another seed of the sampler
            shutil.copyfile(folder / f"u{k % 3}.csv", folder / f"u{k}.csv")
        rows.append(f"a{k},u{k}.csv,{k},j{k % 2},{1.5 * k}")
    (folder / "broken.csv").write_text("time,position,torque\n1,2,3\n")
    rows += ["broken,broken.csv,7,j0,1.0", "missing,none.csv,8,j1,2.0"]
    (folder / "units.csv").write_text("\n".join(rows) + "\n")
    return folder / "fleet.toml"
