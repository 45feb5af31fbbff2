"""What the name of a column says: which signal, of which joint, in which unit."""

from __future__ import annotations

import re
from dataclasses import dataclass

from bayesfric.errors import BadInput
from bayesfric.recordings import units

# Words for each channel, the surest first.
_WORDS: dict[str, tuple[str, ...]] = {
    "time": ("time", "timestamp", "t", "stamp", "clock", "seconds", "zeit", "received"),
    "velocity": (
        "velocity",
        "velocities",
        "vel",
        "qd",
        "dq",
        "qvel",
        "qdot",
        "speed",
        "omega",
        "v",
    ),
    "torque": ("torque", "torques", "tau", "effort", "efforts", "trq", "moment", "force", "load"),
    "current": ("current", "currents", "iq", "curr", "amps", "ampere", "i"),
    "voltage": ("voltage", "volts", "volt", "pwm", "duty", "u"),
    "temperature": ("temperature", "temp"),
    "position": (
        *("position", "positions", "pos", "q", "qpos", "angle", "theta", "phi", "encoder", "enc"),
        *("qm", "state", "winkel"),
    ),
}
# Letters that say something only where they are the whole name.
_LETTERS = {"t", "v", "i", "u"}
# A column with such a word is not what was measured, or not of the joint.
_WANTED = {
    *("target", "desired", "goal", "command", "commanded", "cmd", "ref", "reference", "setpoint"),
    *("des", "sp", "action", "error", "limit", "max", "min", "raw", "bus", "input", "supply"),
}
_MEASURED = {"actual", "measured", "meas", "estimate", "est", "feedback"}
# Words that say nothing of which joint it is.
_FILL = {
    *("joint", "joints", "motor", "observation", "observations", "obs", "header", "in", "the"),
    *("output", "axis", "data", "value", "values", "signal", "log", "electrical", "control"),
}
_KINDS: dict[str, tuple[units.Kind, ...]] = {
    "time": ("time",),
    "position": ("angle", "length"),
    "velocity": ("angular_speed", "speed"),
    "torque": ("torque", "force"),
    "current": ("current",),
    "voltage": ("voltage",),
    "temperature": (),
}
_USE = {"enable", "enabled", "valid"}
# Units as they are written in names, where pint would not read them so.
_SPELT: dict[str, dict[str, str]] = {
    "time": {"sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "usec": "us", "nsec": "ns"},
    "position": {"degrees": "deg", "°": "deg", "rev": "turn", "revs": "turn", "turns": "turn"},
    "velocity": {
        **{"rads": "rad/s", "radps": "rad/s", "rad s": "rad/s", "degs": "deg/s", "dps": "deg/s"},
        **{"degps": "deg/s", "deg s": "deg/s", "°/s": "deg/s", "rps": "turn/s", "1/min": "rpm"},
        **{"rev/s": "turn/s", "turns/s": "turn/s", "u/min": "rpm", "hz": "turn/s"},
    },
    "torque": {"nm": "N m", "mnm": "mN m", "n m": "N m", "n": "N"},
    "current": {"a": "A", "ma": "mA", "amps": "A"},
    "voltage": {"v": "V", "mv": "mV", "volts": "V"},
}
_PLAIN_UNIT = re.compile(r"[A-Za-zµ°]")
_BRACKETS = re.compile(r"[\[(]([^\[\]()]*)[\])]\s*$")
_PARTS = re.compile(r"(?:m[AV]|mNm|Nm)(?![A-Za-z])|[A-Z]?[a-z]+|[A-Z]+(?![a-z])|\d+|°")


@dataclass(frozen=True)
class Named:
    """What a column's name says."""

    channel: str  # key of a channel, empty if nothing is recognised
    rank: float  # lower is surer
    joint: str  # which joint, empty if the name does not tell
    unit: str  # empty if the name does not tell


def named(name: str, written: str = "") -> Named:
    """Take a column's name apart; ``written`` is a unit that the file gives for it elsewhere."""
    text, inside = name.strip(), ""
    if found := _BRACKETS.search(text):
        text, inside = text[: found.start()], found[1].strip()
    words = [part.lower() for part in _PARTS.findall(text.rpartition("/")[2])]
    # i_q and I_q are one word
    for k in range(len(words) - 1):
        if words[k : k + 2] == ["i", "q"]:
            words[k : k + 2] = ["iq"]
            break
    channel, rank = _channel(words)
    if not channel:
        return Named("", 0.0, inside, "")
    unit = unit_of(channel, written) or unit_of(channel, inside)
    joint = [] if not inside or (unit and not written) else [inside]
    left = [w for w in words if w not in _WORDS[channel]]
    if not unit:
        for count in (2, 1):
            ending = left[-count:]
            if len(ending) == count and (unit := unit_of(channel, " ".join(ending))):
                left = left[:-count]
                break
    rank += 10.0 * any(word in _WANTED for word in left)
    rank -= 0.5 * any(word in _MEASURED for word in left)
    known = _FILL | _MEASURED | _WANTED
    label = [w for w in left if w not in known and not any(w in row for row in _WORDS.values())]
    return Named(channel, rank, " ".join([*label, *joint]), unit)


def tells_use(name: str) -> bool:
    """Whether a column says when the motor was on."""
    return any(part.lower() in _USE for part in _PARTS.findall(name))


def _channel(words: list[str]) -> tuple[str, float]:
    """Choose the channel whose word stands last, as in ``motor current`` and ``pos_estimate``."""
    alone = sum(not word.isdecimal() for word in words) == 1
    for word in reversed(words):
        if word in _LETTERS and not alone:
            continue
        for channel, known in _WORDS.items():
            if word in known:
                return channel, 0.1 * known.index(word)
    return "", 0.0


def unit_of(channel: str, text: str) -> str:
    """Give a unit as a configuration writes it; empty where it is none of the channel's kind."""
    text = text.strip().strip("[]()").strip()
    spelt = _SPELT.get(channel, {}).get(text.lower(), text)
    if channel == "temperature":
        return spelt if spelt in ("degC", "°C", "K") else ""
    if not _PLAIN_UNIT.search(spelt):
        return ""
    for kind in _KINDS[channel]:
        try:
            units.scale([spelt], kind)
        except BadInput:
            continue
        return spelt
    return ""
