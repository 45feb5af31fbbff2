"""A measured UR10: six joints fitted on one motion, their torque predicted on another.

``python studies/ur10-arm/run.py`` reads ``../shared/data/ur10-arm``, takes about a minute of CPU
time and writes ``result.json`` beside itself.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import bayesfric as bf
from bayesfric.arm.arm_rollout import rollout
from bayesfric.arm.base_parameters import combinations
from bayesfric.arm.fitted_arm import FittedArm
from bayesfric.base.progress import Spent
from bayesfric.inference.predictive import Prediction, predict_held_out

HERE = Path(__file__).parent
DATA = HERE.parents[2] / "shared" / "data" / "ur10-arm"
LOG = DATA / "ur10_exciting_trajectory.db3"
SEED = 1
# N m/A, and friction in A that the authors published (Petrone et al., IEEE TII 2025): viscous,
# and half of the height of the step at standstill.
DRIVE_GAINS = (13.5841, 14.2959, 11.3716, 11.2408, 11.7681, 11.7682)
PUBLISHED = {
    "viscous": (1.064, 0.994, 0.680, 0.316, 0.224, 0.236),
    "Coulomb": (1.03, 1.20, 0.82, 0.23, 0.24, 0.30),
}


def validation_log(path: Path) -> None:
    """Write the one JointTrajectory message as a log, a row a point."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    bag, types = DATA / "validation_trajectory.db3", get_typestore(Stores.LATEST)
    with AnyReader([bag], default_typestore=types) as reader:
        connection, _, raw = next(reader.messages())
        message = reader.deserialize(raw, connection.msgtype)
    frame = {
        "header.stamp": [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec
                         for p in message.points]
    }  # fmt: skip
    for field, column in (("positions", "position"), ("velocities", "velocity"), ("effort",) * 2):
        values = np.array([getattr(point, field) for point in message.points])
        for k, name in enumerate(message.joint_names):
            frame[f"{column}[{name}]"] = values[:, k]
    pd.DataFrame(frame).to_csv(path, index=False)


def least_squares(fitted: bf.Arm) -> dict[str, float]:
    """Predict by ordinary least squares on the same outputs, with its bands for white noise.

    Columns: the URDF's torque, Coulomb, viscous, armature, offset.
    """

    def columns(o):
        urdf = -o.inputs.load_torque.at(o.stamps)
        rows = np.stack([urdf, np.sign(o.qd), o.qd, o.qdd, np.ones_like(o.q)])
        return o.filter.apply(rows).T, o.measured

    model = fitted.result.model
    seen, torque = columns(model.observations[0])
    new, measured = columns(model.held_out[0].observation)
    found, *_ = np.linalg.lstsq(seen, torque, rcond=None)
    scale = np.sqrt(np.sum((torque - seen @ found) ** 2) / (torque.size - found.size))
    leverage = np.einsum("ij,jk,ik->i", new, np.linalg.inv(seen.T @ seen), new)
    error = measured - new @ found
    names = ("URDF torque", "Coulomb", "viscous", "armature", "offset")
    return {
        "rms": float(np.sqrt(np.mean(error**2))),
        "coverage": float(np.mean(np.abs(error) < 1.645 * scale * np.sqrt(1.0 + leverage))),
        "coefficients": dict(zip(names, np.round(found, 4).tolist(), strict=True)),
    }


def on_base_parameters(fitted: FittedArm) -> dict[str, dict[str, dict[str, float]]]:
    """Predict by least squares on base parameters and each joint's friction, all joints at once.

    Ordinary, and weighted by the variance that each joint leaves (Gautier 1997); bands for white
    noise.
    """
    joints = list(fitted.joints)
    _, sums = combinations(fitted.bodies)

    def laid(part):
        """Give outputs and columns by joint, those of friction beside zeros for other joints."""
        observations = [part(fitted.joints[name].result.model) for name in joints]
        motion = np.array([[getattr(o, x) for o in observations] for x in ("q", "qd", "qdd")])
        ways = np.broadcast_to(np.linalg.pinv(sums), (len(joints), *sums.shape[::-1]))
        columns = fitted.bodies.torques(motion, ways)
        for j, o in enumerate(observations):
            own = np.zeros((len(joints), 4, o.q.size))
            own[j] = np.sign(o.qd), o.qd, o.qdd, np.ones_like(o.q)
            yield (
                o.filter.apply(np.concatenate([columns[j], own.reshape(-1, o.q.size)])).T,
                o.measured,
            )

    seen = list(laid(lambda model: model.observations[0]))
    new = list(laid(lambda model: model.held_out[0].observation))
    result, sd = {name: {} for name in joints}, np.ones(len(joints))
    for how in ("base parameters, ordinary", "base parameters, weighted"):
        x = np.concatenate([x / s for (x, _), s in zip(seen, sd, strict=True)])
        y = np.concatenate([y / s for (_, y), s in zip(seen, sd, strict=True)])
        found, *_ = np.linalg.lstsq(x, y, rcond=None)
        sd = np.array([np.std(y - x @ found) for x, y in seen])
        for name, (x, y), s in zip(joints, new, sd, strict=True):
            error = y - x @ found
            result[name][how] = {
                "rms": float(np.sqrt(np.mean(error**2))),
                "coverage": float(np.mean(np.abs(error) < 1.645 * s)),
            }
    return result


def by_one_joint() -> dict[str, dict[str, list[float]]]:
    """Ask each joint by itself what is bolted to the last link: value and sd, kg and kg m."""
    found, joints = {}, list(bf.Arm(DATA / "ur10.urdf").bodies.joints)
    for name in joints:
        off = {one: {"fit": one == name} for one in joints}
        one = bf.Arm(DATA / "ur10.urdf", {"joints": off}).fit(LOG, seed=SEED)
        found[name] = {
            cause["name"]: [cause["value"], cause["sd"]]
            for cause in one.inertial_estimate["causes"]
            if cause["name"].startswith(("payload", "moment"))
        }
    return found


def correlations(fitted: FittedArm) -> list[list[float]]:
    """Correlate what noise leaves unforetold between joints, at outputs that both have."""
    left = []
    for one in fitted.joints.values():
        fit, (o, *_) = one.result.fit, one.result.model.observations
        target, median = fit.target, fit.posterior.median[None]
        (torque,) = target.likelihood.predict(target.chain_values(median))
        scales = target.noise.scales(median[:, len(target.free) :])[0]
        (unforetold,) = target.likelihood.innovations([o.measured - torque[0]], scales)
        left.append((o.filter.starts, unforetold))
    found = np.eye(len(left))
    for i, (at, x) in enumerate(left):
        for j, (beside, y) in enumerate(left[:i]):
            _, here, there = np.intersect1d(at, beside, return_indices=True)
            found[i, j] = found[j, i] = np.corrcoef(x[here], y[there])[0, 1]
    return np.round(found, 2).tolist()


def quality(one: Prediction) -> dict[str, float]:
    """Root mean square of what is left, sd of the prediction, coverage of its 90 % bands."""
    return {
        "rms": float(np.sqrt(np.mean((one.measured - one.mean) ** 2))),
        "sd": float(np.sqrt(np.mean(one.variance))),
        "coverage": float(np.mean(np.abs(one.pit - 0.5) <= 0.45)),
    }


def compared(folder: Path, joints: list[str] | None = None) -> tuple[dict[str, dict], FittedArm]:
    """Fit, and predict the other motion, both ways."""
    validation_log(folder / "validation.csv")
    arm = bf.Arm(DATA / "ur10.urdf")
    if joints:
        off = {name: {"fit": name in joints} for name in arm.bodies.joints}
        arm = bf.Arm(DATA / "ur10.urdf", {"joints": off})
    fitted = arm.fit(LOG, predict=folder / "validation.csv", seed=SEED)
    found = {}
    for name, one in fitted.joints.items():
        told = one.as_json()
        (part,) = told.pop("validation")["parts"].values()
        fit = one.result.fit
        wide = predict_held_out(fit.target, fit.wide.posterior, one.result.model.held_out)
        found[name] = {
            "arm": quality(fit.held_out[0]),
            "arm, together": {
                "rms": part["residual_rms"],
                "sd": part["predictive_sd"],
                "coverage": part["coverage"]["0.9"]["share"],
            },
            "arm, with room for the model's error": quality(wide[0]),
            "least squares": least_squares(one),
            **told,
        }
    print("\n".join(fitted.text()), file=sys.stderr)
    return found, fitted


def main() -> None:
    spent = Spent()
    with tempfile.TemporaryDirectory() as folder:
        found, fitted = compared(Path(folder))
    seconds = round(spent.cpu_seconds, 1)
    played = rollout(fitted, seconds=0.5, seed=SEED)
    for name, told in on_base_parameters(fitted).items():
        found[name] |= told
    for k, told in enumerate(found.values()):
        gain = DRIVE_GAINS[k]
        told["published"] = {key: round(gain * x[k], 3) for key, x in PUBLISHED.items()}
    bodies = fitted.as_json()["bodies"]
    result = {
        "seed": SEED,
        "cpu_seconds": seconds,
        "bodies": bodies,
        "bolted_on_by_one_joint": by_one_joint(),
        "correlations": correlations(fitted),
        "roll_out": {
            "seconds": played.seconds,
            "log": played.log,
            "rms": {name: round(x, 4) for name, x in played.rms.items()},
            "held": {name: round(x, 3) for name, x in played.coverage.items()},
        },
        "joints": found,
    }
    text = json.dumps(result, indent=1, ensure_ascii=False)
    (HERE / "result.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
