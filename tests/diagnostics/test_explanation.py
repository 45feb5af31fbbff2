"""What else explains the torque: found under its name, and nothing where the model is right."""

from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.fit.model import Model
from tests.axis import recording_of
from tests.diagnostics.bench import QUICK, axis, model, recording, table
from tests.estimates.test_processing import PENDULUM, SERVO, servo

# whose target is said to act at once
PROMPT = replace(SERVO, delay=False)


@pytest.fixture(scope="module")
def right():
    return model()


def sagging(columns):
    torque = columns["torque"]
    return torque * (1.0 + 0.1 * np.abs(torque) / np.abs(torque).max())


def late(columns):
    return np.interp(columns["time"] - 0.003, columns["time"], columns["torque"])


def with_torque(change, **options):
    columns = table().copy()
    columns["torque"] = change(columns)
    return Model(axis(**options), recording(columns))


def test_a_right_model_lacks_nothing(right):
    explained = right.explain()
    assert explained.reason is None
    assert len(explained.replicates) >= 20
    assert not explained.findings
    # nor does one with the delay that a late torque needs
    assert not with_torque(late, delay=True).explain().findings


@pytest.mark.parametrize(
    ("change", "kind", "setting"),
    [(sagging, "saturation", ""), (late, "delay", "mechanism.delay = true")],
)
def test_a_missing_effect_is_named_and_nothing_else(change, kind, setting):
    (finding,) = with_torque(change).explain().findings
    assert (finding.kind, finding.setting) == (kind, setting)
    if change is sagging:  # too large a torque makes everything too large
        assert finding.severity == "doubt"
        assert finding.moves["motor.inertia"] != 0.0
        assert all(abs(x) > 1.0 for x in finding.moves.values())


@pytest.mark.parametrize("samples", [0.5, 2.0])
def test_a_late_target_is_named_and_put_in(samples):
    model, (finding,), remaining = Model(PROMPT, servo(100.0, 40.0, samples)).completed()
    assert (finding.kind, finding.setting) == ("target_delay", "mechanism.delay = true")
    assert not remaining.findings
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


def test_a_joint_without_inertia_lacks_it():
    motor = bf.Element("motor", coulomb="symmetric", viscous=True, ratio=50.0)
    bare = Model(bf.Joint([motor], bf.Load(first_moment=True)), recording())
    assert bare.explain().findings[0].kind == "inertia"


def test_of_a_long_recording_a_subsample_is_tested(monkeypatch):
    """What it lacks has the same name, and intervals have room for as much as by the whole."""
    columns = table(40.0).copy()
    columns["torque"] *= 1.0 + 0.05 * columns["torque"].abs() / columns["torque"].abs().max()
    model = Model(axis(), recording(columns), sampling=QUICK)
    before = model.fit(seed=1)
    monkeypatch.setattr("bayesfric.diagnostics.explanation.LONGEST", len(columns) - 1)
    after = model.fit(seed=1)
    assert after.summary.regression.share == pytest.approx(0.5, abs=0.01)
    assert [f.kind for f in after.summary.findings] == ["saturation"]
    full, subsampled = (run.fit.discrepancy for run in (before, after))
    # half of the samples show what is missing nearly as all do, and what it moves on their motion;
    # the mean over 40 reweightings, which friction's is, is uncertain by 1/sqrt(40) of its sd
    sds = np.sqrt(np.diag(full.covariance) + full.deviations.var(axis=0))
    tolerance = np.where(before.fit.target.friction, 4.0 * np.sqrt(2.0 / 40.0), 0.3)
    apart = np.abs(subsampled.mean - full.mean) / sds
    assert (apart < tolerance + 0.3 * np.abs(full.mean / sds)).all()


def test_recordings_too_short_for_the_filters_are_not_tested(right, monkeypatch):
    """As of thousands of short recordings, of which each has its share."""
    assert Model(axis(), recording(table()[:400])).explain().reason == "few"
    monkeypatch.setattr("bayesfric.diagnostics.explanation.LONGEST", 200)
    assert right.explain().reason == "still"


@pytest.mark.parametrize("times", [1.0, 1.3])
def test_a_known_mass_determines_a_factor_of_the_torque(times):
    """SIMULATED. Losses below zero stand for a factor of all torque."""
    joint = replace(bf.Joint.preset("servo-pendulum"), gain=False)
    recordings = []
    for seed, kg in enumerate((0.0, 0.3)):
        options = {"added_mass": kg, "radius": 0.1} if kg else {}
        columns = bf.simulate(
            joint, {}, rate=250, duration=8.0, excitation="multisine",
            torque_noise=0.01, amplitude=1.0, seed=seed + 1, **options,
        )  # fmt: skip
        columns["torque"] *= times
        recordings.append(recording_of(columns, name=f"{seed}", **options))
    explained = Model(joint, recordings).explain().findings
    assert [f.kind for f in explained[:1]] == ["torque_constant"] * (times != 1.0)


@pytest.mark.parametrize("coupled", [False, True])
def test_another_joints_acceleration_is_named_where_it_needs_torque(coupled):
    """SIMULATED: a second joint swings beside; its column is tested, and another is not found."""
    columns = table().copy()
    time = columns["time"].to_numpy()
    for name, hertz in (("q2", (0.31, 0.53, 0.83, 1.09, 1.37)), ("q3", (0.23, 0.61, 0.97, 1.51))):
        columns[name] = sum(np.sin(2.0 * np.pi * f * time + 9.0 * f) / f**2 for f in hertz)
    pull = np.gradient(np.gradient(columns["q2"], time), time)
    size = 0.1 * columns["torque"].std() / pull.std()
    columns["torque"] += coupled * size * pull
    source = bf.Recording.from_dataframe(
        columns,
        time="time",
        position="position",
        torque="torque",
        side="motor",
        others=("q2", "q3"),
    )
    explained = Model(axis(), source).explain()
    assert "another_signal" in explained.kinds
    assert [(f.kind, f.shape) for f in explained.findings] == [("another_signal", "q2")] * coupled
