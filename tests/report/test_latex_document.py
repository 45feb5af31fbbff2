"""Tables, figures, paragraph and references in a two-column paper, compiled."""

import re
import shutil
import subprocess

import pytest

from bayesfric.report.comparison import comparison
from bayesfric.report.friction import friction_figure
from bayesfric.report.methods_text import methods_text
from bayesfric.report.residual import residual_figure
from bayesfric.report.style import save
from bayesfric.report.summary import summarise
from bayesfric.report.tables import methods_latex, parameter_table, parameters_latex

DOCUMENT = r"""\documentclass[journal]{IEEEtran}
\usepackage[T1]{fontenc}
\usepackage[utf8]{inputenc}
\usepackage{array,booktabs,siunitx,graphicx,textcomp,amsmath}
\begin{document}
\section{Method}
\input{methods}
\input{table-parameters}
\input{table-methods}
\begin{figure*}\includegraphics{friction}\caption{Friction.}\end{figure*}
\begin{figure*}\includegraphics{residual}\caption{Residuals.}\end{figure*}
\bibliographystyle{IEEEtran}
\bibliography{references}
\end{document}
"""


def wanted(name):
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def pieces(fit):
    summary = summarise(fit)
    said = methods_text(fit, summary)
    return {
        "methods.tex": said.latex,
        "references.bib": said.bibtex,
        "table-parameters.tex": parameters_latex(parameter_table(summary)),
        "table-methods.tex": methods_latex(comparison({"run": summary})),
    }


def test_braces_dollars_and_cells_are_balanced(knee):
    """What a compiler would stumble over first, for where there is none."""
    for name, text in pieces(knee).items():
        bare = re.sub(r"\\[{}$&%#_]", "", text)
        bare = re.sub(r"^%.*$", "", bare, flags=re.MULTILINE)
        assert bare.count("{") == bare.count("}"), name
        for line in bare.splitlines():
            assert line.count("$") % 2 == 0, line
        if name.startswith("table"):
            (columns,) = re.findall(r"\\begin\{tabular\}\{(.*)\}$", bare, re.MULTILINE)
            count = len(
                re.findall(r"[lp](?=\{0|[l@p>]|$)", re.sub(r"@\{\}|>\{.*?\}(?=p)", "", columns))
            )
            rows = [x for x in bare.splitlines() if x.endswith(r" \\") and "multicolumn" not in x]
            assert {row.count("&") + 1 for row in rows} == {count}, columns
        for environment in re.findall(r"\\begin\{(\S+?)\}", bare):
            assert rf"\end{{{environment}}}" in bare
        assert name == "references.bib" or text.isascii(), name


@pytest.mark.slow
def test_a_two_column_paper_compiles(knee, tmp_path):
    pdflatex, bibtex = wanted("pdflatex"), wanted("bibtex")
    for name, text in pieces(knee).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "paper.tex").write_text(DOCUMENT, encoding="utf-8")
    for stem, draw in (("friction", friction_figure), ("residual", residual_figure)):
        save(draw(knee), tmp_path, stem)
    compile_ = [pdflatex, "-interaction=nonstopmode", "-halt-on-error", "paper"]
    for command in (compile_, [bibtex, "paper"], compile_, compile_):
        done = subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False
        )
        assert done.returncode == 0, done.stdout[-3000:]
    log = (tmp_path / "paper.log").read_text(encoding="utf-8", errors="replace")
    assert "undefined" not in log
    assert "Missing character" not in log
    # nothing reaches more than 2 pt into the margin
    wide = [float(x) for x in re.findall(r"Overfull \\hbox \(([\d.]+)pt", log)]
    assert max(wide, default=0.0) <= 2.0
