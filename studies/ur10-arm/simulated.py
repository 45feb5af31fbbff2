"""Do intervals hold the truth? Simulated arms of two joints, beside a URDF that is not quite right.

``python studies/ur10-arm/simulated.py [N]`` makes N arms (12 if left out; 10 s of CPU time each) of
the bench of ``tests/arm``: MuJoCo's torques of bodies whose masses and inertias differ from the
URDF's by 10 % (standard deviation), friction and noise. It writes ``simulated.json`` beside itself.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1]))

import bayesfric as bf
from tests.arm import bench

# Without the self-check, whose corrections are small here, and with the model that is right.
OPTIONS = {"terms": "as written", "fit": {"self_check": {"recordings": 0}}}
ARMATURE, COULOMB, VISCOUS, LOAD = (1.2, 0.4), (5.0, 2.0), (4.0, 1.5), (0.15, 0.1)


def one_arm(folder: Path, seed: int) -> list[dict]:
    """Make and fit one arm; a row for each number of each joint."""
    rng = np.random.default_rng(seed)
    factors = {name: float(rng.normal(1.0, 0.1)) for name in bench.LINKS}
    truth = {
        name: {
            "motor.inertia": ARMATURE[k] * rng.uniform(0.5, 1.5),
            "motor.coulomb": COULOMB[k] * rng.uniform(0.5, 1.5),
            "motor.viscous": VISCOUS[k] * rng.uniform(0.5, 1.5),
            "motor.load": LOAD[k] * rng.uniform(0.5, 1.5),
        }
        for k, name in enumerate((bench.SHOULDER, bench.ELBOW))
    }
    (folder / "arm.urdf").write_text(bench.urdf())
    bench.log(bench.urdf(factors), truth, seed=seed).to_csv(folder / "log.csv", index=False)
    fitted = bf.Arm(folder / "arm.urdf", OPTIONS).fit(folder / "log.csv", seed=seed)
    rows = []
    for name, own in truth.items():
        told = fitted.joints[name].as_json()
        for parameter, value in own.items():
            one = told["parameters"][parameter]
            low, high = one["interval"]
            rows.append(
                {
                    "seed": seed,
                    "joint": name,
                    "parameter": parameter,
                    "truth": value,
                    **one,
                    "inside": low <= value <= high,
                    "p": told["urdf"]["p"],
                    "added": told["added"],
                    "findings": told["findings"],
                }
            )
    return rows


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 12
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(1, count + 1):
            rows += one_arm(Path(folder), seed)
            told = [row["inside"] for row in rows if row["status"] == "identified"]
            print(seed, f"{np.mean(told):.0%} of {len(told)} identified numbers", flush=True)
    joints = rows[::4]
    result = {
        "arms": count,
        "identified": len(told),
        "inside": float(np.mean(told)),
        "inside_all": float(np.mean([row["inside"] for row in rows])),
        "joints_with_a_finding": sum(bool(j["added"] or j["findings"]) for j in joints),
        "joints_that_contradict_the_urdf": sum(j["p"] < 0.01 for j in joints),
        "joints": len(joints),
        "rows": rows,
    }
    text = json.dumps(result, indent=1, ensure_ascii=False)
    (HERE / "simulated.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
