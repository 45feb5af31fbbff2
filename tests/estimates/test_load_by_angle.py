"""Whether the load goes with the angle, where closed forms say so; and what is said of it."""

import numpy as np
import pytest

import bayesfric as bf
from bayesfric.estimates.load_by_angle import load_by_angle
from bayesfric.report.alerts import alerts_of
from bayesfric.report.paper.tables import parameter_table
from tests.report.made_summaries import knee, posterior_row

ARM = bf.Joint(
    [bf.Element("gearbox", coulomb="symmetric", load_loss="one")],
    load=bf.Load(inertia=True, first_moment=True),
)
T = 0.005 * np.arange(4000)
VALUES = {
    "gearbox.coulomb": 0.1,
    "gearbox.load": 0.1,
    "load.inertia": 0.5,
    "load.first_moment": 1.0,
}


def recorded(*lines, **more):
    q = sum(a * np.sin(2 * np.pi * f * T) for f, a in lines)
    return bf.Recording.from_arrays(T, q, np.sign(np.gradient(q, T)), name=str(more), **more)


def share(*recordings, joint=ARM, **values):
    observations = bf.Model(joint, list(recordings)).observations
    return load_by_angle(joint, observations, joint.vector(VALUES | values))


def test_of_one_sine_all_of_the_load_goes_with_the_angle():
    """Its acceleration is in proportion to its angle."""
    assert share(recorded((0.3, 1.0))) == pytest.approx(1.0, abs=1e-4)


def test_of_two_sines_without_gravity_it_is_what_they_correlate():
    lines = ((0.31, 0.5), (1.27, 0.3))
    found = share(recorded(*lines), **{"load.first_moment": 0.0})
    a, w = np.array([[x, 2 * np.pi * f] for f, x in lines]).T
    linear = (a**2 @ w**2) ** 2 / ((a**2).sum() * (a**2 @ w**4))
    # higher powers of the angle may add to it, hardly
    assert linear - 0.02 < found < linear + 0.1


def test_the_same_motion_with_a_payload_parts_them():
    alone = recorded((0.3, 1.0))
    heavier = recorded((0.3, 1.0), added_mass=1.0, radius=0.5)
    assert share(alone, heavier) < 0.97


def test_a_joint_without_load_losses_is_not_asked():
    plain = bf.Joint([bf.Element("motor", inertia=True)], load=bf.Load(first_moment=True))
    observations = bf.Model(plain, recorded((0.3, 1.0))).observations
    assert load_by_angle(plain, observations, np.ones(2)) is None


@pytest.mark.parametrize(
    ("by_angle", "row", "said"),
    [
        (0.999, {}, True),
        (0.9, {}, False),
        (None, {}, False),
        (0.999, {"verdict": "prior"}, False),
        (0.999, {"at_bound": "lower", "bound": 0.0}, False),
    ],
)
def test_a_loss_by_the_load_that_is_told_says_so(by_angle, row, said):
    run = knee()
    run["parameters"]["gearbox.load"] = posterior_row("", 0.2, 0.01) | row
    run["fit"]["load_by_angle"] = by_angle
    texts = [a.text for a in alerts_of(run) if a.kind == "load by angle"]
    assert len(texts) == said
    assert all("makes up all of it but 0.1 %" in text for text in texts)
    assert all("much like gearbox.load;" in text for text in texts)
    # a table and a methods section go without the page
    notes = [note for note in parameter_table(run).notes if "all of it but 0.1 %" in note]
    assert len(notes) == said
