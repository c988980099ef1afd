"""The frame of a self-contained page: style and script inside, nothing fetched."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from html import escape
from importlib.resources import files
from types import MappingProxyType

from mseg.evaluation.layout import TextTable

# Says to the browser what the page promises: nothing from anywhere else.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data:"


def page(title: str, body: str, script: str = "") -> str:
    """Wrap a body in a page that needs no other file and no network."""
    run = f"<script>{static('report.js')}</script>" if script == "report" else ""
    return (
        "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
        "<meta name='viewport' content='width=device-width, initial-scale=1'>"
        "<meta name='color-scheme' content='light dark'>"
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        f"<link rel='icon' href='data:,'><title>{escape(title)}</title>"
        f"<style>{static('page.css')}</style></head><body><main>{body}</main>{run}</body></html>\n"
    )


def html_table(table: TextTable, *, kind: str = "", marks: Mapping[int, str] = MappingProxyType({})) -> str:
    """Turn a table of texts into HTML.

    Parameters
    ----------
    table : TextTable
        Title, columns, rows and notes.
    kind : str
        Class of the table, for the style.
    marks : mapping of int to str
        Row -> its class.
    """
    head = "".join(f"<th scope='col'>{escape(c)}</th>" for c in table.columns)
    rows = "".join(
        f"<tr class='{marks.get(i, '')}'><th scope='row'>{escape(row[0])}</th>"
        + "".join(f"<td>{escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for i, row in enumerate(table.rows)
    )
    notes = "".join(f"<p class='quiet'>{escape(note)}</p>" for note in table.notes)
    return (
        f"<div class='scroll'><table class='{kind}'><caption>{escape(table.title)}</caption>"
        f"<thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table></div>{notes}"
    )


@cache
def static(name: str) -> str:
    """Text of a file that comes with the package."""
    return files("mseg.evaluation").joinpath("static", name).read_text(encoding="utf-8")
