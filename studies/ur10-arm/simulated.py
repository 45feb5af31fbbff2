"""Measure the coverage of intervals for SIMULATED UR10s with an inaccurate URDF.

``python studies/ur10-arm/simulated.py`` simulates ``--arms`` (12; 40 s of CPU time each) of the
URDF in ``../shared/data/ur10-arm`` for ``--seconds`` (27). MuJoCo's bodies differ from the URDF's
by ``--sd`` (0.1; centres by 10 cm times that); recordings have friction, encoder steps and noise of
autocorrelation ``--memory`` (0.8); ``--rate``, ``--jitter`` and ``--step`` are of the log.
``--rollout`` also simulates another motion (60 s more each).
Writes ``simulated-SD.json``; options other than the defaults are part of the name.
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

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER.parents[1]))

import bayesfric as bf
from bayesfric.arm.arm_rollout import rollout
from bayesfric.base.progress import Timer
from tests.arm.bench import GRAVITY, rigid_torque

URDF = FOLDER.parents[2] / "shared" / "data" / "ur10-arm" / "ur10.urdf"
FIRST = 5001  # seed; none of these arms was used during development
TYPICAL = {  # of shoulder, elbow and wrists, as published; times 0.5 to 1.5
    "motor.inertia": (3.0, 3.0, 1.2, 0.3, 0.3, 0.3),
    "motor.coulomb": (14.0, 17.0, 9.0, 2.6, 2.8, 3.5),
    "motor.viscous": (14.0, 14.0, 8.0, 3.5, 2.6, 2.8),
    "motor.load": (0.05, 0.05, 0.05, 0.05, 0.05, 0.05),
}
NOISE = (1.0, 1.0, 0.5, 0.2, 0.2, 0.2)  # N m
HARMONICS, BASE = 5, 0.08
PLAYED = 0.5  # s, after which a roll-out restarts
# Command-line options: type and default.
OPTIONS = {
    "arms": (int, 12),
    "sd": (float, 0.1),
    "memory": (float, 0.8),  # autocorrelation of noise over 8 ms
    "seconds": (float, 27.0),
    "rate": (float, 125.0),  # Hz
    "jitter": (float, 0.0),  # sd of the time of a sample, of its period
    "step": (float, 2.0 * np.pi / 2**19),  # rad, of the encoder
}


def bodies(factors: dict[str, float], shifts: dict[str, np.ndarray]) -> str:
    """Return the URDF without shapes, with scaled masses and inertias and shifted centres."""
    root = ElementTree.fromstring(URDF.read_text())
    root[:] = [child for child in root if child.tag in ("link", "joint")]
    for link in root.findall("link"):
        link[:] = link.findall("inertial")
        name = link.get("name")
        for inertial in link if name in factors else ():
            for child in (inertial.find("mass"), inertial.find("inertia")):
                for key, value in child.attrib.items():
                    child.set(key, repr(factors[name] * float(value)))
            origin = inertial.find("origin")
            centre = np.array(origin.get("xyz").split(), float) + shifts[name]
            origin.set("xyz", " ".join(map(repr, centre.tolist())))
    compiler = ElementTree.SubElement(ElementTree.SubElement(root, "mujoco"), "compiler")
    compiler.set("balanceinertia", "true")
    compiler.set("fusestatic", "false")
    return ElementTree.tostring(root, "unicode")


def motion(rng: np.random.Generator, options: Namespace) -> tuple[np.ndarray, ...]:
    """Return time ``(n,)``, position, speed and acceleration ``(n, 6)`` of Fourier series."""
    time = np.arange(0.0, options.seconds, 1.0 / options.rate)
    if options.jitter:
        time += np.clip(options.jitter * rng.normal(size=time.size), -0.45, 0.45) / options.rate
    q = np.array([0.0, -1.2, 1.0, -0.5, 0.5, 0.0]) + np.zeros((time.size, 6))
    qd, qdd = np.zeros_like(q), np.zeros_like(q)
    for k in range(1, HARMONICS + 1):
        omega = 2.0 * np.pi * BASE * k
        amplitude, phase = rng.uniform(0.1, 0.5, 6) / k, rng.uniform(0.0, 2.0 * np.pi, 6)
        q += amplitude * np.sin(omega * time[:, None] + phase)
        qd += amplitude * omega * np.cos(omega * time[:, None] + phase)
        qdd -= amplitude * omega**2 * np.sin(omega * time[:, None] + phase)
    return time, q, qd, qdd


def recorded(
    rng: np.random.Generator, text: str, joints: Iterable[tuple[str, dict]], options: Namespace
) -> pd.DataFrame:
    """Record the motion of an arm with URDF ``text`` and friction of its ``joints``."""
    time, q, qd, qdd = motion(rng, options)
    memory = options.memory ** (125.0 / options.rate)
    rigid, columns = rigid_torque(text, q, qd, qdd, GRAVITY), {"time [s]": time}
    for k, (name, friction) in enumerate(joints):
        effort = (
            rigid[:, k]
            + friction["motor.inertia"] * qdd[:, k]
            + friction["motor.viscous"] * qd[:, k]
        )
        loss = friction["motor.coulomb"] + friction["motor.load"] * np.abs(rigid[:, k])
        white = NOISE[k] * np.sqrt(1.0 - memory**2) * rng.normal(size=time.size)
        effort += loss * np.sign(qd[:, k]) + lfilter([1.0], [1.0, -memory], white)
        columns[f"position[{name}] [rad]"] = options.step * np.round(q[:, k] / options.step)
        columns[f"effort[{name}] [N m]"] = effort
    return pd.DataFrame(columns)


def one_arm(folder: Path, seed: int, options: Namespace) -> tuple[list[dict], dict]:
    """Simulate and fit one arm; return rows of all numbers, and the arm's record."""
    rng = np.random.default_rng(seed)
    arm = bf.Arm(URDF)
    factors = {name: float(max(rng.normal(1.0, options.sd), 0.2)) for name in arm.bodies.links}
    shifts = {name: 0.1 * options.sd * rng.normal(size=3) for name in arm.bodies.links}
    text, truth = bodies(factors, shifts), {}

    def joints() -> Iterator[tuple[str, dict]]:
        for k, name in enumerate(arm.bodies.joints):
            truth[name] = {key: size[k] * rng.uniform(0.5, 1.5) for key, size in TYPICAL.items()}
            yield name, truth[name]

    log, other = folder / "log.csv", folder / "other.csv"
    recorded(rng, text, joints(), options).to_csv(log, index=False)
    if options.rollout:
        recorded(rng, text, truth.items(), options).to_csv(other, index=False)
    fitted, rows = arm.fit(log, predict=other if options.rollout else None, seed=seed), []
    for name, values in truth.items():
        for parameter, value in values.items():
            row = {"seed": seed, "joint": name, "parameter": parameter, "truth": value}
            separate = fitted.joints[name].result.summary.parameters
            for fit_kind, numbers in (("alone", separate), ("together", fitted.joints[name].rows)):
                reported = numbers[parameter].reported
                low, high = reported.interval
                row[fit_kind] = {
                    "value": reported.value,
                    "interval": [low, high],
                    "status": reported.status,
                    "inside": bool(low <= value <= high),
                }
            rows.append(row)
    consistency = {key: fitted.inertial_estimate[key] for key in ("p", "agreed", "physical")}
    findings = {name: joint.as_json()["findings"] for name, joint in fitted.joints.items()}
    extra = (
        {"rollout": rollout(fitted, seconds=PLAYED, seed=seed).as_json()} if options.rollout else {}
    )
    return rows, {"seed": seed, **consistency, "findings": findings, **extra}


def share(rows: list[dict], fit_kind: str) -> dict[str, float]:
    """Count identified numbers and intervals that hold the truth."""
    identified = [row for row in rows if row[fit_kind]["status"] == "identified"]
    widths = [row[fit_kind]["interval"][1] - row[fit_kind]["interval"][0] for row in rows]
    return {
        "identified": len(identified),
        "inside": round(float(np.mean([row[fit_kind]["inside"] for row in identified])), 3)
        if identified
        else None,
        "inside_all": round(float(np.mean([row[fit_kind]["inside"] for row in rows])), 3),
        "mean_log_width": round(float(np.mean(np.log(widths))), 3),
    }


def main() -> None:
    """Simulate and fit all arms, and write the result."""
    parser = ArgumentParser(description=__doc__.partition("\n")[0])
    for key, (kind, value) in OPTIONS.items():
        parser.add_argument(f"--{key}", type=kind, default=value)
    parser.add_argument("--rollout", action="store_true")
    options = parser.parse_args()
    rows, arms, timer = [], [], Timer()
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(FIRST, FIRST + options.arms):
            arm_rows, arm = one_arm(Path(folder), seed, options)
            rows, arms = rows + arm_rows, [*arms, arm]
            result = {
                "arms": len(arms),
                "sd": options.sd,
                "alone": share(rows, "alone"),
                "together": share(rows, "together"),
                "joints_with_a_finding": sum(bool(x) for a in arms for x in a["findings"].values()),
                "joints_that_disagree": sum(len(a["findings"]) - len(a["agreed"]) for a in arms),
                "arms_that_contradict_the_urdf": sum(a["p"] < 0.01 for a in arms),
                "cpu_seconds": round(timer.cpu_seconds),
                "peak_megabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1000,
            }
            if options.rollout:
                held = [x for a in arms for x in a["rollout"]["held"].values()]
                result["rollout_held"] = round(float(np.mean(held)), 3)
            print(json.dumps(result), flush=True)
    for key in ("parameter", "joint"):
        for name in dict.fromkeys(row[key] for row in rows):
            subset = [row for row in rows if row[key] == name]
            result[name] = {fit_kind: share(subset, fit_kind) for fit_kind in ("alone", "together")}
    text = json.dumps({**result, "of": arms}, indent=1, ensure_ascii=False)
    others = [
        f"{k}-{getattr(options, k):g}"
        for k in ("memory", "seconds", "rate", "jitter", "step")
        if getattr(options, k) != OPTIONS[k][1]
    ]
    name = "-".join([f"simulated-{options.sd:g}", *others, *["rollout"] * options.rollout])
    (FOLDER / f"{name}.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
