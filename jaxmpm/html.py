"""What notebooks show: tables, pictures inline. Text in, HTML out; notebooks bring their own style."""

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

KINDS = {".png": "image/png", ".svg": "image/svg+xml", ".gif": "image/gif"}  # what a browser shows inline


def table(rows: Iterable[Sequence], header: Sequence[str] = ()) -> str:
    """A table; its cells are escaped unless they come as `Markup`."""
    left = ' style="text-align:left"'
    head = "".join(f"<th{left}>{_cell(one)}</th>" for one in header)
    body = "".join("<tr>" + "".join(f"<td{left}>{_cell(one)}</td>" for one in row) + "</tr>" for row in rows)
    return "<table>" + (f"<thead><tr>{head}</tr></thead>" if head else "") + f"<tbody>{body}</tbody></table>"


class Markup(str):
    """HTML already, not to be escaped."""


def _cell(value) -> str:
    return value if isinstance(value, Markup) else escape(str(value))


def image(data: bytes, suffix: str, name: str = "", width: str = "48%") -> str:
    """A picture inline, no wider than that share of the page."""
    text = base64.b64encode(data).decode()
    return f'<img alt="{escape(name)}" src="data:{KINDS[suffix]};base64,{text}" style="max-width:{width};height:auto">'


@dataclass(frozen=True)
class Pictures:
    """Pictures on disk: inline in a notebook, by name elsewhere."""

    paths: tuple[Path, ...]

    def __iter__(self):
        return iter(self.paths)

    def __len__(self):
        return len(self.paths)

    def __getitem__(self, k):
        return self.paths[k]

    def __repr__(self):
        return "\n".join(map(str, self.paths))

    def _repr_html_(self):
        shown = (
            image(path.read_bytes(), path.suffix, path.name) if path.suffix in KINDS else f"<p>{escape(str(path))}</p>"
            for path in self.paths
        )
        return "".join(shown)
