"""Do intervals hold the truth? Simulated UR10s, beside a URDF that is not quite right.

``python studies/ur10-arm/simulated.py [N] [SD] [MEMORY] [SECONDS]`` makes N arms (12 if left out;
40 s of CPU time each), which move for SECONDS (27), of the URDF in ``../shared/data/ur10-arm``:
MuJoCo's torques of bodies whose masses, inertias and centres differ from the URDF's by SD (0.1) and
SD times 10 cm, friction, an encoder's steps and autocorrelated noise, by MEMORY (0.8) from one
sample to the next. It writes ``simulated-SD.json``, ``simulated-SD-MEMORY.json`` and so on.
"""

import json
import resource
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from scipy.signal import lfilter

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1]))

import bayesfric as bf
from bayesfric.base.progress import Spent
from tests.arm.bench import GRAVITY, rigid_torque

URDF = HERE.parents[2] / "shared" / "data" / "ur10-arm" / "ur10.urdf"
FIRST = 5001  # seed; none of these arms was looked at while this was made
TYPICAL = {  # of shoulder, elbow and wrists, as published; halved to half again
    "motor.inertia": (3.0, 3.0, 1.2, 0.3, 0.3, 0.3),
    "motor.coulomb": (14.0, 17.0, 9.0, 2.6, 2.8, 3.5),
    "motor.viscous": (14.0, 14.0, 8.0, 3.5, 2.6, 2.8),
    "motor.load": (0.05, 0.05, 0.05, 0.05, 0.05, 0.05),
}
NOISE, MEMORY = (1.0, 1.0, 0.5, 0.2, 0.2, 0.2), 0.8  # N m; of a first-order autoregression
STEP = 2.0 * np.pi / 2**19  # rad
SECONDS, RATE, HARMONICS, BASE = 27.0, 125.0, 5, 0.08


def bodies(factors: dict[str, float], shifts: dict[str, np.ndarray]) -> str:
    """Write the URDF without shapes, its masses and inertias times factors, its centres moved."""
    root = ElementTree.fromstring(URDF.read_text())
    root[:] = [one for one in root if one.tag in ("link", "joint")]
    for link in root.findall("link"):
        link[:] = link.findall("inertial")
        name = link.get("name")
        for inertial in link if name in factors else ():
            for one in (inertial.find("mass"), inertial.find("inertia")):
                for key, value in one.attrib.items():
                    one.set(key, repr(factors[name] * float(value)))
            origin = inertial.find("origin")
            at = np.array(origin.get("xyz").split(), float) + shifts[name]
            origin.set("xyz", " ".join(map(repr, at.tolist())))
    more = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    more.set("balanceinertia", "true")
    more.set("fusestatic", "false")
    return ElementTree.tostring(root, "unicode")


def motion(rng: np.random.Generator, seconds: float) -> tuple[np.ndarray, ...]:
    """Time, and position, speed and acceleration ``(n, 6)`` of Fourier series."""
    time = np.arange(0.0, seconds, 1.0 / RATE)
    q = np.array([0.0, -1.2, 1.0, -0.5, 0.5, 0.0]) + np.zeros((time.size, 6))
    qd, qdd = np.zeros_like(q), np.zeros_like(q)
    for k in range(1, HARMONICS + 1):
        w = 2.0 * np.pi * BASE * k
        size, phase = rng.uniform(0.1, 0.5, 6) / k, rng.uniform(0.0, 2.0 * np.pi, 6)
        q += size * np.sin(w * time[:, None] + phase)
        qd += size * w * np.cos(w * time[:, None] + phase)
        qdd -= size * w**2 * np.sin(w * time[:, None] + phase)
    return time, q, qd, qdd


def one_arm(
    folder: Path, seed: int, sd: float, memory: float = MEMORY, seconds: float = SECONDS
) -> tuple[list[dict], dict]:
    """Make and fit one arm; a row for each number of each joint, and what is said of bodies."""
    rng = np.random.default_rng(seed)
    arm = bf.Arm(URDF)
    factors = {name: float(max(rng.normal(1.0, sd), 0.2)) for name in arm.bodies.links}
    shifts = {name: 0.1 * sd * rng.normal(size=3) for name in arm.bodies.links}
    time, q, qd, qdd = motion(rng, seconds)
    carried = rigid_torque(bodies(factors, shifts), q, qd, qdd, GRAVITY)
    truth, columns = {}, {"time [s]": time}
    for k, name in enumerate(arm.bodies.joints):
        own = {key: size[k] * rng.uniform(0.5, 1.5) for key, size in TYPICAL.items()}
        effort = carried[:, k] + own["motor.inertia"] * qdd[:, k] + own["motor.viscous"] * qd[:, k]
        lost = own["motor.coulomb"] + own["motor.load"] * np.abs(carried[:, k])
        white = NOISE[k] * np.sqrt(1.0 - memory**2) * rng.normal(size=time.size)
        effort += lost * np.sign(qd[:, k]) + lfilter([1.0], [1.0, -memory], white)
        columns[f"position[{name}] [rad]"] = STEP * np.round(q[:, k] / STEP)
        columns[f"effort[{name}] [N m]"] = effort
        truth[name] = own
    pd.DataFrame(columns).to_csv(folder / "log.csv", index=False)
    fitted, rows = arm.fit(folder / "log.csv", seed=seed), []
    for name, own in truth.items():
        one = fitted.joints[name]
        for parameter, value in own.items():
            row = {"seed": seed, "joint": name, "parameter": parameter, "truth": value}
            for how, where in (
                ("alone", one.result.summary.parameters),
                ("together", one.rows),
            ):
                told = where[parameter].reported
                low, high = told.interval
                row[how] = {"value": told.value, "interval": [low, high], "status": told.status,
                            "inside": bool(low <= value <= high)}  # fmt: skip
            rows.append(row)
    found = {key: fitted.found[key] for key in ("p", "agreed", "physical")}
    findings = {name: one.as_json()["findings"] for name, one in fitted.joints.items()}
    return rows, {"seed": seed, **found, "findings": findings}


def share(rows: list[dict], how: str) -> dict[str, float]:
    """Count identified numbers, and their intervals that hold the truth."""
    told = [row for row in rows if row[how]["status"] == "identified"]
    widths = [row[how]["interval"][1] - row[how]["interval"][0] for row in rows]
    return {
        "identified": len(told),
        "inside": round(float(np.mean([row[how]["inside"] for row in told])), 3) if told else None,
        "inside_all": round(float(np.mean([row[how]["inside"] for row in rows])), 3),
        "mean_log_width": round(float(np.mean(np.log(widths))), 3),
    }


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    sd = float(sys.argv[2]) if len(sys.argv) > 2 else 0.1
    memory = float(sys.argv[3]) if len(sys.argv) > 3 else MEMORY
    seconds = float(sys.argv[4]) if len(sys.argv) > 4 else SECONDS
    rows, arms, spent = [], [], Spent()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(FIRST, FIRST + count):
            found, arm = one_arm(Path(folder), seed, sd, memory, seconds)
            rows, arms = rows + found, [*arms, arm]
            result = {
                "arms": len(arms),
                "sd": sd,
                "alone": share(rows, "alone"),
                "together": share(rows, "together"),
                "joints_with_a_finding": sum(bool(x) for a in arms for x in a["findings"].values()),
                "joints_that_disagree": sum(len(a["findings"]) - len(a["agreed"]) for a in arms),
                "arms_that_contradict_the_urdf": sum(a["p"] < 0.01 for a in arms),
                "cpu_seconds": round(spent.cpu_seconds),
                "peak_megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000,
            }
            print(json.dumps(result), flush=True)
    for key in ("parameter", "joint"):
        for name in dict.fromkeys(row[key] for row in rows):
            some = [row for row in rows if row[key] == name]
            result[name] = {how: share(some, how) for how in ("alone", "together")}
    text = json.dumps({**result, "of": arms}, indent=1, ensure_ascii=False)
    more = [memory] * (memory != MEMORY or seconds != SECONDS) + [seconds] * (seconds != SECONDS)
    name = "-".join(["simulated", *(f"{one:g}" for one in (sd, *more))])
    (HERE / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
