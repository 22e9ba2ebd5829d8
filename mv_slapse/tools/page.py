"""An HTML page in one file, pictures and all."""

import base64
from collections.abc import Iterable, Mapping
from html import escape
from io import BytesIO
import json
from typing import Any

from matplotlib.figure import Figure
from mv_slapse.tools.plain import plain

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem;
  color: #222 } h1 { font-size: 1.6rem } h2 { font-size: 1.15rem; margin-top: 2.2rem }
table { border-collapse: collapse } td, th { padding: .25rem .8rem; border-bottom: 1px solid #ddd;
  text-align: left } td:nth-child(2) { text-align: right; font-weight: 600; white-space: nowrap }
img { max-width: 100% } pre { background: #f5f5f5; padding: .8rem; overflow: auto;
  font-size: 12px } .legend b { padding: 0 .5em; margin-right: .3em }
"""


def page(title: str, sections: Iterable[tuple[str, str]]) -> str:
    """Return a page of sections, each a title and its content as HTML."""
    body = '\n'.join(f'<h2>{escape(name)}</h2>\n{content}' for name, content in sections)
    head = f'<meta charset="utf-8"><title>mv_slapse</title><style>{STYLE}</style>'
    return (f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>'
            f'<h1>{escape(title)}</h1>\n{body}\n</body></html>\n')


def table(rows: Iterable[tuple[str, ...]], head: tuple[str, ...] = ('', 'result', 'meaning')
          ) -> str:
    """Return a table of texts."""
    body = ''.join('<tr>' + ''.join(f'<td>{escape(cell)}</td>' for cell in row) + '</tr>'
                   for row in rows)
    return ('<table><tr>' + ''.join(f'<th>{escape(cell)}</th>' for cell in head)
            + f'</tr>{body}</table>')


def image(png_bytes: bytes, name: str) -> str:
    """Return a picture that is part of the page."""
    data = base64.b64encode(png_bytes).decode('ascii')
    return f'<img alt="{escape(name)}" src="data:image/png;base64,{data}">'


def png(figure: Figure) -> bytes:
    """Return a figure as PNG; without the date and the version two runs give the same file."""
    file = BytesIO()
    figure.savefig(file, format='png', metadata={'Software': None})
    return file.getvalue()


def listing(content: Mapping[str, Any]) -> str:
    """Return content as indented JSON."""
    return f'<pre>{escape(json.dumps(plain(content), indent=1))}</pre>'
