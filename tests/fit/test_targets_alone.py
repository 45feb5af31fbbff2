"""Targets and encoder alone: numbers of a simulated servo, its gain, and what is refused.

SIMULATED by semi-implicit Euler steps with friction as an impulse, not by the package's integrator.
"""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numba import njit
from scipy.stats import chi2

import bayesfric as bf
from bayesfric.inference.closed_loop_fit import closed_loop_mode, slope_and_information

RATE, FINE, COUNT = 200.0, 50, 2.0 * np.pi / 4096
MASS, RADIUS = 0.49, 0.1
TRUTH = {
    "motor.inertia": 0.003, "motor.viscous": 0.06, "motor.coulomb": 0.03, "target.delay": 0.007,
}  # fmt: skip
KP = 1.6
SERVO = bf.Joint(
    [bf.Element("motor", inertia=True, viscous=True, coulomb="symmetric")],
    bf.Load(first_moment=True, inertia=True),
)
WITHOUT_LOAD = {"load.first_moment": 0.0, "load.inertia": 0.0}


@njit
def played(goal, push, late, inertia, viscous, coulomb, weight, kp, h, fine):
    q, v = goal[0], 0.0
    out = np.empty(goal.size)
    for k in range(goal.size * fine):
        if k % fine == 0:
            out[k // fine] = q
        i = max(int(np.floor((k - late) / fine + 1e-9)), 0)
        torque = kp * (goal[i] - q) - weight * np.sin(q) + push[k // fine]
        w = (v + h * torque / inertia) / (1.0 + h * viscous / inertia)
        stop = h * coulomb / (inertia + h * viscous)
        v = 0.0 if abs(w) <= stop else (w - stop if w > 0 else w + stop)
        q += h * v
    return out


def table(seed, duration=8.0):
    """Time, counted position and target, with 1 % of random torque."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, duration, 1.0 / RATE)
    goal = sum(
        a * np.sin(2.0 * np.pi * f * time + p)
        for a, f, p in zip((0.7, 0.4, 0.2), (0.4, 1.1, 2.3), rng.uniform(0, 6.28, 3), strict=True)
    )
    push, keeps = np.zeros(time.size), np.exp(-1.0 / (RATE * 0.03))
    for k, z in enumerate(rng.standard_normal(time.size - 1)):
        push[k + 1] = keeps * push[k] + 0.01 * np.sqrt(1.0 - keeps**2) * z
    h = 1.0 / (RATE * FINE)
    q = played(
        goal, push, round(TRUTH["target.delay"] / h), TRUTH["motor.inertia"] + MASS * RADIUS**2,
        TRUTH["motor.viscous"], TRUTH["motor.coulomb"], MASS * 9.80665 * RADIUS, KP, h, FINE,
    )  # fmt: skip
    return pd.DataFrame({"t": time, "q": COUNT * np.round(q / COUNT), "goal": goal})


def recording(frame, known_mass=True, **target):
    aim = {"column": "goal", "unit": "rad", "kp": f"{KP} N m/rad", "held": True}
    aim |= {"loop": "0 s", "velocity_filter": "0 s"} | target
    aim = {key: value for key, value in aim.items() if value is not None}
    load = {"added_mass": MASS, "radius": RADIUS} if known_mass else {}
    return bf.Recording.from_dataframe(frame, time="t", position="q", target=aim, **load)


def at_mode(model):
    """Free parameters, their names and covariance at the posterior's mode, without noise."""
    start = model.starting_point()
    mode = closed_loop_mode(start.target, start.estimates, 1)
    _, information = slope_and_information(mode.target, mode.mode, np.full(mode.mode.size, 1e-3))
    step = 1e-4 * np.eye(mode.mode.size)
    ends = [mode.target.to_parameters(mode.mode + s * step)[0] for s in (1.0, -1.0)]
    slope = (ends[0] - ends[1]) / 2e-4
    k = len(mode.target.free)
    covariance = slope.T @ np.linalg.inv(information) @ slope
    return mode.target.free, mode.parameters[:k], covariance[:k, :k]


def test_a_servo_with_a_known_mass_and_an_unknown_gain():
    kps = [f"{0.4 * KP} N m/rad", f"{2 * KP} N m/rad"]
    result = bf.Model(SERVO, recording(table(1), kp=kps), priors=WITHOUT_LOAD).fit()
    assert result.summary.likelihood["method"] == "closed-loop"
    for name, true in {**TRUTH, "drive.kp": KP}.items():
        row = result.summary.parameters[name]
        assert abs(row.mean - true) < 4.0 * row.sd, name
        assert row.reported.status == "identified", name


@pytest.mark.slow
def test_errors_are_as_large_as_their_covariance_says():
    """Twenty-four numbers of six seeds."""
    squares, numbers = 0.0, 0
    for seed in range(100, 106):
        names, x, covariance = at_mode(bf.Model(SERVO, recording(table(seed)), priors=WITHOUT_LOAD))
        error = x - [TRUTH[name] for name in names]
        squares += error @ np.linalg.solve(covariance, error)
        numbers += len(names)
    assert chi2.ppf(1e-3, numbers) < squares < chi2.ppf(1.0 - 1e-3, numbers)


def test_without_a_scale_numbers_are_ratios_to_the_gain():
    """The same motion, of a joint whose weight is a parameter: all over kp."""
    model = bf.Model(
        SERVO, recording(table(2), known_mass=False, kp=None), priors={"load.inertia": 0.0}
    )
    assert model.priors["drive.kp"].value == 1.0
    names, x, covariance = at_mode(model)
    truth = TRUTH | {
        "motor.inertia": TRUTH["motor.inertia"] + MASS * RADIUS**2,
        "load.first_moment": MASS * RADIUS,
    }
    for name, value, sd in zip(names, x, np.sqrt(np.diag(covariance)), strict=True):
        true = truth[name] / (1.0 if name == "target.delay" else KP)
        assert abs(value - true) < 4.0 * sd, name


def test_one_factor_on_every_torque_and_the_split_of_inertia_change_no_motion():
    kps = [f"{0.1 * KP} N m/rad", f"{10 * KP} N m/rad"]
    model = bf.Model(SERVO, recording(table(2), known_mass=False, kp=kps))
    answer = model.identification()
    scale, split = (direction.exponents for direction in answer.directions if direction.null)
    assert scale == dict.fromkeys([n for n in answer.frame.index if n != "target.delay"], 1.0)
    # of their sum every share is the motor's
    assert set(split) == {"motor.inertia", "load.inertia"}
    parts = [answer.frame.value[name] * power for name, power in split.items()]
    assert abs(sum(parts)) < 1e-4 * max(map(abs, parts))
    total = next(p for p in answer.combinations if p.name == "total.inertia_over_kp")
    true = (TRUTH["motor.inertia"] + MASS * RADIUS**2) / KP
    assert abs(total.value - true) < 4.0 * total.data_sd


def test_a_loop_of_unknown_period_is_in_viscous_loss_and_inertia():
    """Half normal of .5 ms: sds of kp T/2 and of kd (T/2 + lag)."""
    frame, kd = table(3), "0.03 N m s/rad"
    known, unknown = (
        bf.Model(SERVO, recording(frame, kd=kd, **lags), priors=WITHOUT_LOAD).fit()
        for lags in ({}, {"loop": None, "velocity_filter": None})
    )
    period = 5e-4 * np.sqrt(1.0 - 2.0 / np.pi)
    for name, sd in {
        "motor.viscous": 0.5 * KP * period,
        "motor.inertia": 0.03 * period * np.hypot(0.5, 1.0),
    }.items():
        added = unknown.summary.parameters[name].sd ** 2 - known.summary.parameters[name].sd ** 2
        assert added == pytest.approx(sd**2, abs=0.2 * unknown.summary.parameters[name].sd ** 2)


def swapped(frame):
    return frame.rename(columns={"q": "goal", "goal": "q"})


BAD = {
    "in degrees": (lambda f: replace_goal(f, np.rad2deg(f["goal"])), {}, "as far"),
    "never moves": (lambda f: replace_goal(f, 0.0 * f["goal"]), {}, "moves"),
    "swapped": (swapped, {}, "before"),
    "sign": (lambda f: replace_goal(f, -f["goal"]), {}, "against"),
    "gain's sign": (lambda f: f, {"kp": "-1.6 N m/rad"}, "kp"),
    "no range": (lambda f: f, {"kp": ["2 N m/rad", "1 N m/rad"]}, "kp"),
}


def replace_goal(frame, goal):
    return frame.assign(goal=goal)


@pytest.mark.parametrize("case", BAD)
def test_bad_targets_are_named(case):
    change, target, named = BAD[case]
    with pytest.raises(bf.BadInput, match=named):
        bf.Model(replace(SERVO), recording(change(table(4, 3.0)), **target), priors=WITHOUT_LOAD)
