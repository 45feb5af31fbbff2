"""Numbers of faulty recordings that are called identified: generators, counting, and fits again."""

import tomllib

import numpy as np
import pytest

from .bench import committed, medians_agree, scripts

faulty, identified = (
    scripts(name, folders=["identified", "calibration", "diagnostics"])
    for name in ("faulty", "identified")
)
KINDS = "late target", "current column", "smoothed", "prior", "swing", "short"


@pytest.mark.parametrize("kind", KINDS)
def test_without_its_fault_least_squares_gives_the_truth(faulty, kind, tmp_path):
    recording = faulty.recording(kind, 61, 0, fault=False)
    (estimate,) = recording.model(tmp_path).estimates(["input-error"])
    values = {value.name: value for value in estimate.values}
    for name, true in recording.truth.items():
        # five sds of four numbers: once in half a million
        assert abs(values[name].value - true) < 5.0 * values[name].sd, name


def test_each_kind_has_its_fault(faulty):
    assert set(KINDS) == set(faulty.KINDS)
    for kind in KINDS:
        right, wrong = (faulty.recording(kind, 61, 0, fault=fault) for fault in (False, True))
        assert right.truth.keys() == wrong.truth.keys()
        same = right.configuration == wrong.configuration and all(
            np.array_equal(x, y)
            for x, y in zip(right.columns.values(), wrong.columns.values(), strict=True)
        )
        assert not same, kind


def test_a_prior_excludes_the_truth_by_as_many_sds_as_it_says(faulty):
    recordings = [faulty.recording("prior", 61, number) for number in range(20)]
    assert len({recording.fault for recording in recordings}) > 4
    for recording in recordings:
        which, _, name = recording.fault.partition(" of ")
        prior = tomllib.loads(recording.configuration)["priors"][name]
        true = recording.truth[name]
        if which == "normal":
            sds = abs(true - prior["loc"]) / prior["scale"]
            assert sds == pytest.approx(recording.size)
        else:
            assert not prior[0] <= true <= prior[1]


def row(number, *statuses, z=0.0):
    numbers = {f"n{k}": {"status": status, "z": z} for k, status in enumerate(statuses)}
    return {"number": number, "numbers": numbers, "outcome": "good", "cpu_seconds": 1.0}


def test_counting(identified):
    rows = [row(0, "identified", "doubtful", z=4.0), row(1, "identified", "limit", z=-1.0)]
    sums = identified.judged([*rows, {"number": 2, "refused": "too short"}])
    assert (sums["identified"], sums["identified_off"], sums["refused"]) == (2, 1, 1)
    # of two numbers one is off: with 95 % confidence fewer than 97.5 % are
    assert sums["identified_off_at_most"] == pytest.approx(np.sqrt(0.95), abs=1e-3)
    later = [row(0, "doubtful", "identified"), row(1, "identified", "identified")]
    assert identified.still_identified(rows, later) == (1, 2)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_two_recordings_again(identified, kind):
    before = committed("identified/identified.json")[kind]
    for number in range(2):
        again, same = identified.fit_faulty((kind, number)), before[number]
        assert again["number"] == same["number"] == number
        assert again["numbers"].keys() == same["numbers"].keys()
        for name, new in again["numbers"].items():
            old = same["numbers"][name]
            assert new["status"] == old["status"], (number, name)
            draws = 2.0 / (1.0 / new["ess"] + 1.0 / old["ess"])
            assert medians_agree(new["value"], old["value"], old["sd"], draws), (number, name)
