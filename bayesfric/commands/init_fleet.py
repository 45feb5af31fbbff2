"""``bayesfric init fleet``: a commented plan of a fleet to start from."""

from __future__ import annotations

from bayesfric.commands.init import options
from bayesfric.fleet.plan import FleetTables

# What is written in place of a preset.
FLEET = "fleet"
_PRESET = "motor-axis"


def fleet_plan() -> str:
    """Text of a commented ``FLEET.toml`` for a folder of recordings, the template in it."""
    return "\n".join(
        [
            "# bayesfric fleet: one configuration, fitted for every file of a folder.",
            "# Lines that begin with '#' are defaults or examples; remove the '#' to change them.",
            "",
            "# Where a table tells more of each unit, name it in place of the glob: 'table'. Its",
            '# columns can stand in the template\'s texts, such as added_mass = "{mass} kg".',
            *options("units", FleetTables, {"glob": "recordings/{unit}.csv"}),
            *options("runs", FleetTables),
            *options("cluster", FleetTables),
            "",
            "# The configuration; 'bayesfric init' writes all that may stand in one. In place of",
            '# these tables a file may be named, above [units]: template = "unit.toml".',
            "[template.mechanism]",
            f'preset = "{_PRESET}"',
            "",
            "[[template.recordings]]",
            'file = "{file}"',
            'time = { column = "time", unit = "s" }',
            'position = { column = "position", unit = "rad" }',
            'torque = { column = "torque", unit = "N m" }',
            "",
        ]
    )
