"""Read pages and LaTeX tables back: cells, names, targets, texts and numbers."""

import re
from dataclasses import dataclass, field
from html.parser import HTMLParser

VOID = {"meta", "br", "link", "img", "input", "hr"}


@dataclass
class Node:
    tag: str
    attrs: dict
    children: list = field(default_factory=list)

    @property
    def text(self):
        text = "".join(c if isinstance(c, str) else c.text for c in self.children)
        return f"^{text}" if self.tag == "sup" else text

    def every(self):
        for child in self.children:
            if isinstance(child, Node):
                yield child
                yield from child.every()

    def all(self, tag, **wanted):
        return (
            node
            for node in self.every()
            if node.tag == tag and wanted.items() <= node.attrs.items()
        )


class _Reader(HTMLParser):
    def __init__(self):
        super().__init__(convert_charrefs=True)
        self.root = Node("root", {})
        self.open = [self.root]

    def handle_starttag(self, tag, attrs):
        node = Node(tag, dict(attrs))
        self.open[-1].children.append(node)
        if tag not in VOID:
            self.open.append(node)

    def handle_endtag(self, tag):
        assert self.open[-1].tag == tag, (self.open[-1].tag, tag)
        self.open.pop()

    def handle_data(self, data):
        self.open[-1].children.append(data)


def read_page(text):
    """Return the root of a page whose every element is closed."""
    reader = _Reader()
    reader.feed(text)
    reader.close()
    assert reader.open == [reader.root]
    return reader.root


def number(text):
    """Value, sd, ends or limit of what a page shows, scaled; and the weight of the last digit."""
    text = text.replace("\u2212", "-").replace("\u00a0", " ").strip()
    text, _, power = text.partition(" × 10^")
    factor = 10.0 ** int(power or 0)
    text = text.removeprefix("(").removesuffix(")")
    decimals = len(re.search(r"\d+\.?\d*", text)[0].partition(".")[2])
    last = factor * 10.0**-decimals
    numbers = [factor * float(x) for x in re.findall(r"-?\d+\.?\d*", text)]
    return numbers, last


def latex_number(text):
    """Read the same of a LaTeX cell; an uncertainty in parentheses counts last digits."""
    text = re.sub(r"\\num\{([^}]*)\}", r"\1", text)
    power = re.search(r"(?:e|10\^\{)(-?\d+)", text)
    text = text.partition("e")[0]
    last = 10.0 ** (int(power[1] if power else 0) - len(re.search(r"\d+\.?(\d*)", text)[1]))
    factor = 10.0 ** int(power[1] if power else 0)
    if (uncertainty := re.fullmatch(r"(-?[\d.]+)\((\d+)\)", text)) is not None:
        return [float(uncertainty[1]) * factor, int(uncertainty[2]) * last], last
    return [float(x) * factor for x in re.findall(r"-?\d+\.?\d*", text)], last


def latex_lines(table):
    """Cells of every line of a LaTeX table."""
    body = table.partition(r"\midrule")[2].partition(r"\bottomrule")[0]
    return [
        [cell.strip() for cell in line.removesuffix(r" \\").split(" & ")]
        for line in body.splitlines()
        if line.endswith(r" \\") and not line.startswith(r"\multicolumn")
    ]
