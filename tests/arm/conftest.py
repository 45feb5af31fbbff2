"""An arm of two joints that is fitted once."""

import pytest

from bayesfric.arm.arm import Arm

from . import bench
from .test_arm import QUICK, TRUTH


@pytest.fixture(scope="session")
def arm(tmp_path_factory):
    """Beside bodies that are a tenth off."""
    folder = tmp_path_factory.mktemp("arm")
    (folder / "arm.urdf").write_text(bench.urdf())
    bench.log(bench.urdf(bench.FACTORS), TRUTH).to_csv(folder / "log.csv", index=False)
    return Arm(folder / "arm.urdf", QUICK).fit(folder / "log.csv", seed=1)
