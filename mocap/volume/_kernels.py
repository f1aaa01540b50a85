"""Compiled loops on voxel lists: surface, smoothing, visibility, colour, components, reprojection.

Arrays and scalars only; each has a numpy twin in the tests.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mocap.data._voxel_kernels import subscripts_of


@njit(cache=True, nogil=True)
def subscripts_and_bounds(voxels, ny, nz):
    """(ix, iy, iz) (n, 3) int32 of linear indices, and the lower and (exclusive) upper corner, (3,) int64."""
    n = voxels.shape[0]
    subs = np.empty((n, 3), dtype=np.int32)
    lower = np.full(3, 2**31 - 1, dtype=np.int64)
    upper = np.zeros(3, dtype=np.int64)
    subscripts_of(voxels, ny, nz, subs)
    for i in range(n):
        for a in range(3):
            lower[a] = min(lower[a], np.int64(subs[i, a]))
            upper[a] = max(upper[a], np.int64(subs[i, a]) + 1)
    return subs, lower, upper


@njit(cache=True, nogil=True)
def fill_crop(subs, lower, crop):
    """Set crop[subs - lower] to 1 where that lies inside the crop (uint8, zero on entry)."""
    nx, ny, nz = crop.shape
    for i in range(subs.shape[0]):
        x, y, z = subs[i, 0] - lower[0], subs[i, 1] - lower[1], subs[i, 2] - lower[2]
        if x >= 0 and y >= 0 and z >= 0 and x < nx and y < ny and z < nz:
            crop[x, y, z] = 1


@njit(cache=True, nogil=True)
def mark_inner(subs, lower, value, crop):
    """Set the bits of a value in crop[subs - lower] where that lies inside the crop and not in its outermost layer."""
    nx, ny, nz = crop.shape
    for i in range(subs.shape[0]):
        x, y, z = subs[i, 0] - lower[0], subs[i, 1] - lower[1], subs[i, 2] - lower[2]
        if x > 0 and y > 0 and z > 0 and x < nx - 1 and y < ny - 1 and z < nz - 1:
            crop[x, y, z] |= value


@njit(cache=True, nogil=True)
def bounds_within(subs, low, high):
    """How many subscripts (n, 3) lie in low .. high, both included, and the corners of these, the upper exclusive."""
    n = 0
    lower = np.full(3, 2**31 - 1, dtype=np.int64)
    upper = np.zeros(3, dtype=np.int64)
    for i in range(subs.shape[0]):
        is_within = True
        for a in range(3):
            is_within &= low[a] <= subs[i, a] <= high[a]
        if is_within:
            n += 1
            for a in range(3):
                lower[a] = min(lower[a], np.int64(subs[i, a]))
                upper[a] = max(upper[a], np.int64(subs[i, a]) + 1)
    return n, lower, upper


@njit(cache=True, nogil=True)
def surface_of_crop(subs, lower, crop, is_surface):
    """Whether some 6-neighbour is empty; the crop must reach one voxel beyond every voxel."""
    for i in range(subs.shape[0]):
        x, y, z = subs[i, 0] - lower[0], subs[i, 1] - lower[1], subs[i, 2] - lower[2]
        full = (
            crop[x - 1, y, z] & crop[x + 1, y, z]
            & crop[x, y - 1, z] & crop[x, y + 1, z]
            & crop[x, y, z - 1] & crop[x, y, z + 1]
        )  # fmt: skip
        is_surface[i] = full == 0


@njit(cache=True, nogil=True)
def smooth_surface(subs, is_surface, lower, kernel, gain, corner, along_z, along_y, packed):
    """Gaussian-smoothed surface and occupancy in one byte, axis by axis; see surface.surface_map.

    subs : (n, 3).  lower : (3,) first voxel of `packed`, uint8 zeros.  kernel : (2 r + 1,) float32 weights.
    corner : (3,) element of `packed` (it may lie outside) at which the work arrays along_z, along_y begin, float32
    zeros; they must reach r beyond every element of `packed` that is wanted and that a surface voxel reaches.
    """
    nx, ny, nz = packed.shape
    fx, fy, fz = along_z.shape
    r = kernel.shape[0] // 2
    for i in range(subs.shape[0]):
        x, y, z = subs[i, 0] - lower[0], subs[i, 1] - lower[1], subs[i, 2] - lower[2]
        if x > 0 and y > 0 and z > 0 and x < nx - 1 and y < ny - 1 and z < nz - 1:
            packed[x, y, z] = 128
        x, y, z = x - corner[0], y - corner[1], z - corner[2]
        if is_surface[i] and x >= 0 and y >= 0 and x < fx and y < fy:
            for zz in range(max(z - r, 0), min(z + r, fz - 1) + 1):
                along_z[x, y, zz] += kernel[zz - z + r]
    for x in range(fx):
        for y in range(fy):
            out = along_y[x, y]
            for yy in range(max(y - r, 0), min(y + r, fy - 1) + 1):
                w = kernel[yy - y + r]
                row = along_z[x, yy]
                for z in range(fz):
                    out[z] += w * row[z]
    total = np.empty(fz, dtype=np.float32)
    z0, z1 = max(1 - corner[2], 0), min(nz - 1 - corner[2], fz)
    for x in range(max(1 - corner[0], 0), min(nx - 1 - corner[0], fx)):
        for y in range(max(1 - corner[1], 0), min(ny - 1 - corner[1], fy)):
            total[:] = 0.0
            for xx in range(max(x - r, 0), min(x + r, fx - 1) + 1):
                w = kernel[xx - x + r]
                row = along_y[xx, y]
                for z in range(fz):
                    total[z] += w * row[z]
            line = packed[corner[0] + x, corner[1] + y]
            for z in range(z0, z1):
                level = np.int32(total[z] * gain + np.float32(0.5))
                line[corner[2] + z] += np.uint8(min(level, np.int32(127)))


@njit(cache=True, nogil=True, error_model="numpy")
def line_of_sight(subs, pixels, crop, lower, eyes, skip, visible):
    """Walk voxel by voxel from voxel centres to the optical centres until something blocks or the crop ends.

    subs : (n, 3).  pixels : (n, C), negative = not in that picture.  crop : occupancy of the bounding box,
    uint8, with a layer of 2 ("outside") around it, first element at voxel `lower`.  eyes : (C, 3) optical
    centres in voxel units.  Voxels within `skip` (Chebyshev) of the start never block.  visible : (n, C) out.
    """
    _, ny, nz = crop.shape
    flat = crop.reshape(-1)
    jump_x, jump_y = np.int64(ny * nz), np.int64(nz)
    for i in range(subs.shape[0]):
        sx, sy, sz = subs[i, 0] - lower[0], subs[i, 1] - lower[1], subs[i, 2] - lower[2]
        home = (sx * ny + sy) * nz + sz
        for c in range(eyes.shape[0]):
            visible[i, c] = False
            if pixels[i, c] < 0:
                continue
            dx = eyes[c, 0] - lower[0] - (sx + 0.5)
            dy = eyes[c, 1] - lower[1] - (sy + 0.5)
            dz = eyes[c, 2] - lower[2] - (sz + 0.5)
            step_x = jump_x if dx > 0 else -jump_x
            step_y = jump_y if dy > 0 else -jump_y
            step_z = 1 if dz > 0 else -1
            gap_x = 1.0 / abs(dx) if dx != 0.0 else 1e30
            gap_y = 1.0 / abs(dy) if dy != 0.0 else 1e30
            gap_z = 1.0 / abs(dz) if dz != 0.0 else 1e30
            next_x, next_y, next_z = 0.5 * gap_x, 0.5 * gap_y, 0.5 * gap_z
            n_x = n_y = n_z = 0
            at = home
            free = True
            while True:
                if next_x <= next_y and next_x <= next_z:
                    if next_x >= 1.0:
                        break
                    at += step_x
                    n_x += 1
                    next_x += gap_x
                elif next_y <= next_z:
                    if next_y >= 1.0:
                        break
                    at += step_y
                    n_y += 1
                    next_y += gap_y
                else:
                    if next_z >= 1.0:
                        break
                    at += step_z
                    n_z += 1
                    next_z += gap_z
                cell = flat[np.uint64(at)]
                if cell == 0:
                    continue
                if cell == 2:
                    break
                if n_x > skip or n_y > skip or n_z > skip:
                    free = False
                    break
            visible[i, c] = free


@njit(cache=True, nogil=True)
def nearest_in_picture(pixels, depth, width, half_at_1m, shrink, tolerance, buffer, visible):
    """Depth buffer of one camera, and which voxels it does not hide.

    pixels : (n,) v * width + u, negative = not in the picture.  depth : (n,) m.  half_at_1m : half the side, px, of
    the square that a voxel covers at a depth of 1 m.  shrink : pixels of the picture per cell of the buffer.
    tolerance : m by which a voxel may lie behind the nearest.  buffer : float32, infinite.  visible : (n,) out.
    """
    rows, columns = buffer.shape
    for i in range(pixels.shape[0]):
        if pixels[i] < 0:
            continue
        v = pixels[i] // width
        u = pixels[i] - v * width
        half = half_at_1m / depth[i]
        u0 = max(math.floor((u - half) / shrink + 0.5), 0)
        u1 = min(math.floor((u + half) / shrink + 0.5), columns - 1)
        v0 = max(math.floor((v - half) / shrink + 0.5), 0)
        v1 = min(math.floor((v + half) / shrink + 0.5), rows - 1)
        d = np.float32(depth[i])
        for y in range(v0, v1 + 1):
            for x in range(u0, u1 + 1):
                buffer[y, x] = min(buffer[y, x], d)
    for i in range(pixels.shape[0]):
        visible[i] = False
        if pixels[i] >= 0:
            v = pixels[i] // width
            u = pixels[i] - v * width
            y, x = min((v + shrink // 2) // shrink, rows - 1), min((u + shrink // 2) // shrink, columns - 1)
            visible[i] = depth[i] <= buffer[y, x] + tolerance


@njit(cache=True, nogil=True)
def add_colours(image, pixels, visible, sums, count):
    """Add the colour (h * w, 3) uint8 at pixels (n,) where visible (n,) to sums (n, 3) int32 and count (n,)."""
    for i in range(pixels.shape[0]):
        if visible[i]:
            p = np.uint32(pixels[i])
            count[i] += 1
            sums[i, 0] += image[p, 0]
            sums[i, 1] += image[p, 1]
            sums[i, 2] += image[p, 2]


@njit(cache=True, nogil=True)
def union_runs(voxels, ny, nz, slack_side, slack_corner, label_of_run, run_of_voxel):
    """Connected runs along z of an ascending voxel list by union-find; returns the number of runs.

    slack_side, slack_corner : how far (0, 1) z-intervals of neighbouring columns may miss each other and
    still touch, across a column side and across a column edge; -1 = such columns do not touch.
    label_of_run : (n,) int32 out, root run of each run.  run_of_voxel : (n,) int32 out.
    """
    n = voxels.shape[0]
    column = np.empty(n, dtype=np.int64)
    first = np.empty(n, dtype=np.int64)
    last = np.empty(n, dtype=np.int64)
    runs = 0
    for i in range(n):
        v = np.int64(voxels[i])
        q = v // nz
        z = v - q * nz
        if runs > 0 and column[runs - 1] == q and last[runs - 1] == z - 1:
            last[runs - 1] = z
        else:
            column[runs] = q
            first[runs] = z
            last[runs] = z
            label_of_run[runs] = runs
            runs += 1
        run_of_voxel[i] = runs - 1
    for k in range(4):
        dx = 0 if k == 3 else -1
        dy = k - 1 if k < 3 else -1
        slack = slack_side if (dx == 0 or dy == 0) else slack_corner
        if slack < 0:
            continue
        p = 0
        for r in range(runs):
            iy = column[r] % ny
            if iy + dy < 0 or iy + dy >= ny:
                continue
            q = column[r] + dx * ny + dy
            while column[p] < q or (column[p] == q and last[p] < first[r] - slack):
                p += 1
            s = p
            while s < r and column[s] == q and first[s] <= last[r] + slack:
                a, b = r, s
                while label_of_run[a] != a:
                    label_of_run[a] = label_of_run[label_of_run[a]]
                    a = label_of_run[a]
                while label_of_run[b] != b:
                    label_of_run[b] = label_of_run[label_of_run[b]]
                    b = label_of_run[b]
                if a < b:
                    label_of_run[b] = a
                elif b < a:
                    label_of_run[a] = b
                s += 1
    for r in range(runs):
        # roots are the smallest run of their set, so earlier runs are already final
        label_of_run[r] = label_of_run[label_of_run[r]]
    return runs


@njit(cache=True, nogil=True)
def count_runs(label_of_run, run_of_voxel, sizes):
    """Add the voxels of each run to sizes (n_runs,) at the run's label."""
    n = 0
    for i in range(run_of_voxel.shape[0]):
        n += 1
        if i + 1 == run_of_voxel.shape[0] or run_of_voxel[i + 1] != run_of_voxel[i]:
            sizes[label_of_run[run_of_voxel[i]]] += n
            n = 0


@njit(cache=True, nogil=True)
def name_runs(rank, label_of_run, run_of_voxel):
    """Replace the run of each voxel (N,) by the rank of its label."""
    for i in range(run_of_voxel.shape[0]):
        run_of_voxel[i] = rank[label_of_run[run_of_voxel[i]]]


@njit(cache=True, nogil=True)
def paint_boxes(uv, half, canvas):
    """Set canvas to 1 in squares of half-width half (n,) px about pixels uv (n, 2); NaN is skipped."""
    height, width = canvas.shape
    for i in range(uv.shape[0]):
        if math.isnan(uv[i, 0]):
            continue
        u0 = max(math.floor(uv[i, 0] - half[i] + 0.5), 0)
        u1 = min(math.floor(uv[i, 0] + half[i] + 0.5), width - 1)
        v0 = max(math.floor(uv[i, 1] - half[i] + 0.5), 0)
        v1 = min(math.floor(uv[i, 1] + half[i] + 0.5), height - 1)
        for v in range(v0, v1 + 1):
            for u in range(u0, u1 + 1):
                canvas[v, u] = 1


@njit(cache=True, nogil=True)
def paint_left_out(pixels, is_miss, depth, width, half_at_1m, shrink, tolerance, canvas):
    """Silhouettes, per camera, of the hull that the other cameras leave, at reduced resolution.

    pixels : (n, C) int32 v * width + u, negative = not in that picture.  is_miss : (n, C) bool, the camera votes
    background.  depth : (n, C) m.  half_at_1m : (C,) half side, px, of the square that a voxel covers at 1 m.
    shrink : picture pixels per cell.  canvas : (C, h, w) uint8 zeros, out: bit 0 where at most `tolerance` other
    cameras vote background, bit 1 where none does.
    """
    n_cameras, rows, columns = canvas.shape
    for i in range(pixels.shape[0]):
        n_misses = 0
        for c in range(n_cameras):
            n_misses += is_miss[i, c]
        for c in range(n_cameras):
            n_others = n_misses - is_miss[i, c]
            if pixels[i, c] < 0 or n_others > tolerance:
                continue
            value = np.uint8(3 if n_others == 0 else 1)
            v = pixels[i, c] // width[c]
            u = pixels[i, c] - v * width[c]
            half = half_at_1m[c] / depth[i, c]
            u0 = max(math.floor((u - half) / shrink), 0)
            u1 = min(math.floor((u + half) / shrink), columns - 1)
            v0 = max(math.floor((v - half) / shrink), 0)
            v1 = min(math.floor((v + half) / shrink), rows - 1)
            for y in range(v0, v1 + 1):
                for x in range(u0, u1 + 1):
                    canvas[c, y, x] |= value


@njit(cache=True, nogil=True)
def regions_met(masks, hulls, own, rects, cells, work):
    """Of each camera's mask the regions that meet its silhouette; corners join regions.

    masks : (C, h, w) uint8 of 0 and 1.  hulls : (C, h, w) uint8, 0 = outside the silhouette.  own : (C, h, w) uint8
    zeros, out: those regions.  rects : (C, 4) out: u0, u1, v0, v1 inclusive, around them; u1 < u0 without any.
    cells : (C,) out: their size.  work : (h * w,) int32.
    """
    n_cameras, rows, columns = masks.shape
    for c in range(n_cameras):
        mask, mine = masks[c], own[c]
        n, u0, u1, v0, v1 = 0, columns, -1, rows, -1
        for y in range(rows):
            for x in range(columns):
                if mask[y, x] == 0 or hulls[c, y, x] == 0 or mine[y, x] != 0:
                    continue
                mine[y, x] = 1
                work[n] = y * columns + x
                first, n = n, n + 1
                while first < n:
                    v = work[first] // columns
                    u = work[first] - v * columns
                    first += 1
                    u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
                    for j in range(max(v - 1, 0), min(v + 2, rows)):
                        for i in range(max(u - 1, 0), min(u + 2, columns)):
                            if mask[j, i] != 0 and mine[j, i] == 0:
                                mine[j, i] = 1
                                work[n] = j * columns + i
                                n += 1
        rects[c, 0], rects[c, 1], rects[c, 2], rects[c, 3] = u0, u1, v0, v1
        cells[c] = n


@njit(cache=True, nogil=True)
def uncovered_shares(own, cells, rects, hulls, hull_cells, expected, limits, column, uncovered, strict):
    """Shares of the cameras' masks in one frame outside the silhouettes of another, into a column of both (C, L).

    own, cells, rects : as of `regions_met`.  hulls : (C, h, w) uint8, bit 0 the silhouette, bit 1 the strict one.
    hull_cells, expected : (C,) size of the silhouette, and of what a mask must meet.  limits : cells with which a
    silhouette says something, and share of the expected ones that a mask must cover; else its share is 1.
    """
    for c in range(own.shape[0]):
        if hull_cells[c] < limits[0]:
            continue
        one, two = 0, 0
        for y in range(rects[c, 2], rects[c, 3] + 1):
            for x in range(rects[c, 0], rects[c, 1] + 1):
                both = own[c, y, x] * hulls[c, y, x]
                one += both & 1
                two += both >> 1
        if one < limits[1] * expected[c]:
            uncovered[c, column] = strict[c, column] = 1.0
        else:
            uncovered[c, column] = 1.0 - one / cells[c]
            strict[c, column] = 1.0 - two / cells[c]


@njit(cache=True, nogil=True)
def light_of(samples, before):
    """Mean and standard deviation of some pixels of a picture, and their mean change since the last; grey levels.

    samples, before : (rows, columns) uint8.
    """
    total, square, change = 0, 0, 0
    for j in range(samples.shape[0]):
        now, then = samples[j], before[j]
        for i in range(now.shape[0]):
            value = np.int64(now[i])
            total += value
            square += value * value
            change += abs(value - np.int64(then[i]))
    n = samples.size
    mean = total / n
    return mean, math.sqrt(max(square / n - mean * mean, 0.0)), change / n


@njit(cache=True, nogil=True)
def ends_of_regions(mask, least_area, least_share, runs, ends):
    """The first and last pixel of each row of a mask's large regions; returns the number of rows with any.

    mask : (H, W) uint8 of 0 and 1; corners join regions. Large is `least_share` of the largest, which must have
    `least_area` pixels.  runs : (at least the runs along rows, 4) int32, work.  ends : (H, 3) int32 out, row, column of
    the first and of the last pixel.
    """
    n, before = 0, 0
    for y in range(mask.shape[0]):
        here = n
        row = mask[y]
        x = 0
        while x < row.shape[0]:
            if row[x] == 0:
                x += 1
                continue
            start = x
            while x < row.shape[0] and row[x] != 0:
                x += 1
            runs[n, 0], runs[n, 1], runs[n, 2], runs[n, 3] = y, start, x, n
            n += 1
        # Two runs of neighbouring rows touch when neither ends before the other begins.
        i = before
        while i < here and runs[i, 0] < y - 1:
            i += 1
        for j in range(here, n):
            while i < here and runs[i, 2] < runs[j, 1]:
                i += 1
            k = i
            while k < here and runs[k, 1] <= runs[j, 2]:
                a, b = k, j
                while runs[a, 3] != a:
                    a = runs[a, 3]
                while runs[b, 3] != b:
                    b = runs[b, 3]
                runs[max(a, b), 3] = min(a, b)
                k += 1
        before = here
    area = np.zeros(n, dtype=np.int64)
    largest = 0
    for i in range(n):
        runs[i, 3] = runs[runs[i, 3], 3]  # roots come first, so that theirs is final
        area[runs[i, 3]] += runs[i, 2] - runs[i, 1]
    for i in range(n):
        largest = max(largest, area[i])
    if n == 0 or largest < least_area:
        return 0
    m = 0
    for i in range(n):
        if area[runs[i, 3]] < least_share * largest:
            continue
        if m == 0 or ends[m - 1, 0] != runs[i, 0]:
            ends[m, 0], ends[m, 1] = runs[i, 0], runs[i, 1]
            m += 1
        ends[m - 1, 2] = runs[i, 2] - 1
    return m


@njit(cache=True, nogil=True, error_model="numpy")
def clearance_of_points(uv, depth, is_hidden, inside, focal, out):
    """How far points lie inside a mask, m, into out (N,) float32; inf where the camera does not judge them.

    uv : (N, 2) px, NaN = not seen.  depth : (N,) m.  is_hidden : (N,) bool.  inside : (H, W) float32 px, between whose
    pixels values are taken; inf and NaN there do not judge.  focal : px.
    """
    height, width = inside.shape
    for i in range(uv.shape[0]):
        u, v = uv[i, 0], uv[i, 1]
        out[i] = np.inf
        if is_hidden[i] or not (u >= -0.5 and u < width - 0.5 and v >= -0.5 and v < height - 0.5):
            continue
        u = np.float64(min(max(np.float32(u), np.float32(0)), np.float32(width - 1)))
        v = np.float64(min(max(np.float32(v), np.float32(0)), np.float32(height - 1)))
        x, y = min(int(u), width - 2), min(int(v), height - 2)
        a, b = u - x, v - y
        top = inside[y, x] * (1 - a) + inside[y, x + 1] * a
        bottom = inside[y + 1, x] * (1 - a) + inside[y + 1, x + 1] * a
        px = np.float32(top * (1 - b) + bottom * b)
        if not math.isnan(px):
            out[i] = np.float32(np.float64(px) * depth[i] / focal)
