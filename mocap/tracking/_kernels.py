"""Inner loops of the trackers: arrays and scalars only; every random number is drawn outside."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

# Bits of a byte of the crop that sparse sampling looks at.
OCCUPIED, COLOURED, SIMILAR, TAKEN = 1, 2, 4, 8


@njit(cache=True, nogil=True)
def voxel_centers(voxels, ny, nz, origin, side, out):
    """Centres (N, 3) m of linear voxel indices (N,), C order."""
    column, x, y = np.int64(-1), 0.0, 0.0
    for i in range(voxels.shape[0]):
        q = voxels[i] // nz
        if q != column:  # ascending voxels come in runs along z
            column = q
            ix = q // ny
            x = origin[0] + (ix + 0.5) * side
            y = origin[1] + (q - ix * ny + 0.5) * side
        out[i, 0] = x
        out[i, 1] = y
        out[i, 2] = origin[2] + (voxels[i] - q * nz + 0.5) * side


@njit(cache=True, nogil=True)
def count_labels(labels, count):
    """Add the number of voxels of each label (N,) to count; negative ones are nobody's."""
    last, n = np.int64(-1), 0
    for label in labels:
        if label != last:  # neighbours in the list mostly have one label: one counter at a time
            if last >= 0:
                count[last] += n
            last, n = label, 0
        n += 1
    if last >= 0:
        count[last] += n


@njit(cache=True, nogil=True)
def group_by_label(labels, rank, start, order, component_of):
    """Sort voxels by component, stably.

    labels : (N,) int, negative = nobody's.  rank : (largest label + 1,) row of each label.
    start : (K + 1,) first place of each row.  order : (n,) out.  component_of : (N,) out, -1 = nobody's.
    """
    place = start.copy()
    for i in range(labels.shape[0]):
        component_of[i] = -1
        if labels[i] >= 0:
            k = rank[labels[i]]
            component_of[i] = k
            order[place[k]] = i
            place[k] += 1


@njit(cache=True, nogil=True)
def measure_groups(centers, order, start, mean, lower, upper):
    """Mean, smallest and largest coordinates, each (K, 3), of the rows order[start[k]:start[k + 1]] of centers."""
    for k in range(start.shape[0] - 1):
        x_sum, y_sum, z_sum = 0.0, 0.0, 0.0
        x_low, y_low, z_low = np.inf, np.inf, np.inf
        x_high, y_high, z_high = -np.inf, -np.inf, -np.inf
        for i in range(start[k], start[k + 1]):
            row = order[i]
            x, y, z = centers[row, 0], centers[row, 1], centers[row, 2]
            x_sum += x
            y_sum += y
            z_sum += z
            x_low, x_high = min(x_low, x), max(x_high, x)
            y_low, y_high = min(y_low, y), max(y_high, y)
            z_low, z_high = min(z_low, z), max(z_high, z)
        n = max(start[k + 1] - start[k], 1)
        mean[k, 0], mean[k, 1], mean[k, 2] = x_sum / n, y_sum / n, z_sum / n
        lower[k, 0], lower[k, 1], lower[k, 2] = x_low, y_low, z_low
        upper[k, 0], upper[k, 1], upper[k, 2] = x_high, y_high, z_high


@njit(cache=True, nogil=True)
def ellipsoid_distances(points, centers, axes, out):
    """Squared distance of points (N, 3) from ellipsoids in radii, (T, N); centers, axes (T, 3). CF Eq. 4.2."""
    for t in range(centers.shape[0]):
        ax, ay, az = 1.0 / axes[t, 0], 1.0 / axes[t, 1], 1.0 / axes[t, 2]
        for i in range(points.shape[0]):
            x = (points[i, 0] - centers[t, 0]) * ax
            y = (points[i, 1] - centers[t, 1]) * ay
            z = (points[i, 2] - centers[t, 2]) * az
            out[t, i] = x * x + y * y + z * z


@njit(cache=True, nogil=True)
def extent(points):
    """Smallest and largest coordinates, (3,) m each, of points (N, 3); N > 0. numpy is slow over rows of three."""
    low, high = points[0].copy(), points[0].copy()
    for i in range(1, points.shape[0]):
        for j in range(3):
            if points[i, j] < low[j]:
                low[j] = points[i, j]
            elif points[i, j] > high[j]:
                high[j] = points[i, j]
    return low, high


@njit(cache=True, nogil=True)
def is_apart(centre, half, k, lower, upper):
    """Whether a box of half sides half about centre, (3,) m each, and that of component k have no point in common."""
    for i in range(3):
        # A hair's breadth for what the edges of an ellipsoid may gain by rounding.
        reach = half[i] + 1e-9
        if centre[i] + reach < lower[k, i] or centre[i] - reach > upper[k, i]:
            return True
    return False


@njit(cache=True, nogil=True)
def count_votes(points, order, start, lower, upper, centers, axes, exclusive, every):
    """Voxels of each component inside each ellipsoid, (T, K): in no other ellipsoid, and in all of it.

    points : (N, 3) m.  order, start, lower, upper : of the components, as in `Components`.
    centers, axes : (T, 3) m.
    """
    n_tracks = centers.shape[0]
    scale = 1.0 / axes
    near = np.empty(n_tracks, dtype=np.int64)
    for k in range(start.shape[0] - 1):
        n_near = 0
        for t in range(n_tracks):
            if not is_apart(centers[t], axes[t], k, lower, upper):
                near[n_near] = t
                n_near += 1
        if n_near == 0:
            continue
        for place in range(start[k], start[k + 1]):
            i = order[place]
            n_inside, last = 0, -1
            for j in range(n_near):
                t = near[j]
                x = (points[i, 0] - centers[t, 0]) * scale[t, 0]
                y = (points[i, 1] - centers[t, 1]) * scale[t, 1]
                flat = x * x + y * y
                if flat > 1.0:
                    continue
                z = (points[i, 2] - centers[t, 2]) * scale[t, 2]
                if flat + z * z <= 1.0:
                    every[t, k] += 1
                    n_inside += 1
                    last = t
            if n_inside == 1:
                exclusive[last, k] += 1


@njit(cache=True, nogil=True)
def rows_in_box(points, order, start, lower, upper, low, high, out):
    """Rows of the voxels of all components strictly between low and high, (2,) m, in x and y; returns how many.

    points, order, start, lower, upper : as of count_votes.  out : (N,) int64, component by component.
    """
    n = 0
    for k in range(start.shape[0] - 1):
        if low[0] >= upper[k, 0] or high[0] <= lower[k, 0] or low[1] >= upper[k, 1] or high[1] <= lower[k, 1]:
            continue
        for place in range(start[k], start[k + 1]):
            i = order[place]
            if low[0] < points[i, 0] < high[0] and low[1] < points[i, 1] < high[1]:
                out[n] = i
                n += 1
    return n


@njit(cache=True, nogil=True)
def colour_bins(rgb, has_colour, n_bins, out):
    """Joint YCbCr bin of each colour (N, 3) uint8, n_bins per channel, -1 without one; full range, ITU-R BT.601."""
    for i in range(rgb.shape[0]):
        out[i] = -1
        if has_colour[i]:
            r, g, b = np.int64(rgb[i, 0]), np.int64(rgb[i, 1]), np.int64(rgb[i, 2])
            # 14 bits behind the point and half a unit to round, as OpenCV does it.
            luma = (4899 * r + 9617 * g + 1868 * b + 8192) >> 14
            red = min(max(((r - luma) * 11682 + (128 << 14) + 8192) >> 14, 0), 255)
            blue = min(max(((b - luma) * 9241 + (128 << 14) + 8192) >> 14, 0), 255)
            out[i] = ((luma * n_bins >> 8) * n_bins + (blue * n_bins >> 8)) * n_bins + (red * n_bins >> 8)


@njit(cache=True, nogil=True)
def mark_similar(histogram, threshold, bit, byte_of):
    """Set a bit of byte_of (n + 1,) uint8 after the first one, of all bins of a histogram (n,) from threshold on."""
    for i in range(histogram.shape[0]):
        if histogram[i] >= threshold:
            byte_of[i + 1] |= bit


@njit(cache=True, nogil=True)
def add_histogram(bins, centers, rows, edges, histogram):
    """Count the bins of some voxels by height band; returns how many had a colour.

    bins : (N,) int, negative = no colour.  centers : (N, 3) m.  rows : (n,) which voxels.
    edges : (B - 1,) m ascending, between bands.  histogram : (B, n_bins), counts are added.
    """
    n = 0
    for i in rows:
        if bins[i] >= 0:
            band = 0
            while band < edges.shape[0] and centers[i, 2] >= edges[band]:
                band += 1
            histogram[band, bins[i]] += 1.0
            n += 1
    return n


@njit(cache=True, nogil=True)
def fill_columns(points, lower, side, below):
    """Occupied voxels of a crop, counted along z.

    points : (N, 3) m.  lower : (3,) m, corner of the crop.  below : (nx, ny, nz + 1) int16 zeros, out:
    below[x, y, z] voxels of the column lie under z.
    """
    nx, ny, nz = below.shape
    nz -= 1
    for i in range(points.shape[0]):
        x = (points[i, 0] - lower[0]) / side
        y = (points[i, 1] - lower[1]) / side
        z = (points[i, 2] - lower[2]) / side
        if 0.0 <= x < nx and 0.0 <= y < ny and 0.0 <= z < nz:
            below[int(x), int(y), int(z) + 1] = 1
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                below[x, y, z + 1] += below[x, y, z]


@njit(cache=True, nogil=True)
def overlap_shares(particles, radius, min_height, side, lower, below, out):
    """Share of each particle's ellipsoid that is occupied, (P,). CF Eq. 4.9.

    particles : (P, 3) m; semi-axes radius, radius and the particle's own height, at least min_height.
    lower, below : as of fill_columns; outside of the crop everything is empty. An ellipsoid is the set of
    voxels whose centre lies in it.
    """
    nx, ny, nz = below.shape
    nz -= 1
    for p in range(particles.shape[0]):
        px = (particles[p, 0] - lower[0]) / side - 0.5
        py = (particles[p, 1] - lower[1]) / side - 0.5
        pz = (particles[p, 2] - lower[2]) / side - 0.5
        r = radius / side
        h = max(particles[p, 2], min_height) / side
        n_all, n_full = 0, 0
        for x in range(math.ceil(px - r), math.floor(px + r) + 1):
            for y in range(math.ceil(py - r), math.floor(py + r) + 1):
                left = 1.0 - ((x - px) ** 2 + (y - py) ** 2) / (r * r)
                if left < 0.0:
                    continue
                half = h * math.sqrt(left)
                first, last = math.ceil(pz - half), math.floor(pz + half)
                if last < first:
                    continue
                n_all += last - first + 1
                if 0 <= x < nx and 0 <= y < ny:
                    first, last = max(first, 0), min(last, nz - 1)
                    if last >= first:
                        n_full += below[x, y, last + 1] - below[x, y, first]
        out[p] = n_full / n_all if n_all else 0.0


@njit(cache=True, nogil=True)
def colour_shares(particles, radius, min_height, points, bins, root_reference, out):
    """Bhattacharyya coefficient of the reference and the colours in each particle's ellipsoid, (P,). CF Eq. 4.10.

    points : (M, 3) m and bins : (M,) of the voxels with a colour; it is fast where the voxels of a column follow one
    another in ascending z.  root_reference : (n_bins,) square root of the reference histogram.  An ellipsoid without
    a coloured voxel gives 0.
    """
    n_points = points.shape[0]
    # Numbers of the colours that there are, and first point of each column.
    number = np.full(root_reference.shape[0], -1, dtype=np.int32)
    colour = np.empty(n_points, dtype=np.int32)
    root = np.empty(n_points)
    first = np.empty(n_points + 1, dtype=np.int64)
    n_colours, n_columns = 0, 0
    for i in range(n_points):
        if number[bins[i]] < 0:
            number[bins[i]] = n_colours
            root[n_colours] = root_reference[bins[i]]
            n_colours += 1
        colour[i] = number[bins[i]]
        is_next = i > 0 and points[i, 0] == points[i - 1, 0] and points[i, 1] == points[i - 1, 1]
        if not (is_next and points[i, 2] >= points[i - 1, 2]):
            first[n_columns] = i
            n_columns += 1
    first[n_columns] = n_points
    count = np.zeros(n_colours, dtype=np.int64)
    r2 = radius * radius
    for p in range(particles.shape[0]):
        h = max(particles[p, 2], min_height)
        n = 0
        for c in range(n_columns):
            start, end = first[c], first[c + 1]
            dx = points[start, 0] - particles[p, 0]
            dy = points[start, 1] - particles[p, 1]
            flat = (dx * dx + dy * dy) / r2
            if flat > 1.0:
                continue
            # What is inside of a column is one piece: its ends are sought from below and from above.
            while start < end and flat + ((points[start, 2] - particles[p, 2]) / h) ** 2 > 1.0:
                start += 1
            while start < end and flat + ((points[end - 1, 2] - particles[p, 2]) / h) ** 2 > 1.0:
                end -= 1
            n += end - start
            for i in range(start, end):
                count[colour[i]] += 1
        total = 0.0
        for b in range(n_colours):
            if count[b]:
                total += root[b] * math.sqrt(count[b] / n)
                count[b] = 0
        out[p] = total


@njit(cache=True, nogil=True)
def fill_crop(points, order, start, lower, upper, bins, byte_of, corner, side, crop):
    """Write what is known of each voxel into the bits of a crop (nx, ny, nz) uint8 of zeros.

    points : (N, 3) m.  order, start, lower, upper : of the components, as in `Components`.
    bins : (N,) int, -1 = no colour; (0,) = no colours at all.  byte_of : (n_bins + 1,) uint8, what is written of a
    voxel without a colour and of one in each bin.  corner : (3,) m, lower corner of the crop.
    """
    nx, ny, nz = crop.shape
    scale = 1.0 / side
    x0, y0, z0 = corner[0], corner[1], corner[2]
    has_bins = bins.shape[0] > 0
    byte = byte_of[0]
    flat = crop.reshape(-1)
    for k in range(start.shape[0] - 1):
        # Half a side too generous: the loop below is exact.
        if upper[k, 0] < x0 - side or lower[k, 0] > x0 + (nx + 1) * side:
            continue
        if upper[k, 1] < y0 - side or lower[k, 1] > y0 + (ny + 1) * side:
            continue
        last_x, last_y = np.nan, np.nan
        column = np.int64(-1)  # first cell of the column, -1 = it is outside
        for place in range(start[k], start[k + 1]):
            i = order[place]
            if points[i, 0] != last_x or points[i, 1] != last_y:  # ascending voxels come in runs along z
                last_x, last_y = points[i, 0], points[i, 1]
                x, y = (last_x - x0) * scale, (last_y - y0) * scale
                column = -1
                if 0.0 <= x < nx and 0.0 <= y < ny:
                    # Positive numbers only are cut off at the point: that is ten times faster than to round down.
                    column = (int(x) * ny + int(y)) * nz
            z = (points[i, 2] - z0) * scale
            if column >= 0 and 0.0 <= z < nz:
                if has_bins:
                    byte = byte_of[bins[i] + 1]
                flat[column + int(z)] = byte


@njit(cache=True, nogil=True)
def mix(reference, observed, share, out):
    """share * reference + (1 - share) * observed, (n,) each; what has faded to nothing becomes 0.

    Numbers below 1e-12 would go on fading until they are denormal, and a hundred times slower.
    """
    for i in range(out.shape[0]):
        value = share * reference[i] + (1.0 - share) * observed[i]
        out[i] = value if value > 1e-12 else 0.0


@njit(cache=True, nogil=True)
def draw(state, n):
    """A whole number in 0 .. n - 1 and the next state of a 64-bit linear congruential generator."""
    state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
    return np.int64((state >> np.uint64(33)) % np.uint64(n)), state


@njit(cache=True, nogil=True)
def scatter(start, seed, radius, n_steps, crop, placed):
    """Put every sample into a voxel of its own; returns how many have found one.

    start : (n, 3) voxel of the crop that each copy comes from.  seed : uint64 of the noise.
    radius : the discrete noise is even over the cube of so many voxels to each side.
    n_steps : a sample whose voxel is taken walks at random to adjacent voxels, so many times; it is dropped when it
    has found no empty one, or leaves the crop.  crop : the TAKEN bits are set.  placed : (n, 3) out, the voxels.
    """
    nx, ny, nz = crop.shape
    state = np.uint64(seed)
    width = 2 * radius + 1
    n = 0
    for i in range(start.shape[0]):
        place, state = draw(state, width * width * width)
        x = start[i, 0] + place // (width * width) - radius
        y = start[i, 1] + place // width % width - radius
        z = start[i, 2] + place % width - radius
        for _ in range(n_steps + 1):
            if not (0 <= x < nx and 0 <= y < ny and 0 <= z < nz):
                break
            if not crop[x, y, z] & TAKEN:
                crop[x, y, z] |= TAKEN
                placed[n, 0] = x
                placed[n, 1] = y
                placed[n, 2] = z
                n += 1
                break
            step, state = draw(state, 26)
            step += step >= 13  # the 27 cells without the middle one
            x += step // 9 - 1
            y += step // 3 % 3 - 1
            z += step % 3 - 1
    return n


@njit(cache=True, nogil=True)
def systematic_voxels(samples, weights, offset, lower, side, out):
    """Voxels (n, 3) of n copies of samples (m, 3) m by systematic resampling, CF Alg. 2; lower : of the crop.

    weights : (m,), their sum need not be 1.  offset : in [0, 1).
    """
    n, m = out.shape[0], samples.shape[0]
    total, last = 0.0, 0
    for j in range(m):
        total += weights[j]
        if weights[j] > 0.0:
            last = j
    j, edge = 0, weights[0]
    for i in range(n):
        place = (i + offset) / n * total
        # Never beyond the last sample of positive weight, whatever rounding does to the sum.
        while edge <= place and j < last:
            j += 1
            edge += weights[j]
        for k in range(3):
            out[i, k] = math.floor((samples[j, k] - lower[k]) / side)


@njit(cache=True, nogil=True)
def weigh_samples(
    placed, corner, side, centre, reach, likelihood, is_even, crowd, others, k, points, weights
):
    """Weigh samples in the voxels placed (n, 3) of a crop: sum of the weights, mean (3,) and its covariance (3, 3).

    corner : (3,) m, of the crop.  centre : (3,) m; samples further than reach from it in the plane weigh nothing.
    crowd : (n,), the weights are divided by it if is_even.  others : (L, 2) m, exclusion zones with the factor k of
    CF Eq. 4.13.  points : (n, 3) m out, where the samples are.  weights : (n,) out, with sum 1.
    With a sum of zero the mean and the covariance are zeros.  Source: CF Eq. 4.12-4.19.
    """
    total = 0.0
    mean, covariance = np.zeros(3), np.zeros((3, 3))
    for i in range(placed.shape[0]):
        for a in range(3):
            points[i, a] = corner[a] + (placed[i, a] + 0.5) * side
        x, y = points[i, 0], points[i, 1]
        weights[i] = 0.0
        if (x - centre[0]) ** 2 + (y - centre[1]) ** 2 > reach * reach:
            continue
        w = likelihood[i] / crowd[i] if is_even else likelihood[i]
        for j in range(others.shape[0]):
            gap = k * ((x - others[j, 0]) ** 2 + (y - others[j, 1]) ** 2)
            if gap < 40.0:  # further away the factor is 1 to the last digit
                w *= 1.0 - math.exp(-gap)
        weights[i] = w
        total += w
        for a in range(3):
            mean[a] += w * points[i, a]
    if not total > 0.0:
        return total, np.zeros(3), covariance
    mean /= total
    for i in range(points.shape[0]):
        weights[i] /= total
        w = weights[i] * weights[i]
        for a in range(3):
            for b in range(a + 1):
                covariance[a, b] += w * (points[i, a] - mean[a]) * (points[i, b] - mean[b])
    for a in range(3):
        for b in range(a):
            covariance[b, a] = covariance[a, b]
    return total, mean, covariance


@njit(cache=True, nogil=True)
def local_shares(samples, radius, crop, raw, colour, crowd):
    """Pseudo-likelihoods of samples (n, 3), voxels of the crop: raw (n,) CF Eq. 4.20, colour (n,) CF Eq. 4.21.

    crowd : (n,) out, samples in the same neighbourhood, the sample itself included.

    The neighbourhood is the cube of 2 radius + 1 voxels about the sample (26-connected, radius steps); outside of the
    crop everything is empty. A neighbourhood without a coloured voxel has colour 0.  radius : at most 12.
    """
    nx, ny, nz = crop.shape
    n_all = (2 * radius + 1) ** 3
    for i in range(samples.shape[0]):
        total = np.int64(0)  # four counts in one number, 15 bits each: one addition per voxel
        x0, x1 = samples[i, 0] - radius, samples[i, 0] + radius + 1
        y0, y1 = samples[i, 1] - radius, samples[i, 1] + radius + 1
        z0, z1 = samples[i, 2] - radius, samples[i, 2] + radius + 1
        x0, x1, y0, y1, z0, z1 = max(x0, 0), min(x1, nx), max(y0, 0), min(y1, ny), max(z0, 0), min(z1, nz)
        for x in range(x0, x1):
            for y in range(y0, y1):
                row = crop[x, y, z0:z1]
                for z in range(row.shape[0]):
                    byte = np.int64(row[z])
                    total += (byte & 1) + ((byte & 2) << 14) + ((byte & 4) << 28) + ((byte & 8) << 42)
        n_full, n_coloured, n_similar = total & 0x7FFF, total >> 15 & 0x7FFF, total >> 30 & 0x7FFF
        raw[i] = 1.0 - abs(2.0 * n_full / n_all - 1.0)
        colour[i] = n_similar / n_coloured if n_coloured else 0.0
        crowd[i] = total >> 45


@njit(cache=True, nogil=True)
def local_shares_in_words(samples, radius, words, raw, colour, crowd):
    """local_shares eight voxels at a time, of the same values; for a radius of 2 at most.

    words : (nx, ny, nz / 8) uint64, the crop with eight voxels of a column in each, the lowest in the lowest byte.
    """
    nx, ny, n_words = words.shape
    n_all = (2 * radius + 1) ** 3
    one = np.uint64(0x0101010101010101)  # the lowest bit of every voxel
    kept = np.uint64(0xFFFFFFFFFFFFFFFF) >> np.uint64(8 * (7 - 2 * radius))
    for i in range(samples.shape[0]):
        first = samples[i, 2] - radius
        w, shift = first >> 3, np.uint64(8 * (first & 7))
        full, coloured, similar, taken = np.uint64(0), np.uint64(0), np.uint64(0), np.uint64(0)
        for x in range(max(samples[i, 0] - radius, 0), min(samples[i, 0] + radius + 1, nx)):
            for y in range(max(samples[i, 1] - radius, 0), min(samples[i, 1] + radius + 1, ny)):
                v = words[x, y, w] >> shift if 0 <= w < n_words else np.uint64(0)
                if shift and 0 <= w + 1 < n_words:
                    v |= words[x, y, w + 1] << (np.uint64(64) - shift)
                v &= kept
                # Every byte counts for itself: 25 columns at most.
                full += v & one
                coloured += v >> np.uint64(1) & one
                similar += v >> np.uint64(2) & one
                taken += v >> np.uint64(3) & one
        # The product has the sum of all bytes in its highest one: 125 voxels at most.
        n_full, n_coloured = np.int64(full * one >> np.uint64(56)), np.int64(coloured * one >> np.uint64(56))
        n_similar = np.int64(similar * one >> np.uint64(56))
        raw[i] = 1.0 - abs(2.0 * n_full / n_all - 1.0)
        colour[i] = n_similar / n_coloured if n_coloured else 0.0
        crowd[i] = np.int64(taken * one >> np.uint64(56))
