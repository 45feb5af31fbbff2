"""The committed reference says what the code says, and every error in it has a mend."""

import re

import pytest

from bayesfric.report.alerts import DOUBTS
from tests.conftest import REPOSITORY, imported

FOLDER = REPOSITORY / "studies" / "reference"
AGAIN = "python studies/reference/reference.py"


@pytest.fixture(scope="module")
def reference():
    return imported(FOLDER / "reference.py")


@pytest.fixture(scope="module")
def texts(reference):
    return reference.texts()


@pytest.mark.parametrize("name", ["keys.md", "warnings.md", "errors.md"])
def test_it_is_up_to_date(name, texts):
    committed = (FOLDER / name).read_text(encoding="utf-8")
    assert committed == texts[name], f"write it anew: {AGAIN}"


def test_every_error_of_the_source_is_there_with_a_mend(reference):
    found = reference.errors()
    for name, tree in reference.sources().items():
        text = reference.ast.unparse(tree)
        # one that only its class or signature names is none
        if re.search(r"raise BadInput\(|return BadInput\(", text):
            assert found.get(name), name
    rows = [row for module in found.values() for row in module]
    assert len(rows) > 250
    for where, what, mend in rows:
        assert where, (what, mend)
        assert what, (where, mend)
        assert mend, (where, what)


def test_sentences_are_read_as_they_are_written(reference):
    """Known lines, of each way in which the source writes them."""
    found = reference.errors()
    assert ("{path}", "there is no such file", "check the name") in found["bayesfric/config.py"]
    # a value of a model's own check, and what it wants
    row = ("the key", "got {value}", "give a speed of 0 or more")
    assert row in found["bayesfric/recordings/processing.py"]
    told = reference.warnings_of_recordings()
    assert "exclude: no sample lies in [{start}, {stop}] s" in told["bayesfric/recordings/read.py"]
    # one that is given by a function, and a constant of its module
    assert any(
        text.startswith("band: {band} Hz is above half")
        for text in told["bayesfric/recordings/observation.py"]
    )
    assert any(
        text.startswith("warm-up was still moving")
        for text in told["bayesfric/inference/sampling/sampling.py"]
    )
    assert reference.plain("{% if a %}one{% else %}two {{ b }}{% endif %}") == "[one / two …]"


def test_every_doubt_and_statement_has_its_sentence(reference):
    kinds = set(reference.sentences())
    assert {kind.replace("-", "_") for kind in DOUBTS} <= kinds
    for text in (*reference.sentences().values(), *reference.statements()["remedy"].values()):
        assert len(text.split()) > 2, text
        assert "{%" not in text
        assert "{{" not in text
