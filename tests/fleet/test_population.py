"""What a fleet's finished runs say together."""

import json

import pytest

from tests.report.made_fleet import WORN, write_fleet
from tests.report.made_summaries import LEG

pytestmark = pytest.mark.usefixtures("nothing_explained")


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return write_fleet(tmp_path_factory.mktemp("fleet"))


def test_the_worn_unit_is_the_first_outlier(found):
    assert found.outliers[0][0] == WORN
    assert found.outliers[0][1] > 0.9
    assert found.outliers[1][1] < 0.5


def test_what_the_data_leave_open_is_not_pooled(found):
    assert not {one.name for one in found.quantities} & set(LEG)
    assert {one.name for one in found.quantities} >= {"motor.inertia", "total.inertia"}


def test_what_is_written_is_json_and_tells_every_quantity(found):
    told = json.loads(json.dumps(found.as_json(), allow_nan=False))
    assert [one["name"] for one in told["quantities"]] == [one.name for one in found.quantities]
    assert told["outliers"][0]["unit"] == WORN
