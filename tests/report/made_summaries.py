"""Invented summaries of the Rabbit knee: one recording, and the same with a known mass."""

import copy

from bayesfric.base import __version__

# name: unit, symbol, value, plain sd, sd for correlated residuals
TOTALS = {
    "total.inertia": ("kg m²", "J_t", 4.62e-4, 4.1e-7, 1.3e-6),
    "total.viscous": ("N m s", "f_t", 5.57e-3, 1.1e-5, 3.6e-5),
    "total.coulomb": ("N m", "C_t", 0.236, 9.4e-4, 3.1e-3),
    "total.offset": ("N m", r"\Delta C_t", -4.4e-3, 3.0e-4, 9e-4),
    "total.gravity": ("N m", r"ml\,g/(\alpha_m N)", 0.1127, 1.2e-3, 3.3e-3),
}
DERIVED = {
    "total_drive.inertia": ("kg m²", r"J_{t}^{\mathrm{drive}}", 4.681e-4, 5e-7, 1.2e-6),
    "total_drive.viscous": ("N m s", r"f_{t}^{\mathrm{drive}}", 5.70e-3, 1.0e-5, 2.4e-5),
    "total_drive.coulomb_positive": ("N m", r"C_{t1}^{\mathrm{drive}}", 0.2203, 9e-4, 2.2e-3),
    "total_drive.gravity": ("N m", r"G_{t}^{\mathrm{drive}}", 0.1128, 9e-4, 2.0e-3),
    "gearbox.lambda_ratio": ("", r"\lambda_1/\lambda_2", 2.74, 0.55, 0.9),
}
MOTOR = {
    "motor.inertia": ("kg m²", "J_{m}", 3.40e-4, 1.4e-5, 2.6e-5),
    "motor.viscous": ("N m s", "f_{m}", 3.8e-3, 2.5e-4, 4.4e-4),
}
# name: unit, symbol, value, span
LEG = {
    "gearbox.load_drive": ("", r"\mu_{1}", 0.30, (0.0, 0.65)),
    "joint.viscous": ("N m s", "f_{c}", 3.4, (2.5, 4.7)),
    "load.inertia": ("kg m²", "J_{c}", 0.24, (0.18, 0.34)),
    "load.first_moment": ("kg m", "ml", 0.42, (0.30, 0.57)),
}
# What estimates say that compare torques.
TORQUE = {
    "residual_unit": "N m",
    "assumption": "sd: uncorrelated residuals; sd_robust: correlated ones (HAC)",
}
# What else explains a torque, as a run tells it.
FOUND = {
    **{"kind": "spring", "severity": "doubt", "parameters": ["motor.viscous"], "p": 1 / 61},
    **{"hint": "mechanism.load.spring = true", "statistic": 9.0, "share": 0.123},
    **{"moves": {"motor.viscous": 2.0}, "shape": "", "rivals": []},
}


def posterior_row(unit, mean, sd, *, verdict="data", **more):
    row = {"unit": unit, "meaning": "made up", "mean": mean, "sd": sd, "median": mean}
    row |= {"interval": [mean - 1.645 * sd, mean + 1.645 * sd], "level": 0.9, "verdict": verdict}
    return row | more


def estimated(unit, symbol, value, sd, robust, kind, **more):
    row = {"unit": unit, "symbol": symbol, "meaning": "made up", "value": value, "sd": sd}
    row |= {"sd_robust": robust, "kind": kind, "gauge_free": True, "determined": True}
    return row | {"at_bound": None, "span": None, **more}


def left_open(name):
    unit, symbol, value, span = LEG[name]
    is_open = {"gauge_free": False, "determined": False, "span": list(span)}
    return estimated(unit, symbol, value, None, None, "parameter", **is_open)


def method(shift):
    """Return an estimate of everything: ``shift`` robust sds off."""
    rows = {}
    for kind, group in (("total", TOTALS), ("derived", DERIVED), ("parameter", MOTOR)):
        for name, (unit, symbol, value, sd, robust) in group.items():
            rows[name] = estimated(unit, symbol, value + shift * robust, sd, robust, kind)
    return rows | {name: left_open(name) for name in LEG}


def knee():
    """Return a run with all methods; the leg's parameters are open."""
    least_squares = {
        name: estimated(unit, symbol, value - 1.4 * robust, sd, robust, "total")
        for name, (unit, symbol, value, sd, robust) in TOTALS.items()
    }
    estimates = {
        "output-error": {
            "parameters": method(0.8), "residual_rms": 3.1e-4, "residual_unit": "rad",
            "assumption": "sd: encoder noise only; sd_robust: correlated residuals (HAC)",
            "notes": ["stopped after 12 iterations"],
        },
        "input-error": {"parameters": method(-0.6), "residual_rms": 6.3e-3, **TORQUE},
        "least-squares": {"parameters": least_squares, "residual_rms": 7.1e-3, **TORQUE},
    }  # fmt: skip
    parameters = {
        name: posterior_row(unit, value, sd, data_sd=sd, prior_sd=10 * value)
        for name, (unit, _, value, _, sd) in MOTOR.items()
    }
    parameters |= {
        name: posterior_row(unit, value, 0.15 * value, verdict="prior", data_sd=None)
        for name, (unit, _, value, _) in LEG.items()
    }
    return {
        "bayesfric": __version__,
        "parameters": parameters
        | {"noise.sigma": posterior_row("N m", 0.0063, 1e-4, data_sd=1e-4)},
        "derived": {
            name: posterior_row(unit, value, sd, gauge_free=True)
            for name, (unit, _, value, _, sd) in (DERIVED | TOTALS).items()
        },
        "estimates": estimates,
        "references": {
            "load.first_moment": {"value": 0.41, "sd": None, "unit": "kg m", "source": "CAD"},
            "motor.inertia": {"value": 3.32e-4, "sd": 1e-5, "unit": "kg m²", "source": "sheet"},
        },
        "likelihood": {"method": "input-error"},
        "noise": {"model": "AR(2)", "residual_lag1": 0.02, "accounts_for_correlation": True},
        "fit": {"residual_rms": 6.3e-3, "unit": "N m"},
        "sampler": {"status": "reliable"},
    }


def loaded():
    """Return a run in which a known mass was bolted on: nothing is open."""
    run = copy.deepcopy(knee())
    for name, (unit, _, value, _) in LEG.items():
        sd = 0.012 * value
        run["parameters"][name] = posterior_row(unit, 1.02 * value, sd, data_sd=sd, prior_sd=value)
        for table in ("input-error", "output-error"):
            rows = run["estimates"][table]["parameters"]
            rows[name] |= {"determined": True, "span": None, "sd": 0.4 * sd, "sd_robust": sd}
    for row in run["derived"].values():
        row["mean"] += 0.7 * row["sd"]
        row["median"] = row["mean"]
        row["interval"] = [end + 0.7 * row["sd"] for end in row["interval"]]
    return run


def failed(summary, *sound):
    """Return what the same run writes whose ensembles disagree on all but ``sound``."""
    run = copy.deepcopy(summary)
    run["sampler"]["status"] = "unusable"
    for name, row in [*run["derived"].items(), *run["parameters"].items()]:
        row["converged"] = name in sound
    return run


def every_kind():
    """Return a run with every kind of number there is."""
    run = copy.deepcopy(knee())
    rows = run["parameters"]
    rows["motor.coulomb_positive"] = posterior_row("N m", 0.02, 0.015, verdict="weak")
    rows["motor.coulomb_positive"] |= {"median": 0.016, "interval": [0.002, 0.051]}
    limit = {"at_bound": "lower", "data_sd": 0.01, "prior_sd": 1.0}
    rows["motor.coulomb_negative"] = posterior_row("N m", 0.02, 0.015, verdict="prior", **limit)
    rows["motor_50%.inertia"] = posterior_row("kg", 95123.0, 310.0)
    run["fixed"] = {"offset": {"unit": "N m", "value": -0.0213}}
    return run
