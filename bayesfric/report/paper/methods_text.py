r"""A methods paragraph about what a run really did, with what it cites.

The same sentences as plain text and as LaTeX; every number is read from the fit and its
summary, and nothing is cited that was not used.
"""

from __future__ import annotations

import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import bayesfric
from bayesfric.inference.fit import Fit
from bayesfric.inference.noise import SCALES
from bayesfric.mechanism.element import Element
from bayesfric.mechanism.parameter import effort_words
from bayesfric.recordings.observation import Observation
from bayesfric.report.comparison.cell import TOGETHER
from bayesfric.report.paper import latex
from bayesfric.report.paper.bibliography import ENTRIES, bibliography
from bayesfric.report.paper.tables import counts, parameter_table
from bayesfric.report.summary.noise import p_words, white_words

_CITED = re.compile(r"\s*\[@([\w;@]+)\]")
_VERSIONS = ("numpy", "scipy", "emcee", "arviz", "numba")


@dataclass(frozen=True)
class MethodsText:
    r"""A paragraph in three forms.

    Attributes
    ----------
    plain
        Text with citations such as (Foreman-Mackey et al. 2013).
    latex
        The same with ``\cite``.
    bibtex
        What it cites.
    keys
        BibTeX keys in the order of first use.
    """

    plain: str
    latex: str
    bibtex: str
    keys: tuple[str, ...]


def methods_text(fit: Fit, summary: Mapping[str, Any]) -> MethodsText:
    """Write what was done in a run.

    Parameters
    ----------
    fit
        A finished fit.
    summary
        From :func:`bayesfric.report.summary.summary.summarise`.
    """
    paragraphs = [
        " ".join(part(fit, summary))
        for part in (_model, _data, _likelihood, _priors, _sampling, _software)
    ]
    marked = effort_words("\n\n".join(paragraphs), fit.chain.motor_motion)
    keys = tuple(
        dict.fromkeys(key for found in _CITED.findall(marked) for key in found.split(";@"))
    )

    def words(match: re.Match[str]) -> str:
        return " (" + "; ".join(ENTRIES[key].short for key in match[1].split(";@")) + ")"

    parts = []
    last = 0
    for match in _CITED.finditer(marked):
        parts += [latex.escaped(marked[last : match.start()])]
        parts += [rf"~\cite{{{match[1].replace(';@', ',')}}}"]
        last = match.end()
    parts.append(latex.escaped(marked[last:]))
    typeset = _typeset("".join(parts))
    return MethodsText(_CITED.sub(words, marked) + "\n", typeset + "\n", bibliography(keys), keys)


def _typeset(text: str) -> str:
    """Keep numbers and their units on one line, and set what has a symbol as one."""
    text = re.sub(r"(\d) (\\%|(?:Hz|rad/s|m/s|ms|s|kg|m|N)\b)", r"\1\\,\2", text)
    text = text.replace("\\,N m", r"\,N\,m").replace("R-hat", r"$\widehat{R}$")
    return re.sub(r"\bp (=|<) (\d\.?\d*)(?:e([+-]\d+))?", _p_value, text)


def _p_value(found: re.Match[str]) -> str:
    power = rf"\times 10^{{{int(found[3])}}}" if found[3] else ""
    return f"$p {found[1]} {found[2]}{power}$"


def _model(fit: Fit, _: Mapping[str, Any]) -> Iterator[str]:
    chain = fit.chain
    names = listed([_element(e) for e in chain.elements])
    moved = [
        words
        for on, words in (
            (chain.load.inertia, "inertia"),
            (chain.load.first_moment, "gravity"),
            (chain.load.gravity_angle, "an unknown zero of the angle of gravity"),
        )
        if on
    ]
    load = f" and moves a load with {listed(moved)}" if moved else ""
    yield (
        f"The joint was modelled after the friction model of the biped robot Rabbit's knee "
        f"[@rabbit2005] as a chain of {len(chain.elements)} "
        f"{'element' if len(chain.elements) == 1 else 'elements'} from motor to load, {names}; "
        f"the chain has a total ratio of {chain.ratio:g}{load}."
    )
    extras = [
        words
        for on, words in (
            (chain.offset and not chain.own_offsets, "a constant offset of the measured torque"),
            (bool(chain.own_offsets), "a constant offset of the torque in each recording"),
            (chain.gain, "an unknown factor between computed and true motor torque"),
        )
        if on
    ]
    if extras:
        yield f"The model has {listed(extras)}."


def _element(e: Element) -> str:
    parts = [
        words
        for on, words in (
            (e.inertia, "inertia"),
            (e.coulomb == "symmetric", "constant loss"),
            (e.coulomb == "by-direction", "constant loss by direction"),
            (e.viscous, "viscous loss"),
            (e.quadratic, "quadratic loss"),
            (e.stribeck, "a Stribeck rise"),
            (e.load_loss == "one", "a loss per transmitted torque"),
            (e.load_loss == "two", "losses per transmitted torque when driving and back-driven"),
        )
        if on
    ]
    ratio = f", ratio {e.ratio:g}" if e.ratio != 1.0 else ""
    return f"{e.name} ({listed(parts) or 'no loss'}{ratio})"


def _data(fit: Fit, summary: Mapping[str, Any]) -> Iterator[str]:
    seen = fit.observations
    samples = sum(int(o.settings["n_samples"]) for o in seen)
    count = "One recording" if len(seen) == 1 else f"{len(seen)} recordings"
    rates = _each(seen, "sampling_rate")
    was = "was" if len(seen) == 1 else "were"
    yield f"{count} of {samples} samples in all, at {rates} Hz, {was} used."
    if summary.get("may_be_simulated"):
        yield (
            "The configuration tells how to simulate its recordings: where that was done, they "
            "are simulated, not measured."
        )
    masses = [o for o in seen if o.added_mass]
    if masses:
        told = listed(
            [
                f"{o.added_mass:g} kg" + (f" at {o.radius:g} m" if o.radius else "")
                for o in {(o.added_mass, o.radius): o for o in masses}.values()
            ]
        )
        which = "each" if len(masses) == len(seen) else f"{len(masses)} of them"
        yield f"A known mass of {told} was added to the load in {which}."
    if any(o.settings["lowpass"] for o in seen):
        yield (
            f"Positions were low-pass filtered (zero-phase Butterworth of order "
            f"{_each(seen, 'order')}, {_each(seen, 'lowpass')} Hz) and differentiated."
        )
    else:
        yield "Positions were differentiated without a filter."
    if fit.target.likelihood.method == "input-error":
        if any(int(o.settings["taps"]) > 1 for o in seen):
            yield (
                f"Measured and modelled torque alike passed one linear filter (cut-off "
                f"{_each(seen, 'band')} Hz) and were decimated by {_each(seen, 'decimate')}."
            )
        outputs = sum(o.measured.size for o in fit.target.likelihood.outputs)
        slow = sum(int(o.settings["dropped_dead_zone"]) for o in seen)
        unit = "rad/s" if fit.chain.load.motion == "rotary" else "m/s"
        words = f"; {slow} at joint speeds below {_each(seen, 'dead_zone')} {unit} were left out"
        words = words if slow else ""
        yield f"{outputs} outputs were compared with the model{words}."
    if fit.held_out:
        pooled = summary["validation"]["pooled"]
        cover = pooled["coverage"]["0.9"]
        yield (
            f"Besides these, {pooled['outputs']} outputs were held out of the fit; 90 % intervals "
            f"of the posterior predictive cover {100 * cover['share']:.1f} % of them (standard "
            f"error {100 * cover['standard_error']:.1f} %, correlation accounted for)."
        )


def _each(seen: Sequence[Observation], key: str) -> str:
    """Give a setting of all recordings, or its range."""
    values = sorted({float(o.settings[key]) for o in seen})
    if len(values) == 1:
        return f"{values[0]:.4g}"
    return f"{values[0]:.4g} to {values[-1]:.4g}"


def _likelihood(fit: Fit, summary: Mapping[str, Any]) -> Iterator[str]:
    noise = fit.target.noise
    if fit.target.likelihood.method == "input-error":
        yield (
            "The likelihood compares the measured motor torque with that of the inverse model "
            "along the measured motion (input error)."
        )
    else:
        yield (
            "The likelihood compares the measured position with a simulation driven by the "
            "measured torque and restarted in segments (output error)."
        )
    shared = len(noise.names) == len(set(noise.quantities)) and len(fit.observations) > 1
    scales = f"{len(noise.names)} noise parameter{'s' if len(noise.names) > 1 else ''}"
    yield (
        f"Noise model: {summary['noise']['model']}; {scales}"
        f"{' for all recordings' if shared else ''}, sampled along with those of the joint."
    )
    tried = summary["noise"].get("order_chosen_from")
    if tried and len(tried) > 1:
        orders = [one["order"] for one in tried]
        yield (
            f"The order of its memory was chosen from {min(orders)} to {max(orders)} by the "
            "Bayesian information criterion."
        )
    yield from dict.fromkeys(
        SCALES[kind].remark for kind in noise.quantities if SCALES[kind].remark
    )
    if (lag := summary["noise"].get("residual_lag1")) is not None:
        yield f"The residuals' lag-1 correlation is {lag:.2f}."
    test = summary["noise"].get("innovation_whiteness")
    if test is not None:
        yield (
            f"The innovations, what the noise model does not foretell, "
            f"{white_words(test['white'])} ({test['test']}, {p_words(test['p_value'])})."
        )
    yield from (
        f"{text[0].upper()}{text[1:]}."
        for text in summary["warnings"]
        if "taken for independent" in text
    )
    left = summary["fit"]
    yield f"The residuals' root mean square is {left['residual_rms']:.3g} {left['unit']}."


def _priors(_: Fit, summary: Mapping[str, Any]) -> Iterator[str]:
    rows = summary["parameters"]
    default = [name for name, row in rows.items() if row["prior_default"]]
    given = {name: row["prior"] for name, row in rows.items() if not row["prior_default"]}
    if default:
        yield (
            f"Of {len(rows)} sampled parameters {len(default)} had the package's wide default "
            "priors, whose scales follow from the largest measured torque and motion."
        )
    if given:
        yield f"Given priors: {'; '.join(f'{name} {text}' for name, text in given.items())}."
    if summary["fixed"]:
        fixed = [
            f"{name} = {row['value']:.4g} {row['unit']}".strip()
            for name, row in summary["fixed"].items()
        ]
        yield f"Taken as known: {'; '.join(fixed)}."
    joint = parameter_table(summary).joint
    sound = [row for row in joint if row.cell.converged]
    if sound:
        n = counts(sound)
        lost = f", not converged {len(joint) - len(sound)}" if len(sound) < len(joint) else ""
        limits = f"limited on one side {n.limits}, " if n.limits else ""
        yield (
            f"Parameters of the joint, {len(joint)} in all: determined by the data {n.data}, by "
            f"{TOGETHER} {n.together}, {limits}not determined by the data "
            f"{n.open}{lost}."
        )
    found = summary["identifiability"]["null_directions"]
    for direction in found:
        yield f"No recording of this kind can tell: {direction['meaning']}."


def _sampling(fit: Fit, summary: Mapping[str, Any]) -> Iterator[str]:
    d, sampler = fit.posterior.diagnostics, summary["sampler"]
    yield (
        f"The posterior was sampled with emcee [@emcee2013] by {d.ensembles} independent "
        f"ensembles of {d.walkers} walkers, {d.warmup} steps of warm-up and {d.steps} steps, "
        f"seed {sampler['seed']}; coordinates: {sampler['coordinates']}."
    )
    learned = "independent draws from a mixture of normals with a Student-t around it, fitted"
    if summary["likelihood"]["method"] == "output-error":
        learned = (
            "the ends of walks on a polynomial in place of the likelihood [@christen2005], learned"
        )
    yield (
        f"Proposals were differential evolution [@terbraak2006] and {learned} in the warm-up and "
        "then frozen."
    )
    if sampler["max_rhat"] is not None and sampler["min_ess"] is not None:
        yield (
            f"The largest nested R-hat [@margossian2024] between ensembles is "
            f"{sampler['max_rhat']:.4f}, the smallest effective sample size "
            f"{sampler['min_ess']:.0f}; the run is {sampler['status']}."
        )
    else:
        yield f"A parameter never moved; the run is {sampler['status']}."
    if stuck := sampler["stuck_walkers"]:
        yield f"{stuck} walkers never moved and are in no interval."
    level = next(iter(summary["parameters"].values()))["level"]
    yield f"Intervals are central and hold {100 * level:g} % of the posterior."


def _software(_: Fit, __: Mapping[str, Any]) -> Iterator[str]:
    of = {name: version(name) for name in _VERSIONS}
    yield (
        f"Computed with bayesfric {bayesfric.__version__} [@bayesfric] in Python "
        f"{platform.python_version()}, with NumPy {of['numpy']} [@numpy2020], SciPy "
        f"{of['scipy']} [@scipy2020], emcee {of['emcee']}, Numba {of['numba']} [@numba2015] and "
        f"ArviZ {of['arviz']} [@arviz2019]."
    )


def listed(parts: Sequence[str]) -> str:
    """Join words: ``a, b and c``."""
    if len(parts) < 2:
        return "".join(parts)
    return f"{', '.join(parts[:-1])} and {parts[-1]}"
