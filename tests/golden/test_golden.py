"""Runs give the numbers that they gave: scaffolding of a rewriting, not facts of the model."""

import json

import numpy as np
import pytest

from . import golden

pytestmark = pytest.mark.slow

# Of a posterior's sd. At 3,000 effective draws the ends of two runs' intervals differ by 0.055.
CLOSE = 0.15
EXPECTED = json.loads(golden.GOLDEN.read_text())


@pytest.mark.parametrize("name", golden.RUNS)
def test_a_run_gives_what_it_gave(name, tmp_path, request):
    if name in golden.NEED_DATA:
        request.getfixturevalue("real_data")
    expected, again = EXPECTED[name], golden.RUNS[name](tmp_path)
    assert again["sampler"] == expected["sampler"]
    assert again["findings"] == expected["findings"]
    assert set(again["numbers"]) == set(expected["numbers"])
    differences = []
    for key, before in expected["numbers"].items():
        now = again["numbers"][key]
        pairs = [("", now, before, before["median"], now["median"])]
        if "reported" in before:
            now_, before_ = now["reported"], before["reported"]
            if now_["status"] != before_["status"]:
                differences.append(f"{key}: {before_['status']} is {now_['status']}")
            pairs.append(("reported ", now_, before_, before_["value"], now_["value"]))
        for what, after, earlier, middle, moved in pairs:
            ends = [earlier["interval"], after["interval"]]
            old, new = ([middle, *ends[0]], [moved, *ends[1]])
            numbers = np.array([[np.nan if x is None else x for x in row] for row in (old, new)])
            apart = np.abs(np.diff(numbers, axis=0)) / earlier["sd"]
            if not (np.isnan(apart) | (apart <= CLOSE)).all():
                differences.append(f"{key} {what}: {old} is {new}, sd {earlier['sd']}")
            if not 1.0 - CLOSE < after["sd"] / earlier["sd"] < 1.0 + CLOSE:
                differences.append(f"{key} {what}sd: {earlier['sd']} is {after['sd']}")
    assert not differences, "\n".join(differences)
