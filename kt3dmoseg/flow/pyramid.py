"""The default flow: DIS for large motions, a variational pyramid for precision, sharp outlines."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from threading import get_ident

import cv2
import numpy as np

from kt3dmoseg.compiled import compiled
from kt3dmoseg.errors import InvalidValueError
from kt3dmoseg.flow import check_pair, smooth
from kt3dmoseg.options import option
from kt3dmoseg.types import ByteArray
from kt3dmoseg.types import Float32Array as Array

_SIDE = 5
_CAP = 20
_REPLICATE = cv2.BORDER_REPLICATE
_ZETA = 0.1
_DIRECTIONS = ((1, 0), (-1, 0), (0, 1), (0, -1))


@dataclass(frozen=True)
class VariationalPyramid:
    """DIS at half size, refined level by level up to full size.

    DIS (Kroeger, Timofte, Dai, Van Gool, ECCV 2016) finds motions of any size. At each level the
    energy of Brox, Bruhn, Papenberg and Weickert (ECCV 2004) - robust constancy of gray values and
    of gradients, robust smoothness - is minimised around the flow so far (`_minimise`), each
    constancy term divided by the squared gradient plus 0.1^2. `contrast` moves that 0.1: at the
    default, edges steeper than 0.1 / 0.02 = 5 gray values per pixel count alike and fainter ones
    less, so that noise in flat regions has little weight. As soon as the flow has full size, motion that has
    spread over outlines is taken back (`sharpen`). The linear equations are relaxed far
    beyond the usual 1.6: near 2, successive overrelaxation converges fastest on a grid this large (Young,
    "Iterative Solution of Large Linear Systems", 1971, chapter 6). Measured in docs/tracking.md.
    """

    smoothing: float = option(0.8, "smoothing of the frames before the refinement, sigma", low=0, high=5)
    scales: tuple[float, ...] = option(
        (0.5, 0.7, 1.0, 1.0), "size of each level to the frame; the flow is warped once at each"
    )
    contrast: float = option(
        0.02, "gray values are multiplied by this before the refinement", low=1e-4, high=10
    )
    alpha: float = option(18.0, "weight of smoothness", low=0)
    delta: float = option(2.0, "weight of gray value constancy", low=0)
    gamma: float = option(6.0, "weight of gradient constancy", low=0)
    epsilon: float = option(0.01, "the robust penalty is sqrt(x^2 + epsilon^2)", low=1e-6, high=10)
    iterations: int = option(3, "fixed-point iterations at each level", low=1, high=100)
    relaxations: int = option(5, "SOR sweeps in each fixed-point iteration", low=1, high=100)
    overrelaxation: float = option(1.95, "step of a sweep to the one that solves a row", low=0.1, high=1.99)
    reach: tuple[int, ...] = option(
        (7,), "distances in pixels at which other motions are tried once the flow has full size"
    )
    share: float = option(
        0.95,
        "another motion must bring the patch's difference under share * difference - floor",
        low=0,
        high=1,
    )
    floor: float = option(0.3, "that floor, in gray values", low=0, high=255)

    def __post_init__(self) -> None:
        if not self.scales or not all(0.1 <= scale <= 1 for scale in self.scales) or self.scales[-1] != 1:
            raise InvalidValueError(
                "scales", expected="sizes from 0.1 to 1, the last 1", found=f"{self.scales}"
            )
        if not all(distance >= 1 for distance in self.reach):
            raise InvalidValueError("reach", expected="distances of at least 1 pixel", found=f"{self.reach}")

    def __call__(self, a: ByteArray, b: ByteArray) -> Array:
        """Displacement of every pixel of `a`; see `kt3dmoseg.flow.Flow`."""
        check_pair(a, b)
        field = _seed(a, b)
        frames = [smooth(frame * np.float32(self.contrast), self.smoothing) for frame in (a, b)]
        for level, scale in enumerate(self.scales):
            size = round(a.shape[0] * scale), round(a.shape[1] * scale)
            # Smoothed as they are, the frames need no averaging at half size and above.
            first, second, field = (_resized(picture, size) for picture in (*frames, field))
            if level == self.scales.index(1):
                field = sharpen(a, b, field, reach=self.reach, share=self.share, floor=self.floor)
            field = self._refined(first, second, field)
        return field

    def _refined(self, first: Array, second: Array, field: Array) -> Array:
        """Warp the second frame by a flow, minimise the energy around it, and change it in place."""
        height, width = first.shape
        planes = np.empty((7, height, width + 2), np.float32)
        target = _pixels(first.shape) + field
        warped = cv2.remap(second, target, None, cv2.INTER_LINEAR, borderMode=_REPLICATE)  # type: ignore[call-overload]  # its stub forgets None
        _expand(first, warped, field, planes)
        halved = self.alpha / 2, self.delta / 2, self.gamma / 2
        weights = np.array([*halved, self.epsilon, _ZETA, self.overrelaxation], np.float32)
        weights[3:5] **= 2
        _minimise(planes, weights, self.iterations, 2 * self.relaxations)
        for axis in (0, 1):
            field[..., axis] += planes[5 + axis, :, 1:-1]
        return field


def _seed(a: ByteArray, b: ByteArray) -> Array:
    """DIS medium on lightly smoothed frames, without its own refinement: the pyramid does better."""
    smooth_a, smooth_b = (cv2.GaussianBlur(frame, (5, 5), 0.8) for frame in (a, b))
    field = _search(get_ident()).calc(smooth_a, smooth_b, None)  # type: ignore[call-overload]  # its stub forgets None
    return np.asarray(field, np.float32)


@lru_cache(maxsize=1)
def _search(_thread: int) -> cv2.DISOpticalFlow:
    """Make a thread's solver and keep it, with its memory."""
    solver = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    solver.setVariationalRefinementIterations(0)
    return solver


def _resized(picture: Array, shape: tuple[int, int]) -> Array:
    """Resample a frame, or a field, whose vectors are scaled alike."""
    if picture.shape[:2] == shape:
        return picture
    result = np.asarray(cv2.resize(picture, shape[::-1]), np.float32)
    for axis in (0, 1) if result.ndim == 3 else ():  # both at once, broadcast, take seven times as long
        result[..., axis] *= shape[1 - axis] / picture.shape[1 - axis]
    return result


def sharpen(
    a: ByteArray, b: ByteArray, field: Array, *, reach: Sequence[int], share: float, floor: float
) -> Array:
    """Replace motions by those of neighbours where these fit the frames clearly better.

    A smooth field carries the motion of an object some pixels beyond its outline. The right motion is
    then found a few pixels away, on the pixel's own side. A field fits as well as a patch about
    each pixel agrees with the patch that it leads to: the mean over 5 x 5 pixels of the absolute difference
    of gray values, none counted with more than 20, so that the other side of the outline, which moves
    differently, has little weight. Trying the neighbours' motions is the propagation of PatchMatch
    (Barnes, Shechtman, Finkelstein, Goldman, SIGGRAPH 2009); the cost with its cap is common in stereo
    (Hosni, Rhemann, Bleyer, Rother, Gelautz, PAMI 2013).

    `reach` lists distances in pixels of the neighbours: left, right, above and below at each. The first
    change must bring the mean difference under ``share * difference - floor``, so that noise moves nothing;
    further ones need only be better.
    """
    (height, width), pixels = a.shape, _pixels(a.shape)

    def difference(candidates: Array) -> Array:
        """Mean capped difference of patches; outside, the second frame is black."""
        seen = cv2.remap(b, pixels + candidates, None, cv2.INTER_LINEAR)  # type: ignore[call-overload]  # its stub forgets None
        apart = cv2.min(cv2.absdiff(seen, a), _CAP)  # type: ignore[call-overload]  # nor numbers
        return np.asarray(cv2.boxFilter(apart, cv2.CV_32F, (_SIDE, _SIDE)), np.float32)

    limit = np.asarray(difference(field) * np.float32(share) - np.float32(floor), np.float32)
    result = field.copy()
    for far in reach:
        around = np.asarray(cv2.copyMakeBorder(result, far, far, far, far, _REPLICATE), np.float32)
        for x, y in _DIRECTIONS:
            left, top = far * (1 + x), far * (1 + y)
            candidates = around[top : top + height, left : left + width]
            found = difference(candidates)
            better = cv2.compare(found, limit, cv2.CMP_LT)
            cv2.copyTo(candidates, better, result)
            cv2.copyTo(found, better, limit)
    return result


@lru_cache(maxsize=4)
def _pixels(shape: tuple[int, ...]) -> Array:
    """Where the pixels of frames (H, W) are, (H, W, 2); kept, as making it takes longer than adding to it."""
    return np.dstack(np.meshgrid(*(np.arange(side, dtype=np.float32) for side in shape[::-1])))


# The solver: equations, and the order of all operations on a pixel, are those of OpenCV's
# `VariationalRefinement`, so both give the same bits. Here rows stay in the processor's cache from their
# equations to the last sweep over them.


@compiled
def _expand(first: Array, warped: Array, field: Array, planes: Array) -> None:
    """Make the `planes` of `_minimise` from the first and the warped second frame (H, W) and the flow."""
    height, width = first.shape
    for i in range(height):
        h, k, half = max(i - 1, 0), min(i + 1, height - 1), np.float32(0.5)
        a, b, a0, b0, a1, b1 = first[i], warped[i], first[h], warped[h], first[k], warped[k]
        x, y, z = planes[0, i, 1:], planes[1, i, 1:], planes[2, i, 1:]
        u, v, du, dv = planes[3, i, 1:], planes[4, i, 1:], planes[5, i, 1:], planes[6, i, 1:]
        for j in range(width):
            y[j], z[j] = half * (a1[j] + b1[j] - (a0[j] + b0[j])), b[j] - a[j]
        for j in range(width):
            u[j], v[j], du[j], dv[j] = field[i, j, 0], field[i, j, 1], 0, 0
        for j in range(1, width - 1):
            x[j] = half * (a[j + 1] + b[j + 1] - (a[j - 1] + b[j - 1]))
        for j in (0, width - 1):
            right, left = min(j + 1, width - 1), max(j - 1, 0)
            x[j] = half * (a[right] + b[right] - (a[left] + b[left]))
        for plane in planes:
            plane[i, 0], plane[i, -1] = plane[i, 1], plane[i, -2]


@compiled
def _minimise(planes: Array, weights: Array, iterations: int, halves: int) -> None:
    """Find the change of a flow (u, v) that minimises the energy of Brox et al. around it.

    That is the (du, dv) of least sum over the pixels of

        delta psi((Iz + Ix du + Iy dv)^2 / n) + gamma psi(sum of the same for both derivatives of I)
        + alpha psi(|grad (u + du)|^2 + |grad (v + dv)|^2) + z (du^2 + dv^2) / 2,    psi(s) = sqrt(s + e),

    where n = Ix^2 + Iy^2 + z. Each of the `iterations` fixes the slopes of psi and relaxes the linear
    equations by red-black successive overrelaxation: in `halves` half sweeps over the pixels of one colour.
    Once row i has its equations, half sweep k can do row i - 1 - k, around which half sweep k - 1 has been.
    So only the last rows are held, in a ring (rows, colours, 8, pixels): a11, a22, b1, b2, a12, the weight
    of the links to the next pixels, du, dv. The first pixel of the frame has colour 0.

    Parameters
    ----------
    planes : (7, H, W + 2) float32
        Ix, Iy, Iz, u, v, and du, dv, which are 0 and changed in place; all with their first and last column
        repeated.
    weights : (6,) float32
        alpha / 2, delta / 2, gamma / 2, e, z, and the overrelaxation.
    """
    height, width = planes.shape[1], planes.shape[2] - 2
    ring = np.empty((halves + 4, 2, 8, width // 2 + 3), np.float32)  # even: which colour has more alternates
    row, links = np.empty((8, width + 2), np.float32), np.empty((2, 6, width + 2), np.float32)
    for _ in range(iterations):
        ring[:] = 0
        links[:] = 0
        for i in range(height + halves + 1):
            if i < height:
                _equate(planes, i, weights, links[i % 2], links[1 - i % 2], row)
                _split(row, ring[i % len(ring)], i % 2)
            else:
                ring[i % len(ring)] = 0
            for half in range(halves):
                if 0 <= i - 1 - half < height:
                    _relax(ring, i - 1 - half, half % 2, width, weights[5])
            if 0 <= i - halves < height:
                _merge(ring[(i - halves) % len(ring)], planes, i - halves)


@compiled
def _equate(
    planes: Array,
    i: int,
    weights: Array,
    links: Array,
    above: Array,
    row: Array,
) -> None:
    """Set up the equations of row i, and its links to the next pixels and the row below, three rows each.

    These are weights, and weights times differences of u and v.
    """
    _link(planes, i, weights, links)
    right, down, w, du, dv = links[0], links[3], row[5], row[6], row[7]
    for x in range(len(w)):
        w[x], du[x], dv[x] = right[x], planes[5, i, x], planes[6, i, x]
        down[x] = right[x] if i + 1 < planes.shape[1] else 0
    right[-2] = 0  # nothing follows the last pixel
    _fit(planes, i, weights, row)
    _join(links, above, i % 2, row)


@compiled
def _link(planes: Array, i: int, weights: Array, links: Array) -> None:
    u, v, du, dv, k = planes[3, i], planes[4, i], planes[5, i], planes[6, i], min(i + 1, planes.shape[1] - 1)
    below_u, below_v, below_du, below_dv = planes[3, k], planes[4, k], planes[5, k], planes[6, k]
    weight, right_u, right_v, down_u, down_v = links[0], links[1], links[2], links[4], links[5]
    alpha, least = weights[0], weights[3]
    for x in range(1, len(u) - 1):
        here_u, here_v = u[x] + du[x], v[x] + dv[x]
        ux, vx = u[x + 1] + du[x + 1] - here_u, v[x + 1] + dv[x + 1] - here_v
        uy, vy = below_u[x] + below_du[x] - here_u, below_v[x] + below_dv[x] - here_v
        w = alpha / np.sqrt(ux * ux + vx * vx + uy * uy + vy * vy + least)
        weight[x] = w
        right_u[x], right_v[x] = w * (u[x + 1] - u[x]), w * (v[x + 1] - v[x])
        down_u[x], down_v[x] = w * (below_u[x] - u[x]), w * (below_v[x] - v[x])


@compiled
def _fit(planes: Array, i: int, weights: Array, row: Array) -> None:
    h, k = max(i - 1, 0), min(i + 1, planes.shape[1] - 1)
    above_x, above_y, above_z = planes[0, h], planes[1, h], planes[2, h]
    here_x, here_y, here_z = planes[0, i], planes[1, i], planes[2, i]
    below_x, below_y, below_z = planes[0, k], planes[1, k], planes[2, k]
    du, dv, a11, a22, b1, b2, a12 = planes[5, i], planes[6, i], row[0], row[1], row[2], row[3], row[4]
    delta, gamma, least, zeta = weights[1], weights[2], weights[3], weights[4]
    for j in range(1, len(du) - 1):
        x, y, z = here_x[j], here_y[j], here_z[j]
        n, rest = x * x + y * y + zeta, z + x * du[j] + y * dv[j]
        w = delta / np.sqrt(rest * rest / n + least) / n
        xx, xy, yy = here_x[j + 1] - here_x[j - 1], below_x[j] - above_x[j], below_y[j] - above_y[j]
        xz, yz = here_z[j + 1] - here_z[j - 1], below_z[j] - above_z[j]
        nx, ny = xx * xx + xy * xy + zeta, yy * yy + xy * xy + zeta
        rest_x, rest_y = xz + xx * du[j] + xy * dv[j], yz + xy * du[j] + yy * dv[j]
        g = gamma / np.sqrt(rest_x * rest_x / nx + rest_y * rest_y / ny + least)
        a11[j] = w * (x * x) + zeta + g * (xx * xx / nx + xy * xy / ny)
        a22[j] = w * (y * y) + zeta + g * (xy * xy / nx + yy * yy / ny)
        b1[j] = -(w * (z * x)) - g * (xx * xz / nx + xy * yz / ny)
        b2[j] = -(w * (z * y)) - g * (xy * xz / nx + yy * yz / ny)
        a12[j] = w * (x * y) + g * (xx * xy / nx + xy * yy / ny)


@compiled
def _join(links: Array, above: Array, colour: int, row: Array) -> None:
    """Add the links to the equations of a row: colour 0 adds its own first."""
    w, u, v, w_down, u_down, v_down = links[0], links[1], links[2], links[3], links[4], links[5]
    w_up, u_up, v_up, a11, a22, b1, b2 = above[3], above[4], above[5], row[0], row[1], row[2], row[3]
    for x in range(1, len(w) - 1):
        own_first = (x & 1) != colour
        right, left, down, up = w[x], w[x - 1], w_down[x], w_up[x]
        one, two, three, four = (right, left, down, up) if own_first else (left, right, up, down)
        a11[x], a22[x] = a11[x] + one + two + three + four, a22[x] + one + two + three + four
    for x in range(1, len(w) - 1):
        own_first = (x & 1) != colour
        one, two = (u[x], -u[x - 1]) if own_first else (-u[x - 1], u[x])
        three, four = (u_down[x], -u_up[x]) if own_first else (-u_up[x], u_down[x])
        b1[x] = b1[x] + one + two + three + four
        one, two = (v[x], -v[x - 1]) if own_first else (-v[x - 1], v[x])
        three, four = (v_down[x], -v_up[x]) if own_first else (-v_up[x], v_down[x])
        b2[x] = b2[x] + one + two + three + four


@compiled
def _split(row: Array, here: Array, colour: int) -> None:
    width = row.shape[1] - 2
    for k in range(8):
        source, first, second = row[k, 1:], here[colour, k, 1:], here[1 - colour, k, 1:]
        for j in range(width // 2):
            first[j], second[j] = source[2 * j], source[2 * j + 1]
        if width % 2:
            first[width // 2] = source[width - 1]


@compiled
def _merge(here: Array, planes: Array, i: int) -> None:
    width, colour = planes.shape[2] - 2, i % 2
    for k in range(2):
        row, first, second = planes[5 + k, i, 1:], here[colour, 6 + k, 1:], here[1 - colour, 6 + k, 1:]
        for j in range(width // 2):
            row[2 * j], row[2 * j + 1] = first[j], second[j]
        if width % 2:
            row[width - 1] = first[width // 2]
        row[width] = row[width - 1]


@compiled
def _relax(ring: Array, i: int, colour: int, width: int, step: np.float32) -> None:
    here, start = ring[i % len(ring)], (i + colour) % 2
    own, other = here[colour], here[1 - colour]
    above, below = ring[(i - 1) % len(ring), 1 - colour], ring[(i + 1) % len(ring), 1 - colour]
    a11, a22, b1, b2, a12 = own[0, 1:], own[1, 1:], own[2, 1:], own[3, 1:], own[4, 1:]
    w, w_left, w_up, du, dv = own[5, 1:], other[5, start:], above[5, 1:], own[6, 1:], own[7, 1:]
    left_u, right_u, up_u, down_u = other[6, start:], other[6, start + 1 :], above[6, 1:], below[6, 1:]
    left_v, right_v, up_v, down_v = other[7, start:], other[7, start + 1 :], above[7, 1:], below[7, 1:]
    for j in range((width - start + 1) // 2):
        u = w_left[j] * left_u[j] + w[j] * right_u[j] + w_up[j] * up_u[j] + w[j] * down_u[j]
        v = w_left[j] * left_v[j] + w[j] * right_v[j] + w_up[j] * up_v[j] + w[j] * down_v[j]
        now = du[j] + step * ((u + b1[j] - dv[j] * a12[j]) / a11[j] - du[j])
        du[j] = now
        dv[j] += step * ((v + b2[j] - now * a12[j]) / a22[j] - dv[j])
