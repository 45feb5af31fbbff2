"""A quadruped's joints from targets and encoders, measured: what is committed, and one joint."""

import pytest

from tests.conftest import REPOSITORY, imported

from .bench import committed

RESULT = committed("go2-legs/go2.json")


@pytest.fixture(scope="module")
def study():
    return imported(REPOSITORY / "studies" / "go2-legs" / "go2.py")


def test_the_page_has_the_table_of_the_result(study):
    """As ``--table`` prints it."""
    page = (REPOSITORY / "studies" / "go2-legs" / "README.md").read_text(encoding="utf-8")
    assert study.table(RESULT) in page


@pytest.mark.slow
def test_a_thigh_again(real_data, study):  # noqa: ARG001
    """Its delay and its clock without the other joints: a search ends .3 sds from the mode."""
    name = "FL_thigh_joint"
    again = study.fitted("first", [name])["timing"]["joints"][name]
    before = RESULT["first"]["timing"]["joints"][name]
    for key, (value, sd) in again.items():
        assert abs(value - before[key][0]) < 0.6 * sd, key
        assert sd == pytest.approx(before[key][1], rel=0.1), key
