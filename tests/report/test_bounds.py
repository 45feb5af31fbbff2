"""A posterior that a bound holds: told with the mend, and the mend mends it."""

import numpy as np
import pytest

from bayesfric.inference.fitting import fit, make_target, read_priors
from bayesfric.inference.priors import bound_of
from bayesfric.inference.sampling import Sampling
from bayesfric.mechanism.joint import PRESETS
from bayesfric.report.result_row import result_rows
from bayesfric.report.summary.derived_quantities import loss_leaning
from bayesfric.report.summary.doubts import bound_hint, bound_warning, noise_cut
from bayesfric.report.summary.record import PosteriorRow
from bayesfric.report.summary.summary import summarise
from bayesfric.report.terminal import brief

from .made_summaries import failed, posterior_row

AXIS = PRESETS["motor-axis"]
VISCOUS = AXIS.values["motor.viscous"]


@pytest.fixture(scope="module")
def summaries(make_observation):
    """Return the same axis with a range that ends below the truth, and with one that does not."""
    joint = AXIS.chain()
    values = AXIS.values | {"motor.coulomb": 0.0}
    # of this noise the least-squares value of the loss that is not there is about zero
    observation = make_observation(joint, values, sigma=0.05, n=2000, seed=5)

    def summary(upper):
        ranges = {"motor.viscous": [0.0, upper], "motor.coulomb": [0.0, 20.0]}
        priors = read_priors(joint, ranges, [observation])
        target = make_target(joint, [observation], priors, "shared")
        sampled = fit(target, Sampling(seed=2, min_ess=400, walkers=24, ensembles=2))
        return summarise(sampled).as_dict()

    return {"narrow": summary(0.7 * VISCOUS), "wide": summary(10.0 * VISCOUS)}


def test_a_bound_that_was_set_is_warned_of_and_widening_it_helps(summaries):
    narrow, wide = summaries["narrow"], summaries["wide"]
    row = narrow["parameters"]["motor.viscous"]
    assert row["at_bound"] == "upper"
    assert row["bound"] == pytest.approx(0.7 * VISCOUS)
    assert row["bound_physical"] is False
    (warning,) = [text for text in narrow["warnings"] if text.startswith("motor.viscous")]
    assert "widen priors.motor.v" in warning
    wider = wide["parameters"]["motor.viscous"]
    assert wider["at_bound"] is None
    # the constant loss that is not there pulls at it from its own bound
    assert abs(wider["mean"] - VISCOUS) < 4.0 * wider["sd"]
    assert row["interval"][1] < VISCOUS
    assert not any("end of its range" in text for text in wide["warnings"])


def test_a_physical_bound_is_explained_and_not_warned_of(summaries):
    for summary in summaries.values():
        row = summary["parameters"]["motor.coulomb"]
        if summary is summaries["wide"]:
            assert (row["at_bound"], row["bound"], row["bound_physical"]) == ("lower", 0.0, True)
            hint = result_rows(summary)["motor.coulomb"].hint
            assert "cannot distinguish it from 0 N m" in hint
        assert not any(text.startswith("motor.coulomb") for text in summary["warnings"])


HELD = {"at_bound": "upper", "bound": 0.05, "data_sd": 0.01, "prior_sd": 1.0}


def test_what_a_loss_alone_makes_is_a_limit_where_the_loss_is():
    """Measured, AK80-6: mu at most 0.056, and an efficiency of 0.927 to 0.977 was "to cite"."""
    rng = np.random.default_rng(1)
    for at_zero, mu in ((True, rng.exponential(0.02, 4000)), (False, rng.normal(0.2, 0.02, 4000))):
        sides = {"alpha_drive": (1 / (1 + mu), "upper"), "alpha_back": (1 / (1 - mu), "lower")}
        sides["efficiency_drive"] = sides["alpha_drive"]
        for name, (draws, side) in sides.items():
            leaning = loss_leaning(f"gearbox.{name}", draws)
            assert leaning["at_bound"] == (side if at_zero else None)
            # and where its loss itself leans
            assert (bound_of(mu, 0.0, np.inf) is not None) == at_zero
    assert loss_leaning("gearbox.lambda_ratio", mu) == {}


OPEN = HELD | {"bound": 1.0, "data_sd": None, "prior_sd": 0.29}


@pytest.mark.parametrize(
    ("name", "verdict", "changed", "hint"),
    [
        # a flat prior that the data say nothing to leans on both of its ends
        ("motor.coulomb", "prior", OPEN, False),
        ("motor.coulomb", "prior", {}, True),
        # a number of the residuals' autocorrelation needs no wider prior
        *(("noise.pacf_2", "data", {"bound": x, "bound_physical": x == 1.0}, False)
          for x in (0.95, 1.0)),
        ("noise.sigma", "data", {}, True),
        ("motor.pacf_1", "data", {}, True),
    ],
)  # fmt: skip
def test_a_bound_that_holds_a_number_has_a_hint(name, verdict, changed, hint):
    held = HELD | {"bound_physical": False} | changed
    row = PosteriorRow.model_validate(posterior_row("N m", 0.04, 0.01, verdict=verdict, **held))
    assert bool(bound_hint(name, row)) == hint
    # of all numbers it is a doubt
    assert bool(bound_warning(name, row)) == (hint and name != "noise.sigma")


@pytest.mark.parametrize(
    ("changed", "doubted"),
    [({}, True), ({"at_bound": "lower"}, False), ({"bound_physical": True}, False)],
)
def test_noise_that_a_prior_keeps_small_makes_every_number_doubtful(changed, doubted):
    held = HELD | {"bound_physical": False} | changed
    row = PosteriorRow.model_validate(posterior_row("N m", 0.04, 0.01, verdict="data", **held))
    assert noise_cut("noise.sigma", row) is doubted
    # as a doubt or as a warning
    assert bool(bound_warning("noise.sigma", row)) == (changed == {"at_bound": "lower"})
    # one of the joint is its own affair
    assert not noise_cut("motor.coulomb", row)


@pytest.mark.parametrize(
    ("status", "sound"), [("tentative", ["motor.inertia"]), ("unusable", ["motor.inertia"]),
                          ("unusable", [])]
)  # fmt: skip
def test_of_a_run_that_did_not_converge_what_is_sound_is_shown(summaries, status, sound):
    summary = failed(summaries["wide"], *sound)
    problem = "the ensembles disagree on motor.viscous: raise sampling.max_steps"
    summary["sampler"] |= {"status": status, "problems": [problem]}
    names = {*summary["parameters"], *summary["derived"]}
    lost = set(brief(summary)["lost"])
    assert {"motor.viscous", "motor.coulomb"} <= lost <= names - set(sound)
    for name, cell in result_rows(summary).items():
        assert (cell.interval is not None) == (name in sound)
