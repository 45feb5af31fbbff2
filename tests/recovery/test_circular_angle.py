"""The angle of gravity is a place on a circle: no turn of the zero of position changes a result."""

import numpy as np
import pytest

from bayesfric.commands.fit import fit
from bayesfric.fit.model import Model
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS
from bayesfric.problem.config import parse_config
from bayesfric.report.comparison.between_runs import between_runs
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.summary.record import Summary
from tests.axis import swing
from tests.commands.bench import recorded, without_figures

pytestmark = pytest.mark.usefixtures("nothing_explained")

SERVO = PRESETS["servo-pendulum"]
ANGLE = "load.gravity_angle"


def arm(folder, angle, prior="", mechanism=""):
    """Write a recording of one and the same swing, its zero of position elsewhere."""
    t = np.arange(1500) * 0.008
    q, qd, qdd = swing(t, ((0.3, 0.8), (0.9, 0.4), (2.1, 0.1)))
    chain = SERVO.chain()
    values = chain.vector(SERVO.values | {ANGLE: 0.0})
    torque = inverse_torque(chain, values, q, qd, qdd)
    torque += 0.05 * np.random.default_rng(3).standard_normal(t.size)
    rows = np.stack([t, q - angle, torque], axis=1)
    header = "time,position,torque"
    np.savetxt(folder / "arm.csv", rows, "%.9f", ",", header=header, comments="")
    text = f'[mechanism]\npreset = "servo-pendulum"\n{mechanism}\n{recorded("arm")}'
    text += "[sampling]\nmin_ess = 400\n[estimation]\nstarts = 2\n[priors]\n"
    return parse_config(text + (f'"{ANGLE}" = {prior}' if prior else ""), folder / "arm.toml")


def fitted(folder, angle):
    """Fit a recording, without figures."""
    with pytest.MonkeyPatch.context() as patch:
        without_figures(patch)
        return fit(arm(folder, angle), folder / "run")


def round_the_circle(x):
    return (x + np.pi) % (2 * np.pi) - np.pi


@pytest.fixture(scope="module")
def hanging(tmp_path_factory):
    return fitted(tmp_path_factory.mktemp("hanging"), 0.0)


@pytest.fixture(
    scope="module",
    params=[np.pi, *(pytest.param(angle, marks=pytest.mark.slow) for angle in (3.0, -3.1))],
)
def turned(request, hanging, tmp_path_factory):
    folder = tmp_path_factory.mktemp("turned")
    angle = request.param
    if angle == np.pi:  # a posterior half on either side of pi
        angle -= hanging["parameters"][ANGLE]["median"]
    return angle, fitted(folder, angle)


def test_an_upright_arm_has_an_uncut_posterior(turned):
    angle, summary = turned
    row = summary["parameters"][ANGLE]
    low, high = row["interval"]
    centre = row["median"]
    # the branch of the interval is free, and one side of the cut must hold all of it
    true = centre + round_the_circle(angle - centre)
    assert abs(true - centre) < 4.0 * row["sd"]
    assert high - low < 0.2
    assert -np.pi - row["sd"] < centre <= np.pi + row["sd"]
    assert row["at_bound"] is None
    assert not [text for text in summary["warnings"] if ANGLE in text]
    for estimate in summary["estimates"].values():
        rows = estimate["parameters"]
        assert all(row["at_bound"] is None for row in rows.values())
        if ANGLE in rows:
            assert abs(round_the_circle(rows[ANGLE]["value"] - angle)) < 0.05


def test_a_turned_zero_changes_nothing_but_the_angle(turned, hanging):
    angle, summary = turned
    for name, row in summary["parameters"].items():
        still = hanging["parameters"][name]
        # 600 independent draws tell a median to a twentieth of an sd
        shift = angle if name == ANGLE else 0.0
        apart = row["median"] - still["median"] - shift
        apart = round_the_circle(apart) if name == ANGLE else apart
        assert abs(apart) < 0.25 * still["sd"], name
        assert row["sd"] == pytest.approx(still["sd"], rel=0.2), name
        assert row["verdict"] == still["verdict"], name
    for method, estimate in summary["estimates"].items():
        for name, row in estimate["parameters"].items():
            apart = row["value"] - hanging["estimates"][method]["parameters"][name]["value"]
            if name == ANGLE:
                apart = round_the_circle(apart - angle)
            if not name.startswith("total.gravity"):  # sine and cosine of the angle
                assert abs(apart) <= 0.02 * (row["sd"] or 1e-9), (method, name)


@pytest.mark.parametrize(
    ("angle", "prior"),
    [
        (-2.9, "[0, 6.283]"),
        (-2.9, "[2.5, 4.0]"),
        (np.pi, '{ distribution = "norm", loc = 3.14, scale = 0.3 }'),
        (3.1, "[-9.0, -2.8]"),
    ],
)
def test_a_prior_may_lie_on_any_branch(tmp_path, angle, prior):
    model = Model.from_config(arm(tmp_path, angle, prior))
    for estimate in model.estimates():
        if estimate.point:
            assert abs(round_the_circle(dict(estimate.point)[ANGLE] - angle)) < 0.05
            assert estimate[ANGLE].at_bound is None
    configured = model.priors[ANGLE]
    assert configured.lower <= configured.turned(float(angle)) <= configured.upper
    point = dict(model.estimates(("input-error",))[0].point)
    target = model.target(point)
    used = target.priors[target.free.index(ANGLE)]
    # far from any cut where the prior leaves the branch open
    assert used.lower + 0.2 < used.turned(angle) < used.upper - 0.2


def test_a_part_of_the_circle_bounds_and_can_be_widened(tmp_path):
    summary = Model.from_config(arm(tmp_path, -3.0, "[2.0, 3.2]")).fit().summary.as_dict()
    row = summary["parameters"][ANGLE]
    assert row["at_bound"] == "upper"
    assert not row["bound_physical"]
    assert [text for text in summary["warnings"] if "widen priors.load.gravity_angle" in text]


def test_identify_draws_on_both_sides_of_pi(tmp_path):
    identification = Model.from_config(arm(tmp_path, np.pi)).identification()
    prospect = {p.name: p for p in identification.parameters}[ANGLE]
    assert prospect.on_bound is None
    assert abs(round_the_circle(prospect.value - np.pi)) < 0.05


def test_runs_on_either_side_of_pi_agree(hanging):
    """3.13 and -3.13 are 0.02 apart."""
    here, there = ({**hanging, "parameters": dict(hanging["parameters"])} for _ in range(2))
    for run, middle in ((here, 3.13), (there, -3.13)):
        interval = [middle - 0.03, middle + 0.03]
        row = {"mean": middle, "median": middle, "sd": 0.02, "interval": interval}
        run["parameters"][ANGLE] = hanging["parameters"][ANGLE] | row | {"verdict": "data"}
        del run["parameters"][ANGLE]["reported"]  # it follows from these numbers
    row = comparison({"here": here, "there": there})[ANGLE]
    cell = row.cells["there: posterior"]
    assert abs(cell.disagreement) < 1.0
    assert cell.interval[0] < cell.value < cell.interval[1]
    pooled = between_runs({k: Summary.read(v, k) for k, v in (("a", here), ("b", there))})
    assert {line["name"]: line for line in pooled}[ANGLE]["agree"]
