"""Arguments that several commands take, and the progress bar."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from kt3dmoseg.options import add_parameters


def add_submission(parser: argparse.ArgumentParser) -> None:
    """Add a submission and the data that it is for."""
    parser.add_argument("submission", metavar="SUBMISSION", help="folder or zip")
    parser.add_argument("data", metavar="DATA", help="folder of clips with labels (or one clip file)")
    add_benchmark_flag(parser)


def add_benchmark_flag(parser: argparse.ArgumentParser) -> None:
    """Add the choice of a protocol."""
    parser.add_argument(
        "--benchmark", default="", metavar="NAME", help="protocol (default: the submission's own)"
    )


def add_force_flag(parser: argparse.ArgumentParser) -> None:
    """Add the wish to score what is invalid."""
    parser.add_argument("--force", action="store_true", help="count clips with problems as fully wrong")


def add_running_flags(parser: argparse.ArgumentParser, *, seeds_help: str) -> None:
    """Add the flags."""
    parser.add_argument("--seeds", type=positive, default=1, metavar="N", help=seeds_help)
    add_parameters(parser, "a method, see 'mseg methods NAME'")
    parser.add_argument("--workers", type=positive, default=1, metavar="N", help="processes (default: 1)")
    parser.add_argument("--dask", default="", metavar="ADDRESS", help="Dask scheduler, tcp://host:8786")
    parser.add_argument("--quiet", action="store_true", help="no progress bar")


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[Callable[[int, int, str], None]]:
    """Give a function that draws progress on standard error, where that is a terminal."""
    from tqdm import tqdm

    with tqdm(disable=True if quiet else None, unit="task", smoothing=0) as bar:

        def show(done: int, total: int, name: str) -> None:
            bar.total = total
            bar.set_postfix_str(name, refresh=False)
            bar.update(done - bar.n)

        yield show


def positive(text: str) -> int:
    """Take a whole number from 1 up."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number >= 1, found {text!r}")
    return int(text)
