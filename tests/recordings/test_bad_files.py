"""Every text file that cannot be used is refused in one line that names the place."""

import pytest

from bayesfric.recordings.source import Processing

from .samples import has, lines, numbered, refused, source, write


@pytest.mark.parametrize("cell", ["oops", "-Infinity", "0x1F", "1_0", "1e999"])
def test_a_bad_cell_is_named_by_file_column_row_and_line(tmp_path, cell):
    text = lines()
    time, _, torque = text[50].split(",")
    text[50] = f"{time},{cell},{torque}"
    text.insert(20, "")
    text.insert(10, "  ")  # blank lines are no rows
    write(tmp_path, "\n".join(text))
    has(refused(tmp_path), "run.csv", "'q'", "row 50 (line 53)")


@pytest.mark.parametrize("row", [2, 30, 200])
@pytest.mark.parametrize("cells", ["1.0,2.0", "1.0,x", "1.0", "1.0,2.0,3.0,4.0"])
def test_ragged_row(tmp_path, row, cells):
    text = lines()
    text[row] = cells
    write(tmp_path, "\n".join(text))
    has(refused(tmp_path), "run.csv", f"line {row + 1}")


ROWS = lines()


def constant(column):
    cells = [line.split(",") for line in ROWS[1:]]
    return [ROWS[0], *(",".join([*row[:column], "0.5", *row[column + 1 :]]) for row in cells)]


PLAIN = "\n".join(ROWS)
PROSE = "This is a letter,\nnot a recording.\nYours, nobody\n\nP.S. none"
VELOCITY = {"column": 9, "unit": "rad/s"}


@pytest.mark.parametrize(
    ("text", "used", "parts"),
    [
        (PLAIN, numbered(velocity=VELOCITY), ["column 9", "1 to 3"]),
        ("\n".join(lines(header=None)), source(), ["'t'", "1 to 3"]),
        ("\n".join(lines(header="t,q,q")), source(), ["line 1", "2 and 3", "'q'"]),
        ("\n".join(lines(header="t,Q,tau")), source(), ["'q'", "Q", "line 1"]),
        ("t,q,tau\n", source(), []),
        (PROSE, source(), []),
        (PLAIN, source(skip_rows=500), ["500"]),
        (PLAIN.replace("\n", '\n"', 9), source(), []),  # an open quote
        *((empty, source(), []) for empty in ("", "\n\n", "\ufeff", "  ")),
        # time stamps and signals that make no sense
        *(("\n".join(rows), source(), parts) for rows, parts in (
            ([*ROWS[:17], ROWS[18], ROWS[17], *ROWS[19:]], ["'t'", "row 18 (line 19)"]),
            ([*ROWS[:18], ROWS[17].replace(",", ",9"), *ROWS[19:]], ["'t'", "row 18 (line 19)"]),
            (constant(1), ["'q'"]),
            (constant(2), ["'tau'"]),
            (lines(30), ["30"]),
            ([r for i, r in enumerate(ROWS) if i == 0 or i % 40 < 30], ["50"]))),
    ],
)  # fmt: skip
def test_text_that_is_no_such_table(tmp_path, text, used, parts):
    write(tmp_path, text)
    has(refused(tmp_path, used), "run.csv", *parts)


@pytest.mark.parametrize(
    ("encoding", "lost", "parts"),
    [
        ("latin-1", 0, ["byte 3", "UTF-8"]),
        ("utf-16-le", 0, []),  # without a mark
        ("utf-16", 1, ["UTF-16"]),
    ],
)
def test_another_encoding(tmp_path, encoding, lost, parts):
    header = "t,q°,tau" if encoding == "latin-1" else "t,q,tau"
    path = write(tmp_path, "\n".join(lines(header=header)), encoding=encoding)
    path.write_bytes(path.read_bytes()[: path.stat().st_size - lost])
    has(refused(tmp_path), "run.csv", *parts)


@pytest.mark.parametrize(
    ("used", "more", "parts"),
    [
        (source(start=50), {}, ["run.csv", "start = 50 s"]),
        (source(), {"ratio": 101.0}, ["run.csv", "'q'", "101", "side"]),
        (source(), {"processing": Processing(dead_zone="1 mm/s")}, ["dead_zone"]),
    ],
)
def test_meaning(tmp_path, used, more, parts):
    write(tmp_path, "\n".join(ROWS))
    has(refused(tmp_path, used, **more), *parts)
