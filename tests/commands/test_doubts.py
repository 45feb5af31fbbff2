"""Numbers that the sampling is sure of and nobody should be: found, demoted, and said first."""

import importlib
import json
import sys
from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.checked import check
from bayesfric.commands.fit import fit_text
from bayesfric.estimates.delay import Delay
from bayesfric.estimates.disturbances import Disturbance
from bayesfric.estimates.once_a_turn import OnceATurn
from bayesfric.estimates.point_estimate import Estimate, EstimatedValue
from bayesfric.inference.likelihood.noise_choice import Choice, Evidence
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.quantities import QUANTITIES
from bayesfric.model import Model
from bayesfric.recordings.recording import Recording
from bayesfric.report.alerts import alerts_of, doubt_text
from bayesfric.report.comparison.cell import posterior_cells
from bayesfric.report.summary.doubts import (
    _accelerates,
    contradicting,
    doubts_before,
    find_doubts,
    pushed_doubts,
    put_doubts,
)
from bayesfric.report.summary.record import ModelError, Summary, Whiteness
from bayesfric.report.summary.residual import Lack
from bayesfric.report.summary.rows import Spread
from tests.axis import AXIS, VALUES, swing
from tests.commands.bench import SMALL
from tests.conftest import REPOSITORY

JOINT = """\
[mechanism]
preset = "{preset}"

[[recordings]]
file = "run.csv"
time = {{ column = "t", unit = "s" }}
position = {{ column = "q", unit = "rad" }}
torque = {{ column = "tau", unit = "N m" }}

[sampling]
min_ess = 500
{more}
"""


@pytest.fixture(scope="module")
def closed_loop():
    folder = REPOSITORY / "studies" / "closed_loop"
    sys.path.insert(0, str(folder))
    try:
        yield importlib.import_module("closed_loop")
    finally:
        sys.path.remove(str(folder))


@pytest.fixture
def fitted(tmp_path):
    """Write a recording, check and fit it; nobody looks at figures and pages here."""

    def run(t, q, torque, preset="motor-axis", more=""):
        np.savetxt(
            tmp_path / "run.csv", np.c_[t, q, torque], "%.9g", ",", header="t,q,tau", comments=""
        )
        path = tmp_path / "joint.toml"
        path.write_text(JOINT.format(preset=preset, more=more), encoding="utf-8")
        model = Model.from_config(path)
        told = check(model).text().splitlines()
        return model.fit().summary.as_dict(), told

    return run


def kinds(summary):
    return {one["kind"] for one in summary["doubts"]}


def first_lines(summary):
    lines = list(fit_text(summary))
    return lines[: lines.index("")]


def verdicts(summary):
    return {
        name: row["verdict"]
        for name, row in summary["parameters"].items()
        if not name.startswith("noise.")
    }


def test_a_joint_in_closed_loop_keeps_its_inertia(closed_loop, fitted):
    """0.1.0: inertia 0.003 for 7.7, reliable, data, no warning (studies/closed_loop)."""
    one = closed_loop.recorded(3)
    summary, _ = fitted(one.time, one.position, one.torque)
    assert summary["sampler"]["status"] == "reliable"
    for name, true in one.truth.items():
        row = summary["parameters"][name]
        assert abs(row["median"] - true) < 4.0 * row["sd"], name


def test_a_band_that_is_asked_for_and_is_noise_is_doubted_first(closed_loop, fitted):
    """The band of 0.1.0: nothing of it is called data, and why is said before any number."""
    one = closed_loop.recorded(3)
    wide = "[processing]\nlowpass = 50.0\ndecimate = 10"
    summary, told = fitted(one.time, one.position, one.torque, more=wide)
    assert summary["sampler"]["status"] == "tentative"
    true = one.truth["motor.inertia"]
    row = summary["parameters"]["motor.inertia"]
    assert row["verdict"] != "data" or abs(row["median"] - true) < 4.0 * row["sd"]
    assert any("acceleration" in line for line in told if "WARNING" in line)
    assert kinds(summary) & {"acceleration", "memory", "unexplained", "noise"}
    assert len(first_lines(summary)) > 1


def test_a_controllers_law_is_not_learned_as_friction(fitted):
    """Torque 0.9 N m times the sign of speed: 0.1.0 called that Coulomb friction, and data."""
    from tests.recordings.test_motion_checks import T, bang_bang

    q, _, torque = bang_bang()
    # what it takes to find no better posterior is not what is tested
    summary, told = fitted(T, q, torque, preset="servo-pendulum", more="max_steps = 2000")
    assert "feedback" in kinds(summary)
    assert "data" not in verdicts(summary).values()
    assert summary["sampler"]["status"] == "tentative"
    assert any("sign of speed" in line for line in told)
    assert any("sign of speed" in line for line in first_lines(summary))


def test_a_torque_of_the_wrong_sign_is_said(fitted):
    t = 0.005 * np.arange(3000)
    q = np.sin(3 * t) + 0.4 * np.sin(7.1 * t)
    v = 3 * np.cos(3 * t) + 0.4 * 7.1 * np.cos(7.1 * t)
    a = -9 * np.sin(3 * t) - 0.4 * 7.1**2 * np.sin(7.1 * t)
    noise = np.random.default_rng(1).normal(0, 0.01, t.size)
    summary, told = fitted(t, q, -(0.1 * a + 0.3 * v + 0.2 * np.sign(v)) + noise)
    (doubt,) = [one for one in summary["doubts"] if one["kind"] == "negative"]
    assert set(doubt["values"]) == {"motor.inertia", "motor.viscous", "motor.coulomb"}
    assert doubt["values"]["motor.inertia"] == pytest.approx(-0.1, rel=0.02)
    assert any("negative" in line for line in told)
    assert "data" not in verdicts(summary).values()


def test_what_a_model_does_not_explain_determines_nothing(fitted):
    """A hand on the joint: slow torques that have nothing to do with the motion."""
    t = 0.005 * np.arange(4000)
    rng = np.random.default_rng(3)
    q = np.sin(2 * t) + 0.3 * np.sin(5.3 * t)
    hand = np.convolve(rng.normal(size=t.size), np.exp(-np.arange(600) / 120.0), mode="same")
    torque = 0.02 * -4 * np.sin(2 * t) + 0.5 * hand / hand.std()
    summary, _ = fitted(t, q, torque)
    assert summary["fit"]["explained"] < 0.8
    assert "unexplained" in kinds(summary)
    assert "data" not in verdicts(summary).values()


def test_an_honest_recording_raises_no_doubt(fitted):
    t = 0.005 * np.arange(4000)
    q = np.sin(2 * t) + 0.3 * np.sin(5.3 * t)
    v = 2 * np.cos(2 * t) + 0.3 * 5.3 * np.cos(5.3 * t)
    a = -4 * np.sin(2 * t) - 0.3 * 5.3**2 * np.sin(5.3 * t)
    # noise twice as large as the signal: little is explained, and that is all right
    noise = np.random.default_rng(4).normal(0, 2.0, t.size)
    summary, told = fitted(t, q, 0.1 * a + 0.3 * v + 0.2 * np.sign(v) + noise)
    assert summary["doubts"] == []
    assert summary["sampler"]["status"] == "reliable"
    assert not any("WARNING" in line for line in told)


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
    ("verdict", "ends", "status", "told"),
    [
        ("data", [1.2, 1.3], "reliable", True),
        ("data", [1.05, 1.3], "reliable", False),
        ("prior", [1.2, 1.3], "reliable", False),
        ("data", [1.2, 1.3], "unusable", False),
    ],
)
def test_a_number_that_moves_with_the_noise_model_is_named(verdict, ends, status, told):
    summary = summary_of({"a.b": row(1.0, 0.9, 1.1, verdict), "c.d": row(2.0, 1.9, 2.1)}, status)
    white = {"a.b": Spread.read(row(1.2, *ends)), "c.d": Spread.read(row(2.0, 1.9, 2.1))}
    found = find_doubts(_Fit(), summary, white=(white, 1.0))
    assert [(one["kind"], one["parameters"]) for one in found] == [("noise", ["a.b"])] * told
    summary = put_doubts(summary, found)
    assert (summary.sampler.status == "tentative") == told
    verdicts = [one.verdict for one in summary.parameters.values()]
    assert verdicts == ["weak" if told else verdict, "data"]
    assert (summary.parameters["a.b"].doubted == ["noise"]) == told


@pytest.mark.parametrize(
    ("reason", "white", "lacks", "told"),
    [
        ("few", False, False, True),
        ("few", True, True, False),
        (None, False, False, False),
    ],
)
def test_a_model_that_nothing_could_ask_is_doubted_where_it_leaves_no_noise(
    reason, white, lacks, told
):
    """Measured, XL330: 36 outputs, an inertia of a tenth of what its mass has, and no doubt."""
    summary = summary_of({"a.b": row(1.0, 0.9, 1.1)})
    lacking = [Lack(on="speed", sure=False, share=0.38)] if lacks else []
    noise = summary.noise.model_copy(update={"innovation_whiteness": Whiteness(white=white)})
    fit = summary.fit.model_copy(update={"lacks": lacking})
    update = {"model_error": ModelError(shown=False, reason=reason), "noise": noise, "fit": fit}
    found = find_doubts(_Fit(), summary.model_copy(update=update))
    assert [one["kind"] for one in found] == ["unchecked"] * told
    if told:
        doubted = put_doubts(summary.model_copy(update=update), found)
        assert doubted.sampler.status == "tentative"
        assert doubted.parameters["a.b"].doubtful
        text = "\n".join(fit_text(doubted))
        assert "all numbers are tentative" in text
        assert "too few outputs to be parted" not in text


def test_residuals_that_rise_with_a_noise_model_make_all_of_it_doubtful():
    summary = summary_of({"a.b": row(1.0, 0.9, 1.1)})
    (one,) = find_doubts(_Fit(), summary, white=(summary.parameters, 0.8))
    assert (one["parameters"], one["rise"]) == (["a.b"], 1.25)


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


@pytest.mark.parametrize(
    ("doubt", "says"),
    [
        (
            {"kind": "unexplained", "share": 0.217, "quantity": "motor torque"},
            "22 % of the measured",
        ),
        ({"kind": "feedback", "law": "sign of speed", "recordings": ["a", "b"]}, "(a, b)"),
        ({"kind": "negative", "values": {"total.viscous": -0.31}}, "total.viscous -0.31"),
        ({"kind": "memory", "asked": 4, "taken": 0, "shift": 7.8, "rise": 1.3}, "AR(4)"),
        ({"kind": "memory", "asked": 4, "taken": 1, "shift": 7.8, "rise": 1.3}, "AR(1) is taken"),
        (
            {
                **{"kind": "once-a-turn", "cosine": 0.0341, "sd": 0.001, "moves": 7.0, "times": 1},
                "moved": {"offset": -2.2},
            },
            "moves offset by 2.2 of its sds; a sine as large",
        ),
        (
            {
                **{"kind": "once-a-turn", "cosine": 0.0341, "sd": 0.001, "moves": 7.0, "times": 0},
                "moved": {},
            },
            "once a turn of something that turns with the joint",
        ),
        ({"kind": "velocity", "recording": "a", "factor": 57.3}, "velocity of a is 57.3 times"),
        ({"kind": "velocity", "recording": "a", "factor": 0.0}, "has nothing to do with"),
        ({"kind": "noise", "rise": 1.0, "white": {"offset": -3.309}}, "offset -3.309"),
        ({"kind": "noise", "rise": 1.2, "white": {}}, "1.2 times smaller"),
        ({"kind": "acceleration", "ratio": 5.6, "parameters": ["motor.inertia"]}, "motor.inertia"),
    ],
)
def test_every_kind_is_worded_with_its_numbers(doubt, says):
    words = doubt_text(doubt)
    assert says in words
    assert "\n" not in words
    assert not words.endswith(".")


def test_no_doubt_changes_nothing():
    summary = summary_of({"a.b": row(1.0, 0.9, 1.1)})
    summary = put_doubts(summary, find_doubts(_Fit(), summary))
    assert summary.as_dict()["doubts"] == []
    assert summary.sampler.status == "reliable"


def test_a_late_position_is_warned_of_and_no_speed_term_called_data(fitted):
    """Two samples late at 500 Hz; inertia and viscous loss are what that moves."""
    joint = Joint.preset("servo-pendulum")
    late = replace(joint, delay=True)
    options = {"rate": 500, "excitation": "multisine", "amplitude": 1.0, "torque_noise": 0.01}
    made = late.simulate({"drive.delay": 0.004}, encoder_side="joint", **options)
    columns = (made[name].to_numpy() for name in ("time", "position", "torque"))
    summary, told = fitted(*columns, preset="servo-pendulum")
    assert "delay" in kinds(summary)
    assert verdicts(summary)["motor.inertia"] != "data"
    assert verdicts(summary)["motor.viscous"] != "data"
    assert summary["sampler"]["status"] == "tentative"
    (line,) = [line for line in told if "set delay = true in [mechanism]" in line]
    assert line.startswith("WARNING: the position comes 0.004")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({}, "the position comes 0.00399"),
        ({"velocity": "rad/s"}, "late: velocity: is 57.3 times"),
        ({"time": "s"}, "late: time: all numbers are whole"),
    ],
)
def test_while_a_unit_is_doubted_no_delay_is(wrong, said):
    """What a wrong unit leaves of the torque may look late; it is to be mended first."""
    late = replace(Joint.preset("servo-pendulum"), delay=True)
    options = {"rate": 500, "excitation": "multisine", "amplitude": 1.0, "torque_noise": 0.01}
    made = late.simulate({"drive.delay": 0.004}, encoder_side="joint", **options)
    speed = np.degrees(np.gradient(made["position"], made["time"]))
    made = made.assign(time=np.round(1e3 * made["time"]), velocity=speed)
    units = {"time": "ms", "velocity": "deg/s"} | wrong
    one = Recording.from_dataframe(
        made, name="late", velocity="velocity", time="time", torque="torque", position="position",
        units=units,
    )  # fmt: skip
    found = check(Model(Joint.preset("servo-pendulum"), one))
    assert any(text.startswith(said) for text in found.warnings), found.warnings
    assert ("delay" in {doubt["kind"] for doubt in found.as_json()["doubts"]}) is not bool(wrong)
    # of a fit it is the first doubt, of all numbers
    summary = summary_of({"a.b": row(1.0, 0.9, 1.1)})
    fit = _Fit()
    fit.chain = Joint.preset("servo-pendulum")
    fit.observations = Model(fit.chain, one).observations
    doubts = find_doubts(fit, summary)
    if wrong:
        factor = 180.0 / np.pi if "velocity" in wrong else 1e3
        assert doubts[0]["kind"] == "velocity"
        assert doubts[0]["factor"] == pytest.approx(factor, rel=0.01)
        assert doubts[0]["parameters"] == ["a.b"]
    else:
        assert "velocity" not in {doubt["kind"] for doubt in doubts}
    # what it would be is told all the same
    assert found.as_json()["delays"]


def test_a_zero_that_is_off_is_warned_of_and_gravity_not_called_data(fitted):
    """The same as a ripple once a turn; speed and acceleration have nothing to do with it."""
    text = "\n[mechanism.load]\ngravity_angle = false\n"
    options = {"rate": 500, "excitation": "multisine", "amplitude": 1.0, "torque_noise": 0.01}
    made = Joint.preset("servo-pendulum").simulate({"load.gravity_angle": 0.05}, **options)
    columns = (made[name].to_numpy() for name in ("time", "position", "torque"))
    summary, told = fitted(*columns, preset="servo-pendulum", more=text)
    (doubt,) = (one for one in summary["doubts"] if one["kind"] == "once-a-turn")
    assert "load.first_moment" in doubt["parameters"]
    assert verdicts(summary)["load.first_moment"] == "weak"
    assert summary["sampler"]["status"] == "tentative"
    (line,) = [line for line in told if "gravity_angle = true mends" in line]
    assert line.startswith("WARNING: the torque depends on the angle as gravity")


def test_only_what_moves_is_doubted_beside_gravity():
    turn = OnceATurn(0.03, 0.001, 6.0, {"offset.run": 2.0, "total.coulomb": 0.1}, 1)
    rows = ("load.first_moment", "total_drive.gravity", "motor.inertia", "offset", "a.coulomb")
    summary = summary_of({name: row(1.0, 0.9, 1.1) for name in rows})
    (doubt,) = find_doubts(_Fit(), summary, turn=turn)
    assert doubt["parameters"] == ["load.first_moment", "total_drive.gravity", "offset"]
    assert find_doubts(_Fit(), summary, turn=replace(turn, value=0.002)) == []
    assert find_doubts(_Fit(), summary_of({"a.b": row(1.0, 0.9, 1.1)}), turn=turn) == []
    # half the difference of both directions is a constant
    split = summary_of({"motor.coulomb_positive": row(1.0, 0.9, 1.1)})
    assert find_doubts(_Fit(), split, turn=turn)[0]["parameters"] == ["motor.coulomb_positive"]


@pytest.mark.parametrize("shown", [False, True])
def test_a_push_is_told_before_what_the_model_lacks(shown):
    summary = summary_of({"a.b": row(1.0, 0.9, 1.1)})
    if shown:
        error = {"shown": True, "axes": []}
        summary = summary.model_copy(update={"model_error": ModelError.model_validate(error)})
    pushes = [Disturbance("run", 15.94, 16.21, 60.0, 9.0), Disturbance("run", 3.0, 3.4, 20.0, 3.0)]
    found = find_doubts(_Fit(), summary, white=(summary.parameters, 0.8), pushed=pushes)
    assert [one["kind"] for one in found] == ["pushed", "noise"]
    assert found[0]["exclude"] == [[3.0, 3.4], [15.9, 16.3]]
    words = doubt_text(found[0])
    assert "exclude = [[3.0, 3.4], [15.9, 16.3]]" in words
    assert "by at least 9 N m at its worst, 60 times as much as usual" in words
    # as runs of before wrote it
    before = {key: value for key, value in found[0].items() if key not in ("torque", "unit")}
    assert "by up to 60 times as much as usual" in doubt_text(before)
    assert ("before any term is added" in words) == shown
    assert put_doubts(summary, found).parameters["a.b"].doubted == ["pushed", "noise"]


def test_a_push_is_a_doubt_of_all_that_rests_on_the_data():
    """Also of what a prior helped to settle, and of a limit; not of what is the prior's alone."""
    limit = row(0.01, 0.001, 0.02, "prior") | {"at_bound": "lower", "bound": 0.0}
    limit |= {"data_sd": 0.01, "prior_sd": 0.3}
    rows = {
        "a.known": row(1.0, 0.9, 1.1),
        "a.helped": row(1.0, 0.9, 1.1, "weak") | {"given_by": ["b.c"]},
        "a.limit": limit,
        "a.open": row(1.0, 0.9, 1.1, "prior"),
    }
    summary = summary_of(rows)
    pushes = [Disturbance("run", 3.0, 3.4, 20.0, 3.0)]
    found = put_doubts(summary, find_doubts(_Fit(), summary, pushed=pushes))
    told = found.parameters
    assert [name for name in rows if told[name].doubted] == ["a.known", "a.helped", "a.limit"]
    verdicts = [(told[name].verdict, told[name].undoubted) for name in rows]
    assert verdicts == [("weak", "data"), ("weak", "weak"), ("prior", "prior"), ("prior", None)]
    cells = posterior_cells(found)
    assert [cells[name].told_status for name in rows] == [*["doubtful"] * 3, "undetermined"]


@pytest.mark.parametrize(
    ("move", "shown", "doubted"),
    [
        (
            0.03,
            True,
            [],
        ),  # within the sd with room for the model's error, not within the narrow one
        (0.3, True, ["a.viscous", "total.viscous"]),
        (0.03, False, ["a.viscous", "b.inertia", "total.viscous"]),
    ],
)
def test_noise_that_moves_a_number_by_less_than_its_room_doubts_nothing(move, shown, doubted):
    rows = {name: row(1.0, 0.99, 1.01) for name in ("a.viscous", "b.inertia")}
    rows |= {"total.viscous": row(1.0, 0.99, 1.01)}
    for one in rows.values():
        one |= {"model_error_interval": [0.8, 1.2], "model_error_sd": 0.1} if shown else {}
    summary = summary_of(rows)
    derived = {"total.viscous": summary.parameters.pop("total.viscous")}
    error = ModelError.model_validate({"shown": shown, "axes": []})
    summary = summary.model_copy(update={"model_error": error, "derived": derived})
    tried = (Evidence(0, 0.0, 1.0, 0.0), Evidence(1, -90.0, 0.9, 0.0, shift=5.0, rise=1.02))
    choice = Choice(0, tried, {"a.viscous": -move, "b.inertia": 1e-3})
    assert choice.refused
    found = find_doubts(_Fit(), summary, choice)
    assert [name for one in found for name in sorted(one["parameters"])] == doubted
    assert put_doubts(summary, found).sampler.status == ("tentative" if doubted else "reliable")


def test_a_delay_makes_those_numbers_doubtful_that_it_moves():
    moves = {"motor.coulomb": -2.7, "total.viscous": 1.7, "total.viscous_difference": -0.1}
    late = Delay(("run",), 8e-4, 2e-5, 1e-3, moves | {"motor.inertia": -0.3, "offset": 0.1})
    rows = ("motor.inertia", "motor.viscous_positive", "motor.coulomb", "offset")
    (doubt,) = find_doubts(_Fit(), summary_of({n: row(1.0, 0.9, 1.1) for n in rows}), delays=[late])
    assert doubt["parameters"] == ["motor.viscous_positive", "motor.coulomb"]
    words = doubt_text(doubt)
    assert "motor.coulomb by 2.7 of its sds (total.viscous by more than one of theirs)" in words
    assert "see first what bayesfric explain finds" in words
    assert "explain" not in doubt_text(doubt | {"none_asked": True})


def test_pushes_that_overlap_in_tenths_of_a_second_are_one_span():
    pushes = [
        Disturbance("run", 15.94, 16.21, 60.0, 9.0),
        Disturbance("run", 16.24, 17.16, 20.0, 3.0),
    ]
    (doubt,) = pushed_doubts(pushes, "N m")
    assert doubt["exclude"] == [[15.9, 17.2]]


def test_delays_that_contradict_each_other_are_no_delay():
    def one(value, name):
        return Delay((name,), value, 1e-4, 2e-3, {"motor.inertia": 4.0})

    totals = Estimate("least-squares", (), 1.0, 100, "")
    (doubt,) = doubts_before(totals, [], [one(0.01, "a"), one(-0.01, "b"), one(0.0, "c")])
    assert [late["recordings"] for late in doubt["late"]] == [["a"], ["b"]]
    assert "contradict each other" in doubt_text(doubt)
    (doubt,) = doubts_before(totals, [], [one(0.01, "a"), one(0.0101, "b")])
    assert "set delay = true" in doubt_text(doubt)
    # a motor does not follow the motion that it makes
    (doubt,) = doubts_before(totals, [], [one(-0.01, "a"), one(-0.0101, "b")])
    assert "set delay = true" not in doubt_text(doubt)
    assert "no torque comes after the motion" in doubt_text(doubt)
    assert doubts_before(totals, [], [one(2e-4, "a")]) == []


@pytest.mark.parametrize(("together", "alike"), [(0.0259, False), (-0.0105, True)])
def test_a_delay_of_all_that_none_of_them_has_is_none(together, alike):
    """Measured, XL330: four recordings each some 10 ms early, and all together 26 ms late."""
    sds = {"a": (-0.003, 0.012), "b": (-0.025, 0.012), "c": (-0.011, 0.0064), "d": (-0.0067, 0.009)}
    alone = [Delay((name,), *one, 1e-3, {}) for name, one in sds.items()]
    every = Delay((*sds,), together, 0.003, 1e-3, {"total.inertia": 4.0})
    rows = ("motor.inertia", "motor.viscous", "offset")
    summary = summary_of({n: row(1.0, 0.9, 1.1) for n in rows})
    (doubt,) = find_doubts(_Fit(), summary, delays=[*alone, every])
    assert doubt["alike"] is alike
    assert ("delay = true" in doubt_text(doubt)) == (alike and together > 0)


def test_one_delay_of_the_joint_does_not_hold_what_another_recording_has():
    """Measured, AK80-6: 12 ms late in one of two recordings, and zero with delay = true."""
    totals = Estimate("least-squares", (), 1.0, 100, "")
    moves = {"total.viscous": 1.7}
    found = [Delay(("a",), 0.0, 1e-3, 2e-3, moves), Delay(("b",), 0.0116, 2e-3, 2e-3, moves)]
    together = Delay(("a", "b"), 0.001, 1e-3, 2e-3, moves)
    left = contradicting([*found, together], 0.0005, 1e-3)
    (doubt,) = doubts_before(totals, [], left)
    assert [late["recordings"] for late in doubt["late"]] == [["b"]]
    assert "contradict each other" in doubt_text(doubt)
    assert contradicting([*found, together], 0.005, 2.5e-3) == []
    # one recording has the delay that it has
    assert contradicting(found[1:], 0.0, 1e-3) == []


def test_check_says_that_a_pendulum_is_no_axis(bench):
    """A SIMULATED servo pendulum, asked as a motor axis: gravity is most of its torque."""
    pendulum = SMALL.replace("motor-axis", "servo-pendulum")
    seen = '\n[simulation]\nduration = 4.0\nrate = 200\nexcitation = "multisine"\n'
    bench.simulated(pendulum + seen, "small", seed=3)
    kinds = {}
    for name, text in {"right": pendulum, "wrong": SMALL}.items():
        (bench.folder / f"{name}.toml").write_text(text, encoding="utf-8")
        ended = bench.run("check", f"{name}.toml", "--json")
        assert ended.code == 0
        kinds[name] = [one["kind"] for one in json.loads(ended.out)["doubts"]]
    assert "unexplained" in kinds["wrong"]
    assert "unexplained" not in kinds["right"]
    assert "servo-pendulum" in bench.run("check", "wrong.toml").out


@pytest.mark.parametrize("told", [0.15, 0.3])
def test_a_compromise_of_data_and_a_prior_that_they_contradict_is_doubted(told):
    """Measured, XL330: a weight 4.1 sds off, and an inertia a third of the bob's as data's."""
    time = np.arange(0.0, 12.0, 0.004)
    q, qd, qdd = swing(time, [(0.31, 0.9), (0.73, 0.5), (1.9, 0.1)])
    torque = AXIS.torque(VALUES, q, qd, qdd)
    torque += 0.2 * np.random.default_rng(8).standard_normal(time.size)
    prior = {"load.first_moment": {"distribution": "norm", "loc": told, "scale": 0.01}}
    model = bf.Model(AXIS, bf.Recording.from_arrays(time, q, torque), priors=prior,
                     self_check={"recordings": 0}, sampling={"min_ess": 400})  # fmt: skip
    summary = model.fit(seed=1).summary
    kinds = [one.kind for one in summary.doubts]
    if told == VALUES["load.first_moment"]:
        assert "prior" not in kinds
        return
    assert kinds == ["prior"]
    assert summary.sampler.status == "tentative"
    assert all(row.doubted == ["prior"] for row in summary.joint.values())
    first = [a.text for a in alerts_of(summary) if a.first]
    assert first[0].startswith("the data contradict the prior given for load.first_moment")


def test_what_depends_on_the_acceleration_is_told_of_every_quantity():
    """Of one that another parameter shapes, such as a loss that warms up, it ended a fit."""
    moved = {name for name, row in QUANTITIES.items() if _accelerates(row)}
    assert moved == {name for name, row in QUANTITIES.items() if row.option == "inertia"}
