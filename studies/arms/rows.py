"""Fit SIMULATED three-joint arms whose logs are fast, jittered, scaled, late or coupled.

``python studies/arms/rows.py`` simulates ``--arms`` (20) of each row and writes ``rows.json``;
``--rows NAME …`` are those to do again, ``--fits N`` (8) the arms of a row that are sampled.
Bodies of MuJoCo's arms differ from their URDF's by 5 % each and 5 % in common.
"""

import json
import sys
import tempfile
from argparse import ArgumentParser
from pathlib import Path

import numpy as np
import pandas as pd

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER.parents[1]))

import bayesfric as bf
from bayesfric.base.progress import Timer
from tests.arm.bench import GRAVITY, joint, link, rigid_torque, robot

PAN, SHOULDER, ELBOW = JOINTS = ("pan_joint", "shoulder_joint", "elbow_joint")
LINKS = ("base", "upper", "lower", "tool")
TYPICAL = {  # of pan, shoulder and elbow; times 0.5 to 1.5
    "motor.inertia": (0.8, 1.2, 0.4),
    "motor.coulomb": (4.0, 5.0, 2.0),
    "motor.viscous": (3.0, 4.0, 1.5),
    "motor.load": (0.1, 0.1, 0.1),
}
NOISE, SECONDS, LATE, GAINS, PAYLOAD, SCALE = 0.3, 12.0, 0.008, 0.1, 2.0, 1.4
FIRST = 7001  # seed
# Rate in Hz, jitter of stamps over the period, encoder step in rad.
TIMINGS = (
    (100, 0.0, 2e-5), (100, 0.2, 1e-4), (250, 0.1, 1e-3), (500, 0.0, 1e-3),
    (1000, 0.1, 2e-5), (1000, 0.2, 1e-3), (5000, 0.0, 2e-5), (5000, 0.2, 1e-4),
)  # fmt: skip
# What differs from a right log at 200 Hz.
ROWS = {
    "timing": {"timing": True},
    "efforts x 1.4": {"scale": dict.fromkeys(JOINTS, SCALE)},
    "one effort x 1.4": {"scale": {ELBOW: SCALE}},
    "one effort x -1": {"scale": {SHOULDER: -1.0}},
    "efforts without gravity": {"without_gravity": True},
    "wrong axis": {"axis": True},
    "bodies 25 % heavy": {"heavier": dict.fromkeys(LINKS, 1.25)},
    "lower link twice as heavy": {"heavier": {"lower": 2.0}},
    "upper link twice as heavy": {"heavier": {"upper": 2.0}},
    "gains off 10 %, known payload": {"gains": True},
    "coupled": {"coupled": True},
    "coupled, in arm.toml": {"coupled": True, "in arm.toml": True},
    "late": {"late": True},
}


def urdf(factors: dict[str, float], pan: str = "0 0 1") -> str:
    """Write the arm with masses and inertias times ``factors`` by link."""
    return robot(
        '<link name="root"/>',
        *(link(name, factors.get(name, 1.0)) for name in LINKS),
        joint(PAN, "root", "base").replace("0 1 0", pan),
        joint(SHOULDER, "base", "upper"),
        joint(ELBOW, "upper", "lower"),
        joint("wrist", "lower", "tool", "fixed"),
    )


def recorded(rng, text: str, truth: dict, row: dict, timing: tuple, gains: dict) -> tuple:
    """Record an arm with the friction of ``truth``: the log, and its motion ``(3, n, 3)``."""
    rate, jitter, step = timing
    stamps = np.arange(0.0, SECONDS, 1.0 / rate)
    time = stamps + np.clip(jitter * rng.normal(size=stamps.size), -0.45, 0.45) / rate
    motion = np.zeros((3, time.size, 3))
    for hertz, size in ((0.17, 0.5), (0.31, 0.4), (0.73, 0.2)):
        w = 2.0 * np.pi * hertz * rng.uniform(0.8, 1.2, 3)
        amplitude, phase = size * rng.uniform(0.7, 1.3, 3), rng.uniform(0.0, 2.0 * np.pi, 3)
        angle = w * time[:, None] + phase
        waves = np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)
        motion += amplitude * np.array(waves)
    q, qd, qdd = motion
    motors = np.eye(3)
    motors[2, 1] = 1.0 if row.get("coupled") else 0.0
    load = rigid_torque(text, q, qd, qdd, GRAVITY) @ np.linalg.inv(motors)
    rigid = load  # what efforts hold of it
    if row.get("without_gravity"):
        rigid = rigid_torque(text, q, qd, qdd, (0.0, 0.0, 0.0))
    qd, qdd = qd @ motors.T, qdd @ motors.T
    columns = {"time [s]": stamps if jitter else time}
    for k, (name, numbers) in enumerate(truth.items()):
        loss = numbers["motor.coulomb"] + numbers["motor.load"] * np.abs(load[:, k])
        effort = rigid[:, k] + numbers["motor.inertia"] * qdd[:, k] + loss * np.sign(qd[:, k])
        effort += numbers["motor.viscous"] * qd[:, k]
        if row.get("late"):
            effort = np.interp(time + LATE, time, effort)
        effort = effort / gains[name] + NOISE * rng.normal(size=time.size)
        columns[f"position[{name}] [rad]"] = step * np.round(q[:, k] / step)
        columns[f"effort[{name}] [N m]"] = row.get("scale", {}).get(name, 1.0) * effort
    return pd.DataFrame(columns), motion


def one_arm(folder: Path, row: dict, seed: int, *, fit: bool) -> dict:
    """Simulate, examine and perhaps fit one arm."""
    rng = np.random.default_rng(seed)
    common = 1.0 if row.get("heavier") else rng.normal(1.0, 0.05)
    factors = {
        x: common * rng.normal(1.0, 0.05) * row.get("heavier", {}).get(x, 1.0) for x in LINKS
    }
    truth = {
        name: {key: size[k] * rng.uniform(0.5, 1.5) for key, size in TYPICAL.items()}
        for k, name in enumerate(JOINTS)
    }
    gains = {name: rng.normal(1.0, GAINS) if row.get("gains") else 1.0 for name in JOINTS}
    timing = TIMINGS[seed % len(TIMINGS)] if row.get("timing") else (200, 0.0, 2e-5)
    nominal = urdf({})
    if row.get("axis"):  # of the pan, or of the shoulder
        nominal = urdf({}, "0 1 0") if seed % 2 else nominal.replace("0 1 0", "0 0 1", 1)
    (folder / "arm.urdf").write_text(nominal)
    options, logs = {}, [folder / "bare.csv"]
    frame, motion = recorded(rng, urdf(factors), truth, row, timing, gains)
    frame.to_csv(logs[0], index=False)
    if row.get("gains"):
        logs.append(folder / "loaded.csv")
        loaded = {**factors, "tool": factors["tool"] + PAYLOAD}  # the tool's mass is 1 kg
        frame, _ = recorded(rng, urdf(loaded), truth, row, timing, gains)
        frame.to_csv(logs[1], index=False)
        # the payload has the tool's centre
        payload = {"logs": ["loaded"], "link": "tool", "mass": PAYLOAD, "mass_sd": "20 g"}
        options = {"gain": GAINS, "payload": {**payload, "centre": [0.0, 0.03, 0.1]}}
    if row.get("in arm.toml"):
        options["coupling"] = {"joints": [SHOULDER, ELBOW], "matrix": [[1, 0], [1, 1]]}
    arm, timer = bf.Arm(folder / "arm.urdf", options), Timer()
    if fit:
        examined = arm.fit(logs, seed=seed)
    else:
        examined, models, torques = arm.prepared(logs)
    departures, late = examined.departures, examined.late
    record = {
        "seed": seed,
        "departures": [[*x] for x in departures.included],
        "alternatives": [[*x] for x in departures.alternatives],
        "scaled": {name: [*x] for name, x in departures.joints.items()},
        "factor": [*departures.bodies],
        "delay": [late.value, late.sd, late.evident],
    }
    if row.get("timing"):
        record |= {"timing": timing, "torque": torque_ratios(examined, motion)}
    if row.get("coupled") and not row.get("in arm.toml"):
        joints = examined.joints if fit else {
            n: arm._with_coupling(examined.joints[n], models[n], examined.logs[0], torques[n])
            for n in models
        }  # fmt: skip
        record["coupled"] = {name: x.remarks for name, x in joints.items() if x.is_coupled}
    if fit:
        record["agreed"] = len(examined.consistency.agreed)
        record["gravity"] = any(
            finding.kind == "gravity" for x in examined.fitted.values()
            for finding in x.fitted.summary.findings
        )  # fmt: skip
        record["numbers"] = [
            [name, key, value, *row_of.reported.interval, row_of.reported.status]
            for name, x in examined.fitted.items()
            for key, value in {**truth[name], "drive.gain": gains[name]}.items()
            if (key != "drive.gain" or row.get("gains"))  # else it is over what is undone
            and (row_of := x.rows.get(key))
            and row_of.reported.interval
        ]
    return {**record, "cpu_seconds": round(timer.cpu_seconds, 1)}


def torque_ratios(arm, motion: np.ndarray) -> list[float]:
    """Rms torque of the URDF's bodies along the log's motion over that along the true one."""
    nominal = np.repeat(arm.prior.columns(loaded=True)[None, :, :1], len(JOINTS), axis=0)
    evaluated = arm.bodies.torques(arm.logs[0].motion, nominal)[:, 0]
    true = rigid_torque(urdf({}), *motion, GRAVITY)
    return np.sqrt(np.mean(evaluated**2, axis=1) / np.mean(true**2, axis=0)).tolist()


def is_named(name: str, record: dict) -> bool:
    """Whether what a row does to a log is said, or in a right log that nothing is."""
    kinds = {kind for kind, *_ in record["departures"] + record["alternatives"]}
    value, sd, evident = record["delay"]
    factor, factor_sd = record["factor"]
    if name in ("timing", "gains off 10 %, known payload", "coupled, in arm.toml"):
        return not evident and not record["scaled"] and kinds <= {"payload"}
    if name == "efforts x 1.4":
        return {*record["scaled"]} == {*JOINTS}
    if name.startswith("one effort"):
        return {*ROWS[name]["scale"]} <= {*record["scaled"]}
    if name == "bodies 25 % heavy":
        return abs(factor - 1.0) > 3.0 * factor_sd or {*record["scaled"]} == {*JOINTS}
    if name == "wrong axis":
        return record["gravity"] or any(abs(x) < 3.0 * sd for x, sd in record["scaled"].values())
    if name == "coupled":
        return [*record["coupled"]] == [ELBOW] and f'"{SHOULDER}"' in record["coupled"][ELBOW][-1]
    if name == "late":
        return evident and abs(value - LATE) < 3.0 * sd
    return "gravity" in kinds if "gravity" in name else bool(kinds & {"body", "bodies", "payload"})


def summarised(name: str, records: list[dict]) -> dict:
    """Count what is named and how many intervals hold."""
    examined = [x for x in records if name != "wrong axis" or "gravity" in x]
    fitted, numbers = [x for x in records if "numbers" in x], {}
    for _, key, value, low, high, _ in (n for x in fitted for n in x["numbers"]):
        numbers.setdefault(key, []).append(low <= value <= high)
    summary = {
        "arms": len(records),
        "named": f"{sum(is_named(name, x) for x in examined)} of {len(examined)}",
        "cpu_seconds": round(sum(x["cpu_seconds"] for x in records)),
    }
    if fitted:
        summary |= {
            "fitted": len(fitted),
            "joints_excluded": sum(len(JOINTS) - x["agreed"] for x in fitted),
            "held": {key: f"{sum(x)} of {len(x)}" for key, x in numbers.items()},
            "identified_though_scaled": sum(
                n[5] == "identified" and n[0] in x["scaled"]
                for x in fitted for n in x["numbers"] if n[1] not in ("motor.load", "drive.gain")
            ),
            "identified_and_wrong": sum(
                n[5] == "identified" and not n[3] <= n[2] <= n[4] for x in fitted
                for n in x["numbers"]
            ),
        }  # fmt: skip
    if name == "timing":
        ratios = np.abs(np.log([r for x in records for r in x["torque"]]))
        summary["torque_within_2_percent"] = f"{np.sum(ratios < 0.02)} of {ratios.size}"
        summary["torque_farthest"] = round(float(ratios.max()), 4)
    return summary


def main() -> None:
    """Simulate all rows, and write the result after each arm."""
    parser = ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--arms", type=int, default=20)
    parser.add_argument("--fits", type=int, default=8)
    parser.add_argument("--rows", nargs="*", default=[*ROWS], choices=[*ROWS])
    options, path = parser.parse_args(), FOLDER / "rows.json"
    for name in options.rows:
        records = []
        for k in range(options.arms):
            with tempfile.TemporaryDirectory() as folder:
                sampled = k < options.fits
                records.append(one_arm(Path(folder), ROWS[name], FIRST + k, fit=sampled))
        result = json.loads(path.read_text()) if path.exists() else {"rows": {}, "arms": {}}
        result["arms"][name], result["rows"][name] = records, summarised(name, records)
        print(json.dumps({name: result["rows"][name]}), flush=True)
        path.write_text(f"{json.dumps(result, indent=1, ensure_ascii=False)}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
