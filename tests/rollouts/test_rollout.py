"""Roll-outs of SIMULATED servos under position control, through the command line and Python."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

import bayesfric as bf
from bayesfric.base.atomic_write import jsonable
from bayesfric.fit.result import result_of
from bayesfric.mechanism.closed_loop import follow
from bayesfric.mechanism.joint import PRESETS
from bayesfric.recordings.measurement import Law
from bayesfric.report.terminal import roll_out_messages
from bayesfric.rollouts.rollout import (
    PreparedRecording,
    _compare,
    autocorrelation_time,
    bootstrapped,
    moving_share,
    rollout,
)
from tests.commands.bench import Bench, has, without_figures

pytestmark = pytest.mark.usefixtures("nothing_explained")

JOINT = '[mechanism]\npreset = "motor-axis"\n[mechanism.load]\nfirst_moment = true\n'
TRUTH = {"motor.inertia": 0.01, "motor.viscous": 0.06, "motor.coulomb": 0.1,
         "load.first_moment": 0.05, "offset": 0.0}  # fmt: skip
CHAIN = PRESETS["motor-axis"].chain()
RATE, N = 250.0, 2000
QUICK = """
[processing]
dead_zone = 0.1
[noise]
model = "white"
[sampling]
seed = 3
min_ess = 400
ensembles = 2
walkers = 32
[self_check]
recordings = 0
"""


def table(name, kp=4.0, effort=True):
    """A recording's table; one without its torque is known by its target alone."""
    torque = 'torque = { column = "tau", unit = "N m" }\n' if effort else ""
    return f"""
[[recordings]]
file = "{name}.csv"
time = {{ column = "t", unit = "s" }}
position = {{ column = "q", unit = "rad" }}
{torque}target = {{ column = "goal", unit = "rad", kp = "{kp} N m/rad", kd = "0.05 N m s/rad" }}
"""


@pytest.fixture(scope="module")
def joint():
    from bayesfric.problem.config import config_of

    return config_of({"mechanism": {"preset": "motor-axis", "load": {"first_moment": True}}}
                     ).tables.mechanism.joint()  # fmt: skip


def recorded(joint, folder, name, seed, kp=4.0, noise=0.02, missing=0.0):
    """Play targets to the true joint; ``missing`` is a torque that no model has."""
    rng = np.random.default_rng(seed)
    time = np.arange(N) / RATE
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    goal = sum(a * np.sin(w * time + p) for w, a, p in zip((1.3, 3.1, 7.9), (0.8, 0.4, 0.1),
                                                           phases, strict=True))  # fmt: skip
    law = Law(kp * goal, np.ones(N), kp=kp, kd=0.05)
    push = missing * np.sin(5.0 * time + phases[0])[None]
    q, qd = follow(joint, joint.vector(TRUTH)[None], law, 1.0 / RATE, [(0, N)], goal[:1],
                   np.zeros(1), push=push)  # fmt: skip
    torque = law.drives(q[0], qd[0]) + noise * rng.standard_normal(N)
    steps = 2.0 * np.pi / 20_000
    frame = {"t": time, "q": steps * np.round(q[0] / steps), "goal": goal, "tau": torque}
    pd.DataFrame(frame).to_csv(folder / f"{name}.csv", index=False)


@pytest.fixture(scope="module")
def made(joint, tmp_path_factory):
    """A run of one recording that holds another out, and a third that it never saw."""
    folder = tmp_path_factory.mktemp("rollout")
    for seed, name in enumerate(("one", "two", "three")):
        recorded(joint, folder, name, seed)
    held = '[validation]\nrecordings = ["two"]\n'
    (folder / "c.toml").write_text(JOINT + table("one") + table("two") + QUICK + held)
    (folder / "new.toml").write_text(table("three", effort=False))
    model = bf.Model.from_config(folder / "c.toml")
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        found = model.sample()
        bf.report(found, folder / "run")
    return folder, found


@pytest.fixture
def bench(made, monkeypatch, capfd):
    monkeypatch.chdir(made[0])
    return Bench(made[0], monkeypatch, capfd)


def test_a_right_model_moves_as_measured(made):
    _, found = made
    rolled = rollout(found)
    (two,) = rolled.rolled
    assert (two.name, two.part, two.input, two.unit) == ("two", "held out", "target", "rad")
    assert two.errors["position"].mae < 2e-3
    assert two.errors["speed"].mae < 0.02
    # two cycles of a motion are a few independent positions
    assert two.errors["position"].inside > 0.6
    # the same seed gives the same numbers, any seed the same median
    first, repeated, other = (rollout(found, draws=20, seed=seed) for seed in (None, None, 9))
    assert first.rolled[0].band[0].tobytes() == repeated.rolled[0].band[0].tobytes()
    assert first.rolled[0].middle.tobytes() == other.rolled[0].middle.tobytes()
    # noise of the torque sensor moves no joint
    assert rolled.unexplained["one"] < 0.5
    assert rolled.left == pytest.approx(0.02 * np.sqrt(2.0 * 0.5 * 0.1), rel=1.0)


def test_the_command_prints_what_python_returns(bench, made):
    folder, _ = made
    told = bench.run("rollout", "run", "--draws", "30", "--json")
    assert told.code == 0, told.err
    found = json.loads(told.out)
    rolled = rollout(folder / "run", draws=30)
    assert found["recordings"]["two"]["position"]["mae"] == rolled.rolled[0].errors["position"].mae
    assert found["pooled"]["speed"]["rmse"] == rolled.pooled["speed"].rmse
    frame = rolled.frame
    assert frame.loc[("two", "position"), "inside"] == rolled.rolled[0].errors["position"].inside
    summary = bf.summary(folder / "run")
    assert jsonable(summary.rollout) == found
    page = (folder / "run" / "report.html").read_text()
    assert 'id="roll-out"' in page
    for kind in ("pdf", "png", "svg"):
        assert (folder / "run" / "figures" / f"rollout.{kind}").is_file()


def test_other_recordings_are_simulated_by_their_targets(bench, made):
    folder, _ = made
    told = bench.run("rollout", "run", "new.toml", "--draws", "30", "--json")
    assert told.code == 0, told.err
    rows = json.loads(told.out)["recordings"]
    assert rows["three"]["part"] == "new"
    assert rows["three"]["position"]["mae"] < 2e-3
    # and in Python, a recording made there
    frame = pd.read_csv(folder / "three.csv")
    other = bf.Recording.from_dataframe(
        frame, time="t", position="q", target="goal", kp="4 N m/rad", kd="0.05 N m s/rad", name="x"
    )
    (x,) = rollout(folder / "run", other, draws=30).rolled
    assert x.errors["position"].mae == pytest.approx(rows["three"]["position"]["mae"], rel=0.2)


def test_part_of_a_fitted_file_is_not_new(made):
    folder, _ = made
    frame = folder / "one.csv"
    columns = {"time": "t", "position": "q", "torque": "tau", "name": "x"}
    piece = bf.Recording.from_file(frame, **columns, stop="3 s")
    (x,) = rollout(folder / "run", piece, draws=10).rolled
    assert x.part == "fitted"
    other = bf.Recording.from_file(folder / "three.csv", **columns, stop="3 s")
    (x,) = rollout(folder / "run", other, draws=10).rolled
    assert x.part == "new"


def test_a_measured_torque_is_simulated_in_open_loop(made):
    folder, _ = made
    frame = pd.read_csv(folder / "three.csv")
    other = bf.Recording.from_dataframe(frame, time="t", position="q", torque="tau", name="x")
    (x,) = rollout(folder / "run", other, draws=30).rolled
    assert x.input == "torque"
    assert x.errors["position"].mae < 0.3


def test_narrow_bands_are_reported_where_a_torque_is_missing(made, joint, tmp_path):
    """A push that the fitted recording did not have: bands too narrow, and said so."""
    _, found = made
    recorded(joint, tmp_path, "pushed", 5, missing=0.5)
    frame = pd.read_csv(tmp_path / "pushed.csv")
    other = bf.Recording.from_dataframe(
        frame, time="t", position="q", target="goal", kp="4 N m/rad", kd="0.05 N m s/rad"
    )
    doubt = roll_out_messages(rollout(found, other, draws=30).summary)["roll-out"]
    assert doubt["inside"] < 0.5
    assert "roll-out" not in roll_out_messages(rollout(found, draws=30).summary)


def test_bands_wider_than_the_motion_are_reported(made):
    """The same bands and motion, and then the motion 300 times smaller."""
    _, found = made
    played = rollout(found, draws=30)
    (two,) = played.rolled
    fine = np.isfinite(two.band[0])
    span = np.ptp(two.position[fine])
    assert two.room == pytest.approx(span)
    assert span < np.pi
    assert two.errors["position"].width == pytest.approx(
        np.median((two.band[1] - two.band[0])[fine])
    )
    assert not two.wide
    told = played.summary
    assert "wide bands" not in roll_out_messages(told)
    # at what half of all bands are wider than
    small = replace(two, room=two.errors["position"].width, blind=0.5)
    told = replace(played, rolled=(small,)).summary
    assert roll_out_messages(told)["wide bands"] == {"wide": ["two"]}


@pytest.mark.parametrize(("gravity", "turns"), [(True, 0.5), (False, 4.0)])
def test_useful_width_is_half_a_turn_where_gravity_acts(made, joint, gravity, turns):
    """A motion over four turns: beyond half of one, gravity may be anything."""
    _, found = made
    run = result_of(found)
    m, o = run.model.recordings[0], run.model.observations[0]
    far = replace(m, position=np.linspace(0.0, 8.0 * np.pi, m.time.size))
    moved = far.position + np.linspace(-2.0, 2.0, 5)[:, None], np.zeros((5, m.time.size))
    some = SimpleNamespace(joint=joint if gravity else CHAIN)
    x = _compare(some, PreparedRecording(far, o, "new"), moved, moved)
    assert x.room == pytest.approx(2.0 * np.pi * turns)
    # ends of nine tenths of five draws over 4 rad: wider than half a turn, not than four
    assert (x.blind, x.wide) == (float(gravity), gravity)


@pytest.mark.parametrize("lost", [0, 3, 30])
def test_draws_that_go_another_way_over_the_top_are_left_out_of_bands(made, joint, lost):
    """Of 100 plays some leave for the next turn half way; without gravity that is no other way."""
    _, found = made
    run = result_of(found)
    m, o = run.model.recordings[0], run.model.observations[0]
    near = m.position + np.random.default_rng(1).normal(0.0, 0.1, (100, 1))
    near[:lost, m.time.size // 2 :] += 2.0 * np.pi
    still = np.zeros_like(near)
    for chain in (joint, CHAIN):
        x = _compare(
            SimpleNamespace(joint=chain), PreparedRecording(m, o, "new"), *[(near, still)] * 2
        )
        assert x.over == (lost / 100 if chain is joint else 0.0)
        if chain is joint:
            assert x.wide == (lost == 30)
        if chain is joint and lost <= 3:
            # 90 % of a normal is 3.3 sds wide; a quantile's own sd is 0.2 of them at 100 draws
            assert x.errors["position"].width == pytest.approx(0.33, abs=4 * 0.03)
            ends = (x.band[1] - x.band[0])[np.isfinite(x.band[0])]
            assert np.ptp(ends) < 1e-9


def test_recordings_with_wide_bands_decide_nothing(made):
    """One is inside bands that are too wide; the other leaves its own for a third of the time."""
    _, found = made
    played = rollout(found, draws=30)
    (one,) = played.rolled

    def inside(share):
        return one.errors | {"position": replace(one.errors["position"], inside=share)}

    wide = replace(one, name="wide", over=0.5, errors=inside(1.0))
    left = replace(one, name="left", errors=inside(0.67))
    doubt = roll_out_messages(replace(played, rolled=(wide, left)).summary)["roll-out"]
    assert doubt["inside"] == pytest.approx(0.67)
    assert doubt["narrow"] == ["left"]
    assert "roll-out" not in roll_out_messages(replace(played, rolled=(wide,)).summary)


def test_a_fit_by_targets_is_that_by_the_torque(made, joint):
    """Without noise of a sensor the target's gains make the very torque."""
    folder, found = made
    measured = result_of(found).summary.parameters
    other = bf.Model(
        joint,
        bf.Recording.from_dataframe(
            pd.read_csv(folder / "one.csv"), time="t", position="q", target="goal",
            kp="4 N m/rad", kd="0.05 N m s/rad",
        ),
        processing={"dead_zone": 0.1},
    )  # fmt: skip
    by_target = {p.name: p for p in other.estimates(["input-error"])[0].values}
    for name, row in measured.items():
        if name in by_target:
            assert abs(by_target[name].value - row.mean) < 5.0 * row.sd, name


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["run", "other.toml"], ["other.toml: mechanism: is not the run's"]),
        (["."], ["summary.json"]),
        (["run", "nowhere.toml"], ["nowhere.toml"]),
        (["gone"], ["one.csv"]),
        (["drawless"], ["posterior.nc"]),
    ],
)
def test_impossible_roll_outs_are_refused(bench, made, words, parts):
    folder, _ = made
    text = '[mechanism]\npreset = "servo-pendulum"\n' + table("three")
    (folder / "other.toml").write_text(text)
    for name in ("gone", "drawless"):
        shutil.copytree(folder / "run", folder / name, dirs_exist_ok=True)
    (folder / "drawless" / "posterior.nc").write_bytes(b"no draws")
    summary = (folder / "run" / "summary.json").read_text().replace("one.csv", "none/one.csv")
    (folder / "gone" / "summary.json").write_text(summary)
    has(bench.refused("rollout", *words), *parts)


def test_a_run_read_back_has_the_draws_of_its_intervals(made):
    """What goes on from a run, goes on from draws that have the intervals it tells."""
    folder, found = made
    summary = result_of(found).summary
    for posterior in (result_of(found), result_of(folder / "run")):
        assert posterior.joint.names == result_of(found).model.chain.names
        for k, name in enumerate(posterior.names):
            row = summary.parameters[name]
            # 4000 draws of maybe 400 independent ones
            ends = np.quantile(posterior.draws[:, k], [0.05, 0.95])
            assert ends == pytest.approx(
                [row.reported.low, row.reported.high], abs=0.25 * row.reported.sd
            ), name
        whole = posterior.values(posterior.picked(7))
        assert whole.shape == (7, len(posterior.joint.names))


def test_what_was_fixed_is_filled_in(made):
    posterior = result_of(made[1])
    names = posterior.joint.names
    known = {name: SimpleNamespace(value=0.5 + k) for k, name in enumerate(names)}
    model = SimpleNamespace(chain=posterior.joint, priors=known)
    summary = SimpleNamespace(parameters=dict.fromkeys(names[:1]))
    given = replace(posterior, model=model, summary=summary, draws=np.full((3, 1), 0.7))
    values = given.values(given.draws)
    assert (values[:, 0] == 0.7).all()
    for k in range(1, len(names)):
        assert (values[:, k] == 0.5 + k).all()


# -- blocks of residuals, and their share that moves a joint


def autoregression(n=20_000, a=0.8, seed=0):
    """A first-order autoregression with standard deviation one."""
    rng = np.random.default_rng(seed)
    x = np.empty(n)
    x[0] = rng.standard_normal()
    for k in range(1, n):
        x[k] = a * x[k - 1] + np.sqrt(1.0 - a**2) * rng.standard_normal()
    return x


def test_autocorrelation_time_of_an_autoregression():
    # (1 + a) / (1 - a); its estimate's relative sd is about sqrt(2 (2 W + 1) / N), Sokal
    assert autocorrelation_time(autoregression()) == pytest.approx(9.0, rel=0.25)
    assert autocorrelation_time(np.random.default_rng(1).standard_normal(20_000)) == pytest.approx(
        1.0, abs=0.1
    )
    assert autocorrelation_time(np.zeros(30)) == 1.0


def test_blocks_keep_variance_and_autocorrelation():
    x = autoregression()
    rng = np.random.default_rng(2)
    drawn = bootstrapped([(x, 0.02)], 40, 2000, 0.02, rng)
    # 80,000 outputs of which every nine are one: sd of a variance sqrt(2 * 9 / 80000) = 0.015
    assert drawn.var() == pytest.approx(1.0, abs=0.06)
    lag = np.mean(drawn[:, 1:] * drawn[:, :-1]) / drawn.var()
    # one pair in ninety is torn apart
    assert lag == pytest.approx(0.8, abs=0.03)


def test_share_of_the_torque_that_moves_the_joint():
    """Errors that are half of what the whole torque would make; parameters known or not."""
    rng = np.random.default_rng(6)
    for known in (0.0, 0.3):
        without = known * rng.standard_normal((4000, 300))
        disturbed = without + rng.standard_normal((4000, 300))
        measured = np.sqrt(known**2 + 0.25) * rng.standard_normal(300)
        # the 90 % point of 300 normals: sd of the quantile 0.09 of a sd, twice that allowed
        assert moving_share(measured, without, disturbed, 0.0) == pytest.approx(0.5, abs=0.1)


def test_share_is_zero_without_need_and_one_without_motion():
    rng = np.random.default_rng(7)
    without = rng.standard_normal((200, 300))
    disturbed = without + rng.standard_normal((200, 300))
    assert moving_share(0.5 * rng.standard_normal(300), without, disturbed, 0.0) == 0.0
    nothing = np.full((5, 8), np.nan)
    assert moving_share(np.zeros(8), nothing, nothing, 0.0) == 1.0
