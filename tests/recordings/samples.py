"""Small made-up recordings, and the way tests read them."""

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.source import Channel, Position, Processing, Recording, Source, Torque


def swing(n=200, period=0.01):
    """Return time, position and torque of a smooth swing with exact decimal time stamps."""
    t = np.round(np.arange(n) * period, 9)
    return t, np.sin(2 * np.pi * 0.7 * t), 0.3 * np.cos(2 * np.pi * 0.7 * t) + 0.01 * t


def lines(n=200, header="t,q,tau"):
    t, q, tau = swing(n)
    rows = [
        f"{a!r},{b!r},{c!r}" for a, b, c in zip(t.tolist(), q.tolist(), tau.tolist(), strict=True)
    ]
    return [header, *rows] if header else rows


def write(folder, text, name="run.csv", encoding="utf-8"):
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


def source(file="run.csv", **changes):
    keys = {
        "file": file,
        "time": Channel(column="t", unit="s"),
        "position": Position(column="q", unit="rad"),
        "torque": Torque(column="tau", unit="N m"),
    }
    keys.update(changes)
    return Source(**keys)


def numbered(file="run.csv", **changes):
    return source(
        file,
        time=Channel(column=1, unit="s"),
        position=Position(column=2, unit="rad"),
        torque=Torque(column=3, unit="N m"),
        **changes,
    )


def read(folder, used=None, *, ratio=1.0, motion="rotary", processing=None, **more):
    return read_recordings(
        Recording(used or source(), folder),
        ratio=ratio,
        motion=motion,
        processing=processing or Processing(),
        **more,
    )


def measured(recording, *, ratio=1.0, motion="rotary", number=1, **processing):
    """Read the one recording of a file or table; a load that slides has a motor that slides."""
    (measurement,) = read_recordings(
        recording,
        ratio=ratio,
        motion=motion,
        motor_motion=motion,
        processing=Processing(**processing),
        number=number,
    )
    return measurement


def refused(folder, used=None, **more):
    with pytest.raises(BadInput) as caught:
        read(folder, used, **more)
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.where
    assert caught.value.problem
    assert caught.value.hint
    return message


def has(message, *parts):
    for part in parts:
        assert part in message, message
