"""Values show themselves: HTML in notebooks, plots, data frames."""

from __future__ import annotations

import re
import sys

import matplotlib as mpl
import numpy as np
import pytest

import mseg
from kt3dmoseg.draw.palette import PALETTE, css
from kt3dmoseg.errors import InvalidValueError, MissingDependencyError, UnknownNameError
from kt3dmoseg.types import Clip, Labels, Trajectories
from mseg.evaluation import compare
from mseg.types import Segmentation

mpl.use("agg")
from matplotlib import pyplot
from matplotlib.colors import to_hex


@pytest.fixture(autouse=True)
def _close_figures():
    yield
    pyplot.close("all")


def make_clip() -> Clip:
    """Four trajectories over 3 frames; the second is invisible in frame 2, the last is not evaluated."""
    xy = np.arange(24.0).reshape(4, 3, 2)
    visible = np.ones((4, 3), dtype=bool)
    visible[1, 2] = False
    xy[~visible] = np.nan
    tracks = Trajectories(xy, visible, np.array([10, 11, 12, 13]), image_size=(40, 30))
    labels = Labels(np.array([1, 2, 2]), background=1, names={2: "<b>van</b>"})
    return Clip("Seq", tracks, np.array([0, 1, 2]), labels, frame_numbers=np.array([5, 6, 7]))


CLIP = make_clip()
FOUND = Segmentation(np.array([4, 7, 4]), {"notes": ("did not converge",), "rank": 3})
SCORES = mseg.score(CLIP, FOUND)
COMPARISON = compare([SCORES, mseg.score(CLIP, Segmentation(np.array([1, 1, 1])))])
EVERY = (CLIP, CLIP.dense, CLIP.labels, FOUND, SCORES, COMPARISON)


def points(axes):
    """Positions and colours of the points in a plot."""
    dots = axes.collections[1]
    return dots.get_offsets().tolist(), [to_hex(colour) for colour in dots.get_facecolors()]


@pytest.mark.parametrize("value", EVERY, ids=lambda value: type(value).__name__)
def test_every_value_has_a_table_a_plot_and_a_data_frame(value):
    html = value._repr_html_()
    assert len(re.findall("<table>", html)) == len(re.findall("</table>", html)) > 0
    assert isinstance(value.plot(), mpl.axes.Axes)
    assert len(value.to_dataframe()) > 0


def test_names_cannot_bring_html_of_their_own():
    assert "&lt;b&gt;van&lt;/b&gt;" in CLIP._repr_html_()
    assert "<b>van" not in CLIP._repr_html_() + CLIP.labels._repr_html_()
    shown = mseg.score({"<i>": CLIP}, {"<i>": FOUND})._repr_html_()
    assert "&lt;i&gt;" in shown
    assert "<i>" not in shown


def test_html_shows_the_facts():
    html = CLIP._repr_html_()
    for fact in ("3, 5 to 7", "40 x 30 pixels", "4, 3 of them evaluated", "66.7 %"):
        assert fact in html
    assert "did not converge" in FOUND._repr_html_()
    assert "33.33" in SCORES._repr_html_()
    assert COMPARISON.pairs[0].sentence in COMPARISON._repr_html_()
    assert repr(COMPARISON) == "Comparison(error of labels (1), labels (2))"


def test_a_frame_is_plotted_in_pixels_and_in_the_palette():
    axes = CLIP.plot(frame=2)
    xy, colours = points(axes)
    assert xy == [[4.0, 5.0], [16.0, 17.0]]  # the second is invisible there
    assert colours == ["#9aa7b8", css(PALETTE[1])]
    assert axes.get_xlim() == (-0.5, 39.5)
    assert axes.get_ylim() == (29.5, -0.5)
    assert axes.get_title() == "Seq, frame 2"


def test_without_a_frame_every_trajectory_ends_where_it_was_last_visible():
    xy, _ = points(CLIP.plot())
    assert xy == [[4.0, 5.0], [8.0, 9.0], [16.0, 17.0]]


def test_predictions_take_the_colours_of_the_motions_they_match_and_ring_the_others():
    axes = FOUND.plot(CLIP, 1)
    assert points(axes)[1] == ["#9aa7b8", css(PALETTE[1]), "#9aa7b8"]
    assert axes.collections[2].get_offsets().tolist() == [[14.0, 15.0]]


@pytest.mark.parametrize("frame", [3, -1, 1.5, "1"])
def test_a_frame_that_is_none_is_refused(frame):
    with pytest.raises(InvalidValueError, match=r"frame: expected None or 0\.\.2"):
        CLIP.plot(frame)


def test_a_picture_of_another_size_is_refused():
    with pytest.raises(InvalidValueError, match=r"picture: expected \(30, 40\)"):
        CLIP.plot(0, picture=np.zeros((40, 30)))
    assert CLIP.plot(0, picture=np.zeros((30, 40, 3), np.uint8)).images
    [shown] = CLIP.plot(0, picture=np.full((30, 40), 0.5)).images  # as plt.imread reads a file
    assert (shown.get_array() == 128).all()
    for picture in (np.full((30, 40), 300, np.uint16), np.full((30, 40), 1.5)):
        with pytest.raises(InvalidValueError, match="picture: expected uint8, or 0 to 1"):
            CLIP.plot(0, picture=picture)


def test_a_segmentation_of_another_clip_is_refused():
    other = Segmentation(np.array([1, 2]))
    for call in (other.plot, other.to_dataframe):
        with pytest.raises(InvalidValueError, match="clip Seq: expected 2 evaluated trajectories, found 3"):
            call(CLIP)
    with pytest.raises(InvalidValueError, match="clip: expected the clip"):
        other.plot(frame=1)


def test_scores_are_plotted_in_the_unit_and_direction_of_the_metric():
    assert SCORES.plot().get_xlabel() == "error, % (lower is better)"
    assert SCORES.plot("nmi").get_xlabel() == "NMI, % (higher is better)"
    assert SCORES.plot().collections[1].get_offsets()[0][0] == pytest.approx(100 / 3)
    with pytest.raises(UnknownNameError, match="metric"):
        SCORES.plot("erorr")


def test_without_matplotlib_one_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    for value in (CLIP, CLIP.labels, SCORES):
        with pytest.raises(
            MissingDependencyError, match=r"^plots need matplotlib; pip install 'kt3dmoseg\[plot\]'$"
        ):
            value.plot()


def test_data_frames_hold_what_the_arrays_hold():
    dense = CLIP.dense.to_dataframe()
    assert list(dense.columns) == ["track", "frame", "x", "y"]
    assert len(dense) == CLIP.dense.visible.sum()
    assert dense.iloc[-1].tolist() == [13, 2, 22, 23]
    table = CLIP.to_dataframe().set_index(["track", "frame"])
    assert table.loc[(11, 1)].tolist() == [8, 9, 6, 2, "<b>van</b>"]
    assert 13 not in table.index.get_level_values("track")
    assert CLIP.labels.to_dataframe()["label"].tolist() == [1, 2, 2]
    assert SCORES.to_dataframe()["error"].tolist() == SCORES.matrix().ravel().tolist()
    assert COMPARISON.to_dataframe()["method"].tolist() == COMPARISON.names


def test_trajectories_are_an_xarray_dataset_over_track_and_frame():
    pytest.importorskip("xarray")
    data = CLIP.dense.to_xarray()
    assert data.sizes == {"track": 4, "frame": 3}
    assert data.x.sel(track=13, frame=2) == 22
    assert data.y.isnull().sum() == 1
    assert (data.x.units, data.image_size) == ("pixels", (40, 30))
    assert SCORES.to_xarray().error.sel(clip=SCORES.names[0], seed=0) == SCORES.error


def test_without_xarray_one_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(MissingDependencyError, match=r"needs xarray; pip install 'kt3dmoseg\[xarray\]'$"):
        CLIP.dense.to_xarray()


def test_a_data_frame_of_a_segmentation_is_scored_by_track():
    shuffled = FOUND.to_dataframe(CLIP).iloc[[2, 0, 1]]
    assert mseg.score(CLIP, shuffled).error == SCORES.error


def test_clips_without_points_frames_or_labels_are_shown_too():
    for shape in ((0, 3), (2, 3), (2, 0)):
        tracks = Trajectories(np.full((*shape, 2), np.nan), np.zeros(shape, dtype=bool))
        clip = Clip("empty", tracks, np.arange(shape[0]), Labels(np.zeros(shape[0], dtype=int)))
        assert clip._repr_html_()
        assert tracks._repr_html_()
        assert points(clip.plot())[0] == []
        assert clip.labels.plot()
        assert len(clip.to_dataframe()) == 0
