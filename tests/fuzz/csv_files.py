"""CSV files: cells, rows, headers, ends of lines, encodings."""

from __future__ import annotations

from pathlib import Path

from hypothesis import strategies as st

from fuzz.cases import Case, Expected, refused, taken
from fuzz.mutations import NUMBERS, TEXTS, Sound, mutated_bytes

FILE = "run.csv"
NEEDS = ("machine", FILE)
OUT = "new.zarr"
IMPORT = ("import-log", FILE, "--task", "machine", "--out", OUT)
LINES = (  # that are given it: the arguments, what they need, what they write
    *[(IMPORT, NEEDS, (OUT,))] * 8,
    ((*IMPORT[:-2], "--append", "--out", "log.zarr"), (*NEEDS, "log.zarr"), ("log.zarr",)),
    (("inspect", FILE, "--task", "machine", "--json"), NEEDS, ()),
)
SWITCHES = ("--drop-nan", "--drop-repeats", "--drop-held", "--even-times")
TIMES = (
    "2026-11-23T10:00:00.005",
    "2026-11-23 10:00:00",
    "10:00:00.005",
    "23:59:59.999",
    "23.11.2026",
    "1700000000000000000",
    "2026-13-45T99:99:99",
    "0001-01-01T00:00:00",
    "9999-12-31T23:59:59Z",
    "-1",
)
SEPARATORS = (";", "\t", "|", " ", ",,", ", ")
CODES = (*["utf-8"] * 12, "utf-8-sig", "utf-16", "utf-32", "latin-1", "cp1252", "utf-7")


def seeds(inputs: Path) -> list[Case]:
    text = (inputs / FILE).read_text()
    header, *rows = text.splitlines()
    first = rows[0].split(",")

    def seed(name: str, content: str | bytes, expected: Expected) -> Case:
        content = content.encode() if isinstance(content, str) else content
        return Case(IMPORT, NEEDS, {FILE: content}, (OUT,), expected, name)

    def with_cell(cell: str) -> str:
        return "\n".join([header, *rows[:5], ",".join([first[0], cell, *first[2:]]), *rows[6:]])

    return [
        seed("a cell of 131,073 characters", with_cell("1" * 131_073), refused()),
        seed("a cell of 200,000 letters", with_cell("x" * 200_000), refused()),
        seed("a line of 30 MB", with_cell("x" * 30_000_000), refused()),
        seed("a quote that is never closed", with_cell('"' + "x" * 200_000), refused()),
        seed("integers of 400 digits", with_cell("9" * 400), refused("force_N")),
        seed("integers of 5,000 digits", with_cell("9" * 5000), refused("force_N")),
        seed("a zero byte", with_cell("1\0"), refused()),
        seed("a number that is none", with_cell("nan"), refused("force_N")),
        seed("an empty file", "", refused("empty")),
        seed("a header alone", header, refused()),
        seed("a column too few", text.replace("force_N", "torque"), refused("force_N")),
        seed("a column twice", text.replace("q_m", "force_N"), refused()),
        seed("lines that end as on Windows", text.replace("\n", "\r\n"), taken()),
        seed("a mark of UTF-8 before it", text.encode("utf-8-sig"), taken()),
        seed(
            "other columns beside",
            "\n".join(f"{line},c{n}" for n, line in enumerate([header, *rows])),
            taken(),
        ),
        seed("comments before it", f"# made by a logger\n{text}", taken()),
        seed("UTF-16", text.encode("utf-16"), refused()),
    ]


def cases(inputs: Path) -> st.SearchStrategy[Case]:
    text = (inputs / FILE).read_text()
    contents = st.one_of(
        mutated_table(text).map(lambda t: t.encode("utf-8", "surrogatepass")),
        mutated_table(text),
        mutated_bytes(Sound(text.encode())),
        st.binary(max_size=200),
    )
    return st.builds(
        _case,
        contents,
        st.sampled_from(CODES),
        st.lists(st.sampled_from(SWITCHES), max_size=2),
        st.sampled_from(LINES),
    )


def _case(content: str | bytes, code: str, switches: list[str], line: tuple) -> Case:
    if isinstance(content, str):
        content = content.encode(code, errors="replace")
    arguments, needs, outputs = line
    more = switches if arguments[0] == "import-log" else ()
    return Case((*arguments, *more), needs, {FILE: content}, outputs)


@st.composite
def mutated_table(draw, text: str) -> str:
    """The table with one to four of its cells, rows, columns or signs as other loggers, or nobody, would write them."""
    rows = [line.split(",") for line in text.splitlines()]
    separator, ending = ",", "\n"
    cells = st.sampled_from((*NUMBERS, *TEXTS, *TIMES))
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 4)))):
        row = draw(st.integers(0, len(rows) - 1)) if len(rows) > 1 else 0
        column = draw(st.integers(0, 3))
        match draw(
            st.sampled_from(
                ("cell", "cell", "column", "row", "rows", "separator", "ending", "lines", "order", "scale")
            )
        ):
            case "cell" if column < len(rows[row]):
                rows[row][column] = draw(cells)
            case "column":
                value = draw(cells)
                rows = [r if n == 0 else [*r[:column], value, *r[column + 1 :]] for n, r in enumerate(rows)]
            case "row":
                del rows[row:]
                rows = rows or [[""]]
            case "rows":
                rows[row:row] = [list(rows[row])] * draw(st.sampled_from((1, 2, 1000)))
            case "separator":
                separator = draw(st.sampled_from(SEPARATORS))
            case "ending":
                ending = draw(st.sampled_from(("\r\n", "\r", "\n\n", "\n\r", "\x0b", ",\n")))
            case "lines":
                rows[row:row] = [
                    [draw(st.sampled_from(("", "# a comment", "% x", "// y", '"', ",", "NaN", "\0")))]
                ]
            case "order":
                rows = [rows[0], *rows[:0:-1]]
            case "scale":
                rows = [[c.replace(".", ",") if n else c for c in r] for n, r in enumerate(rows)]
    return ending.join(separator.join(r) for r in rows)
