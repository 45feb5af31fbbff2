"""The answer of a run: short, in one order, the same on terminal and page."""

import pytest

from bayesfric.report.summary.record import PosteriorRow
from bayesfric.report.terminal import FINDINGS, ROWS, brief
from bayesfric.report.words import line_of, words
from bayesfric.results.reported import ORDER

from .made_summaries import FOUND, every_kind, knee, loaded, posterior_row


def crowded():
    """A run with more of everything than anybody reads."""
    summary = loaded()
    summary["findings"] = [FOUND | {"severity": "note", "kind": kind} for kind in words()][:12]
    summary["warnings"] = [f"remark {k}; and a long story behind it" for k in range(40)]
    row = summary["parameters"]["motor.inertia"]
    summary["parameters"] |= {f"offset.recording_{k}": dict(row) for k in range(30)}
    return summary


@pytest.mark.parametrize(
    ("rms", "left"), [(0.0, "0 %"), (0.1, "10 %"), (1.0, "100 %"), (2.0, "200 %")]
)
def test_what_the_model_leaves_is_of_the_torque(rms, left):
    summary = knee()
    summary["fit"] |= {"residual_rms": 3.0 * rms, "measured_rms": 3.0}
    assert f"leaves {left}" in brief(summary)["verdict"]


def test_numbers_come_by_status_and_what_is_too_much_is_counted():
    answer = brief(crowded())
    assert (len(answer["lines"]), len(answer["findings"])) == (ROWS, FINDINGS)
    assert answer["left_out"] == 30 + len(brief(loaded())["lines"]) - ROWS
    assert answer["others"] >= 9
    order = [row[-1] for row in brief(every_kind())["lines"]]
    ranks = [ORDER.index({"needs the prior": "prior"}.get(x, x)) for x in order]
    assert ranks == sorted(ranks)


@pytest.mark.parametrize(
    ("verdict", "more", "status", "bound"),
    [
        ("data", {}, "identified", None),
        ("weak", {}, "prior", None),
        ("prior", {}, "unidentified", None),
        ("prior", {"prior": "uniform(0, 4)"}, "prior", None),
        ("data", {"at_bound": "lower"}, "limit", 3.0),
        ("data", {"at_bound": "upper"}, "limit", 1.0),
        ("data", {"doubted": ["delay"]}, "doubtful", None),
        ("data", {"at_bound": "lower", "doubted": ["delay"]}, "doubtful", 3.0),
        # nothing is doubted of what nobody knows, and nothing told of what has not converged
        ("prior", {"doubted": ["delay"]}, "unidentified", None),
        ("data", {"converged": False, "at_bound": "lower"}, "unidentified", None),
    ],
)
def test_the_status_of_a_number(verdict, more, status, bound):
    row = posterior_row("N m", 2.0, 0.6, verdict=verdict, **more) | {"interval": [1.0, 3.0]}
    reported = PosteriorRow.model_validate(row).reported
    assert (reported.status, reported.bound) == (status, bound)
    assert (reported.value, reported.interval, reported.sd) == (2.0, [1.0, 3.0], 0.6)
    wide = {"model_error_interval": [0.0, 4.0], "model_error_sd": 1.2}
    reported = PosteriorRow.model_validate(row | wide).reported
    assert (reported.value, reported.interval, reported.sd) == (2.0, [0.0, 4.0], 1.2)
    assert reported.status == status


def test_every_kind_has_its_line():
    values = dict.fromkeys(("share", "times", "ratio", "seconds"), 0.5)
    assert all(line_of(kind, values) and "{" not in line_of(kind, values) for kind in words())
