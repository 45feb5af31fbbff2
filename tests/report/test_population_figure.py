"""The figure of the population: every run in its line, nothing drawn where nothing is pooled."""

import matplotlib.pyplot as plt
import numpy as np
import pytest

from bayesfric.report.comparison.between_runs import between_runs
from bayesfric.report.comparison.comparison import comparison
from bayesfric.report.figures.population import population_figure
from bayesfric.report.figures.registry import ComparedRuns

from .made_summaries import knee, loaded
from .test_between_runs import checked


def compared(runs):
    read = checked(**runs)
    return ComparedRuns(comparison(runs), read, between_runs(read))


def test_nothing_pooled_is_no_figure():
    assert population_figure(compared({"a": knee()})) is None


def test_every_run_has_its_line_whatever_the_others_determine():
    runs = {"first": knee(), "second": loaded(), "third": knee(), "fourth": loaded()}
    one = compared(runs)
    figure = population_figure(one)
    axes = [ax for ax in figure.axes if ax.get_visible()]
    shown = [p for p in one.pooled if not p.name.startswith("total")][: len(axes)]
    places = np.linspace(0.0, -4.0, 4)
    for ax, pooled in zip(axes, shown, strict=True):
        lines = sorted(
            {float(line.get_ydata()[0]) for line in ax.lines if line.get_linewidth() > 2.0},
            reverse=True,
        )
        expected = [y for name, y in zip(runs, places, strict=True) if name in pooled.runs]
        assert lines == pytest.approx(expected)
        unit = pooled.told.unit
        assert unit in ax.get_xlabel()
    names = [text.get_text() for text in axes[0].get_yticklabels()]
    assert names == ["first", "second", "third", "fourth", "population", "next"]
    plt.close(figure)
