"""``bayesfric init fleet``: a commented plan of a fleet to start from."""

from __future__ import annotations

# What is written in place of a preset.
FLEET = "fleet"
PLAN = """\
# bayesfric fleet: one configuration, fitted for every file of a folder.
# What begins with '#' is an example; every key: bayesfric init fleet --all-keys
[units]
glob = "recordings/{unit}.csv"  # or a table of them, whose columns the template's texts can hold:
# table = "units.csv"  # file,mass,robot,day: then added_mass = "{mass} kg" below
# name = "{robot}-{day}"
# joint = "robot"  # shared by the days of one joint
# over = "day"  # to look for a trend over

[runs]
# light = true  # no figures, tables and pages, and few draws

[cluster]
# workers = 4

# The configuration, see 'bayesfric init'; or, above [units]: template = "unit.toml"
[template.mechanism]
preset = "motor-axis"

[[template.recordings]]
file = "{file}"
time = { column = "time", unit = "s" }
position = { column = "position", unit = "rad" }
torque = { column = "torque", unit = "N m" }
"""
