"""A load loss among several terms comes first: it brings terms that others may stand for."""

import pytest

from bayesfric.explain.explanation import Term, opening
from bayesfric.report.summary.record import Summary
from tests.report.made_summaries import knee


def term(setting, *parameters):
    return Term(setting, "gearbox", setting, 50.0, (), parameters=parameters)


LOSS = term('mechanism.elements.gearbox.load_loss = "one"', "gearbox.load")
WAVE = term("mechanism.elements.gearbox.periodic_friction = [8]", "gearbox.periodic_friction_sin_8")
TWO = term(
    'mechanism.elements.gearbox.load_loss = "two"', "gearbox.load_drive", "gearbox.load_back"
)


@pytest.mark.parametrize(
    ("asked", "known", "first"),
    [
        ((WAVE, LOSS), ["motor.coulomb"], LOSS),
        ((LOSS,), ["motor.coulomb"], None),  # alone it is first anyway
        ((WAVE, WAVE), ["motor.coulomb"], None),
        ((WAVE, TWO), ["motor.coulomb", "gearbox.load"], None),  # its like was there to be tried
        ((WAVE, TWO), ["motor.coulomb"], TWO),
    ],
)
def test_it_is_the_load_loss_that_the_model_has_none_of(asked, known, first):
    assert opening(asked, known) is first


def test_a_run_asks_for_that_one_only():
    run = Summary.read(knee())
    bare = {"motor.viscous": run.parameters["motor.viscous"]}
    run = run.model_copy(update={"parameters": bare, "fixed": {}})
    both = run.model_copy(update={"asked_terms": [WAVE, LOSS]})
    assert list(both.asked) == [LOSS]
    assert list(run.model_copy(update={"asked_terms": [WAVE]}).asked) == [WAVE]
