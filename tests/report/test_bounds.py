"""A posterior that a bound holds: told with the mend, and the mend mends it."""

import copy

import numpy as np
import pytest

from bayesfric.inference.fitting import fit, make_target, read_priors
from bayesfric.inference.priors import bound_of
from bayesfric.inference.sampling import Sampling
from bayesfric.mechanism.joint import PRESETS
from bayesfric.report.paper.tables import parameter_table
from bayesfric.report.result_row import result_rows
from bayesfric.report.summary.derived_quantities import loss_leaning
from bayesfric.report.summary.doubts import bound_hint, bound_warning, noise_cut
from bayesfric.report.summary.record import PosteriorRow, Summary
from bayesfric.report.summary.summary import summarise
from bayesfric.report.terminal import brief

from .made_summaries import failed, knee, posterior_row

AXIS = PRESETS["motor-axis"]
VISCOUS = AXIS.values["motor.viscous"]


@pytest.fixture(scope="module")
def summaries(make_observation):
    """Return the same axis with a range that ends below the truth, and with one that does not."""
    chain = AXIS.chain()
    values = AXIS.values | {"motor.coulomb": 0.0}
    # of this noise the least-squares value of the loss that is not there is about zero
    observation = make_observation(chain, values, sigma=0.05, n=2000, seed=5)

    def summary(upper):
        told = {"motor.viscous": [0.0, upper], "motor.coulomb": [0.0, 20.0]}
        priors = read_priors(chain, told, [observation])
        target = make_target(chain, [observation], priors, "shared")
        return summarise(
            fit(target, Sampling(seed=2, min_ess=400, walkers=24, ensembles=2))
        ).as_dict()

    return {"narrow": summary(0.7 * VISCOUS), "wide": summary(10.0 * VISCOUS)}


def test_a_bound_that_was_set_is_warned_of_and_widening_it_helps(summaries):
    narrow, wide = summaries["narrow"], summaries["wide"]
    row = narrow["parameters"]["motor.viscous"]
    assert row["at_bound"] == "upper"
    assert row["bound"] == pytest.approx(0.7 * VISCOUS)
    assert row["bound_physical"] is False
    (told,) = [text for text in narrow["warnings"] if text.startswith("motor.viscous")]
    assert "widen priors.motor.v" in told
    mended = wide["parameters"]["motor.viscous"]
    assert mended["at_bound"] is None
    # the constant loss that is not there pulls at it from its own bound
    assert abs(mended["mean"] - VISCOUS) < 4.0 * mended["sd"]
    assert row["interval"][1] < VISCOUS
    assert not any("end of its range" in text for text in wide["warnings"])


def test_a_physical_bound_is_explained_and_not_warned_of(summaries):
    for summary in summaries.values():
        row = summary["parameters"]["motor.coulomb"]
        if summary is summaries["wide"]:
            assert (row["at_bound"], row["bound"], row["bound_physical"]) == ("lower", 0.0, True)
            (printed,) = (r for r in parameter_table(summary).rows if r.name == "motor.coulomb")
            assert "cannot distinguish it from 0 N m" in printed.hint
        assert not any(text.startswith("motor.coulomb") for text in summary["warnings"])


HELD = {"at_bound": "upper", "bound": 0.05, "data_sd": 0.01, "prior_sd": 1.0}


def test_what_a_loss_alone_makes_is_a_limit_where_the_loss_is():
    """Measured, AK80-6: mu at most 0.056, and an efficiency of 0.927 to 0.977 was "to cite"."""
    rng = np.random.default_rng(1)
    for at_zero, mu in ((True, rng.exponential(0.02, 4000)), (False, rng.normal(0.2, 0.02, 4000))):
        sides = {"alpha_drive": (1 / (1 + mu), "upper"), "alpha_back": (1 / (1 - mu), "lower")}
        sides["efficiency_drive"] = sides["alpha_drive"]
        for name, (draws, side) in sides.items():
            told = loss_leaning(f"gearbox.{name}", draws)
            assert told["at_bound"] == (side if at_zero else None)
            # and where its loss itself leans
            assert (bound_of(mu, 0.0, np.inf) is not None) == at_zero
    assert loss_leaning("gearbox.lambda_ratio", mu) == {}


def test_what_the_prior_alone_makes_needs_no_other_bound():
    """A flat prior that the data say nothing to leans on both of its ends."""
    open_ = posterior_row("N m", 0.5, 0.29, verdict="prior", at_bound="upper", bound=1.0)
    open_ |= {"data_sd": None, "prior_sd": 0.29, "bound_physical": False}
    assert bound_hint("motor.coulomb", PosteriorRow.model_validate(open_)) == ""
    assert bound_warning("motor.coulomb", PosteriorRow.model_validate(open_)) == ""
    pushed = posterior_row("N m", 0.04, 0.01, verdict="prior", **HELD, bound_physical=False)
    assert "widen" in bound_hint("motor.coulomb", PosteriorRow.model_validate(pushed))


@pytest.mark.parametrize(("bound", "physical"), [(0.95, False), (1.0, True)])
@pytest.mark.parametrize("name", ["noise.pacf_1", "noise.pacf_2"])
def test_a_memory_at_its_bound_is_no_friction_at_zero_and_needs_no_wider_prior(
    name, bound, physical
):
    told = HELD | {"bound": bound, "bound_physical": physical}
    row = PosteriorRow.model_validate(posterior_row("", 0.94, 0.01, verdict="data", **told))
    assert bound_hint(name, row) == ""
    assert bound_warning(name, row) == ""
    # what the joint has keeps its own words, and so does another number of the noise
    assert bound_hint("noise.sigma", row)
    assert bound_hint("motor.pacf_1", row)


@pytest.mark.parametrize(
    ("changed", "doubted"),
    [({}, True), ({"at_bound": "lower"}, False), ({"bound_physical": True}, False)],
)
def test_noise_that_a_prior_keeps_small_makes_every_number_doubtful(changed, doubted):
    told = copy.deepcopy(knee())
    row = posterior_row("N m", 0.04, 0.01, verdict="data", **HELD, bound_physical=False)
    told["parameters"]["noise.sigma"] = row | changed
    summary = Summary.read(told)
    cut = noise_cut("noise.sigma", summary.parameters["noise.sigma"])
    assert cut is doubted
    # told once: as a doubt or as a warning
    warned = bound_warning("noise.sigma", summary.parameters["noise.sigma"])
    assert bool(warned) == (changed == {"at_bound": "lower"})
    # one of the joint is its own affair
    assert not noise_cut("motor.coulomb", summary.parameters["noise.sigma"])


@pytest.mark.parametrize(
    ("status", "sound"), [("tentative", ["motor.inertia"]), ("unusable", ["motor.inertia"]),
                          ("unusable", [])]
)  # fmt: skip
def test_of_a_run_that_did_not_converge_what_is_sound_is_shown(summaries, status, sound):
    summary = failed(summaries["wide"], *sound)
    problem = "the ensembles disagree on motor.viscous: raise sampling.max_steps"
    summary["sampler"] |= {"status": status, "problems": [problem]}
    names = {*summary["parameters"], *summary["derived"]}
    lost = set(brief(summary).lost)
    assert {"motor.viscous", "motor.coulomb"} <= lost <= names - set(sound)
    for row in parameter_table(summary).rows:
        assert row.converged == (row.name in sound)
    for name, cell in result_rows(summary).items():
        assert (cell.interval is not None) == (name in sound)
