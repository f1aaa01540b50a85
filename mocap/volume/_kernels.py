"""Compiled loops of the volume stage. Arrays and scalars only; each has a numpy twin in the tests.

Blocks of voxels are numbered in C order; the 64 voxels of a block of 4 are numbered (dx * 4 + dy) * 4 + dz.
Camera sets are bit sets in int64. Gather indices are cast to uint64: a signed index would make the compiler
emit a wrap-around test per access.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

DROP, KEEP, DESCEND = 0, 1, 2
TIE_PX = 1e-7  # values this close below a rounding tie count as the tie; see carve.nearest_pixel


@njit(cache=True, nogil=True)
def pixels_of_points(points, p, width, height, out):
    """Flat pixel index (v * width + u) of points (n, 3) m in one camera; -1 outside its view.

    p : (22,) R row by row, t, fx, fy, cx, cy, k1 k2 p1 p2 k3 k4 k5 k6 ... see carve.camera_parameters.
    """
    fisheye = p[25] > 0.5
    reach_limit = p[24]
    for i in range(points.shape[0]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        a = p[0] * x + p[1] * y + p[2] * z + p[9]
        b = p[3] * x + p[4] * y + p[5] * z + p[10]
        c = p[6] * x + p[7] * y + p[8] * z + p[11]
        out[i] = -1
        if not c > 1e-6:
            continue
        a /= c
        b /= c
        r2 = a * a + b * b
        if fisheye:
            r = math.sqrt(r2)
            theta = math.atan(r)
            if theta > reach_limit:
                continue
            t2 = theta * theta
            bent = theta * (1 + t2 * (p[16] + t2 * (p[17] + t2 * (p[18] + t2 * p[19]))))
            scale = bent / r if r > 1e-8 else 1.0
            u = p[12] * a * scale + p[14]
            v = p[13] * b * scale + p[15]
        else:
            if math.sqrt(r2) > reach_limit:
                continue
            radial = (1 + r2 * (p[16] + r2 * (p[17] + r2 * p[20]))) / (
                1 + r2 * (p[21] + r2 * (p[22] + r2 * p[23]))
            )
            ab2 = 2 * a * b
            u = p[12] * (a * radial + p[18] * ab2 + p[19] * (r2 + 2 * a * a)) + p[14]
            v = p[13] * (b * radial + p[18] * (r2 + 2 * b * b) + p[19] * ab2) + p[15]
        iu = math.floor(u + (0.5 + TIE_PX))
        iv = math.floor(v + (0.5 + TIE_PX))
        if iu >= 0 and iu < width and iv >= 0 and iv < height:
            out[i] = int(iv) * width + int(iu)


@njit(cache=True, nogil=True)
def fill_blocks(pixels, bx, nby, nbz, camera, width, table, box, n_seen, sees_all, sees_some):
    """Enter one camera's pixels of four x-planes (<= 4, ny, nz) int32 into the tables of the blocks.

    table : (nb, C, 64) int32.  box : (nb, C, 4) int16 u0, u1, v0, v1 of the voxels seen.
    n_seen : (nb, 64) uint8, added to.  sees_all, sees_some : (nb,) int64 bit sets.
    """
    planes, ny, nz = pixels.shape
    bit = np.int64(1) << camera
    for by in range(nby):
        for bz in range(nbz):
            b = (bx * nby + by) * nbz + bz
            u0, u1, v0, v1 = 32767, -1, 32767, -1
            n_real = 0
            n_inside = 0
            for dx in range(4):
                for dy in range(4):
                    for dz in range(4):
                        j = (dx * 4 + dy) * 4 + dz
                        iy = by * 4 + dy
                        iz = bz * 4 + dz
                        pixel = -1
                        if dx < planes and iy < ny and iz < nz:
                            n_real += 1
                            pixel = pixels[dx, iy, iz]
                        table[b, camera, j] = pixel
                        if pixel >= 0:
                            n_inside += 1
                            n_seen[b, j] += 1
                            v = pixel // width
                            u = pixel - v * width
                            u0, u1 = min(u0, u), max(u1, u)
                            v0, v1 = min(v0, v), max(v1, v)
            box[b, camera, 0] = u0
            box[b, camera, 1] = u1
            box[b, camera, 2] = v0
            box[b, camera, 3] = v1
            if n_inside > 0:
                sees_some[b] |= bit
            if n_inside == n_real:
                sees_all[b] |= bit


@njit(cache=True, nogil=True)
def judge(box, integral, start, width, active, sees_all, tolerance, misses):
    """Vote of the active cameras on one block: (decision, cameras still ambiguous, sure misses).

    box : (C, 4).  integral : concatenated integral images; camera c begins at start[c], rows of width[c] + 1.
    """
    ambiguous = np.int64(0)
    n_ambiguous = 0
    for c in range(box.shape[0]):
        if (active >> c) & 1 == 0:
            continue
        u0, u1, v0, v1 = np.int64(box[c, 0]), np.int64(box[c, 1]), np.int64(box[c, 2]), np.int64(box[c, 3])
        row = width[c] + 1
        top = start[c] + v0 * row
        bottom = start[c] + (v1 + 1) * row
        n = (
            np.int64(integral[np.uint64(bottom + u1 + 1)])
            - integral[np.uint64(bottom + u0)]
            - integral[np.uint64(top + u1 + 1)]
            + integral[np.uint64(top + u0)]
        )
        if n == 0 and (sees_all >> c) & 1:
            misses += 1
            if misses > tolerance:
                return DROP, ambiguous, misses
        elif n < (u1 - u0 + 1) * (v1 - v0 + 1):
            ambiguous |= np.int64(1) << c
            n_ambiguous += 1
    if misses + n_ambiguous <= tolerance:
        return KEEP, ambiguous, misses
    return DESCEND, ambiguous, misses


@njit(cache=True, nogil=True)
def carve_blocks(
    box4, all4, some4, low4, high4,
    box8, all8, some8, low8, high8,
    box16, all16, some16, low16, high16,
    counts4, counts8, counts16, grid_shape, table, n_seen,
    masks, mask_start, integral, integral_start, width, tolerance, min_views, out,
):  # fmt: skip
    """Occupied voxels by blocks of 16, 8 and 4; writes linear indices into out, returns their number.

    A block is dropped when more than `tolerance` cameras that see all of it find no foreground in its pixel
    box, kept when at most `tolerance` cameras could still vote background, else opened with the undecided
    cameras.
    """
    ny, nz = grid_shape[1], grid_shape[2]
    n_cameras = box4.shape[1]
    n = 0
    sums = np.zeros(64, dtype=np.uint8)
    for b16 in range(box16.shape[0]):
        if high16[b16] < min_views:
            continue
        d16, open16, m16 = judge(
            box16[b16], integral, integral_start, width, some16[b16], all16[b16], tolerance, 0
        )
        if d16 == DROP:
            continue
        z16 = b16 % counts16[2]
        y16 = (b16 // counts16[2]) % counts16[1]
        x16 = b16 // (counts16[2] * counts16[1])
        for x8 in range(2 * x16, min(2 * x16 + 2, counts8[0])):
            for y8 in range(2 * y16, min(2 * y16 + 2, counts8[1])):
                for z8 in range(2 * z16, min(2 * z16 + 2, counts8[2])):
                    b8 = (x8 * counts8[1] + y8) * counts8[2] + z8
                    if high8[b8] < min_views:
                        continue
                    d8, open8, m8 = judge(
                        box8[b8],
                        integral,
                        integral_start,
                        width,
                        open16 & some8[b8],
                        all8[b8],
                        tolerance,
                        m16,
                    )
                    if d8 == DROP:
                        continue
                    for x4 in range(2 * x8, min(2 * x8 + 2, counts4[0])):
                        for y4 in range(2 * y8, min(2 * y8 + 2, counts4[1])):
                            for z4 in range(2 * z8, min(2 * z8 + 2, counts4[2])):
                                b = (x4 * counts4[1] + y4) * counts4[2] + z4
                                if high4[b] < min_views:
                                    continue
                                d4, open4, m4 = judge(
                                    box4[b], integral, integral_start, width,
                                    open8 & some4[b], all4[b], tolerance, m8,
                                )  # fmt: skip
                                if d4 == DROP:
                                    continue
                                sums[:] = m4
                                if d4 == DESCEND:
                                    for c in range(n_cameras):
                                        if (open4 >> c) & 1:
                                            start = mask_start[c]
                                            row = table[b, c]
                                            for j in range(64):
                                                # -1 reads the foreground sentinel before each mask
                                                sums[j] += (
                                                    np.uint8(1) - masks[np.uint64(start + np.int64(row[j]))]
                                                )
                                for j in range(64):
                                    if sums[j] <= tolerance and n_seen[b, j] >= min_views:
                                        out[n] = (
                                            ((x4 * 4 + (j >> 4)) * ny + y4 * 4 + ((j >> 2) & 3)) * nz
                                            + z4 * 4
                                            + (j & 3)
                                        )
                                        n += 1
    return n


@njit(cache=True, nogil=True)
def subscripts_and_bounds(voxels, ny, nz):
    """(ix, iy, iz) (n, 3) int32 of linear indices, and the lower and (exclusive) upper corner, (3,) int64."""
    n = voxels.shape[0]
    subs = np.empty((n, 3), dtype=np.int32)
    lower = np.full(3, 2**31 - 1, dtype=np.int64)
    upper = np.zeros(3, dtype=np.int64)
    for i in range(n):
        v = np.uint32(voxels[i])
        ixy = v // np.uint32(nz)
        ix = ixy // np.uint32(ny)
        subs[i, 0] = ix
        subs[i, 1] = ixy - ix * np.uint32(ny)
        subs[i, 2] = v - ixy * np.uint32(nz)
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
def splat_surface(subs, is_surface, lower, kernel, gain, field, packed):
    """Gaussian-smoothed surface and occupancy in one byte; see surface.surface_map.

    kernel : (2 r + 1,) float32 one-dimensional weights.  field, packed : crop-shaped float32 and uint8 zeros.
    """
    nx, ny, nz = packed.shape
    r = kernel.shape[0] // 2
    for i in range(subs.shape[0]):
        x, y, z = subs[i, 0] - lower[0], subs[i, 1] - lower[1], subs[i, 2] - lower[2]
        if x > 0 and y > 0 and z > 0 and x < nx - 1 and y < ny - 1 and z < nz - 1:
            packed[x, y, z] = 128
        if not is_surface[i]:
            continue
        if x <= -r or y <= -r or z <= -r or x >= nx - 1 + r or y >= ny - 1 + r or z >= nz - 1 + r:
            continue
        z0, z1 = max(z - r, 1), min(z + r, nz - 2)
        for xx in range(max(x - r, 1), min(x + r, nx - 2) + 1):
            wx = kernel[xx - x + r]
            for yy in range(max(y - r, 1), min(y + r, ny - 2) + 1):
                w = wx * kernel[yy - y + r]
                for zz in range(z0, z1 + 1):
                    field[xx, yy, zz] += w * kernel[zz - z + r]
    flat_field = field.reshape(-1)
    flat = packed.reshape(-1)
    for i in range(flat.shape[0]):
        level = np.int32(flat_field[i] * gain + np.float32(0.5))
        flat[i] += np.uint8(min(level, np.int32(127)))


@njit(cache=True, nogil=True)
def line_of_sight(subs, pixels, crop, lower, eyes, skip, visible):
    """Walk voxel by voxel from voxel centres to the optical centres until something blocks or the crop ends.

    subs : (n, 3).  pixels : (n, C), negative = not in that picture.  crop : occupancy of the bounding box.
    eyes : (C, 3) optical centres in voxel units.  Voxels within `skip` (Chebyshev) of the start never block.
    """
    nx, ny, nz = crop.shape
    for i in range(subs.shape[0]):
        sx, sy, sz = subs[i, 0] - lower[0], subs[i, 1] - lower[1], subs[i, 2] - lower[2]
        for c in range(eyes.shape[0]):
            visible[i, c] = False
            if pixels[i, c] < 0:
                continue
            dx = eyes[c, 0] - lower[0] - (sx + 0.5)
            dy = eyes[c, 1] - lower[1] - (sy + 0.5)
            dz = eyes[c, 2] - lower[2] - (sz + 0.5)
            step_x, step_y, step_z = 1 if dx > 0 else -1, 1 if dy > 0 else -1, 1 if dz > 0 else -1
            gap_x = 1.0 / abs(dx) if dx != 0.0 else 1e30
            gap_y = 1.0 / abs(dy) if dy != 0.0 else 1e30
            gap_z = 1.0 / abs(dz) if dz != 0.0 else 1e30
            next_x, next_y, next_z = 0.5 * gap_x, 0.5 * gap_y, 0.5 * gap_z
            x, y, z = sx, sy, sz
            free = True
            while True:
                if next_x <= next_y and next_x <= next_z:
                    if next_x >= 1.0:
                        break
                    x += step_x
                    next_x += gap_x
                elif next_y <= next_z:
                    if next_y >= 1.0:
                        break
                    y += step_y
                    next_y += gap_y
                else:
                    if next_z >= 1.0:
                        break
                    z += step_z
                    next_z += gap_z
                if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
                    break
                if crop[x, y, z] and (abs(x - sx) > skip or abs(y - sy) > skip or abs(z - sz) > skip):
                    free = False
                    break
            visible[i, c] = free


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
