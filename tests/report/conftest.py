"""Made-up fits: the truth with a little spread around it, no sampling."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

from bayesfric.estimates.least_squares import least_squares
from bayesfric.inference.fitting import Fit, make_target, read_priors
from bayesfric.inference.posterior import Diagnostics, Posterior
from bayesfric.mechanism.element import Element, Load
from bayesfric.mechanism.inverse import inverse_torque
from bayesfric.mechanism.joint import PRESETS, Joint
from bayesfric.recordings.signals import observe
from bayesfric.recordings.source import Processing
from bayesfric.report import run_directory
from bayesfric.report.summary.summary import summarise
from tests.conftest import made_recording

NOISE = 0.02
SLIDE = Joint(
    elements=(Element("slide", inertia=True, coulomb="symmetric", motion="linear", subscript="s"),),
    load=Load(motion="linear"),
)
# Every optional term at once: what has a slot of the kernels, what is carried by its column.
EVERYTHING = Joint(
    elements=(
        Element(
            "motor", inertia=True, coulomb="by-direction", viscous="by-direction", quadratic=True,
            stribeck="either", stribeck_exponent=True, cogging=(6,), load_loss="one",
        ),
        Element(
            "gearbox", ratio=30.0, load_loss="two", load_direction="quadrants", load_speed=True,
            load_square=True, coulomb="symmetric", stribeck="apart", periodic_friction=(1,),
        ),
        Element("bearing", power=True, viscous=True, temperature="both", warming="viscous"),
    ),
    load=Load(inertia=True, first_moment=True, gravity_angle=True, spring="stiffening"),
    offset=True,
    gain=True,
)  # fmt: skip


def recording(chain, values, name, samples, seed):
    """Return a swing of white torque noise in two segments with 1 s between them."""
    rng = np.random.default_rng(seed)
    time = 1e-3 * np.arange(samples)
    q, qd, qdd = np.zeros((3, samples))
    for frequency, amplitude in ((0.7, 0.6), (1.9, 0.3), (4.3, 0.06)):
        w, phase = 2 * np.pi * frequency, rng.uniform(0, 2 * np.pi)
        q += amplitude * np.sin(w * time + phase)
        qd += amplitude * w * np.cos(w * time + phase)
        qdd -= amplitude * w**2 * np.sin(w * time + phase)
    torque = inverse_torque(chain, values, q, qd, qdd) + NOISE * rng.standard_normal(samples)
    half = samples // 2
    time[half:] += 1.0
    segments = ((0, half), (half, samples))
    return made_recording(time, q, torque, 1e-3, name=name, velocity=qd, segments=segments)


def build(
    chain=None,
    *,
    recordings=1,
    samples=1500,
    noise_scale="shared",
    thin=3,
    ensembles=3,
    spread=1e-3,
    processing=None,
):
    """Make a fit of a rabbit knee, or of another chain (values: 0.3 each)."""
    preset = PRESETS["rabbit-knee"]
    truth = preset.values if chain is None else dict.fromkeys(chain.names, 0.3)
    chain = chain or preset.chain()
    x = chain.vector(truth)
    # every sample an output: the noise stays white and the model exact
    processing = processing or Processing(lowpass=0, decimate=1, dead_zone=0.2)
    observations = [
        observe(recording(chain, x, f"run {r}", samples, r), processing) for r in range(recordings)
    ]
    target = make_target(chain, observations, read_priors(chain, {}, observations), noise_scale)
    centre = np.append(x, np.full(len(target.noise.names), NOISE))
    rng = np.random.default_rng(5)
    draws = centre * (1 + spread * rng.standard_normal((ensembles, 16, 40, centre.size)))
    d = centre.size
    diagnostics = Diagnostics(
        status="reliable",
        problems=(),
        rhat=np.ones(d),
        tau=np.where(np.ptp(draws.reshape(-1, d), axis=0) > 0, 2.5, np.inf),
        ess=np.full(d, 4000.0),
        acceptance=np.full((ensembles, 16), 0.5),
        ensembles=ensembles, walkers=16, warmup=100, steps=40 * thin, thin=thin,
        not_finite=0, seconds=1.0,
    )  # fmt: skip
    posterior = Posterior(
        names=target.names,
        priors=target.priors,
        draws=draws,
        log_density=np.zeros(draws.shape[:3]),
        diagnostics=diagnostics,
        seed=5,
    )
    return Fit(target, posterior, (least_squares(chain, observations),))


def by_gid(ax, gid):
    """Return the one artist of that name."""
    (artist,) = [a for a in ax.get_children() if a.get_gid() == gid]
    return artist


@pytest.fixture(scope="session")
def make_fit():
    return build


@pytest.fixture(scope="session")
def knee():
    return build()


@pytest.fixture(scope="session")
def written_run(tmp_path_factory):
    """A run directory of a knee whose leg is open, with three real figures and a blank one."""
    fit = build(samples=400, ensembles=2)
    folder = tmp_path_factory.mktemp("written") / "run"
    with pytest.MonkeyPatch.context() as patch:
        # one of bands, one of many panels, one with pixels in it
        some = ("prediction", "corner", "ridge")
        drawn = {s: run_directory.FIGURES[s] for s in some}
        small = replace(run_directory.FIGURES["methods"], draw=lambda *_: Figure(figsize=(3, 1)))
        patch.setattr(run_directory, "FIGURES", {"methods": small} | drawn)
        config = '[simulation]\nnote = "</script><b>"\n'
        summary = summarise(fit).as_dict() | {"may_be_simulated": True}
        run_directory.write_run(folder, fit, summary, config, [])
    return folder


@pytest.fixture(scope="session")
def slide():
    return build(SLIDE)


@pytest.fixture(scope="session")
def many():
    """Four recordings, each with its own noise: 15 sampled parameters."""
    return build(recordings=4, samples=600, noise_scale="per-recording")
