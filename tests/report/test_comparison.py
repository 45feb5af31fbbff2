"""Side by side: the arithmetic, the order, and that what is open stays without numbers."""

import csv
import io
import json
import math
import re
from dataclasses import replace

import pytest

from bayesfric.report.comparison.comparison import (
    comparison,
    comparison_csv,
    comparison_dict,
    comparison_text,
)
from bayesfric.report.messages import messages_of
from bayesfric.report.paper.tables import parameter_table
from bayesfric.report.result_row import result_rows

from .made_summaries import (
    DERIVED,
    LEG,
    MOTOR,
    TOTALS,
    knee,
    loaded,
)


def text(found):
    return "\n".join(comparison_text(found))


# -- arithmetic


def test_disagreement_of_an_estimate_is_in_the_larger_sd():
    found = comparison({"knee": knee()})
    assert found.baseline == "posterior"
    for name in (*TOTALS, *DERIVED, *MOTOR):
        cells = found[name].cells
        # made so: 0.6 sds below, 0.8 above; both sds are the same
        assert cells["input-error"].disagreement == pytest.approx(-0.6, abs=1e-9)
        assert cells["output-error"].disagreement == pytest.approx(0.8, abs=1e-9)
        assert cells["posterior"].disagreement is None
    run = knee()
    run["estimates"]["output-error"]["parameters"]["motor.inertia"]["sd_robust"] *= 4.0
    cell = comparison({"knee": run})["motor.inertia"].cells["output-error"]
    assert cell.disagreement == pytest.approx(0.2, abs=1e-9)


def test_disagreement_of_references_and_runs_adds_their_variance():
    found = comparison({"a": knee(), "b": loaded()})
    reference = found["motor.inertia"].cells["reference"]
    # data sheet 3.32e-4 +- 1e-5 against 3.40e-4 +- 2.6e-5
    expected = (3.32 - 3.40) / math.hypot(0.26, 0.10)
    assert reference.disagreement == pytest.approx(expected, rel=1e-9)
    for name in DERIVED:
        # 0.7 sds apart, both sds the same
        cell = found[name].cells["b: posterior"]
        assert cell.disagreement == pytest.approx(0.7 / math.sqrt(2), rel=1e-6)


def test_totals_of_the_motion_are_not_measured_between_runs():
    a, b = knee(), loaded()
    b["derived"]["total.inertia"]["of_motion"] = True  # an older run does not tell
    found = comparison({"a": a, "b": b})
    assert found["total.inertia"].cells["b: posterior"].disagreement is None
    assert found["total.viscous"].cells["b: posterior"].disagreement is not None
    # of one recording the methods have one motion
    alone = comparison({"b": b})
    assert alone["total.inertia"].cells["input-error"].disagreement is not None


def test_white_noise_that_was_found_and_passes_is_not_called_assumed():
    run = knee()
    run["noise"] |= {"accounts_for_correlation": False, "order_chosen_from": []}
    run["noise"]["innovation_whiteness"] = {"test": "Ljung-Box", "p_value": 0.16, "white": True}
    cells = comparison({"knee": run})["total.inertia"].cells
    assert not cells["posterior"].accounts
    tried = [{"order": k, "bic": 4.0 * k} for k in range(3)]
    run["noise"]["order_chosen_from"] = tried
    found = comparison({"knee": run})
    assert found["total.inertia"].cells["posterior"].accounts
    run["noise"]["innovation_whiteness"]["white"] = False
    assert not comparison({"knee": run})["total.inertia"].cells["posterior"].accounts


def test_estimates_that_disagree_are_named():
    run = knee()
    row = run["estimates"]["least-squares"]["parameters"]["total.inertia"]
    row["value"] += 4.0 * TOTALS["total.inertia"][4]
    # 1.4 - 4 sds: 2.6, and then 3.6
    assert comparison({"knee": run}).contested == ()
    row["value"] += 1.0 * TOTALS["total.inertia"][4]
    assert comparison({"knee": run}).contested == ("total.inertia",)
    (told,) = [one for one in messages_of(run) if one.kind == "methods"]
    assert "total.inertia" in told.text


@pytest.mark.parametrize("bent", [True, False])
def test_a_total_by_a_parameters_name_is_not_held_against_it_where_losses_bend_it(bent):
    """Least squares has what a load loss adds in it; a UR10e's constant loss 15.5 for 10.6 N m."""
    run = knee()
    viscous = run["parameters"]["motor.viscous"]
    total = {"unit": viscous["unit"], "value": 1.5 * viscous["median"], "sd": viscous["sd"]}
    run["estimates"]["least-squares"]["parameters"]["motor.viscous"] = total
    if not bent:
        for group in ("parameters", "derived"):
            run[group] = {k: row for k, row in run[group].items() if "gearbox" not in k}
    found = comparison({"knee": run})
    cell = found["motor.viscous"].cells["least-squares"]
    assert cell.value == total["value"]
    assert (cell.disagreement is None) == bent
    assert ("load-dependent friction" in cell.remark) == bent
    assert ("motor.viscous" in found.contested) != bent


def test_estimates_of_another_run_saw_other_data():
    """The other run is another posterior's matter: its estimates are not told to be wrong."""
    other = loaded()
    rows = other["estimates"]["input-error"]["parameters"]
    rows["total.inertia"]["value"] *= 1.2
    found = comparison({"a": knee(), "b": other}, estimates=True)
    assert not [note for note in found.notes if "differs" in note]
    base, cell = (found["total.inertia"].cells[c] for c in ("a: posterior", "b: input-error"))
    expected = (cell.value - base.value) / math.hypot(base.sd, cell.sd)
    assert cell.disagreement == pytest.approx(expected, rel=1e-12)


def test_a_reference_without_sd_is_measured_in_the_posteriors():
    run = loaded()
    run["derived"]["total.inertia"]["median"] = 4.5e-4
    found = comparison({"b": run})
    assert found["total.inertia"].cells["posterior"].value == 4.5e-4  # the median
    row = run["parameters"]["load.first_moment"]
    cell = found["load.first_moment"].cells["reference"]
    assert cell.disagreement == pytest.approx((0.41 - row["mean"]) / row["sd"], rel=1e-12)
    assert cell.sd is None
    assert cell.remark == "CAD"


def test_the_sd_is_the_one_for_correlated_residuals():
    cell = comparison({"knee": knee()})["total.inertia"].cells["least-squares"]
    *_, plain, robust = TOTALS["total.inertia"]
    assert (cell.sd, cell.sd_plain, cell.accounts) == (robust, plain, True)
    run = knee()
    run["noise"] = {"model": "white", "parameters": ["noise.sigma"], "residual_lag1": 0.3}
    for row in run["estimates"]["least-squares"]["parameters"].values():
        row["sd_robust"] = None
    found = comparison({"white": run})
    cell = found["total.inertia"].cells["least-squares"]
    assert (cell.sd, cell.sd_plain, cell.accounts) == (plain, plain, False)
    # a posterior that takes noise for white says so
    assert not found["motor.inertia"].cells["posterior"].accounts


@pytest.mark.parametrize(
    ("noise", "method", "accounts"),
    [
        ({"model": "Student-t", "accounts_for_correlation": False}, "input-error", False),
        ({"model": "AR(1)", "order": 1, "accounts_for_correlation": True}, "input-error", True),
        ({"model": "whatever", "accounts_for_correlation": True}, "output-error", True),
    ],
)
def test_noise_accounts_for_correlation_where_it_has_a_memory(noise, method, accounts):
    run = knee() | {"noise": noise, "likelihood": {"method": method}}
    cell = comparison({"knee": run})["motor.inertia"].cells["posterior"]
    assert cell.accounts == accounts
    assert result_rows(run)["motor.inertia"] == replace(cell, disagreement=None)
    (row,) = (r for r in parameter_table(run).rows if r.name == "motor.inertia")
    assert row.accounts == accounts
    assert (row.sd_plain is None) == accounts


# -- what is shown, in which order


# -- what is open


def undetermined(found):
    return [
        (row.name, label, cell)
        for row in found.rows
        for label, cell in row.cells.items()
        if cell.status == "undetermined"
    ]


@pytest.mark.parametrize("runs", [{"a": knee()}, {"a": knee(), "b": loaded()}])
def test_open_numbers_carry_no_sd_and_no_interval(runs):
    for estimates in (False, True):
        found = comparison(runs, estimates=estimates)
        left = undetermined(found)
        assert {name for name, *_ in left} >= set(LEG)
        for _, _, cell in left:
            assert (cell.sd, cell.sd_plain, cell.interval, cell.level) == (None,) * 4
            assert cell.disagreement is None
            assert cell.remark.startswith("not determined")


def test_open_numbers_are_printed_nowhere():
    """Odd digits put into every sd and interval of the leg must not come out again."""
    run = knee()
    for name in LEG:
        run["parameters"][name] |= {"sd": 0.0717171, "interval": [0.1717171, 0.9717171]}
        for method in ("input-error", "output-error"):
            # a file that contradicts itself: not determined, yet with sds
            more = {"sd": 0.0717171, "sd_robust": 0.1717171}
            run["estimates"][method]["parameters"][name] |= more
    found = comparison({"a": run})
    everything = [text(found), comparison_csv(found)]
    everything.append(json.dumps(comparison_dict(found)))
    for told in everything:
        assert "717171" not in told
        assert not re.search(r"0?\.0?717\d*|0?\.1717|0?\.9717", told)
    for row in csv.DictReader(io.StringIO(comparison_csv(found))):
        if row["status"] == "undetermined":
            keys = ("sd", "sd_plain", "low", "high", "level", "limit", "disagreement")
            assert [row[key] for key in keys] == [""] * 7
            assert row["remark"].startswith("not determined")


def lost(run, method="output-error"):
    """Make an estimate one whose search ended at no minimum, as ``estimate_summary`` writes it."""
    table = run["estimates"][method]
    table["converged"] = False
    for row in table["parameters"].values():
        row |= {"sd": None, "sd_robust": None, "determined": False, "span": None}
    return run


def test_an_estimate_that_did_not_converge_is_told_in_its_own_column_only():
    sound, told = comparison({"a": loaded()}), comparison({"a": lost(loaded())})
    for name in (*TOTALS, *DERIVED, *MOTOR, *LEG):
        cells = dict(told[name].cells)
        cell = cells.pop("output-error")
        assert (cell.status, cell.converged) == ("undetermined", False)
        assert cell.remark == "the search has not converged"
        assert cells == {k: c for k, c in sound[name].cells.items() if k != "output-error"}


@pytest.mark.parametrize("span", [None, [0.0, 0.0]])
def test_on_a_bound(span):
    """Scaling a zero leaves it zero: a span without width is a bound, too."""
    run = knee()
    row = run["estimates"]["input-error"]["parameters"]["motor.viscous"]
    row |= {"value": 0.0, "sd": None, "sd_robust": None, "determined": False, "at_bound": "lower"}
    row["span"] = span
    cell = comparison({"a": run})["motor.viscous"].cells["input-error"]
    assert (cell.status, cell.sd, cell.remark) == ("bound", None, "at its lower bound")
    assert cell.span is None
    assert cell.disagreement == pytest.approx((0.0 - 3.8e-3) / 4.4e-4, rel=1e-9)


def test_what_is_known_is_no_result():
    one, two = knee(), knee()
    row = one["parameters"].pop("motor.viscous")
    for table in ("input-error", "output-error"):
        del one["estimates"][table]["parameters"]["motor.viscous"]
    one["fixed"] = {
        "motor.viscous": {"unit": row["unit"], "value": 4e-3},
        "motor.extra": {"unit": "", "value": 1.0},
    }
    found = comparison({"one": one, "two": two})
    cell = found["motor.viscous"].cells["one: posterior"]
    assert (cell.value, cell.status, cell.sd) == (4e-3, "known", None)
    assert "motor.extra" not in [row.name for row in found.rows]


def test_what_a_file_says_of_scaling_counts_more_than_a_guess():
    run = knee()
    run["parameters"]["motor.inertia"] |= {"verdict": "prior", "data_sd": None}
    row = comparison({"a": run})["motor.inertia"]
    assert row.gauge_free
    assert row.cells["input-error"].status == "determined"


# -- layouts


def test_a_table_that_is_filtered_by_status_does_not_pass_what_is_doubtful():
    run = loaded()
    doubted = {"verdict": "weak", "doubted": ["some"]}
    run["parameters"]["motor.inertia"] |= doubted
    limit = {"at_bound": "lower", "bound": 0.0, "data_sd": 1e-3, "prior_sd": 1.0}
    run["parameters"]["load.inertia"] |= doubted | limit
    rows = csv.DictReader(io.StringIO(comparison_csv(comparison({"run": run}))))
    status = {row["name"]: row["status"] for row in rows if row["column"] == "posterior"}
    assert (status["motor.inertia"], status["load.inertia"]) == ("doubtful", "doubtful")
    assert status["motor.viscous"] == "determined"


def test_csv_and_json_hold_the_same():
    found = comparison({"a": knee(), "b": loaded()}, estimates=True)
    record = json.loads(json.dumps(comparison_dict(found), allow_nan=False))
    rows = list(csv.DictReader(io.StringIO(comparison_csv(found))))
    assert len(rows) == sum(len(row.cells) for row in found.rows)
    for row in rows:
        cell = record["quantities"][row["name"]]["columns"][row["column"]]
        assert float(row["value"]) == cell["value"]
        assert row["sd"] == ("" if cell["sd"] is None else str(cell["sd"]))
        assert row["status"] == cell["status"]
