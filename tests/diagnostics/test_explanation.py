"""What else explains the torque: found under its name, and nothing where the model is right."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.diagnostics.regression import regression_of
from bayesfric.fit.model import Model
from tests.axis import recording_of
from tests.diagnostics.bench import QUICK, axis, model, recording, table
from tests.estimates.test_delay import PENDULUM, SERVO, servo

# whose target is said to act at once
PROMPT = replace(SERVO, delay=False)


@pytest.fixture(scope="module")
def right():
    return model()


def of_table(change, **more):
    made = table().copy()
    change(made)
    return Model(axis(**more), recording(made))


def test_a_right_model_lacks_nothing(right):
    explained = right.explain()
    assert explained.reason is None
    assert len(explained.replicates) >= 20
    assert not explained.findings


def test_a_torque_constant_that_sags_is_named_and_moves_what_it_moves():
    def sags(made):
        torque = made["torque"]
        made["torque"] = torque * (1.0 + 0.1 * np.abs(torque) / np.abs(torque).max())

    (first, *others) = of_table(sags).explain().findings
    assert first.kind == "saturation"
    assert first.severity == "doubt"
    assert not others
    # a torque that is told too large makes everything too large
    assert first.moves["motor.inertia"] != 0.0
    assert all(abs(x) > 1.0 for x in first.moves.values())


def test_a_late_torque_is_a_delay_with_its_key():
    def late(made):
        made["torque"] = np.interp(made["time"] - 0.003, made["time"], made["torque"])

    (first, *others) = of_table(late).explain().findings
    assert first.kind == "delay"
    assert first.setting == "mechanism.delay = true"
    assert not others
    # and a joint that has it lacks nothing
    assert not of_table(late, delay=True).explain().findings


@pytest.mark.parametrize("samples", [0.5, 2.0])
def test_a_late_target_is_named_and_put_in(samples):
    taken = Model(PROMPT, servo(100.0, 40.0, samples)).completed()
    model, (first, *others), left = taken
    assert (first.kind, first.setting) == ("target_delay", "mechanism.delay = true")
    assert not others
    assert not left.findings
    value = model.estimates(["input-error"])[0]["target.delay"]
    assert abs(value.value - samples / 100.0) < 4.0 * value.larger_sd


def test_a_prompt_target_lacks_nothing():
    explained = Model(PROMPT, servo(100.0, 40.0, 0.0)).explain()
    assert not explained.findings
    assert "target_delay" in explained.kinds
    assert "delay" not in (*explained.kinds, *explained.indistinguishable)


@pytest.mark.slow
def test_how_late_a_target_acts_is_unknown_by_default():
    """At a stiffness that makes it viscous friction: 400 N m/rad times 5 ms are 2 N m s."""
    stiff = Model(SERVO, servo(250.0, 400.0, 1.25), sampling=QUICK)
    assert stiff.chain.delay_name == "target.delay"
    row = stiff.fit(seed=1).summary.joint["motor.viscous"]
    right = abs(row.value - PENDULUM["motor.viscous"]) < 3.0 * row.reported.sd
    assert right or row.reported.status != "identified"


def test_the_same_seed_gives_the_same_answer(right):
    values = right.chain.vector(dict(right.estimates(["input-error"])[0].point))
    processing = right.config.tables.processing
    seen = right.chain, right.recordings, right.observations, processing, values

    def best(seed):
        (effect,) = regression_of(*seen, seed=seed, number=12)[0].effects(1)
        return effect.kind, effect.shape, effect.z

    assert best(5) == best(5) != best(6)


def test_a_joint_without_inertia_lacks_it():
    motor = bf.Element("motor", coulomb="symmetric", viscous=True, ratio=50.0)
    bare = Model(bf.Joint([motor], bf.Load(first_moment=True)), recording())
    assert bare.explain().findings[0].kind == "inertia"


def test_of_a_long_recording_an_excerpt_is_asked(monkeypatch):
    """What it lacks has the same name, and intervals have room for as much as by the whole."""
    made = table(40.0).copy()
    made["torque"] *= 1.0 + 0.05 * made["torque"].abs() / made["torque"].abs().max()
    whole = Model(axis(), recording(made), sampling=QUICK)
    before = whole.fit(seed=1)
    monkeypatch.setattr("bayesfric.diagnostics.explanation.LONGEST", len(made) - 1)
    after = whole.fit(seed=1)
    assert after.summary.regression["share"] == pytest.approx(0.5, abs=0.01)
    assert [one.kind for one in after.summary.findings] == ["saturation"]
    one, other = (run.fit.discrepancy for run in (before, after))
    # half of the samples show what is missing nearly as all do, and what it moves on their motion;
    # the mean over 40 reweightings, which friction's is, is uncertain by 1/sqrt(40) of its sd
    sds = np.sqrt(np.diag(one.covariance) + one.deviations.var(axis=0))
    close = np.where(before.fit.target.friction, 4.0 * np.sqrt(2.0 / 40.0), 0.3)
    apart = np.abs(other.mean - one.mean) / sds
    assert (apart < close + 0.3 * np.abs(one.mean / sds)).all()


def test_recordings_too_short_for_the_filters_are_not_asked(right, monkeypatch):
    """As of thousands of short recordings, of which each has its share."""
    assert Model(axis(), recording(table()[:400])).explain().reason == "few"
    monkeypatch.setattr("bayesfric.diagnostics.explanation.LONGEST", 200)
    assert right.explain().reason == "still"


@pytest.mark.parametrize("times", [1.0, 1.3])
def test_a_known_mass_tells_a_torque_that_is_off_by_a_factor(times):
    """SIMULATED. What passes it on with losses below zero is a factor of all torque."""
    full = bf.Joint.preset("servo-pendulum")
    recordings = []
    for seed, kg in enumerate((0.0, 0.3)):
        more = {"added_mass": kg, "radius": 0.1} if kg else {}
        made = bf.simulate(
            replace(full, gain=False), {}, rate=250, duration=8.0, excitation="multisine",
            torque_noise=0.01, amplitude=1.0, seed=seed + 1, **more,
        )  # fmt: skip
        made["torque"] *= times
        recordings.append(recording_of(made, name=f"{seed}", **more))
    explained = Model(replace(full, gain=False), recordings).explain().findings
    assert [one.kind for one in explained[:1]] == ["torque_constant"] * (times != 1.0)


@pytest.mark.parametrize("coupled", [False, True])
def test_another_joints_acceleration_is_named_where_it_takes_torque(coupled):
    """SIMULATED: a second joint swings beside; its column is tested, and another is not found."""
    made = table().copy()
    time = made["time"].to_numpy()
    for name, hertz in (("q2", (0.31, 0.53, 0.83, 1.09, 1.37)), ("q3", (0.23, 0.61, 0.97, 1.51))):
        made[name] = sum(np.sin(2.0 * np.pi * f * time + 9.0 * f) / f**2 for f in hertz)
    pull = np.gradient(np.gradient(made["q2"], time), time)
    size = 0.1 * made["torque"].std() / pull.std()
    made["torque"] += coupled * size * pull
    source = bf.Recording.from_dataframe(
        made, time="time", position="position", torque="torque", side="motor", others=("q2", "q3")
    )
    explained = Model(axis(), source).explain()
    assert "another_signal" in explained.kinds
    assert [(f.kind, f.shape) for f in explained.findings] == [("another_signal", "q2")] * coupled
