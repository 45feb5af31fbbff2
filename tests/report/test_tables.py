"""Tables for papers: the summary's numbers, read back; nothing open passes for a number."""

import os
import re
import shutil
import subprocess

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.joint import Joint
from bayesfric.recordings.source import Processing
from bayesfric.report import numbers
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.registry import RUN_FIGURES
from bayesfric.report.figures.style import save
from bayesfric.report.paper.tables import (
    escaped,
    latex_symbol,
    methods_latex,
    parameters_latex,
    references,
)
from bayesfric.report.result_row import table_rows
from bayesfric.report.summary.record import is_skewed
from bayesfric.report.summary.summary import summarise
from bayesfric.report.terminal import fit_text

from .made_summaries import every_kind, knee, loaded
from .page_reader import latex_lines, latex_number


def test_what_least_squares_makes_of_the_motion_is_not_what_the_motor_feels(make_fit):
    """Behind a load loss it may lie outside what is felt in either direction of power."""
    summary = summarise(make_fit(samples=600)).as_dict()
    of_motion = {name for name, row in summary["derived"].items() if row.get("of_motion")}
    assert "total.inertia" in of_motion
    assert not of_motion & {row.name for row in table_rows(summary)}
    assert not of_motion & {line.split()[0] for line in fit_text(summary) if line.strip()}


@pytest.mark.parametrize("summary", [knee(), loaded(), every_kind()])
def test_methods_table_is_the_comparison(summary):
    compared = comparison({"run": summary})
    body = latex_lines(methods_latex(compared))
    for cells, row in zip(body, compared.rows, strict=True):
        for text, column in zip(cells[2:], compared.columns, strict=True):
            cell = row.cells.get(column.label)
            text = re.sub(r"\\textsuperscript\{.*\}$", "", text)
            if cell is None or cell.status == "unidentified":
                assert text == ("" if cell is None else "---")
            elif cell.interval and is_skewed(cell.value, *cell.interval):
                (middle, up, down), last = latex_number(text)
                ends = [middle + down, middle + up]
                np.testing.assert_allclose(ends, cell.interval, rtol=0, atol=1.001 * last)
            elif cell.limit is None:
                (value, *sd), last = latex_number(text)
                tolerance = 0.5001 * last if cell.sd else 1e-3 * abs(cell.value)
                assert value == pytest.approx(cell.value, abs=tolerance)
                assert sd == ([pytest.approx(cell.sd, abs=0.5001 * last)] if cell.sd else [])


# -- numbers


@given(st.floats(-1e6, 1e6, allow_subnormal=False), st.floats(1e-9, 1e6))
def test_any_number_reads_back(value, sd):
    (shown, uncertainty), _ = latex_number(numbers.LATEX.value(value, sd))
    last = 10.0 ** numbers.last_digit(sd)
    # rounding to the last digit, and that of a double
    assert shown == pytest.approx(value, abs=0.5001 * last + 1e-15 * abs(value))
    assert uncertainty == pytest.approx(sd, abs=0.5001 * last)


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (4.6178e-4, 3.6e-7, r"\num{4.6178(36)e-4}"),
        (0.23600, 0.00084, r"\num{0.23600(84)}"),
        (0.0123, 0.000996, r"\num{0.0123(10)}"),
        (203.5, 1.14, r"\num{203.5(11)}"),
        (95123.0, 310.0, r"\num{9.512(31)e4}"),
        (0.0, 0.25, r"\num{0.00(25)}"),
        (-0.001, 0.3, r"\num{0.00(30)}"),
        (2034.0, 11.4, r"\num{2034(11)}"),
        # far below its sd it takes the sd's power of ten
        (1.35, 690.0, r"\num{0.0(69)e2}"),
    ],
)
def test_digits_are_set_by_the_uncertainty(value, sd, text):
    assert numbers.LATEX.value(value, sd) == text


@pytest.mark.parametrize(
    ("middle", "low", "high", "sd", "interval", "ends"),
    [
        # of runs: a tail of one side made the sd larger than all of the other
        (11.1, 4.80, 11.54, 5.2, "[4.80, 11.54]", r"$\num{11.10}^{+\num{0.44}}_{-\num{6.30}}$"),
        (1.0056, 1.0003, 9.1, 6.0, "[1.0003, 9.1000]", None),
        # an end that is nearer than a thousandth of the other's distance sets no digits
        (18.19, -11962.0, 18.2, 12000.0, "[-1.1962e4, 18]", None),
        (4.1, 2.455, 5.745, 1.0, "[2.5, 5.7]", r"$\num{4.1}^{+\num{1.6}}_{-\num{1.6}}$"),
    ],
)
def test_a_skewed_interval_is_rounded_by_its_nearer_end(middle, low, high, sd, interval, ends):
    fine = numbers.finer(middle, low, high, sd)
    assert numbers.TEXT.interval(low, high, fine) == interval
    assert ends in (None, numbers.LATEX.ends(middle, low, high, fine))


def test_names_that_latex_would_trip_over():
    assert latex_symbol("", "motor_50%.inertia") == r"\texttt{motor\_50\%.inertia}"
    assert latex_symbol("J_{left_arm}", "x") == r"$J_{\mathrm{left\_arm}}$"
    assert escaped("a & b_c $5 {x} 50%") == r"a \& b\_c \$5 \{x\} 50\%"


# -- a two-column paper, compiled

DOCUMENT = r"""\documentclass[journal]{IEEEtran}
\usepackage[T1]{fontenc}
\usepackage[utf8]{inputenc}
\usepackage{array,booktabs,siunitx,tabularx,graphicx,textcomp}
\begin{document}
\section{Method}
\input{knee-parameters}\input{knee-methods}\input{axis-parameters}\input{axis-methods}
Tables \ref{tab:knee-parameters} and \ref{tab:axis-methods}.
\input{every-parameters}\input{every-methods}\input{runs-methods}
\begin{figure*}\includegraphics{friction}\caption{Friction.}\end{figure*}
\begin{figure*}\includegraphics{residual}\caption{Residuals.}\end{figure*}
\nocite{*}
\bibliographystyle{IEEEtran}
\bibliography{references}
\end{document}
"""
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


def compiled(folder):
    """Compile ``paper.tex``, and list what a reader of the paper would stumble over."""
    compile_ = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper"]
    # one line of the log for each message, however long
    options = {"cwd": folder, "env": os.environ | {"max_print_line": "10000"}, "timeout": 300}
    for command in (compile_, ["bibtex", "paper"], compile_, compile_):
        done = subprocess.run(command, capture_output=True, check=False, **options)
        assert done.returncode in (0, 2 * (command[0] == "bibtex")), done.stdout[-3000:]
    log, blg = (
        (folder / f"paper.{kind}").read_text(encoding="utf-8", errors="replace")
        for kind in ("log", "blg")
    )
    faults = "undefined|multiply defined|Missing character|Float too large"
    # nothing reaches more than 2 pt into the margin; figures of 7.16 in reach 1.5 pt
    wide = re.findall(r"^(Overfull \\hbox \(([\d.]+)pt too wide\).*)$", log, re.MULTILINE)
    return [
        *re.findall(rf"^.*(?:{faults}).*$", log, re.MULTILINE),
        *(line for line, points in wide if float(points) > 2.0),
        *re.findall(r"^Warning--.*$", blg, re.MULTILINE),
    ]


@pytest.mark.slow
def test_a_two_column_paper_compiles(knee, make_fit, tmp_path):
    for program in ("pdflatex", "bibtex", "kpsewhich"):
        if shutil.which(program) is None:
            pytest.skip(f"{program} is not installed")
    for name in ("IEEEtran.cls", "siunitx.sty"):
        if subprocess.run(["kpsewhich", name], capture_output=True, check=False).returncode:
            pytest.skip(f"{name} is not installed")
    axis = make_fit(AXIS, samples=600, processing=Processing(lowpass=50.0, decimate=4))
    runs = {"knee": {"run": summarise(knee).as_dict()}, "axis": {"run": summarise(axis).as_dict()}}
    # every kind of number: skewed, limits, on bounds, open, large, negative
    runs |= {"every": {"run": every_kind()}, "runs": {"a": every_kind(), "b_2": loaded()}}
    for name, summaries in runs.items():
        tables = {"methods": methods_latex(comparison(summaries))}
        if len(summaries) == 1:
            tables["parameters"] = parameters_latex(summaries["run"])
        for kind, text in tables.items():
            # labels are unique in a paper
            text = text.replace(r"\label{tab:", rf"\label{{tab:{name}-")
            (tmp_path / f"{name}-{kind}.tex").write_text(text, encoding="utf-8")
    (tmp_path / "references.bib").write_text(references(), encoding="utf-8")
    for stem in ("friction", "residual"):
        save(RUN_FIGURES[stem].draw(knee, summarise(knee)), tmp_path, stem)
    (tmp_path / "paper.tex").write_text(DOCUMENT, encoding="utf-8")
    assert compiled(tmp_path) == []
    # and the complaints are heard: a citation and a reference of nothing
    bad = DOCUMENT.replace(r"\begin{figure*}", r"\cite{nobody}\ref{nothing}\begin{figure*}", 1)
    (tmp_path / "paper.tex").write_text(bad, encoding="utf-8")
    complaints = "\n".join(compiled(tmp_path))
    assert "nobody" in complaints
    assert "nothing" in complaints
