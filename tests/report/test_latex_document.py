"""Tables, figures and references in a two-column paper, compiled."""

import os
import re
import shutil
import subprocess

import pytest

from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.source import Processing
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.friction import friction_figure
from bayesfric.report.figures.prediction import residual_figure
from bayesfric.report.figures.style import save
from bayesfric.report.paper import latex
from bayesfric.report.paper.tables import (
    methods_latex,
    parameter_table,
    parameters_latex,
)
from bayesfric.report.summary.record import Summary
from bayesfric.report.summary.summary import summarise

from .made_summaries import every_kind, loaded

DOCUMENT = r"""\documentclass[journal]{IEEEtran}
\usepackage[T1]{fontenc}
\usepackage[utf8]{inputenc}
\usepackage{array,booktabs,siunitx,tabularx,graphicx,textcomp}
\begin{document}
\section{An axis}
\input{axis-table-parameters}
\input{axis-table-methods}
\section{Method}
\input{table-parameters}
\input{table-methods}
Tables \ref{tab:parameters} and \ref{tab:methods}.
\input{table-every-kind}
\input{table-every-method}
\input{table-runs}
\begin{figure*}\includegraphics{friction}\caption{Friction.}\end{figure*}
\begin{figure*}\includegraphics{residual}\caption{Residuals.}\end{figure*}
\nocite{*}
\bibliographystyle{IEEEtran}
\bibliography{references}
\end{document}
"""


def wanted(name):
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


AXIS = Joint(
    elements=(
        Element(
            "motor", inertia=True, coulomb="symmetric", viscous="by-direction",
            stribeck="either", motion="linear", subscript="m",
        ),
    ),
    load=Load(motion="linear"),
    offset=True,
)  # fmt: skip


@pytest.fixture(scope="module")
def axis(make_fit):
    return make_fit(AXIS, samples=600, processing=Processing(lowpass=50.0, decimate=4))


def axis_pieces(fit):
    """Write files of a linear axis, with labels and names of its own."""
    found = {f"axis-{name}": text for name, text in pieces(fit).items() if "bib" not in name}
    return {name: text.replace(r"\label{", r"\label{axis-") for name, text in found.items()}


def pieces(fit):
    summary = summarise(fit).as_dict()
    return {
        "references.bib": latex.references(),
        "table-parameters.tex": parameters_latex(parameter_table(summary)),
        "table-methods.tex": methods_latex(comparison({"run": summary})),
    }


def invented_tables():
    """Tables with every kind of number: skewed, limits, on bounds, open, large, negative."""
    run = every_kind()
    runs = {name: Summary.read(one, name) for name, one in {"a": run, "b_2": loaded()}.items()}
    tables = {
        "table-every-kind.tex": parameters_latex(parameter_table(run)),
        "table-every-method.tex": methods_latex(comparison({"run": run})),
        "table-runs.tex": methods_latex(comparison(runs)),
    }
    # labels are unique in a paper
    return {name: text.replace(r"\label{", r"\label{invented-") for name, text in tables.items()}


def compiled(folder, pdflatex, bibtex=None):
    """Compile ``paper.tex`` and return what TeX and BibTeX wrote into their logs."""
    compile_ = [pdflatex, "-interaction=nonstopmode", "-halt-on-error", "paper"]
    steps = (compile_, [bibtex, "paper"], compile_, compile_) if bibtex else (compile_,)
    for command in steps:
        done = subprocess.run(
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=300,
            # one line of the log for each message, however long
            env=os.environ | {"max_print_line": "10000"},
        )
        assert done.returncode == 0, done.stdout[-3000:]
    return [
        (folder / f"paper.{kind}").read_text(encoding="utf-8", errors="replace")
        for kind in ("log", "blg")
    ]


def complaints(log, blg):
    """List what a reader of the paper would stumble over."""
    found = re.findall(
        r"^.*(?:undefined|multiply defined|Missing character|Float too large).*$",
        log,
        re.MULTILINE,
    )
    # nothing reaches more than 2 pt into the margin; figures of 7.16 in reach 1.5 pt
    found += [
        told[0]
        for told in re.findall(r"^(Overfull \\hbox \(([\d.]+)pt too wide\).*)$", log, re.MULTILINE)
        if float(told[1]) > 2.0
    ]
    return found + re.findall(r"^Warning--.*$", blg, re.MULTILINE)


@pytest.mark.slow
def test_a_two_column_paper_compiles(knee, axis, tmp_path):
    pdflatex, bibtex = wanted("pdflatex"), wanted("bibtex")
    for name in ("IEEEtran.cls", "siunitx.sty"):
        if subprocess.run([wanted("kpsewhich"), name], capture_output=True, check=False).returncode:
            pytest.skip(f"{name} is not installed")
    for name, text in (pieces(knee) | axis_pieces(axis)).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    for name, text in invented_tables().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "paper.tex").write_text(DOCUMENT, encoding="utf-8")
    for stem, draw in (("friction", friction_figure), ("residual", residual_figure)):
        save(draw(knee), tmp_path, stem)
    assert complaints(*compiled(tmp_path, pdflatex, bibtex)) == []
    # and the complaints are heard: a citation and a reference of nothing
    bad = DOCUMENT.replace(r"\begin{figure*}", r"\cite{nobody}\ref{nothing}\begin{figure*}", 1)
    (tmp_path / "paper.tex").write_text(bad, encoding="utf-8")
    told = "\n".join(complaints(*compiled(tmp_path, pdflatex)))
    assert "nobody" in told
    assert "nothing" in told
