"""What several folders of tests share: the real recordings, and made-up ones."""

import importlib.util
import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

WORKER = os.environ.get("PYTEST_XDIST_WORKER", "").removeprefix("gw")
if WORKER:
    # Tests run side by side already: threads of one, and second processes, would only wait for
    # those of another. So each keeps to a core, and what it starts does too.
    for variable in ("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(variable, "1")
    # and compiles for itself: what two write into one cache at once may be the other's function
    os.environ["NUMBA_CACHE_DIR"] = f"{Path(__file__).resolve().parents[1]}/.numba-cache/{WORKER}"
    if hasattr(os, "sched_setaffinity"):
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, {cores[int(WORKER) % len(cores)]})

import numpy as np
import pytest
from hypothesis import settings

from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.recordings.filters import lay_windows, parallel_taps
from bayesfric.recordings.measurement import Inputs, Measurement
from bayesfric.recordings.signals import Signals

# a busy machine is no defect of what is tested
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = REPOSITORY.parent / "shared" / "data"


# Files that take too long for each commit: they sample, search, draw or start processes.
LONG = {
    "": """
        face own_term""",
    "arm": """
        arm arm_closed_loop arm_rollout departures excitation joint_consistency""",
    "commands": """
        doubts estimate explain fit identify init runs""",
    "diagnostics": """
        calibration_check explanation regression replicates""",
    "estimates": """
        assemble input_error output_error processing""",
    "fit": """
        targets_alone""",
    "export": """
        command mujoco""",
    "fleet": """
        cluster workers""",
    "identifiability": """
        advise""",
    "inference": """
        discrepancy likelihood_dense moments position_likelihood proposals sampling standstill""",
    "mechanism": """
        closed_loop integrator prediction_errors quantities""",
    "population": """
        pooled""",
    "recordings": """
        experiments inputs variants""",
    "recovery": """
        circular_angle friction_terms output_error""",
    "report": """
        bounds browser corner doubts_of_summary figures model_error prediction ridge
        run_directory self_check summary validation""",
    "rollouts": """
        rollout""",
    "studies": """
        benchmark_problem dfki_pendulum identified real_recordings""",
}
LONG_FILES = {
    Path(__file__).parent / folder / f"test_{name}.py"
    for folder, names in LONG.items()
    for name in names.split()
}


def pytest_configure():
    missing = [path for path in LONG_FILES if not path.is_file()]
    assert not missing, missing


def pytest_ignore_collect(collection_path, config):
    """Import nothing of the long ones where the quick are asked for: programs and figures."""
    return True if config.option.markexpr == "quick" and collection_path in LONG_FILES else None


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Give a file's tests to one worker: what they share is made once."""
    from xdist.scheduler import LoadFileScheduling

    return LoadFileScheduling(config, log) if config.option.dist == "load" else None


@pytest.hookimpl(tryfirst=True)  # before pytest chooses by marks
def pytest_collection_modifyitems(items):
    """Mark ``quick`` all but the long ones, so that ``-m quick`` is most of the facts soon."""
    for item in items:
        if item.path not in LONG_FILES and not item.get_closest_marker("slow"):
            item.add_marker("quick")


def imported(path):
    """Import a study's script, which is in no package."""
    name = f"{path.parent.name}_{path.stem}".replace("-", "_")
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses, and what is pickled, look it up
    spec.loader.exec_module(module)
    return module


def made_recording(time, position, torque, period, **more):
    """Return a recording in one piece, unless ``more`` says something else."""
    n = len(time)
    given = {
        "name": "made-up",
        "path": Path("made-up.csv"),
        "sha256": "0" * 64,
        "velocity": None,
        "segments": ((0, n),),
        "excluded": np.zeros(n, dtype=bool),
        "inputs": Inputs(),
        "steps": (),
        "warnings": (),
    }
    return Measurement(time=time, position=position, torque=torque, period=period, **(given | more))


@contextmanager
def _no_explanation():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesfric.diagnostics.explanation.least_outputs", lambda _: 10**9)
        yield


@pytest.fixture
def unexplained():
    """Let fits and checks simulate no replicates, where what else explains a torque is not asked.

    Half of the time of a fit goes there; every recording is taken for too long to be asked.
    """
    with _no_explanation():
        yield


@pytest.fixture(scope="module")
def nothing_explained():
    """Be ``unexplained`` for a module, and the fits that its tests share."""
    with _no_explanation():
        yield


@pytest.fixture
def real_data():
    if not DATA.is_dir():
        pytest.skip(f"the real recordings are not at {DATA}")
    return DATA


def made_observation(name, time, motion, torque, taken, period, inputs, **more):
    """Return exact motion (position, speed, acceleration) and torque, as they are compared."""
    q, qd, qdd = motion
    given = {
        "name": name, "q": q, "qd": qd, "qdd": qdd, "torque": torque, "compared": torque,
        "filter": taken, "time": taken.apply(time), "measured": taken.apply(torque),
        "speed": taken.apply(qd), "period": period, "stamps": time, "inputs": inputs,
        "segment_of": np.zeros(taken.n_outputs, dtype=np.int64), "steps": (), "warnings": (),
        "settings": {},
    }  # fmt: skip
    return Signals(**(given | more))


@pytest.fixture(scope="session")
def make_observation():
    """Exact motion and torque of known parameters, noise added: no encoder, no filter error."""

    def make(
        chain,
        values,
        *,
        sigma=0.01,
        n=1500,
        factor=1,
        seed=0,
        added_mass=0.0,
        radius=0.0,
        name="made-up",
        amplitude=1.0,
    ):
        period = 0.002
        time = np.arange(n) * period
        rng = np.random.default_rng(seed)
        q, qd, qdd = np.zeros(n), np.zeros(n), np.zeros(n)
        for frequency, a in ((0.4, 0.8), (1.1, 0.4), (2.7, 0.15), (5.3, 0.05)):
            w, phase = 2 * np.pi * frequency, rng.uniform(0, 2 * np.pi)
            q += amplitude * a * np.sin(w * time + phase)
            qd += amplitude * a * w * np.cos(w * time + phase)
            qdd -= amplitude * a * w**2 * np.sin(w * time + phase)
        inputs, vector = Inputs(added_mass, radius, name), chain.vector(values)
        torque = inverse_torque(chain, vector, q, qd, qdd, inputs=inputs, time=time)
        torque = torque + sigma * rng.standard_normal(n)
        taken = lay_windows(
            parallel_taps(factor, None, 1 / period), ((0, n),), factor, np.ones(n, dtype=bool)
        )
        return made_observation(name, time, (q, qd, qdd), torque, taken, factor * period, inputs)

    return make


def brought(by, *libraries):
    """Say which libraries the import of modules brings, in a process of its own."""
    code = f"import sys, {by}; print([m for m in {libraries!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.strip()
