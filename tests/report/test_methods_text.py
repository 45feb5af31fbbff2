"""The methods paragraph: what was done in this run, and nothing that was not."""

import copy
import re
from dataclasses import replace
from importlib.metadata import version

import pytest

import bayesfric
from bayesfric.recordings.measurement import LeftOut
from bayesfric.report.paper import latex
from bayesfric.report.paper.equation import latex_equations, plain_equations
from bayesfric.report.paper.methods_text import ENTRIES, methods_text
from bayesfric.report.paper.tables import latex_texts, parameter_table
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.summary import summarise

from .made_summaries import FOUND


@pytest.fixture
def summary(knee):
    return summarise(knee).as_dict()


@pytest.fixture(scope="module")
def said(knee):
    return methods_text(knee, summarise(knee))


def test_numbers_of_this_run(knee, said):
    d = knee.posterior.diagnostics
    (o,) = knee.observations
    (out,) = knee.target.likelihood.outputs
    for words in (
        "3 elements from motor to load",
        "ratio 50",
        f"One recording of {o.settings['n_samples']} samples in all, at 1000 Hz, was used",
        f"{out.measured.size} outputs",
        f"{d.ensembles} independent ensembles of {d.walkers} walkers, {d.warmup} steps of warm-up",
        f"{d.steps} steps, seed {knee.posterior.seed}",
        f"bayesfric {bayesfric.__version__} (The bayesfric developers)",  # not named twice
        f"NumPy {version('numpy')}",
        "(input error)",
        "Velocities were measured, accelerations differentiated from them without a filter",
    ):
        assert words in said.plain, words


CURRENT = {"torque_constant": 0.32}
VOLTAGE = {"motor_constant": "0.3 N m/A", "motor_resistance": "2 ohm"}


@pytest.mark.parametrize(
    ("which", "settings", "said"),
    [
        # the made-up motions have a velocity; take it away, and the words must change
        (
            "knee",
            {"velocity": "differentiated"},
            "Velocities and accelerations were differentiated from positions",
        ),
        # a window that holds a reversal is left out whole, and most of it may be fast
        (
            "knee",
            {"dropped_dead_zone": 24, "dead_zone": 0.0064},
            "24 were left out: [^.]*below 0.0064 rad/s[^.]* or filtered together with such samples",
        ),
        (
            "knee",
            {"interpolated_from": 1473},
            "One recording of 1473 measured samples was used. They were stamped at irregular "
            "times, and were interpolated to 1500 at even steps",
        ),
        ("knee", CURRENT, "The torque is a measured current times 0.32 N m/A, taken as exact"),
        # a commanded voltage times a constant, and a motor's voltage less its back-EMF
        (
            "slide",
            {"signal_unit": "V", "signal_constant": "35.15065188248547 N/V"},
            "The force is a recorded signal in V, times 35.1507 N/V",
        ),
        ("knee", VOLTAGE, r"voltage, less its back-EMF \(kt = 0.3 N m/A, R = 2 ohm\)"),
    ],
)
def test_how_a_recording_was_read_is_told(which, settings, said, request, monkeypatch):
    fit = request.getfixturevalue(which)
    summary = summarise(fit)
    before = methods_text(fit, summary).plain
    (o,) = fit.observations
    for key, value in settings.items():
        monkeypatch.setitem(o.settings, key, value)
    after = methods_text(fit, summary).plain
    assert re.search(said, after)
    assert not re.search(said, before)
    assert ("measured, accel" in after) == ("velocity" not in settings)


def test_the_model_is_written_down(knee, slide, said):
    for line in plain_equations(knee.chain):
        assert line in said.plain
    assert latex_equations(knee.chain) in said.latex
    assert "is that at its element's input:\n\\begin{align*}" in said.latex
    assert "of the form psi Theta1 + sign(qd)|psi Theta2|" in said.plain
    assert r"$\psi\Theta_1 + \operatorname{sign}(\dot q)\,|\psi\Theta_2|$" in said.latex
    said = methods_text(slide, summarise(slide))
    assert "Theta" not in said.plain + said.latex


def test_what_was_left_out_by_hand_is_told_by_recording_and_in_all(many):
    summary = summarise(many).as_dict()
    assert "Left out" not in methods_text(many, summary).plain
    first, second, *others = many.observations
    cut = LeftOut(0.0, 0.25, "cut"), LeftOut(1.4, 2.0, "cut")
    hand = LeftOut(0.5, 0.75, "exclude"), LeftOut(1.0, 1.1, "exclude")
    off = LeftOut(1.2, 1.23, "valid")
    seen = (
        replace(first, left_out=(cut[0], *hand, cut[1])),
        replace(second, left_out=(off, hand[1])),
        *others,
    )
    target, likelihood = copy.copy(many.target), copy.copy(many.target.likelihood)
    likelihood.observations, target.likelihood = seen, likelihood
    text = methods_text(replace(many, target=target), summary).plain
    assert (
        "Left out by hand were 1.3 s in all: of run 0 what lies before 0.25 s, 0.5 to 0.75 s, "
        "1 to 1.1 s and what lies after 1.4 s; of run 1 1 to 1.1 s." in text
    )
    assert "Not compared were 0.03 s more in which a recording's own column says" in text


def test_what_every_torque_rests_on_is_said_unless_its_factor_is_fitted(summary):
    """0.32 N m/A were one number off, and every other would be."""
    read = Summary.read(summary)
    assert not read.rests_on  # a torque as measured
    current = read.model_copy(update={"fit": read.fit.model_copy(update=CURRENT)})
    told = "Torque is a current times 0.32 N m/A, taken as exact"
    assert any(told in note for note in parameter_table(current).notes())
    row = read.parameters["motor.inertia"]
    fitted = current.model_copy(update={"parameters": current.parameters | {"drive.gain": row}})
    assert not fitted.rests_on


def test_why_numbers_are_doubtful_is_said(knee, summary):
    name = "motor.inertia"
    summary["doubts"] = [
        {"kind": "missing", "what": "torque_constant", "parameters": [name], "share": 0.123}
    ]
    row = summary["parameters"][name]
    row |= {"verdict": "weak", "doubted": ["missing"], "converged": True}
    words = "another torque constant explains 12 % of the torque"
    assert f"Doubtful they are because {words}." in methods_text(knee, summary).plain
    texts = latex_texts(summary, "run")
    words = words.replace(" %", "\\,\\%")
    assert f"Doubtful, because {words}" in texts["tables/parameters.tex"]
    assert f"d: doubtful, because {words}" in texts["tables/estimates.tex"]


def test_noise_and_simulation_are_the_summarys(knee, summary, said):
    summary["noise"]["model"] = "autoregressive of order 2, Student-t"
    told = methods_text(knee, summary | {"may_be_simulated": True}).plain
    assert "Noise model: autoregressive of order 2, Student-t;" in told
    # a paper must not take simulated for measured
    assert "they are simulated, not measured" in told
    assert "simulated, not measured" not in said.plain


def test_what_is_open_and_what_is_wrong_is_said(knee, summary):
    summary["noise"]["innovation_lag1"] = 0.67
    summary["warnings"] = ["run 0: something else"]
    text = methods_text(knee, summary).plain
    assert "Residuals count as independent, but are correlated (lag 1: 0.67)" in text
    assert "something else" not in text
    assert "No recording of this kind can tell: gearbox.alpha_drive" in text
    table = parameter_table(summary)
    shown = [r.cell.status for r in table.rows if r.group == "parameter"]
    assert shown.count("limit") + shown.count("undetermined") > 0
    assert f"not determined by the data {shown.count('undetermined')}." in text
    if shown.count("limit"):
        assert f"on one side {shown.count('limit')}," in text


def test_all_that_is_cited_is_listed_and_nothing_else(said):
    cited = re.findall(r"\\cite\{([^}]+)\}", said.latex)
    listed = re.findall(r"^@\w+\{(\w+),", said.bibtex, re.MULTILINE)
    assert tuple(cited) == tuple(listed) == said.keys
    elsewhere = {"barndorff1973", "carvalho2010"}
    assert set(listed) == set(ENTRIES) - elsewhere
    for key in listed:
        assert ENTRIES[key].short in said.plain
    assert "[@" not in said.plain + said.latex
    for block in said.bibtex.split("\n\n"):
        assert block.count("{") == block.count("}")
    assert said.bibtex.isascii()


def test_what_another_noise_or_likelihood_rests_on_is_cited(knee, summary, said):
    noise = replace(knee.target.noise, quantities=("pacf_1",))
    target = object.__new__(type(knee.target))
    target.__dict__ |= knee.target.__dict__ | {"noise": noise}
    found = methods_text(replace(knee, target=target), summary)
    assert "barndorff1973" in found.keys
    assert "mixture of normals" in said.plain


def test_the_paper_is_named_as_its_proceedings_name_it(said):
    """https://skoge.folk.ntnu.no/prost/proceedings/ifac2005/Papers/JsPaper3808.html."""
    entry = said.bibtex.partition("{rabbit2005,")[2].partition("\n}")[0]
    for words in (
        "author = {Abba, Gabriel and Sardain, Philippe}",
        "frictions in the transmission elements of a robot axis for its identification",
        "year = {2005}",
        "pages = {7--12}",
    ):
        assert words in entry
    assert "(Abba and Sardain 2005)" in said.plain


# What BibTeX's standard styles warn of where it is missing.
_WANTED = {
    "article": {"author", "title", "journal", "year"},
    "inproceedings": {"author", "title", "booktitle", "year", "pages"},
    "misc": {"author", "title", "note"},
}


@pytest.mark.parametrize("key", ENTRIES)
def test_an_entry_is_complete_and_bibtex_warns_of_none(key):
    kind = re.match(r"@(\w+)", ENTRIES[key].text)[1]
    fields = set(re.findall(r"^  (\w+) = ", ENTRIES[key].text, re.MULTILINE))
    assert fields >= _WANTED[kind]
    # standard styles take one of volume and number, of a paper in proceedings
    assert kind != "inproceedings" or not fields >= {"volume", "number"}


def test_signs_and_numbers_below_zero_are_math(knee, summary):
    """Text fonts print ``<``, ``>`` and ``|`` as other characters, and a hyphen for a minus."""
    summary["noise"]["residual_lag1"] = -0.61
    row = next(iter(summary["parameters"].values()))
    row["prior_default"], row["prior"] = False, "norm(loc=-1.5, scale=2e-05) cut to [-2, 3]"
    said = methods_text(knee, summary)
    assert "correlation is -0.61" in said.plain
    assert "correlation is $-0.61$" in said.latex
    assert r"norm(loc=$-1.5$, scale=$2\times 10^{-5}$) cut to [$-2$, 3]" in said.latex
    assert not re.search(r"[<>|]|(?<![\w-])-\d", outside_math(said.latex))


def outside_math(text):
    text = re.sub(r"\\begin\{align\*\}.*?\\end\{align\*\}", "", text, flags=re.DOTALL)
    return re.sub(r"\$[^$]*\$", "", text)


def test_latex_has_the_symbols_of_the_tables_and_text_the_names(knee, summary):
    for row in summary["parameters"].values():
        row["prior_default"] = False
    said = methods_text(knee, summary)
    table = {r.name: latex.symbol(r.symbol, r.name) for r in parameter_table(summary).rows}
    for name in summary["parameters"]:
        assert f" {name} " in said.plain
        assert latex.escaped(name) not in said.latex
        assert f" {table[name]} " in said.latex


def test_latex_is_escaped(knee, summary):
    row = next(iter(summary["parameters"].values()))
    row["prior_default"], row["prior"] = False, "norm(loc=50%, my_scale=1)"
    text = methods_text(knee, summary).latex
    assert r"norm(loc=50\%, my\_scale=1)" in text
    text = outside_math(text).partition("\n")[2]  # behind its comment
    assert not re.search(r"(?<!\\)[%&#_]", re.sub(r"\\cite\{[^}]+\}", "", text))


def test_an_axis_and_four_recordings(slide, many):
    text = methods_text(slide, summarise(slide).as_dict()).plain
    assert "1 element from motor to load, slide (inertia and constant loss)" in text
    text = methods_text(many, summarise(many).as_dict()).plain
    assert "4 recordings of" in text
    assert "4 noise parameters," in text


@pytest.mark.parametrize("found", [[], [FOUND | {"kind": "load_loss"}]])
def test_what_was_asked_of_the_model_is_what_is_said_of_it(knee, summary, found):
    told = summary | {"regression": {"twins": 60}, "findings": found}
    told["model_error"] = {"shown": bool(found), "chance": 0.99}
    said = methods_text(knee, told).plain
    assert "60 recordings simulated from the model" in said
    assert ("This one showed load loss." in said) == bool(found)
    assert ("This one showed nothing." in said) == (not found)
    assert ("were marginalised" in said) == bool(found)
