"""The fast twin of `chain`: the same passes in numba, checked against the NumPy reference by the tests.

Contacts are worked on in blocks of `WIDTH`, each quantity a row of one scratch array of that fixed
width, so that every loop compiles to straight vector code. Two facts save most of the work:

* what does not vary from contact to contact (geometry) is folded into one 3 x 4 matrix a joint, once
  an evaluation of the parameters;
* a joint turns by its nominal angle plus a small displacement, and sin and cos of the nominal angle
  are known, so only the small angle needs a short series (`MAX_ANGLE`).

A term is (site, parameter, driver row): displacement[site] += value[parameter] * driver[row]; the last
row is 1 everywhere. Sites count 6 a frame in the order of `transforms.AXES`.
"""

from __future__ import annotations

import math

import numpy as np

from bayescal.arm.transforms import compiled

WIDTH = 128
MAX_ANGLE = 0.15  # rad a displacement; the series are then right to 1e-13 rad
_FAST = {"error_model": "numpy", "fastmath": {"contract", "nsz", "arcp"}}
_jit = compiled(**_FAST)
_inline = compiled(**_FAST, forceinline=True)  # copied in by LLVM; copies by numba take longer to compile

# Scratch rows: the point (or the wrench's point), the force, a joint's sine and cosine, working rows
_X, _Y, _Z, _U, _V, _W, _S, _C, _T, _D = range(10)
_ROWS = 10
# a displacement's pairs (turn, slide) in turn about z, x, y: rows of that axis and of the two across it
_AXES = ((2, 0, 1), (0, 1, 2), (1, 2, 0))
# the first of the pairs that are used, and a frame; numba would compile a function for each literal in a call
_ZXY, _XY, _BASE = np.int64(0), np.int64(1), np.int64(0)


@_inline
def _sin(x):  # Taylor to x^7: remainder 1e-13 at 0.15 rad, below rounding at 0.05
    s = x * x
    return x * (1.0 + s * (-1 / 6 + s * (1 / 120 - s / 5040)))


@_inline
def _cos(x):  # Taylor to x^8
    s = x * x
    return 1.0 + s * (-0.5 + s * (1 / 24 + s * (-1 / 720 + s / 40320)))


@_inline
def _add(work, row, sign, base, start, first, last, terms, values, drivers):
    """Row `row` of the scratch += sign x (base + the varying terms first..last of one site)."""
    for i in range(WIDTH):
        work[row, i] += sign * base
    for k in range(first, last):
        value = sign * values[terms[k, 1]]
        driver = drivers[terms[k, 2], start : start + WIDTH]
        for i in range(WIDTH):
            work[row, i] += value * driver[i]


@_inline
def _turn(work, a, b, c, s):
    """Rotate rows (a, b) by an angle that is the same for all contacts."""
    for i in range(WIDTH):
        x = work[a, i]
        work[a, i] = c * x - s * work[b, i]
        work[b, i] = s * x + c * work[b, i]


@_inline
def _turn_rows(work, a, b, sign):
    """Rotate rows (a, b) by the angle whose cosine and sine stand in rows _C and _S."""
    for i in range(WIDTH):
        x = work[a, i]
        s = sign * work[_S, i]
        work[a, i] = work[_C, i] * x - s * work[b, i]
        work[b, i] = s * x + work[_C, i] * work[b, i]


@_inline
def _angle(work, start, base, first, last, terms, values, drivers):
    """Rows _C, _S of a small angle: base plus its varying terms."""
    work[_D] = 0.0
    _add(work, _D, 1.0, base, start, first, last, terms, values, drivers)
    for i in range(WIDTH):
        x = work[_D, i]
        work[_S, i] = _sin(x)
        work[_C, i] = _cos(x)


@_inline
def _joint_angle(work, start, base, first, last, terms, values, drivers, joint, sines, cosines):
    """Rows _C, _S of a joint's whole angle: the nominal one, displaced."""
    nominal_sine = sines[joint, start : start + WIDTH]
    nominal_cosine = cosines[joint, start : start + WIDTH]
    if first == last:
        s, c = math.sin(base), math.cos(base)
        for i in range(WIDTH):
            a, b = nominal_sine[i], nominal_cosine[i]
            work[_S, i] = a * c + b * s
            work[_C, i] = b * c - a * s
    else:
        value = values[terms[first, 1]]
        driver = drivers[terms[first, 2], start : start + WIDTH]
        for i in range(WIDTH):
            work[_D, i] = base + value * driver[i]
        _add(work, _D, 1.0, 0.0, start, first + 1, last, terms, values, drivers)
        for i in range(WIDTH):
            x = work[_D, i]
            s, c = _sin(x), _cos(x)
            a, b = nominal_sine[i], nominal_cosine[i]
            work[_S, i] = a * c + b * s
            work[_C, i] = b * c - a * s


@_jit
def _out_displaced(work, start, frame, pairs, const, firsts, terms, values, drivers):
    """Apply the pairs `pairs`..2 of one frame's displacement to the points, from Ry Ty outward."""
    for pair in range(2, pairs - 1, -1):
        axis, b, c = _AXES[pair]
        turn, slide = 6 * frame + 2 * pair, 6 * frame + 2 * pair + 1
        _add(work, axis, 1.0, const[slide], start, firsts[slide], firsts[slide + 1], terms, values, drivers)
        if firsts[turn] < firsts[turn + 1]:
            _angle(work, start, const[turn], firsts[turn], firsts[turn + 1], terms, values, drivers)
            _turn_rows(work, b, c, 1.0)
        elif const[turn] != 0.0:
            _turn(work, b, c, math.cos(const[turn]), math.sin(const[turn]))


@_jit
def _matrices(const, link, distance, general, out):
    """Per joint one 3 x 4 matrix: Tz Rx Tx Ry Ty of the frame times `link`, as far as they are constant."""
    n = len(distance)
    for f in range(1, n + 1):
        sx, cx, sy, cy, tx, ty = 0.0, 1.0, 0.0, 1.0, 0.0, 0.0
        if not general[f]:
            tx, ty = const[6 * f + 3], const[6 * f + 5]
            sx, cx = math.sin(const[6 * f + 2]), math.cos(const[6 * f + 2])
            sy, cy = math.sin(const[6 * f + 4]), math.cos(const[6 * f + 4])
        for j in range(4):
            x, y, z = link[f, 0, j], link[f, 1, j], link[f, 2, j]
            if j == 3:
                y += ty
            x, z = cy * x + sy * z, cy * z - sy * x
            if j == 3:
                x += tx
            y, z = cx * y - sx * z, sx * y + cx * z
            if j == 3 and not general[f]:
                z += distance[f - 1] + const[6 * f + 1]
            out[f, 0, j], out[f, 1, j], out[f, 2, j] = x, y, z


@_inline
def _map(work, m):
    """The points mapped by m (3 x 4)."""
    m00, m01, m02, m03 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, m13 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, m23 = m[2, 0], m[2, 1], m[2, 2], m[2, 3]
    for i in range(WIDTH):
        x, y, z = work[_X, i], work[_Y, i], work[_Z, i]
        work[_X, i] = m00 * x + (m01 * y + (m02 * z + m03))
        work[_Y, i] = m10 * x + (m11 * y + (m12 * z + m13))
        work[_Z, i] = m20 * x + (m21 * y + (m22 * z + m23))


@_inline
def _unmap(work, m, shift):
    """Point and force of the wrench = the inverse of the rigid m (3 x 4), z first taken back by `shift`."""
    m00, m01, m02, t0 = m[0, 0], m[0, 1], m[0, 2], m[0, 3]
    m10, m11, m12, t1 = m[1, 0], m[1, 1], m[1, 2], m[1, 3]
    m20, m21, m22, t2 = m[2, 0], m[2, 1], m[2, 2], m[2, 3] - shift
    for i in range(WIDTH):
        x, y, z = work[_X, i] - t0, work[_Y, i] - t1, work[_Z, i] - t2
        u, v, w = work[_U, i], work[_V, i], work[_W, i]
        work[_X, i] = m00 * x + (m10 * y + m20 * z)
        work[_Y, i] = m01 * x + (m11 * y + m21 * z)
        work[_Z, i] = m02 * x + (m12 * y + m22 * z)
        work[_U, i] = m00 * u + (m10 * v + m20 * w)
        work[_V, i] = m01 * u + (m11 * v + m21 * w)
        work[_W, i] = m02 * u + (m12 * v + m22 * w)


@_inline
def _offset(work, sign, tool, start):
    """The points moved by sign x their tool's centre."""
    for j in range(3):
        centre = tool[j, start : start + WIDTH]
        for i in range(WIDTH):
            work[j, i] += sign * centre[i]


@_inline
def _constants(values, constant_terms, const):
    const[:] = 0.0
    for k in range(len(constant_terms)):
        const[constant_terms[k, 0]] += values[constant_terms[k, 1]]


@_jit
def points(values, constant_terms, terms, firsts, general, drivers, sines, cosines, tool, base, link, d, out):
    """Ball centres for many parameter vectors.

    Parameters
    ----------
    values : (W, P) parameter values, SI, as deviations from nominal
    constant_terms : (K0, 2) int64, site and parameter of the terms whose driver is 1
    terms : (K, 3) int64, site, parameter and driver row of the others, sorted by site
    firsts : (6 (n + 2) + 1,) int64, where each site's rows of `terms` begin
    general : (n + 2,) bool, frames in which more than the joint's own angle varies
    drivers, sines, cosines, tool : (R, B), (n, B), (n, B), (3, B), B a multiple of WIDTH
    base, link, d : (4, 4), (n + 1, 4, 4), (n,), of `chain.Chain`
    out : (W, 3, B), m, written
    """
    n = len(d)
    const = np.empty(6 * (n + 2))
    matrices = np.empty((n + 1, 3, 4))
    work = np.empty((_ROWS, WIDTH))
    for w in range(values.shape[0]):
        row = values[w]
        _constants(row, constant_terms, const)
        _matrices(const, link, d, general, matrices)
        for start in range(0, tool.shape[1], WIDTH):
            for j in range(3):
                work[j] = 0.0 if general[n + 1] else const[6 * (n + 1) + (3, 5, 1)[j]]
            if general[n + 1]:
                _out_displaced(work, start, n + 1, _ZXY, const, firsts, terms, row, drivers)
            _offset(work, 1.0, tool, start)
            for f in range(n, 0, -1):
                site = 6 * f
                _map(work, matrices[f])
                if general[f]:
                    _out_displaced(work, start, f, _XY, const, firsts, terms, row, drivers)
                    shift = d[f - 1] + const[site + 1]
                    _add(work, _Z, 1.0, shift, start, firsts[site + 1], firsts[site + 2], terms, row, drivers)
                _joint_angle(
                    work, start, const[site], firsts[site], firsts[site + 1], terms, row, drivers,
                    f - 1, sines, cosines,
                )  # fmt: skip
                _turn_rows(work, _X, _Y, 1.0)
            _map(work, link[0])
            _out_displaced(work, start, _BASE, _ZXY, const, firsts, terms, row, drivers)
            _map(work, base)
            for j in range(3):  # numba compiles assignments of arrays to arrays for seconds
                for i in range(WIDTH):
                    out[w, j, start + i] = work[j, i]


@_inline
def _emit(work, component, start, site, by_site, by_first, drivers, columns, fresh):
    """Add a row, the wrench component of a site, times their drivers, to the columns of its terms."""
    for k in range(by_first[site], by_first[site + 1]):
        parameter = by_site[k, 1]
        column = columns[parameter, start : start + WIDTH]
        driver = drivers[by_site[k, 2], start : start + WIDTH]
        if fresh[parameter]:
            fresh[parameter] = False
            for i in range(WIDTH):
                column[i] = work[component, i] * driver[i]
        else:
            for i in range(WIDTH):
                column[i] += work[component, i] * driver[i]


@_inline
def _emit_pair(work, start, turn, axis, b, c, by_site, by_first, drivers, columns, fresh):
    """The columns of a turn about and a slide along one axis, from point and force in that frame."""
    if by_first[turn] < by_first[turn + 1]:
        for i in range(WIDTH):
            work[_T, i] = work[b, i] * work[c + 3, i] - work[c, i] * work[b + 3, i]
        _emit(work, _T, start, turn, by_site, by_first, drivers, columns, fresh)
    _emit(work, axis + 3, start, turn + 1, by_site, by_first, drivers, columns, fresh)


@_jit
def _back_displaced(
    work, start, frame, pairs, const, firsts, terms, values, drivers, by_site, by_first, columns, fresh
):
    """Undo the pairs `pairs`..2 of a frame's displacement, giving their columns on the way."""
    for pair in range(pairs, 3):
        axis, b, c = _AXES[pair]
        turn, slide = 6 * frame + 2 * pair, 6 * frame + 2 * pair + 1
        _emit_pair(work, start, turn, axis, b, c, by_site, by_first, drivers, columns, fresh)
        if firsts[turn] < firsts[turn + 1]:
            _angle(work, start, const[turn], firsts[turn], firsts[turn + 1], terms, values, drivers)
            _turn_rows(work, b, c, -1.0)
            _turn_rows(work, b + 3, c + 3, -1.0)
        elif const[turn] != 0.0:
            cosine, sine = math.cos(const[turn]), -math.sin(const[turn])
            _turn(work, b, c, cosine, sine)
            _turn(work, b + 3, c + 3, cosine, sine)
        first, last = firsts[slide], firsts[slide + 1]
        if const[slide] != 0.0 or first < last:
            _add(work, axis, -1.0, const[slide], start, first, last, terms, values, drivers)


@_jit
def columns(
    values, constant_terms, terms, firsts, general, by_site, by_first, drivers, sines, cosines, tool, base,
    link, d, p, u, out,
):  # fmt: skip
    """Derivatives of ``u . p`` by every parameter: the contact wrench carried from base to tool.

    Parameters
    ----------
    values : (P,) the parameters at which `p` was found
    by_site, by_first : all terms (K0 + K, 3) sorted by site, and where each site begins
    p, u : (3, C) ball centres and directions in F0, C <= B
    out : (P, B) written
    """
    n = len(d)
    const = np.empty(6 * (n + 2))
    matrices = np.empty((n + 1, 3, 4))
    work = np.empty((_ROWS, WIDTH))
    fresh = np.empty(len(out), np.bool_)
    _constants(values, constant_terms, const)
    _matrices(const, link, d, general, matrices)
    for start in range(0, tool.shape[1], WIDTH):
        for j in range(len(fresh)):
            fresh[j] = True
        inside = min(WIDTH, p.shape[1] - start)  # what lies beyond is padding: zeros
        work[:6] = 0.0
        for j in range(3):
            for i in range(inside):
                work[j, i], work[j + 3, i] = p[j, start + i], u[j, start + i]
        _unmap(work, base, 0.0)
        _back_displaced(
            work, start, _BASE, _ZXY, const, firsts, terms, values, drivers, by_site, by_first, out, fresh
        )
        _unmap(work, link[0], 0.0)
        for f in range(1, n + 1):
            site = 6 * f
            _emit_pair(work, start, site, 2, 0, 1, by_site, by_first, drivers, out, fresh)
            _joint_angle(
                work, start, const[site], firsts[site], firsts[site + 1], terms, values, drivers,
                f - 1, sines, cosines,
            )  # fmt: skip
            shift = d[f - 1] + const[site + 1]
            _turn_rows(work, _X, _Y, -1.0)
            _turn_rows(work, _U, _V, -1.0)
            _add(work, _Z, -1.0, shift, start, 0, 0, terms, values, drivers)
            if general[f] or by_first[site + 4] < by_first[site + 6]:
                _add(work, _Z, -1.0, 0.0, start, firsts[site + 1], firsts[site + 2], terms, values, drivers)
                _back_displaced(
                    work, start, f, _XY, const, firsts, terms, values, drivers, by_site, by_first, out, fresh
                )
                _unmap(work, link[f], 0.0)
            else:
                _emit_pair(work, start, site + 2, 0, 1, 2, by_site, by_first, drivers, out, fresh)
                _unmap(work, matrices[f], shift)
        _offset(work, -1.0, tool, start)
        _back_displaced(
            work, start, n + 1, _ZXY, const, firsts, terms, values, drivers, by_site, by_first, out, fresh
        )
        for j in range(len(fresh)):
            if fresh[j]:
                out[j, start : start + WIDTH] = 0.0
