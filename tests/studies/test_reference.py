"""The committed reference says what the code says."""

import pytest

from bayesfric.commands.keys import key_tables
from bayesfric.report.words import words
from tests.conftest import REPOSITORY, imported

FOLDER = REPOSITORY / "studies" / "reference"
AGAIN = "python studies/reference/reference.py"


@pytest.fixture(scope="module")
def texts():
    return imported(FOLDER / "reference.py").texts()


@pytest.mark.parametrize("name", ["keys.md", "warnings.md"])
def test_it_is_up_to_date(name, texts):
    committed = (FOLDER / name).read_text(encoding="utf-8")
    assert committed == texts[name], f"write it anew: {AGAIN}"


def test_every_key_is_there(texts):
    lines = texts["keys.md"].splitlines()
    for table in (*key_tables("configuration"), *key_tables("fleet")):
        for key in table.keys:
            assert any(line.startswith(f"|`{key.name}`|") for line in lines), key.name


def test_every_kind_is_there(texts):
    for kind, one in words().items():
        assert f"|`{kind}`|{one.what}|" in texts["warnings.md"], kind
