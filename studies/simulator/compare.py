"""Compare the forward simulator with SciPy's ``solve_ivp`` with events: accuracy, order, speed.

``python studies/simulator/compare.py`` prints the tables of the README, writes
``result.json`` and ``figures/simulator/work-precision``. Everything is simulated.

The rival's model implements the paper's equations independently and shares no code with
``bayesfric``.
"""

from __future__ import annotations

import json
import math
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numba
import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.experiment import current_loop, sine, square
from bayesfric.mechanism.forward import Motion, simulate, simulate_segments
from bayesfric.mechanism.joint import Joint

Array = NDArray[np.float64]
Restart = Literal["every sample", "corners", "events"]

FOLDER = Path(__file__).parent
ROOT = FOLDER.parents[1]
GRAVITY = 9.80665  # m/s²
ENCODER = 2.0 * math.pi / 8192 / 50  # rad at the joint: 8192 counts on the motor shaft, N = 50
LEVELS = {"encoder/10": ENCODER / 10.0, "1e-6": 1e-6, "1e-8": 1e-8}  # rad, largest error
METHODS = ("RK45", "DOP853", "LSODA", "Radau")
TOLERANCES = tuple(10.0 ** (-k / 2) for k in range(8, 23))  # 1e-4 to 1e-11
SUBSTEPS = (1, 2, 4, 8, 16, 32)
TIGHT = 1e-13


# --- the rival's model: eqs. (2) to (9) -----------------------------------------------


@dataclass(frozen=True)
class Plant:
    """Motor, gearbox and leg; dry losses are (forwards, backwards), all SI."""

    motor_inertia: float
    motor_viscous: float
    motor_dry: tuple[float, float]
    ratio: float
    drive: float  # mu_1
    back: float  # mu_2
    gear_dry: float
    rise: float  # Stribeck rise c of the gearbox
    rise_speed: float  # rad/s at its input, Stribeck velocity
    joint_viscous: float
    joint_dry: tuple[float, float]
    inertia: float
    moment: float  # m l, kg m

    def breakaway(self, q: float) -> tuple[float, float]:
        """Return the motor torques between which the joint sticks."""

        def needed(sign: float) -> float:
            side = 0 if sign > 0 else 1
            rise = 1.0 + self.rise
            passed = (
                sign * self.joint_dry[side] + GRAVITY * self.moment * math.sin(q)
            ) / self.ratio
            mu = self.drive if passed * sign > 0 else -self.back
            return passed * (1.0 + mu * rise) + sign * (self.gear_dry * rise + self.motor_dry[side])

        return needed(-1.0), needed(1.0)

    def branch(
        self, torque: Callable[[float], float], sign: float, drives: bool
    ) -> tuple[Callable[..., Any], Callable[..., Any], Callable[..., Any]]:
        """Return the right-hand side for fixed direction and power flow, and its end events.

        Plain floats: arrays of two numbers would be several times slower.
        """
        n, jm, jc = self.ratio, self.motor_inertia * self.ratio, self.inertia
        side = 0 if sign > 0 else 1
        motor, gear = sign * self.motor_dry[side], sign * self.gear_dry
        joint, fc = sign * self.joint_dry[side], self.joint_viscous
        fm, weight = self.motor_viscous * n, GRAVITY * self.moment
        mu, c, scale = self.drive if drives else -self.back, self.rise, n / self.rise_speed
        toward = sign if drives else -sign
        sin, exp = math.sin, math.exp

        def field(t: float, y: Array) -> list[float]:
            q, v = y.tolist()
            r = 1.0 + c * exp(-((scale * v) ** 2)) if c else 1.0
            k = (1.0 + mu * r) / n
            loss = motor + fm * v + gear * r + k * (joint + fc * v + weight * sin(q))
            return [v, (torque(t) - loss) / (jm + k * jc)]

        def stop(t: float, y: Array) -> float:  # noqa: ARG001
            return sign * float(y[1])

        def turn(t: float, y: Array) -> float:
            # Where the gearbox transmits no torque, the leg determines qdd, and so the motor
            # torque. More torque drives, less is back-driven.
            q, v = y.tolist()
            r = 1.0 + c * exp(-((scale * v) ** 2)) if c else 1.0
            free = -(joint + fc * v + weight * sin(q)) / jc
            return toward * (torque(t) - (jm * free + motor + fm * v + gear * r))

        for event in (stop, turn):
            event.terminal, event.direction = True, -1.0  # type: ignore[attr-defined]
        return field, stop, turn

    def chain(self) -> tuple[Joint, Array]:
        """Return the same mechanism as a ``bayesfric`` joint and its parameter vector."""
        chain = Joint(
            elements=(
                Element("motor", inertia=True, coulomb="by-direction", viscous=True),
                Element(
                    "gearbox", ratio=self.ratio, coulomb="symmetric", stribeck=True, load_loss="two"
                ),
                Element("joint", coulomb="by-direction", viscous=True),
            ),
            load=Load(inertia=True, first_moment=True),
        )
        return chain, chain.vector(
            {
                "motor.inertia": self.motor_inertia,
                "motor.viscous": self.motor_viscous,
                "motor.coulomb_positive": self.motor_dry[0],
                "motor.coulomb_negative": self.motor_dry[1],
                "gearbox.coulomb": self.gear_dry,
                "gearbox.stribeck_ratio": self.rise,
                "gearbox.stribeck_velocity": self.rise_speed,
                "gearbox.load_drive": self.drive,
                "gearbox.load_back": self.back,
                "joint.viscous": self.joint_viscous,
                "joint.coulomb_positive": self.joint_dry[0],
                "joint.coulomb_negative": self.joint_dry[1],
                "load.inertia": self.inertia,
                "load.first_moment": self.moment,
            }
        )


def compiled_fields(case: Case) -> dict[tuple[float, bool], Callable[..., Any]]:
    """Return the same right-hand sides compiled by Numba: a faster rival."""
    p, period, torque = case.plant, case.period, case.torque
    rate = np.diff(torque) / period

    def branch(sign: float, drives: bool) -> Callable[..., Any]:
        side = 0 if sign > 0 else 1
        n, jm, jc = p.ratio, p.motor_inertia * p.ratio, p.inertia
        motor, gear, joint = sign * p.motor_dry[side], sign * p.gear_dry, sign * p.joint_dry[side]
        fc, fm, weight = p.joint_viscous, p.motor_viscous * n, GRAVITY * p.moment
        mu, c, scale = p.drive if drives else -p.back, p.rise, n / p.rise_speed

        @numba.njit(error_model="numpy")
        def field(t, y):  # type: ignore[no-untyped-def]
            # everything except t and y is a compile-time constant
            i = min(int(t / period), rate.size - 1)
            q, v = y[0], y[1]
            r = 1.0 + c * math.exp(-((scale * v) ** 2)) if c != 0.0 else 1.0
            k = (1.0 + mu * r) / n
            loss = motor + fm * v + gear * r + k * (joint + fc * v + weight * math.sin(q))
            out = np.empty(2)
            out[0] = v
            out[1] = (torque[i] + rate[i] * (t - i * period) - loss) / (jm + k * jc)
            return out

        return field

    return {(s, d): branch(s, d) for s in (1.0, -1.0) for d in (True, False)}


# --- the rival's integration ----------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A mechanism and the motor torque that acts on it, linear between samples."""

    name: str
    plant: Plant
    torque: Array
    period: float

    @property
    def times(self) -> Array:
        """Return the times of the samples, s."""
        return np.arange(self.torque.size) * self.period


@dataclass
class Solved:
    """The rival's solution at the samples."""

    q: Array
    qd: Array
    sticking: NDArray[np.bool_]
    calls: int = 0  # of solve_ivp
    evaluations: int = 0  # of the right-hand side
    stops: int = 0
    turns: int = 0


def borders(case: Case, restart: Restart) -> Array:
    """Return the times at which the rival restarts because of a corner of the torque.

    ``corners``: where the torque's rate jumps by more than 1 % of its largest jump. Elsewhere
    the step control handles it, as it does everywhere with ``events``.
    """
    times = case.times
    if restart == "every sample":
        return times[1:]
    if restart == "events":
        return times[-1:]
    jumps = np.abs(np.diff(case.torque, 2))
    return np.append(times[1:-1][jumps > 0.01 * jumps.max()], times[-1])


def solve(
    case: Case,
    method: str,
    rtol: float,
    restart: Restart,
    compiled: dict[tuple[float, bool], Callable[..., Any]] | None = None,
) -> Solved:
    """Integrate with ``solve_ivp`` from event to event, sticking handled in between.

    ``compiled`` are right-hand sides that replace the Python ones.
    """
    plant, period, times = case.plant, case.period, case.times
    ends = borders(case, restart)
    start, last = case.torque.tolist(), case.torque.size - 2
    rate = (np.diff(case.torque) / period).tolist()

    def torque(t: float) -> float:
        i = min(int(t / period), last)
        return start[i] + rate[i] * (t - i * period)

    branches = {(s, d): plant.branch(torque, s, d) for s in (1.0, -1.0) for d in (True, False)}
    fields = compiled or {key: branch[0] for key, branch in branches.items()}
    solution = Solved(
        *(np.zeros(times.size) for _ in range(2)), np.zeros(times.size, dtype=np.bool_)
    )
    state, t, done = np.zeros(2), 0.0, 0  # done: samples before this one are written
    sign, drives = 0.0, True
    while True:
        if sign == 0.0:  # standstill until the torque exceeds friction
            low, high = plant.breakaway(float(state[0]))
            t_off, sign = _moves_off(case, t, low, high)
            # the sample of the breakaway belongs to the motion
            end = times.size if sign == 0.0 else int(np.searchsorted(times, t_off, "left"))
            solution.q[done:end], solution.sticking[done:end] = state[0], True
            if sign == 0.0:
                return solution
            t, done = t_off, max(done, end)
            if done < times.size and times[done] <= t:
                solution.q[done], done = state[0], done + 1
            drives = branches[sign, True][2](t, state) > 0.0
        border = float(ends[min(np.searchsorted(ends, t, "right"), ends.size - 1)])
        if t >= border:
            return solution
        stop = int(np.searchsorted(times, border, "right"))
        stamps = times[done:stop]
        solved = solve_ivp(
            fields[sign, drives],
            (t, border),
            state,
            method,
            # a single sample at the border needs no interpolation
            t_eval=stamps if stamps.size > 1 else None,
            events=branches[sign, drives][1:],
            rtol=rtol,
            atol=rtol,
            first_step=border - t if restart == "every sample" and rtol > TIGHT else None,
        )
        solution.calls += 1
        solution.evaluations += solved.nfev
        if solved.status < 0:
            raise RuntimeError(solved.message)
        if solved.status == 0:
            t, state = border, solved.y[:, -1]
            written = stamps.size
        else:
            which = 0 if solved.t_events[0].size else 1
            t, state = float(solved.t_events[which][-1]), solved.y_events[which][-1].copy()
            written = int(np.searchsorted(stamps, t, "left"))
            if which == 0:
                solution.stops += 1
                state[1], sign = 0.0, 0.0
            else:
                solution.turns += 1
                drives = not drives
        if stamps.size > 1 and written:
            solution.q[done : done + written] = solved.y[0, :written]
            solution.qd[done : done + written] = solved.y[1, :written]
        elif written:
            solution.q[done], solution.qd[done] = state if solved.status == 0 else solved.y[:, -1]
        done += written
        if solution.calls > 50 * times.size:
            raise RuntimeError("no progress")


def _moves_off(case: Case, t: float, low: float, high: float) -> tuple[float, float]:
    """Return when after ``t`` the torque leaves the two limits, and the direction."""
    tau, times = case.torque, case.times
    now = float(np.interp(t, times, tau))
    if now > high or now < low:
        return t, math.copysign(1.0, now - low)
    first = int(np.searchsorted(times, t, "right"))
    beyond = np.flatnonzero((tau[first:] > high) | (tau[first:] < low))
    if beyond.size == 0:
        return math.inf, 0.0
    j = first + int(beyond[0])
    limit = high if tau[j] > high else low
    left = times[j - 1] + case.period * (limit - tau[j - 1]) / (tau[j] - tau[j - 1])
    return max(t, float(left)), 1.0 if tau[j] > high else -1.0


# --- cases ----------------------------------------------------------------------------

# Table 3 of the paper; mu from its alpha by eq. (6)
KNEE = Plant(
    motor_inertia=3.56e-4,
    motor_viscous=4.0e-3,
    motor_dry=(0.087, 0.091),
    ratio=50.0,
    drive=1.0 / 0.7432 - 1.0,
    back=1.0 - 1.0 / 1.408,
    gear_dry=0.0,
    rise=0.0,
    rise_speed=1.0,
    joint_viscous=3.12,
    joint_dry=(5.03, 5.15),
    inertia=0.206,
    moment=0.42,
)
# Fictitious: Stribeck on Coulomb and load-dependent friction, eq. (2)
STRIBECK = Plant(
    motor_inertia=2.0e-4,
    motor_viscous=1.0e-3,
    motor_dry=(0.02, 0.025),
    ratio=30.0,
    drive=0.25,
    back=0.30,
    gear_dry=0.05,
    rise=0.4,
    rise_speed=3.0,
    joint_viscous=1.0,
    joint_dry=(1.5, 1.2),
    inertia=0.3,
    moment=0.3,
)


def cases(rate: float, seconds: float) -> list[Case]:
    """Return the three cases at ``rate`` samples a second."""
    period = 1.0 / rate
    t = np.arange(round(seconds * rate) + 1) * period
    return [
        Case("knee, square", KNEE, current_loop(square(t, 0.8, 1.0), period, 5e-3), period),
        Case("knee, slow sine", KNEE, sine(t, 0.4, 0.5), period),
        Case("Stribeck axis", STRIBECK, sine(t, 0.45, 0.8), period),
    ]


def reference(case: Case) -> Solved:
    """Return the most accurate solution, restarted at every sample."""
    return solve(case, "DOP853", TIGHT, "every sample")


def mine(case: Case, substeps: int | None = None) -> Motion:
    chain, values = case.plant.chain()
    return simulate(chain, values, case.torque, case.period, substeps=substeps)


def largest(a: Array, b: Array) -> float:
    return float(np.max(np.abs(a - b)))


# --- what is measured -----------------------------------------------------------------


def order(case: Case, truth: Solved, substeps: Sequence[int] = SUBSTEPS) -> dict[str, Any]:
    """Return errors against the rival as the simulator's step is halved."""
    errors = [largest(mine(case, n).q, truth.q) for n in substeps]
    halvings = [math.log2(a / b) for a, b in pairwise(errors)]
    return {"case": case.name, "substeps": list(substeps), "errors": errors, "orders": halvings}


def agreement(case: Case, truth: Solved) -> dict[str, Any]:
    """Compare the default step control with the rival."""
    motion = mine(case)
    error = largest(motion.q, truth.q)
    return {
        "case": case.name,
        "rate": round(1.0 / case.period),
        "reversals": motion.reversals,
        "turns": truth.turns,
        "sticking": float(np.mean(truth.sticking)),
        "sticking_differs": int(np.sum(motion.sticking != truth.sticking)),
        "substeps": motion.substeps,
        "step_error": motion.step_error,
        "error": error,
        "error_qd": largest(motion.qd, truth.qd),
        "error_finest": largest(mine(case, 64).q, truth.q),
        "encoder_over_error": ENCODER / error,
    }


def best_time(work: Callable[[], object], repeats: int) -> float:
    """Return the shortest CPU time of several runs, s, as other load only adds time."""
    shortest = math.inf
    for _ in range(repeats):
        start = time.process_time()
        work()
        shortest = min(shortest, time.process_time() - start)
    return shortest


@dataclass(frozen=True)
class Point:
    """One setting: its largest error in rad and its time in s."""

    setting: str
    error: float
    seconds: float
    evaluations: int = 0
    options: tuple[Any, ...] = ()


def rivals(case: Case, truth: Solved) -> list[Point]:
    """Run all settings of ``solve_ivp`` once, except those certain to be slower."""
    # with loose tolerances these take one step a sample and differ only by rounding
    points = [
        _rival(case, truth, method, rtol, "every sample")
        for method in METHODS[:3]
        for rtol in (1e-4, 1e-9, 1e-11)
    ]
    # accurate enough for every level, so slower settings cannot be the fastest
    limit = 1.5 * min(p.seconds for p in points if p.error < min(LEVELS.values()))
    # a sine has no corners
    for restart in ("events", "corners") if "square" in case.name else ("events",):
        for method in METHODS:
            # decades only where it is never the fastest, and no tight ones for the slowest
            tolerances = TOLERANCES[:: 1 if method in ("RK45", "LSODA") else 2]
            for rtol in tolerances[:4] if method == "Radau" else tolerances:
                points.append(_rival(case, truth, method, rtol, restart))
                if points[-1].seconds > limit:
                    break
    return points


def _rival(case: Case, truth: Solved, method: str, rtol: float, restart: str) -> Point:
    options = (method, rtol, restart)
    start = time.process_time()
    solved = solve(case, *options)
    seconds = time.process_time() - start
    setting = f"{method} {rtol:.0e}, restarts at {restart}"
    return Point(setting, largest(solved.q, truth.q), seconds, solved.evaluations, options)


def simulator(case: Case, truth: Solved) -> tuple[list[Point], list[Point]]:
    """Time ``simulate`` with its error estimate, and one bare integration."""
    chain, values = case.plant.chain()
    full, bare = [], []
    for n in SUBSTEPS:
        # `simulate` integrates again with half as many steps to estimate its error: one step a
        # sample takes as long as two
        fixed = {"torque": case.torque, "period": case.period, "substeps": n}

        def with_error_estimate(fixed: dict[str, Any] = fixed) -> Array:
            return simulate(chain, values, **fixed).q

        def bare_run(fixed: dict[str, Any] = fixed) -> Array:
            segments = [(0, case.torque.size)]
            start = {"segments": segments, "q0": [0.0], "qd0": [0.0]}
            return simulate_segments(chain, values[np.newaxis], **start, **fixed)[0]

        for points, run in ((bare, bare_run), (full, with_error_estimate))[: 1 if n == 1 else 2]:
            error = largest(run(), truth.q)
            points.append(Point(f"{n} a sample", error, best_time(run, 15), options=(n,)))
    return full, bare


def fastest(points: Sequence[Point], level: float, count: int = 1) -> list[Point]:
    """Return the fastest settings that are at least as accurate as ``level``."""
    return sorted((p for p in points if p.error <= level), key=lambda p: p.seconds)[:count]


def compare(case: Case, truth: Solved) -> dict[str, Any]:
    """Compare speed at equal accuracy; the best settings of both are timed again."""
    points = rivals(case, truth)
    full, bare = simulator(case, truth)
    fields = compiled_fields(case)
    solve(case, "RK45", 1e-4, "events", fields)  # compiles
    timed: dict[Point, tuple[float, float]] = {}
    rows = []
    levels = dict(LEVELS)
    if bare[0].error < min(LEVELS.values()):
        levels["one step"] = bare[0].error  # no coarser step is possible
    for name, level in levels.items():
        candidates = fastest(points, level, 2)
        for p in candidates:
            if p not in timed:
                repeats = 2 if p.seconds > 0.3 else 3
                timed[p] = (
                    best_time(lambda p=p: solve(case, *p.options), repeats),
                    best_time(lambda p=p: solve(case, *p.options, fields), repeats),
                )
        times = [timed[p][0] for p in candidates]
        compiled = min(timed[p][1] for p in candidates)
        k = int(np.argmin(times))
        row = {"case": case.name, "rate": round(1.0 / case.period), "level": name, "rad": level}
        row |= {"rival": asdict(replace(candidates[k], seconds=times[k])), "compiled": compiled}
        for key, mine_points in (("simulate", full), ("bare", bare)):
            chosen = fastest(mine_points, level)[0]
            row[key] = asdict(chosen)
            row[f"{key}_ratio"] = times[k] / chosen.seconds
            row[f"{key}_ratio_compiled"] = compiled / chosen.seconds
        rows.append(row)
    return {"rows": rows, "points": points, "full": full, "bare": bare}


def where_time_goes(case: Case) -> dict[str, float]:
    """Return the cost of a right-hand side of the rival, and its share of the time."""
    y, t = np.array([0.3, 1.0]), 0.3 * case.times[-1]
    start, rate = case.torque.tolist(), (np.diff(case.torque) / case.period).tolist()

    def torque(instant: float) -> float:
        i = min(int(instant / case.period), len(rate) - 1)
        return start[i] + rate[i] * (instant - i * case.period)

    python = case.plant.branch(torque, 1.0, True)[0]
    compiled = compiled_fields(case)[1.0, True]
    compiled(t, y)
    cost = [
        best_time(lambda f=f: [f(t, y) for _ in range(2000)], 5) / 2000 for f in (python, compiled)
    ]
    solved = solve(case, "LSODA", 1e-7, "events")
    total = best_time(lambda: solve(case, "LSODA", 1e-7, "events"), 3)
    return {
        "python_seconds": cost[0],
        "compiled_seconds": cost[1],
        "evaluations": float(solved.evaluations),
        "share": cost[0] * solved.evaluations / total,
        "default_simulate_seconds": best_time(lambda: mine(case), 10),
    }


def main() -> None:
    """Run all comparisons and print the tables."""
    import show  # importable when run as a script, not when a test loads this file

    start = time.perf_counter()
    numba.set_num_threads(1)  # one core for both
    slow, quick = cases(100.0, 4.0), cases(1000.0, 4.0)
    truths = {id(case): reference(case) for case in (*slow, *quick)}
    orders = [order(case, truths[id(case)]) for case in slow]
    agreements = [agreement(case, truths[id(case)]) for case in (*slow, *quick)]
    comparisons = {(c.name, c.period): compare(c, truths[id(c)]) for c in (*slow, *quick)}
    rows = [row for f in comparisons.values() for row in f["rows"]]
    time_goes = where_time_goes(quick[0])
    print("Simulated, not measured. 4 s of motion.\n")
    for text in (
        show.order_table(orders),
        show.agreement_table(agreements),
        show.speed_table(rows),
    ):
        print(text + "\n")
    print(
        "one right-hand side: {python_seconds:.2e} s, compiled {compiled_seconds:.2e} s; "
        "{share:.0%} of the time of LSODA at 1e-7\n"
        "simulate with its default step control: {default_simulate_seconds:.2e} s".format(
            **time_goes
        )
    )
    panels = [
        (f"simulated {c.name}, {1 / c.period:.0f} Hz", comparisons[c.name, c.period])
        for c in (slow[0], quick[0])
    ]
    show.draw(panels, ENCODER, ROOT / "figures" / "simulator")
    versions = {"python": platform.python_version(), "scipy": scipy.__version__}
    versions |= {"numba": numba.__version__, "machine": platform.machine()}
    result = {"simulated": True, "versions": versions, "encoder_rad": ENCODER, "order": orders}
    result |= {"agreement": agreements, "speed": rows, "where_time_goes": time_goes}
    result["seconds"] = time.perf_counter() - start
    (FOLDER / "result.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    print(f"{result['seconds']:.0f} s in all")


if __name__ == "__main__":
    main()
