"""Numbers that a fit is sure of and nobody should be are doubted, and no others."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.mechanism.joint import PRESETS
from bayesfric.report.summary.doubts import find_doubts
from bayesfric.report.summary.record import Summary
from bayesfric.report.terminal import messages_of
from tests.axis import AXIS, VALUES, recording_of, swing
from tests.report.made_summaries import FOUND, knee

SHORT = {"self_check": {"recordings": 0}, "sampling": {"min_ess": 400}}
T = 0.002 * np.arange(10000)


def noise(n, sd, seed):
    return sd * np.random.default_rng(seed).standard_normal(n)


def fitted(t, q, torque, preset="motor-axis", **options):
    recording = bf.Recording.from_arrays(t, q, torque)
    model = bf.Model(
        bf.Joint.preset(preset), recording, **{"sampling": {"min_ess": 500}, **options}
    )
    return model.fit().summary


def kinds(summary):
    return {doubt.kind for doubt in summary.doubts}


def verdicts(summary):
    return {row.verdict for name, row in summary.parameters.items() if name[:6] != "noise."}


# -- after a fit


@pytest.mark.slow
@pytest.mark.usefixtures("unexplained")
def test_a_control_law_is_not_friction():
    """Torque 0.9 N m times the sign of speed: 0.1.0 called that Coulomb friction, and data."""
    rng, period, q, v, rows = np.random.default_rng(5), 0.005, 0.3, 0.0, []
    for _ in range(4000):
        torque = 0.9 * (np.sign(v) if v else 1.0)
        rows.append((q, torque + 0.01 * rng.standard_normal()))
        for _ in range(10):
            loss = 0.85 * np.sign(v) + 0.1 * v
            v += period / 10 * (torque - loss - 0.3 * 9.81 * np.sin(q)) / 0.15
            q += period / 10 * v
    # more steps for a better posterior are not what is tested
    options = {"preset": "servo-pendulum", "sampling": {"max_steps": 2000}}
    summary = fitted(period * np.arange(4000), *np.array(rows).T, **options)
    assert "feedback" in kinds(summary)
    assert "data" not in verdicts(summary)
    assert summary.sampler.status == "tentative"


@pytest.mark.usefixtures("unexplained")
def test_a_torque_of_the_wrong_sign():
    t = 0.005 * np.arange(3000)
    q, v, a = swing(t, [(0.477, 1.0), (1.13, 0.4)])
    torque = -(0.1 * a + 0.3 * v + 0.2 * np.sign(v)) + noise(t.size, 0.01, seed=1)
    summary = fitted(t, q, torque)
    (doubt,) = [doubt for doubt in summary.doubts if doubt.kind == "negative"]
    assert set(doubt.values) == {"motor.inertia", "motor.viscous", "motor.coulomb"}
    assert doubt.values["motor.inertia"] == pytest.approx(-0.1, rel=0.02)
    assert "data" not in verdicts(summary)


@pytest.mark.usefixtures("unexplained")
def test_a_model_that_explains_little_determines_nothing():
    """A hand on the joint: slow torques that are independent of the motion."""
    t = 0.005 * np.arange(4000)
    q = np.sin(2 * t) + 0.3 * np.sin(5.3 * t)
    memory = np.exp(-np.arange(600) / 120.0)
    hand = np.convolve(noise(t.size, 1.0, seed=3), memory, mode="same")
    summary = fitted(t, q, 0.02 * -4 * np.sin(2 * t) + 0.5 * hand / hand.std())
    assert summary.fit.explained < 0.8
    assert "unexplained" in kinds(summary)
    assert "data" not in verdicts(summary)


def test_an_honest_recording_raises_no_doubt():
    t = 0.005 * np.arange(4000)
    q, v, a = swing(t, [(0.318, 1.0), (0.844, 0.3)])
    # noise twice as large as the signal: little is explained, and rightly so
    torque = 0.1 * a + 0.3 * v + 0.2 * np.sign(v) + noise(t.size, 2.0, seed=4)
    summary = fitted(t, q, torque)
    assert not summary.doubts
    assert summary.sampler.status == "reliable"


def test_intervals_cover_a_delay_that_is_not_modelled():
    """Two samples late at 500 Hz; inertia and viscous friction are what that moves."""
    joint = bf.Joint.preset("servo-pendulum")
    options = {"rate": 500, "excitation": "multisine", "amplitude": 1.0, "torque_noise": 0.01}
    late = replace(joint, delay=True)
    table = bf.simulate(late, {"drive.delay": 0.004}, encoder_side="joint", **options)
    summary = bf.Model(joint, recording_of(table), sampling={"min_ess": 500}).fit().summary
    (finding,) = summary.findings
    assert (finding.kind, finding.hint) == ("delay", "mechanism.delay = true")
    for name in ("motor.inertia", "motor.viscous"):
        row = summary.parameters[name]
        off = PRESETS["servo-pendulum"].values[name] - row.reported.value
        assert abs(off) < 3.0 * row.reported.sd
        assert row.reported.sd > row.sd


@pytest.mark.parametrize("severity", ["doubt", "note"])
def test_a_finding_doubts_what_it_moves_and_a_note_nothing(severity):
    finding = FOUND | {"severity": severity, "moves": {"motor.viscous": 2.0}}
    summary = Summary.read(knee() | {"findings": [finding]})
    totals = Estimate("least-squares", (), 1.0, 100, "N m")
    target = SimpleNamespace(likelihood=SimpleNamespace(method="input-error"))
    fit = SimpleNamespace(estimates=(totals,), observations=(), target=target, faster={})
    doubted = [x["parameters"] for x in find_doubts(fit, summary, {}) if x["kind"] == "missing"]
    assert doubted == [["motor.viscous"]] * (severity == "doubt")


def test_data_and_prior_that_contradict_each_other():
    """Measured, XL330: a weight 4.1 sds off, and an inertia a third of the bob's as data's."""
    time = np.arange(0.0, 12.0, 0.004)
    q, qd, qdd = swing(time, [(0.31, 0.9), (0.73, 0.5), (1.9, 0.1)])
    torque = AXIS.torque(VALUES, q, qd, qdd) + noise(time.size, 0.2, seed=8)
    prior = {"load.first_moment": {"distribution": "norm", "loc": 0.15, "scale": 0.01}}
    model = bf.Model(AXIS, bf.Recording.from_arrays(time, q, torque), priors=prior, **SHORT)
    summary = model.fit(seed=1).summary
    assert kinds(summary) == {"prior"}
    assert summary.sampler.status == "tentative"
    assert all(row.doubted == ["prior"] for row in summary.joint.values())


# -- before a fit


def pendulum(scale=1.0, preset="servo-pendulum", late=0, spins=True, delay=False):
    """A SIMULATED pendulum; its position is scaled, and samples late."""
    q = -8.0 + 8.0 * np.cos(2 * np.pi * 0.1 * T) if spins else 0.2 * np.sin(2 * np.pi * 0.3 * T)
    q = q + 0.4 * np.sin(2 * np.pi * 0.7 * T) * (1.0 if spins else 0.2)
    v = np.gradient(q, T)
    torque = 0.15 * np.gradient(v, T) + 0.05 * v + 0.1 * np.tanh(v / 0.02) + 3.0 * np.sin(q)
    torque += noise(T.size, 0.02, seed=1)
    q = np.roll(q, late)[100:]
    recording = bf.Recording.from_arrays(T[100:], scale * q, torque[100:], name="bench")
    return bf.Model(replace(bf.Joint.preset(preset), delay=delay), recording)


def unexplained_doubts(model):
    doubts = bf.check(model).as_json()["doubts"]
    return [doubt for doubt in doubts if doubt["kind"] == "unexplained"]


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "advised"), [(1.0, True), (np.pi / 180.0, False)])
def test_no_delay_is_advised_while_little_is_explained(scale, advised):
    """A position 10 samples late, in its own unit and in a wrong one."""
    warnings = " ".join(bf.check(pendulum(scale, late=10)).warnings)
    assert ("delay = true in [mechanism]" in warnings) == advised


@pytest.mark.parametrize("late", [60, -100])
def test_a_delay_far_longer_than_the_trimmed_span_is_found_and_fitted(late):
    """A position 0.12 or 0.2 s late, or early; 0.024 s is what is trimmed."""
    first = pendulum(late=late).explain(seed=1).findings[0]
    assert (first.kind, first.setting) == ("delay", "mechanism.delay = true")
    estimate = pendulum(late=late, delay=True).estimates(["input-error"])[0]
    assert estimate["drive.delay"].value == pytest.approx(0.002 * late, abs=0.001)


@pytest.mark.parametrize("wrong", [{"preset": "motor-axis"}, {"scale": 2.0 * np.pi}])
def test_a_wrong_mechanism_or_unit_is_not_called_a_delay(wrong):
    assert pendulum(**wrong).explain(seed=1).findings[0].kind != "delay"


def measured_pendulum(real_data, name, unit, preset):
    units = {"time": "s", "position": unit, "velocity": f"{unit}/s", "torque": "N m"}
    keys = {column: {"column": column, "unit": text} for column, text in units.items()}
    recording = bf.Recording.from_file(real_data / f"dfki-pendulum/{name}.csv", **keys)
    return bf.Model(bf.Joint.preset(preset), recording)


def test_a_measured_swing_as_an_axis_is_not_called_late(real_data):
    """A quarter of its period, assumed as a delay, explains 75 % of ilqr instead of 46 %."""
    explained = measured_pendulum(real_data, "ilqr", "rad", "motor-axis").explain(seed=1)
    assert all(finding.kind != "delay" for finding in explained.findings[:1])


@pytest.mark.parametrize(("unit", "wrong"), [("deg", True), ("rad", False)])
def test_a_measured_pendulum_in_a_wrong_unit(real_data, unit, wrong):
    doubts = unexplained_doubts(measured_pendulum(real_data, "sac", unit, "servo-pendulum"))
    assert len(doubts) == wrong
    assert all(doubt["share"] < 0.4 for doubt in doubts)


# -- a joint driven by a voltage

KT, R, RATIO = 0.4, 4.0, 10.0
# the motor's true kt²/R over the nominal one, at a torque constant over R that is right
EXCESS = 1.25


@pytest.mark.usefixtures("unexplained")
@pytest.mark.parametrize(("viscous_kind", "delay"), [(True, False), ("by-direction", True)])
def test_viscous_friction_takes_up_the_error_of_the_back_emf(viscous_kind, delay):
    """Eq. (1) with a drive; the torque is kt V/R less the nominal back-EMF."""
    inertia, coulomb, viscous = 0.002, 0.02, 0.03
    t = 0.002 * np.arange(8000)
    joint = bf.Joint.preset("motor-axis")
    motor = replace(joint.elements[0], ratio=RATIO, viscous=viscous_kind)
    joint = replace(joint, elements=(motor,), delay=delay)
    q = 0.9 * np.sin(2 * np.pi * 0.4 * t) + 0.3 * np.sin(2 * np.pi * 1.1 * t + 1)
    speed = RATIO * np.gradient(q, t)
    torque = inertia * np.gradient(speed, t) + coulomb * np.sign(speed) + viscous * speed
    volts = R / KT * (torque + noise(t.size, 0.005, seed=4) + EXCESS * KT**2 / R * speed)
    drive = {"torque_constant": f"{KT} N m/A", "resistance": f"{R} ohm"}
    recording = bf.Recording.from_arrays(t, q, side="joint", voltage=volts, name="bench", **drive)
    summary = bf.Model(joint, recording).fit().summary
    names = [name for name in summary.parameters if "viscous" in name]
    assert list(summary.fit.back_emf["same_as_back_emf"]) == names
    assert summary.fit.back_emf["nominal"] == pytest.approx(KT**2 / R)
    assert [message.kind for message in messages_of(summary)].count("back-EMF") == 1
    if viscous_kind is True:
        row = summary.parameters["motor.viscous"]
        # three sds: an interval of 90 % is to miss it in one recording of ten
        low, high = row.mean - 3.0 * row.sd, row.mean + 3.0 * row.sd
        assert low < viscous + (EXCESS - 1.0) * KT**2 / R < high
        assert not low < viscous < high
