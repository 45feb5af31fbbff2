"""Do intervals hold where only targets and encoder are known? SIMULATED, whole path.

``python studies/motion_only/motion_only.py`` simulates joints by semi-implicit Euler steps of 25 us
with friction as an impulse, not by the package's integrator, fits each from targets and readings
alone, and counts how often its 90 % intervals hold. Writes ``motion_only.json``; ``--recordings N``
of each, ``--rows A B`` for less, ``--first N`` for other joints, ``--table`` prints.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numba import njit

import bayesfric as bf
from bayesfric.base.errors import BadInput

HERE = Path(__file__).parent
STEP, RATE, SPREAD = 25e-6, 200.0, 0.25
G = 9.80665
# Typical values: a servo with a known mass on its horn, a leg with known gravity. Errors are those
# of control, rms encoder counts.
SERVO = {"inertia": 0.0012, "viscous": 0.06, "coulomb": 0.03, "delay": 0.007, "kd": 0.0}
SERVO |= {"mass": 0.49, "radius": 0.1, "duration": 12.0, "counts": 4096.0}
LEG = {"inertia": 0.02, "viscous": 0.06, "coulomb": 0.25, "delay": 0.0125, "kd": 1.5, "kp": 20.0}
LEG |= {"moment": 0.15, "offset": 0.2, "duration": 20.0, "counts": 2.0 * np.pi / 3e-5}
ROWS: dict[str, dict[str, Any]] = {
    "servo, 160 counts": SERVO | {"kp": 1.5, "unknown": True},
    "servo, 60 counts": SERVO | {"kp": 12.0, "unknown": True},
    "servo, 30 counts": SERVO | {"kp": 60.0, "unknown": True},
    "servo, target not held": SERVO | {"kp": 1.5, "unknown": True, "smooth": True},
    "leg": LEG,
    "leg, kp unknown": LEG | {"unknown": True},
    "leg, instants uncertain by 0.9 ms": LEG | {"instants": 9e-4},
    "leg, drive at 1 kHz, not stated": LEG | {"loop": 1e-3},
    "leg, elastic at 25 Hz": LEG | {"elastic": 25.0},
    "leg, Stribeck 50 %": LEG | {"stribeck": 0.5},
}
# What their models lack; of these a name or a doubt is wanted, not intervals that hold.
WRONG = ("leg, elastic at 25 Hz", "leg, Stribeck 50 %")


@njit(cache=True)
def played(goal, push, step, per_sample, late, loop, p, kp, kd, elastic, stribeck):  # type: ignore[no-untyped-def]
    """Simulate positions ``(n,)`` at every step of one joint, whose drive holds its targets."""
    inertia, viscous, coulomb, moment, angle, offset = p
    share = 0.6 if elastic > 0.0 else 1.0
    near, far = share * inertia, (1.0 - share) * inertia
    stiff = (2.0 * np.pi * elastic) ** 2 * near * far / inertia
    q, v = goal[0], 0.0
    q2, v2 = q, v
    out = np.empty(push.size)
    control = 0.0
    for k in range(push.size):
        out[k] = q
        if k % loop == 0:
            i = min(max((k - late) // per_sample, 0), goal.size - 1)
            control = kp * (goal[i] - q) - kd * v
        weight = moment * np.sin((q if elastic == 0.0 else q2) + angle)
        torque = control + push[k] + offset
        if elastic > 0.0:
            carried = stiff * (q - q2) + 2.0 * 0.02 * np.sqrt(stiff * far) * (v - v2)
            torque -= carried
            v2 += step * (carried - weight) / far
            q2 += step * v2
        else:
            torque -= weight
        rise = 1.0 + stribeck * np.exp(-((v / 0.2) ** 2))
        w = (v + step * torque / near) / (1.0 + step * viscous / near)
        stop = step * coulomb * rise / (near + step * viscous)
        v = 0.0 if abs(w) <= stop else (w - stop if w > 0.0 else w + stop)
        q += step * v
    return out


def recorded(row: str, number: int) -> tuple[bf.Joint, bf.Recording, dict[str, Any], dict]:
    """Simulate one joint; return model, recording, priors and true values."""
    options, rng = ROWS[row], np.random.default_rng([67, *row.encode(), number])
    names = ("inertia", "viscous", "coulomb", "kp", "delay")
    true = {n: float(options[n] * rng.uniform(1.0 - SPREAD, 1.0 + SPREAD)) for n in names}
    is_servo = "mass" in options
    angle = float(rng.uniform(-0.1, 0.1)) if is_servo else 0.0
    moment = options["mass"] * options["radius"] if is_servo else options["moment"]
    inertia = true["inertia"] + (options["mass"] * options["radius"] ** 2 if is_servo else 0.0)
    time_s = np.arange(0.0, options["duration"], 1.0 / RATE)
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    if is_servo:
        waves = zip((0.7, 0.4, 0.2), (0.4, 1.1, 2.3), phases, strict=True)
        goal = np.sum([a * np.sin(2.0 * np.pi * f * time_s + x) for a, f, x in waves], axis=0)
    else:
        sweep = 0.2 * time_s + 0.5 * (3.5 - 0.2) / options["duration"] * time_s**2
        goal = 0.35 * np.sin(2.0 * np.pi * sweep + phases[0])
    per_sample = round(1.0 / (RATE * STEP))
    steps = time_s.size * per_sample
    fine = np.arange(steps) * STEP
    # a slow random torque, 0.3 % of kp times the targets' spread
    keeps, size = (
        np.exp(-1.0 / (RATE * rng.uniform(0.02, 0.2))),
        0.01 * true["kp"] * goal.std() * 0.3,
    )
    slow = np.zeros(time_s.size)
    for k, z in enumerate(rng.standard_normal(time_s.size - 1)):
        slow[k + 1] = keeps * slow[k] + size * np.sqrt(1.0 - keeps**2) * z
    smooth, passes = options.get("smooth", False), per_sample
    targets = goal
    if smooth:  # the drive's own targets lie between those of the log
        passes, targets = 40, np.interp(np.arange(0.0, options["duration"], 1e-3), fine, fine)
        waves = zip((0.7, 0.4, 0.2), (0.4, 1.1, 2.3), phases, strict=True)
        targets = np.sum([a * np.sin(2.0 * np.pi * f * targets + x) for a, f, x in waves], axis=0)
    p = (inertia, true["viscous"], true["coulomb"], moment * G, angle, options.get("offset", 0.0))
    q = played(
        targets, np.interp(fine, time_s, slow), STEP, passes, round(true["delay"] / STEP),
        max(1, round(options.get("loop", 0.0) / STEP)), p, true["kp"], options["kd"],
        options.get("elastic", 0.0), options.get("stribeck", 0.0),
    )  # fmt: skip
    instants = time_s + options.get("instants", 0.0) * rng.standard_normal(time_s.size)
    count = 2.0 * np.pi / options["counts"]
    readings = count * np.round(np.interp(instants, fine, q) / count)
    frame = pd.DataFrame({"t": time_s, "q": readings, "goal": goal})
    kp = true["kp"]
    gain = (
        [f"{0.3 * kp:.6g} N m/rad", f"{2.0 * kp:.6g} N m/rad"] if options.get("unknown") else None
    )
    target = {"column": "goal", "unit": "rad", "kp": gain or f"{kp:.12g} N m/rad"}
    target |= {} if smooth else {"held": True}
    target |= {"kd": f"{options['kd']} N m s/rad"} if options["kd"] else {}
    target |= {} if options.get("loop") else {"loop": "0 s", "velocity_filter": "0 s"}
    known = {"added_mass": options["mass"], "radius": options["radius"]} if is_servo else {}
    recording = bf.Recording.from_dataframe(frame, time="t", position="q", target=target, **known)
    load = bf.Load(first_moment=True, inertia=is_servo, gravity_angle=is_servo)
    motor = bf.Element("motor", inertia=True, viscous=True, coulomb="symmetric")
    truth = {f"motor.{n}": true[n] for n in names[:3]} | {"target.delay": true["delay"]}
    if smooth:  # half of the time that the drive holds its own targets
        truth["target.delay"] += 0.5 * passes * STEP
    if loop := options.get("loop"):  # a target waits for the drive's next turn
        truth["target.delay"] = loop * np.ceil(true["delay"] / loop - 1e-9)
    truth |= {"drive.kp": kp} if options.get("unknown") else {}
    if is_servo:
        priors = {"load.first_moment": 0.0, "load.inertia": 0.0}
        return bf.Joint([motor], load), recording, priors, truth | {"load.gravity_angle": angle}
    joint = bf.Joint([motor], load, offset=True)
    return joint, recording, {"load.first_moment": moment}, truth | {"offset": -p[5]}


def fitted(row: str, number: int) -> dict[str, Any]:
    """Fit one joint, and compare each number with its true value."""
    joint, recording, priors, truth = recorded(row, number)
    begun = time.process_time()
    try:
        summary = bf.Model(joint, [recording], priors=priors).fit(seed=number).summary
    except BadInput as error:
        return {"number": number, "refused": str(error)}
    rows = {}
    for name, true in truth.items():
        reported = summary.rows[name].reported
        low, high = reported.interval
        rows[name] = {
            "truth": true,
            "status": reported.status,
            "sd": reported.sd,
            "interval": [low, high],
            "z": (summary.rows[name].middle - true) / reported.sd,
            "posterior_z": (summary.rows[name].middle - true) / summary.rows[name].sd,
        }
    return {
        "number": number,
        "outcome": summary.verdict.outcome,
        "findings": [finding.kind for finding in summary.findings],
        "taken": [finding.kind for finding in summary.taken],
        "doubts": [doubt.kind for doubt in summary.doubts],
        "cpu_seconds": round(time.process_time() - begun, 1),
        "numbers": rows,
    }


def table(results: dict[str, list[dict[str, Any]]]) -> str:
    """Return the README's table."""
    lines = [
        "| row | fits | intervals hold | posterior's | identified | of these off | doubted or named"
        " | median half widths, % | CPU s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row, fits in results.items():
        done = [fit for fit in fits if "numbers" in fit]
        numbers = [(name, x) for fit in done for name, x in fit["numbers"].items()]
        held = [x["interval"][0] <= x["truth"] <= x["interval"][1] for _, x in numbers]
        plain = [abs(x["posterior_z"]) < 1.645 for _, x in numbers]
        sure = [x for _, x in numbers if x["status"] == "identified"]
        off = sum(abs(x["z"]) > 3.0 for x in sure)
        said = sum(bool(f["findings"] or f["taken"] or f["doubts"]) for f in done)
        widths: dict[str, list[float]] = {}
        for name, x in numbers:
            half = 50.0 * (x["interval"][1] - x["interval"][0]) / max(abs(x["truth"]), 1e-12)
            widths.setdefault(name.rpartition(".")[2], []).append(half)
        sizes = ", ".join(f"{name} {np.median(half):.2g}" for name, half in widths.items())
        cpu = np.median([fit["cpu_seconds"] for fit in done]) if done else np.nan
        lines.append(
            f"| {row} | {len(done)} | {np.mean(held):.0%} of {len(held)} | {np.mean(plain):.0%} "
            f"| {len(sure)} | {off} | {said} | {sizes} | {cpu:.0f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Fit the requested rows, and save after each fit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=40)
    parser.add_argument("--first", type=int, default=100)
    parser.add_argument("--rows", nargs="*", default=list(ROWS))
    parser.add_argument("--to", type=Path, default=HERE / "motion_only.json")
    parser.add_argument("--table", action="store_true", help="print what is saved")
    options = parser.parse_args()
    results = json.loads(options.to.read_text()) if options.to.is_file() else {}
    if not options.table:
        for row in options.rows:
            results[row] = []
            for number in range(options.first, options.first + options.recordings):
                results[row].append(fitted(row, number))
                options.to.write_text(json.dumps(results, indent=1) + "\n")
                print(row, number, results[row][-1].get("cpu_seconds"), flush=True)
    print(table(results))


if __name__ == "__main__":
    main()
