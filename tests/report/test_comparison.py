"""Side by side: the arithmetic, what is open stays without numbers, what cannot be compared."""

import copy
import csv
import io
import json
import math
import re
from dataclasses import replace

import pytest

from bayesfric.base.errors import BadInput
from bayesfric.report.comparison.comparison import comparison, comparison_dict, comparison_text
from bayesfric.report.paper.tables import comparison_csv
from bayesfric.report.result_row import result_rows
from bayesfric.report.terminal import messages_of

from .made_summaries import DERIVED, LEG, MOTOR, TOTALS, estimated, knee, loaded, posterior_row


def cell(runs, name, column="posterior"):
    return comparison(runs)[name].cells[column]


# -- arithmetic


def test_disagreement_of_an_estimate_is_in_the_larger_sd():
    compared = comparison({"knee": knee()})
    assert compared.baseline == "posterior"
    for name in (*TOTALS, *DERIVED, *MOTOR):
        cells = compared[name].cells
        # made so: 0.6 sds below, 0.8 above; both sds are the same
        assert cells["input-error"].disagreement == pytest.approx(-0.6, abs=1e-9)
        assert cells["output-error"].disagreement == pytest.approx(0.8, abs=1e-9)
        assert cells["posterior"].disagreement is None
    run = knee()
    run["estimates"]["output-error"]["parameters"]["motor.inertia"]["sd_robust"] *= 4.0
    wide = cell({"knee": run}, "motor.inertia", "output-error")
    assert wide.disagreement == pytest.approx(0.2, abs=1e-9)


def test_disagreement_of_references_and_runs_adds_their_variance():
    compared = comparison({"a": knee(), "b": loaded()})
    # data sheet 3.32e-4 +- 1e-5 against 3.40e-4 +- 2.6e-5
    expected = (3.32 - 3.40) / math.hypot(0.26, 0.10)
    reference = compared["motor.inertia"].cells["reference"]
    assert reference.disagreement == pytest.approx(expected, rel=1e-9)
    for name in DERIVED:
        # 0.7 sds apart, both sds the same
        other = compared[name].cells["b: posterior"]
        assert other.disagreement == pytest.approx(0.7 / math.sqrt(2), rel=1e-6)
    # a reference without an sd is measured in the posterior's
    run = loaded()
    row, cad = (
        run["parameters"]["load.first_moment"],
        cell({"b": run}, "load.first_moment", "reference"),
    )
    assert (cad.sd, cad.remark) == (None, "CAD")
    assert cad.disagreement == pytest.approx((0.41 - row["mean"]) / row["sd"], rel=1e-12)


def test_totals_of_the_motion_and_limits_are_not_measured_everywhere():
    a, b = knee(), loaded()
    b["derived"]["total.inertia"]["of_motion"] = True
    assert cell({"a": a, "b": b}, "total.inertia", "b: posterior").disagreement is None
    assert cell({"a": a, "b": b}, "total.viscous", "b: posterior").disagreement is not None
    # of one recording the methods have one motion
    assert cell({"b": b}, "total.inertia", "input-error").disagreement is not None
    # the same run's estimates know no limit
    assert cell({"a": a}, "motor.viscous", "input-error").disagreement is not None
    a["parameters"]["motor.viscous"] |= {"at_bound": "lower", "bound": 0.0}
    assert cell({"a": a}, "motor.viscous", "input-error").disagreement is None


def test_estimates_that_disagree_are_named():
    run = knee()
    row = run["estimates"]["least-squares"]["parameters"]["total.inertia"]
    for sds, contested in ((4.0, ()), (1.0, ("total.inertia",))):
        row["value"] += sds * TOTALS["total.inertia"][4]
        # 1.4 - 4 sds: 2.6, and then 3.6
        assert comparison({"knee": run}).contested == contested
    (message,) = [message for message in messages_of(run) if message.kind == "methods"]
    assert "total.inertia" in message.text


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
    compared = comparison({"knee": run})
    least_squares = compared["motor.viscous"].cells["least-squares"]
    assert least_squares.value == total["value"]
    assert (least_squares.disagreement is None) == bent
    assert ("load-dependent friction" in least_squares.remark) == bent
    assert ("motor.viscous" in compared.contested) != bent


def test_estimates_of_another_run_saw_other_data():
    """The other run is another posterior's matter: its estimates are not said to be wrong."""
    other = loaded()
    other["estimates"]["input-error"]["parameters"]["total.inertia"]["value"] *= 1.2
    compared = comparison({"a": knee(), "b": other}, estimates=True)
    assert not [note for note in compared.notes if "differs" in note]
    cells = compared["total.inertia"].cells
    base, estimate = cells["a: posterior"], cells["b: input-error"]
    expected = (estimate.value - base.value) / math.hypot(base.sd, estimate.sd)
    assert estimate.disagreement == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("robust", [TOTALS["total.inertia"][4], None])
def test_the_sd_is_the_one_for_correlated_residuals(robust):
    *_, plain, _ = TOTALS["total.inertia"]
    run = knee()
    run["estimates"]["least-squares"]["parameters"]["total.inertia"]["sd_robust"] = robust
    shown = cell({"white": run}, "total.inertia", "least-squares")
    assert (shown.sd, shown.plain) == (robust or plain, not robust)


WHITE = {"model": "white", "accounts_for_correlation": False}
TRIED = [{"order": k, "bic": 4.0 * k} for k in range(3)]


@pytest.mark.parametrize(
    ("noise", "accounts"),
    [
        ({"model": "white", "parameters": ["noise.sigma"], "residual_lag1": 0.3}, False),
        ({"model": "Student-t", "accounts_for_correlation": False}, False),
        ({"model": "AR(1)", "order": 1, "accounts_for_correlation": True}, True),
        # white noise accounts for it where it was chosen, and passes
        (WHITE | {"innovation_whiteness": {"test": "", "white": True}}, False),
        (WHITE | {"innovation_whiteness": {"white": True}, "order_chosen_from": TRIED}, True),
        (WHITE | {"innovation_whiteness": {"white": False}, "order_chosen_from": TRIED}, False),
    ],
)
def test_a_posterior_accounts_for_correlation_where_its_noise_does(noise, accounts):
    run = knee() | {"noise": noise}
    shown = cell({"knee": run}, "motor.inertia")
    assert shown.plain != accounts
    assert result_rows(run)["motor.inertia"] == replace(shown, disagreement=None)


# -- how far runs are apart


def test_runs_that_are_far_apart_are_named():
    other = loaded()
    assert not comparison({"a": knee(), "b": other}).runs_apart
    name = next(iter(DERIVED))
    row = other["derived"][name]
    by = 10.0 * row["sd"]
    row |= {"median": row["median"] + by, "interval": [end + by for end in row["interval"]]}
    compared = comparison({"a": knee(), "b": other})
    (note,) = compared.runs_apart
    far = compared[name].cells["b: posterior"].disagreement
    assert far == pytest.approx((10.0 + 0.7) / math.sqrt(2), rel=1e-6)
    assert f"{name} ({far:+.1f} sd)" in note
    assert compared.notes[0] == note
    # what a run doubts itself says nothing of the joint
    row["doubted"] = ["delay"]
    assert not comparison({"a": knee(), "b": other}).runs_apart


def _coulomb(median, low, high, sd, **more):
    run, row = knee(), posterior_row("N m", median, sd, **more)
    run["parameters"]["motor.coulomb"] = row | {"interval": [low, high]}
    return run


LIMIT = _coulomb(0.004, 0.0003, 0.0115, 0.0035, at_bound="lower", bound=0.0)


@pytest.mark.parametrize(
    ("first", "median", "half", "facing", "apart"),
    [
        # one long tail, away from the other run, made an sd that hid that nothing overlaps
        (_coulomb(0.147, 0.078, 0.468, 0.13), 0.02, 0.0165, 0.147 - 0.078, False),
        (_coulomb(0.147, 0.078, 0.468, 0.13), 0.9, 0.0165, 0.468 - 0.147, True),
        # a limit may be far from what another run determines
        (LIMIT, 0.147, 0.0658, 0.0115 - 0.004, True),
        (LIMIT, 0.006, 0.0033, 0.0115 - 0.004, False),
    ],
)
def test_the_side_that_faces_the_other_counts(first, median, half, facing, apart):
    second = _coulomb(median, median - half, median + half, half / 1.645)
    middle = first["parameters"]["motor.coulomb"]["median"]
    expected = (median - middle) / (math.hypot(facing, half) / 1.645)
    for runs, sign in (((first, second), 1.0), ((second, first), -1.0)):
        compared = comparison(dict(zip("ab", runs, strict=True)))
        far = compared["motor.coulomb"].cells["b: posterior"].disagreement
        assert far == pytest.approx(sign * expected, rel=1e-4)
        assert bool(compared.runs_apart) == apart


# -- what is open


def test_open_numbers_have_no_sd_no_interval_and_are_printed_nowhere():
    """Odd digits put into every sd and interval of the leg must not come out again."""
    run = knee()
    for name in LEG:
        run["parameters"][name] |= {"sd": 0.0717171, "interval": [0.1717171, 0.9717171]}
        for method in ("input-error", "output-error"):
            # a file that contradicts itself: not determined, yet with sds
            sds = {"sd": 0.0717171, "sd_robust": 0.1717171}
            run["estimates"][method]["parameters"][name] |= sds
    for runs in ({"a": run}, {"a": run, "b": loaded()}):
        compared = comparison(runs, estimates=True)
        cells = [(row.name, c) for row in compared.rows for c in row.cells.values()]
        left = [(name, c) for name, c in cells if c.status == "unidentified"]
        assert {name for name, _ in left} == set(LEG)
        for _, shown in left:
            numbers = shown.sd, shown.interval, shown.limit, shown.disagreement
            assert numbers == (None,) * 4
            assert shown.remark.startswith("not determined")
        views = ["\n".join(comparison_text(compared)), comparison_csv(compared)]
        for text in (*views, json.dumps(comparison_dict(compared))):
            assert not re.search(r"0?\.0?717\d*|0?\.1717|0?\.9717|717171", text)


def test_an_estimate_that_did_not_converge_is_open_in_its_own_column_only():
    run = loaded()
    run["estimates"]["output-error"]["converged"] = False
    for row in run["estimates"]["output-error"]["parameters"].values():
        row |= {"sd": None, "sd_robust": None, "determined": False, "span": None}
    sound, lost = comparison({"a": loaded()}), comparison({"a": run})
    for name in (*TOTALS, *DERIVED, *MOTOR, *LEG):
        cells = dict(lost[name].cells)
        shown = cells.pop("output-error")
        assert (shown.status, shown.converged) == ("unidentified", False)
        assert shown.remark == "the search has not converged"
        assert cells == {k: c for k, c in sound[name].cells.items() if k != "output-error"}


@pytest.mark.parametrize("span", [None, [0.0, 0.0]])
def test_on_a_bound(span):
    """Scaling a zero leaves it zero: a span without width is a bound, too."""
    run = knee()
    row = run["estimates"]["input-error"]["parameters"]["motor.viscous"]
    row |= {"value": 0.0, "sd": None, "sd_robust": None, "determined": False, "at_bound": "lower"}
    row["span"] = span
    shown = cell({"a": run}, "motor.viscous", "input-error")
    assert (shown.status, shown.sd, shown.span) == ("bound", None, None)
    assert shown.disagreement == pytest.approx((0.0 - 3.8e-3) / 4.4e-4, rel=1e-9)


def test_what_is_known_is_no_result():
    first, second = knee(), knee()
    unit = first["parameters"].pop("motor.viscous")["unit"]
    for table in ("input-error", "output-error"):
        del first["estimates"][table]["parameters"]["motor.viscous"]
    extra = {"unit": "", "value": 1.0}
    first["fixed"] = {"motor.viscous": {"unit": unit, "value": 4e-3}, "motor.extra": extra}
    compared = comparison({"one": first, "two": second})
    shown = compared["motor.viscous"].cells["one: posterior"]
    assert (shown.value, shown.status, shown.sd) == (4e-3, "known", None)
    assert "motor.extra" not in [row.name for row in compared.rows]


# -- layouts


def test_csv_and_json_hold_the_same():
    run = loaded()
    doubted = {"verdict": "weak", "doubted": ["some"]}
    run["parameters"]["motor.inertia"] |= doubted
    limit = {"at_bound": "lower", "bound": 0.0, "data_sd": 1e-3, "prior_sd": 1.0}
    run["parameters"]["load.inertia"] |= doubted | limit
    compared = comparison({"a": knee(), "b": run}, estimates=True)
    record = json.loads(json.dumps(comparison_dict(compared), allow_nan=False))["rows"]
    rows = list(csv.DictReader(io.StringIO(comparison_csv(compared))))
    assert len(rows) == len(compared.cells)
    for row, stored in zip(rows, record, strict=True):
        assert (float(row["value"]), row["status"]) == (stored["value"], stored["status"])
        assert row["sd"] == ("" if stored["sd"] is None else str(stored["sd"]))
    doubtful = {row["name"] for row in rows if row["status"] == "doubtful"}
    assert doubtful == {"motor.inertia", "load.inertia"}


# -- what cannot be compared


def refused(summaries, *parts):
    with pytest.raises(BadInput) as caught:
        comparison(summaries)
    for part in parts:
        assert part in str(caught.value)
    assert not re.search("Input should|pydantic|<class", str(caught.value))


def put(key, value):
    """Change the posterior's motor inertia."""
    return lambda run: run["parameters"]["motor.inertia"].update({key: value})


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda r: r.pop("parameters"), ["parameters", "is missing"]),
        (lambda r: r.update(parameters=[1, 2]), ["parameters", "[1, 2]"]),
        (put("mean", "3e-4"), ["parameters.motor.inertia.mean", "'3e-4'"]),
        (put("sd", -1.0), ["parameters.motor.inertia.sd", "-1.0"]),
        (put("mean", True), ["parameters.motor.inertia.mean", "true"]),
        (put("verdict", "maybe"), ["parameters.motor.inertia.verdict", "'maybe'"]),
        (lambda r: r["estimates"].update(guess={"parameters": {}}), ["estimates", "guess"]),
        (
            lambda r: r["references"]["motor.inertia"].update(unit="g m²"),
            ["references.motor.inertia", "'g m²'", "'kg m²'"],
        ),
        (put("unit", "kg"), ["motor.inertia", "'kg'", "'kg m²'"]),
    ],
)
def test_summaries_that_hold_something_else(change, parts):
    run = knee()
    change(run)
    refused({"a run": run}, "a run", *parts)


def test_runs_that_cannot_be_compared():
    other = knee()
    estimates = [e["parameters"]["total.coulomb"] for e in other["estimates"].values()]
    for row in (other["derived"]["total.coulomb"], *estimates):
        row["unit"] = "N"
    refused({"a": knee(), "b": other}, "b: total.coulomb", "'N'", "'N m'")
    # shared, but not shown
    total = {"parameters": {"total.x": estimated("N", "x", 1.0, 0.1, 0.1, "total")}}
    other = {"parameters": {"axis.coulomb": posterior_row("N", 3.0, 0.1, data_sd=0.1)}}
    other["estimates"] = {"least-squares": total}
    third = copy.deepcopy(other)
    refused({"a": knee(), "b": other}, "in common")
    refused({"b": other, "c": third, "a": knee()}, "a: has no quantity in common")
    assert comparison({"b": other, "c": third}).rows
    refused({"a": {"parameters": {}}}, "a: holds no result")
    refused({"a": knee(), "b": {"parameters": {}}}, "b: holds no result")
