"""What a report may cite, as BibTeX."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import bayesfric


@dataclass(frozen=True)
class Entry:
    """One reference.

    Attributes
    ----------
    short
        As written in plain text.
    kind
        BibTeX entry type.
    fields
        BibTeX fields, values without outer braces.
    """

    short: str
    kind: str
    fields: dict[str, str]


def _article(short: str, author: str, title: str, journal: str, year: int, **more: str) -> Entry:
    fields = {"author": author, "title": title, "journal": journal, "year": str(year)}
    return Entry(short, "article", fields | more)


ENTRIES: dict[str, Entry] = {
    # As in CITATION.cff: the text at hand has no title page. Nothing is made up here.
    "rabbit2005": Entry(
        "IFAC paper on the knee of Rabbit, 2005",
        "misc",
        {
            "key": "IFAC",
            "title": "Friction modelling and identification of the knee of the biped robot "
            "{Rabbit}",
            "howpublished": "IFAC",
            "year": "2005",
            "note": "Title as described by the notes of bayesfric; authors, exact title and pages "
            "are to be taken from the printed paper",
        },
    ),
    "emcee2013": _article(
        "Foreman-Mackey et al. 2013",
        "Foreman-Mackey, Daniel and Hogg, David W. and Lang, Dustin and Goodman, Jonathan",
        "{emcee}: The {MCMC} Hammer",
        "Publications of the Astronomical Society of the Pacific",
        2013,
        volume="125",
        number="925",
        pages="306--312",
        doi="10.1086/670067",
    ),
    "terbraak2006": _article(
        "ter Braak 2006",
        "ter Braak, Cajo J. F.",
        "A {Markov} Chain {Monte Carlo} version of the genetic algorithm Differential Evolution: "
        "easy {Bayesian} computing for real parameter spaces",
        "Statistics and Computing",
        2006,
        volume="16",
        pages="239--249",
        doi="10.1007/s11222-006-8769-1",
    ),
    "christen2005": _article(
        "Christen and Fox 2005",
        "Christen, J. Andr{\\'e}s and Fox, Colin",
        "{Markov} chain {Monte Carlo} using an approximation",
        "Journal of Computational and Graphical Statistics",
        2005,
        volume="14",
        number="4",
        pages="795--810",
    ),
    "margossian2024": _article(
        "Margossian et al. 2024",
        "Margossian, Charles C. and Hoffman, Matthew D. and Sountsov, Pavel and Riou-Durand, "
        "Lionel and Vehtari, Aki and Gelman, Andrew",
        r"Nested {$\widehat{R}$}: Assessing the convergence of {Markov} chain {Monte Carlo} when "
        "running many short chains",
        "Bayesian Analysis",
        2024,
        doi="10.1214/24-BA1453",
    ),
    "arviz2019": _article(
        "Kumar et al. 2019",
        "Kumar, Ravin and Carroll, Colin and Hartikainen, Ari and Martin, Osvaldo",
        "{ArviZ} a unified library for exploratory analysis of {Bayesian} models in {Python}",
        "Journal of Open Source Software",
        2019,
        volume="4",
        number="33",
        pages="1143",
        doi="10.21105/joss.01143",
    ),
    "numpy2020": _article(
        "Harris et al. 2020",
        "Harris, Charles R. and Millman, K. Jarrod and van der Walt, St{\\'e}fan J. and others",
        "Array programming with {NumPy}",
        "Nature",
        2020,
        volume="585",
        pages="357--362",
        doi="10.1038/s41586-020-2649-2",
    ),
    "scipy2020": _article(
        "Virtanen et al. 2020",
        "Virtanen, Pauli and Gommers, Ralf and Oliphant, Travis E. and others",
        "{SciPy} 1.0: fundamental algorithms for scientific computing in {Python}",
        "Nature Methods",
        2020,
        volume="17",
        pages="261--272",
        doi="10.1038/s41592-019-0686-2",
    ),
    "numba2015": Entry(
        "Lam et al. 2015",
        "inproceedings",
        {
            "author": "Lam, Siu Kwan and Pitrou, Antoine and Seibert, Stanley",
            "title": "{Numba}: a {LLVM}-based {Python} {JIT} compiler",
            "booktitle": "Proceedings of the Second Workshop on the LLVM Compiler "
            "Infrastructure in HPC",
            "year": "2015",
            "pages": "1--6",
            "doi": "10.1145/2833157.2833162",
        },
    ),
    "barndorff1973": _article(
        "Barndorff-Nielsen and Schou 1973",
        "Barndorff-Nielsen, O. and Schou, G.",
        "On the parametrization of autoregressive models by partial autocorrelations",
        "Journal of Multivariate Analysis",
        1973,
        volume="3",
        number="4",
        pages="408--419",
    ),
    "juarez2010": _article(
        "Juárez and Steel 2010",
        "Ju{\\'a}rez, Miguel A. and Steel, Mark F. J.",
        "Model-based clustering of non-{Gaussian} panel data based on skew-$t$ distributions",
        "Journal of Business and Economic Statistics",
        2010,
        volume="28",
        number="1",
        pages="52--66",
    ),
    "bayesfric": Entry(
        f"bayesfric {bayesfric.__version__}",
        "misc",
        {
            "author": "{The bayesfric developers}",
            "title": "bayesfric: posteriors of joint inertia, friction and gearbox losses from "
            "motor torque",
            "note": f"Version {bayesfric.__version__}",
        },
    ),
}


def bibliography(keys: Sequence[str]) -> str:
    """Write the entries of the given keys as a BibTeX file, in that order."""
    return "\n".join(_written(key, ENTRIES[key]) for key in keys)


def _written(key: str, entry: Entry) -> str:
    fields = "".join(f"  {name} = {{{value}}},\n" for name, value in entry.fields.items())
    return f"@{entry.kind}{{{key},\n{fields}}}\n"
