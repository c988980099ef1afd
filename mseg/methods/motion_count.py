"""The number of motions, where a method has to be told."""

from __future__ import annotations

from kt3dmoseg.errors import InvalidValueError


def told(n_motions: int | None, method: object) -> int:
    """Return the number of motions, for a method that cannot find it by itself.

    Raises
    ------
    InvalidValueError
        When it is None.
    """
    if n_motions is None:
        raise InvalidValueError(
            "n_motions",
            expected=f"a number: {type(method).__name__} cannot find it",
            found="none",
            fix="give --n-motions N, or segment(..., n_motions=N)",
        )
    return n_motions
