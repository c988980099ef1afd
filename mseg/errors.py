"""Errors of mseg; all belong to the family of `kt3dmoseg.errors`."""

from kt3dmoseg.errors import InvalidValueError, KT3DMoSegError


class SegmentationError(KT3DMoSegError):
    """A method cannot segment a clip, or in a run none; the message is the reason that reports show."""

    exit_code = 1


class FaultyMethodError(SegmentationError, ValueError):
    """A method raised an error of another family, or returned no segmentation of the clip."""


class TooFewPointsError(SegmentationError, InvalidValueError):
    """A clip holds too few trajectories or frames for the request."""


class IncompleteTrajectoriesError(SegmentationError, InvalidValueError):
    """A method that needs complete trajectories was given gaps."""


class RejectedSubmissionError(KT3DMoSegError):
    """A submission is invalid."""

    exit_code = 1
