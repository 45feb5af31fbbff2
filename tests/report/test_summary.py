"""summary.json and summary.csv against the fixed schema, the draws, and what theory says."""

import csv
import io
import json
import math
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from bayesfric.inference.fitting import fit, make_target, read_priors
from bayesfric.inference.sampling import Sampling
from bayesfric.mechanism.configuration import MechanismOptions
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.report.paper.tables import summary_table
from bayesfric.report.summary import summary as summary_module
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.summary import summarise

KNEE, AXIS = PRESETS["rabbit-knee"], PRESETS["motor-axis"]
ROTARY_UNITS = {
    **dict.fromkeys(("motor.inertia", "load.inertia"), "kg m²"),
    **dict.fromkeys(("motor.viscous", "joint.viscous"), "N m s"),
    **{f"{e}.coulomb_{way}": "N m" for e in ("motor", "joint") for way in ("positive", "negative")},
    **dict.fromkeys(("gearbox.load_drive", "gearbox.load_back"), ""),
    "load.first_moment": "kg m",
    "noise.sigma": "N m",
}
# One recording of the knee cannot tell the common scale of the leg and of alpha: seven names.
LEG = {"load.inertia", "load.first_moment", *(n for n in ROTARY_UNITS if n.startswith("joint."))}
SCALED = LEG | {"gearbox.alpha_drive", "gearbox.alpha_back"}
# Published values of the linear EMPS axis, rounded, and a noise like its residual.
EMPS = {"motor.inertia": 95.1, "motor.viscous": 203.5, "motor.coulomb": 20.4, "offset": -3.17}


def fitted(chain, observations, texts=None):
    target = make_target(
        chain, observations, read_priors(chain, texts or {}, observations), "shared"
    )
    result = fit(target, Sampling(seed=1, min_ess=500))
    return result, summarise(result).as_dict()


@pytest.fixture(scope="module")
def knee_alone(make_observation):
    chain = KNEE.chain()
    return fitted(chain, [make_observation(chain, KNEE.values, amplitude=2.0)])


@pytest.fixture(scope="module")
def knee_loaded(make_observation):
    chain = KNEE.chain()
    mass = {"added_mass": 2.0, "radius": 0.35, "name": "loaded", "seed": 1}
    return fitted(
        chain,
        [
            make_observation(chain, KNEE.values, amplitude=2.0),
            make_observation(chain, KNEE.values, amplitude=2.0, **mass),
        ],
    )


@pytest.fixture(scope="module")
def emps(make_observation):
    chain = MechanismOptions(preset="motor-axis", motion="linear").joint()
    observation = make_observation(chain, EMPS, sigma=5.0, amplitude=0.1)
    return fitted(chain, [observation], {"motor.viscous": [0.0, 1000.0]})


@pytest.fixture(scope="module")
def lossless(make_observation):
    """No viscous loss; of the noise's seeds one that does not push it far up by chance."""
    chain = AXIS.chain()
    values = {**AXIS.values, "motor.viscous": 0.0}
    observation = make_observation(chain, values, seed=0)
    return fitted(chain, [observation], {"offset": 0.02})


CASES = ["knee_alone", "knee_loaded", "emps", "lossless"]


@pytest.fixture(params=CASES)
def case(request):
    return request.getfixturevalue(request.param)


def number(x):
    return isinstance(x, float) and math.isfinite(x)


def spread_is_whole(row):
    low, high = row["interval"]
    assert all(map(number, (row["mean"], row["sd"], row["median"], low, high)))
    assert low <= row["median"] <= high
    assert row["level"] == 0.9
    assert row["verdict"] in ("data", "prior", "weak")


def test_schema_of_the_design(case):
    _, summary = case
    keys = "bayesfric parameters derived estimates identifiability noise fit sampler"
    assert set(keys.split()) <= set(summary)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    for row in summary["parameters"].values():
        spread_is_whole(row)
        assert all(number(row[key]) for key in ("rhat", "ess", "prior_sd", "contraction"))
    for row in summary["derived"].values():
        spread_is_whole(row)
    rows = summary["estimates"]["least-squares"]["parameters"]
    assert all(number(row["value"]) and number(row["sd"]) for row in rows.values())
    assert number(summary["fit"]["residual_rms"])
    assert summary["fit"]["unit"] in ("N m", "N")
    sampler = summary["sampler"]
    assert (sampler["status"], sampler["problems"], sampler["seed"]) == ("reliable", [], 1)
    assert number(sampler["tau"])
    rows = summary["parameters"].values()
    assert sampler["min_ess"] == min(row["ess"] for row in rows) >= 500
    assert max(row["rhat"] for row in rows) <= 1.01
    assert sampler["draws"] == sampler["ensembles"] * sampler["walkers"] * sampler["steps"]


def test_intervals_are_quantiles_of_the_draws(case):
    result, summary = case
    assert list(summary["parameters"]) == list(result.posterior.names)
    for name, row in summary["parameters"].items():
        draws = result.posterior[name].ravel()
        np.testing.assert_allclose(row["interval"], np.quantile(draws, [0.05, 0.95]), rtol=1e-12)
        expected = [draws.mean(), draws.std(), np.median(draws)]
        np.testing.assert_allclose([row[k] for k in ("mean", "sd", "median")], expected, rtol=1e-9)
        # the share of variance that went
        went = 1 - row["sd"] ** 2 / row["prior_sd"] ** 2
        assert row["contraction"] == pytest.approx(went, abs=1e-12), name


def test_prior_sds_are_those_of_the_distributions(case):
    """Half-normal: scale times sqrt(1 - 2/pi); uniform: width over sqrt(12)."""
    _, summary = case
    seen = 0
    for name, row in summary["parameters"].items():
        scale = re.fullmatch(r"halfnorm\(scale=([^,)]+)\)", row["prior"])
        if scale and name != "gearbox.load_back":  # that one ends at 1, a passive gearbox
            expected = float(scale[1]) * math.sqrt(1 - 2 / math.pi)
            assert row["prior_sd"] == pytest.approx(expected, rel=1e-6), name
            assert row["prior_default"] is True
            seen += 1
    assert seen


def test_a_given_prior_and_a_known_value_are_told(emps, lossless):
    row = emps[1]["parameters"]["motor.viscous"]
    assert row["prior_default"] is False
    assert row["prior_sd"] == pytest.approx(1000 / math.sqrt(12), rel=1e-6)
    _, summary = lossless
    (offset,) = summary["fixed"].values()
    assert (offset["unit"], offset["value"]) == ("N m", 0.02)
    assert offset["symbol"]
    assert offset["meaning"]
    assert "offset" not in summary["parameters"]


def test_csv_holds_the_same_numbers(case):
    _, summary = case
    rows = list(csv.DictReader(io.StringIO(summary_table(summary))))
    together = {**summary["parameters"], **summary["derived"]}
    told = Summary.read(summary).rows
    assert [row["name"] for row in rows] == list(together)
    for row in rows:
        expected = together[row["name"]]
        one = told[row["name"]].reported
        assert [float(row["low"]), float(row["high"])] == one.interval
        assert (float(row["value"]), float(row["sd"])) == (one.value, one.sd)
        assert (row["unit"], row["status"]) == (expected["unit"], one.status)
        ends = [float(row[f"posterior_{end}"]) for end in ("low", "high")]
        assert ends == expected["interval"]
        for key in ("level", "rhat", "ess", "prior_sd", "contraction"):
            value = expected.get(key)
            assert row[key] == ("" if value is None else repr(value)), (row["name"], key)


def test_one_recording_of_the_knee_cannot_tell_the_scale(knee_alone):
    _, summary = knee_alone
    for name in LEG | {"gearbox.load_drive", "gearbox.load_back"}:
        assert summary["parameters"][name]["verdict"] != "data", name
    for name in ("gearbox.alpha_drive", "gearbox.alpha_back"):
        assert summary["derived"][name]["verdict"] != "data", name
    (direction,) = summary["identifiability"]["null_directions"]
    assert set(direction["parameters"]) == SCALED
    np.testing.assert_allclose(list(direction["parameters"].values()), 1.0, atol=1e-6)
    assert all(name in direction["meaning"] for name in SCALED)
    # what the motor feels is known all the same
    free = {name for name, row in summary["derived"].items() if row["gauge_free"]}
    totals = {"inertia", "viscous", "coulomb_positive", "coulomb_negative", "gravity"}
    assert {f"total_{side}.{key}" for side in ("drive", "back") for key in totals} <= free
    for name in free:
        assert summary["derived"][name]["verdict"] == "data", name
    # and leads
    order = [row["gauge_free"] for row in summary["derived"].values()]
    assert order == sorted(order, reverse=True)
    assert set(order) == {True, False}


def test_a_known_mass_tells_the_scale(knee_loaded):
    _, summary = knee_loaded
    assert summary["identifiability"]["null_directions"] == []
    for name, row in summary["parameters"].items():
        assert row["verdict"] != "prior", name
        if name in KNEE.values:
            assert abs(row["mean"] - KNEE.values[name]) < 4.5 * row["sd"], name


def test_an_axis_is_determined_by_its_data(emps):
    _, summary = emps
    assert summary["identifiability"]["null_directions"] == []
    for name, row in summary["parameters"].items():
        assert row["verdict"] == "data", name
        assert row["contraction"] > 0.9, name
        assert row["at_bound"] is None, name
    for name, value in EMPS.items():
        row = summary["parameters"][name]
        assert abs(row["mean"] - value) < 4.5 * row["sd"], name
    # its parameters are its totals already
    assert summary["derived"] == {}


def test_a_loss_that_is_zero_leans_on_its_bound(lossless):
    _, summary = lossless
    assert summary["parameters"]["motor.viscous"]["at_bound"] == "lower"
    for name in ("motor.inertia", "motor.coulomb", "noise.sigma"):
        assert summary["parameters"][name]["at_bound"] is None, name


def test_derived_quantities_follow_from_each_draw(knee_alone):
    """Eqs. (6), (11) and (13), written out anew."""
    result, summary = knee_alone
    p = {name: result.posterior[name].ravel() for name in result.posterior.names}
    n, g = 50.0, 9.80665
    passed = {"drive": 1 + p["gearbox.load_drive"], "back": 1 - p["gearbox.load_back"]}
    expected = {
        "gearbox.alpha_drive": 1 / passed["drive"],
        "gearbox.alpha_back": 1 / passed["back"],
        "gearbox.lambda_1": (passed["drive"] + passed["back"]) / 2,
        "gearbox.lambda_2": (passed["drive"] - passed["back"]) / 2,
    }
    for side, factor in passed.items():
        total = f"total_{side}"
        expected[f"{total}.inertia"] = p["motor.inertia"] + factor * p["load.inertia"] / n**2
        expected[f"{total}.viscous"] = p["motor.viscous"] + factor * p["joint.viscous"] / n**2
        for way in ("coulomb_positive", "coulomb_negative"):
            expected[f"{total}.{way}"] = p[f"motor.{way}"] + factor * p[f"joint.{way}"] / n
        expected[f"{total}.gravity"] = factor * p["load.first_moment"] * g / n
    for name, values in expected.items():
        row = summary["derived"][name]
        found = [row["mean"], row["sd"], row["median"], *row["interval"]]
        quantiles = np.quantile(values, [0.5, 0.05, 0.95])
        wanted = [values.mean(), values.std(), *quantiles]
        np.testing.assert_allclose(found, wanted, rtol=1e-7, err_msg=name)


def with_draws(made, **columns):
    """Replace draws of a made-up fit; a pair fills one half of each walker's steps each."""
    draws = made.posterior.draws.copy()
    half = draws.shape[2] // 2
    for name, (first, second) in columns.items():
        j = made.posterior.names.index(name.replace("__", "."))
        draws[:, :, :half, j] = first
        draws[:, :, half:, j] = second
    return replace(made, posterior=replace(made.posterior, draws=draws))


@pytest.mark.parametrize(("others", "undefined"), [(0.01, 0.5), (0.9998, 1.0)])
def test_a_gearbox_that_draws_call_irreversible(make_fit, others, undefined):
    """Eq. (4): 1 - mu_2 - Fr/Ts is negative where mu_2 is nearly one, and no number there."""
    constant = (5.0, 1e-9) if others == 0.01 else (5.0, 5.0)
    made = with_draws(
        make_fit(samples=600, ensembles=2),
        gearbox__load_back=(0.9999, others),
        joint__coulomb_positive=constant,
        joint__coulomb_negative=constant,
    )
    summary = summarise(made).as_dict()
    json.dumps(summary, allow_nan=False)
    summary_table(summary)
    row = summary["derived"].get("gearbox.efficiency_back")
    if undefined == 1.0:
        assert row is None or row["undefined_share"] == 1.0
        return
    assert row["undefined_share"] == undefined
    # what is left are the draws that do pass something back, all of them 0.99
    np.testing.assert_allclose([*row["interval"], row["median"]], 0.99, atol=1e-6)
    assert summary["derived"]["gearbox.efficiency_drive"]["undefined_share"] == 0.0


def test_what_has_converged_by_itself_is_told_where_the_whole_has_not(make_fit):
    """Ensembles apart in the first parameter: only what is made of it is lost."""
    fit = make_fit(samples=400)
    assert all(row["converged"] for row in summarise(fit).as_dict()["parameters"].values())
    posterior = fit.posterior
    d = posterior.diagnostics
    rhat = d.rhat.copy()
    rhat[0] = 1.3
    draws = posterior.draws.copy()
    draws[..., 0] *= np.linspace(1.0, 9.0, len(draws))[:, None, None]
    lost = replace(
        posterior,
        draws=draws,
        diagnostics=replace(d, status="unusable", rhat=rhat, ess=np.full(rhat.size, 900.0)),
    )
    summary = summarise(replace(fit, posterior=lost)).as_dict()
    first, *others = posterior.names
    assert not summary["parameters"][first]["converged"]
    assert all(summary["parameters"][name]["converged"] for name in others)
    sound = {name for name, row in summary["derived"].items() if row["converged"]}
    assert sound
    assert set(summary["derived"]) - sound


def test_totals_of_a_joint_with_load_losses_are_those_of_its_motion(knee, slide):
    derived = summarise(knee).derived
    of_motion = {name for name, row in derived.items() if row.of_motion}
    assert of_motion
    assert {name.partition(".")[0] for name in of_motion} == {"total"}
    assert {name for name in derived if name.startswith("total_")}
    assert not any(row.of_motion for row in summarise(slide).derived.values())


def test_a_total_that_is_nought_by_geometry_is_no_quantity(make_fit):
    """Gravity with its zero where it is taken to be has no cosine; one that is off has."""
    lever = Load(motion="rotary", inertia=False, first_moment=True, gravity_angle=True)
    own = Element("motor", inertia=True, coulomb="symmetric", viscous=True, subscript="m")
    fit = make_fit(Joint(elements=(own,), load=lever), samples=600)
    assert "total.gravity_cosine" in summarise(fit).derived
    draws = fit.posterior.draws.copy()
    draws[..., fit.posterior.names.index("load.gravity_angle")] = 0.0
    level = replace(fit, posterior=replace(fit.posterior, draws=draws))
    assert "total.gravity_cosine" not in summarise(level).derived


def test_one_loss_for_both_ways_says_which_was_seen(make_fit, monkeypatch):
    """Of a way of driving that hardly occurred, the other one says what it loses."""
    gearbox = Element("gearbox", load_loss="one", ratio=10.0)
    motor = Element("motor", inertia=True, coulomb="symmetric")
    lossy = make_fit(Joint(elements=(motor, gearbox), load=Load(inertia=True)), ensembles=2)
    sides = {side: f"gearbox.efficiency_{side}" for side in ("drive", "back")}
    plain = summarise(lossy).derived
    # a swing without gravity or friction behind the gear brakes as long as it speeds up
    assert {plain[name].mirrored for name in sides.values()} == {None}
    always = partial(summary_module._with_mirrored, seldom=1.0)
    monkeypatch.setattr(summary_module, "_with_mirrored", always)
    found = summarise(lossy)
    shares = [found.derived[name].mirrored for name in sides.values()]
    assert shares == pytest.approx([0.5, 0.5], abs=0.1)
    assert sum(shares) == pytest.approx(1.0)
    verdicts = [found.derived[name].verdict for name in sides.values()]
    assert "data" not in verdicts
    # two losses speak for themselves
    two = summarise(make_fit(samples=600, ensembles=2))
    assert not any(row.mirrored for row in two.derived.values())
