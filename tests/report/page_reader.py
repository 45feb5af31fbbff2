"""Read a page back: tables with their cells, names, targets, and texts."""

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
