"""The first screen: three answers out of data, strips on one axis, the worst seconds."""

import re

import pytest

from bayesfric.report.answers.calculator import calculator
from bayesfric.report.answers.record import Answers
from bayesfric.report.numbers import TEXT
from bayesfric.report.page.run_page import run_page
from bayesfric.report.page.status import Glance, glance
from bayesfric.report.paper.tables import parameter_table
from bayesfric.report.summary.record import Summary, of_noise
from bayesfric.report.terminal import fit_text
from tests.conftest import REPOSITORY

from .conftest import build
from .made_summaries import FOUND, LEG, MOTOR, every_kind, failed, knee, loaded
from .page_reader import read_page
from .test_first_pictures import made_strips


def looked(told):
    read = Summary.read(told)
    return glance(parameter_table(read), read)


def asked(found, **more):
    asked = {"model_error": {"shown": False, "axes": []}, "regression": {"twins": 60}}
    return found | asked | more


def test_three_answers_are_those_of_the_data():
    look = looked(knee())
    assert (look.trusted, look.known, look.right) == ("yes", "partly", "unasked")
    assert look.settled == ("data",) * len(MOTOR) + ("open",) * len(LEG)
    names = tuple(name for name in loaded()["parameters"] if not of_noise(name))
    assert looked(asked(loaded())) == Glance(
        "yes", "yes", "yes", ("data",) * 6, {"data": names}, 5 + 5, (), ()
    )
    look = looked(every_kind())
    assert set(look.settled) == {"data", "together", "limit", "open"}
    assert list(look.settled) == sorted(
        look.settled, key=("data", "together", "limit", "open").index
    )
    tentative = asked(knee(), sampler={"status": "tentative"})
    assert looked(tentative).trusted == "partly"
    doubted = asked(knee(), doubts=[{"kind": "memory", "parameters": []}])
    assert looked(doubted).trusted == "partly"
    doubted = asked(loaded())
    doubted["parameters"]["motor.inertia"] |= {"verdict": "weak", "doubted": ["delay"]}
    look = looked(doubted)
    assert (look.known, look.settled.count("doubted")) == ("partly", 1)
    look = looked(failed(knee()))
    assert (look.trusted, look.known, look.right) == ("no", "no", "unasked")
    assert set(look.settled) == {"lost"}


def card_of(tmp_path, told):
    page = read_page(run_page(tmp_path, told, "run"))
    (card,) = [li for li in page.all("li") if "Known?" in li.text]
    return card


def test_what_could_be_zero_is_no_tick(tmp_path):
    """An interval on both sides of zero: the data tell how large it can be, not that it is."""
    told = asked(loaded())
    assert looked(told).known == "yes"
    row = told["parameters"]["load.first_moment"]
    row |= {"median": 0.01, "mean": 0.01, "interval": [-0.02, 0.04]}
    look = looked(told)
    assert (look.known, look.named["zero"]) == ("partly", ("load.first_moment",))
    assert "could be zero (load.first_moment)" in card_of(tmp_path, told).text
    assert any("first_moment" in x and "could be zero" in x for x in fit_text(told))
    row["interval"] = [0.001, 0.04]
    assert looked(told).known == "yes"
    # zero of an angle is a place like any other
    row |= {"interval": [-0.02, 0.04], "period": 6.283}
    assert looked(told).known == "yes"


def test_what_leans_on_zero_is_a_limit_however_narrow(tmp_path):
    told = asked(loaded())
    row = told["parameters"]["load.first_moment"]
    row |= {"median": 0.01, "mean": 0.01, "interval": [0.0002, 0.03]}
    row |= {"verdict": "data", "at_bound": "lower", "bound": 0.0, "bound_physical": True}
    look = looked(told)
    assert (look.known, look.named["limit"]) == ("partly", ("load.first_moment",))
    (told_row,) = [r for r in parameter_table(told).rows if r.name == "load.first_moment"]
    assert told_row.shown(TEXT)[0] == "≤ 0.03"
    assert "only as a limit (load.first_moment)" in card_of(tmp_path, told).text


def checked(coverage, **more):
    rows = {
        name: {"bias": 0.1, "bias_error": 0.01, "coverage": share, "coverage_error": 0.01}
        for name, share in coverage.items()
    }
    for name, row in more.items():
        rows[name.replace("__", ".")] |= row
    took = {"seconds": 1.0, "cpu_seconds": 1.0}
    return {"asked": 40, "made": 40, "rows": rows, "unexplained": 0.1, **took}


def test_one_look_tells_the_worst_coverage_and_which_interval_it_is(tmp_path):
    told = asked(loaded())
    told["self_check"] = checked({"motor.inertia": 0.89, "motor.viscous": 0.813})
    card, *_ = (
        li
        for li in read_page(run_page(tmp_path, told, "run")).all("li")
        if "Sampled well?" in li.text
    )
    assert "81 % at worst (motor.viscous)" in card.text
    assert "if the model is right" in card.text
    # what is open is the prior's, whatever is simulated
    told["parameters"]["motor.viscous"]["verdict"] = "prior"
    assert looked(told).worst == ("motor.inertia", 0.89)
    del told["self_check"]
    assert looked(told).worst is None


@pytest.mark.parametrize(
    ("change", "said", "alone"),
    [
        ({}, "Yes: it converged", True),
        (
            {"sampler": {"status": "tentative"}, "doubts": [{"kind": "some"}]},
            "Converged, but numbers are doubtful",
            False,
        ),
        ({"sampler": {"status": "tentative", "problems": ["x"]}}, "Not yet: tentative", False),
    ],
)
def test_a_sampling_that_converged_is_not_told_as_a_right_result(tmp_path, change, said, alone):
    page = read_page(run_page(tmp_path, asked(loaded()) | change, "run"))
    card, *others = page.all("li", **{"class": "glance"})
    question, answer = (next(card.all("p", **{"class": c})).text for c in ("question", "said"))
    assert (question, answer) == ("Sampled well?", said)
    assert ("of the sampling alone" in card.text) == alone
    # no heading asks whether the result is to be trusted
    assert not any("rusted" in one.text for one in (card, *others))


def test_no_green_where_an_interval_of_the_simulation_holds_too_few_truths(tmp_path):
    """Nor does the terminal then call more than the sampling reliable."""
    told = asked(loaded(), self_check=checked({"motor.inertia": 0.89, "motor.viscous": 0.77}))
    assert looked(told).trusted == "partly"
    told["sampler"] |= {"min_ess": 5000.0, "max_rhat": 1.0, "seconds": 1.0}
    text = "Sampling reliable, intervals too narrow in simulation"
    assert text in read_page(run_page(tmp_path, told, "run")).text
    assert next(fit_text(told)).startswith(text.lower())
    # what a prior has a say in misses truths without being wrong
    told["parameters"]["motor.viscous"]["verdict"] = "weak"
    assert looked(told).trusted == "yes"
    # forty recordings scatter by as much
    told["parameters"]["motor.viscous"]["verdict"] = "data"
    told["self_check"]["rows"]["motor.viscous"]["coverage"] = 0.79
    assert looked(told).trusted == "yes"


def test_strips_show_the_widened_interval_and_what_the_self_check_corrects(tmp_path):
    told = asked(loaded(), model_error={"shown": True, "axes": []})
    row = told["parameters"]["motor.inertia"]
    low, high = row["interval"]
    row |= {"model_error_interval": [low - 1e-5, high + 1e-5], "model_error_sd": 3.5e-5}
    right = {"corrected": 3.511e-4, "corrected_interval": [3.1e-4, 3.9e-4]}
    told["self_check"] = checked({"motor.inertia": 0.7}, motor__inertia=right)
    assert "posterior 0.0002872 to 0.0003928" in made_strips(told)["motor.inertia"].words
    page = read_page(run_page(tmp_path, told, "run"))
    (first,) = page.all("section", id="findings")
    (card,) = [li for li in first.all("li") if "Sampled well?" in li.text]
    assert "widened" in card.text
    (legend,) = [p for p in first.all("p") if p.attrs.get("class") == "legend"]
    assert "widened" in legend.text
    (line,) = [s.text for s in first.all("span") if "by the self-check" in s.text][-1:]
    assert "3.51" in line
    assert "were the model right" in line


@pytest.mark.parametrize("blind", [0.1, 0.9])
def test_bands_that_tell_nothing_make_nothing_green(tmp_path, blind):
    error = {"mae": 1.0, "rmse": 1.0, "inside": 0.94, "inside_alone": 0.9, "width": 20.0}
    row = {"position": error, "speed": error, "room": 3.14159, "blind": blind}
    rolled = {"level": 0.9, "draws": 9, "seed": 1, "unit": "rad", "recordings": {"sac": row},
              "pooled": row, "unexplained": {"sac": 0.5}, "left": 0.3,
              "torque_unit": "N m"}  # fmt: skip
    told = loaded() | {"rollout": rolled}
    wide = blind > 0.2
    assert looked(told).right == ("unasked" if wide else "yes")
    page = read_page(run_page(tmp_path, told, "run"))
    (section,) = page.all("section", id="roll-out")
    assert ("too wide to tell" in section.text) == wide
    said = [p.text for p in page.all("p", **{"class": "flag"})]
    assert any("bands that tell nothing: wider than 3.1 rad" in text for text in said) == wide


def test_what_is_undecided_is_not_green(tmp_path):
    told = asked(knee())
    held = {"outputs": 9, "coverage": {}, "residual_rms": 1.0, "says": "too few"}
    told["validation"] = {"unit": "N m", "parts": {}, "pooled": held | {"verdict": "undecided"}}
    page = read_page(run_page(tmp_path, told, "run"))
    (card,) = [li for li in page.all("li") if "Model right?" in li.text]
    assert card.attrs["data-kind"] == "unasked"
    assert "Not decided" in card.text
    told.pop("validation")
    assert looked(told).right == "yes"


def test_a_limit_and_what_needs_its_prior_are_counted_apart(tmp_path):
    """Six numbers, of which the data alone tell four: not all six are known."""
    told = asked(loaded())
    told["parameters"]["motor.inertia"] |= {
        "verdict": "weak", "at_bound": "lower", "bound": 0.0, "data_sd": 1e-5, "prior_sd": 1e-2,
    }  # fmt: skip
    told["parameters"]["load.inertia"] |= {"verdict": "weak"}
    look = looked(told)
    assert look.known == "partly"
    assert look.settled == ("data",) * 4 + ("together", "limit")
    assert (look.named["limit"], look.named["together"]) == (("motor.inertia",), ("load.inertia",))
    page = read_page(run_page(tmp_path, told, "run"))
    (card,) = [li for li in page.all("li") if "Known?" in li.text]
    assert "Four of six parameters by the data" in card.text
    assert re.search(r"one only as a limit \(motor\.inertia\)", card.text)
    assert re.search(r"one only together with prior and bounds \(load\.inertia\)", card.text)
    # and neither list says that all is settled
    said = "is known only together with prior and bounds and one is known only as a limit."
    for kind in ("left-open", "next"):
        (part,) = [div for div in page.all("div") if div.attrs.get("class") == kind]
        assert "one " + said in part.text, kind


@pytest.mark.parametrize(
    ("change", "right", "against"),
    [
        ({}, "yes", ()),
        ({"model_error": {"shown": True, "axes": []}}, "partly", ("error",)),
        ({"regression": {"reason": "few"}}, "unasked", ()),
        ({"findings": [FOUND]}, "partly", ("missing",)),
        # what moves no number by half its interval speaks against none
        ({"findings": [FOUND | {"severity": "note"}]}, "yes", ()),
        ({"doubts": [{"kind": "unexplained"}]}, "no", ("unexplained",)),
        # measured, a pendulum with another weight: 0.5 kg told, 1.5 times as much by the torque
        ({"doubts": [{"kind": "memory"}]}, "partly", ("memory",)),
    ],
)
def test_whether_the_model_is_right(change, right, against):
    look = looked(asked(knee()) | change)
    assert (look.right, look.against) == (right, against)


GRAVITY = FOUND | {"kind": "gravity", "hint": "mechanism.load.first_moment = true"}


def of_wrong_mechanism(told, kind, **more):
    """A run whose residual is no noise, and what it tells of that."""
    doubt = {
        "unexplained": {"share": 0.6, "quantity": "motor torque"},
        "memory": {"asked": 2, "taken": 0, "shift": 4.0, "rise": 1.2},
    }[kind]
    return told | {"doubts": [{"kind": kind, "parameters": [], **doubt}]} | more


@pytest.mark.parametrize("told", [knee, loaded])
@pytest.mark.parametrize("kind", ["unexplained", "memory"])
@pytest.mark.parametrize("findings", [[], [GRAVITY]])
def test_a_wrong_mechanism_comes_before_every_experiment(tmp_path, told, kind, findings):
    if kind == "memory" and not findings:
        return  # what nothing explains is no other mechanism
    right = read_page(run_page(tmp_path, asked(told()), "run"))
    page = read_page(
        run_page(tmp_path, of_wrong_mechanism(asked(told()), kind, findings=findings), "run")
    )
    lines = list(fit_text(of_wrong_mechanism(asked(told()), kind, findings=findings)))
    # a torque that nothing explains may be a hand's: that is looked at before
    hand = kind == "unexplained" and not findings
    change = "Then change the mechanism" if hand else "First change the mechanism"
    (place,) = [k for k, x in enumerate(lines) if change in x]
    assert ("First make sure that nothing but the drive" in lines[place - 1]) == hand
    assert ("first_moment = true under [mechanism.load]" in lines[place]) == bool(findings)
    assert not any(x.startswith("  motor.inertia") for x in lines[:place])
    assert "First change the mechanism" not in "\n".join(fit_text(asked(told())))
    (*steps, _), (before, *_) = (
        [li for div in one.all("div") if div.attrs.get("class") == "next" for li in div.all("li")]
        or [None]
        for one in (page, right)
    )
    assert len(steps) == 1 + hand
    step = steps[hand]
    assert step.text.startswith(change)
    assert steps[0].text.startswith("First make sure that nothing but the drive") == hand
    assert before is None or not before.text.startswith("First change the mechanism")
    assert ("first_moment = true under [mechanism.load]" in step.text) == bool(findings)
    (following,) = [d for d in page.all("div") if d.attrs.get("class") == "next"]
    # neither a value to fix nor a recording to make: they would be for a wrong mechanism
    assert "--advise" not in following.text
    assert "prior from a data sheet" not in following.text
    (left,) = page.all("div", id="left-open")
    assert "Nothing" not in left.text
    # what explains all but a thousandth is not said to explain nothing
    assert ("no number here is settled" in left.text) == (kind == "unexplained")
    assert ("does not explain what was measured" in left.text) == (kind == "unexplained")


REMEMBERS = [{"order": 0, "bic": 0.0}, {"order": 2, "bic": -90.0}]


def test_where_no_term_is_found_nobody_is_sent_to_look_again(tmp_path):
    wide = {
        "shown": True,
        "axes": [{"name": "power", "groups": 4, "p_value": 0.0, "differs": True}],
    }
    told = of_wrong_mechanism(asked(loaded()), "memory", model_error=wide)
    told["noise"] |= {"order_chosen_from": REMEMBERS}
    told["doubts"][0]["moved"] = {"motor.inertia": 1.4}

    def following(found):
        page = read_page(run_page(tmp_path, found, "run"))
        (left,) = page.all("div", id="left-open")
        (div,) = page.all("div", **{"class": "next"})
        return left.text, div.text

    left, text = following(told)
    assert "does not explain what was measured" not in left
    assert "hand" not in text
    assert "--advise" in text
    assert "<code>" not in text
    lines = "\n".join(fit_text(told))
    assert "change the mechanism" not in lines
    assert "would move motor.inertia by 1.4 of the sds shown" in lines
    # one that is found comes first
    _, text = following(told | {"findings": [GRAVITY]})
    assert "First change the mechanism: write first_moment = true" in text
    # also where that is no doubt of any number
    _, text = following(told | {"findings": [GRAVITY], "doubts": []})
    assert "Put in what else explains the torque, and fit again" in text
    assert "--advise" in text


def test_of_another_motion_the_page_promises_what_was_measured(tmp_path):
    told = asked(loaded(), model_error={"shown": True, "axes": []})
    (first,) = read_page(run_page(tmp_path, told, "run")).all("section", id="findings")
    assert "nine in ten should" not in first.text
    assert "about eight in ten" in first.text
    # as the README has it
    readme = " ".join((REPOSITORY / "README.md").read_text(encoding="utf-8").split())
    (measured,) = re.findall(r"90 % intervals of differences hold (\d+ %)", readme)
    assert measured in first.text.replace("\u00a0", " ")


def test_what_is_too_narrow_is_not_what_is_shown_first():
    test = {"white": False, "p_value": 1e-9}
    for shown in (True, False):
        told = asked(loaded(), model_error={"shown": shown, "axes": []})
        told["noise"] |= {"innovation_whiteness": test}
        lines = "\n".join(fit_text(told))
        assert ("white: intervals may be too narrow" in lines) is not shown
        narrow = "'were the model right', may be too narrow"
        assert lines.count(narrow) == 2 * shown


@pytest.mark.parametrize("told", [knee, loaded])
def test_a_push_is_left_out_before_any_trajectory_is_proposed(tmp_path, told):
    pushed = FOUND | {"kind": "push", "hint": "", "recording": "sac", "span": [17.9, 18.3]}
    found = asked(told(), findings=[pushed])
    first = "First leave out what was pushed (of sac exclude = [[17.9, 18.3]])"
    (following,) = read_page(run_page(tmp_path, found, "run")).all("div", **{"class": "next"})
    step, *_ = following.all("li")
    assert step.text.startswith(first)
    assert "record again without a hand" in step.text
    assert following.text.index(first) < following.text.index("--advise")
    assert "Only after that" in following.text
    assert any(line.strip().startswith(first) for line in fit_text(found))
    (following,) = read_page(run_page(tmp_path, asked(told()), "run")).all(
        "div", **{"class": "next"}
    )
    assert "hand" not in following.text


def test_the_unit_of_the_position_comes_before_the_mechanism(tmp_path):
    told = of_wrong_mechanism(asked(knee()), "unexplained", findings=[GRAVITY])
    told["doubts"][0]["units"] = [{"is": "rad", "taken": "deg", "share": 0.997}]
    page = read_page(run_page(tmp_path, told, "run"))
    (following,) = [d for d in page.all("div") if d.attrs.get("class") == "next"]
    assert next(iter(following.all("li"))).text.startswith("First look at the unit of the position")
    assert "in rad, not in deg" in following.text
    assert "100 %" in following.text
    lines = "\n".join(fit_text(told))
    assert "  First look at the unit of the position" in lines
    for text in (following.text, lines):
        assert "First change the mechanism" not in text


def test_nothing_is_open_only_where_nothing_speaks_against_the_model(tmp_path):
    def said(**more):
        page = read_page(run_page(tmp_path, asked(loaded(), **more), "run"))
        following = [d for d in page.all("div") if d.attrs.get("class") == "next"]
        return [one.text for one in (*page.all("div", id="left-open"), *following)]

    assert ["Nothing" in text for text in said()] == [True, True]
    found = said(findings=[FOUND])
    assert ["Nothing" in text for text in found] == [False, False]
    wrong = said(model_error={"shown": True, "axes": []})
    assert ["Nothing" in text for text in wrong] == [False, False]


def test_a_shape_goes_with_every_answer_and_a_link_leads_on(tmp_path):
    for told in (knee(), asked(loaded()), failed(knee())):
        page = read_page(run_page(tmp_path, told, "run"))
        cards = [li for li in page.all("li") if li.attrs.get("class") == "glance"]
        look = looked(told)
        assert [li.attrs["data-kind"] for li in cards] == [look.trusted, look.known, look.right]
        names = {node.attrs.get("id") for node in page.every()}
        for li, kind in zip(cards, (look.trusted, look.known, look.right), strict=True):
            (shape,) = [s for s in li.all("span") if "shape" in s.attrs.get("class", "").split()]
            assert shape.text == {"yes": "✓", "partly": "!", "no": "✕", "unasked": "?"}[kind]
            (link,) = li.all("a")
            assert link.attrs["href"][1:] in names
            assert len(li.text) > 30


@pytest.mark.parametrize("kind", ["unexplained", "memory", None])
def test_a_doubtful_number_of_the_calculator_says_so(tmp_path, kind):
    fit = build(samples=400, ensembles=2)
    answers = Answers(calculator=calculator(fit))
    (tmp_path / "page.json").write_text(answers.model_dump_json(), encoding="utf-8")
    told = of_wrong_mechanism(asked(loaded()), kind) if kind else asked(loaded())
    page = read_page(run_page(tmp_path, told, "run"))
    (section,) = page.all("section", id="calculator")
    numbers = [p for p in section.all("p") if p.attrs.get("class") == "now"]
    assert len(numbers) == 2
    assert ["doubtful" in p.text for p in numbers] == [kind is not None] * 2
