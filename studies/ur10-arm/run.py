"""Fit six joints of a MEASURED UR10 on each of two motions and predict their torque on the other.

``python studies/ur10-arm/run.py`` reads ``../shared/data/ur10-arm``, takes some minutes of CPU
time and writes ``result.json``.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

import bayesfric as bf
from bayesfric.arm.arm_rollout import rollout
from bayesfric.arm.fitted_arm import FittedArm, FittedJoint
from bayesfric.arm.inertial_prior import combinations
from bayesfric.base.progress import Timer
from bayesfric.inference.posterior import Prediction, predict_held_out

FOLDER = Path(__file__).parent
DATA = FOLDER.parents[2] / "shared" / "data" / "ur10-arm"
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
    """Write the JointTrajectory message as a log with one row per point."""
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
    """Predict by ordinary least squares on the same outputs, with bands for white noise."""

    def columns(signals):
        urdf = -signals.inputs.load_torque.at(signals.stamps)
        rows = np.stack(
            [urdf, np.sign(signals.qd), signals.qd, signals.qdd, np.ones_like(signals.q)]
        )
        return signals.filter.apply(rows).T, signals.measured

    model = fitted.result.model
    fitted_columns, torque = columns(model.observations[0])
    held_out_columns, measured = columns(model.held_out[0].observation)
    coefficients, *_ = np.linalg.lstsq(fitted_columns, torque, rcond=None)
    scale = np.sqrt(
        np.sum((torque - fitted_columns @ coefficients) ** 2) / (torque.size - coefficients.size)
    )
    leverage = np.einsum(
        "ij,jk,ik->i",
        held_out_columns,
        np.linalg.inv(fitted_columns.T @ fitted_columns),
        held_out_columns,
    )
    error = measured - held_out_columns @ coefficients
    names = ("URDF torque", "Coulomb", "viscous", "armature", "offset")
    return {
        "rms": float(np.sqrt(np.mean(error**2))),
        "coverage": float(np.mean(np.abs(error) < 1.645 * scale * np.sqrt(1.0 + leverage))),
        "coefficients": dict(zip(names, np.round(coefficients, 4).tolist(), strict=True)),
    }


def on_base_parameters(fitted: FittedArm) -> dict[str, dict[str, dict[str, float]]]:
    """Predict by least squares on base parameters and friction, all joints at once.

    Ordinary, and weighted by each joint's residual variance (Gautier 1997); bands for white noise.
    """
    joints = list(fitted.joints)
    _, sums = combinations(fitted.bodies)

    def regression(part):
        """Yield columns and outputs of each joint; friction columns of other joints are zero."""
        observations = [part(fitted.joints[name].result.model) for name in joints]
        motion = np.array(
            [[getattr(signals, x) for signals in observations] for x in ("q", "qd", "qdd")]
        )
        directions = np.broadcast_to(np.linalg.pinv(sums), (len(joints), *sums.shape[::-1]))
        columns = fitted.bodies.torques(motion, directions)
        for j, signals in enumerate(observations):
            friction = np.zeros((len(joints), 4, signals.q.size))
            friction[j] = np.sign(signals.qd), signals.qd, signals.qdd, np.ones_like(signals.q)
            yield (
                signals.filter.apply(
                    np.concatenate([columns[j], friction.reshape(-1, signals.q.size)])
                ).T,
                signals.measured,
            )

    fitted_outputs = list(regression(lambda model: model.observations[0]))
    held_out_outputs = list(regression(lambda model: model.held_out[0].observation))
    result, sd = {name: {} for name in joints}, np.ones(len(joints))
    for method in ("base parameters, ordinary", "base parameters, weighted"):
        x = np.concatenate([x / s for (x, _), s in zip(fitted_outputs, sd, strict=True)])
        y = np.concatenate([y / s for (_, y), s in zip(fitted_outputs, sd, strict=True)])
        coefficients, *_ = np.linalg.lstsq(x, y, rcond=None)
        sd = np.array([np.std(y - x @ coefficients) for x, y in fitted_outputs])
        for name, (x, y), s in zip(joints, held_out_outputs, sd, strict=True):
            error = y - x @ coefficients
            result[name][method] = {
                "rms": float(np.sqrt(np.mean(error**2))),
                "coverage": float(np.mean(np.abs(error) < 1.645 * s)),
            }
    return result


def correlations(fitted: FittedArm) -> list[list[float]]:
    """Correlate innovations between joints, at outputs that both have."""
    innovations = []
    for joint_fit in fitted.joints.values():
        fit, (signals, *_) = joint_fit.result.fit, joint_fit.result.model.observations
        target, median = fit.target, fit.posterior.median[None]
        (torque,) = target.likelihood.predict(target.chain_values(median))
        scales = target.noise.scales(median[:, len(target.free) :])[0]
        (values,) = target.likelihood.innovations([signals.measured - torque[0]], scales)
        innovations.append((signals.filter.starts, values))
    correlation = np.eye(len(innovations))
    for i, (rows, x) in enumerate(innovations):
        for j, (other_rows, y) in enumerate(innovations[:i]):
            _, common, other_common = np.intersect1d(rows, other_rows, return_indices=True)
            correlation[i, j] = correlation[j, i] = np.corrcoef(x[common], y[other_common])[0, 1]
    return np.round(correlation, 2).tolist()


def quality(prediction: Prediction) -> dict[str, float]:
    """Return residual rms, predictive standard deviation and coverage of 90 % bands."""
    return {
        "rms": float(np.sqrt(np.mean((prediction.measured - prediction.mean) ** 2))),
        "sd": float(np.sqrt(np.mean(prediction.variance))),
        "coverage": float(np.mean(np.abs(prediction.pit - 0.5) <= 0.45)),
    }


def friction(joint_fit: FittedJoint, repeatability: float) -> dict[str, dict[str, list[float]]]:
    """Return 90 % intervals of friction that authors publish, of this log and of another one.

    Load-dependent friction at the URDF's mean load is a part of the step at standstill.
    """
    fit, (signals, *_) = joint_fit.result.fit, joint_fit.result.model.observations
    draws, rows = fit.wide.posterior, joint_fit.result.summary.parameters
    shifted = {
        name: draws[name].ravel() + rows[name].reported.value - np.median(draws[name])
        for name in draws.names
        if name.startswith("motor.")
    }
    load = np.mean(np.abs(signals.inputs.load_torque.at(signals.stamps)))
    step = shifted["motor.coulomb"] + shifted.get("motor.load", 0.0) * load
    change = 1.0 + repeatability * np.random.default_rng(SEED).normal(size=step.size)
    return {
        key: {
            "this log": np.quantile(x, (0.05, 0.95)).tolist(),
            "another log": np.quantile(x * change, (0.05, 0.95)).tolist(),
        }
        for key, x in (("Coulomb", step), ("viscous", shifted["motor.viscous"]))
    }


def compared(
    fitted_log: Path, predicted_log: Path, joints: list[str] | None = None
) -> tuple[dict[str, dict], FittedArm]:
    """Fit the arm, or some joints, on a motion and predict the other by all methods."""
    arm = bf.Arm(DATA / "ur10.urdf")
    if joints:
        joint_options = {name: {"fit": name in joints} for name in arm.bodies.joints}
        arm = bf.Arm(DATA / "ur10.urdf", {"joints": joint_options})
    fitted = arm.fit(fitted_log, predict=predicted_log, seed=SEED)
    outcomes = {}
    for name, joint_fit in fitted.joints.items():
        record = joint_fit.as_json()
        (part,) = record.pop("validation")["parts"].values()
        fit = joint_fit.result.fit
        wide = predict_held_out(fit.target, fit.wide.posterior, joint_fit.result.model.held_out)
        outcomes[name] = {
            "separate": quality(fit.held_out[0]),
            "joint": {
                "rms": part["residual_rms"],
                "sd": part["predictive_sd"],
                "coverage": part["coverage"]["0.9"]["share"],
            },
            "without repeatability": quality(wide[0]),
            "least squares": least_squares(joint_fit),
            "friction": friction(joint_fit, arm.options.repeatability.friction),
            **record,
        }
    if not joints:
        for name, record in on_base_parameters(fitted).items():
            outcomes[name] |= record
    print("\n".join(fitted.text()), file=sys.stderr)
    return outcomes, fitted


def main() -> None:
    """Fit, predict, simulate, and write ``result.json``."""
    result: dict = {"seed": SEED}
    with tempfile.TemporaryDirectory() as folder:
        other = Path(folder) / "validation.csv"
        validation_log(other)
        timer = Timer()
        joints, fitted = compared(LOG, other)
        result["cpu_seconds"] = round(timer.cpu_seconds, 1)
        result["backwards"], backwards = compared(other, LOG)
        played = rollout(fitted, seconds=0.5, seed=SEED)
        result["bodies_backwards"] = backwards.as_json()["bodies"]
    for k, record in enumerate(joints.values()):
        gain = DRIVE_GAINS[k]
        record["published"] = {key: round(gain * x[k], 3) for key, x in PUBLISHED.items()}
    result |= {
        "bodies": fitted.as_json()["bodies"],
        "correlations": correlations(fitted),
        "roll_out": {
            "seconds": played.seconds,
            "log": played.log,
            "rms": {name: round(x, 4) for name, x in played.rms.items()},
            "held": {name: round(x, 3) for name, x in played.coverage.items()},
        },
        "joints": joints,
    }
    text = json.dumps(result, indent=1, ensure_ascii=False)
    (FOLDER / "result.json").write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
