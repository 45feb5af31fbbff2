"""Numbers that the sampling is sure of and nobody should be: found, demoted, and said first."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.diagnostics.before_a_fit import doubts_before
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue
from bayesfric.fit.model import Model
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.report.summary.doubts import _accelerates, find_doubts
from bayesfric.report.summary.record import Message, Summary
from tests.axis import AXIS, VALUES, swing
from tests.commands.bench import SMALL

MISSING = {
    **{"kind": "missing", "what": "delay", "shape": "", "share": 0.034, "p": 1 / 61, "rivals": []},
    **{"parameters": ["motor.inertia", "offset"], "moves": {"motor.inertia": 3.1, "offset": -2.2}},
    **{"hint": "mechanism.delay = true", "physical": True, "recording": "", "span": None},
}


@pytest.fixture
def fitted(tmp_path):
    """Write a recording and fit it; nobody looks at figures and pages here."""

    def run(t, q, torque, preset="motor-axis", more=""):
        header, rows = "time,position,torque", np.c_[t, q, torque]
        np.savetxt(tmp_path / "small.csv", rows, "%.9g", ",", header=header, comments="")
        path = tmp_path / "joint.toml"
        text = SMALL.replace("motor-axis", preset) + f"[sampling]\nmin_ess = 500\n{more}\n"
        path.write_text(text, encoding="utf-8")
        return Model.from_config(path).fit().summary.as_dict()

    return run


def kinds(summary):
    return {one["kind"] for one in summary["doubts"]}


def verdicts(summary):
    return {
        name: row["verdict"]
        for name, row in summary["parameters"].items()
        if not name.startswith("noise.")
    }


@pytest.mark.slow
@pytest.mark.usefixtures("unexplained")
def test_a_controllers_law_is_not_learned_as_friction(fitted):
    """Torque 0.9 N m times the sign of speed: 0.1.0 called that Coulomb friction, and data."""
    from tests.recordings.test_motion_checks import T, bang_bang

    q, _, torque = bang_bang()
    # what it takes to find no better posterior is not what is tested
    summary = fitted(T, q, torque, preset="servo-pendulum", more="max_steps = 2000")
    assert "feedback" in kinds(summary)
    assert "data" not in verdicts(summary).values()
    assert summary["sampler"]["status"] == "tentative"


@pytest.mark.usefixtures("unexplained")
def test_a_torque_of_the_wrong_sign_is_said(fitted):
    t = 0.005 * np.arange(3000)
    q, v, a = swing(t, [(0.477, 1.0), (1.13, 0.4)])
    noise = np.random.default_rng(1).normal(0, 0.01, t.size)
    summary = fitted(t, q, -(0.1 * a + 0.3 * v + 0.2 * np.sign(v)) + noise)
    (doubt,) = [one for one in summary["doubts"] if one["kind"] == "negative"]
    assert set(doubt["values"]) == {"motor.inertia", "motor.viscous", "motor.coulomb"}
    assert doubt["values"]["motor.inertia"] == pytest.approx(-0.1, rel=0.02)
    assert "data" not in verdicts(summary).values()


@pytest.mark.usefixtures("unexplained")
def test_what_a_model_does_not_explain_determines_nothing(fitted):
    """A hand on the joint: slow torques that have nothing to do with the motion."""
    t = 0.005 * np.arange(4000)
    rng = np.random.default_rng(3)
    q = np.sin(2 * t) + 0.3 * np.sin(5.3 * t)
    hand = np.convolve(rng.normal(size=t.size), np.exp(-np.arange(600) / 120.0), mode="same")
    torque = 0.02 * -4 * np.sin(2 * t) + 0.5 * hand / hand.std()
    summary = fitted(t, q, torque)
    assert summary["fit"]["explained"] < 0.8
    assert "unexplained" in kinds(summary)
    assert "data" not in verdicts(summary).values()


def test_an_honest_recording_raises_no_doubt(fitted):
    t = 0.005 * np.arange(4000)
    q, v, a = swing(t, [(0.318, 1.0), (0.844, 0.3)])
    # noise twice as large as the signal: little is explained, and that is all right
    noise = np.random.default_rng(4).normal(0, 2.0, t.size)
    summary = fitted(t, q, 0.1 * a + 0.3 * v + 0.2 * np.sign(v) + noise)
    assert summary["doubts"] == []
    assert summary["sampler"]["status"] == "reliable"


def summary_of(rows, status="reliable"):
    return Summary.read(
        {
            "parameters": rows,
            "derived": {},
            "fit": {"residual_rms": 1.0, "quantity": "motor torque", "explained": 0.99},
            "noise": {"residual_lag1": 0.5},
            "sampler": {"status": status},
        }
    )


def row(median, low, high, verdict="data"):
    spread = {"mean": median, "median": median, "sd": (high - low) / 3.3, "level": 0.9}
    return spread | {"unit": "", "interval": [low, high], "verdict": verdict}


class _Fit:
    estimates = (Estimate("least-squares", (), 1.0, 100, "N m"),)
    observations = ()


@pytest.mark.parametrize(
    ("name", "doubted"),
    [
        ("total.inertia", True),
        ("motor.viscous", True),
        ("total.coulomb", True),
        ("total.quadratic", False),  # it bends the curve of a loss, which is still one
        ("total.gravity", False),
        ("offset", False),
        # a recording may be called what it likes
        ("offset.inertia", False),
        ("total.offset.viscous", False),
    ],
)
def test_what_loses_energy_is_not_negative(name, doubted):
    value = EstimatedValue(name, "", "", "", -1.0, 0.01, 0.01)
    totals = Estimate("least-squares", (value,), 0.1, 100, "")
    found = doubts_before(totals, [])
    assert found == ([{"kind": "negative", "values": {name: -1.0}}] if doubted else [])


def test_intervals_have_room_for_a_delay_that_nobody_put_in(fitted):
    """Two samples late at 500 Hz; inertia and viscous loss are what that moves."""
    joint = Joint.preset("servo-pendulum")
    late = replace(joint, delay=True)
    options = {"rate": 500, "excitation": "multisine", "amplitude": 1.0, "torque_noise": 0.01}
    made = bf.simulate(late, {"drive.delay": 0.004}, encoder_side="joint", **options)
    columns = (made[name].to_numpy() for name in ("time", "position", "torque"))
    summary = fitted(*columns, preset="servo-pendulum")
    (finding,) = summary["findings"]
    assert finding["kind"] == "delay"
    assert finding["hint"] == "mechanism.delay = true"
    for name in ("motor.inertia", "motor.viscous"):
        row = summary["parameters"][name]
        off = PRESETS["servo-pendulum"].values[name] - row["reported"]["value"]
        assert abs(off) < 3.0 * row["reported"]["sd"]
        assert row["reported"]["sd"] > row["sd"]


@pytest.mark.parametrize("severity", ["doubt", "note"])
def test_what_a_finding_moves_is_doubted_and_a_note_doubts_nothing(severity):
    told = {key: MISSING[key] for key in ("share", "p", "parameters", "hint", "shape")}
    moves = {"a.b": 2.0}
    one = Message(kind="delay", severity=severity, statistic=9.0, moves=moves, **told)
    rows = {"a.b": row(1.0, 0.9, 1.1), "a.c": row(1.0, 0.9, 1.1)}
    summary = summary_of(rows).model_copy(update={"findings": [one]})
    found = find_doubts(_Fit(), summary, {})
    assert [doubt["parameters"] for doubt in found] == [["a.b"]] * (severity == "doubt")


def test_a_compromise_of_data_and_a_prior_that_they_contradict_is_doubted():
    """Measured, XL330: a weight 4.1 sds off, and an inertia a third of the bob's as data's."""
    time = np.arange(0.0, 12.0, 0.004)
    q, qd, qdd = swing(time, [(0.31, 0.9), (0.73, 0.5), (1.9, 0.1)])
    torque = AXIS.torque(VALUES, q, qd, qdd)
    torque += 0.2 * np.random.default_rng(8).standard_normal(time.size)
    prior = {"load.first_moment": {"distribution": "norm", "loc": 0.15, "scale": 0.01}}
    model = bf.Model(AXIS, bf.Recording.from_arrays(time, q, torque), priors=prior,
                     self_check={"recordings": 0}, sampling={"min_ess": 400})  # fmt: skip
    summary = model.fit(seed=1).summary
    kinds = [one.kind for one in summary.doubts]
    assert kinds == ["prior"]
    assert summary.sampler.status == "tentative"
    assert all(row.doubted == ["prior"] for row in summary.joint.values())


def test_what_depends_on_the_acceleration_is_told_of_every_quantity():
    """Of one that another parameter shapes, such as a loss that warms up, it ended a fit."""
    moved = {name for name, row in QUANTITIES.items() if _accelerates(row)}
    assert moved == {name for name, row in QUANTITIES.items() if row.option == "inertia"}
