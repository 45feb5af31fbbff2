"""The equation of a paper is the model: written out as text it gives the torque of the kernels."""

import re

import numpy as np
import pytest

from bayesfric.mechanism.joint import Joint
from bayesfric.mechanism.presets import PRESETS
from bayesfric.report.paper.equation import latex_equations, plain_equations

from .conftest import EVERYTHING

CHAINS = {**{name: Joint.preset(name) for name in PRESETS}, "everything": EVERYTHING}
FUNCTIONS = {name: getattr(np, name) for name in ("sin", "cos", "exp", "expm1", "sign")}
FUNCTIONS |= {"abs": np.abs, "max": np.maximum, "min": np.minimum}


@pytest.mark.parametrize("name", CHAINS)
def test_it_is_the_model(name):
    joint = CHAINS[name]
    rng = np.random.default_rng(8)
    values = dict(zip(joint.names, rng.uniform(0.1, 0.6, len(joint.names)), strict=True))
    q, qd, qdd, t = rng.uniform(-2.0, 2.0, (4, 200))
    t = np.abs(t)
    names = sorted(values, key=len, reverse=True)
    known = FUNCTIONS | {n.replace(".", "__"): x for n, x in values.items()}
    known |= {"q": q, "qd": qd, "qdd": qdd, "t": t, "temperature": 20.0}
    for line in reversed(plain_equations(joint)):
        left, right = line.split(" = ")
        for one in names:
            right = re.sub(rf"(?<![\w.]){re.escape(one)}(?![\w.])", one.replace(".", "__"), right)
        known[left] = eval(right, {"__builtins__": {}}, known)
    expected = joint.torque(values, q, qd, qdd, time=t)
    # numbers are written with six digits
    np.testing.assert_allclose(known[left], expected, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("name", CHAINS)
def test_only_the_terms_that_it_has_with_their_symbols(name):
    joint, text = CHAINS[name], latex_equations(CHAINS[name])
    for p in joint.parameters:
        assert p.symbol.replace("_{}", "") in text, p.name
    assert text.count("{") == text.count("}")
    if name == "motor-axis":
        assert r"\mu" not in text
        assert r"\sin" not in text


def test_a_load_loss_is_that_of_the_papers_eq_13():
    text = latex_equations(CHAINS["servo-pendulum"])
    assert r"\operatorname{sign}(\dot q)\,\mu\,\left|" in text
