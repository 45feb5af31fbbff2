"""Least squares, eq. (11), starts and sizes: from their definitions, with a part of everything."""

from dataclasses import replace

import numpy as np
import pytest

from bayesfric.base.errors import BadInput
from bayesfric.estimates.least_squares import (
    TotalsProjection,
    least_squares,
    sizes_at,
    starting_values,
    total_label,
    totals_regressors,
    typical_sizes,
)
from bayesfric.estimates.torque import (
    filtered_torque,
    minimum_norm,
    places,
    torque_form,
    torque_jacobian,
)
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.recordings.filters import lay_windows, parallel_taps

KNEE, MOTOR = PRESETS["rabbit-knee"], PRESETS["motor-axis"]
PARTS = (
    Element("motor", inertia=True, coulomb="by-direction", viscous=True, quadratic=True),
    Element("belt", ratio=4.0, inertia=True, viscous="by-direction", coulomb="symmetric"),
    Element("joint", ratio=2.5, viscous=True, coulomb="by-direction", cogging=(3,)),
)
RICH = Joint(PARTS, Load(inertia=True, first_moment=True, gravity_angle=True), offset=True)
PER_RUN = Joint(PARTS, Load(inertia=True, first_moment=True), own_offsets=("one", "two"))
GAIN = Joint(PARTS[:1], Load(), gain=True)
CHAINS = {"rich": RICH, "own offsets": PER_RUN}


def values_of(chain, seed=3):
    rng = np.random.default_rng(seed)
    return dict(zip(chain.names, rng.uniform(0.1, 0.4, len(chain.names)), strict=True))


@pytest.fixture
def observed(make_observation):
    """Recordings of a joint, without noise unless requested."""

    def make(chain, values, *, names=("one", "two"), added_mass=0.0, **options):
        options = {"sigma": 0.0, "n": 700, "factor": 3, "amplitude": 2.0} | options
        options |= {"added_mass": added_mass, "radius": 0.5 if added_mass else 0.0}
        return [
            make_observation(chain, values, name=name, seed=k, **options)
            for k, name in enumerate(names)
        ]

    return make


@pytest.mark.parametrize("case", CHAINS)
def test_closed_form_totals_where_alpha_is_one(case, observed):
    """Of every owner through the ratios; an angle turns gravity into a sine and a cosine part."""
    chain = CHAINS[case]
    v = values_of(chain)
    totals = least_squares(chain, observed(chain, v))
    n1, n = 4.0, 10.0
    pairs = {
        "inertia": v["motor.inertia"] + v["belt.inertia"] + v["load.inertia"] / n**2,
        "viscous": v["motor.viscous"]
        + (v["belt.viscous_positive"] + v["belt.viscous_negative"]) / 2.0
        + v["joint.viscous"] / n1**2,
        "viscous_difference": (v["belt.viscous_positive"] - v["belt.viscous_negative"]) / 2.0,
        "coulomb": (v["motor.coulomb_positive"] + v["motor.coulomb_negative"]) / 2.0
        + v["belt.coulomb"]
        + (v["joint.coulomb_positive"] + v["joint.coulomb_negative"]) / (2.0 * n1),
    }
    lean = v.get("load.gravity_angle", 0.0)
    pull = 9.80665 * v["load.first_moment"] / n
    pairs["gravity"] = pull * np.cos(lean)
    if lean:
        pairs["gravity_cosine"] = pull * np.sin(lean)
    sided = (v["motor.coulomb_positive"] - v["motor.coulomb_negative"]) / 2.0
    sided += (v["joint.coulomb_positive"] - v["joint.coulomb_negative"]) / (2.0 * n1)
    for name, value in pairs.items():
        assert totals[f"total.{name}"].value == pytest.approx(value, rel=1e-9), name
    offsets = [name for name in v if name.startswith("offset")]
    for name in offsets:
        assert totals[f"total.{name}"].value == pytest.approx(v[name] + sided, rel=1e-9), name
    assert totals["motor.quadratic"].value == pytest.approx(v["motor.quadratic"], rel=1e-9)
    # a term with a column of its own goes by its parameter's name, so that is what it is
    for name in ("joint.cogging_sin_3", "joint.cogging_cos_3"):
        assert totals[name].value == pytest.approx(v[name], rel=1e-9)
    assert len(totals.values) == len(pairs) + len(offsets) + 3
    assert len({value.symbol for value in totals.values}) == len(totals.values)


@pytest.mark.parametrize("case", CHAINS)
@pytest.mark.parametrize("share", [0.2, 0.7])
def test_starts_make_the_totals_and_give_the_motor_its_share(case, share, observed):
    """Alone, each owner's torque is its part of every total: the others' are all alike."""
    chain = CHAINS[case]
    v = values_of(chain)
    observations = observed(chain, v)
    totals = least_squares(chain, observations)
    start = starting_values(chain, totals, 0.1, share)
    projection = TotalsProjection(chain, observations)

    def totals_of(owner):
        own = {k: x if k.startswith(owner) else 0.0 for k, x in start.items()}
        if "load.gravity_angle" in own:
            own["load.gravity_angle"] = start["load.gravity_angle"]
        torque = [filtered_torque(chain, o, chain.vector(own)[None])[0] for o in observations]
        return dict(zip(projection.names, projection.solve(np.concatenate(torque)), strict=True))

    parts = {owner: totals_of(owner) for owner in ("motor", "belt", "joint", "load")}
    owners = {
        "inertia": ("motor", "belt", "load"),
        "viscous": ("motor", "belt", "joint"),
        "coulomb": ("motor", "belt", "joint"),
        "gravity": ("load",),
        "quadratic": ("motor",),
        "joint.cogging_sin_3": ("joint",),
    }
    for kind, names in owners.items():
        total = totals[projection.labels[projection.names.index(kind)]].value
        rest = len(names) - 1
        expected = [share, *([(1.0 - share) / rest] * rest)] if rest else [1.0]
        shares = [parts[name][kind] / total for name in names]
        np.testing.assert_allclose(shares, expected, rtol=1e-9, err_msg=kind)


def test_a_total_that_goes_by_a_parameter_s_name_is_that_parameter(observed):
    """What a load loss or an unknown gain scales on the way to the motor is a total."""
    wave = "joint.cogging_sin_3"
    lossy = Joint((*PARTS[:1], replace(PARTS[1], load_loss="one"), PARTS[2]), Load(inertia=True))
    v = values_of(lossy) | {"belt.load": 0.0}
    totals = least_squares(lossy, observed(lossy, v))
    assert wave not in totals
    assert totals[f"total.{wave}"].value == pytest.approx(v[wave], rel=1e-9)
    sprung = replace(lossy, load=Load(inertia=True, spring=True), delay=True, gain=True)
    assert total_label(sprung, "load.spring") == "total.load.spring"
    assert total_label(sprung, "drive.delay") == "drive.delay"  # of the torque as it is measured
    assert total_label(replace(sprung, elements=PARTS, gain=False), "load.spring") == "load.spring"
    geared = Joint(PARTS, Load(inertia=True), gain=True)
    v = values_of(geared) | {"drive.gain": 0.5}
    totals = least_squares(geared, observed(geared, v, added_mass=1.0))
    assert wave not in totals
    assert totals[f"total.{wave}"].value == pytest.approx(v[wave] / 0.5, rel=1e-9)


def test_a_known_mass_is_a_regressor_of_its_own_where_no_total_has_it(observed):
    """One over the gain; the loads' own parameters take it for more of them."""
    v = values_of(GAIN) | {"drive.gain": 0.5}
    observations = observed(GAIN, v, added_mass=1.5)
    names, regressors = totals_regressors(GAIN, observations)
    o = observations[0]
    alone = 1.5 * 0.5**2 * o.qdd + 9.80665 * 1.5 * 0.5 * np.sin(o.q)
    at = names.index("added_load")
    np.testing.assert_allclose(regressors[: o.measured.size, at], o.filter.apply(alone))
    totals = least_squares(GAIN, observations)
    assert totals["total.added_load"].value == pytest.approx(2.0, rel=1e-9)
    assert starting_values(GAIN, totals, 0.1, 0.5)["drive.gain"] == pytest.approx(0.5)
    assert (
        "added_load"
        not in totals_regressors(RICH, observed(RICH, values_of(RICH), added_mass=1.0))[0]
    )
    light, heavy = (observed(RICH, values_of(RICH), added_mass=m)[:1] for m in (0.0, 1.0))
    assert "added_load" in totals_regressors(RICH, light + heavy)[0]


def test_totals_are_linear_and_go_by_other_names(observed):
    v = values_of(RICH)
    observations = observed(RICH, v, sigma=0.1)
    projection = TotalsProjection(RICH, observations)
    torque = np.concatenate([o.measured for o in observations])
    totals = projection.solve(torque)
    np.testing.assert_allclose(
        totals, np.linalg.lstsq(projection.regressors, torque, rcond=None)[0], rtol=1e-9
    )
    names = projection.aliases()
    assert names["total.quadratic"] == "motor.quadratic"
    assert names["belt.viscous_difference"] == "total.viscous_difference"
    assert set(names.values()) <= set(projection.labels)
    assert not set(names) & set(projection.labels)
    # the torque is linear in all but the angle: columns of the Jacobian times values make it
    flat = RICH.vector(v | {"load.gravity_angle": 0.0})
    jacobian = torque_jacobian(RICH, observations, flat, 1e-3 * np.abs(flat))
    assert not jacobian[:, RICH.names.index("load.gravity_angle")].any()
    flat_observations = observed(RICH, v | {"load.gravity_angle": 0.0})
    np.testing.assert_allclose(
        jacobian @ flat, np.concatenate([o.measured for o in flat_observations]), rtol=1e-7
    )


def test_sizes_are_those_where_outputs_are(observed):
    observations = observed(RICH, values_of(RICH), sigma=0.05)
    # a glitch that no output is at does not count
    o = observations[0]
    q = o.q.copy()
    q[np.setdiff1d(np.arange(q.size), o.filter.centres)[5]] = 1e6
    observations = [
        replace(o, q=q, position_step=0.01),
        replace(observations[1], position_step=2e-3),
    ]
    scales = typical_sizes(RICH, observations, {})
    joined = [
        np.concatenate([getattr(o, name)[o.filter.centres] for o in observations])
        for name in ("q", "qd", "qdd")
    ]
    torque = np.concatenate([o.measured for o in observations])
    assert scales.torque == pytest.approx(np.quantile(np.abs(torque), 0.999))
    speed, acceleration = (np.sqrt(np.mean(x**2)) for x in joined[1:])
    assert (scales.speed, scales.acceleration) == pytest.approx((speed, acceleration))
    assert scales.position < 1e2
    assert scales.duration == pytest.approx(699 / 500.0)
    assert scales.position_step == 2e-3
    cosine = np.sqrt(np.mean(np.cos(3.0 * 2.5 * joined[0]) ** 2))
    assert scales.columns["joint.cogging_cos_3"] == pytest.approx(cosine)
    # a term surely takes what its total and its column say, less two sds
    totals = least_squares(RICH, observations).values
    sizes = np.quantile(np.abs(totals_regressors(RICH, observations)[1]), 0.999, axis=0)
    least = [abs(x.value) - 2.0 * max(x.sd, x.sd_robust) for x in totals]
    assert scales.exchanged == pytest.approx(np.max(least * sizes))
    # the angle is measured from an unknown zero, or seen
    small = [replace(o, q=0.1 * o.q) for o in observed(PER_RUN, values_of(PER_RUN))]
    leans = [np.abs(np.sin(o.q[o.filter.centres])).max() for o in small]
    assert (scales.lean, typical_sizes(PER_RUN, small, {}).lean) == pytest.approx((1.0, max(leans)))
    # speeds go with the ratio, torque against it
    for owner, before, behind in (("motor", 1.0, 10.0), ("joint", 4.0, 2.5), ("load", 10.0, 1.0)):
        sizes = sizes_at(RICH, owner, scales)
        assert sizes.torque == pytest.approx(scales.torque * before)
        assert sizes.speed == pytest.approx(scales.speed * behind)
        assert sizes.acceleration == pytest.approx(scales.acceleration * behind)


def test_places_are_even_in_time_and_apart_between_segments_and_recordings(observed):
    n = 600
    windows = lay_windows(
        parallel_taps(4, None, 500.0), ((0, 300), (301, 600)), 4, np.arange(n) % 97 > 9
    )
    o = observed(RICH, values_of(RICH), names=("one",))[0]
    number = (windows.starts > 300).astype(np.int64)
    halved = replace(o, filter=windows, segment_of=number)
    at = places([halved, o])
    first, second = np.split(at, [windows.starts.size])
    for part in (0, 1):
        rows = number == part
        assert np.array_equal(np.diff(first[rows]), np.diff(windows.starts[rows]) // 4)
    assert np.array_equal(np.diff(second), np.ones(second.size - 1))
    # by a tenth of the recording and more
    tenth = np.ptp(windows.starts) / 4 / 10
    assert np.diff(first)[np.flatnonzero(np.diff(number))[0]] > tenth
    assert second[0] - first[-1] > tenth
    assert first[0] == 0


def test_columns_that_others_can_stand_for_are_those_of_a_null_direction():
    rng = np.random.default_rng(5)
    x, target = rng.standard_normal((60, 5)) * [1.0, 1e-3, 5.0, 1.0, 40.0], rng.standard_normal(60)
    x[:, 3] = x[:, 0] - 700.0 * x[:, 1]
    size, shared, solution, basis = minimum_norm(x)
    np.testing.assert_array_equal(shared, [True, True, False, True, False])
    np.testing.assert_allclose(size * (solution @ target), np.linalg.pinv(x / size) @ target)
    np.testing.assert_allclose(basis @ basis.T, x @ np.linalg.pinv(x), atol=1e-12)


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e3])
def test_where_no_column_is_the_load_s_alone_the_scale_leaves_all_losses_positive(scale):
    parts = {"inertia": True, "coulomb": "symmetric", "viscous": True}
    gearbox = Element("gearbox", load_loss="two")
    chain = Joint((Element("motor", **parts), gearbox, Element("joint", **parts)), Load())
    values = values_of(chain) | {"gearbox.load_drive": 0.9, "gearbox.load_back": 0.5}
    own = [name for name in chain.names if ".load_" not in name]
    values |= {n: scale * (0.1 if n.startswith("motor") else 1.0) for n in own}
    form = torque_form(chain)
    thetas = form.thetas(chain.vector(values))
    restored = dict(zip(chain.names, form.parameters(*thetas).tolist(), strict=True))
    assert all(restored[name] > 0.0 for name in own)
    for theta, again in zip(thetas, form.thetas(chain.vector(restored)), strict=True):
        np.testing.assert_allclose(again, theta, rtol=1e-12)


def test_what_one_direction_of_motion_cannot_tell_is_left_open(make_observation):
    """Moving one way only, constant loss and offset are one number; the rest is known."""
    chain = MOTOR.chain()
    o = make_observation(chain, MOTOR.values, sigma=0.0)
    speed = np.abs(o.qd) + 0.1
    torque = 0.01 * o.qdd + 0.05 * speed + 0.2 + 0.02
    one_way = type(o)(**{**vars(o), "qd": speed, "measured": o.filter.apply(torque)})
    totals = least_squares(chain, [one_way])
    assert totals["motor.inertia"].value == pytest.approx(0.01, rel=1e-6)
    assert totals["motor.viscous"].value == pytest.approx(0.05, rel=1e-6)
    assert np.isfinite(totals["motor.inertia"].sd)
    assert np.isinf(totals["motor.coulomb"].sd)
    assert np.isinf(totals["offset"].sd)


def test_fewer_outputs_than_totals_are_refused(make_observation):
    o = make_observation(MOTOR.chain(), MOTOR.values)
    few = type(o)(**{**vars(o), "measured": o.measured[:3]})
    with pytest.raises(BadInput, match="cannot determine"):
        least_squares(MOTOR.chain(), [few])


def test_a_total_without_a_part_of_the_motor_is_shared_by_the_others(make_observation):
    parts = Element("gearbox", viscous=True, ratio=2.0), Element("joint", viscous=True)
    chain = Joint((Element("motor", inertia=True), *parts), Load(inertia=True))
    true = {"motor.inertia": 0.01, "gearbox.viscous": 0.2, "joint.viscous": 0.3}
    o = make_observation(chain, true | {"load.inertia": 0.02}, sigma=0.0)
    start = starting_values(chain, least_squares(chain, [o]), 0.0, 0.5)
    # both at the input of the gearbox, whose ratio a friction of the joint passes twice
    assert start["gearbox.viscous"] + start["joint.viscous"] / 4.0 == pytest.approx(0.2 + 0.3 / 4.0)
