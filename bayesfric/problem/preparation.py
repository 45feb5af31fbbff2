"""Read and preprocess the recordings of a configuration, and read its priors."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from bayesfric.base.errors import BadInput, nearest
from bayesfric.estimates.least_squares import TotalsProjection
from bayesfric.estimates.point_estimate import Estimation, Knowledge
from bayesfric.estimates.processing import (
    BandFit,
    attenuations,
    estimate_delay,
    fine_motion,
    with_fine_motion,
)
from bayesfric.inference.fitting import read_priors
from bayesfric.inference.noise import CLOSED_LOOP_NOISE, MAX_ORDER, Autoregressive
from bayesfric.inference.position_likelihood import PositionLikelihood
from bayesfric.inference.priors import Prior, PriorText, as_knowledge
from bayesfric.mechanism.derived import derive
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.own_term import Term
from bayesfric.problem.config import Config, Tables
from bayesfric.recordings.held_out import Part, divide, fitted
from bayesfric.recordings.measurement import Measurement
from bayesfric.recordings.read import read_recordings
from bayesfric.recordings.signals import Signals, longest_delay, timed
from bayesfric.recordings.source import Recording


def prepare(
    config: Config, recordings: Sequence[Recording] | None = None, terms: Sequence[Term] = ()
) -> tuple[Joint, dict[str, Prior], list[Part], list[Signals]]:
    """Read and preprocess every recording of a configuration, or those given.

    ``terms`` are the functions of custom terms that its table ``mechanism`` names. Returns joint,
    priors, recordings, and the fitted ones with the motion of the encoder alone.
    """
    tables = config.tables
    with config.named():
        chain = tables.mechanism.joint(terms)
    if not tables.recordings:
        raise BadInput(str(config.path), "names no recording", "add a [[recordings]] table")
    if not chain.parameters:
        raise BadInput(
            f"{config.path}: mechanism", "has no parameter", "give an element inertia or friction"
        )
    measurements = _read_all(config, chain, recordings)
    chain = replace(
        chain,
        by_target=all(r.feedback is not None for r in measurements),
        own_inertia=all(r.inputs.inertia_of("load_torque") for r in measurements),
    )
    _check_method(config, chain)
    if chain.by_target and chain.delay is None:
        # drives react late to their target, which looks like viscous friction
        chain = replace(chain, delay=True)
    laws = [r.law for r in measurements if r.law is not None]
    if chain.closed_loop and any(law.held is None for law in laws):
        chain = replace(chain, smoothness=True)
    chain, ranges = _with_unknown_gains(config, chain, measurements)
    texts = {**ranges, **config.priors}
    with config.named():
        measurements, parts, doubted = _with_band(measurements, chain, tables)
        # the torque's rate scales a prior, for any delay
        _, observations = fitted(_with_delay(parts, 0.0) if chain.delay else parts)
    if tables.mechanism.offset == "per-recording":
        chain = replace(chain, own_offsets=tuple(o.name for o in observations))
    with config.named():
        _check_size(chain, observations)
        _check_priors(config, chain)
        priors = read_priors(chain, texts, observations, _noise_quantities(config, chain))
        if chain.delay:
            prior = priors[chain.delay_name]
            known = as_knowledge(chain, priors)
            recordings_fitted, encoder = fitted(parts)
            evidence = chain, recordings_fitted, observations, known, tables.estimation
            delay = prior.value if prior.fixed else estimate_delay(*evidence)
            if not prior.fixed and abs(delay) > min(
                longest_delay(o, r.period) for r, o in zip(recordings_fitted, encoder, strict=True)
            ):
                # trim the ends, where the torque is unknown, and a margin
                measurements = [
                    replace(r, late=delay + math.copysign(r.period, delay)) for r in measurements
                ]
                parts = divide(measurements, tables.processing, tables.validation)
                parts = _note_attenuation(parts, doubted)
            parts = _with_delay(parts, delay)
        _, encoder = fitted(parts)
        parts = _with_refined_motion(parts, chain, as_knowledge(chain, priors), tables.estimation)
    return chain, priors, parts, encoder


def _with_unknown_gains(
    config: Config, chain: Joint, recordings: Sequence[Measurement]
) -> tuple[Joint, dict[str, PriorText]]:
    """Make unknown gains of the drive parameters; all recordings have the same."""
    laws = [r.law for r in recordings if r.law is not None]
    if not (chain.by_target and any(law.unknown for law in laws)):
        return chain, {}
    unknown, where = laws[0].unknown, f"{config.path}: recordings"
    if not chain.closed_loop:
        problem = "have gains that are not known, and a load from further columns"
        raise BadInput(where, problem, "give the gains")
    if any(law.unknown != unknown or (unknown and law.kp != laws[0].kp) for law in laws):
        raise BadInput(where, "differ in gains that are not known", "fit one gain at a time")
    if unknown and chain.gain:
        problem = "is unknown, and so are the drive's gains: only products count"
        raise BadInput(f"{config.path}: mechanism.gain", problem, "leave gain out")
    ranges: dict[str, PriorText] = {f"drive.{name}": list(ends) for name, ends in unknown.items()}
    if unknown.get("kp") == (0.0, math.inf):
        # only a torque says how large a gain is: without one all are multiples of it
        known = any(r.inputs.known_load for r in recordings) or any(
            name.rpartition(".")[2] in ("inertia", "first_moment") and prior not in (0, 0.0)
            for name, prior in config.priors.items()
        )
        spread: PriorText = {"distribution": "loguniform", "a": 1e-3, "b": 1e3}
        ranges["drive.kp"] = spread if known else 1.0
    return replace(chain, kp=laws[0].kp if "kp" in unknown else None, kd="kd" in unknown), ranges


def _read_all(
    config: Config, chain: Joint, recordings: Sequence[Recording] | None
) -> list[Measurement]:
    """Read all recordings, with a warning for those that changed since a run."""
    measurements: list[Measurement] = []
    if recordings is None:
        recordings = [Recording(source, config.folder) for source in config.tables.recordings]
    for number, recording in enumerate(recordings, start=1):
        measurements += _read(config, chain, recording, number)
    fitted = config.origin.get("recordings", {})
    for k, r in enumerate(measurements):
        if r.name in fitted and fitted[r.name]["sha256"] != r.sha256:
            text = f"changed since the run was made: its SHA-256 was {fitted[r.name]['sha256']}"
            measurements[k] = replace(r, warnings=(*r.warnings, text))
    _check_recordings(config, chain, measurements)
    return measurements


def _with_band(
    recordings: list[Measurement], chain: Joint, tables: Tables
) -> tuple[list[Measurement], list[Part], Mapping[str, tuple[BandFit, BandFit]]]:
    """Filter to a band that preserves the inertia, or note that the requested one does not."""
    parts = divide(recordings, tables.processing, tables.validation)
    _check_signals(chain, fitted(parts)[1])
    _check_positions(chain, *fitted(parts))
    attenuated = attenuations(chain, *fitted(parts), tables.processing)
    if not attenuated:
        return recordings, parts, {}
    if not tables.processing.chooses_band:
        return recordings, _note_attenuation(parts, attenuated), attenuated
    narrower = {name: narrow.band for name, (_, narrow) in attenuated.items()}
    recordings = [replace(r, widest_band=narrower.get(r.name)) for r in recordings]
    return recordings, divide(recordings, tables.processing, tables.validation), {}


def _note_attenuation(
    parts: Sequence[Part],
    attenuated: Mapping[str, tuple[BandFit, BandFit]],
    *,
    larger: float = 1.05,
) -> list[Part]:
    """Note that a narrower band contradicts the requested one.

    If the inertia changes by less than a factor ``larger``, keep the user's bandwidth.
    """
    notes = {
        name: {
            "band_doubted": wide.band,
            "band_narrower": narrow.band,
            "inertia_narrower": narrow.inertia / wide.inertia,
        }
        for name, (wide, narrow) in attenuated.items()
        if narrow.inertia > larger * wide.inertia
    }

    def noted(o: Signals) -> Signals:
        return replace(o, settings={**o.settings, **notes.get(o.name, {})})

    return [p if p.held_out else replace(p, observation=noted(p.observation)) for p in parts]


def _with_delay(parts: Sequence[Part], delay: float) -> list[Part]:
    """Compare with the torque ``delay`` seconds earlier."""
    return [replace(p, observation=timed(p.observation, p.recording, delay)) for p in parts]


def _with_refined_motion(
    parts: list[Part], chain: Joint, knowledge: Knowledge, options: Estimation
) -> list[Part]:
    """Refine motions by the model fitted to what is not held out."""
    values, observations = with_fine_motion(chain, *fitted(parts), knowledge, options)
    if values is None:
        return parts
    refined = iter(observations)
    return [
        replace(
            p,
            observation=fine_motion(chain, values, p.recording, p.observation)
            if p.held_out
            else next(refined),
        )
        for p in parts
    ]


def _check_recordings(config: Config, chain: Joint, recordings: Sequence[Measurement]) -> None:
    """Refuse duplicate and reserved names."""
    where = f"{config.path}: recordings"
    for name, count in Counter(r.name for r in recordings).items():
        if count > 1:
            raise BadInput(where, f"{count} are called {name!r}", "give each its own name = ...")
        # posterior.nc names arrays after recordings and parameters
        if "/" in name or name in {*chain.names, "chain", "draw", "lp", "ensemble"}:
            problem = f"a recording cannot be called {name!r}"
            raise BadInput(where, problem, "give it another name with name = ...")


def _check_method(config: Config, chain: Joint) -> None:
    """Refuse a likelihood that these recordings do not have, and held-out data for positions."""
    tables, method = config.tables, config.tables.likelihood.method
    chosen = tables.likelihood.model_fields_set
    if (method == "closed-loop") != chain.closed_loop and (chosen or method == "closed-loop"):
        why = (
            "and no torque is recorded" if chain.closed_loop else "and not all is of targets alone"
        )
        where = f"{config.path}: likelihood.method"
        raise BadInput(where, f"is {method!r}, {why}", "leave it out")
    holds_out = tables.validation.recordings or tables.validation.hold_out is not None
    if holds_out and (chain.closed_loop or method == "output-error"):
        raise BadInput(
            f"{config.path}: validation",
            "is not offered for output-error or closed-loop, likelihoods of the position",
            "leave it out, or give a torque and the input-error likelihood",
        )


def _check_signals(chain: Joint, observations: Sequence[Signals]) -> None:
    """Refuse terms that depend on a missing signal."""
    rows = {c.row for c in chain.carried if c.row.column and c.row.signal}
    for row in rows:
        for o in observations:
            is_listed = row.option == "signals"
            if row.signal not in o.inputs.others if is_listed else not o.inputs.signal(row.signal):
                raise BadInput(
                    f"recording {o.name!r}",
                    f"has no {row.signal}, and the mechanism has terms that depend on it",
                    f'name its column: others = ["{row.signal}"]'
                    if is_listed
                    else f"name its column with {row.signal} = {{ column = ... }}",
                )


def _check_positions(
    chain: Joint, recordings: Sequence[Measurement], observations: Sequence[Signals]
) -> None:
    """Refuse torques that depend on the position, of which an integrated one lacks the origin."""
    undelayed = replace(chain, delay=False)
    names = ("the added mass", *undelayed.names)
    vectors = np.eye(len(names))[:, 1:]  # each parameter alone, after none
    for r, o in zip(recordings, observations, strict=True):
        if not r.integrated:
            continue
        motions = ((q, o.qd, o.qdd) for q in (o.q, o.q + 1.0))
        here, there = (
            inverse_torque(undelayed, vectors, *motion, inputs=o.inputs, time=o.stamps)
            for motion in motions
        )
        if (depends := np.any(here != there, axis=1)).any():
            raise BadInput(
                f"recording {o.name!r}",
                f"has no position, on which {names[int(np.argmax(depends))]} depends",
                "record it, or take this out of the mechanism",
            )


def _check_size(chain: Joint, observations: Sequence[Signals]) -> None:
    """Refuse fewer outputs than parameters."""
    outputs = sum(len(o.time) for o in observations)
    if outputs < len(chain.parameters):
        reasons = {
            "dropped_dead_zone": "where it stands or turns round (dead_zone)",
            "dropped_trim": "at ends (trim)",
            "dropped_excluded": "in or next to what is excluded",
        }
        lost = {
            why: sum(int(o.settings[key]) for o in observations) for key, why in reasons.items()
        }
        main_cause = max(lost, key=lost.__getitem__)
        problem = f"{outputs} outputs after filtering, {len(chain.parameters)} parameters"
        raise BadInput(
            ", ".join(f"recording {o.name!r}" for o in observations),
            problem
            + f"; {lost[main_cause]} more were left out {main_cause}" * bool(lost[main_cause]),
            "record longer, or decimate less",
        )


def _check_priors(config: Config, chain: Joint) -> None:
    """Refuse a table in place of a prior without a distribution."""
    for name in config.priors:
        parameter = name.rpartition(".")[0]
        if parameter in chain.names or parameter.startswith("noise."):
            raise BadInput(
                f"priors.{parameter}",
                "its table names no distribution",
                'write for example {distribution = "norm", loc = 0.4, scale = 0.05}',
            )


def _noise_quantities(config: Config, chain: Joint) -> tuple[str, ...]:
    """Noise scales that may have a prior."""
    tables = config.tables
    if chain.closed_loop:
        return CLOSED_LOOP_NOISE.quantities
    if tables.likelihood.method == "output-error":
        return PositionLikelihood.noise.quantities
    return Autoregressive(MAX_ORDER if tables.noise.model == "auto" else 0).quantities


def _read(config: Config, chain: Joint, recording: Recording, number: int) -> list[Measurement]:
    place, source = f"recordings.{number}", recording.source
    if source.added_mass and not source.radius and chain.load.motion == "rotary":
        raise BadInput(
            f"{config.path}: {place}.added_mass", "has no radius", 'add radius, such as "0.35 m"'
        )
    try:
        return read_recordings(
            recording,
            ratio=chain.ratio,
            motion=chain.load.motion,
            motor_motion=chain.motor_motion,
            processing=config.tables.processing,
            number=number,
        )
    except BadInput as error:
        # errors not about a file are about a key: of the recording, or of [processing]
        named = {"file": place, "name": place, "processing": ""}
        key = error.where.partition(" = ")[0].partition(",")[0]
        if key not in named:
            raise
        with config.named(named[key]):
            raise
    except OSError as error:
        raise BadInput(
            f"{config.path}: {place}.file",
            f"cannot be read ({error.strerror})",
            "check the file's name",
        ) from None


def references(
    config: Config, chain: Joint, observations: Sequence[Signals]
) -> dict[str, dict[str, Any]]:
    """Return values to compare with, by name; refuse names that no result has."""
    units = {p.name: p.unit for p in chain.parameters}
    middle = np.ones((1, len(chain.names)))
    units |= {q.name: q.unit for q in derive(chain, middle, 1.0)}
    projection = TotalsProjection(chain, observations)
    for name, label in zip(projection.names, projection.labels, strict=True):
        units[label] = projection.describe(name)[0]
    converted, aliases = {}, projection.aliases()
    for key, reference in config.references.items():
        name = key if key in units else aliases.get(key, key)
        if name not in units or (name != key and name in config.references):
            raise BadInput(
                f"{config.path}: references.{key}",
                "no result of this mechanism has that name",
                nearest(key, units),
            )
        converted[name] = {**reference.model_dump(), "unit": units[name]}
    return converted
