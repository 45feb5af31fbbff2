"""What recordings can tell, where theory says so: simulated knee, Table 3 of the paper."""

import json
from dataclasses import replace

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.estimates.torque import torque_jacobian
from bayesfric.identifiability.friction_curve import coverage_of
from bayesfric.identifiability.identification import identify, speed_term
from bayesfric.identifiability.local import estimate_point, local_information
from bayesfric.identifiability.next_recording import simulate_recording
from bayesfric.mechanism import experiment
from bayesfric.mechanism.forward import simulate
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import lay_windows, parallel_taps
from bayesfric.recordings.measurement import Inputs, Law
from tests.axis import swing
from tests.conftest import made_observation, made_recording
from tests.identifiability.bench import AXIS, CHAIN, KNEE, PERIOD, VALUES, problem

SCALED = (
    "gearbox.alpha_drive",
    "gearbox.alpha_back",
    "joint.viscous",
    "joint.coulomb_positive",
    "joint.coulomb_negative",
    "load.inertia",
    "load.first_moment",
)
HEAVY = bf.Load(first_moment=True)
N, PEAK = 4000, 0.8
TIME = PERIOD * np.arange(N)
SQUARE = experiment.square(TIME, PEAK, 1.0)
LAGGED = experiment.current_loop(SQUARE, PERIOD, 0.005)
SINE = experiment.sine(TIME, PEAK, 1.0)


def recorded(torque, *, added_mass=0.0, radius=0.0, name="made-up"):
    """Motion and torque as they are: filtering would blur what the square wave's edges are."""
    inputs = Inputs(added_mass, radius, name)
    motion = simulate(CHAIN, VALUES, torque, PERIOD, inputs=inputs)
    taken = lay_windows(
        parallel_taps(1, None, 1.0 / PERIOD), ((0, N),), 1, np.abs(motion.qd) > 0.01
    )
    moved = motion.q, motion.qd, motion.qdd
    return made_observation(name, motion.time, moved, torque, taken, PERIOD, inputs)


def look(*observations, texts=None):
    return identify(*problem(*observations, texts=texts))


@pytest.fixture(scope="module")
def lagged():
    return look(recorded(LAGGED))


@pytest.fixture(scope="module")
def sine():
    return look(recorded(SINE))


def test_lagged_square_torque_leaves_the_papers_scaling_and_nothing_else(lagged):
    (null,) = [row for row in lagged.directions if row.null]
    assert set(null.exponents) == set(SCALED)
    np.testing.assert_allclose(list(null.exponents.values()), 1.0, atol=1e-6)
    zero = np.array([label not in SCALED for label in lagged.local.labels])
    np.testing.assert_allclose(lagged.local.null_rows[0][zero], 0.0, atol=1e-6)
    assert lagged.directions[0] is null


def test_an_ideal_square_wave_leaves_three(lagged):
    """Torque of one size: the equation of motion is itself a relation between the columns.

    With tau = M' + s Cm + (L' + s Cc) u_i/N = +-A and u_i = 1/alpha_i, where M' and L' are
    the inertial, viscous and gravity torques: M' times 1 + a, u_i times 1 + a, and
    ``dCm + dCc u_i/N = a (Cm -+ A)`` change nothing, - where the motor drives.
    """
    result = look(recorded(SQUARE))
    null = [row for row in result.directions if row.null]
    assert len(null) == 3
    assert set(null[0].exponents) == set(SCALED)
    # what rounding makes of an exact zero is far below what any recording leaves
    values, known = (row.local.directions.singular_values for row in (result, lagged))
    share = values / values[0]
    assert share[-3:].max() < 1e-9
    assert share[-4] > 1e-4
    assert (known[:-1] > 1e-4 * known[0]).all()

    u, ratio = 1.0 / np.array([0.7432, 1.408]), 50.0
    of = dict(zip(CHAIN.names, VALUES, strict=True))
    change = {"motor.inertia": 1.0, "motor.viscous": 1.0}
    change |= {"gearbox.alpha_drive": -1.0, "gearbox.alpha_back": -1.0}
    for side in ("positive", "negative"):
        constant = of[f"motor.coulomb_{side}"]
        matrix = np.array([[1.0, u[0] / ratio], [1.0, u[1] / ratio]])
        motor, joint = np.linalg.solve(matrix, [constant - PEAK, constant + PEAK])
        change[f"motor.coulomb_{side}"] = motor / constant
        change[f"joint.coulomb_{side}"] = joint / of[f"joint.coulomb_{side}"]
    row = np.array([change.get(label, 0.0) for label in result.local.labels])
    null_space = np.linalg.qr(result.local.null_rows.T)[0]
    np.testing.assert_allclose(null_space @ (null_space.T @ row), row, atol=1e-6 * abs(row).max())
    assert all(any("multisine" in r["text"] for r in row.remedies) for row in null[1:])


def test_with_a_sine_the_load_never_drives(sine):
    assert sine.back_driving == {"gearbox": 0.0}
    alone = next(row for row in sine.directions if set(row.exponents) == {"gearbox.alpha_back"})
    assert alone.null
    assert any("load drives the motor" in r["text"] for r in alone.remedies)
    # five totals are all that a motor that always drives can tell
    assert sum(row.null for row in sine.directions) == len(CHAIN.names) - 5
    (row,) = [row for row in sine.parameters if row.name == "gearbox.load_back"]
    assert (row.data_sd, row.status) == (np.inf, "unidentified")
    assert row.expected_sd == pytest.approx(row.prior_sd, rel=1e-6)
    others = sine.frame.loc["load.inertia", "open_with"].split(", ")
    assert set(others) >= set(SCALED) - {"load.inertia"}
    record = json.loads(json.dumps(sine.as_json(), allow_nan=False))  # without an infinity
    assert record["parameters"]["gearbox.load_back"]["data_sd"] is None


def test_what_is_proposed_does_it(lagged):
    """A known mass, a known value: made in earnest, they leave no null direction."""
    null = lagged.directions[0]
    kinds = {r["kind"] for r in null.remedies}
    assert {"known value", "known mass"} <= kinds
    (fixed,) = [r for r in null.remedies if r["kind"] == "known value"]
    assert set(fixed["parameters"]) == {
        name.replace("alpha_", "load_") if "alpha" in name else name for name in SCALED
    }
    plain = recorded(LAGGED)
    for name in fixed["parameters"]:
        known = look(plain, texts={name: KNEE.values[name]})
        assert not any(row.null for row in known.directions)
    loaded = simulate_recording(CHAIN, VALUES, plain, plain.torque, Inputs(2.0, 0.35))
    both = look(plain, loaded)
    assert not any(row.null for row in both.directions)
    assert all(np.isfinite(row.data_sd) for row in both.parameters)


def test_what_a_prior_determines_is_no_remedy():
    prior = {"distribution": "norm", "loc": 0.206, "scale": 0.01}
    result = look(recorded(LAGGED), texts={"load.inertia": prior})
    (fixed,) = [r for r in result.directions[0].remedies if r["kind"] == "known value"]
    assert "load.inertia" not in fixed["parameters"]
    assert "load.first_moment" in fixed["parameters"]


def test_the_same_mass_everywhere_counts_as_load():
    """Load and mass scale together: (ml + m r) times k, and the mass itself tells nothing."""
    result = look(recorded(1.4 * LAGGED, added_mass=2.0, radius=0.35))
    null = result.directions[0]
    assert null.null
    moment, inertia = KNEE.values["load.first_moment"], KNEE.values["load.inertia"]
    expected = dict.fromkeys(SCALED, 1.0)
    expected |= {"load.first_moment": 1.0 + 2.0 * 0.35 / moment}
    expected |= {"load.inertia": 1.0 + 2.0 * 0.35**2 / inertia}
    whole = expected["load.first_moment"]
    assert null.exponents == pytest.approx({n: x / whole for n, x in expected.items()}, abs=1e-6)
    assert any("another known added mass" in r["text"] for r in null.remedies)


@pytest.mark.parametrize("viscous", [{}, {"viscous": "by-direction"}])
@pytest.mark.parametrize("load_loss", [{}, {"load_loss": "two"}])
def test_a_back_emf_has_the_shape_of_viscous_loss(viscous, load_loss):
    """An error of it, at the motor, is a sum of the columns of exactly these parameters."""
    law = Law(LAGGED, np.ones(N), back_emf=0.3)
    raw = replace(made_recording(TIME, 0.0 * TIME, LAGGED, PERIOD, name="made-up"), ratio=10.0)
    choices = {"inertia": True, "coulomb": "symmetric", "viscous": True, **viscous, **load_loss}
    joint = bf.Joint([bf.Element("motor", **choices), bf.Element("arm", viscous=True)], HEAVY)
    o = replace(recorded(LAGGED), name="made-up")
    values = dict.fromkeys(joint.names, 0.1)
    target, _ = problem(o, chain=joint, values=values)
    result = speed_term(target, [replace(raw, law=law)])
    assert result["nominal"] == pytest.approx(0.03)
    assert speed_term(target, [raw]) is None
    jacobian = torque_jacobian(joint, [o], joint.vector(values), np.full(len(joint.names), 1e-4))
    terms = jacobian[:, [joint.names.index(name) for name in result["same_as_back_emf"]]]
    speed = o.filter.apply(o.qd)
    np.testing.assert_allclose(terms @ np.linalg.lstsq(terms, speed)[0], speed, atol=1e-6)
    assert ("arm.viscous" in result["same_as_back_emf"]) == (not load_loss)


def test_sds_are_those_of_a_linear_model_with_normal_priors(make_observation):
    chain = AXIS.chain()
    o = make_observation(chain, AXIS.values, n=500)
    target, parameters = problem(o, chain=chain, values=AXIS.values)
    result = identify(target, parameters)
    x = np.stack([o.qdd, o.qd, np.sign(o.qd), np.ones_like(o.q)], axis=1)
    data = x.T @ x / 0.02**2
    prior = np.diag([1.0 / p.sd() ** 2 for p in target.priors[:4]])
    rows = result.parameters
    np.testing.assert_allclose(
        [row.data_sd for row in rows], np.sqrt(np.diag(np.linalg.inv(data))), rtol=1e-6
    )
    np.testing.assert_allclose(
        [row.expected_sd for row in rows], np.sqrt(np.diag(np.linalg.inv(data + prior))), rtol=1e-6
    )
    assert {row.status for row in rows} == {"identified"}
    assert result.directions == ()


def test_noise_of_the_estimate_is_its_residual():
    plain = recorded(LAGGED)
    rng = np.random.default_rng(0)
    noisy = replace(plain, measured=plain.measured + 0.02 * rng.standard_normal(plain.time.size))
    target, _ = problem(noisy)
    point = estimate_point(target, KNEE.values)
    rms = np.sqrt(np.mean((noisy.measured - plain.measured) ** 2))
    assert point[-1] == pytest.approx(rms, rel=1e-3)


def test_facts_of_a_recording():
    """Who drives whom is the sign of the power that passes the gearbox, eq. (6)."""
    o = recorded(LAGGED)
    of = KNEE.values
    leg = of["load.inertia"] * o.qdd + 9.80665 * of["load.first_moment"] * np.sin(o.q)
    bearing = of["joint.viscous"] * o.qd + np.where(
        o.qd > 0, of["joint.coulomb_positive"], -of["joint.coulomb_negative"]
    )
    at = o.filter.centres
    (facts,) = coverage_of(CHAIN, [o], VALUES)
    assert facts["load_drives"]["gearbox"] == np.mean(((leg + bearing) * o.qd)[at] < 0)
    assert facts["turn"] == np.ptp(o.q[at])


@pytest.mark.parametrize("sds", [0.5, 5.0])
def test_an_offset_that_the_data_determine_is_not_weak(make_observation, sds):
    """Known to a hundredth of the torque, it is well known, whether or not it differs from 0."""
    chain = AXIS.chain()
    observation = make_observation(chain, AXIS.values | {"offset": 0.0}, sigma=1.0, n=1000)
    target, values = problem(observation, chain=chain, values=AXIS.values, sigma=1.0)
    j = target.free.index("offset")
    values[j] = sds * local_information(target, values).data_sd[j]
    result = identify(target, values)
    (row,) = [row for row in result.parameters if row.name == "offset"]
    assert row.value / row.data_sd == pytest.approx(sds, rel=1e-6)
    assert row.status == "identified"
    assert not any("offset" in row.exponents for row in result.directions)


def test_a_limit_is_not_called_determined():
    """Without a load loss in the recording its alphas are at one: what fit calls the bounds'."""
    pendulum = bf.Joint.preset("servo-pendulum")
    values = {"gearbox.load": 0.0, "motor.coulomb": 0.1}
    made = bf.simulate(pendulum, values, rate=200, duration=10.0, excitation="multisine",
                             amplitude=1.0, torque_noise=0.05, seed=3)  # fmt: skip
    t, q, torque = (made[name].to_numpy() for name in ("time", "position", "torque"))
    # an efficiency above one is what fits: the loss is held at zero
    lifted = torque - 0.02 * np.abs(torque) * np.sign(np.gradient(q, t))
    result = bf.Model(pendulum, bf.Recording.from_arrays(t, q, lifted)).identification()
    (loss,) = (p for p in result.parameters if p.name == "gearbox.load")
    assert loss.on_bound == "lower"
    named = {row.name: row for row in result.combinations}
    assert named["gearbox.alpha_drive"].on_bound == "lower"
    determined = [row.name for row in result.determined]
    assert "total_drive.gravity_size" in determined
    assert not any("alpha" in name or "efficiency" in name for name in determined)


# Terms that repeat or pull back

SWUNG = {
    "motor.inertia": 0.05,
    "motor.coulomb": 0.2,
    "motor.viscous": 0.1,
    "load.first_moment": 0.3,
}


def identified(load, more, amplitude):
    """Look at an exact motion of a motor that swings a load without a gear."""
    joint = bf.Joint(
        [bf.Element("motor", inertia=True, coulomb="symmetric", viscous=True)],
        load=bf.Load(first_moment=True, **load),
    )
    time = np.arange(4000) * 0.002
    lines = ((0.4, 0.8), (1.1, 0.4), (2.7, 0.15))
    q, qd, qdd = swing(time, [(f, amplitude * a) for f, a in lines])
    torque = inverse_torque(joint, joint.vector(SWUNG | more), q, qd, qdd, time=time)
    torque += 0.01 * np.random.default_rng(1).standard_normal(time.size)
    return bf.Model(joint, bf.Recording.from_arrays(time, q, torque)).identification()


def test_a_ripple_once_a_turn_is_gravity():
    more = {"load.cogging_sin_1": 0.05, "load.cogging_cos_1": 0.02}
    result = identified({"cogging": (1,)}, more, 1.0)
    (row,) = result.directions
    assert row.kind == "null"
    assert set(row.exponents) == {"load.first_moment", "load.cogging_sin_1"}
    # the cosine gravity does not have
    assert np.isfinite(result.frame.loc["load.cogging_cos_1", "data_sd"])


@pytest.mark.parametrize(("amplitude", "identified_by_data"), [(0.15, False), (1.5, True)])
def test_a_spring_is_gravity_as_long_as_the_swing_is_small(amplitude, identified_by_data):
    result = identified({"spring": True}, {"load.spring": 0.2}, amplitude)
    sd = result.frame.loc["load.spring", "data_sd"]
    # of a small swing the sine is the angle but for its sixth of a cube
    assert (sd < 0.01) == identified_by_data
    assert [row.kind for row in result.directions] == ([] if identified_by_data else ["weak"])
