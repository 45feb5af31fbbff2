"""The simulator study's claims of accuracy, in small; its times are never tested."""

import numpy as np
import pytest

from tests.conftest import REPOSITORY, imported

pytestmark = pytest.mark.slow

NAMES = ["knee, square", "knee, slow sine", "Stribeck axis"]


@pytest.fixture(scope="module")
def study():
    return imported(REPOSITORY / "studies" / "simulator" / "compare.py")


@pytest.fixture(scope="module")
def solved(study):
    """Return case and ``solve_ivp`` at its tightest, by name and rate."""
    found = {}
    for rate in (100, 1000):
        for case in study.cases(float(rate), 2.6):
            found[case.name, rate] = case, study.reference(case)
    return found


def test_cases_reverse_stick_and_change_power_flow(solved):
    square, sine, axis = (solved[name, 100][1] for name in NAMES)
    assert square.stops >= 4
    assert square.turns >= 4  # the leg drives the motor for a while before each stop
    assert np.mean(sine.sticking) > 0.2
    assert axis.stops >= 3
    assert axis.turns >= 3
    assert axis.sticking.any()


@pytest.mark.parametrize("rate", [100, 1000])
@pytest.mark.parametrize("name", NAMES)
def test_agrees_with_solve_ivp(study, solved, name, rate):
    case, truth = solved[name, rate]
    found = study.agreement(case, truth)
    # the claim is 1e-8; the default step control aims at a change of 1e-9 and stays below it
    assert found["error"] < 1e-9
    # 64 steps a sample leave less than 1e-12 even at 10 ms; solve_ivp was asked for 1e-13
    assert found["error_finest"] < 3e-12
    # the same samples stick: a breakaway within rounding of a sample might differ, none is
    assert found["sticking_differs"] == 0
    # Runge-Kutta's error per speed is a hundred times larger near the fast events
    assert found["error_qd"] < 1e-8


@pytest.mark.parametrize("rate", [100, 1000])
@pytest.mark.parametrize("name", NAMES)
def test_step_control_reports_the_true_error(study, solved, name, rate):
    found = study.agreement(*solved[name, rate])
    # Richardson's estimate is exact for a pure fourth order; the floor is the rival's own error
    assert found["step_error"] == pytest.approx(found["error"], rel=0.5, abs=2e-14)
    assert found["encoder_over_error"] > 1e5


def test_rivals_settings_converge_to_the_reference(study, solved):
    """Neither the method nor where it starts afresh changes what it converges to."""
    case, truth = solved["knee, square", 100]
    for method, rtol, restart, close in (
        ("RK45", 1e-11, "every sample", 1e-10),
        ("LSODA", 1e-11, "every sample", 1e-7),
        ("LSODA", 1e-11, "events", 1e-8),
        ("Radau", 1e-9, "corners", 1e-6),
    ):
        # local tolerances add up over the calls; LSODA starts each at first order
        assert study.largest(study.solve(case, method, rtol, restart).q, truth.q) < close, method
    compiled = study.solve(case, "RK45", 1e-8, "corners", study.compiled_fields(case))
    plain = study.solve(case, "RK45", 1e-8, "corners")
    # one formula written twice: only the order of rounding differs
    assert study.largest(compiled.q, plain.q) < 1e-10
