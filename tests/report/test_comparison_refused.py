"""Summaries that hold something else, and runs that cannot stand side by side."""

import copy

import pytest

from bayesfric.base.errors import BadInput
from bayesfric.report.comparison.comparison import comparison

from .made_summaries import estimated, knee, posterior_row


def refused(summaries, *parts):
    with pytest.raises(BadInput) as caught:
        comparison(summaries)
    for part in parts:
        assert part in str(caught.value), str(caught.value)
    for foreign in ("Input should", "pydantic", "<class"):
        assert foreign not in str(caught.value)


INERTIA = "parameters.motor.inertia"


def put(key, value):
    """Change the posterior's motor inertia."""
    return lambda run: run["parameters"]["motor.inertia"].update({key: value})


@pytest.mark.parametrize(
    ("change", "parts"),
    [
        (lambda r: r.pop("parameters"), ["parameters", "is missing"]),
        (lambda r: r.update(parameters=[1, 2]), ["parameters", "[1, 2]"]),
        (
            lambda r: r["parameters"]["motor.inertia"].pop("mean"),
            [f"{INERTIA}.mean", "is missing"],
        ),
        (put("mean", "3e-4"), [f"{INERTIA}.mean", "'3e-4'"]),
        (put("sd", -1.0), [f"{INERTIA}.sd", "-1.0"]),
        (put("mean", float("inf")), [f"{INERTIA}.mean", "inf"]),
        (put("mean", 10**400), [f"{INERTIA}.mean"]),
        (put("mean", True), [f"{INERTIA}.mean", "true"]),
        (put("interval", [1.0]), [f"{INERTIA}.interval"]),
        (put("verdict", "maybe"), [f"{INERTIA}.verdict", "'maybe'"]),
        (lambda r: r["estimates"].update(guess={"parameters": {}}), ["estimates", "guess"]),
        (lambda r: r.update(references={"motor.inertia": 3.3e-4}), ["references.motor.inertia"]),
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


def test_units_that_differ_between_runs():
    other = knee()
    for row in (
        other["derived"]["total.coulomb"],
        *(e["parameters"]["total.coulomb"] for e in other["estimates"].values()),
    ):
        row["unit"] = "N"
    refused({"a": knee(), "b": other}, "b: total.coulomb", "'N'", "'N m'", "in a")


def test_runs_with_nothing_in_common():
    other = {
        "parameters": {"axis.coulomb": posterior_row("N", 3.0, 0.1, data_sd=0.1)},
        "estimates": {
            "least-squares": {
                # shared, but not shown
                "parameters": {"total.x": estimated("N", "x", 1.0, 0.1, 0.1, "total")}
            }
        },
    }
    third = copy.deepcopy(other)
    refused({"a": knee(), "b": other}, "in common")
    refused({"b": other, "c": third, "a": knee()}, "a: has no quantity in common")
    assert comparison({"b": other, "c": third}).rows


def test_a_run_without_results():
    refused({"a": {"parameters": {}}}, "a: holds no result")
    refused({"a": knee(), "b": {"parameters": {}}}, "b: holds no result")
