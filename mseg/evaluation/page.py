"""The frame of a self-contained page: style and script inside, nothing fetched."""

from __future__ import annotations

from functools import cache
from html import escape
from importlib.resources import files

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


@cache
def static(name: str) -> str:
    """Text of a file that comes with the package."""
    return files("mseg.evaluation").joinpath("static", name).read_text(encoding="utf-8")
