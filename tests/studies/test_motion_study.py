"""Which motion columns are made of: what the committed result claims, and a few files again."""

import numpy as np
import pytest

from .bench import results, scripts

result = results("calibration/motion.json")
study = scripts("motion", folders=["calibration"])


def test_the_refined_motion_is_as_good_as_the_exact_one(result):
    """Coverage within three points of the ceiling's, or within its errors."""
    for case, one in result.items():
        error = np.hypot(one["refined"]["error"], one["exact"]["error"])
        lacks = abs(one["refined"]["coverage"] - 0.9) - abs(one["exact"]["coverage"] - 0.9)
        assert lacks < max(0.03, 2.0 * error), case
        assert one["refined"]["z_rms"] < max(1.2, one["exact"]["z_rms"] + 0.1), case


def test_friction_that_takes_a_third_biases_no_inertia(result):
    slow = {way: result["slow"][way]["numbers"]["motor.inertia"] for way in ("encoder", "refined")}
    assert slow["encoder"]["z"] > 1.0
    assert abs(slow["refined"]["z"]) < 0.4 * slow["encoder"]["z"]


@pytest.mark.slow
def test_again(study):
    found = study.judged([study.run_case(("slow", n)) for n in range(12)])
    rms = {way: found[way]["numbers"]["motor.inertia"]["z_rms"] for way in study.MOTIONS}
    # of 12 standard normals the rms is below 1.6 in 999 of 1000
    assert rms["refined"] < 1.6 * 1.33
    assert rms["refined"] < rms["encoder"]
