"""A model sampled, and all that is asked of its posterior before anyone may read it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bayesfric.diagnostics.explanation import Explanation
from bayesfric.diagnostics.finding import Finding
from bayesfric.diagnostics.self_check import Checked, self_check
from bayesfric.errors import BadInput
from bayesfric.estimates.alike_losses import alike_losses
from bayesfric.estimates.methods import ESTIMATORS, estimate_by
from bayesfric.estimates.point_estimate import Estimate
from bayesfric.identifiability.identification import identify
from bayesfric.identifiability.known_quantities import speed_term
from bayesfric.identifiability.sentences import plain
from bayesfric.inference.discrepancy import discrepancy
from bayesfric.inference.fitting import Fit, fit
from bayesfric.inference.likelihood.noise_choice import Choice
from bayesfric.inference.predictive import predict_held_out
from bayesfric.inference.rests_beyond import rests_beyond
from bayesfric.inference.sampling.checkpoint import Checkpoint
from bayesfric.inference.sampling.sampling import Sampling
from bayesfric.inference.target import Target
from bayesfric.model import Model
from bayesfric.progress import Progress, Shown, by_method, silent
from bayesfric.report.summary.derived_quantities import groups
from bayesfric.report.summary.doubts import find_doubts, put_doubts
from bayesfric.report.summary.loss_limits import limits_of_losses
from bayesfric.report.summary.model_error import add_model_error
from bayesfric.report.summary.record import FindingRow, Identifiability, RegressionPart, Summary
from bayesfric.report.summary.reported import put_reported
from bayesfric.report.summary.residual import BackEmfPart, RestsPart
from bayesfric.report.summary.self_check import self_check_doubts, self_check_part
from bayesfric.report.summary.summary import summarise
from bayesfric.report.text_templates import sentence
from bayesfric.result import Result


@dataclass(frozen=True)
class Beginning:
    """What sampling starts from."""

    estimates: list[Estimate]  # least squares first
    missing: list[str]  # a sentence for each that was wanted and cannot be had
    choice: Choice | None  # how the order of the noise was chosen, where it was
    target: Target  # the log-posterior

    @property
    def searched(self) -> Estimate:
        """The first estimate that tells every parameter; there always is one."""
        return next(one for one in self.estimates if one.point)


def whole_fit(
    model: Model,
    sampling: Sampling,
    *,
    output_error: bool,
    progress: Shown,
    checkpoint: Callable[[str, Sampling], Checkpoint | None],
) -> Result:
    """Sample a model and sum it up; arguments as of :meth:`bayesfric.Model.fit`."""
    if model.config.tables.pooling.vary:
        raise BadInput(
            "pooling.vary",
            "is for 'bayesfric pool': a fit shares all parameters between recordings",
            "ask that, or leave the table out",
        )
    # before anything is estimated: a run of other settings is refused at once
    kept = checkpoint("posterior", sampling)
    taken: Sequence[Finding] = ()
    explained: Explanation | None = None
    if model.config.tables.mechanism.auto:
        model, taken, explained = model.completed(progress=progress)
    begun = begin(model, output_error=output_error, progress=progress)
    _refuse_alike_losses(model, begun)
    explained = explained or model.explain(begun.estimates, progress=progress)
    with model.config.named():
        found = fit(
            begun.target, sampling, estimates=begun.estimates, progress=progress, checkpoint=kept
        )
    if model.held_out:
        held_out = predict_held_out(found.target, found.posterior, model.held_out)
        found = replace(found, held_out=held_out)
    derived = groups(found)
    summary = summarise(found, model.references(), begun.choice, derived)
    room = discrepancy(found.target, found.posterior, explained.missing)
    found = replace(found, discrepancy=room)
    # room for what the model lacks, too, lets a loss reach zero
    summary = limits_of_losses(add_model_error(summary, found, derived))
    summary = _with_back_emf(summary, model, found)
    summary = _with_rests(summary, model, found)
    summary = _with_findings(summary, explained, taken)
    doubts = find_doubts(found, summary)
    if (checked := _self_check(model, found, progress)) is not None:
        part = self_check_part(found, summary, checked, derived)
        summary = summary.model_copy(update={"self_check": part})
        doubts += self_check_doubts(summary)
    summary = put_doubts(summary, doubts)
    progress(Progress("identifiability"))
    update: dict[str, Any] = {
        "warnings": [*summary.warnings, *begun.missing],
        # nothing in a file of samples tells; the configuration may
        "may_be_simulated": _may_be_simulated(model),
    }
    with suppress(BadInput):  # a simulation that fails there takes no result away
        here = identify(begun.target, found.posterior.median)
        update["identifiability"] = Identifiability.model_validate(
            summary.identifiability.as_dict() | {"directions": plain(here.directions)}
        )
    return Result(model, found, put_reported(summary.model_copy(update=update)))


def _refuse_alike_losses(model: Model, begun: Beginning) -> None:
    """Refuse load losses of several elements that these recordings do not tell apart."""
    known = [name for name, prior in model.priors.items() if not prior.default]
    if names := alike_losses(model.chain, begun.searched, known):
        first, *_, last = names
        raise BadInput(
            f"{model.config.path}: mechanism.elements.{last.partition('.')[0]}.load_loss",
            f"these recordings cannot tell {', '.join(names)} apart, load losses one behind the "
            "other",
            f'set load_loss = "none" in all elements but one, or give {first} a number or a '
            "narrow range under [priors]",
        )


def _may_be_simulated(model: Model) -> bool:
    """Whether something says how, or there is the truth; ``init`` writes an empty table."""
    told = model.config.tables.simulation
    files = [one.path for one in model.recordings if one.path is not None]
    there = any(path.with_suffix(".truth.json").is_file() for path in files)
    return there or (told is not None and any(told.model_dump(exclude_unset=True).values()))


def begin(model: Model, *, output_error: bool = False, progress: Shown = silent) -> Beginning:
    """Estimate, choose the noise, and make the log-posterior that is sampled.

    The output error simulates. It is asked for, or its likelihood needs a place to start
    from: then however long it takes, as sampling that goes on later must start from the
    same place. A mechanism that cannot be simulated still has a posterior of the torque.
    """
    tables, given = model.config.tables, model.evidence
    simulating = [one.name for one in ESTIMATORS.values() if one.simulates]
    plain = [name for name in ESTIMATORS if name not in simulating]
    made = {e.method: e for e in model.estimates(plain, progress=progress)}
    if tables.likelihood.method in simulating:
        given = replace(given, options=given.options.model_copy(update={"max_seconds": np.inf}))
    elif not (output_error or tables.estimation.output_error):
        simulating = []
    missing = []
    for name in simulating:
        try:
            with model.config.named():
                made |= estimate_by([name], given, made, progress=by_method(progress))
        except BadInput as error:
            missing.append(f"no {name} estimate: {error.what}")
    found = list(made.values())
    points = [dict(e.point) for e in found if e.point]
    choice = model.noise_choice(points[0])
    return Beginning(found, missing, choice, _first_target(model, points, choice))


def _first_target(
    model: Model, points: Sequence[Mapping[str, float]], choice: Choice | None
) -> Target:
    """Make the log-posterior; where it simulates, near the first point that can be simulated.

    The simulation is linearised there first, and anew at every mode this leads to.
    """
    for point in points[:-1]:
        with suppress(BadInput):
            return model.target(point, choice)
    return model.target(points[-1], choice)


def _with_findings(summary: Summary, found: Explanation, taken: Sequence[Finding]) -> Summary:
    """Put in what else explains the torque, and how that was asked."""
    asked: dict[str, Any] = {"twins": found.twins, "asked": len(found.kinds)}
    asked |= {"reason": found.reason} if found.reason else {}
    # what is marginalised is in the intervals, and no doubt
    room = found.missing.kinds if found.missing and summary.widened else {}
    findings = [
        replace(one, severity="note") if one.kind in room else one for one in found.findings
    ]
    update = {
        "findings": [FindingRow.model_validate(one.as_dict()) for one in findings],
        "taken": [FindingRow.model_validate(one.as_dict()) for one in taken],
        "regression": RegressionPart.model_validate(asked),
    }
    return summary.model_copy(update=update)


def _with_back_emf(summary: Summary, model: Model, found: Fit) -> Summary:
    """Put in what the nominal back-EMF's error cannot be told from, where a voltage drives."""
    term = speed_term(found.target, found.posterior.median, model.recordings)
    if term is None:
        return summary
    part = BackEmfPart.model_validate(plain({**vars(term), "among": len(model.recordings)}))
    changes = {
        name: {"meaning": sentence("with back-emf", {"meaning": summary.parameters[name].meaning})}
        for name in term.same_as_back_emf
    }
    fit = summary.fit.model_copy(update={"back_emf": part})
    return summary.with_rows(changes, fit=fit)


def _with_rests(summary: Summary, model: Model, found: Fit) -> Summary:
    """Put in rests that the law contradicts."""
    if summary.sampler.status == "unusable":
        return summary
    seen = rests_beyond(found, model.recordings, model.config.tables.processing)
    rests = [RestsPart.model_validate(vars(one)) for one in seen]
    return summary.model_copy(update={"fit": summary.fit.model_copy(update={"rests": rests})})


def _self_check(model: Model, found: Fit, progress: Shown) -> Checked | None:
    """Try the fit on simulated recordings like its own, unless none are wanted."""
    tables, seen = model.config.tables, (model.recordings, model.observations)
    number = tables.self_check.number(sum(r.time.size for r in model.recordings))
    if number == 0:
        return None
    progress(Progress("self-check"))
    return self_check(found.target, found.posterior, *seen, tables.processing, number)
