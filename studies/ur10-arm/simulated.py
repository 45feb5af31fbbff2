"""Do intervals hold the truth? Simulated UR10s, beside a URDF that is not quite right.

``python studies/ur10-arm/simulated.py`` makes ``--arms`` (12; 40 s of CPU time each) of the URDF in
``../shared/data/ur10-arm``, which move for ``--seconds`` (27): MuJoCo's torques of bodies whose
masses, inertias and centres differ from the URDF's by ``--sd`` (0.1) and that times 10 cm,
friction, an encoder's steps and autocorrelated noise, by ``--memory`` (0.8) from one sample to the
next. With ``--rollout`` it predicts another motion of each, and plays that one's efforts (60 s more
each). It writes ``simulated-SD.json`` beside itself, with what else is not as above in the name.
"""

import json
import resource
import sys
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Iterable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from scipy.signal import lfilter

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1]))

import bayesfric as bf
from bayesfric.arm.arm_rollout import rollout
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
NOISE = (1.0, 1.0, 0.5, 0.2, 0.2, 0.2)  # N m
STEP = 2.0 * np.pi / 2**19  # rad
RATE, HARMONICS, BASE = 125.0, 5, 0.08
PLAYED = 0.5  # s, after which a roll-out begins anew
# What the command line may change.
GIVEN = {"arms": (int, 12), "sd": (float, 0.1), "memory": (float, 0.8), "seconds": (float, 27.0)}


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


def recorded(
    rng: np.random.Generator, text: str, joints: Iterable[tuple[str, dict]], told: Namespace
) -> pd.DataFrame:
    """Move an arm of bodies ``text`` and friction of its ``joints``, and record it."""
    time, q, qd, qdd = motion(rng, told.seconds)
    carried, columns = rigid_torque(text, q, qd, qdd, GRAVITY), {"time [s]": time}
    for k, (name, own) in enumerate(joints):
        effort = carried[:, k] + own["motor.inertia"] * qdd[:, k] + own["motor.viscous"] * qd[:, k]
        lost = own["motor.coulomb"] + own["motor.load"] * np.abs(carried[:, k])
        white = NOISE[k] * np.sqrt(1.0 - told.memory**2) * rng.normal(size=time.size)
        effort += lost * np.sign(qd[:, k]) + lfilter([1.0], [1.0, -told.memory], white)
        columns[f"position[{name}] [rad]"] = STEP * np.round(q[:, k] / STEP)
        columns[f"effort[{name}] [N m]"] = effort
    return pd.DataFrame(columns)


def one_arm(folder: Path, seed: int, told: Namespace) -> tuple[list[dict], dict]:
    """Make and fit one arm; a row for each number of each joint, and what is said of bodies."""
    rng = np.random.default_rng(seed)
    arm = bf.Arm(URDF)
    factors = {name: float(max(rng.normal(1.0, told.sd), 0.2)) for name in arm.bodies.links}
    shifts = {name: 0.1 * told.sd * rng.normal(size=3) for name in arm.bodies.links}
    text, truth = bodies(factors, shifts), {}

    def joints() -> Iterator[tuple[str, dict]]:
        for k, name in enumerate(arm.bodies.joints):
            truth[name] = {key: size[k] * rng.uniform(0.5, 1.5) for key, size in TYPICAL.items()}
            yield name, truth[name]

    log, other = folder / "log.csv", folder / "other.csv"
    recorded(rng, text, joints(), told).to_csv(log, index=False)
    if told.rollout:
        recorded(rng, text, truth.items(), told).to_csv(other, index=False)
    fitted, rows = arm.fit(log, predict=other if told.rollout else None, seed=seed), []
    for name, own in truth.items():
        for parameter, value in own.items():
            row = {"seed": seed, "joint": name, "parameter": parameter, "truth": value}
            alone = fitted.joints[name].result.summary.parameters
            for how, where in (("alone", alone), ("together", fitted.joints[name].rows)):
                one = where[parameter].reported
                low, high = one.interval
                row[how] = {"value": one.value, "interval": [low, high], "status": one.status,
                            "inside": bool(low <= value <= high)}  # fmt: skip
            rows.append(row)
    found = {key: fitted.inertial_estimate[key] for key in ("p", "agreed", "physical")}
    findings = {name: one.as_json()["findings"] for name, one in fitted.joints.items()}
    more = {"rollout": rollout(fitted, seconds=PLAYED, seed=seed).as_json()} if told.rollout else {}
    return rows, {"seed": seed, **found, "findings": findings, **more}


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
    parser = ArgumentParser(description=__doc__.partition("\n")[0])
    for key, (kind, value) in GIVEN.items():
        parser.add_argument(f"--{key}", type=kind, default=value)
    parser.add_argument("--rollout", action="store_true")
    told = parser.parse_args()
    rows, arms, spent = [], [], Spent()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(FIRST, FIRST + told.arms):
            found, arm = one_arm(Path(folder), seed, told)
            rows, arms = rows + found, [*arms, arm]
            result = {
                "arms": len(arms),
                "sd": told.sd,
                "alone": share(rows, "alone"),
                "together": share(rows, "together"),
                "joints_with_a_finding": sum(bool(x) for a in arms for x in a["findings"].values()),
                "joints_that_disagree": sum(len(a["findings"]) - len(a["agreed"]) for a in arms),
                "arms_that_contradict_the_urdf": sum(a["p"] < 0.01 for a in arms),
                "cpu_seconds": round(spent.cpu_seconds),
                "peak_megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000,
            }
            if told.rollout:
                held = [x for a in arms for x in a["rollout"]["held"].values()]
                result["rollout_held"] = round(float(np.mean(held)), 3)
            print(json.dumps(result), flush=True)
    for key in ("parameter", "joint"):
        for name in dict.fromkeys(row[key] for row in rows):
            some = [row for row in rows if row[key] == name]
            result[name] = {how: share(some, how) for how in ("alone", "together")}
    text = json.dumps({**result, "of": arms}, indent=1, ensure_ascii=False)
    others = [
        f"{k}-{getattr(told, k):g}"
        for k in ("memory", "seconds")
        if getattr(told, k) != GIVEN[k][1]
    ]
    name = "-".join([f"simulated-{told.sd:g}", *others, *["rollout"] * told.rollout])
    (HERE / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
