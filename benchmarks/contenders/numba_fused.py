"""Numba: the whole equation fused by hand into one loop over samples, and its hand-derived reverse sweep beside it."""

from __future__ import annotations

import math
from typing import Any

import numba
import numpy as np

from ..workload import Arrays, Workload
from .base import Contender, Operation, Run, ValueAndGradient

LIGHT_FIELDS = ("ambient_intensity", "attenuation", "color", "intensity", "location", "radius")
MATERIAL_FIELDS = ("ambient_intensity", "diffuse_color", "emissive_color", "shininess", "specular_color")
_ONE = np.float32(1)
_TINY = np.float32(1e-30)
_ZERO = np.float32(0)

jit = numba.njit(fastmath=True, error_model="numpy", boundscheck=False)


@jit
def shade(position, normal, tint, eye, fog_color, visibility, mat, lights, out):
    """out [3, N]. `mat` and `lights` are tuples in the order of the field lists above."""
    oa, diffuse, emissive, shininess, specular = mat
    ambient_intensity, attenuation, color, intensity, location, radius = lights
    exponent = np.float32(128) * shininess
    for i in range(position.shape[1]):
        px, py, pz = position[0, i], position[1, i], position[2, i]
        nx, ny, nz = normal[0, i], normal[1, i], normal[2, i]
        vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
        far = math.sqrt(vx * vx + vy * vy + vz * vz)
        vx, vy, vz = vx / far, vy / far, vz / far
        dr = dg = db = sr = sg = sb = _ZERO
        for k in range(len(intensity)):
            x, y, z = location[k, 0] - px, location[k, 1] - py, location[k, 2] - pz
            d = math.sqrt(x * x + y * y + z * z)
            if d > radius[k]:
                continue
            inv = _ONE / d
            x, y, z = x * inv, y * inv, z * inv
            n_l = max(nx * x + ny * y + nz * z, _ZERO)
            hx, hy, hz = x + vx, y + vy, z + vz
            n_h = max((nx * hx + ny * hy + nz * hz) / math.sqrt(hx * hx + hy * hy + hz * hz), _TINY)
            peak = math.exp(exponent * math.log(n_h))
            w = _ONE / max(attenuation[k, 0] + attenuation[k, 1] * d + attenuation[k, 2] * d * d, _ONE)
            wd = w * (ambient_intensity[k] * oa + intensity[k] * n_l)
            ws = w * intensity[k] * peak
            dr += wd * color[k, 0]
            dg += wd * color[k, 1]
            db += wd * color[k, 2]
            sr += ws * color[k, 0]
            sg += ws * color[k, 1]
            sb += ws * color[k, 2]
        f = math.exp(-far / (visibility - far))
        g = _ONE - f
        r0, r1, r2 = diffuse[0], diffuse[1], diffuse[2]
        if tint.shape[1] > 0:
            r0, r1, r2 = tint[0, i], tint[1, i], tint[2, i]
        out[0, i] = fog_color[0] * g + f * (emissive[0] + dr * r0 + sr * specular[0])
        out[1, i] = fog_color[1] * g + f * (emissive[1] + dg * r1 + sg * specular[1])
        out[2, i] = fog_color[2] * g + f * (emissive[2] + db * r2 + sb * specular[2])


@jit
def loss_gradient(position, normal, tint, eye, fog_color, visibility, mat, lights, target, keep, g_mat, g_lights):
    """Sum of squared residuals; adds its derivative to `g_mat` [11] and `g_lights` [L, 11] (float64).

    `keep` [L, 12] holds what the reverse sweep of one sample needs.
    """
    oa, diffuse, emissive, shininess, specular = mat
    ambient_intensity, attenuation, color, intensity, location, radius = lights
    exponent = np.float32(128) * shininess
    value = 0.0
    for i in range(position.shape[1]):
        px, py, pz = position[0, i], position[1, i], position[2, i]
        nx, ny, nz = normal[0, i], normal[1, i], normal[2, i]
        vx, vy, vz = eye[0] - px, eye[1] - py, eye[2] - pz
        far = math.sqrt(vx * vx + vy * vy + vz * vz)
        vx, vy, vz = vx / far, vy / far, vz / far
        dr = dg = db = sr = sg = sb = _ZERO
        for k in range(len(intensity)):
            x, y, z = location[k, 0] - px, location[k, 1] - py, location[k, 2] - pz
            d = math.sqrt(x * x + y * y + z * z)
            keep[k, 3] = d
            if d > radius[k]:
                continue
            inv = _ONE / d
            x, y, z = x * inv, y * inv, z * inv
            n_l = max(nx * x + ny * y + nz * z, _ZERO)
            hx, hy, hz = x + vx, y + vy, z + vz
            half = _ONE / math.sqrt(hx * hx + hy * hy + hz * hz)
            n_h = max((nx * hx + ny * hy + nz * hz) * half, _TINY)
            log_n_h = math.log(n_h)
            peak = math.exp(exponent * log_n_h)
            w = _ONE / max(attenuation[k, 0] + attenuation[k, 1] * d + attenuation[k, 2] * d * d, _ONE)
            wd = w * (ambient_intensity[k] * oa + intensity[k] * n_l)
            ws = w * intensity[k] * peak
            keep[k, 0], keep[k, 1], keep[k, 2], keep[k, 4] = x, y, z, n_l
            keep[k, 5], keep[k, 6], keep[k, 7], keep[k, 8] = half, n_h, log_n_h, peak
            keep[k, 9], keep[k, 10], keep[k, 11] = w, wd, ws
            dr += wd * color[k, 0]
            dg += wd * color[k, 1]
            db += wd * color[k, 2]
            sr += ws * color[k, 0]
            sg += ws * color[k, 1]
            sb += ws * color[k, 2]
        f = math.exp(-far / (visibility - far))
        g = _ONE - f
        r0, r1, r2 = diffuse[0], diffuse[1], diffuse[2]
        if tint.shape[1] > 0:
            r0, r1, r2 = tint[0, i], tint[1, i], tint[2, i]
        e0 = fog_color[0] * g + f * (emissive[0] + dr * r0 + sr * specular[0]) - target[0, i]
        e1 = fog_color[1] * g + f * (emissive[1] + dg * r1 + sg * specular[1]) - target[1, i]
        e2 = fog_color[2] * g + f * (emissive[2] + db * r2 + sb * specular[2]) - target[2, i]
        value += e0 * e0 + e1 * e1 + e2 * e2
        e0, e1, e2 = 2 * f * e0, 2 * f * e1, 2 * f * e2
        g_mat[1] += e0 * dr
        g_mat[2] += e1 * dg
        g_mat[3] += e2 * db
        g_mat[4] += e0
        g_mat[5] += e1
        g_mat[6] += e2
        g_mat[8] += e0 * sr
        g_mat[9] += e1 * sg
        g_mat[10] += e2 * sb
        for k in range(len(intensity)):
            d = keep[k, 3]
            if d > radius[k]:
                continue
            x, y, z, n_l = keep[k, 0], keep[k, 1], keep[k, 2], keep[k, 4]
            half, n_h, log_n_h, peak = keep[k, 5], keep[k, 6], keep[k, 7], keep[k, 8]
            w, wd, ws = keep[k, 9], keep[k, 10], keep[k, 11]
            d_wd = e0 * color[k, 0] * r0 + e1 * color[k, 1] * r1 + e2 * color[k, 2] * r2
            d_ws = e0 * color[k, 0] * specular[0] + e1 * color[k, 1] * specular[1] + e2 * color[k, 2] * specular[2]
            a = ambient_intensity[k] * oa + intensity[k] * n_l
            d_peak = d_ws * w * intensity[k] * peak
            d_n_l = d_wd * w * intensity[k] if n_l > 0 else _ZERO
            d_n_h = d_peak * exponent / n_h
            d_w = d_wd * a + d_ws * intensity[k] * peak
            d_sum = -d_w * w * w if w < _ONE else _ZERO
            d_d = d_sum * (attenuation[k, 1] + 2 * attenuation[k, 2] * d)
            hx, hy, hz = (x + vx) * half, (y + vy) * half, (z + vz) * half
            c = d_n_h * half
            lx = d_n_l * nx + c * (nx - n_h * hx)
            ly = d_n_l * ny + c * (ny - n_h * hy)
            lz = d_n_l * nz + c * (nz - n_h * hz)
            along = x * lx + y * ly + z * lz
            inv = _ONE / d
            g_mat[0] += d_wd * w * ambient_intensity[k]
            g_mat[7] += 128 * d_peak * log_n_h
            g_lights[k, 0] += d_wd * w * oa
            g_lights[k, 1] += d_sum
            g_lights[k, 2] += d_sum * d
            g_lights[k, 3] += d_sum * d * d
            g_lights[k, 4] += e0 * (wd * r0 + ws * specular[0])
            g_lights[k, 5] += e1 * (wd * r1 + ws * specular[1])
            g_lights[k, 6] += e2 * (wd * r2 + ws * specular[2])
            g_lights[k, 7] += w * (d_wd * n_l + d_ws * peak)
            g_lights[k, 8] += (lx - x * along) * inv + d_d * x
            g_lights[k, 9] += (ly - y * along) * inv + d_d * y
            g_lights[k, 10] += (lz - z * along) * inv + d_d * z
    return value


class NumbaFused(Contender):
    """One thread, `fastmath`; compiled for its types by a call on a few samples."""

    def __init__(self, work: Workload, arrays: Arrays) -> None:
        tint = np.empty((3, 0), np.float32) if arrays.sample_color is None else arrays.sample_color
        material = {**arrays.material}
        self._planes = (arrays.position, arrays.normal, tint)
        self._rest = (
            arrays.eye,
            arrays.fog_color,
            np.float32(arrays.fog_visibility),
            tuple(material[name] if material[name].ndim else np.float32(material[name]) for name in MATERIAL_FIELDS),
            tuple(arrays.lights[name] for name in LIGHT_FIELDS),
        )
        self._target = arrays.target
        self._out = np.empty_like(arrays.position)
        self._keep = np.empty((work.lights, 12), np.float32)
        self._free = tuple(arrays.parameters)

    def prepare(self, operation: Operation) -> Run:
        run = self._forward if operation == "forward" else self._gradient
        run(16)
        return run

    def _forward(self, count: int | None = None) -> np.ndarray:
        shade(*(plane[:, :count] for plane in self._planes), *self._rest, self._out[:, :count])
        return self._out

    def _gradient(self, count: int | None = None) -> tuple[float, np.ndarray, np.ndarray]:
        g_mat, g_lights = np.zeros(11), np.zeros((len(self._keep), 11))
        planes = (plane[:, :count] for plane in self._planes)
        target = self._target[:, :count]
        value = loss_gradient(*planes, *self._rest, target, self._keep, g_mat, g_lights)
        return value, g_mat, g_lights

    def colors(self, result: Any) -> np.ndarray:
        return result

    def value_and_gradient(self, result: Any) -> ValueAndGradient:
        value, g_mat, g_lights = result
        blocks = [0, slice(1, 4), slice(4, 7), 7, slice(8, 11)]
        fields = {f"material.{name}": g_mat[block] for name, block in zip(MATERIAL_FIELDS, blocks, strict=True)}
        fields |= {f"lights.{name}": g_lights[:, b] for name, b in zip(LIGHT_FIELDS[:5], blocks, strict=True)}
        return ValueAndGradient(value, {name: fields[name] for name in self._free})
